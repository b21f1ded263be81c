"""The command line in this process, in an empty folder."""

from pathlib import Path

import pytest

from helpers.command_line import WALL, Ran, Run
from lidarscene.cli import main
from lidarscene.figures import pictures


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command line in tmp_path."""
    monkeypatch.chdir(tmp_path)

    def command(*argv: str) -> Ran:
        capsys.readouterr()
        try:
            code = main.main(argv)
        except SystemExit as end:  # argparse after -h and --version
            code = int(end.code or 0)
        return Ran(code, *capsys.readouterr())

    return command


@pytest.fixture
def wall(tmp_path: Path) -> str:
    """A scene of one wall of 4 m, 10 m off, in the middle of the coarse raster."""
    (tmp_path / "wall.toml").write_text(WALL)
    return "wall.toml"


@pytest.fixture
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a sixteenth of the pixels, where pictures are compared with one another: whole ones take most of the time."""
    monkeypatch.setitem(pictures.frame_picture.__kwdefaults__, "size_px", (480, 400))
