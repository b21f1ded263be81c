"""People who walk along +x: adults, elderly and children, with bags, skinned, with a stride each.

Lengths of segments by stature: R. Drillis and R. Contini (1966), as in D. A. Winter, "Biomechanics and motor control of
human movement", 4th ed. (2009), fig. 4.1. Statures: German adults by DIN 33402-2 (2005), the 5th, 50th and 95th
percentile of men 1.65, 1.75 and 1.855 m, of women 1.535, 1.625 and 1.72 m; children of 4, 7 and 12 years by the medians
of the WHO's growth standard (2006) and reference (2007), 1.03, 1.22 and 1.50 m. The elderly are chosen some centimetres
below the medians. `gait` has the strides. These numbers are as remembered of the works named, so assumed.

Modelled as one stands, arms a little off the body. Symbols: v vertices, j joints.
"""

from dataclasses import dataclass

import numpy as np
from cutting import split
from gait import KEYS, Leg, arm, stride_of_adult, walk
from glb import Clip, Skeleton, Skinned
from modelling import Mesh, circle, closed_loft, curve, ellipsoid, join, rounded_box, tube
from pram import HANDLE_M

COLOURS = {
    "skin": (0.80, 0.58, 0.46, 1.0),
    "clothes": (0.20, 0.28, 0.48, 1.0),
    "trousers": (0.12, 0.13, 0.20, 1.0),
    "shoes": (0.06, 0.05, 0.05, 1.0),
    "hair": (0.10, 0.07, 0.05, 1.0),
    "bag": (0.25, 0.10, 0.08, 1.0),
}
JOINTS = (
    "ground",
    "pelvis",
    "chest",
    "head",
    *(f"{bone}_{s}" for s in "lr" for bone in ("thigh", "shank", "foot", "toes")),
)
JOINTS += tuple(f"{bone}_{side}" for side in "lr" for bone in ("arm", "forearm"))
PARENTS = {
    "pelvis": "ground",
    "chest": "pelvis",
    "head": "chest",
    "shank": "thigh",
    "foot": "shank",
    "toes": "foot",
    "forearm": "arm",
}
PARENTS |= {"thigh": "pelvis", "arm": "chest"}


@dataclass(frozen=True, slots=True)
class Person:
    """One kind of person.

    Attributes:
        stature_m: with shoes
        stride: length [m] and time [s] of a stride
        head: scale of the head against an adult's of this stature
        girth: scale of depths and widths likewise
        lean_deg: of the trunk, forward
        crouch: by which the legs are bent, as a share of their length
        swing: of the arms, against the usual
        hair: "short" or "long"
        carries: "", "rucksack", "bag", or "pram" for arms that push one
    """

    stature_m: float
    stride: tuple[float, float]
    head: float = 1.0
    girth: float = 1.0
    lean_deg: float = 3.0
    crouch: float = 0.0
    swing: float = 1.0
    hair: str = "short"
    carries: str = ""


def _adult(speed_m_s, stature_m, **keys):
    return Person(stature_m, stride_of_adult(speed_m_s, stature_m), **keys)


PEOPLE = {
    "pedestrian": _adult(1.43, 1.75),
    "man_tall": _adult(1.36, 1.86, girth=1.08),
    "man_rucksack": _adult(1.43, 1.75, carries="rucksack", lean_deg=6.0),
    "man_old": _adult(0.97, 1.72, lean_deg=14.0, crouch=0.012, swing=0.5),
    "woman": _adult(1.39, 1.63, girth=0.95, hair="long"),
    "woman_short": _adult(1.34, 1.54, girth=1.05, hair="long"),
    "woman_bag": _adult(1.31, 1.63, hair="long", carries="bag"),
    "woman_pram": _adult(1.34, 1.72, girth=0.95, hair="long", carries="pram"),
    "woman_old": _adult(0.94, 1.57, lean_deg=16.0, crouch=0.012, swing=0.4, girth=1.12, carries="bag"),
    "child_12": Person(1.50, (1.28 * 1.072, 1.072), head=1.12, girth=0.95, hair="long"),
    "child_7": Person(1.22, (1.20 * 0.955, 0.955), head=1.30, girth=1.02),
    "child_4": Person(1.03, (1.00 * 0.900, 0.900), head=1.47, girth=1.10),
}
"""Names of the meshes -> people. Speeds of adults are those of their age and sex in `gait`."""

# Rings of the trunk by share of the stature: height, half depth, half width, forward shift.
_JACKET = [
    (0.480, 0.068, 0.100, 0.0),
    (0.520, 0.069, 0.100, 0.0),
    (0.583, 0.062, 0.089, 0.003),
    (0.663, 0.064, 0.095, 0.005),
    (0.731, 0.068, 0.106, 0.005),
    (0.783, 0.064, 0.112, 0.002),
    (0.811, 0.055, 0.102, 0.0),
    (0.834, 0.042, 0.066, 0.0),
    (0.851, 0.035, 0.039, 0.0),
    (0.863, 0.033, 0.035, 0.0),
]
_HIPS = [(0.455, 0.050, 0.078, 0.0), (0.480, 0.062, 0.090, 0.0), (0.515, 0.063, 0.092, 0.0), (0.56, 0.056, 0.084, 0.0)]


def build(name):
    """Part name -> Skinned, and the `Skeleton`, of a person."""
    person = PEOPLE[name]
    places = _places(person)
    hair, head = _head(person, places)
    parts = {
        "skin": [head, _neck(person, places)],
        "clothes": [_trunk(person, _JACKET, "chest")],
        "trousers": [_trunk(person, _HIPS, "pelvis")],
        "shoes": [],
        "hair": [hair],
    }
    for side in "lr":
        parts["skin"].append(_hand(person, places, side))
        parts["clothes"].append(_arm(person, places, side))
        parts["trousers"].append(_leg(person, places, side))
        parts["shoes"].append(_shoe(person, places, side))
    for part, pieces in _carried(person, places).items():
        parts.setdefault(part, []).extend(pieces)
    return {part: _joined(pieces) for part, pieces in parts.items()}, _skeleton(person, places)


def _leg_of(person):
    h = person.stature_m
    return Leg(0.245 * h, 0.246 * h, 0.039 * h, 0.045 * h, 0.072 * h, 0.042 * h)


def _places(person):
    """Joint -> (3,) place as modelled."""
    h, girth = person.stature_m, person.girth
    leg = _leg_of(person)
    places = {"ground": (0, 0, 0), "pelvis": (0, 0, 0.53 * h), "chest": (0, 0, 0.60 * h), "head": (0, 0, 0.855 * h)}
    for side, sign in (("l", 1), ("r", -1)):
        hip, foot = 0.050 * h * girth, 0.036 * h * girth + 0.008
        places |= {
            f"thigh_{side}": (0, sign * hip, 0.53 * h),
            f"shank_{side}": (0, sign * 0.5 * (hip + foot), 0.285 * h),
            f"foot_{side}": (0, sign * foot, 0.039 * h),
            f"toes_{side}": (leg.ball, sign * foot, 0.0),
            f"arm_{side}": (0, sign * 0.103 * h * girth, 0.795 * h),
            f"forearm_{side}": (0, sign * (0.120 * h * girth + 0.012), 0.620 * h),
        }
    return {name: np.array(places[name], float) for name in JOINTS}


def _shared(mesh, low, high, share):
    """Carry points by two joints: `share` (v,) of the second."""
    shares = np.zeros((len(mesh.points_m), len(JOINTS)))
    shares[:, JOINTS.index(low)] += 1.0 - share
    shares[:, JOINTS.index(high)] += share
    return Skinned(mesh, shares)


def _carried_by(mesh, joint):
    return _shared(mesh, joint, joint, np.zeros(len(mesh.points_m)))


def _joined(pieces):
    return Skinned(join(*(piece.mesh for piece in pieces)), np.concatenate([piece.shares for piece in pieces]))


def _ramp(value, low, high):
    """0 below `low`, 1 above `high`, smooth between."""
    share = np.clip((value - low) / (high - low), 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def _trunk(person, table, joint, *, segments=20):
    h, rows = person.stature_m, np.asarray(table, float) * person.stature_m
    rows[:, 1:3] *= person.girth
    rings = np.zeros((len(rows), segments, 3))
    rings[:, :, :2] = circle(segments) * rows[:, None, 1:3]
    rings[:, :, 0] += rows[:, 3:]
    rings[:, :, 2] = rows[:, :1]
    mesh = closed_loft(rings)
    if joint == "pelvis":
        return _carried_by(mesh, "pelvis")
    return _shared(mesh, "pelvis", "chest", _ramp(mesh.points_m[:, 2], 0.54 * h, 0.66 * h))


def _limb(points_m, radii_m, *, count=11, segments=10):
    """(mesh, (v,) length along it) of a limb with a rounded top, through a few points."""
    points_m = np.asarray(points_m, float)
    at = np.linspace(0, 1, count)
    knots = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1))])
    path = np.stack([curve(at * knots[-1], knots, axis) for axis in points_m.T], axis=1)
    radius = curve(at, np.linspace(0, 1, len(radii_m)), radii_m)
    top = path[0] + (path[0] - path[1]) * np.array([[0.55], [0.4], [0.2]])
    radius = np.concatenate([radii_m[0] * np.array([0.35, 0.75, 0.95]), radius])
    mesh = tube(np.vstack([top, path]), radius, segments=segments)
    return mesh


def _leg(person, places, side):
    h, girth = person.stature_m, person.girth
    hip, knee, ankle = (places[f"{bone}_{side}"] for bone in ("thigh", "shank", "foot"))
    top = hip - np.array([0, 0, 0.02 * h])
    mesh = _limb(
        [top, knee, ankle + np.array([0, 0, 0.012 * h])], np.array([0.052, 0.046, 0.036, 0.034, 0.029]) * h * girth
    )
    z = mesh.points_m[:, 2]
    shares = np.zeros((len(z), len(JOINTS)))
    thigh = _ramp(-z, -0.545 * h, -0.47 * h)
    shank = _ramp(-z, -0.325 * h, -0.245 * h)
    for joint, share in (("pelvis", 1 - thigh), (f"thigh_{side}", thigh * (1 - shank)), (f"shank_{side}", shank)):
        shares[:, JOINTS.index(joint)] = share
    return Skinned(mesh, shares)


def _arm(person, places, side):
    h, girth = person.stature_m, person.girth
    shoulder, elbow = places[f"arm_{side}"], places[f"forearm_{side}"]
    mesh = _limb([shoulder, elbow, _wrist(person, places, side)], np.array([0.034, 0.028, 0.022]) * h * girth)
    z = mesh.points_m[:, 2]
    shares = np.zeros((len(z), len(JOINTS)))
    upper, lower = _ramp(-z, -0.815 * h, -0.765 * h), _ramp(-z, -0.645 * h, -0.595 * h)
    for joint, share in (("chest", 1 - upper), (f"arm_{side}", upper * (1 - lower)), (f"forearm_{side}", lower)):
        shares[:, JOINTS.index(joint)] = share
    return Skinned(mesh, shares)


def _wrist(person, places, side):
    return places[f"forearm_{side}"] + np.array([0.0, 0.1 * places[f"forearm_{side}"][1], -0.140 * person.stature_m])


def _hand(person, places, side):
    h = person.stature_m
    mesh = ellipsoid(radii_m=(0.022 * h, 0.013 * h, 0.050 * h), segments=10, rows=7)
    return _carried_by(mesh.moved(position_m=_wrist(person, places, side) - [0, 0, 0.035 * h]), f"forearm_{side}")


def _neck(person, places):
    h = person.stature_m
    path = np.linspace(places["head"] - [0.006 * h, 0, 0.02 * h], places["head"] + [0.006 * h, 0, 0.06 * h], 4)
    mesh = tube(path, 0.032 * h * person.girth, segments=12)
    return _shared(mesh, "chest", "head", _ramp(mesh.points_m[:, 2], 0.85 * h, 0.88 * h))


def _head(person, places):
    """(hair, head with nose and ears)."""
    scale = person.head * person.stature_m / 1.75
    skull = ellipsoid(radii_m=(0.098, 0.077, 0.124), segments=18, rows=12, power=2.15)
    narrow = 1 - 0.22 * np.clip(-skull.points_m[:, 2:] / 0.12, 0, 1)  # towards the chin
    head = Mesh(skull.points_m * np.column_stack([narrow**0.4, narrow, np.ones_like(narrow)]), skull.faces)
    nose = ellipsoid(radii_m=(0.020, 0.014, 0.026), segments=8, rows=6).moved(position_m=(0.097, 0, -0.012))
    ear = ellipsoid(radii_m=(0.020, 0.010, 0.032), segments=8, rows=6).moved(position_m=(-0.005, 0.078, 0))
    cap = ellipsoid(radii_m=(0.107, 0.086, 0.129), segments=18, rows=12, power=2.15)
    x, _, z = cap.points_m.T
    hair, _ = split(cap, 0.012 + 0.62 * x - z)
    if person.hair == "long":
        hair = join(
            hair, ellipsoid(radii_m=(0.05, 0.078, 0.13), segments=12, rows=9).moved(position_m=(-0.07, 0, -0.1))
        )
    # The top of the hair is the stature.
    place = np.array([0.010 * person.stature_m, 0, person.stature_m - 0.129 * scale])
    scaled = {"scale": (scale,) * 3, "position_m": place}
    whole = join(head, nose, ear, ear.mirrored())
    return _carried_by(hair.moved(**scaled), "head"), _carried_by(whole.moved(**scaled), "head")


def _shoe(person, places, side):
    """A shoe on the ground: its sole is flat from the heel to the tip of the toes, which bend at the ball."""
    leg = _leg_of(person)
    length = leg.heel + leg.ball + leg.toes
    sole = ellipsoid(
        radii_m=(0.5 * length, 0.030 * person.stature_m, 0.055 * person.stature_m), segments=18, rows=12, power=2.6
    )
    points = sole.points_m.copy()
    points[:, 2] = np.maximum(points[:, 2], 0.0) * np.clip(
        0.85 - 2.2 * points[:, 0] * 1.75 / person.stature_m, 0.5, 1.0
    )
    points[:, 0] += 0.5 * length - leg.heel
    mesh = Mesh(points, sole.faces).moved(position_m=(0, places[f"foot_{side}"][1], 0))
    return _shared(mesh, f"foot_{side}", f"toes_{side}", _ramp(points[:, 0], leg.ball - 0.004, leg.ball + 0.004))


def _carried(person, places):
    """Part -> pieces of what a person has with them."""
    h = person.stature_m
    if person.carries == "rucksack":
        pack = rounded_box(size_m=(0.17, 0.30, 0.46), radius_m=0.05).moved(position_m=(-0.205, 0, 0.70 * h))
        return {"bag": [_carried_by(pack, "chest")]}
    if person.carries == "bag":
        wrist = _wrist(person, places, "r")
        bag = rounded_box(size_m=(0.32, 0.12, 0.26), radius_m=0.03).moved(position_m=wrist - [0, 0.02, 0.30])
        straps = [tube([wrist - [x, 0.02, 0.18], wrist - [0, 0, 0.07]], 0.008, segments=6) for x in (-0.09, 0.09)]
        return {"bag": [_carried_by(join(bag, *straps), "forearm_r")]}
    return {}


def _skeleton(person, places):
    leg = _leg_of(person)
    stride_m, period_s = person.stride
    step = walk(leg, stride_m=stride_m, crouch=person.crouch, lift=min(1.0, stride_m / person.stature_m / 0.75))
    phase = np.arange(KEYS + 1) / KEYS
    walking, standing = {}, {}
    turn = 2.0 * np.pi * phase
    later = np.concatenate([np.arange(KEYS // 2, KEYS + 1), np.arange(1, KEYS // 2 + 1)])
    for side in "lr":
        at = np.arange(KEYS + 1) if side == "l" else later
        stand_thigh, stand_knee = step.standing[1:]
        for bones, (thigh, knee, foot, toe) in (
            (walking, (step.thigh[at], step.knee[at], step.foot[at], step.toe[at])),
            (standing, ([stand_thigh], [stand_knee], [0.0], [0.0])),
        ):
            thigh, knee, foot, toe = (np.asarray(angle, float) for angle in (thigh, knee, foot, toe))
            _turn(bones, f"thigh_{side}", thigh)
            _turn(bones, f"shank_{side}", -knee)
            _turn(bones, f"foot_{side}", foot - thigh + knee)
            _turn(bones, f"toes_{side}", toe)
        shoulder, elbow = arm(phase[at], swing=person.swing)
        if person.carries == "bag" and side == "r":
            shoulder, elbow = 0.15 * shoulder, 0.0 * elbow
        if person.carries == "pram":
            shoulder, elbow = _reach(person, places)
            shoulder, elbow = (np.full(KEYS + 1, angle) for angle in (shoulder, elbow))
        _turn(walking, f"arm_{side}", shoulder - np.radians(-person.lean_deg))
        _turn(walking, f"forearm_{side}", elbow)
        still = person.carries == "pram"
        _turn(
            standing,
            f"arm_{side}",
            [shoulder[0] + np.radians(person.lean_deg) if still else np.radians(person.lean_deg - 2)],
        )
        _turn(standing, f"forearm_{side}", [elbow[0] if still else np.radians(8)])
    lean = np.radians(person.lean_deg)
    twist = np.radians(5.0 * person.swing) * np.cos(turn)
    walking["chest"] = np.stack([0 * turn, np.full_like(turn, -lean), twist], axis=1)
    standing["chest"] = np.array([[0.0, -lean, 0.0]])
    _turn(walking, "head", np.full_like(turn, 0.8 * lean))
    _turn(standing, "head", [0.8 * lean])
    walk_m, stand_m = np.zeros((KEYS + 1, 3)), np.zeros((1, 3))
    walk_m[:, 2], stand_m[:, 2] = step.pelvis_m - places["pelvis"][2], step.standing[0] - places["pelvis"][2]
    clips = {
        "walk": Clip(period_s, walking, {"pelvis": walk_m}),
        "stand": Clip(period_s, standing, {"pelvis": stand_m}),
    }
    return Skeleton(places, {name: _parent(name) for name in JOINTS}, clips)


def _parent(name):
    bone, _, side = name.partition("_")
    above = PARENTS.get(bone, "")
    return f"{above}_{side}" if side and above not in ("", "pelvis", "chest") else above


def _turn(bones, joint, angle):
    """Turn a joint in the plane of walking."""
    angle = np.asarray(angle, float)
    bones[joint] = np.stack([0 * angle, angle, 0 * angle], axis=1)


def _reach(person, places):
    """(shoulder, elbow) of arms whose hands hold the handle of the pram."""
    shoulder, elbow = places["arm_l"], places["forearm_l"]
    upper, lower = float(np.linalg.norm(shoulder - elbow)), 0.175 * person.stature_m
    ahead, high = HANDLE_M
    lean = np.radians(person.lean_deg)
    rise = shoulder[2] - places["chest"][2]
    at = np.array([rise * np.sin(lean), places["chest"][2] + rise * np.cos(lean)])
    way = np.array([ahead, high]) - at
    reach = min(float(np.hypot(*way)), 0.999 * (upper + lower))
    elbow_bent = np.pi - np.arccos((upper**2 + lower**2 - reach**2) / (2 * upper * lower))
    towards = np.arctan2(way[0], -way[1])
    return towards - np.arccos((upper**2 + reach**2 - lower**2) / (2 * upper * reach)), elbow_bent
