"""3D boxes of the bodies that can be counted, and how much of each the cloud shows.

Detectors are trained on boxes. A box follows its body's own axes: length along the axis that is forward, width to the
left, height along the axis nearest to up. Its pose is position and rotation of its centre, in the world or seen from
the sensor.

If a body moves, or if the points contain the sensor's own motion, no single pose is right for a whole frame. The box is
then where the cloud shows the body: as seen from the sensor at the mean time of the body's points.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..errors import InputError
from ..files.spool import Spool
from ..formats.cloud_columns import frame_starts_s, sensor_positions_m
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.trajectory import pose_at
from ..scene.scene import Ball, Body, Part, Scene
from .kinds import kind_of

PIECE_POINTS = 1 << 20
PICOSECOND = 1e-12
STOPPED_M = 0.05
"""Tolerance for a beam that reaches a box: one that ends less than this before the box only has an error of range."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Box:
    """The box around a body.

    body           index into the scene's bodies, as in the cloud's column
    size_m         (3,) length, width, height
    pose           pose of the centre; x along the length, y along the width
    velocity_m_s   (3,) velocity of the centre in the world
    points_inside  number of points inside the box, of any body
    points_on      number of echoes of the body itself
    beams          number of echoes whose beams would enter the box if nothing stopped them
    reached        number of those that nothing stopped before the box
    """

    body: int
    name: str
    class_name: str
    size_m: Numbers
    pose: Pose
    velocity_m_s: Numbers = field(default_factory=lambda: np.zeros(3))
    points_inside: int = 0
    points_on: int = 0
    beams: int = 0
    reached: int = 0

    @property
    def has_points(self) -> bool:
        """True if the cloud has points in the box or on its body."""
        return self.points_inside > 0 or self.points_on > 0

    @property
    def visibility(self) -> float:
        """Share of the beams that nothing stopped before the box; 0 without beams."""
        return self.reached / self.beams if self.beams else 0.0

    def corners_m(self) -> Numbers:
        """(8, 3) corners, in the frame of the pose."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return self.pose.apply(0.5 * self.size_m * signs)

    def seen_from(self, observer: Pose) -> Box:
        """Transform the box to the frame of an observer, whose pose is in the same frame as the box's."""
        rotation = observer.rotation.T @ self.pose.rotation
        position = observer.inverse_apply(self.pose.position_m[None])[0]
        return replace(self, pose=Pose(position_m=position, rotation=rotation))


def boxes(cloud: PointCloud, scene: Scene, *, as_seen: bool = True) -> list[Box]:
    """Box of every body that can be counted, in the world frame, with counts of the points and beams on it.

    as_seen  place moving bodies where the cloud shows them; False: where they are when the frame starts
    Bodies of a Mitsuba base scene have no box: their shapes are not known here. Raises InputError for a cloud
    without truth, or without the pose of its sensor.
    """
    tally = BoxTally(cloud, scene, as_seen=as_seen)
    pieces = [slice(first, first + PIECE_POINTS) for first in range(0, len(cloud), PIECE_POINTS)]
    for piece in pieces:
        tally.add_echoes(cloud.select(piece))
    tally.place_boxes()
    for piece in pieces:
        piece_cloud = cloud.select(piece)
        tally.count_points(piece_cloud.xyz_m, truth_of(piece_cloud)[0], piece_cloud.status, piece_cloud.sensor_index)
    return tally.boxes()


class BoxTally:
    """`boxes` of a frame that comes in pieces: `add_echoes` for all, `place_boxes`, `count_points` for all, `boxes`.

    moves  True if something moves: the places of the boxes are then known only after all pieces. If not, `place_boxes`
           may come first, so that each piece can be added, counted and dropped
    """

    def __init__(self, cloud: PointCloud, scene: Scene, *, as_seen: bool = True) -> None:
        """Begin a tally; ``cloud`` is any piece of the frame, whose names and metadata are used."""
        truth_of(cloud)
        self._to_world = frame_to_world(cloud)
        self._origins_m = self._to_world.apply(sensor_positions_m(cloud.metadata))
        starts_s = frame_starts_s(cloud.metadata)
        self._starts_s = np.resize(starts_s, len(self._origins_m))  # one for each sensor, or one for all
        # Otherwise points are placed as if the sensor had stood still.
        self._ego = scene.ego if cloud.metadata.get("ego_motion") == "in the points" else None
        self._things = [
            (index, body)
            for index, body in enumerate(scene.bodies)
            if kind_of(body.class_name).is_thing and body.parts and not body.away
        ]
        moving = self._ego is not None or any(body.motion is not None for _, body in self._things)
        self.moves = as_seen and moving
        self._points_on = np.zeros((len(self._things), len(self._starts_s)), np.int64)  # by sensor
        self._time_ps = [0] * len(self._things)  # whole numbers: a sum that does not depend on the pieces
        self._boxes: list[Box] = []

    def add_echoes(self, cloud: PointCloud) -> None:
        """Count the echoes of each body, and add up their times."""
        _, body_index = truth_of(cloud)
        is_echo, sensors = cloud.status == 0, len(self._starts_s)
        for number, (index, _) in enumerate(self._things):
            echoes = np.flatnonzero((body_index == index) & is_echo)
            self._points_on[number] += np.bincount(cloud.sensor_index[echoes], minlength=sensors)
            if self.moves:
                self._time_ps[number] += int(np.rint(cloud.time_s[echoes] / PICOSECOND).astype(np.int64).sum())

    def place_boxes(self) -> None:
        """Place the boxes at the mean time of their bodies' points."""
        for number, (index, body) in enumerate(self._things):
            points = max(int(self._points_on[number].sum()), 1)
            later_s = self._points_on[number] @ (self._starts_s - self._starts_s[0]) / points
            since_s = self._time_ps[number] * PICOSECOND / points
            self._boxes.append(self._box_at(body, index, float(self._starts_s[0] + later_s), since_s))

    def count_points(self, xyz_m: Numbers, true_range_m: Numbers, status: Numbers, sensor_index: Numbers) -> None:
        """Count points and beams in the boxes; columns of a cloud."""
        world_m = np.ascontiguousarray(self._to_world.apply(xyz_m.astype(np.float64)).T)
        sensors = _Beams.from_points(world_m, self._origins_m, true_range_m, status, sensor_index)
        for number, box in enumerate(self._boxes):
            counts = [sensor.count_entering(box) for sensor in sensors]
            entering, reaching = (sum(sensor_counts[i] for sensor_counts in counts) for i in (0, 1))
            self._boxes[number] = replace(
                box,
                points_inside=box.points_inside + _count_inside(box, world_m),
                beams=box.beams + entering,
                reached=box.reached + reaching,
            )

    def boxes(self) -> list[Box]:
        """Boxes with all counts."""
        return [
            replace(box, points_on=int(points_on.sum()))
            for box, points_on in zip(self._boxes, self._points_on, strict=True)
        ]

    def _box_at(self, body: Body, index: int, start_s: float, since_s: float) -> Box:
        """Return the box of a body ``since_s`` after a frame's start, where the cloud shows it."""
        box = box_of(body, index)
        if body.motion is not None:
            # The box that the body has by its pose, carried along.
            carried = body.pose.inverse() @ box.pose
            states = body.motion.at(np.clip([start_s + since_s], *body.motion.span_s)) @ carried
            box = replace(box, pose=states.pose(), velocity_m_s=states.velocity_m_s[0])
        if self._ego is not None:
            # As seen from the sensor then, but placed from its pose at the start of the frame.
            ego_at_start, ego_then = pose_at(self._ego, start_s), pose_at(self._ego, start_s + since_s)
            box = replace(box, pose=ego_at_start @ ego_then.inverse() @ box.pose)
        return box


class GatheredBoxes:
    """Boxes of one frame that comes in clouds, at least one, in memory that does not grow with the frame.

    If something moves, the place of a box is known only when all its points have come, and only then can the points
    inside be counted. Until then the points are stored on disk.

    first   the first cloud, without its points
    points  number of points of all clouds
    """

    first: PointCloud

    def __init__(self, folder: str | os.PathLike[str], scene: Scene, *, as_seen: bool = True) -> None:
        """Begin a frame; points are stored in ``folder`` if something moves."""
        self._folder, self._scene, self._as_seen = folder, scene, as_seen
        self._tally: BoxTally | None = None
        self._spool: Spool | None = None
        self.points = 0

    def __enter__(self) -> GatheredBoxes:
        return self

    def __exit__(self, *_: object) -> None:
        if self._spool is not None:
            self._spool.__exit__()

    def append(self, cloud: PointCloud) -> None:
        """Add the points of a cloud."""
        if self._tally is None:
            self._begin(cloud)
        self.points += len(cloud)
        for first in range(0, len(cloud), PIECE_POINTS):
            self._add(cloud.select(slice(first, first + PIECE_POINTS)))

    def boxes(self) -> list[Box]:
        """Boxes of all clouds that were appended; call it once."""
        assert self._tally is not None
        if self._spool is not None:
            self._tally.place_boxes()
            for rows in self._spool.blocks():
                xyz_m = np.stack([rows["x"], rows["y"], rows["z"]], axis=-1)
                self._tally.count_points(xyz_m, rows["true_range"], rows["status"], rows["sensor_index"])
        return self._tally.boxes()

    def _begin(self, cloud: PointCloud) -> None:
        self.first = cloud.without_points()
        self._tally = BoxTally(cloud, self._scene, as_seen=self._as_seen)
        if self._tally.moves:
            position: list[tuple[str, Any]] = [(axis, cloud.xyz_m.dtype) for axis in "xyz"]
            row = [*position, ("true_range", "f4"), ("status", "u1"), ("sensor_index", "u1")]
            self._spool = Spool(self._folder, row)
        else:
            self._tally.place_boxes()

    def _add(self, cloud: PointCloud) -> None:
        assert self._tally is not None
        self._tally.add_echoes(cloud)
        if self._spool is None:
            self._tally.count_points(cloud.xyz_m, truth_of(cloud)[0], cloud.status, cloud.sensor_index)
            return
        self._spool.append(
            **dict(zip("xyz", cloud.xyz_m.T, strict=True)),
            true_range=truth_of(cloud)[0],
            status=cloud.status,
            sensor_index=cloud.sensor_index,
        )


def truth_of(cloud: PointCloud) -> tuple[Numbers, Numbers]:
    """(n,) true range and (n,) index of the body of each point. Raises InputError for a cloud without truth."""
    if cloud.true_range_m is None or cloud.body is None:
        raise InputError("labels: the cloud has no truth, from which they are made")
    return cloud.true_range_m, cloud.body


def sensor_place(cloud: PointCloud) -> Pose:
    """Pose of the sensor in the world. Raises InputError if the cloud lacks it."""
    return _require_pose(cloud.sensor_to_world)


def frame_to_world(cloud: PointCloud) -> Pose:
    """Pose of the frame of the points in the world. Raises InputError if the cloud lacks it."""
    return _require_pose(cloud.frame_to_world)


def _require_pose(pose: Pose | None) -> Pose:
    if pose is None:
        raise InputError("labels: the cloud does not say how its sensor stood (metadata 'sensor_to_world')")
    return pose


def box_of(body: Body, index: int) -> Box:
    """Box of a body at its pose in the scene, in the world frame."""
    low, high = _extent_m(body)
    axes = _axes(body.pose.rotation).T
    return Box(
        body=index,
        name=body.name,
        class_name=body.class_name,
        size_m=np.abs(axes.T @ (high - low)),
        pose=body.pose @ Pose(position_m=0.5 * (low + high), rotation=axes),
    )


def upright_size_and_yaw(box: Box) -> tuple[Numbers, float]:
    """Return (length, width, height) and yaw in radians of the smallest upright box around this one.

    For formats without other rotations. An upright box keeps its size.
    """
    forward = box.pose.rotation[:, 0]
    yaw = float(np.arctan2(forward[1], forward[0]))
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return np.ptp(box.corners_m() @ about_z, axis=0), yaw


def _extent_m(body: Body) -> tuple[Numbers, Numbers]:
    """(3,) least and (3,) largest coordinates of a body in its own frame."""
    outlines_m = [_outline_m(part) for part in body.parts]
    low_m, high_m = ([reduce(outline_m, axis=0) for outline_m in outlines_m] for reduce in (np.min, np.max))
    return np.min(low_m, axis=0), np.max(high_m, axis=0)


def _outline_m(part: Part | Ball) -> Numbers:
    if isinstance(part, Ball):
        return np.array([[-part.radius_m] * 3, [part.radius_m] * 3])
    return part.vertices_m


def _axes(rotation: Numbers) -> Numbers:
    """(3, 3) rows forward, left and up of a body, each along one axis of the body's frame.

    Up is the axis nearest to the world's z; forward is its own x, or y where x is up.
    """
    up = int(np.argmax(np.abs(rotation[2])))
    axes = np.eye(3)
    upward = axes[up] * (1.0 if rotation[2, up] >= 0 else -1.0)
    forward = axes[1] if up == 0 else axes[0]
    return np.stack([forward, np.cross(upward, forward), upward])


def _count_inside(box: Box, xyz_m: Numbers) -> int:
    """Number of the (3, n) points that are inside the box, in the frame of its pose."""
    half = np.abs(box.corners_m() - box.pose.position_m).max(axis=0)
    candidates = np.arange(xyz_m.shape[1])
    for values, centre, reach in zip(xyz_m, box.pose.position_m, half, strict=True):
        candidates = candidates[np.abs(values[candidates] - centre) <= reach]
    local = box.pose.inverse_apply(xyz_m[:, candidates].T)
    return int((np.abs(local) <= 0.5 * box.size_m).all(axis=1).sum())


@dataclass(frozen=True, slots=True, eq=False)
class _Beams:
    """Beams of one sensor that have an echo: directions (3, k), and distances to the surface that they met (k,)."""

    origin_m: Numbers
    direction: Numbers
    end_m: Numbers

    @staticmethod
    def from_points(
        world_m: Numbers, origins_m: Numbers, true_range_m: Numbers, status: Numbers, sensor_index: Numbers
    ) -> list[_Beams]:
        """Beams of each sensor at ``origins_m`` (sensors, 3) to the points at ``world_m`` (3, n)."""
        beams = []
        for index, origin_m in enumerate(origins_m):
            of_sensor = (status == 0) & (sensor_index == index)
            vectors_m = world_m[:, of_sensor] - origin_m[:, None]
            length_m = np.sqrt((vectors_m**2).sum(axis=0))
            has_length = length_m > 0
            beams.append(
                _Beams(origin_m, vectors_m[:, has_length] / length_m[has_length], true_range_m[of_sensor][has_length])
            )
        return beams

    def count_entering(self, box: Box) -> tuple[int, int]:
        """Numbers of beams that would enter the box if nothing stopped them, and of those that reach it."""
        candidates = self._towards(box)
        start = box.pose.inverse_apply(self.origin_m[None]).T
        direction = box.pose.rotation.T @ self.direction[:, candidates]
        direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
        # Slab method: a line is inside a box between its last entry and its first exit of the three pairs of planes.
        half = 0.5 * box.size_m[:, None]
        low_m, high_m = (-half - start) / direction, (half - start) / direction
        enter_m = np.minimum(low_m, high_m).max(axis=0, initial=0.0)
        meets = enter_m <= np.maximum(low_m, high_m).min(axis=0)
        reaches = meets & (self.end_m[candidates] >= enter_m - STOPPED_M)
        return int(meets.sum()), int(reaches.sum())

    def _towards(self, box: Box) -> Numbers:
        """Indices of the beams in the cone around the box: no other can enter it."""
        x, y, z = box.pose.position_m - self.origin_m
        distance_squared, radius = float(x * x + y * y + z * z), 0.5 * float(np.linalg.norm(box.size_m))
        if distance_squared <= radius**2:
            return np.arange(len(self.end_m))
        along_m = self.direction[0] * x + self.direction[1] * y + self.direction[2] * z
        return np.flatnonzero(along_m >= np.sqrt(distance_squared - radius**2))
