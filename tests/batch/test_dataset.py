"""Data sets of jobs: parts, names, what is resumed, and tables that hold together."""

import itertools
import json
import math
from collections import Counter, defaultdict
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import mistakes, told
from helpers.run_seed import chosen
from helpers.small_job import use_no_worlds_of_others
from helpers.walls import APPROACHED, LEFT_AND_RIGHT, MOVING, rig_text
from scipy.spatial.transform import Rotation

from lidarscene.batch import dataset, dispatch, work
from lidarscene.batch.dataset import PARTS, share_out
from lidarscene.batch.dispatch import Connect, Progress, run_job
from lidarscene.batch.drives import DriveTask
from lidarscene.batch.store import Store
from lidarscene.batch.tasks import Job
from lidarscene.errors import LidarSceneError, OutputError
from lidarscene.labels import nuscenes_dataset
from lidarscene.maths.pose import Pose
from lidarscene.scene.meshes.primitives import plane_mesh
from lidarscene.scene.scene import Body, Part, Scene
from lidarscene.scene.scene_file import scene_model

ROAD = """
[[bodies]]
name = "road"
primitive = "plane"
class = "road"
size_m = [40, 6]
material = "asphalt"
"""
SMALL = """
[sweep.sensor]
"scanner.azimuth_fov_deg" = [40]
"scanner.elevation_fov_deg" = [20]
"scanner.azimuth_step_deg" = [2]
"scanner.elevation_step_deg" = [2]
"""
SHARES = "[splits]\ntrain = 0.5\nval = 0.25\ntest = 0.25\n"
SPLITS = SHARES + 'by = "drive"\n'


@pytest.fixture(autouse=True)
def _fresh(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    use_no_worlds_of_others(monkeypatch)


SENSOR = '[sensor]\nname = "table1-apd"\n'
APPROACHING = SENSOR + MOVING + ROAD


def read_job(folder: Path, text: str, *, scene: str = APPROACHING, rig: str = LEFT_AND_RIGHT) -> Job:
    """A job over a car that comes nearer on a road, seen by a vehicle that drives."""
    (folder / "street.toml").write_text(scene)
    (folder / "rig.toml").write_text(rig)
    path = folder / "job.toml"
    path.write_text(("" if "scenes = " in text else 'scenes = ["street.toml"]\n') + text + SMALL)
    return Job.read(path)


def run(job: Job, folder: Path, threads: Connect) -> Progress:
    progress = run_job(job, folder, connect=threads, threads=1)
    assert not progress.failed
    return progress


# --- parts ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "shares", "counts"),
    [
        (10, (0.8, 0.1, 0.1), (8, 1, 1)),
        (3, (0.8, 0.1, 0.1), (1, 1, 1)),
        (4, (0.8, 0.1, 0.1), (2, 1, 1)),
        (7, (0.5, 0.5, 0.0), (4, 3, 0)),  # of equal remainders the first
        (1, (1.0, 0.0, 0.0), (1, 0, 0)),
        (1000, (0.7, 0.15, 0.15), (700, 150, 150)),
        (11, (1 / 3, 1 / 3, 1 / 3), (4, 4, 3)),
    ],
)
def test_shares_by_hand(count: int, shares: tuple[float, ...], counts: tuple[int, ...]) -> None:
    assert share_out(count, dict(zip(PARTS, shares, strict=True)), "drives") == dict(zip(PARTS, counts, strict=True))


def test_shares_are_within_one_of_what_was_asked() -> None:
    """All are shared out; where each part has at least two, none is off by one or more."""
    rng = np.random.default_rng(17)
    for _ in range(200):
        shares, count = rng.dirichlet([2.0, 2.0, 2.0]), int(rng.integers(3, 500))
        counts = share_out(count, dict(zip(PARTS, shares, strict=True)), "drives")
        assert sum(counts.values()) == count
        assert min(counts.values()) >= 1
        if count * shares.min() >= 2:
            assert all(abs(counts[part] - count * share) < 1 for part, share in zip(PARTS, shares, strict=True))


@mistakes(
    r"""
    dataset = "kitti"\nseeds = [1, 2]\nBY_DRIVE | train, val, test | each | drives
    dataset = "kitti"\nseed_count = 9\nSHARES | streets | 1 | "street.seed"
    dataset = "kitti"\nframes = 2\nSHARES by = "frames" | frames of a drive | 2
    dataset = "kitti"\n[splits]\ntrain = 0.7\nval = 0.2 | splits | add up to 1 | 0.9
    [splits]\ntrain = 0.7\nval = 0.3 | splits | dataset
    dataset = "kitti"\nformat = "ply" | format | data set | dataset
    dataset = "waymo" | dataset | waymo
    [draws.scene]\n"sun.illuminance_klux" = { low = 100, high = 1 } | illuminance_klux | high | above low, 100 | 1
    [draws.scene]\n"sun.illuminance_klux" = { low = 0, high = 1, log = true } | illuminance_klux | low | > 0 with log
    [draws.scene]\n"sun.illuminance_klux" = { low = -1, high = 1 } | sun.illuminance_klux | >= 0 | got -1.0
    [draws.scene]\n"sun.illuminance_klux" = 7 | sun.illuminance_klux | a list | low and high | 7
    [draws.scene]\n"sun.illumination" = [1] | illumination
    [draws.scene]\n"ego" = [{ poses_file = "drive.csv" }] | draws.scene.ego | files
    RAIN[draws.scene]\n"weather.rain_mm_h" = [1] | draws.scene.weather.rain_mm_h | is in
    dataset = "nuscenes"\nframes = 3\nrigs = ["uneven.toml"] | 3 frames | together | 'quick' | 'slow'
    """,
    BY_DRIVE=SPLITS,
    SHARES=SHARES,
    RAIN='[sweep.scene]\n"weather.rain_mm_h" = [1]\n',
)
def test_mistakes(tmp_path: Path, given: str, named: str) -> None:
    (tmp_path / "drive.csv").write_text("0 0 0 0 0 0 0 1\n")
    slow = 'set = ["laser.repetition_rate_khz=10"]'
    (tmp_path / "uneven.toml").write_text(rig_text(("quick", "table1-apd"), ("slow", "table1-apd", slow)))
    with told(f"job.toml | {named}"):
        read_job(tmp_path, f"{given}\n")


def parts_of(job: Job) -> list[tuple[str, int, int, int]]:
    places = [task.place for task in job.tasks()]
    return [(place.split, place.sequence, place.step, place.number) for place in places if place is not None]


def test_a_drive_is_in_one_part(tmp_path: Path) -> None:
    """Two of four drives train; KITTI counts the frames of tests by themselves."""
    parts = parts_of(read_job(tmp_path, 'dataset = "kitti"\nframes = 3\nseed_count = 4\n' + SPLITS))
    assert Counter(part for part, *_ in parts) == {"train": 6, "val": 3, "test": 3}
    assert len({(part, sequence) for part, sequence, *_ in parts}) == 4
    for numbers in (
        [number for part, *_, number in parts if part != "test"],
        [number for part, *_, number in parts if part == "test"],
    ):
        assert numbers == list(range(len(numbers)))


def test_frames_of_a_drive_are_cut_in_order(tmp_path: Path) -> None:
    """Each part of a drive is a sequence of its own: poses and times have no holes."""
    text = 'dataset = "semantickitti"\nframes = 4\nseed_count = 2\n' + SHARES + 'by = "frames"\n'
    drive = [("train", 0, 0), ("train", 0, 1), ("val", 1, 0), ("test", 2, 0)]
    expected = [(part, sequence + 3 * seed, step, step) for seed in range(2) for part, sequence, step in drive]
    assert parts_of(read_job(tmp_path, text)) == expected


TAXI = """
[[bodies]]
name = "taxi"
class = "car"
material = "asphalt"
primitive = "box"
size_m = [4, 2, 1]
motion = { speed_m_s = 5 }
"""


def test_a_street_is_in_one_part(tmp_path: Path) -> None:
    """What differs in light, paint, traffic, the vehicle's way or the file's name is one street, unless `by` says
    otherwise; another place of the car is another. So no pose of what is tested was learned.
    """
    text = 'dataset = "kitti"\n[splits]\ntrain = 0.5\nval = 0.5\n[sweep.scene]\n'
    text += '"sun.illuminance_klux" = [1, 100]\n"bodies.wall.position_m" = [[10, 0, 1.8], [12, 0, 1.8]]\n'
    text += '"ego.speed_m_s" = [5, 9]\n"bodies.wall.material" = ["concrete", "asphalt"]\n'
    text = text.replace("dataset", 'scenes = ["street.toml", "wet.toml"]\ndataset', 1)
    (tmp_path / "wet.toml").write_text('extends = "street.toml"\n[weather]\nrain_mm_h = 5\n' + TAXI)
    parts, streets = defaultdict(set), defaultdict(set)
    for task in read_job(tmp_path, text).tasks():
        assert task.place is not None
        place = str(task.parameters["scene.bodies.wall.position_m"])
        parts[place].add(task.place.split)
        streets[place].add(task.scene.street)
    assert sorted(map(sorted, parts.values())) == [["train"], ["val"]]
    assert [len(hashes) for hashes in streets.values()] == [1, 1]


def test_traffic_makes_no_other_street(tmp_path: Path) -> None:
    """Drives through one street with other traffic, after rain, or in another car are in one part: houses, walls and
    posts are where they were.
    """
    keys = '"street.speed_m_s" = [[5, 6], [9, 13]]\n"street.wet" = [true, false]\n"bodies.own_car.scale" = [1, 1.1]\n'
    (tmp_path / "made.toml").write_text("[street]\nlength_m = 50\nshown_m = 50\n" + SENSOR)
    text = 'scenes = ["made.toml"]\ndataset = "kitti"\n[splits]\ntrain = 0.5\ntest = 0.5\n'
    text += '[sweep.scene]\n"street.seed" = [1, 2]\n'
    parts, houses = defaultdict(set), defaultdict(set)
    for task in read_job(tmp_path, text + keys).tasks():
        assert task.place is not None
        seed = task.parameters["scene.street.seed"]
        parts[seed].add(task.place.split)
        if task.parameters["scene.bodies.own_car.scale"] == 1 and seed == 1:
            bodies = scene_model(Path(task.scene.path), overrides=task.scene.overrides).bodies
            fixed = [body for body in bodies if body.name.startswith(("houses", "trees", "hedges", "lamp", "sign"))]
            houses[seed].add(str(fixed))
    assert sorted(map(sorted, parts.values())) == [["test"], ["train"]]
    assert [len(places) for places in houses.values()] == [1]


# --- draws ------------------------------------------------------------------------------------------

DRAWS = """
[draws.scene]
"sun.illuminance_klux" = { low = 1, high = 100, log = true }
"weather.rain_mm_h" = { low = 0, high = 20 }
"bodies.wall.material" = ["concrete", "asphalt", "car_paint_black"]
[draws.sensor]
"wear.film_transmittance" = { low = 0.5, high = 1.0 }
"""


def test_each_drive_draws_anew(tmp_path: Path) -> None:
    """All frames of a drive and all sensors of a rig have one draw, which no other key and seed changes; light,
    wear and paint make no other street. Limits: of 200 uniform draws the mean scatters by 0.02 of the range, and the
    chance that one of three materials is never drawn is 1e-35.
    """
    text = 'dataset = "kitti"\nframes = 2\nseed_count = 200\nrigs = ["rig.toml"]\n'
    drives = defaultdict(set)
    streets = set()
    for task in read_job(tmp_path, text + DRAWS).tasks():
        names = ("scene.sun.illuminance_klux", "scene.weather.rain_mm_h", "scene.bodies.wall.material")
        values = tuple(task.parameters[name] for name in (*names, "sensor.wear.film_transmittance"))
        drives[task.frame.seed].add(values)
        streets.add(task.scene.street)
        assert f"weather.rain_mm_h={values[1]}" in task.scene.overrides
        assert f"wear.film_transmittance={values[3]}" in task.sensor.overrides
    assert ({len(draws) for draws in drives.values()}, len(streets), len(drives)) == ({1}, 1, 200)
    klux, rain, paint, film = zip(*(draw for draws in drives.values() for draw in draws), strict=True)
    assert set(paint) == {"concrete", "asphalt", "car_paint_black"}
    for values, low, high in ((np.log10(klux), 0.0, 2.0), (rain, 0.0, 20.0), (film, 0.5, 1.0)):
        assert low <= min(values) < low + 0.1 * (high - low) < high - 0.1 * (high - low) < max(values) <= high
        assert np.mean(values) == pytest.approx(0.5 * (low + high), abs=0.12 * (high - low))
    fewer = text.replace("200", "3") + DRAWS.replace('"weather.rain_mm_h" = { low = 0, high = 20 }\n', "")
    for task in read_job(tmp_path, fewer).tasks():
        assert task.parameters["scene.sun.illuminance_klux"] == klux[task.frame.seed]


def test_a_drawn_drive_is_rendered_with_its_draw(threads: Connect, tmp_path: Path) -> None:
    """Reference: `record` with the values that the manifest names."""
    from lidarscene.outputs.output_options import Outputs
    from lidarscene.outputs.record import record

    parquet = pytest.importorskip("pyarrow.parquet")
    job = read_job(tmp_path, "seed_count = 2\n" + DRAWS)
    run(job, tmp_path / "out", threads)
    rows = parquet.read_table(Store(tmp_path / "out").manifest).to_pylist()
    assert len({row["scene.weather.rain_mm_h"] for row in rows}) == 2
    for row in rows:
        changes = {
            kind: [f"{key.partition('.')[2]}={value}" for key, value in row.items() if key.startswith(f"{kind}.")]
            for kind in ("scene", "sensor")
        }
        path = tmp_path / "single.ply"
        record(
            tmp_path / "street.toml",
            outputs=Outputs(path),
            seed=row["seed"],
            overrides=changes["sensor"],
            scene_overrides=changes["scene"],
        )
        assert (tmp_path / "out" / row["file"]).read_bytes() == path.read_bytes()


# --- files ------------------------------------------------------------------------------------------


FORMATS = ("kitti", "semantickitti", "nuscenes")
JOBS = ("", "truth = false\n", 'rigs = ["rig.toml"]\n', 'coordinates = "sensor"\n')


@pytest.mark.parametrize(("name", "options"), chosen(4, list(itertools.product(FORMATS, JOBS))))
def test_as_many_labels_as_clouds(threads: Connect, tmp_path: Path, name: str, options: str) -> None:
    job = read_job(tmp_path, f'dataset = "{name}"\nframes = 2\nseed_count = 3\n{options}{SPLITS}')
    assert run(job, tmp_path / "out", threads).rendered == len(job) == (12 if "rig" in options else 6)
    places = [task.place for task in job.tasks()]
    clouds = sorted(path for pattern in dataset.CLOUD_FOLDERS[name] for path in (tmp_path / "out").glob(pattern))
    assert clouds == sorted(tmp_path / "out" / place.files[0] for place in places if place is not None)
    for place in places:
        assert place is not None
        cloud, labels = (tmp_path / "out" / file for file in place.files[:2])
        if name == "semantickitti":
            assert labels.stat().st_size // 4 == cloud.stat().st_size // 16 > 0
        elif name == "nuscenes":
            assert labels.stat().st_size == cloud.stat().st_size // 20 > 0
        else:
            assert labels.read_text().startswith("Car ")


def test_lists_of_kitti_name_every_frame(threads: Connect, tmp_path: Path) -> None:
    job = read_job(tmp_path, 'dataset = "kitti"\nframes = 2\nseed_count = 4\n' + SPLITS)
    run(job, tmp_path / "out", threads)
    lists = {part: (tmp_path / f"out/ImageSets/{part}.txt").read_text().split() for part in (*PARTS, "trainval")}
    assert sorted(lists["train"] + lists["val"]) == lists["trainval"] == [f"{n:06d}" for n in range(6)]
    assert lists["test"] == ["000000", "000001"]
    for part, numbers in lists.items():
        folder = tmp_path / "out" / ("testing" if part == "test" else "training")
        for number in numbers:
            for kind, suffix in (("velodyne", "bin"), ("label_2", "txt"), ("calib", "txt"), ("image_2", "png")):
                assert (folder / kind / f"{number}.{suffix}").stat().st_size > 0


def test_a_sequence_is_that_of_render(threads: Connect, tmp_path: Path) -> None:
    """Reference: the same frames by `record`, whose files other loaders open in its own tests."""
    from lidarscene.outputs.output_options import Outputs
    from lidarscene.outputs.record import record

    job = read_job(tmp_path, 'dataset = "semantickitti"\nframes = 3\n')
    run(job, tmp_path / "out", threads)
    sets = ["scanner.azimuth_fov_deg=40", "scanner.elevation_fov_deg=20"]
    sets += ["scanner.azimuth_step_deg=2", "scanner.elevation_step_deg=2"]
    outputs = Outputs(tmp_path / "single", dataset="semantickitti")
    record(tmp_path / "street.toml", outputs=outputs, frames=3, overrides=sets)
    files = {path.relative_to(tmp_path / "single") for path in (tmp_path / "single").rglob("*") if path.is_file()}
    assert len(files) == 3 + 3 + 3 + 1
    for file in files:
        assert (tmp_path / "out" / file).read_bytes() == (tmp_path / "single" / file).read_bytes(), file
    assert (tmp_path / "out/dataset/splits.yaml").read_text() == "split:\n  train: [0]\n  valid: []\n  test: []\n"


# --- resumed ----------------------------------------------------------------------------------------


def test_what_is_missing_is_rendered_again_and_no_more(threads: Connect, tmp_path: Path) -> None:
    """A label that was changed by hand is as missing as a cloud that is gone."""
    job = read_job(tmp_path, 'dataset = "kitti"\nframes = 2\nseed_count = 2\n')
    run(job, tmp_path / "out", threads)
    label = tmp_path / "out/training/label_2/000001.txt"
    content = label.read_bytes()
    label.write_bytes(content.replace(b"Car", b"Van"))
    (tmp_path / "out/training/velodyne/000003.bin").unlink()
    progress = run(job, tmp_path / "out", threads)
    assert (progress.rendered, progress.reused) == (2, 2)
    assert label.read_bytes() == content


def test_frames_of_another_job_are_refused(threads: Connect, tmp_path: Path) -> None:
    """Rationale: a loader takes every file of the folder for a frame of the data set."""
    run(read_job(tmp_path, 'dataset = "kitti"\nframes = 3\n'), tmp_path / "out", threads)
    with told("000002.bin | earlier job"):
        run(read_job(tmp_path, 'dataset = "kitti"\nframes = 2\n'), tmp_path / "out", threads)
    with told("earlier job"):
        run(read_job(tmp_path, 'dataset = "semantickitti"\nframes = 3\n'), tmp_path / "out", threads)
    assert run(read_job(tmp_path, 'dataset = "kitti"\nframes = 4\n'), tmp_path / "out", threads).finished == 4


def test_a_data_set_with_holes_has_no_tables(threads: Connect, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same command again, without the failure, fills the hole and writes them."""
    job, render = read_job(tmp_path, 'dataset = "semantickitti"\nframes = 2\n'), work._rendered
    monkeypatch.setattr(
        work, "_rendered", lambda task, *more: nullcontext("no room") if task.frame.number else render(task, *more)
    )
    assert len(run_job(job, tmp_path / "out", connect=threads, threads=1).failed) == 1
    assert not (tmp_path / "out/dataset/poses").exists()
    monkeypatch.setattr(work, "_rendered", render)
    assert run(job, tmp_path / "out", threads).rendered == 1
    assert len((tmp_path / "out/dataset/poses/00.txt").read_text().splitlines()) == 2


def test_the_manifest_names_parts_and_files(threads: Connect, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    job = read_job(tmp_path, 'dataset = "nuscenes"\nframes = 2\nseed_count = 3\n' + SPLITS)
    run(job, tmp_path / "out", threads)
    rows = parquet.read_table(Store(tmp_path / "out").manifest).to_pylist()
    assert Counter(row["split"] for row in rows) == {"train": 2, "val": 2, "test": 2}
    assert [row["file"] for row in rows] == [f"samples/LIDAR_TOP/{n:06d}.pcd.bin" for n in range(6)]
    assert {row["sequence"] for row in rows} == {"scene-0001", "scene-0002", "scene-0003"}
    assert {row["split_by"] for row in rows} == {"drive"}
    assert len({row["street"] for row in rows}) == 1
    assert {(row["format"], row["stray"], row["revived"], row["error"]) for row in rows} == {("nuscenes", 0, 0, None)}


# --- whole drives -----------------------------------------------------------------------------------


COARSE = [
    f"scanner.{axis}_{key}_deg={value}"
    for axis, fov in (("azimuth", 40), ("elevation", 20))
    for key, value in (("fov", fov), ("step", 2.0))
]


def log_of(path: Path) -> dict[str, list[str]]:
    """Entity of a log of Rerun -> its rows but for the time of writing, as text."""
    from rerun import chunk

    rows = defaultdict(list)
    for part in chunk.RrdReader(path).stream():
        batch = part.to_record_batch()
        # How many rows are together depends on the time that passed while they were written.
        names = sorted({*batch.schema.names} - {"log_time", "log_tick"})
        names = [name for name in names if "row_id" not in name.lower() and "RowId" not in name]
        for row in range(batch.num_rows):
            values = {name: batch[name][row].as_py() for name in names}
            rows[str(part.entity_path)].append(repr({name: v for name, v in values.items() if v is not None}))
    return {entity: sorted(texts) for entity, texts in rows.items() if not entity.startswith("/__")}


@pytest.mark.parametrize(
    ("name", "package", "rig", "truth"),
    [
        ("mcap", "rosbags", "", True),
        ("mcap-ouster", "rosbags", 'rigs = ["rig.toml"]\n', False),
        ("rrd", "rerun", "", False),
        ("rrd", "rerun", 'rigs = ["rig.toml"]\n', True),
    ],
)
def test_a_whole_drive_is_that_of_render(
    threads: Connect, library: Any, tmp_path: Path, name: str, package: str, rig: str, truth: bool
) -> None:
    """Reference: the same frames by `record`, whose bags and logs other readers open in its own tests."""
    from lidarscene.outputs.output_options import Outputs
    from lidarscene.outputs.record import record
    from lidarscene.sensor.rig_file import load_rig

    library(package)
    text = f'dataset = "{name}"\nframes = 3\nseed_count = 2\n{rig}truth = {str(truth).lower()}\n'
    job = read_job(tmp_path, text + '[splits]\ntrain = 0.5\nval = 0.5\nby = "drive"\n')
    assert run(job, tmp_path / "out", threads).rendered == len(job)
    suffix = f".{name[:4].rstrip('-')}"
    files = {
        path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*") if path.suffix == suffix
    }
    assert {file[-len(f"drive_0000{suffix}") :] for file in files} == {f"drive_000{n}{suffix}" for n in range(2)}
    assert len({file.split("/")[0] for file in files} & {"train", "val"}) == len(files) == 2
    for file in files:
        seed = int(file.split("_")[-1].split(".")[0])
        path = tmp_path / f"drive_{seed:04d}{suffix}"
        outputs = Outputs(path, format=name, truth=truth)
        sensor = load_rig(tmp_path / "rig.toml", overrides=COARSE) if rig else "table1-apd"
        changes = () if rig else COARSE
        record(tmp_path / "street.toml", sensor, outputs=outputs, frames=3, seed=seed, overrides=changes)
        if suffix == ".mcap":
            assert (tmp_path / "out" / file).read_bytes() == path.read_bytes()
        else:
            expected = log_of(path)
            assert log_of(tmp_path / "out" / file) == expected
            assert len(expected["/world/boxes"]) == len(job) // 2


def test_a_drive_that_was_broken_off_goes_on(
    threads: Connect, library: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drive with a hole has no file and keeps its frames; once it is written they are gone. A file that was lost
    is made anew, and one that is there is not touched.
    """
    library("rosbags")
    parquet = pytest.importorskip("pyarrow.parquet")
    job, folder = read_job(tmp_path, 'dataset = "mcap"\nframes = 3\nseed_count = 2\n'), tmp_path / "out"
    frames_there = lambda: len(list(folder.glob("frames/*/*.ply")))  # noqa: E731
    render = work._rendered

    def fail_once(task: Any, *more: Any) -> Any:
        hole = isinstance(task, work.FrameTask) and (task.frame.seed, task.frame.number) == (1, 1)
        return nullcontext("no room") if hole else render(task, *more)

    monkeypatch.setattr(work, "_rendered", fail_once)
    assert len(run_job(job, folder, connect=threads, threads=1).failed) == 1
    first, second = folder / "train/drive_0000.mcap", folder / "train/drive_0001.mcap"
    assert (first.is_file(), second.exists(), frames_there()) == (True, False, 2)
    written = first.stat()
    monkeypatch.setattr(work, "_rendered", render)
    progress = run(job, folder, threads)
    assert (progress.rendered, progress.reused, frames_there()) == (1, 5, 0)
    assert (first.stat().st_mtime_ns, second.is_file()) == (written.st_mtime_ns, True)
    rows = parquet.read_table(Store(folder).manifest).to_pylist()
    assert [row["file"] for row in rows] == [f"train/drive_000{drive}.mcap" for drive in (0, 0, 0, 1, 1, 1)]
    assert {(row["error"], row["sequence"][:6], row["points"] > 0) for row in rows} == {(None, "drive_", True)}
    content = second.read_bytes()
    second.unlink()
    assert run(job, folder, threads).rendered == 3
    assert second.read_bytes() == content
    with told("drive_0001.mcap | earlier job"):
        run(read_job(tmp_path, 'dataset = "mcap"\nframes = 3\n'), folder, threads)


def test_a_drive_that_cannot_be_written_says_why(
    threads: Connect, library: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its frames are kept, and the same command writes it."""
    library("rosbags")
    job, folder = read_job(tmp_path, 'dataset = "mcap"\nframes = 2\n'), tmp_path / "out"
    write = DriveTask.write
    monkeypatch.setattr(DriveTask, "write", lambda *_: (_ for _ in ()).throw(OutputError("no room")))
    with told("drive_0000.mcap | no room", LidarSceneError):
        run_job(job, folder, connect=threads, threads=1)
    monkeypatch.setattr(DriveTask, "write", write)
    assert run(job, folder, threads).reused == 2
    assert (folder / "train/drive_0000.mcap").is_file()


# --- tables of nuScenes -----------------------------------------------------------------------------


def tables_of(folder: Path) -> dict[str, dict[str, dict[str, Any]]]:
    """Table -> token -> row."""
    files = [path for path in (folder / nuscenes_dataset.VERSION).glob("*.json") if path.stem != "splits"]
    return {path.stem: {row["token"]: row for row in json.loads(path.read_text())} for path in files}


@pytest.mark.parametrize("rig", ["", 'rigs = ["rig.toml"]\n'])
def test_tables_refer_to_each_other(threads: Connect, tmp_path: Path, rig: str) -> None:
    """Each token of a row is one of the table it names, chains run in order of time, and every file is there. The
    scheme is that of nuscenes-devkit, docs/schema_nuscenes.md.
    """
    job = read_job(tmp_path, f'dataset = "nuscenes"\nframes = 3\nseed_count = 3\n{rig}{SPLITS}')
    run(job, tmp_path / "out", threads)
    tables = tables_of(tmp_path / "out")
    sensors = 2 if rig else 1
    counts = {"scene": 3, "sample": 9, "sample_data": 9 * sensors, "ego_pose": 9 * sensors, "map": 3, "sensor": sensors}
    counts |= {"lidarseg": 9 * sensors, "calibrated_sensor": 3 * sensors, "instance": 3, "sample_annotation": 9}
    assert {name: len(tables[name]) for name in counts} == counts
    for name, rows in tables.items():
        for row in rows.values():
            for key, value in row.items():
                table = {"first_annotation": "sample_annotation", "last_annotation": "sample_annotation"}.get(
                    key.removesuffix("_token"), key.removesuffix("_token").removeprefix("first_").removeprefix("last_")
                )
                if key.endswith("_token"):
                    assert value in tables[table], (name, key)
                elif key.endswith("_tokens"):
                    assert all(token in tables[key.removesuffix("_tokens")] for token in value)
                elif key in ("next", "prev") and value:
                    other = {"next": "prev", "prev": "next"}[key]
                    assert rows[value][other] == row["token"]
                elif key == "filename":
                    assert (tmp_path / "out" / value).is_file()
    for scene in tables["scene"].values():
        token, times = scene["first_sample_token"], []
        while token:
            times.append(tables["sample"][token]["timestamp"])
            last, token = token, tables["sample"][token]["next"]
        assert (last, len(times)) == (scene["last_sample_token"], scene["nbr_samples"])
        assert times == sorted(set(times))
    assert len({scene["first_sample_token"] for scene in tables["scene"].values()}) == 3
    splits = json.loads((tmp_path / "out" / nuscenes_dataset.VERSION / "splits.json").read_text())
    assert sorted(name for names in splits.values() for name in names) == ["scene-0001", "scene-0002", "scene-0003"]


def test_a_cloud_lies_where_its_tables_say(threads: Connect, tmp_path: Path) -> None:
    """Reference: the car's place in the scene file. Its points, taken into the world by the tables as the devkit does
    (calibration, then vehicle's pose), lie in its box; nuScenes' x is to the right. Tolerances:
    car and sensor go 0.1 m towards each other within a frame, and beams are 0.35 m apart on the car.
    """
    job = read_job(tmp_path, 'dataset = "nuscenes"\nframes = 3\n')
    run(job, tmp_path / "out", threads)
    tables = tables_of(tmp_path / "out")
    truths = [json.loads(path.read_text())["truth"] for path in (tmp_path / "out/rows").rglob("*.json")]
    (corner_m,) = (truth["map_corner_m"] for truth in truths if "map_corner_m" in truth)
    first_us = min(data["timestamp"] for data in tables["sample_data"].values())
    for step, data in enumerate(tables["sample_data"].values()):
        points = np.fromfile(tmp_path / "out" / data["filename"], np.float32).reshape(-1, 5)[:, :3].astype(float)
        assert np.median(points[:, 1]) > 5.0 > abs(np.median(points[:, 0]))
        for table, key in (("calibrated_sensor", "calibrated_sensor_token"), ("ego_pose", "ego_pose_token")):
            row = tables[table][data[key]]
            rotation = nuscenes_dataset._rotation(row["rotation"])
            points = points @ rotation.T + row["translation"]
        annotation = next(a for a in tables["sample_annotation"].values() if a["sample_token"] == data["sample_token"])
        classes = np.fromfile(
            tmp_path / f"out/lidarseg/{nuscenes_dataset.VERSION}/{data['token']}_lidarseg.bin", np.uint8
        )
        names = {nuscenes_dataset.CATEGORIES[number] for number in set(classes.tolist())}
        assert names - {"noise"} == {"vehicle.car", "flat.driveable_surface"}  # a false alarm now and then
        on_car = points[classes == nuscenes_dataset.CATEGORIES.index("vehicle.car")]
        width, length, height = annotation["size"]
        assert (length, width, height) == (1.0, 4.0, 4.0)
        reach_m = np.abs(on_car - annotation["translation"]).max(axis=0)
        assert reach_m == pytest.approx([0.5, 2.0, 2.0], abs=0.45)
        assert np.median(np.abs(on_car[:, 0] - annotation["translation"][0])) == pytest.approx(0.5, abs=0.1)
        world_m = np.array(annotation["translation"][:2]) + corner_m
        start_s = 1e-6 * (data["timestamp"] - first_us)
        assert start_s >= 0.004 * step
        assert world_m == pytest.approx([10 - 10 * start_s, 2 * start_s], abs=0.1)
        assert math.hypot(*annotation["rotation"]) == pytest.approx(1.0)


PARKED = SENSOR + APPROACHED.replace("[10, 0, 1.8]", "[14.3, 0, 1.8]")
"""A car that stands, and a sensor that drives towards it, by 9 cm in a frame."""

ONE_BEHIND_THE_OTHER = rig_text(
    ("roof", "table1-apd", "position_m = [0, 0, 1.8]"),
    ("front", "table1-sipm", "position_m = [2.3, -0.6, 0.8]", "yaw_deg = 15"),
)


def parked_job(folder: Path, text: str) -> Job:
    """A job over a car that stands on no road."""
    return read_job(folder, text, scene=PARKED, rig=ONE_BEHIND_THE_OTHER)


def in_the_world(folder: Path, tables: dict[str, dict[str, dict[str, Any]]], data: dict[str, Any]) -> Any:
    """(n, 3) points of a cloud, by the chain that nuscenes-devkit documents: calibration, then pose of the vehicle."""
    points = np.fromfile(folder / data["filename"], np.float32).reshape(-1, 5)[:, :3].astype(float)
    for table in ("calibrated_sensor", "ego_pose"):
        row = tables[table][data[f"{table}_token"]]
        points = Rotation.from_quat(row["rotation"], scalar_first=True).apply(points) + row["translation"]
    return points


@pytest.mark.parametrize(("deskew", "drift_m"), [("", (0.0, 1e-5)), ("deskew = false\n", (0.02, 0.15))])
def test_two_lidars_of_a_rig_meet_on_one_surface(
    threads: Connect, tmp_path: Path, deskew: str, drift_m: tuple[float, float]
) -> None:
    """Both see the front of a car; the sensors stand in different cells of a grid of 1 m, from which maps begin.

    Tolerance: 5 cm, six sigma of the mean of three frames. The box of a car that stands does so, unless the points hold
    the way of 9 cm within a frame.
    """
    job = parked_job(tmp_path, f'dataset = "nuscenes"\nframes = 3\nrigs = ["rig.toml"]\n{deskew}')
    run(job, tmp_path / "out", threads)
    tables = tables_of(tmp_path / "out")
    faces: dict[str, list[float]] = defaultdict(list)
    for data in tables["sample_data"].values():
        classes = np.fromfile(tmp_path / "out" / tables["lidarseg"][data["token"]]["filename"], np.uint8)
        points = in_the_world(tmp_path / "out", tables, data)[
            classes == nuscenes_dataset.CATEGORIES.index("vehicle.car")
        ]
        faces[data["filename"].split("/")[1]].append(float(np.median(points[:, 0])))
    assert len(faces["LIDAR_TOP"]) == len(faces["LIDAR_FRONT"]) == 3
    assert np.mean(faces["LIDAR_TOP"]) == pytest.approx(np.mean(faces["LIDAR_FRONT"]), abs=0.05)
    places = [annotation["translation"] for annotation in tables["sample_annotation"].values()]
    drifts_m = np.abs(np.subtract(places, [14.3 + 120.0, 120.0, 1.8])).max(axis=1)
    assert drift_m[0] <= drifts_m.min() <= drifts_m.max() <= drift_m[1]


@pytest.mark.parametrize(("deskew", "off_m"), [("", (0.0, 0.02)), ("deskew = false\n", (0.025, 0.15))])
def test_kitti_has_the_way_of_its_vehicle_taken_out(
    threads: Connect, tmp_path: Path, deskew: str, off_m: tuple[float, float]
) -> None:
    """The face of a car that stands, 13.8 m ahead at the frame's start. In raw points the sensor came 9 cm nearer.

    Tolerance: 4 cm of noise, of which the median of some 70 points has a sixth.
    """
    run(parked_job(tmp_path, f'dataset = "kitti"\n{deskew}'), tmp_path / "out", threads)
    (path,) = (tmp_path / "out").rglob("velodyne/*.bin")
    x_m = np.fromfile(path, np.float32).reshape(-1, 4)[:, 0]
    face_m = x_m[np.abs(x_m - 13.8) < 0.4]
    assert len(face_m) > 50
    assert off_m[0] < abs(np.median(face_m) - 13.8) + 1e-9 < off_m[1]


def test_points_in_a_moving_box_are_those_of_all_sensors(threads: Connect, tmp_path: Path) -> None:
    """Reference: half-spaces of the box in the tables, point by point. The car goes 0.3 m within a frame, and each
    sensor sees it at another time.
    """
    scene, rig = APPROACHING.replace("[-10, 2, 0]", "[0, 60, 0]"), ONE_BEHIND_THE_OTHER + "pitch_deg = 12\n"
    job = read_job(tmp_path, 'dataset = "nuscenes"\nframes = 2\nrigs = ["rig.toml"]\n', scene=scene, rig=rig)
    run(job, tmp_path / "out", threads)
    tables = tables_of(tmp_path / "out")
    assert len(tables["sample_annotation"]) == 2
    for annotation in tables["sample_annotation"].values():
        width, length, height = annotation["size"]
        counts = []
        for data in tables["sample_data"].values():
            if data["sample_token"] == annotation["sample_token"]:
                offset = in_the_world(tmp_path / "out", tables, data) - annotation["translation"]
                local = Rotation.from_quat(annotation["rotation"], scalar_first=True).inv().apply(offset)
                counts.append(int((np.abs(local) <= 0.5 * np.array([length, width, height])).all(axis=1).sum()))
        assert len(counts) == 2
        assert min(counts) > 10
        assert annotation["num_lidar_pts"] == sum(counts)


@pytest.mark.parametrize("name", ["kitti", "nuscenes", "semantickitti"])
def test_points_on_the_own_car_stay_out(threads: Connect, tmp_path: Path, name: str) -> None:
    """The only body rides with the sensor: of the cloud noise is left."""
    scene = PARKED.replace("14.3, 0, 1.8]", "6, 0, 1.8]\n[bodies.motion]\nwith_ego = true")
    sizes = []
    for options in ("", "own_car = false\n"):
        folder = tmp_path / f"out{len(sizes)}"
        run(read_job(tmp_path, f'dataset = "{name}"\n{options}', scene=scene), folder, threads)
        (path,) = (path for pattern in dataset.CLOUD_FOLDERS[name] for path in folder.glob(pattern))
        sizes.append(path.stat().st_size // (20 if name == "nuscenes" else 16))
    assert sizes[0] > 50 > 5 > sizes[1]


def test_a_map_shows_the_road(tmp_path: Path) -> None:
    """A road of 40 by 6 m makes as many pixels white as it covers; tolerance: a pixel along its edges."""
    from PIL import Image

    vertices, faces = plane_mesh(size_m=(40.0, 6.0))
    part = Part(vertices_m=vertices, faces=faces, material="asphalt")
    turned = Pose.from_degrees(position_m=(3.0, 1.0, 0.0), yaw_deg=90.0)
    scene = Scene(bodies=tuple(Body(name=c, class_name=c, parts=(part,), pose=turned) for c in ("road", "building")))
    corner_m, size_px = nuscenes_dataset.map_area(np.array([[0.0, 0.0, 1.0], [10.0, 5.0, 1.0]]))
    assert (corner_m.tolist(), size_px) == ([-120.0, -120.0], (2500, 2450))
    nuscenes_dataset.write_map(tmp_path / "map.png", scene, corner_m, size_px)
    picture = np.asarray(Image.open(tmp_path / "map.png"))
    assert picture.shape == size_px[::-1]
    rows, columns = np.nonzero(picture)
    assert set(picture[rows, columns].tolist()) == {255}
    assert len(rows) == pytest.approx(400 * 60, abs=2 * 460)
    middle_m = np.array([columns.mean(), size_px[1] - rows.mean()]) * 0.1 + corner_m
    assert middle_m == pytest.approx([3.0, 1.0], abs=0.1)


def test_a_folder_without_data_set_is_not_searched(monkeypatch: pytest.MonkeyPatch, job: Job, tmp_path: Path) -> None:
    """Rationale: a job of millions of clouds must not look for data sets."""
    monkeypatch.setattr(Path, "glob", lambda *_: pytest.fail("searched"))
    dispatch.require_no_other_clouds(tmp_path, (task.place for task in job.tasks()))
