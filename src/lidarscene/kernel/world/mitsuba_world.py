"""Compile a `Scene` for one wavelength into Mitsuba scenes and lookup tables: the `World`.

Three measurements decide its form. Every shape costs time on each call and triangles do not (256 boxes as 256 meshes
take a hundred times as long as in one mesh), so all parts of one material become one mesh. Mitsuba's identities of
shapes are no indices and differ between back ends, so the triangle's number is the identity, and tables say which body,
class and material it belongs to. Moving a shape makes Embree rebuild everything (0.5 s beside a mesh of 330,000
triangles), so all bodies that move are in a Mitsuba scene in which they stand still (`mover_scene`, `rays.meeting`).

Symbols: b bodies, f faces (triangles, or a whole sphere) over all shapes, in the order in which shapes were added, m
movers, s their shapes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ...errors import InputError, OptionWarning, warn
from ...maths.arrays import Mask, Numbers, retire_with
from ...maths.motion_table import NOWHERE, MotionTable, MovingBodies, Placement, Strides
from ...maths.pose import Pose
from ...maths.trajectory import CLOCK_ROUNDING_S, Course, Motion
from ...scene.scene import Ball, Body, Part, Scene, box_of
from ..device import transfer
from ..device.backend import mitsuba, require_scene_trial
from ..device.choice import ask_one
from ..device.gate import exclusive, retire
from ..device.types import Bsdf, Interaction
from . import merged_meshes, mitsuba_xml
from .bsdfs import ATTRIBUTE, bsdf_dict, has_gaps, make_bsdf, reflectivities, texture, texture_key
from .faces import FaceTables, PlacedShape
from .mover_scene import MoverScene, mitsuba_scenes, side_by_side
from .speculars import Speculars, lets_through
from .walkers import Walkers


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mover:
    """A body that moves. Bodies with the same parts share their shapes, and follow each other.

    Attributes:
        box_m: (2, 3) float64, numpy; lowest and highest corner of a box around it, in its frame
        number: of the body among the scene's bodies
        body: the body, with its motion
        others: numbers and bodies of the same shape and class that take its place in frames that do not show it
    """

    box_m: Numbers
    number: int
    body: Body
    others: tuple[tuple[int, Body], ...] = ()

    def in_frame(self, start_s: float) -> Mover:
        """Return the mover of the body that a frame shows in this place; itself if there is none."""
        if self.body.is_present(start_s):
            return self
        shown = ((number, body) for number, body in self.others if body.is_present(start_s))
        return next((replace(self, number=number, body=body) for number, body in shown), self)

    def walk_in_frame(self, start_s: float) -> Strides | None:
        """Return `Body.walk_in_frame`; None for one that the frame does not show, too."""
        return self.body.walk_in_frame(start_s) if self.body.is_present(start_s) else None

    @property
    def motion(self) -> Motion:
        """Pose of the body over time."""
        assert self.body.motion is not None
        return self.body.motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, weakref_slot=True)
class World:
    """Mitsuba scenes that the kernel traces, and the tables that identify a triangle. Device arrays unless stated.

    Attributes:
        scene: Mitsuba scene of what stands still, panes and porous surfaces left out; None if there is nothing.
            Vertices are relative to ``centre_m``
        panes: Mitsuba scene of panes and porous surfaces that stand still; None if there are none
        movers: what moves
        mover_scene: Mitsuba scene of all of them, without panes and porous surfaces; None if there is nothing
        mover_panes: likewise of these
        mover_rows: (movers,) UInt32, the first of the rows of each in `face_body` and `face_material`, one for each
            shape; None if nothing moves
        centre_m: (3,) float64, numpy; subtracted from every coordinate before it became single precision
        bsdfs: Mitsuba BSDFs of all its surfaces, each once
        bsdf_of_material: those without images and gaps of their own, by material; another world can use them, too
        first_face: by the registry number of a shape: number of its first face; index into ``bsdfs``; diffuse
            reflectivity (-1: ask the BSDF); diffuse transmittance (None: every shape is opaque)
        mover_shape: number of a shape among those of the movers, as `first_face`; None if nothing moves
        bsdf_index: as `first_face`
        shape_reflectivity: as `first_face`
        shape_transmittance: as `first_face`
        face_normal: (4 f,) Float, unit normal of each face and the registry number of its shape, below 2^24. None if
            some shape is not a mesh of flat triangles
        face_body: (f + m s,) Int32, index into ``body_names``
        face_material: (f + m s,) Int32, index into ``material_names``
        body_class: (b,) Int32, index into ``class_names``
        has_foreign: whether some BSDF was taken from a Mitsuba file unchanged
        speculars: panes, mirrors and porous surfaces; None if there are none, or if they end every beam
        see_through: whether the world was built for beams that go on behind panes and mirrors
        scene_of: the scene that was compiled
    """

    scene: Any
    panes: Any
    movers: tuple[Mover, ...]
    mover_scene: MoverScene | None
    mover_panes: MoverScene | None
    mover_rows: Any
    centre_m: Numbers
    bsdfs: tuple[Bsdf, ...]
    bsdf_of_material: Mapping[str, object]
    first_face: Any
    mover_shape: Any
    bsdf_index: Any
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
    scene_of: Scene

    def __post_init__(self) -> None:
        """Keep the Mitsuba scenes, should this go while another thread traces, until that is done."""
        things = self.scene, self.panes, self.mover_scene, self.mover_panes, self.speculars, self.bsdfs
        retire_with(self, *things, then=retire)

    def ask_bsdf(self, ask: Callable[..., object], surface: Interaction, *arguments: object, active: Mask) -> Any:
        """Return what the BSDF of the surface that each active ray met answers; zeros for the others.

        Args:
            ask: takes a BSDF, the surface, the arguments and whether each ray is active
        """
        import drjit as dr

        mi = mitsuba()
        shape = dr.reinterpret_array(mi.UInt32, surface.shape)
        index = dr.gather(mi.UInt32, self.bsdf_index, shape, active)
        return ask_one(self.bsdfs, index, ask, surface, *arguments, active=active)

    def bodies_in_frame(self, start_s: float) -> Numbers | None:
        """Return the number of the body that a frame shows by that of the body in the tables, the last entry for none.

        None if each is itself.
        """
        if not any(mover.others for mover in self.movers):
            return None
        numbers = np.append(np.arange(len(self.body_names), dtype=np.int32), np.int32(-1))
        for mover in self.movers:
            numbers[mover.number] = mover.in_frame(start_s).number
        return numbers

    def with_bodies(self, bodies: Sequence[Body]) -> World:
        """Return this world with its movers where ``bodies`` of the scene are now; nothing is compiled again.

        The arrays that recorded kernels use stay as they are: only later frames follow the new motions.
        """
        return replace(self, movers=tuple(replace(mover, body=bodies[mover.number]) for mover in self.movers))


@dataclass(frozen=True, slots=True, eq=False)
class _BodiesOfOneShape:
    """Moving bodies with the same parts: their indices, and where the origin of their frame is in their scene, (3,)."""

    bodies: tuple[int, ...]
    offset_m: Numbers


@exclusive
def build_world(
    scene: Scene,
    *,
    wavelength_m: float,
    centre_m: Numbers | None = None,
    see_through: bool = True,
    takes_turns: bool = True,
    standing: Collection[str] | None = None,
    bsdf_of_material: Mapping[str, object] | None = None,
) -> World:
    """Compile a scene.

    Args:
        centre_m: (3,) point that becomes the origin of the traced coordinates: the place of the sensor. Float32 errors
            grow with the distance from the origin. A scene from a Mitsuba file keeps its origin
        see_through: whether beams go on through panes and off mirrors; if not they end there, which is traced faster
        takes_turns: whether bodies that hide may share a place; not if they are placed elsewhere later (`with_bodies`)
        standing: names of the bodies that stand still and are there; None: all of them
        bsdf_of_material: that of another world of the scene at this wavelength

    Raises:
        InputError: if a material has no data at the wavelength, or if there is nothing to trace
    """
    if scene.base is not None:
        require_scene_trial(scene)
    # In double precision, before anything becomes float32: at 5,000 km, a UTM northing, float32 is good to 4 m.
    centre = np.zeros(3) if centre_m is None or scene.base else np.asarray(centre_m, dtype=np.float64)
    resolved = {name: material.at(wavelength_m) for name, material in scene.materials.items()}
    still = {i: body for i, body in enumerate(scene.bodies) if body.motion is None}
    bsdfs = dict(bsdf_of_material or {})
    if standing is not None:
        still = _near_and_of_all_materials(still, standing)
    shapes = _loaded_shapes(still, centre, resolved, bsdfs)
    moving = _moving_groups(scene.bodies)
    first_of_groups = {group.bodies[0]: group.offset_m for group in moving}
    # What walks is met as its vertices are then (`walkers`): its shapes are in no scene, and have a BSDF and images.
    in_cells, walking = (
        {number: _placed_alone(scene.bodies[number], place, walks) for number, place in first_of_groups.items()}
        for walks in (False, True)
    )
    rigid_shapes, walking_shapes = (
        _loaded_shapes(bodies, np.zeros(3), resolved, bsdfs) for bodies in (in_cells, walking)
    )
    mover_shapes = rigid_shapes + walking_shapes
    body_names = [body.name for body in scene.bodies]
    class_of = [body.class_name for body in scene.bodies]
    if scene.base is not None:
        file_shapes = mitsuba_xml.load_shapes(scene.base, scene.base_materials, resolved, wavelength_m)
        _warn_of_stand_ins(file_shapes, scene.base)
        shapes += merged_meshes.merge_by_bsdf(file_shapes, len(body_names))
        body_names += [shape.name for shape in file_shapes]
        class_of += ["unlabelled"] * len(file_shapes)
        del file_shapes  # the shapes of the file: each one that lives costs time in every frame
    if not shapes and not moving:
        raise InputError(f"scene '{scene.name}': nothing to trace, every body is empty")
    faces = FaceTables()
    if standing is not None:
        # The same numbers of materials in all parts of a scene.
        faces.material_names.update({name: number for number, name in enumerate(scene.materials)})
    faces.add(shapes)
    movers: list[Mover] = []
    offsets_m: list[Numbers] = []
    for group in moving:
        # Bodies that hide take turns: those of which no two are ever shown at a time share a place among the movers. So
        # there are as many as the most bodies that are there at a time need.
        turns = _turns(scene.bodies, group.bodies) if takes_turns else [[index] for index in group.bodies]
        offsets_m += [group.offset_m] * len(turns)
        for turn in turns:
            mover = _mover(scene.bodies, number=turn[0])
            movers.append(replace(mover, others=tuple((index, scene.bodies[index]) for index in turn[1:])))
    faces.add_movers(mover_shapes, [mover.number for mover in movers])
    class_names = tuple(dict.fromkeys(class_of))
    class_numbers = np.array([class_names.index(name) for name in class_of], dtype=np.int32)
    solid, panes = _panes_apart(shapes, see_through)
    rigid_apart = _panes_apart(rigid_shapes, see_through)
    still_scene, still_panes, *of_movers = mitsuba_scenes([solid, panes, *rigid_apart])
    mover_scene, mover_panes = (
        MoverScene.of_cells(
            rigid_scene,
            boxes_m=_boxes_of_materials(movers, rigid),
            offsets_m=offsets_m,
            walkers=Walkers.of_shapes(walks, [mover.body for mover in movers], faces.first_of(walks)),
        )
        for rigid_scene, rigid, walks in zip(
            of_movers, rigid_apart, _panes_apart(walking_shapes, see_through), strict=True
        )
    )
    return World(
        scene=still_scene,
        panes=still_panes,
        see_through=see_through,
        scene_of=scene,
        bsdf_of_material=bsdfs,
        movers=tuple(movers),
        mover_scene=mover_scene,
        mover_panes=mover_panes,
        centre_m=centre,
        body_class=transfer.whole_numbers(class_numbers),
        body_names=tuple(body_names),
        class_names=class_names,
        **faces.on_device(see_through),
    )


def _warn_of_stand_ins(shapes: Sequence[mitsuba_xml.FileShape], path: Path) -> None:
    """Warn of materials that were chosen by the names of BSDFs."""
    chosen = {shape.assumed: shape.material for shape in shapes if shape.assumed}
    if chosen:
        pairs = ", ".join(f"{bsdf} is {material}" for bsdf, material in sorted(chosen.items()))
        warn(
            OptionWarning(
                "{0}: BSDFs that Mitsuba does not have are of the catalogue's materials, by their names: {1}; "
                "base_materials can name others",
                path,
                pairs,
            )
        )


def _loaded_shapes(
    bodies: Mapping[int, Body], centre: Numbers, resolved: dict[str, dict[str, object]], bsdfs: dict[str, object]
) -> list[PlacedShape]:
    """Return one mesh for each material and image of these bodies, where they stand, and a shape for each sphere.

    Args:
        bsdfs: by material, those of worlds so far: a coat's takes 10 ms to make
    """
    mi = mitsuba()
    grouped: dict[Hashable, list[tuple[int, Pose, Part]]] = {}
    shapes: list[PlacedShape] = []
    for index, body in bodies.items():
        for part in body.parts:
            if isinstance(part, Part):
                if not len(part.faces):
                    continue
                grouped.setdefault(_mesh_key(part), []).append((index, body.pose, part))
            else:
                shapes.append(_ball_shape(mi, part, body.pose.position_m - centre, index, resolved))
    for pieces in grouped.values():
        first = pieces[0][2]
        material, pattern = first.material, first.pattern
        values = resolved[material]
        cutout = first.cutout if has_gaps(first.cutout, values) else None
        if pattern is not None or cutout is not None:
            bsdf = make_bsdf(values, None if pattern is None else texture(pattern, values), cutout)
        elif (bsdf := bsdfs.get(material)) is None:
            bsdf = bsdfs[material] = make_bsdf(values)
        shapes.append(_merged_mesh(mi, centre, pieces, values, bsdf, is_cut=cutout is not None))
    return shapes


def _near_and_of_all_materials(bodies: Mapping[int, Body], near: Collection[str]) -> dict[int, Body]:
    """Return the bodies that are near, and one of each material and image that they lack, sorted by these.

    So all parts of a scene have the same shapes in the same order, and their kernels are the same.
    """
    first_of: dict[Hashable, int] = {}
    for is_near in (True, False):
        for index, body in bodies.items():
            if (body.name in near) == is_near:
                for key in _mesh_keys(body):
                    first_of.setdefault(key, index)
    everything = {key: None for body in bodies.values() for key in _mesh_keys(body)}
    chosen = dict.fromkeys(first_of[key] for key in everything)
    chosen |= dict.fromkeys(index for index, body in bodies.items() if body.name in near)
    return {index: bodies[index] for index in chosen}


def _mesh_keys(body: Body) -> list[Hashable]:
    return [_mesh_key(part) for part in body.parts if isinstance(part, Part)]


def _mesh_key(part: Part) -> Hashable:
    """Return material, image and gaps of a part: parts with the same become one mesh."""
    # All parts of one material share the pixels of its gaps.
    cutout = None if part.cutout is None else (part.cutout.solid.ctypes.data, part.cutout.solid.shape)
    return part.material, texture_key(part.pattern), cutout


def _moving_groups(bodies: Sequence[Body]) -> list[_BodiesOfOneShape]:
    """Group the bodies that move and have a surface by their parts."""
    # By identity: the copies of one body of a scene file share their tuple of parts.
    sharing: dict[int, list[int]] = {}
    for index, body in enumerate(bodies):
        if body.motion is not None and any(isinstance(part, Ball) or len(part.faces) for part in body.parts):
            sharing.setdefault(id(body.parts), []).append(index)
    boxes_m = [box_of(_rigid_parts(bodies[indices[0]])) for indices in sharing.values()]
    boxes_m = [np.zeros((2, 3)) if box_m is None else box_m for box_m in boxes_m]
    offsets_m = side_by_side(np.array(boxes_m, dtype=np.float64).reshape(-1, 2, 3))
    return [
        _BodiesOfOneShape(tuple(indices), offset_m)
        for indices, offset_m in zip(sharing.values(), offsets_m, strict=True)
    ]


def _placed_alone(body: Body, position_m: Numbers, walks: bool) -> Body:
    """Return a body that stands still here, of those parts that have a stride or of the others."""
    parts = _parts_that_walk(body) if walks else _rigid_parts(body)
    return Body(name=body.name, class_name=body.class_name, parts=tuple(parts), pose=Pose(position_m=position_m))


def _rigid_parts(body: Body) -> list[Part | Ball]:
    """Return the parts of a body that are rigid as it moves."""
    walking = _parts_that_walk(body)
    return [part for part in body.parts if part not in walking]


def _parts_that_walk(body: Body) -> list[Part]:
    """Return the parts of a body that have a stride, if it walks."""
    parts = [part for part in body.parts if isinstance(part, Part) and part.stride_m is not None]
    return parts if body.gait is not None else []


def _boxes_of_materials(movers: Sequence[Mover], shapes: Sequence[PlacedShape]) -> list[Numbers | None]:
    """Return the box around each mover's rigid parts of the materials of these shapes, in its frame; None without."""
    materials = {shape.material for shape in shapes}
    return [box_of([part for part in _rigid_parts(mover.body) if part.material in materials]) for mover in movers]


def _turns(bodies: Sequence[Body], indices: Sequence[int]) -> list[list[int]]:
    """Partition bodies of one shape into sequences, in each of which no two are ever present at the same time.

    Each body joins the first sequence whose last one is gone before it comes: that makes as many as are present at the
    busiest time. Bodies without an end stay alone, and so do those of different classes.
    """
    turns: list[list[int]] = []
    for index in sorted(indices, key=lambda number: bodies[number].present_s[0]):
        body = bodies[index]
        first_s, last_s = body.present_s
        for turn in turns:
            before = bodies[turn[-1]]
            # Frames begin at times that are rounded: apart by more than that (`Body.is_present`).
            is_gone = before.present_s[1] + 3.0 * CLOCK_ROUNDING_S < first_s < last_s
            if is_gone and before.class_name == body.class_name and not before.away and not body.away:
                turn.append(index)
                break
        else:
            turns.append([index])
    return turns


def _merged_mesh(
    mi: ModuleType,
    centre: Numbers,
    pieces: Sequence[tuple[int, Pose, Part]],
    values: dict[str, object],
    bsdf: object,
    *,
    is_cut: bool,
) -> PlacedShape:
    # The vertices of all pieces one after the other; each piece's faces count from its own first vertex. They are
    # placed one by one: all of them in double precision would be new pages, which take longer than to compute them.
    material, counts = pieces[0][2].material, [len(part.faces) for *_, part in pieces]
    vertices = np.empty((sum(len(part.vertices_m) for *_, part in pieces), 3), np.float32)
    faces = np.empty((sum(counts), 3), np.uint32)
    vertex, face = 0, 0
    for _, pose, part in pieces:
        end, last = vertex + len(part.vertices_m), face + len(part.faces)
        vertices[vertex:end] = pose.apply(part.vertices_m) - centre
        np.add(part.faces, np.uint32(vertex), out=faces[face:last])
        vertex, face = end, last
    bodies = np.repeat(np.array([index for index, _, _ in pieces], np.int32), counts)
    props = mi.Properties()
    # The order of faces is kept by Mitsuba and by Embree: a hit's `prim_index` is the row in `faces`, and in `bodies`.
    first = pieces[0][2].pattern
    props["mesh_bsdf"] = bsdf
    # The colours and the gaps of a part are in one image.
    has_image = is_cut or (first is not None and first.uv is not None)
    mesh = mi.Mesh(material, len(vertices), len(faces), props=props, has_vertex_texcoords=has_image)
    patterns = [part.pattern for _, _, part in pieces if part.pattern is not None]
    if first is not None and first.uv is None:
        varied = np.concatenate([reflectivities(pattern, values) for pattern in patterns])
        mesh.add_attribute(ATTRIBUTE, 1, varied)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.ravel()
    parameters["faces"] = faces.ravel()
    if has_image:
        images = [part.cutout if is_cut else part.pattern for _, _, part in pieces]
        uv = np.concatenate([image.uv for image in images if image is not None and image.uv is not None])
        parameters["vertex_texcoords"] = uv.ravel()
    parameters.update()
    return PlacedShape(
        mesh,
        bodies,
        material,
        values,
        parts=tuple(part for _, _, part in pieces),
        is_plain=not has_image,
        is_varied=first is not None,
        is_cut=is_cut,
    )


def _ball_shape(
    mi: ModuleType, ball: Ball, centre_m: Numbers, index: int, resolved: dict[str, dict[str, object]]
) -> PlacedShape:
    values = resolved[ball.material]
    shape = mi.load_dict(
        {
            "type": "sphere",
            "center": [float(coordinate) for coordinate in centre_m],
            "radius": float(ball.radius_m),
            "bsdf": bsdf_dict(values),
        }
    )
    return PlacedShape(shape, np.array([index], np.int32), ball.material, values)


def _panes_apart(shapes: Sequence[PlacedShape], see_through: bool) -> tuple[list[PlacedShape], list[PlacedShape]]:
    """Return all but the panes and porous surfaces, and these; without ``see_through`` all are among the first."""
    panes = [shape for shape in shapes if see_through and lets_through(shape.shape.bsdf())]
    return [shape for shape in shapes if shape not in panes], panes


def _mover(bodies: Sequence[Body], *, number: int) -> Mover:
    body = bodies[number]
    box_m = box_of(body.parts, walking=body.gait is not None)
    assert box_m is not None  # it has shapes
    return Mover(box_m=box_m, number=number, body=body)


def motions_on_device(motions: MotionTable) -> MotionTable:
    """Return a motion table whose numbers are on the device."""
    on_device = transfer.opaque(motions)
    if motions.boxes is not None:
        nodes = transfer.from_numpy(motions.boxes.nodes)
        on_device = replace(on_device, boxes=replace(on_device.boxes, nodes=nodes))
    return replace(on_device, table=transfer.from_numpy(np.asarray(motions.table)))


def mover_boxes(movers: Sequence[Mover], start_s: float) -> Numbers | None:
    """Return the boxes around bodies, (m, 2, 3), each in its frame; None without any.

    Those that a frame from ``start_s`` on does not show are `NOWHERE`.
    """
    if not movers:
        return None
    return np.stack([mover.box_m if mover.body.is_present(start_s) else NOWHERE for mover in movers])


def placed_movers(
    movers: Sequence[Mover], poses: Sequence[Pose], *, centre_m: Numbers, time_s: float = 0.0
) -> MovingBodies:
    """Return movers that stand at these poses; those that are not there at this time have boxes that no ray passes."""
    stay = [Course(), *(Course(start=pose) for pose in poses)]
    motions = MotionTable.from_motions(
        stay,
        start_s=0.0,
        length_s=1.0,
        centre_m=centre_m,
        carried_m=mover_boxes(movers, time_s),
        walks=[_held(mover.walk_in_frame(time_s), time_s) for mover in movers],
    )
    return MovingBodies(motions=motions_on_device(motions), time_s=transfer.opaque(0.0))


def _held(walk: Strides | None, time_s: float) -> Strides | None:
    """Return a walk that stays where another one is at a time."""
    if walk is None:
        return None
    place = walk(np.array([time_s]))
    return lambda time_s, states=None: np.broadcast_to(place, (len(time_s), 2))


def fixed_placement(pose: Pose, centre_m: Numbers) -> Placement:
    """Return a pose as a placement in the traced frame, its numbers opaque."""
    numbers = [float(number) for number in (*(pose.position_m - centre_m), *pose.rotation.ravel())]
    x, y, z, *rotation = transfer.opaque(tuple(numbers))
    return Placement(origin_m=(x, y, z), rotation=tuple(rotation))
