"""Motion in scene files, trajectory files, rig files: what becomes of their keys, and what is refused."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.scene_text import scene_of
from helpers.walls import ROOF_AND_LEFT
from scipy.spatial.transform import Rotation

from lidarscene import catalog, load_rig, load_sensor
from lidarscene.maths.trajectory import Course, Riding, Spline, pose_at
from lidarscene.rendering.frame import check_frame
from lidarscene.scene.poses import read_poses
from lidarscene.scene.scene_file import files_of_scene

BOX = '[[bodies]]\nname = "box"\nprimitive = "box"\nsize_m = [1, 2, 3]\nmaterial = "brick"\n'
CSV = "time_s,x_m,y_m,z_m,yaw_deg\n0,0,0,0,0\n1,10,0,0,0\n2,20,5,0,45\n"
TUM = "# time x y z qx qy qz qw\n0 0 0 0 0 0 0 1\n1 10 0 0 0 0 0 1\n2 20 5 0 0 0 0.38268343 0.92387953\n"


def yaw_deg(rotation: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0])))


def test_nothing_moves_without_being_told(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, BOX)
    assert scene.ego is None
    assert scene.bodies[0].motion is None


def test_constant_speeds(tmp_path: Path) -> None:
    scene = scene_of(
        tmp_path,
        "[ego]\nposition_m = [1, 2, 0]\nyaw_deg = 90\nspeed_m_s = 20\nyaw_rate_deg_s = -10\n"
        + BOX
        + "position_m = [5, 0, 0]\nyaw_deg = 180\n[bodies.motion]\nspeed_m_s = 3\nvelocity_m_s = [0, 1, 0]\n",
    )
    assert isinstance(scene.ego, Course)
    start = scene.ego.at(np.zeros(1))
    np.testing.assert_allclose(start.velocity_m_s[0], [0, 20, 0], atol=1e-14)
    np.testing.assert_allclose(start.turning_rad_s[0], [0, 0, np.radians(-10)], atol=1e-15)
    (box,) = scene.bodies
    assert box.motion is not None
    np.testing.assert_allclose(box.motion.at(np.array([2.0])).position_m[0], [-1, 2, 0], atol=1e-14)
    np.testing.assert_array_equal(box.pose.position_m, [5, 0, 0])


def test_poses_move_the_frame_that_the_pose_is_in(tmp_path: Path) -> None:
    """The box stands 1 m to the left in a frame that turns by 90 degrees on the spot."""
    scene = scene_of(
        tmp_path,
        BOX + "position_m = [0, 1, 0]\n[bodies.motion]\n"
        "poses = [{ time_s = 0, position_m = [10, 0, 0] }, { time_s = 2, position_m = [10, 0, 0], yaw_deg = 90 }]\n",
    )
    motion = scene.bodies[0].motion
    assert isinstance(motion, Riding)
    np.testing.assert_allclose(motion.at(np.array([0.0, 2.0])).position_m, [[10, 1, 0], [9, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(scene.bodies[0].pose.position_m, [10, 1, 0], atol=1e-12)


@pytest.mark.parametrize(("name", "text"), [("way.csv", CSV), ("way.txt", TUM), ("way.tum", TUM)])
def test_poses_from_files(tmp_path: Path, name: str, text: str) -> None:
    """CSV and TUM say the same; the quaternion of 45 degrees has eight digits. The file is an input of the run."""
    (tmp_path / name).write_text(text)
    scene = scene_of(tmp_path, f'[ego]\nposition_m = [1, 0, 0]\nposes_file = "{name}"\n' + BOX)
    assert scene.ego is not None
    assert scene.ego.span_s == (0.0, 2.0)
    end = pose_at(scene.ego, 2.0)
    np.testing.assert_allclose(end.position_m, [20 + 0.5**0.5, 5 + 0.5**0.5, 0], atol=1e-7)
    assert yaw_deg(end.rotation) == pytest.approx(45.0, abs=1e-6)
    assert tmp_path / name in files_of_scene(tmp_path / "scene.toml")


def test_csv_with_quaternions_and_columns_of_others(tmp_path: Path) -> None:
    path = tmp_path / "way.csv"
    path.write_text("frame,time_s, x_m,y_m,z_m,qw,qx,qy,qz\n7,0,1,2,3,1,0,0,0\n8,0.5,1,2,4,0.70710678,0,0.70710678,0\n")
    spline = read_poses(path)
    assert isinstance(spline, Spline)
    np.testing.assert_allclose(spline.poses[1].rotation @ [1, 0, 0], [0, 0, -1], atol=1e-8)


@pytest.mark.parametrize("length", [0.991, 1.009])
def test_a_quaternion_of_few_digits_turns_and_does_not_stretch(tmp_path: Path, length: float) -> None:
    """Reference: SciPy, which norms quaternions. Files are taken with lengths up to 0.01 off 1."""
    turn = Rotation.from_euler("ZYX", [50.0, -20.0, 10.0], degrees=True)
    numbers = " ".join(map(repr, (length * turn.as_quat()).tolist()))
    path = tmp_path / "way.tum"
    path.write_text(f"0 0 0 0 {numbers}\n1 1 0 0 {numbers}\n")
    spline = read_poses(path)
    np.testing.assert_allclose(spline.poses[0].rotation, turn.as_matrix(), atol=1e-12)


def test_three_angles_of_a_pose(tmp_path: Path) -> None:
    """Yaw about z, pitch up, so about -y as it is then, roll about the new x; SciPy turns about y itself."""
    path = tmp_path / "way.csv"
    path.write_text("time_s,x_m,y_m,z_m,yaw_deg,pitch_deg,roll_deg\n0,0,0,0,50,-20,10\n1,1,0,0,50,-20,10\n")
    turn = Rotation.from_euler("ZYX", [50.0, 20.0, 10.0], degrees=True)
    np.testing.assert_allclose(read_poses(path).poses[0].rotation, turn.as_matrix(), atol=1e-12)


def test_epoch_times_keep_their_microseconds(tmp_path: Path) -> None:
    """TUM files count from 1970. At 1.7e9 s a double has steps of 0.24 us, 7 um at 30 m/s."""
    path = tmp_path / "way.txt"
    path.write_text("1700000000.0 0 0 0 0 0 0 1\n1700000001.0 30 0 0 0 0 0 1\n")
    states = read_poses(path).at(1.7e9 + np.linspace(0.0, 1.0, 11))
    np.testing.assert_allclose(states.position_m[:, 0], np.linspace(0.0, 30.0, 11), atol=1e-5)


def test_riding_with_the_ego_vehicle_and_instances(tmp_path: Path) -> None:
    """Instances of a body that rides stand where their poses say, in the vehicle's frame; they share their shape."""
    scene = scene_of(
        tmp_path,
        "[ego]\nyaw_deg = 90\nspeed_m_s = 10\n"
        + BOX
        + "position_m = [1, 0, 0]\ninstances = [{}, { position_m = [0, 2, 0] }]\n"
        "[bodies.motion]\nwith_ego = true\n",
    )
    motions = [body.motion for body in scene.bodies]
    assert all(motion is not None for motion in motions)
    places = [motion.at(np.array([3.0])).position_m[0] for motion in motions if motion is not None]
    np.testing.assert_allclose(places, [[0, 31, 0], [-2, 31, 0]], atol=1e-12)
    assert scene.bodies[0].parts is scene.bodies[1].parts


def test_instances_move_each_from_its_own_pose(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, BOX + "instances = [{}, { yaw_deg = 90 }]\n[bodies.motion]\nspeed_m_s = 2\n")
    places = [pose_at(body.motion, 1.0).position_m for body in scene.bodies if body.motion]
    np.testing.assert_allclose(places, [[2, 0, 0], [0, 2, 0]], atol=1e-14)


def test_an_instance_may_move_by_itself(tmp_path: Path) -> None:
    """One of three has a motion of its own, in place of the body's; all share one shape."""
    instances = "instances = [{}, { position_m = [0, 3, 0], motion = { speed_m_s = 5 } }, { yaw_deg = 90 }]\n"
    bodies = scene_of(tmp_path, BOX + instances + "[bodies.motion]\nspeed_m_s = 2\n").bodies
    places = [pose_at(body.motion, 1.0).position_m for body in bodies if body.motion]
    np.testing.assert_allclose(places, [[2, 0, 0], [5, 3, 0], [0, 2, 0]], atol=1e-14)
    assert len({id(body.parts) for body in bodies}) == 1
    alone = scene_of(tmp_path, BOX + instances).bodies
    assert [body.motion is None for body in alone] == [True, False, True]


ENDS = BOX + "[bodies.motion]\nposes = [{ time_s = 1 }, { time_s = 3, position_m = [20, 0, 0] }]\n"


@pytest.mark.parametrize(
    ("at_end", "places_m", "is_there"),
    [
        ("hold", [0.0, 10.0, 20.0], [True, True, True]),
        ("hide", [0.0, 10.0, 20.0], [False, True, False]),
        ("leave", [-5.0, 10.0, 40.0], [True, True, True]),
        ("repeat", [15.0, 10.0, 0.0], [True, True, True]),
    ],
)
def test_at_its_end_it_holds_hides_leaves_or_repeats(tmp_path, at_end, places_m, is_there):
    """States at 0.5, 2 and 5 s, of a motion from 1 to 3 s at 10 m/s."""
    (body,) = scene_of(tmp_path, ENDS + f'at_end = "{at_end}"\n').bodies
    assert body.motion is not None
    times_s = [0.5, 2.0, 5.0]
    assert [pose_at(body.motion, time_s).position_m[0] for time_s in times_s] == pytest.approx(places_m, abs=1e-9)
    assert [body.is_present(time_s) for time_s in times_s] == is_there
    assert body.motion.span_s == (-math.inf, math.inf)


def test_without_an_end_a_frame_beyond_the_poses_is_refused(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, ENDS)
    assert scene.bodies[0].motion is not None
    assert scene.bodies[0].motion.span_s == (1.0, 3.0)
    with told("motion of body 'box' | poses"):
        check_frame(scene, load_sensor("vlp-16").scanner, number=0, begin_s=2.95)


def test_a_vehicle_that_leaves_rides_on(tmp_path: Path) -> None:
    """The vehicle rides on its springs beyond the last pose, too; one that holds rests as it stood at the end."""
    ground = '[ground]\nroughness = "C"\n'
    poses = "poses = [{ time_s = 0 }, { time_s = 2, position_m = [20, 0, 0] }]\nride = {}\n"
    for at_end, rides in (("leave", True), ("hold", False)):
        ego = scene_of(tmp_path, f'{ground}[ego]\n{poses}at_end = "{at_end}"\n' + BOX).ego
        assert ego is not None
        heights_m = ego.at(np.array([2.5, 3.0, 3.5])).position_m[:, 2]
        assert (np.ptp(heights_m) > 1e-3) == rides


def rig_of(folder: Path, text: str) -> Path:
    sensor_text = catalog.path_of("sensors", "table1-sipm").read_text(encoding="utf-8")
    (folder / "own.toml").write_text(sensor_text, encoding="utf-8")
    path = folder / "van.toml"
    path.write_text(text)
    return path


def test_a_rig_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Labels, poses, own changes before the run's, and files relative to the rig's."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    path = rig_of(tmp_path, ROOF_AND_LEFT)
    rig = load_rig(Path("..") / "van.toml", overrides=["laser.peak_power_w=33"])
    assert (rig.name, [mounted.label for mounted in rig.sensors]) == ("van", ["roof", "left"])
    assert rig.sensors[0].sensor.detector.gain == 50
    assert {mounted.sensor.laser.peak_power_w for mounted in rig.sensors} == {33.0}
    assert rig.sensors[0].pose.position_m.tolist() == [0, 0, 1.8]
    assert yaw_deg(rig.sensors[1].pose.rotation) == pytest.approx(90)
    assert rig.sensors[1].sensor.name == "table1-sipm"
    assert load_rig(path).files == (path, tmp_path / "own.toml")
    assert load_rig(rig) is rig
    changed = load_rig(
        rig_of(tmp_path, 'name = "x"\n' + ROOF_AND_LEFT), overrides=["roof:detector.gain=9", "left:detector.cells=77"]
    )
    assert changed.name == "x"
    assert [mounted.sensor.detector for mounted in changed.sensors] == [
        dataclasses.replace(rig.sensors[0].sensor.detector, gain=9.0),
        dataclasses.replace(rig.sensors[1].sensor.detector, cells=77),
    ]


def test_the_shipped_rig(tmp_path: Path) -> None:
    rig = load_rig("rig")
    assert [mounted.label for mounted in rig.sensors] == ["roof", "left", "right"]
