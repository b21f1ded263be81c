"""Stray light of other channels: what a detector sees of the echoes of pulses that left at the same instant.

Every other echo of the volley arrives with its share (`sensor.volleys`). One sub-echo stands for all of them: at the
time of the strongest, and as high as all of them are together at that time, theory (T123).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..maths.arrays import Array, Lanes, Mask, Ops, xp
from ..physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ..physics.optics import radiometry
from ..sensor.sensor_model import Sensor
from ..sensor.volleys import Volleys, find_volleys
from .echoes import Echoes, EchoTrain, SubEchoes

NEGLIGIBLE = 0.1
"""Choice: share of the least power that a detector finds in the dark: a scan line with less stray light than that has
none."""

FAINT = 0.1
"""Accuracy bought: share of the power from which on an echo gives its scan line stray light. Echoes of less than this
share add nothing: all of them together give a channel less than a hundredth of the least power that it finds in the
dark."""

UNSEEN = 1e-6
"""Accuracy bought: share of the power below which stray light is none: in single precision its shape could not be
computed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Crosstalk:
    """Volleys of a scanner and what its receivers notice of them.

    Attributes:
        least_w: power of an echo from which on its scan line has stray light, or glares
        faint_w: power of an echo up to which it adds nothing to the stray light of others
        unseen_w: power of stray light up to which a detector has none
        unit_m: c sigma_p / 2: range in which light comes back one standard deviation of the pulse later
        glare_w: power of an echo from which on other channels withhold returns at its range; None: they report them
    """

    volleys: Volleys
    least_w: Lanes
    faint_w: Lanes
    unseen_w: Lanes
    unit_m: Lanes
    glare_w: Lanes | None = None

    @classmethod
    def from_sensor(cls, sensor: Sensor) -> Crosstalk | None:
        """Build for a sensor; None if its channels do not see each other's light."""
        if sensor.optics.stray is None:
            return None
        point = sensor.working_point(np.zeros(1))
        threshold_w = np.ravel(point.response.power_w(sensor.threshold(point)))[0]
        sigma_s = sensor.received_fwhm_s / SIGMAS_PER_FWHM
        volleys = find_volleys(sensor.scanner, sensor.optics.stray)
        # No channel then has more than NEGLIGIBLE of it, even if all others are as bright as the brightest.
        least_w = NEGLIGIBLE * float(threshold_w) / max(volleys.largest_sum, 1e-30)
        faint_w, glare_w = FAINT * least_w, None
        if sensor.optics.stray.glare_photons is not None:
            glare_photons = float(sensor.optics.stray.glare_photons)
            glare_w = float(np.ravel(point.response.power_w(glare_photons * np.ones(1)))[0])
            # More than all SPADs can count has no power.
            if float(np.ravel(point.response.signal(np.full(1, glare_w)))[0]) < 0.99 * glare_photons:
                glare_w = math.inf
            least_w = min(least_w, glare_w)
        return cls(
            volleys=volleys,
            least_w=least_w,
            faint_w=faint_w,
            unseen_w=UNSEEN * float(threshold_w),
            unit_m=radiometry.range_from_time_of_flight_m(time_of_flight_s=sigma_s),
            glare_w=glare_w,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelLight:
    """Light of each channel's own echoes at the time of the strongest, in order of time; each (n,).

    Attributes:
        range_m: range of the strongest
        power_w: power of all of them there
    """

    range_m: Lanes
    power_w: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Volley:
    """The volley of each pulse of whole scan lines in order of time; each field (n,).

    Attributes:
        volleys: of the scanner
        lane: lane of the pulse
        first: lane of the volley's first pulse
        in_line: number of pulses of the line from that one on
        row: first entry of the pulse in the table of shares
    """

    volleys: Volleys
    lane: Array
    first: Array
    in_line: Array
    row: Array

    @classmethod
    def of_pulses(cls, volleys: Volleys, light: ChannelLight, pulse: Array) -> Volley:
        """Find the volleys of these pulses, (n,) uint32, with this light."""
        ops = xp(pulse, light.power_w)
        place, lane = ops.divmod(ops.int32(pulse), volleys.line)[1], ops.index(light.power_w)
        begin = ops.int32(ops.take(volleys.first, place))
        return cls(
            volleys=volleys,
            lane=lane,
            first=lane - place + begin,
            in_line=volleys.line - begin,
            row=place * volleys.size,
        )

    def source(self, number: Lanes) -> Array:
        """Lane of a pulse of the volley, by its number in it; beyond the end of the line that of the pulse itself."""
        return xp(number).where(number < self.in_line, self.first + number, self.lane)

    def share(self, number: Lanes) -> Array:
        """Share of that pulse's light that reaches this one; 0 of itself, and beyond the end of the volley."""
        return xp(number).take(self.volleys.share, self.row + number)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Brightest:
    """Search for the brightest source of stray light; each field (n,).

    Attributes:
        number: next pulse of the volley
        range_m: its range so far, 0 without one
        power_w: its power on this detector
    """

    number: Lanes
    range_m: Lanes
    power_w: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class _Total:
    """Sum over the sources; each field (n,).

    Attributes:
        number: next pulse of the volley
        power_w: sum so far
    """

    number: Lanes
    power_w: Lanes


def reaches_others(paths: Sequence[Echoes], crosstalk: Crosstalk) -> Mask:
    """(n,) bool, whether enough of a ray's echo reaches other channels to matter there.

    A ray counts as if it had all of its pulse's power.
    """
    reaches = paths[0].peak_power_w >= crosstalk.least_w
    for path in paths[1:]:
        reaches = reaches | (path.peak_power_w >= crosstalk.least_w)
    return reaches


def channel_light(train: EchoTrain, crosstalk: Crosstalk) -> ChannelLight:
    """Reduce the echoes of surfaces of each pulse to one; the light of the air does not count."""
    ops = xp(train.parts[0].range_m)
    ranges, powers = (
        [ops.column(getattr(part, name), number, part.count) for part in train.parts for number in range(part.count)][
            : train.surfaces
        ]
        for name in ("range_m", "peak_power_w")
    )
    range_m, power_w = _combine(ops, ranges, powers, crosstalk.unit_m)
    return ChannelLight(range_m=range_m, power_w=power_w)


def _combine(ops: Ops, ranges: Sequence[Lanes], powers: Sequence[Lanes], unit_m: Lanes) -> tuple[Lanes, Lanes]:
    """Range of the strongest of some echoes, and their power together at its time, (n,) each."""
    if len(ranges) == 1:
        return ranges[0], powers[0]
    highest, place = powers[0], ranges[0]
    for range_m, power_w in zip(ranges[1:], powers[1:], strict=True):
        brighter = power_w > highest
        highest, place = ops.where(brighter, power_w, highest), ops.where(brighter, range_m, place)
    total: Lanes = 0.0
    for range_m, power_w in zip(ranges, powers, strict=True):
        apart = (range_m - place) / unit_m
        total = total + ops.where(power_w > 0.0, power_w * ops.exp(-0.5 * apart * apart), 0.0)
    return place, total


def add_stray_light(train: EchoTrain, light: ChannelLight, crosstalk: Crosstalk, *, pulse: Array) -> EchoTrain:
    """Add the stray light of each pulse's volley to its train, as the last sub-echo.

    Args:
        light: computed before
        pulse: (n,) uint32 pulse numbers of whole scan lines in order of time
    """
    volley, light_w = Volley.of_pulses(crosstalk.volleys, light, pulse), light.power_w
    ops, size = xp(pulse, light_w), crosstalk.volleys.size
    zero, start = ops.full(light_w, 0.0), ops.full(light_w, 0)

    def brighter(state: _Brightest) -> _Brightest:
        source = volley.source(state.number)
        source_w = ops.take(light_w, source)

        def compare() -> tuple[Lanes, Lanes]:
            power_w = volley.share(state.number) * source_w
            higher = power_w > state.power_w
            range_m = ops.where(higher, ops.take(light.range_m, source), state.range_m)
            return range_m, ops.where(higher, power_w, state.power_w)

        # All lanes of a packet have the same source, and most sources are faint.
        range_m, power_w = ops.where_any(source_w > crosstalk.faint_w, compare, (state.range_m, state.power_w))
        return _Brightest(number=state.number + 1, range_m=range_m, power_w=power_w)

    brightest = ops.loop(
        _Brightest(number=start, range_m=zero, power_w=zero), lambda state: state.number < size, brighter
    )

    def added(state: _Total) -> _Total:
        source = volley.source(state.number)
        source_w = ops.take(light_w, source)

        def add() -> Lanes:
            apart = (ops.take(light.range_m, source) - brightest.range_m) / crosstalk.unit_m
            power_w: Lanes = volley.share(state.number) * source_w * ops.exp(-0.5 * apart * apart)
            return state.power_w + power_w

        power_w = ops.where_any(source_w > crosstalk.faint_w, add, state.power_w)
        return _Total(number=state.number + 1, power_w=power_w)

    lit = brightest.power_w > crosstalk.unseen_w
    total = ops.loop(_Total(number=start, power_w=zero), lambda state: (state.number < size) & lit, added)
    part = SubEchoes(range_m=brightest.range_m, peak_power_w=total.power_w, count=1)
    return replace(train, parts=(*train.parts, part), stray=True)
