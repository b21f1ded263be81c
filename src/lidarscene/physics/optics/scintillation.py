"""Echoes that fluctuate: speckle of the laser's light on rough surfaces, and turbulence of the air.

A rough surface in coherent light throws a pattern of bright and dark cells on the lens. The lens gathers few or many
of them, so the echo's power scatters about its mean, from shot to shot as the beam moves on. Turbulent air focuses and
spreads light on its way back, which a wide lens evens out. Both are one relative variance of the power.

Symbols: M number of independent cells, w radius of the spot (1/e^2, or of a top hat), a radius of the lens, R range,
lambda wavelength, sigma_lambda deviation of the laser's line, beta angle of incidence, k wave number, C_n^2 structure
constant of the refractive index.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from ...maths.arrays import Lanes, xp
from ...maths.special import expm1
from ..electronics.pulse_sums import SIGMAS_PER_FWHM

_LEAST_COSINE = 0.02
"""Accuracy bought: least cosine that the slope is divided by: flatter surfaces count as this flat."""

_LEAST_POWER = 1e-6
"""Accuracy bought: smallest drawn power over its mean: an echo of none has no logarithm."""

_DEVIATES = tuple(0.375 * (number - 11.5) for number in range(24))
_WEIGHTS = tuple(math.exp(-0.5 * deviate * deviate) for deviate in _DEVIATES)
NODES = tuple((deviate, weight / sum(_WEIGHTS)) for deviate, weight in zip(_DEVIATES, _WEIGHTS, strict=True))
"""Normal deviates and their weights, for `mean`."""


def speckle_cells(
    *,
    spot_rad: Lanes,
    range_m: Lanes,
    aperture_radius_m: Lanes,
    wavelength_m: Lanes,
    linewidth_m: Lanes,
    cos_incidence: Lanes,
) -> Lanes:
    """M: number of independent speckle cells that the lens gathers of unpolarised light, as rough surfaces return it.

    A cell is lambda R / w wide, so M = 1 + A_spot A_lens / (lambda R)^2 for light of one wavelength (Goodman, Speckle
    Phenomena in Optics, 2nd ed., 4.6), here with a Gaussian lens of the same variance. On a surface that leans each
    wavelength of the line has a pattern that is moved sideways, which adds cells along the slope.

    Args:
        spot_rad: angular radius w / R of the spot
        linewidth_m: full width at half maximum of the laser's line, as wavelength; 0: one line
    """
    cos_incidence = xp(range_m, cos_incidence).maximum(cos_incidence, _LEAST_COSINE)
    across = math.pi * spot_rad * aperture_radius_m / wavelength_m
    slope_square = 1.0 / (cos_incidence * cos_incidence) - 1.0
    spread = (4.0 * math.pi / SIGMAS_PER_FWHM) * (linewidth_m / wavelength_m) * (spot_rad * range_m / wavelength_m)
    even = 1.0 + across * across
    product = even * (even + spread * spread * slope_square)
    return 2.0 * xp(product).sqrt(product)


def swept_patterns(*, spot_rad: Lanes, sweep_rad: Lanes) -> Lanes:
    """Number of independent speckle patterns of shots that are summed while the beam turns by ``sweep_rad``.

    sqrt(1 + phi^2 / (3 w^2)): spots that lie side by side have patterns of their own; for the even sweep stands a
    Gaussian one of the same variance, phi^2 / 12.
    """
    square = 1.0 + sweep_rad * sweep_rad / (3.0 * spot_rad * spot_rad)
    return xp(square).sqrt(square)


def turbulence_variance(
    *, structure_constant: Lanes, range_m: Lanes, wavelength_m: Lanes, aperture_radius_m: Lanes
) -> Lanes:
    """Relative variance of the power of a small source at a range that a lens gathers through turbulent air.

    Andrews and Phillips, Laser Beam Propagation through Random Media, 2nd ed., 10.3.2: aperture averaging of a
    spherical wave, from weak to strong turbulence, with no inner or outer scale.

    Args:
        structure_constant: C_n^2 [m^(-2/3)], the same along the path
    """
    ops, wave_number = xp(range_m, structure_constant, wavelength_m), 2.0 * math.pi / wavelength_m

    def power(base: Lanes, exponent: float) -> Lanes:
        return ops.exp(exponent * ops.log(base))

    rytov = 0.5 * structure_constant * power(wave_number, 7.0 / 6.0) * power(range_m, 11.0 / 6.0)  # beta^2
    width = wave_number * aperture_radius_m * aperture_radius_m / range_m  # d^2 = k D^2 / (4 L)
    strong = power(ops.maximum(rytov, 1e-20), 1.2)  # beta^(12/5)
    large = 0.49 * rytov * power(1.0 + 0.18 * width + 0.56 * strong, -7.0 / 6.0)
    small = 0.51 * rytov * power(1.0 + 0.69 * strong, -5.0 / 6.0)
    exponent = large + small / (1.0 + 0.90 * width + 0.62 * width * strong)
    return expm1(exponent)


def relative_power(deviate: Lanes, variance: Lanes) -> Lanes:
    """Power over its mean, gamma distributed with this variance, from a standard normal deviate.

    (1 - v / 9 + z sqrt(v) / 3)^3: Wilson and Hilferty, Proc. Natl. Acad. Sci. 17, 684 (1931). Its mean is 1 to 2e-3 at
    v = 1, to 1e-4 at v = 0.25; never 0.
    """
    ops = xp(deviate, variance)
    root = ops.maximum(1.0 - variance / 9.0 + deviate * ops.sqrt(variance) / 3.0, 0.0)
    return ops.maximum(root * root * root, _LEAST_POWER)


def mean(function: Callable[[Lanes], Lanes], variance: Lanes) -> Lanes:
    """Mean of a function of `relative_power` over its distribution, by the midpoint rule at 24 normal deviates.

    Smooth functions converge exponentially: an error below 1e-3 for a rise from 0 to 1 that is wider than a fifth of
    the fluctuation, 0.06 at worst for a step.
    """
    total: Lanes = 0.0
    for deviate, weight in NODES:
        total = total + weight * function(relative_power(deviate, variance))
    return total
