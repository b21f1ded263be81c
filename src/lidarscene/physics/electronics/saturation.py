"""An amplifier that clips: what it makes of a strong pulse's height, width and timing.

Echoes of retro-reflectors exceed an amplifier's range by orders of magnitude. Their height is then lost, but their
width still grows with it, which some sensors use. The input stage passes s g(t), the Gaussian pulse, up to a level S.
What it cannot pass it holds as charge: when the pulse has fallen back to S, the output is what is left of the peak s.
It drains with the recovery time tau and is still clipped:

    v(t) = min(S, s g(t))                 up to t_S,     s g(t_S) = S on the falling side
    v(t) = min(S, s exp(-(t - t_S)/tau))  after, or s g(t) where that is more

So the output leaves S late by tau ln(s / S), and the pulse is longer by as much: recovery times and pulse widths of
receivers do grow with the logarithm of the overdrive. The rising edge below S is not changed.

Symbols: s peak of the signal, S saturation level, U level of the comparator, tau recovery time.
"""

from __future__ import annotations

import math

import numpy as np

from ...maths.arrays import Lanes, Numbers, xp

_STEPS = 3  # of Newton's method in `overdrive_of_width`: 1e-8 of any overdrive up to the largest

LARGEST_OVERDRIVE = 80.0
"""Accuracy bought: largest ln(s / U): its exponential still fits single precision."""


def clip(*, signal: Lanes, saturation: Lanes) -> Lanes:
    """The peak behind the amplifier, min(s, S)."""
    return xp(signal, saturation).minimum(signal, saturation)


_RISE = 1e-3
"""Accuracy bought: light counts as new from this share of S on, and as gone when that share of it is left."""


def clipped_course(*, signal: Numbers, step_s: float, saturation: float, recovery_s: float) -> Numbers:
    """v(t) of any light, (n, times): later light comes on top of what is held.

    Of a lone pulse it is `reference.electronics.clipped_waveform`.

    Args:
        signal: (n, times) what the amplifier would pass without clipping, in even steps
    """
    fading = math.exp(-step_s / max(recovery_s, 1e-18))
    output, zero = np.zeros_like(signal), np.zeros(len(signal))
    held, lowest, clips = zero, signal[:, 0], zero > 0.0
    # State while the amplifier clips: charge and light when that began (base, floor), highest input and light since
    # (top, brightest). Clipping begins where light and charge together exceed S and the light is new; it ends where
    # they fall back to S or the new light is gone. From then on the highest input drains as charge.
    base, floor, top, brightest = zero, zero, zero, zero
    for k in range(signal.shape[1]):
        light = signal[:, k]
        held = np.where(clips, held, held * fading)
        lowest = np.where(clips, lowest, np.minimum(lowest, light))
        total = np.maximum(light, np.where(clips, base + light - floor, held + light - lowest))
        begins = ~clips & (total > saturation) & (light - lowest > _RISE * saturation)
        base, floor = np.where(begins, held, base), np.where(begins, lowest, floor)
        clips = clips | begins
        top = np.where(begins, total, np.maximum(top, total))
        brightest = np.where(begins, light, np.maximum(brightest, light))
        faded = light - floor <= _RISE * (brightest - floor)
        ends = clips & (light < brightest) & ((total <= saturation) | faded)
        held, lowest = np.where(ends, top, held), np.where(ends, light, lowest)
        clips = clips & ~ends
        output[:, k] = np.minimum(np.where(ends, top, total), saturation)
    return output


def held_until(
    *, fall_s: Lanes, released_s: Lanes, level: Lanes, signal: Lanes, saturation: Lanes, recovery_s: Lanes
) -> Lanes:
    """Time at which v(t) falls through a level at or below S.

    Any unit of time. A peak below S falls with the light.

    Args:
        fall_s: time at which the light falls through the level
        released_s: time at which the light falls through S
    """
    ops = xp(fall_s, released_s, level, signal)
    drained = released_s + recovery_s * ops.log(ops.maximum(signal / level, 1.0))
    return ops.where(signal > saturation, ops.maximum(fall_s, drained), fall_s)


def remaining_charge(*, held: Lanes, since_s: Lanes, recovery_s: Lanes) -> Lanes:
    """Charge left of a clipped pulse, as a signal level, ``since_s`` after the light fell back to S: s exp(-t / tau).

    The next pulse comes on top of it. Nothing drains before.
    """
    ops = xp(held, since_s)
    return held * ops.exp(-ops.maximum(since_s, 0.0) / ops.maximum(recovery_s, 1e-18))


def overdrive_of_width(*, width_s: Lanes, level: Lanes, saturation: Lanes, fwhm_s: Lanes, recovery_s: Lanes) -> Lanes:
    """ln(s / U) of a pulse that stays above the level U for this time.

    It is `reference.electronics.width_at_level_s` solved for the peak.
    The longer of two widths, so the smaller of two solutions: that of a pulse that falls with its light, and that of
    one that drains. With a = FWHM / sqrt(4 ln 2), l = ln(S / U) and ln(s / U) = l + y^2 the second one solves
    a sqrt(l + y^2) + a y + tau (l + y^2) = w. Its left side is convex in y and grows, so Newton's method comes down
    from any bound above; a width that only clipping can exceed belongs to a peak at S. Three steps from the lower of
    two bounds, each with one of the first two terms at its least, leave 1e-8.
    """
    ops = xp(width_s, level, saturation)
    unit = fwhm_s / math.sqrt(4.0 * math.log(2.0))
    width, recovery = width_s / unit, recovery_s / unit
    clipped_from = ops.maximum(ops.log(saturation / level), 0.0)
    beyond = ops.maximum(width - recovery * clipped_from, 0.0)

    def bound(constant: Lanes, factor: float) -> Lanes:
        """Root of factor y + tau y^2 = constant."""
        return 2.0 * constant / (factor + ops.sqrt(factor * factor + 4.0 * recovery * constant))

    y = ops.minimum(bound(ops.maximum(beyond - ops.sqrt(clipped_from), 0.0), 1.0), bound(beyond, 2.0))
    for _ in range(_STEPS):
        overdrive = clipped_from + y * y
        root = ops.sqrt(ops.maximum(overdrive, 1e-12))
        y = ops.maximum(y - (root + y + recovery * overdrive - width) / (y / root + 1.0 + 2.0 * recovery * y), 0.0)
    even = overdrive_of_symmetric_width(width_s=width_s, fwhm_s=fwhm_s)
    return ops.minimum(even, clipped_from + y * y)


def overdrive_of_symmetric_width(*, width_s: Lanes, fwhm_s: Lanes) -> Lanes:
    """ln(s / U) of a pulse of this width that falls as it rises: ln 2 (w / FWHM)^2."""
    ratio = width_s / fwhm_s
    return math.log(2.0) * ratio * ratio
