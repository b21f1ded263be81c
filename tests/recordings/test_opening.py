"""Which reader a recording gets, and what is said where its library is missing."""

import sys
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import Run
from helpers.mistakes import told
from helpers.recordings import OUSTER, copy_to_mcap, pcap, turns

from lidarscene.errors import LidarSceneError
from lidarscene.files import optional
from lidarscene.recordings.opening import is_recording, open_recording


def hide_packages(monkeypatch: pytest.MonkeyPatch, *packages: str) -> None:
    for name in [*sys.modules, *packages]:
        if name.partition(".")[0] in packages:
            monkeypatch.setitem(sys.modules, name, None)


def test_a_missing_library_is_told_with_what_to_type(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = copy_to_mcap(tmp_path / "a.mcap")
    hide_packages(monkeypatch, "ouster", "velodyne_decoder", "mcap", "mcap_ros2")
    for path, extra in ((OUSTER, "ouster"), (pcap(tmp_path / "v.pcap", turns(1)), "velodyne"), (bag, "ros")):
        packages = " ".join(optional.EXTRAS[extra].values())
        with told(f"pip install 'lidarscene[{extra}]' | pip install {packages}", LidarSceneError):
            open_recording(path)


def test_a_twin_names_all_that_is_missing_at_once(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    hide_packages(monkeypatch, "ouster", "open3d")
    ran = run("twin", "os0-32", "--frames", "0,1", "-o", "out")
    assert (ran.code, ran.err.count("\n")) == (1, 1)
    assert "error: ouster-sdk, open3d and libusb-package are needed and cannot be found" in ran.err
    assert "try: pip install 'lidarscene[ouster,open3d]', or pip install ouster-sdk open3d libusb-package" in ran.err


def test_a_twin_of_one_frame_needs_no_open3d(run: Run, library: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    library("ouster.sdk")
    hide_packages(monkeypatch, "open3d")
    assert run("twin", "os0-32", "--held-out", "columns", "-o", "out").code == 0


def test_a_folder_with_nothing_to_read_hides_no_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of a bag or of files of points is a recording, though."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "os0-32").mkdir()
    (tmp_path / "os0-32" / "notes.txt").touch()
    assert is_recording(Path("os0-32"))
    (tmp_path / "os0-32" / "000000.bin").touch()
    with open_recording("os0-32") as recording:
        assert recording.path == Path("os0-32")


def test_what_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("1")
    with told("notes.txt | .pcap | '.txt'"):
        open_recording(tmp_path / "notes.txt")
    with told(".pcd.bin | .bin | none"):
        open_recording(tmp_path)
    with told("metadata | notes.txt | packets"):
        open_recording(tmp_path, tmp_path / "notes.txt")
