"""Samplers: time, amplitude and width of a pulse that tripped the comparator, as the sensor measures them.

Sensors measure a pulse in three ways (X. Guo's section 2.2.3): with the TDC alone, with comparators at several levels,
or with an ADC. Which pulses there are is decided before, by edges or by peaks; the sampler only measures them
(docs/theory_receivers.md 24 and 29).

Symbols: U threshold, w time over a threshold, sigma_p width of the laser pulse and unit of all places, P power,
s_i sample i, g Gaussian pulse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from ..maths import random
from ..maths.arrays import Array, Lanes, Mask, S, chosen, xp
from ..maths.random import Stage
from ..physics.electronics import sampling, tdc
from ..physics.electronics.pulse_sums import SIGMAS_PER_FWHM, crossing
from ..physics.optics import pulse as pulse_shape
from ..sensor.electronics import Adc, MultiLevel
from . import comparator
from .comparator import Trip
from .pulses import edges, timing
from .rises import Rise
from .shots import Received

_SLOW = 2.0 * SIGMAS_PER_FWHM
"""Farther than this before its peak, in sigma_p, only slow light is over the threshold: a pulse would have to be 65,000
thresholds high."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """What the sampler measures of a pulse; each field (n,).

    reported_s  time that the converter reports
    amplitude   peak, in signal units
    width_s     time over the threshold; 0 from a TDC that times rising edges only
    place       that of what was timed on the waveform
    """

    reported_s: Lanes
    place: Lanes
    amplitude: Lanes
    width_s: Lanes


def read(shots: Received, rise: Rise, trip: Trip, place: Lanes, *, wanted: Mask) -> Reading:
    """Measure a pulse with the sensor's sampler.

    place   (n,) place at which the pulse crosses the threshold
    wanted  (n,) bool, lanes to measure; results of other lanes are undefined
    """
    sampler = shots.sensor.sampler
    if isinstance(sampler, MultiLevel):
        return _by_levels(shots, sampler, rise, trip, place, wanted)
    if isinstance(sampler, Adc):
        return _by_samples(shots, sampler, rise, trip, place, wanted)
    amplitude = timing.amplitude(shots, trip, lag_s=(place - rise.peak) * shots.sigma_s)
    width = None
    if shots.sensor.tdc.both_edges:
        leaving = edges.trailing_level(shots, rise, trip, place, shots.threshold)
        end, _ = edges.fall(shots, rise, trip, leaving, rise.peak, wanted)
        width = shots.ops.where(wanted, (end - place) * shots.sigma_s, 0.0)
    reported_s, timed = timing.of_rise(
        shots, rise, trip, place=place, measured=amplitude, width_s=width, wanted=wanted
    )
    if width is None:
        width = shots.ops.full(place, 0.0)
    return Reading(reported_s=reported_s, amplitude=amplitude, width_s=width, place=timed)


def _by_levels(
    shots: Received, sampler: MultiLevel, rise: Rise, trip: Trip, place: Lanes, wanted: Mask
) -> Reading:
    """Reading of comparators at several levels.

    The width at the highest level that tripped gives the amplitude, theory (T54). The width at the threshold gives the
    walk: the middle of both crossings is the peak of a symmetric pulse, whatever its height.

    Where other light holds a level high before the pulse or behind it, that level says nothing of the pulse: the lowest
    one that both edges pass takes its place. Without any, the pulse is read as the TDC alone reads it.
    """
    # One deviate stands for the whole leading edge, at all levels; another for the trailing edge, correlated with the
    # first (T26a). So the levels cannot contradict each other.
    ops, point, fwhm = shots.ops, shots.point, shots.sensor.received_fwhm_s
    own_level, foot = shots.threshold + trip.base, edges.foot(shots, rise, trip, wanted)
    first, *higher = (
        _Level.of(shots, rise, trip, place, factor * shots.threshold, wanted).between(own_level, foot)
        for factor in sampler.levels
    )
    lowest, highest, above, raised = first, first, ops.full(wanted, False), ops.full(wanted, False)
    for one in higher:
        later = one.reached & ~lowest.reached
        raised = raised | (later & (one.level > own_level * (1.0 + 1e-6)))
        lowest, highest = chosen(later, one, lowest), highest.or_if_reached(one)
        above = above | (one.reached & ~later)
    # Only two levels are searched in the waveform: the lowest for the time, the highest reached for the amplitude.
    crossed = place
    place = ops.where(
        raised,
        crossing(
            shots.wave.at, ops.where(raised, point.power_w(lowest.up), 1.0),
            far=rise.valley, peak=rise.peak, top=rise.top, wanted=raised,
        ),
        place,
    )  # fmt: skip
    start = crossing(
        shots.wave.at, ops.where(above, point.power_w(highest.up), 1.0),
        far=rise.valley, peak=rise.peak, top=rise.top, wanted=above,
    )  # fmt: skip
    # The waveform falls below a higher level before it falls below a lower one, so the lower search starts from there.
    end, near = edges.fall(shots, rise, trip, highest.down, rise.peak, above)
    since = ops.where(above, near, rise.peak)
    width = ops.where(
        lowest.reached, edges.fall(shots, rise, trip, lowest.down, since, lowest.reached)[0] - place, 0.0
    )
    power = point.power_of_width_w(
        ops.where(above, end - start, width) * shots.sigma_s, threshold=highest.level, pulse_fwhm_s=fwhm
    )
    amplitude: Lanes = ops.where(
        highest.reached, point.signal(ops.where(highest.reached, power, 0.0)), shots.threshold
    )
    if shots.wave.volume is not None:
        # The air's light lasts longer than any pulse, and a width says too much of it. It did not reach the next level;
        # above the highest one another is assumed, as far from it as that is from the one before.
        levels = sampler.levels
        following = (*levels[1:], levels[-1] * levels[-1] / levels[-2])
        for factor, after in zip(levels, following, strict=True):
            here = highest.level == factor * shots.threshold
            amplitude = ops.where(here, ops.minimum(amplitude, after * shots.threshold), amplitude)
    open_ = ~highest.reached & (foot >= own_level)
    edge_alone = comparator.amplitude(shots, trip, lag_s=(place - rise.peak) * shots.sigma_s)
    amplitude = ops.where(open_, edge_alone, amplitude)
    # The crossing precedes the middle of both crossings by half the width: that is the walk. ``tdc.walk`` = "none"
    # takes the walk of the leading edge at the true power instead, and "raw" takes none.
    walk: Lanes = -0.5 * width
    if shots.sensor.tdc.walk != "corrected":
        true_power = ops.where(wanted, rise.top[0], 1.0)
        walk_s = comparator.walk_s(shots, measured=amplitude, width_s=None, true_power_w=true_power)
        walk = walk_s / shots.sigma_s
    elif point.recovery_s is not None:
        # An amplifier that drains slowly lengthens the falling edge, and the pulse is not symmetric. Then the width
        # gives the power (T45), and the power how long before its peak the pulse crossed.
        power = point.power_of_width_w(width * shots.sigma_s, threshold=shots.threshold, pulse_fwhm_s=fwhm)
        share = point.power_w(shots.threshold) / power
        walk = pulse_shape.leading_edge_time_s(level=share, fwhm_s=fwhm) / shots.sigma_s
    if shots.sensor.tdc.walk == "corrected":
        of_edge = comparator.walk_s(
            shots, measured=ops.where(open_, amplitude - trip.base, shots.threshold), width_s=None,
            true_power_w=1.0,
        )  # fmt: skip
        walk = ops.where(open_, of_edge / shots.sigma_s, walk)
    return Reading(
        reported_s=comparator.converted(shots, shots.time_s(place - walk), draw=rise.number),
        amplitude=ops.maximum(amplitude, shots.threshold),
        width_s=width * shots.sigma_s,
        place=ops.where(open_, crossed, place - walk),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Level:
    """One of several thresholds, and where the edges of a pulse pass it; each field (n,).

    level    the threshold, in signal units
    up       noiseless signal at which the leading edge passes it, theory (T25)
    down     noiseless signal at which the trailing edge passes it
    reached  whether both edges pass it
    """

    level: Lanes
    up: Lanes
    down: Lanes
    reached: Mask

    @classmethod
    def of(cls, shots: Received, rise: Rise, trip: Trip, place: Lanes, level: Lanes, wanted: Mask) -> _Level:
        """A threshold for a pulse that crossed the lowest one at ``place``."""
        point = shots.point
        up = tdc.crossing_level(
            threshold=level, deviate=trip.deviate,
            noise=point.noise, kappa_1=point.kappa_1, kappa_2=point.kappa_2,
        )  # fmt: skip
        down = edges.trailing_level(shots, rise, trip, place, level)
        reached = wanted & (up < trip.signal) & (down < trip.signal)
        if point.saturation is not None:
            reached = reached & (level < point.saturation)
        return cls(level=level, up=up, down=down, reached=reached)

    def between(self, least: Lanes, foot: Lanes) -> _Level:
        """The level, reached only if it is at least this one and above the light behind the pulse."""
        reached = self.reached & (self.level >= least * (1.0 - 1e-6)) & (self.level > foot)
        return replace(self, reached=reached)

    def or_if_reached(self, other: _Level) -> _Level:
        """The other level where the pulse reaches it, else this one."""
        ops = xp(self.up)
        return _Level(
            level=ops.where(other.reached, other.level, self.level),
            up=ops.where(other.reached, other.up, self.up),
            down=ops.where(other.reached, other.down, self.down),
            reached=self.reached | other.reached,
        )


def _by_samples(shots: Received, adc: Adc, rise: Rise, trip: Trip, place: Lanes, wanted: Mask) -> Reading:
    """Reading of an ADC: the centroid of its samples, or the place where a matched filter answers most.

    The matched filter needs a start near its maximum; the centroid of the samples above the threshold is that.
    """
    ops = shots.ops
    # Of light that lasts samples have less than the filter makes of it.
    base = trip.base / sampling.LASTING_GAIN if shots.sensor.matches else trip.base
    # The window lies around the peak of light that rises slowly, far behind where it trips the comparator.
    window = _Window.around(shots, adc, rise, ops.maximum(place, rise.peak - _SLOW), base)
    samples = window.read(wanted)
    sums = window.centroid(samples, wanted)
    any_over = sums.over > 0
    # Weak pulses have no sample above the threshold, and are seen behind the filter only.
    at: Lanes = ops.where(
        any_over,
        sums.moment / ops.where(any_over, sums.total, 1.0),
        rise.peak if shots.sensor.matches else place,
    )
    amplitude: Lanes = sums.highest
    if adc.estimator == "matched_filter":
        # Newton's method squares the error in each step: from the centroid two steps are enough.
        for _ in range(2):
            at, amplitude = window.matched(samples, at, wanted)
    return Reading(
        reported_s=comparator.converted(shots, shots.time_s(at), draw=rise.number),
        amplitude=ops.maximum(amplitude, shots.threshold) + trip.base,
        width_s=sums.over / adc.rate_hz,
        place=at,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Window:
    """The ADC's samples around a crossing; each array (n,), places in sigma_p.

    shots     the pulses
    adc       the converter
    rise      the rise that crossed the threshold
    crossing  place of the crossing
    start     place of the first sample
    spacing   distance between two samples
    base      signal of the light on which the pulse stands: it is taken off the samples
    """

    shots: Received
    adc: Adc
    rise: Rise
    crossing: Lanes
    start: Lanes
    spacing: Lanes
    base: Lanes

    @classmethod
    def around(cls, shots: Received, adc: Adc, rise: Rise, place: Lanes, base: Lanes) -> _Window:
        """The window that begins one pulse width before a crossing, on the ticks of the ADC's clock."""
        spacing = 1.0 / (adc.rate_hz * shots.sigma_s)
        # The clock starts with the pulse, so an echo falls anywhere between two ticks. The first sample is the next
        # tick after the window's start.
        tick = (shots.time_s(place) - shots.sensor.received_fwhm_s) * adc.rate_hz
        late = shots.ops.floor(tick) + 1.0 - tick
        return cls(
            shots=shots, adc=adc, rise=rise, crossing=place, spacing=spacing,
            start=place - SIGMAS_PER_FWHM + late * spacing, base=base,
        )  # fmt: skip

    def place(self, number: Lanes) -> Lanes:
        """Place of a sample, (n,)."""
        return self.start + self.shots.ops.float32(number) * self.spacing

    def read(self, wanted: Mask) -> Array:
        """Local memory with all samples of each lane, in order of time; they have noise and are quantised."""
        shots, adc, ops = self.shots, self.adc, self.shots.ops
        kept = shots.sensor.noise_correlation(1.0 / adc.rate_hz)
        fresh = ops.sqrt(1.0 - kept * kept)
        # Each rise of a pulse has a block of draws of its own, one for each sample.
        before = self.rise.number * ops.uint32(adc.samples)
        # Samples are evenly spaced, so each sub-echo's part follows from the one before by a multiplication.
        comb = shots.wave.evenly(
            self.start, self.spacing, self.start + 0.5 * (adc.samples - 1) * self.spacing
        )

        def step(number: Lanes, so_far: _Sampled) -> _Sampled:
            own = random.normal_pair(shots.words(Stage.SAMPLES, before + ops.uint32(number)))[0]
            # Noise through a single pole is a first-order recursion: each deviate keeps the share r of the one before
            # (T26a), and sqrt(1 - r^2) of a fresh one keeps its variance at 1.
            deviate = ops.where(number == 0, own, kept * so_far.deviate + fresh * own)
            signal = shots.point.signal(comb.power_w(self.place(number), so_far.parts))
            sample = sampling.quantised(
                signal=shots.point.measured(signal + deviate * shots.noise_at(signal)),
                step=adc.step,
                full_scale=adc.full_scale,
            )
            samples = ops.put(so_far.samples, number, sample - self.base)
            return _Sampled(deviate=deviate, samples=samples, parts=comb.following(so_far.parts))

        nothing = ops.full(self.start, 0.0)
        start = _Sampled(deviate=nothing, samples=ops.room(self.start, adc.room), parts=tuple(comb.parts))
        return self._for_each(step, start, wanted).samples

    def _for_each(self, step: Callable[[Lanes, S], S], state: S, wanted: Mask) -> S:
        """Run ``step(number, state) -> state`` over all samples in order of time; returns the last state."""
        samples = self.adc.samples

        def active(now: tuple[Lanes, S]) -> Mask:
            return wanted & (now[0] < samples)

        def stepped(now: tuple[Lanes, S]) -> tuple[Lanes, S]:
            number, so_far = now
            return number + 1, step(number, so_far)

        start: tuple[Lanes, S] = self.shots.ops.full(self.rise.number, 0), state
        return self.shots.ops.loop(start, active, stepped)[1]

    def centroid(self, samples: Array, wanted: Mask) -> _Centroid:
        """Sums over the first run of samples above the threshold.

        The run ends at the first sample below half the threshold. Noise alone should not cut a pulse in two at its
        foot, so it cannot end within sigma_p of the crossing.
        """
        ops, threshold = self.shots.ops, self.shots.sample_threshold
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
        """One step of Newton's method towards the maximum of the correlation sum_i s_i g(t_i - t).

        at  (n,) place from which the step is taken

        Returns the next place and the height of the pulse that fits the samples best at ``at``.
        """
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
        # Near a maximum the second derivative is negative; ``bend`` is its negative. Where it is too small for a
        # sensible step, and beyond half a sigma_p, the step is not trusted.
        curved = found.bend > 0.1 * ops.abs(found.height)
        newton = ops.where(curved, found.slope / ops.where(curved, found.bend, 1.0), 0.0)
        # Least squares: the height a that minimises sum (s_i - a g_i)^2 is sum s_i g_i / sum g_i^2.
        amplitude = found.height / ops.where(found.power > 0.0, found.power, 1.0)
        return at + ops.maximum(ops.minimum(newton, 0.5), -0.5), amplitude


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sampled:
    """State of reading the samples.

    deviate  (n,) of the last sample's noise, N(0, 1)
    samples  local memory for all samples of each lane
    parts    (n,) each, every sub-echo's part at the next sample (`light.waveform.Comb`)
    """

    deviate: Lanes
    samples: Array
    parts: tuple[Lanes, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Centroid:
    """Sums over the first run of samples above the threshold; each field (n,).

    total    sum of the samples
    moment   sum of the samples times their places
    over     number of samples
    highest  highest sample
    closed   whether the run has ended
    """

    total: Array
    moment: Array
    over: Array
    highest: Array
    closed: Mask


@dataclass(frozen=True, slots=True, kw_only=True)
class _Correlation:
    """Correlation of the samples with a pulse at some place; each field (n,).

    slope   its derivative by the pulse's place
    bend    its second derivative, with the sign changed
    height  the correlation
    power   sum of the pulse's squares
    """

    slope: Array
    bend: Array
    height: Array
    power: Array
