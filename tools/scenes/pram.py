"""A pram with spoked wheels before its pusher, who stands at the origin and walks along +x."""

from cutting import split
from modelling import box, ellipsoid, join, rounded_box, tube
from vehicle_parts import SPOKES, rolling, wheels

HANDLE_M = (0.42, 1.0)
"""Ahead of the pelvis of who pushes, and above the ground."""
WHEEL_M, AXLES_X_M = 0.28, (HANDLE_M[0] + 0.16, HANDLE_M[0] + 0.82)
COLOURS = {
    "cloth": (0.25, 0.10, 0.08, 1.0),
    "frame": (0.60, 0.60, 0.62, 1.0),
    "tyre": (0.05, 0.05, 0.05, 1.0),
    "rim": (0.62, 0.63, 0.65, 1.0),
}


def build():
    """Part name -> Mesh, the wheels `Skinned`, and the `Skeleton` by which they turn."""
    ahead, high = HANDLE_M
    tub = rounded_box(size_m=(0.78, 0.40, 0.24), radius_m=0.09).moved(position_m=(ahead + 0.52, 0, 0.70))
    hood = ellipsoid(radii_m=(0.24, 0.21, 0.26), segments=16, rows=10, power=2.4)
    hood = hood.moved(position_m=(ahead + 0.72, 0, 0.82))
    hood, _ = split(hood, 0.74 - hood.points_m[:, 2])
    rear_x_m, front_x_m = AXLES_X_M
    knee = (ahead + 0.35, 0.25, 0.55)
    rods = [
        tube([(ahead, 0.25, high), knee, (front_x_m, 0.25, 0.5 * WHEEL_M)], 0.012, segments=6),
        tube([knee, (rear_x_m, 0.25, 0.5 * WHEEL_M)], 0.012, segments=6),
    ]
    handle = tube([(ahead, -0.25, high), (ahead, 0.25, high)], 0.015, segments=8)
    bed = box(size_m=(0.7, 0.3, 0.04), centre_m=(ahead + 0.5, 0, 0.57))
    parts = {"cloth": join(tub, hood), "frame": join(handle, join(*rods).both_sides(), bed)}
    parts |= wheels(axles_x_m=AXLES_X_M, half_track_m=0.28, diameter_m=WHEEL_M, width_m=0.044, rim_share=0.86)
    return rolling(parts, [(x, 0.0, 0.5 * WHEEL_M) for x in AXLES_X_M], turns=1 / SPOKES)
