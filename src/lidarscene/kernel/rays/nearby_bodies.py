"""Find the bodies that move and that a ray comes near.

To intersect a ray with a moving body takes a lookup of the body's pose and a query of its scene. Few rays come near any
body, so each ray asks only those whose boxes it passes. A box holds the body for the whole frame: it is the same for
all rays. The boxes are a tree of numbers (`maths.box_tree`), through which each ray walks from one box that it passes
to the next; so no number of bodies is part of a kernel. In the scene of all movers (`world.mover_scene`) a ray goes
from where it enters the body's cell to where it leaves it, and meets nothing of its neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ...maths.arrays import Array, Lanes, Mask, xp
from ...maths.box_tree import BoxTree
from ...maths.vectors import Vector
from ..device.backend import mitsuba
from ..device.types import Ray, components
from ..world.mover_scene import MoverScene

_SMALLEST_COMPONENT = 1e-20
"""Accuracy bought: smallest component of a direction to divide by; no ray is so long that it would matter."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Slabs:
    """Rays, ready for the slab method.

    Attributes:
        origin: where the rays start
        inverse: reciprocals of their directions' components
        rises: whether these are positive
    """

    origin: Vector
    inverse: Vector
    rises: tuple[Mask, Mask, Mask]

    @classmethod
    def of_ray(cls, ray: Ray) -> Slabs:
        """Prepare rays in the frame of the boxes."""
        import drjit as dr

        x, y, z = (
            dr.rcp(dr.select(dr.abs(d) < _SMALLEST_COMPONENT, _SMALLEST_COMPONENT, d)) for d in components(ray.d)
        )
        return cls(origin=components(ray.o), inverse=(x, y, z), rises=(x > 0.0, y > 0.0, z > 0.0))

    def passage(self, low: Sequence[Lanes], high: Sequence[Lanes], length_m: Lanes) -> tuple[Any, Any]:
        """Return where rays enter and leave a box within their first ``length_m`` [m]; those that miss it leave first.

        The slab method: the ray is between the two planes of each axis from `near` to `far`. The direction decides
        which plane comes first, not the distances: so no ray passes a box that is `NOWHERE`.
        """
        import drjit as dr

        ops = xp(length_m)
        near: Lanes = mitsuba().Float(0.0)
        far = length_m
        for o, i, up, lower, upper in zip(self.origin, self.inverse, self.rises, low, high, strict=True):
            near = ops.maximum(near, (dr.select(up, lower, upper) - o) * i)
            far = ops.minimum(far, (dr.select(up, upper, lower) - o) * i)
        return near, far


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoxWalk:
    """A walk of rays through a tree of boxes."""

    tree: BoxTree
    slabs: Slabs

    def start(self, active: Mask, length_m: Lanes) -> Any:
        """Return the node at which each ray begins; 0 for those that do not pass the box around all."""
        import drjit as dr

        first = mitsuba().UInt32(self.tree.root) + 1
        return dr.select(active & self._passes(self.tree.low, self.tree.high, length_m), first, 0)

    def next_box(self, node: Array, length_m: Lanes) -> tuple[Any, Any]:
        """Return where to go on behind the next box of a body that each ray passes, and that body's number.

        Node 0 is the end; the number is -1 where a ray passes no further box within its first ``length_m``.
        """
        import drjit as dr

        mi = mitsuba()

        def step(node: Array, _: Array) -> tuple[Any, Any]:
            # Four neighbouring numbers are one load.
            low = dr.gather(mi.Vector4f, self.tree.nodes, 2 * node)
            high = dr.gather(mi.Vector4f, self.tree.nodes, 2 * node + 1)
            passes, number = self._passes(tuple(low[:3]), tuple(high[:3]), length_m), mi.Int32(high[3])
            return dr.select(passes & (number < 0), node + 1, mi.UInt32(low[3])), dr.select(passes, number, -1)

        behind, number = dr.while_loop(
            (node, mi.Int32(-1)), lambda node, number: (node != 0) & (number < 0), step, mode="symbolic"
        )
        return behind, number

    def _passes(self, low: Sequence[Lanes], high: Sequence[Lanes], length_m: Lanes) -> Any:
        """Return whether rays pass a box within their first ``length_m``."""
        near, far = self.slabs.passage(low, high, length_m)
        return near <= far


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellPassage:
    """Passages of rays through the cells of movers.

    Attributes:
        ray: in the scene of all movers, from where it enters the cell to where it leaves it
        start_m: length of the ray up to there
        passes: whether it goes through the cell
    """

    ray: Any
    start_m: Any
    passes: Any

    @classmethod
    def of_ray(cls, ray: Ray, movers: MoverScene, mover_index: Array, active: Mask) -> CellPassage:
        """Take active rays, each in the frame of a mover, through the cell of this mover."""
        import drjit as dr

        mi = mitsuba()
        low, high, offset = (
            dr.gather(mi.Vector4f, movers.cells, 3 * mi.UInt32(mover_index) + row, active)[:3] for row in range(3)
        )
        in_scene = mi.Ray3f(ray.o + mi.Vector3f(*offset), ray.d)
        near, far = Slabs.of_ray(in_scene).passage(low, high, ray.maxt)
        in_scene.o, in_scene.maxt = in_scene(near), far - near
        return cls(ray=in_scene, start_m=near, passes=active & (near <= far))
