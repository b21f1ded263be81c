"""The response of a medium to a pulse: exponential integrals, adaptive quadrature and the limit of a short pulse."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import expn

from lidarscene.maths.arrays import LookupTable
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.optics import pulse
from lidarscene.physics.weather import soft_target

ALPHA_PER_M, BETA, NEAR_M, FWHM_S = 0.02, 1e-3, 1.5, 6e-9
HALF_C = 0.5 * SPEED_OF_LIGHT_M_S


def even(r):
    return np.full_like(r, BETA)


def response(range_m, backscatter=even, **changes):
    options = {"extinction_per_m": ALPHA_PER_M, "fwhm_s": FWHM_S, "nearest_m": NEAR_M} | changes
    return soft_target.volume_response(range_m=np.asarray(range_m, float), backscatter_per_m_sr=backscatter, **options)


@pytest.mark.parametrize("alpha", [1e-4, 0.02, 0.1])
@pytest.mark.parametrize("nearest_m", [0.5, 3.0])
def test_energy_is_an_exponential_integral(alpha, nearest_m):
    """Whatever the pulse, the energy of all that comes back is that of the pulse times

        int_a^inf beta exp(-2 alpha r) / r^2 dr = beta E_2(2 alpha a) / a.

    The grid is even, of 26 mm to a pulse of sigma 0.38 m, and ends where the tail, beta E_2(2 alpha b) / b, is added:
    1e-6.
    """
    end_m = 200.0
    grid = np.linspace(-8.0, end_m, 8001)
    power = response(grid, extinction_per_m=alpha, nearest_m=nearest_m)
    energy = np.trapezoid(power, grid) / HALF_C
    expected = BETA * (expn(2, 2 * alpha * nearest_m) / nearest_m - expn(2, 2 * alpha * end_m) / end_m)
    assert energy == pytest.approx(pulse.pulse_energy_j(peak_power_w=1.0, fwhm_s=FWHM_S) * expected, rel=2e-5)


def test_a_medium_between_two_ranges():
    """A slab much thinner than the pulse is a surface: it echoes the pulse, with the energy of the closed form."""
    near, far = 30.0, 30.002
    range_m = np.array([29.3, 30.001, 30.9])
    column = BETA * (expn(2, 2 * ALPHA_PER_M * near) / near - expn(2, 2 * ALPHA_PER_M * far) / far)
    shape = pulse.gaussian_pulse(time_s=(range_m - 30.001) / HALF_C, fwhm_s=FWHM_S)
    np.testing.assert_allclose(response(range_m, nearest_m=near, farthest_m=far), column * shape, rtol=1e-5)


@pytest.mark.parametrize("range_m", [0.9, 1.5, 1.8, 2.5, 10.0, 80.0])
def test_adaptive_quadrature(range_m):
    """The overlap is that of Rasshofer and others: 0 up to R1 = 0.9 m, linear, 1 from R2 = 5 m on."""

    def overlap(r):
        return np.clip((r - 0.9) / (5.0 - 0.9), 0.0, 1.0)

    def integrand(r):
        g = pulse.gaussian_pulse(time_s=(range_m - r) / HALF_C, fwhm_s=FWHM_S)
        return g * BETA * overlap(r) * math.exp(-2 * ALPHA_PER_M * r) / r**2

    expected, _ = quad(integrand, 0.5, range_m + 5, points=[0.9, 5.0, range_m], epsabs=0, epsrel=1e-11, limit=400)
    # The quadrature's panels do not know the kinks of the overlap.
    computed = response([range_m], lambda r: BETA * overlap(r), nearest_m=0.5)[0]
    assert computed == pytest.approx(expected, rel=3e-4)


def test_a_sine_squared_pulse_of_the_same_energy():
    """Rasshofer and others have sin^2(pi t / (2 tau_H)) for t up to 2 tau_H, of FWHM tau_H and energy tau_H P.

    Far from the start only the energy matters: 6 % apart, as the energies are.
    """
    tau, r = FWHM_S, 40.0

    def integrand(t):
        scatter_m = r - HALF_C * t
        return math.sin(math.pi * t / (2 * tau)) ** 2 * BETA * math.exp(-2 * ALPHA_PER_M * scatter_m) / scatter_m**2

    theirs = HALF_C * quad(integrand, 0.0, 2 * tau)[0]
    assert response([r - HALF_C * tau])[0] / theirs == pytest.approx(1.0645, rel=1e-3)


def test_a_short_pulse_is_the_lidar_equation():
    """1.0645 (c FWHM / 2) beta exp(-2 alpha R) / R^2, to the second order in the pulse's length over R."""
    r = np.array([5.0, 20.0, 100.0])
    length = HALF_C * pulse.pulse_energy_j(peak_power_w=1.0, fwhm_s=1e-10)
    expected = length * BETA * np.exp(-2 * ALPHA_PER_M * r) / r**2
    np.testing.assert_allclose(response(r, fwhm_s=1e-10), expected, rtol=1e-5)


def test_integral_over_all_ranges_is_half_the_lidar_ratio():
    """int beta exp(-2 alpha r) dr = 1 / (2 S) in an endless fog, from the sensor on (C. M. R. Platt, 1973)."""
    grid = np.linspace(0.0, 800.0, 8001)
    squared = np.trapezoid(response(grid, lambda r: BETA * r * r, nearest_m=1e-9), grid)
    length = HALF_C * pulse.pulse_energy_j(peak_power_w=1.0, fwhm_s=FWHM_S)
    assert squared / length == pytest.approx(BETA / (2 * ALPHA_PER_M), rel=2e-2)


@pytest.mark.parametrize("surface_m", [10.0, 40.0])
def test_a_surface_ends_the_medium(surface_m):
    """Compared with the integral that stops there, to the second order in sigma = 0.38 m over the range."""
    r = surface_m + np.linspace(-1.5, 0.8, 24)
    whole, stopped = response(r), response(r, farthest_m=surface_m)
    share = soft_target.share_before_surface(
        range_m=r, surface_m=surface_m, extinction_per_m=ALPHA_PER_M, fwhm_s=FWHM_S
    )
    np.testing.assert_allclose(whole * share, stopped, atol=(0.38 / surface_m) ** 2 * whole.max())
    assert share[0] > 0.999
    assert share[-1] < 0.03


def test_the_table_s_grid_is_fine_enough():
    """What the chain looks up against the response itself, halfway between places, where a line is farthest from it.

    That is h^2 V'' / 8, where h is the grid's step. On the rise V'' is at most the highest V over sigma^2, as that of
    the pulse; from 5 m on V follows exp(-2 alpha r) / r^2, and V'' / V = 6 / r^2 + 8 alpha / r + 4 alpha^2. Tolerance:
    these, and a tenth for higher orders and for the width of the pulse.
    """
    grid = soft_target.range_grid_m(farthest_m=150.0, fwhm_s=FWHM_S)
    assert np.ptp(np.diff(grid)) < 1e-12
    table = LookupTable(response(grid))
    r = 0.5 * (grid[1:] + grid[:-1])
    tabulated, expected = table.at((r - grid[0]) / (150.0 - grid[0])), response(r)
    eighth = (grid[1] - grid[0]) ** 2 / 8.0
    sigma_m = HALF_C * FWHM_S / math.sqrt(8.0 * math.log(2.0))
    np.testing.assert_allclose(tabulated, expected, rtol=0.0, atol=1.1 * eighth / sigma_m**2 * expected.max())
    far = r > 5.0
    r, tabulated, expected = r[far], tabulated[far], expected[far]
    bend = 6.0 / r**2 + 8.0 * ALPHA_PER_M / r + 4.0 * ALPHA_PER_M**2
    assert np.all(np.abs(tabulated / expected - 1.0) < 1.1 * eighth * bend)
