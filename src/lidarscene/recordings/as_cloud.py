"""A sweep's points as a point cloud, for files, pictures and the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..formats.cloud_columns import COLUMNS, MEASURED, SENSOR_TO_WORLD
from ..maths.arrays import Numbers
from .sweep import Sweep

UNKNOWN = 0
"""In columns that the recording does not know; `metadata["recorded"]` names those that it knows."""


def cloud_of(sweep: Sweep) -> PointCloud:
    """First and second returns in the sensor's frame. Columns that no recording knows (snr, ...) are 0.

    The intensity is what the recording has of it: intensity, else signal, else reflectivity.
    """
    parts = [_first(sweep)]
    if sweep.second is not None:
        parts.append(_second(sweep))
    columns: dict[str, Numbers] = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    known = " ".join(name for name, values in columns.items() if np.any(values))
    n = len(columns["range_m"])
    kinds = {column.attribute: column.dtype for column in COLUMNS}
    given: dict[str, Any] = {
        name: columns[name].astype(kinds[name]) if name in columns else np.broadcast_to(np.zeros(1, kinds[name]), (n,))
        for name in MEASURED
    }
    metadata = {key: value for key, value in sweep.metadata.items() if value}
    metadata |= {"recorded": known, "frame": "sensor", "frame_start_s": repr(float(sweep.start_s))}
    if sweep.pose is not None:
        rows = np.column_stack([sweep.pose.rotation, sweep.pose.position_m])
        metadata[SENSOR_TO_WORLD] = " ".join(repr(float(x)) for x in rows.ravel())
    return PointCloud(**given, metadata=metadata)


def _first(sweep: Sweep) -> dict[str, Numbers]:
    strength = next((one for one in (sweep.intensity, sweep.signal, sweep.reflectivity) if one is not None), None)
    return _columns(sweep, sweep.range_m, 1, strength=strength, signal=sweep.signal)


def _second(sweep: Sweep) -> dict[str, Numbers]:
    assert sweep.second is not None
    two = sweep.second
    strength = next((one for one in (two.intensity, two.signal, two.reflectivity) if one is not None), None)
    return _columns(sweep, two.range_m, 2, strength=strength, signal=two.signal)


def _columns(
    sweep: Sweep, range_m: Numbers, number: int, *, strength: Numbers | None, signal: Numbers | None
) -> dict[str, Numbers]:
    """Columns of the points at these ranges."""
    there = np.isfinite(range_m)

    def known(values: Numbers | None) -> Numbers:
        return np.nan_to_num(values[there]) if values is not None else np.full(there.sum(), UNKNOWN)

    direction = sweep.direction[there]
    returned = sweep.return_number if number == 1 and sweep.return_number is not None else None
    return {
        "xyz_m": sweep.points(range_m)[there],
        "range_m": range_m[there],
        "intensity": known(strength),
        "signal": known(signal),
        "ambient": known(sweep.near_ir),
        "time_s": known(sweep.time_s),
        "channel": known(sweep.ring),
        "azimuth_rad": np.arctan2(direction[:, 1], direction[:, 0]),
        "elevation_rad": np.arcsin(direction[:, 2].clip(-1.0, 1.0)),
        "return_number": np.full(there.sum(), number) if returned is None else returned[there],
    }
