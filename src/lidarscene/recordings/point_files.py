"""Recordings in files of points: KITTI, nuScenes, Argoverse 2, PCD, PLY and LAS, one frame each; folders of them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..errors import InputError, OptionError, OptionWarning, warn
from ..files.inputs import NOT_HIDDEN, by_numbers
from ..files.optional import import_optional
from ..formats.cloud_description import input_errors
from ..formats.las import las_columns
from ..formats.pcd import pcd_columns
from ..formats.ply import ply_columns
from ..maths.arrays import Numbers
from .recording import Recording
from .sweep import Sweep
from .sweep_from_columns import sweep_of

Columns = dict[str, Numbers]

NUSCENES_LEAST_M = 1.0
"""Choice: least distance of a point in nuScenes: nearer ones are markers of lost pulses at the origin, which were moved
with the car as if they were points."""


HEADER_BYTES = 1 << 16
"""Bytes from the start in which formats of clouds name the program that wrote the file."""


def rows_of(path: Path, names: tuple[str, ...]) -> Columns:
    """Columns of a file of float32 rows without a header; ValueError unless it holds whole rows, by all signs of these.

    In rows of float64 or of another number of columns, coordinates come in the place of intensities.
    """
    values = np.frombuffer(path.read_bytes(), np.uint8)
    size = 4 * len(names)
    must = f"must be rows of {size} bytes, float32 ({', '.join(names)}; with ring: .pcd.bin)"
    if len(values) % size:
        raise ValueError(f"{must}, got {len(values)} bytes")
    columns = dict(zip(names, values.view("<f4").reshape(-1, len(names)).T, strict=True))
    if len(np.unique(columns["intensity"][columns["intensity"] < 0.0])) > 1:  # one marks what has none
        raise ValueError(f"{must}, got others: intensities are negative")
    return columns


def is_own(path: Path) -> bool:
    """Whether lidarscene wrote a file of a cloud: its header says so."""
    with path.open("rb") as file:
        return b"lidarscene" in file.read(HEADER_BYTES)


def own_cloud(path: Path) -> PointCloud | None:
    """Cloud that lidarscene wrote, in the sensor's frame; None if it is another's, or another program changed it."""
    cloud = None
    with suppress(InputError):
        cloud = PointCloud.load(path) if is_own(path) else None
    return None if cloud is None else cloud.in_sensor_frame()


def _read_kitti(path: Path) -> tuple[Columns, tuple[int, ...] | None]:
    return rows_of(path, ("x", "y", "z", "intensity")), None


def _read_nuscenes(path: Path) -> tuple[Columns, tuple[int, ...] | None]:
    columns = rows_of(path, ("x", "y", "z", "intensity", "ring"))
    with np.errstate(over="ignore"):
        is_point = columns["x"] ** 2 + columns["y"] ** 2 + columns["z"] ** 2 >= NUSCENES_LEAST_M**2
    return {name: values[is_point] for name, values in columns.items()}, None


def _feather_columns(path: Path) -> Columns:
    """Columns of a table in Feather, such as a sweep of Argoverse 2."""
    table = import_optional("pyarrow.feather", extra="parquet").read_table(path, memory_map=False)
    return {name: table.column(name).to_numpy() for name in table.column_names}


def _as_list(read: Callable[[Path], Columns]) -> Callable[[Path], tuple[Columns, tuple[int, ...] | None]]:
    return lambda path: (read(path), None)


CLOUDS: dict[str, tuple[str, Callable[[Path], tuple[Columns, tuple[int, ...] | None]]]] = {
    ".pcd.bin": ("nuscenes", _read_nuscenes),
    ".bin": ("kitti", _read_kitti),
    ".pcd": ("pcd", pcd_columns),
    ".ply": ("ply", _as_list(ply_columns)),
    ".las": ("las", _as_list(las_columns)),
    ".laz": ("laz", _as_list(las_columns)),
    ".feather": ("feather", _as_list(_feather_columns)),
}
"""Suffix, the longest first -> (format, reader of the columns and of (rows, columns) if they are an array)."""


def suffix_of(path: Path) -> str | None:
    """Suffix of `CLOUDS` that a name ends in; None for another."""
    return next((suffix for suffix in CLOUDS if path.name.lower().endswith(suffix)), None)


def open_cloud(path: Path, metadata: Path | None) -> Recording:
    """Open one file, or a folder of them in the order of the numbers in their names.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    if metadata is not None:
        raise OptionError("{metadata} {0}: needs a recording of packets, got {1}", metadata, path.name)
    files = [path] if path.is_file() else sorted(filter(suffix_of, path.glob(NOT_HIDDEN)), key=by_numbers)
    if not files:
        raise InputError(f"{path}: must hold files that end in {', '.join(CLOUDS)}, got none")
    suffixes = sorted({str(suffix_of(file)) for file in files})
    if len(suffixes) > 1:
        warn(
            OptionWarning(
                "{0}: files of several formats are read as frames of one sensor: {1}", path, ", ".join(suffixes)
            )
        )
    recording_metadata = {"format": CLOUDS[str(suffix_of(files[0]))][0], "sensor": "", "frame": "0"}

    def read(frame: int) -> Sweep:
        file = files[frame]
        with input_errors(file):
            name, columns_of = CLOUDS[str(suffix_of(file))]
            own = own_cloud(file)
            if own is None:
                columns, shape = columns_of(file)
                placed: dict[str, Any] = {}
            else:
                columns, shape = {column.name: own.column(column.name) for column in own.columns}, None
                placed = {"pose": own.sensor_to_world, "start_s": own.frame_start_s}
            described = recording_metadata | {"format": name, "frame": str(frame)}
            sweep = sweep_of(columns, shape=shape, metadata=described, **placed)
        if not sweep.has_return.any():
            raise InputError(f"{file}: must have points, got none")
        return sweep

    return Recording(path=path, count=len(files), read=read, metadata=recording_metadata)
