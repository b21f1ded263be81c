"""Cells of equal solid angle on the sphere of directions.

Coverage needs cells of equal size that do not beat with the raster. Rows are ``size_deg`` high in elevation; each is
cut into the whole number of columns that makes its cells nearest to square. So every cell has the solid angle
size_deg^2, except for this rounding and the poles. Edges are at odd fractions of a cell from zero, so that no even
raster of directions falls on them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers

_SHIFT = 0.381966
"""Choice: shift of the edges, in cells: the golden section is far from every simple fraction."""


@dataclass(frozen=True, slots=True, eq=False)
class SphereCells:
    """Division of the sphere into cells, numbered row by row from below.

    Attributes:
        size_deg: height of a row [degrees]
        columns: (rows,) number of cells in each row
        first: (rows + 1,) number of the first cell of each row
        edges_deg: (rows + 1,) elevations between the rows
    """

    size_deg: float
    columns: Numbers
    first: Numbers
    edges_deg: Numbers

    @classmethod
    def of_size(cls, size_deg: float) -> SphereCells:
        """Make cells of about this height and width in degrees."""
        below = math.ceil(90.0 / size_deg) + 1
        edges = np.clip((np.arange(-below, below + 1) + _SHIFT) * size_deg, -90.0, 90.0)
        edges = np.unique(edges)
        middle = np.radians(0.5 * (edges[1:] + edges[:-1]))
        columns = np.maximum(np.rint(360.0 * np.cos(middle) / size_deg), 1).astype(np.int64)
        return cls(size_deg, columns, np.concatenate([[0], np.cumsum(columns)]), edges)

    @property
    def count(self) -> int:
        """Number of cells on the whole sphere."""
        return int(self.first[-1])

    def locate(self, azimuth_deg: Numbers, elevation_deg: Numbers) -> Numbers:
        """Number of the cell in which each direction lies."""
        row = np.clip(np.searchsorted(self.edges_deg, elevation_deg, side="right") - 1, 0, len(self.columns) - 1)
        columns = self.columns[row]
        column = np.floor(azimuth_deg * columns / 360.0 + _SHIFT).astype(np.int64) % columns
        return np.asarray(self.first[row] + column)

    def row_of(self, cell: Numbers) -> Numbers:
        """Number of the row in which each cell lies."""
        return np.asarray(np.searchsorted(self.first, cell, side="right") - 1)

    def middle_deg(self, cell: Numbers) -> tuple[Numbers, Numbers]:
        """Azimuth (-180 to 180) and elevation of each cell's middle, in degrees."""
        row = self.row_of(cell)
        column = cell - self.first[row]
        azimuth = (column + 0.5 - _SHIFT) * 360.0 / self.columns[row]
        elevation = 0.5 * (self.edges_deg[row] + self.edges_deg[row + 1])
        return np.asarray((azimuth + 180.0) % 360.0 - 180.0), np.asarray(elevation)

    def square_degrees(self, cell: Numbers) -> Numbers:
        """Solid angle of each cell in square degrees: (sin upper - sin lower edge) times its width."""
        row = self.row_of(cell)
        sines = np.sin(np.radians(self.edges_deg))
        return np.asarray(np.degrees(sines[row + 1] - sines[row]) * 360.0 / self.columns[row])

    def within(self, outline: Numbers) -> Numbers:
        """Sorted numbers of the cells whose middle is inside a convex polygon.

        Args:
            outline: (n, 2) azimuth and elevation of its corners in degrees, counter-clockwise
        """
        low, high = outline[:, 1].min(), outline[:, 1].max()
        rows = np.flatnonzero((self.edges_deg[1:] > low) & (self.edges_deg[:-1] < high))
        if len(rows) == 0:
            return np.zeros(0, dtype=np.int64)
        cell = np.arange(self.first[rows[0]], self.first[rows[-1] + 1])
        azimuth, elevation = self.middle_deg(cell)
        inside = np.ones(len(cell), dtype=bool)
        # Inside is to the left of every edge: its cross product with the way to the middle is not negative.
        for (x, y), (next_x, next_y) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            inside &= (next_x - x) * (elevation - y) - (next_y - y) * (azimuth - x) >= -1e-9
        return np.asarray(cell[inside])
