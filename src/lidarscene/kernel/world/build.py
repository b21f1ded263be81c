"""World: a `Scene` compiled for one wavelength. One mesh for each material; identity is the triangle's number.

What moves is traced apart, in its own frame, so that nothing is built again when it does (MITSUBA.md 5.5).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from ...maths.arrays import Numbers
from ...maths.paths import Placement
from ...maths.pose import Pose
from ...maths.trajectory import Motion
from ...scene.model import Ball, Body, Part, Scene
from ..device import transfer
from ..device.backend import mitsuba
from . import mitsuba_xml
from .bsdfs import absorption, bsdf_dict, diffuse_share
from .speculars import Speculars, lets_through


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mover:
    """A body that moves. Bodies of one shape share one Mitsuba scene.

    scene       Mitsuba scene of what is no pane, in the body's frame; None where there is nothing of it
    panes       the same of its panes and porous surfaces
    sphere      (x, y, z, radius) around all of it, in the body's frame; opaque
    face_shift  from the numbers of the shared scene's faces to this body's, UInt32; opaque
    motion      where it is
    rest        where it is at time 0, in the traced frame; opaque
    """

    scene: Any
    panes: Any
    sphere: tuple[Any, ...]
    face_shift: Any
    motion: Motion
    rest: Placement


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """What the kernel traces, and the tables that say what a triangle is.

    scene           Mitsuba scene of what stands still and is neither pane nor porous; vertices are relative to
                    ``centre_m``
    panes           the same of panes and porous surfaces; None where there is none
    movers          what moves
    centre_m        (3,) float64: what was taken off every coordinate before it became single precision
    first_face, shape_reflectivity, shape_transmittance
                    by Mitsuba's registry number of a shape; reflectivity -1: ask the BSDF; transmittance None: all
                    are opaque
    face_normal     (4 f,) Float on the device, the unit normal of each face and a number to fill four, all zero for
                    faces that share their shape with others; None where some shape is no mesh of plain triangles
    face_body       (f,) Int32 on the device, index into ``body_names``
    face_material   (f,) Int32 on the device, index into ``material_names``
    body_class      (b,) Int32 on the device, index into ``class_names``
    has_foreign     whether some BSDF comes from a Mitsuba file as it is
    speculars       where a beam goes on, or None: nowhere
    see_through     whether it was built for beams that go on at all
    """

    scene: Any
    panes: Any
    movers: tuple[Mover, ...]
    centre_m: Numbers
    first_face: Any
    shape_reflectivity: Any
    shape_transmittance: Any
    face_normal: Any
    face_body: Any
    face_material: Any
    body_class: Any
    body_names: tuple[str, ...]
    class_names: tuple[str, ...]
    material_names: tuple[str, ...]
    has_foreign: bool
    speculars: Speculars | None
    see_through: bool

    @property
    def has_panes(self) -> bool:
        """Whether anything lets light through, or has gaps."""
        return self.speculars is not None and self.speculars.lets_through


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """A Mitsuba shape, who its faces are, and its material by `Material.at`; None where only its BSDF knows it.

    is_plain  whether it is a mesh that is flat between its edges and looks the same all over
    """

    shape: Any
    face_body: Numbers
    material: str
    values: Mapping[str, Any] | None
    is_plain: bool = False

    @property
    def reflectivity(self) -> float | None:
        return None if self.values is None else diffuse_share(self.values)

    @property
    def transmittance(self) -> float:
        return 0.0 if self.values is None else self.values.get("transmittance", 0.0)

    @property
    def absorbs(self) -> tuple[float, float] | None:
        return None if self.values is None else absorption(self.values)


@dataclass(frozen=True, slots=True, eq=False)
class _Moving:
    """The bodies of one shape that move: their indices, and their shapes, whose faces are the first body's."""

    bodies: tuple[int, ...]
    shapes: list[_Shape]


def build_world(
    scene: Scene, *, wavelength_m: float, centre_m: Numbers | None = None, see_through: bool = True
) -> World:
    """Compile a scene.

    centre_m  (3,) point that becomes the origin of the traced coordinates: put it where the rays start, so
              that single precision is spent where it counts. A scene from a Mitsuba file keeps its origin.
    see_through  whether beams go on through panes and off mirrors; else they end there, and that is traced faster
    Raises InputError where a material has no data at the wavelength.
    """
    centre = np.zeros(3) if centre_m is None or scene.base else np.asarray(centre_m, dtype=np.float64)
    resolved = {name: material.at(wavelength_m) for name, material in scene.materials.items()}
    still = {i: body for i, body in enumerate(scene.bodies) if body.motion is None}
    shapes = _own_shapes(still, centre, resolved)
    moving = _moving(scene.bodies, resolved)
    body_names = [body.name for body in scene.bodies]
    class_of = [body.class_name for body in scene.bodies]
    if scene.base is not None:
        for found in mitsuba_xml.load_shapes(scene.base, scene.base_materials, resolved):
            index = np.full(found.faces, len(body_names), dtype=np.int32)
            body_names.append(found.name)
            class_of.append("unlabelled")
            values = None if found.reflectivity is None else resolved[found.material]
            shapes.append(_Shape(found.shape, index, found.material, values))
    if not shapes and not moving:
        raise InputError(f"scene '{scene.name}': nothing to trace, every body is empty")
    faces = _FaceTables()
    faces.add(shapes)
    movers: list[Mover] = []
    for group in moving:
        traced, panes = _mitsuba_scenes(group.shapes, see_through)
        # The first body's faces are those that hits have; each other body's are the same ones further on.
        starts = [faces.add(group.shapes, body=index) for index in group.bodies]
        movers += [
            _mover(traced, panes, scene.bodies[index], centre, start - starts[0])
            for index, start in zip(group.bodies, starts, strict=True)
        ]
    class_names = tuple(dict.fromkeys(class_of))
    class_numbers = np.array([class_names.index(name) for name in class_of], dtype=np.int32)
    standing, panes = _mitsuba_scenes(shapes, see_through)
    return World(
        scene=standing,
        panes=panes,
        see_through=see_through,
        movers=tuple(movers),
        centre_m=centre,
        body_class=mitsuba().Int32(class_numbers),
        body_names=tuple(body_names),
        class_names=class_names,
        **faces.on_device(see_through),
    )


def _own_shapes(bodies: Mapping[int, Body], centre: Numbers, resolved: dict[str, Any]) -> list[_Shape]:
    """One mesh for each material, over all these bodies where they stand, and a shape for each exact sphere."""
    mi = mitsuba()
    grouped: dict[str, list[tuple[int, Numbers, Numbers]]] = {}
    shapes: list[_Shape] = []
    for index, body in bodies.items():
        for part in body.parts:
            if isinstance(part, Part):
                if not len(part.faces):
                    continue
                placed = body.pose.apply(part.vertices_m) - centre
                grouped.setdefault(part.material, []).append((index, placed, part.faces))
            else:
                shapes.append(_ball(mi, part, body.pose.position_m - centre, index, resolved))
    for material, pieces in grouped.items():
        shapes.append(_merged(mi, material, pieces, resolved[material]))
    return shapes


def _moving(bodies: Sequence[Body], resolved: dict[str, Any]) -> list[_Moving]:
    """The bodies that move, by their shapes, each in its own frame."""
    sharing: dict[int, list[int]] = {}
    for index, body in enumerate(bodies):
        if body.motion is not None:
            sharing.setdefault(id(body.parts), []).append(index)
    moving = []
    for indices in sharing.values():
        first = bodies[indices[0]]
        at_origin = Body(name=first.name, class_name=first.class_name, parts=first.parts)
        shapes = _own_shapes({indices[0]: at_origin}, np.zeros(3), resolved)
        if shapes:
            moving.append(_Moving(tuple(indices), shapes))
    return moving


def _merged(mi: Any, material: str, pieces: Sequence[tuple[int, Numbers, Numbers]], values: Any) -> _Shape:
    counts = [len(vertices) for _, vertices, _ in pieces]
    starts = np.cumsum([0, *counts[:-1]])
    vertices = np.concatenate([v for _, v, _ in pieces]).astype(np.float32)
    faces = np.concatenate(
        [f.astype(np.int64) + start for (_, _, f), start in zip(pieces, starts, strict=True)]
    )
    bodies = np.concatenate([np.full(len(f), index, dtype=np.int32) for index, _, f in pieces])
    props = mi.Properties()
    props["mesh_bsdf"] = mi.load_dict(bsdf_dict(values))
    mesh = mi.Mesh(material, len(vertices), len(faces), props=props)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return _Shape(mesh, bodies, material, values, is_plain=True)


def _ball(mi: Any, ball: Ball, centre_m: Numbers, index: int, resolved: dict[str, Any]) -> _Shape:
    values = resolved[ball.material]
    shape = mi.load_dict(
        {
            "type": "sphere", "center": [float(c) for c in centre_m], "radius": float(ball.radius_m),
            "bsdf": bsdf_dict(values),
        }
    )  # fmt: skip
    return _Shape(shape, np.array([index], np.int32), ball.material, values)


def _mitsuba_scenes(shapes: Sequence[_Shape], see_through: bool) -> tuple[Any, Any]:
    """Of what is no pane, or all where beams go through none, and of panes; None where there is nothing of it."""
    panes = [shape for shape in shapes if see_through and lets_through(shape.shape.bsdf())]
    others = [shape for shape in shapes if shape not in panes]
    return _mitsuba_scene(others), _mitsuba_scene(panes)


def _mitsuba_scene(shapes: Sequence[_Shape]) -> Any:
    if not shapes:
        return None
    # Without robust intersections a ray that meets a shared edge exactly may pass between its triangles. They
    # cost 8 % of the tracing and build three times as fast (measured on street.toml); a shape group, the other
    # way to a fast build (MITSUBA.md 5.5), would lose the setting.
    settings = {"type": "scene", "embree_use_robust_intersections": True}
    children = {f"shape_{i}": shape.shape for i, shape in enumerate(shapes)}
    return mitsuba().load_dict(settings | children, optimize=False)


class _FaceTables:
    """Who each face is, shape after shape: what a World looks up behind a hit."""

    def __init__(self) -> None:
        self._body: list[Numbers] = []
        self._material: list[Numbers] = []
        self._first: dict[int, tuple[_Shape, int]] = {}
        self._faces = 0
        self.material_names: dict[str, int] = {}

    def add(self, shapes: Sequence[_Shape], *, body: int | None = None) -> int:
        """Append the faces of these shapes, all of one body if it is given; returns the number of the first.

        Shapes that came before get a second set of faces; a hit's face is in the first one.
        """
        start = self._faces
        for shape in shapes:
            count = len(shape.face_body)
            material = self.material_names.setdefault(shape.material, len(self.material_names))
            self._body.append(shape.face_body if body is None else np.full(count, body, np.int32))
            self._material.append(np.full(count, material, np.int32))
            self._first.setdefault(id(shape), (shape, self._faces))
            self._faces += count
        return start

    def on_device(self, see_through: bool) -> dict[str, Any]:
        """The fields of World that are looked up by a shape's registry number, or by a face."""
        mi = mitsuba()
        numbers = [_registry_number(shape.shape) for shape, _ in self._first.values()]
        first_face = np.zeros(max(numbers) + 1, dtype=np.uint32)
        reflectivity, transmittance = np.zeros((2, max(numbers) + 1), dtype=np.float32)
        for number, (shape, start) in zip(numbers, self._first.values(), strict=True):
            first_face[number] = start
            reflectivity[number] = -1.0 if shape.reflectivity is None else shape.reflectivity
            transmittance[number] = shape.transmittance
        return {
            "first_face": mi.UInt32(first_face),
            "shape_reflectivity": mi.Float(reflectivity),
            "shape_transmittance": mi.Float(transmittance) if transmittance.any() else None,
            "face_normal": self._normals(),
            "face_body": mi.Int32(np.concatenate(self._body)),
            "face_material": mi.Int32(np.concatenate(self._material)),
            "material_names": tuple(self.material_names),
            "has_foreign": any(shape.reflectivity is None for shape, _ in self._first.values()),
            "speculars": Speculars.of([_surface(shape) for shape, _ in self._first.values()])
            if see_through
            else None,
        }

    def _normals(self) -> Any:
        """As World has them."""
        import drjit as dr

        mi = mitsuba()
        if not all(shape.is_plain for shape, _ in self._first.values()):
            return None
        table = dr.zeros(mi.Float, 4 * self._faces)
        for shape, start in self._first.values():
            vertices, faces = shape.shape.vertex_positions_buffer(), shape.shape.faces_buffer()
            number = dr.arange(mi.UInt32, len(shape.face_body))
            a, b, c = (
                dr.gather(mi.Point3f, vertices, dr.gather(mi.UInt32, faces, 3 * number + i)) for i in range(3)
            )
            normal = dr.normalize(dr.cross(b - a, c - a))
            dr.scatter(table, mi.Vector4f(*normal, 0.0), number + transfer.opaque_uint32(start))
        dr.eval(table)
        return table


def _surface(shape: _Shape) -> tuple[int, Any, Hashable, Any]:
    """A shape's number, its BSDF, what that is (a name in a Mitsuba file may stand for several), what it absorbs."""
    import drjit as dr

    mi = mitsuba()
    bsdf = shape.shape.bsdf()
    own = int(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(bsdf))[0])
    return (
        _registry_number(shape.shape),
        bsdf,
        own if shape.reflectivity is None else shape.material,
        shape.absorbs,
    )


def _registry_number(shape: Any) -> int:
    """By which the device knows a shape."""
    import drjit as dr

    mi = mitsuba()
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def _mover(scene: Any, panes: Any, body: Body, centre: Numbers, face_shift: int) -> Mover:
    low, high = _extent(body)
    middle = (low + high) / 2.0
    radius = float(np.linalg.norm(high - low)) / 2.0
    assert body.motion is not None
    return Mover(
        scene=scene,
        panes=panes,
        sphere=transfer.opaque((*(float(x) for x in middle), radius)),
        face_shift=transfer.opaque_uint32(face_shift),
        motion=body.motion,
        rest=at_rest(body.pose, centre),
    )


def at_rest(pose: Pose, centre_m: Numbers) -> Placement:
    """A pose as a placement in the traced frame, its numbers on the device."""
    numbers = [float(x) for x in (*(pose.position_m - centre_m), *pose.rotation.ravel())]
    x, y, z, *rotation = transfer.opaque(tuple(numbers))
    return Placement(origin_m=(x, y, z), rotation=tuple(rotation))


def _extent(body: Body) -> tuple[Numbers, Numbers]:
    """Corners of the box around a body, in its frame."""
    corners = [
        part.vertices_m if isinstance(part, Part) else np.outer([-1.0, 1.0], [part.radius_m] * 3)
        for part in body.parts
    ]
    points = np.concatenate(corners)
    return points.min(axis=0), points.max(axis=0)
