"""A tree over boxes: as numbers on the device, so that another number of boxes is no other kernel.

Each `CHILDREN` neighbours get a box around them, and so on up to one. The boxes of bodies that move are others in every
frame, and few: they are sorted along a curve through space, without a cost model. A node is eight numbers.
Nodes are in the order in which a walk that skips nothing passes them; a walk needs no stack, since each node knows
where it goes on without those below it.

Symbols: m boxes, n sets of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .arrays import Lanes, Numbers

CHILDREN = 4
"""Boxes within a box of the next level."""

NUMBERS = 8
"""Numbers of a node."""

_CELLS = 1024
"""Cells of the curve along each axis: three numbers of ten bits make one of thirty."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoxTree:
    """Boxes along the axes, in a tree.

    Attributes:
        nodes: eight numbers for each node: lowest corner; number of the node at which a walk goes on without those
            below, 0 at the end; highest corner; number of the box, -1 for a box around others. Node 0 is the box around
            all
        low: lowest corner of the box around all, as plain numbers
        high: highest corner of it, likewise
        size: nodes of the tree; of each, where there are several (`joined`)
        root: number of the tree's node 0, (n,) where each of n rays has its own tree
    """

    nodes: Any
    low: tuple[Any, ...]
    high: tuple[Any, ...]
    size: Any
    root: Any = 0

    @classmethod
    def from_boxes(cls, boxes: Numbers) -> BoxTree:
        """Build from (m, 2, 3) lowest and highest corners, m > 0; boxes that nothing is in have infinite ones."""
        order = np.argsort(_curve_place(boxes), kind="stable")
        return cls.from_sets(boxes[order].transpose(1, 2, 0)[None], order)

    @classmethod
    def from_sets(cls, boxes: Numbers, numbers: Numbers) -> BoxTree:
        """Build trees from n sets of the same m boxes, (n, 2, 3, m), one behind the other (`of_tree`).

        They have the same nodes in the same order.

        Args:
            boxes: those that stand together follow each other
            numbers: (m,) of the boxes
        """
        # From the leaves up: boxes of each level, and the nodes of the tree below each.
        levels, sizes = [boxes], [np.ones(len(numbers), dtype=np.int64)]
        while len(levels) == 1 or len(sizes[-1]) > 1:
            starts = np.arange(0, len(sizes[-1]), CHILDREN)
            low, high = levels[-1][:, 0], levels[-1][:, 1]
            around = np.minimum.reduceat(low, starts, axis=2), np.maximum.reduceat(high, starts, axis=2)
            levels.append(np.stack(around, axis=1))
            sizes.append(1 + np.add.reduceat(sizes[-1], starts))
        # From the root down: a node stands behind its parent and the trees of its elder siblings.
        places = [np.zeros(1, dtype=np.int64)]
        for below in sizes[-2::-1]:
            parent = np.arange(len(below)) // CHILDREN
            before = np.cumsum(below) - below
            places.append(places[-1][parent] + 1 + before - before[parent * CHILDREN])
        size = int(sizes[-1][0])
        order = np.argsort(np.concatenate(places))
        low, high = np.take(np.concatenate(levels[::-1], axis=3), order, axis=3, mode="clip").transpose(1, 0, 3, 2)
        onward = np.arange(size) + np.concatenate(sizes[::-1])[order]
        onward = np.where(onward < size, size * np.arange(len(boxes))[:, None] + onward, 0)
        number = np.concatenate([np.full(size - len(numbers), -1), numbers])[order]
        number = np.broadcast_to(number, onward.shape)
        onward, number = (each[..., None].astype(boxes.dtype) for each in (onward, number))
        nodes = np.concatenate([low, onward, high, number], axis=2)
        lowest, highest = levels[-1][:, 0, :, 0].min(axis=0), levels[-1][:, 1, :, 0].max(axis=0)
        return cls(nodes=nodes.ravel(), low=tuple(lowest.tolist()), high=tuple(highest.tolist()), size=size)

    @classmethod
    def joined(cls, trees: Sequence[BoxTree]) -> BoxTree:
        """Join trees over the same number of boxes, one behind the other; `low` and `high` are around all of them."""
        size = trees[0].size
        nodes = np.stack([tree.nodes for tree in trees]).reshape(len(trees), size, NUMBERS)
        onward = nodes[:, :, 3]
        onward += np.where(onward > 0.0, size * np.arange(len(trees))[:, None], 0.0)
        corners = np.array([(tree.low, tree.high) for tree in trees])
        lowest, highest = tuple(corners[:, 0].min(axis=0).tolist()), tuple(corners[:, 1].max(axis=0).tolist())
        return cls(nodes=nodes.ravel(), low=lowest, high=highest, size=size)

    def of_tree(self, number: Lanes) -> BoxTree:
        """Return the trees of which each of n rays has the one of this number, (n,)."""
        return replace(self, root=number * self.size)


def _curve_place(boxes: Numbers) -> Numbers:
    """Return the place of the middle of each box on a Z-order curve, (m,); boxes that nothing is in come last."""
    holds = np.asarray(np.isfinite(boxes).all(axis=(1, 2)))
    if not holds.any():
        return np.zeros(len(boxes), dtype=np.int64)
    middle = np.where(holds[:, None, None], boxes, 0.0).mean(axis=1)
    lowest = middle[holds].min(axis=0)
    # One scale for all axes, so that cells are cubes: what moves stands on a plane.
    extent = max(float((middle[holds].max(axis=0) - lowest).max()), 1e-9)
    cell = ((middle - lowest) * ((_CELLS - 1) / extent)).clip(0, _CELLS - 1).astype(np.int64)
    # Two zeros come between any two of the ten bits of a number: half of them are moved at a time.
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        cell = (cell | cell << shift) & mask
    place = cell[:, 0] | cell[:, 1] << 1 | cell[:, 2] << 2
    return np.where(holds, place, 1 << 30)
