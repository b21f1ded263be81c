"""Electrons out of an avalanche photodiode: the tail of McIntyre's distribution.

An electron that enters the avalanche leaves as a random number of electrons with mean M and second moment M^2 F.
The sum over Poisson primaries is skewed, so its upper tail lies above that of the Gaussian (9) with the same
variance, and false alarms are more frequent than (9) says. Sources: R. J. McIntyre, IEEE Trans. Electron Devices 19,
703 (1972); J. Conradi, ibid. 713; P. P. Webb, R. J. McIntyre and J. Conradi, RCA Review 35, 234 (1974).

Everything here counts electrons: primaries in, output in one resolution time 1 / (2 B), for which the shot noise
2 e i B of (14) is exactly the Poisson variance of the count. Electrons start the avalanche; k is the ratio of the
ionisation rates (hole over electron), constant over the junction, 0 <= k < 1.

Symbols: M gain, F excess noise factor, k ionisation ratio, N mean number of primaries, G generating function.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from ...maths.arrays import Lanes, xp
from ...maths.special import log1p, normal_tail
from ..constants import ELEMENTARY_CHARGE_C
from .tdc import MEAN_FREQUENCY_LOW_PASS

_STEPS = 14  # of Newton's method for the saddle point

_LAST = 1e-5
"""Accuracy bought: step of Newton's method, over the solution, that ends at the root in single precision."""

_TERMS = 14  # of the cumulants' series near the mean

_ROUNDING = 1.01
"""Accuracy bought: factor by which a bound is raised, so that its rounding in single precision leaves out no rate."""


def ionisation_ratio(*, gain: Lanes, excess_noise: Lanes) -> Lanes:
    """The k whose McIntyre F at this gain is ``excess_noise``, limited to [0, 0.999].

    It gives a k to a diode that is described by F = M^x: 0.02225 for x = 0.3 at M = 80. At a gain of one there is no
    avalanche, and k is 0.
    """
    ops = xp(gain, excess_noise)
    floor = 2.0 - 1.0 / gain
    span = gain - floor
    ratio = (excess_noise - floor) / ops.where(span > 0.0, span, 1.0)
    return ops.minimum(ops.maximum(ops.where(span > 0.0, ratio, 0.0), 0.0), 0.999)


def resolution_time_s(*, bandwidth_hz: Lanes) -> Lanes:
    """1 / (2 B): over this time the Poisson variance of the count is the shot noise 2 e i B."""
    return 0.5 / bandwidth_hz


def tail_probability(
    *, excess: Lanes, primaries: Lanes, gain: Lanes, ionisation_ratio: Lanes, amplifier: Lanes
) -> Lanes:
    """Probability that Poisson primaries through McIntyre's avalanche, plus amplifier noise, exceed the mean.

    The generating function G of one electron's output obeys z = G (1 - b + b G)^(-1 / (1 - k)) with b = (1 - k)(M -
    1) / M; expanded by Lagrange's theorem it gives `reference.mcintyre.log_probability`. So the cumulants are known
    exactly with d = G - 1 as parameter, and a saddle point gives the tail Q(r + ln(v / r) / r), in Barndorff-Nielsen's
    form (Biometrika 73, 307, 1986), which stays between 0 and 1. Compared with the exact sum
    (`reference.mcintyre.tail_probability_exact`) it is 0.7 % low with 24 primaries, 10 % with 2.4 and a half with 0.5.
    With fewer it misses single electrons that stand out of the amplifier's noise. numpy and Dr.Jit.

    Args:
        excess: output electrons above the mean, > 0
        primaries: mean number N of primary electrons
        amplifier: standard deviation of the amplifier's Gaussian noise, in output electrons
    """
    saddle = _saddle_point(excess, primaries, gain, ionisation_ratio, amplifier)
    ops = xp(saddle.exponent)
    # Barndorff-Nielsen's tail: r from the exponent at the saddle point, v from its curvature.
    r = ops.sqrt(ops.maximum(2.0 * saddle.exponent, _TINY))
    v = saddle.s * ops.sqrt(saddle.curvature)
    tail = normal_tail(r + ops.log(ops.maximum(v / r, _TINY)) / r)
    # The amplifier alone, when no electron comes at all: a lower bound, and the whole of it in the dark.
    amplifier_tail = ops.exp(-primaries) * normal_tail((excess + primaries * gain) / ops.maximum(amplifier, 1e-3))
    tail = ops.where(primaries > 1e-3, ops.maximum(tail, amplifier_tail), amplifier_tail)
    return ops.where(saddle.variance > 0.0, tail, 0.0)


def crossings_per_frequency(
    *, excess: Lanes, primaries: Lanes, gain: Lanes, ionisation_ratio: Lanes, amplifier: Lanes
) -> Lanes:
    """Upward crossings of a level in units of f_rms, sqrt(2 pi) sigma p(U), of `tail_probability`'s noise (T28b).

    S. O. Rice's rate is the density p of the height times the mean of the positive slopes, sqrt(2 pi) f_rms sigma for
    slopes that are Gaussian whatever the height: the electrons that make a peak arrive together, where the response
    of the amplifier has no slope. The density is the saddle point's, exp(-I) / sqrt(2 pi K''). numpy and Dr.Jit.
    """
    saddle = _saddle_point(excess, primaries, gain, ionisation_ratio, amplifier)
    ops = xp(saddle.exponent)
    narrower = ops.sqrt(saddle.variance / ops.maximum(saddle.curvature, _TINY))
    deviations = (excess + primaries * gain) / ops.maximum(amplifier, 1e-3)
    share = ops.where(
        primaries > 1e-3, narrower * ops.exp(-saddle.exponent), ops.exp(-primaries - 0.5 * deviations * deviations)
    )
    return ops.where(saddle.variance > 0.0, share, 0.0)


def crossings_bound(
    *, excess: Lanes, primaries: Lanes, gain: Lanes, ionisation_ratio: Lanes, amplifier: Lanes
) -> Lanes:
    """Upper bound of `crossings_per_frequency`: within ten times of it for the diodes of real sensors.

    H. Chernoff's exp(K(s) - s x) is one for any tilt s; here it is the tilt of a Gaussian of this variance.
    """
    saddle = _saddle_point(excess, primaries, gain, ionisation_ratio, amplifier, steps=0)
    return xp(saddle.exponent).exp(-saddle.exponent)


class _Saddle(NamedTuple):
    """The saddle point s, the exponent s x - K(s) and the curvature K''(s) there, and the variance K''(0)."""

    s: Lanes
    exponent: Lanes
    curvature: Lanes
    variance: Lanes


_TINY = 1e-30
"""Accuracy bought: least number that is divided by, or whose logarithm is taken."""


def _saddle_point(
    excess: Lanes, primaries: Lanes, gain: Lanes, ionisation_ratio: Lanes, amplifier: Lanes, *, steps: int = _STEPS
) -> _Saddle:
    """Find the tilt exp(s x) that moves the mean of electrons and amplifier to the level; as `tail_probability`.

    Args:
        steps: of Newton's method, from the tilt that a Gaussian would need
    """
    ops = xp(excess, primaries, gain, ionisation_ratio, amplifier)
    k, b, q = ionisation_ratio, (1.0 - ionisation_ratio) * (gain - 1.0) / gain, (gain - 1.0) / gain
    variance = amplifier * amplifier
    tiny = _TINY

    def log_z(d: Lanes) -> Lanes:
        return log1p(d) - log1p(b * d) / (1.0 - k)

    # Step 1, the saddle point: the d at which the tilted mean equals the mean plus excess, K'(d) = excess.
    # p(d) = (K'(d) - excess) (1 / M - k q d) changes its sign once. Without amplifier it is a quadratic, whose root
    # is an upper bound of d. Newton's method, with bisection where a step would leave the bracket.
    linear = primaries * (1.0 + b + gain * k * q) + excess * k * q
    square = primaries * b
    high = 2.0 * (excess / gain) / (linear + ops.sqrt(linear * linear + 4.0 * square * excess / gain) + tiny)
    low = 0.0 * high
    second_moment = k * gain + (1.0 - k) * (2.0 - 1.0 / gain)
    total = primaries * gain * gain * second_moment + variance
    d: Lanes = ops.minimum(gain * excess / (total + tiny), 0.9 * high)

    def narrow(bracket: tuple[Lanes, Lanes, Lanes]) -> tuple[Lanes, Lanes, Lanes]:
        """Narrow the bracket around d by a step."""
        d, low, high = bracket
        room = 1.0 / gain - k * q * d
        s = log_z(d)
        value = d * (linear + square * d) - excess / gain + variance * s * room
        low, high = ops.where(value < 0.0, d, low), ops.where(value < 0.0, high, d)
        slope = room / ((1.0 + d) * (1.0 + b * d))
        rise = linear + 2.0 * square * d + variance * (slope * room - k * q * s)
        newton = d - value / ops.where(ops.abs(rise) > tiny, rise, tiny)
        # At the root the bracket is as narrow as rounding makes it, and says nothing of the last step.
        inside = ((newton >= low) & (newton <= high)) | (ops.abs(newton - d) < _LAST * d)
        return ops.where(inside, newton, 0.5 * (low + high)), low, high

    if steps:
        # Derivatives do not pass the loop. Newton's last step has them: at the root its own by d is 0.
        start: tuple[Lanes, tuple[Lanes, Lanes, Lanes]] = ops.full(d, 0), (d, low, high)
        end = ops.loop(start, lambda state: state[0] < steps - 1, lambda state: (state[0] + 1, narrow(state[1])))
        d, _, _ = narrow(end[1])
    # Step 2, the cumulant generating function there, less its linear part: M s - d. Near d = 0 the two logarithms
    # cancel in single precision, so there its power series is summed (Horner's scheme).
    series, power = 0.0 * d, 1.0 + 0.0 * b
    coefficients = []
    for n in range(1, _TERMS + 1):
        power = power * b
        coefficients.append((1.0 - power / (1.0 - k)) / n)
    for coefficient in coefficients[:0:-1]:
        series = d * (coefficient - series)
    nonlinear = gain * ops.where(d < 0.125, -d * series, log_z(d) - d / gain)
    # Step 3, the exponent there, and its curvature.
    s = (d + nonlinear) / gain
    room = ops.maximum(1.0 / gain - k * q * d, 1e-7 / gain)
    grown = (1.0 + d) * (1.0 + b * d) / room  # G'(s)
    bend = grown * (1.0 + b + 2.0 * b * d + k * q * grown) / room  # G''(s)
    exponent = s * excess + primaries * nonlinear - 0.5 * variance * s * s
    return _Saddle(s, exponent, primaries * bend + variance, total)


@dataclass(frozen=True, slots=True, kw_only=True)
class Currents:
    """Currents and gain that determine the noise of an avalanche photodiode.

    Attributes:
        primary_a: current of the background and of the bulk dark current, before the avalanche
        unmultiplied_a2: variance of the noise that is not multiplied, as in (18); taken as Gaussian
        gain: M
        excess_noise: F at this gain; k follows from it (`ionisation_ratio`), so the variance is that of (18)
        bandwidth_hz: B of the noise
    """

    primary_a: Lanes
    unmultiplied_a2: Lanes
    gain: Lanes
    excess_noise: Lanes
    bandwidth_hz: Lanes

    def electrons(self, threshold_a: Lanes) -> dict[str, Lanes]:
        """Arguments of `tail_probability`: numbers of electrons in one resolution time, and the threshold's excess."""
        per_ampere = resolution_time_s(bandwidth_hz=self.bandwidth_hz) / ELEMENTARY_CHARGE_C
        return {
            "excess": threshold_a * per_ampere,
            "primaries": self.primary_a * per_ampere,
            "gain": self.gain,
            "ionisation_ratio": ionisation_ratio(gain=self.gain, excess_noise=self.excess_noise),
            "amplifier": xp(self.unmultiplied_a2).sqrt(self.unmultiplied_a2) * per_ampere,
        }


def false_alarm_probability(currents: Currents, *, threshold_a: Lanes) -> Lanes:
    """P_f of one comparison with McIntyre's tail in place of the Gaussian (9): `tail_probability` in amperes."""
    return tail_probability(**currents.electrons(threshold_a))


def crossing_rate_hz(currents: Currents, *, threshold_a: Lanes, least_hz: Lanes | None = None) -> Lanes:
    """Upward crossings a second, `tdc.rice_rate_hz` with McIntyre's tail: `crossings_per_frequency` in amperes.

    Args:
        least_hz: rates below it are 0 where `crossings_bound` says that they are: it takes a tenth of the time; None:
            none
    """
    electrons, frequency_hz = currents.electrons(threshold_a), MEAN_FREQUENCY_LOW_PASS * currents.bandwidth_hz
    if least_hz is None:
        return frequency_hz * crossings_per_frequency(**electrons)
    bound_hz = frequency_hz * crossings_bound(**electrons)
    return xp(bound_hz, least_hz).where_any(
        bound_hz * _ROUNDING > least_hz,
        lambda: frequency_hz * crossings_per_frequency(**electrons) + 0.0 * bound_hz,
        0.0 * bound_hz,
    )
