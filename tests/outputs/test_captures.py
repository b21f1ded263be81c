"""Captures: what `render` writes as packets is the cloud it would have written, read by the makers' libraries."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import Run
from helpers.mistakes import typed
from helpers.walls import rig_text

from lidarscene import PointCloud
from lidarscene.recordings.opening import open_recording

RIG = rig_text(("left", "vlp-16", "position_m = [0, 1, 1.8]"), ("right", "hdl-32e", "position_m = [0, -1, 1.8]"))
NOTE = "lidarscene: note: packets of this sensor end at 131.07 m: returns beyond are left out\n"
"""Where a false alarm is beyond."""
OUSTER = ("--sensor", "os1-128", "--set=scanner.columns_per_turn=512")


def test_a_capture_has_the_points_of_the_clouds(mi: Any, run: Run, wall: str, library: Callable[[str], Any]) -> None:
    """Three frames in one file; velodyne-decoder puts them where the clouds have them.

    It takes no point beyond 130 m, where a false alarm may lie: a packet has 16 bits for steps of 2 mm.
    """
    library("velodyne_decoder")
    arguments = ("render", wall, "--sensor", "vlp-16", "--coordinates", "sensor", "--frames", "3")
    assert run(*arguments, "-o", "clouds", "--format", "npz").code == 0
    ran = run(*arguments, "-o", "out/a.pcap")
    clouds = [PointCloud.load(f"clouds/frame_{number:04d}.npz") for number in range(3)]
    beyond = any((cloud.range_m > 131.07).any() for cloud in clouds)
    assert (ran.code, ran.err) == (0, NOTE if beyond else "")
    assert ran.out.endswith("wrote         3 frames in out/a.pcap\n")
    assert os.listdir("out") == ["a.pcap"]
    clouds = [cloud.select(cloud.range_m < 130.0) for cloud in clouds]
    with open_recording("out/a.pcap") as recording:
        sweeps = list(recording)
    xyz_m = np.concatenate([sweep.xyz_m[sweep.has_return] for sweep in sweeps])
    time_s = np.concatenate([sweep.time_s[sweep.has_return] + sweep.start_s for sweep in sweeps])
    ring = np.concatenate([sweep.ring[sweep.has_return] for sweep in sweeps])
    elevation = np.concatenate([cloud.elevation_rad for cloud in clouds])
    expected_s = np.concatenate([cloud.time_s + cloud.frame_start_s for cloud in clouds])
    theirs, ours = np.lexsort((ring, time_s.round(6))), np.lexsort((elevation, expected_s.round(6)))
    expected = np.concatenate([cloud.xyz_m for cloud in clouds])[ours]
    assert len(xyz_m) == len(expected) > 1000
    apart_m = np.linalg.norm(xyz_m[theirs] - expected, axis=1)
    assert (apart_m < 0.003 + np.radians(0.01) * np.linalg.norm(expected, axis=1)).all()


def test_ouster_metadata_and_background(mi: Any, run: Run, wall: str, library: Callable[[str], Any]) -> None:
    """The near infrared is the background of every pulse, as `--ambient` has it.

    Stamps are dates: to ouster-cli 0 means that there are none.
    """
    library("ouster.sdk")
    ran = run("render", wall, *OUSTER, "-o", "a.pcap", "--ambient", "a.npz", "--keep-missed", "m.npz")
    assert (ran.code, ran.err) == (0, "")
    assert sorted(os.listdir()) == ["a.json", "a.npz", "a.pcap", "m.npz", "wall.toml"]
    assert "a.json" in ran.out.splitlines()[-1]
    with open_recording("a.pcap") as recording:
        sweep = recording[0]
    with np.load("a.npz") as ambient, np.load("m.npz") as missed:
        counts = ambient["counts"].reshape(512, 128).T
        missed_pulses = len(missed["pulse"])
    assert (sweep.near_ir == counts).all()
    assert sweep.start_s == pytest.approx(1_767_225_600, abs=1e-6)  # `date -u -d 2026-01-01 +%s`
    assert sweep.lost.sum() <= missed_pulses < 512 * 128  # false alarms are points, and of missed pulses


def test_a_rig_has_a_capture_for_each_sensor(mi: Any, run: Run, wall: str, library: Callable[[str], Any]) -> None:
    library("velodyne_decoder")
    Path("rig.toml").write_text(RIG)
    ran = run("render", wall, "--rig", "rig.toml", "-o", "out", "--format", "pcap", "--frames", "2")
    assert ran.code == 0
    assert ran.err in ("", NOTE)
    assert sorted(os.listdir("out")) == ["left.pcap", "right.pcap"]
    for name, model in (("left", "VLP16"), ("right", "HDL32E")):
        with open_recording(f"out/{name}.pcap") as recording:
            assert (recording.metadata["sensor"], len(recording)) == (model, 2)


def test_a_folder_in_place_of_metadata_is_told(run: Run, wall: str, library: Callable[[str], Any]) -> None:
    library("ouster.sdk")
    Path("taken.json").mkdir()
    typed(run, "taken.json | a file | a folder", "render", wall, *OUSTER, "-o", "taken.pcap")


def test_a_scene_is_not_written_over_by_metadata(run: Run, wall: str, library: Callable[[str], Any]) -> None:
    """Rationale: the name of the metadata is not typed by anyone."""
    library("ouster.sdk")
    os.rename("wall.toml", "wall.json")
    os.symlink("wall.json", "wall.toml")
    typed(run, "wall.json | an input", "render", wall, *OUSTER, "-o", "wall.pcap")
