"""Pile-up within an echo: SPADs that fire on the leading edge are blind for the rest, so strong echoes look too near.

Behind the echo its SPADs are blind to the background too. Both follow from one renewal course of the free SPADs
(`dead_time.firing_shares`), which is tabulated here for a lone echo on even light.

Symbols: Lambda detections of an echo that one free SPAD would make without dead time, sigma width of the echo, lambda
rate of the background on a free SPAD, tau dead time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...maths.arrays import Lanes, LookupTable, Mask, Numbers, xp
from ...maths.special import normal_tail
from . import dead_time
from .matched_filter import OUTPUT_WIDTH, SCALE, SIGNAL_SLOPE, TEMPLATE

BOX = 2.4
"""Choice: half width of the bins whose counts are an echo's photons, in sigmas."""

BOX_SHARE = math.erf(BOX / math.sqrt(2.0))
"""Share of a Gaussian within it."""

_WEAK = 1e-3
"""Accuracy bought: Lambda that stands for weak light."""

MOST = 1e4
"""Accuracy bought: largest Lambda of the tables: all SPADs fire 4 sigmas before the peak."""

_MOST_SUN = 2.0
"""Choice: largest lambda sigma of the tables."""

_BEND = 0.25
"""Accuracy bought: lambda sigma at which the tables' axis bends: x / (x + 0.25) is its coordinate."""

_NEVER_AGAIN, _SHORTEST = 5.6, 1.5
"""Accuracy bought: dead time in sigmas from which on no SPAD comes back within the filter, and the shortest one of the
tables."""

_NODES, _NODES_OF_WEAK = (56, 16, 10), (32, 19)
"""Nodes of the tables over Lambda, lambda sigma and sigma / tau, and of weak light over the latter two."""

_FAINT = 0.05
"""Accuracy bought: Lambda up to which an echo's peak follows from that of a weak one, to 1e-3 of its height and of
sigma; its bend and variances are those of a weak one, to 1e-2."""

_TOP = ("height", "bend", "variance", "of_slope")
"""Fields of `Top`, in the order of their table."""

_NEWTON = 4
"""Steps of Newton's method to the top of a hump: to 0.01 of its width."""

_STEP = 0.08
"""Accuracy bought: step of the tables' courses, in sigmas: a shorter one takes longer to tabulate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Top:
    """Highest value of the matched filter at a lone echo on even light (T101); each field a number or (n,).

    Each value and variance is over the SPADs that the echo fires without sun, N a (1 - exp(-Lambda)).

    Attributes:
        height: value above that of the background
        bend: second derivative there over that of a weak echo of this height without sun; below 1 where SPADs fire
            again within the echo, which broadens it
        variance: variance of the value by the firings above those of the background, each for itself
        of_slope: the same of the slope; equal to that of the value for a weak echo without sun
    """

    height: Lanes
    bend: Lanes
    variance: Lanes
    of_slope: Lanes


def top(*, detections: Lanes, sun: Lanes, dead: Lanes, weak: Top | None = None) -> Top:
    """Highest value of the filter at an echo, from the renewal course of the free SPADs (T101).

    Args:
        detections: Lambda
        sun: lambda sigma
        dead: tau / sigma
        weak: `weak_top` of these, if computed before
    """
    weak = weak or weak_top(sun=sun, dead=dead)
    place = _Place.of(detections, sun, dead)
    # No branch: derivatives pass here.
    choose = xp(place.detections).choice(place.is_strong)
    height, *others = _tables()["top"].four_at(*place.coordinates())
    bend, variance, of_slope = map(choose, others, (weak.bend, weak.variance, weak.of_slope))
    faint = weak.height + place.faint * _tables_of_weak()["filled"].at(place.bright)
    return Top(height=choose(height, faint), bend=bend, variance=variance, of_slope=of_slope)


def shift(*, detections: Lanes, sun: Lanes, dead: Lanes) -> Lanes:
    """Place of the filter's highest value at an echo, in sigmas from the echo's middle: negative (T101).

    Arguments as of `top`. It serves searches, through which no derivatives pass.
    """
    place, tables = _Place.of(detections, sun, dead), _tables_of_weak()
    weak = tables["shift"].at(place.bright, place.short)
    # Most echoes fire few SPADs, and packets of those need no table of three axes.
    return xp(weak).where_any(
        place.is_strong,
        lambda: _tables()["shift"].at(*place.coordinates()),
        weak + place.faint * tables["pulled"].at(place.bright),
    )


def weak_top(*, sun: Lanes, dead: Lanes) -> Top:
    """Highest value of the filter at a weak echo, as `top` with few detections.

    Args:
        sun: lambda sigma
        dead: tau / sigma
    """
    place, tables = _Place.of(0.0, sun, dead), _tables_of_weak()
    return Top(**dict(zip(_TOP, tables["top"].four_at(place.bright, place.short), strict=True)))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """An echo in the tables; each field as wide as all of them, (n,) or numbers.

    Attributes:
        detections: Lambda
        bright: coordinate of lambda sigma
        short: coordinate of sigma / tau
    """

    detections: Lanes
    bright: Lanes
    short: Lanes

    @classmethod
    def of(cls, detections: Lanes, sun: Lanes, dead: Lanes) -> _Place:
        """Place of an echo with Lambda, lambda sigma and tau / sigma."""
        zero = 0.0 * (detections + sun + dead)
        return cls(
            detections=xp(zero).maximum(detections + zero, 0.0),
            bright=sun_coordinate(sun) + zero,
            short=_SHORTEST / (dead + zero),
        )

    @property
    def is_strong(self) -> Mask:
        """Whether the echo fires so many SPADs that its peak does not follow from that of a weak one."""
        return self.detections > _FAINT

    @property
    def faint(self) -> Lanes:
        """Lambda, as far as it is faint."""
        return xp(self.detections).minimum(self.detections, _FAINT)

    def coordinates(self) -> tuple[Lanes, Lanes, Lanes]:
        """Coordinates in the tables of three axes."""
        ops = xp(self.detections)
        return ops.log(1.0 + self.detections) * (1.0 / math.log1p(MOST)), self.bright, self.short


def sun_coordinate(sun: Lanes) -> Lanes:
    """Coordinate of lambda sigma in the tables."""
    return sun * (1.0 + _BEND / _MOST_SUN) / (sun + _BEND)


def shade_of_box(*, sun: Lanes) -> Lanes:
    """Counts above the background within `BOX` sigmas of a weak echo's peak over its photons (T102).

    Up to a moment t the share exp(lambda (lambda sigma^2 / 2 - t)) Q(lambda sigma - t / sigma) of the SPADs that the
    echo fires is missing: the background has not fired them in its place. The counts are what is missing at the box's
    end, less that at its begin.

    Args:
        sun: lambda sigma; the dead time is longer than the box
    """
    return _tables_of_weak()["box"].at(sun_coordinate(sun))


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoFirings:
    """Firings of SPADs by an echo in the sun, times in sigmas; each field (n,).

    Attributes:
        share: firings over the SPADs that are free in even light: those that come free within the echo fire too
        mean: mean time from the echo's middle: negative
        deviation: standard deviation of the time
    """

    share: Lanes
    mean: Lanes
    deviation: Lanes


def firings(*, detections: Lanes, sun: Lanes) -> EchoFirings:
    """Firings of SPADs by an echo, to first order in the sun (T107); arguments as of `top`."""
    ops, tables = xp(detections + sun), _tables_of_firings()
    bright = ops.log(1.0 + ops.maximum(detections, 0.0)) * (1.0 / math.log1p(MOST))
    at_first = dead_time.firing_share(detections=detections)
    early, deviation = tables["early"].at(bright), tables["deviation"].at(bright)
    # SPADs that come free within the echo fire too, later.
    later = sun * tables["later"].at(bright)
    share = at_first + later
    part = later / ops.maximum(share, 1e-20)
    apart = early + tables["later_mean"].at(bright)
    spread = deviation * deviation + part * (tables["later_variance"].at(bright) - deviation * deviation)
    return EchoFirings(
        share=share, mean=part * apart - early, deviation=ops.sqrt(spread + part * (1.0 - part) * apart * apart)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Hump:
    """Hump of the counts a dead time behind an echo, where the SPADs that it fired are back; each field (n,).

    Attributes:
        excess: share by which more SPADs are free there than in even light, behind the filter's template
        place: of the highest value of the filter, in sigmas behind the return of these SPADs
    """

    excess: Lanes
    place: Lanes


def hump(echo: EchoFirings, *, sun: Lanes, dead: Lanes) -> Hump:
    """Hump of the SPADs that an echo has fired and that come back together (T108); arguments as of `top`.

    No SPAD comes back within the echo.
    """
    ops = xp(echo.share + sun + dead)
    width = ops.sqrt(TEMPLATE * TEMPLATE + echo.deviation * echo.deviation)
    sun_width, still_blind = sun * width, ops.exp(-sun * dead)
    rise = 1.0 + sun_width * sun_width
    place = 1.0 + 0.0 * sun_width
    for _ in range(_NEWTON):
        density, back = _normal(place)
        value = density * rise - sun_width * (back * (2.0 - sun_width * place) - still_blind)
        slope = place * density * rise + sun_width * (density * (2.0 - sun_width * place) - sun_width * back)
        place = ops.minimum(ops.maximum(place + value / ops.maximum(slope, 1e-6), 0.5 * place - 0.5), place + 1.0)
    density, back = _normal(place)
    course = (1.0 - sun_width * place) * back - sun_width * density - still_blind
    decayed = ops.exp(-sun_width * (place + 0.5 * sun_width))
    return Hump(excess=echo.share * decayed * course, place=width * (place + sun_width))


def _normal(place: Lanes) -> tuple[Lanes, Lanes]:
    """Density and distribution function of a standard normal number."""
    return xp(place).exp(-0.5 * place * place) * (1.0 / math.sqrt(2.0 * math.pi)), normal_tail(-place)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Node:
    """`Top` of peaks at the tables' nodes and their shift; each field (detections, sun), NumPy."""

    height: Numbers
    shift: Numbers
    bend: Numbers
    variance: Numbers
    of_slope: Numbers


@lru_cache(maxsize=1)
def _tables() -> dict[str, LookupTable]:
    """Tables of the top and its shift over ln(1 + Lambda), lambda sigma and sigma / tau."""
    return _tables_of(_by_dead_time(_detections(_NODES[0]), sun_nodes(_NODES[1]), _NODES[2]))


def _tables_of(tops: list[_Node], detections: slice | int = slice(None)) -> dict[str, LookupTable]:
    """Tables "top" and "shift" of peaks at so many dead times; "top" has the fields of `Top` along its last axis."""
    stacked = {
        name: np.stack([getattr(shape, name)[detections] for shape in tops], axis=-1) for name in (*_TOP, "shift")
    }
    return {
        "top": LookupTable(np.stack([stacked[name] for name in _TOP], axis=-1)),
        "shift": LookupTable(stacked["shift"]),
    }


@lru_cache(maxsize=1)
def _tables_of_weak() -> dict[str, LookupTable]:
    """Tables for weak light: the top and its shift over lambda sigma and sigma / tau, the others over lambda sigma.

    The others are what a few detections add to height and shift, and the counts in the box.
    """
    sun = sun_nodes(_NODES_OF_WEAK[0])
    weak, faint = (_tops(np.array([light]), sun, _NEVER_AGAIN) for light in (_WEAK, _FAINT))

    def missing(edge: Numbers) -> Numbers:
        return np.exp(sun * (0.5 * sun - edge)) * normal_tail(sun - edge)

    return _tables_of(_by_dead_time(np.array([_WEAK]), sun, _NODES_OF_WEAK[1]), 0) | {
        "filled": LookupTable((faint.height - weak.height)[0] / _FAINT),
        "pulled": LookupTable((faint.shift - weak.shift)[0] / _FAINT),
        "box": LookupTable(missing(weak.shift[0] + BOX) - missing(weak.shift[0] - BOX)),
    }


@lru_cache(maxsize=1)
def _tables_of_firings() -> dict[str, LookupTable]:
    """Tables over ln(1 + Lambda) of the firings of an echo: times of SPADs that are free before it, and of others.

    "early" and "deviation" are the mean time of the former before the echo's middle, and its deviation; "later",
    "later_mean" and "later_variance" the firings of those that come free within the echo, over lambda sigma, and their
    times.
    """
    detections = np.expm1(np.linspace(0.0, 1.0, _NODES[0]) * math.log1p(MOST))[:, None]
    time = np.arange(-6.4, 6.4, _STEP)
    before, light = detections * normal_tail(-time), detections * np.exp(-0.5 * time * time) / math.sqrt(2.0 * math.pi)
    density = np.maximum(light, 1e-30) * np.exp(-before)
    # A share lambda of the SPADs comes free in each moment, less what the sun fires of those that are free.
    late = np.zeros_like(density)
    free = np.zeros_like(detections[:, 0])
    for i in range(len(time)):
        released = _STEP * -np.expm1(-before[:, i])
        of_free, of_released = dead_time.firing_parts(detections=light[:, i] * _STEP)
        late[:, i] = free * of_free + released * of_released
        free = free + released - late[:, i]

    def times(weights: Numbers) -> tuple[Numbers, Numbers]:
        weights = weights / weights.sum(axis=1, keepdims=True)
        mean = weights @ time
        return mean, weights @ time**2 - mean**2

    mean, variance = times(density)
    later_mean, later_variance = times(late + 1e-9 * density)
    return {
        "early": LookupTable(-mean),
        "deviation": LookupTable(np.sqrt(variance)),
        "later": LookupTable(late.sum(axis=1)),
        "later_mean": LookupTable(later_mean),
        "later_variance": LookupTable(later_variance),
    }


def _detections(count: int) -> Numbers:
    """Lambda at the nodes; the first is weak light, of which the share that fires is in proportion to it."""
    return np.maximum(np.expm1(np.linspace(0.0, 1.0, count) * math.log1p(MOST)), _WEAK)


def _by_dead_time(detections: Numbers, sun: Numbers, count: int) -> list[_Node]:
    """`_tops` at the nodes of tau: SPADs that are blind for ever stand at 0, the shortest dead time at 1."""
    inverse = np.linspace(0.0, 1.0 / _SHORTEST, count)
    lasting = _tops(detections, sun, _NEVER_AGAIN)
    return [_tops(detections, sun, float(1.0 / k)) if k * _NEVER_AGAIN > 1.0 else lasting for k in inverse]


def sun_nodes(count: int) -> Numbers:
    """Values of lambda sigma at the nodes."""
    coordinate = np.linspace(0.0, 1.0, count) / (1.0 + _BEND / _MOST_SUN)
    return _BEND * coordinate / (1.0 - coordinate)


def _tops(detections: Numbers, sun: Numbers, dead: float) -> _Node:
    """Highest values of the filter at echoes, from the courses of the free SPADs: (detections, sun) each."""
    detections, sun = detections[:, None, None], sun[:, None]
    time = np.arange(-6.4, 5.6, _STEP) + 0.5 * _STEP
    pulse = np.exp(-0.5 * time * time) / math.sqrt(2.0 * math.pi)
    places = np.arange(-4.5, 1.0, _STEP)
    template = SCALE * np.exp(-0.5 * ((time[:, None] - places) / TEMPLATE) ** 2)
    # A step of the background alone comes first: the SPADs are in balance with it.
    rate = np.concatenate([sun + 0.0 * detections, sun + detections * pulse], axis=-1)
    # Dead times that matter in the filter are followed; longer ones outlast the course.
    dead = dead if dead < _NEVER_AGAIN else 20.0
    fired = dead_time.firing_shares(rate, bin_s=_STEP, dead_time_s=dead)
    free = dead_time.free_share(rate_hz=sun, dead_time_s=dead)
    excess = (fired[..., 1:] - fired[..., :1]) / (free * dead_time.firing_share(detections=detections))
    values = excess @ template
    best = np.clip(np.argmax(values, axis=-1), 1, len(places) - 2)[..., None]
    low, middle, high = (np.take_along_axis(values, best + k, axis=-1)[..., 0] for k in (-1, 0, 1))
    second = low - 2.0 * middle + high
    offset = 0.5 * (low - high) / second
    shift = places[best[..., 0]] + offset * _STEP
    apart = (time - shift[..., None]) / TEMPLATE
    spread = excess * (SCALE * np.exp(-0.5 * apart * apart)) ** 2
    of_slope = (OUTPUT_WIDTH / TEMPLATE) ** 2 / SIGNAL_SLOPE
    return _Node(
        height=middle - 0.25 * (low - high) * offset,
        shift=shift,
        bend=-second / middle * (OUTPUT_WIDTH / _STEP) ** 2,
        variance=spread.sum(axis=-1),
        of_slope=of_slope * (apart * apart * spread).sum(axis=-1),
    )
