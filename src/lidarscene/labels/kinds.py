"""Names and numbers that data sets give to the classes of scene files.

A scene has classes such as "car" or "kerb"; each data set has its own numbers and names, and lacks some classes. One
table holds all of them, with the classes that can be counted (things) and those that cannot (road, vegetation).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Kind:
    """Class in the terms of data sets: number in SemanticKITTI, type in KITTI, category in nuScenes.

    Attributes:
        is_thing: True if bodies of the class can be counted, so that they get boxes and instances
    """

    semantic_kitti: int
    kitti: str
    nuscenes: str
    is_thing: bool = True


def _stuff(semantic_kitti: int, nuscenes: str) -> Kind:
    return Kind(semantic_kitti, NOT_IN_KITTI, nuscenes, is_thing=False)


NOT_IN_KITTI = "DontCare"
"""KITTI's type of what nobody labelled: roads and houses, and poles, signs and barriers, too."""


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
    "child": Kind(30, "Pedestrian", "human.pedestrian.child"),
    "wheelchair_user": Kind(30, "Pedestrian", "human.pedestrian.wheelchair"),
    "pram": Kind(99, "Misc", "human.pedestrian.stroller"),
    "animal": Kind(99, "Misc", "animal"),
    "traffic_cone": Kind(99, NOT_IN_KITTI, "movable_object.trafficcone"),
    "bin": Kind(99, NOT_IN_KITTI, "movable_object.pushable_pullable"),
    "barrier": Kind(52, NOT_IN_KITTI, "movable_object.barrier"),
    "pole": Kind(80, NOT_IN_KITTI, "static.manmade"),
    "traffic_light": Kind(80, NOT_IN_KITTI, "static.manmade"),
    "sign": Kind(81, NOT_IN_KITTI, "static.manmade"),
    "traffic_sign": Kind(81, NOT_IN_KITTI, "static.manmade"),
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
"""Class of a scene file -> its terms. Any other class is a thing (`kind_of`)."""

MOVING = {10: 252, 31: 253, 30: 254, 32: 255, 16: 256, 13: 257, 18: 258, 20: 259}
"""SemanticKITTI's number of a standing object -> that of a moving one."""

UNLABELLED, OUTLIER, OTHER_OBJECT = 0, 1, 99
"""Numbers of SemanticKITTI: no surface met, no echo, class that is not in KINDS."""


def kind_of(class_name: str) -> Kind:
    """Terms of data sets for this class of a scene file; an unknown class is another object, a thing."""
    return KINDS.get(class_name.lower(), Kind(OTHER_OBJECT, "Misc", class_name))
