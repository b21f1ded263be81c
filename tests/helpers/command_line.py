"""What the tests of the command line share: a small scene, a coarse raster, what a run leaves."""

from collections.abc import Callable
from dataclasses import dataclass

from helpers.walls import WALL as WALL

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


Run = Callable[..., Ran]
