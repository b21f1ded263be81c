"""The car: a modern hatchback of 4.4 x 1.8 x 1.45 m, part by part."""

from car_body import body_parts
from car_details import inside_parts, outside_parts
from car_shape import AXLE_HEIGHT_M, AXLES_M
from car_wheels import SPOKES, wheel_parts
from modelling import join
from vehicle_parts import rolling

COLOURS = {
    "paint": (0.75, 0.76, 0.78, 1.0),
    "glass": (0.55, 0.65, 0.65, 0.25),
    "tyre": (0.03, 0.03, 0.03, 1.0),
    "rim": (0.62, 0.63, 0.65, 1.0),
    "trim": (0.04, 0.04, 0.04, 1.0),
    "headlamp": (0.85, 0.88, 0.90, 1.0),
    "taillamp": (0.55, 0.03, 0.03, 1.0),
    "plate": (0.92, 0.92, 0.88, 1.0),
    "interior": (0.10, 0.10, 0.11, 1.0),
}
COLOURS |= {
    "mirrors/paint": COLOURS["paint"],
    "mirrors/trim": COLOURS["trim"],
    "mirrors/chrome": (0.80, 0.80, 0.80, 1.0),
}


def build():
    """Part name -> Mesh, the wheels `Skinned`, and the `Skeleton` by which they turn."""
    found = [body_parts(), wheel_parts(), outside_parts(), inside_parts()]
    parts = {name: join(*(mesh for part in found for mesh in part.get(name, ()))) for name in COLOURS}
    return rolling(parts, [(x, 0.0, AXLE_HEIGHT_M) for x in AXLES_M], turns=1 / SPOKES)
