"""Matched filter over a histogram of counts: noise, detection, false alarms and precision.

The counts of the bins are weighted with a template, a Gaussian somewhat wider than the pulse, which is moved along the
histogram. The weights are scaled so that the filter's value at an echo is the echo's number of photons. Counts are not
Gaussian: where few are expected, chance exceeds a threshold far more often than a normal distribution says.

Symbols: S photons of the echo, r rate of background counts, sigma width of the pulse in the histogram, w that of the
template in sigmas, U threshold, F value of the filter.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from ...maths.arrays import Lanes, LookupTable, Numbers, xp
from ...maths.special import normal_tail, polynomial, scaled_normal_tail

TEMPLATE = 1.2
"""Choice: w. The exact match, 1, is best against the background alone; against the echo's own noise a wider one is
better. With 1.2 the precision is within 1.15 of the bound with and without background, and the SNR 0.992 of the
best."""

_GAIN = TEMPLATE / math.sqrt(1.0 + TEMPLATE**2)
"""Gain of the filter at the echo, before scaling."""

SCALE = 1.0 / _GAIN
"""Weight of a count in the middle of the template, so that F is a number of photons."""

_BACKGROUND_GAIN = (1.0 + TEMPLATE**2) / (4.0 * TEMPLATE**2)
_SIGNAL_GAIN = (1.0 + TEMPLATE**2) / (2.0 * TEMPLATE**2 * (TEMPLATE**2 + 2.0))
"""var F' / (2 |F''|) of (T98), for each unit of variance and times S."""

SIGNAL_SLOPE = 2.0 * _SIGNAL_GAIN
"""Variance of F' by an echo's own photons for each unit of theirs in F, in widths of the filter's response."""

_LEAST_STEEP = 1.5
"""Choice: echoes below this SNR gain no more than one of it: their peaks are no longer theirs."""

SECOND_ORDER = 1.5
"""Source: drawn histograms of 25 to 70 photons, 1.5 +/- 0.3; coefficient k of the peak position's variance,
proportional to (1 + k / photons) / photons: with few photons the position is not linear in them."""

_NEVER_AGAIN = 5.0
"""Accuracy bought: dead time in widths of the filter beyond which no SPAD fires twice in it, to 1e-5."""

_BROADEST = 3.0
"""Choice: largest additional gain of a broad peak, in gains of a lone echo."""

_THIRD = math.sqrt(2.0 / 3.0)
"""Integral of the template's cube over that of its square."""

_TILT_1 = 1.5**-1.5
_TILT_2 = 0.5 * (2.0**-1.5 - 1.5**-3.0)
"""Exponents of the growth of the slope's variance with the tilt: ln of the integral of t^2 exp(s h(t) - t^2)."""


_FEWEST, _MOST = 1e-4, 4.0
"""Accuracy bought: background counts in sigma between which (T97) is corrected; above, the correction is that of the
most."""

_ROWS_PER_DECADE = 4

_LEAST_SHARE = 1e-13
"""Accuracy bought: shares that the transform of the counts' distribution resolves: its rounding is 1e-16."""


def background_variance(*, rate_hz: Lanes, sigma_s: Lanes) -> Lanes:
    """Variance of F by even background, r sigma sqrt(pi) (1 + w^2) / w (T95)."""
    return rate_hz * sigma_s * (math.sqrt(math.pi) * (1.0 + TEMPLATE**2) / TEMPLATE)


SIGNAL_VARIANCE = (1.0 + TEMPLATE**2) / (TEMPLATE * math.sqrt(TEMPLATE**2 + 2.0))
"""Variance of F by the echo's own photons, for each of them (T95)."""

OUTPUT_WIDTH = math.sqrt(1.0 + TEMPLATE**2)
"""Width of the filter's response to an echo, in sigmas of the pulse."""


def background_skewness(*, variance_share: Lanes) -> Lanes:
    """Third cumulant of F by even background over its variance: photons that one unit of noise counts as (T95).

    Args:
        variance_share: variance of F over `background_variance`; in the dark, where both are 0, the limit of their
            ratio
    """
    return _THIRD / _GAIN * variance_share


SIGNAL_SKEWNESS = (TEMPLATE / math.sqrt(TEMPLATE**2 + 3.0)) / (TEMPLATE / math.sqrt(TEMPLATE**2 + 2.0)) / _GAIN
"""The same by the echo's own photons."""


def tail(*, excess: Lanes, variance: Lanes, unit: Lanes) -> Lanes:
    """Probability that F exceeds its mean by so much, (T96).

    F is taken for a scaled and shifted Poisson number with its variance and third cumulant, and that one's tail is
    Lugannani and Rice's (Adv. Appl. Probab. 12, 475, 1980) in the form of Barndorff-Nielsen.

    Args:
        excess: excess of the threshold over the mean
        variance: variance of F
        unit: third cumulant over variance: the step of the Poisson number
    """
    root, theta, mean, x, depth = _saddle(excess, variance, unit)
    ops = xp(root)
    # Barndorff-Nielsen's r + ln(v / r) / r, with v = theta sqrt(mean x), is 0 / 0 at the mean, r = 0; its limit there
    # is 1 / (6 sqrt(mean)).
    close = ops.abs(theta) < 2e-2
    square = ops.where(close, 1.0, theta * theta * x / ops.where(close, 1.0, 2.0 * depth))
    lift = ops.where(close, 1.0 / (6.0 * ops.sqrt(mean)), 0.5 * ops.log(square) / ops.where(close, 1.0, root))
    # A Poisson number is never below 0, and F never below the value that stands for it. An echo that fires every SPAD
    # has next to no variance, and its threshold lies there.
    return ops.where(excess <= -unit * mean, 1.0, normal_tail(root + lift))


def _saddle(excess: Lanes, variance: Lanes, unit: Lanes) -> tuple[Lanes, ...]:
    """Signed root r of the log likelihood ratio, tilt theta, mean of the Poisson number, and of it the share that the
    threshold is and the depth r^2 / 2.
    """
    ops = xp(excess, variance, unit)
    mean = ops.maximum(variance, 1e-12) / (unit * unit)
    x = ops.maximum(ops.fma(excess, 1.0 / (unit * mean), 1.0), 1e-6)
    theta = ops.log(x)
    # x ln x - x + 1, without the difference of near equals close to x = 1.
    x_minus_1 = x - 1.0
    series = x_minus_1 * x_minus_1 * polynomial(x_minus_1, -0.05, 1.0 / 12.0, -1.0 / 6.0, 0.5)
    depth = ops.where(ops.abs(x_minus_1) < 3e-2, series, ops.fma(x, theta, -x_minus_1))
    depth = ops.maximum(depth, 0.0)
    root = ops.sqrt(2.0 * mean * depth)
    return ops.where(x_minus_1 < 0.0, -root, root), theta, mean, x, depth


def false_peak_share(
    *,
    threshold: Lanes,
    rate_hz: Lanes,
    sigma_s: Lanes,
    bin_s: Lanes,
    variance_share: Lanes = 1.0,
    bin_to_sigma: float | Numbers | None = None,
) -> Lanes:
    """Probability that noise makes a peak above the threshold, for each bin (T97).

    A smooth noise passes the threshold upwards with Rice's rate, here with the density of (T96) at the threshold and
    the variance of the slope given that F is there. Excursions that end before the next bin are not seen: their length
    is Rayleigh's. Few counts under the template are not smooth: F has the steps of their whole number, and a table
    holds how much more often, or more rarely, it passes the threshold.

    Args:
        rate_hz: r, counts per second
        variance_share: variance of F over `background_variance`: 1 unless the counts are not Poisson's
        bin_to_sigma: bin_s over sigma_s, as a number that chooses the table; None, or an array: no table
    """
    if not isinstance(bin_to_sigma, float):
        return _smooth_peak_share(
            threshold=threshold, rate_hz=rate_hz, sigma_s=sigma_s, bin_s=bin_s, variance_share=variance_share
        )
    ops = xp(threshold, rate_hz, variance_share)
    # Counts that are not Poisson's are like those of another rate, each of this weight.
    unit = variance_share
    counts = rate_hz * sigma_s / unit
    # Below the fewest counts nearly all peaks are of a single one.
    single = ops.minimum(counts * (1.0 / _FEWEST), 1.0)
    counts = ops.maximum(counts, _FEWEST)
    # A single count exceeds any lower threshold, where the smooth form is steep.
    threshold = ops.maximum(threshold, 2.0 * _FINEST * unit)
    share = single * _smooth_peak_share(
        threshold=threshold, rate_hz=counts * unit / sigma_s, sigma_s=sigma_s, bin_s=bin_s, variance_share=unit
    )
    most = ops.minimum(counts, _MOST)
    value = threshold / unit * ops.sqrt(most / counts) + _MEAN_SHARE * most
    row = ops.log(most * (1.0 / _FEWEST)) * (1.0 / math.log(_MOST / _FEWEST))
    few = ops.exp(_excess_of_few_counts(bin_to_sigma).at(row, value * (1.0 / _LARGEST)))
    return ops.minimum(share * few, 1.0)


_MEAN_SHARE = SCALE * TEMPLATE * math.sqrt(2.0 * math.pi)
"""Mean of the filter's value, over the counts in sigma."""

_FINEST = SCALE / 40.0
"""Accuracy bought: step of the filter's value, of which a count in the middle of the template is a whole number."""

_COARSE_BIN, _FEW = 0.5, 0.3
"""Accuracy bought: bins from which on, in sigmas, more counts than these in sigma are corrected too: finer ones need a
finer grid."""

_LARGEST = 45.0
"""Accuracy bought: largest value of the filter in the table: 7 deviations above the mean of `_MOST`."""


@functools.lru_cache(maxsize=16)
def _excess_of_few_counts(bin_to_sigma: float) -> LookupTable:
    """ln of the share of bins in which F passes a value upwards over (T97), by ln(counts in sigma) and that value.

    From the exact distribution of F in two neighbouring bins (`_passages`); some 0.05 s.
    """
    rows = round(_ROWS_PER_DECADE * math.log10(_MOST / _FEWEST)) + 1
    values = np.linspace(0.0, _LARGEST, round(_LARGEST / _FINEST) + 1)
    ratio = np.zeros((rows, len(values)))
    for row, counts in zip(ratio, np.geomspace(_FEWEST, _MOST, rows), strict=True):
        if counts > _FEW and bin_to_sigma < _COARSE_BIN:
            continue
        places, passing = _passages(bin_to_sigma, float(counts))
        resolved = passing > _LEAST_SHARE
        excess = np.maximum(values - _MEAN_SHARE * counts, 0.0)
        smooth = _smooth_peak_share(
            threshold=excess, rate_hz=counts, sigma_s=1.0, bin_s=bin_to_sigma, variance_share=1.0
        )
        exact = np.interp(excess + _MEAN_SHARE * counts, places[resolved], np.log(passing[resolved]))
        beyond = excess + _MEAN_SHARE * counts > places[resolved][-1]
        row[:] = exact - np.log(np.maximum(smooth, 1e-37))
        row[beyond] = row[~beyond][-1]
    return LookupTable(ratio)


def _passages(bin_to_sigma: float, counts: float) -> tuple[Numbers, Numbers]:
    """Values (n,) of the filter, mean included, and the share of bins in which it passes them upwards.

    Poisson counts make a compound Poisson number of the filter's values in two neighbouring bins. Its distribution on
    a grid follows from that of one count by a Fourier transform. A value between two points of the grid counts on
    both, so that its mean stays.
    """
    from scipy.fft import irfft2, next_fast_len, rfft2

    side = math.ceil(3.0 / bin_to_sigma)
    place = np.arange(-side, side + 1) * (bin_to_sigma / TEMPLATE)
    weights = np.concatenate([[0.0], SCALE * np.exp(-0.5 * place * place), [0.0]])
    step = _FINEST * (1.0 if counts < 0.03 else 2.0 if counts < _FEW else 4.0)
    deviation = math.sqrt(float(background_variance(rate_hz=counts, sigma_s=1.0)))
    size = next_fast_len(math.ceil((_MEAN_SHARE * counts + 7.0 * deviation + 8.0) / step), real=True)
    of_one = np.zeros((size, size))
    now, before = weights[1:] / step, weights[:-1] / step
    for first in (0, 1):
        for second in (0, 1):
            shares = (np.abs(1 - first - now % 1.0)) * (np.abs(1 - second - before % 1.0))
            np.add.at(of_one, (now.astype(int) + first, before.astype(int) + second), shares)
    mean = counts * bin_to_sigma
    together = irfft2(np.exp(mean * (rfft2(of_one) - len(now))), s=of_one.shape)
    # Now above a value, before not above it.
    below = np.cumsum(together, axis=1)
    above = np.cumsum(below[::-1], axis=0)[::-1]
    return (np.arange(size - 1) + 0.5) * step, np.diagonal(above, offset=-1)


def _smooth_peak_share(
    *, threshold: Lanes, rate_hz: Lanes, sigma_s: Lanes, bin_s: Lanes, variance_share: Lanes
) -> Lanes:
    """`false_peak_share` of smooth noise."""
    variance = variance_share * background_variance(rate_hz=rate_hz, sigma_s=sigma_s)
    unit = background_skewness(variance_share=variance_share)
    above = tail(excess=threshold, variance=variance, unit=unit)
    root, theta, mean, x, _ = _saddle(threshold, variance, unit)
    ops = xp(root)
    level = ops.maximum(mean * x, 1e-6)
    density = ops.exp(-0.5 * root * root) / (unit * ops.sqrt(2.0 * math.pi * level))
    # var F' / var F = 1 / (2 w^2 sigma^2) without tilt; counts near the peak weigh more where F is high.
    peak = 1.0 / _THIRD
    tilted = ops.exp(theta * (_TILT_1 * peak + _TILT_2 * peak * peak * theta))
    slope = variance * tilted / (2.0 * TEMPLATE**2 * sigma_s * sigma_s)
    crossings = density * ops.sqrt(slope / (2.0 * math.pi)) * bin_s
    safe = ops.maximum(above, 1e-37)
    # above erf(sqrt(pi) / 2 crossings / above), with erf(x) = 1 - 2 Q(x sqrt(2))
    ratio = ops.minimum(crossings / safe, 10.0)
    # Of a ratio of 0 the approximated tail may be a little more than one half.
    return safe * ops.maximum(1.0 - 2.0 * normal_tail(math.sqrt(0.5 * math.pi) * ratio), 0.0)


def detection_probability(*, threshold: Lanes, signal: Lanes, variance: Lanes, unit: Lanes, gained: Lanes) -> Lanes:
    """Probability that the filter's peak at an echo exceeds the threshold (T98).

    Args:
        signal: expected value of the filter at the echo
        variance: variance of F there
        unit: third cumulant of F over its variance
        gained: photons by which the highest of the filter's values near the echo exceeds that at it, on average
    """
    ops = xp(threshold, signal, variance)
    lit = signal > 1e-6
    spread = ops.maximum(variance, 1e-30)
    probability = tail(excess=threshold - signal - gained, variance=spread, unit=unit)
    return ops.where(lit, probability, 0.0)


def gain_of_place(*, signal: Lanes, background: Lanes, signal_variance: Lanes, bend: Lanes = 1.0) -> Lanes:
    """Photons that the search for the highest value gains on a lone echo, var F' / (2 |F''|) (T98).

    The receiver takes the highest value near the echo, which noise moves.

    Args:
        signal: S
        background: variance of F by the background, as far as its slope has it (`slope_excluded`)
        signal_variance: variance of F by the echo's own photons, as far as the slope has it
        bend: |F''| over that of a weak echo of this height
    """
    return (_BACKGROUND_GAIN * background + _SIGNAL_GAIN * signal_variance) / _steepness(
        signal, background, signal_variance, bend
    )


def _steepness(signal: Lanes, background: Lanes, signal_variance: Lanes, bend: Lanes) -> Lanes:
    """|F''| at the peak of an echo; arguments as of `gain_of_place`."""
    ops = xp(signal, background, signal_variance)
    spread = ops.maximum(background + signal_variance, 1e-30)
    return ops.where(signal > 1e-6, ops.maximum(signal * bend, _LEAST_STEEP * ops.sqrt(spread)), 1.0)


def place_variance(*, signal: Lanes, background: Lanes, signal_variance: Lanes, bend: Lanes = 1.0) -> Lanes:
    """Variance of the place of the filter's peak at a lone echo, var F' / F''^2, in sigmas of the pulse squared (T176).

    Arguments as of `gain_of_place`.
    """
    variance = (1.0 + SECOND_ORDER / xp(signal).maximum(signal, 1.0)) * signal_variance
    gain = gain_of_place(signal=signal, background=background, signal_variance=variance, bend=bend)
    return 2.0 * OUTPUT_WIDTH * OUTPUT_WIDTH * gain / _steepness(signal, background, signal_variance, bend)


def loss_between_bins(*, signal: Lanes, bin_sigmas: Lanes, bend: Lanes = 1.0) -> Lanes:
    """Photons by which the highest bin lies below the filter's peak, on average over its places in a bin (T103).

    The peak lies anywhere within half a bin of the highest one, |F''| bin^2 / 24 above it.

    Args:
        bin_sigmas: length of a bin in widths of the echo
        bend: |F''| over that of a weak echo of this height
    """
    return signal * bend * bin_sigmas * bin_sigmas * (1.0 / (24.0 * OUTPUT_WIDTH * OUTPUT_WIDTH))


SIGNAL_REACH = TEMPLATE * math.sqrt((TEMPLATE**2 + 2.0) / (TEMPLATE**2 + 1.0))
"""Width in which a count of the background shares the template with one of the echo, in sigmas of the pulse (T104)."""

BACKGROUND_REACH = math.sqrt(2.0) * TEMPLATE
"""The same of two counts of the background."""


def excluded(*, rate_hz: Lanes, free: Lanes, dead_time_s: Lanes, reach_s: Lanes) -> Lanes:
    """Integral of a SPAD's renewal density less its mean rate, over a Gaussian (T104).

    A firing of a SPAD excludes others for a dead time; then it fires with the rate of a free one, which falls back to
    the mean.

    Args:
        rate_hz: lambda
        free: share of the SPADs that are free
        reach_s: width of the Gaussian, `SIGNAL_REACH` or `BACKGROUND_REACH`
    """
    ops = xp(rate_hz, dead_time_s, reach_s)
    bright, later = rate_hz * reach_s, dead_time_s / reach_s
    # Long dead times leave nothing, of numbers that may be too large.
    within = ops.minimum(later, _NEVER_AGAIN)
    revived = ops.exp(-0.5 * within * within) * scaled_normal_tail(bright + within) * math.sqrt(2.0 * math.pi)
    return bright * (revived - math.sqrt(0.5 * math.pi) * free)


def repeated(*, rate_hz: Lanes, dead_time_s: Lanes, reach_s: Lanes, afterpulse: Lanes, afterpulse_s: Lanes) -> Lanes:
    """Integral of a firing's afterpulses over the Gaussian of `excluded`, to first order in their number (T109)."""
    ops = xp(rate_hz, dead_time_s, reach_s)
    within = ops.minimum(dead_time_s / reach_s, _NEVER_AGAIN)
    fading = reach_s / afterpulse_s
    tail = ops.exp(-0.5 * within * within - dead_time_s / afterpulse_s) * scaled_normal_tail(
        rate_hz * reach_s + within + fading
    )
    return afterpulse * fading * tail * math.sqrt(2.0 * math.pi)


def slope_excluded(*, rate_hz: Lanes, dead_time_s: Lanes, sigma_s: Lanes) -> Lanes:
    """Factor of the variance of the filter's slope by even background, over that of Poisson counts (T104).

    The slope does not see that SPADs exclude each other's firings for long, as its weights have no sum; firings a dead
    time apart are in opposite parts of it.
    """
    ops = xp(rate_hz, dead_time_s, sigma_s)
    reach_s = BACKGROUND_REACH * sigma_s
    bright, later = rate_hz * reach_s, ops.minimum(dead_time_s / reach_s, _NEVER_AGAIN)
    sum_0 = scaled_normal_tail(bright + later) * math.sqrt(2.0 * math.pi)
    sum_1 = 1.0 - (bright + later) * sum_0
    sum_2 = sum_0 - (bright + later) * sum_1
    weighted = (1.0 - later * later) * sum_0 - 2.0 * later * sum_1 - sum_2
    return ops.maximum(1.0 + 2.0 * bright * ops.exp(-0.5 * later * later) * weighted, 0.0)


def gain_of_breadth(*, signal: Lanes, background: Lanes, signal_variance: Lanes, bend: Lanes) -> Lanes:
    """Additional gain of a broad peak from the noise of its place, over that of a lone echo, in photons.

    The gain of (T98) grows as the peak's curvature falls, by x = |F''| of a lone echo / |F''| - 1. A top that is
    flat at its middle still falls off to its sides: echoes at every distance, drawn bin by bin, gain
    x / sqrt(1 + (x / 3)^2), so 4 times as much at most (T98a).

    Args:
        signal: as of `gain_of_place`
        background: as of `gain_of_place`
        signal_variance: as of `gain_of_place`
        bend: second derivative of the peak over its height, in widths of a lone echo (which has -1)
    """
    ops = xp(signal, bend)
    flatness = ops.maximum(1.0 / ops.maximum(-bend, 1e-3) - 1.0, 0.0)
    broader = flatness / ops.sqrt(1.0 + flatness * flatness * (1.0 / (_BROADEST * _BROADEST)))
    return gain_of_place(signal=signal, background=background, signal_variance=signal_variance) * broader
