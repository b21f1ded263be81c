"""Streets from a seed: nothing overlaps, nobody collides, a seed is a street, and the file is the same scene."""

import itertools
from collections import Counter
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.run_seed import chosen
from helpers.sheets import grounds, scene_of
from scipy.special import fresnel

from lidarscene import catalog
from lidarscene.maths.trajectory import pose_at
from lidarscene.scene.saving import write_street
from lidarscene.scene.scene_file import load_scene, scene_model
from lidarscene.scene.street import layout as laid
from lidarscene.scene.street import traffic as driven
from lidarscene.scene.street.centre_line import ASIDE_M_S2, CentreLine, Profile, draw_profile
from lidarscene.scene.street.pieces import box_places_m
from lidarscene.scene.street.shapes import DISTRICTS, draw_vehicle, shapes, vehicle_length_m
from lidarscene.scene.street.street_file import StreetFile
from lidarscene.scene.street.street_tables import street_tables

SHORT = {"length_m": 60.0, "shown_m": 50.0}
SIZES_M = {
    "car": laid.CAR_M,
    "pedestrian": (0.82, 0.6),
    "hedge": (0.66, 2.05),
    "fence": (0.1, 2.0),
    "dustbin": (0.78, 0.58),
    "container": (1.08, 1.38),
    "cabinet": (0.36, 1.0),
    "letter_box": (0.53, 0.51),
    "gatepost": (0.46, 0.46),
    "barrier": (0.8, 2.0),
    "cone": (0.31, 0.31),
    "bush": (1.2, 1.2),
    "juniper": (0.5, 0.5),
}
POST_M = (0.32, 0.6)
"""Length and width of meshes; of trees the trunk, and a lamp's arm is overhead."""


def street(seed: int, **keys: object) -> StreetFile:
    return StreetFile(seed=seed, **{"length_m": 400.0, **keys})


def size_m(name: str) -> tuple[float, float]:
    # People come in many meshes, about as wide as the first, which is what layout and traffic keep room for.
    mesh = "pedestrian" if name in ("pedestrians", "walkers") else shapes()[name].mesh
    if mesh in catalog.vehicles():
        return catalog.vehicles()[mesh].size_m[:2]
    if "plot_m" in catalog.shipped_meshes()[mesh]:
        width, front, _ = catalog.shipped_meshes()[mesh]["plot_m"]
        return 2 * front, width
    return SIZES_M.get(mesh, POST_M)


def boxes(line: CentreLine, name: str, x_m: np.ndarray, y_m: np.ndarray, yaw_deg: np.ndarray) -> np.ndarray:
    """(n, 4, 2) corners in the world of a body's boxes at n places of the street."""
    east_m, north_m, heading = line.at(x_m, y_m).T
    yaw = heading + np.radians(yaw_deg)
    length, width = size_m(name)
    behind = -0.5 * length - (laid.EAVES_M if name.startswith("houses") else 0.0)
    ahead, left = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1), np.stack([-np.sin(yaw), np.cos(yaw)], axis=-1)
    corners = [(0.5 * length, 0.5), (behind, 0.5), (behind, -0.5), (0.5 * length, -0.5)]
    middle = np.stack([east_m, north_m], axis=-1)
    return np.stack([middle + along * ahead + width * across * left for along, across in corners], axis=1)


def meet(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Whether rectangles (..., 4, 2) overlap: their shadows on the sides of both do."""
    result = np.ones(np.broadcast_shapes(first.shape[:-2], second.shape[:-2]), dtype=bool)
    for sides in (first, second):
        for corner in (1, 3):
            axis = sides[..., corner, :] - sides[..., 0, :]
            a, b = (np.einsum("...ij,...j->...i", each, axis) for each in (first, second))
            result &= (a.max(axis=-1) > b.min(axis=-1)) & (b.max(axis=-1) > a.min(axis=-1))
    return result


def standing_boxes(layout: laid.Layout) -> tuple[np.ndarray, list[str]]:
    """(n, 4, 2) corners and names of all that stands, on streets that cross, too; of trees the trunks."""
    rows = [(each.line, *row) for each in layout.streets for row in each.items.items()]
    corners = [boxes(line, name, *np.array(places).T) for line, name, places in rows]
    return np.concatenate(corners), [name for _, name, places in rows for _ in places]


LOOP = {"loop": True, "laps": 1, "length_m": 900.0}
JUNCTIONS = LOOP | {"corners": "junctions"}
STRAIGHT = CentreLine([(1000.0, 0.0, 0.0)], 0.0)


@pytest.mark.parametrize(
    ("seed", "keys"),
    chosen(1, [*itertools.product((1, 2, 3), ({"lanes": 1}, {"lanes": 2}, LOOP, JUNCTIONS, JUNCTIONS | {"lanes": 2}))]),
)
def test_nothing_that_stands_overlaps(seed: int, keys: dict[str, object]) -> None:
    """Houses, parked cars, trunks, posts and people are apart from each other and clear of all lanes and crossings."""
    layout = laid.lay_out(street(seed, parked_share=(0.5, 1.0), house_share=(0.5, 1.0), **keys))
    corners, names = standing_boxes(layout)
    assert len(names) > 200
    assert sum(name.startswith("bushes") for name in names) > 5
    for side_street in (*layout.side_streets, *layout.arms):
        assert sum(name.startswith("houses") for name in side_street.items) > 0, "a street that crosses has houses"
    overlaps = meet(corners[:, None], corners)
    np.fill_diagonal(overlaps, False)
    assert [(names[a], names[b]) for a, b in zip(*np.nonzero(overlaps), strict=True)] == []
    assert on_roads(layout) == []


@pytest.mark.parametrize(("lanes", "pavement_m"), chosen(1, [*itertools.product((1, 2, 3), (2.8, 6.0, 10.0))]))
def test_nothing_stands_on_the_streets_that_lead_away_from_junctions(lanes: int, pavement_m: float) -> None:
    """Their room is taken from one end to the other, whatever the widths, before anything is built."""
    layout = laid.lay_out(street(1, **JUNCTIONS | {"length_m": 1200.0, "lanes": lanes, "pavement_m": pavement_m}))
    assert on_roads(layout) == []
    for arm in layout.arms:
        assert arm.begin_m >= layout.front_m, "the square ends beyond the pavements"
        for x_m in np.arange(arm.begin_m + 1.0, arm.end_m, 2.0):
            assert not arm.room.is_free(np.append(arm.line.at(np.array([x_m]), np.zeros(1)), [[0.1, 0.1]], axis=1))


def on_roads(layout: laid.Layout) -> list[str]:
    """Names of what stands on the lanes of a street, each metre, and on streets that cross it or lead away."""
    (corners, names), found = standing_boxes(layout), []
    for each in layout.streets:
        way_m = np.arange(each.begin_m, each.end_m, 1.0)
        is_alike = each.file is layout.file
        road_m = 2 * (each.file.lanes * each.file.lane_width_m if is_alike else each.kerb_m)
        places = ribbon(each, way_m, np.zeros(len(way_m)), (1.2, road_m))
        found += [names[index] for index in np.flatnonzero(meet(corners[:, None], places).any(axis=1))]
    return found


def ribbon(layout: laid.Layout, x_m: np.ndarray, y_m: np.ndarray, size_m: tuple[float, float]) -> np.ndarray:
    """(n, 4, 2) corners of rectangles along the street."""
    east_m, north_m, yaw = layout.line.at(x_m, y_m).T
    ahead, left = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1), np.stack([-np.sin(yaw), np.cos(yaw)], axis=-1)
    signs = np.array([(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)]) * size_m
    return np.stack([east_m, north_m], axis=-1)[:, None] + signs[:, :1] * ahead[:, None] + signs[:, 1:] * left[:, None]


@pytest.mark.parametrize("seed", chosen(1, [1, 2]))
def test_the_way_is_driven_to_its_end_by_the_rules(seed: int) -> None:
    """The way goes from 0 to its length, never back, never faster than a driver wants, never braking harder than
    drivers do.

    It brakes for whoever crosses, even if they are across before it stands, and there is always traffic.
    """
    file = street(seed, length_m=1000.0, stop_share=1.0)
    layout = laid.lay_out(file)
    traffic = driven.drive(layout)
    ego = traffic.ego
    assert ego.x_m[0] == pytest.approx(0.0, abs=1e-9)
    assert ego.x_m[-1] == pytest.approx(1000.0, abs=1.0)
    speed_m_s = np.diff(ego.x_m) / np.diff(ego.time_s)
    assert speed_m_s.min() >= 0.0
    assert speed_m_s.max() <= file.speed_m_s[1]
    # A mean over half a second brakes no harder than the hardest moment.
    assert np.diff(speed_m_s).min() / 0.5 > -driven.HARDEST_M_S2
    lines_m = [crossing.stop_x_m(1) for crossing in layout.crossings if 30.0 < crossing.x_m < 980.0]
    before = [(ego.x_m[1:] > line_m - 15.0) & (ego.x_m[1:] < line_m) for line_m in lines_m]
    assert all(speed_m_s[near].min() < 0.7 * file.speed_m_s[0] for near in before)
    present = [((t.time_s[0] <= ego.time_s) & (ego.time_s <= t.time_s[-1])) for t in traffic.others]
    at_a_time = np.sum(present, axis=0)
    assert at_a_time.min() >= 4
    assert at_a_time.max() <= 60


def test_drivers_keep_the_gap_of_the_model() -> None:
    """A platoon behind a steady leader settles to the equilibrium gap, (s0 + v T) / sqrt(1 - (v / v0)^4), to 1 %.

    Two roads: the formula at which the acceleration (T173) is 0, and 200 s of driving.
    """
    pace_m_s, desired_m_s = 8.0, np.array([8.0, 12.0, 14.0])
    gap_m = (driven.STANDING_GAP_M + driven.HEADWAY_S * pace_m_s) / np.sqrt(1.0 - (pace_m_s / desired_m_s[1:]) ** 4)
    rates = driven.driver_acceleration_m_s2(
        speed_m_s=np.full(2, pace_m_s), desired_m_s=desired_m_s[1:], gap_m=gap_m, closing_m_s=np.zeros(2)
    )
    np.testing.assert_allclose(rates, 0.0, atol=1e-12)
    # By hand: 12 m/s, 3 m/s faster than the one 50 m ahead, s* = 2.5 + 18 + 36 / (2 sqrt 3) = 30.892 m.
    rate = driven.driver_acceleration_m_s2(
        speed_m_s=np.array([12.0]), desired_m_s=np.array([15.0]), gap_m=np.array([50.0]), closing_m_s=np.array([3.0])
    )
    np.testing.assert_allclose(rate, 1.5 * (1.0 - 0.4096 - (30.8923 / 50.0) ** 2), atol=1e-4)
    front_m = np.array([0.0, -40.0, -60.0])
    lengths_m = np.array([4.4, 18.0, 2.1])
    # On a loop the first is behind the last, here the slowest.
    for loop_m, order in ((np.inf, [0, 1, 2]), (200.0, [1, 2, 0])):
        numbers = (front_m, np.full(3, 8.0), desired_m_s[order], lengths_m)
        lane = driven._Lane(STRAIGHT, 0.0, 1, *numbers, ["car"] * 3, loop_m)
        for _ in range(2000):
            lane.step([], 1e7)
        rear_m = lane.front_m - lengths_m
        ahead_m = np.append(rear_m[-1] + loop_m, rear_m[:-1]) - lane.front_m
        np.testing.assert_allclose(ahead_m[np.array(order) > 0], gap_m, rtol=0.01)


def one_at_10_m_s(front_m: float, length_m: float = 4.4) -> driven._Lane:
    """A lane with one vehicle."""
    pace_m_s = np.array([10.0])
    return driven._Lane(STRAIGHT, 0.0, 1, np.array([front_m]), pace_m_s, pace_m_s, np.array([length_m]), ["car"])


def test_a_closed_line_stops_those_who_can() -> None:
    """One stops, at 10 m/s, within 100 / (2 * 3.5) = 14.3 m: who is 14 m away drives on, who is 15 m away stops."""
    for room_m, stops in ((14.0, False), (15.0, True)):
        lane = one_at_10_m_s(-room_m)
        for _ in range(200):
            lane.step([0.0], 1e7)
        assert (lane.front_m[0] < 0.0) == stops
        assert (lane.speed_m_s[0] < 0.1) == stops


def test_a_crossing_closes_where_the_ego_vehicle_can_stop_and_is_near() -> None:
    """Reference: 25 m at 10 m/s and 2 m/s2: .7 of it and 2 m is too near, and 2 s and 6 m more than it too far."""
    crossing = laid.Crossing(100.0, 2.0, is_zebra=True)
    for room_m, closes in ((19.0, False), (20.0, True), (50.5, True), (51.5, False)):
        ego = one_at_10_m_s(crossing.stop_x_m(1) - room_m)
        closing = driven._Closing(crossing, {ego: ego.lines_m(crossing)}, 5.0)
        closing.update(0.0, ego, 0, [ego])
        assert closing.is_closed == closes, room_m


def test_others_cross_once_all_have_left_or_can_stop() -> None:
    """A bus of 12 m leaves a crossing of 10 m with its rear, and stops within 14.3 m before it."""
    clear, crossing = one_at_10_m_s(-15.0, 12.0), laid.Crossing(0.0, 5.0, is_zebra=True)
    for front_m, is_clear in ((-15.0, True), (-14.0, False), (21.0, False), (23.0, True)):
        lane = one_at_10_m_s(front_m, 12.0)
        closing = driven._Closing(crossing, dict.fromkeys((clear, lane), (0.0, 10.0)), 5.0, is_closed=True)
        for _ in range(30):
            closing.update(0.0, clear, 0, [clear, lane])
        assert closing.go_s == [0.0] * is_clear, front_m


def test_who_is_near_for_two_steps_is_shown() -> None:
    """A body that moves has two poses at least."""
    layout: Any = SimpleNamespace(file=StreetFile(shown_m=50.0))
    for x_m, shown in (([60, 51, 51, 60], []), ([60, 49, 51, 60], []), ([60, 50, -50, 60], [1, 2])):
        row = np.arange(4.0)
        track = driven._shown(layout, driven.Track("car", row, np.array(x_m, float), row, row), np.zeros(4))
        assert ([] if track is None else track.time_s.tolist()) == shown


def test_a_line_is_the_integral_of_its_curvature() -> None:
    """A clothoid of 40 m to a radius of 30 m ends where Fresnel's integrals say; it goes on before it."""
    rate = 1.0 / (30.0 * 40.0)
    line = CentreLine([(20.0, 0.0, 0.0), (40.0, 0.0, 1.0 / 30.0)], begin_m=-20.0)
    sine, cosine = fresnel(40.0 * np.sqrt(rate / np.pi))
    end = line.at(np.array([40.0]), np.zeros(1))[0]
    np.testing.assert_allclose(end, [np.sqrt(np.pi / rate) * cosine, np.sqrt(np.pi / rate) * sine, 2 / 3], atol=1e-9)
    np.testing.assert_allclose(line.at(np.array([-30.0]), np.array([2.0]))[0], [-30.0, 2.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("corners", chosen(1, ["bends", "junctions"]))
def test_a_loop_closes(corners: str) -> None:
    """It turns by 360 degrees; the vehicle comes back to the pose it left from, and brakes for the bends.

    One street of 80 has a driver so slow that no bend slows it.
    """
    wished = []
    for seed in chosen(2, [1, 2, 3]):
        file = street(seed, length_m=600.0, loop=True, corners=corners)
        layout = laid.lay_out(file)
        ends = layout.line.at(np.array([0.0, 600.0 - 1e-9]), np.zeros(2))
        np.testing.assert_allclose(ends[1, :2], ends[0, :2], atol=1e-8)
        assert abs(ends[1, 2] - ends[0, 2]) == pytest.approx(2.0 * np.pi, abs=1e-9)
        poses = street_tables(file)["ego"]["poses"]
        assert poses[0] | {"time_s": 0} == poses[-1] | {"time_s": 0}
        ego = driven.drive(layout).ego
        speed_m_s, middle_m = np.diff(ego.x_m) / np.diff(ego.time_s), 0.5 * (ego.x_m[1:] + ego.x_m[:-1])
        bent, lane_m = layout.line.curvature_per_m(middle_m), layout.lane_m(0, 1)
        wished.append(np.max(speed_m_s**2 * np.abs(bent) * (1.0 - bent * lane_m)) / ASIDE_M_S2)
        assert ego.x_m[-1] == pytest.approx(2 * 600.0, abs=1e-9)
    # Drivers lag behind the wish by up to 1.5; 1.63 where a lane's own bend has 9 m.
    assert 1.0 < max(wished) < 1.7, "the speed follows what the driver wishes for"


def test_the_vehicle_of_a_loop_drives_for_ever(tmp_path: Path) -> None:
    """An hour later it is on the road, at the place and speed of the first lap, and others are around it."""
    (tmp_path / "loop.toml").write_text('name = "loop"\n[street]\nlength_m = 500\nloop = true\nlaps = 1\n')
    scene = load_scene(tmp_path / "loop.toml")
    ego = scene.ego
    assert ego is not None
    assert ego.span_s == (-np.inf, np.inf)
    period_s = street_tables(StreetFile(length_m=500.0, loop=True, laps=1))["ego"]["poses"][-1]["time_s"]
    states = ego.at(np.array([7.0, 7.0 + 40 * period_s]))
    np.testing.assert_allclose(states.position_m[1], states.position_m[0], atol=1e-6)
    np.testing.assert_allclose(states.velocity_m_s[1], states.velocity_m_s[0], atol=1e-5)
    before, after = (pose_at(ego, 40 * period_s + shift_s).position_m for shift_s in (-1e-3, 1e-3))
    np.testing.assert_allclose(after, before, atol=1e-3)
    assert all(body.present_s == (-np.inf, np.inf) for body in scene.bodies)


def test_a_seed_is_a_street() -> None:
    first = street_tables(street(3))
    street_tables.cache_clear()
    again, other = street_tables(street(3)), street_tables(street(4))
    assert first is not again
    assert first == again
    assert first != other


def test_a_longer_street_keeps_its_drivers_and_its_numbers_in_sight_few() -> None:
    """Five minutes of driving: nothing comes twice, and no more is there at a time than in a seventh of it."""
    most = []
    for length_m in (400.0, 3000.0):
        layout = laid.lay_out(street(5, length_m=length_m))
        traffic = driven.drive(layout)
        spans = np.array([(track.time_s[0], track.time_s[-1]) for track in traffic.others])
        most.append(max(int(((spans[:, 0] <= t) & (t <= spans[:, 1])).sum()) for t in traffic.ego.time_s))
    assert traffic.ego.time_s[-1] > 300.0
    # The largest of seven times as many moments is larger by chance, up to 1.9 times; all at once would be 7 times.
    assert most[1] < 3.0 * most[0]
    gaps_m = np.diff(sorted(x_m for x_m, *_ in layout.items["lamp_posts"]))
    assert len(np.unique(np.round(gaps_m, 6))) > 0.9 * len(gaps_m)


def test_each_stop_line_lies_where_drivers_stop() -> None:
    """Lines for each crossing and direction, across the lanes on the right."""
    file = street(4)
    layout = laid.lay_out(file)
    (lines,) = (body for body in street_tables(file)["bodies"] if body["name"] == "stop_lines")
    painted = np.array([place["position_m"][:2] for place in lines["instances"]])
    expected = [
        layout.line.at(np.array([crossing.stop_x_m(to)]), np.array([-to * 0.5 * file.lanes * file.lane_width_m]))[0, :2]
        for crossing in layout.crossings
        for to in (1, -1)
    ]
    assert len(painted) == len(expected) >= 4
    gaps_m = np.hypot(*(painted[:, None] - np.array(expected)).transpose(2, 0, 1))
    assert gaps_m.min(axis=0).max() < 0.3


@pytest.mark.parametrize("loop", chosen(1, [False, True]))
def test_kerbs_go_round_the_corners_of_streets_that_cross(loop: bool) -> None:
    """Four at each, 0.15 m wide and as long as a pavement with its kerb, between those along both streets."""
    files = (street(seed, length_m=900.0, loop=loop) for seed in itertools.count(4))
    file = next(file for file in files if any(not crossing.is_zebra for crossing in laid.lay_out(file).crossings))
    layout, bodies = laid.lay_out(file), street_tables(file)["bodies"]
    (corners,) = (body for body in bodies if body["name"] == "kerbs_of_corners")
    assert corners["size_m"] == [laid.KERB_M, file.pavement_m + laid.KERB_M]
    expected = [
        layout.line.at(
            np.array([crossing.x_m + along * (laid.CROSS_HALF_M + 0.5 * laid.KERB_M)]),
            np.array([side * 0.5 * (layout.kerb_m + layout.front_m)]),
        )[0, :2]
        for crossing in layout.crossings
        if not crossing.is_zebra
        for along in (-1, 1)
        for side in (1, -1)
    ]
    places_m = np.array([place["position_m"] for place in corners["instances"]])
    assert len(places_m) == len(expected) >= 4
    np.testing.assert_allclose(places_m[:, :2], expected, atol=1e-3)
    names = {f"pavement_{number}_{side}" for number in range(len(layout.blocks)) for side in ("left", "right")}
    lines_m = [np.array(body["line"])[:, :2] for body in bodies if body["name"] in names]
    pavement_m = sum(float(np.hypot(*np.diff(line_m, axis=0).T).sum()) for line_m in lines_m)
    blocks_m = sum(block.length_m for block in layout.blocks)
    assert 2.0 * blocks_m - pavement_m == pytest.approx(len(expected) * laid.KERB_M, abs=0.15)


@pytest.mark.parametrize(("seed", "lanes", "pavement_m"), chosen(1, [(1, 1, 10.0), (2, 3, 3.2), (3, 2, 3.2)]))
def test_a_junction_is_road_and_pavement_without_a_gap_and_the_lanes_are_on_its_road(seed, lanes, pavement_m, tmp_path):
    """Its square is one ground at each place, the soil behind its cut corners left out; four streets begin there.

    A car keeps 0.5 m to the kerbs on each lane.
    """
    file = street(seed, lanes=lanes, pavement_m=pavement_m, **JUNCTIONS)
    path = write_street(street_tables(file), tmp_path / "loop", origin="junctions")
    of_class = {name: grounds(path, name) for name in ("road", "pavement", "kerb")}
    layout = laid.lay_out(file)
    assert len(layout.junctions) == 6
    assert len(layout.arms) == 12
    for junction in layout.junctions:
        x_m, y_m, heading = junction.middle
        places_m = box_places_m((x_m, y_m, heading, junction.half_m - 0.02, junction.half_m - 0.02), 0.35)
        cos, sin = np.cos(heading), np.sin(heading)
        local_m = np.abs((places_m - [x_m, y_m]) @ np.array([[cos, -sin], [sin, cos]]))
        behind = local_m.sum(axis=1) > layout.front_m + junction.half_m - 0.1
        covers = sum(np.isfinite(each.height_m(places_m)).astype(int) for each in of_class.values())
        assert set(covers[~behind]) == {1}
        edges_m = junction.half_m + np.array([-0.01, 0.01])
        for turn in heading + 0.5 * np.pi * np.arange(4):
            ends_m = [x_m, y_m] + edges_m[:, None] * [np.cos(turn), np.sin(turn)]
            heights_m = of_class["road"].height_m(ends_m)
            assert abs(heights_m[1] - heights_m[0]) < 0.01, "a road begins at each side, as high"
    way_m = np.arange(0.0, 900.0, 0.5)
    for lane in range(lanes):
        for direction in (1, -1):
            for aside_m in (-1.4, 0.0, 1.4):
                place_m = layout.line.at(way_m, np.full(len(way_m), layout.lane_m(lane, direction) + aside_m))[:, :2]
                assert np.isfinite(of_class["road"].height_m(place_m)).all()
                assert np.isnan(of_class["kerb"].height_m(place_m)).all()


def test_traffic_lights_stand_by_stop_lines_and_face_those_who_wait() -> None:
    """Two for each street that crosses, on the right of both directions, beside the lanes."""
    layout = next(layout for seed in itertools.count(4) if "lights" in (layout := laid.lay_out(street(seed))).items)
    lights = layout.items["lights"]
    crossings = [crossing for crossing in layout.crossings if not crossing.is_zebra]
    assert len(lights) == 2 * len(crossings) > 0
    for crossing in crossings:
        for to in (1, -1):
            (light,) = (place for place in lights if abs(place[0] - crossing.stop_x_m(to)) < 1e-9)
            assert light[1] == pytest.approx(-to * (layout.kerb_m + laid.POST_LINE_M))
            assert np.cos(np.radians(light[2])) == pytest.approx(-to), "its front is where they come from"


@cache
def layouts() -> list[laid.Layout]:
    """Forty streets full of parked vehicles."""
    return [laid.lay_out(street(seed, parked_share=(0.5, 1.0))) for seed in range(1, 41)]


def test_a_thousand_vehicles_are_of_all_classes_by_their_shares_and_as_long_as_real_ones() -> None:
    """Cars are 3.88 m long on average in KITTI and 4.63 m in nuScenes (type means, anchors); ours are between.

    Shares of classes of parked vehicles, and of paints, are those stated to four standard deviations of 3,000.
    Rationale: with three of 1,500 one of the fourteen was beyond in a run of 25.
    """
    parked = [
        (shapes()[name], catalog.vehicles()[shapes()[name].mesh])
        for layout in layouts()
        for name, places in layout.items.items()
        for _ in places
        if name.startswith("parked")
    ]
    assert len(parked) > 2000
    parked_shares = catalog.street_parts()["parked"]
    assert {body.class_name for _, body in parked} == set(parked_shares)
    assert len({body.size_m for _, body in parked}) >= 35
    for shares, found in (
        (parked_shares, Counter(body.class_name for _, body in parked)),
        (catalog.paint_shares(), Counter(shape.materials["paint"] for shape, _ in parked)),
    ):
        for name, share in shares.items():
            deviation = np.sqrt(share * (1.0 - share) * len(parked))
            assert abs(found[name] - share * len(parked)) < 4.0 * deviation, name
    sizes_m = np.array([body.size_m for _, body in parked if body.class_name == "car"])
    length_m, width_m, height_m = sizes_m.mean(axis=0)
    assert 3.88 < length_m < 4.63
    assert 1.63 < width_m < 1.97
    assert 1.50 < height_m < 1.74
    assert sizes_m[:, 0].std() > 0.3


def test_lorries_and_buses_drive_where_the_street_is_straight_enough_for_them() -> None:
    """The ends of a vehicle swing out by L^2 / (8 r), within its lane: bends of 25 m leave out what is longer than 7 m.

    On straight streets some of all that drive have 16 m and more.
    """
    for bend_deg in ((10.0, 60.0), (0.0, 0.0)):
        for seed in (1, 2):
            layout = laid.lay_out(street(seed, bend_deg=bend_deg))
            for track in driven.drive(layout).others:
                if "traffic" in track.name:
                    length_m, width_m, _ = catalog.vehicles()[shapes()[track.name].mesh].size_m
                    sharpest_per_m = layout.line.sharpest_per_m(layout.begin_m, layout.end_m, float(track.y_m[0]))
                    assert width_m + length_m**2 * sharpest_per_m / 4.0 <= 3.2 - 0.1

    def drawn_m(curvature_per_m: float) -> np.ndarray:
        keys = {"longest_m": np.inf, "widest_m": 3.1, "curvature_per_m": curvature_per_m}
        share = np.linspace(0.0, 1.0, 500, endpoint=False)
        return np.array([vehicle_length_m(draw_vehicle("traffic", each, 0.5, **keys)) for each in share])

    assert 6.9 < drawn_m(1.0 / 25.0).max() < 7.0
    lengths_m = drawn_m(0.0)
    assert lengths_m.max() > 16.0
    assert 0.03 < np.mean(lengths_m > 8.0) < 0.12


@pytest.mark.parametrize("seed", chosen(1, [1, 2, 3]))
def test_a_narrow_pavement_has_room_for_who_walks_there(seed: int) -> None:
    """Who stands or waits keeps to the kerb, 0.4 m from those who walk; no conifer stands where people go.

    On one of twenty streets nobody waits.
    """
    keys = {"pavement_m": 2.8, "standing_spacing_m": (8.0, 12.0), "zebra_share": 1.0, "stop_share": 1.0}
    layout = laid.lay_out(street(seed, **keys))
    traffic = driven.drive(layout)
    waiting = [track.y_m[0] for track in traffic.others if track.name == "walkers" and abs(track.yaw_deg[0]) == 90.0]
    standing = [y_m for _, y_m, _ in layout.items["pedestrians"]]
    assert standing
    assert np.abs([*waiting, *standing]).max() <= layout.walk_m(-1) - 0.55
    stems = [y_m for name in layout.items if "conifer" in name for _, y_m, _ in layout.items[name]]
    assert not stems or np.abs(stems).min() > layout.front_m


def test_streets_of_different_seeds_have_different_houses_and_trees() -> None:
    """Half of the pairs of ten streets share less than half of their kinds of houses and trees.

    All houses come up on forty; rationale: on ten streets one was missing in one of five runs.
    """
    kinds = [{name for name in layout.items if name.startswith(("houses", "trees"))} for layout in layouts()]
    shared = [len(a & b) / len(a | b) for a, b in itertools.combinations(kinds[:10], 2)]
    assert np.median(shared) < 0.5
    houses = {shapes()[name].mesh for each in kinds for name in each if name.startswith("houses")}
    assert houses == {house for district in DISTRICTS for house in district.houses}


@pytest.mark.parametrize("seed", chosen(1, [1, 2, 3]))
def test_one_of_24_who_move_rolls_in_a_wheelchair_and_nobody_who_stands(seed: int) -> None:
    bodies = street_tables(street(seed, walking_spacing_m=(15.0, 30.0)))["bodies"]
    (chair,) = (body for body in bodies if "wheelchair" in body["name"])
    assert (chair["class"], chair["animation"]) == ("wheelchair_user", "roll")
    walkers = [len(body["instances"]) for body in bodies if body["name"].startswith("walkers")]
    assert 1 <= len(chair["instances"]) <= sum(walkers) // 24
    for instance in chair["instances"]:
        places_m = np.array([pose["position_m"][:2] for pose in instance["motion"]["poses"]])
        assert (np.hypot(*np.diff(places_m, axis=0).T) > 0.0).all()


def test_a_pram_rolls_before_who_pushes_it() -> None:
    """Each that pushes has one, which goes where its pusher goes, and rolls."""
    bodies = {body["name"]: body for body in street_tables(street(1, walking_spacing_m=(15.0, 30.0)))["bodies"]}
    pusher, pram = bodies["walkers_woman_pram"], bodies["prams"]
    assert (pram["class"], pram["animation"], pram["on_ground"]) == ("pram", "roll", True)
    assert pram["instances"] == pusher["instances"]


def test_a_wet_street_has_wet_ground_and_nothing_else() -> None:
    dry, wet = (street_tables(street(4, wet=is_wet))["bodies"] for is_wet in (False, True))
    changed = {(a["material"], b["material"]) for a, b in zip(dry, wet, strict=True) if a != b}
    assert changed == {("asphalt", "asphalt_wet"), ("concrete", "concrete_wet")}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A scene file with [street], and the file with all bodies that is written of the same."""
    folder = tmp_path_factory.mktemp("street")
    (folder / "table.toml").write_text('name = "street"\n[street]\nseed = 7\nlength_m = 60\nshown_m = 50\n')
    return folder / "table.toml", write_street(
        street_tables(StreetFile(seed=7, **SHORT)), folder / "out", origin="seed = 7"
    )


def test_the_file_is_the_scene_of_the_table(written: tuple[Path, Path]) -> None:
    """Body by body, pose by pose, to the bit: names, classes, places, motions."""
    table, file = (load_scene(path) for path in written)
    assert [(b.name, b.class_name, b.present_s) for b in table.bodies] == [
        (b.name, b.class_name, b.present_s) for b in file.bodies
    ]
    for a, b in zip(table.bodies, file.bodies, strict=True):
        np.testing.assert_array_equal(a.pose.position_m, b.pose.position_m)
        np.testing.assert_array_equal(a.pose.rotation, b.pose.rotation)
        if a.motion is not None and b.motion is not None:
            time_s = 0.5 * sum(np.clip(a.present_s, 0.0, 10.0))
            np.testing.assert_array_equal(pose_at(a.motion, time_s).position_m, pose_at(b.motion, time_s).position_m)
    assert table.ego is not None
    assert table.ego.span_s == (-np.inf, np.inf)
    classes = {"road", "pavement", "kerb", "terrain", "lane_marking", "building", "car", "vegetation", "pedestrian"}
    assert {body.class_name for body in table.bodies} >= classes | {"sign", "pole", "child"}
    assert {path.suffix for path in written[1].parent.rglob("*") if path.is_file()} == {".toml", ".glb", ".csv"}


def test_keys_of_a_street_and_of_its_bodies_can_be_changed(written: tuple[Path, Path]) -> None:
    """`--scene-set` reaches the street before it is made, and its bodies after."""
    path, _ = written
    model = scene_model(
        path, overrides=["street.lanes=2", "street.seed=4", "bodies.own_car.scale=1.1", "sun.elevation_deg=10"]
    )
    widths_m = [body.width_m for body in model.bodies if body.name == "road_0"]
    assert widths_m == [2 * (2 * 3.2 + laid.PARKING_M)]
    assert next(body.scale for body in model.bodies if body.name == "own_car") == 1.1
    assert model.sun.elevation_deg == 10
    assert model.sun.azimuth_deg == street_tables(StreetFile(seed=4)).get("sun", {})["azimuth_deg"]


def test_heights_are_sums_of_slopes() -> None:
    """The reference is sums over steps of a millimetre."""
    profile = Profile(np.array([-20.0, 10.0, 50.0, 90.0]), np.array([0.0, 0.06, 0.06, -0.02]))
    fine_m = np.arange(-20.0, 90.0, 1e-3)
    rise_m = np.cumsum(1e-3 * np.interp(fine_m + 5e-4, profile.node_m, profile.slope))
    way_m = np.array([-20.0, -3.0, 20.0, 55.5, 90.0])
    np.testing.assert_allclose(profile.height_m(way_m), np.interp(way_m, fine_m + 1e-3, rise_m), atol=1e-4)


@pytest.mark.parametrize("keys", [LOOP, JUNCTIONS, {}])
@pytest.mark.parametrize("seed", chosen(1, [1, 2, 3]))
def test_hills_are_as_steep_as_asked_and_level_at_crossings(seed: int, keys: dict[str, Any]) -> None:
    """A loop is as high at its end as at its begin, for which all its slopes change by as much."""
    layout = laid.lay_out(street(seed, **{"length_m": 900.0, "slope_percent": (4.0, 8.0), **keys}))
    profile = layout.profile
    steepest = profile.slope[np.abs(profile.slope) > 0.0]
    assert len(steepest) > 5
    assert {-1.0, 1.0} == set(np.sign(steepest))
    if keys:
        assert profile.height_m(profile.node_m[-1:])[0] == pytest.approx(0.0, abs=1e-9)
        assert np.abs(steepest).max() < 0.16
    else:
        assert 0.04 <= np.abs(steepest).min() <= np.abs(steepest).max() <= 0.08
    for crossing in layout.crossings:
        if not crossing.is_zebra:
            over_m = crossing.x_m + np.linspace(-1.0, 1.0, 9) * crossing.half_m
            np.testing.assert_allclose(profile.slope_at(over_m), 0.0, atol=1e-12)
            np.testing.assert_allclose(np.ptp(profile.height_m(over_m)), 0.0, atol=1e-12)
    for number, arm in enumerate(layout.arms):
        (height_m,) = layout.height_m(np.array([layout.junctions[number // 2].end_m]))
        np.testing.assert_allclose(arm.height_m(np.array([0.0, arm.end_m])), height_m, atol=1e-12)
    assert draw_profile(street(seed), [(0.0, 300.0)], np.random.default_rng(1)).is_level


@pytest.fixture(scope="module")
def hills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scene file of a street with hills."""
    file = StreetFile(seed=5, length_m=120.0, shown_m=60.0, slope_percent=(6.0, 9.0), parked_share=(0.5, 1.0))
    return write_street(street_tables(file), tmp_path_factory.mktemp("hills") / "out", origin="hills")


def test_nothing_floats_on_hills(hills: Path) -> None:
    """Soil is 0 to 0.25 m below roads, whose sides reach down 0.3 m; houses stand in it, and not deep."""
    soil, roads, scene = grounds(hills, "terrain"), grounds(hills, "road", "pavement", "kerb"), scene_of(hills)
    for sheet in roads.sheets:
        place_m = sheet.pose.apply(sheet.vertices_m.reshape(-1, 3))
        raised_m = 0.0 if sheet.pose.position_m[2] != 0.12 else 0.12
        over_m = place_m[:, 2] - soil.height_m(place_m[:, :2])
        assert raised_m < over_m.min()
        assert over_m.max() < raised_m + 0.25
    houses = [body for body in scene.bodies if body.class_name == "building"]
    assert np.ptp([house.pose.position_m[2] for house in houses]) > 4.0
    for house in houses:
        (below_m,) = soil.height_m(house.pose.position_m[None, :2])
        assert house.pose.position_m[2] < below_m + 0.15
        assert house.pose.position_m[2] > below_m - 2.0


def test_who_parks_drives_and_walks_on_a_hill_is_along_its_slope(hills: Path) -> None:
    """Axes of bodies against the heights of the ground ahead and behind; houses, lamps and trees are upright."""
    ground, scene, slopes = grounds(hills, "road", "pavement"), scene_of(hills), []
    for body in scene.bodies:
        if body.class_name in ("pole", "sign", "building", "vegetation") and "hedge" not in body.name:
            np.testing.assert_allclose(body.pose.rotation[:, 2], [0.0, 0.0, 1.0], atol=1e-12)
        if not body.name.startswith(("parked", "traffic", "walkers")):
            continue
        poses = [body.pose]
        if body.motion is not None:
            poses = [pose_at(body.motion, float(time_s)) for time_s in np.linspace(*body.present_s, 5)[1:-1]]
        for pose in poses:
            rear_m, front_m = ground.height_m(pose.apply(np.array([[-0.3, 0.0, 0.0], [0.3, 0.0, 0.0]]))[:, :2])
            if abs(front_m - rear_m) < 0.1:  # both on the road or both on the pavement
                slopes.append((front_m - rear_m) / 0.6)
                # Poses lie some metres apart: between two of them the axis turns evenly, and the ground need not.
                assert pose.rotation[2, 0] == pytest.approx(slopes[-1], abs=0.03), body.name
    assert len(slopes) > 40
    assert max(slopes) > 0.05
    assert min(slopes) < -0.05
