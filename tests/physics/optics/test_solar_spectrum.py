"""Sunlight by wavelength: the standard spectrum, what klux means, filters, and Table 1's irradiance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarscene.physics.optics import solar_spectrum as sun
from lidarscene.physics.optics.solar_spectrum import SpectralCurve
from lidarscene.physics.reference import optics as reference_optics

NM = 1e-9

# V(lambda) of CIE 1924 at 10 nm (Wyszecki and Stiles, Color Science, 2nd ed., table I(3.3.1)).
VALUES = """
    0.000039 0.00012 0.000396 0.00121 0.004 0.0116 0.023 0.038 0.060 0.09098 0.13902 0.20802 0.323 0.503 0.710 0.862
    0.954 0.99495 0.995 0.952 0.870 0.757 0.631 0.503 0.381 0.265 0.175 0.107 0.061 0.032 0.017 0.00821 0.004102
    0.002091 0.001047 0.00052 0.000249 0.00012 0.00006 0.00003 0.000015
"""
TABLE = dict(zip(range(380, 790, 10), map(float, VALUES.split()), strict=True))


def flat(value: float = 1.0) -> SpectralCurve:
    return SpectralCurve(wavelength_m=np.arange(300, 2001) * NM, value=np.full(1701, value / NM))


def spectrum(name: str) -> SpectralCurve:
    pytest.importorskip("pvlib")
    from lidarscene.files.pvlib import reference_spectrum

    return reference_spectrum(name)


def band(name: str, centre_nm: float, width_nm: float) -> float:
    box = sun.box_filter(centre_m=centre_nm * NM, width_m=width_nm * NM)
    return sun.irradiance_at_100_klux_w_m2(spectrum(name), box)


def test_luminous_efficiency_follows_the_table() -> None:
    """The fit is as close as the docstring says."""
    error = sun.photopic_efficiency(wavelength_m=np.array(list(TABLE)) * NM) - np.array(list(TABLE.values()))
    assert np.abs(error).max() < 0.0071
    assert sun.photopic_efficiency(wavelength_m=555 * NM) == pytest.approx(1.0, abs=5e-3)


@pytest.mark.parametrize("name", ["global", "direct", "extraterrestrial"])
def test_illuminance_by_the_table(name: str) -> None:
    """The fit and the table, interpolated by cubics, make the same daylight to 0.1 %."""
    pchip = pytest.importorskip("scipy.interpolate").PchipInterpolator
    table = pchip(np.array(list(TABLE)) * NM, list(TABLE.values()))
    lumens = sun.integral(spectrum(name), table, nodes_m=np.arange(380, 781) * NM)
    assert sun.illuminance_lux(spectrum(name)) == pytest.approx(sun.LUMINOUS_EFFICACY_LM_W * lumens, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "w_m2", "klux"), [("global", 1000.4, 109.5), ("direct", 900.1, 97.2), ("extraterrestrial", 1347.9, 133.1)]
)
def test_totals_of_astm_g173(name: str, w_m2: float, klux: float) -> None:
    """Reference: the standard's own 1000.4 and 900.1 W/m2 (and 1366.1 W/m2 with all beyond 4 um).

    The illuminance of AM1.5 global is 109.6 klx by integration with the analytic curve of V(lambda) (docs/sun.md).
    """
    assert reference_optics.total(spectrum(name)) == pytest.approx(w_m2, abs=0.05)
    assert sun.illuminance_lux(spectrum(name)) == pytest.approx(klux * 1e3, rel=1e-3)


@pytest.mark.parametrize(("centre_nm", "w_m2_nm"), [(850, 0.89), (905, 0.63), (940, 0.28), (1064, 0.57), (1550, 0.25)])
def test_mean_over_20_nm_at_100_klux(centre_nm: float, w_m2_nm: float) -> None:
    """Reference: ASTM G173-03 global, integrated apart from this code, two digits."""
    assert band("global", centre_nm, 20) / 20 == pytest.approx(w_m2_nm, abs=0.005)


@pytest.mark.parametrize(("name", "width_nm"), [("global", 42.84), ("direct", 40.85), ("extraterrestrial", 43.22)])
def test_filter_that_table_1_implies(name: str, width_nm: float) -> None:
    """29.4 W/m2 at 905 nm and 100 klux: docs/sun.md states these widths."""
    width_m = reference_optics.implied_box_width_m(spectrum(name), centre_m=905 * NM, irradiance_w_m2=29.4)
    assert width_m == pytest.approx(width_nm * NM, abs=0.006 * NM)
    assert band(name, 905, width_m / NM) == pytest.approx(29.4, rel=1e-9)


def test_implied_width_says_what_is_too_much() -> None:
    with pytest.raises(ValueError, match=r"at most 913\.\d W/m2"):
        reference_optics.implied_box_width_m(spectrum("global"), centre_m=905 * NM, irradiance_w_m2=2000.0)


def test_no_light_through_no_filter() -> None:
    far = sun.box_filter(centre_m=5000 * NM, width_m=10 * NM)
    assert sun.irradiance_at_100_klux_w_m2(flat(), far) == 0.0


@given(centre=st.floats(400, 1900), width=st.floats(0.01, 90), value=st.floats(1e-3, 1e3))
@settings(max_examples=60)
def test_flat_spectrum(centre: float, width: float, value: float) -> None:
    """Light through a box: value times width, however narrow. Through another shape: value times its equivalent
    width.
    """
    light = flat(value)
    box = sun.box_filter(centre_m=centre * NM, width_m=width * NM)
    assert sun.in_band_irradiance_w_m2(light, box) == pytest.approx(value * width, rel=1e-6)
    smooth = sun.gaussian_filter(centre_m=centre * NM, width_m=0.1 * width * NM)
    expected = value * reference_optics.total(smooth) / NM
    assert sun.in_band_irradiance_w_m2(light, smooth) == pytest.approx(expected, rel=1e-6)


def test_gaussian_at_half_height() -> None:
    """The full width at half maximum is the width; the equivalent width is sqrt(pi / ln2) / 2 of it."""
    curve = sun.gaussian_filter(centre_m=905 * NM, width_m=40 * NM)
    np.testing.assert_allclose(curve.at(np.array([885, 905, 925]) * NM), [0.5, 1.0, 0.5], atol=2e-3)
    assert reference_optics.total(curve) == pytest.approx(40 * NM * 1.0644670, rel=1e-3)


def test_share_of_a_laser_that_drifts() -> None:
    """A Gaussian 20 nm wide at half, 10 nm beside its middle, has half of the light. Tolerance: its table."""
    curve = sun.gaussian_filter(centre_m=905 * NM, width_m=20 * NM)
    assert sun.passed_share(curve, wavelength_m=905 * NM, drift_m=10 * NM) == pytest.approx(0.5, rel=1e-4)
    assert sun.passed_share(curve, wavelength_m=895 * NM, drift_m=10 * NM) == pytest.approx(2.0, rel=1e-4)


def test_units() -> None:
    """Twice the light is twice the irradiance as it is, and the same at 100 klux."""
    box = sun.box_filter(centre_m=905 * NM, width_m=10 * NM)
    assert sun.in_band_irradiance_w_m2(flat(2.0), box) == pytest.approx(20.0)
    assert sun.irradiance_at_100_klux_w_m2(flat(2.0), box) == pytest.approx(
        sun.irradiance_at_100_klux_w_m2(flat(1.0), box)
    )


@pytest.mark.parametrize("wavelengths", [[1.0], [1.0, 1.0], [2.0, 1.0]])
def test_curves_rise(wavelengths: list[float]) -> None:
    with pytest.raises(ValueError, match="each longer than the one before"):
        SpectralCurve(wavelength_m=np.array(wavelengths), value=np.ones(len(wavelengths)))


def test_the_product_of_straight_lines_is_integrated_exactly() -> None:
    """int x (3 - x) dx from 1 to 2 is 13 / 6, with a point of either curve in between or not."""
    for inner in ([], [1.3]):
        points = np.array([1.0, *inner, 2.0])
        line = SpectralCurve(wavelength_m=points, value=points)
        integral = sun.integral(line, lambda x: 3.0 - x, nodes_m=np.array([0.5, 1.6, 2.5]))
        assert integral == pytest.approx(13.0 / 6.0, rel=1e-12)
