"""Stops: the returns that a converter keeps of each pulse, out of all that it finds.

A converter reports a few returns of a pulse: the first, the last, the strongest, or the strongest and the last. Returns
come one after the other, so the best so far are held in a short list, into which each new one is inserted
(docs/theory_light.md 5, docs/theory_receivers.md 6).

One time decides about a return, whether an echo or noise causes it: when it crosses the comparator's threshold. By that
time it is within the window or not, and before or behind another. A histogram has no crossings: its returns are ordered
and held apart by the time that is reported of them, and are within the window if their light is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..maths.arrays import Array, Lanes, Mask, select_state, xp
from ..sensor.electronics import Tdc
from .report import Measurement

EMPTY = -1e30
"""Choice: key of an unused stop: below every other key."""

Stops = tuple["Stop", ...]
"""The returns kept so far, best first; of ``strongest_and_last`` the two strongest, then the last."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop(Measurement):
    """A stop of the converter and the return that it holds; each field (n,).

    Attributes:
        key: sort key: returns with larger keys are kept first; `EMPTY` if the stop is unused
        reported_s: time that the converter reports
        crossing_s: time at which the comparator tripped; None: the reported time decides in its place
    """

    key: Lanes
    reported_s: Lanes
    crossing_s: Lanes | None = None

    @property
    def occupied(self) -> Mask:
        """True where the stop holds a return, (n,) bool."""
        return self.key > EMPTY

    @property
    def time_s(self) -> Lanes:
        """Time that decides about the return, (n,)."""
        return self.reported_s if self.crossing_s is None else self.crossing_s

    def with_values(self, **values: Lanes | None) -> Stop:
        """Return a stop with these values in the fields that this one has."""
        changes: dict[str, Any] = {name: value for name, value in values.items() if getattr(self, name) is not None}
        return replace(self, **changes)

    def only_where(self, condition: Mask) -> Stop:
        """Return the stop with its return where the condition holds, else unused."""
        return replace(self, key=xp(self.key).where(condition, self.key, EMPTY))


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What a finder found in the light of n pulses; each field but the stops (n,).

    Attributes:
        stops: echoes that the converter keeps, not yet in the order in which it reports them
        tripped: whether any light tripped the comparator
        in_window: whether the converter took any of it
        snr: of the highest peak, as in `report.Detection`
        detection_probability: of the highest peak, as in `report.Detection`
        source: of the strongest sub-echo of a surface, which alarms get too; None: there is only one
        true_range_m: as `source`
    """

    stops: Stops
    tripped: Mask
    in_window: Mask
    snr: Lanes
    detection_probability: Lanes
    source: Array | None = None
    true_range_m: Lanes | None = None


def empty_stops(tdc: Tdc, like: Stop) -> Stops:
    """Stops of a converter before its first return, with the fields of this one."""
    empty = replace(like, key=xp(like.key).full(like.key, EMPTY))
    return (empty,) * (3 if tdc.keep == "strongest_and_last" else tdc.stops)


def sort_key(tdc: Tdc, time_s: Lanes, amplitude: Lanes) -> Lanes:
    """Sort key, (n,): returns with larger keys are kept first."""
    by_time = {"first": -time_s, "last": time_s}
    return by_time.get(tdc.keep, amplitude)


def may_keep(tdc: Tdc, crossing_s: Lanes, stops: Stops) -> Mask:
    """True if a return at this time can be among the best, (n,) bool; others need not be measured.

    Where the key is the amplitude, every return has to be measured first.
    """
    if tdc.keep in ("first", "last"):
        return sort_key(tdc, crossing_s, 0.0) > stops[-1].key
    return True


def insert_stop(tdc: Tdc, stops: Stops, new: Stop, *, later: bool = False) -> Stops:
    """Insert a return into the stops and keep the best.

    Args:
        later: whether the new one comes after all that are there
    """
    if tdc.keep == "strongest_and_last":
        in_time = replace(new, key=xp(new.key).where(new.occupied, new.time_s, EMPTY))
        return (*_insert(stops[:2], new), *_insert(stops[2:], in_time))
    # Later ones have the smaller keys if the first are kept: they go into the first unused stop.
    return _append(stops, new) if later and tdc.keep == "first" else _insert(stops, new)


def best_first(tdc: Tdc, stops: Stops) -> Stops:
    """Put the stops in order again after some of them were freed (`Stop.only_where`).

    Returns:
        can be inserted before that: a new one takes the place of the worst, wherever that is
    """
    if tdc.keep == "strongest_and_last":
        return (*_sort(stops[:2], [stop.key for stop in stops[:2]]), *stops[2:])
    return _sort(stops, [stop.key for stop in stops])


def reported_stops(tdc: Tdc, stops: Stops) -> Stops:
    """Stops in the order in which the converter reports them; unused ones come last."""
    if tdc.keep == "strongest_and_last":
        strongest, second, last = stops
        # If the strongest is the last too, the second strongest takes its place.
        stops = (strongest, select_state(last.occupied & (last.time_s > strongest.time_s), last, second))
    return stops if tdc.keep == "first" else _sort(stops, [-stop.time_s for stop in stops])


def _sort(stops: Stops, keys: Sequence[Lanes]) -> Stops:
    """Sort the stops by other keys, falling; unused ones come last."""
    ops = xp(stops[0].key)
    keyed = [replace(stop, key=ops.where(stop.occupied, new, EMPTY)) for stop, new in zip(stops, keys, strict=True)]
    # Insert them one by one into placeholders, whose key is below even that of an unused stop: all are pushed out.
    empty = replace(keyed[0], key=ops.full(keyed[0].key, 2.0 * EMPTY))
    ordered: Stops = (empty,) * len(stops)
    for stop in keyed:
        ordered = _insert(ordered, stop)
    return ordered


def _insert(stops: Stops, new: Stop) -> Stops:
    """Insert a stop into a list in falling order of keys; the last one drops out."""
    ordered = []
    # Insertion sort, lane by lane: from the stop that the new one displaces on, each takes the one before it.
    for old in stops:
        better = new.key > old.key
        ordered.append(select_state(better, new, old))
        new = select_state(better, old, new)
    return tuple(ordered)


def _append(stops: Stops, new: Stop) -> Stops:
    """Put a stop whose key is below all used ones into the first unused stop; the result is that of `_insert`."""
    pending, updated = new.occupied, []
    for old in stops:
        updated.append(select_state(pending & ~old.occupied, new, old))
        pending = pending & old.occupied
    return tuple(updated)
