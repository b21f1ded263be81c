"""What the tests of the view share: a scene file, a browser or a reason."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.chromium import Chromium, executable
from helpers.small_scene import SCENE


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wall that faces the sun, a pane and a ball, before the coarse raster; no test changes the file."""
    path = tmp_path_factory.mktemp("scene") / "view.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="session")
def _chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    """Started once for all tests, which takes longer than most of them."""
    if executable() is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    with Chromium(tmp_path_factory.mktemp("chromium")) as chromium:
        yield chromium


@pytest.fixture
def browser(_chromium: Chromium) -> Chromium:
    """A headless Chromium on an empty page; without one the test is skipped."""
    _chromium.leave()
    return _chromium
