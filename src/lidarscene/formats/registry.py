"""The formats of point clouds by name and suffix, and what each can do.

The command line, the library and the documentation ask this table, so that a new format is one module and one line.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import Any

from ..errors import InputError
from ..files.optional import require
from . import e57, kitti, las, npz, osi, parquet, pcd, ply, ros
from .columns import Fields

Write = Callable[..., None]
Read = Callable[[str | os.PathLike[str]], Fields]
Stream = Callable[..., AbstractContextManager[Callable[[Any], None]]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """One format.

    suffix  what names of such files end in
    write   path, cloud and options to a file
    read    path to the fields of a cloud; None where a file cannot hold enough to become a cloud again
    stream  path and ``ascii`` to a block in which clouds are appended to the file; None where a file cannot be written
            piece by piece, bit for bit as it is from the whole cloud
    extra   group of optional packages that it needs (`files.optional`)
    text    whether ``write`` and ``stream`` know ``ascii``
    """

    suffix: str
    write: Write
    read: Read | None = None
    stream: Stream | None = None
    extra: str = ""
    text: bool = False

    def require(self) -> None:
        """Raise LidarSceneError, with what to install, if a package is missing."""
        if self.extra:
            require(self.extra)


def _ros(suffix: str, storage: str, layout: str = "velodyne") -> Format:
    return Format(suffix=suffix, write=partial(ros.write_ros, storage=storage, layout=layout), extra="ros")


def _las(suffix: str, *, compressed: bool) -> Format:
    return Format(
        suffix=suffix, write=partial(las.write_las, compressed=compressed), read=las.read_las,
        stream=partial(las.las_stream, compressed=compressed), extra="las",
    )  # fmt: skip


FORMATS = {
    "ply": Format(suffix=".ply", write=ply.write_ply, read=ply.read_ply, stream=ply.ply_stream, text=True),
    "pcd": Format(suffix=".pcd", write=pcd.write_pcd, read=pcd.read_pcd, stream=pcd.pcd_stream, text=True),
    "pcd-compressed": Format(
        suffix=".pcd", write=partial(pcd.write_pcd, compressed=True), read=pcd.read_pcd, extra="pcd"
    ),
    "las": _las(".las", compressed=False),
    "laz": _las(".laz", compressed=True),
    "e57": Format(suffix=".e57", write=e57.write_e57, extra="e57"),
    "kitti": Format(suffix=".bin", write=kitti.write_kitti, stream=kitti.kitti_stream),
    "nuscenes": Format(suffix=".pcd.bin", write=kitti.write_nuscenes, stream=kitti.nuscenes_stream),
    "npz": Format(suffix=".npz", write=npz.write_npz, read=npz.read_npz),
    "parquet": Format(
        suffix=".parquet", write=parquet.write_parquet, read=parquet.read_parquet, stream=parquet.parquet_stream,
        extra="parquet",
    ),
    "mcap": _ros(".mcap", storage="mcap"),
    "mcap-ouster": _ros(".mcap", storage="mcap", layout="ouster"),
    "rosbag2": _ros(".db3", storage="sqlite3"),
    "rosbag2-ouster": _ros(".db3", storage="sqlite3", layout="ouster"),
    "osi": Format(suffix=".osi", write=osi.write_osi),
}  # fmt: skip
"""Formats by name. Of several with one suffix the first is what the suffix means."""

SUFFIXES = tuple(dict.fromkeys(one.suffix for one in FORMATS.values()))

LABELS = {
    "kitti": (".txt", ".calib.txt"),
    "nuscenes": (".boxes.json",),
    "semantickitti": (".label",),
    "osi": ("_gt.osi",),
}
"""Labels by name (`lidarscene.labels.files`): what their files have in place of the cloud's suffix."""

DATASETS = ("kitti", "semantickitti")
"""Data sets by name (`lidarscene.labels.kitti_dataset`)."""


def format_of(path: str | os.PathLike[str], name: str | None = None) -> Format:
    """The format of this name, or else the one whose suffix the path has; the longest counts."""
    if name is not None:
        if name not in FORMATS:
            raise InputError(f"format '{name}': there is none; the choices are {', '.join(FORMATS)}")
        return FORMATS[name]
    file = os.path.basename(os.fspath(path)).lower()
    fitting = [one for one in FORMATS.values() if file.endswith(one.suffix)]
    if not fitting:
        suffix, choices = os.path.splitext(file)[1], ", ".join(SUFFIXES)
        raise InputError(
            f"{os.fspath(path)}: suffix '{suffix}' names no point cloud format; known: {choices}"
        )
    return max(fitting, key=lambda one: len(one.suffix))
