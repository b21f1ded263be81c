"""Tables of a scene file for a street: bodies with their instances, the ego vehicle's way, light, sensor and camera.

The same tables become a `Scene` at once, or a scene file that people read and edit, with its meshes and the motions
beside it.
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ... import catalog
from ...maths.arrays import Numbers
from ..derived import merged
from ..ground_area import Outline
from .islands import kerbed_corner_m
from .layout import CORNER_M, CROSS_HALF_M, CROSS_REACH_M, KERB_M, STOP_LINE_M, ZEBRA_M, Block, Layout, Place, lay_out
from .pieces import FOOT_M, PAINT_M, RAISED_M, Tables, ground, placed, rounded, sheet, soil, street_scene, timed_poses
from .shapes import PEOPLE, WALKERS, moving_tables, own_table, shapes, standing_table
from .street_file import StreetFile
from .terrain import PLACES_M, SOIL_BLUR_M, Relief, Terrain
from .traffic import Track, Traffic, drive

CORNER_STEPS = 8
"""Accuracy bought: chords of the round kerb at a corner of a junction, which are 2 cm off."""

ROAD_SPACING_M = 0.4
"""Choice: distance of vertices of roads."""

EVEN_STEP = 1e-5
"""Accuracy bought: difference of two steps from pose to pose, in metres and degrees, up to which the pose between them
is left out: an acceleration of 0.04 mm/s2, which moves by 7 cm in a minute."""

CAR_ROOF_M = 1.48
"""Source: the car's mesh."""

TILTED = ("parked", "hedges", "fences", "barriers")
"""Begins of the names of what stands along the slope of a street; all else is upright."""

WET = {"asphalt": "asphalt_wet", "concrete": "concrete_wet"}
"""Material of the ground -> the same under a film of water."""


def with_street(tables: Mapping[str, Any], file: StreetFile) -> Tables:
    """Return the tables of a scene file with those of its street below them: what the file says itself stays."""
    without_street = {key: value for key, value in tables.items() if key != "street"}
    return merged(street_tables(file), without_street)


@functools.lru_cache(maxsize=4)
def street_tables(file: StreetFile) -> Tables:
    """Lay out a street and its traffic as tables of a scene file, which nobody may change."""
    layout = lay_out(file)
    traffic = drive(layout)
    terrain = None if layout.profile.is_level else Terrain.around(Relief(_places_on_roads(layout), SOIL_BLUR_M))
    return street_scene(
        file.shown_m,
        roof_m=CAR_ROOF_M,
        ego={"poses": _poses(layout, traffic.ego, tilts=False), "at_end": "repeat" if file.loop else "hold"},
        bodies=[
            *(_wetted(body) if file.wet else body for body in _grounds(layout)),
            *([_soil(layout)] if terrain is None else terrain.tables()),
            *_markings([layout, *layout.arms]),
            *_markings(layout.side_streets, "side_"),
            *_standing(layout, terrain),
            own_table("own_car"),
            *_moving(layout, traffic),
        ],
    )


class StreetSummary(NamedTuple):
    """Length and time of a drive along roads, and the numbers of things there."""

    length_m: float
    duration_s: float
    houses: int
    parked_vehicles: int
    vehicles_in_traffic: int
    people: int

    def as_text(self) -> str:
        """One line of text."""
        return (
            f"{self.length_m:g} m of driving in {self.duration_s:g} s; {self.houses} houses, "
            f"{self.parked_vehicles} parked vehicles, {self.vehicles_in_traffic} in traffic, {self.people} people"
        )


def street_summary(tables: Tables) -> StreetSummary:
    """Summarise what the scene of a street or of a road network has."""
    poses = tables["ego"]["poses"]
    chord_m = np.hypot(*np.diff([pose["position_m"][:2] for pose in poses], axis=0).T)
    # Of an arc between two poses, which turns as they do.
    turn = np.radians(np.diff(np.unwrap([pose.get("yaw_deg", 0.0) for pose in poses], period=360.0)))
    counts = Counter(body["name"].split("_")[0] for body in tables["bodies"] for _ in body.get("instances", ()))
    return StreetSummary(
        length_m=round(float((chord_m / np.sinc(0.5 * turn / np.pi)).sum()), 1),
        duration_s=poses[-1]["time_s"],
        houses=counts["houses"],
        parked_vehicles=counts["parked"],
        vehicles_in_traffic=counts["traffic"],
        people=counts["pedestrians"] + counts["walkers"],
    )


def _along(layout: Layout, x_m: float, y_m: float, z_m: float = 0.0, yaw_deg: float = 0.0, *tilt_deg: float) -> Tables:
    """Pose at a place of the street, turned against it, with pitch and roll."""
    ((east_m, north_m, heading),) = layout.line.at(np.array([x_m]), np.array([y_m])).tolist()
    return placed(east_m, north_m, z_m, yaw_deg + math.degrees(heading), *tilt_deg)


def _places_on_roads(layout: Layout) -> Numbers:
    """(n, 3) places on the street and on those that cross it, two metres apart."""
    places = []
    for street in layout.streets:
        across_m = np.linspace(-street.front_m, street.front_m, 2 + int(street.front_m))
        along_m = np.arange(street.begin_m, street.end_m + 0.1, PLACES_M)
        x_m, y_m = (each.ravel() for each in np.meshgrid(along_m, across_m))
        places.append(np.column_stack([street.line.at(x_m, y_m)[:, :2], street.height_m(x_m)]))
    return np.concatenate(places)


def _standing(layout: Layout, terrain: Terrain | None) -> list[Tables]:
    """Bodies of what stands along a street and those that cross it."""
    places = (
        (name, (street, place))
        for street in layout.streets
        for name, of_name in street.items.items()
        for place in of_name
    )
    return [
        standing_table(name, [_stood(street, terrain, name, place) for street, place in stands])
        for name, stands in _by_shape(places).items()
    ]


def _stood(layout: Layout, terrain: Terrain | None, name: str, place: Place) -> Tables:
    """Pose of what stands along a street: houses in the soil, upright; cars, hedges and fences along its slope."""
    x_m, y_m, yaw_deg = place
    if terrain is not None and name.startswith("houses"):
        width_m, front_m, _ = catalog.shipped_meshes()[shapes()[name].mesh]["plot_m"]
        ((east_m, north_m, heading),) = layout.line.at(np.array([x_m]), np.array([y_m])).tolist()
        return _along(layout, x_m, y_m, terrain.lowest_m((east_m, north_m, heading, 0.5 * width_m, front_m)), yaw_deg)
    tilt_deg = layout.tilt_deg(np.array([x_m]), np.array([yaw_deg]))[0] if name.startswith(TILTED) else ()
    return _along(layout, x_m, y_m, 0.0, yaw_deg, *tilt_deg)


def _poses(layout: Layout, track: Track, *, tilts: bool = True) -> list[Tables]:
    """Poses of a track; what rides on its springs tilts by itself."""
    east_m, north_m, heading = layout.line.at(track.x_m, track.y_m).T
    yaw_deg = np.degrees(heading) + track.yaw_deg
    pitch_deg = layout.tilt_deg(track.x_m, track.yaw_deg)[:, 0] if tilts else np.zeros(len(yaw_deg))
    # Between even steps a spline through the others goes the same way.
    states = np.stack([east_m, north_m, np.unwrap(yaw_deg, period=360.0), pitch_deg], axis=1)
    uneven = np.pad(np.abs(np.diff(states, 2, axis=0)).max(axis=1) > EVEN_STEP, 1, constant_values=True)
    kept = uneven | np.roll(uneven, 1) | np.roll(uneven, -1)
    rows = np.stack([track.time_s, east_m, north_m, np.zeros(len(yaw_deg)), yaw_deg, pitch_deg], axis=1)
    return timed_poses(rows[kept])


Thing = TypeVar("Thing")


def _by_shape(things: Iterable[tuple[str, Thing]]) -> dict[str, list[Thing]]:
    """Return named things by the name of their body in `shapes`, in its order; people get one mesh after the other."""
    shaped: dict[str, list[Thing]] = {name: [] for name in shapes()}
    counts: Counter[str] = Counter()
    for name, thing in things:
        shaped[name if name in shaped else f"{name}_{_person(counts[name], thing)}"].append(thing)
        counts[name] += 1
    return {name: of_shape for name, of_shape in shaped.items() if of_shape}


def _person(number: int, thing: object) -> str:
    """Mesh of a person; none with a pram or wheelchair, which are long, where people stand or wait in a row."""
    if isinstance(thing, Track) and bool((np.hypot(np.diff(thing.x_m), np.diff(thing.y_m)) > 0.0).all()):
        return WALKERS[number % len(WALKERS)]
    person = PEOPLE[number % len(PEOPLE)]
    return person if person != "woman_pram" else "woman"


def _moving(layout: Layout, traffic: Traffic) -> list[Tables]:
    """Bodies of all that moves, but for the own car: an instance with a motion for each."""
    at_end = "repeat" if layout.file.loop else "hide"
    return [
        body
        for name, tracks in _by_shape((track.name, track) for track in traffic.others).items()
        for body in moving_tables(name, [{"poses": _poses(layout, track), "at_end": at_end} for track in tracks])
    ]


def _strip(
    layout: Layout, block: Block, number: int, kind: str, width_m: float, offset_m: float, **keys: Any
) -> Tables:
    """Ground along a block, to the left of its middle or around it."""
    side = {0: "", 1: "_left", -1: "_right"}[int(np.sign(offset_m))]
    material = "asphalt" if kind == "road" else "concrete"
    points = layout.line.points_m(block.begin_m, block.end_m, layout.profile)
    sizes = {"line": rounded(points, 4), "width_m": round(width_m, 3), "offset_m": round(offset_m, 4)}
    return ground(f"{kind}_{number}{side}", kind, material, **sizes, **keys)


def _grounds(layout: Layout) -> list[Tables]:
    """Roads, pavements and kerbs."""
    grounds = []
    pavement_m = layout.file.pavement_m
    raised = {"position_m": [0.0, 0.0, RAISED_M], "kerb_m": RAISED_M + FOOT_M}
    blocks = [(street, block) for street in layout.streets for block in street.blocks]
    for number, (street, block) in enumerate(blocks):
        if street.file is layout.file:
            keys = {"crown_m": 0.08, "kerb_m": FOOT_M, "spacing_m": ROAD_SPACING_M}
            grounds.append(_strip(street, block, number, "road", 2.0 * street.kerb_m, 0.0, **keys))
        for kind, width_m, middle_m in (
            ("pavement", pavement_m, street.kerb_m + KERB_M + 0.5 * pavement_m),
            ("kerb", KERB_M, street.kerb_m + 0.5 * KERB_M),
        ):
            ways = _without_corners(layout, block) if street is layout else block
            grounds += [_strip(street, ways, number, kind, width_m, side * middle_m, **raised) for side in (1, -1)]
    crossing = [_along(street, 0.0, 0.0, street.profile.begin_m) for street in layout.side_streets]
    if crossing:
        size_m = [2.0 * CROSS_REACH_M, 2.0 * CROSS_HALF_M]
        grounds.append(
            sheet("cross_roads", "road", "asphalt", size_m, crossing, spacing_m=ROAD_SPACING_M, kerb_m=FOOT_M)
        )
        size_m, y_m = [KERB_M, pavement_m + KERB_M], layout.kerb_m + 0.5 * (KERB_M + pavement_m)
        ends_m = [
            0.5 * (block_m + ways_m)
            for block in layout.blocks
            for ways in [_without_corners(layout, block)]
            for block_m, ways_m in ((block.begin_m, ways.begin_m), (block.end_m, ways.end_m))
            if block_m != ways_m
        ]
        heights_m = (RAISED_M + layout.height_m(np.array(ends_m))).tolist()
        corners = [
            _along(layout, x_m, side * y_m, z_m) for x_m, z_m in zip(ends_m, heights_m, strict=True) for side in (1, -1)
        ]
        grounds.append(sheet("kerbs_of_corners", "kerb", "concrete", size_m, corners, kerb_m=RAISED_M + FOOT_M))
    return grounds + (_junctions(layout) if layout.junctions else [])


def _junctions(layout: Layout) -> list[Tables]:
    """Roads, pavements and kerbs of the junctions at which a loop turns, which are alike."""
    half_m, turn = layout.junctions[0].half_m, np.linspace(0.0, 0.5 * np.pi, CORNER_STEPS + 1)[:, None]
    kerb_m, front_m = layout.kerb_m, layout.front_m
    rounded_m = kerb_m + CORNER_M * (1.0 - np.concatenate([np.cos(turn), np.sin(turn)], axis=1))
    outer_m = np.array([[half_m, kerb_m], [half_m, front_m], [front_m, half_m], [kerb_m, half_m]])
    corner_m = np.pad(np.concatenate([outer_m, rounded_m]), ((0, 0), (0, 1)))
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    edge_m = corner_m[[*range(3, len(corner_m)), 0]][::-1]
    road_m = np.concatenate([edge_m @ np.linalg.matrix_power(quarter, number) for number in range(4)])
    pavement_m, (rim_m,) = kerbed_corner_m(corner_m, Outline(corner_m=road_m, spacing_m=ROAD_SPACING_M))
    places = [
        [
            placed(*junction.middle[:2], z_m, math.degrees(junction.middle[2]) + 90.0 * number)
            for junction in layout.junctions
            for z_m in (layout.height_m(np.array([junction.begin_m])) + raised_m).tolist()
            for number in range(corners)
        ]
        for raised_m, corners in ((0.0, 1), (RAISED_M, 4))
    ]
    raised = {"instances": places[1], "kerb_m": RAISED_M + FOOT_M}
    keys = {"outline": rounded(road_m), "instances": places[0], "spacing_m": ROAD_SPACING_M}
    return [
        ground("junctions", "road", "asphalt", **keys),
        ground("corners", "pavement", "concrete", outline=rounded(pavement_m), **raised),
        ground("kerbs_of_junctions", "kerb", "concrete", outline=rounded(rim_m), **raised),
    ]


def _without_corners(layout: Layout, block: Block) -> Block:
    """Part of a block between the kerbs along the streets that cross at its ends."""
    open_m = {layout.begin_m, layout.end_m, *(end_m for junction in layout.junctions for end_m in junction[:2])}
    return Block(
        block.begin_m + KERB_M * (block.begin_m not in open_m), block.end_m - KERB_M * (block.end_m not in open_m)
    )


def _soil(layout: Layout) -> Tables:
    """Level soil below a street."""
    way_m = np.arange(layout.begin_m, layout.end_m, 10.0)
    return soil(layout.line.at(way_m, np.zeros(len(way_m)))[:, :2])


def _wetted(ground: Tables) -> Tables:
    """Ground under a film of water, if its material has one."""
    return ground | {"material": WET.get(ground["material"], ground["material"])}


def _markings(streets: Sequence[Layout], prefix: str = "") -> list[Tables]:
    """Dashes between lanes, zebras and stop lines of streets that are alike."""
    dashes, stripes, lines, width_m = [], [], [], 0.0
    for street in streets:
        file = street.file
        width_m = file.lanes * file.lane_width_m - 0.3
        for block in street.blocks:
            for x_m in np.arange(block.begin_m + 5.0, block.end_m - 5.0, 6.0).tolist():
                if not block.has_zebra(x_m, 0.5 * ZEBRA_M + STOP_LINE_M + 2.0):
                    numbers = range(1 - file.lanes, file.lanes)
                    dashes += [_along(street, x_m, number * file.lane_width_m, PAINT_M) for number in numbers]
        for crossing in street.crossings:
            if crossing.is_zebra:
                across = range(-int(street.kerb_m - 0.5), int(street.kerb_m - 0.5) + 1)
                stripes += [_along(street, crossing.x_m, number, PAINT_M) for number in across]
            for direction in (1, -1):
                stop_m, middle_m = crossing.stop_x_m(direction), -direction * 0.5 * file.lanes * file.lane_width_m
                if street.begin_m < stop_m < street.end_m:
                    lines.append(_along(street, stop_m + 0.2 * direction, middle_m, PAINT_M))
    keys = {"spacing_m": 0.2, "on_ground": True}
    markings = (
        ("dashes", [3.0, 0.12], dashes),
        ("zebras", [ZEBRA_M, 0.5], stripes),
        ("stop_lines", [0.3, width_m], lines),
    )
    return [
        sheet(prefix + name, "lane_marking", "lane_marking", size_m, places, **keys)
        for name, size_m, places in markings
        if places
    ]
