"""Rows of points as the files of KITTI's data sets hold them, of a cloud or computed where the points are.

SemanticKITTI's files have 20 of the some 110 bytes of a point; of KITTI's some 20 more are counted in boxes. On the
device the points are freed from the sensor's motion, turned into its frame and labelled, and these bytes alone are
copied.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..cloud.deskew import MOTION_REMOVED, Deskewing
from ..cloud.device_cloud import DeviceCloud
from ..cloud.point_cloud import PointCloud
from ..formats.kitti import kitti_rows
from ..kernel.device import transfer
from ..kernel.device.gate import exclusive
from ..kernel.rays.device_columns import copy_rows
from ..maths.arrays import Numbers, xp
from ..maths.motion_table import Placement
from ..scene.scene import Scene
from .boxes import CountedPoints
from .files import LabelTables, label_words, semantic_kitti

OF_ROWS = "kitti", "semantickitti"
"""Data sets whose files are made of `PointRows`."""


@dataclass(frozen=True, slots=True, eq=False)
class PointRows:
    """Some points of a frame.

    Attributes:
        rows: (n, 4) float32: x, y and z in the sensor's frame [m], intensity
        labels: (n,) uint32, as of `labels.files.semantic_kitti`; in KITTI what its boxes are counted of
        cloud: names and metadata, without points
    """

    rows: Numbers
    labels: Numbers | CountedPoints
    cloud: PointCloud

    @classmethod
    def of_cloud(cls, cloud: PointCloud, scene: Scene, dataset: str) -> PointRows:
        """Compute them in NumPy.

        Raises:
            InputError: for a cloud without truth
        """
        labels = CountedPoints.of_cloud(cloud) if dataset == "kitti" else semantic_kitti(cloud, scene)
        return cls(kitti_rows(cloud, ("intensity",)), labels, cloud.without_points())


class DeviceRows:
    """Reader of the rows of points that are on the device: those of one frame, piece by piece."""

    @exclusive
    def __init__(
        self, scene: Scene, class_names: Sequence[str], deskewing: Deskewing | None, *, dataset: str, own_car: bool
    ) -> None:
        """Upload what the points have in common.

        Args:
            class_names: of the frame's clouds
            deskewing: frees the points from the sensor's motion; None: they keep it
            dataset: key of `formats.registry.DATASETS`
            own_car: whether points on the ego vehicle are among them
        """
        tables = LabelTables.of_scene(scene, class_names)
        self._dataset, self._own_car = dataset, own_car
        numbers = np.asarray(tables.classes), np.asarray(tables.bodies)
        self._tables = LabelTables(*map(transfer.whole_numbers, numbers))
        self._deskewing = transfer.opaque(deskewing, double=True)

    @exclusive
    def __call__(self, cloud: DeviceCloud) -> PointRows | None:
        """Compute the rows of some points, at least one, and copy them; None where all are on the ego vehicle."""
        columns = cloud.columns
        if not self._own_car:
            columns = columns.select(~self._tables.is_own(columns.array("body")))
            if not columns.count:
                return None
        removed = {} if self._deskewing is None else {"ego_motion": MOTION_REMOVED}
        described = cloud.without_points(**removed)
        sensor = transfer.opaque(Placement.of_pose(described.sensor_place), double=True)
        points_m, time_s = columns.positions(), columns.array("time_s")
        ops = xp(time_s)
        if self._deskewing is not None:
            x, y, z = self._deskewing.points(points_m, self._deskewing.paths.placement(time_s, 0))
            # A deskewed cloud would hold them so.
            if not columns.is_far:
                x, y, z = (ops.float64(ops.float32(axis)) for axis in (x, y, z))
            points_m = x, y, z
        rows = [*map(ops.float32, sensor.point_within(points_m)), columns.array("intensity")]
        body, status = columns.array("body"), ops.int32(columns.array("status"))
        if self._dataset == "kitti":
            places = points_m if columns.is_far else tuple(map(ops.float32, points_m))
            beyond_m = columns.array("true_range_m") - columns.array("range_m")
            tables = [[time_s], places, rows, [beyond_m], [body], [status]]
            times, xyz, points, *others = copy_rows(tables)
            beyond, of_body, statuses = (words[:, 0] for words in others)
            counted = CountedPoints(
                cloud=described,
                columns=(
                    xyz.view(np.float64 if columns.is_far else np.float32),
                    beyond.view(np.float32),
                    of_body.view(np.int32),
                    statuses.astype(np.uint8),
                    np.zeros(len(xyz), np.uint8),
                ),
                time_s=times.view(np.float64)[:, 0],
            )
            return PointRows(points.view(np.float32), counted, described)
        labels = label_words(*self._tables.labels(columns.array("class_id"), body, status))
        points, words = copy_rows([rows, [labels]])
        return PointRows(points.view(np.float32), words[:, 0], described)
