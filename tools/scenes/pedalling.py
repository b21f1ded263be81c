"""Cyclists who pedal: cranks and legs turn with the wheels.

A foot stays level on its pedal, and the leg between hip and ankle follows: thigh and shank keep their lengths, the knee
is ahead. All turns are about axes across the bicycle.
"""

import numpy as np
from glb import Clip, Skeleton, Skinned
from vehicle_parts import rolling, sitting_leg

GEAR = 2.0  # turns of the wheels in one of the cranks, chosen: 70 turns of the cranks a minute at 18 km/h
KEYS = 48  # key frames of a turn of the cranks
SOLE_M = 0.01  # of a foot over the middle of its pedal
KNEE_BENT = 0.30  # of a `rider`: legs that nearly stretch at the lowest place of their pedal
PEDAL_POINTS = 16  # of both pedals, which are boxes
BLEND_M = 0.05  # half of the part of a knee that goes with both bones
SIDES = {"l": 1, "r": -1}


def pedalling(parts, axles_m, *, crank_m, pedals_m, seat_m, height_m):
    """Parts of a cyclist, wheels, cranks and legs `Skinned`, and the `Skeleton` by which they turn."""
    parts, wheels = rolling(parts, axles_m, turns=GEAR, keys=KEYS)
    (stride,) = wheels.clips.values()
    angle = 2.0 * np.pi * np.arange(KEYS + 1) / KEYS
    places_m, parents = wheels.places_m | {"crank": crank_m}, wheels.parents | {"crank": ""}
    turns = stride.turns | {"crank": _about_axle(angle)}
    legs = {}
    for (side, sign), pedal_m in zip(SIDES.items(), pedals_m, strict=True):
        foot_m = np.add(pedal_m, (0.0, 0.0, SOLE_M))
        legs[side] = leg = sitting_leg(seat_m=seat_m[::2], foot_m=foot_m, height_m=height_m, side=sign, bent=KNEE_BENT)
        places_m |= {f"pedal_{side}": pedal_m, f"thigh_{side}": leg[0], f"shank_{side}": leg[1]}
        parents |= {f"pedal_{side}": "crank", f"thigh_{side}": "", f"shank_{side}": f"thigh_{side}"}
        thigh, shank = _bent(leg, _turned(pedal_m - crank_m, angle) + crank_m - pedal_m)
        turns |= {f"pedal_{side}": _about_axle(-angle)}
        turns |= {f"thigh_{side}": _about_axle(thigh), f"shank_{side}": _about_axle(shank - thigh)}
    joints = list(places_m)
    for name, of_points in (("cranks/trim", _of_cranks), ("shoes", _of_shoes), ("trousers", _of_legs)):
        parts[name] = Skinned(parts[name], of_points(parts[name].points_m, joints, legs))
    return parts, Skeleton(places_m, parents, {"roll": Clip(GEAR, turns)})


def _about_axle(angle):
    """Turns about the axis to the left, by which what is above goes ahead."""
    return np.stack([0.0 * angle, -angle, 0.0 * angle], axis=1)


def _turned(place_m, angle):
    """(n, 3) place about the axis to the left."""
    x, y, z = place_m
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([x * cos + z * sin, np.full_like(angle, y), z * cos - x * sin], axis=1)


def _bent(leg, shift_m):
    """(thigh, shank) turns of a leg whose ankle is shifted by (n, 3)."""
    hip, knee, ankle = leg
    upper, lower = np.hypot(*(knee - hip)[::2]), np.hypot(*(ankle - knee)[::2])
    way = ankle + shift_m - hip
    reach = np.hypot(way[:, 0], way[:, 2])
    if reach.max() > 0.999 * (upper + lower):
        raise ValueError(f"a leg of {upper + lower:.3f} m must reach {reach.max():.3f} m")
    ahead = np.arccos((upper**2 + reach**2 - lower**2) / (2.0 * upper * reach))
    thigh = _angle(way) - ahead
    to_knee = np.stack([upper * np.sin(thigh), 0.0 * thigh, upper * np.cos(thigh)], axis=1)
    return thigh - _angle(knee - hip), _angle(way - to_knee) - _angle(ankle - knee)


def _angle(way):
    """Angle of a way from above, by which `_turned` turns."""
    return np.mod(np.arctan2(way[..., 0], way[..., 2]), 2.0 * np.pi)


def _shares(joints, columns):
    """(v, j) shares of the joints that are named."""
    zeros = np.zeros_like(next(iter(columns.values())))
    return np.stack([columns.get(joint, zeros) for joint in joints], axis=1)


def _of_cranks(points_m, joints, _):
    """Shares of cranks and pedals, which are the first points."""
    is_pedal = np.arange(len(points_m)) < PEDAL_POINTS
    left = points_m[:, 1] > 0.0
    columns = {"crank": ~is_pedal, "pedal_l": is_pedal & left, "pedal_r": is_pedal & ~left}
    return _shares(joints, {joint: column.astype(float) for joint, column in columns.items()})


def _of_shoes(points_m, joints, _):
    left = points_m[:, 1] > 0.0
    return _shares(joints, {"pedal_l": left.astype(float), "pedal_r": (~left).astype(float)})


def _of_legs(points_m, joints, legs):
    """Shares of legs, whose points around the knee go with both bones."""
    columns = {}
    for side, sign in SIDES.items():
        hip, knee, ankle = legs[side]
        along = (knee - hip) / np.linalg.norm(knee - hip) + (ankle - knee) / np.linalg.norm(ankle - knee)
        behind_m = (points_m - knee) @ (along / np.linalg.norm(along))
        share = np.clip(0.5 + 0.5 * behind_m / BLEND_M, 0.0, 1.0)
        here = (sign * points_m[:, 1] > 0.0).astype(float)
        columns |= {f"thigh_{side}": here * (1.0 - share), f"shank_{side}": here * share}
    return _shares(joints, columns)
