"""Point clouds as LAS 1.4 or LAZ: a PointCloud in, a file out, and back. Needs laspy, and lazrs for LAZ.

Point format 6. Standard fields: x, y, z in steps of 10 um from a round origin; intensity as 16 bits of its largest
value; return_number and number_of_returns, up to 15; gps_time, the pulse's time in the frame; classification, 64 +
class (the codes that ASPRS leaves to users), 1 where none, 7 for what is no echo; scan_angle, the azimuth, in steps
of 0.006 degrees. Every column but the positions follows exactly in extra bytes of its name (`LAS_NAMES` where LAS
has another field of that name). The `described.description` is in a VLR of the user `lidarscene`.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from lidarscene.cloud import PointCloud
from lidarscene.errors import InputError

from .described import described_cloud, description, reading, unit_of
from .files import atomic_output
from .optional import optional

Array = np.ndarray[Any, Any]

STEP_M = 1e-5
REACH_M = STEP_M * 2**31
LAS_NAMES = {"intensity": "echo_peak", "return_number": "return"}
"""Names of extra bytes that differ from the column's, because LAS has a coarser field of that name."""

VLR_USER, VLR_RECORD, LARGEST_VLR = "lidarscene", 1, 65535
UNCLASSIFIED, LOW_NOISE, FIRST_OF_USERS, LARGEST_CLASS = 1, 7, 64, 255
SCAN_ANGLE_STEP_DEG = 0.006
MOST_RETURNS = 15


def write_las(path: str | os.PathLike[str], cloud: PointCloud, *, compressed: bool = False) -> None:
    """Write the cloud, as LAZ if ``compressed``."""
    laspy = optional("laspy", extra="las")
    backend = None
    if compressed:
        optional("lazrs", extra="las")
        backend = laspy.LazBackend.Lazrs
    las = _las(laspy, cloud, path)
    with atomic_output(path) as temporary, open(temporary, "wb") as file:
        las.write(file, do_compress=compressed, laz_backend=backend)


def read_las(path: str | os.PathLike[str]) -> PointCloud:
    """Read a file of `write_las`; the positions to 10 um. Raises InputError, in one line."""
    laspy = optional("laspy", extra="las")
    with reading(path), open(path, "rb") as file:
        las = laspy.read(file, closefd=False)
        ours = [v for v in (*las.vlrs, *(las.evlrs or ())) if v.user_id == VLR_USER]
        if not ours:
            raise ValueError("not a point cloud of lidarscene: there is no description in it")
        extra = {name: np.ascontiguousarray(las[name]) for name in las.point_format.extra_dimension_names}
        columns = {column: extra.pop(name) for column, name in LAS_NAMES.items() if name in extra}
        columns |= extra | {axis: np.asarray(las[axis]) for axis in "xyz"}
        return described_cloud(columns, ours[0].record_data_bytes().decode())


def _las(laspy: Any, cloud: PointCloud, path: str | os.PathLike[str]) -> Any:
    """The cloud as laspy has it."""
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, STEP_M), np.rint(cloud.sensor_place.position_m)
    header.generating_software = "lidarscene"
    if len(cloud) and np.abs(cloud.xyz_m - header.offsets).max() >= REACH_M:
        raise InputError(
            f"{os.fspath(path)}: LAS holds points up to {REACH_M:.0f} m from the sensor, one is farther"
        )
    columns = {LAS_NAMES.get(c.name, c.name): c for c in cloud.columns if c.name not in ("x", "y", "z")}
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(
                name=name, type=cloud.column(c.name).dtype, description=unit_of(cloud, c.name)[:32]
            )
            for name, c in columns.items()
        ]
    )
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(len(cloud), header=header)
    for axis, values in zip("xyz", cloud.xyz_m.T, strict=True):
        las[axis] = values
    for name, c in columns.items():
        las[name] = cloud.column(c.name)
    for name, values in _standard_fields(cloud).items():
        las[name] = values
    text = description(cloud).encode("ascii")
    record = laspy.VLR(VLR_USER, VLR_RECORD, "point cloud of lidarscene", text)
    if len(text) <= LARGEST_VLR:
        las.vlrs.append(record)
    else:
        las.evlrs = laspy.vlrs.vlrlist.VLRList([record])
    return las


def _standard_fields(cloud: PointCloud) -> dict[str, Array]:
    """What LAS calls things, as far as it can hold them."""
    peak = float(cloud.intensity.max(initial=0.0))
    returns = cloud.return_number.clip(1, MOST_RETURNS)
    angle = np.rint(np.degrees(cloud.azimuth_rad.astype(np.float64)) / SCAN_ANGLE_STEP_DEG)
    return {
        "intensity": np.rint(cloud.intensity.clip(0) * (65535.0 / (peak or 1.0))).astype(np.uint16),
        "return_number": returns,
        "number_of_returns": returns_of_pulses(cloud).clip(returns, MOST_RETURNS),
        "gps_time": cloud.time_s,
        "classification": _classification(cloud),
        "scan_angle": angle.clip(-30000, 30000).astype(np.int16),
    }


def returns_of_pulses(cloud: PointCloud) -> Array:
    """(n,) how many points the pulse of each point has: neighbours of one time, channel and direction."""
    if not len(cloud):
        return np.zeros(0, np.uint8)
    key = np.stack([cloud.time_s, cloud.channel, cloud.azimuth_rad, cloud.elevation_rad])
    starts = np.flatnonzero(np.r_[True, np.any(np.diff(key, axis=1) != 0, axis=0)])
    counts = np.diff(np.r_[starts, len(cloud)])
    return np.repeat(counts, counts).clip(max=255).astype(np.uint8)


def _classification(cloud: PointCloud) -> Array:
    classes = np.full(len(cloud), UNCLASSIFIED, np.int64)
    if cloud.class_id is not None:
        known = cloud.class_id >= 0
        classes[known] = np.minimum(FIRST_OF_USERS + cloud.class_id[known], LARGEST_CLASS)
    return np.where(cloud.status != 0, LOW_NOISE, classes).astype(np.uint8)
