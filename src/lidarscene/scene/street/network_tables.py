"""Tables of a scene file for a road network of SUMO: surfaces, kerbs and markings of its lanes, and its traffic."""

from __future__ import annotations

import math
import zlib
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from ... import catalog
from ...errors import OptionWarning, warn
from ...maths.arrays import Numbers
from ..ground import SPACING_M, Strip
from ..ground_area import Outline
from . import sumo
from .islands import islands_between_m, kerbed_corner_m, ring_island_m
from .layout import EAVES_M, KERB_M, POST_LINE_M, Room, drawn_bushes, spaced
from .pieces import (
    FOOT_M,
    PAINT_M,
    RAISED_M,
    Tables,
    box_places_m,
    ground,
    placed,
    rounded,
    sheet,
    soil,
    street_scene,
    timed_poses,
)
from .polylines import along, beside, on_line, poses_along, way_length_m, ways_m
from .shapes import (
    PEOPLE,
    TREE_SCALES,
    District,
    draw_district,
    moving_tables,
    own_table,
    paint_at,
    shapes,
    standing_table,
)
from .street_file import StreetFile
from .sumo import LaneGroup, Network, RoadUser
from .terrain import PLACES_M, SOIL_BLUR_M, STOREY_M, Relief, Terrain

EDGE_M = 0.05
"""Choice: distance from the edge of a road at which another one would be between it and a house."""

RAIL_M_S, RAIL_M, RAIL_ASIDE_M = 19.0, 4.0, 0.7
"""Choice: speed from which on roads without a pavement have guard rails, 70 km/h; length of a piece, and its distance
from the edge of the road."""

UNDER_M, OVER_M = 4.0, 12.0
"""Choice: distances from a road above, up to which there are no markings, and from one below, up to which there are
rails."""

Island = tuple[Numbers, str]
"""(k, 3) corners of an island, and its material."""

PIER_M, PIER_ASIDE_M, PIER_SUNK_M, PIER_BELOW_M = 0.8, 2.0, 0.5, 0.03
"""Choice: side of a bridge's square piers, their distance from the road below, depth of their feet, and distance of
their heads from the top of the road above."""

SEARCH_M = 0.5
"""Choice: distance of places along a road at which a road below it is looked for."""

VERGE_M = 3.0
"""Choice: distance of houses from the edge of a road without a pavement."""

LINE_M = 0.12
"""Choice: width of lines on the road."""

ASIDE_M = 0.2
"""Choice: distance of a line at the edge of the road from that edge."""

DASH_M, DASHES_M = 3.0, 6.0
"""Choice: length of a dash of a line, and from dash to dash."""

STRIPE_M, MARK_SPACING_M = 0.5, 0.2
"""Choice: width of a zebra's stripe, and distance of vertices of markings."""

POINTS_M, RIM_M = 5.0, 1.0
"""Accuracy bought: distance of points of lanes that lie on a relief, and of corners of junctions."""

CLOSE_M = 0.1
"""Choice: distance from the end of a lane within which a junction's corner has its height."""

SLOPE_M = 2.0
"""Choice: distance over which the slope below a vehicle is taken."""

SLOWEST_M_S = 3.0
"""Choice: mean speed of the ego vehicle, waits included, that a simulation of drawn trips has time for."""

ALIKE_M = 0.3
"""Choice: by how much a body may be farther from a vehicle's length than the nearest one."""

NetworkKind = Literal["opendrive", "osm", "sumo", "town"]


def network_scene(
    source: Path | int, kind: NetworkKind, file: StreetFile, *, ego: str | None = None, left_hand: bool = False
) -> Tables:
    """Lay out a road network and its simulated traffic as tables of a scene file.

    Args:
        source: OpenDRIVE file, OpenStreetMap file or SUMO's configuration; number of streets of a drawn town
        file: what stands along the roads; the seed is that of drawn trips, too
        ego: SUMO's name of the vehicle that carries the sensor; that which drives for longest, if it is not said
        left_hand: whether the traffic of an OpenStreetMap file keeps to the left

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    with TemporaryDirectory(prefix="lidarscene-") as name:
        folder = Path(name)
        if kind == "sumo":
            assert isinstance(source, Path)
            scenario = sumo.read_scenario(source)
            network = sumo.read_network(scenario.network)
        else:
            loop: Sequence[str] = ()
            if kind == "town":
                assert isinstance(source, int)
                low, high = (0.01 * percent for percent in file.slope_percent)
                origin = f"town {source}"
                net, loop = sumo.draw_town(source, folder, seed=file.seed, slopes=(low, high))
            else:
                assert isinstance(source, Path)
                net, origin = sumo.convert(source, kind, folder, left_hand=left_hand), str(source)
            network = sumo.read_network(net)
            gap_m = float(np.mean(file.oncoming_gap_m))
            routes, ego, way_m = sumo.draw_routes(
                network, net, origin=origin, bodies=_drawn_bodies(), seed=file.seed, gap_m=gap_m, loop=loop
            )
            scenario = sumo.drawn_scenario(origin, net, routes, seed=file.seed, last_s=60.0 + way_m / SLOWEST_M_S)
        own, others = sumo.simulate(scenario, ego=ego, shown_m=file.shown_m, folder=folder)
    near = _near(network, own, file.shown_m + 50.0)
    # Junctions of converted networks are level, whatever the slope of the lanes that lead there.
    relief = Relief(np.concatenate(_places_on_lanes(near)))
    terrain = None
    if not relief.is_level:
        near = _on_relief(near, relief)
        relief = Relief(np.concatenate([*_places_on_lanes(near), *_places_on_areas(near)]), SOIL_BLUR_M)
        terrain = Terrain.around(relief)
    islands = _islands(near)
    return street_scene(
        file.shown_m,
        roof_m=catalog.vehicles()[shapes()[_look(own)].mesh].size_m[2],
        ego=_motion(own, relief, at_end="hold", tilts=False),
        bodies=[
            *_grounds(near, islands),
            *([soil(relief.place_m[:, :2])] if terrain is None else terrain.tables()),
            *([] if terrain is None else _piers(near, relief, terrain)),
            *_markings(near, relief, islands),
            *_surroundings(near, file, relief, terrain),
            own_table(_look(own)) | {"name": "own_car"},
            *_moving(others, relief),
        ],
    )


def _near(network: Network, own: RoadUser, reach_m: float) -> Network:
    """Return what of a network is within reach of the ego vehicle's way."""
    way_m = np.array(own.rows)[:: max(1, len(own.rows) // 500), 1:3]

    def is_near(points_m: Numbers) -> bool:
        # Long straight roads have few points.
        step_m = np.hypot(*np.diff(points_m[:, :2], axis=0).T)
        share = np.linspace(0.0, 1.0, 2 + int(step_m.max() / 20.0))[:, None, None]
        dense_m = (points_m[:-1, :2] + share * np.diff(points_m[:, :2], axis=0)).reshape(-1, 2)
        return bool((np.hypot(*(dense_m[:, None] - way_m).transpose(2, 0, 1)) < reach_m).any())

    return network._replace(
        groups=[group for group in network.groups if is_near(group.line_m)],
        junctions=[corners_m for corners_m in network.junctions if is_near(corners_m)],
        corners=[corners_m for corners_m in network.corners if is_near(corners_m)],
        crossings=[crossing for crossing in network.crossings if is_near(crossing[0])],
    )


def _places_on_lanes(network: Network) -> list[Numbers]:
    """(n, 3) places on roads and pavements, some two metres apart."""
    places = []
    for group in network.groups:
        way_m = np.linspace(0.0, way_length_m(group.line_m), 2 + int(way_length_m(group.line_m) / PLACES_M))
        places += [_places_across(group, at_m) for at_m in way_m.tolist()]
    return places


def _places_across(group: LaneGroup, way_m: float) -> Numbers:
    """(n, 3) places across lanes, some two metres apart."""
    left_m = np.linspace(-0.5, 0.5, 2 + int(group.width_m / PLACES_M)) * group.width_m
    return beside(group.line_m, np.full(len(left_m), way_m), left_m)


def _places_on_areas(network: Network) -> list[Numbers]:
    """(n, 3) places on junctions and the pavements beside them, some two metres apart."""
    outlines = [Outline(corner_m=each, spacing_m=PLACES_M) for each in (*network.junctions, *network.corners)]
    return [outline.triangulated()[0] for outline in outlines if outline.is_usable()]


def _on_relief(network: Network, relief: Relief) -> Network:
    """Return a network whose lanes and junctions meet in height."""

    def on_it(points_m: Numbers) -> Numbers:
        return np.column_stack([points_m[:, :2], relief.height_m(points_m, points_m[:, 2])])

    def dense(line_m: Numbers) -> Numbers:
        counts = np.ceil(np.diff(ways_m(line_m)) / POINTS_M).astype(int).tolist()
        place = np.concatenate(
            [*(number + np.arange(count) / count for number, count in enumerate(counts)), [len(counts)]]
        )
        return np.stack([np.interp(place, np.arange(len(line_m)), column) for column in line_m.T], axis=1)

    groups = [group._replace(line_m=on_it(dense(group.line_m))) for group in network.groups]
    ends = [_places_across(group, at_m) for group in groups for at_m in (0.0, way_length_m(group.line_m))]
    ends_m = np.concatenate(ends)

    def between_ends(outline_m: Numbers) -> Numbers:
        corners_m = Outline(corner_m=outline_m, spacing_m=RIM_M).rim_m()
        weight = 1.0 / (((corners_m[:, None, :2] - ends_m[:, :2]) ** 2).sum(axis=-1) + CLOSE_M**2) ** 2
        weight = weight * (np.abs(corners_m[:, None, 2] - ends_m[:, 2]) < STOREY_M) + 1e-12
        return np.column_stack([corners_m[:, :2], weight @ ends_m[:, 2] / weight.sum(axis=1)])

    return network._replace(
        groups=groups,
        junctions=[between_ends(outline_m) for outline_m in network.junctions],
        corners=[between_ends(outline_m) for outline_m in network.corners],
    )


def _bodies_of(kind: str) -> list[catalog.VehicleBody]:
    """Bodies that vehicles of a class of SUMO may have; those of cars if it has none, as a tram with the sensor."""
    classes = sumo.class_entry(kind)["bodies"] or sumo.CLASSES["passenger"]["bodies"]
    return [body for body in catalog.vehicles().values() if body.class_name in classes]


def _drawn_bodies() -> dict[str, tuple[str, float, float, float]]:
    """Bodies of drawn traffic: SUMO's class, length, width and share of the vehicles."""
    found = {}
    for kind, entry in sumo.CLASSES.items():
        bodies = _bodies_of(kind) if "share" in entry else ()
        for body in bodies:
            found[body.name] = kind, body.size_m[0], body.size_m[1], entry["share"] / len(bodies)
    return found


def _look(mover: RoadUser) -> str:
    """Name in `shapes` of a vehicle, by class and length, or of a person; the same for the same name."""
    number = zlib.crc32(mover.name.encode())
    if mover.kind == "wheelchair":
        return "walkers_wheelchair_user"
    if mover.kind == "pedestrian":
        return f"walkers_{PEOPLE[number % len(PEOPLE)]}"
    apart_m = {body.name: abs(body.size_m[0] - mover.length_m) for body in _bodies_of(mover.kind)}
    alike = [name for name, apart in apart_m.items() if apart <= min(apart_m.values()) + ALIKE_M]
    return f"traffic_{alike[number % len(alike)]}_{paint_at((number // 64) % 9973 / 9973)}"


def _motion(mover: RoadUser, relief: Relief, *, at_end: str, tilts: bool = True) -> Tables:
    """Motion of a vehicle or person with the slope of a relief; one that rides on its springs tilts by itself."""
    rows = np.array(mover.rows)
    height_m, pitch_deg = np.zeros(len(rows)), np.zeros(len(rows))
    if not relief.is_level:
        yaw = np.radians(rows[:, 3])
        ahead_m = 0.5 * SLOPE_M * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        rear_m, height_m, front_m = (relief.height_m(rows[:, 1:3] + k * ahead_m, rows[:, 4]) for k in (-1.0, 0.0, 1.0))
        pitch_deg = tilts * np.degrees(np.arctan2(front_m - rear_m, SLOPE_M))
    poses = timed_poses(np.column_stack([rows[:, :3], height_m, rows[:, 3], pitch_deg]))
    return {"poses": poses, "at_end": at_end} | ({} if relief.is_level else {"storeys": True})


def _moving(movers: Sequence[RoadUser], relief: Relief) -> list[Tables]:
    """Bodies of all that moves, but for the own car: an instance with a motion for each."""
    if lacking := sorted(kind for kind in {mover.kind for mover in movers} if not sumo.class_entry(kind)["bodies"]):
        warn(OptionWarning("vehicles of {0} have no body and are left out", " and ".join(lacking)))
    motions: defaultdict[str, list[Tables]] = defaultdict(list)
    for mover in movers:
        if mover.kind not in lacking:
            motions[_look(mover)].append(_motion(mover, relief, at_end="hide"))
    names = sorted(motions, key=lambda name: (shapes()[name].mesh, name))
    return [body for name in names for body in moving_tables(name, motions[name])]


def _strip(
    name: str, class_name: str, material: str, line_m: Numbers, width_m: float, offset_m: float = 0.0, **keys: Any
) -> Tables:
    """Ground along a line; points at which it bends too sharply for its width are left out."""
    kept_m = line_m
    while len(kept_m) > 2:
        plan = Strip(line_m=kept_m, width_m=width_m, offset_m=offset_m, spacing_m=1.0)
        corner_m = plan.sharp_corner()
        if corner_m is None:
            break
        number = int(np.argmin(np.hypot(*(kept_m - corner_m)[:, :2].T)))
        kept_m = np.delete(kept_m, min(max(number, 1), len(kept_m) - 2), axis=0)
    sizes = {"line": rounded(kept_m), "width_m": round(width_m, 3), "offset_m": round(offset_m, 3)}
    return ground(name, class_name, material, **sizes, **keys)


def _area(name: str, class_name: str, material: str, corners_m: Numbers, **keys: Any) -> list[Tables]:
    """Ground within an outline; none where that crosses itself or is as thin as a line."""
    if not Outline(corner_m=np.array(rounded(corners_m)), spacing_m=SPACING_M).is_usable():
        return []
    return [ground(name, class_name, material, outline=rounded(corners_m), **keys)]


def _grounds(network: Network, islands: Sequence[Island]) -> list[Tables]:
    """Roads, pavements and their corners with kerbs, junctions, and islands of roundabouts and between lanes."""
    grounds = []
    raised = {"position_m": [0.0, 0.0, RAISED_M], "kerb_m": RAISED_M + FOOT_M}
    for number, group in enumerate(network.groups):
        if group.kind != "pavement":
            of = f"road_{number}", "road", "asphalt" if group.kind == "road" else "concrete"
            grounds.append(_strip(*of, group.line_m, group.width_m, kerb_m=FOOT_M, spacing_m=0.4))
            continue
        # The kerb is on the left, where the road is.
        width_m = group.width_m - KERB_M
        name, line_m = f"pavement_{number}", group.line_m
        grounds += [
            _strip(name, "pavement", "concrete", line_m, width_m, -0.5 * KERB_M, **raised),
            _strip(f"kerb_{number}", "kerb", "concrete", line_m, KERB_M, 0.5 * width_m, **raised),
        ]
    middles_m = np.array([corners_m.mean(axis=0) for corners_m in network.corners]).reshape(-1, 3)[:, :2]
    kerbed: dict[int, tuple[Numbers, list[Numbers]]] = {}
    for number, corners_m in enumerate(network.junctions):
        junction = Outline(corner_m=corners_m, spacing_m=SPACING_M)
        within = np.flatnonzero(junction.contains(middles_m)).tolist()
        kerbed |= {corner: kerbed_corner_m(network.corners[corner], junction) for corner in within}
        # Pavements at a junction have faces down along its outline themselves.
        grounds += _area(f"junction_{number}", "road", "asphalt", corners_m, **({} if within else {"kerb_m": FOOT_M}))
    for number, corners_m in enumerate(network.corners):
        pavement_m, kerbs = kerbed.get(number, (corners_m, []))
        grounds += _area(f"corner_{number}", "pavement", "concrete", pavement_m, **raised)
        for side, kerb_m in enumerate(kerbs):
            grounds += _area(f"kerb_corner_{number}_{side}", "kerb", "concrete", kerb_m, **raised)
    for number, (island_m, material) in enumerate(islands):
        class_name = "terrain" if material == "soil" else "pavement"
        grounds += _area(f"island_{number}", class_name, material, island_m, **raised)
    return grounds


def _islands(network: Network) -> list[Island]:
    """Corners and material of the islands of roundabouts, and of those between lanes of opposite directions."""
    roads = {group.edge: group for group in network.groups if group.kind == "road"}
    # Of a ring that is near in part there is no outline.
    rings = [[roads[edge] for edge in sorted(ring)] for ring in network.rings if ring <= roads.keys()]
    pairs = [(roads[one], roads[other]) for one, other in network.opposite if {one, other} <= roads.keys()]
    return [
        *((ring_island_m(ring), "soil") for ring in rings),
        *((island_m, "concrete") for pair in pairs for island_m in islands_between_m(*pair)),
    ]


def _piers(network: Network, relief: Relief, terrain: Terrain) -> list[Tables]:
    """Piers below each road on both sides of another one that it passes over."""
    piers: list[Tables] = []
    for group in network.groups:
        way_m = np.arange(0.5 * SEARCH_M, way_length_m(group.line_m), SEARCH_M)
        over = relief.has_storey(on_line(group.line_m, way_m), above=False, beside_m=PIER_ASIDE_M)
        sides_m = way_m[1:][np.diff(over)] if group.kind == "road" else way_m[:0]
        tops_m = on_line(group.line_m, sides_m)[:, 2] - PIER_BELOW_M
        feet_m = terrain.height_m(on_line(group.line_m, sides_m)[:, :2]) - PIER_SUNK_M
        for (x_m, y_m, heading), top_m, foot_m in zip(
            along(group.line_m, sides_m).tolist(), tops_m.tolist(), feet_m.tolist(), strict=True
        ):
            pose = placed(x_m, y_m, 0.5 * (top_m + foot_m), math.degrees(heading))
            keys = {"primitive": "box", "class": "building", "material": "concrete"}
            piers.append(
                {"name": f"pier_{len(piers)}", **keys, "size_m": [PIER_M, PIER_M, round(top_m - foot_m, 3)], **pose}
            )
    return piers


def _markings(network: Network, relief: Relief, islands: Sequence[Island]) -> list[Tables]:
    """Lines at the edges of roads and between lanes, stop lines, and zebras at crossings; none below bridges."""
    keys: Tables = {"spacing_m": MARK_SPACING_M, "on_ground": True}
    markings = []
    marks: defaultdict[tuple[str, float, float], list[Tables]] = defaultdict(list)
    for number, group in enumerate(network.groups):
        length_m = way_length_m(group.line_m)
        if group.kind != "road" or length_m < DASHES_M:
            continue
        ends_m = along(group.line_m, np.array([0.2, length_m - 0.2]))[:, :2]
        between = np.abs(ways_m(group.line_m) - 0.5 * length_m) < 0.5 * length_m - 0.25
        within_m = np.concatenate([ends_m[:1], group.line_m[between, :2], ends_m[1:]])
        line_m = np.pad(within_m, ((0, 0), (0, 1)), constant_values=PAINT_M)
        edge_m = 0.5 * group.width_m - ASIDE_M
        between[[0, -1]] = True
        covered = relief.has_storey(group.line_m[between], above=True, beside_m=UNDER_M)
        for run in np.split(np.arange(len(line_m)), np.flatnonzero(covered)):
            piece_m = line_m[run[~covered[run]]]
            for side, offset_m in (("right", -edge_m), ("left", edge_m)) if len(piece_m) > 1 else ():
                name = f"line_{number}_{side}" + (f"_{run[0]}" if run[0] else "")
                markings.append(_strip(name, "lane_marking", "lane_marking", piece_m, LINE_M, offset_m, **keys))
        way_m = np.arange(0.5 * DASHES_M, length_m - 0.5 * DASHES_M, DASHES_M)
        way_m = way_m[~relief.has_storey(on_line(group.line_m, way_m), above=True, beside_m=UNDER_M)]
        for border_m in np.cumsum(group.widths_m)[:-1].tolist():
            left_m = border_m - 0.5 * group.width_m
            marks["dashes", DASH_M, LINE_M] += poses_along(group.line_m, way_m, left_m, z_m=PAINT_M)
        if group.ends_at_lights:
            key = "stop_lines", 0.3, round(group.width_m - 2.0 * ASIDE_M, 2)
            marks[key] += poses_along(group.line_m, np.array([length_m - 0.4]), z_m=PAINT_M)
    raised = [*network.corners, *(island_m for island_m, _ in islands)]
    pavements = [Outline(corner_m=corners_m, spacing_m=SPACING_M) for corners_m in raised]
    low_m, high_m = (
        np.array([side(corners_m[:, :2], axis=0) for corners_m in raised]).reshape(-1, 2) for side in (np.min, np.max)
    )
    for shape_m, width_m in network.crossings:
        stripe_m, way_m = width_m - 0.5, np.arange(0.75, way_length_m(shape_m) - 0.5, 2.0 * STRIPE_M)
        # Where a crossing is oblique, its first stripes would lie on the kerb in part.
        off_kerb = [
            not any(pavements[near].contains(places_m).any() for near in np.flatnonzero(beside).tolist())
            for x_m, y_m, heading in along(shape_m, way_m).tolist()
            for places_m in [box_places_m((x_m, y_m, heading, 0.5 * STRIPE_M, 0.5 * stripe_m), MARK_SPACING_M)]
            for beside in [((low_m < places_m.max(axis=0)) & (high_m > places_m.min(axis=0))).all(axis=1)]
        ]
        way_m = way_m[np.array(off_kerb, dtype=bool)]
        marks["zebras", stripe_m, STRIPE_M] += poses_along(shape_m, way_m, z_m=PAINT_M, turn_deg=90.0)
    return markings + [
        sheet(f"{name}_{number}", "lane_marking", "lane_marking", size_m, places, **keys)
        for number, ((name, *size_m), places) in enumerate(marks.items())
        if places
    ]


def _surroundings(network: Network, file: StreetFile, relief: Relief, terrain: Terrain | None) -> list[Tables]:
    """Houses, trees, lamps, lights and guard rails along roads, on both sides, where there is room."""
    roadside = _Roadside(network, file, terrain)
    roadside.lights(network)
    for group in network.groups:
        roadside.parapets(group, relief)
    main = draw_district(roadside.random)
    for group in network.groups:
        district = draw_district(roadside.random, main)
        for side in (group.outside,) if any(group.edge in ring for ring in network.rings) else (-1, 1):
            roadside.rails(group, side)
            roadside.line(group, side, district)
    for group in network.groups:
        for side in (-1, 1):
            roadside.bushes(group, side)
    return [standing_table(name, places) for name, places in sorted(roadside.items.items()) if places]


class _Roadside:
    """What stands beside roads, and the room that it and the roads take.

    Attributes:
        items: name of a body -> places
    """

    def __init__(self, network: Network, file: StreetFile, terrain: Terrain | None) -> None:
        self.random = np.random.default_rng([file.seed, 5])
        self._terrain = terrain
        self.items: defaultdict[str, list[Tables]] = defaultdict(list)
        self._file = file
        boxes = []
        for group in network.groups:
            length_m = way_length_m(group.line_m)
            count = max(1, math.ceil(length_m / 5.0))
            half_m = np.broadcast_to([0.6 * length_m / count, 0.5 * group.width_m], (count, 2))
            boxes.append(np.hstack([along(group.line_m, (np.arange(count) + 0.5) * length_m / count), half_m]))
        for corners_m in network.junctions:
            low_m, high_m = corners_m[:, :2].min(axis=0), corners_m[:, :2].max(axis=0)
            boxes.append(np.array([[*0.5 * (low_m + high_m), 0.0, *0.5 * (high_m - low_m)]]))
        self._roads, self._room = Room(np.concatenate(boxes)), Room(np.concatenate(boxes))

    def lights(self, network: Network) -> None:
        """Place traffic lights where lanes end at them, outside of these and of cycle paths beside them."""
        for group in network.groups:
            if group.kind == "road" and group.ends_at_lights:
                beside = [each for each in network.groups if each.edge == group.edge and each.kind == "cycle_path"]
                aside_m = 0.5 * group.width_m + sum(each.width_m for each in beside) + POST_LINE_M
                left_m = group.outside * aside_m
                way_m = np.array([max(way_length_m(group.line_m) - 0.5, 0.0)])
                self._room.take(np.hstack([along(group.line_m, way_m, left_m), [[0.2, 0.2]]]))
                self.items["lights"] += poses_along(group.line_m, way_m, left_m, turn_deg=180.0)

    def parapets(self, group: LaneGroup, relief: Relief) -> None:
        """Place guard rails on both sides of a road where it passes over another."""
        if group.kind != "road":
            return
        way_m = np.arange(0.5 * RAIL_M, way_length_m(group.line_m), RAIL_M)
        way_m = way_m[relief.has_storey(on_line(group.line_m, way_m), above=False, beside_m=OVER_M)]
        for side in (-1.0, 1.0):
            left_m = side * (0.5 * group.width_m - 0.5 * ASIDE_M)
            self.items["guard_rails"] += poses_along(group.line_m, way_m, left_m, turn_deg=-90.0 * side)

    def rails(self, group: LaneGroup, side: float) -> None:
        """Place guard rails along one side of a fast road, where nothing else is."""
        if group.kind == "road" and group.speed_m_s >= RAIL_M_S:
            for way_m in np.arange(0.5 * RAIL_M, way_length_m(group.line_m), RAIL_M).tolist():
                left_m = side * (0.5 * group.width_m + RAIL_ASIDE_M)
                self._place("guard_rails", group, (way_m, left_m), (0.49 * RAIL_M, 0.1), -90.0 * side)

    def line(self, group: LaneGroup, side: float, district: District) -> None:
        """Place houses, trees and lamps along one side of a road, where nothing else is."""
        random, file, meshes = self.random, self._file, catalog.shipped_meshes()
        length_m, share = way_length_m(group.line_m), random.uniform(*file.house_share)
        edge_m = 0.5 * group.width_m
        for way_m in spaced(random, file.lamp_spacing_m, 0.0, length_m, 0.5):
            self._place("lamp_posts", group, (way_m, side * (edge_m + POST_LINE_M)), (0.2, 0.2), -90.0 * side)
        way_m = 0.0
        while way_m < length_m:
            house, wall, tree = (random.choice(each) for each in (district.houses, district.walls, district.trees))
            width_m, front_m, _ = meshes[house]["plot_m"]
            verge_m = district.garden_m + (2.0 * POST_LINE_M if group.kind == "pavement" else VERGE_M)
            aside_m, turn_deg = edge_m + verge_m + random.uniform(*file.setback_m), random.uniform(0.0, 360.0)
            if random.random() < share:
                name, half_m, turn_deg = f"houses_{house}_{wall}", (0.5 * width_m, front_m + EAVES_M), -90.0 * side
            else:
                reach_m = meshes[tree]["reach_m"]
                name, half_m = f"trees_{tree}_{len(TREE_SCALES) - 1}", (reach_m, reach_m)
            place_m = way_m + half_m[0], side * (aside_m + half_m[1])
            way_m += width_m + 0.1 if self._place(name, group, place_m, half_m, turn_deg) else 2.0

    def bushes(self, group: LaneGroup, side: float) -> None:
        """Plant bushes along one side of a road, where nothing else is."""
        reach_m = catalog.shipped_meshes()["bush"]["reach_m"]
        for way_m, aside_m, name in drawn_bushes(self.random, 0.0, way_length_m(group.line_m)):
            place_m = way_m, side * (0.5 * group.width_m + aside_m)
            self._place(name, group, place_m, (reach_m, reach_m), self.random.uniform(0.0, 360.0))

    def _place(
        self, name: str, group: LaneGroup, place_m: tuple[float, float], half_m: tuple[float, float], turn_deg: float
    ) -> bool:
        """Place a thing along a road and to the left of it, if nothing is there, nor another road between the two."""
        way_m, left_m = place_m
        ((x_m, y_m, heading),) = along(group.line_m, np.array([way_m]), left_m).tolist()
        verge_m = 0.5 * group.width_m + EDGE_M, abs(left_m)
        between = along(group.line_m, np.array([way_m]), math.copysign(0.5 * sum(verge_m), left_m))
        beside = np.hstack([between, [[half_m[0], 0.5 * (verge_m[1] - verge_m[0])]]])
        free = self._roads.is_free(beside) and self._room.take(np.array([[x_m, y_m, heading, *half_m]]))
        if free:
            z_m = 0.0
            if self._terrain is not None and name.startswith("houses"):
                z_m = self._terrain.lowest_m((x_m, y_m, heading, *half_m))
            self.items[name].append(placed(x_m, y_m, z_m, math.degrees(heading) + turn_deg))
        return free
