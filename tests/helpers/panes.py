"""Panes and mirrors, and how much a lossless pane reflects."""

import dataclasses
import math
from typing import Any

from helpers import chain
from lidarscene.materials.material import Material, Spectrum
from lidarscene.maths.trajectory import Motion
from lidarscene.scene.scene import Body

MIDDLE = 4

INDEX = 1.5


def pane_material(name: str = "pane", **parameters: Any) -> Material:
    values = {"index_n": INDEX, "index_k": 0.0} | parameters
    return Material(name=name, bsdf="glass", reflectivity=Spectrum.constant(0.08), parameters=values)


def mirror_material(name: str = "mirror", reflectivity: float = 0.9, **parameters: Any) -> Material:
    return Material(name=name, bsdf="mirror", reflectivity=Spectrum.constant(reflectivity), parameters=parameters)


MATERIALS = (pane_material(), mirror_material())


def pane(
    range_m: float,
    theta_deg: float = 0.0,
    *,
    name: str = "pane",
    material: str = "pane",
    size_m: float = 4.0,
    motion: Motion | None = None,
) -> Body:
    body = chain.facing(range_m=range_m, theta_deg=theta_deg, size_m=size_m, material=material)
    return dataclasses.replace(body, name=name, motion=motion)


def both_sides(cosine: float, index: float = INDEX) -> float:
    """R of a lossless pane, written anew: Snell by angles, Fresnel by sines, the geometric series by 50 terms."""
    theta = math.acos(cosine)
    if theta < 1e-6:
        r = ((index - 1.0) / (index + 1.0)) ** 2
    else:
        inside = math.asin(math.sin(theta) / index)
        r = 0.5 * (
            (math.sin(theta - inside) / math.sin(theta + inside)) ** 2
            + (math.tan(theta - inside) / math.tan(theta + inside)) ** 2
        )
    return r + (1 - r) ** 2 * sum(r ** (2 * k + 1) for k in range(50))
