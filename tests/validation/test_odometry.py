"""Lidar odometry of others on rendered frames: KISS-ICP and small_gicp (both MIT), skipped without them."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers.scene_text import scene_of

from lidarscene import PointCloud, Simulator, load_scene, load_sensor
from lidarscene.maths.arrays import Numbers

pytestmark = pytest.mark.usefixtures("mi")

FRAME_S = 0.1


def from_rest() -> str:
    """Poses of an ego vehicle that reaches 8 m/s in 4 s and keeps it."""
    times = np.arange(0.0, 15.01, 0.5)
    way_m = np.where(times < 4.0, times * times, 16.0 + 8.0 * (times - 4.0))
    poses = (f"{{time_s = {time}, position_m = [{x - 40.0}, -1.6, 0]}}" for time, x in zip(times, way_m, strict=True))
    return f"ego.poses=[{', '.join(poses)}]"


def frames_of(simulator: Simulator, count: int, begin_s: float) -> Iterator[PointCloud]:
    """Frames with points in the sensor's coordinates, as a driver gives them."""
    for number in range(count):
        yield simulator.render(number=number, begin_s=begin_s, coordinates="sensor")


def errors(simulator: Simulator, poses: list[Numbers], begin_s: float) -> tuple[float, float, float]:
    """Length of the way [m], and by how much the last of (4, 4) poses of frames' ends is off from the first: m, deg."""
    true_poses = []
    for number in range(len(poses)):
        pose = simulator.motion.at(np.array([begin_s + FRAME_S * (number + 1)])).pose()
        true_poses.append(np.vstack([np.column_stack([pose.rotation, pose.position_m]), [0.0, 0.0, 0.0, 1.0]]))
    way_m = np.linalg.norm(np.diff([pose[:3, 3] for pose in true_poses], axis=0), axis=1).sum()
    moved, truly_moved = (np.linalg.inv(path[0]) @ path[-1] for path in (poses, true_poses))
    error = np.linalg.inv(truly_moved) @ moved
    turn_deg = np.degrees(np.arccos(np.clip(0.5 * (np.trace(error[:3, :3]) - 1.0), -1.0, 1.0)))
    return float(way_m), float(np.linalg.norm(error[:3, 3])), float(turn_deg)


def test_kiss_icp_follows_a_vehicle_that_rides() -> None:
    """The error over 96 m of the street is below 1 % of the length and 0.5 degrees per 100 m, the goals of odometry
    benchmarks.

    Poses of KISS-ICP are of the end of a frame, to which it moves the points.
    """
    kiss_icp = pytest.importorskip("kiss_icp.kiss_icp", reason="KISS-ICP is not installed: pip install kiss-icp")
    config = pytest.importorskip("kiss_icp.config")
    changes = [from_rest(), "sensor.position_m=[0, 0, 1.75]", "ego.ride.active=true"]
    sensor = load_sensor("os1-128", overrides=["scanner.columns_per_turn=1024"])
    simulator = Simulator(load_scene("street", overrides=changes), sensor)
    settings = config.KISSConfig()
    settings.data.max_range, settings.data.deskew, settings.mapping.voxel_size = 100.0, True, 1.0
    odometry, poses = kiss_icp.KissICP(settings), []
    for cloud in frames_of(simulator, 140, 0.0):
        odometry.register_frame(cloud.xyz_m.astype(float), cloud.time_s / FRAME_S)
        poses.append(odometry.last_pose.copy())
    way_m, error_m, turn_deg = errors(simulator, poses, 0.0)
    assert way_m > 95.0
    assert error_m < 0.01 * way_m
    assert turn_deg < 0.5 * way_m / 100.0


def test_small_gicp_follows_sixteen_beams_through_traffic(tmp_path: Path) -> None:
    """A VLP-16 thrown in at 9 m/s: from the second second on, 105 m within 1 % of the length and 0.5 degrees per 100 m.

    Each frame is aligned with a map of Gaussian voxels of all before it, once the points are where a steady motion
    like that of the last frame puts them at the frame's end. Points on the vehicle itself are left out.
    """
    small_gicp = pytest.importorskip("small_gicp", reason="small_gicp is not installed: pip install small_gicp")
    from scipy.spatial.transform import Rotation

    begin_s, locked = 15.0, 10
    simulator = Simulator(scene_of(tmp_path, "[street]\nseed = 1\nlength_m = 400\n"), load_sensor("vlp-16"))
    voxels = small_gicp.GaussianVoxelMap(1.0)
    voxels.set_lru(horizon=100, clear_cycle=10)
    pose, step, poses = np.eye(4), np.eye(4), []
    for number, cloud in enumerate(frames_of(simulator, 125, begin_s)):
        outside = cloud.range_m > 3.0
        share = (np.clip(cloud.time_s[outside] / FRAME_S, 0.0, 1.0) - 1.0)[:, None]
        turn = Rotation.from_rotvec(Rotation.from_matrix(step[:3, :3]).as_rotvec() * share)
        points = turn.apply(cloud.xyz_m[outside].astype(float)) + share * step[:3, 3]
        thinned, _ = small_gicp.preprocess_points(points, 0.25)
        if number:
            aligned = small_gicp.align(voxels, thinned, init_T_target_source=pose @ step).T_target_source
            pose, step = aligned, np.linalg.inv(pose) @ aligned
        voxels.insert(thinned, pose)
        poses.append(pose)
    way_m, error_m, turn_deg = errors(simulator, poses[locked:], begin_s + FRAME_S * locked)
    assert way_m > 100.0
    assert error_m < 0.01 * way_m
    assert turn_deg < 0.5 * way_m / 100.0
