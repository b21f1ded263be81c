"""A live world against scene files with the same poses, against worlds rebuilt at every pose, and without compiling."""

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers import chain, launches, panes
from helpers.mistakes import refused, told
from helpers.walker import write_walker

from lidarscene import LiveSimulator, Simulator
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.errors import InputError, OptionWarning
from lidarscene.formats.cloud_columns import columns_of
from lidarscene.labels.boxes import boxes
from lidarscene.labels.files import point_labels
from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course, Riding
from lidarscene.rendering.live_simulator import live_scene, spare_names
from lidarscene.rendering.render_options import FrameKeywords
from lidarscene.scene.scene import Scene

WALKER = """
[[bodies]]
name = "ground"
primitive = "plane"
size_m = [60, 60]
material = "soil"

[[bodies]]
name = "walker"
mesh = "walker.glb"
class = "pedestrian"
material = "skin"
animation = "walk"
position_m = [10, 0, 0]
motion = { speed_m_s = 0 }
"""

pytestmark = pytest.mark.usefixtures("mi")

DAY = 24 * 3600 * 20
"""Number of a frame a day later, at 20 Hz."""

SENSOR = ("scanner.azimuth_step_deg=0.6", "scanner.elevation_step_deg=0.6", "tdc.threshold_to_noise=4")

FILE = """
[ego]
{ego}

[[bodies]]
name = "wall"
primitive = "box"
size_m = [1, 60, 20]
position_m = [40, 0, 0]
material = "grey"

[[bodies]]
name = "car"
primitive = "box"
size_m = [4, 2, 1.5]
material = "grey"
{car}
motion = {{ {motion} }}

[materials.grey]
bsdf = "diffuse"
reflectivity = 0.3
"""


def sensor():
    return chain.sensor("table1-apd", *SENSOR)


def file(folder: Path, *, car: str, ego: str = "position_m = [0, 0, 0]", motion: str = "speed_m_s = 0") -> Path:
    path = folder / "scene.toml"
    path.write_text(FILE.format(ego=ego, car=car, motion=motion), encoding="utf-8")
    return path


def assert_same(cloud: PointCloud, expected: PointCloud) -> None:
    """Hold that they are the same to the last bit, metadata too."""
    assert len(cloud) == len(expected) > 500
    for column in columns_of(truth=True, vectors=False):
        np.testing.assert_array_equal(cloud.column(column.name), expected.column(column.name), err_msg=column.name)
    assert (cloud.metadata, cloud.body_names) == (expected.metadata, expected.body_names)


def echoes_on(cloud: PointCloud, name: str) -> int:
    """Echoes of a body."""
    return int(((cloud.body == cloud.body_names.index(name)) & (cloud.status == 0)).sum())


CAR = "position_m = [14, 2, -0.5]\nyaw_deg = 30\npitch_deg = 4"
CAR_POSE = (14.0, 2.0, -0.5, 30.0, 4.0, 0.0)


def test_a_placed_body_is_that_of_a_scene_file(tmp_path: Path) -> None:
    """The body is the same to the last bit: where it stands, and where it drives on a curve."""
    live = LiveSimulator(file(tmp_path, car="position_m = [20, -3, 0]"), sensor())
    cloud_elsewhere = live.render(seed=1)
    live.place("car", CAR_POSE)
    expected = Simulator(file(tmp_path, car=CAR), sensor()).render(seed=1)
    assert_same(live.render(seed=1), expected)
    assert echoes_on(expected, "car") > 100
    assert not np.array_equal(cloud_elsewhere.body, expected.body)
    live.place("car", CAR_POSE, velocity_m_s=(3.0, -9.0, 0.5), yaw_rate_deg_s=50.0)
    drives = "velocity_m_s = [3, -9, 0.5], yaw_rate_deg_s = 50"
    moving = Simulator(file(tmp_path, car=CAR, motion=drives), sensor()).render(seed=1, number=2)
    cloud = live.render(seed=1, number=2)
    assert_same(cloud, moving)
    assert np.ptp(cloud.radial_velocity_m_s) > 1.0
    live.place("car", CAR_POSE)
    assert_same(live.render(seed=1), expected)


def test_the_ego_vehicle_is_that_of_a_scene_file(tmp_path: Path) -> None:
    """The file's world is built around another place of the sensor: single precision of 40 m, 4 um, some ten times.

    Around the same place it is the same to the last bit: a pose that is turned only has one.
    """
    live = LiveSimulator(file(tmp_path, car=CAR), sensor(), pose=(0.0, 0.0, 0.0))
    live.render()
    live.move_ego((0.0, 0.0, 0.0, 7.0, 2.0, 1.0))
    turned = file(tmp_path, car=CAR, ego="yaw_deg = 7\npitch_deg = 2\nroll_deg = 1")
    assert_same(live.render(seed=2), Simulator(turned, sensor(), pose=(0.0, 0.0, 0.0)).render(seed=2))
    live.move_ego((2.0, -1.0, 0.5, 7.0, 2.0, 1.0))
    ego = "position_m = [2, -1, 0.5]\nyaw_deg = 7\npitch_deg = 2\nroll_deg = 1"
    placed_simulator = Simulator(file(tmp_path, car=CAR, ego=ego), sensor(), pose=(0.0, 0.0, 0.0))
    assert_near(live.render(seed=2), placed_simulator.render(seed=2))


def assert_near(cloud: PointCloud, expected: PointCloud) -> None:
    """Points within 0.1 mm, but where beams graze an edge and may fall to either side: fewer than one in a hundred."""
    cloud, expected = (compared.select(compared.status == 0) for compared in (cloud, expected))
    is_in_both = np.isin(cloud.time_s, expected.time_s)
    assert is_in_both.mean() > 0.99
    shared, shared_expected = cloud.select(is_in_both), expected.select(np.isin(expected.time_s, cloud.time_s))
    names_of_bodies = [np.array(compared.body_names)[compared.body] for compared in (shared, shared_expected)]
    agree = (names_of_bodies[0] == names_of_bodies[1]) & (
        np.abs(shared.true_range_m - shared_expected.true_range_m) < 1e-4
    )
    agree &= (
        np.abs(shared.xyz_m - shared_expected.xyz_m).max(axis=1) < 1e-2
    )  # a reported range has noise that goes with the SNR
    assert agree.mean() > 0.99
    assert (shared.in_shadow == shared_expected.in_shadow)[agree].mean() > 0.99


def street() -> Scene:
    """A wall, a car and a ball: all stand still."""
    car = chain.box(at=(15.0, 0.0, 0.0), size_m=(3.0, 1.8, 1.4))
    return chain.scene(
        chain.facing(range_m=45.0, size_m=120.0),
        dataclasses.replace(car, name="car", class_name="car"),
        dataclasses.replace(chain.ball(at=(12.0, -4.0, 0.0)), name="ball"),
    )


def rebuild_scene(scene: Scene, poses: dict[str, Pose], ego: Pose) -> Scene:
    """The scene with these bodies standing there, copies by name too, and no motion."""
    bodies_by_name = {body.name: body for body in scene.bodies}
    moved = [
        dataclasses.replace(bodies_by_name[name.split(".")[0]], name=name, pose=pose) for name, pose in poses.items()
    ]
    standing_bodies = [body for body in scene.bodies if body.name == "plane"]
    return dataclasses.replace(scene, bodies=(*standing_bodies, *moved), sensor_pose=ego)


def pose(x: float, y: float, z: float, yaw: float = 0.0) -> Pose:
    return Pose.from_degrees(position_m=(x, y, z), yaw_deg=yaw)


def test_bodies_come_and_go_as_in_worlds_built_anew() -> None:
    """Compared with static meshes in the world's frame, for each step a world of its own."""
    live = LiveSimulator(street(), sensor(), movable=("ball",), spares={"car": 2})
    assert live.world.body_names == ("plane", "car", "ball", "car.1", "car.2")
    poses, ego = {"car": pose(17, 3, 0.2, 40), "ball": pose(9, 1, 0.5)}, Pose()

    def check() -> None:
        cloud = live.render(seed=1)
        assert_near(cloud, Simulator(rebuild_scene(street(), poses, ego), sensor()).render(seed=1))
        assert {name for name in cloud.body_names if echoes_on(cloud, name)} == {"plane", *poses}

    for name, body_pose in poses.items():
        live.place(name, body_pose)
    check()
    for body_pose in (pose(11, -2, 0, 80), pose(20, 0, -1, 10)):
        poses[live.add("car", body_pose)] = body_pose
    assert set(poses) == {"car", "ball", "car.1", "car.2"}
    check()
    for name in ("car", "ball"):
        live.remove(name)
        del poses[name]
    ego = pose(1, 0.5, 0.1, 5)
    live.move_ego(ego)
    check()
    poses["car"] = pose(10, 2, 0, 15)
    assert live.add("car", poses["car"]) == "car"
    check()
    poses["ball"] = pose(8, -1, 0.4)  # without spares it is its own
    assert live.add("ball", poses["ball"]) == "ball"
    check()


def test_a_body_whose_time_is_over_is_there_where_it_is_placed() -> None:
    """The car of the scene drives for half a second and is hidden then."""
    scene = street()
    passing = dataclasses.replace(scene.bodies[1], motion=Course(velocity_m_s=(1.0, 0.0, 0.0)), present_s=(0.0, 0.5))
    live = LiveSimulator(dataclasses.replace(scene, bodies=(scene.bodies[0], passing, scene.bodies[2])), sensor())
    assert echoes_on(live.render(begin_s=0.5), "car") > 100
    assert echoes_on(live.render(begin_s=1.0), "car") == 0
    live.place("car", pose(12, 1, 0))
    assert echoes_on(live.render(begin_s=1.0), "car") > 100


def test_nothing_is_compiled() -> None:
    """No frame launches a kernel that the first did not, whatever moves, comes and goes, straight or on a curve."""
    live = LiveSimulator(street(), sensor(), movable=("ball",), spares={"car": 2})
    with launches.launched() as before:
        live.render()
    with launches.launched(after=before):
        live.place("ball", (9, 1, 0))
        live.add("car", (11, -2, 0), velocity_m_s=(5.0, 0.0, 0.0), yaw_rate_deg_s=40.0)
        live.render(number=1)
        live.remove("car")
        live.remove("car.1")
        live.remove("ball")
        live.move_ego((1, 1, 0), yaw_rate_deg_s=5.0)
        live.render(number=2)
        live.add("car", (14, 0, 0))
        live.advance(0.4, {"car": (14, 0.5, 0, 20)}, ego=(0, 0, 0))


def test_panes_on_bodies_that_are_placed() -> None:
    """Points behind a pane that is placed are those of a world built with it there, by number of panes and SNR."""
    scene = dataclasses.replace(
        chain.scene(chain.facing(range_m=30.0, size_m=80.0), materials=panes.MATERIALS), name="glazed"
    )
    glass = panes.pane(8.0)
    live = LiveSimulator(dataclasses.replace(scene, bodies=(*scene.bodies, glass)), sensor(), spares={"pane": 1})
    for number, pane_pose in enumerate((panes.pane(9.0, 25.0).pose, panes.pane(6.0, -40.0).pose)):
        live.place("pane", pane_pose)
        placed_pane = dataclasses.replace(glass, pose=pane_pose)
        cloud = live.render(seed=number)
        expected = Simulator(dataclasses.replace(scene, bodies=(*scene.bodies, placed_pane)), sensor()).render(
            seed=number
        )
        assert (cloud.interactions == 1).sum() > 100
        assert_near(cloud, expected)
        for column in ("interactions", "snr"):
            placed_values, expected_values = (np.sort(getattr(two, column)) for two in (cloud, expected))
            assert np.isclose(placed_values[:500], expected_values[:500], rtol=1e-3).mean() > 0.99
    live.remove("pane")
    assert not live.render().interactions.any()


def test_labels_and_boxes_are_of_what_is_there() -> None:
    """No box of a body that is away; that of a placed one is where it was placed; at rest it is no moving car."""
    live = LiveSimulator(street(), sensor(), spares={"car": 2})
    live.place("car", (15, 3, 0, 30))
    live.add("car", (12, -3, 0), velocity_m_s=(8.0, 0.0, 0.0))
    cloud = live.render()
    boxes_by_name = {box.name: box for box in boxes(cloud, live.scene)}
    assert set(boxes_by_name) == {"plane", "ball", "car", "car.1"}
    np.testing.assert_allclose(boxes_by_name["car"].pose.position_m, (15, 3, 0), atol=1e-9)
    assert boxes_by_name["car"].points_on == echoes_on(cloud, "car") > 50
    assert boxes_by_name["car.1"].velocity_m_s[0] == pytest.approx(8.0)
    semantic, instance = point_labels(cloud, live.scene)
    for name, label in (("car", 10), ("car.1", 252)):
        is_own_echo = (cloud.body == cloud.body_names.index(name)) & (cloud.status == 0)
        assert set(semantic[is_own_echo]) == {label}
        assert len(set(instance[is_own_echo])) == 1


def test_what_is_fixed_to_the_ego_vehicle_goes_with_it() -> None:
    """A mast 5 m ahead on the ego vehicle is seen at the same places, wherever that stands and drives."""
    ego = Course(start=pose(1, 0, 0))
    mast = dataclasses.replace(
        chain.box(at=(0, 0, 0), size_m=(0.3, 0.3, 3.0)), name="mast", motion=Riding(carrier=ego, pose=pose(5, 0, 0))
    )
    live = LiveSimulator(dataclasses.replace(chain.scene(mast), ego=ego), sensor())
    before = live.render(coordinates="sensor")
    for velocity in ((0.0, 0.0, 0.0), (20.0, 3.0, 0.0)):
        live.move_ego((30.0, -7.0, 1.0, 50.0, 3.0), velocity_m_s=velocity)
        cloud = live.render(coordinates="sensor")
        assert echoes_on(cloud, "mast") == echoes_on(before, "mast") > 20
        ranges = [measured.true_range_m[measured.status == 0] for measured in (cloud, before)]
        np.testing.assert_allclose(*ranges, atol=1e-4)  # some ten roundings at 30 m


def test_the_callers_clock() -> None:
    """Frames are given when they are over; within one a body goes evenly from pose to pose, and then it stays: what
    waits has the label of what moves, as in a scene file.
    """
    live = LiveSimulator(street(), sensor(), movable=("ball",), spares={"car": 1})
    length_s = live.sensor.scanner.frame_s
    clouds, times = [], []
    for step in range(1, 41):
        now_s = step * length_s / 8.0
        for cloud in live.advance(now_s, {"car": (12.0 + 10.0 * now_s, 0.0, 0.0)} if step <= 20 else {}):
            clouds.append(cloud)
            times.append(step)
            semantic, _ = point_labels(cloud, live.scene)
            is_own_echo = (cloud.body == cloud.body_names.index("car")) & (cloud.status == 0)
            assert set(semantic[is_own_echo].tolist()) == {252}
    assert [int(cloud.metadata["frame_number"]) for cloud in clouds] == [0, 1, 2, 3, 4]
    assert times == [8, 16, 24, 32, 40]
    # A straight line from the first pose on, which is held before.
    drives = LiveSimulator(street(), sensor(), movable=("ball",), spares={"car": 1})
    drives.place("car", (12.0, 0.0, 0.0), velocity_m_s=(10.0, 0.0, 0.0))
    assert_near(clouds[1], drives.render(number=1))
    car = clouds[1].body == clouds[1].body_names.index("car")
    np.testing.assert_allclose(
        clouds[1].radial_velocity_m_s[car], drives.render(number=1).radial_velocity_m_s[car], atol=1e-3
    )


def test_what_is_placed_has_left_the_way_of_the_clock() -> None:
    """Poses given to `advance` before count no more."""
    live = LiveSimulator(street(), sensor(), movable=("ball",), spares={"car": 1})
    assert live.advance(0.001, {"ball": pose(9, 3, 0), "car": pose(18, 0, 0)}, ego=pose(0, 2, 0)) == []
    poses, ego = {"car": pose(18, 0, 0), "ball": pose(10, -2, 0.5)}, pose(1, 0.5, 0.1, 5)
    live.place("ball", poses["ball"])
    live.move_ego(ego)
    (cloud,) = live.advance(1.5 * live.sensor.scanner.frame_s)
    assert_near(cloud, Simulator(rebuild_scene(street(), poses, ego), sensor()).render())


def test_what_rests_starts_where_frames_showed_it() -> None:
    """A pose that no call repeats holds until a new one: the clouds of a caller who repeats it at each frame's end."""
    clouds = []
    for repeats in (False, True):
        live = LiveSimulator(street(), sensor(), movable=("ball",), spares={"car": 1})
        length_s = live.sensor.scanner.frame_s
        for frames, x_m in ((0.5, 12.0), (1.0, None), (2.0, None), (2.5, 13.0), (3.0, 14.0)):
            poses = {"car": (x_m or 12.0, 0.0, 0.0)} if repeats or x_m else {}
            clouds += live.advance(frames * length_s, poses)
    assert len(clouds) == 6
    for cloud, other in zip(clouds[:3], clouds[3:], strict=True):
        assert_same(cloud, other)


def test_several_frames_of_one_advance() -> None:
    """Those that are over together are traced together; each is the frame that is rendered alone."""
    live = LiveSimulator(street(), "livox-mid-40", movable=("ball",), spares={"car": 1})
    together = launches.count_frames(live)
    clouds = live.advance(0.35, {"car": (12.0, 0.0, 0.0)})
    clouds += live.advance(0.75, {"car": (15.0, 1.0, 0.0)})
    assert together == [1, 2, 1, 3]
    for number, cloud in enumerate(clouds[3:], start=3):
        assert_same(cloud, live.render(number=number))


def test_a_physics_engine_owns_the_clock() -> None:
    """A box that MuJoCo lets fall: at the mean time of its points it is where the engine's own poses say."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><option timestep='0.002'/><worldbody><body name='car' pos='15 0 1'><freejoint/>"
        "<geom type='box' size='1.5 .9 .7' mass='1'/></body></worldbody></mujoco>"
    )
    data, live = mujoco.MjData(model), LiveSimulator(street(), sensor(), movable=["car"])
    heights, clouds = [], []
    while not clouds:
        mujoco.mj_step(model, data)
        body = data.body("car")
        heights.append((data.time, float(body.xpos[2])))
        car_pose = Pose(position_m=body.xpos.copy(), rotation=body.xmat.reshape(3, 3).copy())
        clouds = live.advance(data.time, {"car": car_pose})
    car_box = {box.name: box for box in boxes(clouds[0], live.scene)}["car"]
    on_car = (clouds[0].body == clouds[0].body_names.index("car")) & (clouds[0].status == 0)
    expected = np.interp(clouds[0].time_s[on_car].mean(), *zip(*heights, strict=True))
    assert car_box.pose.position_m[2] == pytest.approx(expected, abs=1e-6)
    assert car_box.velocity_m_s[2] == pytest.approx(-9.81 * clouds[0].time_s[on_car].mean(), abs=0.05)


def live() -> LiveSimulator:
    return LiveSimulator(street(), sensor(), movable=["ball"], spares={"car": 1})


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (lambda simulator: simulator.place("van", (0, 0, 0)), "body 'van' | 'car', 'ball'"),
        (lambda simulator: simulator.place("plane", (0, 0, 0)), "body 'plane' | placed"),
        (lambda simulator: simulator.place("car.1", (0, 0, 0)), "body 'car.1' | away"),
        (lambda simulator: simulator.add("ball", (9, 0, 0)), "body 'ball' | spares | 'car'"),
        (lambda simulator: [simulator.add("car", (9, 0, 0)) for _ in range(2)], "spare | 1 | spares={'car': 2}"),
        (lambda simulator: simulator.place("car", (9, 0)), "pose | Pose"),
        (lambda simulator: simulator.place("car", Pose(rotation=np.diag([1.0, 1.0, -1.0]))), "'car' | pose"),
        (lambda simulator: simulator.place("car", Pose(position_m=np.full(3, np.nan))), "'car' | pose"),
        (lambda simulator: simulator.place("car", (9, 0, 0), velocity_m_s=(np.inf, 0, 0)), "'car' | velocity_m_s"),
        (lambda simulator: simulator.move_ego(Pose(rotation=np.eye(3) * 2.0)), "ego | pose"),
        (lambda simulator: simulator.advance(0.0) + simulator.advance(0.0), "later | 0 s"),
        (lambda simulator: simulator.advance(0.1, {"van": (0, 0, 0)}), "body 'van'"),
        (
            lambda simulator: (
                simulator.advance(0.0, {"car": (9, 0, 0)}) + simulator.advance(1.0, {"car": (9, 0, 0, 175)})
            ),
            "'car' | turn",
        ),
        (lambda simulator: simulator.advance("now"), "later | -inf s | 'now'"),
        (lambda simulator: simulator.advance(0.1, [("car", (9, 0, 0))]), "poses | dict of names and poses"),
        (lambda simulator: simulator.place("car", (9, 0, 0), velocity=(1, 0, 0)), "'velocity'"),
        (lambda simulator: simulator.place("car", (9, 0, 0), velocity_m_s=5), "velocity_m_s | three finite"),
        (lambda simulator: simulator.add("car", (9, 0, 0), time_s=10**400), "time_s | finite number"),
        (lambda simulator: simulator.place("car", (9, 0, 10**400)), "pose | Pose"),
        (lambda simulator: simulator.add({}, (9, 0, 0)), "body | name | {}"),
        (lambda simulator: simulator.advance(1e300), "frame number | 0"),
        (lambda simulator: simulator.move_ego((15, 0.89, 0)), None),
    ],
)
def test_mistakes_are_told_in_a_line(wrong, named) -> None:
    simulator = live()
    if named is None:
        wrong(simulator)
        with told("'car'"):
            simulator.render()
        simulator.remove("car")
        assert len(simulator.render())
        return
    with told(named):
        wrong(simulator)


@pytest.mark.parametrize("first", [0, DAY])
def test_a_frame_that_fails_is_reported_and_the_next_goes_on(first: int) -> None:
    """A car drives through the sensor in the second frame of four: one warning, three clouds, in one call or many.

    So it is in the first frames and after a day at 20 Hz, when the pulses have numbers of more than 32 bits.
    """
    for calls in (1, 8):
        simulator = live()
        frame_s = simulator.sensor.scanner.frame_s
        options: FrameKeywords = {"number": first, "begin_s": -first * frame_s}
        times = [4.001 * frame_s] if calls == 1 else [(call + 1) * 4.001 * frame_s / calls for call in range(calls)]
        simulator.advance(0.0, {"car": (12.0, 0.0, 0.0)}, **options)
        simulator.place("car", (0.0, -0.89, 0.0), velocity_m_s=(6.0 / frame_s, 0.0, 0.0), time_s=frame_s)
        with pytest.warns(OptionWarning, match=f"advance: frame {first + 1} is left out: .*must stand") as warned:
            clouds = [cloud for time_s in times for cloud in simulator.advance(time_s, **options)]
        assert len(warned) == 1
        assert [int(cloud.metadata["frame_number"]) - first for cloud in clouds] == [0, 2, 3]


@pytest.mark.parametrize("with_ego", [False, True])
def test_who_walks_goes_on_with_the_stride(tmp_path: Path, with_ego: bool) -> None:
    """Poses every 50 ms at two speeds: strides are the way over their length, however often the motion is a new one."""
    write_walker(tmp_path / "walker.glb")
    (tmp_path / "scene.toml").write_text(WALKER.replace("speed_m_s = 0", "with_ego = true") if with_ego else WALKER)
    if with_ego:
        with (tmp_path / "scene.toml").open("a") as scene:
            scene.write("[ego]\n")
    simulator = LiveSimulator(tmp_path / "scene.toml", sensor(), movable=["walker"])

    def strides(time_s: float) -> tuple[float, float]:
        body = simulator.scene.bodies["walker"]
        walk, gait = body.walk_in_frame(time_s), body.gait
        assert walk is not None
        assert gait is not None
        return float(walk(np.array([time_s]))[0, 0]), gait.stride_m

    x_m, expected, found = 0.0, [0.0], [0.0]
    for number in range(41):
        time_s = 0.05 * number
        place = pose(10.0, x_m, 0.0, 90.0)
        poses, ego = ({}, place) if with_ego else ({"walker": place}, None)
        if simulator.advance(time_s, poses, ego, begin_s=0.0):
            phase, stride_m = strides(time_s)
            found.append(phase)
            expected.append(x_m / stride_m)
        x_m += 0.05 * (0.8 if number < 20 else 1.4)
    assert len(found) > 10
    np.testing.assert_allclose(np.unwrap(np.array(found), period=1.0), expected, atol=0.01)
    go_on = simulator.move_ego if with_ego else partial(simulator.place, "walker")
    go_on(pose(10.0, x_m, 0.0, 90.0), velocity_m_s=(0.0, 1.0, 0.0), time_s=2.0)
    assert strides(2.0)[0] % 1.0 == pytest.approx(found[-1] % 1.0, abs=0.05), "placed anew, it does not start again"


def test_a_mistake_leaves_the_world_as_it_was() -> None:
    """The same clouds as without any of them."""
    careful, careless = live(), live()
    frame_s = careful.sensor.scanner.frame_s
    for simulator in (careful, careless):
        simulator.advance(0.0, {"car": (12.0, 0.0, 0.0)})
    for wrong in (
        lambda: careless.advance(1.5 * frame_s, {"car": (12.0, 0.0, 0.0, 175.0)}),
        lambda: careless.advance(1.5 * frame_s, {"car": (20.0, 0.0, 0.0), "van": (0.0, 0.0, 0.0)}),
        lambda: careless.advance(1.5 * frame_s, {"car": "there"}),
        lambda: careless.place("car", (9.0, 0.0, 0.0), velocity_m_s=3),
        lambda: careless.move_ego((1.0, 2.0)),
        lambda: careless.add("car", (9.0, 0.0, 0.0), time_s=np.nan),
    ):
        with pytest.raises(InputError):
            wrong()
    clouds = [simulator.advance(2.01 * frame_s, {"car": (14.0, 0.0, 0.0)}) for simulator in (careful, careless)]
    assert len(clouds[0]) == 2
    for cloud, other in zip(*clouds, strict=True):
        np.testing.assert_array_equal(cloud.xyz_m, other.xyz_m)


test_declarations_are_checked = refused(
    lambda options: LiveSimulator(street(), sensor(), **options),
    ({"movable": ["van"]}, "body 'van'"),
    ({"spares": {"van": 1}}, "body 'van'"),
    ({"movable": "car"}, "movable"),
    ({"spares": {"car": -1}}, "spares | 'car' | whole number >= 0 | -1"),
)


@pytest.mark.parametrize(
    ("name", "used_names", "names"),
    [
        ("car", ["car"], ["car.1", "car.2"]),
        ("car.0", ["car.0", "car.1"], ["car.2", "car.3"]),
        ("car.x", ["car.x.2"], ["car.x.1", "car.x.3"]),
    ],
)
def test_spares_have_names_that_are_free(name: str, used_names: list[str], names: list[str]) -> None:
    assert spare_names(name, 2, used_names) == names


def test_spares_of_two_bodies_have_names_of_their_own() -> None:
    cars = [dataclasses.replace(chain.box(at=(0, 0, 0)), name=name) for name in ("car.0", "car.1")]
    scene, pools = live_scene(chain.scene(*cars), (), {"car.0": 1, "car.1": 2})
    assert pools == {"car.0": ("car.0", "car.2"), "car.1": ("car.1", "car.3", "car.4")}
    assert [body.name for body in scene.bodies] == ["car.0", "car.1", "car.2", "car.3", "car.4"]
    assert [body.away for body in scene.bodies] == [False, False, True, True, True]
