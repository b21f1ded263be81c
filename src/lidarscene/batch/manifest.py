"""Manifest: a Parquet file with a row for each frame of the jobs of a folder: its options, its counts and its file."""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from typing import Any

from ..files.atomic import atomic_output
from ..files.overrides import toml_text
from ..outputs import run_report
from .drives import DriveTask
from .job_file import RangeFile, SplitFile
from .store import Store
from .tasks import FrameTask, Job, cloud_settings

ROWS_AT_A_TIME = 20_000
COUNTS = ("beams", "hits", "points", "echoes", "false_alarms", "weather", "stray", "revived")

CLAIM = 16 * "0"
"""Claim of the manifest, as if it were a frame's."""

NOT_RENDERED = "not rendered"
"""Error of a frame that is neither done nor failed."""

AGAIN_EVERY_S = 0.2
"""Choice: interval at which a manifest that another job is writing is claimed again."""


def write_manifest(job: Job, store: Store, failed: Mapping[str, str], drives: Iterable[DriveTask] = ()) -> set[str]:
    """Write the rows of all frames of a job, in its order, and behind them those of other jobs in the folder.

    Args:
        failed: key of a frame -> cause of its failure. A frame neither done nor failed gets the error "not rendered"
        drives: whole drives of the job

    Returns:
        keys of the frames with that error

    Raises:
        OutputError: if a result cannot be written
    """
    import pyarrow
    from pyarrow import parquet

    with ExitStack() as claimed:
        while not claimed.enter_context(store.claim(CLAIM)):
            time.sleep(AGAIN_EVERY_S)
        others, swept = _rows_of_others(job, store), _sweep_types(job)
        columns = {name: getattr(pyarrow, kind)() for name, kind in _columns(swept).items()}
        for field in others.schema if len(others) else ():
            if (own := columns.setdefault(field.name, field.type)) != field.type:
                are_numbers = {own, field.type} == {pyarrow.int64(), pyarrow.float64()}
                columns[field.name] = pyarrow.float64() if are_numbers else pyarrow.string()
        schema, types = pyarrow.schema(list(columns.items())), {name: str(columns[name]) for name in swept}
        splits = {} if job.file.dataset is None else {"split_by": (job.file.splits or SplitFile()).by}
        drive_of = {frame.key: drive for drive in drives for frame in drive.frames}
        rows = (
            _row(
                task,
                drive_of[task.key].row_of_frame(store, task) if drive_of else store.row(task.key, read=False),
                failed,
                types,
            )
            | splits
            | {"job": job.path.stem, "job_file": str(job.path)}
            for task in job.tasks()
        )
        with atomic_output(store.manifest) as temporary, parquet.ParquetWriter(temporary, schema) as writer:
            missing_keys = set[str]()
            while part := list(itertools.islice(rows, ROWS_AT_A_TIME)):
                missing_keys.update(row["key"] for row in part if row.get("error") == NOT_RENDERED)
                writer.write_table(pyarrow.Table.from_pylist(part, schema=schema))
            if len(others):
                missing = {name: pyarrow.nulls(len(others), kind) for name, kind in columns.items()}
                values = missing | dict(zip(others.column_names, others.columns, strict=True))
                writer.write_table(
                    pyarrow.table([values[name].cast(schema.field(name).type) for name in values], schema)
                )
    return missing_keys


def _rows_of_others(job: Job, store: Store) -> Any:
    """Rows of the manifest that are of other job files, and not of frames that this one has or that are gone."""
    import pyarrow
    from pyarrow import parquet

    try:
        table = parquet.read_table(store.manifest, filters=[("job_file", "!=", str(job.path))])
    except (OSError, pyarrow.ArrowException):  # there is none yet, or it is damaged or older
        return pyarrow.table({})
    keys = {task.key for task in job.tasks()} if len(table) else set[str]()
    frames = zip(table["key"].to_pylist(), table["file"].to_pylist(), strict=True)
    return table.filter(
        pyarrow.array(
            [key not in keys and (not file or (store.folder / file).is_file()) for key, file in frames], "bool"
        )
    )


def _columns(sweep: Mapping[str, str]) -> dict[str, str]:
    """Names and Arrow types of the columns."""
    labels = ("job", "job_file", "key", "scene", "sensor", "rig", "label", "trajectory")
    missed = [f"missed_{text.replace(' ', '_')}" for text in run_report.OUTCOME_TEXT.values()]
    return (
        dict.fromkeys(labels, "string")
        | {"number": "int64", "begin_s": "float64", "seed": "int64", "format": "string", "coordinates": "string"}
        | dict.fromkeys(("split", "split_by", "street", "sequence"), "string")
        | {"truth": "bool_", "rays": "int64", "interactions": "int64"}
        | dict(sweep)
        | dict.fromkeys([*COUNTS, *missed], "int64")
        | {"seconds": "float64", "seconds_by_stage": "string", "file": "string", "bytes": "int64"}
        | {"version": "string", "error": "string"}
    )


def _row(
    task: FrameTask, result: Mapping[str, Any] | None, failed: Mapping[str, str], types: Mapping[str, str]
) -> dict[str, Any]:
    """Row of the manifest of a frame; ``result`` is its row in the store, None if it is not done."""
    row: dict[str, Any] = {
        "key": task.key,
        "scene": task.scene.path,
        "sensor": task.sensor.name,
        "rig": task.sensor.rig,
        "label": task.sensor.label,
        "trajectory": task.scene.trajectory,
        **cloud_settings(task.trace, task.frame),
        "format": task.format,
        "truth": task.truth,
        "version": task.version,
    }
    if task.place is not None:
        row |= {"format": task.place.dataset, "split": task.place.split, "sequence": task.place.name}
        row["street"] = task.scene.street
    for name, value in task.parameters.items():
        row[name] = toml_text(value) if types[name] == "string" and not isinstance(value, str) else value
    if result is None:
        return row | {"error": failed.get(task.key, NOT_RENDERED)}
    row |= {name: result.get(name) for name in (*COUNTS, "file", "bytes")}
    row |= {f"missed_{reason}": count for reason, count in result["missed"].items()}
    seconds = result["seconds"]
    return row | {"seconds": sum(seconds.values()), "seconds_by_stage": json.dumps(seconds)}


def _sweep_types(job: Job) -> dict[str, str]:
    """Key that is swept or drawn -> Arrow type: numbers and truth values as they are, all else as text."""
    sweep, draws = job.file.sweep, job.file.draws
    scene: dict[str, Any] = sweep.scene_values() | draws.rules("scene")
    sensor: dict[str, Any] = sweep.sensor_values() | draws.rules("sensor")
    varied = {f"scene.{key}": values for key, values in scene.items()}
    varied |= {f"sensor.{key}": values for key, values in sensor.items()}
    return {name: "float64" if isinstance(values, RangeFile) else _type_of(values) for name, values in varied.items()}


def _type_of(values: Iterable[Any]) -> str:
    kinds = {type(value) for value in values}
    if kinds == {bool}:
        return "bool_"
    if kinds == {int}:
        return "int64"
    return "float64" if kinds <= {int, float} else "string"
