"""Reflectivities that vary over a surface, as Mitsuba textures: values of vertices, and images."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np

from ...errors import InputError
from ...materials.colour import reflectivity_by_colour
from ...maths.arrays import Numbers
from ...physics.optics import reflection
from ...scene.meshes.reflectivity_patterns import ReflectivityPattern
from ..device.backend import mitsuba

ATTRIBUTE = "vertex_reflectivity"


def texture_key(pattern: ReflectivityPattern | None) -> Hashable:
    """What parts of one material must share to be one Mitsuba mesh: no pattern, values of vertices, or an image."""
    if pattern is None or pattern.uv is None:
        return pattern is not None
    return id(pattern.values), pattern.mean


def reflectivities(pattern: ReflectivityPattern, values: Mapping[str, Any]) -> Numbers:
    """Return the pattern's values as reflectivities of a material at the laser's wavelength, float32.

    values  the material by `Material.at`
    At most what conserves energy on its surface.
    """
    found: Numbers = pattern.values
    if pattern.kind == "colour":
        # A part that is black all over has no mean to be scaled by, and stays black.
        found = reflectivity_by_colour(
            red=pattern.values,
            mean_red=max(pattern.mean, 1e-6),
            reflectivity=values["reflectivity"],
            wavelength_m=values["wavelength_m"],
        )
    limit = reflection.largest_reflectivity(math.radians(values.get("facet_slope_deg", 0.0)))
    return np.minimum(found, limit).astype(np.float32)


def texture(pattern: ReflectivityPattern, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the Mitsuba texture of a pattern; a mesh brings the values of its vertices itself, by `ATTRIBUTE`.

    Raises InputError for a material that is not diffuse.
    """
    if values["bsdf"] != "diffuse":
        raise InputError(
            f"material '{values['name']}': must be diffuse where reflectivity varies, got {values['bsdf']}"
        )
    if pattern.uv is None:
        return {"type": "mesh_attribute", "name": ATTRIBUTE}
    image = mitsuba().Bitmap(reflectivities(pattern, values)[..., None])
    return {"type": "bitmap", "bitmap": image, "raw": True, "wrap_mode": "repeat"}
