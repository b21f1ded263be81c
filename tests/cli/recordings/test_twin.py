"""The command `twin`, and `certify` with a twin."""

import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.child import assert_ended
from helpers.command_line import Run
from helpers.recordings import OUSTER, pcap, turns
from helpers.waiting import PATIENCE_S

from lidarscene import Simulator, load_scene, load_sensor


def test_a_twin_of_a_recording(run: Run) -> None:
    """One packet of an OS0: 16 of 1024 columns."""
    printed = run.well("twin", str(OUSTER), "--held-out", "columns", "-o", "twin")
    assert "quads of 1 frame" in printed
    assert {path.name for path in Path("twin").iterdir()} == {"scene.toml", "sensor.toml", "twin.json", "meshes"}
    text = Path("twin/sensor.toml").read_text()
    assert "stops = 2" in text  # it recorded two returns
    assert re.search(
        r"second returns take several rays of a pulse: lidarscene render twin.scene\.toml --rays 16", printed
    )


@pytest.mark.usefixtures("mi")
def test_a_twin_of_a_recording_without_signal_renders(run: Run, tmp_path: Path, library: Callable[[str], Any]) -> None:
    """A Velodyne's packets say nothing of lost pulses. Five degrees of one laser are lost in a round room of 10 m: they
    are filled from the lasers beside it, and what the twin returns is where the room is.
    """
    library("velodyne_decoder")
    lost_pulses = [(3, firing) for firing in range(800, 825)]
    path = pcap(tmp_path / "room.pcap", turns(150, missing=lost_pulses))
    run.well("twin", str(path), "--frames", "0", "--sensor", "vlp-16", "-o", "twin")
    scene = load_scene("twin/scene.toml")
    assert {body.class_name for body in scene.bodies} >= {"smooth", "filled"}
    assert "bright" not in {body.class_name for body in scene.bodies}
    for file in (tmp_path / "twin").rglob("*.[tj]*"):
        assert not re.search(r"\b(inf|nan|infinity)\b", file.read_text().lower()), file
    cloud = Simulator(scene, load_sensor(scene.sensor_name)).render()
    assert len(cloud) > 0.99 * 16 * 1800
    # A quad of 0.2 degrees is flat within 20 um here; the rest is the scatter of the sensor, some 10 mm.
    assert np.median(cloud.range_m) == pytest.approx(10.0, abs=0.01)


def test_libraries_report_nothing_at_the_end(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """Rationale: at exit the decoder counts objects that it thinks are leaked, a hundred lines of them."""
    library("velodyne_decoder")
    path = pcap(tmp_path / "room.pcap", turns(150))
    command = [sys.executable, *shlex.split(f"-m lidarscene twin {path} --frames 0 --sensor vlp-16 -o twin")]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE_S)
    assert_ended(ran)
