"""One Mitsuba scene for all bodies that move: each stands still in it, in a cell of its own.

A ray is carried into the frame of a body, from there to the body's cell, and goes through this cell alone: one scene
serves all movers, in every step of a loop.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...maths.arrays import Array, Mask, Numbers
from ...maths.motion_table import NOWHERE
from ..device import transfer
from ..device.backend import is_cuda, mitsuba
from .faces import PlacedShape
from .walkers import Walkers

MARGIN_M = 0.05
"""Accuracy bought: width of the empty rim of a cell. Rays enter and leave the cell in it; a coordinate of a ray that
comes from 100 km away is good to 0.02 m."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MoverScene:
    """A Mitsuba scene of the shapes of all movers.

    Attributes:
        scene: Mitsuba's; None if all that moves walks
        cells: (12 m,) Float, three times four numbers for each of m movers, the last of each four unused: lowest and
            highest corner of its cell in the scene, and the way from its frame to the scene's
        walkers: the movers that walk, whose shapes are in no scene; None: nobody walks
    """

    scene: Any
    cells: Any
    walkers: Walkers | None = None

    @classmethod
    def of_cells(
        cls,
        scene: Any,
        *,
        boxes_m: Sequence[Numbers | None],
        offsets_m: Sequence[Numbers],
        walkers: Walkers | None = None,
    ) -> MoverScene | None:
        """Build from a scene of the rigid shapes of all movers, each in its cell; None without any shape and walker.

        Args:
            scene: Mitsuba's; None without any shape
            boxes_m: (2, 3) lowest and highest corner of what each mover has in the scene, in its frame; None: nothing
            offsets_m: (3,) where the origin of each mover's frame is in the scene
            walkers: the movers that walk
        """
        if scene is None and walkers is None:
            return None
        cells = np.zeros((len(boxes_m), 3, 4))
        for cell, box_m, offset_m in zip(cells, boxes_m, offsets_m, strict=True):
            # A cell in which nothing is has a box that no ray passes.
            cell[:2, :3] = NOWHERE if box_m is None else box_m + offset_m + [[-MARGIN_M], [MARGIN_M]]
            cell[2, :3] = offset_m
        return cls(scene=scene, cells=transfer.from_numpy(cells.ravel()), walkers=walkers)

    def offset(self, mover_index: Array, active: Mask) -> Any:
        """Return where the origin of the frame of each active lane's mover is in the scene."""
        import drjit as dr

        mi = mitsuba()
        return mi.Vector3f(*dr.gather(mi.Vector4f, self.cells, 3 * mi.UInt32(mover_index) + 2, active)[:3])


def mitsuba_scenes(shapes_of: Sequence[Sequence[PlacedShape]]) -> list[Any]:
    """Return a Mitsuba scene of each of these, all of which one kernel can ask; None for one without any shape."""
    # Without robust intersections a ray that meets a shared edge exactly may pass between its triangles. They
    # cost 8 % of the tracing and build three times as fast (measured on street.toml). A shape group is the other way to
    # a fast build, and would lose the setting.
    settings: dict[str, object] = {"type": "scene", "embree_use_robust_intersections": True}
    if is_cuda():
        # A kernel of a GPU has one OptiX pipeline and one table of shapes, and Dr.Jit leaves out what asks a second.
        # Mitsuba gives a scene those of another scene among its children, which has to know all kinds of its shapes.
        kinds = {placed.shape.shape_type(): placed for shapes in shapes_of for placed in _smallest_last(shapes)}
        settings["same_pipeline"] = _load(settings, list(kinds.values()))
    return [_load(settings, shapes) if shapes else None for shapes in shapes_of]


def _smallest_last(shapes: Sequence[PlacedShape]) -> list[PlacedShape]:
    return sorted(shapes, key=lambda placed: -int(placed.shape.primitive_count()))


def _load(settings: Mapping[str, object], shapes: Sequence[PlacedShape]) -> Any:
    # optimize=False: Mitsuba would merge meshes of equal materials, and the number of a triangle would not be ours.
    children = {f"shape_{i}": placed.shape for i, placed in enumerate(shapes)}
    return mitsuba().load_dict({**settings, **children}, optimize=False)


def side_by_side(boxes_m: Numbers) -> Numbers:
    """Return (g, 3): by how much to shift (g, 2, 3) boxes so that they stand apart, around the origin and near it.

    Single precision is fine near the origin only. So the two smallest blocks are joined along the axis on which they
    make the smallest block, again and again, until there is one.
    """
    if not len(boxes_m):
        return np.zeros((0, 3))
    sizes = np.ptp(boxes_m, axis=1) + 4.0 * MARGIN_M  # apart by as much as the rims of two cells once more
    corners = np.zeros_like(sizes)
    blocks = [(float(size.max()), number, size, [number]) for number, size in enumerate(sizes)]
    heapq.heapify(blocks)
    while len(blocks) > 1:
        (_, number, first, of_first), (_, _, second, of_second) = heapq.heappop(blocks), heapq.heappop(blocks)
        joined = np.where(np.eye(3, dtype=bool), first + second, np.maximum(first, second))
        axis = int(joined.max(axis=1).argmin())
        corners[of_second, axis] += first[axis]
        heapq.heappush(blocks, (float(joined[axis].max()), number, joined[axis], of_first + of_second))
    return np.asarray(corners + 2.0 * MARGIN_M - blocks[0][2] / 2.0 - boxes_m[:, 0])
