"""Samplers: a pulse that tripped the comparator in, its time, amplitude and width as the sensor measures them out.

Three kinds (X. Guo's section 2.2.3): the TDC alone, comparators at several levels, and an ADC. Which pulses there
are is the comparator's decision in all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..maths import random
from ..maths.arrays import Array, Lanes, Mask, S, xp
from ..maths.random import Stage
from ..physics.electronics import sampling, saturation, tdc
from ..physics.electronics.pulse_sums import SIGMAS_PER_FWHM, crossing
from ..physics.optics import pulse as pulse_shape
from ..sensor.model import Adc, MultiLevel
from . import comparator
from .comparator import Trip
from .rises import STEP, Rise
from .shots import Received

_LONGEST = 200
"""Steps of one sigma_p after which a pulse that stays above its level counts as over."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """What is measured of a pulse.

    reported_s  time, amplitude in signal units
    width_s     time over the threshold; 0 from a TDC that times rising edges only
    """

    reported_s: Lanes
    amplitude: Lanes
    width_s: Lanes


def read(shots: Received, rise: Rise, trip: Trip, place: Lanes, *, wanted: Mask) -> Reading:
    """A pulse that crosses the threshold at ``place``, by the sensor's sampler; lanes not wanted mean nothing."""
    sampler = shots.sensor.sampler
    if isinstance(sampler, MultiLevel):
        return _by_levels(shots, sampler, rise, trip, place, wanted)
    if isinstance(sampler, Adc):
        return _by_samples(shots, sampler, rise, place, wanted)
    amplitude = comparator.amplitude(shots, trip, lag_s=(place - rise.peak) * shots.sigma_s)
    width = None
    if shots.sensor.tdc.both_edges:
        leaving = _trailing(shots, rise, trip, place, shots.threshold)
        end, _ = _end(shots, rise, trip, leaving, rise.peak, wanted)
        width = shots.ops.where(wanted, (end - place) * shots.sigma_s, 0.0)
    reported_s = comparator.reported_s(
        shots, shots.time_s(place), measured=amplitude, width_s=width,
        true_power_w=shots.ops.where(wanted, rise.top[0], 1.0), draw=rise.number,
    )  # fmt: skip
    if width is None:
        width = shots.ops.full(place, 0.0)
    return Reading(reported_s=reported_s, amplitude=amplitude, width_s=width)


def _by_levels(
    shots: Received, sampler: MultiLevel, rise: Rise, trip: Trip, place: Lanes, wanted: Mask
) -> Reading:
    """Amplitude from the width at the highest level that tripped, walk from the width at the threshold.

    One deviate for the whole leading edge, as for its foot, and one for the trailing edge, with what is left of the
    first after the time between them.
    """
    ops, point, fwhm = shots.ops, shots.point, shots.sensor.laser.pulse_fwhm_s
    lowest, *higher = (
        _Level.of(shots, rise, trip, place, factor * shots.threshold, wanted) for factor in sampler.levels
    )
    highest, above = lowest, ops.full(wanted, False)
    for one in higher:
        highest, above = highest.or_if_reached(one), above | one.reached
    start = crossing(
        shots.wave.at, ops.where(above, point.power_w(highest.up), 1.0),
        far=rise.valley, peak=rise.peak, top=rise.top, wanted=above,
    )  # fmt: skip
    # The waveform is not below a lower level before it is below a higher one.
    end, near = _end(shots, rise, trip, highest.down, rise.peak, above)
    since = ops.where(above, near, rise.peak)
    width = ops.where(
        lowest.reached, _end(shots, rise, trip, lowest.down, since, lowest.reached)[0] - place, 0.0
    )
    power = point.power_of_width_w(
        ops.where(above, end - start, width) * shots.sigma_s, threshold=highest.level, pulse_fwhm_s=fwhm
    )
    amplitude: Lanes = ops.where(
        highest.reached, point.signal(ops.where(highest.reached, power, 0.0)), shots.threshold
    )
    walk: Lanes = -0.5 * width
    if shots.sensor.tdc.walk != "corrected":
        true_power = ops.where(wanted, rise.top[0], 1.0)
        walk_s = comparator.walk_s(shots, measured=amplitude, width_s=None, true_power_w=true_power)
        walk = walk_s / shots.sigma_s
    elif point.recovery_s is not None:  # not even: the table of widths says how early it was
        power = point.power_of_width_w(width * shots.sigma_s, threshold=shots.threshold, pulse_fwhm_s=fwhm)
        share = point.power_w(shots.threshold) / power
        walk = pulse_shape.leading_edge_time_s(level=share, fwhm_s=fwhm) / shots.sigma_s
    return Reading(
        reported_s=comparator.converted(shots, shots.time_s(place - walk), draw=rise.number),
        amplitude=ops.maximum(amplitude, shots.threshold),
        width_s=width * shots.sigma_s,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Level:
    """One of several thresholds: signals at which the edges of a pulse pass it, and whether they do."""

    level: Lanes
    up: Lanes
    down: Lanes
    reached: Mask

    @classmethod
    def of(cls, shots: Received, rise: Rise, trip: Trip, place: Lanes, level: Lanes, wanted: Mask) -> _Level:
        """For a pulse that crossed the lowest one at ``place``."""
        point = shots.point
        up = tdc.crossing_level(
            threshold=level, deviate=trip.deviate,
            noise=point.noise, kappa_1=point.kappa_1, kappa_2=point.kappa_2,
        )  # fmt: skip
        down = _trailing(shots, rise, trip, place, level)
        reached = wanted & (up < trip.signal) & (down < trip.signal)
        if point.saturation is not None:
            reached = reached & (level < point.saturation)
        return cls(level=level, up=up, down=down, reached=reached)

    def or_if_reached(self, other: _Level) -> _Level:
        """The other level where that is reached."""
        ops = xp(self.up)
        return _Level(
            level=ops.where(other.reached, other.level, self.level),
            up=ops.where(other.reached, other.up, self.up),
            down=ops.where(other.reached, other.down, self.down),
            reached=self.reached | other.reached,
        )


def _trailing(shots: Received, rise: Rise, trip: Trip, place: Lanes, threshold: Lanes) -> Lanes:
    """Signal at which a pulse that crossed at ``place`` leaves a level behind its peak."""
    return comparator.trailing_level(
        shots, trip, threshold=threshold, lag_s=2.0 * (rise.peak - place) * shots.sigma_s, draw=rise.number
    )


def _end(
    shots: Received, rise: Rise, trip: Trip, level: Lanes, since: Lanes, wanted: Mask
) -> tuple[Lanes, Lanes]:
    """Place at which what the amplifier makes of a pulse has fallen to a signal level; the peak if it is below that.

    Returns a second place as `_falling` does, before the amplifier.
    """
    ops, point = shots.ops, shots.point
    below = wanted & (level < trip.signal)
    end, near = _falling(shots, ops.where(below, point.power_w(level), 1.0), rise, since, below)
    if point.saturation is not None and point.recovery_s is not None:
        clipped = below & (trip.signal > point.saturation)
        clipped_w = ops.where(clipped, point.power_w(point.saturation), 1.0)
        released, _ = _falling(shots, clipped_w, rise, rise.peak, clipped)
        end = saturation.held_until(
            fall_s=end, released_s=released, level=level, signal=trip.signal, saturation=point.saturation,
            recovery_s=point.recovery_s / shots.sigma_s,
        )  # fmt: skip
    return ops.where(below, end, rise.peak), near


def _falling(shots: Received, level_w: Lanes, rise: Rise, since: Lanes, wanted: Mask) -> tuple[Lanes, Lanes]:
    """Place behind a peak at which the waveform has fallen to a level; over further peaks that follow above it.

    since  where it is still above the level: the peak, or a place behind that

    Returns a second place, at most a step before the first, where it still is.
    """
    ops = shots.ops

    def step(fall: _Fall) -> _Fall:
        place = fall.place + STEP
        return _Fall(place=place, above=shots.wave.at(place)[0] > level_w, steps=fall.steps + 1)

    start = _Fall(
        place=since + ops.full(since, 0.0), above=wanted & (since == since), steps=ops.full(rise.number, 0)
    )
    far = ops.loop(start, lambda fall: fall.above & (fall.steps < _LONGEST), step).place
    near = far - STEP
    end = crossing(
        shots.wave.at, level_w, far=far, near=near, peak=rise.peak, top=rise.top, wanted=wanted
    )  # fmt: skip
    return end, near


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fall:
    """A way down behind a peak: the place, whether the waveform is still above the level there, steps so far."""

    place: Lanes
    above: Mask
    steps: Lanes


def _by_samples(shots: Received, adc: Adc, rise: Rise, place: Lanes, wanted: Mask) -> Reading:
    """Centroid of the samples that stay above the threshold; from there the best place of a matched filter."""
    ops = shots.ops
    window = _Window.around(shots, adc, rise, place)
    samples = window.read(wanted)
    sums = window.centroid(samples, wanted)
    any_over = sums.over > 0
    at: Lanes = ops.where(any_over, sums.moment / ops.where(any_over, sums.total, 1.0), place)
    amplitude: Lanes = sums.highest
    if adc.estimator == "matched_filter":
        for _ in range(2):  # the centroid is near: the first step comes to its square, the second to rounding
            at, amplitude = window.matched(samples, at, wanted)
    return Reading(
        reported_s=comparator.converted(shots, shots.time_s(at), draw=rise.number),
        amplitude=ops.maximum(amplitude, shots.threshold),
        width_s=sums.over / adc.rate_hz,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Window:
    """The samples around a crossing.

    rise      what was crossed
    crossing  place where the threshold was crossed
    start     place of the first sample, spacing between two, both in sigma_p
    """

    shots: Received
    adc: Adc
    rise: Rise
    crossing: Lanes
    start: Lanes
    spacing: Lanes

    @classmethod
    def around(cls, shots: Received, adc: Adc, rise: Rise, place: Lanes) -> _Window:
        """From one pulse width before a crossing on, on the clock's ticks."""
        spacing = 1.0 / (adc.rate_hz * shots.sigma_s)
        tick = (shots.time_s(place) - shots.sensor.laser.pulse_fwhm_s) * adc.rate_hz
        late = shots.ops.floor(tick) + 1.0 - tick
        return cls(
            shots=shots, adc=adc, rise=rise, crossing=place, spacing=spacing,
            start=place - SIGMAS_PER_FWHM + late * spacing,
        )  # fmt: skip

    def place(self, number: Lanes) -> Lanes:
        """Where a sample is."""
        return self.start + self.shots.ops.float32(number) * self.spacing

    def read(self, wanted: Mask) -> Array:
        """All samples, in order of time."""
        shots, adc, ops = self.shots, self.adc, self.shots.ops
        kept = tdc.noise_correlation(lag_s=1.0 / adc.rate_hz, bandwidth_hz=shots.sensor.tdc.bandwidth_hz)
        fresh = ops.sqrt(1.0 - kept * kept)
        before = self.rise.number * ops.uint32(adc.samples)

        comb = shots.wave.evenly(
            self.start, self.spacing, self.start + 0.5 * (adc.samples - 1) * self.spacing
        )

        def step(number: Lanes, so_far: _Sampled) -> _Sampled:
            own = random.normal_pair(shots.words(Stage.SAMPLES, before + ops.uint32(number)))[0]
            deviate = ops.where(number == 0, own, kept * so_far.deviate + fresh * own)
            signal = shots.point.signal(comb.power_w(self.place(number), so_far.parts))
            sample = sampling.quantised(
                signal=shots.point.measured(signal + deviate * shots.noise_at(signal)),
                step=adc.step,
                full_scale=adc.full_scale,
            )
            samples = ops.put(so_far.samples, number, sample)
            return _Sampled(deviate=deviate, samples=samples, parts=comb.following(so_far.parts))

        nothing = ops.full(self.start, 0.0)
        start = _Sampled(deviate=nothing, samples=ops.room(self.start, adc.room), parts=tuple(comb.parts))
        return self._for_each(step, start, wanted).samples

    def _for_each(self, step: Callable[[Lanes, S], S], state: S, wanted: Mask) -> S:
        """``step(number, state)`` over all samples in order of time."""
        samples = self.adc.samples

        def active(now: tuple[Lanes, S]) -> Mask:
            return wanted & (now[0] < samples)

        def stepped(now: tuple[Lanes, S]) -> tuple[Lanes, S]:
            number, so_far = now
            return number + 1, step(number, so_far)

        start: tuple[Lanes, S] = self.shots.ops.full(self.rise.number, 0), state
        return self.shots.ops.loop(start, active, stepped)[1]

    def centroid(self, samples: Array, wanted: Mask) -> _Centroid:
        """Of the first samples above the threshold.

        They end where one falls below half of it, but not within sigma_p of the crossing: noise at the threshold
        does not cut a pulse in two.
        """
        ops, threshold = self.shots.ops, self.shots.threshold
        nothing, count = ops.full(self.start, 0.0), ops.full(self.rise.number, 0)

        def step(number: Lanes, so_far: _Centroid) -> _Centroid:
            place, sample = self.place(number), ops.get(samples, number)
            above = (sample >= threshold) & ~so_far.closed
            part = ops.where(above, sample, 0.0)
            return _Centroid(
                total=so_far.total + part,
                moment=so_far.moment + part * place,
                over=so_far.over + ops.where(above, 1, 0),
                highest=ops.maximum(so_far.highest, part),
                closed=so_far.closed | ((sample < 0.5 * threshold) & (place > self.crossing + 1.0)),
            )

        empty = _Centroid(
            total=nothing, moment=nothing, over=count, highest=nothing, closed=ops.full(self.start, False)
        )
        return self._for_each(step, empty, wanted)

    def matched(self, samples: Array, at: Lanes, wanted: Mask) -> tuple[Lanes, Lanes]:
        """One step of Newton's method towards the highest correlation with the pulse, and the height there."""
        ops = self.shots.ops
        nothing = ops.full(self.start, 0.0)

        def step(number: Lanes, so_far: _Correlation) -> _Correlation:
            ahead = self.place(number) - at
            pulse = ops.exp(-0.5 * ahead * ahead)
            part = ops.get(samples, number) * pulse
            return _Correlation(
                slope=so_far.slope + part * ahead,
                bend=so_far.bend + part * (1.0 - ahead * ahead),
                height=so_far.height + part,
                power=so_far.power + pulse * pulse,
            )

        empty = _Correlation(slope=nothing, bend=nothing, height=nothing, power=nothing)
        found = self._for_each(step, empty, wanted)
        curved = found.bend > 0.1 * ops.abs(found.height)
        newton = ops.where(curved, found.slope / ops.where(curved, found.bend, 1.0), 0.0)
        amplitude = found.height / ops.where(found.power > 0.0, found.power, 1.0)
        return at + ops.maximum(ops.minimum(newton, 0.5), -0.5), amplitude


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sampled:
    """Samples so far.

    deviate  of the noise of the last one
    samples  room for all
    parts    of the waveform's pulses at the next one (`light.waveform.Comb`)
    """

    deviate: Lanes
    samples: Array
    parts: tuple[Lanes, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Centroid:
    """Sums over the first samples above the threshold: of the samples, of these times their places, their number.

    highest  of them
    closed   whether they have ended
    """

    total: Array
    moment: Array
    over: Array
    highest: Array
    closed: Mask


@dataclass(frozen=True, slots=True, kw_only=True)
class _Correlation:
    """Of the samples with a pulse, and its first two derivatives by the pulse's place.

    power  of the pulse itself
    """

    slope: Array
    bend: Array
    height: Array
    power: Array
