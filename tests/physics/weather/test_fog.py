"""Fog: published extinction and lidar ratios against Mie's theory over the published sizes."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from lidarscene.physics.optics import air
from lidarscene.physics.weather import fog, mie


@pytest.mark.parametrize("kind", fog.TYPES)
def test_sizes_hold_the_published_number(kind):
    droplets = fog.TYPES[kind]
    number, _ = quad(droplets.per_m4, 0.0, droplets.largest_m, epsabs=0, epsrel=1e-10, limit=200)
    assert number == pytest.approx(droplets.number_per_m3, rel=1e-6)
    radius = np.linspace(0.0, 3 * droplets.mode_m, 30_001)
    assert radius[np.argmax(droplets.per_m4(radius))] == pytest.approx(droplets.mode_m, rel=1e-3)


@pytest.mark.parametrize(("kind", "a", "alpha", "b"), [("strong_advection", 0.027, 3, 0.3), ("radiation", 607.5, 6, 3)])
def test_coefficients_as_printed(kind, a, alpha, b):
    """Shettle and Fenn print n = a r^alpha exp(-b r) per cm3 and micrometre, r in micrometres, with these."""
    radius_um = np.array([0.5, 2.0, 8.0])
    expected = a * radius_um**alpha * np.exp(-b * radius_um) * 1e12
    np.testing.assert_allclose(fog.TYPES[kind].per_m4(radius_um * 1e-6), expected, rtol=1e-3)


@pytest.mark.parametrize(("kind", "visibility_m"), [("moderate_advection", 200.0), ("radiation", 500.0)])
def test_visibilities_of_lowtran(kind, visibility_m):
    """LOWTRAN 7 takes 0.2 km for advection and 0.5 km for radiation fog if none is given: one digit each."""
    assert fog.visibility_m(fog.TYPES[kind]) == pytest.approx(visibility_m, rel=0.12)


@pytest.mark.parametrize(
    ("wavelength_m", "kind"),
    [*((905e-9, kind) for kind in fog.TYPES), (1550e-9, "moderate_advection"), (1550e-9, "radiation")],
)
def test_extinction_is_near_twice_the_shadow(kind, wavelength_m):
    """2 pi N <r^2>, <r^2> = b^(-2/gamma) Gamma((alpha + 3)/gamma) / Gamma((alpha + 1)/gamma) in closed form.

    Above it by the edge's 2 (pi / x)^(2/3) and the first oscillations of Q_ext, for droplets of 2 um a fifth.
    """
    d = fog.TYPES[kind]
    b = d.alpha / d.gamma / d.mode_m**d.gamma
    moment = math.gamma((d.alpha + 3) / d.gamma) / math.gamma((d.alpha + 1) / d.gamma) * b ** (-2 / d.gamma)
    extinction, _ = fog.scattering(d, wavelength_m)
    assert 1.02 < extinction / (2 * math.pi * d.number_per_m3 * moment) < 1.26


@pytest.mark.parametrize("kind", ["strong_advection", "moderate_advection", "strong_spray", "chu_hogg"])
def test_lidar_ratio_at_905_nm(kind):
    """18.8 +- 0.8 sr for water clouds of 8 to 20 um median volume diameter at 905 nm, by Mie's theory and by
    lidar: E. J. O'Connor, A. J. Illingworth and R. J. Hogan, J. Atmos. Oceanic Technol. 21, 777 (2004).
    """
    extinction, backscatter = fog.scattering(fog.TYPES[kind], 905e-9)
    assert extinction / backscatter == pytest.approx(18.8, abs=0.8)


def test_colour_ratio_of_drizzle(monkeypatch):
    """A median volume diameter of 200 um sends 6 dB less back at 1.5 um than at 905 nm: C. D. Westbrook and
    others, Atmos. Meas. Tech. 3, 671 (2010). Theirs is a gamma distribution of shape 0 to 10 (here 2), 1 dB wide.
    """
    monkeypatch.setattr(fog, "_RADII", 500)  # an eighth of them is enough for 1 dB
    median_m = 200e-6
    drizzle = fog.Droplets(number_per_m3=1e3, alpha=2.0, gamma=1.0, mode_m=2.0 / (3.67 + 2.0) * median_m / 2)
    (_, at_905), (_, at_1550) = (fog.scattering(drizzle, w) for w in (905e-9, 1550e-9))
    assert 10 * math.log10(at_905 / at_1550) == pytest.approx(6.0, abs=1.0)


def extinction_al_naboulsi_per_m(*, visibility_m, wavelength_m, kind):
    """Extinction of "advection" or "radiation" fog from visibility, 690 to 1550 nm and 50 m to 1 km.

    M. Al Naboulsi, H. Sizun and F. de Fornel, Opt. Eng. 43, 319 (2004): fits to FASCOD, (0.11478 lambda + 3.8367) / V
    and (0.18126 lambda^2 + 0.13709 lambda + 3.7502) / V per km, lambda in micrometres, V in km.
    """
    um = wavelength_m * 1e6
    fits = {"advection": 0.11478 * um + 3.8367, "radiation": 0.18126 * um * um + 0.13709 * um + 3.7502}
    return fits[kind] / visibility_m


@pytest.mark.parametrize("wavelength_m", [850e-9, 905e-9, 1550e-9])
@pytest.mark.parametrize(("kind", "fit"), [("moderate_advection", "advection"), ("radiation", "radiation")])
def test_al_naboulsi(kind, fit, wavelength_m):
    """The published fits of the same fogs against Mie's theory at the same visibility: within 5 %."""
    droplets = fog.TYPES[kind]
    expected = extinction_al_naboulsi_per_m(
        visibility_m=fog.visibility_m(droplets), wavelength_m=wavelength_m, kind=fit
    )
    assert fog.scattering(droplets, wavelength_m)[0] == pytest.approx(expected, rel=0.06)


def test_dense_fog_is_as_grey_as_kim_says():
    """Kim has q = 0 below 500 m; Mie's theory has q between -0.1 and 0 over 550 to 1550 nm."""
    droplets = fog.TYPES["moderate_advection"]
    kim = air.extinction_from_visibility_per_m(visibility_m=fog.visibility_m(droplets), wavelength_m=905e-9)
    assert fog.scattering(droplets, 905e-9)[0] == pytest.approx(kim, rel=0.02)


def test_enough_radii():
    """Rationale: Q_back has spikes narrower than any grid. The same integral on an odd, finer grid, to 2 %."""
    droplets = fog.TYPES["strong_advection"]
    radius = np.linspace(0.0, droplets.largest_m, 9778)[1:]
    _, q = mie.efficiencies(size_parameter=2 * math.pi * radius / 905e-9, index=mie.water_index(wavelength_m=905e-9))
    beta = 0.25 * np.trapezoid(droplets.per_m4(radius) * radius**2 * q, radius)
    assert fog.scattering(droplets, 905e-9)[1] == pytest.approx(beta, rel=0.02)
