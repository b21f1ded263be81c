"""Courses: how many SPADs are free when the drawn bins of an echo begin, and which come free within them.

Nearer echoes, the air and the sun have fired some of the SPADs before. What fires a dead time before comes free in the
bins, as sharply as the light that fired it came. So the SPADs are followed in steps of a bin, in courses some dead
times before the bins, side by side (docs/photon_counting.md, T100 and T109).

Symbols: lambda rate of detections of one free SPAD, sigma width of an echo in the histogram.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ...light.echoes import Volume
from ...light.waveform import Waveform
from ...maths.arrays import Array, Lanes, Mask, Ops, xp
from ...physics.photon_counting import dead_time, matched_filter
from ...sensor.detectors.macropixel import Macropixel
from .shadows import DEAD_TIMES, Shadow
from .tuning import FEW, LEAD, LEAST_CHANGE, NOTHING_BEFORE, PEAK_PLACES

_BACK = (4, 3, 2, 1, 0)
"""Dead times before the bins at which SPADs are followed, the earliest first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EarlierFirings:
    """SPADs that fired before the first bin; each (n,), or a room with an entry for each bin.

    Attributes:
        free: share that is free at the first bin
        released: share that comes free in each bin a dead time after it has fired; None: that of even light
        due: afterpulses in each bin for each free SPAD, above those of even light; None: there are none
        shaded: whether light came before the bins: else the rooms hold nothing
        value: mean of the filter's value then, in photons; None: not followed
        changed: whether the free share is another one than in even light
    """

    free: Lanes
    released: Array | None = None
    due: Array | None = None
    shaded: Mask = False
    value: Lanes | None = None
    changed: Mask = False


@dataclass(frozen=True, slots=True, kw_only=True)
class _Course:
    """Course of the free SPADs some dead times before the drawn bins, or within them; each field (n,).

    Attributes:
        free: share that is free when a step begins
        due: afterpulses a step that free ones are to have
        parts: light of each sub-echo in the step (`light.waveform.Comb`)
    """

    free: Lanes
    due: Lanes
    parts: tuple[Lanes, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Following:
    """State of following the courses; each field (n,), rooms of `EarlierFirings`.

    Attributes:
        number: number of the next step, from the first bin: negative before it
        courses: those of `_BACK`
        free: share that is free at the first bin
        values: counts behind the filter's template so far, at some places
    """

    number: Lanes
    courses: tuple[_Course, ...]
    free: Lanes
    values: tuple[Lanes, ...]
    released: Array
    due: Array | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stepped:
    """Courses after a step, before their light advances; each field (n,), rooms of `EarlierFirings`.

    Attributes:
        fired: share that the last of them fires in the step
    """

    courses: tuple[_Course, ...]
    fired: Lanes
    released: Array
    due: Array | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Courses:
    """Courses of the free SPADs of some pulses; fields as of `bins.Bins`."""

    pixel: Macropixel
    wave: Waveform

    @property
    def ops(self) -> Ops:
        """Array functions of the arrays' kind, NumPy's or Dr.Jit's."""
        return xp(self.wave.origin_m)

    @property
    def _followed(self) -> tuple[int, ...]:
        """Dead times before the bins at which SPADs are followed, the earliest first."""
        return (0,) if self.pixel.spad.fires_once else _BACK

    def earlier_firings(
        self, start: Lanes, time_s: Lanes, echo_s: Lanes, middle: Lanes, *, behind: bool
    ) -> EarlierFirings:
        """SPADs that background, nearer echoes and the air have fired before the first bin.

        Args:
            start: place of that bin
            time_s: time of flight of that bin
            echo_s: time of flight of the echo, for which the pixel is
            middle: place of the echo
            behind: whether there is light before these bins even where a pulse has one echo
        """
        pixel, wave = self.pixel, self.wave
        free = pixel.free
        if pixel.spad.fires_once:
            armed = pixel.armed_s + time_s - echo_s
            free = dead_time.free_share_of_first(rate_hz=pixel.rate_hz, time_s=armed)
        if len(wave.centres) == 1 and wave.volume is None and not behind:
            # The pulse's only echo is the one in these bins.
            return EarlierFirings(free=free)
        # Places count from the nearest echo.
        shaded: Mask = start > -NOTHING_BEFORE if behind else self._echoes_fire(start)
        if wave.volume is not None:
            shaded = shaded | self._air_fires(wave.volume, start)
        return self._follow(start, time_s, shaded, free, middle)

    def _echoes_fire(self, start: Lanes) -> Mask:
        """Whether echoes that begin before a place fire enough SPADs to be missed there, (n,)."""
        pixel, ops = self.pixel, self.ops
        power_w: Lanes = 0.0
        for centre, height in zip(self.wave.centres, self.wave.heights, strict=True):
            power_w = power_w + ops.where(centre - start < NOTHING_BEFORE, height, 0.0)
        return power_w * (pixel.per_watt * pixel.sigma_s * math.sqrt(2.0 * math.pi)) > FEW

    def _air_fires(self, air: Volume, start: Lanes) -> Mask:
        """Whether the air's light fires enough SPADs before a place to be missed there, (n,)."""
        pixel = self.pixel
        if pixel.spad.fires_once:
            return air.scale > 0.0  # none that has fired since the pulse left comes back
        # Older firings count in the light of the dead times before only.
        earliest_m = self.wave.range_m(start - (DEAD_TIMES + 1) * pixel.blind_sigmas)
        return air.highest_w(earliest_m) * pixel.per_watt * pixel.spad.dead_time_s > FEW

    def _follow(self, start: Lanes, time_s: Lanes, shaded: Mask, even: Lanes, middle: Lanes) -> EarlierFirings:
        """Follow the SPADs through the light before the bins, four dead times to none before (T100), (T109).

        What fires a dead time before comes free in the bins, as sharply as the light that fired it came. So the courses
        of some dead times are followed side by side, the earliest first: what fires in one comes free in the next.

        Args:
            even: free share in even light
            middle: place beside which the filter's highest value is expected
        """
        pixel, ops = self.pixel, self.ops
        spad = pixel.spad
        step, zero, count = pixel.histogram.bin_s / pixel.sigma_s, ops.full(start, 0.0), 2 * pixel.histogram.reach + 2
        # An echo that ends shortly before the bins is followed too.
        lead = 0 if spad.fires_once else math.ceil(LEAD / pixel.histogram.bin_to_sigma)
        steps, followed = lead + count - 1, self._followed
        begin = start - lead * step
        combs = [
            self.wave.comb(
                begin - back * pixel.blind_sigmas,
                step,
                begin + 0.5 * steps * step - back * pixel.blind_sigmas,
                half=0.5 * steps * pixel.histogram.bin_to_sigma,
                recurrent=True,
            )
            for back in followed
        ]
        courses = tuple(
            _Course(free=free, due=due, parts=tuple(comb.parts))
            for (free, due), comb in zip(self._first_shares(start, time_s, shaded, even, lead), combs, strict=True)
        )
        state = _Following(
            number=zero - lead,
            courses=courses,
            free=courses[-1].free,
            values=(zero,) * len(PEAK_PLACES),
            released=ops.room(start, count),
            due=None if spad.afterpulse is None else ops.room(start, count),
        )

        def follow_step(state: _Following) -> _Following:
            place = start + state.number * step
            lights = [
                comb.power_w(place - back * pixel.blind_sigmas, course.parts) * (pixel.per_watt * pixel.histogram.bin_s)
                for back, comb, course in zip(followed, combs, state.courses, strict=True)
            ]
            stepped = self._step_courses(state, lights)
            in_bins = state.number > -0.5
            counted = ops.where(in_bins, pixel.count_probability(stepped.fired) - pixel.count_share, 0.0)
            offsets = ((place - middle - beside) * (1.0 / matched_filter.TEMPLATE) for beside in PEAK_PLACES)
            return _Following(
                number=state.number + 1.0,
                courses=tuple(
                    replace(course, parts=comb.advance(course.parts))
                    for course, comb in zip(stepped.courses, combs, strict=True)
                ),
                free=ops.where(in_bins, state.free, stepped.courses[-1].free),
                values=tuple(
                    value + counted * ops.exp(-0.5 * offset * offset)
                    for value, offset in zip(state.values, offsets, strict=True)
                ),
                released=stepped.released,
                due=stepped.due,
            )

        final = ops.loop(state, lambda state: shaded & (state.number < count - 0.5), follow_step)
        return EarlierFirings(
            free=final.free,
            released=None if spad.fires_once else final.released,
            due=final.due,
            shaded=shaded,
            value=None if pixel.knows_free else self._highest_of(final.values),
            changed=shaded & (ops.abs(final.free - even) > LEAST_CHANGE * even),
        )

    def _first_shares(
        self, start: Lanes, time_s: Lanes, shaded: Mask, even: Lanes, lead: int
    ) -> list[tuple[Lanes, Lanes]]:
        """Free share, and afterpulses that are due in a step, (n,) each, where each course begins; as of `_follow`.

        Args:
            lead: number of steps before the first bin
        """
        pixel, ops = self.pixel, self.ops
        bin_s, early = pixel.histogram.bin_s, lead + 0.5
        step = bin_s / pixel.sigma_s
        zero: Lanes = ops.full(start, 0.0)

        def shares() -> tuple[Lanes, ...]:
            shadow = Shadow.before(pixel, self.wave, start - early * step, time_s - early * bin_s)
            free = [shadow.free(number) for number in self._followed]
            dues: list[Lanes] = [0.0] * len(free)
            if pixel.spad.afterpulse is not None:
                dues = [shadow.due_hz(pixel, number, of) for number, of in zip(self._followed, free, strict=True)]
            return tuple(zero + even * share for share in (*free, *dues))

        of_even = (1.0,) * len(self._followed) + (pixel.even_afterpulses_hz,) * len(self._followed)
        first = ops.where_any(shaded, shares, tuple(zero + even * share for share in of_even))
        free, due_hz = first[: len(self._followed)], first[len(self._followed) :]
        return [(share, hz * bin_s) for share, hz in zip(free, due_hz, strict=True)]

    def _step_courses(self, state: _Following, lights: list[Lanes]) -> _Stepped:
        """Follow the courses through a step.

        Args:
            lights: (n,) for each: detections of a free SPAD in the step, of light of its own
        """
        pixel, ops = self.pixel, self.ops
        spad, bin_s = pixel.spad, pixel.histogram.bin_s
        index = ops.int32(ops.maximum(state.number, 0.0))
        zero = ops.full(state.number, 0.0)
        room, due_room = state.released, state.due
        # Before the first course light is even, so as many come free as fire.
        even = 0.0 if spad.fires_once else pixel.free * pixel.rate_hz * bin_s
        released: Lanes = even
        caught: Lanes = zero
        if spad.afterpulse is not None and spad.afterpulse_s is not None:
            even_due = pixel.free * pixel.even_afterpulses_hz * bin_s
            caught = even_due * pixel.primary_hz * bin_s + even * (spad.afterpulse * bin_s / spad.afterpulse_s)
        courses: list[_Course] = []
        for course, light in zip(state.courses, lights, strict=True):
            in_bins = len(courses) == len(lights) - 1
            if in_bins:
                room = ops.put(room, index, zero + released)
            others = light + pixel.primary_hz * bin_s
            of_free, of_released = dead_time.firing_parts(detections=others)
            fired, due = course.free * of_free + released * of_released, course.due
            if due_room is not None and spad.afterpulse is not None and spad.afterpulse_s is not None:
                # As in `dead_time.firing_shares`: they fire, light fires their SPADs, or they go on.
                lost = others + bin_s / spad.afterpulse_s
                at_once, late = dead_time.firing_parts(detections=lost)
                # Afterpulses of the course before whose SPADs come free.
                returned = ops.exp(-spad.dead_time_s / spad.afterpulse_s) * caught
                afterpulses = (due * at_once + returned * late) / lost
                if in_bins:
                    of_each = afterpulses / ops.maximum(course.free + 0.5 * released, 1e-6)
                    due_room = ops.put(due_room, index, of_each - pixel.even_afterpulses_hz * bin_s)
                fired, due = fired + afterpulses, due + returned - afterpulses * lost
                caught = afterpulses * others + fired * (spad.afterpulse * bin_s / spad.afterpulse_s)
            courses.append(replace(course, free=course.free + released - fired, due=due))
            released = fired
        return _Stepped(courses=tuple(courses), fired=released, released=room, due=due_room)

    def _highest_of(self, values: tuple[Lanes, ...]) -> Lanes:
        """Highest of the parabola through the filter's values at `PEAK_PLACES`, (n,) in photons."""
        ops, (low, top, high) = self.ops, values
        bend = ops.minimum(low - 2.0 * top + high, -1e-6 * ops.abs(top) - 1e-20)
        offset = ops.minimum(ops.maximum(0.5 * (low - high) / bend, -1.0), 1.0)
        height = top - 0.5 * (low - high - bend * offset) * offset
        return height * (matched_filter.SCALE * self.pixel.trials)
