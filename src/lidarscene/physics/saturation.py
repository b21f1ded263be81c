"""An amplifier that clips: what it makes of a strong pulse's height, width and timing.

The input stage passes s g(t), the Gaussian pulse, up to a level S. What it cannot pass it holds as charge: from the
moment the pulse has fallen back to S the output is what is left of the peak s, draining with the recovery time tau,
and still clipped,

    v(t) = min(S, s g(t))                 up to t_S,     s g(t_S) = S on the falling side
    v(t) = min(S, s exp(-(t - t_S)/tau))  after, or s g(t) where that is more

so that the output leaves S tau ln(s / S) late and the pulse is longer by so much: recovery times and pulse widths of
receivers do grow with the logarithm of the overdrive. The rising edge is not touched below S.
"""

from __future__ import annotations

from ..arrays import Array, xp
from ..constants import SPEED_OF_LIGHT_M_S
from .pulse import gaussian_pulse, leading_edge_time_s


def clipped(*, signal: Array, saturation: Array) -> Array:
    """A peak as it comes out of the amplifier: no more than S."""
    return xp(signal, saturation).minimum(signal, saturation)


def clipped_waveform(
    *, time_s: Array, signal: Array, saturation: Array, fwhm_s: Array, recovery_s: Array
) -> Array:
    """v(t) of a pulse of this peak, centred on zero; the pulse itself where the peak is below S."""
    ops = xp(time_s, signal, saturation)
    pulse = signal * gaussian_pulse(time_s=time_s, fwhm_s=fwhm_s)
    released = -leading_edge_time_s(level=saturation / signal, fwhm_s=fwhm_s)
    since = ops.maximum(time_s - released, 0.0)
    drained = signal * ops.exp(-since / ops.maximum(recovery_s, 1e-18))
    held = (signal > saturation) & (time_s > released)
    return ops.minimum(ops.where(held, ops.maximum(pulse, drained), pulse), saturation)


def width_at_level_s(
    *, level: Array, signal: Array, saturation: Array, fwhm_s: Array, recovery_s: Array
) -> Array:
    """Time that v(t) spends above a level at or below S: between the comparator's two crossings. 0 above the peak.

    Not saturated it is 2 t(U) with t(U) = FWHM sqrt(ln(s / U) / (4 ln 2)); else t(U) + max(t(U), t(S) +
    tau ln(s / U)).
    """
    ops = xp(level, signal, saturation)
    rise = -leading_edge_time_s(level=level / signal, fwhm_s=fwhm_s)
    released = -leading_edge_time_s(level=saturation / signal, fwhm_s=fwhm_s)
    drained = released + recovery_s * ops.log(ops.maximum(signal / level, 1.0))
    fall = ops.where(signal > saturation, ops.maximum(rise, drained), rise)
    return ops.where(signal > level, rise + fall, 0.0)


def walk_bias_m(*, threshold: Array, signal: Array, saturation: Array, fwhm_s: Array) -> Array:
    """Range error that is left where the walk is corrected by the clipped peak: negative, too near; 0 below S.

    The edge crosses U at -t(U / s) of the pulse, and is thought to have at -t(U / S). Without noise.
    """
    true_s = leading_edge_time_s(level=threshold / signal, fwhm_s=fwhm_s)
    seen = clipped(signal=signal, saturation=saturation)
    thought_s = leading_edge_time_s(level=threshold / seen, fwhm_s=fwhm_s)
    return 0.5 * SPEED_OF_LIGHT_M_S * (true_s - thought_s)
