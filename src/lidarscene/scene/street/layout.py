"""What stands along a street: lanes, crossings, kerbs, houses, trees, parked cars, signs, lamps and people.

Places are counted along the middle of the street, x, and to the left of it, y, whatever its bends; `centre_line` has
them in the world. Traffic keeps to the right, so that y < 0 is the side of those who drive towards +x. Nothing that is
placed here overlaps with anything else: houses have plots, cars have bays, and posts, trees and people share a line
along each kerb. What does not fit where the street bends is left out.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ... import catalog
from ...errors import InputError
from ...maths.arrays import Numbers
from .centre_line import CentreLine, Profile, bend, close, draw_profile, tangent_m, wind
from .shapes import (
    BUSH_ASIDE_M,
    BUSH_SPACING_M,
    BUSHES,
    FURNITURE,
    SIGNS,
    TREE_SCALES,
    District,
    draw_district,
    draw_vehicle,
    vehicle_length_m,
)
from .street_file import StreetFile

BAY_M, PARKING_M = 6.0, 2.3
"""Choice: length of a parking bay, and width of the strip of bays along each kerb."""

CAR_M = (4.45, 2.15)
"""Source: the car's mesh; length and width, with mirrors."""

KERB_M = 0.15
"""Choice: width of a kerb."""

CROSS_LANE_M = 3.2
"""Choice: width of a lane of the streets that cross."""

CROSS_HALF_M = CROSS_LANE_M + 0.8
"""Half the width of the streets that cross."""

CROSS_REACH_M = 70.0
"""Choice: distance from the middle of the street to the end of those that cross."""

QUEUE_M = 1.5
"""Choice: distance from a vehicle that waits on a street that crosses to the kerb's line."""

VERGE_M = 3.0
"""Choice: distance of the house at the end of a street that crosses from that end."""

ZEBRA_M = 4.0
"""Choice: width of a zebra crossing, along the street."""

STOP_LINE_M = 2.0
"""Choice: distance from a stop line to the crossing or the zebra."""

EAVES_M = 0.5
"""Source: the houses' meshes; by how much roofs hang out behind the walls, at most."""

SQUARE_M = 16.0
"""Choice: side of the squares in which rectangles near each other are found."""

PLOT_SHIFT_M = 1.5
"""Choice: way along the street to the next plot that is tried, where a house has no room."""

CALM_SHARE = 0.05
"""Choice: share by which kerbs are shorter or longer than the middle in a bend, up to which cars park and people cross
there."""

TREE_LINE_M, POST_LINE_M, FURNITURE_LINE_M = 1.0, 0.45, 0.75
"""Choice: distance from the kerb to the trunks, to the posts of lamps and signs, and to bins and cabinets."""

WIDEST_PARKED_M = 2.0
"""Choice: width, without mirrors, of what parks in bays."""

PARKED_GAP_M = 0.6
"""Choice: least distance of a parked vehicle to those in the next bays."""

BORDER_M, BORDER_STEP_M, GATE_M = 0.45, 2.08, 2.6
"""Choice: distance of hedges and fences from the pavement, from one piece to the next, and width of a garden's gate."""

GATEPOST_M, GATEPOST_HALF_M = 0.25, 0.24
"""Choice: distance of a gatepost's middle from the end of the hedge or fence, and half the side of the square that it
takes."""

WORKS_SHARE, WORKS_M, CONE_STEP_M = 0.15, 14.0, 3.5
"""Choice: share of sides of blocks where works close parking bays, their length, and distance from cone to cone."""

FURNITURE_M = (18.0, 60.0)
"""Choice: distance between bins, cabinets and poles along a kerb."""

FREE_M = 1.6
"""Choice: least distance between two things in the line along a kerb."""

LEAST_SHARE = 0.1
"""Choice: least length of a kerb inside of a bend, over that of the middle, with which things are set apart."""

CORNER_M = 5.0
"""Choice: radius of the kerbs at the corners of a junction."""

ARM_SHARE = 0.6
"""Choice: length of a street that leads away from a loop, over its shortest side: so none comes near another."""

Place = tuple[float, float, float]
"""x, y [m] and yaw [degrees]."""


@dataclass(frozen=True, slots=True)
class Crossing:
    """A place where others cross the street: a street that crosses, or a zebra.

    Attributes:
        x_m: of its middle
        half_m: from there to its edges along x
    """

    x_m: float
    half_m: float
    is_zebra: bool

    def stop_x_m(self, direction: int) -> float:
        """Where vehicles that drive towards +x (1) or -x (-1) stop."""
        return self.x_m - direction * (self.half_m + STOP_LINE_M)


@dataclass(frozen=True, slots=True)
class Block:
    """The street between two that cross, along x.

    Attributes:
        zebras_m: x of the zebras in it
    """

    begin_m: float
    end_m: float
    zebras_m: tuple[float, ...] = ()

    @property
    def length_m(self) -> float:
        """Length along x."""
        return self.end_m - self.begin_m

    def has_zebra(self, x_m: float, within_m: float) -> bool:
        """Return whether a zebra is nearer to a place than this."""
        return any(abs(x_m - zebra_m) < within_m for zebra_m in self.zebras_m)


class Junction(NamedTuple):
    """Crossroads at which a loop turns.

    Attributes:
        begin_m, end_m: of the bend that the vehicle drives there
        half_m: half the side of its square, at whose edges the four streets begin
        middle: x, y [m] and heading [rad] of those who come
    """

    begin_m: float
    end_m: float
    half_m: float
    middle: tuple[float, float, float]

    @classmethod
    def at_bend(cls, line: CentreLine, begin_m: float, end_m: float) -> Junction:
        """Return the junction around a bend by a right angle."""
        begin, end = line.at(np.array([begin_m, end_m]), np.zeros(2))
        ahead = np.array([np.cos(begin[2]), np.sin(begin[2])])
        half_m = float((end - begin)[:2] @ ahead)
        return cls(begin_m, end_m, half_m, (*(begin[:2] + half_m * ahead).tolist(), float(begin[2])))


@dataclass(slots=True)
class Layout:
    """A street without its traffic.

    Attributes:
        kerb_m: |y| of the road's edges
        line: the middle of the street
        room: what is taken around it
        profile: its heights
        items: name of a body -> places of its instances
        side_streets: those that cross it, each with s = 0 at its middle and blocks on both sides
        junctions: at which it turns, of a loop that has them
        arms: streets like it that lead away from a junction, with s = 0 in its middle
    """

    file: StreetFile
    kerb_m: float
    front_m: float
    begin_m: float
    end_m: float
    line: CentreLine
    room: Room
    profile: Profile = field(init=False)
    crossings: list[Crossing] = field(default_factory=list)
    blocks: list[Block] = field(default_factory=list)
    items: dict[str, list[Place]] = field(default_factory=dict)
    side_streets: list[Layout] = field(default_factory=list)
    junctions: list[Junction] = field(default_factory=list)
    arms: list[Layout] = field(default_factory=list)

    @property
    def streets(self) -> tuple[Layout, ...]:
        """The street itself and all others."""
        return (self, *self.side_streets, *self.arms)

    def add(self, name: str, x_m: float, y_m: float, yaw_deg: float = 0.0) -> None:
        """Place an instance of a body."""
        self.items.setdefault(name, []).append((x_m, y_m, yaw_deg))

    def take(self, x_m: float, y_m: float, *half_m: float) -> bool:
        """Take the room around a place, half lengths along the street and across it, if it is free."""
        return self.room.take(_boxes(self.line, [(x_m, y_m, *half_m)]))

    def height_m(self, x_m: Numbers) -> Numbers:
        """Heights at (n,) places along the street."""
        return self.profile.height_m(self.line.on_loop(x_m))

    def tilt_deg(self, x_m: Numbers, yaw_deg: Numbers) -> Numbers:
        """(n, 2) pitch and roll of what stands along the slope at a yaw against the street."""
        slope, yaw = self.profile.slope_at(self.line.on_loop(x_m)), np.radians(yaw_deg)
        tilts = np.stack([slope * np.cos(yaw), -slope * np.sin(yaw)], axis=1)
        return np.asarray(np.degrees(np.arctan(tilts)) + 0.0)

    def bends(self, low_m: float, high_m: float) -> bool:
        """Return whether the street bends too sharply between two places for cars to park or people to cross."""
        return self.line.sharpest_per_m(low_m, high_m) * self.kerb_m > CALM_SHARE

    def lane_m(self, lane: int, direction: int) -> float:
        """Y of the middle of a lane, 0 the innermost, for traffic towards +x (1) or -x (-1)."""
        return -direction * (lane + 0.5) * self.file.lane_width_m

    def walk_m(self, direction: int) -> float:
        """Distance of people who walk towards +x (1) or -x (-1) from the middle of the street."""
        return self.front_m - (0.6 if direction > 0 else 1.3)


def lay_out(file: StreetFile) -> Layout:
    """Lay out a street; the same for the same file.

    Raises:
        InputError: if it cannot have the corners of the file, or is too short for a loop of its width
    """
    kerb_m = file.lanes * file.lane_width_m + PARKING_M
    front_m = kerb_m + KERB_M + file.pavement_m
    # What hides is never beyond the road's ends, nor is a driver who looks for room to stop there.
    margin_m = 0.0 if file.loop else file.shown_m + 60.0
    begin_m, end_m = -margin_m, file.length_m + margin_m
    plan = np.random.default_rng([file.seed, 3])
    radius_m = _junction_radius_m(file, kerb_m, front_m) if file.corners == "junctions" else None
    line = close(file, front_m, plan, radius_m) if file.loop else wind(file, begin_m, end_m, front_m, plan)
    step_m = 0.5 * CROSS_HALF_M
    # Houses may stand at its edge.
    half_m = 0.6 * step_m, front_m - 0.05
    room = Room(_boxes(line, [(x_m, 0.0, *half_m) for x_m in np.arange(begin_m, end_m, step_m) + 0.5 * step_m]))
    layout = Layout(file, kerb_m, front_m, begin_m, end_m, line, room)
    random = np.random.default_rng([file.seed, 1])
    if file.corners == "junctions":
        _lay_junctions(layout)
    ends_m = [place_m for junction in layout.junctions for place_m in junction[:2]]
    for first_m, last_m in np.reshape([begin_m, *ends_m, end_m], (-1, 2)).tolist():
        _cut_into_blocks(layout, first_m, last_m, random)
    parts_m = [(block.begin_m, block.end_m) for block in layout.blocks]
    layout.profile = draw_profile(file, parts_m, np.random.default_rng([file.seed, 6]))
    main = draw_district(random)
    for block in layout.blocks:
        district = draw_district(random, main)
        for side in (-1, 1):
            _park_cars(layout, block, side, random)
            _build_houses(layout, block, side, district, random)
            _line_kerb(layout, block, side, district, random)
    aside = np.random.default_rng([file.seed, 9])
    for crossing in layout.crossings:
        if crossing.half_m == CROSS_HALF_M:  # and no junction
            layout.side_streets.append(_lay_side_street(layout, crossing, draw_district(aside, main), aside))
    for number, arm in enumerate(layout.arms):
        for side in (-1, 1):
            _park_cars(arm, arm.blocks[0], side, aside)
        _line_street(layout, arm, layout.junctions[number // 2].begin_m, draw_district(aside, main), aside)
    _plant_bushes(layout, np.random.default_rng([file.seed, 7]))
    return layout


def _junction_radius_m(file: StreetFile, kerb_m: float, front_m: float) -> float:
    """Radius of bends in squares that hold round kerbs and end beyond the pavements."""
    if not file.loop:
        raise InputError('street.corners: "junctions" needs loop = true')
    if "bend_radius_m" in file.model_fields_set:
        raise InputError(
            'street.bend_radius_m: cannot be combined with corners = "junctions", whose bends have one radius'
        )
    return max(kerb_m + CORNER_M, (front_m + KERB_M) / tangent_m(bend(0.5 * math.pi, 1.0)))


def _lay_side_street(layout: Layout, crossing: Crossing, district: District, random: np.random.Generator) -> Layout:
    """Lay out a street that crosses another: kerbs, houses where there is room, and one before each of its ends."""
    ((x_m, y_m, heading),) = layout.line.at(np.array([crossing.x_m]), np.zeros(1)).tolist()
    length_m = 2.0 * CROSS_REACH_M
    line = CentreLine([(length_m, 0.0, 0.0)], -CROSS_REACH_M, origin=(x_m, y_m, heading + 0.5 * np.pi))
    file = layout.file.model_copy(update={"lanes": 1, "lane_width_m": CROSS_LANE_M})
    front_m = CROSS_HALF_M + KERB_M + file.pavement_m
    street = Layout(file, CROSS_HALF_M, front_m, -CROSS_REACH_M, CROSS_REACH_M, line, layout.room)
    street.crossings = [Crossing(0.0, layout.kerb_m + QUEUE_M - STOP_LINE_M, is_zebra=False)]
    street.blocks = [Block(-CROSS_REACH_M, -layout.front_m), Block(layout.front_m, CROSS_REACH_M)]
    _line_street(layout, street, crossing.x_m, district, random)
    return street


def _lay_junctions(layout: Layout) -> None:
    """Lay crossroads at the bends of a loop, and streets that lead straight on and straight back from there."""
    line = layout.line
    junctions = [Junction.at_bend(line, *bend_m) for bend_m in line.bends_m()]
    begin_m, end_m, half_m = np.array([junction[:3] for junction in junctions]).T
    sides_m = np.mod(np.roll(begin_m, -1) - end_m, line.length_m) + half_m + np.roll(half_m, -1)
    reach_m = min(CROSS_REACH_M, ARM_SHARE * float(sides_m.min()))
    for junction in junctions:
        middle_m, half_m = 0.5 * (junction.begin_m + junction.end_m), junction.half_m
        layout.crossings.append(Crossing(middle_m, middle_m - junction.begin_m, is_zebra=False))
        layout.room.add(np.array([[*junction.middle, half_m, half_m]]))
        leaving = float(line.at(np.array([junction.end_m]), np.zeros(1))[0, 2])
        for heading in (junction.middle[2], leaving + np.pi):
            arm_line = CentreLine([(reach_m, 0.0, 0.0)], 0.0, origin=(*junction.middle[:2], heading))
            arm = Layout(layout.file, layout.kerb_m, layout.front_m, half_m, reach_m, arm_line, layout.room)
            arm.crossings, arm.blocks = [Crossing(0.0, half_m, is_zebra=False)], [Block(half_m, reach_m)]
            half_length_m = 0.5 * (reach_m - half_m)
            layout.room.add(_boxes(arm_line, [(half_m + half_length_m, 0.0, half_length_m, layout.front_m - 0.05)]))
            layout.arms.append(arm)
    layout.junctions = junctions


def _line_street(layout: Layout, street: Layout, way_m: float, district: District, random: np.random.Generator) -> None:
    """Line a street that leaves another at a place of that: kerbs and houses, and one house before each of its ends."""
    height_m = float(layout.height_m(np.array([way_m]))[0])
    street.profile = Profile(np.array([street.begin_m, street.end_m]), np.zeros(2), height_m)
    for block in street.blocks:
        towards = math.copysign(1.0, block.begin_m)
        for side in (-1, 1):
            _build_houses(street, block, side, district, random)
            _line_kerb(street, block, side, district, random)
        house, wall = random.choice(district.houses), random.choice(district.walls)
        width_m, front_m, _ = catalog.shipped_meshes()[house]["plot_m"]
        end_m = towards * (street.end_m + VERGE_M + front_m)
        if street.take(end_m, 0.0, front_m + EAVES_M, 0.5 * width_m):
            street.add(f"houses_{house}_{wall}", end_m, 0.0, 180.0 if towards > 0.0 else 0.0)


class Room:
    """Rectangles that are taken, (n, 5): x, y, yaw [rad], half length and width; listed by squares that they touch."""

    def __init__(self, boxes: Numbers) -> None:
        self._squares: dict[tuple[int, int], list[Numbers]] = {}
        self.add(boxes)

    def add(self, boxes: Numbers) -> None:
        """Take rectangles whatever is there."""
        for box in boxes:
            for square in _squares(box):
                self._squares.setdefault(square, []).append(box)

    def is_free(self, boxes: Numbers) -> bool:
        """Return whether rectangles overlap with none that is taken."""
        for box in boxes:
            near = [taken for square in _squares(box) for taken in self._squares.get(square, ())]
            if near and overlaps(box, np.array(near)).any():
                return False
        return True

    def take(self, boxes: Numbers) -> bool:
        """Take rectangles if all of them are free."""
        free = self.is_free(boxes)
        if free:
            self.add(boxes)
        return free


def _squares(box: Numbers) -> Iterator[tuple[int, int]]:
    """Yield the squares of `SQUARE_M` that the circle around a rectangle may touch."""
    x_m, y_m, _, *half_m = box.tolist()
    reach_m = math.hypot(*half_m)
    columns, rows = (
        range(math.floor((at_m - reach_m) / SQUARE_M), math.floor((at_m + reach_m) / SQUARE_M) + 1)
        for at_m in (x_m, y_m)
    )
    return itertools.product(columns, rows)


def _boxes(line: CentreLine, places: Sequence[tuple[float, ...]]) -> Numbers:
    """Rectangles at x and y along a street, with half lengths along and across it."""
    x_m, y_m, *half_m = np.array(places).T
    return np.concatenate([line.at(x_m, y_m), np.stack(half_m, axis=1)], axis=1)


def overlaps(box: Numbers, boxes: Numbers) -> Numbers:
    """Whether a rectangle overlaps each of (n, 5) others: x, y, yaw [rad] and half length and width.

    Two rectangles are apart if they are so along an axis of the one or of the other.
    """
    rows = np.concatenate([np.broadcast_to(box, boxes.shape)[None], boxes[None]])
    cos, sin = np.cos(rows[..., 2]), np.sin(rows[..., 2])
    axes = np.stack([np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)], axis=2)
    apart = boxes[:, :2] - box[:2]
    meets = np.ones(len(boxes), dtype=bool)
    for axis in (axes[owner, :, side] for owner in (0, 1) for side in (0, 1)):
        shadow = np.einsum("onsk,nk->ons", axes, axis)
        reach_m = (np.abs(shadow) * rows[..., 3:]).sum(axis=(0, 2))
        meets &= np.abs(np.einsum("nk,nk->n", apart, axis)) < reach_m
    return meets


def _cut_into_blocks(layout: Layout, begin_m: float, end_m: float, random: np.random.Generator) -> None:
    """Place crossing streets between two places where there is room, zebras between them, and the blocks left."""
    file, part_m = layout.file, begin_m
    zebras_m: list[float] = []
    while True:
        middle_m = part_m + random.uniform(*file.block_m) + CROSS_HALF_M
        is_last = middle_m + CROSS_HALF_M + file.block_m[0] > end_m
        part_end_m = end_m if is_last else middle_m - CROSS_HALF_M
        if random.random() < file.zebra_share and part_end_m - part_m > 60.0:
            x_m = random.uniform(part_m + 25.0, part_end_m - 25.0)
            if not layout.bends(x_m - ZEBRA_M, x_m + ZEBRA_M):
                layout.crossings.append(Crossing(x_m, 0.5 * ZEBRA_M, is_zebra=True))
                zebras_m.append(x_m)
        part_m = middle_m + CROSS_HALF_M
        if is_last or _crosses(layout, middle_m):
            layout.blocks.append(Block(begin_m, part_end_m, tuple(zebras_m)))
            if is_last:
                return
            layout.crossings.append(Crossing(middle_m, CROSS_HALF_M, is_zebra=False))
            begin_m, zebras_m = part_m, []


def _crosses(layout: Layout, middle_m: float) -> bool:
    """Return whether a street can cross here: where this one is straight, and nothing is in its way."""
    if layout.line.sharpest_per_m(middle_m - CROSS_HALF_M - 2.0, middle_m + CROSS_HALF_M + 2.0) > 0.0:
        return False
    half_m = 0.5 * (CROSS_REACH_M - layout.front_m), CROSS_HALF_M + KERB_M + layout.file.pavement_m - 0.05
    arms = [(middle_m, side * (layout.front_m + half_m[0]), half_m[1], half_m[0]) for side in (-1, 1)]
    return layout.room.take(_boxes(layout.line, arms))


def _park_cars(layout: Layout, block: Block, side: int, random: np.random.Generator) -> None:
    """Park vehicles in bays, none near a crossing or a zebra, nor where works close them."""
    share = random.uniform(*layout.file.parked_share)
    y_m = side * (layout.kerb_m - 0.5 * PARKING_M)
    works_m = _close_bays(layout, block, side, random)
    for x_m in np.arange(block.begin_m + 8.0, block.end_m - 8.0 - BAY_M, BAY_M) + 0.5 * BAY_M:
        body, paint, shift_m, turn_deg, parks = random.random(5)
        is_closed = block.has_zebra(x_m, 5.0 + BAY_M) or abs(x_m - works_m) < 0.5 * WORKS_M + BAY_M
        if parks >= share or is_closed or layout.bends(x_m - BAY_M, x_m + BAY_M):
            continue
        longest_m = BAY_M - PARKED_GAP_M
        name = draw_vehicle("parked", body, paint, longest_m=longest_m, widest_m=WIDEST_PARKED_M)
        place_m = x_m + (shift_m - 0.5) * (longest_m - vehicle_length_m(name))
        layout.add(name, place_m, y_m, (180.0 if side > 0 else 0.0) + 2.0 * (turn_deg - 0.5))


def _close_bays(layout: Layout, block: Block, side: int, random: np.random.Generator) -> float:
    """Close parking bays for works, with cones and a barrier at each end; return their middle, infinite without any."""
    share, place = random.random(2)
    x_m = block.begin_m + 20.0 + place * max(block.length_m - 40.0, 0.0)
    is_open = share >= WORKS_SHARE or block.length_m < 60.0 or block.has_zebra(x_m, 5.0 + WORKS_M)
    if is_open or layout.bends(x_m - WORKS_M, x_m + WORKS_M):
        return np.inf
    for along_m in np.arange(-0.5 * WORKS_M, 0.5 * WORKS_M + 0.1, CONE_STEP_M):
        layout.add("cones", x_m + along_m, side * (layout.kerb_m - PARKING_M + 0.35))
    for end_m in (-0.5 * WORKS_M, 0.5 * WORKS_M):
        layout.add("barriers", x_m + 0.9 * end_m, side * (layout.kerb_m - 1.1), 180.0 * (end_m < 0.0))
    return float(x_m)


def _build_houses(layout: Layout, block: Block, side: int, district: District, random: np.random.Generator) -> None:
    """Build houses on plots side by side where there is room; a plot without one may have a tree."""
    file, meshes = layout.file, catalog.shipped_meshes()
    share = random.uniform(*file.house_share)
    x_m = block.begin_m + 1.0 + file.pavement_m
    while True:
        house, wall, tree = (random.choice(each) for each in (district.houses, district.walls, district.trees))
        width_m, front_m, reach_m = meshes[house]["plot_m"]
        is_built, setback_m = random.random() < share, random.uniform(*file.setback_m) + district.garden_m
        if x_m + width_m > block.end_m - 1.0 - file.pavement_m:
            return
        middle_m = x_m + 0.5 * width_m
        house_y_m, tree_y_m = layout.front_m + setback_m + front_m, layout.front_m + reach_m
        if is_built:
            half_m = 0.5 * width_m, front_m + 0.5 * EAVES_M
            if not layout.take(middle_m, side * (house_y_m + 0.5 * EAVES_M), *half_m):
                x_m += PLOT_SHIFT_M
                continue
            layout.add(f"houses_{house}_{wall}", middle_m, side * house_y_m, -90.0 * side)
            if district.border:
                _border_garden(layout, district, side, x_m, width_m)
            wall_m, edge_m = house_y_m - front_m, max(house_y_m - reach_m, layout.front_m)
            if edge_m < wall_m:  # no bush grows into what hangs out
                below = middle_m, side * 0.5 * (wall_m + edge_m), 0.5 * width_m, 0.5 * (wall_m - edge_m)
                layout.room.add(_boxes(layout.line, [below]))
        elif random.random() < 0.7:
            yaw_deg, reach_m = random.uniform(0.0, 360.0), meshes[tree]["reach_m"]
            if layout.take(middle_m, side * tree_y_m, reach_m, reach_m):
                layout.add(f"trees_{tree}_{len(TREE_SCALES) - 1}", middle_m, side * tree_y_m, yaw_deg)
        x_m += width_m + 0.1


def _border_garden(layout: Layout, district: District, side: int, x_m: float, width_m: float) -> None:
    """Place a hedge or a fence along a plot where there is room, with two posts of a gate in a gap in its middle."""
    middle_m, y_m = x_m + 0.5 * width_m, side * (layout.front_m + BORDER_M)
    pieces = [("gateposts", 0.5 * GATE_M - GATEPOST_M, (GATEPOST_HALF_M, GATEPOST_HALF_M))]
    for number in range(int((width_m - GATE_M) // (2.0 * BORDER_STEP_M))):
        away_m = 0.5 * GATE_M + (number + 0.5) * BORDER_STEP_M
        pieces.append((f"{district.border}s", away_m, (0.5 * BORDER_STEP_M - 0.005, 0.75 * BORDER_M)))
    for name, away_m, half_m in pieces:
        for place_m in (middle_m - away_m, middle_m + away_m):
            if layout.take(place_m, y_m, *half_m):
                layout.add(name, place_m, y_m, 90.0 * side)


def _plant_bushes(layout: Layout, random: np.random.Generator) -> None:
    """Plant bushes where nothing else is beside the pavements."""
    reach_m = catalog.shipped_meshes()["bush"]["reach_m"]
    for side in (-1, 1):
        for x_m, aside_m, name in drawn_bushes(random, layout.begin_m, layout.end_m):
            y_m = side * (layout.front_m + aside_m)
            if layout.take(x_m, y_m, reach_m, reach_m):
                layout.add(name, x_m, y_m, random.uniform(0.0, 360.0))


def drawn_bushes(random: np.random.Generator, begin_m: float, end_m: float) -> Iterator[tuple[float, float, str]]:
    """Yield places along a road for bushes, their distances from its edge, and the names of their bodies."""
    for place_m in spaced(random, BUSH_SPACING_M, begin_m, end_m):
        yield place_m, random.uniform(*BUSH_ASIDE_M), random.choice(list(BUSHES))


def spaced(
    random: np.random.Generator, spacing_m: tuple[float, float], begin_m: float, end_m: float, first: float = 1.0
) -> Iterator[float]:
    """Yield places with a drawn distance from one to the next.

    Args:
        first: share of a distance from the begin to the first of them
    """
    place_m = begin_m + first * random.uniform(*spacing_m)
    while place_m < end_m:
        yield place_m
        place_m += random.uniform(*spacing_m)


def _line_kerb(layout: Layout, block: Block, side: int, district: District, random: np.random.Generator) -> None:
    """Place traffic lights, lamps, signs, bins, trees and people who stand along a kerb.

    They are placed in this order where they come too close.
    """
    file, places = layout.file, functools.partial(_free_places, layout, block, [])
    towards_deg = 180.0 if side < 0 else 0.0
    for zebra_m in block.zebras_m:
        for shift_m in (-3.3, -2.6, 2.6, 3.3):
            layout.add("bollards", zebra_m + shift_m, side * (layout.kerb_m + 0.35))
        # The one who drives towards the zebra on this side sees the sign's face.
        layout.add("sign_squares", zebra_m + side * 4.2, side * (layout.kerb_m + POST_LINE_M), towards_deg)
    for crossing in layout.crossings:
        # By the stop line, to the right of those who wait there and see its lamps.
        stop_m = crossing.stop_x_m(-side)
        if not crossing.is_zebra and block.begin_m < stop_m < block.end_m:
            layout.add("lights", stop_m, side * (layout.kerb_m + POST_LINE_M), towards_deg)
    for x_m in places(file.lamp_spacing_m, random):
        layout.add("lamp_posts", x_m, side * (layout.kerb_m + POST_LINE_M), -90.0 * side)
    for x_m in places(file.sign_spacing_m, random):
        layout.add(f"{random.choice(SIGNS)}s", x_m, side * (layout.kerb_m + POST_LINE_M), towards_deg)
    for x_m in places(FURNITURE_M, random):
        layout.add(f"{random.choice(FURNITURE)}s", x_m, side * (layout.kerb_m + FURNITURE_LINE_M), -90.0 * side)
    room_m = KERB_M + file.pavement_m - TREE_LINE_M
    meshes = [(tree, catalog.shipped_meshes()[tree]) for tree in district.trees]
    trees = [
        f"trees_{tree}_{number}"
        for tree, mesh in meshes
        for number, scale in enumerate(TREE_SCALES)
        if scale * mesh["reach_m"] <= room_m and mesh.get("by_kerb", True)
    ]
    for x_m in places(file.tree_spacing_m, random):
        if trees:
            yaw_deg = random.uniform(0.0, 360.0)
            layout.add(random.choice(trees), x_m, side * (layout.kerb_m + TREE_LINE_M), yaw_deg)
    for x_m in places(file.standing_spacing_m, random):
        # Who stands on a narrow pavement leaves room for those who walk there.
        y_m = side * (layout.kerb_m + random.uniform(0.7, min(1.0, file.pavement_m - 1.9)))
        layout.add("pedestrians", x_m, y_m, random.uniform(0.0, 360.0))


def _free_places(
    layout: Layout, block: Block, taken_m: list[float], spacing_m: tuple[float, float], random: np.random.Generator
) -> Iterator[float]:
    """Yield places along the line by a kerb one after the other, those left out that are taken, and take them."""
    # On the inner side of a bend things stand closer than along the middle of the street.
    curvature_per_m = layout.line.sharpest_per_m(block.begin_m, block.end_m)
    free_m = FREE_M / max(1.0 - curvature_per_m * (layout.kerb_m + TREE_LINE_M), LEAST_SHARE)
    x_m = block.begin_m + 3.0 + random.random() * spacing_m[0]
    while x_m < block.end_m - 3.0:
        if all(abs(x_m - each_m) >= free_m for each_m in taken_m) and not block.has_zebra(x_m, 6.0):
            taken_m.append(x_m)
            yield x_m
        x_m += max(random.uniform(*spacing_m), free_m)
