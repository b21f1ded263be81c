"""Data sets in KITTI's folders, frame by frame: a PointCloud and its Scene in, the files that loaders expect out.

`write_object_frame` fills `training/velodyne`, `label_2` and `calib` (3D object detection), `write_sequence_frame`
`dataset/sequences/00` and `dataset/poses` (odometry and SemanticKITTI). A frame's files do not depend on the others,
but `times.txt` and `poses.txt` have a line for each frame so far: frames are written in order.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from lidarscene.cloud import PointCloud
from lidarscene.errors import InputError
from lidarscene.geometry import Pose
from lidarscene.labels import sensor_place
from lidarscene.scene import Scene

from .files import atomic_output
from .kitti import write_kitti
from .label_files import SENSOR_TO_CAMERA, kitti_calibration, kitti_lines, semantic_kitti


def cloud_path(dataset: str, folder: str | os.PathLike[str], frame: int, *, sequence: str = "00") -> Path:
    """The file of the cloud of this frame, in a data set of `formats.DATASETS`."""
    parts = ("training",) if dataset == "kitti" else ("dataset", "sequences", sequence)
    return Path(folder).joinpath(*parts, "velodyne", f"{frame:06d}.bin")


def write_frame(
    dataset: str, folder: str | os.PathLike[str], frame: int, cloud: PointCloud, scene: Scene
) -> None:
    """Write a frame of a data set of `formats.DATASETS`."""
    {"kitti": write_object_frame, "semantickitti": write_sequence_frame}[dataset](folder, frame, cloud, scene)


def write_object_frame(folder: str | os.PathLike[str], frame: int, cloud: PointCloud, scene: Scene) -> None:
    """Write frame number ``frame`` (from 0) of a data set for object detection.

    Without labels where the cloud has no truth.
    """
    root = Path(folder) / "training"
    write_kitti(cloud_path("kitti", folder, frame), cloud)
    if cloud.has_truth:
        _write_text(root / "label_2" / f"{frame:06d}.txt", kitti_lines(cloud, scene))
    _write_text(root / "calib" / f"{frame:06d}.txt", kitti_calibration().splitlines())


def write_sequence_frame(
    folder: str | os.PathLike[str], frame: int, cloud: PointCloud, scene: Scene, *, sequence: str = "00"
) -> None:
    """Write frame number ``frame`` (from 0) of a sequence, without labels where the cloud has no truth."""
    root = Path(folder) / "dataset"
    here = root / "sequences" / sequence
    place = sensor_place(cloud)
    write_kitti(cloud_path("semantickitti", folder, frame, sequence=sequence), cloud)
    if cloud.has_truth:
        labels = semantic_kitti(cloud, scene)
        (here / "labels").mkdir(parents=True, exist_ok=True)
        with atomic_output(here / "labels" / f"{frame:06d}.label") as temporary:
            labels.tofile(temporary)
    # The odometry data set knows only the cameras and the way from the lidar to the first of them.
    cameras = [line for line in kitti_calibration().splitlines() if line.startswith("P")]
    lidar = next(line for line in kitti_calibration().splitlines() if line.startswith("Tr_velo"))
    _write_text(here / "calib.txt", [*cameras, lidar.replace("Tr_velo_to_cam", "Tr")])
    _write_line(here / "times.txt", frame, f"{float(cloud.metadata.get('frame_start_s', 0.0)):.9e}")
    for poses in (here / "poses.txt", root / "poses" / f"{sequence}.txt"):
        _write_line(poses, frame, camera_pose(place))


def camera_pose(place: Pose) -> str:
    """Where KITTI's camera stands: 12 numbers, a (3, 4) matrix row by row, world and camera with camera axes."""
    rotation = SENSOR_TO_CAMERA @ place.rotation @ SENSOR_TO_CAMERA.T
    rows = np.column_stack([rotation, SENSOR_TO_CAMERA @ place.position_m])
    return " ".join(f"{x:.12e}" for x in rows.ravel())


def _write_line(path: Path, frame: int, line: str) -> None:
    """Make this line number ``frame``, behind those that there are."""
    before = path.read_text(encoding="ascii").splitlines()[:frame] if frame and path.exists() else []
    if len(before) != frame:
        raise InputError(f"{path}: {frame} lines were expected before this frame, {len(before)} came")
    _write_text(path, [*before, line])


def _write_text(path: Path, lines: list[str]) -> None:
    with atomic_output(path) as temporary:
        temporary.write_text("".join(line + "\n" for line in lines), encoding="ascii")
