"""The car's wheels: tyres with grooves, rims with spokes, brake discs."""

import numpy as np
from car_shape import AXLE_HEIGHT_M, AXLES_M
from modelling import Mesh, cap, circle, closed_loft, join, lathe

TRACK_HALF_M = 0.783
SEGMENTS, SPOKES = 32, 5
# Local z is the axle, outwards. (radius, z)
_SHOULDER = [(0.208, -0.088), (0.232, -0.103), (0.268, -0.106), (0.298, -0.098), (0.312, -0.084)]
_TREAD = [(0.318, -0.060), (0.319, -0.018), (0.311, -0.014)]
_BARREL = [(0.188, -0.08), (0.192, 0.06), (0.204, 0.08), (0.205, 0.09), (0.217, 0.094), (0.217, 0.084)]


def wheel_parts():
    """Part name -> list of meshes: four wheels, standing on the ground."""
    tyre, rim = _placed(_tyre()), _placed(_rim())
    points = tyre.points_m.copy()
    points[:, 2] = np.maximum(points[:, 2], 0.0)  # the flat of the contact patch
    return {"tyre": [Mesh(points, tyre.faces)], "rim": [rim]}


def _placed(wheel):
    upright = wheel.turned([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    left = [upright.moved(position_m=(x, TRACK_HALF_M, AXLE_HEIGHT_M)) for x in AXLES_M]
    return join(*left).both_sides()


def _tyre():
    half = _SHOULDER + _TREAD
    return lathe(half + [(radius, -z) for radius, z in reversed(half)], segments=SEGMENTS)


def _rim():
    barrel = lathe(_BARREL, segments=SEGMENTS).flipped()
    hub = lathe([(0.062, 0.02), (0.060, 0.058), (0.048, 0.066), (0.030, 0.068)], segments=20)
    hub_cap = cap(np.column_stack([circle(20, radius_m=0.030), np.full(20, 0.068)]))
    disc = lathe([(0.150, -0.01), (0.150, 0.012), (0.07, 0.012)], segments=SEGMENTS)
    turns = np.pi * 2 / SPOKES * np.arange(SPOKES)
    spokes = [_spoke(turn + lean * 0.13, lean=lean) for turn in turns for lean in (-1, 1)]
    back = cap(np.column_stack([circle(SEGMENTS, radius_m=0.188), np.full(SEGMENTS, -0.08)])).flipped()
    return join(barrel, hub, hub_cap, disc, back, *spokes)


def _spoke(turn, *, lean):
    """One of a pair of spokes: a tapered bar from hub to rim that leans away from its twin."""
    reach = np.array([0.040, 0.100, 0.160, 0.204])
    half, front = np.array([0.017, 0.013, 0.013, 0.018]), np.array([0.060, 0.068, 0.074, 0.078])
    depth, sweep = 0.030, lean * 0.010 * np.array([0.0, 0.3, 1.0, 1.8])
    corners = np.array([[-1, -1], [1, -1], [0.7, 0], [-0.7, 0]], float)
    rings = np.zeros((4, 4, 3))
    rings[:, :, 0] = reach[:, None]
    rings[:, :, 1] = sweep[:, None] + half[:, None] * corners[:, 0]
    rings[:, :, 2] = front[:, None] + depth * corners[:, 1]
    return closed_loft(rings).moved(yaw_rad=turn)
