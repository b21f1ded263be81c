"""`render` writes a cloud while it is made where it can: the same bytes, the same summary."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import BEAMS, COARSE, Run

from lidarscene import api
from lidarscene.simulate import Simulator

SENSOR = "table1-apd"
CHUNKS = "--chunk=50"  # five chunks of the coarse raster, some without a point


def whole(folder: Path, name: str, *, seed: int = 0, truth: bool = True, ascii: bool = False) -> bytes:
    """The file of the cloud that is put together first, in one chunk."""
    overrides = [one.removeprefix("--set=") for one in COARSE]
    scene = api.load_scene(folder / "wall.toml")
    cloud = Simulator(scene, api.load_sensor(SENSOR, overrides=overrides)).render(seed=seed)
    assert 0 < len(cloud) < BEAMS
    (cloud if truth else cloud.without_truth()).save(folder / f"whole_{name}", ascii=ascii)
    return (folder / f"whole_{name}").read_bytes()


@pytest.fixture
def streamed_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing may ask for a whole cloud."""

    def refused(*_: Any, **__: Any) -> None:
        raise AssertionError("the whole cloud was asked for")

    monkeypatch.setattr(Simulator, "render", refused)


@pytest.mark.parametrize("name", ["a.ply", "a.las", "a.parquet"])
def test_the_file_is_that_of_the_whole_cloud(
    run: Run, wall: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    expected = whole(tmp_path, name)
    monkeypatch.setattr(Simulator, "render", None)
    assert run("render", wall, "-o", name, "--sensor", SENSOR, *COARSE, CHUNKS).code == 0
    assert (tmp_path / name).read_bytes() == expected


def test_text_without_truth(run: Run, wall: str, tmp_path: Path) -> None:
    expected = whole(tmp_path, "a.ply", truth=False, ascii=True)
    asked = ("--ascii", "--no-truth", "--sensor", SENSOR)
    assert run("render", wall, "-o", "a.ply", *asked, *COARSE, CHUNKS).code == 0
    assert (tmp_path / "a.ply").read_bytes() == expected


@pytest.mark.usefixtures("streamed_only")
def test_a_frame_without_points(run: Run, tmp_path: Path) -> None:
    """A wall far behind the window, and a threshold that no noise reaches."""
    text = '[[bodies]]\nname = "w"\nprimitive = "plane"\nsize_m = [1, 1]\nmaterial = "concrete"\n'
    (tmp_path / "far.toml").write_text(text + "position_m = [0, 0, -900]\n")
    quiet = "--set=tdc.threshold_to_noise=30"
    assert run("render", "far.toml", "-o", "a.ply", "--sensor", SENSOR, *COARSE, quiet, CHUNKS).code == 0
    assert len(api.PointCloud.load(tmp_path / "a.ply")) == 0


def test_the_summary_counts_the_same(run: Run, wall: str) -> None:
    """With a picture the cloud is put together; its counts are those of the chunks."""
    asked = ("--sensor", SENSOR, *COARSE, CHUNKS, "--json", "--keep-missed", "m.npz")
    chunks = json.loads(run("render", wall, "-o", "a.ply", *asked).out)
    missed = np.load("m.npz")["pulse"]
    together = json.loads(run("render", wall, "-o", "b.ply", *asked, "--picture", "p.png").out)
    same = set(chunks) - {"seconds", "beams_per_second", "output"}
    assert {key: chunks[key] for key in same} == {key: together[key] for key in same}
    assert chunks["points"] == len(api.PointCloud.load("a.ply"))
    assert np.array_equal(missed, np.load("m.npz")["pulse"])
    assert {"write"} <= set(chunks["seconds"])
    assert "assemble" not in chunks["seconds"]


@pytest.mark.usefixtures("streamed_only")
def test_frames_are_streamed_too(run: Run, wall: str, tmp_path: Path) -> None:
    asked = ("--sensor", SENSOR, *COARSE, CHUNKS, "--frames", "2")
    assert run("render", wall, "-o", "many", *asked).code == 0
    starts = [
        api.PointCloud.load(one).metadata["frame_number"] for one in sorted((tmp_path / "many").iterdir())
    ]
    assert starts == ["0", "1"]
