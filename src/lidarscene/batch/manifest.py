"""Manifest: a Parquet file with one row for each frame of a job: what was asked, what came of it, and where it is."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Mapping
from typing import Any

from ..files.atomic import atomic_output
from ..files.overrides import toml_text
from ..outputs import report
from .store import Store
from .tasks import FrameTask, Job, told_of

ROWS_AT_A_TIME = 20_000
COUNTS = ("beams", "hits", "points", "echoes", "false_alarms", "weather")


def write_manifest(job: Job, store: Store, failed: Mapping[str, str]) -> None:
    """All frames of the job, in its order; of those that failed the cause. Raises OutputError.

    failed  cause by key. A frame that is neither done nor failed was not reached, and says so
    """
    import pyarrow
    from pyarrow import parquet

    types = _sweep_types(job)
    schema = pyarrow.schema([(name, getattr(pyarrow, kind)()) for name, kind in _columns(types).items()])
    rows = (_row(task, store, failed, types) for task in job.tasks())
    with atomic_output(store.manifest) as temporary, parquet.ParquetWriter(temporary, schema) as writer:
        while part := list(itertools.islice(rows, ROWS_AT_A_TIME)):
            writer.write_table(pyarrow.Table.from_pylist(part, schema=schema))


def _columns(sweep: Mapping[str, str]) -> dict[str, str]:
    """Names and Arrow types of the columns."""
    asked = ("key", "scene", "sensor", "rig", "label", "trajectory")
    missed = [f"missed_{text.replace(' ', '_')}" for text in report.OUTCOME_TEXT.values()]
    return (
        dict.fromkeys(asked, "string")
        | {"number": "int64", "begin_s": "float64", "seed": "int64", "format": "string", "coordinates": "string"}
        | {"truth": "bool_", "rays": "int64", "interactions": "int64"}
        | dict(sweep)
        | dict.fromkeys([*COUNTS, *missed], "int64")
        | {"seconds": "float64", "seconds_by_stage": "string", "file": "string", "bytes": "int64"}
        | {"version": "string", "error": "string"}
    )


def _row(task: FrameTask, store: Store, failed: Mapping[str, str], types: Mapping[str, str]) -> dict[str, Any]:
    row: dict[str, Any] = {
        "key": task.key,
        "scene": task.scene.path,
        "sensor": task.sensor.name,
        "rig": task.sensor.rig,
        "label": task.sensor.label,
        "trajectory": task.scene.trajectory,
        **told_of(task.trace, task.frame),
        "format": task.format,
        "truth": task.truth,
        "version": task.version,
    }
    for name, value in task.parameters.items():
        row[name] = toml_text(value) if types[name] == "string" and not isinstance(value, str) else value
    told = store.row(task.key, read=False)
    if told is None:
        return row | {"error": failed.get(task.key, "not rendered")}
    row |= {name: told[name] for name in (*COUNTS, "file", "bytes")}
    row |= {f"missed_{reason}": count for reason, count in told["missed"].items()}
    seconds = told["seconds"]
    return row | {"seconds": sum(seconds.values()), "seconds_by_stage": json.dumps(seconds)}


def _sweep_types(job: Job) -> dict[str, str]:
    """Arrow types by swept key: numbers and truth values as they are, all else as text."""
    file = job.file.sweep
    swept = {f"scene.{key}": values for key, values in file.of_scene().items()}
    swept |= {f"sensor.{key}": values for key, values in file.of_sensor().items()}
    return {name: _type_of(values) for name, values in swept.items()}


def _type_of(values: Iterable[Any]) -> str:
    kinds = {type(value) for value in values}
    if kinds == {bool}:
        return "bool_"
    if kinds == {int}:
        return "int64"
    return "float64" if kinds <= {int, float} else "string"
