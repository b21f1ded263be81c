"""Labels for training: a PointCloud and its Scene in, classes, instances and 3D boxes out.

A box stands along its body's own axes: length along the axis that is forward, width to the left, height along the
one that is nearest to up. Its pose is where its centre is and how it is turned, in the world or seen from the sensor.

Of a body that moves, and of every body where the sensor's own motion is in the points, a frame shows no one place. Its
box is where the cloud shows it: as it stood, seen from the sensor, at the mean time of its points.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .cloud import PointCloud, sensor_positions_m
from .errors import InputError
from .geometry import Pose
from .scene import Ball, Body, Part, Scene
from .trajectory import pose_at

Array = np.ndarray[Any, Any]

STOPPED_M = 0.05
"""A beam that ends this much before a box was not stopped by something else: its range has an error."""


@dataclass(frozen=True, slots=True)
class Kind:
    """What data sets call a class: number in SemanticKITTI, type in KITTI, category in nuScenes.

    thing  can be counted, so that its bodies get boxes and instances
    """

    semantic_kitti: int
    kitti: str
    nuscenes: str
    thing: bool = True


def _stuff(semantic_kitti: int, nuscenes: str) -> Kind:
    return Kind(semantic_kitti, "DontCare", nuscenes, thing=False)


KINDS = {
    "car": Kind(10, "Car", "vehicle.car"),
    "van": Kind(20, "Van", "vehicle.car"),
    "truck": Kind(18, "Truck", "vehicle.truck"),
    "bus": Kind(13, "Misc", "vehicle.bus.rigid"),
    "tram": Kind(16, "Tram", "vehicle.bus.rigid"),
    "trailer": Kind(20, "Misc", "vehicle.trailer"),
    "bicycle": Kind(11, "Misc", "vehicle.bicycle"),
    "motorcycle": Kind(15, "Misc", "vehicle.motorcycle"),
    "cyclist": Kind(31, "Cyclist", "vehicle.bicycle"),
    "motorcyclist": Kind(32, "Misc", "vehicle.motorcycle"),
    "pedestrian": Kind(30, "Pedestrian", "human.pedestrian.adult"),
    "person": Kind(30, "Pedestrian", "human.pedestrian.adult"),
    "animal": Kind(99, "Misc", "animal"),
    "traffic_cone": Kind(99, "Misc", "movable_object.trafficcone"),
    "barrier": Kind(52, "Misc", "movable_object.barrier"),
    "pole": Kind(80, "Misc", "static.manmade"),
    "sign": Kind(81, "Misc", "static.manmade"),
    "traffic_sign": Kind(81, "Misc", "static.manmade"),
    "road": _stuff(40, "flat.driveable_surface"),
    "parking": _stuff(44, "flat.driveable_surface"),
    "pavement": _stuff(48, "flat.sidewalk"),
    "sidewalk": _stuff(48, "flat.sidewalk"),
    "kerb": _stuff(49, "flat.other"),
    "ground": _stuff(49, "flat.other"),
    "lane_marking": _stuff(60, "flat.driveable_surface"),
    "terrain": _stuff(72, "flat.terrain"),
    "building": _stuff(50, "static.manmade"),
    "wall": _stuff(52, "static.manmade"),
    "fence": _stuff(51, "static.manmade"),
    "vegetation": _stuff(70, "static.vegetation"),
    "unlabelled": _stuff(0, "unlabelled"),
}
"""By the class of a scene file. Any other class is a thing of its own: `kind_of`."""

MOVING = {10: 252, 31: 253, 30: 254, 32: 255, 16: 256, 13: 257, 18: 258, 20: 259}
"""SemanticKITTI's numbers for what moves, by those for what stands."""

UNLABELLED, OUTLIER, OTHER_OBJECT = 0, 1, 99
"""Numbers of SemanticKITTI: no surface met, no echo, class that is not in KINDS."""


def kind_of(class_name: str) -> Kind:
    """What data sets call this class of a scene file."""
    return KINDS.get(class_name.lower(), Kind(OTHER_OBJECT, "Misc", class_name))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Box:
    """The box around a body.

    body           index into the scene's bodies, as in the cloud's column
    size_m         (3,) length, width, height
    pose           of its centre; x along the length, y along the width
    velocity_m_s   (3,) of its centre in the world
    points_inside  points of the cloud inside the box, whatever they are of
    points_on      echoes of the body itself
    beams          echoes whose beams, if nothing stopped them, would enter the box
    visibility     share of those beams that nothing stopped before the box; 0 without beams
    """

    body: int
    name: str
    class_name: str
    size_m: Array
    pose: Pose
    velocity_m_s: Array = field(default_factory=lambda: np.zeros(3))
    points_inside: int = 0
    points_on: int = 0
    beams: int = 0
    visibility: float = 0.0

    @property
    def has_points(self) -> bool:
        """Whether the cloud shows anything of it."""
        return self.points_inside > 0 or self.points_on > 0

    def corners_m(self) -> Array:
        """(8, 3) corners, in the frame of its pose."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return self.pose.apply(0.5 * self.size_m * signs)

    def seen_from(self, observer: Pose) -> Box:
        """The same box in the frame of an observer, who stands in the frame of the box's pose."""
        rotation = observer.rotation.T @ self.pose.rotation
        position = observer.inverse_apply(self.pose.position_m[None])[0]
        return replace(self, pose=Pose(position_m=position, rotation=rotation))


def boxes(cloud: PointCloud, scene: Scene, *, as_seen: bool = True) -> list[Box]:
    """The box of every body that is a thing, in the world frame, with what the cloud shows of it.

    as_seen  where the cloud shows what moves; or else where it is when the frame starts
    Bodies of a Mitsuba base scene have no box: their shapes are not known here. Raises InputError for a cloud
    without truth, or one that does not know how its sensor stood.
    """
    _truth(cloud)
    to_world = frame_to_world(cloud)
    world_m = np.ascontiguousarray(to_world.apply(cloud.xyz_m.astype(np.float64)).T)
    beams = _Beams.of(cloud, world_m, to_world.apply(sensor_positions_m(cloud.metadata)))
    found = []
    for index, body in enumerate(scene.bodies):
        if kind_of(body.class_name).thing and body.parts:
            own = (cloud.body == index) & (cloud.status == 0)
            since_s = float(cloud.time_s[own].mean()) if as_seen and own.any() else 0.0
            box = _at(body, index, cloud, scene, since_s)
            counts = [sensor.into(box) for sensor in beams]
            met, reached = (sum(one[i] for one in counts) for i in (0, 1))
            found.append(
                replace(
                    box, points_inside=_inside(box, world_m), points_on=int(own.sum()), beams=met,
                    visibility=reached / met if met else 0.0,
                )
            )  # fmt: skip
    return found


def box_of(body: Body, index: int) -> Box:
    """The box of a body as it stands in the world."""
    low, high = _extent_m(body)
    turn = _axes(body.pose.rotation).T
    return Box(
        body=index,
        name=body.name,
        class_name=body.class_name,
        size_m=np.abs(turn.T @ (high - low)),
        pose=body.pose @ Pose(position_m=0.5 * (low + high), rotation=turn),
    )


def _at(body: Body, index: int, cloud: PointCloud, scene: Scene, since_s: float) -> Box:
    """The box of a body, so long after the frame's start, where the cloud shows it."""
    start_s = float(cloud.metadata.get("frame_start_s", 0.0))
    box = box_of(body, index)
    if body.motion is not None:
        # The box that the body has by its pose, carried along.
        carried = body.pose.inverse() @ box.pose
        states = body.motion.at(np.clip([start_s + since_s], *body.motion.span_s)) @ carried
        box = replace(box, pose=states.pose(), velocity_m_s=states.velocity_m_s[0])
    if scene.ego is not None and cloud.metadata.get("ego_motion") == "in the points":
        # Points are placed as if the sensor had stood still: what it saw then, from where it was at the start.
        ego, ego_then = pose_at(scene.ego, start_s), pose_at(scene.ego, start_s + since_s)
        box = replace(box, pose=ego @ ego_then.inverse() @ box.pose)
    return box


def upright(box: Box) -> tuple[Array, float]:
    """Length, width, height, and the turn to the left in radians, of the least box about z around this one.

    For formats that know no other turn. The same box where it stands upright.
    """
    forward = box.pose.rotation[:, 0]
    yaw = float(np.arctan2(forward[1], forward[0]))
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return np.ptp(box.corners_m() @ about_z, axis=0), yaw


def point_labels(cloud: PointCloud, scene: Scene) -> tuple[Array, Array]:
    """(n,) SemanticKITTI number and (n,) instance of each point: body + 1 of a thing, else 0.

    What is no echo is an outlier, a point without a body unlabelled.
    """
    body, class_id = _truth(cloud)
    kinds = [kind_of(name) for name in cloud.class_names]
    # The last entry of each table is that of -1.
    numbers = np.array([*(kind.semantic_kitti for kind in kinds), UNLABELLED], np.uint32)
    things = np.array([*(kind.thing for kind in kinds), False])
    semantic, echo = numbers[class_id], cloud.status == 0
    for index, one in enumerate(scene.bodies):
        number = kind_of(one.class_name).semantic_kitti
        if one.motion is not None and number in MOVING:
            semantic[body == index] = MOVING[number]
    instance = np.where(echo & things[class_id], body + 1, 0).astype(np.uint32)
    return np.where(echo, semantic, np.uint32(OUTLIER)), instance


def _truth(cloud: PointCloud) -> tuple[Array, Array]:
    if cloud.body is None or cloud.class_id is None:
        raise InputError("labels: the cloud has no truth, from which they are made")
    return cloud.body, cloud.class_id


def sensor_place(cloud: PointCloud) -> Pose:
    """Where the sensor stood in the world. Raises InputError if the cloud does not know."""
    return _known(cloud.sensor_to_world)


def frame_to_world(cloud: PointCloud) -> Pose:
    """The frame of the points in the world. Raises InputError if the cloud does not know."""
    return _known(cloud.frame_to_world)


def _known(place: Pose | None) -> Pose:
    if place is None:
        raise InputError("labels: the cloud does not say how its sensor stood (metadata 'sensor_to_world')")
    return place


def _extent_m(body: Body) -> tuple[Array, Array]:
    """Least and largest coordinates of a body in its own frame."""
    points = [_outline_m(part) for part in body.parts]
    return np.min([p.min(axis=0) for p in points], axis=0), np.max([p.max(axis=0) for p in points], axis=0)


def _outline_m(part: Part | Ball) -> Array:
    if isinstance(part, Ball):
        return np.array([[-part.radius_m] * 3, [part.radius_m] * 3])
    return part.vertices_m


def _axes(rotation: Array) -> Array:
    """(3, 3) rows forward, left and up of a body, each along one axis of its own frame.

    Up is the one nearest to the world's z; forward is its own x, or y where x is up.
    """
    up = int(np.argmax(np.abs(rotation[2])))
    own = np.eye(3)
    upward = own[up] * (1.0 if rotation[2, up] >= 0 else -1.0)
    forward = own[1] if up == 0 else own[0]
    return np.stack([forward, np.cross(upward, forward), upward])


def _inside(box: Box, xyz_m: Array) -> int:
    """How many of (3, n) points of the box's frame are inside it."""
    half = np.abs(box.corners_m() - box.pose.position_m).max(axis=0)
    near = np.arange(xyz_m.shape[1])
    for values, centre, reach in zip(xyz_m, box.pose.position_m, half, strict=True):
        near = near[np.abs(values[near] - centre) <= reach]
    local = box.pose.inverse_apply(xyz_m[:, near].T)
    return int((np.abs(local) <= 0.5 * box.size_m).all(axis=1).sum())


@dataclass(frozen=True, slots=True, eq=False)
class _Beams:
    """The beams of one sensor that have an echo, into directions (3, k), as far as the surface they met (k,)."""

    origin_m: Array
    direction: Array
    end_m: Array

    @staticmethod
    def of(cloud: PointCloud, world_m: Array, origins_m: Array) -> list[_Beams]:
        """Of each sensor at ``origins_m`` (sensors, 3), for a cloud whose points are at ``world_m`` (3, n)."""
        end_m, found = np.asarray(cloud.true_range_m), []
        for index, origin_m in enumerate(origins_m):
            own = (cloud.status == 0) & (cloud.sensor_index == index)
            along = world_m[:, own] - origin_m[:, None]
            length = np.sqrt((along**2).sum(axis=0))
            far = length > 0
            found.append(_Beams(origin_m, along[:, far] / length[far], end_m[own][far]))
        return found

    def into(self, box: Box) -> tuple[int, int]:
        """How many would enter the box if nothing stopped them, and how many reach it."""
        near = self._towards(box)
        start = box.pose.inverse_apply(self.origin_m[None]).T
        direction = box.pose.rotation.T @ self.direction[:, near]
        direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
        half = 0.5 * box.size_m[:, None]
        one, other = (-half - start) / direction, (half - start) / direction
        enter = np.minimum(one, other).max(axis=0, initial=0.0)
        meets = enter <= np.maximum(one, other).min(axis=0)
        reaches = meets & (self.end_m[near] >= enter - STOPPED_M)
        return int(meets.sum()), int(reaches.sum())

    def _towards(self, box: Box) -> Array:
        """Index of the beams in the cone around the box: no other can enter it."""
        x, y, z = box.pose.position_m - self.origin_m
        square, radius = float(x * x + y * y + z * z), 0.5 * float(np.linalg.norm(box.size_m))
        if square <= radius**2:
            return np.arange(len(self.end_m))
        along = self.direction[0] * x + self.direction[1] * y + self.direction[2] * z
        return np.flatnonzero(along >= np.sqrt(square - radius**2))
