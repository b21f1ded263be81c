"""`lidarscene.record` from Python: the files of the command `render`, byte for byte, and mistakes in Python's words."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BEAMS, COARSE, Run
from helpers.folders import file_contents
from helpers.mistakes import told
from helpers.run_seed import chosen
from helpers.walls import write_moving_rig

import lidarscene
from lidarscene import (
    FrameOptions,
    Outputs,
    TraceOptions,
    load_rig,
    load_scene,
    load_sensor,
    record,
    render,
    render_frames,
)
from lidarscene.errors import OptionWarning
from lidarscene.rendering.simulator import Simulator

pytestmark = pytest.mark.usefixtures("small_pictures")

SETS = tuple(option.removeprefix("--set=") for option in COARSE)


@pytest.fixture
def moving(run: Run, tmp_path: Path) -> str:
    """A car and a sensor that move, and a rig of two sensors, in the folder where the command runs."""
    return write_moving_rig(tmp_path)


EVERY = {"picture": "{}/p.png", "missed": "{}/m.npz", "ambient": "{}/a.png", "range_image": "{}/r.png"}
EVERY |= {"waveforms": "{}/w.npz", "deskew": True, "labels": "kitti", "pulses": (3, 100)}
EVERY_ASKED = (
    "--picture {}/p.png --keep-missed {}/m.npz --ambient {}/a.png --range-image {}/r.png --waveforms {}/w.npz --deskew "
    "--labels kitti --pulses 3,100"
)

CASES: dict[str, tuple[str, dict[str, Any], dict[str, Any], str]] = {
    "every file": ("{}/a.ply", EVERY, {"seed": 3, "begin_s": 0.1}, f"{EVERY_ASKED} --seed 3 --begin 0.1"),
    "frames of text": (
        "{}",
        {"ascii": True, "truth": False},
        {"frames": 2, "coordinates": "vehicle"},
        "--frames 2 --ascii --no-truth --coordinates vehicle",
    ),
    "laz": ("{}/a.laz", {"labels": "semantickitti"}, {"chunk": 50}, "--labels semantickitti --chunk 50"),
    "whole": (
        "{}/a.npz",
        {},
        {"coordinates": "sensor", "rays": 3, "background_rays": 2},
        "--frame sensor --rays 3 --background-rays 2 --set=laser.divergence_mrad=3",
    ),
    "data set": (
        "{}",
        {"dataset": "semantickitti", "deskew": True},
        {"frames": 2},
        "--dataset semantickitti --deskew --frames 2",
    ),
    "rig": (
        "{}",
        {"format": "pcd", "missed": "{}/m.npz"},
        {"frames": 2},
        "--rig rig.toml --format pcd --keep-missed {}/m.npz --frames 2",
    ),
    "merged": (
        "{}/a.ply",
        {"merge": True, "deskew": True, "labels": "nuscenes", "picture": "{}/p.png"},
        {"interactions": 0},
        "--rig rig.toml --merge --deskew --labels nuscenes --picture {}/p.png --interactions 0",
    ),
}


@pytest.mark.parametrize("case", chosen(4, [*CASES]))
def test_python_writes_the_files_of_the_command(mi, run: Run, moving: str, tmp_path: Path, case: str) -> None:
    path, files, options, typed = CASES[case]
    argv = typed.replace("{}", "cli").split()
    files = {key: value.format("api") if isinstance(value, str) else value for key, value in files.items()}
    sets = [*SETS, *(option.removeprefix("--set=") for option in argv if option.startswith("--set="))]
    subject: dict[str, Any] = {"overrides": sets}
    if "--rig" in argv:
        subject = {"sensor": load_rig("rig.toml", overrides=sets)}
    recorded = record(moving, **subject, outputs=Outputs(path.format("api"), **files), **options)
    ran = run("render", moving, "-o", path.format("cli"), *argv, *COARSE)
    assert (ran.code, ran.err) == (0, "")
    written = file_contents(tmp_path / "api")
    assert len(written) >= len(recorded.files) > 0
    assert set(recorded.files) <= {Path("api") / name for name in written}
    assert written == file_contents(tmp_path / "cli")
    assert recorded.summary.beams == len(recorded.clouds) * BEAMS * (2 if "--merge" in argv else 1)


def test_objects_do_as_well_as_files(mi, run: Run, moving: str, tmp_path: Path) -> None:
    scene = load_scene(moving, overrides=["sun.illuminance_klux=1"])
    sensor = load_sensor(scene.sensor_name, overrides=SETS)
    frame, trace = FrameOptions(seed=5, number=2), TraceOptions(interactions=1)
    record(scene, sensor, outputs=Outputs(tmp_path / "api" / "a.ply"), frame=frame, trace=trace)
    record(
        moving,
        outputs=Outputs(tmp_path / "loose" / "a.ply"),
        seed=5,
        number=2,
        interactions=1,
        overrides=SETS,
        scene_overrides=["sun.illuminance_klux=1"],
    )
    cloud = lidarscene.render(scene, sensor, frame=frame, trace=trace)
    (tmp_path / "whole").mkdir()
    cloud.save(tmp_path / "whole" / "a.ply")
    assert file_contents(tmp_path / "api") == file_contents(tmp_path / "loose") == file_contents(tmp_path / "whole")
    assert file_contents(tmp_path / "api") != {}


def test_frames_go_on_from_a_number(mi, moving: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frame 1 of two is frame 1 alone, where its name says so. No frame is traced that nobody asked for."""
    started, start = list[int](), Simulator._started

    def counted(sim: Simulator, frames: Sequence[Any], first: int) -> Any:
        started.append(len(frames))
        return start(sim, frames, first)

    monkeypatch.setattr(Simulator, "_started", counted)
    for folder, first, count in (("two", 0, 2), ("one", 1, 1)):
        record(moving, outputs=Outputs(folder), frames=count, number=first, overrides=SETS)
    two, single = file_contents(tmp_path / "two"), file_contents(tmp_path / "one")
    assert sum(started) == 2 + 1
    assert list(single) == ["frame_0001.ply"]
    assert single["frame_0001.ply"] == two["frame_0001.ply"] != two["frame_0000.ply"]


def test_progress_is_that_of_the_run(mi, moving: str) -> None:
    """The run is of two frames of two sensors, in chunks; what is done only grows, and ends with all."""
    reports: list[tuple[int, int]] = []
    record(
        moving,
        load_rig("rig.toml", overrides=SETS),
        outputs=Outputs("out"),
        frames=2,
        chunk=100,
        progress=lambda pulses_done, pulses: reports.append((pulses_done, pulses)),
    )
    pulses_done = [count_done for count_done, _ in reports]
    assert {pulses for _, pulses in reports} == {4 * BEAMS}
    assert pulses_done == sorted(set(pulses_done))
    assert (len(pulses_done), pulses_done[-1]) == (12, 4 * BEAMS)


@pytest.mark.parametrize(
    ("files", "options", "named"),
    [
        (("a.ply",), {"frames": 2}, "path a.ply | folder | frames"),
        (("out",), {}, "path out | .ply"),
        (("a.laz", {"ascii": True}), {}, "ascii | ply and pcd"),
        (("a.ply", {"merge": True}), {}, "merge | rig"),
        (("out",), {"frames": 0}, "frames | whole number | 1 | 10000 | 0"),
        (("a.ply",), {"seed": -1}, "seed | whole number | 0 | 4294967295 | -1"),
        (("a.ply",), {"sed": 1}, "option 'sed' | seed? | rays"),
        (("a.ply",), {"progress": 1}, "progress | function | 1"),
        (("moving.toml", {"format": "ply"}), {}, "path moving.toml | input"),
        (("a.ply", {"waveforms": "w.npz", "pulses": [BEAMS]}), {}, "pulses | 0 | 230"),
    ],
)
def test_mistakes_are_told_in_the_words_of_python(run, moving, tmp_path, files, options, named):
    before = file_contents(tmp_path)
    path, *more = files
    with told(named):
        record(moving, outputs=Outputs(path, **dict(*more)), overrides=SETS, **options)
    assert file_contents(tmp_path) == before


def test_a_rig_and_its_sensors_are_not_written_over(run: Run, moving: str, tmp_path: Path) -> None:
    rig = load_rig("rig.toml")
    (tmp_path / "way.ply").write_text("")
    with told("path way.ply | input"):
        record(moving, replace(rig, files=(*rig.files, Path("way.ply"))), outputs=Outputs("way.ply", merge=True))
    assert rig.files == (Path("rig.toml"),)


def test_overrides_are_for_files(run: Run, moving: str) -> None:
    """A rig that is loaded does not change; silence would hide it."""
    with told("overrides | sensor | a Rig"):
        record(moving, load_rig("rig.toml"), outputs=Outputs("out"), overrides=SETS)


def test_rays_without_a_width_are_warned_of(mi, run: Run, moving: str) -> None:
    sensor = load_sensor("table1-apd", overrides=SETS)
    message = (
        r"^rays 3 changes nothing: laser.divergence_mrad of 'table1-apd' is 0; a width is given by overrides laser"
    )
    calls = (partial(record, outputs=Outputs("a.ply")), render, partial(render_frames, frames=1))
    for call in calls:
        with pytest.warns(OptionWarning, match=message) as caught:
            call(moving, sensor, rays=3)
        assert caught[0].filename == __file__


def test_observers_are_told_of_what_is_streamed(mi, run: Run, moving: str) -> None:
    """The pulse of each point, as `render` tells it."""
    simulator = lidarscene.Simulator(load_scene(moving), load_sensor("table1-apd", overrides=SETS))
    clouds: list[lidarscene.PointCloud] = []
    streamed, rendered = list[np.ndarray](), list[np.ndarray]()
    simulator.stream(clouds.append, points=lambda pulse, _: streamed.append(pulse), chunk=100)
    simulator.render(points=lambda pulse, _: rendered.append(pulse))
    assert len(streamed) == 3
    np.testing.assert_array_equal(np.concatenate(streamed), np.concatenate(rendered))
    assert sum(map(len, clouds)) == len(rendered[0]) > 0


@pytest.mark.parametrize(
    ("place", "files"),
    [
        ("ambient a.npz", {"path": "o.ply", "missed": "a.npz", "ambient": "a.npz"}),
        ("missed b/../a.npz", {"path": "a.npz", "missed": "b/../a.npz"}),
        ("waveforms link.npz", {"path": "a.npz", "waveforms": "link.npz"}),
        ("range_image r.status.png", {"path": "o.ply", "range_image": "r.png", "picture": "r.status.png"}),
        ("ambient r.intensity.png", {"path": "o.ply", "ambient": "r.intensity.png", "range_image": "r.png"}),
    ],
)
def test_two_outputs_of_one_name(run: Run, wall: str, tmp_path: Path, place: str, files: dict[str, str]) -> None:
    """Rationale: the second would be written over the first, without a word."""
    (tmp_path / "link.npz").symlink_to("a.npz")
    before = file_contents(tmp_path)
    with told(f"{place} | two outputs"):
        record(wall, outputs=Outputs(**files))
    assert file_contents(tmp_path) == before


def test_the_first_frame_bears_what_comes_before_all(mi, moving: str) -> None:
    """Loading and building happen once: the seconds of all frames are those of the run."""
    recorded = record(moving, outputs=Outputs("out"), frames=3, overrides=SETS)
    first, *later_frames = [cloud.summary.seconds for cloud in recorded.clouds]
    assert {"load", "build"} <= set(first)
    for seconds in later_frames:
        assert not {"load", "build"} & set(seconds)


def test_a_shorter_run_into_a_data_set_is_refused(mi, moving: str, tmp_path: Path) -> None:
    """Its last frames would be of another run. The same number again, and the frames after them, are welcome."""
    outputs = Outputs("set", dataset="kitti")
    record(moving, outputs=outputs, frames=3, overrides=SETS)
    with told("000002.bin | 000001.bin"):
        record(moving, outputs=outputs, frames=2, overrides=SETS)
    record(moving, outputs=outputs, frames=1, number=2, overrides=SETS)
