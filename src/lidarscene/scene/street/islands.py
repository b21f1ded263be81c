"""Raised ground of road networks, as outlines: islands between lanes, kerbs along the corners of junctions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ...maths.arrays import Numbers
from ...maths.vectors import cross_in_plane
from ..ground_area import Outline
from .layout import KERB_M
from .polylines import along, beside, runs, way_length_m, ways_m
from .sumo import LaneGroup

ISLAND_STEP_M = 1.0
"""Accuracy bought: distance of the corners of an island between lanes."""

LEAST_ISLAND_M, MOST_ISLAND_M = 0.1, 6.0
"""Choice: widths between which lanes of opposite directions have an island between them; wider ones are soil."""

LAP_M = 0.02
"""Choice: by how much an island reaches over the roads beside it, so that no soil shows between."""

ASIDE_M = 0.1
"""Choice: distance beside the edge of a pavement at which there is a road if the edge has a kerb."""

PARALLEL = 0.1
"""Choice: sine of the angle between edges of an outline up to which their offset lines are not made to meet."""


def ring_island_m(ring: Sequence[LaneGroup]) -> Numbers:
    """(k, 3) corners of the island within a roundabout, counter-clockwise."""
    middle_m = np.concatenate([group.line_m for group in ring])[:, :2].mean(axis=0)
    sides = []
    for group in ring:
        both = [_border_m(group, ways_m(group.line_m), side * LAP_M, side) for side in (1.0, -1.0)]
        sides.append(min(both, key=lambda side_m: np.hypot(*(side_m[:, :2] - middle_m).T).mean()))
    x_m, y_m, z_m = (np.concatenate(sides) - np.append(middle_m, 0.0)).T
    radius_m, angle = np.hypot(x_m, y_m), np.arctan2(y_m, x_m)
    # Junctions are between the pieces of the ring.
    turn = np.linspace(-np.pi, np.pi, 4 + int(2.0 * np.pi * radius_m.mean() / ISLAND_STEP_M))[1:]
    radius_m, z_m = (np.interp(turn, angle, each, period=2.0 * np.pi) for each in (radius_m, z_m))
    x_m, y_m = middle_m[:, None] + radius_m * np.stack([np.cos(turn), np.sin(turn)])
    return np.stack([x_m, y_m, z_m], axis=1)


def islands_between_m(group: LaneGroup, opposite: LaneGroup) -> Iterator[Numbers]:
    """Yield (k, 3) corners of the islands between lanes of two directions of a road, where these are apart."""
    share = np.linspace(0.0, 1.0, 2 + int(way_length_m(group.line_m) / ISLAND_STEP_M))
    near_m, far_m = (
        _border_m(each, of_it * way_length_m(each.line_m), 0.0, -group.outside)
        for each, of_it in ((group, share), (opposite, 1.0 - share))
    )
    heading = along(group.line_m, share * way_length_m(group.line_m))[:, 2]
    apart_m = far_m[:, :2] - near_m[:, :2]
    width_m = group.outside * (np.sin(heading) * apart_m[:, 0] - np.cos(heading) * apart_m[:, 1])
    lap_m = np.pad(LAP_M * apart_m / np.maximum(np.abs(width_m), LEAST_ISLAND_M)[:, None], ((0, 0), (0, 1)))
    is_island = (width_m > LEAST_ISLAND_M) & (width_m < MOST_ISLAND_M)
    for begin, end in runs(is_island):
        if end - begin > 1:
            run = slice(begin, end)
            yield np.concatenate([(near_m - lap_m)[run], (far_m + lap_m)[run][::-1]])


def _border_m(group: LaneGroup, way_m: Numbers, lap_m: float, side: float = 1.0) -> Numbers:
    """(n, 3) places on the border of lanes, to the left of them (1) or to the right (-1), and a lap inside."""
    return beside(group.line_m, way_m, side * 0.5 * group.width_m - lap_m)


def kerbed_corner_m(corner_m: Numbers, road: Outline) -> tuple[Numbers, list[Numbers]]:
    """(k, 3) corners of a pavement at a junction without its kerbs, and those of each kerb.

    Args:
        corner_m: (k, 3) corners of the pavement with its kerbs
        road: outline of the junction
    """
    corner_m = corner_m if Outline(corner_m=corner_m, spacing_m=1.0).area_m2() > 0.0 else corner_m[::-1]
    step_m = np.roll(corner_m, -1, axis=0) - corner_m
    ahead = step_m[:, :2] / np.hypot(*step_m[:, :2].T)[:, None]
    inwards = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    has_kerb = road.contains((corner_m + 0.5 * step_m)[:, :2] - ASIDE_M * inwards)
    if not has_kerb.any() or has_kerb.all():
        return corner_m, []
    # The first edge is one without a kerb, and the last edge before it has one.
    first = int(np.flatnonzero(~has_kerb & np.roll(has_kerb, 1))[0])
    corner_m, ahead, inwards, has_kerb = (
        np.roll(each, -first, axis=0) for each in (corner_m, ahead, inwards, has_kerb)
    )
    inner: list[list[Numbers]] = []
    for number, place_m in enumerate(corner_m):
        before, after = (KERB_M * has_kerb[each] * inwards[each] for each in (number - 1, number))
        turn = float(cross_in_plane(ahead[number - 1], ahead[number]))
        if abs(turn) > PARALLEL:
            # The place on the one edge's line, moved aside, that is as far from the other edge as that is moved.
            beyond_m = (before - after) @ inwards[number] / turn
            moved = [before + beyond_m * ahead[number - 1]]
        else:
            moved = [before, after] if has_kerb[number - 1] != has_kerb[number] else [before]
        inner.append([place_m + np.append(each, 0.0) for each in moved])
    kerbs = []
    for begin, end in runs(has_kerb):
        numbers = [number % len(corner_m) for number in range(begin, end + 1)]
        within = [inner[numbers[0]][-1], *(inner[number][0] for number in numbers[1:])]
        kerbs.append(np.concatenate([corner_m[numbers], within[::-1]]))
    return np.array([place_m for places in inner for place_m in places]), kerbs
