"""The sensor file of factors."""

import numpy as np
import pytest

from lidarscene import catalog
from lidarscene.studies.fit.estimates import Estimate
from lidarscene.studies.fit.sensor_text import parse_sensor, scaled_text

TEXT = catalog.path_of("sensors", "os0-128").read_text(encoding="utf-8")


def scale_text(**factors: float) -> tuple[str, tuple[str, ...]]:
    estimates = {
        key.replace("__", "."): Estimate(
            key=key.replace("__", "."), value=value, unit="times", fisher=0.01, bootstrap=0.01
        )
        for key, value in factors.items()
    }
    return scaled_text(TEXT, estimates, "drawn", "os0.toml")


def test_a_stretched_near_field_is_the_same_curve_farther_out() -> None:
    """Two lenses that meet and are in focus at 6.25 m: at 1.3 times the range all is as it was, and so is the sun."""
    text, notes = scale_text(near_field_m=1.3)
    assert not notes
    before, after = parse_sensor(TEXT, "a"), parse_sensor(text, "b")
    assert before.optics.overlap is not None
    assert after.optics.overlap is not None
    range_m = np.geomspace(1.0, 50.0, 15)
    # The table is linear between 1025 places; the file has six digits.
    np.testing.assert_allclose(
        after.optics.overlap.share(1.3 * range_m), before.optics.overlap.share(range_m), atol=1e-4
    )
    # Of power, aperture squared: K. Of aperture times field: the background.
    for figure_of in (
        lambda rated: rated.laser.peak_power_w * rated.optics.aperture_radius_m**2,
        lambda rated: rated.optics.aperture_radius_m / rated.optics.focal_length_m,
    ):
        assert figure_of(after) == pytest.approx(figure_of(before), rel=1e-5)


def test_what_does_not_go_with_the_rest_is_left_and_told() -> None:
    """Rationale: a pulse of 40 ns has no place in bins of 0.7 ns; the power is changed all the same."""
    text, notes = scale_text(laser__pulse_fwhm_ns=20.0, laser__peak_power_w=2.0)
    assert len(notes) == 1
    assert notes[0].startswith("laser.pulse_fwhm_ns is left as it was: ")
    before, after = parse_sensor(TEXT, "a"), parse_sensor(text, "b")
    assert after.laser.pulse_fwhm_s == before.laser.pulse_fwhm_s
    assert after.laser.peak_power_w == pytest.approx(2.0 * before.laser.peak_power_w, rel=1e-5)
    assert after.sources["laser.peak_power_w"].startswith("fitted with a scene: laser.peak_power_w 2 +/- 0.01 times")


def test_factors_of_one_key_multiply() -> None:
    """A near field 1.3 times as far shrinks angles by its root and takes its own from the power; both have their own
    factor besides.
    """
    text, notes = scale_text(near_field_m=1.3, spot_over_field=1.2, laser__peak_power_w=2.0)
    assert not notes
    before, after = parse_sensor(TEXT, "a").laser, parse_sensor(text, "b").laser
    assert after.divergence_rad == pytest.approx(1.2 / np.sqrt(1.3) * before.divergence_rad, rel=1e-5)
    assert after.peak_power_w == pytest.approx(2.0 / 1.3 * before.peak_power_w, rel=1e-5)


@pytest.mark.parametrize(("sigma", "is_written"), [(0.29, True), (0.31, False)])
def test_what_is_known_to_30_per_cent_is_written(sigma: float, is_written: bool) -> None:
    factor = Estimate(key="laser.peak_power_w", value=2.0, unit="times", fisher=2.0 * sigma, bootstrap=2.0 * sigma)
    text, notes = scaled_text(TEXT, {factor.key: factor}, "drawn", "os0.toml")
    assert (text != TEXT) is is_written
    assert (len(notes) == 1) is not is_written
