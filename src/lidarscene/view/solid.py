"""Triangles of a scene that the page shades, each with its material's colour."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..kernel.world.triangles import sphere, triangles_of_base
from ..maths.arrays import Numbers
from ..maths.trajectory import pose_at
from ..scene.scene import Part, Scene

TINTS = {"glass": (0.55, 0.85, 1.0), "conductor": (0.70, 0.80, 0.95), "retroreflector": (1.0, 0.80, 0.45)}
"""Choice: tint by kind of BSDF: shiny materials get a hue, all others are grey."""

UNKNOWN_REFLECTIVITY = 0.4
"""Choice: reflectivity of a BSDF of a Mitsuba file, for its grey."""

GLASS_ALPHA = 70


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """Triangles with colours; those of glass come last.

    Attributes:
        vertices_m: (v, 3) float64, world
        colours: (v, 4) uint8, red, green, blue, alpha
        faces: (f, 3) uint32
        opaque: number of faces that are not glass
    """

    vertices_m: Numbers
    colours: Numbers
    faces: Numbers
    opaque: int


def solid_of(scene: Scene, wavelength_m: float, *, time_s: float = 0.0) -> Solid:
    """Triangles of all bodies at a time, in the grey of their reflectivity at this wavelength."""
    colour_of = {name: _colour(material.at(wavelength_m)) for name, material in scene.materials.items()}
    default_colour = _colour({"bsdf": "diffuse", "reflectivity": UNKNOWN_REFLECTIVITY})
    coloured_pieces = [
        (vertices, faces, colour_of.get(material, default_colour))
        for vertices, faces, material in _pieces(scene, wavelength_m, time_s)
    ]
    pieces = sorted(coloured_pieces, key=lambda piece: piece[2][3] == GLASS_ALPHA)
    vertex_counts = [len(vertices) for vertices, _, _ in pieces]
    starts = np.cumsum([0, *vertex_counts])[:-1]
    faces = [triangles.astype(np.int64) + start for (_, triangles, _), start in zip(pieces, starts, strict=True)]
    return Solid(
        vertices_m=np.concatenate([np.zeros((0, 3)), *(vertices for vertices, _, _ in pieces)]),
        colours=np.repeat(
            np.array([colour for _, _, colour in pieces], np.uint8).reshape(-1, 4), vertex_counts, axis=0
        ),
        faces=np.concatenate([np.zeros((0, 3), np.int64), *faces]).astype(np.uint32),
        opaque=sum(len(triangles) for _, triangles, colour in pieces if colour[3] == 255),
    )


def _pieces(scene: Scene, wavelength_m: float, time_s: float) -> Iterator[tuple[Numbers, Numbers, str]]:
    """Yield vertices in the world, faces and material name of every part."""
    for body in scene.bodies:
        if not body.is_present(time_s):
            continue
        pose = body.pose if body.motion is None else pose_at(body.motion, time_s)
        for part in body.posed(time_s, time_s).parts:
            if isinstance(part, Part):
                yield pose.apply(part.vertices_m), part.faces, part.material
            else:
                vertices, faces = sphere(part.radius_m)
                yield pose.apply(vertices), faces, part.material
    for base_shape in triangles_of_base(scene, wavelength_m):
        yield base_shape.vertices_m, base_shape.faces, base_shape.material


def _colour(values: dict[str, Any]) -> tuple[int, int, int, int]:
    """RGBA of a material: grey goes with the root of the reflectivity, close to a screen's gamma, times the tint."""
    kind = values["bsdf"]
    bright = 0.85 if kind in TINTS else 0.2 + 0.65 * float(values["reflectivity"]) ** 0.5
    red, green, blue = (round(255 * bright * share) for share in TINTS.get(kind, (1.0, 1.0, 1.0)))
    return red, green, blue, GLASS_ALPHA if kind == "glass" else 255
