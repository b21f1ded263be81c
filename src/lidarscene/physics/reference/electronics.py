"""Comparator, clock, samples and a clipping amplifier: closed forms and bounds, (9).

Nothing in a render or a study runs this: tests compare with it what does (`lidarscene.physics.reference`).
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from ...maths.special import normal_tail_inverse
from ..constants import SPEED_OF_LIGHT_M_S
from ..electronics.pulse_sums import SIGMAS_PER_FWHM
from ..electronics.saturation import clip, held_until
from ..optics.pulse import gaussian_pulse, leading_edge_time_s


def threshold_to_noise(*, p_false: Lanes) -> Lanes:
    """TNR at which one comparison of Gaussian noise has this P_f: (9) solved for U / sigma_0."""
    return normal_tail_inverse(p_false)


def fraction_deviation(
    *, fraction: Lanes, noise_share_at_fraction: Lanes, noise_share_at_peak: Lanes, correlation: Lanes
) -> Lanes:
    """Deviation of the time at which an edge reaches a fraction of the measured peak, in sigma_p; slope formula (T76).

    Args:
        noise_share_at_fraction: deviation of the noise at the fraction, over the peak's height
        noise_share_at_peak: deviation of the noise at the peak, over its height
        correlation: correlation of the noise between both
    """
    ops = xp(fraction, noise_share_at_peak)
    held = fraction * noise_share_at_peak
    variance = (
        noise_share_at_fraction * noise_share_at_fraction
        + held * held
        - 2.0 * correlation * noise_share_at_fraction * held
    )
    return ops.sqrt(variance) / (fraction * ops.sqrt(-2.0 * ops.log(fraction)))


def least_time_deviation_s(*, snr: Lanes, rate_hz: Lanes, pulse_fwhm_s: Lanes) -> Lanes:
    """Cramer-Rao bound of the time of a Gaussian pulse in white noise, with unknown height.

    The information is sum_k (dg/dt)^2 snr^2 = snr^2 rate sqrt(pi) / (2 sigma_p): S. M. Kay, Fundamentals of
    Statistical Signal Processing I, section 3.5. Errors of height and time are not correlated, because the pulse is
    even and its slope odd.

    Args:
        snr: peak over the standard deviation of one sample
        rate_hz: samples per second, several in a pulse
    """
    ops = xp(snr, rate_hz, pulse_fwhm_s)
    sigma_s = pulse_fwhm_s / SIGMAS_PER_FWHM
    return ops.sqrt(2.0 * sigma_s / (math.sqrt(math.pi) * rate_hz)) / snr


def clipped_waveform(*, time_s: Lanes, signal: Lanes, saturation: Lanes, fwhm_s: Lanes, recovery_s: Lanes) -> Lanes:
    """v(t) of a pulse of peak ``signal``, centred on zero; the pulse itself if its peak is below S."""
    ops = xp(time_s, signal, saturation)
    pulse = signal * gaussian_pulse(time_s=time_s, fwhm_s=fwhm_s)
    released = -leading_edge_time_s(level=saturation / signal, fwhm_s=fwhm_s)
    since = ops.maximum(time_s - released, 0.0)
    drained = signal * ops.exp(-since / ops.maximum(recovery_s, 1e-18))
    held = (signal > saturation) & (time_s > released)
    return ops.minimum(ops.where(held, ops.maximum(pulse, drained), pulse), saturation)


def width_at_level_s(*, level: Lanes, signal: Lanes, saturation: Lanes, fwhm_s: Lanes, recovery_s: Lanes) -> Lanes:
    """Time that v(t) spends above a level at or below S, between the comparator's two crossings; 0 if s < U.

    Below saturation it is 2 t(U), with t(U) = FWHM sqrt(ln(s / U) / (4 ln 2)). Above it is
    t(U) + max(t(U), t(S) + tau ln(s / U)).
    """
    ops = xp(level, signal, saturation)
    rise = -leading_edge_time_s(level=level / signal, fwhm_s=fwhm_s)
    fall = held_until(
        fall_s=rise,
        released_s=-leading_edge_time_s(level=saturation / signal, fwhm_s=fwhm_s),
        level=level,
        signal=signal,
        saturation=saturation,
        recovery_s=recovery_s,
    )
    return ops.where(signal > level, rise + fall, 0.0)


def walk_bias_m(*, threshold: Lanes, signal: Lanes, saturation: Lanes, fwhm_s: Lanes) -> Lanes:
    """Range error if the walk is corrected with the clipped peak: negative (too near); 0 below S. Without noise.

    The edge crosses U at -t(U / s) from the pulse's peak, but the correction assumes -t(U / S). For a detector whose
    response is not linear, all three arguments are powers of light: at U, of the echo, and at S.
    """
    true_s = leading_edge_time_s(level=threshold / signal, fwhm_s=fwhm_s)
    measured = clip(signal=signal, saturation=saturation)
    thought_s = leading_edge_time_s(level=threshold / measured, fwhm_s=fwhm_s)
    return 0.5 * SPEED_OF_LIGHT_M_S * (true_s - thought_s)
