"""Comparator and time-to-digital converter: false alarms, detection, and where an edge crosses.

The echo's own shot noise grows along its edge. One standard normal deviate z sets the noise n(s) = z sigma(s) at
every signal level s, with sigma(s)^2 = sigma_0^2 + kappa_1 s + kappa_2 s^2 (13). The comparator trips where s + n(s)
= U, which is a quadratic in s. The echo is detected if and only if its peak reaches that level, so that P_d = Q((U -
peak) / sigma(peak)) exactly (docs/theory.md, section 8).

Symbols: U threshold, sigma_0 noise without echo, kappa_1 and kappa_2 its growth, z deviate, B bandwidth, TNR = U /
sigma_0.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from ...maths.special import log1p, normal_tail

MEAN_FREQUENCY_LOW_PASS = 1.0 / math.sqrt(3.0)
"""Root of the mean square frequency of white noise behind an ideal low-pass, in units of B."""

_NO_NOISE = 1e-30
"""Choice: noise in the place of none, so that a signal over it is a number that files can hold."""

_OUT_OF_REACH = 1e12
"""Choice: multiple of the threshold that no signal reaches."""


def false_alarm_probability(*, threshold: Lanes, noise: Lanes) -> Lanes:
    """P_f of one comparison, (9): probability that Gaussian noise exceeds the threshold. 0 without noise."""
    ops = xp(threshold, noise)
    quiet = noise <= 0.0
    return ops.where(quiet, 0.0, normal_tail(threshold / ops.where(quiet, 1.0, noise)))


def rice_rate_hz(*, threshold: Lanes, noise: Lanes, bandwidth_hz: Lanes) -> Lanes:
    """Upward crossings per second of white Gaussian noise behind an ideal low-pass, B / sqrt(3) exp(-TNR^2 / 2).

    S. O. Rice, Bell System Technical Journal 24, 46 (1945): f_rms exp(-U^2 / (2 sigma_0^2)), with f_rms the root of the
    mean square frequency of the noise. An alternative to the independent comparisons of (9) and (10), with 7.5 times
    as many alarms at TNR 5. A Gaussian filter of the same noise bandwidth has sqrt(2 / pi) B in place of B / sqrt(3),
    1.38 times as many; a single pole has no finite number. 0 without noise.
    """
    ops = xp(threshold, noise)
    quiet = noise <= 0.0
    ratio = threshold / ops.where(quiet, 1.0, noise)
    rate = MEAN_FREQUENCY_LOW_PASS * bandwidth_hz * ops.exp(-0.5 * ratio * ratio)
    return ops.where(quiet, 0.0, rate)


def further_crossings(*, steepness: Lanes) -> Lanes:
    """Mean number of crossings of an edge by noise beyond the first, phi(q) / q - Q(q), (T80a).

    An edge that rises by q times the noise's own rms slope crosses a level phi(q) / q + Phi(q) times on the way up
    (H. Cramer and M. R. Leadbetter, Stationary and Related Stochastic Processes, 1967, 13.2, of a straight edge),
    and once without noise.

    Args:
        steepness: q, above 0
    """
    ops = xp(steepness)
    density = ops.exp(-0.5 * steepness * steepness) * (1.0 / math.sqrt(2.0 * math.pi))
    return ops.maximum(density / steepness - normal_tail(steepness), 0.0)


def comparisons(*, window_s: Lanes, bandwidth_hz: Lanes) -> Lanes:
    """Number of comparisons in a time window, M of (10)."""
    return window_s * bandwidth_hz


def correct_probability(*, p_false: Lanes, p_detect: Lanes, comparisons: Lanes) -> Lanes:
    """Share of correct returns among all returns, for a target at the end of the window, (10)."""
    ops = xp(p_false, p_detect, comparisons)
    silence = ops.exp((comparisons - 1.0) * log1p(-p_false))
    return silence * p_detect / (1.0 - silence * (1.0 - p_detect))


def false_alarm_rate_hz(*, p_false: Lanes, bandwidth_hz: Lanes) -> Lanes:
    """Rate of the Poisson process that leaves a window of M comparisons quiet with (1 - P_f)^M, as in (10)."""
    return -log1p(-p_false) * bandwidth_hz


def excursion_width_s(*, height: Lanes, threshold: Lanes, bandwidth_hz: Lanes) -> Lanes:
    """Time that a noise peak of height h spends over the threshold, sqrt(6) / (pi B) sqrt(1 - U / h).

    Near a high peak, noise follows its own correlation (D. Slepian, 1963), 1 - (2 pi B t)^2 / 6 behind an ideal
    low-pass, a parabola. With exponential heights above U (mean sigma^2 / U) the mean width is that of Rice, time
    above U over number of crossings, to first order in sigma / U.
    """
    ops = xp(height, threshold, bandwidth_hz)
    excess = ops.maximum(1.0 - threshold / height, 0.0)
    return math.sqrt(6.0) / math.pi / bandwidth_hz * ops.sqrt(excess)


def signal_to_noise(*, signal: Lanes, noise: Lanes) -> Lanes:
    """Trigger SNR, (11): peak with echo over deviation without; finite without any noise.

    The echo's own shot noise is left out.
    """
    return signal / xp(signal, noise).where(noise <= 0.0, _NO_NOISE, noise)


def noise_at_level(*, level: Lanes, noise: Lanes, kappa_1: Lanes, kappa_2: Lanes) -> Lanes:
    """sigma(s) = sqrt(sigma_0^2 + kappa_1 s + kappa_2 s^2), noise with the echo's own part, (13)."""
    ops = xp(level, noise, kappa_1)
    return ops.sqrt(ops.maximum(noise * noise + level * (kappa_1 + kappa_2 * level), 0.0))


def detection_probability(*, signal: Lanes, threshold: Lanes, noise_at_peak: Lanes) -> Lanes:
    """P_d = Q((U - peak) / sigma(peak)). Without noise it is 1 for a peak at or above U, else 0."""
    ops = xp(signal, threshold, noise_at_peak)
    quiet = noise_at_peak <= 0.0
    step = ops.where(signal >= threshold, 1.0, 0.0)
    smooth = normal_tail((threshold - signal) / ops.where(quiet, 1.0, noise_at_peak))
    return ops.where(quiet, step, smooth)


def noise_correlation(*, lag_s: Lanes, bandwidth_hz: Lanes) -> Lanes:
    """Correlation of the noise with itself after ``lag_s``: exp(-2 pi B |lag|), a single pole of bandwidth B.

    It says how much of the noise that shifts an edge is still present at the peak.
    """
    ops = xp(lag_s, bandwidth_hz)
    return ops.exp((-2.0 * math.pi) * bandwidth_hz * ops.abs(lag_s))


def noise_change(*, lag_s: Lanes, crossing_bandwidth_hz: Lanes) -> Lanes:
    """Root of 1 - r: how much of the noise changes after ``lag_s``, over that of two independent instants.

    r = exp(-(2 pi f t)^2 / 2), which has the curvature of the noise's correlation: f is its root mean square frequency.

    Args:
        crossing_bandwidth_hz: bandwidth of the ideal low-pass whose white noise has that frequency, sqrt(3) f
    """
    ops = xp(lag_s, crossing_bandwidth_hz)
    turn = (2.0 * math.pi * MEAN_FREQUENCY_LOW_PASS) * crossing_bandwidth_hz * lag_s
    return ops.sqrt(ops.maximum(1.0 - ops.exp(-0.5 * turn * turn), 0.0))


def crossing_level(*, threshold: Lanes, noise: Lanes, kappa_1: Lanes, kappa_2: Lanes, deviate: Lanes) -> Lanes:
    """Signal level s at which s + z sigma(s) = U.

    The root of (1 - z^2 k2) s^2 - (2 U + z^2 k1) s + U^2 - z^2 sigma_0^2 = 0 on the branch of z's sign, written
    without cancellation. Levels below 1e-3 U are raised to it, so that the time stays finite; there a noise peak
    would have tripped the comparator without any echo (z sigma_0 > U). Where z < 0 and z^2 k2 >= 1 noise grows faster
    than the signal and no level is high enough: the level is `_OUT_OF_REACH` U or more.

    Args:
        threshold: U, in signal units
        noise: sigma_0, in signal units
        kappa_1: coefficients of the echo's own noise; kappa_2 < 0 of cells, > 0 of a laser whose power scatters
        kappa_2: as `kappa_1`
        deviate: z, standard normal
    """
    ops = xp(threshold, noise, deviate)
    z2 = deviate * deviate
    a = 1.0 - z2 * kappa_2
    half_b = threshold + 0.5 * z2 * kappa_1
    c = threshold * threshold - z2 * noise * noise
    # The discriminant half_b^2 - a c is z^2 times ``inner``, for kappa_2 <= 0 a sum of positive terms: U^2 is cancelled
    # by hand, since in single precision the difference of two nearly equal squares would lose most digits.
    inner = (
        threshold * (kappa_1 + threshold * kappa_2)
        + noise * noise
        + z2 * (0.25 * kappa_1 * kappa_1 - kappa_2 * noise * noise)
    )
    root = ops.abs(deviate) * ops.sqrt(ops.maximum(inner, 0.0))
    upper = (half_b + root) / ops.maximum(a, 1.0 / _OUT_OF_REACH)
    # z < 0 needs more signal than U, the larger root; z > 0 less, the smaller one, as c over the larger.
    level = ops.where(deviate < 0.0, upper, c / (half_b + root))
    return ops.maximum(level, 1e-3 * threshold)


def quantise(*, time_s: Lanes, least_significant_bit_s: Lanes) -> Lanes:
    """Time rounded to the converter's step; a step of zero leaves it unchanged."""
    ops = xp(time_s, least_significant_bit_s)
    step = ops.where(least_significant_bit_s > 0.0, least_significant_bit_s, 1.0)
    return ops.where(least_significant_bit_s > 0.0, ops.rint(time_s / step) * step, time_s)
