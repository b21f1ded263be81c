"""Convert a sweep's points to a point cloud, for files, pictures and the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..formats.cloud_columns import COLUMNS, MEASURED, SENSOR_TO_WORLD, pose_text
from ..maths.arrays import Numbers
from .sweep import Second, Sweep

UNKNOWN = 0
"""Value of columns that the recording does not have; `metadata["recorded"]` names those that it has."""

PLACES = ("xyz_m", "range_m", "azimuth_rad", "elevation_rad")
"""Columns that every recording has, in a frame without points too."""

UNITS = {"intensity": "as recorded", "signal": "photons", "reflectivity": "as recorded"}
"""Scalars that may be the column `intensity`, the first that the recording has, and their units."""


def cloud_of(sweep: Sweep) -> PointCloud:
    """Point cloud of the first and second returns, in the sensor's frame; columns that no recording has are 0.

    `UNITS` says what its intensity is.
    """
    returns = [_columns(sweep, sweep, 1)]
    if sweep.second is not None:
        returns.append(_columns(sweep, sweep.second, 2))
    columns: dict[str, Numbers] = {
        name: np.concatenate([return_columns[name] for return_columns in returns]) for name in returns[0]
    }
    recorded_columns = " ".join(name for name, values in columns.items() if name in PLACES or np.any(values))
    points = len(columns["range_m"])
    dtypes = {column.attribute: column.dtype for column in COLUMNS}
    attributes: dict[str, Any] = {
        name: columns[name].astype(dtypes[name])
        if name in columns
        else np.broadcast_to(np.zeros(1, dtypes[name]), (points,))
        for name in MEASURED
    }
    metadata = {key: value for key, value in sweep.metadata.items() if value}
    if intensity := _intensity(sweep):
        metadata["intensity_unit"] = UNITS[intensity]
    metadata |= {"recorded": recorded_columns, "frame": "sensor", "frame_start_s": repr(float(sweep.start_s))}
    if sweep.pose is not None:
        metadata[SENSOR_TO_WORLD] = pose_text(sweep.pose)
    return PointCloud(**attributes, metadata=metadata)


def _intensity(returns: Sweep | Second) -> str:
    """Scalar that is the intensity; "" without any."""
    return next((name for name in UNITS if getattr(returns, name) is not None), "")


def _columns(sweep: Sweep, returns: Sweep | Second, number: int) -> dict[str, Numbers]:
    """Columns of the first or second returns, by attribute of a cloud; pulses without one are left out."""
    range_m = returns.range_m
    has_point = np.isfinite(range_m)

    def at_points(values: Numbers | None) -> Numbers:
        return np.nan_to_num(values[has_point]) if values is not None else np.full(has_point.sum(), UNKNOWN)

    direction = sweep.direction[has_point]
    return_number = sweep.return_number if number == 1 and sweep.return_number is not None else None
    return {
        "xyz_m": sweep.points(range_m)[has_point],
        "range_m": range_m[has_point],
        "intensity": at_points(getattr(returns, _intensity(returns), None)),
        "signal": at_points(returns.signal),
        "ambient": at_points(sweep.near_ir),
        "time_s": at_points(sweep.time_s),
        "channel": at_points(sweep.ring),  # which laser it was, recordings seldom say
        "ring": at_points(sweep.ring),
        "azimuth_rad": np.arctan2(direction[:, 1], direction[:, 0]),
        "elevation_rad": np.arcsin(direction[:, 2].clip(-1.0, 1.0)),
        "return_number": np.full(has_point.sum(), number) if return_number is None else return_number[has_point],
    }
