"""The plan of a street, a line of straights, clothoids and arcs, open or closed to a loop; and its heights.

The curvature is linear in the way s along the line, k(s) = k0 + k' (s - s0), in each of its pieces: 0 on a straight,
even on an arc, rising or falling on a clothoid. The heading is its integral, the place that of (cos, sin) of the
heading. The slope, too, is linear in s in each of its pieces, so that heights are straight lines and parabolas.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ...maths.arrays import Numbers
from .polylines import integral, runs
from .street_file import StreetFile

NODE_M = 2.0
"""Accuracy bought: longest step between nodes of a bend: chords are 3 cm off an arc of 15 m, and the three nodes of
Gauss's quadrature place it to 1e-9 m."""

CLOTHOID_SHARE = 0.6
"""Choice: length of a clothoid over the radius that it leads to, unless the bend is too small for it."""

STEEPEST_RAD = math.radians(60.0)
"""Choice: largest angle between an open street and the x axis, so that it never meets itself."""

ASIDE_M_S2 = 1.5
"""Choice: acceleration towards the middle of a bend, at the speed that drivers wish for there."""

BEND_BRAKING_M_S2 = 1.5
"""Choice: of drivers before a bend."""

LOOP_WIDTHS = 50.0
"""Choice: least length of a loop over the distance from its middle to the houses, which leaves room inside."""

LEAST_RADIUS = 1.1
"""Choice: least radius of a bend over that distance, so that pavements inside of it have a length."""

LOOP_TURNS = (1, 1, -1, 1, 1, 1)
"""Choice: signs of a loop's right angles: an L."""

HILL_M = 120.0
"""Choice: longest way from one level place of a street to the next."""

CURVE_SHARE = 0.3
"""Choice: share of a hill in which the slope grows, and in which it falls again: 8 % on 100 m have a radius of
375 m."""

BESIDE_OFF_M = 1e-6
"""Accuracy bought: largest last step to a place along a lane, a thousandth of the digits of a file."""

_GAUSS = (0.5 - math.sqrt(0.15), 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.5 + math.sqrt(0.15), 5.0 / 18.0)

Piece = tuple[float, float, float]
"""Length [m] and curvature at both ends [1/m], to the left positive."""


class CentreLine:
    """The middle of a street.

    Attributes:
        pieces: one after the other; the first and the last of an open line, which go on beyond its ends, are straight
        begin_m: s at the begin of the first
        is_loop: whether the last piece leads into the first
        node_m: (k,) places between which the curvature is linear
    """

    def __init__(
        self,
        pieces: Sequence[Piece],
        begin_m: float,
        *,
        is_loop: bool = False,
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """Compute curvature, heading and place at nodes, with x, y [m] and heading [rad] of the origin at s = 0."""
        self.pieces, self.begin_m, self.is_loop = pieces, begin_m, is_loop
        lengths, curvatures = [], [pieces[0][1]]
        for length_m, first, last in pieces:
            count = max(1, math.ceil(length_m / NODE_M)) if first or last else 1
            lengths += [length_m / count] * count
            curvatures += [first + (last - first) * number / count for number in range(1, count + 1)]
        step = np.array(lengths)
        self._curvature: Numbers = np.array(curvatures)
        self.node_m: Numbers = begin_m + np.concatenate([[0.0], np.cumsum(step)])
        turned = 0.5 * step * (self._curvature[:-1] + self._curvature[1:])
        self._heading = np.concatenate([[0.0], np.cumsum(turned)])
        # Piece by piece from a place of 0, and then moved and turned to the origin.
        ends_m = np.cumsum(self._from_node(np.arange(len(step)), step)[:, :2], axis=0)
        self._place_m = np.concatenate([np.zeros((1, 2)), ends_m])
        x_m, y_m, yaw = self.at(np.zeros(1), np.zeros(1))[0]
        turn = origin[2] - yaw
        cos, sin = math.cos(turn), math.sin(turn)
        self._place_m = (self._place_m - [x_m, y_m]) @ np.array([[cos, sin], [-sin, cos]]) + origin[:2]
        self._heading = self._heading + turn

    @property
    def length_m(self) -> float:
        """Length of all pieces together."""
        return float(self.node_m[-1] - self.node_m[0])

    def bends_m(self) -> list[tuple[float, float]]:
        """Begin and end of each bend."""
        at_m = self.begin_m + np.cumsum([0.0, *(piece[0] for piece in self.pieces)])
        bends = np.array([any(piece[1:]) for piece in self.pieces])
        return [(float(at_m[begin]), float(at_m[end])) for begin, end in runs(bends)]

    def _from_node(self, number: Numbers, beyond_m: Numbers) -> Numbers:
        """(n, 3) change of x, y and heading from (n,) nodes to places beyond them."""
        step = self.node_m[number + 1] - self.node_m[number]
        curvature, rate = self._curvature[number], (self._curvature[number + 1] - self._curvature[number]) / step
        change = np.zeros((len(beyond_m), 3))
        for share, weight in _GAUSS:
            way_m = share * beyond_m
            heading = self._heading[number] + way_m * (curvature + 0.5 * rate * way_m)
            change[:, :2] += (weight * beyond_m * np.stack([np.cos(heading), np.sin(heading)])).T
        change[:, 2] = beyond_m * (curvature + 0.5 * rate * beyond_m)
        return change

    def at(self, way_m: Numbers, left_m: Numbers) -> Numbers:
        """(n, 3) x, y [m] and heading [rad] at (n,) places along the line, and to the left of it."""
        way_m = self.on_loop(way_m)
        number = np.clip(np.searchsorted(self.node_m, way_m, side="right") - 1, 0, len(self.node_m) - 2)
        change = self._from_node(number, way_m - self.node_m[number])
        heading = self._heading[number] + change[:, 2]
        x_m = self._place_m[number, 0] + change[:, 0] - left_m * np.sin(heading)
        y_m = self._place_m[number, 1] + change[:, 1] + left_m * np.cos(heading)
        return np.stack([x_m, y_m, heading], axis=1)

    def on_loop(self, way_m: Numbers) -> Numbers:
        """The same places on the first lap of a loop; unchanged on an open line."""
        return self.begin_m + np.mod(way_m - self.begin_m, self.length_m) if self.is_loop else np.asarray(way_m)

    def curvature_per_m(self, way_m: Numbers, left_m: float = 0.0) -> Numbers:
        """Curvature k / (1 - k y) at (n,) places, to the left positive, of a line to the left of this."""
        curvature = np.interp(self.on_loop(way_m), self.node_m, self._curvature)
        return np.asarray(curvature / (1.0 - curvature * left_m))

    def way_beside_m(self, way_m: Numbers, left_m: float) -> Numbers:
        """(n,) way along a line to the left of this, s - y times the heading, at places; lap after lap on a loop."""
        laps = np.floor((way_m - self.begin_m) / self.length_m) if self.is_loop else 0.0
        heading = self.at(way_m, np.zeros(len(way_m)))[:, 2] + laps * (self._heading[-1] - self._heading[0])
        return np.asarray(way_m - left_m * heading)

    def way_from_beside_m(self, beside_m: Numbers, left_m: float) -> Numbers:
        """Inverse of `way_beside_m` by Newton's steps from between two nodes: from far away they may go to and fro."""
        nodes_m = self.way_beside_m(self.node_m, left_m)
        laps = np.floor((beside_m - nodes_m[0]) / np.ptp(nodes_m)) if self.is_loop else 0.0
        way_m = np.interp(beside_m - laps * np.ptp(nodes_m), nodes_m, self.node_m) + laps * self.length_m
        step_m = np.full(1, np.inf)
        while np.abs(step_m).max() > BESIDE_OFF_M:
            slope = 1.0 - self.curvature_per_m(way_m) * left_m
            step_m = (self.way_beside_m(way_m, left_m) - beside_m) / slope
            way_m = way_m - step_m
        return np.asarray(way_m)

    def sharpest_per_m(self, low_m: float, high_m: float, left_m: float = 0.0) -> float:
        """Largest curvature between two places, whatever its sign, of a line beside this."""
        way_m = np.append(np.arange(low_m, high_m, NODE_M), high_m)
        return float(np.abs(self.curvature_per_m(way_m, left_m)).max())

    def points_m(self, low_m: float, high_m: float, profile: Profile) -> Numbers:
        """(k, 3) points of the line between two places of one lap: straight segments between them are near it."""
        within = self.node_m[(self.node_m > low_m + 0.01) & (self.node_m < high_m - 0.01)]
        way_m = np.concatenate([[low_m], within, [high_m]])
        # A bend has even steps, in which corners of the line are alike.
        more_m = profile.points_m()
        more_m = more_m[(more_m > low_m) & (more_m < high_m)]
        after = np.searchsorted(way_m, more_m)
        far = np.minimum(more_m - way_m[after - 1], way_m[after] - more_m) > NODE_M
        way_m = np.insert(way_m, after[far], more_m[far])
        place_m = self.at(way_m, np.zeros(len(way_m)))[:, :2]
        return np.column_stack([place_m, profile.height_m(self.on_loop(way_m))])

    def speed_limit_m_s(self, direction: int, left_m: float = 0.0) -> tuple[Numbers, Numbers]:
        """Places along a direction of travel, and the speed beside them: v^2 k is `ASIDE_M_S2` in bends.

        Before them v^2 falls by 2 `BEND_BRAKING_M_S2` with the way.
        """
        way_m = np.arange(self.node_m[0], self.node_m[-1], 1.0)
        square = ASIDE_M_S2 / np.maximum(np.abs(self.curvature_per_m(way_m, left_m)), 1e-4)
        if direction < 0:
            way_m, square = -way_m[::-1], square[::-1]
        ahead = np.tile(square, 2 if self.is_loop else 1)
        rise = 2.0 * BEND_BRAKING_M_S2 * np.arange(len(ahead))
        limited = np.minimum.accumulate((ahead + rise)[::-1])[::-1] - rise
        return way_m, np.sqrt(limited[: len(way_m)])


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Heights along a street.

    Attributes:
        node_m: (k,) places
        slope: (k,) slope there, linear between
        begin_m: height at its begin
    """

    node_m: Numbers
    slope: Numbers
    begin_m: float = 0.0

    @property
    def is_level(self) -> bool:
        """Return whether it has no hills."""
        return not self.slope.any()

    def slope_at(self, way_m: Numbers) -> Numbers:
        """Slope at (n,) places of the first lap."""
        return np.interp(way_m, self.node_m, self.slope)

    def height_m(self, way_m: Numbers) -> Numbers:
        """Height at (n,) places of the first lap."""
        return self.begin_m + integral(way_m, self.node_m, self.slope)

    def points_m(self) -> Numbers:
        """Places between which heights are nearly straight: none of a level street."""
        return np.zeros(0) if self.is_level else np.arange(self.node_m[0], self.node_m[-1], 2.0 * NODE_M)


def draw_profile(file: StreetFile, parts_m: Sequence[tuple[float, float]], random: np.random.Generator) -> Profile:
    """Draw hills in parts of a street, which are level at both ends; a loop comes back to its height.

    Args:
        parts_m: begin and end of each, rising
    """
    hills_m = []
    for begin_m, end_m in parts_m:
        ends_m = np.linspace(begin_m, end_m, 1 + math.ceil((end_m - begin_m) / HILL_M))
        hills_m += [(low, high) for low, high in itertools.pairwise(ends_m.tolist())]
    slope = random.uniform(*file.slope_percent, len(hills_m)) / 100.0 * random.choice([-1.0, 1.0], len(hills_m))
    if file.loop:
        length_m = np.array([high - low for low, high in hills_m])
        slope -= (slope * length_m).sum() / length_m.sum()
    nodes = []
    for (low, high), steepest in zip(hills_m, slope.tolist(), strict=True):
        curve_m = CURVE_SHARE * (high - low)
        nodes += [(low, 0.0), (low + curve_m, steepest), (high - curve_m, steepest), (high, 0.0)]
    return Profile(*np.array(nodes).T)


def wind(file: StreetFile, begin_m: float, end_m: float, front_m: float, random: np.random.Generator) -> CentreLine:
    """Draw the bends of an open street from one end to the other; ``front_m`` as of `close`."""
    pieces: list[Piece] = []
    way_m, heading = begin_m, 0.0
    while True:
        straight_m = random.uniform(*file.bend_spacing_m)
        angle = math.radians(random.uniform(*file.bend_deg)) * (1.0 if random.random() < 0.5 else -1.0)
        radius_m = max(random.uniform(*file.bend_radius_m), LEAST_RADIUS * front_m)
        drawn = bend(-angle if abs(heading + angle) > STEEPEST_RAD else angle, radius_m)
        bend_m = sum(piece[0] for piece in drawn)
        if not drawn or way_m + straight_m + bend_m > end_m - file.bend_spacing_m[0]:
            pieces.append((end_m - way_m, 0.0, 0.0))
            return CentreLine(pieces, begin_m)
        pieces += [(straight_m, 0.0, 0.0), *drawn]
        way_m += straight_m + bend_m
        heading += -angle if abs(heading + angle) > STEEPEST_RAD else angle


def close(file: StreetFile, front_m: float, random: np.random.Generator, radius_m: float | None = None) -> CentreLine:
    """Draw a loop of ``length_m``: an L with round corners, whose first side begins at its middle, s = 0.

    Args:
        front_m: distance of the houses from its middle
        radius_m: of the corners, each drawn if None

    Raises:
        InputError: if it is too short for a street of this width
    """
    least_m = LOOP_WIDTHS * front_m
    if file.length_m < least_m:
        raise InputError(
            f"street.length_m: a loop so wide must be >= {math.ceil(least_m)} m long, got {file.length_m:g}"
        )
    # Sides of the L in its directions: along a, across b - q, back p, across q, back a - p, down b.
    aspect, along, across = random.uniform(0.8, 1.25), *random.uniform(0.42, 0.58, 2)
    sides = np.array([aspect, 1.0 - across, along * aspect, across, (1.0 - along) * aspect, 1.0])
    sides /= sides.sum()
    if radius_m is None:
        chosen_m = np.maximum(random.uniform(*file.bend_radius_m, 6), LEAST_RADIUS * front_m)
    else:
        chosen_m = np.full(6, radius_m)
    radii_m = np.minimum(chosen_m, 0.36 * float(sides.min()) * file.length_m)
    turn = 1.0 if random.random() < 0.5 else -1.0
    corners = [bend(turn * sign * 0.5 * math.pi, each) for sign, each in zip(LOOP_TURNS, radii_m, strict=True)]
    bend_m = np.array([sum(piece[0] for piece in corner) for corner in corners])
    tangents_m = np.array([tangent_m(corner) for corner in corners])
    sides *= file.length_m + float((2.0 * tangents_m - bend_m).sum())
    straight_m = sides - tangents_m - np.roll(tangents_m, 1)
    pieces: list[Piece] = [(0.5 * straight_m[0], 0.0, 0.0)]
    for number, corner in enumerate(corners):
        following = straight_m[(number + 1) % 6] * (0.5 if number == 5 else 1.0)
        pieces += [*corner, (float(following), 0.0, 0.0)]
    return CentreLine(pieces, 0.0, is_loop=True)


def tangent_m(pieces: Sequence[Piece]) -> float:
    """Distance from both ends of a bend by a right angle to where its sides would meet."""
    end_m = np.array([sum(piece[0] for piece in pieces)])
    return float(CentreLine(pieces, 0.0).at(end_m, np.zeros(1))[0, 0])


def bend(angle: float, radius_m: float) -> list[Piece]:
    """Clothoid, arc and clothoid that turn by an angle; nothing for none."""
    if angle == 0.0:
        return []
    share = min(CLOTHOID_SHARE, 0.5 * abs(angle))
    curvature = math.copysign(1.0 / radius_m, angle)
    clothoid_m, arc_m = share * radius_m, (abs(angle) - share) * radius_m
    return [(clothoid_m, 0.0, curvature), (arc_m, curvature, curvature), (clothoid_m, curvature, 0.0)]
