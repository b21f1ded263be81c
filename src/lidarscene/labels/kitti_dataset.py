"""Write data sets in KITTI's folders, frame by frame.

`frame_stream` fills `training/velodyne`, `label_2`, `calib` and `image_2` (3D object detection), or
`dataset/sequences/00` and `dataset/poses` (odometry and SemanticKITTI). A frame's files do not depend on the others,
but `times.txt` and `poses.txt` have a line for each frame so far: frames are written in order, or `write_sequences`
writes them at the end.
"""

from __future__ import annotations

import functools
import io
import itertools
import operator
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..errors import InputError
from ..files.atomic import atomic_output, name_path_in_errors, put_text
from ..maths.pose import Pose
from ..scene.scene import Scene
from .boxes import PIECE_POINTS, sensor_place, truth_of
from .files import PICTURE_PX, SENSOR_TO_CAMERA, kitti_calibration, kitti_stream
from .point_rows import PointRows

Append = Callable[[PointCloud | PointRows], None]


def cloud_path(
    dataset: str, folder: str | os.PathLike[str], frame: int, *, sequence: str = "00", part: str = "training"
) -> Path:
    """Path of the cloud of this frame, in a data set of `formats.registry.DATASETS`.

    Args:
        sequence: folder of SemanticKITTI's sequence
        part: KITTI's folder, training or testing
    """
    parts = (part,) if dataset == "kitti" else ("dataset", "sequences", sequence)
    return Path(folder).joinpath(*parts, "velodyne", f"{frame:06d}.bin")


@contextmanager
def frame_stream(
    dataset: str,
    folder: str | os.PathLike[str],
    frame: int,
    scene: Scene,
    *,
    sequence: str = "00",
    all_around: bool = False,
    in_turn: Callable[[], object] = lambda: None,
) -> Iterator[Append]:
    """Write the clouds that are appended in the block, at least one, as a frame of a data set (`DATASETS`).

    Args:
        frame: number of the frame, from 0
        all_around: whether KITTI's boxes are those outside the camera's picture too
        in_turn: waits until all earlier frames have their lines in files that have one for each

    Raises:
        InputError: for a cloud without truth, of which the labels are made
    """
    clouds = cloud_path(dataset, folder, frame, sequence=sequence)
    with files_stream(dataset, clouds, scene, all_around=all_around) as (append, first):
        yield append
    if dataset != "kitti":
        in_turn()
        _write_sequence(Path(folder) / "dataset", clouds.parents[1], frame, first[0])


@contextmanager
def files_stream(
    dataset: str, clouds: Path, scene: Scene, *, all_around: bool = False
) -> Iterator[tuple[Append, list[PointCloud]]]:
    """Write the files of a frame that no other frame has a part in: its cloud, its labels, and KITTI's calibration.

    Args:
        clouds: path of the cloud (`cloud_path`)
        all_around: as of `frame_stream`

    Yields:
        the function that appends clouds, and a list that the first of them enters, without its points
    """
    first: list[PointCloud] = []
    with ExitStack() as streams:
        appended: list[Callable[..., None]] = []

        def append(piece: PointCloud | PointRows) -> None:
            cloud = piece if isinstance(piece, PointCloud) else piece.cloud
            if not first:
                truth_of(cloud)
                first.append(cloud.without_points())
                paths = frame_files(dataset, clouds)[:2]
                opened: list[AbstractContextManager[Callable[..., Any]]] = [*map(_bytes_stream, paths)]
                if dataset == "kitti":
                    opened[1] = kitti_stream(paths[1], scene, all_around=all_around)
                appended.extend(map(name_path_in_errors, paths, map(streams.enter_context, opened)))
            append_rows, append_labels = appended
            for rows in _rows_of(piece, scene, dataset):
                append_rows(rows.rows.data)
                append_labels(rows.labels)

        yield append, first
    if dataset == "kitti":
        _write_text(clouds.parents[1] / "calib" / f"{clouds.stem}.txt", kitti_calibration().splitlines())
        _write_picture(clouds.parents[1] / "image_2" / f"{clouds.stem}.png")


def _rows_of(piece: PointCloud | PointRows, scene: Scene, dataset: str) -> Iterator[PointRows]:
    """Iterate over the rows of a piece of a frame."""
    if isinstance(piece, PointRows):
        yield piece
        return
    for first in range(0, max(len(piece), 1), PIECE_POINTS):  # a frame without points has files, too
        yield PointRows.of_cloud(piece.select(slice(first, first + PIECE_POINTS)), scene, dataset)


@contextmanager
def _bytes_stream(path: Path) -> Iterator[Callable[..., object]]:
    with atomic_output(path) as temporary, open(temporary, "wb") as file:
        yield file.write


def frame_files(dataset: str, clouds: Path) -> tuple[Path, ...]:
    """Files of `files_stream` by the path of the cloud, which is the first."""
    folder, stem = clouds.parents[1], clouds.stem
    if dataset == "kitti":
        further = (("label_2", ".txt"), ("calib", ".txt"), ("image_2", ".png"))
        return clouds, *(folder / name / f"{stem}{suffix}" for name, suffix in further)
    return clouds, folder / "labels" / f"{stem}.label"


@functools.cache
def _picture() -> bytes:
    """PNG of a black picture of the camera's size."""
    from PIL import Image

    file = io.BytesIO()
    Image.new("RGB", PICTURE_PX).save(file, format="PNG", optimize=True)
    return file.getvalue()


def _write_picture(path: Path) -> None:
    """Write the picture of a frame. There is no camera, but loaders open it to know its size."""
    with atomic_output(path, synced=False) as temporary:
        temporary.write_bytes(_picture())


def write_sequences(root: Path, frames: Iterable[tuple[str, float, Pose]]) -> None:
    """Write calibrations, times and poses of whole sequences.

    Args:
        root: folder `dataset`
        frames: sequence, time at which the frame starts [s] and pose of the sensor then, in order
    """
    for sequence, group in itertools.groupby(frames, key=operator.itemgetter(0)):
        folder, lines = root / "sequences" / sequence, [*group]
        _write_text(folder / "calib.txt", _sequence_calibration())
        _write_text(folder / "times.txt", [f"{time_s:.9e}" for _, time_s, _ in lines])
        for poses in (folder / "poses.txt", root / "poses" / f"{sequence}.txt"):
            _write_text(poses, [camera_pose(pose) for _, _, pose in lines])


def _sequence_calibration() -> list[str]:
    """Lines of a sequence's calibration, which has only the cameras and the lidar's place to the first."""
    cameras = [line for line in kitti_calibration().splitlines() if line.startswith("P")]
    lidar = next(line for line in kitti_calibration().splitlines() if line.startswith("Tr_velo"))
    return [*cameras, lidar.replace("Tr_velo_to_cam", "Tr")]


def _write_sequence(root: Path, folder: Path, frame: int, cloud: PointCloud) -> None:
    """Write calibration, time and pose of a frame of a sequence."""
    sensor_pose = sensor_place(cloud)
    if not frame or not (folder / "calib.txt").exists():
        _write_text(folder / "calib.txt", _sequence_calibration())
    _write_line(folder / "times.txt", frame, f"{cloud.frame_start_s:.9e}")
    for poses in (folder / "poses.txt", root / "poses" / f"{folder.name}.txt"):
        _write_line(poses, frame, camera_pose(sensor_pose))


def camera_pose(sensor_pose: Pose) -> str:
    """Pose of KITTI's camera: 12 numbers, a (3, 4) matrix row by row, with camera axes in world and camera."""
    rotation = SENSOR_TO_CAMERA @ sensor_pose.rotation @ SENSOR_TO_CAMERA.T
    rows = np.column_stack([rotation, SENSOR_TO_CAMERA @ sensor_pose.position_m])
    return " ".join(f"{x:.12e}" for x in rows.ravel())


def _write_line(path: Path, frame: int, line: str) -> None:
    """Write this line as number ``frame`` of a file, after those of the earlier frames."""
    text = path.read_text(encoding="ascii") if frame and path.exists() else ""
    lines = text.splitlines()
    if len(lines) < frame:
        raise InputError(f"{path}: must have {frame} lines before this frame, got {len(lines)}")
    if frame and len(lines) == frame and text.endswith("\n"):
        # To write all lines anew, and wait for the disk, would take a long run most of its time. The frame's files are
        # on the disk by now: a power failure may take the last lines, and then no line names a file that is not whole.
        name_path_in_errors(path, _append_line)(path, line)
    else:
        _write_text(path, [*lines[:frame], line])


def _append_line(path: Path, line: str) -> None:
    """Append a line, or nothing of it if there is no room."""
    rest = f"{line}\n".encode("ascii")
    with open(path, "ab", buffering=0) as file:
        size = file.tell()
        try:
            while rest:
                rest = rest[file.write(rest) :]
        except OSError:
            file.truncate(size)
            raise


def _write_text(path: Path, lines: list[str]) -> None:
    put_text(path, "".join(line + "\n" for line in lines))
