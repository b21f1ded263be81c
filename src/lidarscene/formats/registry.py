"""The formats of point clouds: a name or the end of a file's name in, the module that writes and reads out."""

from __future__ import annotations

import functools
import importlib
import os
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

from ..errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """One format. Its module is loaded by name on use, so that clouds know no file format.

    suffix   what names of such files end in
    reader   "" where a file cannot hold enough to become a cloud again
    appender "" where a file cannot be written piece by piece, bit for bit as it is from the whole cloud
    options  of the writer and of the appender
    extra    group of optional packages that it needs (`lidarscene.files.optional`)
    text     whether the writer knows ``ascii``
    """

    suffix: str
    module: str
    writer: str
    reader: str = ""
    appender: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    extra: str = ""
    text: bool = False

    def write(self) -> Callable[..., None]:
        """The writer: path, cloud, options."""
        return self._function(self.writer)

    def read(self) -> Callable[..., Any]:
        """The reader: path to cloud."""
        return self._function(self.reader)

    def stream(self) -> Callable[..., AbstractContextManager[Callable[[Any], None]]]:
        """The appender: path and ``ascii`` to a block in which clouds are appended to the file."""
        return functools.partial(self._function(self.appender), **self.options)

    def require(self) -> None:
        """Raise LidarSceneError, with what to install, if a package is missing."""
        if self.extra:
            importlib.import_module("lidarscene.files.optional").require(self.extra)

    def _function(self, name: str) -> Callable[..., Any]:
        found: Callable[..., Any] = getattr(
            importlib.import_module(f"lidarscene.formats.{self.module}"), name
        )
        return found


def _ros(suffix: str, **options: str) -> Format:
    return Format(suffix=suffix, module="ros", writer="write_ros", options=options, extra="ros")


_PCD: dict[str, Any] = {"suffix": ".pcd", "module": "pcd", "writer": "write_pcd", "reader": "read_pcd"}
_LAS: dict[str, Any] = {
    "module": "las",
    "writer": "write_las",
    "reader": "read_las",
    "appender": "las_stream",
    "extra": "las",
}

FORMATS = {
    "ply": Format(
        suffix=".ply", module="ply", writer="write_ply", reader="read_ply", appender="ply_stream", text=True
    ),
    "pcd": Format(**_PCD, appender="pcd_stream", text=True),
    "pcd-compressed": Format(**_PCD, options={"compressed": True}, extra="pcd"),
    "las": Format(suffix=".las", **_LAS),
    "laz": Format(suffix=".laz", **_LAS, options={"compressed": True}),
    "e57": Format(suffix=".e57", module="e57", writer="write_e57", extra="e57"),
    "kitti": Format(suffix=".bin", module="kitti", writer="write_kitti", appender="kitti_stream"),
    "nuscenes": Format(
        suffix=".pcd.bin", module="nuscenes", writer="write_nuscenes", appender="nuscenes_stream"
    ),
    "npz": Format(suffix=".npz", module="npz", writer="write_npz", reader="read_npz"),
    "parquet": Format(
        suffix=".parquet",
        module="parquet",
        writer="write_parquet",
        reader="read_parquet",
        appender="parquet_stream",
        extra="parquet",
    ),
    "mcap": _ros(".mcap", storage="mcap"),
    "mcap-ouster": _ros(".mcap", storage="mcap", layout="ouster"),
    "rosbag2": _ros(".db3", storage="sqlite3"),
    "rosbag2-ouster": _ros(".db3", storage="sqlite3", layout="ouster"),
    "osi": Format(suffix=".osi", module="osi", writer="write_osi"),
}
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
        suffix, known = os.path.splitext(file)[1], ", ".join(SUFFIXES)
        raise InputError(f"{os.fspath(path)}: suffix '{suffix}' names no point cloud format; known: {known}")
    return max(fitting, key=lambda one: len(one.suffix))
