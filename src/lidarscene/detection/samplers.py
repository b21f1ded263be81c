"""Samplers: time, amplitude and width of a pulse that tripped the comparator, as the sensor measures them.

Sensors measure a pulse in three ways (X. Guo's section 2.2.3): with the TDC alone, with comparators at several levels,
or with an ADC. Which pulses there are is decided before, by edges or by peaks; the sampler only measures them
(docs/theory_receivers.md 4 and 6).

Symbols: U threshold, w time over a threshold, sigma_p width of the laser pulse and unit of all places, P power,
s_i sample i, g Gaussian pulse.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..maths.arrays import Array, Lanes, Mask, select_state, xp
from ..physics.electronics.pulse_sums import SIGMAS_PER_FWHM, crossing
from ..physics.optics import pulse as pulse_shape
from ..sensor.electronics import Adc, MultiLevel
from . import comparator
from .comparator import Trip
from .pulses import edges, timing
from .pulses.samples import Window
from .rises import Rise
from .shots import Received

_SLOW = 2.0 * SIGMAS_PER_FWHM
"""Accuracy bought: farther than this before its peak, in sigma_p, only slow light is over the threshold: a pulse would
have to be 65,000 thresholds high."""

_OVERDRIVEN = 20.0
"""Accuracy bought: powers over that at which samples are clipped from which its width times a pulse: the window holds
all of others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """Measurement of a pulse by the sampler; each field (n,).

    Attributes:
        reported_s: time that the converter reports
        amplitude: peak, in signal units
        width_s: time over the threshold; 0 from a TDC that times rising edges only
        place: place on the waveform that was timed
    """

    reported_s: Lanes
    place: Lanes
    amplitude: Lanes
    width_s: Lanes


def read(shots: Received, rise: Rise, trip: Trip, place: Lanes, *, mask: Mask) -> Reading:
    """Measure a pulse with the sensor's sampler.

    Args:
        place: (n,) place at which the pulse crosses the threshold
        mask: (n,) bool, lanes to measure; results of other lanes are undefined
    """
    sampler = shots.sensor.sampler
    if isinstance(sampler, MultiLevel):
        return _read_levels(shots, sampler, rise, trip, place, mask)
    if isinstance(sampler, Adc):
        return _read_samples(shots, sampler, rise, trip, place, mask)
    amplitude = timing.amplitude(shots, trip, lag_s=(place - rise.peak) * shots.sigma_s)
    width = None
    if shots.sensor.tdc.both_edges:
        leaving = edges.trailing_level(shots, rise, trip, place, shots.threshold)
        end, _ = edges.fall(shots, rise, trip, leaving, rise.peak, mask)
        width = shots.ops.where(mask, (end - place) * shots.sigma_s, 0.0)
    reported_s, timed = timing.rise_time_s(shots, rise, trip, place=place, measured=amplitude, width_s=width, mask=mask)
    if width is None:
        width = shots.ops.full(place, 0.0)
    return Reading(reported_s=reported_s, amplitude=amplitude, width_s=width, place=timed)


def _read_levels(shots: Received, sampler: MultiLevel, rise: Rise, trip: Trip, place: Lanes, mask: Mask) -> Reading:
    """Measure a pulse with comparators at several levels.

    The width at the highest level that tripped gives the amplitude, theory (T54). The width at the threshold gives the
    walk: the middle of both crossings is the peak of a symmetric pulse, whatever its height.

    Other light may hold a level high before or behind the pulse. Such a level carries no information on the pulse, and
    the lowest level that both edges pass replaces it. If there is none, the pulse is measured as by a TDC alone.
    """
    # One deviate stands for the whole leading edge, at all levels; another for the trailing edge, correlated with the
    # first (T26a). So the levels cannot contradict each other.
    ops, point, fwhm = shots.ops, shots.point, shots.sensor.received_fwhm_s
    own_level, foot = shots.threshold + trip.base, edges.foot(shots, rise, trip, mask)
    first, *higher = (
        _Level.for_pulse(shots, rise, trip, place, factor * shots.threshold, mask).restrict(own_level, foot)
        for factor in sampler.levels
    )
    lowest, highest, above, raised = first, first, ops.full(mask, False), ops.full(mask, False)
    for higher_level in higher:
        first_reached = higher_level.reached & ~lowest.reached
        raised = raised | (first_reached & (higher_level.level > own_level * (1.0 + 1e-6)))
        lowest, highest = select_state(first_reached, higher_level, lowest), highest.or_if_reached(higher_level)
        above = above | (higher_level.reached & ~first_reached)
    # Only two levels are searched in the waveform: the lowest for the time, the highest reached for the amplitude.
    crossed = place
    place = ops.where(
        raised,
        crossing(
            shots.wave.at,
            ops.where(raised, point.response.power_w(lowest.up), 1.0),
            far=rise.valley,
            peak=rise.peak,
            top=rise.top,
            mask=raised,
        ),
        place,
    )
    start = crossing(
        shots.wave.at,
        ops.where(above, point.response.power_w(highest.up), 1.0),
        far=rise.valley,
        peak=rise.peak,
        top=rise.top,
        mask=above,
    )
    # The waveform falls below a higher level before it falls below a lower one, so the lower search starts from there.
    end, near = edges.fall(shots, rise, trip, highest.down, rise.peak, above)
    since = ops.where(above, near, rise.peak)
    width = ops.where(lowest.reached, edges.fall(shots, rise, trip, lowest.down, since, lowest.reached)[0] - place, 0.0)
    power = point.response.power_of_width_w(
        ops.where(above, end - start, width) * shots.sigma_s, threshold=highest.level, pulse_fwhm_s=fwhm
    )
    amplitude: Lanes = ops.where(
        highest.reached, point.response.signal(ops.where(highest.reached, power, 0.0)), shots.threshold
    )
    if shots.wave.volume is not None:
        # The air's light lasts longer than any pulse, so its width overestimates its power. The next level, which it
        # did not reach, is an upper bound. Above the highest level another one at the same ratio is assumed.
        levels = sampler.levels
        following = (*levels[1:], levels[-1] * levels[-1] / levels[-2])
        for factor, next_factor in zip(levels, following, strict=True):
            at_level = highest.level == factor * shots.threshold
            amplitude = ops.where(at_level, ops.minimum(amplitude, next_factor * shots.threshold), amplitude)
    open_ = ~highest.reached & (foot >= own_level)
    edge_alone = comparator.amplitude(shots, trip, lag_s=(place - rise.peak) * shots.sigma_s)
    amplitude = ops.where(open_, edge_alone, amplitude)
    # The crossing precedes the middle of both crossings by half the width: that is the walk. ``tdc.walk`` = "none"
    # takes the walk of the leading edge at the true power instead, and "raw" takes none.
    walk: Lanes = -0.5 * width
    if shots.sensor.tdc.walk != "corrected":
        true_power = ops.where(mask, rise.top[0], 1.0)
        walk_s = comparator.walk_s(shots, measured=amplitude, width_s=None, true_power_w=true_power)
        walk = walk_s / shots.sigma_s
    elif point.response.recovery_s is not None:
        # An amplifier that drains slowly lengthens the falling edge, and the pulse is not symmetric. Then the width
        # gives the power (T45), and the power how long before its peak the pulse crossed.
        power = point.response.power_of_width_w(width * shots.sigma_s, threshold=shots.threshold, pulse_fwhm_s=fwhm)
        share = point.response.power_w(shots.threshold) / power
        walk = pulse_shape.leading_edge_time_s(level=share, fwhm_s=fwhm) / shots.sigma_s
    if shots.sensor.tdc.walk == "corrected":
        edge_walk_s = comparator.walk_s(
            shots, measured=ops.where(open_, amplitude - trip.base, shots.threshold), width_s=None, true_power_w=1.0
        )
        walk = ops.where(open_, edge_walk_s / shots.sigma_s, walk)
    return Reading(
        reported_s=comparator.converted_time_s(shots, shots.time_s(place - walk), draw=rise.number, height=amplitude),
        amplitude=ops.maximum(amplitude, shots.threshold),
        width_s=width * shots.sigma_s,
        place=ops.where(open_, crossed, place - walk),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Level:
    """One of several thresholds, and where the edges of a pulse pass it; each field (n,).

    Attributes:
        level: the threshold, in signal units
        up: noiseless signal at which the leading edge passes it, theory (T25)
        down: noiseless signal at which the trailing edge passes it
        reached: whether both edges pass it
    """

    level: Lanes
    up: Lanes
    down: Lanes
    reached: Mask

    @classmethod
    def for_pulse(cls, shots: Received, rise: Rise, trip: Trip, place: Lanes, level: Lanes, mask: Mask) -> _Level:
        """Compare one threshold with a pulse that crossed the lowest one at ``place``."""
        point = shots.point
        up = point.noise.crossing_level(level, trip.deviate)
        down = edges.trailing_level(shots, rise, trip, place, level)
        reached = mask & (up < trip.signal) & (down < trip.signal)
        if point.response.saturation is not None:
            reached = reached & (level < point.response.saturation)
        return cls(level=level, up=up, down=down, reached=reached)

    def restrict(self, lowest_level: Lanes, foot: Lanes) -> _Level:
        """Restrict the level to pulses for which it is at least ``least`` and above the light behind the pulse."""
        reached = self.reached & (self.level >= lowest_level * (1.0 - 1e-6)) & (self.level > foot)
        return replace(self, reached=reached)

    def or_if_reached(self, other: _Level) -> _Level:
        """Select the other level where the pulse reaches it, else this one."""
        ops = xp(self.up)
        return _Level(
            level=ops.where(other.reached, other.level, self.level),
            up=ops.where(other.reached, other.up, self.up),
            down=ops.where(other.reached, other.down, self.down),
            reached=self.reached | other.reached,
        )


def _read_samples(shots: Received, adc: Adc, rise: Rise, trip: Trip, place: Lanes, mask: Mask) -> Reading:
    """Measure a pulse with an ADC: the centroid of its samples, or the maximum behind a matched filter.

    The matched filter needs a start near its maximum; the centroid of the samples above the threshold is that.
    """
    ops = shots.ops
    # Of light that lasts samples have less than the filter makes of it.
    base = trip.base / shots.sensor.lasting_gain
    # The window lies around the peak of light that rises slowly, far behind where it trips the comparator.
    window = Window.from_crossing(shots, adc, rise, ops.maximum(place, rise.peak - _SLOW), base)
    samples, sums = window.read(mask)
    any_over = sums.count > 0
    # Weak pulses have no sample above the threshold, and are seen behind the filter only.
    peak_place: Lanes = ops.where(
        any_over, sums.moment / ops.where(any_over, sums.total, 1.0), rise.peak if shots.sensor.matches else place
    )
    amplitude: Lanes = sums.highest
    if adc.estimator == "matched_filter":
        # Newton's method squares the error in each step: from the centroid two steps are enough.
        for _ in range(2):
            peak_place, amplitude = window.newton_step(samples, peak_place, mask)
    width_s: Lanes = sums.count / adc.rate_hz
    saturation = shots.point.response.saturation
    if saturation is not None:
        # A step below full scale: rounding must not hide that a sample is clipped.
        clipped_from = ops.minimum(saturation, adc.full_scale) - base - adc.step
        clipped = mask & (sums.highest >= clipped_from)
        sampled = _Sampled(window=window, samples=samples, clipped_from=clipped_from, place=peak_place, width_s=width_s)
        peak_place, width_s = ops.where_any(
            clipped, lambda: _read_clipped(shots, adc, rise, trip, place, sampled, mask=clipped), (peak_place, width_s)
        )
    return Reading(
        reported_s=comparator.converted_time_s(shots, shots.time_s(peak_place), draw=rise.number, height=amplitude),
        amplitude=ops.maximum(amplitude, shots.threshold) + trip.base,
        width_s=width_s * shots.wave.broadening,
        place=peak_place,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sampled:
    """A pulse by the samples of its window alone.

    Attributes:
        samples: (room,) of the window
        clipped_from: (n,) value from which a sample is clipped
        place: (n,) place of the pulse
        width_s: (n,) width of the pulse
    """

    window: Window
    samples: Array
    clipped_from: Lanes
    place: Lanes
    width_s: Lanes


def _read_clipped(
    shots: Received, adc: Adc, rise: Rise, trip: Trip, crossing: Lanes, sampled: _Sampled, *, mask: Mask
) -> tuple[Lanes, Lanes]:
    """Place and width of pulses whose samples are clipped, (T56a).

    The width, which samples show to a tick of the clock, gives the power (T45), and the power how long before the peak
    the last sample was that is not clipped. Pulses that are less than `_OVERDRIVEN` stay where the samples say.

    Args:
        crossing: (n,) place of the crossing
        mask: (n,) bool, pulses with clipped samples
    """
    ops, point, fwhm = shots.ops, shots.point, shots.sensor.received_fwhm_s
    leaving = edges.trailing_level(shots, rise, trip, crossing, shots.sample_threshold + trip.base)
    end, _ = edges.fall(shots, rise, trip, leaving, rise.peak, mask)
    ticks = ops.rint(ops.where(mask, end - crossing, 0.0) / sampled.window.spacing)
    long_s = ops.maximum(ticks / adc.rate_hz, sampled.width_s)
    power = point.response.power_of_width_w(long_s, threshold=shots.sample_threshold, pulse_fwhm_s=fwhm)
    place, sample = sampled.window.foot(sampled.samples, sampled.clipped_from, mask)
    # Below half a threshold a sample is noise.
    foot_w = point.response.power_w(ops.maximum(sample, 0.5 * shots.sample_threshold))
    overdriven = mask & (power > _OVERDRIVEN * point.response.power_w(sampled.clipped_from))
    share = ops.where(overdriven, foot_w / power, 1.0)
    edge = place - pulse_shape.leading_edge_time_s(level=share, fwhm_s=fwhm) / (fwhm / SIGMAS_PER_FWHM)
    return ops.where(overdriven, edge, sampled.place), ops.where(mask, long_s, sampled.width_s)
