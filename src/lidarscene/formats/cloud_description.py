"""A cloud's description as one line of JSON, errors of reading and writing, and files whose header counts the points.

NPZ, Parquet, PCD and LAS hold columns by name and a text: the description has the rest, so that reading gives back the
same cloud. PLY and PCD begin with the number of points, which is known last if clouds come one after the other: the
header is as long for any number, and is written again in the end.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..errors import InputError, LidarSceneError, OutputError
from ..files.atomic import atomic_output
from ..files.inputs import require_file
from ..maths.arrays import Numbers
from ..maths.pose import Pose, is_near
from .cloud_columns import COLUMNS, NAMES, STATUS_NAMES, Cloud, Fields, columns_of

VERSION = 1
NO_ROOM = 1 << 20  # bytes: a disk that has no more is full
LARGEST = np.finfo(np.float32).max


def description(cloud: Cloud) -> str:
    """Return metadata, units, type of the positions and the names behind the integers, as one line of ASCII JSON."""
    content: dict[str, Any] = {
        "lidarscene": VERSION,
        "position": cloud.xyz_m.dtype.name,
        "units": {column.name: unit_of(cloud, column.name) for column in cloud.columns},
        "metadata": dict(cloud.metadata),
    }
    content |= {attribute: list(getattr(cloud, attribute)) for attribute in NAMES.values()}
    return json.dumps(content, separators=(",", ":"))


def unit_of(cloud: Cloud, name: str) -> str:
    """Return the unit of a column; that of the intensity depends on the detector, and is in the metadata."""
    return cloud.metadata.get(f"{name}_unit", next(column.unit for column in cloud.columns if column.name == name))


def category_names(text: str) -> dict[str, tuple[str, ...]]:
    """Names of the codes of a cloud's columns, column -> names, by its `description`.

    Raises:
        ValueError: if the description is none of ours
    """
    content = _content(text)
    named = {column.name: tuple(content[column.names]) for column in COLUMNS if column.names}
    return named | {"status": STATUS_NAMES}


def described_fields(columns: Mapping[str, Numbers], text: str) -> Fields:
    """Return the fields of a cloud from its columns, by name as in files, and its `description`.

    Raises:
        ValueError: if the description is none of ours, or if columns are missing
    """
    content = _content(text)
    needed = dict.fromkeys([*(column.name for column in columns_of(truth=False, vectors=False)), *content["units"]])
    missing_columns = [name for name in needed if name not in columns]
    if missing_columns:
        raise ValueError(f"columns are missing: {', '.join(missing_columns)}")
    xyz_m = np.stack([columns[name] for name in "xyz"], axis=-1).astype(content["position"], copy=False)
    attributes: dict[str, Any] = {
        column.attribute: columns[column.name] for column in COLUMNS[3:] if column.name in content["units"]
    }
    attributes |= {attribute: tuple(content[attribute]) for attribute in NAMES.values()}
    return {"xyz_m": xyz_m, "metadata": content["metadata"], **attributes}


def _content(text: str) -> dict[str, Any]:
    content = json.loads(text)
    if not isinstance(content, dict) or content.get("lidarscene") != VERSION:
        raise ValueError(f"not written by this version of lidarscene: no description of version {VERSION}")
    return content


def line_format(dtype: np.dtype[Any]) -> str:
    """Format of a point as a line of text, with enough digits to be read back exactly."""
    kinds = {"float32": "%.9g", "float64": "%.17g"}
    return " ".join(kinds.get(dtype[name].name, "%d") for name in dtype.names or ()) + "\n"


@contextmanager
def input_errors(path: str | os.PathLike[str], *, folder: bool = False) -> Iterator[None]:
    """Turn every error in the block into an InputError of one line that names the file, or the ``folder``."""
    # The libraries behind the formats raise errors of any type; all of them mean "not readable".
    if not (folder and os.path.isdir(path)):
        require_file(path, "a point cloud")
    try:
        yield
    except LidarSceneError:
        raise
    except OSError as error:
        raise InputError(f"{os.fspath(path)}: cannot be read: {error.strerror or error}") from error
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{os.fspath(path)}: cannot be read: {reason}") from error


@contextmanager
def library_errors(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn what a library raises while it writes, on a full disk too, into an OutputError of one line."""
    try:
        yield
    except (LidarSceneError, OSError, MemoryError):
        raise
    except Exception as error:
        # Libraries report a full disk in their own words: "read() failed", with a page of details.
        reason = " ".join(str(error).partition("****")[0].split())[:200] or type(error).__name__
        if shutil.disk_usage(Path(path).parent).free < NO_ROOM:
            reason = f"No space left on device ({reason})"
        raise OutputError(f"{os.fspath(path)}: cannot be written: {reason}") from error


def is_new_place(places: dict[str, Pose], frame: str, place: Pose, *, where: str, note: str = "") -> bool:
    """Whether a frame had no place on the vehicle yet, which is noted then.

    Args:
        places: of the frames so far
        where: begins the error's message
        note: ends it

    Raises:
        InputError: for a frame that has another place already
    """
    if frame not in places:
        places[frame] = place
        return True
    if not is_near(places[frame], place):
        raise InputError(f"{where}: must have one place on the vehicle, got two{note}")
    return False


@contextmanager
def counted_stream(
    path: str | os.PathLike[str], *, header: Callable[[Cloud, int], bytes], write: Callable[[IO[bytes], Cloud], None]
) -> Iterator[Callable[[Cloud], None]]:
    """Write the clouds that are appended in the block as one cloud; names and metadata are those of the first.

    Args:
        header: from a cloud and a number of points to the header, whose length must not depend on the number
        write: append the points of a cloud to the file
    """
    with atomic_output(path) as temporary, open(temporary, "wb") as file:
        first: list[Cloud] = []
        points = 0

        def append(cloud: Cloud) -> None:
            nonlocal points
            if not first:
                first.append(cloud.without_points())
                file.write(header(cloud, 0))
            points += len(cloud)
            write(file, cloud)

        yield append
        # The number of points is known now: the header is written again over the first one, which is as long.
        file.seek(0)
        file.write(header(first[0], points))
