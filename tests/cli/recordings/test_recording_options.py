"""Recordings on the command line: `view REC`, and what is a recording."""

from pathlib import Path

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.command_line import Run

from lidarscene.cli.recordings.recording_options import with_progress
from lidarscene.recordings.opening import is_recording, open_recording


def room(path: Path, radius_m: float) -> str:
    """A file of KITTI: a ring of 360 points."""
    angle = np.radians(np.arange(360.0))
    rows = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), 0.0 * angle - 1.0, 0.1 + 0.0 * angle], axis=-1)
    path.write_bytes(rows.astype("<f4").tobytes())
    return str(path)


def test_what_is_a_recording(tmp_path: Path) -> None:
    ours, foreign = tmp_path / "ours.ply", tmp_path / "other.ply"
    small_cloud().save(ours)
    foreign.write_text("ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nend_header\n")
    assert [is_recording(path) for path in (ours, foreign)] == [False, True]
    assert is_recording(tmp_path / "nothing.pcap")
    assert not is_recording(tmp_path / "scene.toml")
    room(tmp_path / "1.bin", 5.0)
    assert not is_recording(tmp_path)
    ours.unlink()
    foreign.unlink()
    assert is_recording(tmp_path)


def test_view_saves_all_frames_or_one(run: Run, tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    for number in range(3):
        room(tmp_path / "log" / f"{number}.bin", 5.0 + number)
    pages = []
    for more in ((), ("--frame", "1")):
        run.well("view", "log", *more, "--save", "page.html")
        pages.append(Path("page.html").read_text(encoding="utf-8"))
    assert ["frame-2" in page for page in pages] == [True, False]


def test_a_terminal_is_told_of_each_frame(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "log").mkdir()
    for number in range(2):
        room(tmp_path / "log" / f"{number}.bin", 5.0 + number)
    with open_recording(tmp_path / "log") as recording:
        assert with_progress(recording) is recording
        monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
        assert len(list(with_progress(recording))) == 2
    assert capsys.readouterr().err == "\rlog: frame 1 of 2\rlog: frame 2 of 2\n"
