"""Someone in a wheelchair, who rolls along +x: large wheels with push rims behind, castors in front.

Sizes: within the 1.30 x 0.70 x 1.09 m that ISO 7193 (1985) gives a manual chair, wheels of 24 inches; as remembered, so
assumed. Castors have a quarter of the wheels' radius, so that they look the same again when these do.
"""

import numpy as np
import people
import pram
from modelling import box, join, lathe, rounded_box, tube
from vehicle_parts import SPOKES, UPRIGHT, rider, ring, rolling

RADIUS_M, HALF_TRACK_M = 0.305, 0.285
AXLES_M = np.array([(-0.10, 0.0, RADIUS_M), (0.32, 0.0, RADIUS_M / 4)])
COLOURS = {name: people.COLOURS[name] for name in ("skin", "clothes", "trousers", "shoes", "hair")} | {
    "seat": (0.08, 0.08, 0.09, 1.0),
    **{name: pram.COLOURS[name] for name in ("frame", "tyre", "rim")},
}


def build():
    """Part name -> Mesh, the wheels `Skinned`, and the `Skeleton` by which they turn."""
    sitter = rider(
        seat_m=(-0.06, 0.50),
        hands_m=(0.06, HALF_TRACK_M + 0.02, 0.62),
        feet_m=[(0.42, side * 0.10, 0.13) for side in (1, -1)],
        height_m=1.32,
        lean_m=-0.04,
    )
    head = sitter.pop("helmet")
    rails = [
        tube([(-0.16, 0.21, 0.92), (-0.16, 0.21, 0.46), (0.26, 0.21, 0.46), (0.36, 0.14, 0.12)], 0.012, segments=6),
        tube([(-0.16, 0.21, 0.92), (-0.28, 0.21, 0.93)], 0.014, segments=6),
        tube([(0.30, 0.21, 0.44), (0.32, 0.20, 0.10)], 0.014, segments=6),
        tube([(-0.10, HALF_TRACK_M, RADIUS_M), (-0.10, 0.21, RADIUS_M), (-0.10, 0.21, 0.46)], 0.014, segments=6),
    ]
    rest = box(size_m=(0.16, 0.30, 0.015), centre_m=(0.44, 0.0, 0.115))
    cloth = [
        rounded_box(size_m=(0.42, 0.42, 0.05), centre_m=(0.04, 0.0, 0.48), radius_m=0.02, corner=1),
        rounded_box(size_m=(0.03, 0.42, 0.42), centre_m=(-0.17, 0.0, 0.70), radius_m=0.012, corner=1),
    ]
    small = AXLES_M[1, 2]
    castor = lathe([(0.2 * small, -0.012), (small, -0.012), (small, 0.012), (0.2 * small, 0.012)], segments=4 * SPOKES)
    tyres = [
        ring(0.016, RADIUS_M - 0.016, segments=4 * SPOKES).moved(position_m=AXLES_M[0] + (0, HALF_TRACK_M, 0)),
        castor.turned(UPRIGHT).moved(position_m=AXLES_M[1] + (0, 0.20, 0)),
    ]
    turns = 2 * np.pi * np.arange(2 * SPOKES) / (2 * SPOKES)
    rims = [
        ring(0.010, RADIUS_M - 0.040, segments=4 * SPOKES),
        ring(0.009, RADIUS_M - 0.045, segments=4 * SPOKES).moved(position_m=(0.0, 0.045, 0.0)),
        tube([(0.0, -0.03, 0.0), (0.0, 0.03, 0.0)], 0.025, segments=2 * SPOKES),
        *(
            tube(
                [(0.02 * np.cos(a), 0.015, 0.02 * np.sin(a)), (0.262 * np.cos(a), 0.0, 0.262 * np.sin(a))],
                0.003,
                segments=3,
            )
            for a in turns
        ),
    ]
    wheel = join(*rims).moved(position_m=AXLES_M[0] + (0, HALF_TRACK_M, 0))
    parts = sitter | {
        "hair": head,
        "seat": join(*cloth),
        "frame": join(join(*rails).both_sides(), rest),
        "tyre": join(*tyres).both_sides(),
        "rim": wheel.both_sides(),
    }
    parts = {name: parts[name] for name in COLOURS}
    return rolling(parts, AXLES_M, turns=1 / SPOKES)
