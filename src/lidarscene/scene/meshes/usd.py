"""USD stages (Omniverse, Isaac Sim, Blender, Houdini) as pieces of meshes, in metres and z up.

A stage defines its unit and its axis, so the scene file gives neither. The library is `usd-core`, an optional
package. The reader takes meshes (the control cage of subdivision surfaces), USD's solids, instances and point
instancers at the stage's first time. It skips invisible prims, guides and proxies.

Symbols: v vertices, f triangles.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, OptionWarning, warn
from ...files.in_child import Child
from ...files.inputs import require_file
from ...files.optional import import_optional
from ...files.trimesh import trimesh
from ...maths.arrays import Numbers
from .mesh_axes import turn_upright
from .mesh_cache import SubMesh
from .polygons import triangulate

SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")

_LEFT_OUT = ("guide", "proxy")


def is_usd(path: Path) -> bool:
    """Return True for the name of a USD file."""
    return path.suffix.lower() in SUFFIXES


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UsdStage:
    """A stage as it was read.

    Attributes:
        pieces: one for each material of a prim; metres, z up
        unit_m: length of its unit
        up: its axis that points up
        left_out: kinds of prims that were not read, and how many there are of each
    """

    pieces: list[SubMesh]
    unit_m: float
    up: str
    left_out: dict[str, int]


def read_stage(path: Path) -> UsdStage:
    """Read a stage.

    The keys of a piece are the names of its material and prim, and the prim's path. USD ends the process over some
    damaged binary stages, so a child reads them; it stays for the next stage, since to import USD takes long.

    Raises:
        InputError: if a file, a key or a value cannot be understood
        LidarSceneError: without usd-core
    """
    global _child
    import_optional("pxr", extra="usd")
    with _asking:
        if _child is None or _child[0] != os.getpid() or not _child[1].is_alive:
            _child = os.getpid(), Child(_read_stage)
            atexit.register(_child[1].end)
        stage: UsdStage = _child[1].ask(path, path)
    return stage


_asking = threading.Lock()
_child: tuple[int, Child] | None = None
"""Process that started it, since a fork shares the pipe, and the child that reads stages."""


def _read_stage(path: Path) -> UsdStage:
    pxr = import_optional("pxr", extra="usd")
    for name in ("Sdf", "Usd", "UsdGeom", "UsdShade", "UsdUtils", "Tf", "Gf"):
        import_optional(f"pxr.{name}", extra="usd")
    # USD prints warnings of missing files; this delegate collects them instead.
    diagnostics = pxr.UsdUtils.CoalescingDiagnosticDelegate()
    try:
        _require_layers(pxr, path)
        stage = pxr.Usd.Stage.Open(str(path))
        reader = _Reader(pxr, stage, path)
        read = reader.stage(stage)
    except pxr.Tf.ErrorException as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"cannot be read as a USD stage: {reason}") from None
    missing = [
        diagnostic
        for diagnostic in diagnostics.TakeUncoalescedDiagnostics()
        if "Could not open asset" in diagnostic.commentary
    ]
    if missing:
        raise InputError(f"refers to what cannot be read: {' '.join(missing[0].commentary.split())[:200]}")
    return read


def _require_layers(pxr: Any, path: Path) -> None:
    """Raise InputError for a stage that refers to a pipe or a device, on which USD would wait without end.

    A layer opens without those that it refers to, so each is checked before it is opened.
    """
    layers, checked = [str(path)], set[str]()
    while layers:
        name = layers.pop()
        if name in checked:
            continue
        checked.add(name)
        if os.path.lexists(name):
            require_file(name, "a USD file")
        layer = pxr.Sdf.Layer.FindOrOpen(name)
        if layer is not None:
            layers += [layer.ComputeAbsolutePath(asset) for asset in layer.GetCompositionAssetDependencies()]


class _Reader:
    """Reader of one stage."""

    def __init__(self, pxr: Any, stage: Any, path: Path) -> None:
        self._pxr = pxr
        self._time = pxr.Usd.TimeCode.EarliestTime()
        self._up = str(pxr.UsdGeom.GetStageUpAxis(stage)).lower()
        self._metres = float(pxr.UsdGeom.GetStageMetersPerUnit(stage))
        self._left_out: Counter[str] = Counter()
        self._kinds = {
            "Mesh": self._mesh,
            "Cube": self._cube,
            "Plane": self._plane,
            "Sphere": self._sphere,
            "Cylinder": self._round_solid,
            "Cone": self._round_solid,
            "Capsule": self._round_solid,
        }
        if not pxr.UsdGeom.StageHasAuthoredMetersPerUnit(stage):
            warn(
                OptionWarning(
                    "{0}: says no metersPerUnit, which makes its unit the centimetre by USD's standard; "
                    "scale = 100 in the scene file makes it the metre",
                    path,
                )
            )

    def stage(self, stage: Any) -> UsdStage:
        """Read all of the stage."""
        pieces = list(self.pieces_below(stage.GetPseudoRoot(), np.eye(4), self._pxr.Usd.PrimDefaultPredicate))
        return UsdStage(pieces=pieces, unit_m=self._metres, up=self._up, left_out=dict(self._left_out))

    def pieces_below(self, root: Any, placed: Numbers, drawn: Any) -> Iterator[SubMesh]:
        """Yield the pieces of a prim and of all prims below it.

        Args:
            placed: (4, 4) from the frame of the parent of ``root`` to the stage's; USD multiplies rows from the left
            drawn: predicate of prims that are there
        """
        pxr = self._pxr
        prims = iter(pxr.Usd.PrimRange(root, pxr.Usd.TraverseInstanceProxies(drawn)))
        frames = {root.GetParent().GetPath(): placed} if root.GetParent() else {}
        for prim in prims:
            if not prim.IsA(pxr.UsdGeom.Imageable):
                frames[prim.GetPath()] = frames.get(prim.GetParent().GetPath(), placed) if prim.GetParent() else placed
                continue
            imageable = pxr.UsdGeom.Imageable(prim)
            # All prims below inherit invisibility, and in most stages the purpose too.
            hidden = imageable.GetVisibilityAttr().Get(self._time) == "invisible"
            if hidden or imageable.ComputePurpose() in _LEFT_OUT:
                self._left_out["hidden" if hidden else str(imageable.ComputePurpose())] += 1
                prims.PruneChildren()
                continue
            frame = frames.get(prim.GetParent().GetPath(), placed)
            if prim.IsA(pxr.UsdGeom.Xformable):
                xformable = pxr.UsdGeom.Xformable(prim)
                local_frame = np.array(xformable.GetLocalTransformation(self._time))
                frame = local_frame if xformable.GetResetXformStack() else local_frame @ frame
            frames[prim.GetPath()] = frame
            if prim.IsA(pxr.UsdGeom.PointInstancer):
                prims.PruneChildren()  # its prototypes appear at its points only
                yield from self._instances(pxr.UsdGeom.PointInstancer(prim), frame)
            elif str(prim.GetTypeName()) in self._kinds:
                yield from self._pieces(prim, frame)
            elif prim.IsA(pxr.UsdGeom.Gprim):
                self._left_out[str(prim.GetTypeName())] += 1

    def _instances(self, instancer: Any, frame: Numbers) -> Iterator[SubMesh]:
        """Yield the pieces of all instances of a point instancer."""
        prototypes = [
            instancer.GetPrim().GetStage().GetPrimAtPath(path) for path in instancer.GetPrototypesRel().GetTargets()
        ]
        numbers = instancer.GetProtoIndicesAttr().Get(self._time) or ()
        # With the prototype's own transform, its last; invisible points are masked.
        transforms = instancer.ComputeInstanceTransformsAtTime(
            self._time, self._time, instancer.ExcludeProtoXform, instancer.ApplyMask
        )
        mask = instancer.ComputeMaskAtTime(self._time) or [True] * len(numbers)
        numbers = [index for index, is_kept in zip(numbers, mask, strict=True) if is_kept]
        # As in Pixar's renderers, a prototype may be below an `over`, where it appears at the points only.
        usd = self._pxr.Usd
        drawn = usd.PrimIsActive & usd.PrimIsLoaded & ~usd.PrimIsAbstract
        for index, transform in zip(numbers, transforms, strict=True):
            if prototypes[index].IsAbstract():  # below a `class`, which is drawn nowhere
                self._left_out["prototype below a class"] += 1
            yield from self.pieces_below(prototypes[index], np.array(transform) @ frame, drawn)

    def _pieces(self, prim: Any, frame: Numbers) -> Iterator[SubMesh]:
        """Yield one piece for each material of a prim that has a shape."""
        vertices, faces, face_of = self._kinds[str(prim.GetTypeName())](prim)
        placed = vertices @ frame[:3, :3] + frame[3, :3]
        placed = turn_upright(placed, self._up) * self._metres  # type: ignore[arg-type]
        binding = self._pxr.UsdShade.MaterialBindingAPI(prim)
        unassigned = np.ones(len(faces), dtype=bool)
        for subset in binding.GetMaterialBindSubsets():
            in_subset = np.isin(face_of, np.asarray(subset.GetIndicesAttr().Get(self._time) or ())) & unassigned
            unassigned &= ~in_subset
            yield self._piece(subset.GetPrim(), prim, placed, faces[in_subset])
        if unassigned.any():
            yield self._piece(prim, prim, placed, faces[unassigned])

    def _piece(self, binding_prim: Any, prim: Any, vertices: Numbers, faces: Numbers) -> SubMesh:
        """Piece with names and colour of the material that is bound to ``binding_prim``."""
        material = self._pxr.UsdShade.MaterialBindingAPI(binding_prim).ComputeBoundMaterial()[0]
        name = material.GetPrim().GetName() if material else ""
        used_vertices, vertex_index = np.unique(faces, return_inverse=True)
        return SubMesh(
            vertices_m=vertices[used_vertices],
            faces=vertex_index.reshape(-1, 3),
            keys=tuple(key for key in dict.fromkeys((name, prim.GetName(), str(prim.GetPath()))) if key),
            grey=self._grey(material, prim),
        )

    def _grey(self, material: Any, prim: Any) -> float | None:
        """Mean base colour in linear light, of the material's preview or else of the prim; None without either."""
        colour = None
        if material:
            shader = material.ComputeSurfaceSource()[0]
            diffuse_input = shader.GetInput("diffuseColor") if shader else None
            if diffuse_input and not diffuse_input.HasConnectedSource():
                colour = diffuse_input.Get(self._time)
        if colour is None:
            display_colour = self._pxr.UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
            values = display_colour.Get(self._time) if display_colour else None
            colour = values[0] if values is not None and len(values) == 1 else None
        return None if colour is None else float(np.clip(np.mean(colour), 0.0, 1.0))

    # Each method below returns vertices (v, 3) in the prim's frame, triangles (f, 3), and for each triangle the index
    # of the prim's face that it belongs to, (f,).

    def _mesh(self, prim: Any) -> tuple[Numbers, Numbers, Numbers]:
        """Polygon mesh, cut into triangles.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        mesh = self._pxr.UsdGeom.Mesh(prim)
        points = np.asarray(mesh.GetPointsAttr().Get(self._time) or (), dtype=np.float64).reshape(-1, 3)
        counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get(self._time) or (), dtype=np.int64)
        corners = np.asarray(mesh.GetFaceVertexIndicesAttr().Get(self._time) or (), dtype=np.int64)
        holes = mesh.GetHoleIndicesAttr().Get(self._time) or ()
        if counts.sum() != len(corners) or (len(corners) and not 0 <= corners.min() <= corners.max() < len(points)):
            raise InputError(f"{prim.GetPath()}: its faces do not fit its points")
        triangles, face_of = triangulate(points, counts, corners)
        is_face = ~np.isin(face_of, np.asarray(holes))
        return points, corners[triangles[is_face]], face_of[is_face]

    def _cube(self, prim: Any) -> tuple[Numbers, Numbers, Numbers]:
        size = float(self._pxr.UsdGeom.Cube(prim).GetSizeAttr().Get(self._time))
        return _solid_arrays(trimesh().creation.box((size,) * 3))

    def _plane(self, prim: Any) -> tuple[Numbers, Numbers, Numbers]:
        """Rectangle normal to one of its axes, centred."""
        plane = self._pxr.UsdGeom.Plane(prim)
        width, length = (
            float(attribute.Get(self._time)) for attribute in (plane.GetWidthAttr(), plane.GetLengthAttr())
        )
        u, v = np.array([-1.0, 1.0, 1.0, -1.0]) * width / 2.0, np.array([-1.0, -1.0, 1.0, 1.0]) * length / 2.0
        zero = np.zeros(4)
        # The width of a plane across x is along z, that of any other along x; across y its length is along z.
        axes = {"X": (zero, v, u), "Y": (u, zero, v), "Z": (u, v, zero)}
        corners = np.stack(axes[str(plane.GetAxisAttr().Get(self._time))], axis=1)
        return corners, np.array([[0, 1, 2], [0, 2, 3]]), np.zeros(2, dtype=np.int64)

    def _sphere(self, prim: Any) -> tuple[Numbers, Numbers, Numbers]:
        radius = float(self._pxr.UsdGeom.Sphere(prim).GetRadiusAttr().Get(self._time))
        return _solid_arrays(trimesh().creation.icosphere(subdivisions=4, radius=radius))

    def _round_solid(self, prim: Any) -> tuple[Numbers, Numbers, Numbers]:
        """Cylinder, cone or capsule along one of its axes, centred."""
        kind = str(prim.GetTypeName())
        shape = getattr(self._pxr.UsdGeom, kind)(prim)
        height, radius = (
            float(attribute.Get(self._time)) for attribute in (shape.GetHeightAttr(), shape.GetRadiusAttr())
        )
        if kind == "Capsule":
            solid = trimesh().creation.capsule(height=height, radius=radius, count=[64, 64])
        else:
            solid = getattr(trimesh().creation, kind.lower())(radius=radius, height=height, sections=64)
        # trimesh stands a cone on the origin.
        vertices = solid.vertices - solid.bounds.mean(axis=0)
        # trimesh's solids stand along z.
        vertices_on_axis = np.roll(vertices, {"X": 1, "Y": 2, "Z": 0}[str(shape.GetAxisAttr().Get(self._time))], axis=1)
        return vertices_on_axis, np.asarray(solid.faces), np.zeros(len(solid.faces), dtype=np.int64)


def _solid_arrays(mesh: Any) -> tuple[Numbers, Numbers, Numbers]:
    """Arrays of a solid whose triangles all belong to one face."""
    return np.asarray(mesh.vertices), np.asarray(mesh.faces), np.zeros(len(mesh.faces), dtype=np.int64)
