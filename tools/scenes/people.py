"""A pedestrian of 1.75 m, walking along +x."""

import numpy as np
from cutting import split
from modelling import Mesh, circle, closed_loft, curve, ellipsoid, join, tube

COLOURS = {
    "skin": (0.80, 0.58, 0.46, 1.0),
    "clothes": (0.20, 0.28, 0.48, 1.0),
    "trousers": (0.12, 0.13, 0.20, 1.0),
    "shoes": (0.06, 0.05, 0.05, 1.0),
    "hair": (0.10, 0.07, 0.05, 1.0),
}
# Rings of the jacket and of the hips: height, half depth, half width, forward shift.
_JACKET = [
    (0.86, 0.118, 0.172, 0.000),
    (0.90, 0.121, 0.174, 0.000),
    (1.02, 0.110, 0.158, 0.005),
    (1.16, 0.113, 0.168, 0.010),
    (1.28, 0.121, 0.188, 0.010),
    (1.37, 0.115, 0.197, 0.005),
    (1.42, 0.098, 0.178, 0.000),
    (1.46, 0.075, 0.115, 0.000),
    (1.49, 0.062, 0.068, 0.000),
    (1.51, 0.058, 0.062, 0.000),
]
_HIPS = [(0.80, 0.085, 0.120, 0.0), (0.84, 0.108, 0.158, 0.0), (0.90, 0.112, 0.165, 0.0)]


def build():
    """Part name -> Mesh."""
    hair, head = _head()
    hands = [
        ellipsoid(radii_m=(0.034, 0.024, 0.078), segments=12, rows=8).moved(position_m=place)
        for place in ((-0.165, 0.262, 0.79), (0.315, -0.225, 0.955))
    ]
    neck = tube(_bent([(-0.005, 0, 1.46), (0.01, 0, 1.60)], 4), 0.055, segments=16)
    arms = [
        _limb([(0, 0.180, 1.375), (-0.10, 0.245, 1.13), (-0.155, 0.262, 0.84)], (0.060, 0.050, 0.041)),
        _limb([(0, -0.180, 1.375), (0.05, -0.245, 1.13), (0.285, -0.227, 0.985)], (0.060, 0.050, 0.041)),
    ]
    legs = [
        _limb([(0.0, 0.088, 0.87), (0.165, 0.095, 0.495), (0.265, 0.095, 0.11)], (0.092, 0.066, 0.054)),
        _limb([(0.0, -0.088, 0.87), (0.03, -0.095, 0.47), (-0.265, -0.095, 0.185)], (0.092, 0.066, 0.054)),
    ]
    return {
        "skin": join(head, neck, *hands),
        "clothes": join(_trunk(_JACKET), *arms),
        "trousers": join(_trunk(_HIPS), *legs),
        "shoes": join(_shoe(heel=(0.22, 0.095), toe_up_m=0.055), _shoe(heel=(-0.32, -0.095), toe_up_m=-0.13)),
        "hair": hair,
    }


def _bent(points_m, count):
    """(count, 3) a smooth way through a few points."""
    points_m = np.asarray(points_m, float)
    at, knots = np.linspace(0, 1, count), np.linspace(0, 1, len(points_m))
    return np.stack([curve(at, knots, axis) for axis in points_m.T], axis=1)


def _limb(points_m, radii_m, *, count=13, segments=18):
    """A limb with a rounded top; `points_m` and `radii_m` at shoulder, elbow and wrist or the like."""
    at = np.linspace(0, 1, count)
    radius = curve(at, np.linspace(0, 1, len(radii_m)), radii_m)
    path = _bent(points_m, count)
    top = path[0] + (path[0] - path[1]) * np.array([[0.9], [0.7], [0.4]])
    radius = np.concatenate([radii_m[0] * np.array([0.35, 0.75, 0.95]), radius])
    return tube(np.vstack([top, path]), radius, segments=segments)


def _trunk(table, *, segments=28):
    rows = np.asarray(table, float)
    rings = np.zeros((len(rows), segments, 3))
    rings[:, :, :2] = circle(segments) * rows[:, None, 1:3]
    rings[:, :, 0] += rows[:, 3:]
    rings[:, :, 2] = rows[:, :1]
    return closed_loft(rings)


def _head():
    """(hair, head with nose and ears)."""
    skull = ellipsoid(radii_m=(0.098, 0.077, 0.124), segments=24, rows=16, power=2.15)
    narrow = 1 - 0.22 * np.clip(-skull.points_m[:, 2:] / 0.12, 0, 1)  # towards the chin
    head = Mesh(skull.points_m * np.column_stack([narrow**0.4, narrow, np.ones_like(narrow)]), skull.faces)
    nose = ellipsoid(radii_m=(0.020, 0.014, 0.026), segments=8, rows=6).moved(position_m=(0.097, 0, -0.012))
    ear = ellipsoid(radii_m=(0.020, 0.010, 0.032), segments=8, rows=6).moved(position_m=(-0.005, 0.078, 0))
    cap = ellipsoid(radii_m=(0.107, 0.086, 0.129), segments=24, rows=14, power=2.15)
    x, _, z = cap.points_m.T
    hair, _ = split(cap, 0.012 + 0.62 * x - z)
    place = (0.015, 0, 1.622)
    return hair.moved(position_m=place), join(head, nose, ear, ear.mirrored()).moved(position_m=place)


def _shoe(*, heel, toe_up_m):
    """A shoe on the ground, toe lifted (walking on to the heel) or heel lifted (pushing off)."""
    sole = ellipsoid(radii_m=(0.142, 0.050, 0.095), segments=20, rows=12, power=2.5)
    points = sole.points_m.copy()
    points[:, 2] = np.maximum(points[:, 2], 0.0) * np.clip(0.85 - 2.2 * points[:, 0], 0.5, 1.0)
    share = (points[:, 0] + 0.142) / 0.284
    points[:, 2] += np.where(toe_up_m > 0, toe_up_m * share**1.5, -toe_up_m * (1 - share) ** 1.3)
    return Mesh(points, sole.faces).moved(position_m=(heel[0] + 0.10, heel[1], 0.002))
