"""3D boxes of the bodies that can be counted, and how much of each the cloud shows.

Detectors are trained on boxes. A box follows its body's own axes: length along the axis that is forward, width to the
left, height along the axis nearest to up. Its pose is position and rotation of its centre, in the world or seen from
the sensor.

If a body moves, or if the points contain the sensor's own motion, no single pose is right for a whole frame. The box is
then where the cloud shows the body: as seen from the sensor at the mean time of the body's points. Around one who walks
it is as large as he is then.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..errors import InputError
from ..files.arguments import checks_arguments
from ..files.spool import Spool
from ..formats.cloud_columns import frame_starts_s, sensor_positions_m
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.trajectory import Riding, clipped, motion_in_frame, states_of
from ..scene.scene import Ball, Body, Part, Scene, box_of
from ..scene.scene_file import SceneChoice, load_scene
from .kinds import kind_of

PIECE_POINTS = 1 << 20
WAITING_POINTS = 1 << 20
"""Points of a frame, 22 MB, that wait in memory until the boxes are placed; those after them wait on disk."""


STOPPED_M = 0.05
"""Choice: tolerance for a beam that reaches a box: one that ends less than this before the box only has an error of
range."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Box:
    """The box around a body.

    Attributes:
        body: index into the scene's bodies, as in the cloud's column
        size_m: (3,) length, width, height
        pose: pose of the centre; x along the length, y along the width
        velocity_m_s: (3,) velocity of the centre in the world
        points_inside: number of points inside the box, of any body
        points_on: number of echoes of the body itself, those that came by a mirror among them
        points_within: number of echoes of the body inside the box
        beams: number of echoes whose beams would enter the box if nothing stopped them
        reached: number of those that nothing stopped before the box
    """

    body: int
    name: str
    class_name: str
    size_m: Numbers
    pose: Pose
    velocity_m_s: Numbers = field(default_factory=lambda: np.zeros(3))
    points_inside: int = 0
    points_on: int = 0
    points_within: int = 0
    beams: int = 0
    reached: int = 0

    @property
    def has_points(self) -> bool:
        """True if the box holds points of its body: data sets label no other."""
        return self.points_within > 0

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
        return boxes_seen_from([self], observer)[0]


def boxes_seen_from(boxes: Sequence[Box], observer: Pose) -> list[Box]:
    """`Box.seen_from` of several boxes, at least one."""
    positions_m, rotations = _places([box.pose for box in boxes])
    return _moved(boxes, observer.inverse_apply(positions_m), observer.rotation.T @ rotations)


def _places(poses: Sequence[Pose]) -> tuple[Numbers, Numbers]:
    """(n, 3) positions and (n, 3, 3) rotations of poses."""
    return np.stack([pose.position_m for pose in poses]), np.stack([pose.rotation for pose in poses])


def _moved(boxes: Sequence[Box], positions_m: Numbers, rotations: Numbers) -> list[Box]:
    """Boxes at other poses, (n, 3) positions and (n, 3, 3) rotations."""
    poses = (Pose(position_m=place_m, rotation=turn) for place_m, turn in zip(positions_m, rotations, strict=True))
    return [replace(box, pose=pose) for box, pose in zip(boxes, poses, strict=True)]


@checks_arguments
def boxes(cloud: PointCloud, scene: SceneChoice, *, as_seen: bool = True) -> list[Box]:
    """Box of every body that can be counted, in the world frame, with counts of the points and beams on it.

    The ego vehicle has none: data sets label what it meets.

    Bodies of a Mitsuba base scene have no box: their shapes are not known here.

    Args:
        scene: where the cloud was made, a `Scene`, its name or file
        as_seen: place moving bodies where the cloud shows them; False: where they are when the frame starts

    Raises:
        InputError: for a cloud without truth, or without the pose of its sensor
    """
    tally, points = BoxTally(cloud, load_scene(scene), as_seen=as_seen), CountedPoints.of_cloud(cloud)
    for piece in points.pieces():
        tally.add_echoes(piece)
    tally.place_boxes()
    for piece in points.pieces():
        tally.count_points(*piece.columns)
    return tally.boxes()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CountedPoints:
    """Some points of a frame: what boxes are placed by, and counted of.

    Attributes:
        cloud: names and metadata, without points
        columns: positions (n, 3), true range less reported, index of the body, status and index of the sensor, (n,)
            each
        time_s: (n,) as in `PointCloud`
    """

    cloud: PointCloud
    columns: tuple[Numbers, Numbers, Numbers, Numbers, Numbers]
    time_s: Numbers

    @classmethod
    def of_cloud(cls, cloud: PointCloud) -> CountedPoints:
        """Take the columns of a cloud.

        Raises:
            InputError: for a cloud without truth
        """
        true_range_m, body = truth_of(cloud)
        columns = cloud.xyz_m, true_range_m - cloud.range_m, body, cloud.status, cloud.sensor_index
        return cls(cloud=cloud.without_points(), columns=columns, time_s=cloud.time_s)

    def __len__(self) -> int:
        return len(self.time_s)

    def pieces(self) -> Iterator[CountedPoints]:
        """Iterate over pieces of `PIECE_POINTS` points."""
        for first in range(0, len(self), PIECE_POINTS):
            rows = slice(first, first + PIECE_POINTS)
            xyz_m, beyond_m, body, status, sensor_index = (column[rows] for column in self.columns)
            columns = xyz_m, beyond_m, body, status, sensor_index
            yield replace(self, columns=columns, time_s=self.time_s[rows])


class BoxTally:
    """`boxes` of a frame that comes in pieces: `add_echoes` for all, `place_boxes`, `count_points` for all, `boxes`.

    Attributes:
        moves: True if something moves: the places of the boxes are then known only after all pieces. If not,
            `place_boxes` may come first, so that each piece can be added, counted and dropped
    """

    def __init__(self, cloud: PointCloud, scene: Scene, *, as_seen: bool = True, with_ego: bool = False) -> None:
        """Begin a tally; ``cloud`` is any piece of the frame, whose names and metadata are used.

        Args:
            with_ego: whether bodies of the ego vehicle have a box too
        """
        truth_of(cloud)
        self._to_world = frame_to_world(cloud)
        self._origins_m = sensor_positions_m(cloud.metadata)
        starts_s = frame_starts_s(cloud.metadata)
        self._starts_s = np.resize(starts_s, len(self._origins_m))  # one for each sensor, or one for all
        # Otherwise points are placed as if the sensor had stood still.
        self._ego = scene.ego if cloud.metadata.get("ego_motion") == "in the points" else None
        self._things = [
            (index, body)
            for index, body in enumerate(scene.bodies)
            if kind_of(body.class_name).is_thing
            and any(isinstance(part, Ball) or len(part.vertices_m) for part in _boxed(body.parts))
            and any(body.is_present(start_s) for start_s in starts_s)
            and (with_ego or not body.rides_with(scene.ego))
        ]
        moving = self._ego is not None or any(body.motion is not None for _, body in self._things)
        self.moves = as_seen and moving
        self._points_on = np.zeros((len(self._things), len(self._starts_s)), np.int64)  # by sensor
        self._time_ps = np.zeros(len(self._things), np.int64)  # whole: a sum that does not depend on the pieces
        self._place_of_body = np.full(len(scene.bodies) + 1, -1)  # the last entry is that of no body
        self._place_of_body[[index for index, _ in self._things]] = np.arange(len(self._things))
        self._boxes: list[Box] = []

    def add_echoes(self, points: CountedPoints) -> None:
        """Count the echoes of each body, and add up their times."""
        _, _, body_index, status, sensor_index = points.columns
        place = self._place_of_body[body_index]
        counted = np.flatnonzero((place >= 0) & (status == 0))
        place = place[counted]
        np.add.at(self._points_on, (place, sensor_index[counted]), 1)
        if self.moves:
            np.add.at(self._time_ps, place, np.rint(points.time_s[counted] / 1e-12).astype(np.int64))

    def place_boxes(self, *, seen_only: bool = False) -> None:
        """Place the boxes at the mean time of their bodies' points.

        Args:
            seen_only: leave out bodies without an echo: in a town two thirds
        """
        points = np.maximum(self._points_on.sum(axis=1), 1)
        starts_s = self._starts_s[0] + self._points_on @ (self._starts_s - self._starts_s[0]) / points
        seen_s = starts_s + self._time_ps * 1e-12 / points
        # All motions are asked at once, and the vehicle's for all bodies: one time costs as much as a hundred.
        ego = [] if self._ego is None else [self._ego.at(clipped(times_s, self._ego)) for times_s in (starts_s, seen_s)]
        kept = np.flatnonzero(self._points_on.any(axis=1) | (not seen_only))
        self._things, self._points_on = [self._things[row] for row in kept.tolist()], self._points_on[kept]
        self._boxes = _carried(self._things, starts_s[kept], seen_s[kept])
        if not ego or not self._boxes:
            return
        # As seen from the sensor then, but placed from its pose at the start of the frame.
        start, seen = (states.taken(kept) for states in ego)
        back = seen.rotation.transpose(0, 2, 1)
        between_m = start.position_m + _applied(start.rotation, _applied(-back, seen.position_m))
        turned, (positions_m, rotations) = start.rotation @ back, _places([box.pose for box in self._boxes])
        self._boxes = _moved(self._boxes, between_m + _applied(turned, positions_m), turned @ rotations)

    def count_points(
        self, xyz_m: Numbers, beyond_m: Numbers, body: Numbers, status: Numbers, sensor_index: Numbers
    ) -> None:
        """Count points and beams in the boxes; arguments as `CountedPoints.columns`."""
        for number, origin_m in enumerate(self._origins_m):
            of_sensor = slice(None) if len(self._origins_m) == 1 else sensor_index == number
            columns = (column[of_sensor] for column in (beyond_m, body, status))
            points = _PointsByAzimuth(xyz_m[of_sensor], origin_m, *columns)
            # Few boxes are brought into the frame of the points, in place of many points into that of the boxes.
            if self._boxes:
                self._boxes = points.counted(self._boxes, boxes_seen_from(self._boxes, self._to_world))

    def boxes(self) -> list[Box]:
        """Boxes with all counts."""
        return [
            replace(box, points_on=int(points_on.sum()))
            for box, points_on in zip(self._boxes, self._points_on, strict=True)
        ]


class GatheredBoxes:
    """Boxes of one frame that comes in clouds, at least one, in memory that does not grow with the frame.

    If something moves, the place of a box is known only when all its points have come, and only then can the points
    inside be counted. Until then the points wait: `WAITING_POINTS` in memory, those after them on disk.

    Attributes:
        first: the first cloud, without its points
        points: number of points of all clouds
    """

    first: PointCloud

    def __init__(self, folder: str | os.PathLike[str], scene: Scene, *, whole: bool = False) -> None:
        """Begin a frame; points are stored in ``folder`` if something moves.

        Args:
            whole: take all bodies, with the ego vehicle's, where they are when the frame starts; False: those of which
                points are in the box, where the cloud shows them
        """
        self._folder, self._scene, self._whole = folder, scene, whole
        self._tally: BoxTally | None = None
        self._spool: Spool | None = None
        self._waiting: list[list[Numbers]] = []
        self.points = 0

    def __enter__(self) -> GatheredBoxes:
        return self

    def __exit__(self, *_: object) -> None:
        if self._spool is not None:
            self._spool.__exit__()

    def append(self, points: PointCloud | CountedPoints) -> None:
        """Add the points of a cloud, or such as they are counted."""
        if isinstance(points, PointCloud):
            points = CountedPoints.of_cloud(points)
        if self._tally is None:
            self._begin(points)
        self.points += len(points)
        for piece in points.pieces():
            self._add(piece)

    def boxes(self) -> list[Box]:
        """Boxes of all clouds that were appended; call it once."""
        assert self._tally is not None
        if self._spool is not None:
            self._tally.place_boxes(seen_only=True)
            for piece in self._waiting:
                self._tally.count_points(*piece)
            for rows in self._spool.blocks():
                xyz_m = np.stack([rows["x"], rows["y"], rows["z"]], axis=-1)
                self._tally.count_points(xyz_m, *(rows[name] for name, _ in _WAITING_COLUMNS))
        return [box for box in self._tally.boxes() if self._whole or box.has_points]

    def _begin(self, points: CountedPoints) -> None:
        self.first = points.cloud
        self._tally = BoxTally(points.cloud, self._scene, as_seen=not self._whole, with_ego=self._whole)
        if self._tally.moves:
            position: list[tuple[str, Any]] = [(axis, points.columns[0].dtype) for axis in "xyz"]
            self._spool = Spool(self._folder, [*position, *_WAITING_COLUMNS])
        else:
            self._tally.place_boxes()

    def _add(self, points: CountedPoints) -> None:
        assert self._tally is not None
        self._tally.add_echoes(points)
        if self._spool is None:
            self._tally.count_points(*points.columns)
            return
        if sum(len(piece[0]) for piece in self._waiting) + len(points) <= WAITING_POINTS and not len(self._spool):
            # All columns that come from a GPU at once are views of one array, which would be kept whole.
            self._waiting.append([column.copy() for column in points.columns])
            return
        xyz_m, *columns = points.columns
        names = [name for name, _ in _WAITING_COLUMNS]
        self._spool.append(**dict(zip("xyz", xyz_m.T, strict=True)), **dict(zip(names, columns, strict=True)))


_WAITING_COLUMNS = [("beyond", "f4"), ("body", "i4"), ("status", "u1"), ("sensor_index", "u1")]
"""Name and type of the `CountedPoints.columns` behind the positions."""


def truth_of(cloud: PointCloud) -> tuple[Numbers, Numbers]:
    """(n,) true range and (n,) index of the body of each point.

    Raises:
        InputError: for a cloud without truth
    """
    if cloud.true_range_m is None or cloud.body is None:
        raise InputError("labels: the cloud has no truth, from which they are made")
    return cloud.true_range_m, cloud.body


def sensor_place(cloud: PointCloud) -> Pose:
    """Pose of the sensor in the world.

    Raises:
        InputError: if the cloud lacks it
    """
    return _require_pose(cloud.sensor_to_world)


def frame_to_world(cloud: PointCloud) -> Pose:
    """Pose of the frame of the points in the world.

    Raises:
        InputError: if the cloud lacks it
    """
    return _require_pose(cloud.frame_to_world)


def _require_pose(pose: Pose | None) -> Pose:
    if pose is None:
        raise InputError("labels: the cloud does not say how its sensor stood (metadata 'sensor_to_world')")
    return pose


def _boxed(parts: Sequence[Part | Ball]) -> Sequence[Part | Ball]:
    """Return the parts of a body that its box encloses: all where it would enclose none."""
    return [part for part in parts if isinstance(part, Ball) or part.in_box] or parts


def boxes_of_bodies(
    bodies: Sequence[tuple[int, Body]], parts: Sequence[Sequence[Part | Ball]] | None = None
) -> list[Box]:
    """Boxes of bodies with surfaces, each with its index, at their poses in the scene, in the world frame.

    Args:
        parts: of each, in place of its own
    """
    if not bodies:
        return []
    parts = [body.parts for _, body in bodies] if parts is None else parts
    # Copies of a body share their parts.
    extent_of = {key: box_of(_boxed(own)) for key, own in {id(own): own for own in parts}.items()}
    extents_m = np.array([extent_of[id(own)] for own in parts])
    low, high = extents_m[:, 0], extents_m[:, 1]
    position_m, rotation = _places([body.pose for _, body in bodies])
    axes = _axes(rotation)
    sizes_m = np.abs(np.einsum("nij,nj->ni", axes, high - low))
    centres_m = position_m + np.einsum("nij,nj->ni", rotation, 0.5 * (low + high))
    rotations = rotation @ axes.transpose(0, 2, 1)
    return [
        Box(
            body=index,
            name=body.name,
            class_name=body.class_name,
            size_m=size_m,
            pose=Pose(position_m=centre_m, rotation=turned),
        )
        for (index, body), size_m, centre_m, turned in zip(bodies, sizes_m, centres_m, rotations, strict=True)
    ]


def _carried(bodies: Sequence[tuple[int, Body]], starts_s: Numbers, seen_s: Numbers) -> list[Box]:
    """Boxes of bodies, each with its index, in the world frame, where they are at (n,) times.

    Args:
        starts_s: (n,) when the frame of each begins
    """
    motions = {
        row: motion_in_frame(body.motion, float(starts_s[row]))
        for row, (_, body) in enumerate(bodies)
        if body.motion is not None
    }
    if not motions:
        return boxes_of_bodies(bodies)
    # A walker has the shape of that time.
    parts = [body.parts for _, body in bodies]
    states = states_of([*motions.values()], seen_s[[*motions], None])
    for number, row in enumerate(motions):
        parts[row] = bodies[row][1].parts_at(float(seen_s[row]), float(starts_s[row]), states.taken(number))
    placed = boxes_of_bodies(bodies, parts)
    rides = {
        row: Riding(carrier=motion, pose=bodies[row][1].pose.inverse() @ placed[row].pose)
        for row, motion in motions.items()
    }
    states = states_of([*rides.values()], np.array([clipped(seen_s[row, None], ride) for row, ride in rides.items()]))
    for number, row in enumerate(rides):
        own = states.taken(number)
        placed[row] = replace(placed[row], pose=own.pose(), velocity_m_s=own.velocity_m_s[0])
    return placed


def _applied(rotations: Numbers, vectors: Numbers) -> Numbers:
    """(n, 3, 3) rotations of (n, 3) vectors."""
    return np.asarray((rotations @ vectors[:, :, None])[:, :, 0])


def upright_size_and_yaw(box: Box) -> tuple[Numbers, float]:
    """Return (length, width, height) and yaw in radians of the smallest upright box around this one.

    For formats without other rotations. An upright box keeps its size.
    """
    forward = box.pose.rotation[:, 0]
    yaw = float(np.arctan2(forward[1], forward[0]))
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return np.ptp(box.corners_m() @ about_z, axis=0), yaw


def _axes(rotation: Numbers) -> Numbers:
    """(n, 3, 3) rows forward, left and up of bodies, each along one axis of the body's frame; (n, 3, 3) rotations.

    Up is the axis nearest to the world's z; forward is its own x, or y where x is up.
    """
    up = np.argmax(np.abs(rotation[:, 2]), axis=1)
    axes = np.eye(3)
    sign = np.where(np.take_along_axis(rotation[:, 2], up[:, None], axis=1) >= 0, 1.0, -1.0)
    upward, forward = axes[up] * sign, axes[np.where(up == 0, 1, 0)]
    return np.stack([forward, np.cross(upward, forward), upward], axis=1)


class _PointsByAzimuth:
    """Points of one sensor, sorted by azimuth about it: only those in the direction of a box can be in it or behind it.

    Coordinates are those of the points.
    """

    def __init__(self, xyz_m: Numbers, origin_m: Numbers, beyond_m: Numbers, body: Numbers, status: Numbers) -> None:
        """Sort the points: (n, 3) positions, (3,) place of the sensor, (n,) ways to the surface, bodies and status."""
        self._origin_m = np.asarray(origin_m, dtype=np.float64)
        x, y, z = (xyz_m[:, axis] - xyz_m.dtype.type(origin_m[axis]) for axis in range(3))
        # NumPy sorts 16-bit numbers by radix, in a tenth of the time of others.
        sector = _sector(np.arctan2(y, x)).astype(np.uint16)
        self._order = np.argsort(sector, kind="stable")
        self._sector = sector[self._order]
        self._slope = (z / np.maximum(np.hypot(x, y), np.finfo(x.dtype).tiny))[self._order]
        self._xyz_m, self._beyond_m, self._body, self._status = xyz_m, beyond_m, body, status

    def counted(self, boxes: Sequence[Box], local_boxes: Sequence[Box]) -> list[Box]:
        """Return the boxes with their counts added; ``local_boxes`` are the same in the frame of the points."""
        towards = self._towards(local_boxes) if local_boxes else []
        return [self._counted(*box) for box in zip(boxes, local_boxes, towards, strict=True)]

    def _counted(self, box: Box, local: Box, near: Numbers) -> Box:
        """Return the box with those points and beams added that are near its direction."""
        if not len(near):
            return box
        half_m, into_box = 0.5 * local.size_m, local.pose.rotation.T
        start_m = into_box @ (self._origin_m - local.pose.position_m)
        points_m = into_box @ (self._xyz_m[near] - local.pose.position_m).T
        is_inside = np.ones(len(near), np.bool_)
        # Slab method: a line is inside a box between its last entry and its first exit of the three pairs of planes;
        # here in lengths of the way to the point.
        enter, leave, square_m2 = np.zeros(len(near)), np.full(len(near), np.inf), np.zeros(len(near))
        for along_m, start, half in zip(points_m, start_m, half_m, strict=True):
            is_inside &= np.abs(along_m) <= half
            way_m = along_m - start
            square_m2 += way_m * way_m
            way_m[np.abs(way_m) < 1e-12] = 1e-12
            low, high = (-half - start) / way_m, (half - start) / way_m
            np.maximum(enter, np.minimum(low, high), out=enter)
            np.minimum(leave, np.maximum(low, high), out=leave)
        is_echo, is_own = self._status[near] == 0, self._body[near] == box.body
        meets = (enter <= leave) & is_echo
        # From the point on: deskewed points are not as far from the sensor's one place as the pulse went. A body that
        # moves may send echoes from before its box.
        reaches = meets & (is_own | (self._beyond_m[near] >= (enter - 1.0) * np.sqrt(square_m2) - STOPPED_M))
        return replace(
            box,
            points_inside=box.points_inside + int(is_inside.sum()),
            points_within=box.points_within + int((is_inside & is_echo & is_own).sum()),
            beams=box.beams + int(meets.sum()),
            reached=box.reached + int(reaches.sum()),
        )

    def _towards(self, boxes: Sequence[Box]) -> list[Numbers]:
        """Indices of the points in whose direction some part of each box may be."""
        x, y, z = np.moveaxis(np.stack([box.corners_m() for box in boxes]) - self._origin_m, -1, 0)  # (boxes, corners)
        middle_x, middle_y = x.mean(axis=1), y.mean(axis=1)
        distance = np.hypot(middle_x, middle_y)
        radius = np.hypot(x - middle_x[:, None], y - middle_y[:, None]).max(axis=1)
        around = distance <= radius  # the sensor is above, below or in the box
        azimuth = np.arctan2(middle_y, middle_x)
        turns = np.mod(np.arctan2(y, x) - azimuth[:, None] + np.pi, 2.0 * np.pi) - np.pi
        # One sector more on either side, for rounding.
        first = _sector(azimuth + turns.min(axis=1)).astype(np.int64) - 1
        last = _sector(azimuth + turns.max(axis=1)).astype(np.int64) + 1
        # Bounds of the slope: of the lowest and the highest corner, at the least and at the largest distance.
        nearest, farthest = np.where(around, 1.0, distance - radius), distance + radius
        heights = np.stack([z.min(axis=1), z.max(axis=1)])
        slopes = np.concatenate([heights / nearest, heights / farthest])
        middle, half = 0.5 * (slopes.max(axis=0) + slopes.min(axis=0)), 0.501 * np.ptp(slopes, axis=0) + 1e-5
        # Across the seam of the azimuth a box has two runs of sectors.
        runs = np.stack([first, last + 1, first + _SECTORS, last + 1 - _SECTORS], axis=1)
        rows = np.searchsorted(self._sector, runs.clip(0, _SECTORS))
        near = []
        for number, (low, high, from_end, from_start) in enumerate(rows.tolist()):
            if around[number]:
                near.append(np.arange(len(self._order)))
                continue
            slices = [slice(low, high)]
            if first[number] < 0:
                slices.append(slice(from_end, None))
            elif last[number] >= _SECTORS:
                slices.append(slice(0, from_start))
            near.append(
                np.concatenate(
                    [self._order[run][np.abs(self._slope[run] - middle[number]) <= half[number]] for run in slices]
                )
            )
        return near


_SECTORS = 1 << 16


def _sector(azimuth_rad: Numbers) -> Numbers:
    """Number of the sector of an azimuth: 0 to 65535 from -pi to pi, others beyond."""
    return np.floor((azimuth_rad + np.pi) * ((_SECTORS - 1) / (2.0 * np.pi)))
