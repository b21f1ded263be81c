"""What the tests of the command line share: a small scene, a coarse raster, what a run leaves."""

from dataclasses import dataclass

import pytest

from helpers.walls import WALL as WALL
from lidarscene.cli import main

COARSE = (
    "--set=scanner.azimuth_fov_deg=40",
    "--set=scanner.azimuth_step_deg=2",
    "--set=scanner.elevation_fov_deg=20",
    "--set=scanner.elevation_step_deg=2",
)
BEAMS = 21 * 11


@dataclass(frozen=True)
class Ran:
    code: int
    out: str
    err: str


@dataclass(frozen=True)
class Run:
    """A command line in this process."""

    capsys: pytest.CaptureFixture[str]

    def __call__(self, *argv: str) -> Ran:
        self.capsys.readouterr()
        try:
            code = main.main(argv)
        except SystemExit as end:  # argparse after -h and --version
            code = int(end.code or 0)
        return Ran(code, *self.capsys.readouterr())

    def well(self, *argv: str) -> str:
        """What it prints; it must end well, without a note."""
        ran = self(*argv)
        assert (ran.code, ran.err) == (0, "")
        return ran.out
