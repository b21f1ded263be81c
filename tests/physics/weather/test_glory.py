"""The glory of drops against Mie's series with its angular functions, and how a lens averages it."""

import math

import numpy as np
import pytest
from scipy.special import jv

from lidarscene.physics.weather import glory, mie, precipitation
from lidarscene.physics.weather.particles import Sight, medium_backscatter_per_m_sr, strengths

WAVELENGTH_M = 905e-9


def by_angular_functions(diameter_m: float, angle_rad: float) -> float:
    """W/sr per W/m2 at this angle from straight back: S_1 and S_2 by pi_n and tau_n (Bohren and Huffman, 4.74)."""
    x = math.pi * diameter_m / WAVELENGTH_M
    index = mie.water_index(wavelength_m=WAVELENGTH_M)
    electric, magnetic = mie.coefficients(size_parameter=np.array([x]), index=index)
    mu, before, latest = math.cos(math.pi - angle_rad), 0.0, 1.0
    s1 = s2 = 0.0 + 0.0j
    for n in range(1, len(electric) + 1):
        a, b = electric[n - 1, 0], magnetic[n - 1, 0]
        tau = n * mu * latest - (n + 1) * before
        s1 += (2 * n + 1) / (n * (n + 1)) * (a * latest + b * tau)
        s2 += (2 * n + 1) / (n * (n + 1)) * (a * tau + b * latest)
        before, latest = latest, ((2 * n + 1) * mu * latest - (n + 1) * before) / n
    return 0.5 * (abs(s1) ** 2 + abs(s2) ** 2) * (WAVELENGTH_M / (2.0 * math.pi)) ** 2


@pytest.mark.parametrize("diameter_m", [0.1e-3, 0.413e-3])
def test_brightness_near_straight_back(diameter_m: float) -> None:
    """Tolerance: the small angles of the Bessel functions and their table, 0.3 % of the brightness straight back."""
    places = np.array([0.0, 1.0, 2.5, 5.0, 12.0])
    brightness = glory.sphere_over_faces(diameter_m=np.array([diameter_m]), wavelength_m=WAVELENGTH_M, places=places)[0]
    faces = float(precipitation.drop_backscatter_m2_sr(diameter_m=diameter_m, wavelength_m=WAVELENGTH_M))
    angles = places * WAVELENGTH_M / (math.pi * diameter_m)
    exact = np.array([by_angular_functions(diameter_m, angle) / faces for angle in angles])
    assert brightness == pytest.approx(exact, abs=3e-3 * exact.max(), rel=3e-3)


def test_straight_back_is_the_radar_cross_section() -> None:
    x = np.array([500.0, 1000.0])
    diameter = x * WAVELENGTH_M / math.pi
    index = mie.water_index(wavelength_m=WAVELENGTH_M)
    radar = mie.efficiencies(size_parameter=x, index=index)[1] * diameter**2 / 16.0
    faces = np.asarray(precipitation.drop_backscatter_m2_sr(diameter_m=diameter, wavelength_m=WAVELENGTH_M))
    ratio = glory.sphere_over_faces(diameter_m=diameter, wavelength_m=WAVELENGTH_M, places=np.zeros(1))
    assert ratio[:, 0] == pytest.approx(radar / faces, rel=1e-6)


def test_bessel_functions() -> None:
    argument = np.arange(0.0, 60.0, glory._STEP)
    j0, j2 = glory._bessel(60.0)
    np.testing.assert_allclose(j0, jv(0, argument), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(j2, jv(2, argument), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("range_m", "low", "high"), [(3.0, 5.0, 12.0), (10.0, 11.0, 26.0), (30.0, 20.0, 36.0)])
def test_lens_of_25_mm(range_m: float, low: float, high: float) -> None:
    """Mean over 0.2 to 0.4 mm: spheres summed apart, over lenses of the same order, had 5, 11 and 20 to 25."""
    diameter = np.linspace(0.2e-3, 0.4e-3, 41)
    gain = glory.gain(diameter_m=diameter, wavelength_m=WAVELENGTH_M, within_rad=np.array(0.0125 / range_m))
    assert low < gain.mean() < high


def test_mean_over_a_lens() -> None:
    """Compared with single spheres of the sizes around it, each averaged over the lens by quadrature.

    Sizes that the table does not have: their own ripples leave 10 % on 60 of them, at a fixed set of sizes.
    """
    sizes = np.geomspace(0.3e-3 / 1.1, 0.3e-3 * 1.1, 60)
    angle = 0.0125 / 10.0
    u = np.linspace(0.0, math.pi * sizes.max() / WAVELENGTH_M * angle, 41)
    bright = glory.sphere_over_faces(diameter_m=sizes, wavelength_m=WAVELENGTH_M, places=u)
    size_angle = math.pi * sizes / WAVELENGTH_M * angle
    lens = np.linspace(0.0, 1.0, 41)
    means = [np.trapezoid(2.0 * lens * np.interp(lens * size_angle[i], u, bright[i]), lens) for i in range(len(sizes))]
    gain = glory.gain(diameter_m=np.array(0.3e-3), wavelength_m=WAVELENGTH_M, within_rad=np.array(angle))
    assert float(gain) == pytest.approx(np.mean(means), rel=0.15)


def test_a_lens_in_two_rings() -> None:
    """The whole lens is the mean of its inner disc and the ring around it, by area."""
    arguments = {"diameter_m": np.array([0.2e-3, 0.6e-3]), "wavelength_m": WAVELENGTH_M}
    whole = glory.gain(**arguments, within_rad=np.array(4e-3))
    disc = glory.gain(**arguments, within_rad=np.array(2e-3))
    ring = glory.gain(**arguments, within_rad=np.array(4e-3), from_rad=np.array(2e-3))
    assert 0.25 * disc + 0.75 * ring == pytest.approx(whole, rel=1e-12)
    assert np.all(ring < disc)


def test_large_drops_have_none() -> None:
    gain = glory.gain(diameter_m=np.array([1e-3, 3e-3]), wavelength_m=WAVELENGTH_M, within_rad=np.array(1e-3))
    assert np.all(gain == 1.0)


def test_drawn_and_even_light_are_the_whole_medium() -> None:
    """The gain makes small drops the brighter: mean power of the drawn ones and beta of the rest.

    Tolerance: 1 % for what is drawn beyond 1e-6 of the pulses and for the steps of the tables.
    """
    sizes = precipitation.marshall_palmer(rate_mm_h=10.0)
    sigma = {"sizes": sizes, "backscatter_m2_sr": lambda *, diameter_m: 1e-2 * diameter_m**2}

    def gain(*, diameter_m: np.ndarray, within_rad: np.ndarray, from_rad: np.ndarray) -> np.ndarray:
        return 1.0 + 20.0 * np.exp(-diameter_m / 0.3e-3) * np.exp(-within_rad / 5e-3) + 0.0 * from_rad

    sight = Sight(
        beam_area_m2=lambda r: 1e-4 + 0.0 * r,
        overlap=lambda r: 1.0 + 0.0 * r,
        extinction_per_m=0.0,
        nearest_m=2.0,
        farthest_m=50.0,
        aperture_radius_m=0.0125,
    )
    tables = strengths(sight, **sigma, gain=gain, count=8)
    whole = medium_backscatter_per_m_sr(tables.range_m, sight=sight, **sigma, gain=gain)
    # Power of the drawn ones: their strengths over the logarithm of Lambda, int s dLambda.
    mean_log = np.linspace(math.log(1e-6), math.log(3.5), len(tables.log_strength.values))
    levels = np.exp(mean_log)
    # Per beam area, as the even light.
    drawn = np.trapezoid(np.exp(tables.log_strength.values), levels)
    falloff = 1.0 / tables.range_m**2
    weak = tables.weak_backscatter_per_m_sr(tables.range_m)
    assert np.all(weak <= whole * (1.0 + 1e-9))
    total = np.trapezoid(falloff * whole, tables.range_m)
    assert drawn + np.trapezoid(falloff * weak, tables.range_m) == pytest.approx(total, rel=0.01)
    faces = np.trapezoid(falloff, tables.range_m) * 1e-2 * 2.0 * sizes.intercept_per_m4 / sizes.slope_per_m**3
    assert total > 1.5 * faces


@pytest.mark.parametrize("diameter_m", [0.15e-3, 0.4e-3])
def test_far_from_straight_back_the_brightness_goes_on(diameter_m: float) -> None:
    """Rings beyond the table's last place, u = 40, are as bright as those before it: a turn there changes a tenth."""
    per_place = WAVELENGTH_M / (math.pi * diameter_m)
    rings = [
        glory.gain(
            diameter_m=np.array([diameter_m]),
            wavelength_m=WAVELENGTH_M,
            from_rad=first * per_place,
            within_rad=last * per_place,
        )[0]
        for first, last in ((30.0, 40.0), (40.0, 60.0), (80.0, 200.0))
    ]
    assert rings[1] == pytest.approx(rings[0], rel=0.1)
    assert rings[2] == pytest.approx(rings[1], rel=1e-6)
