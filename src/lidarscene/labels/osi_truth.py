"""Write the boxes of a frame as ASAM OSI 3.7 ground truth: a trace file of one GroundTruth.

Vehicles, people and animals are moving objects, all other things stationary ones, with the id body + 1, dimensions,
position of the box's centre and orientation in the world frame when the frame starts; moving ones have a velocity.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..files.encodings.protobuf import message, number
from ..formats.osi import pose_fields, timestamp, trace_file, vector, version
from .boxes import Box

VEHICLE, PEDESTRIAN, ANIMAL = 2, 3, 4
"""Values of MovingObject.Type."""

MOVING = {"pedestrian": PEDESTRIAN, "person": PEDESTRIAN, "animal": ANIMAL}
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


def ground_truth(boxes: Sequence[Box], start_s: float) -> bytes:
    """Encode the file of one frame."""
    objects = [_moving_object(box) if _is_moving(box) else _stationary_object(box) for box in boxes]
    return trace_file(version(1), timestamp(2, start_s), *objects)


def _is_moving(box: Box) -> bool:
    return box.class_name.lower() in (MOVING | VEHICLES)


def _moving_object(box: Box) -> bytes:
    name = box.class_name.lower()
    base = message(2, _base(box), vector(4, box.velocity_m_s))
    parts = [_identity(box), base, number(3, MOVING.get(name, VEHICLE))]
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
