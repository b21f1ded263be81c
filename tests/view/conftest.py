"""What the tests of the view share: a coarse sensor, a scene, a browser or a reason."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from chromium import Chromium, executable

COARSE = (
    "scanner.azimuth_fov_deg=40", "scanner.azimuth_step_deg=2",
    "scanner.elevation_fov_deg=20", "scanner.elevation_step_deg=2",
)  # fmt: skip

SCENE = """
name = "view"
[sun]
azimuth_deg = 180.0
[picture]
eye_m = [-4, -3, 3]
target_m = [10, 0, 0]
fov_deg = 60
[[bodies]]
name = "wall"
class = "building"
primitive = "plane"
size_m = [4, 4]
material = "concrete"
position_m = [10, 0, 0]
pitch_deg = 90
[[bodies]]
name = "pane"
class = "window"
primitive = "plane"
size_m = [1, 1]
material = "clear_glass"
position_m = [9, 3, 0]
pitch_deg = 90
[[bodies]]
name = "ball"
class = "ball"
primitive = "sphere"
radius_m = 0.8
material = "target_80"
position_m = [7, -3, 0]
"""


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    """A wall that faces the sun, a pane and a ball, before the coarse raster."""
    path = tmp_path / "view.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Chromium]:
    """A headless Chromium; without one the test is skipped, or fails with LIDARSCENE_REQUIRE_CHROMIUM=1."""
    if executable() is None:
        if os.environ.get("LIDARSCENE_REQUIRE_CHROMIUM") == "1":
            pytest.fail("LIDARSCENE_REQUIRE_CHROMIUM=1, and there is no Chromium")
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    with Chromium(tmp_path / "profile") as chromium:
        yield chromium
