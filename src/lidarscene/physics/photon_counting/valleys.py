"""Valleys of the filtered histogram: where noise splits echoes that merge, or lifts one out of the flank of another.

Two peaks have a valley between them, so the mean number of peaks follows from that of the valleys. A bin holds one if
the filter's value falls to it and rises behind it. The values of three bins are taken for jointly normal; that noise is
not the same everywhere enters by their covariance.

Symbols: F value of the filter, M its mean, w width of the template in sigmas of the echo, g variance of F.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from ...maths.special import normal_tail
from .matched_filter import OUTPUT_WIDTH, SCALE, SIGNAL_VARIANCE, TEMPLATE

SIGNAL_WIDTH = math.sqrt(0.5 * (TEMPLATE * TEMPLATE + 2.0)) / OUTPUT_WIDTH
"""Width of the variance that an echo's photons give F over that of the filter's response to it (T165)."""

SIGNAL_HEIGHT = SIGNAL_VARIANCE
"""Variance in the middle of an echo, for each of its photons."""

EVEN_HEIGHT = SCALE / math.sqrt(2.0)
"""Variance of F by even light over its mean."""

TEMPLATE_AREA = TEMPLATE * math.sqrt(2.0 * math.pi)
"""Area of the template before it is scaled, in sigmas of the echo: F's mean over the counts of even light in one."""


def probability(*, means: tuple[Lanes, Lanes, Lanes], variances: tuple[Lanes, ...], bin_sigmas: Lanes) -> Lanes:
    """Probability that a bin holds a valley of the filtered histogram, (n,) (T166).

    Args:
        means: M one bin before, at the bin and one behind
        variances: g at five places half a bin apart, from one bin before to one behind
        bin_sigmas: length of a bin in widths of the echo
    """
    first, middle, last = means
    before, half_before, here, half_behind, behind = variances
    ops = xp(first, before)
    # Covariance of F at two places: g half way between them, times exp(-d^2 / 4 w^2) with their distance d.
    near = ops.exp(-0.25 * bin_sigmas * bin_sigmas / (TEMPLATE * TEMPLATE))
    far = near * near * near * near
    # A valley: the mean of both steps, s, is nearer to zero than half their difference, q.
    step, bend = 0.5 * (last - first), 0.5 * (last - 2.0 * middle + first)
    of_step = ops.maximum(0.25 * (before + behind - 2.0 * far * here), 1e-12)
    of_bend = 0.25 * (before + behind + (4.0 + 2.0 * far) * here - 4.0 * near * (half_before + half_behind))
    of_both = 0.25 * (behind - before - 2.0 * near * (half_behind - half_before))
    tilt = of_both / of_step
    deviation = ops.sqrt(ops.maximum(of_bend - of_both * tilt, 1e-6 * of_step))
    # Moments of q, as far as it is positive, where s is zero.
    z = ops.maximum((bend - tilt * step) / deviation, -6.0)
    above, density = normal_tail(-z), ops.exp(-0.5 * z * z) * (1.0 / math.sqrt(2.0 * math.pi))
    reach = ops.maximum(density + z * above, 1e-20)
    square = ((z * z + 1.0) * above + z * density) / reach
    cube = ((z * z * z + 3.0 * z) * above + (z * z + 2.0) * density) / reach
    # Of each q the places s within it, which lie askew by the tilt; over them the density of s is a Gaussian.
    askew = 1.0 / ops.maximum(1.0 - tilt * tilt, 0.1)
    aside = square * deviation * tilt * askew
    spread = cube * deviation * deviation * (1.0 + 3.0 * tilt * tilt) * askew * askew * (1.0 / 3.0) - aside * aside
    variance = of_step + ops.maximum(spread, 0.0)
    off = step - aside
    share = 2.0 * askew * reach * deviation * ops.exp(-0.5 * off * off / variance)
    return ops.minimum(share / ops.sqrt(2.0 * math.pi * variance), 1.0)
