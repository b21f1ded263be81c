"""The command `sensor`."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from helpers.command_line import Run
from helpers.recordings import OUSTER

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.files.toml import read_toml
from lidarscene.recordings.ouster_reader import beams
from lidarscene.sensor.sensor_file import load_sensor


def test_a_unit_of_an_ouster(run: Run) -> None:
    shutil.copy(OUSTER.with_suffix(".json"), "unit.json")
    printed = run.well("sensor", "--from", "unit.json", "--mode", "512x10", "-o", "mine.toml")
    assert printed == "wrote mine.toml: OS-0-32-U1 992137000142, 32 beams, else as os0-128\n"
    assert load_sensor("mine.toml").scanner.pulses == 512 * 32
    mine = read_toml(Path("mine.toml"))
    assert run("sensor", "--from", "os0-32", "--mode", "512x10", "-o", "mine.toml").out == printed
    assert read_toml(Path("mine.toml"))["scanner"] == mine["scanner"]


def test_points_that_it_renders_lie_on_the_makers_beams(
    mi: Any, run: Run, wall: str, library: Callable[[str], Any]
) -> None:
    """Rationale: 2 mm is the acceptance; at 10 m single precision is worth 0.01 mm."""
    core = library("ouster.sdk.core")
    metadata = OUSTER.with_suffix(".json")
    assert run("sensor", "--from", str(metadata), "-o", "mine.toml").code == 0
    quiet = "laser.peak_power_w=1000"  # so that the wall is found, whatever its light
    assert run("render", wall, "--sensor", "mine.toml", "--set", quiet, "-o", "a.ply").code == 0
    cloud = PointCloud.load("a.ply")
    cloud = cloud.select(cloud.status == 0)
    assert len(cloud) > 100
    direction, origin_m = beams(core, core.SensorInfo(metadata.read_text()))
    column = np.rint(cloud.time_s * 10_240).astype(int)
    along, start = direction[cloud.channel, column], origin_m[cloud.channel, column]
    from_start = cloud.in_sensor_frame().xyz_m - start
    range_m = np.sum(from_start * along, axis=1)
    miss_m = np.linalg.norm(from_start - range_m[:, None] * along, axis=1)
    assert miss_m.max() < 2e-3
