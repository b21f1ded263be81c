"""Motion at its edges: deskewing, rigs, far coordinates, nothing that stands still, many bodies of one shape."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from helpers import chain
from helpers.mistakes import told
from helpers.traffic import EGO, SENSOR, direction, frozen, traffic

from lidarscene.cloud.deskew import deskewed
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.cloud.rig_clouds import merge_clouds
from lidarscene.kernel.world.mitsuba_world import build_world
from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course, HeldAtEnds, Riding, Spline, pose_at
from lidarscene.rendering.rig_simulators import require_common_frames, simulators
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Ball, Body, Scene
from lidarscene.scene.scene_file import load_scene
from lidarscene.sensor.rig_file import Mounted

pytestmark = pytest.mark.usefixtures("mi")

MOUNT = Pose.from_degrees(position_m=(1.0, -0.5, 1.5), yaw_deg=20.0, pitch_deg=3.0)


def table1_sensor():
    return chain.sensor("table1-apd", *SENSOR)


def select_echoes(cloud: PointCloud) -> PointCloud:
    return cloud.select(cloud.status == 0)


def standing_scene() -> Scene:
    """The wall and the boxes where they are at time 0; the vehicle drives its curve."""
    return dataclasses.replace(frozen(traffic(), 0.0), ego=EGO)


@pytest.mark.parametrize("frame", ["world", "vehicle", "sensor"])
def test_deskewed_points_are_where_the_beams_went(frame: str) -> None:
    """Reference: from where the sensor is at each pulse along its beam, by Motion.at, not by tables.

    Frame 1 at 0.2 s: the vehicle has come far and turned. Tolerance: single precision of 60 m, ten operations.
    """
    simulator = Simulator(standing_scene(), table1_sensor(), pose=MOUNT)
    raw = select_echoes(simulator.render(seed=1, number=1, begin_s=0.2, coordinates=frame))
    cloud = deskewed(raw, simulator.motion)
    start_s = float(raw.metadata["frame_start_s"])
    state = simulator.motion.at(start_s + raw.time_s)
    beams = direction(raw) * raw.range_m[:, None].astype(float)
    world = state.position_m + np.einsum("nij,nj->ni", state.rotation, beams)
    vehicle, sensor = pose_at(EGO, start_s), pose_at(simulator.motion, start_s)
    expected = {"world": Pose(), "vehicle": vehicle, "sensor": sensor}[frame].inverse_apply(world)
    np.testing.assert_allclose(cloud.xyz_m, expected, atol=1e-4)
    # Raw points are placed from where it all began, which is somewhere else by now.
    origin = {"world": sensor, "vehicle": vehicle.inverse() @ sensor, "sensor": Pose()}[frame]
    np.testing.assert_allclose(raw.xyz_m, origin.apply(beams), atol=1e-4)
    assert np.linalg.norm(cloud.xyz_m - raw.xyz_m, axis=1).max() > 5.0
    assert (raw.metadata["ego_motion"], cloud.metadata["ego_motion"]) == ("in the points", "removed")
    np.testing.assert_array_equal(cloud.range_m, raw.range_m)


@pytest.mark.parametrize("frame", ["world", "vehicle", "sensor"])
def test_a_cloud_from_a_file_is_deskewed_as_well(frame: str, tmp_path: Path) -> None:
    simulator = Simulator(standing_scene(), table1_sensor(), pose=MOUNT)
    cloud = simulator.render(seed=1, number=1, begin_s=0.2, coordinates=frame)
    cloud.save(tmp_path / "raw.ply")
    from_file = deskewed(PointCloud.load(tmp_path / "raw.ply"), simulator.motion)
    np.testing.assert_array_equal(from_file.xyz_m, deskewed(cloud, simulator.motion).xyz_m)
    from_file.save(tmp_path / "deskewed.ply")
    reloaded = PointCloud.load(tmp_path / "deskewed.ply")
    np.testing.assert_array_equal(reloaded.xyz_m, from_file.xyz_m)
    assert reloaded.metadata == from_file.metadata


def test_what_cannot_be_deskewed_is_refused() -> None:
    simulator = Simulator(standing_scene(), table1_sensor())
    cloud = simulator.render(coordinates="vehicle")
    with told("raw cloud | deskewed"):
        deskewed(deskewed(cloud, simulator.motion), simulator.motion)
    with told("one sensor"):
        deskewed(merge_clouds([cloud, cloud], ["a", "b"]), simulator.motion)
    with told("metadata"):
        deskewed(dataclasses.replace(cloud, metadata={"frame": "sensor"}), simulator.motion)
    none = cloud.select(slice(0, 0))
    assert len(deskewed(none, simulator.motion)) == 0


def test_a_rig_is_its_sensors_each_at_its_place(tmp_path: Path) -> None:
    """Each cloud of the rig is the one of that sensor alone; merged they are one after the other, also in a file."""
    sipm = chain.sensor("table1-sipm", *SENSOR)
    rig = [
        Mounted(label="roof", sensor=table1_sensor(), pose=MOUNT),
        Mounted(label="rear", sensor=sipm, pose=Pose.from_degrees(position_m=(-2, 0, 1), yaw_deg=-20.0)),
    ]
    rig_simulators = dict(simulators(traffic(), rig))
    assert rig_simulators["roof"].world is rig_simulators["rear"].world
    clouds = [simulator.render(seed=3, coordinates="vehicle") for simulator in rig_simulators.values()]
    for rig_sensor, cloud in zip(rig, clouds, strict=True):
        seed = int(cloud.metadata["seed"])
        alone = Simulator(traffic(), rig_sensor.sensor, pose=rig_sensor.pose).render(seed=seed, coordinates="vehicle")
        # The shared world has another origin: single precision, and beams that graze an edge.
        assert len(alone) == pytest.approx(len(cloud), rel=1e-3)
        assert len(alone) > 10_000
        assert np.mean(np.isin(alone.time_s, cloud.time_s)) > 0.999
    together = merge_clouds(clouds, list(rig_simulators))
    assert together.sensor_names == ("roof", "rear")
    assert len(together) == sum(map(len, clouds))
    for number, cloud in enumerate(clouds):
        sensor_points = together.select(together.sensor_index == number)
        np.testing.assert_array_equal(sensor_points.xyz_m, cloud.xyz_m)
        np.testing.assert_array_equal(sensor_points.body, cloud.body)
    positions = np.array(together.metadata["sensor_position_m"].split(), float).reshape(2, 3)
    np.testing.assert_allclose(positions, [MOUNT.position_m, [-2, 0, 1]], atol=1e-12)
    assert len(together.metadata["sensor_rotation"].split()) == 18
    assert together.metadata["frame_start_s"].split() == ["0.0", "0.0"]
    assert (together.metadata["sensor"], together.metadata["intensity_unit"]) == (
        "table1-apd, table1-sipm",
        "A or cells",
    )
    together.save(tmp_path / "rig.ply")
    reloaded = PointCloud.load(tmp_path / "rig.ply")
    np.testing.assert_array_equal(reloaded.sensor_index, together.sensor_index)
    assert (reloaded.sensor_names, reloaded.metadata) == (together.sensor_names, dict(together.metadata))
    with told("one frame | world or vehicle", ValueError):
        merge_clouds([clouds[0], rig_simulators["roof"].render(coordinates="world")], ["a", "b"])


def test_frames_that_drift_apart_are_not_merged() -> None:
    longer = chain.sensor("table1-apd", "scanner.azimuth_step_deg=0.5")
    pair = [Mounted(label="short", sensor=table1_sensor()), Mounted(label="long", sensor=longer)]
    require_common_frames(pair, 1)
    with told("9 frames | 0.37926 s | 'short' | 0.60732 s | 'long'"):
        require_common_frames(pair, 9)
    require_common_frames([pair[0], pair[0]], 10_000)


FAR = np.array([500_000.0, 5_400_000.0, 300.0])


def shifted_scene(scene: Scene, shift_m: np.ndarray) -> Scene:
    """The same scene elsewhere in the world."""
    shift = Pose(position_m=shift_m)
    bodies = []
    for body in scene.bodies:
        motion = body.motion
        if isinstance(motion, Course):
            motion = dataclasses.replace(motion, start=shift @ motion.start)
        if isinstance(motion, Spline):
            motion = Spline(time_s=motion.time_s, poses=tuple(shift @ pose for pose in motion.poses))
        bodies.append(dataclasses.replace(body, motion=motion, pose=shift @ body.pose))
    return dataclasses.replace(scene, bodies=tuple(bodies), ego=dataclasses.replace(EGO, start=shift @ EGO.start))


def test_utm_coordinates_cost_nothing() -> None:
    """500 km and 5400 km from the origin, sensor and bodies moving: the same ranges, as at the origin.

    Tolerances: 1 mm is what doubles of 5e6 m leave in twenty operations a million times over; 0.1 mm single precision.
    """
    near = select_echoes(Simulator(traffic(), table1_sensor()).render(seed=2))
    far = select_echoes(Simulator(shifted_scene(traffic(), FAR), table1_sensor()).render(seed=2))
    assert far.xyz_m.dtype == np.float64
    in_both = np.isin(far.time_s, near.time_s)
    assert in_both.mean() > 0.999
    near_points = near.select(np.searchsorted(near.time_s, far.time_s[in_both]))
    far_points = far.select(in_both)
    agree = far_points.body == near_points.body
    assert agree.mean() > 0.999
    np.testing.assert_allclose(far_points.true_range_m[agree], near_points.true_range_m[agree], atol=1e-3)
    # Edges between triangles of one body: fewer than one beam in a hundred differs by more than 0.1 mm.
    assert np.mean(np.abs(far_points.true_range_m - near_points.true_range_m)[agree] < 1e-4) > 0.99
    np.testing.assert_allclose(far_points.xyz_m[agree] - FAR, near_points.xyz_m[agree], atol=2e-3)
    np.testing.assert_allclose(far_points.radial_velocity_m_s[agree], near_points.radial_velocity_m_s[agree], atol=1e-3)


def test_a_scene_in_which_everything_moves() -> None:
    """No static shape at all: box and wall ride with the sensor, so that nothing seems to move."""
    still = chain.scene(chain.facing(range_m=30.0), chain.box(at=(15.0, 2.0, 0.0)))
    riding = tuple(dataclasses.replace(body, motion=Riding(carrier=EGO, pose=body.pose)) for body in still.bodies)
    scene = dataclasses.replace(still, bodies=riding, ego=EGO)
    simulator = Simulator(scene, table1_sensor())
    assert len(simulator.world.movers) == 2
    cloud = select_echoes(simulator.render(seed=4, coordinates="vehicle"))
    expected = select_echoes(Simulator(still, table1_sensor()).render(seed=4, coordinates="sensor"))
    in_both = np.isin(cloud.time_s, expected.time_s)
    assert in_both.mean() > 0.999
    expected_points = expected.select(np.searchsorted(expected.time_s, cloud.time_s[in_both]))
    points = cloud.select(in_both)
    agree = (points.body == expected_points.body) & (np.abs(points.true_range_m - expected_points.true_range_m) < 1e-4)
    assert agree.mean() > 0.999
    # v and w of 25 m/s and 0.3 rad/s in single precision.
    np.testing.assert_allclose(points.radial_velocity_m_s, 0.0, atol=1e-4)


def test_many_bodies_of_one_shape() -> None:
    """Twelve that share two parts of two materials and a ball, each moving in its own way: identities and ranges.

    Each stands alone in its direction, so that it is known which of them, and which part, a beam must meet.
    """
    low, high = (
        chain.box(at=(0, 0, 0), size_m=(1.0, 1.0, 0.8)).parts[0],
        chain.box(at=(0, 0, 0), material="dark").parts[0],
    )
    high = dataclasses.replace(high, vertices_m=high.vertices_m * 0.3 + [0.0, 0.0, 0.7])
    parts = (low, high, Ball(radius_m=0.2, material="grey"))
    bodies = []
    for number in range(12):
        azimuth = math.radians(-55.0 + 10.0 * number)
        distance = 10.0 + number
        start = Pose.from_degrees(
            position_m=(distance * math.cos(azimuth), distance * math.sin(azimuth), 0.0), yaw_deg=37.0 * number
        )
        bodies.append(
            Body(
                name=f"b{number}",
                class_name=f"c{number % 3}",
                parts=parts,
                motion=Course(start=start, yaw_rate_rad_s=0.1 * number),
            )
        )
    scene = chain.scene(*bodies, materials=[chain.diffuse("dark", 0.05)])
    simulator = Simulator(scene, table1_sensor())
    assert len(simulator.world.mover_scene.scene.shapes()) == len(parts)
    cloud = select_echoes(simulator.render(seed=5))
    nearest = np.rint((np.degrees(cloud.azimuth_rad) + 55.0) / 10.0).astype(int)
    np.testing.assert_array_equal(cloud.body, nearest)
    assert len(np.unique(cloud.body)) == 12
    assert [cloud.class_names[c] for c in cloud.class_id] == [f"c{b % 3}" for b in cloud.body]
    dark = cloud.material == cloud.material_names.index("dark")
    assert dark.sum() > 20
    # Its two parts touch at 0.4 m; reports are noisy, so 0.15 m around it is left out.
    clear = np.abs(cloud.xyz_m[:, 2] - 0.4) > 0.15
    np.testing.assert_array_equal(dark[clear], cloud.xyz_m[clear, 2] > 0.4)


XML = """<scene version='3.0.0'><shape type='rectangle' id='wall'>
<transform name='to_world'><scale value='30'/><rotate y='1' angle='-90'/><translate x='40'/></transform>
<bsdf type='diffuse'><rgb name='reflectance' value='0.5'/></bsdf></shape></scene>"""


def test_a_mitsuba_scene_can_be_driven_through(tmp_path: Path) -> None:
    """base = XML with [ego] and a body that moves: the wall at 40 m comes at 20 m/s."""
    (tmp_path / "base.xml").write_text(XML)
    (tmp_path / "scene.toml").write_text(
        'base = "base.xml"\nsensor.position_m = [0, 0, 0]\n'
        '[ego]\nspeed_m_s = 20\n[[bodies]]\nname = "ball"\nprimitive = "sphere"\nradius_m = 0.5\n'
        'material = "own"\nposition_m = [12, 0, 0]\n[bodies.motion]\nvelocity_m_s = [0, 3, 0]\n'
        "[materials.own]\nreflectivity = 0.3\n"
    )
    scene = load_scene(tmp_path / "scene.toml")
    cloud = select_echoes(Simulator(scene, table1_sensor()).render(seed=6))
    ahead = np.cos(cloud.elevation_rad) * np.cos(cloud.azimuth_rad)
    wall = cloud.body == cloud.body_names.index("wall")
    assert wall.sum() > 5000
    np.testing.assert_allclose(cloud.true_range_m[wall], ((40 - 20 * cloud.time_s) / ahead)[wall], atol=1e-4)
    # The exact sphere: the distance of each point from its centre then, in the world, is its radius.
    ball = cloud.body == cloud.body_names.index("ball")
    assert ball.sum() > 20
    ball_points = cloud.select(ball)
    points = direction(ball_points) * ball_points.true_range_m[:, None].astype(float)
    points[:, 0] += 20 * ball_points.time_s
    centre = np.stack([np.full(len(ball_points), 12.0), 3 * ball_points.time_s, np.zeros(len(ball_points))], axis=1)
    np.testing.assert_allclose(np.linalg.norm(points - centre, axis=1), 0.5, atol=1e-4)


def test_shadows_move() -> None:
    """A roof that flies over a board darkens it only while it is between board and sun."""
    board = chain.facing(range_m=30.0, size_m=20.0)
    still = chain.scene(board)
    towards = still.sun.direction
    above = board.pose.position_m + 10.0 * towards
    cover = chain.box(at=(0, 0, 0), size_m=(40.0, 40.0, 0.1))
    cover = dataclasses.replace(
        cover, name="cover", motion=Course(start=Pose(position_m=above), velocity_m_s=(0.0, 200.0, 0.0))
    )
    cloud = select_echoes(Simulator(dataclasses.replace(still, bodies=(board, cover)), table1_sensor()).render(seed=7))
    cloud = cloud.select(cloud.body == 0)
    # Along y the cover's shadow is as wide as it is, and at the same place: the sun has no y here.
    shadow = 200.0 * cloud.time_s
    y = cloud.range_m * np.cos(cloud.elevation_rad) * np.sin(cloud.azimuth_rad)
    inside = np.abs(y - shadow) < 19.5
    outside = np.abs(y - shadow) > 20.5
    assert inside.sum() > 500
    assert outside.sum() > 500
    assert cloud.in_shadow[inside].all()
    assert not cloud.in_shadow[outside].any()


def test_a_body_that_hides_is_in_no_later_frame() -> None:
    """A wall that comes at 10 m/s for 0.15 s: frames that begin by then show it, later ones the wall behind it.

    Reference: the worlds with that wall alone and without it. The same kernels trace all of them, to the bit.
    """
    sensor = table1_sensor()
    line = Spline(
        time_s=np.array([0.0, 0.15]), poses=tuple(Pose(position_m=np.array([x, 0.0, 0.0])) for x in (0.0, -1.5))
    )
    wall, near = chain.facing(range_m=30.0, size_m=60.0), chain.facing(range_m=10.0, size_m=20.0)
    near = dataclasses.replace(near, name="near", motion=Riding(carrier=HeldAtEnds(motion=line), pose=near.pose))
    hiding = dataclasses.replace(near, present_s=line.span_s)

    def ranges_m(body: Body, number: int) -> np.ndarray:
        return np.asarray(Simulator(chain.scene(wall, body), sensor).render(seed=1, number=number).range_m)

    frame_s = float(sensor.scanner.time_s(np.array([sensor.scanner.pulses], np.uint32))[0])
    shown = [number for number in range(4) if number * frame_s <= 0.15]
    assert 0 < len(shown) < 4
    for number in range(4):
        same_as = near if number in shown else dataclasses.replace(near, away=True)
        np.testing.assert_array_equal(ranges_m(hiding, number), ranges_m(same_as, number))
    assert np.median(ranges_m(hiding, 0)) < 20.0 < np.median(ranges_m(hiding, 3))


def test_bodies_that_hide_take_turns() -> None:
    """Three walls one after the other: one place among the movers, and clouds, names and all, as with three places.

    Turns change the kernels and not the rays: columns are the same to the bit.
    """
    sensor = table1_sensor()
    wall, plate = chain.facing(range_m=30.0, size_m=60.0), chain.facing(range_m=10.0, size_m=8.0)
    frame_s = float(sensor.scanner.time_s(np.array([sensor.scanner.pulses], np.uint32))[0])
    spans_s = [(first * frame_s, last * frame_s) for first, last in ((-1.0, 0.5), (0.6, 1.5), (1.6, 9.0))]
    walls = [
        dataclasses.replace(
            plate,
            name=f"plate.{number}",
            motion=Course(start=plate.pose, velocity_m_s=(2.0, 3.0 * (number - 1), 0.0)),
            present_s=span_s,
        )
        for number, span_s in enumerate(spans_s)
    ]
    scene = chain.scene(wall, *walls)
    turns = Simulator(scene, sensor)
    assert [len(mover.others) for mover in turns.world.movers] == [2]
    world = build_world(
        scene,
        wavelength_m=sensor.laser.wavelength_m,
        centre_m=pose_at(turns.motion).position_m,
        see_through=True,
        takes_turns=False,
    )
    assert len(world.movers) == 3
    places = Simulator(scene, sensor, world=world)
    shown = set()
    for number in range(4):
        a, b = (simulator.render(seed=1, number=number) for simulator in (turns, places))
        for field in dataclasses.fields(a):
            if isinstance(values := getattr(a, field.name), np.ndarray):
                np.testing.assert_array_equal(values, getattr(b, field.name))
        assert a.body is not None
        shown |= {a.body_names[index] for index in np.unique(a.body) if index >= 0}
    assert shown == {"plane", "plate.0", "plate.1", "plate.2"}
