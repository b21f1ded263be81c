"""Formats of point clouds: what a test needs of them, and how messages are read."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.errors import LidarSceneError
from lidarscene.formats.cloud_description import LARGEST
from lidarscene.formats.registry import ALL, FORMATS
from lidarscene.formats.ros import ros_frames
from lidarscene.labels.kitti_dataset import frame_stream
from lidarscene.scene.scene import Scene

PLACED = {"sensor_position_m": "1 2 3", "sensor_rotation": "0 -1 0 1 0 0 0 0 1", "frame": "world"}


def need(name: str) -> None:
    """Skip where the format's packages cannot be had."""
    try:
        ALL[name].require()
    except LidarSceneError as error:
        pytest.skip(str(error))


def file_of(folder: Path, name: str) -> Path:
    return folder / f"a{ALL[name].suffix}"


def clipped_to_finite(values: np.ndarray) -> np.ndarray:
    """Values as formats without infinity store them."""
    return np.clip(values, -LARGEST, LARGEST) if values.dtype.kind == "f" else values


def write_bag(path: Path, *clouds: PointCloud, **options: Any) -> None:
    """Write a bag of these frames, with these options of `ros_frames`."""
    with ros_frames(path, **options) as append:
        for cloud in clouds:
            append(cloud)


def write_frame(
    dataset: str, folder: Path, frame: int, cloud: PointCloud, scene: Scene, *, sequence: str = "00"
) -> None:
    """Write a cloud as a frame of a data set in KITTI's folders."""
    with frame_stream(dataset, folder, frame, scene, sequence=sequence) as append:
        append(cloud)


def written(path: Path, name: str, pieces: list[PointCloud]) -> bytes:
    """The file of pieces that are appended one after the other."""
    stream = FORMATS[name].stream
    assert stream is not None
    with stream(path) as append:
        for piece in pieces:
            append(piece)
    return path.read_bytes()


def rotated(quaternion: tuple[float, ...], vectors: np.ndarray) -> np.ndarray:
    """q v q*, by the cross-product form."""
    w, axis = quaternion[0], np.array(quaternion[1:])
    turned: np.ndarray = vectors + 2 * w * np.cross(axis, vectors) + 2 * np.cross(axis, np.cross(axis, vectors))
    return turned


def osi_messages(path: Path, kind: str, library: Any) -> list[Any]:
    betterosi = library("betterosi")
    return list(betterosi.read(str(path), osi_message_type=kind))


def value_at(message: Any, path: tuple[str, ...]) -> Any:
    for name in path:
        message = getattr(message, name)
    return message
