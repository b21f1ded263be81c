"""Light on water spheres by Mie's theory: extinction and backscatter of one droplet, and the index of water.

Fog droplets are a few wavelengths wide, where neither Rayleigh's law nor ray optics holds. numpy in double precision
only: needed once for a scene, never for a pulse.

Symbols: x size parameter, n + i k refractive index, a_n and b_n Mie coefficients, psi, chi, xi Riccati-Bessel
functions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ...maths.arrays import Numbers

_WATER = np.array(
    [
        (0.300, 1.349, 1.60e-8),
        (0.400, 1.339, 1.86e-9),
        (0.500, 1.335, 1.00e-9),
        (0.550, 1.333, 1.96e-9),
        (0.600, 1.332, 1.09e-8),
        (0.700, 1.331, 3.35e-8),
        (0.800, 1.329, 1.25e-7),
        (0.850, 1.329, 2.93e-7),
        (0.900, 1.328, 4.86e-7),
        (0.925, 1.328, 1.06e-6),
        (0.950, 1.327, 2.93e-6),
        (0.975, 1.327, 3.48e-6),
        (1.000, 1.327, 2.89e-6),
        (1.0593, 1.326, 1.30e-6),
        (1.0990, 1.325, 1.71e-6),
        (1.1403, 1.325, 5.95e-6),
        (1.200, 1.324, 9.89e-6),
        (1.2589, 1.323, 1.08e-5),
        (1.3002, 1.322, 1.40e-5),
        (1.3490, 1.322, 4.05e-5),
        (1.400, 1.321, 1.38e-4),
        (1.4289, 1.320, 3.54e-4),
        (1.4588, 1.320, 3.60e-4),
        (1.4997, 1.319, 2.25e-4),
        (1.5488, 1.318, 1.35e-4),
        (1.600, 1.317, 8.55e-5),
        (1.6596, 1.316, 7.40e-5),
        (1.7498, 1.313, 1.00e-4),
        (1.800, 1.312, 1.15e-4),
        (1.8493, 1.311, 1.86e-4),
        (1.8880, 1.309, 9.22e-4),
        (1.9320, 1.308, 1.92e-3),
        (2.000, 1.306, 1.10e-3),
        (2.200, 1.296, 2.89e-4),
        (2.400, 1.279, 9.56e-4),
        (2.500, 1.261, 1.74e-3),
    ]
)
"""Source: G. M. Hale and M. R. Querry, Appl. Opt. 12, 555 (1973); wavelength in micrometres, n, k of liquid water at 25
C. Their steps are too wide for the bands near 1.2 and 1.45 um; there D. J. Segelstein's thesis, University of
Missouri-Kansas City (1981). Both as in the refractiveindex.info database."""

_DERIVATIVES = 2**22  # at once: 64 MiB


def water_index(*, wavelength_m: float) -> complex:
    """Refractive index n + i k of liquid water, 300 nm to 2.5 um; linear in n and in log k between table rows."""
    micrometres = wavelength_m * 1e6
    n = np.interp(micrometres, _WATER[:, 0], _WATER[:, 1])
    k = math.exp(np.interp(micrometres, _WATER[:, 0], np.log(_WATER[:, 2])))
    return complex(n, k)


def efficiencies(*, size_parameter: Numbers, index: complex) -> tuple[Numbers, Numbers]:
    """Extinction and backscatter efficiency of spheres: cross-section over pi r^2.

    Q_ext = 2/x^2 sum (2n + 1) Re(a_n + b_n) and Q_back = |sum (2n + 1) (-1)^n (a_n - b_n)|^2 / x^2, with the radar
    convention: power straight back per steradian is Q_back r^2 / 4 times the irradiance.

    C. F. Bohren and D. R. Huffman, Absorption and Scattering of Light by Small Particles (1983), chapter 4: the
    logarithmic derivative of psi(m x) by downward recurrence, psi(x) and chi(x) upward. Terms up to x + 4 x^(1/3) + 2
    (W. J. Wiscombe, Appl. Opt. 19, 1505 (1980)).

    Args:
        size_parameter: (n,) 2 pi r / lambda, above 0, up to about 20000
        index: n + i k of the sphere over that of the air
    """
    x = np.asarray(size_parameter, dtype=float)
    order = np.argsort(x)
    extinction, backscatter = np.zeros_like(x), np.zeros_like(x)
    # Spheres of similar size together: the derivatives need memory for (terms of the largest) x (spheres). As many as
    # fit, for a term takes nearly the same time for 100 spheres and for 1000.
    groups = math.ceil(len(x) * float(_last_term(x).max()) / _DERIVATIVES)
    for group in np.array_split(order, groups):
        extinction[group], backscatter[group] = _efficiencies_sorted(x[group], index)
    return extinction, backscatter


def coefficients(*, size_parameter: Numbers, index: complex) -> tuple[Numbers, Numbers]:
    """(terms, n) a_n and b_n of spheres of rising size, from n = 1 on; 0 beyond a sphere's last term."""
    x = np.asarray(size_parameter, dtype=float)
    electric, magnetic = (np.zeros((int(_last_term(x).max()), len(x)), dtype=complex) for _ in range(2))
    for n, first, a, b in _terms(x, index):
        electric[n - 1, first:], magnetic[n - 1, first:] = a, b
    return electric, magnetic


def _efficiencies_sorted(x: Numbers, index: complex) -> tuple[Numbers, Numbers]:
    """`efficiencies` of spheres sorted by size, each summed to its own last term."""
    forward, backward = np.zeros_like(x), np.zeros_like(x, dtype=complex)
    for n, first, a, b in _terms(x, index):
        forward[first:] += (2 * n + 1) * (a + b).real
        backward[first:] += (2 * n + 1) * (-1) ** n * (a - b)
    return 2.0 * forward / (x * x), np.abs(backward) ** 2 / (x * x)


def _last_term(x: Numbers) -> Numbers:
    return np.asarray(x + 4.05 * np.cbrt(x) + 2.0)


def _terms(x: Numbers, index: complex) -> Iterator[tuple[int, int, Numbers, Numbers]]:
    """n, number of the first sphere that has not had its last term, and a_n and b_n from it on; sizes rise."""
    last = _last_term(x)
    terms = int(last.max())
    derivative = _logarithmic_derivatives(index * x, terms)
    # psi and xi = psi - i chi of orders n - 1 and n, from -1 and 0: the imaginary part of xi is -chi.
    previous, latest = np.exp(1j * x), -1j * np.exp(1j * x)
    first = 0
    for n in range(1, terms + 1):
        # Beyond its last term a sphere's psi is rounding noise and its chi overflows: drop the sphere. Sizes rise, so
        # the finished ones are at the front.
        finished = int(np.searchsorted(last, n)) - first
        previous, latest, first = previous[finished:], latest[finished:], first + finished
        size = x[first:]
        previous, latest = latest, (2 * n - 1) / size * latest - previous
        d = derivative[n, first:]
        ratio_a, ratio_b = d / index + n / size, d * index + n / size
        a = (ratio_a * latest.real - previous.real) / (ratio_a * latest - previous)
        b = (ratio_b * latest.real - previous.real) / (ratio_b * latest - previous)
        yield n, first, a, b


def _logarithmic_derivatives(y: Numbers, terms: int) -> Numbers:
    """D_n(y) for n = 0 ... terms, (terms + 1, len(y)), by downward recurrence.

    Upward it is unstable; downward any start value far beyond |y| is forgotten.
    """
    largest = float(np.abs(y).max())
    start = max(terms, int(largest + 4.05 * math.cbrt(largest))) + 16
    derivative = np.zeros((terms + 1, len(y)), dtype=complex)
    latest = np.zeros(len(y), dtype=complex)
    for n in range(start, 0, -1):
        ratio = n / y
        latest = ratio - 1.0 / (latest + ratio)
        if n - 1 <= terms:
            derivative[n - 1] = latest
    return derivative
