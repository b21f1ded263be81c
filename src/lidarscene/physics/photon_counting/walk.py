"""Walk of a SPAD's histogram: by how much the filter finds a strong echo too near, as a maker would calibrate it.

SPADs that fire on the leading edge are blind for the rest of the echo, so its counts crowd together and come early
(`pile_up`). A maker moves a target through all powers and writes down the shift over what the receiver measures. Here
the expected histogram takes the target's place, for the bins, dead time, sun and coincidence of one sensor
(`dead_time.firing_shares`), averaged over the echo's places in a bin.

What is measured is the height y of the filter's peak, for each trial that is free. Counts end when all SPADs fire in
every shot; the height goes on rising, because the counts crowd closer together. SPADs that count only together count
fewer, when all of them fire within a bin or two: then two powers have the same height, and the higher one is that
whose counts are the narrower.

Symbols: Lambda detections of an echo that one free SPAD would make without dead time, sigma width of the echo and unit
of all shifts, lambda rate of the background on a free SPAD, y height of the filter's peak over the free trials, q
narrowing, that height over the counts around the peak.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from ...maths.arrays import Lanes, LookupTable, Numbers, xp
from ...maths.units import STATIC
from . import dead_time
from .matched_filter import SCALE, TEMPLATE
from .pile_up import BOX, MOST, sun_coordinate, sun_nodes

_LEAST = 1e-3
"""Choice: smallest Lambda of a calibration; the largest is `pile_up.MOST`."""

_LIGHTS, _SUNS, _HEIGHTS, _PHASES = 96, 32, 96, 4
"""Powers and suns of a calibration, nodes of its tables over y, and places of the echo in a bin."""

_ROUND = 0.01
"""Accuracy bought: share of the highest y at which the axis of heights bends: near the highest, small steps are large
powers."""

_SEARCH = 1.25
"""Accuracy bought: half width of the search for a peak, in sigmas: less than a dead time."""

_REVIVED, _FINE = 6.0, 0.15
"""Accuracy bought: dead time below which SPADs fire twice in an echo, and the step of the course that finds the higher
hump, in sigmas."""

_JUMP, _BLUR, _NEARLY = 0.5, 2.2, 0.9
"""Choice: jump of the shift, in sigmas, from which on two humps are told apart; factor of Lambda to either side of it
within which noise and the place in a bin confuse them; share of the highest y from which on noise confuses echoes that
blind the pixel with those that do not."""

_FAR_BELOW = 0.9
"""Accuracy bought: share of the least y of blinding echoes below which an echo is none: noise reaches no farther."""

_DARK = 1e-30
"""Accuracy bought: counts that are none."""

_NEVER = 1e9
"""Choice: narrowing that no echo has."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Walk:
    """Calibration of one sensor: tables over lambda sigma, or over y and lambda sigma.

    Attributes:
        highest: largest y
        shift: shift of an echo, in sigmas, negative
        blinding: shift of an echo of the same y that is so strong that fewer SPADs count together; None: y tells them
            apart
        divide: q from which on an echo is such a one
        alike: Lambda between which noise may take an echo for another of nearly the same y, in the dark; None: nowhere
        residual: largest shift of such an echo after the correction, in sigmas
    """

    highest: LookupTable
    shift: LookupTable
    blinding: LookupTable | None
    divide: LookupTable | None
    alike: tuple[float, float] | None
    residual: float

    def at(self, *, height: Lanes, narrowing: Lanes, sun: Lanes) -> Lanes:
        """Look up the shift of an echo.

        Args:
            height: y
            narrowing: q
            sun: lambda sigma
        """
        ops = xp(height, sun)
        bright = sun_coordinate(sun) + 0.0 * height
        strong = _height_coordinate(ops.maximum(height, 0.0) / self.highest.at(bright))
        shift = self.shift.at(strong, bright)
        if self.blinding is None or self.divide is None:
            return shift
        return ops.where(narrowing > self.divide.at(strong, bright), self.blinding.at(strong, bright), shift)


@dataclass(frozen=True, slots=True, kw_only=True)
class Filtering:
    """What of a sensor decides its walk.

    Attributes:
        bin_sigmas: length of a bin, in sigmas
        dead_sigmas: dead time, in sigmas; inf: a SPAD fires once in a shot
        spads: of a pixel
        coincidence: SPADs that must fire in a bin to count
        side: bins of the filter on either side
        centroid: whether the centroid of the counts is the place of an echo, and not the filter's peak
    """

    bin_sigmas: float
    dead_sigmas: float
    spads: float
    coincidence: int = field(metadata=STATIC)
    side: int
    centroid: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedEchoes:
    """Expected echoes of a calibration, each field (lights, suns); the mean over places in a bin.

    Attributes:
        height: y
        narrowing: q
        shift: in sigmas
    """

    height: Numbers
    narrowing: Numbers
    shift: Numbers


@lru_cache(maxsize=64)
def calibrate(sensor: Filtering) -> Walk:
    """Calibrate a sensor."""
    lights, suns = _lights(), sun_nodes(_SUNS)
    course = expected_course(lights, suns, sensor)
    # Counts of single SPADs only crowd closer together as light grows.
    tops = np.argmax(course.height, axis=0) if sensor.coincidence > 1 else np.full(_SUNS, _LIGHTS - 1)
    highest = np.max(course.height, axis=0)
    nodes = _heights()[:, None] * highest
    tables = np.zeros((3, _HEIGHTS, _SUNS))
    for j, top in enumerate(tops):
        rising, falling = slice(0, top + 1), slice(None, max(top - 1, 0), -1)
        height, narrowing, shift = (values[:, j] for values in (course.height, course.narrowing, course.shift))
        # Rounding may leave ripples where the height hardly rises.
        low = np.maximum.accumulate(height[rising])
        tables[0, :, j] = np.interp(nodes[:, j], low, shift[rising])
        high = np.maximum.accumulate(height[falling])
        tables[1, :, j] = np.interp(nodes[:, j], high, shift[falling])
        middle = 0.5 * (
            np.interp(nodes[:, j], low, narrowing[rising]) + np.interp(nodes[:, j], high, narrowing[falling])
        )
        tables[2, :, j] = np.where(nodes[:, j] < _FAR_BELOW * high[0], _NEVER, middle)
    folds = sensor.coincidence > 1
    alike, residual = _look_alikes(course, int(tops[0]))
    return Walk(
        highest=LookupTable(highest),
        shift=LookupTable(tables[0]),
        blinding=LookupTable(tables[1]) if folds else None,
        divide=LookupTable(tables[2]) if folds else None,
        alike=alike,
        residual=residual,
    )


def _look_alikes(course: ExpectedEchoes, top: int) -> tuple[tuple[float, float] | None, float]:
    """`Walk.alike` and `Walk.residual` of the course in the dark.

    Args:
        top: number of the power with the highest y
    """
    lights, (height, shift) = _lights(), (course.height[:, 0], course.shift[:, 0])
    if top < len(lights) - 1:
        first = int(np.argmax(height > _NEARLY * height[top]))
        return (float(lights[first]), MOST), float(shift[first] - shift[-1])
    jump = int(np.argmax(np.abs(np.diff(shift))))
    residual = float(abs(shift[jump + 1] - shift[jump]))
    if residual < _JUMP:
        return None, 0.0
    return (float(lights[jump] / _BLUR), float(lights[jump] * _BLUR)), residual


def expected_course(lights: Numbers, suns: Numbers, sensor: Filtering) -> ExpectedEchoes:
    """Compute the filter's peak at echoes of these Lambda on these suns."""
    near = None
    if sensor.dead_sigmas < _REVIVED:
        # SPADs that a strong echo revives fire a second time: in all places in a bin the same of two humps is taken.
        parts = math.ceil(sensor.bin_sigmas / _FINE)
        finer = replace(sensor, bin_sigmas=sensor.bin_sigmas / parts, side=sensor.side * parts, centroid=False)
        near = _in_phase(lights, suns, finer, phase=0.0, near=None)[2]
    phases = (np.arange(_PHASES) + 0.5) / _PHASES - 0.5
    courses = [_in_phase(lights, suns, sensor, phase=float(phase), near=near) for phase in phases]
    height, narrowing, shift = np.mean(courses, axis=0)
    return ExpectedEchoes(height=height, narrowing=narrowing, shift=shift)


def _in_phase(lights: Numbers, suns: Numbers, sensor: Filtering, *, phase: float, near: Numbers | None) -> Numbers:
    """Height, narrowing and shift (3, lights, suns) of echoes at one place in a bin.

    Args:
        phase: place of the echo in bins from a bin's middle
        near: (lights, suns) shift near which the peak is looked for; None: everywhere
    """
    bin_sigmas, dead_sigmas, side, coincidence = sensor.bin_sigmas, sensor.dead_sigmas, sensor.side, sensor.coincidence
    reach = math.ceil(6.0 / bin_sigmas) + side
    bins = np.arange(-reach, reach + 1)
    time = (bins - phase) * bin_sigmas
    light = lights[:, None, None] * np.exp(-0.5 * time * time) * (bin_sigmas / math.sqrt(2.0 * math.pi))
    detections = light + suns[:, None] * bin_sigmas
    fires_once = math.isinf(dead_sigmas)
    dead_bins = math.inf if fires_once else dead_sigmas / bin_sigmas
    fired = dead_time.firing_shares(detections, bin_s=1.0, dead_time_s=dead_bins)
    dark = dead_time.firing_shares(suns[:, None] * bin_sigmas + 0.0 * time, bin_s=1.0, dead_time_s=dead_bins)
    # SPADs that fire once are all free in the first bin, and counted by those that the sun leaves until the echo.
    free = np.exp(-suns * reach * bin_sigmas) if fires_once else 1.0 / (1.0 + suns * dead_sigmas)
    if coincidence > 1:
        fired, dark = (
            np.asarray(dead_time.coincidence_share(least=coincidence, spads=sensor.spads, share=share))
            for share in (fired, dark)
        )
        free = np.ones_like(suns)
    counts = (fired - dark) / free[:, None]
    offset = bins[:, None] - bins
    template = SCALE * np.exp(-0.5 * (offset * (bin_sigmas / TEMPLATE)) ** 2) * (np.abs(offset) <= side)
    values = counts @ template
    searched = values if near is None else np.where(np.abs(time - near[..., None]) < _SEARCH, values, -np.inf)
    best = np.clip(np.argmax(searched, axis=-1), 1, len(bins) - 2)[..., None]
    low, top, high = (np.take_along_axis(values, best + step, axis=-1)[..., 0] for step in (-1, 0, 1))
    # Without any counts there is a height too.
    least = np.maximum(1e-3 * top, _DARK)
    low, top, high = (np.log(np.maximum(value, least)) for value in (low, top, high))
    away = np.clip(0.5 * (low - high) / np.minimum(low - 2.0 * top + high, -1e-9), -0.5, 0.5)
    height = np.exp(top - 0.25 * (low - high) * away)
    place = best[..., 0] - reach + away

    def inside(middle: Numbers) -> Numbers:
        return np.asarray(np.clip(BOX / bin_sigmas + 0.5 - np.abs(bins - middle[..., None]), 0.0, 1.0) * counts)

    if sensor.centroid:
        around = inside(best[..., 0] - reach)
        place = np.sum(around * bins, axis=-1) / np.maximum(np.sum(around, axis=-1), _DARK)
    return np.stack([height, height / np.maximum(np.sum(inside(place), axis=-1), _DARK), (place - phase) * bin_sigmas])


def _lights() -> Numbers:
    """Lambda of a calibration."""
    return np.geomspace(_LEAST, MOST, _LIGHTS)


def _heights() -> Numbers:
    """y at the nodes, over the highest."""
    return np.asarray((1.0 + _ROUND) * (1.0 - (_ROUND / (1.0 + _ROUND)) ** np.linspace(0.0, 1.0, _HEIGHTS)))


def _height_coordinate(share: Lanes) -> Lanes:
    """Coordinate of y over the highest in the tables."""
    ops = xp(share)
    remaining = ops.maximum((1.0 + _ROUND) - share, _ROUND)
    return (math.log(1.0 + _ROUND) - ops.log(remaining)) * (1.0 / math.log((1.0 + _ROUND) / _ROUND))
