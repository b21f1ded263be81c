"""Write the boxes of a frame as ASAM OSI 3.7 ground truth.

Vehicles, people and animals are moving objects, all other things stationary ones, with the id body + 1, dimensions,
position of the box's centre and orientation in the world frame when the frame starts; moving ones have a velocity.
The host vehicle is the body that rides with the sensor, or else an object without a box.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from ..files.encodings.protobuf import message, number
from ..formats.osi import GroundTruth, Host, pose_fields, vector
from ..maths.pose import Pose
from ..scene.scene import Scene
from .boxes import Box, GatheredBoxes

OTHER_MOVER, VEHICLE, PEDESTRIAN, ANIMAL = 1, 2, 3, 4
"""Values of MovingObject.Type."""

MOVING = {
    "pedestrian": PEDESTRIAN,
    "person": PEDESTRIAN,
    "child": PEDESTRIAN,
    "wheelchair_user": PEDESTRIAN,
    "pram": OTHER_MOVER,
    "animal": ANIMAL,
}
VEHICLES = {
    "car": 4,
    "van": 6,
    "truck": 7,
    "trailer": 9,
    "motorcycle": 10,
    "motorcyclist": 10,
    "bicycle": 11,
    "cyclist": 11,
    "bus": 12,
    "tram": 13,
}
"""Values of MovingObject.VehicleClassification.Type by class."""

STATIONARY = {"pole": 4, "sign": 12, "traffic_sign": 12, "barrier": 8}
OTHER = 1
"""Values of StationaryObject.Classification.Type by class: pole, vertical structure, barrier; other."""


def gathered_truth(gathered: GatheredBoxes, scene: Scene) -> GroundTruth:
    """Encode the objects of a frame whose boxes were gathered, with its host vehicle."""
    first = gathered.first
    bodies = len(first.body_names)
    return ground_truth(gathered.boxes(), first.vehicle_to_world, riding=scene.own_bodies, bodies=bodies)


def ground_truth(
    boxes: Sequence[Box], vehicle: Pose | None = None, *, riding: Collection[int] = (), bodies: int = 0
) -> GroundTruth:
    """Encode the objects of a frame.

    Args:
        vehicle: pose of the vehicle's frame in the world, None if it is unknown
        riding: bodies that ride with it: the first of them that is a vehicle and has the frame's axes is the host's box
        bodies: number of bodies of the scene
    """
    host = None if vehicle is None else _host(boxes, vehicle, riding, bodies)
    encoded = [_moving_object(box, host) if _is_moving(box) else _stationary_object(box) for box in boxes]
    if host is not None and not any(box.body + 1 == host.id for box in boxes):
        encoded.append(host.as_object())
    return GroundTruth(objects=b"".join(encoded), host=host)


def _host(boxes: Sequence[Box], vehicle: Pose, riding: Collection[int], bodies: int) -> Host:
    for box in boxes:
        aligned = np.allclose(box.pose.rotation, vehicle.rotation, atol=1e-6)
        if box.body in riding and box.class_name.lower() in VEHICLES and aligned:
            to_rear_m = (vehicle.position_m - box.pose.position_m) @ box.pose.rotation
            return Host(id=box.body + 1, centre=box.pose, to_rear_m=to_rear_m)
    return Host.without_box(vehicle, bodies)


def _is_moving(box: Box) -> bool:
    return box.class_name.lower() in (MOVING | VEHICLES)


def _moving_object(box: Box, host: Host | None) -> bytes:
    name = box.class_name.lower()
    base = message(2, _base(box), vector(4, box.velocity_m_s))
    parts = [_identity(box), base, number(3, MOVING.get(name, VEHICLE))]
    if host is not None and host.id == box.body + 1:
        parts.append(host.attributes)
    if name in VEHICLES:
        parts.append(message(6, number(1, VEHICLES[name])))
    return message(5, *parts)


def _stationary_object(box: Box) -> bytes:
    kind = STATIONARY.get(box.class_name.lower(), OTHER)
    return message(4, _identity(box), message(2, _base(box)), message(3, number(1, kind)))


def _identity(box: Box) -> bytes:
    return message(1, number(1, box.body + 1))


def _base(box: Box) -> bytes:
    """Encode dimension, position and orientation, whose fields have the same numbers in both kinds of base."""
    return vector(1, box.size_m) + pose_fields(box.pose, position=2, orientation=3)
