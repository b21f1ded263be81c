"""Tables of a world by face and by shape: what stands behind a hit.

A hit is a shape's number in Mitsuba's registry and a triangle's number in that shape. The shape's number leads to that
of its first face; the sum is the face's number in the tables of bodies, materials and normals. Of what moves several
bodies share a face: each has rows of its own in the tables of bodies and materials, one for each shape.

Symbols: f faces (triangles, or a whole sphere) over all shapes, in the order in which shapes were added; m movers, s
their shapes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...maths.arrays import Numbers
from ...scene.scene import Part
from ..device import transfer
from ..device.backend import mitsuba
from ..device.types import Shape
from .bsdfs import absorption, diffuse_share
from .speculars import Speculars, SurfaceOptics


@dataclass(frozen=True, slots=True, eq=False)
class PlacedShape:
    """A Mitsuba shape on its way into a world.

    Attributes:
        face_body: (faces,) index of the body of each face
        values: its material by `Material.at`; None for a BSDF of a Mitsuba file
        parts: of the bodies, whose faces it has one after the other
        is_plain: whether it is a mesh without smooth normals and images
        is_varied: whether its reflectivity varies over it
        is_cut: whether an image cuts gaps into it
    """

    shape: Any
    face_body: Numbers
    material: str
    values: Mapping[str, Any] | None
    parts: tuple[Part, ...] = ()
    is_plain: bool = False
    is_varied: bool = False
    is_cut: bool = False

    @property
    def reflectivity(self) -> float | None:
        """Diffuse reflectivity; None: ask the BSDF."""
        return None if self.values is None or self.is_varied else diffuse_share(self.values)

    @property
    def transmittance(self) -> float:
        """Diffuse transmittance; 0 if it is opaque."""
        return self._parameter("transmittance")

    @property
    def free_path_m(self) -> float:
        """Mean free path behind a porous surface; 0 if all of it is on the surface."""
        return self._parameter("free_path_m")

    def _parameter(self, name: str) -> float:
        return 0.0 if self.values is None else self.values.get(name, 0.0)

    @property
    def absorbs(self) -> tuple[float, float] | None:
        """`bsdfs.absorption` of a pane; None if it does not absorb."""
        return None if self.values is None else absorption(self.values)


class FaceTables:
    """Per-face body and material indices, concatenated over shapes: what a World looks up behind a hit."""

    def __init__(self) -> None:
        self._body: list[Numbers] = []
        self._material: list[Numbers] = []
        self._first: list[tuple[PlacedShape, int]] = []
        self._faces = 0
        self._movers: list[int] = []
        self._mover_shapes: list[PlacedShape] = []
        self.material_names: dict[str, int] = {}

    def add(self, shapes: Sequence[PlacedShape]) -> None:
        """Append the faces of these shapes."""
        for shape in shapes:
            count = len(shape.face_body)
            material = self.material_names.setdefault(shape.material, len(self.material_names))
            self._body.append(shape.face_body)
            self._material.append(np.full(count, material, np.int32))
            self._first.append((shape, self._faces))
            self._faces += count

    def add_movers(self, shapes: Sequence[PlacedShape], bodies: Sequence[int]) -> None:
        """Append the faces of all movers' shapes, and a row for each of these bodies with each shape."""
        self.add(shapes)
        self._movers, self._mover_shapes = list(bodies), list(shapes)

    def first_of(self, shapes: Sequence[PlacedShape]) -> list[int]:
        """Return the number of the first face of each of these shapes."""
        first = {id(shape): start for shape, start in self._first}
        return [first[id(shape)] for shape in shapes]

    def on_device(self, see_through: bool) -> dict[str, Any]:
        """Return the fields of World that are looked up by a shape's registry number or by a face."""
        # Registry numbers are positive, with holes, and used again after shapes are freed. They are small, so a table
        # with unused rows is the simplest map from number to shape.
        numbers = [registry_number(shape.shape) for shape, _ in self._first]
        first_face, bsdf_index, mover_shape = np.zeros((3, max(numbers) + 1), dtype=np.uint32)
        reflectivity, transmittance = np.zeros((2, max(numbers) + 1), dtype=np.float32)
        # In the order of the materials, which is that of all parts of a scene.
        shapes = sorted((shape for shape, _ in self._first), key=lambda s: self.material_names[s.material])
        bsdfs = {_bsdf_number(shape.shape): shape.shape.bsdf() for shape in shapes}
        places = {number: place for place, number in enumerate(bsdfs)}
        for number, (shape, start) in zip(numbers, self._first, strict=True):
            first_face[number] = start
            bsdf_index[number] = places[_bsdf_number(shape.shape)]
            reflectivity[number] = -1.0 if shape.reflectivity is None else shape.reflectivity
            transmittance[number] = shape.transmittance
        per_mover = [self.material_names[shape.material] for shape in self._mover_shapes]
        mover_shape[numbers[len(numbers) - len(per_mover) :]] = np.arange(len(per_mover))
        mover_rows = self._faces + len(per_mover) * np.arange(len(self._movers))
        body = [*self._body, np.repeat(np.array(self._movers, np.int32), len(per_mover))]
        material = [*self._material, np.tile(np.array(per_mover, np.int32), len(self._movers))]
        return {
            "first_face": transfer.unsigned_numbers(first_face),
            "mover_rows": transfer.unsigned_numbers(mover_rows) if self._movers else None,
            "mover_shape": transfer.unsigned_numbers(mover_shape) if self._movers else None,
            "bsdfs": tuple(bsdfs.values()),
            "bsdf_index": transfer.unsigned_numbers(bsdf_index),
            "shape_reflectivity": transfer.from_numpy(reflectivity),
            "shape_transmittance": transfer.from_numpy(transmittance) if transmittance.any() else None,
            "face_normal": self._normals(),
            "face_body": transfer.whole_numbers(np.concatenate(body)),
            "face_material": transfer.whole_numbers(np.concatenate(material)),
            "material_names": tuple(self.material_names),
            "has_foreign": any(shape.reflectivity is None for shape, _ in self._first),
            "speculars": Speculars.from_shapes([_surface_optics(shape) for shape, _ in self._first])
            if see_through
            else None,
        }

    def _normals(self) -> Any:
        """Return `World.face_normal`, computed from the vertices as Mitsuba holds them, in single precision."""
        import drjit as dr

        mi = mitsuba()
        # One shape that is not plain (a sphere, a shape of a Mitsuba file) sends all hits to Mitsuba's own interaction:
        # a kernel with both ways would pay for both.
        if not all(shape.is_plain for shape, _ in self._first):
            return None
        table = dr.zeros(mi.Float, 4 * self._faces)
        for shape, first in self._first:
            vertices, faces = shape.shape.vertex_positions_buffer(), shape.shape.faces_buffer()
            number = dr.arange(mi.UInt32, len(shape.face_body))
            a, b, c = (dr.gather(mi.Point3f, vertices, dr.gather(mi.UInt32, faces, 3 * number + i)) for i in range(3))
            normal = dr.normalize(dr.cross(b - a, c - a))
            # Numbers are opaque, or each shape would compile a kernel of its own.
            start, shape_number = (transfer.opaque_uint32(value) for value in (first, registry_number(shape.shape)))
            dr.scatter(table, mi.Vector4f(*normal, shape_number), number + start)
        dr.eval(table)
        return table


def _surface_optics(shape: PlacedShape) -> SurfaceOptics:
    """Return what `Speculars` needs of a shape."""
    # Our materials are known by name, whole and with gaps cut into them. In a Mitsuba file one name may stand for
    # several BSDFs: their registry number is the identity.
    return SurfaceOptics(
        number=registry_number(shape.shape),
        bsdf=shape.shape.bsdf(),
        material=_bsdf_number(shape.shape) if shape.reflectivity is None else (shape.material, shape.is_cut),
        absorbs=shape.absorbs,
        is_retro=shape.values is not None and shape.values["bsdf"] == "retroreflector",
        free_path_m=shape.free_path_m,
    )


def _bsdf_number(shape: Shape) -> int:
    """Return the number of a shape's BSDF in Mitsuba's registry."""
    import drjit as dr

    mi = mitsuba()
    return int(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(shape.bsdf()))[0])


def registry_number(shape: Shape) -> int:
    """Return a shape's number in Mitsuba's registry, which is its pointer on the device."""
    import drjit as dr

    mi = mitsuba()
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])
