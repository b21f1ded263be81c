"""Edges behind a peak: where a pulse leaves a level, and whether other light rises before it does.

The falling edge has other noise, a clipped amplifier may hold it up, and further peaks on the way belong to the
same pulse (docs/theory_receivers.md 2, 4 and 6).

Symbols: sigma_p width of the laser pulse and unit of all places.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...maths.arrays import Lanes, Mask
from ...physics.electronics import saturation
from ...physics.electronics.pulse_sums import crossing
from .. import comparator
from ..comparator import Trip
from ..rises import STEP, Rise
from ..shots import Received

_LONGEST = 200
"""Most steps of one sigma_p behind a peak: a pulse that is still above its level then counts as over."""


def trailing_level(shots: Received, rise: Rise, trip: Trip, place: Lanes, threshold: Lanes) -> Lanes:
    """Noiseless signal at which a pulse that crossed at ``place`` falls below a threshold, (n,).

    The lag between the edges is twice the way from the crossing to the peak, as of a symmetric pulse.
    """
    return comparator.trailing_level(
        shots, trip, threshold=threshold, lag_s=2.0 * (rise.peak - place) * shots.sigma_s, draw=rise.number
    )


def fall(shots: Received, rise: Rise, trip: Trip, level: Lanes, since: Lanes, mask: Mask) -> tuple[Lanes, Lanes]:
    """Place at which the amplifier's output falls to a signal level, (n,); the peak if that is below the level.

    Args:
        level: (n,) noiseless signal
        since: (n,) place where the waveform is still above the level: the peak, or a place behind it

    Returns:
        a second place, that of `_find_fall` for the light itself
    """
    ops, point = shots.ops, shots.point
    below = mask & (level < trip.signal)
    end, near = _find_fall(shots, ops.where(below, point.response.power_w(level), 1.0), rise, since, below)
    if point.response.saturation is not None and point.response.recovery_s is not None:
        # A clipped amplifier drains from where the light falls back to the clipping level, and may hold the output
        # above the level for longer than the light does (T45).
        clipped = below & (trip.signal > point.response.saturation)
        clipped_w = ops.where(clipped, point.response.power_w(point.response.saturation), 1.0)
        released, _ = _find_fall(shots, clipped_w, rise, rise.peak, clipped)
        end = saturation.held_until(
            fall_s=end,
            released_s=released,
            level=level,
            signal=trip.signal,
            saturation=point.response.saturation,
            recovery_s=point.response.recovery_s / shots.sigma_s,
        )
    return ops.where(below, end, rise.peak), near


def foot(shots: Received, rise: Rise, trip: Trip, mask: Mask) -> Lanes:
    """Lowest signal behind a peak before the light rises again by a threshold, (n,); 0 if it falls below it first."""
    ops, threshold = shots.ops, shots.threshold
    lowest_level = threshold + trip.base

    def step(foot: _Foot) -> _Foot:
        place = foot.place + STEP
        signal = shots.point.response.signal(shots.wave.at(place)[0])
        lowest = ops.minimum(foot.lowest, signal)
        return _Foot(
            place=place,
            lowest=lowest,
            steps=foot.steps + 1,
            walking=(signal >= lowest_level) & (signal < lowest + threshold),
        )

    start = _Foot(
        place=rise.peak + ops.full(rise.peak, 0.0),
        lowest=trip.signal + ops.full(rise.peak, 0.0),
        steps=ops.full(rise.number, 0),
        walking=mask & (trip.signal >= lowest_level),
    )
    lowest = ops.loop(start, lambda foot: foot.walking & (foot.steps < _LONGEST), step).lowest
    return ops.where(lowest >= lowest_level, lowest, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Foot:
    """State of the walk behind a peak in search of the next rise; each field (n,).

    Attributes:
        place: current place of the walk
        lowest: lowest signal so far
        steps: number of steps so far
        walking: whether the walk goes on
    """

    place: Lanes
    lowest: Lanes
    steps: Lanes
    walking: Mask


def _find_fall(shots: Received, level_w: Lanes, rise: Rise, since: Lanes, mask: Mask) -> tuple[Lanes, Lanes]:
    """Place behind a peak at which the waveform falls to a level, (n,).

    Args:
        level_w: (n,) optical power
        since: (n,) place where the waveform is still above the level: the peak, or a place behind it

    Returns:
        a second place, at most a step before the first, where the waveform is still above the level
    """
    ops = shots.ops

    def step(fall: _Fall) -> _Fall:
        place = fall.place + STEP
        return _Fall(place=place, above=shots.wave.at(place)[0] > level_w, steps=fall.steps + 1)

    # Walk in steps until the waveform is below the level, then find the root in the last step. Further peaks on the way
    # belong to the same pulse if the valleys before them stay above the level.
    every = ops.full(since, True)
    start = _Fall(place=since + ops.full(since, 0.0), above=mask & every, steps=ops.full(rise.number, 0))
    far = ops.loop(start, lambda fall: fall.above & (fall.steps < _LONGEST), step).place
    near = far - STEP
    end = crossing(shots.wave.at, level_w, far=far, near=near, peak=rise.peak, top=rise.top, mask=mask)
    return end, near


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fall:
    """State of the walk down behind a peak; each field (n,).

    Attributes:
        place: current place of the walk
        above: whether the waveform is still above the level there
        steps: number of steps so far
    """

    place: Lanes
    above: Mask
    steps: Lanes
