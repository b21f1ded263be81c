"""Write point clouds as E57 (ASTM E2807). Needs pye57.

One scan. Standard fields: cartesianX/Y/Z, intensity, timeStamp (from the start of the frame), returnIndex (from 0),
returnCount, rowIndex (the ring). Every other column is a field of its name in our own extension, prefix `ls`. The
scan's pose takes the points into the world; a cloud in the world frame has none. The `cloud_description.description`
is the scan's description.
"""

from __future__ import annotations

import hashlib
import os
import uuid
from typing import Any

import numpy as np

from ..files.atomic import atomic_output
from ..files.optional import import_optional
from ..maths.arrays import Numbers
from ..maths.rotations import quaternion
from .cloud_columns import Cloud, returns_of_pulses
from .cloud_description import LARGEST, description, library_errors

PREFIX, URI = "ls", "https://lidarscene.invalid/e57/1"
FIELDS = {
    "x": "cartesianX",
    "y": "cartesianY",
    "z": "cartesianZ",
    "intensity": "intensity",
    "time": "timeStamp",
    "return_number": "returnIndex",
    "ring": "rowIndex",
}
BLOCK_POINTS = 1 << 18


def write_e57(path: str | os.PathLike[str], cloud: Cloud) -> None:
    """Write the cloud as one scan."""
    e57 = import_optional("pye57.libe57", extra="e57")
    with atomic_output(path) as temporary, library_errors(path):
        file = e57.ImageFile(str(temporary), "w")
        try:
            _write_scan(e57, file, cloud)
        except BaseException:
            file.cancel()  # closing would write the rest, and fail with another message
            raise
        file.close()


def _write_scan(e57: Any, file: Any, cloud: Cloud) -> None:
    columns = _columns(cloud)
    text = description(cloud)
    file.extensionsAdd("", e57.E57_V1_0_URI)
    file.extensionsAdd(PREFIX, URI)
    tree = {
        "formatName": "ASTM E57 3D Imaging Data File",
        "guid": _guid(text, "file"),
        "versionMajor": e57.E57_FORMAT_MAJOR,
        "versionMinor": e57.E57_FORMAT_MINOR,
        "e57LibraryVersion": e57.E57_LIBRARY_ID,
        "coordinateMetadata": "",
    }
    root = file.root()
    _fill(e57, file, root, tree)
    scans = e57.VectorNode(file, True)
    root.set("data3D", scans)
    root.set("images2D", e57.VectorNode(file, True))
    scan = e57.StructureNode(file)
    scans.append(scan)
    _fill(e57, file, scan, _scan_tree(cloud, columns, text))
    prototype = e57.StructureNode(file)
    for name, values in columns.items():
        prototype.set(name, _node(e57, file, values))
    points = e57.CompressedVectorNode(file, prototype, e57.VectorNode(file, True))
    scan.set("points", points)
    if len(cloud):
        _write_points(e57, file, points, columns)


def _columns(cloud: Cloud) -> dict[str, Numbers]:
    """Columns by the names of the standard and of our extension, finite, with returns counted from 0."""
    columns = {}
    for column in cloud.columns:
        values = cloud.column(column.name)
        if values.dtype.kind == "i" or values.dtype == np.uint32:
            # The library has no unsigned type of 32 bits, and writes C's long as 32 bits; long long has 64.
            values = values.astype(np.longlong)
        if column.name == "return_number":
            values = values.astype(np.longlong) - 1
        if values.dtype.kind == "f":  # there is no infinity in E57
            values = np.clip(values, -LARGEST, LARGEST).astype(values.dtype)
        columns[FIELDS.get(column.name, f"{PREFIX}:{column.name}")] = values
    columns["returnCount"] = np.maximum(returns_of_pulses(cloud), columns["returnIndex"] + 1)
    return columns


def _scan_tree(cloud: Cloud, columns: dict[str, Numbers], text: str) -> dict[str, Any]:
    """Fields of the scan, without its points."""
    low, high = (
        (reduce(cloud.xyz_m, axis=0).astype(float) if len(cloud) else np.zeros(3)) for reduce in (np.min, np.max)
    )
    bounds = {
        f"{axis}{suffix}": float(value[i])
        for suffix, value in (("Minimum", low), ("Maximum", high))
        for i, axis in enumerate("xyz")
    }
    tree: dict[str, Any] = {
        "guid": _guid(text, "scan"),
        "name": cloud.metadata.get("scene", "lidarscene"),
        "description": text,
        "sensorModel": cloud.metadata.get("sensor", ""),
        "cartesianBounds": bounds,
        "indexBounds": {
            "rowMinimum": 0,
            "rowMaximum": int(columns["rowIndex"].max(initial=0)),
            "returnMinimum": 0,
            "returnMaximum": int(columns["returnIndex"].max(initial=0)),
        },
        "intensityLimits": {
            "intensityMinimum": float(columns["intensity"].min(initial=0)),
            "intensityMaximum": float(columns["intensity"].max(initial=0)),
        },
    }
    pose = cloud.frame_to_world
    if cloud.metadata.get("frame", "sensor") != "world" and pose is not None:
        rotation = dict(zip("wxyz", quaternion(pose.rotation), strict=True))
        tree["pose"] = {"rotation": rotation, "translation": dict(zip("xyz", pose.position_m.tolist(), strict=True))}
    return tree


def _fill(e57: Any, file: Any, node: Any, tree: dict[str, Any]) -> None:
    """Add texts, integers, floats and nested tables below a node."""
    for name, value in tree.items():
        if isinstance(value, dict):
            child = e57.StructureNode(file)
            node.set(name, child)
            _fill(e57, file, child, value)
        elif isinstance(value, str):
            node.set(name, e57.StringNode(file, value))
        else:
            kind = e57.IntegerNode if isinstance(value, int) else e57.FloatNode
            node.set(name, kind(file, value))


def _node(e57: Any, file: Any, values: Numbers) -> Any:
    """Node for the type of a field: a float as wide as the column, an integer with the limits of its values."""
    if values.dtype.kind == "f":
        precision = e57.E57_SINGLE if values.dtype == np.float32 else e57.E57_DOUBLE
        limit = float(LARGEST) if values.dtype == np.float32 else float(np.finfo(np.float64).max)
        return e57.FloatNode(file, 0.0, precision, -limit, limit)
    low, high = int(values.min(initial=0)), int(values.max(initial=0))
    return e57.IntegerNode(file, low, low, high)


def _write_points(e57: Any, file: Any, points: Any, columns: dict[str, Numbers]) -> None:
    """Write the points block by block, through buffers that the library reads."""
    count = len(next(iter(columns.values())))
    capacity = min(BLOCK_POINTS, count)
    arrays = {name: np.zeros(capacity, values.dtype) for name, values in columns.items()}
    buffers = e57.VectorSourceDestBuffer()
    for name, array in arrays.items():
        buffers.append(e57.SourceDestBuffer(file, name, array, capacity, True, True))
    writer = points.writer(buffers)
    for first in range(0, count, capacity):
        size = min(capacity, count - first)
        for name, array in arrays.items():
            array[:size] = columns[name][first : first + size]
        writer.write(size)
    writer.close()


def _guid(text: str, part: str) -> str:
    """Identifier derived from the cloud's description, so that the same run writes the same file."""
    return f"{{{uuid.UUID(bytes=hashlib.sha256(f'{part} {text}'.encode()).digest()[:16], version=4)}}}"
