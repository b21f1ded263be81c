"""Write the labels of a frame in the format of a data set.

Loaders of KITTI, nuScenes and SemanticKITTI expect their own axes, classes and levels of visibility. Each format is
translated here, once, so that such a loader reads a simulated frame as it reads a real one.

kitti          text, one box a line, as in KITTI's `label_2`, in the camera of `CALIBRATION`
nuscenes       JSON: entries like those of nuScenes' `sample_annotation`, in the world frame, and the poses
semantickitti  uint32 for each point of the cloud, in its order: class below, instance above 16 bits
osi            a trace file of one GroundTruth (`lidarscene.labels.osi_truth`)
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..errors import InputError
from ..files.atomic import atomic_output, put_text
from ..files.json_text import json_text
from ..formats.osi import framed
from ..formats.registry import LABELS, format_of
from ..maths.arrays import Lanes, Mask, Numbers, xp
from ..maths.rotations import quaternion
from ..scene.scene import Scene
from .boxes import PIECE_POINTS, Box, CountedPoints, GatheredBoxes, sensor_place, truth_of, upright_size_and_yaw
from .kinds import MOVING, NOT_IN_KITTI, OUTLIER, UNLABELLED, kind_of
from .osi_truth import gathered_truth

Append = Callable[[PointCloud], None]

SENSOR_TO_CAMERA = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Source: KITTI; axes of its cameras (x right, y down, z forward) by those of the sensor; both have one origin here."""

PICTURE_PX = (1242, 375)

CAMERA = np.array([[720.0, 0.0, 621.0, 0.0], [0.0, 720.0, 187.5, 0.0], [0.0, 0.0, 1.0, 0.0]])
"""Choice: projection matrix of the camera in KITTI labels: lidarscene has no camera, so one with KITTI's field of view
stands in the sensor's place. With it loaders can project boxes and points, and grade boxes by their height in the
picture."""

DONT_CARE = "DontCare -1 -1 -10 0.00 0.00 0.00 0.00 -1 -1 -1 -1000 -1000 -1000 -10"
"""KITTI's line for a part of the picture that nobody labelled, here without area. A frame without a box has it alone:
OpenPCDet joins the rectangles of all lines, and fails where there are none (`KittiDataset.get_infos`)."""

NEAREST_M = 0.1
"""Choice: nearest depth [m] at which a box is projected: its corners behind the camera are brought there."""

OCCLUDED, UNKNOWN = ((0.8, 0), (0.4, 1), (0.0, 2)), 3
"""Choice: KITTI's levels of occlusion by the least visibility: fully visible, partly, largely; unknown without a
beam."""

VISIBILITY = ((0.8, "4"), (0.6, "3"), (0.4, "2"), (0.0, "1"))
"""Source: nuScenes; its bins of visibility by their lower bounds."""


def write_labels(
    cloud: PointCloud, scene: Scene, path: str | os.PathLike[str], *, format: str, all_around: bool = False
) -> tuple[Path, ...]:
    """Write the labels of a frame; returns the files, all of which appear whole or not at all.

    Args:
        path: where the cloud is or would be written: the labels are put beside it, by `label_paths`
        format: a key of `formats.registry.LABELS`
        all_around: whether KITTI's boxes are those outside the camera's picture too

    Raises:
        InputError: for a cloud without truth, or without the pose of its sensor
    """
    with labels_stream(path, scene, format=format, all_around=all_around) as append:
        append(cloud)
    return label_paths(path, format=format)


@contextmanager
def labels_stream(
    path: str | os.PathLike[str], scene: Scene, *, format: str, all_around: bool = False
) -> Iterator[Append]:
    """Write the labels of the clouds that are appended in the block, at least one, as those of one frame."""
    first, *further_paths = label_paths(path, format=format)
    options = {"all_around": all_around} if format == "kitti" else {}
    with _STREAMS[format](first, scene, **options) as append:
        yield append
    if further_paths:
        put_text(further_paths[0], kitti_calibration())


def label_paths(path: str | os.PathLike[str], *, format: str) -> tuple[Path, ...]:
    """Names of the files that `write_labels` puts beside this file of a cloud."""
    if format not in LABELS:
        raise InputError(f"labels '{format}': there are none; the choices are {', '.join(LABELS)}")
    stem = str(path)
    try:
        stem = stem[: -len(format_of(path).suffix)]
    except InputError:
        stem = str(Path(path).with_suffix(""))
    return tuple(Path(stem + suffix) for suffix in LABELS[format])


def kitti_calibration() -> str:
    """Text of KITTI's `calib` file for our camera: the same for every frame."""
    zero = np.zeros((3, 1))
    entries = {f"P{i}": CAMERA for i in range(4)} | {
        "R0_rect": np.eye(3),
        "Tr_velo_to_cam": np.hstack([SENSOR_TO_CAMERA, zero]),
        "Tr_imu_to_velo": np.hstack([np.eye(3), zero]),
    }
    return "".join(f"{name}: {' '.join(f'{x:.12e}' for x in matrix.ravel())}\n" for name, matrix in entries.items())


def point_labels(cloud: PointCloud, scene: Scene) -> tuple[Numbers, Numbers]:
    """Class and instance of each point: (n,) SemanticKITTI numbers, and (n,) body + 1 of a countable object, else 0.

    A point that is no echo (false alarm, interference, weather) is an outlier, so that a network learns what noise
    looks like; an echo without a body, or of the ego vehicle, is unlabelled.

    Raises:
        InputError: for a cloud without truth
    """
    tables = LabelTables.of_scene(scene, cloud.class_names)
    _, body = truth_of(cloud)
    semantic, instance = tables.labels(np.asarray(cloud.class_id), np.asarray(body), np.asarray(cloud.status))
    return semantic.astype(np.uint32), instance.astype(np.uint32)


@dataclass(frozen=True, slots=True, eq=False)
class LabelTables:
    """Tables of the labels of points, in NumPy or on the device; the last entry of each is that of index -1, and of
    bodies that the scene does not have.

    Attributes:
        classes: (classes + 1,) int32, SemanticKITTI's number of each class, and `_THING` where its bodies are counted
        bodies: (bodies + 1,) int32, number that a body has instead, or `_AS_CLASS`; negative: it is not counted
    """

    classes: Lanes
    bodies: Lanes

    @classmethod
    def of_scene(cls, scene: Scene, class_names: Sequence[str]) -> LabelTables:
        """Build for a scene, and the classes of a cloud of it."""
        kinds = [kind_of(name) for name in class_names]
        numbers = [*(kind.semantic_kitti + _THING * kind.is_thing for kind in kinds), UNLABELLED]
        bodies = np.full(len(scene.bodies) + 1, _AS_CLASS, np.int32)
        for index, body in enumerate(scene.bodies):
            if body.rides_with(scene.ego):
                # As with boxes: a network is to learn what the vehicle meets, not its own roof.
                bodies[index] = -1 - UNLABELLED
            elif body.moves:
                bodies[index] = MOVING.get(kind_of(body.class_name).semantic_kitti, _AS_CLASS)
        return cls(np.array(numbers, np.int32), bodies)

    def labels(self, class_id: Lanes, body: Lanes, status: Lanes) -> tuple[Any, Any]:
        """Class and instance of each point as `point_labels`, (n,) int32."""
        ops = xp(class_id)
        kinds = ops.take(self.classes, ops.where(class_id < 0, ops.width(self.classes) - 1, class_id))
        own = self._of_body(body)
        is_echo, is_thing = status == 0, kinds >= _THING
        of_class = kinds - ops.where(is_thing, _THING, 0)
        semantic = ops.where(own == _AS_CLASS, of_class, ops.where(own < 0, -1 - own, own))
        instance = ops.where(is_echo & is_thing & (own >= 0), body + 1, 0)
        return ops.where(is_echo, semantic, OUTLIER), instance

    def is_own(self, body: Lanes) -> Mask:
        """Whether a body is of the ego vehicle, (n,)."""
        own: Mask = self._of_body(body) < 0
        return own

    def _of_body(self, body: Lanes) -> Any:
        ops, last = xp(body), xp(body).width(self.bodies) - 1
        return ops.take(self.bodies, ops.where((body < 0) | (body > last), last, body))


_THING, _AS_CLASS = 1 << 16, 1 << 17


def semantic_kitti(cloud: PointCloud, scene: Scene) -> Numbers:
    """(n,) uint32: class in the lower 16 bits, instance in the upper; instances from 65536 on begin again."""
    return np.asarray(label_words(*point_labels(cloud, scene)), "<u4")


def label_words(semantic: Any, instance: Any) -> Any:
    """(n,) words of `semantic_kitti`, of the type of the instances."""
    # What is at most 65,535 is not divided: processors divide whole numbers one by one.
    ops = xp(instance)
    short = ops.where(instance > 0xFFFF, (instance - 1) % 0xFFFF + 1, instance)
    return semantic | short << 16


def _kitti_line(box: Box) -> str:
    """Line of a box in the sensor's frame."""
    (length, width, height), yaw = upright_size_and_yaw(box)
    bottom = box.pose.position_m - [0.0, 0.0, 0.5 * height]
    x, y, z = SENSOR_TO_CAMERA @ bottom
    rotation_y = _wrap_angle(-yaw - 0.5 * math.pi)
    alpha = _wrap_angle(rotation_y - math.atan2(x, z))
    (left, top, right, bottom_px), truncated = _picture_box(box)
    occluded = next((level for least, level in OCCLUDED if box.visibility >= least), UNKNOWN)
    return (
        f"{kind_of(box.class_name).kitti} {truncated:.2f} {occluded if box.beams else UNKNOWN} {alpha:.4f} "
        f"{left:.2f} {top:.2f} {right:.2f} {bottom_px:.2f} {height:.4f} {width:.4f} {length:.4f} "
        f"{x:.4f} {y:.4f} {z:.4f} {rotation_y:.4f}"
    )


def _picture_box(box: Box) -> tuple[tuple[float, float, float, float], float]:
    """Left, top, right, bottom of the box in the picture, pixels, and the share of it that is outside."""
    corners = box.corners_m() @ SENSOR_TO_CAMERA.T
    if corners[:, 2].max() < NEAREST_M:
        return (0.0, 0.0, 0.0, 0.0), 1.0
    depth = np.maximum(corners[:, 2:], NEAREST_M)
    corners_px = (corners[:, :2] * CAMERA[0, 0] + CAMERA[:2, 2] * depth) / depth
    low, high = corners_px.min(axis=0), corners_px.max(axis=0)
    limit = np.array(PICTURE_PX) - 1.0
    inner_low, inner_high = low.clip(0, limit), high.clip(0, limit)
    if (inner_low >= inner_high).any():  # beside the picture
        return (0.0, 0.0, 0.0, 0.0), 1.0
    inside_share = float(np.prod(inner_high - inner_low) / np.prod(np.maximum(high - low, 1e-9)))
    return (*inner_low.tolist(), *inner_high.tolist()), 1.0 - inside_share


def _wrap_angle(angle_rad: float) -> float:
    """Wrap an angle to [-pi, pi]."""
    return math.remainder(angle_rad, 2.0 * math.pi)


@contextmanager
def kitti_stream(
    path: Path, scene: Scene, *, all_around: bool = False
) -> Iterator[Callable[[PointCloud | CountedPoints], None]]:
    """Write a line for each box with a point: type, truncated, occluded, alpha, picture, size, place, rotation_y.

    KITTI labels what the picture shows, and no poles or signs. Without a box the only line is `DONT_CARE`.
    """
    with atomic_output(path) as temporary, GatheredBoxes(temporary.parent, scene) as gathered:
        yield gathered.append
        sensor_pose = sensor_place(gathered.first)
        boxes = [
            box.seen_from(sensor_pose) for box in gathered.boxes() if kind_of(box.class_name).kitti != NOT_IN_KITTI
        ]
        lines = [_kitti_line(box) for box in boxes if all_around or _picture_box(box)[1] < 1.0] or [DONT_CARE]
        temporary.write_text("".join(line + "\n" for line in lines), encoding="utf-8")


@contextmanager
def semantic_kitti_stream(path: Path, scene: Scene) -> Iterator[Append]:
    """Write the labels of `semantic_kitti` for each point."""
    with atomic_output(path) as temporary, open(temporary, "wb") as file:

        def append(cloud: PointCloud) -> None:
            for first in range(0, len(cloud), PIECE_POINTS):
                file.write(semantic_kitti(cloud.select(slice(first, first + PIECE_POINTS)), scene).data)

        yield append


@contextmanager
def _nuscenes_stream(path: Path, scene: Scene) -> Iterator[Append]:
    with atomic_output(path) as temporary, GatheredBoxes(temporary.parent, scene) as gathered:
        yield gathered.append
        sensor_pose = sensor_place(gathered.first)
        content = {
            "scene": scene.name,
            "sensor": gathered.first.metadata.get("sensor", ""),
            "num_lidar_pts": gathered.points,
            # Position and quaternion (w, x, y, z) of the lidar in the world, in which the boxes are.
            "lidar_to_world": {
                "translation": sensor_pose.position_m.tolist(),
                "rotation": list(quaternion(sensor_pose.rotation)),
            },
            "sample_annotations": [nuscenes_annotation(box) for box in gathered.boxes()],
        }
        temporary.write_text(json_text(content, indent=1) + "\n", encoding="utf-8")


def nuscenes_annotation(box: Box) -> dict[str, Any]:
    """Entry of a box in the world, like those of nuScenes' `sample_annotation`."""
    length, width, height = box.size_m.tolist()
    return {
        "instance_name": box.name,
        "category_name": kind_of(box.class_name).nuscenes,
        "class_name": box.class_name,
        "body": box.body,
        "translation": box.pose.position_m.tolist(),
        "size": [width, length, height],
        "rotation": list(quaternion(box.pose.rotation)),
        "velocity": box.velocity_m_s.tolist(),
        "num_lidar_pts": box.points_inside,
        "num_body_pts": box.points_on,
        "visibility": round(box.visibility, 4),
        "visibility_token": next(token for least, token in VISIBILITY if box.visibility >= least),
    }


@contextmanager
def _osi_stream(path: Path, scene: Scene) -> Iterator[Append]:
    with atomic_output(path) as temporary, GatheredBoxes(temporary.parent, scene, whole=True) as gathered:
        yield gathered.append
        truth = gathered_truth(gathered, scene)
        temporary.write_bytes(framed(truth.fields(gathered.first.frame_start_s)))


_STREAMS: dict[str, Callable[..., AbstractContextManager[Append]]] = {
    "kitti": kitti_stream,
    "nuscenes": _nuscenes_stream,
    "semantickitti": semantic_kitti_stream,
    "osi": _osi_stream,
}
