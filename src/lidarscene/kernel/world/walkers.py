"""Walkers: bodies whose vertices move, people and wheels, as tables of their strides on the device.

A ray meets a walker as its vertices are when its pulse leaves: p = s + level (w(phase) - s), w straight between the
instants of the stride (`scene.walking`). So nothing is rebuilt, and no frame computes anything for it: phase and level
are two more numbers of its motion (`maths.motion_table`). Boxes around `TRIANGLES` neighbouring triangles are a tree
for each part of the stride and of the levels, through which a ray walks as through those of bodies
(`rays.walking_rays`). Walkers of the same parts share all of it.

Mitsuba has their shapes for BSDFs and images alone, in no scene.

Symbols: k instants of a stride, of which the last begins the next one, v vertices, t triangles, m movers, f faces of
the world.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from ...maths.arrays import Numbers, aligned_copy
from ...maths.box_tree import CHILDREN, BoxTree
from ...scene.scene import Body, Part
from ...scene.walking import LARGEST_LEVEL
from ..device import transfer
from ..device.backend import mitsuba
from ..device.blocks import usable_cores
from .faces import PlacedShape, registry_number

TRIANGLES = 2
"""Choice: triangles that share a box."""

PHASES = 16
"""Choice: parts of a stride with boxes of their own: a foot goes 10 cm in one."""

LEVELS = (LARGEST_LEVEL, 1.05, 0.9, 0.6, 0.0)
"""Choice: bounds of the levels that have boxes of their own, narrow where people walk."""

MOST_NODES = 1 << 24
"""Source: IEEE 754; number up to which single precision, in which nodes are, has every whole number."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Walkers:
    """Tables of all walkers of a world; Dr.Jit.

    Attributes:
        kind: (8 m,) UInt32 of each mover: first row of its kind in ``stride``, its vertices, its first row in
            ``standing``, its instants, first node of its trees, nodes of one of them, first leaf, and how many parts of
            the levels have trees; 0: it does not walk
        standing: (4 v,) Float, vertices of all kinds as they stand
        stride: (4 (k + 1) v,) Float, vertices of all kinds, instant after instant
        corners: (4 t,) UInt32, the three vertices of each triangle within its kind, and nothing; `TRIANGLES` a leaf
        surface: (2 t,) UInt32, number in Mitsuba's registry of the shape of each triangle, and its number there
        triangle_of_face: (f,) UInt32, number of the triangle of each of the world's faces, from 1 on; 0 for rigid ones
        nodes: of `BoxTree`, all trees of all kinds
        shapes: Mitsuba's, which live as long as this does
    """

    kind: Any
    standing: Any
    stride: Any
    corners: Any
    surface: Any
    triangle_of_face: Any
    nodes: Any
    shapes: tuple[Any, ...]

    @classmethod
    def of_shapes(
        cls, shapes: Sequence[PlacedShape], bodies: Sequence[Body], first_faces: Sequence[int]
    ) -> Walkers | None:
        """Build from the shapes of movers; None if nobody walks.

        Args:
            bodies: of the m movers
            first_faces: number of the first face of each shape among the world's
        """
        # By identity: movers of one shape share their parts, and the shapes have those of the first.
        faces_of: dict[int, tuple[int, int, int]] = {}
        total = 0
        for shape, first_face in zip(shapes, first_faces, strict=True):
            number, start = registry_number(shape.shape), 0
            for part in shape.parts:
                faces_of.setdefault(id(part), (number, start, first_face))
                start += len(part.faces)
            total = max(total, first_face + len(shape.face_body))
        kinds: dict[tuple[Part, ...], list[int]] = {}
        for mover, body in enumerate(bodies):
            parts = tuple(part for part in body.parts if isinstance(part, Part) and id(part) in faces_of)
            if body.gait is not None and parts:
                kinds.setdefault(parts, []).append(mover)
        if not kinds:
            return None
        kind = np.zeros((len(bodies), 8), np.uint32)
        triangle_of_face = np.zeros(total, np.uint32)
        surfaces: list[Numbers] = []
        row, vertex, node, triangle = 0, 0, 0, 0
        gaits = (bodies[movers[0]].gait for movers in kinds.values())
        levels_of = [LEVELS if gait is None or gait.stands else (1.0, 1.0) for gait in gaits]
        with ThreadPoolExecutor(usable_cores()) as pool:
            tables = list(pool.map(_kind_of, kinds, levels_of))
        for (parts, movers), table in zip(kinds.items(), tables, strict=True):
            instants, vertices, size = len(table.stride) - 1, len(table.standing), table.tree.size
            levels = len(table.tree.nodes) // (8 * size * PHASES)
            kind[movers] = row, vertices, vertex, instants, node, size, triangle // TRIANGLES, levels
            counts = [len(part.faces) for part in parts]
            numbers, starts, firsts = np.repeat([faces_of[id(part)] for part in parts], counts, axis=0)[table.order].T
            in_shape = starts + np.concatenate([np.arange(count) for count in counts])[table.order]
            surfaces.append(np.stack([numbers, in_shape], axis=1))
            triangle_of_face[firsts + in_shape] = 1 + triangle + np.arange(len(table.order))
            row, vertex = row + (instants + 1) * vertices, vertex + vertices
            node, triangle = node + len(table.tree.nodes) // 8, triangle + len(table.order)
        if node >= MOST_NODES:
            raise InputError(
                f"walkers: their meshes must have fewer than {triangle * MOST_NODES // node} triangles together, got "
                f"{triangle}"
            )
        nodes = aligned_copy(np.float32, *(table.tree.nodes for table in tables))
        firsts = kind[[movers[0] for movers in kinds.values()], 4].tolist()
        for each, first in zip(np.split(nodes, 8 * np.array(firsts[1:], int)), firsts, strict=True):
            # Each tree counts from its own first node; 0 is the end of a walk.
            onward = each[3::8]
            onward[onward > 0.0] += first
        return cls(
            kind=transfer.unsigned_numbers(kind.ravel()),
            standing=transfer.fours(*(table.standing for table in tables)),
            stride=transfer.fours(*(table.stride.reshape(-1, 3) for table in tables)),
            corners=transfer.fours(*(table.corners for table in tables)),
            surface=transfer.unsigned_numbers(np.concatenate(surfaces).ravel()),
            triangle_of_face=transfer.unsigned_numbers(triangle_of_face),
            shapes=tuple(shape.shape for shape in shapes),
            nodes=mitsuba().Float(nodes),
        )

    def tree(self, root: Any) -> BoxTree:
        """Return the trees of which each of n rays has the one at this node, (n,)."""
        return BoxTree(nodes=self.nodes, low=(), high=(), size=0, root=root)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Kind:
    """Tables of walkers of the same parts.

    Attributes:
        standing: (v, 3) float32, its vertices as they stand
        stride: (k + 1, v, 3) float32, those of each instant
        corners: (t, 3) uint32, leaf after leaf, the last one filled
        order: (t,) number of each triangle among the faces of the parts
        tree: a tree for each part of the stride and of the levels, phase after phase
    """

    standing: Numbers
    stride: Numbers
    corners: Numbers
    order: Numbers
    tree: BoxTree


@functools.lru_cache(maxsize=128)
def _kind_of(parts: tuple[Part, ...], levels: tuple[float, ...]) -> _Kind:
    """Return the tables of parts that have a stride; kept, since the worlds of a long street share them.

    Args:
        levels: bounds of those that have boxes of their own
    """
    standing = np.concatenate([part.vertices_m for part in parts]).astype(np.float32)
    stride = np.concatenate([part.stride_m for part in parts if part.stride_m is not None], axis=1)
    starts = np.cumsum([0, *(len(part.vertices_m) for part in parts)])[:-1]
    faces = np.concatenate([part.faces + np.uint32(start) for part, start in zip(parts, starts, strict=True)])
    # Limbs are farthest apart as a foot meets the ground.
    order = _neighbours_together(stride[0][faces].mean(axis=1))
    order = np.concatenate([order, np.repeat(order[-1:], -len(order) % TRIANGLES)])
    corners = faces[order]
    tree = BoxTree.from_sets(_leaf_boxes(standing, stride, corners, levels), np.arange(len(corners) // TRIANGLES))
    return _Kind(standing=standing, stride=stride, corners=corners, order=order, tree=tree)


def _neighbours_together(middle_m: Numbers) -> Numbers:
    """Return (t,) numbers of triangles in an order in which those of a box of each level of the tree stand together.

    They are parted where they reach farthest, again and again, into parts that fill boxes: all parts at once.

    Args:
        middle_m: (t, 3)
    """
    order, starts, counts = np.arange(len(middle_m)), np.array([0]), np.array([len(middle_m)])
    while (large := counts > TRIANGLES).any():
        part, at_m = np.repeat(np.arange(len(counts), dtype=np.min_scalar_type(len(counts))), counts), middle_m[order]
        reach_m = np.maximum.reduceat(at_m, starts) - np.minimum.reduceat(at_m, starts)
        along_m = np.where(large[part], np.take_along_axis(at_m, reach_m.argmax(axis=1)[part, None], axis=1)[:, 0], 0.0)
        # By part, and along it within: NumPy sorts short whole numbers faster than `lexsort` sorts both.
        by_place = np.argsort(along_m, kind="stable")
        order = order[by_place[np.argsort(part[by_place], kind="stable")]]
        full = np.full(len(counts), TRIANGLES)
        while (grows := full * CHILDREN < counts).any():
            full[grows] *= CHILDREN
        halves = np.where(large, full * np.maximum(np.rint(counts / (2 * full)).astype(int), 1), counts)
        counts = np.stack([halves, counts - halves], axis=1).ravel()
        counts = counts[counts > 0]
        starts = np.cumsum(counts) - counts
    return order


def _leaf_boxes(standing: Numbers, stride: Numbers, corners: Numbers, levels: Sequence[float]) -> Numbers:
    """(phases times levels, 2, 3, leaves) boxes around the triangles of each leaf, at any place of that part.

    Between two instants, and between two levels, vertices go straight: a box around both holds what is between.
    """
    bounds = np.linspace(0, len(stride) - 1, PHASES + 1)
    factors = np.array(levels, np.float32)[:, None, None]
    first_corner, *others = corners.reshape(-1, 3 * TRIANGLES).T
    boxes = np.empty((PHASES, len(levels) - 1, 2, 3, len(first_corner)), np.float32)
    for of_phase, first, last in zip(
        boxes, np.floor(bounds[:-1]).astype(int), np.ceil(bounds[1:]).astype(int), strict=True
    ):
        # For single precision of what is computed from them, at a metre or two from the origin.
        for side, around, margin_m in ((0, np.minimum, -1e-5), (1, np.maximum, 1e-5)):
            # A level is a factor, and never negative: lowest stays lowest.
            at_level = (standing + factors * (around.reduce(stride[first : last + 1]) - standing)).transpose(0, 2, 1)
            extremes = (around(at_level[:-1], at_level[1:]).astype(np.float64) + margin_m).astype(np.float32)
            box = of_phase[:, side]
            np.take(extremes, first_corner, axis=2, out=box, mode="clip")
            for corner in others:
                around(box, np.take(extremes, corner, axis=2, mode="clip"), out=box)
    return boxes.reshape(-1, *boxes.shape[2:])
