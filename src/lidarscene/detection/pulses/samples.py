"""Samples: an ADC's samples around a crossing, and the time and height estimated from them.

Symbols: sigma_p width of the laser pulse and unit of all places, s_i sample i, g Gaussian pulse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ...maths import random
from ...maths.arrays import Array, Lanes, Mask, S
from ...maths.random import Stage
from ...physics.electronics import sampling
from ...physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ...sensor.electronics import Adc
from ..rises import Rise
from ..shots import Received


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """The ADC's samples around a crossing; each array (n,), places in sigma_p.

    Attributes:
        shots: the pulses
        adc: the converter
        rise: the rise that crossed the threshold
        crossing: place of the crossing
        start: place of the first sample
        spacing: distance between two samples
        base: signal of the light on which the pulse stands: it is taken off the samples
    """

    shots: Received
    adc: Adc
    rise: Rise
    crossing: Lanes
    start: Lanes
    spacing: Lanes
    base: Lanes

    @classmethod
    def from_crossing(cls, shots: Received, adc: Adc, rise: Rise, place: Lanes, base: Lanes) -> Window:
        """Place the window from one pulse width before a crossing, on the ticks of the ADC's clock."""
        # A broadened pulse is read by as many samples, farther apart, and fitted by a pulse as broad.
        rate_hz = adc.rate_hz / shots.wave.broadening
        spacing = 1.0 / (rate_hz * shots.sigma_s)
        # The clock starts with the pulse, so an echo falls anywhere between two ticks. The first sample is the next
        # tick after the window's start.
        tick = (shots.time_s(place) - shots.wave.fwhm_s) * rate_hz
        late = shots.ops.floor(tick) + 1.0 - tick
        return cls(
            shots=shots,
            adc=adc,
            rise=rise,
            crossing=place,
            spacing=spacing,
            start=place - SIGMAS_PER_FWHM + late * spacing,
            base=base,
        )

    def place(self, number: Lanes) -> Lanes:
        """Place of a sample, (n,)."""
        return self.start + self.shots.ops.float32(number) * self.spacing

    def read(self, mask: Mask) -> tuple[Array, RunOfSamples]:
        """Draw all samples of each lane, in order of time, into local memory; they have noise and are quantised.

        Returns the sums over the first run of samples above the threshold too. It ends at the first sample below half
        the threshold. Noise alone should not cut a pulse in two at its foot, so it cannot end within sigma_p of the
        crossing.
        """
        shots, adc, ops, threshold = self.shots, self.adc, self.shots.ops, self.shots.sample_threshold
        correlation = shots.sensor.noise_correlation(1.0 / adc.rate_hz)
        fresh = ops.sqrt(1.0 - correlation * correlation)
        # Each rise of a pulse has a block of draws of its own, numbered by the samples.
        first_draw = self.rise.number * ops.uint32(adc.samples)
        # Samples are evenly spaced, so each sub-echo's part follows from the one before by a multiplication.
        comb = shots.wave.comb(self.start, self.spacing, self.start + 0.5 * (adc.samples - 1) * self.spacing)

        def add(run: RunOfSamples, index: Lanes, place: Lanes, sample: Lanes) -> RunOfSamples:
            # Samples come in pairs: there may be one more than the window has.
            above = (sample >= threshold) & ~run.closed & (index < adc.samples)
            part = ops.where(above, sample, 0.0)
            return RunOfSamples(
                total=run.total + part,
                moment=run.moment + part * place,
                count=run.count + ops.where(above, 1, 0),
                highest=ops.maximum(run.highest, part),
                closed=run.closed | ((sample < 0.5 * threshold) & (place > self.crossing + 1.0)),
            )

        def step(number: Lanes, state: _Sampled) -> _Sampled:
            # A random number gives two deviates, so samples come in pairs; there is room for one more than there are.
            deviates = random.normal_pair(shots.words(Stage.SAMPLES, first_draw + ops.uint32(number)))
            for index, fresh_deviate in zip((number, number + 1), deviates, strict=True):
                # Noise through a single pole is a first-order recursion: each deviate keeps the share r of the one
                # before (T26a), and sqrt(1 - r^2) of a fresh one keeps its variance at 1.
                deviate = ops.where(index == 0, fresh_deviate, correlation * state.deviate + fresh * fresh_deviate)
                place = self.place(index)
                signal = shots.point.response.signal(comb.power_w(place, state.parts))
                measured = shots.point.response.measured(signal + deviate * shots.noise_at(signal))
                sample = sampling.quantise(signal=measured, step=adc.step, full_scale=adc.full_scale) - self.base
                state = _Sampled(
                    deviate=deviate,
                    samples=ops.put(state.samples, index, sample),
                    parts=comb.advance(state.parts),
                    run=add(state.run, index, place, sample),
                )
            return state

        zero, count = ops.full(self.start, 0.0), ops.full(self.rise.number, 0)
        empty = RunOfSamples(total=zero, moment=zero, count=count, highest=zero, closed=ops.full(self.start, False))
        start = _Sampled(deviate=zero, samples=ops.room(self.start, adc.room), parts=tuple(comb.parts), run=empty)
        final = self._loop(step, start, mask, each=2)
        return final.samples, final.run

    def _loop(self, step: Callable[[Lanes, S], S], state: S, mask: Mask, *, each: int = 1) -> S:
        """Run ``step(number, state) -> state`` over all samples in order of time; returns the last state.

        Args:
            each: samples of a step
        """
        samples = self.adc.samples

        def active(loop_state: tuple[Lanes, S]) -> Mask:
            return mask & (loop_state[0] < samples)

        def next_sample(loop_state: tuple[Lanes, S]) -> tuple[Lanes, S]:
            number, so_far = loop_state
            return number + each, step(number, so_far)

        start: tuple[Lanes, S] = self.shots.ops.full(self.rise.number, 0), state
        return self.shots.ops.loop(start, active, next_sample)[1]

    def foot(self, samples: Array, level: Lanes, mask: Mask) -> tuple[Lanes, Lanes]:
        """Place and value of the last sample before the first at or above a level."""
        ops = self.shots.ops
        zero = ops.full(self.start, 0.0)

        def step(number: Lanes, state: _Foot) -> _Foot:
            sample = ops.get(samples, number)
            reached = state.reached | (sample >= level)
            return _Foot(
                place=ops.where(reached, state.place, self.place(number)),
                sample=ops.where(reached, state.sample, sample),
                reached=reached,
            )

        # Before the window there is nothing of the pulse.
        foot = self._loop(
            step, _Foot(place=self.start - self.spacing, sample=zero, reached=ops.full(zero, False)), mask
        )
        return foot.place, foot.sample

    def newton_step(self, samples: Array, centre: Lanes, mask: Mask) -> tuple[Lanes, Lanes]:
        """One step of Newton's method towards the maximum of the correlation sum_i s_i g(t_i - t).

        Args:
            centre: (n,) place from which the step is taken

        Returns:
            the next place and the height of the pulse that fits the samples best at ``centre``
        """
        ops, spacing = self.shots.ops, self.spacing
        zero, begin = ops.full(self.start, 0.0), self.start - centre
        # At even steps a Gaussian grows by factors that themselves grow by a constant one.
        second = ops.exp(-spacing * spacing)

        def step(number: Lanes, state: _Correlation) -> _Correlation:
            ahead, pulse = self.place(number) - centre, state.pulse
            part = ops.get(samples, number) * pulse
            return _Correlation(
                pulse=pulse * state.growth,
                growth=state.growth * second,
                slope=state.slope + part * ahead,
                bend=state.bend + part * (1.0 - ahead * ahead),
                height=state.height + part,
                power=state.power + pulse * pulse,
            )

        empty = _Correlation(
            pulse=ops.exp(-0.5 * begin * begin),
            growth=ops.exp(-spacing * (begin + 0.5 * spacing)),
            slope=zero,
            bend=zero,
            height=zero,
            power=zero,
        )
        correlation = self._loop(step, empty, mask)
        # Near a maximum the second derivative is negative; ``bend`` is its negative. Where it is too small for a
        # sensible step, and beyond half a sigma_p, the step is not trusted.
        curved = correlation.bend > 0.1 * ops.abs(correlation.height)
        newton = ops.where(curved, correlation.slope / ops.where(curved, correlation.bend, 1.0), 0.0)
        # Least squares: the height a that minimises sum (s_i - a g_i)^2 is sum s_i g_i / sum g_i^2.
        amplitude = correlation.height / ops.where(correlation.power > 0.0, correlation.power, 1.0)
        return centre + ops.maximum(ops.minimum(newton, 0.5), -0.5), amplitude


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sampled:
    """State of reading the samples.

    Attributes:
        deviate: (n,) deviate of the last sample's noise, N(0, 1)
        samples: local memory for all samples of each lane
        parts: (n,) each, every sub-echo's part at the next sample (`light.waveform.Comb`)
        run: first samples above the threshold so far
    """

    deviate: Lanes
    samples: Array
    parts: tuple[Lanes, ...]
    run: RunOfSamples


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOfSamples:
    """Sums over the first run of samples above the threshold; each field (n,).

    Attributes:
        total: sum of the samples
        moment: sum of the samples times their places
        count: number of samples
        highest: highest sample
        closed: whether the run has ended
    """

    total: Array
    moment: Array
    count: Array
    highest: Array
    closed: Mask


@dataclass(frozen=True, slots=True, kw_only=True)
class _Foot:
    """State of the walk up a leading edge; each field (n,).

    Attributes:
        place: place of the last sample below the level
        sample: its value
        reached: whether a sample has reached the level
    """

    place: Lanes
    sample: Lanes
    reached: Mask


@dataclass(frozen=True, slots=True, kw_only=True)
class _Correlation:
    """Correlation of the samples with a pulse at some place; each field (n,).

    Attributes:
        pulse: the pulse at the next sample
        growth: its factor from that sample to the one after
        slope: its derivative by the pulse's place
        bend: its second derivative, with the sign changed
        height: the correlation
        power: sum of the pulse's squares
    """

    pulse: Lanes
    growth: Lanes
    slope: Array
    bend: Array
    height: Array
    power: Array
