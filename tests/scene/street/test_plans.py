"""Laws of the geometry of streets: lengths, areas, headings, curvature and symmetry, without meshes and renderers."""

import itertools
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lidarscene.catalog import shipped_meshes
from lidarscene.errors import OptionWarning
from lidarscene.scene.ground_area import Outline
from lidarscene.scene.street import centre_line as lines
from lidarscene.scene.street import layout as laid
from lidarscene.scene.street import network_tables as tables
from lidarscene.scene.street import sumo, terrain
from lidarscene.scene.street import traffic as driven
from lidarscene.scene.street.islands import LAP_M, islands_between_m, kerbed_corner_m, ring_island_m
from lidarscene.scene.street.pieces import SOIL_M, SOIL_REACH_M, Tables, box_places_m, placed, soil_tiles
from lidarscene.scene.street.polylines import along, on_line, way_length_m
from lidarscene.scene.street.shapes import DISTRICTS, FURNITURE, SIGNS, shapes
from lidarscene.scene.street.street_file import StreetFile

LEVEL = lines.Profile(np.array([-1e4, 1e4]), np.zeros(2))


def road(line_m, *width_m, kind="road", edge="a", lights=False, speed_m_s=14.0):
    return sumo.LaneGroup(kind, np.array(line_m, float), width_m or (3.0,), edge, lights, speed_m_s)


def area_m2(corner_m: np.ndarray) -> float:
    return Outline(corner_m=corner_m, spacing_m=1.0).area_m2()


# --- the middle of a street --------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.2, -1.0, np.pi / 2])
def test_a_bend_turns_by_its_angle_with_its_radius_and_alike_from_both_ends(angle: float) -> None:
    """Clothoids are 0.6 of the radius long, or half of the bend; the way back is the mirror image."""
    pieces = lines.bend(angle, 50.0)
    length_m = sum(piece[0] for piece in pieces)
    assert pieces[0][0] == pytest.approx(50.0 * min(0.6, abs(angle) / 2))
    line = lines.CentreLine([(10.0, 0.0, 0.0), *pieces, (10.0, 0.0, 0.0)], 0.0)
    way_m = np.linspace(0.0, line.length_m, 401)
    place = line.at(way_m, np.zeros(401))
    assert line.length_m == pytest.approx(20.0 + length_m)
    assert place[-1, 2] - place[0, 2] == pytest.approx(angle, abs=1e-12)
    assert line.curvature_per_m(np.array([10.0 + 0.5 * length_m]))[0] == pytest.approx(np.sign(angle) / 50.0)
    assert line.sharpest_per_m(0.0, line.length_m) == pytest.approx(1.0 / 50.0)
    # Lines beside it, on the inside and on the outside of the bend.
    for left_m in (8.0, -8.0):
        assert line.sharpest_per_m(0.0, line.length_m, left_m) == pytest.approx(1 / (50 - np.sign(angle) * left_m))
    assert line.sharpest_per_m(0.0, 9.0) == 0.0
    chord_m = np.hypot(*np.diff(place[:, :2], axis=0).T)
    np.testing.assert_allclose(chord_m, line.length_m / 400, rtol=1e-5)
    np.testing.assert_allclose(place[:, 2] + place[::-1, 2], angle, atol=1e-12)
    left = line.at(way_m, np.full(401, 2.0))
    aside = left[:, :2] - place[:, :2]
    np.testing.assert_allclose(aside, 2.0 * np.stack([-np.sin(place[:, 2]), np.cos(place[:, 2])], axis=1), atol=1e-12)
    turned = lines.CentreLine(line.pieces, 0.0, origin=(3.0, -4.0, 0.7)).at(way_m, np.zeros(401))
    back = (turned[:, :2] - [3.0, -4.0]) @ np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    np.testing.assert_allclose(back, place[:, :2], atol=1e-9)
    assert lines.bend(0.0, 50.0) == []


@pytest.mark.parametrize("seed", range(3))
def test_a_winding_street_has_the_bends_that_are_asked_for_and_never_meets_itself(seed: int) -> None:
    file = StreetFile(bend_deg=(20.0, 50.0), bend_radius_m=(30.0, 80.0), bend_spacing_m=(20.0, 90.0))
    line = lines.wind(file, -100.0, 1500.0, 9.0, np.random.default_rng(seed))
    wide = lines.wind(file, -100.0, 1500.0, 80.0, np.random.default_rng(seed))
    assert wide.sharpest_per_m(-100.0, 1500.0) == pytest.approx(1.0 / (1.1 * 80.0))  # or its pavements would fold
    np.testing.assert_allclose(line.node_m[[0, -1]], [-100.0, 1500.0])
    straights = [piece for piece in line.pieces if piece[1] == piece[2] == 0.0]
    assert all(20.0 <= length_m <= 90.0 for length_m, *_ in straights[:-1])
    assert straights[-1][0] >= 20.0
    groups = itertools.groupby(line.pieces, lambda piece: piece in straights)
    bends = [list(group) for is_straight, group in groups if not is_straight]
    assert len(bends) >= 5
    turns = np.degrees([sum(0.5 * each[0] * (each[1] + each[2]) for each in bend) for bend in bends])
    assert 20.0 - 1e-9 <= np.abs(turns).min() <= np.abs(turns).max() <= 50.0 + 1e-9
    assert np.abs(np.cumsum(turns)).max() <= 60.0 + 50.0
    radii_m = [1.0 / max(abs(each[1]) for each in bend) for bend in bends]
    assert 30.0 - 1e-9 <= min(radii_m) <= max(radii_m) <= 80.0 + 1e-9
    np.testing.assert_allclose(line.at(np.zeros(1), np.zeros(1)), 0.0, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_loop_is_closed_as_long_as_asked_and_an_l(seed: int) -> None:
    """Six right angles, five to one side and one to the other; each place comes again after a lap."""
    file = StreetFile(length_m=700.0, loop=True)
    line = lines.close(file, 12.0, np.random.default_rng(seed))
    assert line.length_m == pytest.approx(700.0)
    ends = line.at(np.array([0.0, 700.0 - 1e-9]), np.zeros(2))
    np.testing.assert_allclose(ends[1, :2], ends[0, :2], atol=1e-6)
    np.testing.assert_allclose(line.at(np.array([1400.0 + 33.0]), np.ones(1)), line.at(np.array([33.0]), np.ones(1)))
    turn = np.array([0.5 * length_m * (first + last) for length_m, first, last in line.pieces])
    corners = [sum(group) for has_turn, group in itertools.groupby(turn, lambda angle: angle != 0.0) if has_turn]
    np.testing.assert_allclose(np.abs(corners), np.pi / 2)
    assert sorted(np.sign(corners) * np.sign(sum(corners))) == [-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    assert all(length_m > 0.0 for length_m, *_ in line.pieces)


def test_drivers_brake_evenly_before_bends_and_alike_from_both_sides() -> None:
    """v^2 k is 1.5 m/s2 in the arc; v^2 falls by 3 m/s2 of the way before it, from where it falls as fast by itself.

    That is where 1.5 k' / k^2 = 3 in a clothoid with k' = 0.05 / 20 m; on a loop it holds for the next lap's bend, too.
    """
    bend = [(20.0, 0.0, 0.05), (20.0, 0.05, 0.05), (20.0, 0.05, 0.0)]
    falls_m = 100.0 + np.sqrt(1.5 / 3.0 / 0.0025)
    square = 1.5 / (0.0025 * (falls_m - 100.0))
    for is_loop in (False, True):
        line = lines.CentreLine([(100.0, 0.0, 0.0), *bend, (100.0, 0.0, 0.0)], 0.0, is_loop=is_loop)
        way_m, limit_m_s = line.speed_limit_m_s(1)
        back_m, other_m_s = line.speed_limit_m_s(-1)
        found = np.interp([130.0, 80.0, 259.0], way_m, limit_m_s) ** 2
        expected = [30.0, square + 3.0 * (falls_m - 80.0), square + 3.0 * (falls_m + 1.0)]
        np.testing.assert_allclose(found[: 2 + is_loop], expected[: 2 + is_loop], rtol=0.01)
        assert is_loop or found[2] > 5000.0
        np.testing.assert_allclose(np.interp(way_m - 260.0, back_m, other_m_s), limit_m_s, rtol=0.03)


@pytest.mark.parametrize("loop", [False, True])
@pytest.mark.parametrize("left_m", [-12.5, 4.8, 12.5])
def test_the_way_along_a_lane_is_that_of_its_places_and_leads_back(left_m: float, *, loop: bool) -> None:
    """Reference: sums of short chords between places of the lane, two laps of a loop, to a millimetre."""
    radii_m, turns_deg = (20.0, 20.0), (60.0, 60.0)
    file = StreetFile(length_m=400.0, loop=loop, bend_spacing_m=(5.0, 10.0), bend_radius_m=radii_m, bend_deg=turns_deg)
    random = np.random.default_rng(3)  # of which Newton's steps from afar go to and fro
    line = lines.close(file, 8.0, random) if loop else lines.wind(file, -20.0, 420.0, 8.0, random)
    way_m = np.arange(0.0, 800.0 if loop else 400.0, 0.1)
    chord_m = np.hypot(*np.diff(line.at(way_m, np.full(len(way_m), left_m))[:, :2], axis=0).T)
    beside_m = line.way_beside_m(way_m, left_m)
    np.testing.assert_allclose(beside_m[0], 0.0, atol=1e-9)
    np.testing.assert_allclose(beside_m[1:], np.cumsum(chord_m), atol=1e-3)
    np.testing.assert_allclose(line.way_from_beside_m(beside_m, left_m), way_m, atol=1e-6)
    assert np.abs(beside_m - way_m).max() > 1.0


def test_points_of_a_line_are_on_it_and_straight_between_and_have_its_heights() -> None:
    line = lines.CentreLine([(50.0, 0.0, 0.0), (20.0, 0.0, 0.05), (20.0, 0.05, 0.0), (30.0, 0.0, 0.0)], 0.0)
    profile = lines.Profile(np.array([0.0, 60.0, 120.0]), np.array([0.0, 0.1, 0.0]))
    for heights in (LEVEL, profile):
        points_m = line.points_m(10.0, 110.0, heights)
        step_m = np.hypot(*np.diff(points_m[:, :2], axis=0).T)
        assert step_m.sum() == pytest.approx(100.0, abs=0.02)
        assert step_m.min() > 0.5
        way_m = np.concatenate([[10.0], 10.0 + np.cumsum(step_m)])
        np.testing.assert_allclose(points_m[:, 2], heights.height_m(way_m), atol=0.01)
    assert step_m.max() < 3.01 * lines.NODE_M


@pytest.mark.parametrize("loop", [False, True])
def test_hills_are_level_at_both_ends_of_each_part(loop: bool) -> None:
    file = StreetFile(slope_percent=(3.0, 8.0), loop=loop, length_m=900.0)
    profile = lines.draw_profile(file, [(0.0, 300.0), (308.0, 700.0)], np.random.default_rng(4))
    assert np.diff(profile.node_m).min() >= 0.0
    np.testing.assert_array_equal(profile.slope_at(np.array([0.0, 300.0, 304.0, 308.0, 700.0])), 0.0)
    steep = profile.node_m[np.abs(profile.slope) > 0.0].reshape(-1, 2)
    assert len(steep) == 3 + 4, "hills of 100 and 98 m, no more than 120"
    np.testing.assert_allclose(np.diff(steep, axis=1)[:, 0], [40.0] * 3 + [0.4 * 98.0] * 4)
    rise_m = profile.height_m(np.array([0.0, 700.0]))
    assert rise_m[0] == 0.0
    assert abs(rise_m[1]) < 1e-9 if loop else abs(rise_m[1]) > 0.01


# --- what stands and moves along it ------------------------------------------------------------------


def test_rectangles_overlap_where_a_grid_of_their_places_does() -> None:
    """40 pairs; what is taken is not free, and what touches nothing can be taken once."""
    random = np.random.default_rng(2)
    boxes = random.uniform([-4, -4, -3, 0.3, 0.3], [4, 4, 3, 3, 3], (40, 5))
    box = np.array([0.5, -0.3, 0.4, 2.0, 0.8])

    def within(places_m: np.ndarray, of_box: np.ndarray) -> np.ndarray:
        x_m, y_m = (places_m - of_box[:2]).T
        cos, sin = np.cos(of_box[2]), np.sin(of_box[2])
        return (np.abs(cos * x_m + sin * y_m) < of_box[3]) & (np.abs(cos * y_m - sin * x_m) < of_box[4])

    fine_m = box_places_m(tuple(box), 0.05)
    expected = [bool(within(fine_m, each).any()) for each in boxes]
    found = laid.overlaps(box, boxes)
    assert np.mean(found == expected) > 0.97  # a corner may reach between places
    assert 10 < found.sum() < 35
    for each, meets in zip(boxes, found, strict=True):
        room = laid.Room(each[None])
        assert room.is_free(box[None]) == (not meets)
        assert room.take(box[None]) == (not meets)
        assert not room.take(box[None])


def test_places_of_a_box_fill_it_and_its_corners() -> None:
    places_m = box_places_m((10.0, 20.0, np.pi / 2, 3.0, 1.0), 0.5)
    np.testing.assert_allclose([places_m.min(axis=0), places_m.max(axis=0)], [[9.0, 17.0], [11.0, 23.0]])
    steps_m = np.diff(np.unique(places_m[:, 1].round(9)))
    assert steps_m.max() <= 0.5


def test_poses_are_rounded_and_angles_are_within_half_a_turn() -> None:
    assert placed(1.23456, -1e-9, 2.0, 540.006, 0.004) == {"position_m": [1.235, 0.0, 2.0], "yaw_deg": -179.99}
    leaning = placed(0.0, 0.0, 0.0, 0.0, -1.5, 0.257)
    assert leaning == {"position_m": [0.0, 0.0, 0.0], "pitch_deg": -1.5, "roll_deg": 0.26}


def test_soil_reaches_beyond_roads_on_all_sides() -> None:
    places_m = np.array([[10.0, 0.0], [40.0, 5.0], [160.0, -80.0]])
    tiles_m = soil_tiles(places_m)
    assert len(np.unique(tiles_m, axis=0)) == len(tiles_m)
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    around_m = SOIL_REACH_M - 1.5 * SOIL_M
    for place_m in places_m:
        edge_m = place_m + around_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        assert (np.abs(edge_m[:, None] - tiles_m).max(axis=2).min(axis=1) <= 0.5 * SOIL_M).all()
    far_m = np.hypot(*(tiles_m[:, None] - places_m).transpose(2, 0, 1)).min(axis=1)
    assert far_m.max() < SOIL_REACH_M + 0.8 * SOIL_M


def test_who_crosses_goes_from_rest_to_rest_with_the_accelerations_of_drivers() -> None:
    time_s = np.arange(-1.0, 40.0, 0.01)
    way_m = driven._stop_and_go_m(np.maximum(time_s, 0.0), 70.0)
    speed = np.gradient(way_m, time_s)
    acceleration = np.gradient(speed, time_s)
    assert (way_m[0], way_m[-1]) == (0.0, 70.0)
    assert speed.min() > -1e-9
    assert speed.max() == pytest.approx(driven.CROSS_M_S, rel=1e-3)
    assert acceleration.max() == pytest.approx(driven.ACCELERATION_M_S2, rel=1e-2)
    assert acceleration.min() == pytest.approx(-driven.BRAKING_M_S2, rel=1e-2)


def test_who_walks_up_and_down_goes_round_at_an_even_pace_and_looks_ahead() -> None:
    layout = laid.lay_out(StreetFile(length_m=60.0, shown_m=50.0))
    radius_m = 0.5 * (layout.walk_m(1) - layout.walk_m(-1))
    round_m = 2.0 * 30.0 + 2.0 * np.pi * radius_m
    way_m = np.linspace(0.0, round_m, 2000)
    x_m, y_m, yaw_deg = driven._round_walk(layout, way_m, 30.0)
    np.testing.assert_allclose([x_m[-1], y_m[-1], yaw_deg[-1]], [x_m[0], y_m[0], yaw_deg[0] - 360.0], atol=1e-9)
    step_m = np.stack([np.diff(x_m), np.diff(y_m)])
    np.testing.assert_allclose(np.hypot(*step_m), round_m / 1999, rtol=1e-3)
    ahead = np.stack([np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))])[:, 1:]
    assert ((step_m * ahead).sum(axis=0) > 0.99 * np.hypot(*step_m)).all()
    np.testing.assert_allclose([y_m.max(), y_m.min()], [layout.walk_m(1), layout.walk_m(-1)], atol=1e-4)


@pytest.mark.parametrize("speed_m_s", driven.WALK_M_S)
def test_people_slow_down_to_turn(speed_m_s: float) -> None:
    """Reference: v / sqrt(1 + (0.9 m / r)^2) on half circles of 0.35 m, 1 m/s2 before and behind, v elsewhere."""
    way_m, at_s = driven._round_times(20.0, 0.35, speed_m_s)
    assert way_m[-1] == pytest.approx(40.0 + 0.7 * np.pi)
    pace_m_s = np.gradient(way_m, at_s)
    turning_m_s = speed_m_s / np.sqrt(1.0 + (0.9 / 0.35) ** 2)
    half_m = 20.0 + 0.35 * np.pi
    near = np.interp([10.0, 20.5, half_m + 10.0, half_m + 20.5], way_m, pace_m_s)
    np.testing.assert_allclose(near, np.tile([speed_m_s, turning_m_s], 2), rtol=1e-3)
    assert turning_m_s**2 / 0.35 < speed_m_s**2 / 1.8
    assert np.abs(np.gradient(pace_m_s, at_s)).max() == pytest.approx(1.0, abs=0.05)


def test_people_walk_as_far_to_the_one_end_of_a_block_as_to_the_other() -> None:
    """Reference: half circles of the pavement's two ways, 2 m before both ends, at an even pace on each side."""
    layout = laid.lay_out(StreetFile(length_m=60.0, shown_m=1000.0, walking_spacing_m=(10.0, 20.0)))
    time_s = np.arange(0.0, 600.0, 0.5)
    tracks = list(driven._walking_tracks(layout, time_s, np.random.default_rng(1)))
    turn_m = 2.0 - 0.5 * (layout.walk_m(1) - layout.walk_m(-1))
    with_people = 0
    for block in layout.blocks:
        for side in (-1.0, 1.0):
            in_block = [t for t in tracks if block.begin_m < t.x_m[0] < block.end_m and side * t.y_m[0] > 0.0]
            if not in_block:
                continue  # the shortest block may have room for nobody
            with_people += 1
            x_m = np.concatenate([track.x_m for track in in_block])
            ends_m = block.begin_m + turn_m, block.end_m - turn_m
            np.testing.assert_allclose([x_m.min(), x_m.max()], ends_m, atol=1.0)
            paces = [np.median(np.hypot(np.diff(t.x_m), np.diff(t.y_m)) / np.diff(t.time_s)) for t in in_block]
            assert np.ptp(paces) < 1e-3
            assert driven.WALK_M_S[0] <= paces[0] <= driven.WALK_M_S[1]
    assert with_people >= 2 * len(layout.blocks) - 2


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_people_keep_apart_on_the_inner_side_of_bends(seed: int) -> None:
    """Though 5 m along the middle of a wide street are 1.4 m there: a pram and who pushes it are 1.9 m long."""
    keys = {"bend_radius_m": (20.0, 20.0), "bend_spacing_m": (20.0, 30.0), "walking_spacing_m": (5.0, 5.0)}
    layout = laid.lay_out(StreetFile(length_m=60.0, shown_m=50.0, lanes=2, pavement_m=6.0, seed=seed, **keys))
    tracks = list(driven._walking_tracks(layout, np.arange(0.0, 60.0, 2.0), np.random.default_rng(seed)))
    assert len(tracks) > 20
    x_m, y_m = np.array([track.x_m for track in tracks]), np.array([track.y_m for track in tracks])
    place_m = layout.line.at(x_m.ravel(), y_m.ravel())[:, :2].reshape(*x_m.shape, 2)
    apart_m = np.hypot(*np.moveaxis(place_m[:, None] - place_m, -1, 0))
    of_one_way = (np.abs(y_m[:, None] - y_m) < 0.01) & ~np.eye(len(tracks), dtype=bool)[..., None]
    assert apart_m[of_one_way].min() > 1.9


def test_vehicles_begin_eight_metres_apart_whatever_their_lengths() -> None:
    keys = {"ahead": 5, "behind": 5, "bend_deg": (0.0, 0.0), "oncoming_gap_m": (5.0, 10.0)}
    layout, lengths_m = laid.lay_out(StreetFile(length_m=60.0, shown_m=50.0, **keys)), []
    for seed in range(20):
        for lane in driven._fill_lanes(layout, np.random.default_rng(seed)):
            assert (-np.diff(lane.front_m) - lane.lengths_m[:-1]).min() > 8.0 - 1e-9
            lengths_m += lane.lengths_m.tolist()
    assert max(lengths_m) > 14.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_who_wants_to_drive_fast_begins_where_one_can_brake(seed: int) -> None:
    """Nobody drives through another: 40 m/s behind cyclists at 18 m/s, at random places."""
    keys = {"speed_m_s": (40.0, 40.0), "oncoming_gap_m": (5.0, 15.0), "ahead": 5, "behind": 5}
    layout = laid.lay_out(StreetFile(length_m=60.0, shown_m=50.0, bend_deg=(0.0, 0.0), lanes=2, **keys))
    for lane in driven._fill_lanes(layout, np.random.default_rng(seed)):
        for _ in range(200):
            lane.step([], 1e6)
            assert (lane.front_m[:-1] - lane.lengths_m[:-1] - lane.front_m[1:]).min() > 0.0


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_what_stands_by_a_kerb_looks_at_the_road_and_has_room(seed: int) -> None:
    """Lamps and bins look at the lanes, signs at those who come; crowns end before the houses, and these before the
    ends of their block, with a gate in the hedge before each.
    """
    layout, meshes = laid.lay_out(StreetFile(seed=seed, length_m=400.0, house_share=(1.0, 1.0))), shipped_meshes()
    kinds = set()
    for street in layout.streets:
        plots_m: list[tuple[float, float, float]] = []
        for name, places in street.items.items():
            mesh = shapes()[name].mesh if name in shapes() else name
            x_m, y_m, yaw_deg = np.array(places).T
            side = np.sign(y_m)
            if name == "lamp_posts" or mesh in FURNITURE:
                np.testing.assert_array_equal(yaw_deg, -90.0 * side)
                kinds.add("lamp" if name == "lamp_posts" else "furniture")
            if mesh in SIGNS:
                np.testing.assert_array_equal(yaw_deg, np.where(side < 0.0, 180.0, 0.0))
                kinds.add("sign")
            if name.startswith("trees"):
                by_kerb = np.isclose(np.abs(y_m), street.kerb_m + laid.TREE_LINE_M)
                reach_m = shapes()[name].scale * meshes[mesh]["reach_m"]
                assert not by_kerb.any() or laid.TREE_LINE_M + reach_m <= street.front_m - street.kerb_m + 1e-9
                kinds |= {"tree"} if by_kerb.any() else set()
            if name.startswith("houses"):
                along = np.abs(yaw_deg) == 90.0  # and not at the end of a street
                half_m = 0.5 * meshes[mesh]["plot_m"][0] + 1.0 + street.file.pavement_m - 1e-9
                for place_m in x_m[along]:
                    assert any(b.begin_m + half_m <= place_m <= b.end_m - half_m for b in street.blocks)
                kinds.add("house")
                plots_m += [(*place, 0.5 * meshes[mesh]["plot_m"][0]) for place in zip(x_m, side, strict=True)]
        for name in ("hedges", "fences"):
            for x, y, _ in street.items.get(name, ()):
                gaps_m = [(abs(x - middle_m), half_m) for middle_m, side, half_m in plots_m if side * y > 0.0]
                assert any(gap_m - 1.0 >= 0.5 * laid.GATE_M and gap_m + 1.0 <= half_m for gap_m, half_m in gaps_m)
    assert kinds >= {"lamp", "furniture", "sign", "house"}


def test_lanes_are_on_the_right_and_stop_lines_before_crossings() -> None:
    layout = laid.lay_out(StreetFile(length_m=60.0, shown_m=50.0, lanes=2, lane_width_m=3.0))
    assert [layout.lane_m(lane, to) for lane in (0, 1) for to in (1, -1)] == [-1.5, 1.5, -4.5, 4.5]
    assert layout.kerb_m == 2 * 3.0 + laid.PARKING_M
    crossing = laid.Crossing(50.0, 4.0, is_zebra=False)
    assert [crossing.stop_x_m(to) for to in (1, -1)] == [44.0, 56.0]
    assert laid.Block(3.0, 10.0).length_m == 7.0


# --- terrain -----------------------------------------------------------------------------------------


def test_a_relief_has_the_heights_of_level_and_of_sloping_roads() -> None:
    """10 % along x; one road is above another where it is 2.5 m higher, and no farther aside than is asked for."""
    x_m, y_m = (each.ravel() for each in np.meshgrid(np.arange(0.0, 100.0, 2.0), np.arange(-4.0, 5.0, 2.0)))
    ramp = terrain.Relief(np.column_stack([x_m, y_m, 0.1 * x_m]))
    at_m = np.array([[50.0, 0.0], [33.0, 3.0], [60.0, -1.0]])
    np.testing.assert_allclose(ramp.height_m(at_m), 0.1 * at_m[:, 0], atol=0.01)
    np.testing.assert_allclose(ramp.distance_m(np.array([[50.0, 7.0], [-3.0, 0.0]])), [3.0, 3.0])
    assert not ramp.is_level
    over_m = np.column_stack([np.full(21, 50.0), np.arange(-20.0, 22.0, 2.0), np.full(21, 12.0)])
    both = terrain.Relief(np.concatenate([ramp.place_m, over_m]))
    np.testing.assert_array_equal(both.has_storey(over_m[[10, 17]], above=False, beside_m=3.0), [True, False])
    np.testing.assert_array_equal(both.has_storey(over_m[[17]], above=False, beside_m=12.0), [True])
    np.testing.assert_array_equal(both.has_storey(over_m[[10]], above=True, beside_m=3.0), [False])
    np.testing.assert_allclose(both.height_m(at_m[:1]), [5.0], atol=0.05)
    np.testing.assert_allclose(both.height_m(at_m[:1], np.array([12.0])), [12.0], atol=0.05)


def test_soil_is_a_skin_between_roads() -> None:
    """Laplace's equation: between two straight roads a plane; beside each road at its height, 8 cm below it."""
    x_m = np.arange(0.0, 400.0, 2.0)
    low, high = (np.column_stack([x_m, np.full(200, y_m), np.full(200, z_m)]) for y_m, z_m in ((0.0, 0.0), (60.0, 6.0)))
    soil = terrain.Terrain.around(terrain.Relief(np.concatenate([low, high]), 1.0))
    np.testing.assert_allclose(soil.height_m(np.array([[200.0, 0.0], [201.0, 61.0]])), [-0.08, 5.92], atol=0.01)
    across_m = np.column_stack([np.full(5, 200.0), np.linspace(15.0, 45.0, 5)])
    np.testing.assert_allclose(soil.height_m(across_m), np.linspace(1.5, 4.5, 5) - 0.08, atol=0.35)
    assert soil.lowest_m((200.0, 30.0, 0.3, 2.0, 10.0)) == pytest.approx(
        soil.height_m(np.array([[203.0, 20.0]]))[0], abs=0.3
    )


def test_a_stretched_skin_is_the_mean_of_its_neighbours() -> None:
    held, nodes_m = np.zeros((9, 7), dtype=bool), np.zeros((9, 7))
    held[[0, -1]], nodes_m[-1] = True, 4.0
    skin_m = terrain._stretched(nodes_m.copy(), held, np.ones((9, 7), dtype=bool))
    np.testing.assert_allclose(skin_m, np.linspace(0.0, 4.0, 9)[:, None] + np.zeros(7), atol=1e-9)


# --- networks ----------------------------------------------------------------------------------------


def test_places_along_a_line_of_two_legs() -> None:
    line_m = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 1.0], [3.0, 4.0, 3.0]])
    assert way_length_m(line_m) == 7.0
    np.testing.assert_allclose(along(line_m, np.array([1.0, 5.0]), 0.5), [[1.0, 0.5, 0.0], [2.5, 2.0, np.pi / 2]])
    np.testing.assert_allclose(on_line(line_m, np.array([1.5, 5.0])), [[1.5, 0.0, 0.5], [3.0, 2.0, 2.0]])


def test_an_island_fills_the_room_between_lanes_that_spread() -> None:
    """A trapezium: from 1 m apart to 3 m, over 20 m; nothing where lanes touch, are too far apart, or on the left."""
    there, back = road([(0, -2.0, 0), (20, -3.0, 0)]), road([(20, 3.0, 0), (0, 2.0, 0)])
    (island_m,) = islands_between_m(there, back)
    assert area_m2(island_m) == pytest.approx(20.0 * (2.0 + 2.0 * LAP_M), rel=0.01)
    assert np.abs(island_m[:, 1]).max() == pytest.approx(1.5 + LAP_M, abs=0.01)
    # Between arcs around one middle, too, with lanes 3 m wide.
    angle = np.linspace(0.0, 1.0, 40)
    arc_m = [r * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) for r in (30.0, 25.0)]
    (island_m,) = islands_between_m(road(arc_m[0].tolist()), road(arc_m[1][::-1].tolist()))
    assert area_m2(island_m) == pytest.approx(0.5 * ((28.5 + LAP_M) ** 2 - (26.5 - LAP_M) ** 2), rel=0.01)
    for right_m, left_m in ((-1.5, 1.5), (-9.0, 1.5), (3.0, -3.0)):
        lanes = road([(0, right_m, 0), (20, right_m, 0)]), road([(20, left_m, 0), (0, left_m, 0)])
        assert not list(islands_between_m(*lanes))


def test_the_island_of_a_ring_reaches_its_lanes_and_fills_the_gaps() -> None:
    quarters = [np.linspace(k, k + 1.2, 9) for k in (0.0, np.pi / 2, np.pi, 3 * np.pi / 2)]
    ring = [road([(5 + 20 * np.cos(a), 20 * np.sin(a), 2.0) for a in quarter]) for quarter in quarters]
    island_m = ring_island_m(ring)
    np.testing.assert_allclose(np.hypot(island_m[:, 0] - 5, island_m[:, 1]), 18.5 + LAP_M, atol=0.1)
    np.testing.assert_allclose(island_m[:, 2], 2.0)
    assert area_m2(island_m) == pytest.approx(np.pi * 18.5**2, rel=0.02)


@pytest.mark.parametrize("turned", [1, -1])
def test_a_corner_has_kerbs_along_the_road_and_nowhere_else(turned: int) -> None:
    """A pavement with the road on two sides: 0.15 m are taken off both sides, and they are one kerb."""
    # In no direction of the axes.
    turn = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    pavement_m = np.array([[0.0, 0, 0], [2, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 0]])[::turned] @ turn
    corner_m = np.array([[0.0, -9, 0], [9, -9, 0], [9, 3, 0], [4, 3, 0], [0, 3, 0]]) @ turn
    junction = Outline(corner_m=corner_m, spacing_m=1.0)
    inner_m, (kerb_m,) = kerbed_corner_m(pavement_m, junction)
    assert area_m2(inner_m) == pytest.approx((4 - laid.KERB_M) * (3 - laid.KERB_M))
    assert area_m2(kerb_m) == pytest.approx(12.0 - (4 - laid.KERB_M) * (3 - laid.KERB_M))
    elsewhere = Outline(corner_m=np.array([[50.0, 0, 0], [60, 0, 0], [60, 9, 0]]), spacing_m=1.0)
    assert kerbed_corner_m(pavement_m, elsewhere)[1] == []


def test_outlines_lose_repeated_and_folded_corners() -> None:
    square_m = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]])
    with_fold_m = np.insert(square_m, 3, [[2.0, 4, 0], [3, 4.1, 0]], axis=0)
    assert area_m2(sumo._unfolded(with_fold_m)) == pytest.approx(16.0, abs=0.3)
    np.testing.assert_array_equal(sumo._unfolded(square_m), square_m)
    wedge_m = np.array([[0.0, 0, 0], [6, 0, 0], [0, 2, 0]])
    np.testing.assert_array_equal(sumo._unfolded(wedge_m), wedge_m)
    flat_m = np.array([[0.0, 0, 0], [6, 0, 0], [3, 0, 0]])
    np.testing.assert_array_equal(sumo._unfolded(flat_m), flat_m)
    repeated_m = np.repeat(square_m, 2, axis=0)
    np.testing.assert_array_equal(sumo._without_repeats(np.concatenate([repeated_m, square_m[:1]])), square_m)


def test_who_turns_round_has_a_pose_between() -> None:
    """A turn from -170 to 170 degrees is one by 20; from 10 to -160 one by 170, half of which is a pose of its own."""
    rows = [(0.0, 0.0, 0.0, -170.0, 0.0), (1.0, 2.0, 0.0, 170.0, 0.0)]
    assert sumo._turned(rows) == rows
    (first, middle, last) = sumo._turned([(0.0, 0.0, 0.0, 10.0, 1.0), (1.0, 2.0, 4.0, -160.0, 3.0)])
    assert middle == (0.5, 1.0, 2.0, -75.0, 2.0)
    assert (first[3], last[3]) == (10.0, -160.0)


def test_a_bus_that_turns_round_leaps_by_the_way_of_its_front() -> None:
    """12 m long: its front stays where its middle goes by 12 m, and goes by 12 m where that stays."""
    bus = sumo.RoadUser("7", "bus", 12.0, [(0.0, 0.0, 0.0, 0.0, 0.0)])
    assert [sumo._leaps(bus, (1.0, x_m, 0.0, 180.0, 0.0), 0.0) for x_m in (12.0, 0.0)] == [False, True]


def test_a_vehicle_of_sumo_has_its_middle_behind_its_front() -> None:
    """Angles are clockwise from north: 90 is east."""
    keys = {"type": "bus", "x": "10", "y": "5", "angle": "90", "z": "2", "speed": "7.5"}
    kind, length_m, speed_m_s, pose = sumo._placed(ElementTree.Element("vehicle", keys), {"bus": ("bus", 12.0)})
    assert (kind, length_m, speed_m_s) == ("bus", 12.0, 7.5)
    np.testing.assert_allclose(pose, (4.0, 5.0, 0.0, 2.0), atol=1e-12)


@pytest.mark.parametrize("keeps_to", [-1.0, 1.0])
def test_kerbs_of_pavements_are_where_the_road_is(keeps_to: float) -> None:
    """Lanes begin at the side that traffic keeps to; a road of one direction may have pavements on both sides."""

    def lane(kind: str, y_m: float) -> SimpleNamespace:
        points_m = [(0.0, y_m, 0.0), (50.0, y_m, 0.0)]
        return SimpleNamespace(getShape3D=lambda: points_m, getWidth=lambda: 2.0, allows=lambda asked: asked == kind)

    lanes = [lane("pedestrian", 3.0 * keeps_to), lane("bus", 0.0), lane("pedestrian", -3.0 * keeps_to)]
    node = SimpleNamespace(getType=lambda: "priority")
    edge = SimpleNamespace(getLanes=lambda: lanes, getToNode=lambda: node, getID=lambda: "a", getSpeed=lambda: 9.0)
    pavements = [group.line_m for group in sumo._groups(edge) if group.kind == "pavement"]
    assert len(pavements) == 2
    for line_m in pavements:
        assert np.sign(line_m[1, 0] - line_m[0, 0]) == -np.sign(line_m[0, 1]), "the road is to the left"


def test_who_rolls_in_sumo_rolls(tmp_path: Path) -> None:
    """People whose type is of SUMO's class `wheelchair`, which is 1.2 m long by default; all others walk, 0.215 m."""
    (tmp_path / "a.rou.xml").write_text('<routes><vType id="rolls" vClass="wheelchair"/><vType id="slow"/></routes>')
    types = sumo._types([tmp_path / "a.rou.xml"])
    people = [ElementTree.Element("person", {"type": kind, "x": "10", "angle": "90"}) for kind in ("rolls", "slow")]
    (kind, length_m, _, pose), (other, _, _, its_pose) = (sumo._placed(thing, types) for thing in people)
    assert (kind, length_m, other) == ("wheelchair", 1.2, "pedestrian")
    assert (pose[0], its_pose[0]) == pytest.approx((9.4, 10.0 - 0.5 * 0.215))


@pytest.mark.parametrize("names", ["n r a", "net routes additional", "net-file route-files additional-files"])
def test_options_of_sumo_have_other_names(tmp_path: Path, names: str) -> None:
    for name in ("a.net.xml", "a.rou.xml", "a.add.xml"):
        (tmp_path / name).write_text(f'<routes><vType id="of_{name}" vClass="bus" length="9"/></routes>')
    values = zip(names.split(), ("a.net.xml", "a.rou.xml", "a.add.xml"), strict=True)
    rows = "".join(f'<{name} value="{value}"/>' for name, value in values)
    (tmp_path / "a.sumocfg").write_text(f"<configuration>{rows}</configuration>")
    scenario = sumo.read_scenario(tmp_path / "a.sumocfg")
    assert scenario.network == tmp_path / "a.net.xml"
    assert {"of_a.rou.xml", "of_a.add.xml"} < scenario.types.keys()


def test_traffic_of_the_left_is_told(tmp_path, monkeypatch):
    """Rationale: netconvert takes no notice of OpenDRIVE's rule, and vehicles drove on the right without a word."""
    monkeypatch.setattr(sumo, "_run", lambda *_: [])
    monkeypatch.setattr(sumo, "_home", lambda: tmp_path)
    (tmp_path / "left.xodr").write_text('<OpenDRIVE><road rule="LHT"/></OpenDRIVE>')
    with pytest.warns(OptionWarning, match=r"left\.xodr: .*\(rule LHT\)"):
        sumo.convert(tmp_path / "left.xodr", "opendrive", tmp_path)


@pytest.mark.parametrize("streets", [3, 4])
def test_a_drawn_town_is_a_grid_with_slopes_and_roads_that_spread(streets, tmp_path, monkeypatch):
    """SUMO is not run: slopes of neighbours, two directions of each street, a ring whose pieces go round it once."""
    monkeypatch.setattr(sumo, "_run", lambda *_: [])
    net, loop = sumo.draw_town(streets, tmp_path, seed=3, slopes=(0.02, 0.05))
    nodes = {node.get("id"): node for node in ElementTree.parse(net.with_name("drawn.nod.xml")).iter("node")}
    edges = {edge.get("id"): edge for edge in ElementTree.parse(net.with_name("drawn.edg.xml")).iter("edge")}
    place_m = {name: np.array([float(node.get(axis)) for axis in "xyz"]) for name, node in nodes.items()}
    shape_m = {
        name: np.array([at.split(",") for at in edge.get("shape").split()], float) for name, edge in edges.items()
    }
    assert len(nodes) == streets**2 - 1 + 4
    assert len(edges) == 4 * streets * (streets - 1) + 4
    ring = {name for name, edge in edges.items() if "ring" in edge.get("from") and "ring" in edge.get("to")}
    turned = 0.0
    for name, edge in edges.items():
        begin_m, end_m = place_m[edge.get("from")], place_m[edge.get("to")]
        if name in ring:
            ahead = np.diff(shape_m[name][:, :2], axis=0)
            turned += np.ptp(np.unwrap(np.arctan2(*ahead.T[::-1]))) * 11 / 10  # of 11 chords
            np.testing.assert_allclose(
                [shape_m[name][0, :2], shape_m[name][-1, :2]], [begin_m[:2], end_m[:2]], atol=0.03
            )
            continue
        assert edges[f"{edge.get('to')}_{edge.get('from')}"].get("to") == edge.get("from")
        assert 0.02 * 60.0 < abs(end_m[2] - begin_m[2]) < 0.051 * sumo.TOWN_BLOCK_M
        np.testing.assert_allclose(shape_m[name][[0, -1], 2], [begin_m[2], end_m[2]], atol=0.01)
        right = np.array([(end_m - begin_m)[1], -(end_m - begin_m)[0]]) / np.hypot(*(end_m - begin_m)[:2])
        off_m = (shape_m[name][:, :2] - begin_m[:2]) @ right
        for number, end in ((0, "from"), (3, "to")):
            allowed_m = [sumo.SPREAD_M[0]] if "ring" in edge.get(end) else [0.0, sumo.SPREAD_M[1]]
            assert np.abs(off_m[number] - allowed_m).min() < 0.03
        np.testing.assert_allclose(off_m[1:3], 0.0, atol=0.02)
        np.testing.assert_allclose(np.hypot(*(shape_m[name][1] - begin_m)[:2]), sumo.SPREAD_WAY_M, atol=0.02)
    assert turned == pytest.approx(2.0 * np.pi, abs=0.3)
    for one, other in itertools.pairwise(loop):
        end, begin = edges[one].get("to"), edges[other].get("from")
        assert end == begin or {end[:4], begin[:4]} == {"ring"}


@pytest.fixture(scope="module")
def crossroads() -> sumo.Network:
    """Two roads of 80 m that meet end to end at a level junction, 6 m high, with lights, a pavement and a crossing."""
    lanes = [
        road([(0, -5, 0), (80, -5, 0)], 2.0, kind="pavement", lights=True),
        road([(0, -3.75, 0), (80, -3.75, 0)], 0.5, kind="cycle_path", lights=True),
        road([(0, -1.75, 0), (80, -1.75, 0)], 1.75, 1.75, lights=True),
        road([(80, 1.75, 0), (0, 1.75, 0)], 3.5, edge="-a", speed_m_s=25.0),
        road([(40, -60, 6), (40, 60, 6)], 4.0, edge="b"),
    ]
    square_m = np.array([[80.0, -6, 0], [92, -6, 0], [92, 6, 0], [80, 6, 0]])
    corner_m = np.array([[80.0, -6, 0], [84, -6, 0], [84, -4, 0], [80, -4, 0]])
    zebra = np.array([[82.0, -5, 0], [82, 6, 0]]), 3.0
    return sumo.Network(lanes, [square_m], [corner_m], [zebra], {}, [], [], [])


@pytest.fixture(scope="module")
def relief(crossroads: sumo.Network) -> terrain.Relief:
    return terrain.Relief(np.concatenate(tables._places_on_lanes(crossroads)), 1.0)


def of(bodies: list[Tables], name: str) -> list[Tables]:
    return [body for body in bodies if body["name"].startswith(name)]


def test_surfaces_of_a_network_are_beside_each_other(crossroads: sumo.Network) -> None:
    """Lanes have their widths, kerbs 0.15 m of pavements, on the side of the road; a corner and its kerb fill it."""
    bodies = tables._grounds(crossroads, tables._islands(crossroads))
    widths_m = {body["name"]: (body["width_m"], body["offset_m"]) for body in bodies if "width_m" in body}
    assert widths_m == {
        "pavement_0": (1.85, -0.075),
        "kerb_0": (0.15, 0.925),
        "road_1": (0.5, 0.0),
        "road_2": (3.5, 0.0),
        "road_3": (3.5, 0.0),
        "road_4": (4.0, 0.0),
    }
    areas_m2 = {body["name"]: abs(area_m2(np.array(body["outline"]))) for body in bodies if "outline" in body}
    assert areas_m2["junction_0"] == pytest.approx(144.0)
    assert areas_m2["corner_0"] + areas_m2["kerb_corner_0_0"] == pytest.approx(8.0)
    assert areas_m2["kerb_corner_0_0"] == pytest.approx(0.15 * (4.0 + 2.0) - 0.15**2)
    raised = {body["name"] for body in bodies if body.get("position_m", [0.0, 0.0, 0.0])[2] == 0.12}
    assert raised == {"pavement_0", "kerb_0", "corner_0", "kerb_corner_0_0"}


def test_markings_of_a_network_are_where_lanes_end_and_meet(crossroads: sumo.Network, relief: terrain.Relief) -> None:
    """Dashes each 6 m between two lanes, but not below the bridge; a stop line at the lights; stripes off the kerb."""
    bodies = tables._markings(crossroads, relief, tables._islands(crossroads))
    (dashes,), (stops,), (stripes,) = (of(bodies, name) for name in ("dashes", "stop_lines", "zebras"))
    x_m = np.array([place["position_m"][0] for place in dashes["instances"]])
    assert (x_m % 6.0 == 3.0).all()
    assert set(np.round(x_m)) == {3, 9, 15, 21, 27, 33, 51, 57, 63, 69, 75}
    assert {place["position_m"][1] for place in dashes["instances"]} == {-1.75}
    assert [place["position_m"] for place in stops["instances"]] == [[79.6, -1.75, 0.003]]
    assert stops["size_m"] == [0.3, 3.1]
    assert [place["position_m"][1] for place in stripes["instances"]] == (np.arange(9) - 3.25).tolist()
    assert stripes["size_m"] == [2.5, 0.5]
    edges = of(bodies, "line_")
    assert {body["offset_m"] for body in edges} == {1.55, -1.55, 1.8, -1.8}
    assert all(np.ptp(np.array(body["line"])[:, int("line_4" in body["name"])]) > 20.0 for body in edges)


def test_a_line_does_not_turn_back_where_a_lane_has_a_point_near_its_end() -> None:
    """Lines end 0.2 m before lanes do. As at a lane of esmini's soderleden.xodr, points are nearer to both ends."""
    lane = road([(0, 1.75, 0), (0.1, 1.75, 0), (40, 1.75, 0), (79.9, 1.75, 0), (80, 1.75, 0)], 3.5)
    network = sumo.Network([lane], [], [], [], {}, [], [], [])
    relief = terrain.Relief(np.concatenate(tables._places_on_lanes(network)), 1.0)
    for body in of(tables._markings(network, relief, []), "line_"):
        assert np.array(body["line"])[:, 0] == pytest.approx([0.2, 40.0, 79.8])


def test_what_stands_by_a_network_faces_the_road_and_stands_off_it(crossroads, relief):
    """Lights to the right of the lanes and the cycle path; rails on both sides of a bridge and of fast roads."""
    roadside = tables._Roadside(crossroads, StreetFile(house_share=(1.0, 1.0)), None)
    roadside.lights(crossroads)
    assert roadside.items["lights"] == [{"position_m": [79.5, -4.45, 0.0], "yaw_deg": -180.0}]
    roadside.parapets(crossroads.groups[4], relief)
    rails = roadside.items.pop("guard_rails")
    sides = {place["position_m"][0]: place.get("yaw_deg", 0.0) for place in rails}
    assert sides == {38.1: 0.0, 41.9: -180.0}, "their fronts look at each other"
    y_m = np.unique([place["position_m"][1] for place in rails])
    assert y_m.min() > -1.75 - 3.5 - 13.0
    assert y_m.max() < 3.5 + 13.0
    np.testing.assert_allclose(np.diff(y_m), 4.0)
    roadside.rails(crossroads.groups[2], -1.0)
    assert "guard_rails" not in roadside.items, "54 km/h"
    roadside.rails(crossroads.groups[3], -1.0)
    fast = roadside.items["guard_rails"]
    assert {place["position_m"][1] for place in fast} == {4.2}
    assert {place["yaw_deg"] for place in fast} == {-90.0}
    assert len(fast) > 10
    roadside.line(crossroads.groups[0], -1.0, DISTRICTS[1])
    houses = [place for name, places in roadside.items.items() if name.startswith("houses") for place in places]
    assert len(houses) >= 2
    assert max(place["position_m"][1] for place in houses) < -6.0 - 0.9 - DISTRICTS[1].garden_m
    assert {place.get("yaw_deg", 0.0) for place in houses} == {90.0}
    assert {place["position_m"][1] for place in roadside.items["lamp_posts"]} == {-6.45}


def test_piers_stand_beside_the_road_below(crossroads: sumo.Network, relief: terrain.Relief) -> None:
    piers = tables._piers(crossroads, relief, terrain.Terrain.around(relief))
    assert [pier["position_m"][0] for pier in piers] == [40.0, 40.0]
    y_m = [pier["position_m"][1] for pier in piers]
    np.testing.assert_allclose(y_m, [-6.0 - tables.PIER_ASIDE_M, 3.5 + tables.PIER_ASIDE_M], atol=0.9)
    for pier in piers:
        middle_m, height_m = pier["position_m"][2], pier["size_m"][2]
        assert middle_m + 0.5 * height_m == pytest.approx(6.0 - tables.PIER_BELOW_M, abs=1e-3)
        assert middle_m - 0.5 * height_m == pytest.approx(-0.08 - tables.PIER_SUNK_M, abs=0.05)


def test_the_ego_vehicle_brakes_evenly_to_its_end() -> None:
    """v^2 = 2 b s with the braking of drivers, 2 m/s2, and the room to its front."""
    line = lines.CentreLine([(1000.0, 0.0, 0.0)], 0.0)
    lane = driven._Lane(
        line, 0.0, 1, np.array([90.0]), np.array([20.0]), np.array([20.0]), np.array([4.0]), ["own_car"]
    )
    driven._stop_at_end(lane, 0, 100.0)
    assert lane.speed_m_s[0] ** 2 == pytest.approx(2.0 * 2.0 * (100.0 + 0.5 * laid.CAR_M[0] - 90.0))


def test_what_is_near_the_way_of_the_ego_vehicle_is_kept(crossroads: sumo.Network) -> None:
    """Roads with two points count by their middle: the bridge passes 10 m beside the way, its ends are 60 m away."""
    own = sumo.RoadUser("ego", "passenger", 4.0, [(float(k), 50.0, 5.0, 90.0, 0.0) for k in range(3)])
    assert [group.edge for group in tables._near(crossroads, own, 8.0).groups] == ["a", "-a"]
    near = tables._near(crossroads, own, 12.0)
    assert ([group.edge for group in near.groups], near.junctions) == (["a", "a", "a", "-a", "b"], [])
    assert len(tables._near(crossroads, own, 34.0).junctions) == 1


def test_the_ego_vehicle_drives_from_the_origin_to_its_end_and_nobody_through_another() -> None:
    layout = laid.lay_out(StreetFile(length_m=60.0, shown_m=50.0, seed=2, stop_share=1.0))
    traffic = driven.drive(layout)
    ego = traffic.ego
    assert (ego.time_s[0], ego.x_m[0]) == pytest.approx((0.0, 0.0))
    assert ego.x_m[-1] == pytest.approx(60.0, abs=0.3)
    assert np.diff(ego.x_m).min() >= 0.0
    np.testing.assert_array_equal(np.unique(ego.y_m), layout.lane_m(0, 1))
    along = [track for track in traffic.others if track.name.startswith("traffic") and np.ptp(track.x_m) > 0.0]
    for track in along:
        assert set(track.yaw_deg) == ({0.0} if track.x_m[-1] > track.x_m[0] else {180.0})
        here = np.intersect1d(ego.time_s, track.time_s)
        apart_m = np.interp(here, ego.time_s, ego.x_m) - np.interp(here, track.time_s, track.x_m)
        on_lane = track.y_m[0] == ego.y_m[0]
        assert not on_lane or np.abs(apart_m).min() > 0.5 * (laid.CAR_M[0] + driven.vehicle_length_m(track.name))


def test_people_cross_a_zebra_from_kerb_to_kerb_and_come_back() -> None:
    """They wait 1 m behind the kerb, look where they go, and turn round on a loop once they are across."""
    layout = laid.lay_out(StreetFile(length_m=500.0, loop=True))
    closing = driven._Closing(laid.Crossing(100.0, 2.0, is_zebra=True), {}, 10.0, go_s=[5.0, 60.0])
    time_s = np.arange(0.0, 120.0, 0.1)
    tracks = list(driven._crossing_tracks(layout, closing, time_s, np.random.default_rng(1)))
    assert 1 <= len(tracks) <= 3
    for track in tracks:
        wait_m = layout.kerb_m + 1.0
        side = np.sign(track.y_m[0])
        y_m = np.interp([4.0, 55.0, 119.0], track.time_s, track.y_m)
        np.testing.assert_allclose(y_m, side * wait_m * np.array([1.0, -1.0, 1.0]))
        speed_m_s = np.abs(np.diff(track.y_m)) / np.diff(track.time_s)
        assert driven.WALK_M_S[0] <= speed_m_s.max() <= driven.WALK_M_S[1]
        np.testing.assert_allclose(np.interp([6.0, 61.0], track.time_s, track.yaw_deg), [-90 * side, 180 - 90 * side])
        assert np.abs(track.x_m - 100.0).max() < 2.0
