"""glTF 2.0 files as pieces of meshes: nodes, instances, skins, materials and their gaps.

A skinned mesh has the pose in which its joints rest, or that of an animation (`gltf_animation`), by linear blend
skinning: v' = sum of w_j M_j v over the joints j that carry a vertex v. `gltf_document` reads what the file declares.

Source: glTF 2.0, Khronos Group (2021), section 3 and the pages of the extensions.

Symbols: v vertices, f triangles, k copies, n instants of an animation, j joints.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...maths.arrays import Numbers
from .gltf_animation import AnimatedNodes, animated_nodes, animation_duration_s
from .gltf_document import DRACO, TRIANGLES, GltfDocument
from .mesh_cache import Stride, SubMesh, WalkingClips
from .reflectivity_patterns import (
    NAMES,
    Cutout,
    Kind,
    ReflectivityPattern,
    check_share,
    mean_over_surface,
    srgb_to_linear,
)

_STRIP, _FAN = 5, 6

FEWEST_INSTANTS, MOST_INSTANTS = 64, 1024
"""Choice: instants of a stride are so many that `STRAIGHT_M` holds, twice as many each time. A wheel that turns once in
a stride is near the ground at two of the fewest, by which its size is measured."""

STRAIGHT_M = 1e-3
"""Accuracy bought: most by which a vertex leaves the straight lines between the instants of a stride. What jumps or
turns its way at once, as between sparse key frames, may leave them farther."""

RIGID_M = 1e-6
"""Accuracy bought: least movement of a piece over a stride; one that moves less is rigid."""


def read_gltf(path: Path, pattern: Kind | None = None, clips: WalkingClips | None = None) -> list[SubMesh]:
    """Read all pieces of a file, one for each primitive of a node, in the order of the nodes; y up, in metres.

    The keys of a piece are the names of its material, mesh and node. Instances of one node are one piece. A file that
    is no proper glTF raises what Python raises of it.

    Args:
        pattern: kind of reflectivity pattern to read too
        clips: animations of one who walks; the pieces then have a stride, and stand as the walker stands

    Raises:
        InputError: if a file, a key or a value cannot be understood
        LidarSceneError: for Draco's compression without DracoPy
    """
    reader = _Reader(GltfDocument(path), pattern)
    return list(reader.pieces() if clips is None else reader.walking_pieces(clips))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Primitive:
    """One primitive of a mesh, in the mesh's frame.

    Attributes:
        shape: vertices and faces, names of material and mesh, colour, pattern, cutout
        targets: (v, 3) shifts of each morph target
        joints: (v, 4 k) numbers of the joints that carry each vertex; None without a skin
        weights: (v, 4 k) their shares
    """

    shape: SubMesh
    targets: list[Numbers] = field(default_factory=list)
    joints: Numbers | None = None
    weights: Numbers | None = None

    def morphed(self, weights: Numbers) -> Numbers:
        """(..., v, 3) vertices with so much of each of t morph targets, (..., t)."""
        shifts = zip(np.moveaxis(weights, -1, 0), self.targets, strict=False)
        return self.shape.vertices_m + sum(np.asarray(weight)[..., None, None] * target for weight, target in shifts)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _FilePose:
    """A pose of all that is in a file, or n of them, one for each instant.

    Attributes:
        placed: (4, 4) from the frame of each node to the file's; (n, 4, 4) where it is animated
        weights: by node: (n, t) of its t morph targets, where they are animated
    """

    placed: list[Numbers]
    weights: Mapping[int, Numbers]


class _Reader:
    """Reader of one document."""

    def __init__(self, document: GltfDocument, pattern: Kind | None) -> None:
        self._document, self._kind = document, pattern
        self._nodes: list[dict[str, Any]] = document.content.get("nodes", [])
        self._primitives: dict[int, list[_Primitive]] = {}
        self._surfaces: dict[int | None, _Surface] = {}
        self._names: Counter[str] = Counter()

    def pieces(self) -> Iterator[SubMesh]:
        """Yield the pieces of the file's scene, at rest."""
        for number, primitive in self._shown_primitives():
            yield self._placed_piece(number, primitive, self._rest)

    def walking_pieces(self, clips: WalkingClips) -> Iterator[SubMesh]:
        """Yield the pieces with their vertices over a stride; they stand as the walker does, or begin it.

        A stride that leads the walker away is brought back step by step: the body's own motion carries it.
        """
        document = self._document
        standing = None if clips.standing is None else self._pose(animated_nodes(document, clips.standing, np.zeros(1)))
        shown = list(self._shown_primitives())
        strides_m = self._strides(clips, shown)
        period_s = animation_duration_s(document, clips.walk)
        for (number, primitive), stride_m in zip(shown, strides_m, strict=True):
            stands_m = stride_m[0]
            if standing is not None:
                stands_m = self._vertices(number, primitive, standing).reshape(stands_m.shape)
            piece = replace(self._placed_piece(number, primitive, self._rest), vertices_m=stands_m)
            is_rigid = bool(clips.unit_m * np.abs(stride_m - stands_m).max(initial=0.0) < RIGID_M)
            stride = Stride(vertices_m=stride_m.astype(np.float32), period_s=period_s)
            yield piece if is_rigid else replace(piece, stride=stride)

    def _strides(self, clips: WalkingClips, shown: Sequence[tuple[int, _Primitive]]) -> list[Numbers]:
        """Return (k + 1, v, 3) vertices of primitives at even instants of a stride, on the spot.

        The last instant is the first of the next stride.
        """
        count = FEWEST_INSTANTS
        while True:
            fine = self._stride(clips.walk, shown, 2 * count)
            off_m = clips.unit_m * max(map(_off_straight, fine), default=0.0)
            if off_m < STRAIGHT_M or count >= MOST_INSTANTS:
                return [each[::2] for each in fine]
            count *= 2

    def _stride(self, name: str, shown: Sequence[tuple[int, _Primitive]], count: int) -> list[Numbers]:
        """Return `_strides` of so many instants and the last."""
        shares = np.arange(count + 1) / count
        pose = self._pose(animated_nodes(self._document, name, shares))
        vertices_m = [self._vertices(number, primitive, pose) for number, primitive in shown]
        away_m = [each[-1] - each[0] for each in vertices_m if each.ndim == 3]
        led_m = shares[:, None, None] * (np.concatenate(away_m).mean(axis=0) if away_m else np.zeros(3))
        # What the animation leaves alone stays where it is.
        return [
            each - led_m if each.ndim == 3 else np.broadcast_to(each, (count + 1, *each.shape)) for each in vertices_m
        ]

    def _shown_primitives(self) -> Iterator[tuple[int, _Primitive]]:
        """Yield the number of the node of each primitive that is visible, and the primitive."""
        for number in self._shown():
            node = self._nodes[number]
            if "mesh" not in node:
                continue
            mesh = self._document.item("meshes", node["mesh"])
            if node["mesh"] not in self._primitives:
                primitives = [self._primitive(mesh, primitive) for primitive in mesh["primitives"]]
                self._primitives[node["mesh"]] = [primitive for primitive in primitives if primitive is not None]
            for primitive in self._primitives[node["mesh"]]:
                yield number, primitive

    def _placed_piece(self, number: int, primitive: _Primitive, pose: _FilePose) -> SubMesh:
        """Return the piece of a node's primitive in a pose, with a copy for each instance of the node."""
        node = self._nodes[number]
        keys = dict.fromkeys((*primitive.shape.keys, str(node.get("name", number))))
        shape = replace(primitive.shape, keys=tuple(keys))
        vertices = self._vertices(number, primitive, pose)
        copies = len(vertices) // max(len(shape.vertices_m), 1)
        return replace(_copies(shape, copies), vertices_m=vertices)

    def _vertices(self, number: int, primitive: _Primitive, pose: _FilePose) -> Numbers:
        """Return (..., v, 3) vertices of a node's primitive, those of all instances one after the other, in a pose."""
        node = self._nodes[number]
        mesh = self._document.item("meshes", node["mesh"])
        weights = pose.weights.get(number, np.asarray(node.get("weights", mesh.get("weights", [])), dtype=np.float64))
        vertices = primitive.morphed(weights)
        if "skin" in node and primitive.joints is not None:
            return self._skinned(primitive, vertices, node["skin"], pose)
        transforms = pose.placed[number][..., None, :, :] @ self._instances(node)
        placed = np.einsum("...kij,...vj->...kvi", transforms[..., :3, :3], vertices) + transforms[..., None, :3, 3]
        return np.asarray(placed.reshape(*placed.shape[:-3], -1, 3))

    def _shown(self) -> Iterator[int]:
        """Yield the numbers of the nodes of the file's scene that are visible, parents first."""
        scenes = self._document.content.get("scenes")
        if scenes:
            roots = self._document.item("scenes", self._document.content.get("scene", 0)).get("nodes", [])
        else:
            roots = sorted(set(range(len(self._nodes))) - set(self._parents))
        todo, met = list(reversed(roots)), set[int]()
        while todo:
            number = todo.pop()
            node = self._document.item("nodes", number)
            # What hides a node hides all below it. A node is in one place only; a file whose nodes go round in a circle
            # must end.
            visible = node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible", True)
            if number in met or not visible:
                continue
            met.add(number)
            todo += reversed(node.get("children", []))
            yield number

    @cached_property
    def _parents(self) -> dict[int, int]:
        return {child: number for number, node in enumerate(self._nodes) for child in node.get("children", [])}

    @cached_property
    def _rest(self) -> _FilePose:
        return self._pose({})

    def _pose(self, animated: AnimatedNodes) -> _FilePose:
        """Place all nodes, of which some have other transforms and weights than the file's."""
        placed: dict[int, Numbers] = {}
        for number in range(len(self._nodes)):
            chain = [number]
            while (parent := self._parents.get(chain[-1])) is not None and parent not in placed:
                if parent in chain:
                    raise ValueError(f"nodes: number {parent} is below itself")
                chain.append(parent)
            for inner in reversed(chain):
                outer = placed.get(self._parents.get(inner, -1), np.eye(4))
                placed[inner] = outer @ _local_transform(self._nodes[inner] | animated.get(inner, {}))
        weights = {number: values["weights"] for number, values in animated.items() if "weights" in values}
        return _FilePose(placed=[placed[number] for number in range(len(self._nodes))], weights=weights)

    def _instances(self, node: Mapping[str, Any]) -> Numbers:
        """(k, 4, 4) from the frame of each instance of a node to the node's; the identity for a node without."""
        attributes = node.get("extensions", {}).get("EXT_mesh_gpu_instancing", {}).get("attributes", {})
        kinds = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
        rows = {kind: self._document.accessor(attributes[name]) for name, kind in kinds.items() if name in attributes}
        if not rows:
            return np.eye(4)[None]
        counts = {len(values) for values in rows.values()}
        if len(counts) > 1:
            raise ValueError(
                f"EXT_mesh_gpu_instancing: its attributes must have as many rows each, got {sorted(counts)}"
            )
        return np.array(
            [_local_transform({kind: values[i] for kind, values in rows.items()}) for i in range(counts.pop())]
        ).reshape(-1, 4, 4)

    def _skinned(self, primitive: _Primitive, vertices: Numbers, skin_number: int, pose: _FilePose) -> Numbers:
        """Return (..., v, 3) vertices where joints carry them; where the mesh's own node stands does not count."""
        assert primitive.joints is not None
        assert primitive.weights is not None
        skin = self._document.item("skins", skin_number)
        carried = np.stack(np.broadcast_arrays(*[pose.placed[joint] for joint in skin["joints"]]), axis=-3)
        if "inverseBindMatrices" in skin:
            # Matrices are stored column by column.
            bound = self._document.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
            carried = carried @ bound[: len(skin["joints"])]
        shares = np.zeros((len(primitive.joints), len(skin["joints"])))
        rows = np.arange(len(shares))
        for joint, weight in zip(primitive.joints.T, primitive.weights.T, strict=True):
            np.add.at(shares, (rows, joint), weight)
        # A vertex that no joint carries goes with the first that it names, as in three.js.
        alone = shares.sum(axis=1) <= 0.0
        shares[alone, primitive.joints[alone, 0]] = 1.0
        shares /= shares.sum(axis=1, keepdims=True)
        # Joint by joint, each with its few vertices: the product of all with all would keep every core busy.
        leading = np.broadcast_shapes(carried.shape[:-3], vertices.shape[:-2])
        skinned = np.zeros((*leading, *vertices.shape[-2:]))
        for joint, share in enumerate(shares.T):
            rows, matrix = np.flatnonzero(share), carried[..., joint, :, :]
            moved = vertices[..., rows, :] @ np.swapaxes(matrix[..., :3, :3], -1, -2)
            skinned[..., rows, :] += share[rows, None] * (moved + matrix[..., None, :3, 3])
        return skinned

    def _primitive(self, mesh: Mapping[str, Any], primitive: Mapping[str, Any]) -> _Primitive | None:
        """Read a primitive; None for points, lines, and what its material hides."""
        mode = primitive.get("mode", TRIANGLES)
        if mode < TRIANGLES:
            return None
        document, decoded = self._document, self._document.draco(primitive)
        packed = primitive["extensions"][DRACO]["attributes"] if decoded is not None else {}

        def attribute(name: str) -> Numbers | None:
            if name not in primitive["attributes"]:
                return None
            number = primitive["attributes"][name]
            if name in packed:
                return document.accessor(number, decoded.get_attribute_by_unique_id(packed[name])["data"])
            return document.accessor(number)

        positions = attribute("POSITION")
        if positions is None:
            return None
        vertices = positions.astype(np.float64)
        if decoded is not None:
            corners, mode = np.asarray(decoded.faces).reshape(-1), TRIANGLES
        elif "indices" in primitive:
            corners = document.accessor(primitive["indices"])[:, 0].astype(np.int64)
        else:
            corners = np.arange(len(vertices))
        # One for each material: its meshes share the pixels of its gaps.
        material = primitive.get("material")
        if material not in self._surfaces:
            self._surfaces[material] = _Surface(document, material)
        surface = self._surfaces[material]
        name = str(mesh.get("name", "GLTF"))
        self._names[name] += 1
        if self._names[name] > 1:
            name = f"{name}_{self._names[name] - 1}"
        shape = SubMesh(
            vertices_m=vertices,
            faces=_faces(corners, mode),
            keys=tuple(dict.fromkeys(key for key in (surface.name, name) if key)),
        )
        uv = attribute(f"TEXCOORD_{surface.uv_set}")
        uv = None if uv is None else surface.uv(uv)
        if surface.hides(uv):
            return None
        colours = attribute("COLOR_0")
        pattern = surface.colours(uv, colours) if self._kind == "colour" else None
        for name in [f"_{name.upper()}" for name in NAMES] if self._kind == "reflectivity" else []:
            values = attribute(name)
            if values is not None and pattern is None:
                shares = check_share(values[:, 0].astype(np.float64), name)
                pattern = ReflectivityPattern(kind="reflectivity", values=shares)
        groups = range(sum(key.startswith("JOINTS_") for key in primitive["attributes"]))
        return _Primitive(
            shape=replace(shape, grey=surface.grey(shape, colours), cutout=surface.cutout(uv), pattern=pattern),
            targets=[
                document.accessor(target["POSITION"]).astype(np.float64) if "POSITION" in target else np.zeros(3)
                for target in primitive.get("targets", [])
            ],
            joints=_side_by_side([attribute(f"JOINTS_{group}") for group in groups]),
            weights=_side_by_side([attribute(f"WEIGHTS_{group}") for group in groups]),
        )


class _Surface:
    """Colour and gaps of a material."""

    def __init__(self, document: GltfDocument, number: int | None) -> None:
        material = {} if number is None else document.item("materials", number)
        gloss = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
        base = material.get("pbrMetallicRoughness", {}) if gloss is None else gloss
        texture = base.get("baseColorTexture" if gloss is None else "diffuseTexture")
        self.name = str(material.get("name", ""))
        self._factor = base.get("baseColorFactor" if gloss is None else "diffuseFactor")
        self._cutoff = material.get("alphaCutoff", 0.5) if material.get("alphaMode") == "MASK" else None
        self._image = None if texture is None else document.image(texture["index"])
        self._transform = {} if texture is None else texture.get("extensions", {}).get("KHR_texture_transform", {})
        self.uv_set = 0 if texture is None else self._transform.get("texCoord", texture.get("texCoord", 0))

    @property
    def _rgba(self) -> Numbers:
        return np.asarray((1.0, 1.0, 1.0, 1.0) if self._factor is None else self._factor, dtype=np.float64)

    @cached_property
    def _solid(self) -> Numbers | None:
        """(h, w) pixels that are there, of a material with gaps; None without an image or gaps."""
        if self._cutoff is None or self._image is None:
            return None
        solid: Numbers = self._image[..., 3] / 255.0 * self._rgba[3] >= self._cutoff
        return solid

    def uv(self, uv: Numbers) -> Numbers:
        """(v, 2) places in the image, (0, 0) its top left corner, by KHR_texture_transform."""
        angle = self._transform.get("rotation", 0.0)
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        scaled = uv.astype(np.float64) * self._transform.get("scale", (1.0, 1.0))
        moved: Numbers = scaled @ turn.T + np.asarray(self._transform.get("offset", (0.0, 0.0)))
        return moved

    def hides(self, uv: Numbers | None) -> bool:
        """Whether nothing of the surface is there: its alpha is below the cutoff all over."""
        solid = self._solid
        if self._cutoff is None or (solid is not None and uv is not None):
            return solid is not None and not solid.any()
        return bool(self._rgba[3] < self._cutoff)

    def cutout(self, uv: Numbers | None) -> Cutout | None:
        """The gaps of the image; None without any."""
        solid = self._solid
        return None if uv is None or solid is None or solid.all() else Cutout(solid=solid, uv=uv)

    def grey(self, shape: SubMesh, colours: Numbers | None) -> float | None:
        """Mean of the base colour in linear light: factor times image times vertex colours; None if there is none."""
        if self._factor is None and self._image is None and colours is None:
            return None
        rgb = self._rgba[:3].copy()
        if self._image is not None:
            solid = self._solid
            pixels = self._image[..., :3].reshape(-1, 3) if solid is None else self._image[solid][:, :3]
            levels = srgb_to_linear(np.arange(256) / 255.0)
            rgb *= [float(levels @ np.bincount(pixels[:, i], minlength=256)) / len(pixels) for i in range(3)]
        if colours is not None:
            mean = ReflectivityPattern(kind="colour", values=colours[:, :3] @ rgb / 3.0)
            return float(np.clip(mean_over_surface([(mean, shape.vertices_m, shape.faces)]), 0.0, 1.0))
        return float(np.clip(rgb.mean(), 0.0, 1.0))

    def colours(self, uv: Numbers | None, colours: Numbers | None) -> ReflectivityPattern | None:
        """Red of the image or else of the vertex colours, in linear light, times that of the factor; None without."""
        if self._image is not None and uv is not None:
            red = srgb_to_linear(self._image[..., 0] / 255.0) * self._rgba[0]
            return ReflectivityPattern(kind="colour", values=red, uv=uv)
        if colours is None:
            return None
        return ReflectivityPattern(kind="colour", values=colours[:, 0] * self._rgba[0])


def _side_by_side(groups: list[Numbers | None]) -> Numbers | None:
    present = [group for group in groups if group is not None]
    return np.concatenate(present, axis=1) if present else None


def _faces(corners: Numbers, mode: int) -> Numbers:
    """(f, 3) triangles of the corners of triangles, of a strip or of a fan."""
    if mode == TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if mode == _STRIP:
        return np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    if mode == _FAN:
        return np.stack([np.full_like(corners[2:], corners[0]), corners[1:-1], corners[2:]], axis=1)
    raise ValueError(f"primitives: mode must be 0 to 6, got {mode}")


def _off_straight(stride_m: Numbers) -> float:
    """Return how far (2 k + 1, v, 3) vertices are from straight lines between every second instant, at most."""
    between_m = 0.5 * (stride_m[:-1:2] + stride_m[2::2]) - stride_m[1::2]
    return float(np.sqrt(np.square(between_m).sum(axis=2).max(initial=0.0)))


def _local_transform(node: Mapping[str, Any]) -> Numbers:
    """(..., 4, 4) from a node's frame to its parent's; an animated node has arrays (n, ...) in place of its numbers."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    rotation = np.asarray(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), dtype=np.float64)
    scale = np.asarray(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
    translation = np.asarray(node.get("translation", (0.0, 0.0, 0.0)), dtype=np.float64)
    x, y, z, w = np.moveaxis(rotation, -1, 0)
    s = 2.0 / np.maximum(x * x + y * y + z * z + w * w, 1e-300)
    rows = [
        [1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
        [s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)],
        [s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)],
    ]
    turn = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    upper = turn * scale[..., None, :]
    leading = np.broadcast_shapes(upper.shape[:-2], translation.shape[:-1])
    transform = np.zeros((*leading, 4, 4))
    transform[..., :3, :3], transform[..., :3, 3], transform[..., 3, 3] = upper, translation, 1.0
    return transform


def _copies(shape: SubMesh, count: int) -> SubMesh:
    """A piece with the faces, colours and gaps of several copies of a shape, whose vertices the caller places."""
    if count == 1:
        return shape
    shifts = np.arange(count)[:, None, None] * len(shape.vertices_m)
    pattern, cutout = shape.pattern, shape.cutout
    if pattern is not None:
        if pattern.uv is None:
            pattern = replace(pattern, values=np.tile(pattern.values, count))
        else:
            pattern = replace(pattern, uv=np.tile(pattern.uv, (count, 1)))
    if cutout is not None:
        cutout = replace(cutout, uv=np.tile(cutout.uv, (count, 1)))
    return replace(shape, faces=(shape.faces + shifts).reshape(-1, 3), pattern=pattern, cutout=cutout)
