"""The command line in this process, in an empty folder."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.command_line import WALL, Run
from lidarscene.figures import intervals, lines, maps, pictures
from lidarscene.figures.canvas import Canvas
from lidarscene.files.encodings.png import encode_png


@pytest.fixture(scope="session", autouse=True)
def _no_waiting_for_the_disk() -> Iterator[None]:
    """Files are left to the system to write: each would be waited for some milliseconds, and no test cuts the power."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command line in tmp_path."""
    monkeypatch.chdir(tmp_path)
    return Run(capsys)


@pytest.fixture
def wall(tmp_path: Path) -> str:
    """A scene of one wall of 4 m, 10 m off, in the middle of the coarse raster."""
    (tmp_path / "wall.toml").write_text(WALL)
    return "wall.toml"


@pytest.fixture
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw pictures of a sixteenth of the pixels, where pictures are compared with one another: whole ones take most of
    the time.
    """
    _draw_small(monkeypatch)


def _draw_small(monkeypatch: pytest.MonkeyPatch) -> None:
    for picture, size_px in ((pictures.frame_picture, (480, 400)), (pictures.perspective_picture, (480, 270))):
        assert picture.__kwdefaults__ is not None
        monkeypatch.setitem(picture.__kwdefaults__, "size_px", size_px)


def draw_roughly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Charts and maps of fewer pixels and with nothing moved to its place, which takes as long; pictures as above."""
    arrange_nothing(monkeypatch)
    monkeypatch.setattr(lines, "DPI", 60)
    _draw_small(monkeypatch)


def arrange_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (lines, maps):
        monkeypatch.setattr(module, "arrange", lambda figure: None)


def draw_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each chart, map and picture is one white pixel, not even put together. Other tests draw all of them."""
    from matplotlib.figure import Figure

    arrange_nothing(monkeypatch)
    whole, pixel = Figure.savefig, Figure(figsize=(0.01, 0.01))
    white = encode_png(np.full((1, 1, 3), 255, np.uint8))

    def saved(_: Figure, path: Any, **options: Any) -> None:
        file_options = {key: value for key, value in options.items() if key in ("format", "metadata")}
        whole(pixel, path, dpi=100, **file_options)

    monkeypatch.setattr(Figure, "savefig", saved)
    monkeypatch.setattr(lines, "_draw_chart", lambda chart: pixel)
    for module in (maps, intervals):
        monkeypatch.setattr(module, "save_figure", lambda path, *how: Path(path).write_bytes(white))
    monkeypatch.setattr(Canvas, "_png", lambda _, with_texts: white)


@pytest.fixture
def rough_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where something else than the drawing is tested, which takes most of the time."""
    draw_roughly(monkeypatch)


@pytest.fixture
def no_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no picture is looked at, and another test draws the same ones."""
    draw_nothing(monkeypatch)


@pytest.fixture
def failing_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing can be drawn: as with a fault of Matplotlib or Pillow, or for numbers that no one has tried."""

    def fail(*_: Any, **__: Any) -> None:
        raise ValueError("no chart")

    for module, name in (
        (lines, "_draw_chart"),
        (lines, "_tornado"),
        (maps, "save_figure"),
        (intervals, "save_figure"),
    ):
        monkeypatch.setattr(module, name, fail)
    monkeypatch.setattr(Canvas, "_png", fail)
