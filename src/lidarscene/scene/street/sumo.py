"""Road networks and traffic by SUMO: its programs convert maps and simulate, its library reads networks.

SUMO (Alvarez Lopez et al., "Microscopic traffic simulation using SUMO", IEEE ITSC 2018) is the extra ``traffic``. Its
coordinates are metres in the plane, x east and y north; a vehicle's place is the middle of its front, its angle is
clockwise from north (FCD output).
"""

from __future__ import annotations

import gzip
import itertools
import math
import os
import re
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from ... import catalog
from ...errors import InputError, OptionWarning, warn
from ...files.inputs import require_file
from ...files.optional import import_optional
from ...maths.arrays import Numbers
from ...maths.vectors import cross_in_plane

MEMORY_GIB = 4.0
"""Choice: memory that SUMO's programs may take: a long road of tiny pieces would take all there is."""

HEADER_BYTES = 32
"""Source: OpenStreetMap's PBF format: its first block says within these bytes what it is."""

WITH_LIMIT = (
    "import os, resource, sys; limit = int(sys.argv[1]); resource.setrlimit(resource.RLIMIT_AS, (limit, limit)); "
    "os.execv(sys.argv[2], sys.argv[2:])"
)
"""Program that limits its memory and becomes another."""

LAYER_M = 6.0
"""Choice: height of a layer of OpenStreetMap above the one below: lorries, 4.7 m of clear height, and a deck."""

POSE_S = 0.5
"""Choice: time from pose to pose of a motion, or SUMO's own step if that is longer."""

STEP_S = 0.1
"""Choice: step of a simulation that says none."""

LANE_CHANGE_S = 3.0
"""Choice: time of a lane change in a simulation that says none; without it vehicles would jump aside."""

TOWN_BLOCK_M, TOWN_SHIFT_M, RING_M = 110.0, 12.0, 16.0
"""Choice: distance between the streets of a drawn town, by how much its junctions are off, and radius of its
roundabout."""

SPREAD_M, SPREAD_WAY_M, REFUGE_SHARE = (1.2, 0.8), 20.0, 0.4
"""Choice: half the width of islands between the lanes of a drawn town at its roundabout, and at crossings of other
junctions; distance over which lanes spread for them; and share of those junctions."""

PLAIN_OUTPUT = (
    *("--output-prefix", "", "--human-readable-time", "false"),
    *("--fcd-output.geo", "false", "--fcd-output.attributes", "x,y,z,angle,speed,type,vehicle"),
)
"""Arguments of SUMO that undo what a configuration says of its own outputs: names, clocks, degrees and columns."""

TURN_M_S2 = 3.0
"""Choice: acceleration towards the middle of a turn at a junction of a drawn town."""

LOOP_CORNERS = ((-1, -1), (1, -1), (1, 0), (0, 0), (0, 1), (-1, 1))
"""Choice: corners of the ego vehicle's way in a drawn town, an L around the roundabout, at which it turns six times."""

SHARPEST_CORNER_DEG = 135.0
"""Choice: turn of a pavement's outline from which on it may be folded."""

FOLDED_SHARE = 0.05
"""Choice: largest share of an outline's area that goes with a folded corner."""

LEAP_M_S = 10.0
"""Choice: by how much a way from one pose to the next is faster than a vehicle where SUMO has moved it elsewhere."""

SHARPEST_TURN_DEG = 120.0
"""Choice: turn from one pose to the next beyond which another is put between them."""

CLASSES: Mapping[str, Mapping[str, Any]] = catalog.street_parts()["sumo"]
"""SUMO's class -> length, classes of bodies and share, by streets.toml."""

LONG_NAMES = {
    "n": "net-file",
    "net": "net-file",
    "r": "route-files",
    "routes": "route-files",
    "a": "additional-files",
    "additional": "additional-files",
}
"""Source: SUMO's options; other name in a configuration -> name that is read here."""

DEFAULT_TYPES = {"DEFAULT_BIKETYPE": "bicycle", "DEFAULT_PEDTYPE": "pedestrian"}
"""SUMO's own types of vehicles that are no cars -> their class."""

MOTOR_CLASSES = ("passenger", "bus", "delivery", "truck", "motorcycle", "taxi")

Row = tuple[float, float, float, float, float]
"""Time [s], x and y [m] of the middle, yaw [degrees], height of the road [m]."""

LaneKind = Literal["road", "cycle_path", "pavement"]


class LaneGroup(NamedTuple):
    """Lanes of one kind side by side.

    Attributes:
        kind: of its surface
        line_m: (k, 3) points along its middle
        widths_m: of its lanes, from right to left
        edge: SUMO's name of the road in this direction
        ends_at_lights: whether vehicles stop at its end for traffic lights
        speed_m_s: allowed there
        outside: side of the road's edge: -1 right, 1 left, where traffic keeps to the left
    """

    kind: LaneKind
    line_m: Numbers
    widths_m: tuple[float, ...]
    edge: str
    ends_at_lights: bool
    speed_m_s: float
    outside: Literal[-1, 1] = -1

    @property
    def width_m(self) -> float:
        """Width of all lanes."""
        return sum(self.widths_m)


class Network(NamedTuple):
    """Surfaces of a road network.

    Attributes:
        junctions: (k, 3) corners of each
        corners: (k, 3) corners of each piece of pavement at a junction
        crossings: (k, 3) points along the middle of each, and its width
        roads: lengths of the roads that cars may take, by SUMO's names
        walks: SUMO's names of roads with a pavement
        rings: SUMO's names of the roads around each roundabout
        opposite: SUMO's names of the two directions of each road that has both
    """

    groups: list[LaneGroup]
    junctions: list[Numbers]
    corners: list[Numbers]
    crossings: list[tuple[Numbers, float]]
    roads: dict[str, float]
    walks: list[str]
    rings: list[frozenset[str]]
    opposite: list[tuple[str, str]]


@dataclass(slots=True)
class RoadUser:
    """A vehicle or person while it is near the ego vehicle, without a break.

    Attributes:
        name: SUMO's
        kind: SUMO's class
        rows: where it is at rising times
    """

    name: str
    kind: str
    length_m: float
    rows: list[Row] = field(default_factory=list)


def class_entry(kind: str) -> Mapping[str, Any]:
    """Length and bodies of a class of SUMO; those of cars where it does not say."""
    return {key: CLASSES.get(kind, {}).get(key, CLASSES["passenger"][key]) for key in ("length_m", "bodies")}


def convert(map_file: Path, kind: Literal["opendrive", "osm"], folder: Path, *, left_hand: bool = False) -> Path:
    """Convert an OpenDRIVE or OpenStreetMap file to a network of SUMO in ``folder``; a warning says what it leaves out.

    Args:
        left_hand: whether traffic keeps to the left; of OpenDRIVE, netconvert would mirror each road with its pavements

    Raises:
        InputError: if it cannot be converted
    """
    require_file(map_file)
    with map_file.open("rb") as file:
        start = file.read(HEADER_BYTES)
    if kind == "osm" and (start.startswith(b"BZh") or b"OSMHeader" in start):
        must = "must be XML (.osm, .osm.xml), as it is or by gzip"
        raise InputError(f"{map_file}: {must}: 'osmium cat {map_file.name} -o map.osm' turns it into that")
    if kind == "opendrive" and b'rule="LHT"' in map_file.read_bytes():
        warn(OptionWarning("{0}: traffic keeps to the left there (rule LHT), and is put on the right here", map_file))
    network = folder / "converted.net.xml"
    maps = _home() / "data" / "typemap"
    types = ",".join(str(maps / f"opendriveNetconvert{kind}.typ.xml") for kind in ("", "Pedestrians", "Bicycle"))
    options = {
        "opendrive": ["--opendrive.curve-resolution", "1.0", "--type-files", types, "--ignore-errors"],
        "osm": [
            *("--geometry.remove", "--ramps.guess", "--junctions.join"),
            *("--tls.guess-signals", "--tls.join", "--sidewalks.guess", "--crossings.guess"),
            *("--osm.layer-elevation", f"{LAYER_M:g}", "--lefthand", str(left_hand)),
        ],
    }[kind]
    files = [f"--{kind}-files", str(map_file), "-o", str(network), "--no-warnings"]
    errors = _run("netconvert", [*files, *options], str(map_file))
    if errors:
        warn(OptionWarning("{0}: netconvert left out what it cannot convert: {1}", map_file, errors[0]))
    return network


def draw_town(streets: int, folder: Path, *, seed: int, slopes: tuple[float, float]) -> tuple[Path, list[str]]:
    """Draw a town of streets in both directions, with lights at some junctions and a roundabout, as a network of SUMO.

    Args:
        streets: in each direction
        folder: of the network's file
        slopes: least and largest difference of heights between neighbouring junctions, over their distance

    Returns:
        The network's file, and the names of the roads of a loop with six turns, the first of them again at its end.
    """
    random = np.random.default_rng([seed, 8])
    place_m = TOWN_BLOCK_M * np.stack(np.meshgrid(*[np.arange(streets, dtype=float)] * 2, indexing="ij"), axis=-1)
    place_m += random.uniform(-TOWN_SHIFT_M, TOWN_SHIFT_M, place_m.shape)
    # Up or down from each row and column to the next: neighbours differ by one of the steps.
    step_m = TOWN_BLOCK_M * random.uniform(*slopes, (2, streets)) * random.choice([-1.0, 1.0], (2, streets))
    height_m = np.cumsum(step_m[0])[:, None] + np.cumsum(step_m[1])
    nodes = ElementTree.Element("nodes")
    edges = ElementTree.Element("edges")

    def node(name: str, x_m: float, y_m: float, z_m: float, kind: str) -> None:
        keys = {"id": name, "x": f"{x_m:.2f}", "y": f"{y_m:.2f}", "z": f"{z_m:.2f}", "type": kind}
        ElementTree.SubElement(nodes, "node", keys)

    def edge(begin: str, end: str, **keys: str) -> None:
        keys = {"id": f"{begin}_{end}", "from": begin, "to": end, "numLanes": "1", "speed": "13.89", **keys}
        ElementTree.SubElement(edges, "edge", keys)

    middle = streets // 2
    ring: list[tuple[float, str]] = []
    names, roads = {}, {}
    for i, j in np.ndindex(streets, streets):
        names[i, j] = f"n{i}_{j}"
        if (i, j) != (middle, middle):
            x_m, y_m = place_m[i, j].tolist()
            node(names[i, j], x_m, y_m, height_m[i, j], str(random.choice(["traffic_light", "priority"])))
    spread_m = SPREAD_M[1] * (random.random((streets, streets)) < REFUGE_SHARE)
    spread_m[middle, middle] = SPREAD_M[0]
    for i, j in np.ndindex(streets, streets):
        for k, m in ((i + 1, j), (i, j + 1)):
            if k < streets and m < streets:
                ends, rows = [], []
                for here, there in (((i, j), (k, m)), ((k, m), (i, j))):
                    ends.append(names[here])
                    end_m = place_m[here]
                    if here == (middle, middle):
                        way_m = place_m[there] - place_m[here]
                        ends[-1] = f"ring{len(ring)}"
                        ring.append((float(np.arctan2(way_m[1], way_m[0])), ends[-1]))
                        end_m = end_m + RING_M * way_m / np.hypot(*way_m)
                    rows.append((*end_m, height_m[here], spread_m[here]))
                edge(*ends, shape=_spread(*rows))
                edge(*ends[::-1], shape=_spread(*rows[::-1]))
                roads[(i, j), (k, m)], roads[(k, m), (i, j)] = "_".join(ends), "_".join(ends[::-1])
    x_m, y_m = place_m[middle, middle]
    ring.sort()
    for number, (begin, name) in enumerate(ring):
        end, following = ring[(number + 1) % len(ring)]
        turn = np.linspace(begin, begin + (end - begin) % (2.0 * np.pi), 12)
        arc = zip(x_m + RING_M * np.cos(turn), y_m + RING_M * np.sin(turn), strict=True)
        node(name, x_m + RING_M * np.cos(begin), y_m + RING_M * np.sin(begin), height_m[middle, middle], "priority")
        shape = " ".join(f"{east_m:.2f},{north_m:.2f},{height_m[middle, middle]:.2f}" for east_m, north_m in arc)
        edge(name, following, shape=shape, speed="8.3", priority="2")
    around = [f"{name}_{ring[(number + 1) % len(ring)][1]}" for number, (_, name) in enumerate(ring)]
    keys = {"nodes": " ".join(name for _, name in ring), "edges": " ".join(around)}
    ElementTree.SubElement(edges, "roundabout", keys)
    files = [folder / f"drawn.{kind}.xml" for kind in ("nod", "edg", "net")]
    for path, root in zip(files, (nodes, edges), strict=False):
        ElementTree.ElementTree(root).write(path, encoding="utf-8")
    options = ["--sidewalks.guess", "--crossings.guess", "--no-warnings", "--default.priority", "1"]
    options += ["--junctions.limit-turn-speed", f"{TURN_M_S2:g}"]
    _run("netconvert", ["-n", str(files[0]), "-e", str(files[1]), "-o", str(files[2]), *options], f"town {streets}")
    reach = (streets - 1) // 2
    passed = [
        (middle + i + step * int(np.sign(k - i)), middle + j + step * int(np.sign(m - j)))
        for (i, j), (k, m) in itertools.pairwise(reach * np.array([*LOOP_CORNERS, LOOP_CORNERS[0]]))
        for step in range(abs(k - i) + abs(m - j))
    ]
    return files[2], [roads[step] for step in itertools.pairwise([*passed, *passed[:2]])]


def _spread(begin: Sequence[float], end: Sequence[float]) -> str:
    """Shape of a road's left edge, to the right of the line between two ends there, as SUMO's files have it.

    Args:
        begin, end: x, y and height of each end, and distance to the right [m]
    """
    length_m = math.hypot(end[0] - begin[0], end[1] - begin[1])
    share = np.array([0.0, SPREAD_WAY_M, length_m - SPREAD_WAY_M, length_m]) / length_m
    line_m = np.array(begin[:3]) + share[:, None] * (np.array(end[:3]) - np.array(begin[:3]))
    right = np.array([end[1] - begin[1], begin[0] - end[0]]) / length_m
    line_m[:, :2] += np.array([begin[3], 0.0, 0.0, end[3]])[:, None] * right
    return " ".join(",".join(f"{number_m:.2f}" for number_m in point_m) for point_m in line_m.tolist())


def read_network(path: Path) -> Network:
    """Read the surfaces of a network of SUMO.

    Raises:
        InputError: if it cannot be read
    """
    sumolib = import_optional("sumolib", extra="traffic")
    with _read_errors(path):
        net = sumolib.net.readNet(str(path), withInternal=True)
        outside: Literal[-1, 1] = 1 if _keeps_left(path) else -1
    rings = [frozenset(roundabout.getEdges()) for roundabout in net.getRoundabouts()]
    network = Network([], [], [], [], {}, [], rings, [])
    ends: dict[tuple[str, str], str] = {}
    walked: set[str] = set()
    for edge in net.getEdges(withInternal=False):
        begin, end = edge.getFromNode().getID(), edge.getToNode().getID()
        if (end, begin) in ends:
            network.opposite.append((ends[end, begin], edge.getID()))
        ends[begin, end] = edge.getID()
        groups = _groups(edge, outside)
        network.groups.extend(groups)
        if any(group.kind == "road" for group in groups):
            network.roads[edge.getID()] = edge.getLength()
        if any(group.kind == "pavement" for group in groups):
            network.walks.append(edge.getID())
            walked |= {begin, end}
    for node in net.getNodes():
        corners_m = _without_repeats(np.array(node.getShape3D() or np.zeros((0, 3))))
        if len(corners_m) > 2 and node.getType() not in ("internal", "dead_end"):
            network.junctions.append(corners_m)
    for edge in net.getEdges():
        if edge.getFunction() not in ("crossing", "walkingarea"):
            continue
        lane = edge.getLane(0)
        shape_m = _without_repeats(np.array(lane.getShape3D()))
        if edge.getFunction() == "crossing":
            network.crossings.append((shape_m, lane.getWidth()))
        elif edge.getFromNode().getID() in walked and len(shape_m) > 2:
            network.corners.append(_unfolded(shape_m))
    return network


def _keeps_left(path: Path) -> bool:
    """Return whether a network's traffic keeps to the left, which sumolib does not read."""
    with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
        _, root = next(iter(ElementTree.iterparse(file, events=["start"])))
    return root.get("lefthand") in ("true", "1")


def _groups(edge: Any, outside: Literal[-1, 1] = -1) -> list[LaneGroup]:
    """Lanes of an edge, those of one kind side by side together; the road is to the left of its pavements' lines."""
    groups: list[LaneGroup] = []
    ends_at_lights = "traffic_light" in edge.getToNode().getType()
    alike = itertools.groupby(edge.getLanes(), key=lambda lane: (_kind(lane), len(lane.getShape3D())))
    for (kind, _), together in alike:
        if kind is None:
            continue
        shapes, widths = zip(*((np.array(lane.getShape3D()), float(lane.getWidth())) for lane in together), strict=True)
        apart_m = sum(widths) - 0.5 * (widths[0] + widths[-1])
        # The middle of all lanes between those of the first and of the last.
        share = (0.5 * sum(widths) - 0.5 * widths[0]) / apart_m if apart_m > 0.0 else 0.0
        line_m = _without_repeats(shapes[0] + share * (shapes[-1] - shapes[0]))
        # SUMO counts lanes from the edge of the road.
        from_right_m = widths[:: -int(outside)]
        groups.append(LaneGroup(kind, line_m, from_right_m, edge.getID(), ends_at_lights, edge.getSpeed(), outside))
    for number, group in enumerate(groups):
        neighbours = [near for near in groups[max(number - 1, 0) : number + 2] if near.kind != "pavement"]
        if group.kind == "pavement" and neighbours:
            begin_m, ahead_m, road_m = group.line_m[0], group.line_m[:2][-1], neighbours[0].line_m[0]
            if np.linalg.det([(ahead_m - begin_m)[:2], (road_m - begin_m)[:2]]) < 0.0:
                groups[number] = group._replace(line_m=group.line_m[::-1])
    return groups


def _kind(lane: Any) -> LaneKind | None:
    """Kind of a lane by who may use it; None for rails, water and what nobody uses."""
    if any(lane.allows(kind) for kind in MOTOR_CLASSES):
        return "road"
    if lane.allows("bicycle"):
        return "cycle_path"
    return "pavement" if lane.allows("pedestrian") else None


def _without_repeats(points_m: Numbers) -> Numbers:
    """Points without those that are at the place of the one before, or of the first."""
    kept: list[Numbers] = []
    for point_m in points_m:
        if not kept or np.hypot(*(point_m - kept[-1])[:2]) > 0.05:
            kept.append(point_m)
    if len(kept) > 2 and np.hypot(*(kept[0] - kept[-1])[:2]) <= 0.05:
        kept.pop()
    return np.array(kept).reshape(-1, 3)


def _unfolded(corners_m: Numbers) -> Numbers:
    """Corners without those at which an outline turns back on itself, which netconvert makes where pavements spread.

    Sharp corners that enclose much of the area are real, and an outline keeps three corners at least.
    """
    x, y = corners_m[:, :2].T
    step = np.diff(corners_m[:, :2], axis=0, append=corners_m[:1, :2])
    before = np.roll(step, 1, axis=0)
    heading = np.arctan2(step[:, 1], step[:, 0])
    turn = np.abs(np.mod(heading - np.roll(heading, 1) + np.pi, 2.0 * np.pi) - np.pi)
    area_m2 = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    lost_m2 = 0.5 * np.abs(cross_in_plane(before, step))
    kept = (turn < math.radians(SHARPEST_CORNER_DEG)) | (lost_m2 > FOLDED_SHARE * area_m2)
    return np.asarray(corners_m[kept] if kept.sum() > 2 else corners_m)


def draw_routes(
    network: Network,
    path: Path,
    *,
    origin: str,
    bodies: Mapping[str, tuple[str, float, float, float]],
    seed: int,
    gap_m: float,
    loop: Sequence[str] = (),
) -> tuple[Path, str, float]:
    """Draw trips through a network: their file, and name and way [m] of the ego vehicle, the longest of some.

    Args:
        path: the network's file, beside which that of the trips is written
        origin: what it was made of, as messages name it
        bodies: name of a vehicle's body -> SUMO's class, length and width [m], and share of the vehicles
        gap_m: length of road for each vehicle
        loop: roads that the ego vehicle takes instead

    Raises:
        InputError: if no car can drive there
    """
    sumolib = import_optional("sumolib", extra="traffic")
    net = sumolib.net.readNet(str(path))
    random = np.random.default_rng([seed, 4])
    roads = sorted(name for name in network.roads if net.getEdge(name).allows("passenger"))
    ways = [[net.getEdge(name) for name in loop]]
    for first, last in random.choice(roads, (40, 2)) if roads and not loop else ():
        ways.append(net.getShortestPath(net.getEdge(first), net.getEdge(last), vClass="passenger")[0] or [])
    way_m, way = max(((sum(edge.getLength() for edge in way), way) for way in ways), key=lambda found: found[0])
    if not way:
        raise InputError(f"{origin}: must have roads that a car can drive along, got none")
    cars = sorted((length_m, name) for name, (kind, length_m, *_) in bodies.items() if kind == "passenger")
    own = cars[len(cars) // 2][1]  # of a usual length
    root = ElementTree.Element("routes")
    for name, (kind, length_m, width_m, _) in bodies.items():
        sizes = {"id": name, "vClass": kind, "length": f"{length_m:g}", "width": f"{width_m:g}"}
        ElementTree.SubElement(root, "vType", sizes)
    count = int(sum(network.roads.values()) / gap_m) + 1
    # Twice as many as are there at a time, from the begin on until the ego vehicle has come to its end; it is the first
    # of all, since others may leave no room for it on a ring.
    departures = np.sort(random.uniform(0.0, way_m / 8.0, 2 * count))
    departures[:count] = 0.0
    passed = [edge.getID() for edge in way]
    ego = {"id": "ego", "type": own, "depart": "0", "from": passed[0], "via": " ".join(passed), "to": passed[-1]}
    trips = [(0.0, "trip", ego)]
    reached: defaultdict[str, dict[Any, Any]] = defaultdict(dict)
    for number, depart_s in enumerate(departures.tolist()):
        begin, end = random.choice(roads, 2).tolist()
        kind = str(random.choice(list(bodies), p=[share for *_, share in bodies.values()]))
        trip = {"id": f"v{number}", "type": kind, "from": begin, "to": end, "departPos": "random", "departSpeed": "max"}
        # Without a way to there SUMO lets it drive to the end of its road, and stand in all others' way.
        road, user = net.getEdge(begin), bodies[kind][0]
        if road.allows(user) and net.getEdge(end) in net.getReachable(road, user, cache=reached[user]):
            trips.append((depart_s, "trip", trip | {"depart": f"{depart_s:.2f}"}))
        if network.walks:
            begin, end = random.choice(network.walks, 2).tolist()
            person = {"id": f"p{number}", "depart": f"{depart_s:.2f}", "from": begin, "to": end}
            trips.append((depart_s, "person", person))
    for _, tag, keys in sorted(trips, key=lambda trip: trip[0]):
        if tag == "trip":
            ElementTree.SubElement(root, tag, keys)
        else:
            walk = {name: keys.pop(name) for name in ("from", "to")}
            ElementTree.SubElement(ElementTree.SubElement(root, tag, keys), "walk", walk)
    routes = path.with_name("drawn.rou.xml")
    ElementTree.ElementTree(root).write(routes, encoding="utf-8")
    return routes, "ego", way_m


class Scenario(NamedTuple):
    """What SUMO simulates: its files, the network among them, and its types of vehicles.

    Attributes:
        source: what it is made of, as messages name it: a file of the user, or an option
        arguments: of SUMO
        types: name of a type -> class and length [m]
    """

    source: str
    network: Path
    arguments: tuple[str, ...]
    types: dict[str, tuple[str, float]]


def read_scenario(path: Path) -> Scenario:
    """Read the configuration of a simulation.

    Raises:
        InputError: if it is no configuration, or names no network
    """
    root = _xml(path)
    values = {LONG_NAMES.get(element.tag, element.tag): element.get("value", "") for element in root.iter()}
    name = values.get("net-file")
    if not name:
        raise InputError(f"{path}: net-file: is missing")
    network = path.parent / name
    require_file(network)
    files = [values.get(key, "") for key in ("route-files", "additional-files")]
    named = [path.parent / part.strip() for text in files for part in text.split(",") if part.strip()]
    arguments = ["-c", str(path)]
    if "step-length" not in values:
        arguments += ["--step-length", f"{STEP_S:g}"]
    if "lanechange.duration" not in values and "lateral-resolution" not in values:
        arguments += ["--lanechange.duration", f"{LANE_CHANGE_S:g}"]
    return Scenario(str(path), network, tuple(arguments), _types(named))


def drawn_scenario(source: str, network: Path, routes: Path, *, seed: int, last_s: float) -> Scenario:
    """Return the simulation of drawn trips through the network of a map."""
    options = {"--step-length": STEP_S, "--lanechange.duration": LANE_CHANGE_S, "--seed": seed, "--end": last_s}
    arguments = ["-n", str(network), "-r", str(routes), "--ignore-route-errors", "--no-warnings"]
    arguments += ["--time-to-teleport", "-1", *(text for key in options for text in (key, f"{options[key]:g}"))]
    return Scenario(source, network, tuple(arguments), _types([routes]))


def _types(files: Sequence[Path]) -> dict[str, tuple[str, float]]:
    """Class and length of the types of vehicles that files of routes define."""
    types = {name: (kind, class_entry(kind)["length_m"]) for name, kind in DEFAULT_TYPES.items()}
    for path in files:
        for element in _xml(path).iter("vType"):
            kind = element.get("vClass", "passenger")
            with _read_errors(path):
                types[element.get("id", "")] = kind, float(element.get("length") or class_entry(kind)["length_m"])
    return types


def simulate(scenario: Scenario, *, ego: str | None, shown_m: float, folder: Path) -> tuple[RoadUser, list[RoadUser]]:
    """Simulate traffic: the ego vehicle, from the time on at which it departs, and who comes near it.

    Args:
        ego: SUMO's name of the vehicle; that which is there for longest, if it is not said
        shown_m: distance to it beyond which others are left out

    Raises:
        InputError: if SUMO refuses the scenario, or there is no such vehicle
    """
    output = folder / "fcd.xml"
    fcd = ["--fcd-output", str(output), "--device.fcd.period", f"{POSE_S:g}", "--no-step-log", *PLAIN_OUTPUT]
    dropped = [note for note in _run("sumo", [*scenario.arguments, *fcd], scenario.source) if "ignoring" in note]
    if dropped:
        more = f", and {len(dropped) - 1} more" if len(dropped) > 1 else ""
        warn(OptionWarning("{0}: sumo left out vehicles or people: {1}{2}", scenario.source, dropped[0], more))
    if ego is None:
        counts = Counter(
            thing.get("id", "") for _, things in _steps(output) for thing in things if thing.tag == "vehicle"
        )
        ego = max(counts, key=lambda name: counts[name], default="")
    found: RoadUser | None = None
    others: list[RoadUser] = []
    open_ones: dict[tuple[str, str], RoadUser] = {}
    start_s = 0.0
    for time_s, things in _steps(output):
        # A person may have the name of a vehicle.
        movers = {
            (thing.tag, thing.get("id", "")): _placed(thing, scenario.types) for thing in things if _is_own(thing)
        }
        if ("vehicle", ego) not in movers:
            if found is not None:
                break
            continue
        kind, length_m, speed_m_s, own = movers.pop(("vehicle", ego))
        if found is None:
            found, start_s = RoadUser(ego, kind, length_m), time_s
        elif _leaps(found, (time_s - start_s, *own), speed_m_s):
            text = "{0}: its drive ends after {1} s, when sumo moves {2} elsewhere (time-to-teleport)"
            warn(OptionWarning(text, scenario.source, f"{time_s - start_s:g}", repr(ego)))
            break
        found.rows.append((time_s - start_s, *own))
        near = {
            key: user for key, user in movers.items() if np.hypot(user[3][0] - own[0], user[3][1] - own[1]) <= shown_m
        }
        open_ones = {key: mover for key, mover in open_ones.items() if key in near}
        for key, (kind, length_m, speed_m_s, place) in near.items():
            row = time_s - start_s, *place
            if key not in open_ones or _leaps(open_ones[key], row, speed_m_s):
                open_ones[key] = RoadUser(key[1], kind, length_m)
                others.append(open_ones[key])
            open_ones[key].rows.append(row)
    if found is None or len(found.rows) < 2:
        raise InputError(f"{scenario.source}: must have a vehicle {repr(ego) if ego else 'that drives'}, got none")
    kept = [mover for mover in others if len(mover.rows) > 1]
    for mover in (found, *kept):
        mover.rows = _turned(mover.rows)
    return found, kept


def _leaps(user: RoadUser, row: Row, speed_m_s: float) -> bool:
    """Return whether the front gets to a place faster than it drives: SUMO moves who waits for too long elsewhere."""
    time_s, x_m, y_m, yaw_deg, _ = np.array([user.rows[-1], row]).T
    front_m = np.exp(1j * np.radians(yaw_deg)) * 0.5 * user.length_m + x_m + 1j * y_m
    return bool(abs(front_m[1] - front_m[0]) > (speed_m_s + LEAP_M_S) * np.ptp(time_s))


def _turned(rows: Sequence[Row]) -> list[Row]:
    """Rows with one more on the way where people turn round from one step to the next."""
    result = [*rows[:1]]
    for before, after in itertools.pairwise(rows):
        turn_deg = (after[3] - before[3] + 180.0) % 360.0 - 180.0
        if abs(turn_deg) > SHARPEST_TURN_DEG:
            time_s, x_m, y_m, _, z_m = (0.5 * (a + b) for a, b in zip(before, after, strict=True))
            result.append((time_s, x_m, y_m, before[3] + 0.5 * turn_deg, z_m))
        result.append(after)
    return result


def _is_own(thing: ElementTree.Element) -> bool:
    """Return whether it moves by itself; people in vehicles do not."""
    return thing.tag == "vehicle" or (thing.tag == "person" and not thing.get("vehicle"))


def _placed(
    thing: ElementTree.Element, types: Mapping[str, tuple[str, float]]
) -> tuple[str, float, float, tuple[float, float, float, float]]:
    """Class, length and speed of a vehicle or person; x and y of its middle, yaw [degrees], and height of its front."""
    kind, length_m = types.get(thing.get("type", ""), ("passenger", class_entry("passenger")["length_m"]))
    if thing.tag == "person" and kind not in ("pedestrian", "wheelchair"):
        # Their type has no class, and SUMO's default one is as long as a car.
        kind, length_m = "pedestrian", class_entry("pedestrian")["length_m"]
    yaw_deg = 90.0 - float(thing.get("angle", 0.0))
    back_m = 0.5 * length_m
    x_m = float(thing.get("x", 0.0)) - back_m * float(np.cos(np.radians(yaw_deg)))
    y_m = float(thing.get("y", 0.0)) - back_m * float(np.sin(np.radians(yaw_deg)))
    return kind, length_m, float(thing.get("speed", 0.0)), (x_m, y_m, yaw_deg, float(thing.get("z", 0.0)))


def _steps(path: Path) -> Iterator[tuple[float, list[ElementTree.Element]]]:
    """Yield the steps of an FCD output, one after the other."""
    for _, element in ElementTree.iterparse(path):
        if element.tag == "timestep":
            yield float(element.get("time", 0.0)), list(element)
            element.clear()


def _xml(path: Path) -> ElementTree.Element:
    """Root of an XML file.

    Raises:
        InputError: if it cannot be read
    """
    require_file(path)
    with _read_errors(path), gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
        return ElementTree.parse(file).getroot()


@contextmanager
def _read_errors(path: Path) -> Iterator[None]:
    """Turn what a reader of XML raises, or sumolib, which checks nothing, into an InputError of one line."""
    try:
        yield
    except Exception as error:
        raise InputError(f"{path}: cannot be read as XML of SUMO: {str(error) or type(error).__name__}") from None


def _home() -> Path:
    """Folder of SUMO's programs and data."""
    return Path(import_optional("sumo", extra="traffic").SUMO_HOME)


def _run(program: str, arguments: Sequence[str], where: str) -> list[str]:
    """Run a program of SUMO, and return the errors that it goes on after, and its warnings.

    Raises:
        InputError: with SUMO's own first error, or if it needs more than `MEMORY_GIB`
    """
    home = _home()
    command = [str(home / "bin" / program), *arguments, "--xml-validation", "never"]
    if sys.platform != "win32":
        # Between a fork and the program nothing of this process may run: another Python sets the limit.
        command = [sys.executable, "-c", WITH_LIMIT, str(int(MEMORY_GIB * 2**30)), *command]
    environment = {**os.environ, "SUMO_HOME": str(home)}
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", env=environment, check=False)
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    notes = [re.sub("^(Error|Warning): *", "", line) for line in lines if line.startswith(("Error:", "Warning:"))]
    errors = [line.removeprefix("Error:").strip() for line in lines if line.startswith("Error:")]
    if "bad_alloc" in done.stderr:
        raise InputError(f"{where}: {program}: must need <= {MEMORY_GIB:g} GiB, got more: try a part of the map")
    if done.returncode != 0:
        reason = f"ended by {signal.Signals(-done.returncode).name}" if done.returncode < 0 else "no reason given"
        raise InputError(f"{where}: {program}: {(errors or lines or [reason])[0]}")
    return notes
