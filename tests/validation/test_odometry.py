"""Lidar odometry of others on rendered frames: KISS-ICP (MIT) on a drive that starts from rest, skipped without it."""

import numpy as np
import pytest

from lidarscene import Simulator, load_scene, load_sensor

kiss_icp = pytest.importorskip("kiss_icp.kiss_icp", reason="KISS-ICP is not installed: pip install kiss-icp")
config = pytest.importorskip("kiss_icp.config")

pytestmark = [pytest.mark.usefixtures("mi"), pytest.mark.slow]

FRAME_S = 0.1
FRAMES = 140


def from_rest() -> str:
    """Poses of an ego vehicle that reaches 8 m/s in 4 s and keeps it."""
    times = np.arange(0.0, 15.01, 0.5)
    way_m = np.where(times < 4.0, times * times, 16.0 + 8.0 * (times - 4.0))
    poses = (f"{{time_s = {time}, position_m = [{x - 40.0}, -1.6, 0]}}" for time, x in zip(times, way_m, strict=True))
    return f"ego.poses=[{', '.join(poses)}]"


def test_kiss_icp_follows_a_vehicle_that_rides() -> None:
    """Over 96 m of the street below 1 % of the length and 0.5 degrees per 100 m, the goals of odometry benchmarks.

    Poses of KISS-ICP are of the end of a frame, to which it moves the points.
    """
    changes = [from_rest(), "sensor.position_m=[0, 0, 1.75]", "ego.ride.active=true"]
    sensor = load_sensor("os1-128", overrides=["scanner.columns_per_turn=1024"])
    simulator = Simulator(load_scene("street", overrides=changes), sensor)
    settings = config.KISSConfig()
    settings.data.max_range, settings.data.deskew, settings.mapping.voxel_size = 100.0, True, 1.0
    odometry, poses = kiss_icp.KissICP(settings), []
    for number in range(FRAMES):
        cloud = simulator.render(number=number, coordinates="sensor")
        odometry.register_frame(cloud.xyz_m.astype(float), cloud.time_s / FRAME_S)
        poses.append(odometry.last_pose.copy())
    true_poses = []
    for number in range(FRAMES):
        pose = simulator.motion.at(np.array([FRAME_S * (number + 1)])).pose()
        true_poses.append(np.vstack([np.column_stack([pose.rotation, pose.position_m]), [0.0, 0.0, 0.0, 1.0]]))
    way_m = np.linalg.norm(np.diff([pose[:3, 3] for pose in true_poses], axis=0), axis=1).sum()
    moved, truly_moved = (np.linalg.inv(path[0]) @ path[-1] for path in (poses, true_poses))
    error = np.linalg.inv(truly_moved) @ moved
    turn_deg = np.degrees(np.arccos(np.clip(0.5 * (np.trace(error[:3, :3]) - 1.0), -1.0, 1.0)))
    assert way_m > 95.0
    assert np.linalg.norm(error[:3, 3]) < 0.01 * way_m
    assert turn_deg < 0.5 * way_m / 100.0
