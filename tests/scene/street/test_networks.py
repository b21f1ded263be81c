"""Scenes of road networks: where an OpenDRIVE road is, what SUMO's traffic becomes, and what is refused."""

import bz2
import dataclasses
import gzip
import math
import re
import shutil
import sys
from collections import defaultdict
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers import chain, networks
from helpers.command_line import Run
from helpers.mistakes import mistakes, told, typed
from helpers.run_seed import chosen
from helpers.shared_faces import on_another_body
from helpers.sheets import grounds, scene_of

from lidarscene import catalog
from lidarscene.errors import OptionWarning
from lidarscene.maths.trajectory import pose_at
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.ground_area import Outline
from lidarscene.scene.saving import write_street
from lidarscene.scene.scene import Body, Scene
from lidarscene.scene.scene_file import load_scene, scene_model
from lidarscene.scene.shared_faces import shared_faces
from lidarscene.scene.street import sumo
from lidarscene.scene.street.network_tables import _drawn_bodies, network_scene
from lidarscene.scene.street.pieces import Tables
from lidarscene.scene.street.shapes import body_table, shapes
from lidarscene.scene.street.street_file import StreetFile
from lidarscene.scene.street.street_tables import street_summary

pytest.importorskip("sumo")
pytest.importorskip("sumolib")


@pytest.fixture(scope="module")
def bend(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scene file of an OpenDRIVE road of our own."""
    folder = tmp_path_factory.mktemp("bend")
    x_m, y_m, heading = reference(np.array([networks.STRAIGHT_M + networks.SPIRAL_M]), 0.0)[0].tolist()
    (folder / "bend.xodr").write_text(networks.opendrive((x_m, y_m, heading)))
    tables = network_scene(folder / "bend.xodr", "opendrive", StreetFile(seed=2, house_share=(1.0, 1.0)))
    return write_street(tables, folder / "out", origin="test")


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Configuration of a simulation, and scene file of it with the ego vehicle that it names first."""
    folder = tmp_path_factory.mktemp("town")
    configuration = networks.sumo_town(folder)
    tables = network_scene(configuration, "sumo", StreetFile(), ego="first")
    return configuration, write_street(tables, folder / "out", origin="test")


@pytest.fixture
def town_copy(town: tuple[Path, Path], tmp_path: Path) -> Path:
    """Configuration of the same simulation, for a test to change."""
    return Path(shutil.copytree(town[0].parent, tmp_path, dirs_exist_ok=True), town[0].name)


@pytest.fixture(scope="module")
def hills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scene file of the same town with junctions at four heights."""
    folder = tmp_path_factory.mktemp("hills")
    configuration = networks.sumo_town(folder, (0.0, 6.0, 3.0, -5.0))
    tables = network_scene(configuration, "sumo", StreetFile(house_share=(1.0, 1.0)), ego="first")
    return write_street(tables, folder / "out", origin="test")


@pytest.fixture(scope="module")
def drawn() -> Tables:
    """Tables of a drawn town with hills."""
    file = StreetFile(seed=1, oncoming_gap_m=(150.0, 160.0), slope_percent=(2.0, 6.0), shown_m=150.0)
    return network_scene(3, "town", file)


def reference(way_m: np.ndarray, left_m: float) -> np.ndarray:
    """(n, 3) x, y and heading along the road: sums over steps of a millimetre of its curvature."""
    step_m = 1e-3
    fine_m = np.arange(0.0, networks.STRAIGHT_M + networks.SPIRAL_M + networks.ARC_M, step_m) + 0.5 * step_m
    curvature = np.clip((fine_m - networks.STRAIGHT_M) / networks.SPIRAL_M, 0.0, 1.0) / networks.RADIUS_M
    heading = np.cumsum(curvature) * step_m
    sums = [np.cumsum(each) * step_m for each in (np.cos(heading), np.sin(heading))]
    x_m, y_m, yaw = (np.interp(way_m, fine_m + 0.5 * step_m, each) for each in (*sums, heading))
    return np.stack([x_m - left_m * np.sin(yaw), y_m + left_m * np.cos(yaw), yaw], axis=1)


def test_a_road_of_opendrive_is_where_its_geometry_says(bend: Path) -> None:
    """A line, a spiral and an arc, by sums of the curvature: lanes and pavement are along them, and no farther."""
    way_m = np.linspace(1.0, 145.0, 200)
    road, pavement = grounds(bend, "road"), grounds(bend, "pavement")
    for left_m, on_road, on_pavement in (
        (3.3, 1, 0),
        (-3.3, 1, 0),
        (3.7, 0, 0),
        (-3.8, 0, 1),
        (-5.3, 0, 1),
        (-5.7, 0, 0),
    ):
        place_m = reference(way_m, left_m)[:, :2]
        if left_m != -3.8:  # where the kerb ends, the pavement begins
            assert (~np.isnan(road.height_m(place_m)) == on_road).all(), left_m
        np.testing.assert_array_equal(~np.isnan(pavement.height_m(place_m)), on_pavement, str(left_m))
    np.testing.assert_allclose(pavement.height_m(reference(way_m, -4.5)[:, :2]), 0.12, atol=1e-9)


def test_a_ring_is_driven_round_and_what_netconvert_leaves_out_is_said(tmp_path: Path) -> None:
    """The ego vehicle stays on its lane, 1.75 m beside the road's middle, and leaves where it began."""
    (tmp_path / "ring.xodr").write_text(networks.RING)
    with pytest.warns(OptionWarning, match=r"ring\.xodr: netconvert left out .*connectingRoad.* connection '2'"):
        tables = network_scene(tmp_path / "ring.xodr", "opendrive", StreetFile(oncoming_gap_m=(10.0, 30.0)))
    place_m = np.array([pose["position_m"][:2] for pose in tables["ego"]["poses"]])
    middle_m = _middle_of_circle_m(place_m)
    radius_m = np.hypot(*(place_m - middle_m).T)
    np.testing.assert_allclose(np.abs(radius_m - networks.RADIUS_M), 1.75, atol=0.25)
    turned = np.ptp(np.unwrap(np.arctan2(*(place_m - middle_m).T)))
    assert turned > 1.0
    assert street_summary(tables).length_m == pytest.approx(turned * radius_m.mean(), rel=2e-3)


def _middle_of_circle_m(place_m: np.ndarray) -> np.ndarray:
    """Middle of the circle through places: x^2 + y^2 = 2 a x + 2 b y + c, wherever netconvert puts its origin."""
    terms = np.column_stack([2.0 * place_m, np.ones(len(place_m))])
    return np.linalg.lstsq(terms, (place_m**2).sum(axis=1), rcond=None)[0][:2]


def test_what_sumo_drops_is_said(town_copy: Path) -> None:
    """SUMO leaves out what departs before the one above it in the file."""
    late = '<trip id="late" depart="9" from="A0B0" to="B1A1"/>'
    early = "".join(f'<trip id="early_{number}" depart="5" from="A0B0" to="B1A1"/>' for number in (1, 2))
    town_copy.with_name("town.rou.xml").write_text(f"<routes>{late}{early}</routes>")
    with pytest.warns(OptionWarning, match=r"town\.sumocfg: sumo left out .*sorted.*'early_1'!, and 1 more"):
        network_scene(town_copy, "sumo", StreetFile())


def test_a_person_may_have_the_name_of_a_vehicle(town_copy: Path, tmp_path: Path) -> None:
    """Nobody is lost, and a vehicle carries the sensor; SUMO's randomTrips.py names them so."""
    trips = "".join(f'<trip id="{number}" depart="0" from="A0B0" to="B1A1" departPos="20"/>' for number in (0, 1))
    walks = "".join(f'<person id="{n}" depart="0"><walk from="A0B0" to="B0B1"/></person>' for n in (0, 1))
    town_copy.with_name("town.rou.xml").write_text(f"<routes>{trips}{walks}</routes>")
    scenario = sumo.read_scenario(town_copy)
    own, others = sumo.simulate(scenario, ego=None, shown_m=100.0, folder=tmp_path)
    assert own.kind == "passenger"
    kinds = sorted((user.kind, user.name) for user in others)
    assert kinds == [("passenger", "10"[int(own.name)]), ("pedestrian", "0"), ("pedestrian", "1")]


@pytest.mark.parametrize("name", ["waits", "blocks"])
def test_who_is_moved_elsewhere_does_not_drive_there(town_copy: Path, tmp_path: Path, name: str) -> None:
    """A car behind one that stands for long: SUMO moves it beyond, by 39 m at once. Its drive ends, or it is another
    one from there on; nobody is faster than 1.2 times the 13.89 m/s of the streets, as SUMO's drivers are.
    """
    stop = '<stop lane="A0B0_1" startPos="60" endPos="70" duration="300"/>'
    blocks = f'<vehicle id="blocks" depart="0"><route edges="A0B0 B0B1 B1A1"/>{stop}</vehicle>'
    waits = '<trip id="waits" depart="5" from="A0B0" to="B1A1"/>'
    town_copy.with_name("town.rou.xml").write_text(f"<routes>{blocks}{waits}</routes>")
    teleports = '</time><processing><time-to-teleport value="10"/></processing>'
    town_copy.write_text(town_copy.read_text().replace("</time>", teleports))
    told_so = pytest.warns(OptionWarning, match="its drive ends after 21 s, when sumo moves 'waits'")
    with told_so if name == "waits" else nullcontext():
        own, others = sumo.simulate(sumo.read_scenario(town_copy), ego=name, shown_m=200.0, folder=tmp_path)
    assert sorted(user.name for user in others) == (["blocks"] if name == "waits" else ["waits", "waits"])
    for user in (own, *others):
        time_s, x_m, y_m = np.array(user.rows).T[:3]
        assert (np.hypot(np.diff(x_m), np.diff(y_m)) / np.diff(time_s)).max() < 16.7


def test_outputs_of_a_configuration_change_nothing(town: tuple[Path, Path], town_copy: Path) -> None:
    """Times as 00:00:01, places in degrees, a prefix of all files' names, and columns without angles and types."""
    output = '<output-prefix value="a_"/><fcd-output.geo value="1"/><fcd-output.attributes value="x,y"/>'
    other = f'<output>{output}</output><report><human-readable-time value="1"/></report></configuration>'
    town_copy.write_text(town_copy.read_text().replace("</configuration>", other))
    (expected, _), (own, _) = (
        sumo.simulate(sumo.read_scenario(file), ego="line_7", shown_m=50.0, folder=file.parent)
        for file in (town[0], town_copy)
    )
    assert (own.kind, own.rows) == ("bus", expected.rows)


@pytest.mark.skipif(sys.platform == "win32", reason="memory has no limit there")
def test_a_road_of_too_many_pieces_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """An arc of a million kilometres in pieces of a metre, of which 1 GiB holds a part."""
    monkeypatch.setattr(sumo, "MEMORY_GIB", 1.0)
    text = networks.RING.replace(f'length="{2 * math.pi * networks.RADIUS_M}"', 'length="1e9"')
    (tmp_path / "long.xodr").write_text(text)
    with told("long.xodr | netconvert | <= 1 GiB"):
        network_scene(tmp_path / "long.xodr", "opendrive", StreetFile())


def test_houses_stand_beside_the_road(bend: Path) -> None:
    scene = scene_of(bend)
    houses = [body.pose.position_m for body in scene.bodies if body.class_name == "building"]
    assert len(houses) > 10
    assert sum(body.name.startswith("bushes") for body in scene.bodies) > 3
    line_m = reference(np.arange(0.0, 150.0, 0.5), 0.0)[:, :2]
    nearest_m = [np.hypot(*(line_m - house_m[:2]).T).min() for house_m in houses]
    assert min(nearest_m) > 3.5 + 3.0 + 0.9 * 4.5 - 0.1


def test_the_vehicles_are_where_sumo_says(town: tuple[Path, Path], tmp_path: Path) -> None:
    """The middle of a vehicle's front, by its own angle from north, read by sumolib from SUMO's own output."""
    import sumolib

    configuration, path = town
    scenario = sumo.read_scenario(configuration)
    output = tmp_path / "fcd.xml"
    sumo._run("sumo", [*scenario.arguments, "--fcd-output", str(output), "--device.fcd.period", "0.5"], configuration)
    steps = list(sumolib.xml.parse(str(output), "timestep"))
    assert len(steps) > 20
    scene = load_scene(path)
    assert scene.ego is not None
    bus = next(body for body in scene.bodies if body.class_name == "bus")
    rider = next(body for body in scene.bodies if body.class_name == "cyclist")
    size_m = np.ptp(np.concatenate([part.vertices_m for part in bus.parts]), axis=0)
    assert size_m[0] == pytest.approx(14.99, abs=0.1)
    for name, motion, length_m in (
        ("first", scene.ego, 5.0),
        ("line_7", bus.motion, 14.9),
        ("rider", rider.motion, 1.6),
    ):
        assert motion is not None
        compared = 0
        for step in steps[::6]:
            thing = next((vehicle for vehicle in step.vehicle or () if vehicle.id == name), None)
            if thing is None:
                continue
            pose = pose_at(motion, float(step.time))
            front_m = pose.apply(np.array([[0.5 * length_m, 0.0, 0.0]]))[0, :2]
            np.testing.assert_allclose(front_m, [float(thing.x), float(thing.y)], atol=0.06)
            compared += 1
        assert compared >= 3


def test_the_sensor_is_over_the_roof_of_its_vehicle(town: tuple[Path, Path]) -> None:
    """That of a bus, too: a sensor in the body would see its roof alone."""
    for name in chosen(1, ["first", "line_7"]):
        tables = network_scene(town[0], "sumo", StreetFile(), ego=name)
        (own,) = (body for body in tables["bodies"] if body["name"] == "own_car")
        height_m = trimesh.load(own["mesh"]).extents[1]
        *middle_m, place_m = tables["sensor"]["position_m"]
        assert middle_m == [0.0, 0.0]
        assert 0.2 < place_m - height_m < 0.4


def test_a_drawn_town_has_hills_lights_and_a_roundabout_at_which_vehicles_turn(drawn: Tables) -> None:
    """The network's height differs by the slope; the ego vehicle drives a loop with six turns, others turn, too."""
    first = drawn
    turned_deg = [
        np.ptp(np.unwrap([pose.get("yaw_deg", 0.0) for pose in motion["poses"]], period=360.0))
        for motion in (
            first["ego"],
            *(
                each["motion"]
                for body in first["bodies"]
                if body["name"].startswith("traffic")
                for each in body["instances"]
            ),
        )
    ]
    first_deg, *_, last_deg = np.unwrap([pose.get("yaw_deg", 0.0) for pose in first["ego"]["poses"]], period=360.0)
    assert last_deg - first_deg == pytest.approx(360.0, abs=8.0)
    way_m = np.array([pose["position_m"][:2] for pose in first["ego"]["poses"]])
    apart_m = np.hypot(*(way_m[:, None] - way_m).transpose(2, 0, 1))
    assert np.median(apart_m[-5:].min(axis=1, initial=np.inf, where=np.arange(len(way_m)) < 40)) < 4.0, "it closes"
    assert sum(turn > 80.0 for turn in turned_deg) > 3
    roads = [body for body in first["bodies"] if body["name"].startswith("road_")]
    lines_m = [np.array(body["line"]) for body in roads]
    assert np.ptp(np.concatenate(lines_m)[:, 2]) > 3.0
    bends = [line_m for line_m in lines_m if len(line_m) > 5 and _turned_deg(line_m) > 30.0]
    assert len(bends) == 4, "a ring of four pieces"
    islands_m = [np.array(body["outline"]) for body in first["bodies"] if body["name"].startswith("island_")]
    round_m = max(islands_m, key=lambda each: Outline(corner_m=each, spacing_m=1.0).area_m2())[:, :2]
    middle_m = _middle_of_circle_m(round_m)
    # netconvert moves ends of roads, by 0.66 m in one of some hundred draws.
    np.testing.assert_allclose(np.hypot(*(round_m - middle_m).T), sumo.RING_M, atol=1.0)
    splitters = [each for each in islands_m if np.hypot(*(each[:, :2].mean(axis=0) - middle_m)) < 40.0]
    assert len(splitters) == 1 + 4, "one within the ring and one in each road that leads to it"
    assert any(body["name"] == "lights" for body in first["bodies"])


def test_a_seed_is_a_town(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What netconvert is given is the same; the junction in the middle is a ring."""
    monkeypatch.setattr(sumo, "_run", lambda *_: [])
    files = []
    for number, seed in enumerate((1, 1, 2)):
        (tmp_path / str(number)).mkdir()
        net, roads = sumo.draw_town(5, tmp_path / str(number), seed=seed, slopes=(0.0, 0.05))
        files.append((net.parent / "drawn.nod.xml").read_text() + (net.parent / "drawn.edg.xml").read_text())
    assert files[0] == files[1] != files[2]
    assert {f"n{i}_{j}" for i in range(5) for j in range(5) if f'id="n{i}_{j}"' not in files[0]} == {"n2_2"}
    assert len(roads) == 8 * 2 + 1
    assert roads[0] == roads[-1] == "n0_0_n1_0"
    around = [name.partition("ring")[::2] for name in roads if "ring" in name]
    assert [(begin, end[1:]) for begin, end in around] == [("n3_2_", ""), ("", "_n2_3")]


def test_the_ego_vehicle_takes_its_loop_though_other_ways_are_longer(town: tuple[Path, Path], tmp_path: Path) -> None:
    path = Path(shutil.copy(sumo.read_scenario(town[0]).network, tmp_path))
    network = sumo.read_network(path)
    shortest = min(network.roads, key=network.roads.__getitem__)
    for loop, longest_m in (([shortest], network.roads[shortest]), ([], 1e4)):
        *_, way_m = sumo.draw_routes(
            network, path, origin="test", bodies=_drawn_bodies(), seed=1, gap_m=200.0, loop=loop
        )
        assert (way_m == pytest.approx(longest_m)) == bool(loop)
        assert way_m >= network.roads[shortest]


def _turned_deg(line_m: np.ndarray) -> float:
    heading = np.unwrap(np.arctan2(*np.diff(line_m[:, :2], axis=0).T[::-1]))
    return float(np.degrees(np.ptp(heading)))


def test_people_walk_on_pavements_and_crossings_are_striped(town: tuple[Path, Path]) -> None:
    scene, pavement = scene_of(town[1]), grounds(town[1], "pavement")
    walker = next(body for body in scene.bodies if body.class_name == "pedestrian" and body.motion is not None)
    assert walker.motion is not None
    first_s, last_s = walker.present_s
    place_m = walker.motion.at(np.linspace(first_s, last_s, 20)).position_m
    assert np.isfinite(pavement.height_m(place_m[:, :2])).mean() > 0.8
    np.testing.assert_allclose(place_m[:, 2], 0.12, atol=0.05)
    names = {body.name.partition("_")[0] for body in scene.bodies}
    assert {"zebras", "stop", "line", "junction", "kerb", "corner"} <= names


def test_lights_stand_where_lanes_end_at_them(town: tuple[Path, Path]) -> None:
    """One for each of eight lanes, on the pavement at its right, with its front towards those who come."""
    import sumolib

    net = sumolib.net.readNet(str(town[0].parent / "town.net.xml"))
    lights = [body for body in scene_of(town[1]).bodies if body.class_name == "traffic_light"]
    assert len(lights) == len(net.getEdges()) == 8
    pavement = grounds(town[1], "pavement", "kerb")
    for edge in net.getEdges():
        lane = edge.getLane(edge.getLaneNumber() - 1)
        (before, end) = np.array(lane.getShape()[-2:])
        ahead = (end - before) / np.hypot(*(end - before))
        place_m = end - 0.5 * ahead + (0.5 * lane.getWidth() + 0.45) * np.array([ahead[1], -ahead[0]])
        (light,) = (each for each in lights if np.hypot(*(each.pose.position_m[:2] - place_m)) < 0.05)
        np.testing.assert_allclose(light.pose.rotation[:2, 0], -ahead, atol=1e-3)
        assert np.isfinite(pavement.height_m(place_m[None])).all()


def test_where_traffic_keeps_to_the_left_the_scene_is_the_mirror_image(tmp_path: Path) -> None:
    """Lights, dashes between lanes of unequal width, stop lines and islands; on that of a ring stand no lamps.

    Tolerance: netconvert rounds to a centimetre.
    """
    both: list[dict[str, np.ndarray]] = []
    for keeps_left, mirrored in ((False, [1.0, 1.0]), (True, [1.0, -1.0])):
        folder = tmp_path / str(keeps_left)
        folder.mkdir()
        configuration = networks.wide_crossing(folder, keeps_left=keeps_left)
        places: defaultdict[str, list[np.ndarray]] = defaultdict(list)
        for body in network_scene(configuration, "sumo", StreetFile(shown_m=400.0))["bodies"]:
            kind = str(body["name"]).rstrip("_0123456789")
            if kind == "island":
                outline_m = np.array(body["outline"])[:, :2]
                places[kind].append(0.5 * (outline_m.min(axis=0) + outline_m.max(axis=0)) * mirrored)
            for place in body.get("instances", ()):
                if "position_m" in place:
                    places[kind].append(np.array(place["position_m"][:2]) * mirrored)
        both.append({kind: np.array(each) for kind, each in places.items()})
    right, left = both
    for kind in ("lights", "dashes", "stop_lines", "island"):
        assert len(right[kind]) == len(left[kind]) > 1, kind
        apart_m = np.hypot(*(right[kind][:, None] - left[kind]).transpose(2, 0, 1)).min(axis=1)
        assert apart_m.max() < 0.05, kind
    # The ring is a square on its corner.
    ring_m = left["island"][np.argmin(np.hypot(*(left["island"] - [300.0, 40.0]).T))]
    assert np.abs(left["lamp_posts"] - ring_m).sum(axis=1).min() > 20.0


@pytest.fixture(scope="module")
def homes(tmp_path_factory: pytest.TempPathFactory) -> Tables:
    """Streets of OpenStreetMap where people live."""
    path = tmp_path_factory.mktemp("homes") / "map.osm"
    path.write_text(networks.OSM)
    return network_scene(path, "osm", StreetFile(seed=4, oncoming_gap_m=(15.0, 40.0)))


def test_fast_roads_without_pavements_have_guard_rails(homes: Tables, tmp_path: Path) -> None:
    """A trunk road: pieces of 4 m on both sides, whose beams face the road; a residential one has none."""
    assert not any(body["name"] == "guard_rails" for body in homes["bodies"])
    (tmp_path / "map.osm").write_text(networks.OSM.replace('v="residential"', 'v="trunk"', 1))
    tables = network_scene(tmp_path / "map.osm", "osm", StreetFile(seed=4, oncoming_gap_m=(100.0, 200.0)))
    rails = [place for body in tables["bodies"] if body["name"] == "guard_rails" for place in body["instances"]]
    roads = [body for body in tables["bodies"] if body["name"].startswith("road_")]
    lines_m = np.concatenate([np.array(body["line"])[:, :2] for body in roads])
    for rail in rails:
        yaw = np.radians(rail.get("yaw_deg", 0.0))
        place_m, front = np.array(rail["position_m"][:2]), np.array([np.cos(yaw), np.sin(yaw)])
        nearest_m = lines_m[np.argmin(np.hypot(*(lines_m - place_m).T))]
        assert (nearest_m - place_m) @ front > 0.0
    assert len(rails) > 20


def test_a_map_may_have_one_road_alone(tmp_path: Path) -> None:
    """Rationale: netconvert was told to leave out roads that meet no other."""
    (tmp_path / "map.osm").write_text(re.sub('  <way id="11".*', "", networks.OSM))
    tables = network_scene(tmp_path / "map.osm", "osm", StreetFile(seed=4))
    assert any(body["name"].startswith("road_") for body in tables["bodies"])


@pytest.mark.parametrize("left_hand", [False, True])
def test_the_vehicle_of_a_map_keeps_to_its_side(tmp_path: Path, left_hand: bool) -> None:
    """A street to the east, along which it drives there and back: on which side of the middle of both lanes."""
    (tmp_path / "map.osm").write_text(re.sub('  <way id="11".*', "", networks.OSM))
    tables = network_scene(tmp_path / "map.osm", "osm", StreetFile(seed=4), left_hand=left_hand)
    roads = [np.array(body["line"])[:, :2] for body in tables["bodies"] if body["name"].startswith("road_")]
    place_m = np.array([pose["position_m"][:2] for pose in tables["ego"]["poses"]])
    (west_m, *_, east_m) = sorted(np.concatenate(roads).tolist())
    step_m = np.gradient(place_m[:, 0])
    middle_m = np.mean([np.interp(place_m[:, 0], *line_m[np.argsort(line_m[:, 0])].T) for line_m in roads], axis=0)
    inside = (place_m[:, 0] > west_m[0] + 20.0) & (place_m[:, 0] < east_m[0] - 20.0) & (np.abs(step_m) > 0.5)
    left_m = (np.sign(step_m) * (place_m[:, 1] - middle_m))[inside]
    assert len(left_m) > 10
    assert (np.sign(left_m) == (1.0 if left_hand else -1.0)).all()


def test_a_bridge_of_a_map_is_above_the_road_below(tmp_path: Path) -> None:
    """Rationale: at one height pavements lay across roads, and vehicles drove through each other."""
    bridge = '<nd ref="4"/><nd ref="5"/><tag k="bridge" v="yes"/><tag k="layer" v="1"/>'
    (tmp_path / "map.osm").write_text(networks.OSM.replace('<nd ref="4"/><nd ref="2"/><nd ref="5"/>', bridge))
    tables = network_scene(tmp_path / "map.osm", "osm", StreetFile(seed=4, oncoming_gap_m=(100.0, 200.0)))
    lines_m = [np.array(body["line"]) for body in tables["bodies"] if body["name"].startswith("road_")]
    heights_m = sorted(float(height_m) for line_m in lines_m for height_m in np.unique(line_m[:, 2].round(3)))
    assert heights_m == [0.0, 0.0, sumo.LAYER_M, sumo.LAYER_M]


def test_nobody_stands_for_ever_at_the_end_of_a_one_way_road(tmp_path: Path) -> None:
    """One-way roads that lead out of the map: most pairs of them have no way from one to the other."""
    one_way = '<tag k="oneway" v="yes"/><tag k="highway"'
    (tmp_path / "map.osm").write_text(networks.OSM.replace('<tag k="highway"', one_way))
    tables = network_scene(tmp_path / "map.osm", "osm", StreetFile(seed=4, oncoming_gap_m=(15.0, 40.0)))
    way_m = np.array([pose["position_m"] for pose in tables["ego"]["poses"]])
    assert np.hypot(*np.diff(way_m[:, :2], axis=0).T)[-20:].max() > 1.0  # in half a second


@pytest.mark.usefixtures("mi")
def test_a_wheelchair_of_sumo_is_one_that_rolls() -> None:
    from lidarscene.scene.street.network_tables import _look

    chair = sumo.RoadUser(name="chair", kind="wheelchair", length_m=1.1)
    table = body_table("chair", shapes()[_look(chair)], moves=True)
    assert (table["class"], table["animation"]) == ("wheelchair_user", "roll")
    assert "standing" not in table


@pytest.mark.parametrize("name", chosen(1, ["town", "hills", "over", "drawn"]))
def test_no_two_bodies_share_a_face_that_a_beam_meets(name, request, tmp_path):
    """Junctions, lanes, kerbs, pavements, islands, piers and markings: fewer than one point in two thousand, where
    bodies touch; from the vehicle, from below a bridge, and from beside a roundabout.
    """
    found = request.getfixturevalue(name)
    path = write_street(found, tmp_path / "out", origin="test") if name == "drawn" else found
    scene = scene_of(path[1] if name == "town" else path)
    assert scene.ego is not None
    pose = pose_at(scene.ego, 4.0) @ scene.sensor_pose
    if name == "over":
        pose = dataclasses.replace(pose, position_m=np.array([188.0, 198.4, 1.75]))
    if name == "drawn":
        poses = found["ego"]["poses"]
        place_m = np.array([at["position_m"] for at in poses])
        turned_deg = np.array([at.get("yaw_deg", 0.0) for at in poses])
        # The first pose at which it turns to the left on its way around.
        number = int(np.argmax(np.diff(np.unwrap(turned_deg, period=360.0)) < -10.0))
        pose = dataclasses.replace(pose, position_m=place_m[number] + [0.0, 0.0, 1.75])
    near = [body for body in _still(scene) if np.hypot(*(_middle_m(body) - pose.position_m)[:2]) < 80.0]
    scene = dataclasses.replace(scene, ego=None, sensor_pose=pose, bodies=tuple(near))
    cloud = Simulator(scene, chain.sensor("vlp-16"), pose=pose).render(seed=1, coordinates="world")
    assert not shared_faces(scene, pose.position_m)
    cloud = cloud.select(cloud.status == 0)
    assert len(cloud) > 10_000
    assert np.mean(on_another_body(scene, cloud) >= 0) < 5e-4


def _middle_m(body: Body) -> np.ndarray:
    return body.pose.apply(np.concatenate([part.vertices_m for part in body.parts])).mean(axis=0)


def test_soil_follows_roads_that_climb(hills: Path) -> None:
    """No road is below the soil, nor is a gap below its sides, which reach down 0.3 m; lanes meet without a step.

    Junctions and opposite lanes of the network differ in height by up to half a metre where they meet.
    """
    scene = scene_model(hills)
    soil, roads = grounds(hills, "terrain"), grounds(hills, "road")
    heights_m, places_m = [], []
    for number, sheet in enumerate(roads.sheets):
        vertices_m = sheet.vertices_m.reshape(-1, 3)
        over_m = vertices_m[:, 2] - soil.height_m(vertices_m[:, :2])
        assert over_m.min() > 0.0
        assert over_m.max() < 0.25
        for other in roads.sheets[:number]:
            on_both, there_m = other.mesh_height_m(vertices_m[:, :2])
            heights_m.append(there_m - vertices_m[on_both, 2])
        places_m.append(vertices_m)
    assert np.ptp(np.concatenate(places_m)[:, 2]) > 9.0
    assert np.abs(np.concatenate(heights_m)).max() < 0.06
    lowest_m = np.concatenate(places_m)[:, 2].min()
    for sheet in soil.sheets:  # a skin is nowhere lower or higher than what it is stretched between
        assert sheet.vertices_m[..., 2].min() > lowest_m - 0.2
    assert any(body.heights_m for body in scene.bodies)


def test_houses_stand_in_the_soil_of_slopes(hills: Path) -> None:
    """No corner of a house is above the soil below it, and one at least is at it; trees and lamps stand on it. 0.25 m:
    the corners are those of eaves and balconies, which reach beyond the walls, and slopes have 13 %.
    """
    scene, soil = scene_of(hills), grounds(hills, "terrain")
    houses = [body for body in scene.bodies if body.class_name == "building"]
    assert np.ptp([house.pose.position_m[2] for house in houses]) > 4.0
    for house in houses:
        vertices_m = np.concatenate([part.vertices_m for part in house.parts])
        low_m, high_m = vertices_m.min(axis=0), vertices_m.max(axis=0)
        corners_m = np.array([[x, y, 0.0] for x in (low_m[0], high_m[0]) for y in (low_m[1], high_m[1])])
        place_m = house.pose.apply(corners_m)
        over_m = place_m[:, 2] - soil.height_m(place_m[:, :2])
        assert over_m.max() < 0.25
        assert over_m.max() > -1.0
    posts = [body for body in scene.bodies if body.class_name == "pole"]
    for post in posts:
        (height_m,) = soil.height_m(post.pose.position_m[None, :2])
        assert post.pose.position_m[2] == pytest.approx(height_m, abs=0.4)


def test_vehicles_on_slopes_pitch_as_the_road(hills: Path) -> None:
    scene, roads = scene_of(hills), grounds(hills, "road")
    bus = next(body for body in scene.bodies if body.class_name == "bus")
    assert bus.motion is not None
    slopes = []
    for time_s in np.linspace(*bus.present_s, 12)[1:-1]:
        pose = pose_at(bus.motion, float(time_s))
        rear_m, front_m = roads.height_m(pose.apply(np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))[:, :2])
        slopes.append(0.5 * (front_m - rear_m))
        assert pose.rotation[2, 0] == pytest.approx(slopes[-1], abs=0.015)
    assert max(map(abs, slopes)) > 0.02


@pytest.fixture(scope="module")
def over(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scene file of a road with a bridge over it."""
    folder = tmp_path_factory.mktemp("over")
    tables = network_scene(networks.bridge(folder), "sumo", StreetFile(shown_m=200.0), ego="we")
    return write_street(tables, folder / "out", origin="test")


def test_piers_stand_on_both_sides_of_the_road_below_and_bear_the_one_above(over: Path) -> None:
    """Heads 3 cm below the top of the bridge, feet in the soil, sides 2 m and more beside the lower road."""
    scene, roads, soil = scene_of(over), grounds(over, "road"), grounds(over, "terrain")
    piers = [body for body in scene.bodies if body.name.startswith("pier")]
    assert [np.sign(pier.pose.position_m[1] - 198.4) for pier in piers] == [-1.0, 1.0]
    for pier in piers:
        vertices_m = pier.pose.apply(np.concatenate([part.vertices_m for part in pier.parts]))
        (top_m,), (low_m,) = (ground.height_m(pier.pose.position_m[None, :2]) for ground in (roads, soil))
        assert top_m - vertices_m[:, 2].max() == pytest.approx(0.03, abs=0.02)
        assert vertices_m[:, 2].min() < low_m - 0.3
        assert np.abs(vertices_m[:, 1] - 198.4).min() > 0.5 * 3.2 + 1.0


def test_each_drives_on_its_own_road_where_one_is_above_the_other(over: Path) -> None:
    """One car goes below the bridge, one over it; soil below the bridge is at the height of the lower road."""
    path = over
    scene, soil = scene_of(path), grounds(path, "terrain")
    assert scene.ego is not None
    other = next(body.motion for body in scene.bodies if body.name.startswith("traffic"))
    assert other is not None
    times_s = np.linspace(0.0, 20.0, 81)
    for motion, axis, height_m in ((scene.ego, 0, 0.0), (other, 1, 6.0)):
        place_m = motion.at(times_s).position_m
        middle_m = 200.0  # netconvert puts the lowest x and y at 0
        below = np.abs(place_m[:, axis] - middle_m) < 15.0
        assert below.sum() > 3
        np.testing.assert_allclose(place_m[below, 2], height_m, atol=0.2)
        assert np.abs(np.diff(place_m[:, 2])).max() < 0.4, "no step"
    np.testing.assert_allclose(
        soil.height_m(np.array([[190.0, 198.4], [200.0, 198.4], [210.0, 198.4]])), -0.08, atol=0.05
    )


def _still(scene: Scene) -> list[Body]:
    return [body for body in scene.bodies if body.motion is None]


def test_every_body_of_drawn_traffic_loads(homes: Tables, tmp_path: Path) -> None:
    """Streets of OpenStreetMap: a junction, houses, and vehicles of classes that the drawn traffic has."""
    scene = load_scene(write_street(homes, tmp_path / "out", origin="test"))
    classes = {body.class_name for body in scene.bodies}
    assert {"road", "building", "car", "terrain", "lane_marking"} <= classes
    assert any(body.name.startswith("junction") for body in scene.bodies)
    known = {body.class_name for body in catalog.vehicles().values()}
    assert len({body.class_name for body in scene.bodies if body.motion is not None} & known) >= 2


@mistakes(
    """
    --opendrive none.xodr | none.xodr | no such file
    --opendrive town.sumocfg | town.sumocfg | netconvert
    --sumo town.rou.xml | town.rou.xml | net-file
    --sumo cut.sumocfg | cut.net.xml | XML | unclosed
    --sumo packed.sumocfg | packed.net.xml.gz | XML | Compressed
    --sumo long.sumocfg | long.rou.xml | XML | 'long'
    --sumo town.sumocfg --ego nobody | town.sumocfg | 'nobody' | none
    --sumo town.sumocfg --ego walks | town.sumocfg | 'walks' | none
    --opendrive town.xodr --ego a | --ego | --sumo
    --ego a | --ego | --sumo
    --osm map.osm.pbf | map.osm.pbf | .osm.xml | gzip | osmium cat
    --osm map.osm.bz2 | map.osm.bz2 | .osm.xml | gzip | osmium cat
    --osm map.osm --length-m 90 | length_m | --osm
    --left-hand --opendrive town.xodr | --left-hand | --osm
    --left-hand | --left-hand | --osm
    --osm map.osm --sumo a | --sumo | --osm
    """
)
def test_mistakes(run: Run, town: tuple[Path, Path], given: str, named: str) -> None:
    for path in town[0].parent.glob("town.*"):
        Path(path.name).write_bytes(path.read_bytes())
    network, routes, scenario = (Path(f"town.{kind}").read_bytes() for kind in ("net.xml", "rou.xml", "sumocfg"))
    Path("cut.net.xml").write_bytes(network[: len(network) // 2])
    Path("packed.net.xml.gz").write_bytes(gzip.compress(network)[:-100])
    Path("long.rou.xml").write_bytes(routes.replace(b"14.9", b"long"))
    for name, old, new in (
        ("cut", b"town.net", b"cut.net"),
        ("packed", b"town.net.xml", b"packed.net.xml.gz"),
        ("long", b"town.rou", b"long.rou"),
    ):
        Path(f"{name}.sumocfg").write_bytes(scenario.replace(old, new))
    Path("map.osm.pbf").write_bytes(b"\0\0\0\x0d\n\x09OSMHeader\x18\x7c")
    Path("map.osm.bz2").write_bytes(bz2.compress(networks.OSM.encode()))
    typed(run, named, "street", *given.split(), "-o", "out")


def test_a_tram_is_left_out_and_a_car_where_it_carries_the_sensor(tmp_path: Path) -> None:
    """Rationale: of no bodies none could be chosen, and a scenario whose longest drive is a tram's gave a traceback."""
    configuration = networks.bridge(tmp_path)
    routes, kind = tmp_path / "bridge.rou.xml", '<vType id="t" vClass="tram"/>'
    routes.write_text(routes.read_text().replace('id="sn"', 'id="sn" type="t"').replace("<trip", f"{kind}<trip", 1))
    with pytest.warns(OptionWarning, match="vehicles of tram have no body"):
        tables = network_scene(configuration, "sumo", StreetFile(), ego="we")
    assert not any(body["name"].startswith("traffic") for body in tables["bodies"])
    bodies = network_scene(configuration, "sumo", StreetFile(), ego="sn")["bodies"]
    (mesh,) = (Path(body["mesh"]).stem for body in bodies if body["name"] == "own_car")
    assert mesh in {body.name for body in catalog.vehicles().values() if body.class_name == "car"}
