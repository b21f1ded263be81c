"""Terrain around roads that climb: one height at each place, which lanes, junctions and soil have in common."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from .pieces import SOIL_M, Tables, box_places_m, ground, rounded, soil_tiles

PLACES_M = 2.0
"""Accuracy bought: distance of the places on roads that a relief is fitted to."""

STEP_M = 2.5
"""Choice: distance of the heights of a terrain."""

BESIDE_M = 4.5
"""Choice: distance up to which soil is level with a road, across: more than a cell's diagonal, so that no cell with a
piece of road has a corner that is higher or lower."""

BELOW_M, LEAST_BELOW_M = -0.08, -0.04
"""Choice: height of soil against a road, and at least where that bends."""

NEIGHBOURS, BLUR_M, SOIL_BLUR_M = 48, 1.5, 1.0
"""Choice: places of roads that a height is fitted to, and the distance at which they count by exp(-1/2): of roads,
whose lanes then meet, and of soil, which follows them."""

STOREY_M = 2.5
"""Choice: difference of heights from which on one road is above another."""

LEVEL_SHARE = 0.02
"""Choice: weight of a slope of 0 in a fit, of which the places may lie along a line."""


class Relief:
    """Heights of roads, smooth over places at which the lanes of a network do not meet in height.

    Attributes:
        place_m: (n, 3) places on roads, no farther apart than some metres
        blur_m: distance at which places count by exp(-1/2) in the height of another
    """

    def __init__(self, place_m: Numbers, blur_m: float = BLUR_M) -> None:
        from scipy.spatial import cKDTree

        self.place_m, self.blur_m = place_m, blur_m
        self._tree = cKDTree(place_m[:, :2])

    @property
    def is_level(self) -> bool:
        """Return whether all roads are at one height."""
        return bool(np.ptp(self.place_m[:, 2]) < 1e-3)

    def distance_m(self, place_m: Numbers) -> Numbers:
        """(n,) distances of places from the roads."""
        return np.asarray(self._tree.query(place_m[:, :2])[0])

    def has_storey(self, place_m: Numbers, *, above: bool, beside_m: float) -> Numbers:
        """(n,) whether another road is above (n, 3) places on roads, or below them, no farther aside than this."""
        near = self._tree.query_ball_point(place_m[:, :2], beside_m)
        sign = 1.0 if above else -1.0
        return np.array(
            [
                (sign * (self.place_m[number, 2] - height_m) > STOREY_M).any()
                for number, height_m in zip(near, place_m[:, 2].tolist(), strict=True)
            ],
            dtype=bool,
        )

    def height_m(self, place_m: Numbers, near_m: Numbers | None = None) -> Numbers:
        """Heights at (n, 2) places: of the planes through what is near, by least squares.

        Args:
            near_m: (n,) heights of the road that is meant, where several are above each other; the lowest without them
        """
        count = min(NEIGHBOURS, len(self.place_m))
        distance_m, number = self._tree.query(place_m[:, :2], k=[*range(1, count + 1)])
        around_m = self.place_m[number]
        storey_m = around_m[..., 2].min(axis=1) if near_m is None else near_m
        weight = np.exp(-0.5 * (distance_m**2 - distance_m[:, :1] ** 2) / self.blur_m**2) + 1e-12
        weight = weight * (np.abs(around_m[..., 2] - storey_m[:, None]) < STOREY_M) + 1e-12 / count
        weight /= weight.sum(axis=1, keepdims=True)
        middle_m = np.einsum("nk,nkx->nx", weight, around_m)
        aside_m = around_m - middle_m[:, None]
        square_m2 = np.einsum("nk,nkx,nky->nxy", weight, aside_m, aside_m)
        flat_m2 = square_m2[:, :2, :2] + LEVEL_SHARE * np.eye(2)
        slope = np.linalg.solve(flat_m2, square_m2[:, :2, 2:])[..., 0]
        return np.asarray(middle_m[:, 2] + ((place_m[:, :2] - middle_m[:, :2]) * slope).sum(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """Soil around roads.

    Attributes:
        corner_m: x and y of the first node
        nodes_m: (nx, ny) heights of nodes `STEP_M` apart; 0 where there is no soil
        tiles_m: (t, 2) middles of the squares with soil
    """

    corner_m: Numbers
    nodes_m: Numbers
    tiles_m: Numbers

    @classmethod
    def around(cls, relief: Relief) -> Terrain:
        """Lay soil beside roads at their height, and between them as a skin that is stretched from one to the other."""
        tiles_m = soil_tiles(relief.place_m[:, :2])
        corner_m = tiles_m.min(axis=0) - 0.5 * SOIL_M
        cells = round(SOIL_M / STEP_M)
        index = np.round((tiles_m - 0.5 * SOIL_M - corner_m) / STEP_M).astype(int)
        is_soil = np.zeros(index.max(axis=0) + cells + 1, dtype=bool)
        for i, j in index.tolist():
            is_soil[i : i + cells + 1, j : j + cells + 1] = True
        place_m = corner_m + STEP_M * np.argwhere(is_soil)
        beside = relief.distance_m(place_m) < BESIDE_M
        held = np.zeros(is_soil.shape, dtype=bool)
        held[is_soil] = beside
        nodes_m = np.zeros(is_soil.shape)
        nodes_m[held] = relief.height_m(place_m[beside]) + BELOW_M
        soil = cls(corner_m, _stretched(nodes_m, held, is_soil), tiles_m)
        # Where roads bend up and down within a cell, its corners go down until none is in the soil.
        above_m = soil.height_m(relief.place_m[:, :2]) - relief.place_m[:, 2] - LEAST_BELOW_M
        index = np.floor((relief.place_m[:, :2] - corner_m) / STEP_M).astype(int)
        lowered_m = np.zeros(nodes_m.shape)
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            np.maximum.at(lowered_m, (index[:, 0] + i, index[:, 1] + j), above_m)
        soil.nodes_m[...] -= lowered_m
        return soil

    def height_m(self, place_m: Numbers) -> Numbers:
        """Heights at (n, 2) places."""
        from scipy.ndimage import map_coordinates

        return np.asarray(map_coordinates(self.nodes_m, ((place_m - self.corner_m) / STEP_M).T, order=1))

    def lowest_m(self, box: tuple[float, float, float, float, float]) -> float:
        """Lowest height of a rectangle: x, y, yaw [rad], half lengths along it and across."""
        return float(self.height_m(box_places_m(box, STEP_M)).min())

    def tables(self) -> list[Tables]:
        """Squares of soil."""
        cells, bodies = round(SOIL_M / STEP_M), []
        for number, tile_m in enumerate(self.tiles_m):
            i, j = np.round((tile_m - 0.5 * SOIL_M - self.corner_m) / STEP_M).astype(int)
            heights_m = self.nodes_m[i : i + cells + 1, j : j + cells + 1]
            keys = {"position_m": [*tile_m.tolist(), 0.0], "spacing_m": STEP_M, "size_m": [SOIL_M, SOIL_M]}
            bodies.append(ground(f"soil_{number}", "terrain", "soil", **keys, heights_m=rounded(heights_m, 2)))
        return bodies


def _stretched(nodes_m: Numbers, held: Numbers, is_soil: Numbers) -> Numbers:
    """Heights of a skin: those of nodes that are not held are the means of the nodes beside them (Laplace's equation).

    Args:
        nodes_m: (nx, ny) heights of the nodes that are held
        held: (nx, ny) which these are
        is_soil: (nx, ny) nodes that there are
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import laplacian
    from scipy.sparse.linalg import spsolve

    free, heights_m = ~held[is_soil], nodes_m[is_soil]
    if not free.any():
        return nodes_m
    number = np.full(is_soil.shape, -1)
    number[is_soil] = np.arange(len(free))
    sides = (number[:-1], number[1:]), (number[:, :-1], number[:, 1:])
    pair = np.concatenate([np.stack([each.ravel() for each in side]) for side in sides], axis=1)
    pair = pair[:, (pair >= 0).all(axis=0)]
    beside = coo_matrix((np.ones(pair.shape[1]), tuple(pair)), shape=(len(free), len(free)))
    skin = laplacian((beside + beside.T).tocsr()).tocsr()[free]
    pull_m = -skin[:, ~free] @ heights_m[~free]
    heights_m[free] = spsolve(skin[:, free].tocsc(), pull_m, permc_spec="MMD_AT_PLUS_A")
    nodes_m[is_soil] = heights_m
    return nodes_m
