"""Reflectivity patterns: measured values, vertex colours or a texture that vary the reflectivity over a mesh; cutouts.

A scan of a street holds the reflectivity of every point, a model made for pictures only the colour. Both are read from
the mesh file here; `materials.colour` turns a colour into reflectivity at the laser's wavelength.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ...errors import InputError
from ...maths.arrays import Numbers, frozen

Kind = Literal["reflectivity", "colour"]

NAMES = ("reflectivity", "reflectance")
"""Property names of vertices or faces in a PLY file; glTF vertex attributes have them in capitals after "_"."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReflectivityPattern:
    """Values over a part, in place of one reflectivity for all of it.

    Attributes:
        kind: "reflectivity": values are reflectivities at the laser's wavelength, in place of the material's; "colour":
            they are the red of visible light, linear, and scale the material's reflectivity
        values: (v,) at the vertices, linear between them; or (h, w) of an image, first row at the top
        uv: (v, 2) where in the image the vertices are: (0, 0) its top left corner, (1, 1) the bottom right; it repeats
        mean: mean of the values over the surface, at which the reflectivity is the material's own; for colours only
    """

    kind: Kind
    values: Numbers
    uv: Numbers | None = None
    mean: float = 1.0

    def __post_init__(self) -> None:
        """Check shapes and freeze the arrays."""
        object.__setattr__(self, "values", frozen(self.values, np.float32, (None,) * (1 if self.uv is None else 2)))
        if self.uv is not None:
            object.__setattr__(self, "uv", frozen(self.uv, np.float32, (None, 2)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cutout:
    """An image that says where a part has gaps, such as those between the leaves of a tree that is painted on squares.

    Attributes:
        solid: (h, w) whether something is there, first row at the top
        uv: (v, 2) where in the image the vertices are, as in a `ReflectivityPattern`
    """

    solid: Numbers
    uv: Numbers

    def __post_init__(self) -> None:
        """Check shapes and freeze the arrays."""
        object.__setattr__(self, "solid", frozen(self.solid, np.bool_, (None, None)))
        object.__setattr__(self, "uv", frozen(self.uv, np.float32, (None, 2)))


def read_pattern(geometry: Any, kind: Kind) -> tuple[ReflectivityPattern, Numbers | None] | None:
    """Read the pattern of a trimesh mesh, and the (f, 3) faces that it needs; None if it has none.

    Values at faces become values at vertices: the faces returned then have three vertices of their own each, in the
    order of the mesh's corners. Faces of None are those of the mesh.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    pattern_or_values = _reflectivities(geometry) if kind == "reflectivity" else _colours(geometry)
    if isinstance(pattern_or_values, ReflectivityPattern) or pattern_or_values is None:
        return None if pattern_or_values is None else (pattern_or_values, None)
    values, of_faces = pattern_or_values
    if not of_faces:
        return ReflectivityPattern(kind=kind, values=values), None
    faces = np.arange(3 * len(values), dtype=np.uint32).reshape(-1, 3)
    return ReflectivityPattern(kind=kind, values=np.repeat(values, 3)), faces


def _reflectivities(geometry: Any) -> tuple[Numbers, bool] | None:
    """Reflectivity of each vertex (False) or each face (True); None if the mesh has no such property."""
    raw = geometry.metadata.get("_ply_raw") or {}
    for element, count in (("vertex", len(geometry.vertices)), ("face", len(geometry.faces))):
        data = raw.get(element, {}).get("data")
        names = data.keys() if isinstance(data, dict) else (getattr(data, "dtype", None) and data.dtype.names) or ()
        for name in NAMES:
            if name in names:
                values = np.asarray(data[name], dtype=np.float64).reshape(-1)
                if len(values) != count:
                    raise InputError(f"property '{name}' of {len(values)} faces: all must be triangles, got {count}")
                return check_share(values, name), element == "face"
    return None


def check_share(values: Numbers, name: str) -> Numbers:
    """The values of a property of a mesh, if they are reflectivities.

    Raises:
        InputError: if one is below 0 or above 1
    """
    outside = values[~((values >= 0.0) & (values <= 1.0))]
    if len(outside):
        raise InputError(f"property '{name}' must be >= 0 and <= 1, got {outside[0]:g}")
    return values


def _colours(geometry: Any) -> ReflectivityPattern | tuple[Numbers, bool] | None:
    """Red component in linear light: the pattern of an image, or values of vertices (False) or faces (True)."""
    visual = geometry.visual
    if visual.kind == "texture":
        return _texture(visual)
    if visual.kind not in ("vertex", "face"):
        return None
    colours = visual.vertex_colors if visual.kind == "vertex" else visual.face_colors
    red = np.asarray(colours, dtype=np.float64)[:, 0] / 255.0
    return srgb_to_linear(red), visual.kind == "face"


def _texture(visual: Any) -> ReflectivityPattern | None:
    """Pattern of a texture image with its coordinates; None without either."""
    material = visual.material
    image = getattr(material, "image", None)
    if image is None or visual.uv is None:
        return None
    red = srgb_to_linear(np.asarray(image.convert("RGB"), dtype=np.float64)[..., 0] / 255.0)
    # trimesh counts v from the bottom of the image.
    return ReflectivityPattern(
        kind="colour", values=red, uv=np.asarray(visual.uv, dtype=np.float64) * (1.0, -1.0) + (0.0, 1.0)
    )


def srgb_to_linear(value: Numbers) -> Numbers:
    """Linear light of a colour component from 0 to 1 (IEC 61966-2-1)."""
    return np.asarray(np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4))


def mean_over_surface(patterns: list[tuple[ReflectivityPattern, Numbers, Numbers]]) -> float:
    """Mean of the values of these patterns over their triangles, by area. Each comes with vertices and faces.

    An image counts with the mean of its pixels, whatever part of it the triangles show.
    """
    total, area = 0.0, 0.0
    for pattern, vertices, faces in patterns:
        a, b, c = (vertices[faces[:, corner]] for corner in range(3))
        areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        values = pattern.values.mean() if pattern.uv is not None else pattern.values[faces].mean(axis=1)
        total, area = total + float((areas * values).sum()), area + float(areas.sum())
    return total / area if area > 0.0 else 0.0
