"""Convert a sweep's points to a point cloud, for files, pictures and the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..formats.cloud_columns import COLUMNS, MEASURED, SENSOR_TO_WORLD
from ..maths.arrays import Numbers
from .sweep import Sweep

UNKNOWN = 0
"""Value of columns that the recording does not have; `metadata["recorded"]` names those that it has."""


def cloud_of(sweep: Sweep) -> PointCloud:
    """Point cloud of the first and second returns, in the sensor's frame; columns that no recording has are 0.

    The intensity is that of the recording, else its signal, else its reflectivity.
    """
    returns = [_first_returns(sweep)]
    if sweep.second is not None:
        returns.append(_second_returns(sweep))
    columns: dict[str, Numbers] = {
        name: np.concatenate([return_columns[name] for return_columns in returns]) for name in returns[0]
    }
    recorded_columns = " ".join(name for name, values in columns.items() if np.any(values))
    points = len(columns["range_m"])
    dtypes = {column.attribute: column.dtype for column in COLUMNS}
    attributes: dict[str, Any] = {
        name: columns[name].astype(dtypes[name])
        if name in columns
        else np.broadcast_to(np.zeros(1, dtypes[name]), (points,))
        for name in MEASURED
    }
    metadata = {key: value for key, value in sweep.metadata.items() if value}
    metadata |= {"recorded": recorded_columns, "frame": "sensor", "frame_start_s": repr(float(sweep.start_s))}
    if sweep.pose is not None:
        rows = np.column_stack([sweep.pose.rotation, sweep.pose.position_m])
        metadata[SENSOR_TO_WORLD] = " ".join(repr(float(x)) for x in rows.ravel())
    return PointCloud(**attributes, metadata=metadata)


def _first_returns(sweep: Sweep) -> dict[str, Numbers]:
    intensity = next(
        (scalar for scalar in (sweep.intensity, sweep.signal, sweep.reflectivity) if scalar is not None), None
    )
    return _columns(sweep, sweep.range_m, 1, intensity=intensity, signal=sweep.signal)


def _second_returns(sweep: Sweep) -> dict[str, Numbers]:
    assert sweep.second is not None
    second = sweep.second
    intensity = next(
        (scalar for scalar in (second.intensity, second.signal, second.reflectivity) if scalar is not None), None
    )
    return _columns(sweep, second.range_m, 2, intensity=intensity, signal=second.signal)


def _columns(
    sweep: Sweep, range_m: Numbers, number: int, *, intensity: Numbers | None, signal: Numbers | None
) -> dict[str, Numbers]:
    """Columns of the points at these ranges, by attribute of a cloud; pulses without a return are left out."""
    has_point = np.isfinite(range_m)

    def at_points(values: Numbers | None) -> Numbers:
        return np.nan_to_num(values[has_point]) if values is not None else np.full(has_point.sum(), UNKNOWN)

    direction = sweep.direction[has_point]
    return_number = sweep.return_number if number == 1 and sweep.return_number is not None else None
    return {
        "xyz_m": sweep.points(range_m)[has_point],
        "range_m": range_m[has_point],
        "intensity": at_points(intensity),
        "signal": at_points(signal),
        "ambient": at_points(sweep.near_ir),
        "time_s": at_points(sweep.time_s),
        "channel": at_points(sweep.ring),  # which laser it was, recordings seldom say
        "ring": at_points(sweep.ring),
        "azimuth_rad": np.arctan2(direction[:, 1], direction[:, 0]),
        "elevation_rad": np.arcsin(direction[:, 2].clip(-1.0, 1.0)),
        "return_number": np.full(has_point.sum(), number) if return_number is None else return_number[has_point],
    }
