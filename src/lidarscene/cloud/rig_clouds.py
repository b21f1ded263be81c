"""Merging the clouds of a rig's sensors into one.

The frames of several sensors begin at different times, and each sensor has its own place and unit of intensity. The
column `sensor_index` of a merged cloud names the sensor of each point; its metadata have one entry for each sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..formats.cloud_columns import RING_ROWS, SENSOR_TO_VEHICLE
from ..maths.arrays import Numbers
from .point_cloud import PointCloud

JOINED = {
    "sensor": ", ",
    "frame_start_s": " ",
    "sensor_position_m": " ",
    "sensor_rotation": " ",
    SENSOR_TO_VEHICLE: " ",
}
"""Metadata that a merged cloud holds once for each sensor: key -> separator."""


def merge_clouds(clouds: Sequence[PointCloud], labels: Sequence[str]) -> PointCloud:
    """Merge clouds of several sensors, all in the vehicle's or all in the world's frame.

    `sensor_index` names the sensor of each point, `sensor_names` are the labels, and the metadata's `frame_start_s`,
    `sensor_position_m` and `sensor_rotation` hold those of all sensors, one after the other. Times still count from the
    start of each sensor's own frame.

    Raises:
        ValueError: for clouds in the sensor's frame or in different frames
    """
    frames = {cloud.metadata.get("frame", "sensor") for cloud in clouds}
    if len(frames) != 1 or "sensor" in frames:
        raise ValueError(f"merged: clouds must be in one frame, world or vehicle, got {sorted(frames)}")
    numbered = [
        replace(cloud, sensor_names=tuple(labels), sensor_index=_constant(sensor_number, len(cloud)))
        for sensor_number, cloud in enumerate(clouds)
    ]
    all_points = PointCloud.concatenate(numbered)
    joined = {
        key: separator.join(cloud.metadata[key] for cloud in clouds)
        for key, separator in JOINED.items()
        if all(key in cloud.metadata for cloud in clouds)
    }
    units = list(dict.fromkeys(cloud.metadata.get("intensity_unit", "") for cloud in clouds))
    if len(units) > 1:
        joined["intensity_unit"] = " or ".join(units)
    metadata = {**clouds[0].metadata, **joined}
    for key in ("driver", RING_ROWS):  # what sensors of several makers do not share
        if len({cloud.metadata.get(key) for cloud in clouds}) > 1:
            metadata.pop(key, None)
    return replace(all_points, metadata=metadata)


class Merging:
    """Streaming form of `merge_clouds`, for clouds that come in pieces, those of the first sensor first."""

    def __init__(self, clouds: Sequence[PointCloud], labels: Sequence[str]) -> None:
        """``clouds`` hold the names and metadata of each sensor's cloud, and no points."""
        self._whole = merge_clouds(clouds, labels)
        self._dtype: Any = None

    def piece(self, sensor_number: int, cloud: PointCloud) -> PointCloud:
        """Turn points of sensor ``number`` into points of the merged cloud."""
        self._dtype = self._dtype or cloud.xyz_m.dtype  # the first one's, as of arrays that are joined
        return replace(
            cloud,
            xyz_m=cloud.xyz_m.astype(self._dtype, copy=False),
            sensor_names=self._whole.sensor_names,
            sensor_index=_constant(sensor_number, len(cloud)),
            metadata=self._whole.metadata,
        )


def _constant(value: int, points: int) -> Numbers:
    return np.broadcast_to(np.uint8(value), points)
