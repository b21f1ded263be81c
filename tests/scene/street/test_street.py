"""Streets from a seed: nothing overlaps, nobody collides, a seed is a street, and the file is the same scene."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from lidarscene.errors import InputError
from lidarscene.maths.trajectory import pose_at
from lidarscene.scene.scene_file import load_scene, scene_model
from lidarscene.scene.street import layout as laid
from lidarscene.scene.street import traffic as driven
from lidarscene.scene.street.street_file import StreetFile
from lidarscene.scene.street.street_tables import street_tables, write_street

SHORT = {"length_m": 60.0, "shown_m": 50.0}
SIZES_M = {"car": laid.CAR_M, "person": (0.82, 0.6), "post": (0.32, 0.6)}
"""Length and width of meshes; a lamp's arm is overhead."""


def street(seed: int, **keys: object) -> StreetFile:
    return StreetFile(seed=seed, **{"length_m": 400.0, **keys})  # type: ignore[arg-type]


def size_m(name: str) -> tuple[float, float]:
    if name.startswith("houses"):
        scale = laid.HOUSE_SCALES[name.removeprefix("houses_")]
        return 2 * scale * laid.HOUSE_M[1], scale * laid.HOUSE_M[0]
    kinds = {"cars": "car", "traffic": "car", "own": "car", "walkers": "person", "pedestrians": "person"}
    return SIZES_M[kinds.get(name.split("_")[0], "post")]


def half_box_m(name: str, yaw_deg: np.ndarray) -> np.ndarray:
    """(n, 2) half the extent along x and y of boxes that are turned."""
    length, width = size_m(name)
    cos, sin = np.abs(np.cos(np.radians(yaw_deg))), np.abs(np.sin(np.radians(yaw_deg)))
    return 0.5 * np.stack([length * cos + width * sin, length * sin + width * cos], axis=-1)


def standing_boxes(file: StreetFile) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(n, 2) middles, (n, 2) half extents and names of all that stands; of trees the trunks."""
    rows = [(name, *place) for name, places in laid.lay_out(file).items.items() for place in places]
    names = [str(row[0]) for row in rows]
    middle_m, yaw_deg = np.array([row[1:3] for row in rows]), np.array([row[3] for row in rows])
    half_m = np.stack([half_box_m(name, yaw) for name, yaw in zip(names, yaw_deg, strict=True)])
    return middle_m, half_m, names


@pytest.mark.parametrize("lanes", [1, 2, 3])
@pytest.mark.parametrize("seed", range(1, 11))
def test_nothing_that_stands_overlaps(seed: int, lanes: int) -> None:
    """Houses, parked cars, trunks, posts and people are apart from each other and clear of the lanes."""
    file = street(seed, lanes=lanes, parked_share=(0.5, 1.0), house_share=(0.5, 1.0))
    middle_m, half_m, names = standing_boxes(file)
    assert len(names) > 200
    apart_m = np.abs(middle_m[:, None] - middle_m) - (half_m[:, None] + half_m)
    overlaps = (apart_m < 0.0).all(axis=2)
    np.fill_diagonal(overlaps, False)
    first, second = np.nonzero(overlaps)
    assert [(names[a], names[b]) for a, b in zip(first, second, strict=True)] == []
    assert (np.abs(middle_m[:, 1]) - half_m[:, 1]).min() > lanes * file.lane_width_m
    streets = [crossing for crossing in laid.lay_out(file).crossings if not crossing.is_zebra]
    for crossing in streets:
        assert (np.abs(middle_m[:, 0] - crossing.x_m) - half_m[:, 0]).min() > crossing.half_m


def boxes_at(traffic: driven.Traffic, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(tracks, times, 2) middles, NaN while hidden, (tracks, 2) half extents, and names; the ego vehicle is first."""
    tracks = [traffic.ego, *traffic.others]
    middle_m = np.stack(
        [
            np.stack(
                [np.interp(times_s, track.time_s, at, left=np.nan, right=np.nan) for at in (track.x_m, track.y_m)], -1
            )
            for track in tracks
        ]
    )
    half_m = np.stack([half_box_m(track.name, np.array(track.yaw_deg)) for track in tracks])
    return middle_m, half_m, [track.name for track in tracks]


@pytest.mark.parametrize("lanes", [1, 2])
@pytest.mark.parametrize("seed", range(1, 11))
def test_nobody_collides(seed: int, lanes: int) -> None:
    """All the time, nobody who moves overlaps with anybody, nor with what stands; every half second and between."""
    file = street(seed, lanes=lanes, stop_share=0.8, ahead=3, behind=2)
    traffic = driven.drive(laid.lay_out(file))
    times_s = np.arange(0.0, traffic.ego.time_s[-1], 0.25)
    middle_m, half_m, names = boxes_at(traffic, times_s)
    for a, b in itertools.combinations(range(len(names)), 2):
        apart_m = np.abs(middle_m[a] - middle_m[b]) - (half_m[a] + half_m[b])
        meets = (apart_m < 0.0).all(axis=1)
        assert not meets.any(), (names[a], names[b], times_s[meets][0])
    still_m, still_half_m, still_names = standing_boxes(file)
    for number, name in enumerate(names):
        apart_m = np.abs(middle_m[number][:, None] - still_m) - (half_m[number] + still_half_m)
        meets = (apart_m < 0.0).all(axis=2).any(axis=0)
        assert not meets.any(), (name, still_names[int(np.argmax(meets))])


@pytest.mark.parametrize("seed", [1, 2])
def test_the_way_is_driven_to_its_end_by_the_rules(seed: int) -> None:
    """The way goes from 0 to its length, never back, never faster than a driver wants, never braking harder than
    drivers do.

    It waits at crossings, and there is always traffic.
    """
    file = street(seed, length_m=1000.0, stop_share=1.0)
    traffic = driven.drive(laid.lay_out(file))
    ego = traffic.ego
    assert ego.x_m[0] == pytest.approx(0.0, abs=1e-9)
    assert ego.x_m[-1] == pytest.approx(1000.0, abs=1.0)
    speed_m_s = np.diff(ego.x_m) / np.diff(ego.time_s)
    assert speed_m_s.min() >= 0.0
    assert speed_m_s.max() <= file.speed_m_s[1]
    # A mean over half a second brakes no harder than the hardest moment.
    assert np.diff(speed_m_s).min() / 0.5 > -driven.HARDEST_M_S2
    waits = (speed_m_s[:-20] < 0.2).sum()
    assert waits
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
    front_m = np.array([0.0, -40.0, -60.0])
    lane = driven._Lane(0, 1, front_m, np.full(3, 8.0), desired_m_s, ["car"] * 3)
    for _ in range(2000):
        lane.step([], 1e7)
    np.testing.assert_allclose(-np.diff(lane.front_m) - laid.CAR_M[0], gap_m, rtol=0.01)


def test_a_closed_line_stops_those_who_can() -> None:
    """One stops, at 10 m/s, within 100 / (2 * 3.5) = 14.3 m: who is 14 m away drives on, who is 15 m away stops."""
    for room_m, stops in ((14.0, False), (15.0, True)):
        lane = driven._Lane(0, 1, np.array([-room_m]), np.array([10.0]), np.array([10.0]), ["car"])
        for _ in range(200):
            lane.step([0.0], 1e7)
        assert (lane.front_m[0] < 0.0) == stops
        assert (lane.speed_m_s[0] < 0.1) == stops


def test_a_seed_is_a_street() -> None:
    first = street_tables(street(3))
    street_tables.cache_clear()
    again, other = street_tables(street(3)), street_tables(street(4))
    assert first is not again
    assert first == again
    assert first != other


def test_a_longer_street_keeps_its_drivers_and_its_numbers_in_sight_few() -> None:
    """Ten minutes of driving: nothing comes twice, and no more is there at a time than in a tenth of it."""
    most = []
    for length_m in (400.0, 5500.0):
        traffic = driven.drive(laid.lay_out(street(5, length_m=length_m)))
        spans = np.array([(track.time_s[0], track.time_s[-1]) for track in traffic.others])
        most.append(max(int(((spans[:, 0] <= t) & (t <= spans[:, 1])).sum()) for t in traffic.ego.time_s))
    assert traffic.ego.time_s[-1] > 600.0
    # The largest of fourteen times as many moments is larger by chance, up to 1.9 times; all at once would be 14 times.
    assert most[1] < 3.0 * most[0]
    gaps_m = np.diff(sorted(x_m for x_m, *_ in laid.lay_out(street(5, length_m=4500.0)).items["lamp_posts"]))
    assert len(np.unique(np.round(gaps_m, 6))) > 0.9 * len(gaps_m)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A scene file with [street], and the file with all bodies that is written of the same."""
    folder = tmp_path_factory.mktemp("street")
    (folder / "table.toml").write_text('name = "street"\n[street]\nseed = 7\nlength_m = 60\nshown_m = 50\n')
    return folder / "table.toml", write_street(StreetFile(seed=7, **SHORT), folder / "out")


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
    classes = {"road", "pavement", "kerb", "terrain", "lane_marking", "building", "car", "vegetation", "sign", "pole"}
    assert {body.class_name for body in table.bodies} == classes | {"pedestrian", "child"}
    assert {path.suffix for path in written[1].parent.rglob("*") if path.is_file()} == {".toml", ".glb", ".csv"}


def test_keys_of_a_street_and_of_its_bodies_can_be_changed(written: tuple[Path, Path]) -> None:
    """`--scene-set` reaches the street before it is made, and its bodies after."""
    path, _ = written
    model = scene_model(path, overrides=["street.lanes=2", "bodies.own_car.scale=1.1", "sun.elevation_deg=10"])
    widths_m = [body.size_m[1] for body in model.bodies if body.name == "road_0" and body.size_m]
    assert widths_m == [2 * (2 * 3.2 + laid.PARKING_M)]
    assert next(body.scale for body in model.bodies if body.name == "own_car") == 1.1
    assert model.sun.elevation_deg == 10
    assert model.sun.azimuth_deg == street_tables(StreetFile()).get("sun", {})["azimuth_deg"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("length_m = 10", r"street\.length_m: must be >= 50, got 10"),
        ("block_m = [200, 100]", r"street\.block_m.* lowest and a highest value, got 200 and 100"),
        ("house_share = [0, 2]", r"street\.house_share.*<= 1, got 2"),
        ("lane = 2", r"unknown key 'street\.lane'"),
    ],
)
def test_mistakes_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "scene.toml").write_text(f"[street]\n{text}\n")
    with pytest.raises(InputError, match=message) as caught:
        load_scene(tmp_path / "scene.toml")
    assert "\n" not in str(caught.value)
