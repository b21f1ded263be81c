"""Mie's theory against the same series by Bessel functions, published values and the limits of small and large."""

import math

import numpy as np
import pytest
from helpers.run_seed import chosen
from scipy.special import spherical_jn, spherical_yn

from lidarscene.physics.weather import mie


def by_bessel_functions(x, m):
    """Q_ext and Q_back from scipy's Bessel functions, one sphere at a time."""
    from_0 = np.arange(int(x + 4.05 * np.cbrt(x) + 2) + 1)
    n = from_0[1:]
    outer, inner = spherical_jn(from_0, x) + 1j * spherical_yn(from_0, x), spherical_jn(from_0, m * x)
    # d(z f_n(z))/dz = z f_(n-1)(z) - n f_n(z)
    xi, xi_slope = x * outer[1:], x * outer[:-1] - n * outer[1:]
    psi, psi_slope = xi.real, xi_slope.real
    inside, inside_slope = m * x * inner[1:], m * x * inner[:-1] - n * inner[1:]
    a = (m * inside * psi_slope - psi * inside_slope) / (m * inside * xi_slope - xi * inside_slope)
    b = (inside * psi_slope - m * psi * inside_slope) / (inside * xi_slope - m * xi * inside_slope)
    extinction = 2 / x**2 * ((2 * n + 1) * (a + b).real).sum()
    return extinction, abs(((2 * n + 1) * (-1.0) ** n * (a - b)).sum()) ** 2 / x**2


@pytest.mark.parametrize("index", chosen(2, [1.328 + 4.9e-7j, 1.318 + 1.35e-4j, 1.55 + 0j, 1.33 + 0.01j]))
def test_bessel_functions(index):
    """Rationale: recurrences lose digits, each in its own range of x. Sizes in one call, in no order.

    Tolerance: of the sums' rounding, which is worst where the backscatter nearly cancels.
    """
    x = np.array([1000.0, 0.5, 123.4, 5.21282, 10.0, 50.0, 3000.0, 0.1])
    extinction, backscatter = mie.efficiencies(size_parameter=x, index=index)
    expected = np.array([by_bessel_functions(size, index) for size in x])
    np.testing.assert_allclose(extinction, expected[:, 0], rtol=1e-9)
    np.testing.assert_allclose(backscatter, expected[:, 1], rtol=1e-6)


def test_the_sphere_of_bohren_and_huffman():
    """Appendix A of their book prints Q_sca 3.10543 and Q_back 2.92534 for a clear sphere of index 1.55."""
    x = np.array([2 * math.pi * 0.525 / 0.6328])
    extinction, backscatter = mie.efficiencies(size_parameter=x, index=1.55 + 0j)
    assert extinction[0] == pytest.approx(3.10543, abs=6e-6)
    assert backscatter[0] == pytest.approx(2.92534, abs=6e-6)


def test_small_spheres_are_rayleigh_s():
    """Q_back = 4 x^4 |K|^2 and Q_ext = 8/3 x^4 |K|^2; the next terms are of relative size x^2."""
    x, index = np.array([0.01]), 1.33 + 0j
    k = abs((index**2 - 1) / (index**2 + 2)) ** 2
    extinction, backscatter = mie.efficiencies(size_parameter=x, index=index)
    assert extinction[0] == pytest.approx(8 / 3 * x[0] ** 4 * k, rel=1e-3)
    assert backscatter[0] == pytest.approx(4 * x[0] ** 4 * k, rel=1e-3)


def test_large_spheres_shade_twice_their_disc():
    """Q_ext = 2 + about 2 x^(-2/3) (H. M. Nussenzveig): 2.004 at a drop of 3 mm. The ripple is some 1e-4."""
    x = 10_400.0 + np.linspace(0.0, 40.0, 21)
    extinction, _ = mie.efficiencies(size_parameter=x, index=1.328 + 4.9e-7j)
    assert extinction.mean() == pytest.approx(2 + 1.99 * 10_400 ** (-2 / 3), abs=3e-4)


def test_an_opaque_sphere_is_a_mirror():
    """Geometrical optics: Q_back is Fresnel's |(m - 1) / (m + 1)|^2, 1.25 / 7.25; corrections are of order 1 / x."""
    _, backscatter = mie.efficiencies(size_parameter=np.array([1000.0]), index=1.5 + 1.0j)
    assert backscatter[0] == pytest.approx(1.25 / 7.25, rel=2e-3)


def test_water():
    """Rows of Hale and Querry and of Segelstein, and the logarithmic step from one to the next."""
    assert mie.water_index(wavelength_m=900e-9) == pytest.approx(1.328 + 4.86e-7j)
    assert mie.water_index(wavelength_m=1548.8e-9).imag == pytest.approx(1.35e-4)
    assert mie.water_index(wavelength_m=912.5e-9).imag == pytest.approx(math.sqrt(4.86e-7 * 1.06e-6))


def test_small_spheres_are_electric_dipoles():
    """a_1 = -(2 i x^3 / 3) (m^2 - 1) / (m^2 + 2) and b_1 = -(i x^5 / 45) (m^2 - 1): Lord Rayleigh, to x^2."""
    x, index = np.array([0.02, 0.05]), complex(1.5, 0.01)
    electric, magnetic = mie.coefficients(size_parameter=x, index=index)
    expected = -2j / 3.0 * x**3 * (index**2 - 1.0) / (index**2 + 2.0)
    np.testing.assert_allclose(electric[0], expected, rtol=5e-3)
    np.testing.assert_allclose(magnetic[0], -1j / 45.0 * x**5 * (index**2 - 1.0), rtol=5e-3)
