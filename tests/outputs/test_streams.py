"""`render` writes its files while the frame is traced: the same bytes, the same summary, no chunk kept."""

import json
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BEAMS, COARSE, Run
from helpers.folders import file_contents
from helpers.formats import write_frame
from helpers.run_seed import chosen
from helpers.walls import write_moving_rig

from lidarscene import load_rig, load_scene, load_sensor
from lidarscene.cloud import thinning
from lidarscene.cloud.deskew import deskewed
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.cloud.rig_clouds import merge_clouds
from lidarscene.formats import parquet
from lidarscene.formats.registry import FORMATS
from lidarscene.labels.files import write_labels
from lidarscene.labels.point_rows import PointRows
from lidarscene.rendering.render_options import FrameOptions
from lidarscene.rendering.rig_simulators import simulators
from lidarscene.rendering.simulator import Simulator

pytestmark = pytest.mark.usefixtures("small_pictures")

SENSOR = "table1-apd"
CHUNKS = "--chunk=50"  # five chunks of the coarse raster, some without a point


def whole_file(folder: Path, name: str, *, seed: int = 0, truth: bool = True, ascii: bool = False) -> bytes:
    """The file of the cloud that is put together first, in one chunk."""
    overrides = [option.removeprefix("--set=") for option in COARSE]
    scene = load_scene(folder / "wall.toml")
    cloud = Simulator(scene, load_sensor(SENSOR, overrides=overrides)).render(seed=seed)
    assert 0 < len(cloud) < BEAMS
    (cloud if truth else cloud.without_truth()).save(folder / f"whole_{name}", ascii=ascii)
    return (folder / f"whole_{name}").read_bytes()


@pytest.fixture
def streamed_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing may ask for a whole cloud."""

    def refused(*_: Any, **__: Any) -> None:
        raise AssertionError("the whole cloud was asked for")

    monkeypatch.setattr(Simulator, "render", refused)


@pytest.mark.parametrize(
    "name", [f"a{format_of_file.suffix}" for format_of_file in FORMATS.values() if format_of_file.stream]
)
def test_the_file_is_that_of_the_whole_cloud(run, wall, tmp_path, monkeypatch, name):
    expected = whole_file(tmp_path, name)
    monkeypatch.setattr(Simulator, "render", None)
    ran = run("render", wall, "-o", name, "--sensor", SENSOR, *COARSE, CHUNKS)
    assert (ran.code, ran.err) == (0, "")
    assert (tmp_path / name).read_bytes() == expected


def test_text_without_truth(run: Run, wall: str, tmp_path: Path) -> None:
    expected = whole_file(tmp_path, "a.ply", truth=False, ascii=True)
    options = ("--ascii", "--no-truth", "--sensor", SENSOR)
    assert run("render", wall, "-o", "a.ply", *options, *COARSE, CHUNKS).code == 0
    assert (tmp_path / "a.ply").read_bytes() == expected


@pytest.mark.usefixtures("streamed_only")
def test_a_frame_without_points(run: Run, tmp_path: Path) -> None:
    """A wall far behind the window, and a threshold that no noise reaches."""
    text = '[[bodies]]\nname = "w"\nprimitive = "plane"\nsize_m = [1, 1]\nmaterial = "concrete"\n'
    (tmp_path / "far.toml").write_text(text + "position_m = [0, 0, -900]\n")
    quiet = "--set=tdc.threshold_to_noise=30"
    assert run("render", "far.toml", "-o", "a.ply", "--sensor", SENSOR, *COARSE, quiet, CHUNKS).code == 0
    assert len(PointCloud.load(tmp_path / "a.ply")) == 0


@pytest.fixture
def moving(tmp_path: Path) -> str:
    """A car and a sensor that move, in the frame's 4.6 ms by 5 and 9 cm; and two sensors."""
    return write_moving_rig(tmp_path)


def all_outputs(folder: str) -> dict[str, tuple[str, ...]]:
    """Options by what they ask for, with everything put into this folder."""
    beside = f"--keep-missed {folder}/m.npz --ambient {folder}/a.npz --range-image {folder}/r.npz"
    lines = {
        "single": f"-o {folder}/a.ply {beside} --picture {folder}/p.png --deskew --labels kitti",
        "semantickitti": f"-o {folder}/a.laz --labels semantickitti",
        "nuscenes": f"-o {folder}/a.pcd --labels nuscenes --no-truth",
        "osi": f"-o {folder}/a.parquet --labels osi",
        "merge": f"-o {folder}/a.ply --rig rig.toml --merge --deskew --labels nuscenes --picture {folder}/p.png",
        "data set": f"-o {folder} --dataset semantickitti --deskew",
        "whole": f"-o {folder}/a.npz",
    }
    return {name: tuple(line.split()) for name, line in lines.items()}


ASKED = tuple(all_outputs(""))


@pytest.mark.parametrize("output", chosen(3, ASKED))
def test_no_output_shows_how_the_frame_was_cut(run: Run, moving: str, tmp_path: Path, output: str) -> None:
    """Pieces of 50 pulses, and all pulses at once."""
    for folder, cut in (("pieces", (CHUNKS,)), ("whole", ())):
        ran = run("render", moving, *all_outputs(folder)[output], *COARSE, *cut)
        assert (ran.code, ran.err) == (0, "")
    assert file_contents(tmp_path / "pieces") == file_contents(tmp_path / "whole")


LABELLED = ("kitti", "semantickitti")


@pytest.mark.parametrize("output", chosen(3, [*ASKED, *LABELLED]))
def test_without_truth_only_the_clouds_have_less(run: Run, moving: str, tmp_path: Path, output: str) -> None:
    """Labels, pictures, missed pulses, waveforms and whole data sets have the same bytes: they need the truth of the
    frame, or none, and not that of the written cloud.
    """
    for folder, more in (("with", ()), ("without", ("--no-truth",))):
        if output in LABELLED:
            argv: tuple[str, ...] = ("-o", folder, "--dataset", output, "--frames", "2")
        else:
            argv = tuple(argument for argument in all_outputs(folder)[output] if argument != "--no-truth")
        if output == "single":
            argv += ("--waveforms", f"{folder}/w.npz")
        ran = run("render", moving, *argv, *more, *COARSE)
        assert (ran.code, ran.err) == (0, "")
    full, bare = file_contents(tmp_path / "with"), file_contents(tmp_path / "without")
    assert set(full) == set(bare)
    suffix = Path(all_outputs("")[output][1]).suffix if output in ASKED else ""
    clouds = {name for name in full if suffix and name in (f"a{suffix}", f"a.deskewed{suffix}")}
    assert len(full) > len(clouds) or output == "whole"
    assert {name for name in full if full[name] != bare[name]} == clouds
    for name in clouds:
        assert PointCloud.load(tmp_path / "with" / name).has_truth
        assert not PointCloud.load(tmp_path / "without" / name).has_truth
    if output in LABELLED:
        labels = [name for name in bare if "label" in Path(name).parent.name]
        assert len(labels) == 2
        assert all(bare[name] for name in labels)


def test_outputs_are_those_of_the_api(run: Run, moving: str, tmp_path: Path) -> None:
    """What Python writes of the clouds that `render` returns, put together before anything else."""
    overrides = [option.removeprefix("--set=") for option in COARSE]
    scene = load_scene(moving)
    simulators_by_name = dict(simulators(scene, load_rig("rig.toml", overrides=overrides).sensors))
    clouds = [simulator.render() for simulator in simulators_by_name.values()]
    deskewed_clouds = [
        deskewed(cloud, simulator.motion) for cloud, simulator in zip(clouds, simulators_by_name.values(), strict=True)
    ]
    for name, parts in (("a", clouds), ("a.deskewed", deskewed_clouds)):
        together = merge_clouds(parts, list(simulators_by_name))
        together.save(tmp_path / "api" / f"{name}.ply")
        write_labels(together, scene, tmp_path / "api" / f"{name}.ply", format="nuscenes")
    arguments = all_outputs("cli")["merge"]
    assert run("render", moving, *arguments[: arguments.index("--picture")], *COARSE, CHUNKS).code == 0
    assert file_contents(tmp_path / "cli") == file_contents(tmp_path / "api")


@pytest.mark.parametrize("option", [(), ("--no-deskew",)])
def test_a_data_set_is_that_of_the_api(run: Run, moving: str, tmp_path: Path, option: tuple[str, ...]) -> None:
    """The cloud is deskewed unless the sensor's motion is asked for."""
    overrides = [option.removeprefix("--set=") for option in COARSE]
    scene = load_scene(moving)
    sensor = load_sensor(scene.sensor_name, overrides=overrides)
    simulator = Simulator(scene, sensor)
    raw = simulator.render()
    cloud = raw if option else simulator.without_motion(raw, FrameOptions())
    write_frame("kitti", tmp_path / "api", 0, cloud, scene)
    assert run("render", moving, "-o", "cli", "--dataset", "kitti", *COARSE, CHUNKS, *option).code == 0
    assert file_contents(tmp_path / "cli") == file_contents(tmp_path / "api")


@pytest.fixture
def most_chunks_alive(monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    """How many chunks there were in memory at most, each when the next was handed out."""
    columns: list[weakref.ref[Any]] = []
    most_alive = [0]
    stream = Simulator.stream

    def stream_and_watch(self: Simulator, sink: Callable[[PointCloud], None], *options: Any, **keywords: Any) -> None:
        def watch_chunk(cloud: PointCloud | PointRows) -> None:
            most_alive[0] = max(most_alive[0], sum(column_ref() is not None for column_ref in columns))
            # Whoever keeps a slice of a column keeps the array that it is of.
            column = cloud.rows if isinstance(cloud, PointRows) else cloud.intensity
            columns.append(weakref.ref(column if column.base is None else column.base))
            sink(cloud)

        stream(self, watch_chunk, *options, **keywords)

    monkeypatch.setattr(Simulator, "stream", stream_and_watch)
    return lambda: most_alive[0] if len(columns) > 3 else 10**6


@pytest.mark.parametrize("output", chosen(3, [output for output in ASKED if output != "whole"]))
def test_no_chunk_is_kept(run, moving, monkeypatch, most_chunks_alive, output):
    """When a chunk comes no other is there, not even the one before.

    A picture keeps a few points of each, and a Parquet file waits for a row group: both are made small here. A range
    image keeps its columns of all points, and until there are two those of the first chunk itself: it is left out.
    """
    monkeypatch.setattr(thinning, "MOST_POINTS", 3)
    monkeypatch.setattr(parquet, "GROUP_POINTS", 20)
    argv = list(all_outputs("o")[output])
    if "--range-image" in argv:
        position = argv.index("--range-image")
        del argv[position : position + 2]
    assert run("render", moving, *argv, *COARSE, CHUNKS).code == 0
    assert most_chunks_alive() == 0


def test_a_format_that_needs_the_whole_keeps_copies(run, moving, most_chunks_alive):
    """The columns of all chunks are one array: chunks themselves are not kept there either, but the first's."""
    assert run("render", moving, *all_outputs("o")["whole"], *COARSE, CHUNKS).code == 0
    assert most_chunks_alive() <= 1


def test_the_summary_counts_the_same(run: Run, wall: str) -> None:
    """The cloud is put together for a picture; its counts are those of the chunks."""
    options = ("--sensor", SENSOR, *COARSE, CHUNKS, "--json", "--keep-missed", "m.npz")
    chunks = json.loads(run("render", wall, "-o", "a.ply", *options).out)
    missed = np.load("m.npz")["pulse"]
    together = json.loads(run("render", wall, "-o", "b.ply", *options, "--picture", "p.png").out)
    compared_keys = set(chunks) - {"seconds", "beams_per_second", "output"}
    assert {key: chunks[key] for key in compared_keys} == {key: together[key] for key in compared_keys}
    assert chunks["points"] == len(PointCloud.load("a.ply"))
    assert np.array_equal(missed, np.load("m.npz")["pulse"])
    assert {"write"} <= set(chunks["seconds"])
    assert "assemble" not in chunks["seconds"]


@pytest.mark.usefixtures("streamed_only")
def test_frames_are_streamed_too(run: Run, wall: str, tmp_path: Path) -> None:
    options = ("--sensor", SENSOR, *COARSE, CHUNKS, "--frames", "2")
    assert run("render", wall, "-o", "many", *options).code == 0
    starts = [PointCloud.load(path).metadata["frame_number"] for path in sorted((tmp_path / "many").iterdir())]
    assert starts == ["0", "1"]
