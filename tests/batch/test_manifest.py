"""Rows of several jobs in a folder; how many frames go out at once, without a cluster."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lidarscene.batch import manifest
from lidarscene.batch.dispatch import BUNDLES_FOR_EACH, _Dispatcher
from lidarscene.batch.store import Store
from lidarscene.batch.tasks import Job


def bundle_size(frames_left: int, *, threads: int, frame_s: float) -> int:
    return _Dispatcher.share(SimpleNamespace(_frame_s=frame_s, _count=lambda: threads), frames_left)


@pytest.mark.parametrize(
    ("frame_s", "threads", "frames_left", "frames"),
    [
        (1.0, 4, 10**6, 1),  # a second of work
        (0.25, 4, 10**6, 4),
        (0.021, 4, 10**6, 47),
        (0.005, 4, 10**6, 100),  # never more than 100
        (1e-9, 4, 10**6, 100),
        (30.0, 4, 10**6, 1),  # never less than one
        (0.02, 4, 200, 25),  # near the end half of what each thread would get
        (0.02, 4, 80, 10),
        (0.02, 1, 80, 40),
        (0.02, 4, 15, 1),
        (0.02, 4, 1, 1),
    ],
)
def test_share_by_hand(frame_s: float, threads: int, frames_left: int, frames: int) -> None:
    assert bundle_size(frames_left, threads=threads, frame_s=frame_s) == frames


@pytest.mark.parametrize("threads", [1, 3, 16])
def test_no_thread_waits_long_for_the_last_bundle(threads: int) -> None:
    """Rationale: what is given out last is what the others wait for. Whatever is left, a bundle is half of a thread's
    even part of it at most, or a single frame; and bundles become smaller to the end.
    """
    frames_left, before = 5000, 100
    while frames_left:
        frames = bundle_size(frames_left, threads=threads, frame_s=1e-3)
        assert 1 <= frames <= before
        assert frames == 1 or frames <= 0.5 * frames_left / threads
        frames_left, before = frames_left - frames, frames
    assert before == 1


def test_each_thread_has_one_bundle_waiting() -> None:
    dispatcher = SimpleNamespace(bundles={}, _count=lambda: 3)
    for number in range(2 * 3):
        assert not _Dispatcher.is_enough(dispatcher)
        dispatcher.bundles[number] = []
    assert _Dispatcher.is_enough(dispatcher)
    assert BUNDLES_FOR_EACH == 2


def test_the_time_of_a_frame_is_that_of_its_bundle_over_its_frames() -> None:
    """Three frames in 0.6 s: 0.2 s each, and five of these are a second."""
    future = SimpleNamespace(key="render-1", cancelled=lambda: False, status="finished")
    bundle = [SimpleNamespace(frame_count=1) for _ in range(3)]
    dispatcher = SimpleNamespace(
        bundles={"render-1": bundle},
        _waiting=iter([(future, (["", "broken", ""], 0.6))]),
        _frame_s=1.0,
        _count=lambda: 4,
        _futures={},
        _since_s={},
        _late={},
        _longest_s=0.3,
    )
    assert _Dispatcher.next(dispatcher) == list(zip(bundle, ("", "broken", ""), strict=True))
    assert dispatcher.bundles == {}
    assert dispatcher._frame_s == pytest.approx(0.2)
    assert dispatcher._longest_s == 0.3
    assert _Dispatcher.share(dispatcher, 1000) == 5


@pytest.mark.parametrize(
    ("values", "kind"),
    [([1, 2.5], "float64"), ([1, 2], "int64"), ([True, False], "bool_"), ([True, 1], "string"), (["a", 1], "string")],
)
def test_columns_have_the_type_of_what_is_swept(values: list[object], kind: str) -> None:
    assert manifest._type_of(values) == kind


def rows_of(folder: Path) -> list[dict[str, Any]]:
    from pyarrow import parquet

    return parquet.read_table(Store(folder).manifest).to_pylist()


def renamed(job_file: Path, name: str, *changes: tuple[str, str]) -> Job:
    text = job_file.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = job_file.parent / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return Job.read(path)


def test_jobs_share_a_folder_and_its_manifest(job_file: Path, tmp_path: Path) -> None:
    """Rationale: the second job's manifest replaced the first one's, whose frames stayed without a row."""
    pytest.importorskip("pyarrow")
    store, lit = Store(tmp_path / "out"), ('"sun.illuminance_klux" = [1, 100]', '"sun.illuminance_klux" = [0.5]')
    # Another file of the same name, in another folder, is another job.
    day, night = Job.read(job_file), renamed(job_file, "night/job.toml", lit, ("wall.toml", "../wall.toml"))
    foggy = renamed(
        job_file, "foggy.toml", ('"sun.illuminance_klux"', '"sun.azimuth_deg" = [7]\n"air.extinction_per_m"')
    )
    for job in (day, night, foggy):
        manifest.write_manifest(job, store, {})
    # The last job's first, then those before.
    rows, tasks = rows_of(store.folder), [*foggy.tasks(), *night.tasks(), *day.tasks()]
    assert [row["key"] for row in rows] == [task.key for task in tasks]
    assert [row["job"] for row in rows] == ["foggy"] * 4 + ["job"] * 6
    assert [row["job_file"] for row in rows[4:]] == [str(tmp_path / "night" / "job.toml")] * 2 + [str(job_file)] * 4
    for row, task in zip(rows, tasks, strict=True):
        swept = {name: value for name, value in row.items() if "." in name and value is not None}
        assert swept == task.parameters
        assert row["error"] == "not rendered"


def test_a_job_that_is_changed_or_has_the_frames_of_another_replaces_rows(job_file: Path, tmp_path: Path) -> None:
    """One that was split ends with the whole; what was taken out of a job, or is not there any more, has no row."""
    pytest.importorskip("pyarrow")
    store, whole = Store(tmp_path / "out"), Job.read(job_file)
    first, second = (renamed(job_file, f"{seed}.toml", ("[0, 7]", f"[{seed}]")) for seed in (0, 7))
    for job in (first, second, whole):
        manifest.write_manifest(job, store, {})
    assert [row["key"] for row in rows_of(store.folder)] == [task.key for task in whole.tasks()]
    kept, gone = first.tasks()
    for task in (kept, gone):
        cloud = store.cloud(task.key, "ply")
        cloud.parent.mkdir(parents=True)
        cloud.write_bytes(b"ply")
        store.finish(task.key, [cloud], {"missed": {}, "seconds": {}})
    manifest.write_manifest(first, store, {})
    store.cloud(gone.key, "ply").unlink()
    manifest.write_manifest(renamed(job_file, "job.toml", ("[1, 100]", "[5]")), store, {})
    assert [(row["job"], row["seed"]) for row in rows_of(store.folder)] == [("job", 0), ("job", 7), ("0", 0)]


@pytest.mark.parametrize(
    ("values", "kind"), [([0.5, 1.0], "double"), ([2, 3], "int64"), (["a", "b"], "string"), ([True, False], "string")]
)
def test_values_of_one_key_in_two_jobs(values: list[Any], kind: str, job_file: Path, tmp_path: Path) -> None:
    """Whole numbers beside fractions are fractions; what is not alike is text."""
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    store, job, key = Store(tmp_path / "out"), Job.read(job_file), "scene.sun.illuminance_klux"
    store.folder.mkdir()
    others = pyarrow.table({"job_file": ["b", "b"], "key": ["1", "2"], "file": pyarrow.nulls(2, "string"), key: values})
    parquet.write_table(others, store.manifest)
    manifest.write_manifest(job, store, {})
    found = parquet.read_table(store.manifest)[key]
    assert found.type == kind
    assert found.to_pylist()[4:] == others[key].cast(found.type).to_pylist()
    assert [float(value) for value in found.to_pylist()[:4]] == [1.0, 1.0, 100.0, 100.0]


def test_a_damaged_manifest_is_written_anew(job_file: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    store, job = Store(tmp_path / "out"), Job.read(job_file)
    manifest.write_manifest(job, store, {})
    store.manifest.write_bytes(store.manifest.read_bytes()[:-5])
    manifest.write_manifest(job, store, {})
    assert len(rows_of(store.folder)) == len(job)
