"""The command `view`: what it takes, what it writes, and how it tells mistakes."""

import time
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import COARSE, Run

from lidarscene.cli import view
from lidarscene.cli.terminal import explained, quietly
from lidarscene.cli.view import COMPILING, list_clouds


@pytest.fixture
def cloud(mi: Any, run: Run, wall: str) -> str:
    assert run("render", wall, "-o", "a.ply", *COARSE).code == 0
    return "a.ply"


def test_save_says_where_and_how_large(run: Run, cloud: str, wall: str) -> None:
    for inputs in ((cloud,), (cloud, wall), (wall,), (wall, "--sensor", "table1-sipm")):
        printed = run.well("view", *inputs, *COARSE, "--save", "out/page.html")
        assert printed.startswith("wrote out/page.html (")
        assert Path("out/page.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_a_folder_hides_a_scene_of_its_name_only_with_clouds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "car").mkdir()
    assert view._is_scene(Path("car"))
    assert not view._is_scene(tmp_path / "car")
    (tmp_path / "car" / "a.ply").touch()
    assert not view._is_scene(Path("car"))


def test_frames_of_a_folder_come_by_their_numbers(tmp_path: Path) -> None:
    names = ["frame_0000.ply", "frame_2.ply", "frame_10.ply", "last.ply"]
    for name in [*reversed(names), ".frame_1.ply", "notes.txt"]:
        (tmp_path / name).touch()
    assert [path.name for path in list_clouds([tmp_path])] == names
    single_file = tmp_path / "b.ply"
    assert list_clouds([single_file, tmp_path])[0] == single_file
    for sensor in ("right", "left"):
        (tmp_path / "rig" / sensor).mkdir(parents=True)
        (tmp_path / "rig" / sensor / "frame_0000.ply").touch()
    rig = [path.parent.name for path in list_clouds([tmp_path / "rig"])]
    assert rig == ["left", "right"]


@pytest.mark.parametrize(("quiet", "wait_s", "lines"), [(False, 0.3, 1), (True, 0.3, 0), (False, 0.0, 0)])
def test_a_long_start_is_explained_once(
    capsys: pytest.CaptureFixture[str], quiet: bool, wait_s: float, lines: int
) -> None:
    """A start below ``after_s`` prints nothing: 0 s against an hour; the long one has 30 times as long as is asked."""
    with quietly(quiet), explained(COMPILING, after_s=0.01 if wait_s else 3600.0):
        time.sleep(wait_s)
    assert capsys.readouterr().err == f"lidarscene: {COMPILING}\n" * lines
