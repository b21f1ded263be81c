"""Skins of vehicles: rings across the body at stations along it, and each cell of this grid given to a part.

Panes, lamps and grilles are cells, so that all parts of a skin share their edges and close it. A station is told by s,
its distance behind the front end; metres, x forward, z up.
"""

from dataclasses import dataclass, field

import numpy as np
from cutting import offset
from modelling import grid, join

NOSE = (0.0, 0.02, 0.09, 0.22, 0.45, 1.0)
"""Stations of a rounded end, over the length of its rounding."""
SIDE = (0.0, 0.10, 0.32, 0.58, 0.82, 1.0)
"""Rows of the sides, over the height from the sill, or from the edge of a wheel's arch, to the beltline."""
INSET = (0.055, 0.022, 0.004, 0.0, 0.006, 0.022)
"""How far the rows stand in, in a metre of the body's width."""
GLASS = (0.10, 0.84, 0.95)
"""Rows above: lower and upper edge of the side windows, and the edge of the roof's rounding."""
ACROSS = (1.0, 0.72, 0.38, 0.0)
"""Columns from the edge of the roof to its middle."""

FLOOR, WALL, UNDER, SILL = range(1, 5)  # cells of half a ring, upwards; 0 is the middle of the floor
FLANK = (5, 6, 7, 8)
BELT, PANE, FRAME, EDGE = range(9, 13)
ROOF = (13, 14, 15)


@dataclass(frozen=True, slots=True)
class Shape:
    """Outline of a skin.

    Attributes:
        top, belt: (s, z) of the middle of the roof or bonnet, and of the beltline, at least 2 cm below
        floor_m: height of the underside
        arch_m: radius of the wheels' arches, about the axles at the height `axle_m`
        well_m: |y| of the inner walls of the wheels' wells
        tumble: by how much the sides lean inwards above the beltline
        round_m: length over which both ends are rounded in plan
        narrow: share of the width that is lost at the ends
        bulge: share of `round_m` by which the lowest and the highest point of the ends stand back
        windows: (first, last s) of the panes of a side
        screens: (first, last s) of panes in the roof's slopes
        faces: "front" and "rear" where the end itself has a pane
        bed: (first, last s, height of the floor) of an open load bed
    """

    length_m: float
    width_m: float
    floor_m: float
    axles_m: tuple[float, ...]
    axle_m: float
    arch_m: float
    well_m: float
    top: tuple[tuple[float, float], ...]
    belt: tuple[tuple[float, float], ...]
    tumble: float = 0.38
    round_m: float = 0.55
    narrow: float = 0.22
    bulge: float = 0.25
    crown_m: float = 0.045
    windows: tuple[tuple[float, float], ...] = ()
    screens: tuple[tuple[float, float], ...] = ()
    faces: tuple[str, ...] = ()
    bed: tuple[float, float, float] | None = None
    lamps: tuple[int, ...] = field(default=(8,))

    def stations(self):
        """Stations from the front to the rear, at least 12 mm apart; those of arches go before others."""
        found = [0.0, self.length_m]
        for axle in self.axles_m:
            turn = np.cos(np.pi * np.arange(9) / 8)
            found += [axle - self.arch_m - 0.02, *(axle - self.arch_m * turn), axle + self.arch_m + 0.02]
        wanted = [share * self.round_m for share in NOSE] + [self.length_m - share * self.round_m for share in NOSE]
        wanted += [s for s, _ in (*self.top, *self.belt)] + [s for pane in (*self.windows, *self.screens) for s in pane]
        if self.bed:
            wanted += [self.bed[0] - 0.015, self.bed[0], self.bed[1], self.bed[1] + 0.015]
        for s in wanted:
            if min(abs(s - other) for other in found) > 0.012 and 0.0 < s < self.length_m:
                found.append(s)
        return np.array(sorted(found))

    def half_ring(self, s):
        """(17, 2) y and z of half a ring, from the middle of the floor to the middle of the roof."""
        end = np.clip(1.0 - min(s, self.length_m - s) / self.round_m, 0.0, 1.0)
        half = 0.5 * self.width_m * (1.0 - self.narrow * (1.0 - np.sqrt(1.0 - end**2)))
        floor = self.floor_m + 0.05 * end
        belt, top = (np.interp(s, *np.transpose(line)) for line in (self.belt, self.top))
        off = min((abs(s - axle) for axle in self.axles_m), default=np.inf)
        lip = floor if off > self.arch_m + 0.01 else self.axle_m + np.sqrt(max(self.arch_m**2 - off**2, 0.0))
        well = min(self.well_m, 0.6 * half)
        z = lip + np.array(SIDE) * (belt - lip)
        share = (z - floor) / (belt - floor)
        y = half - self.width_m * np.interp(share, SIDE, INSET)
        edge = top - self.crown_m * min(1.0, 0.3 + 2.0 * (top - belt))
        z_up = belt + np.array(GLASS) * (edge - belt)
        y_up = y[-1] - self.tumble * (z_up - belt)
        y_edge = y_up[-1] - 0.06 * min(1.0, 0.3 + 2.0 * (top - belt))
        across = np.array(ACROSS)
        y_top, z_top = y_edge * across, edge + (top - edge) * (1.0 - across**2)
        if self.bed and self.bed[0] - 1e-9 <= s <= self.bed[1] + 1e-9:
            y_top[1:3], z_top[1] = y_edge - 0.05, edge
            z_top[2:] = self.bed[2]
        low = [(0.0, floor), (0.4 * well, floor), (well, floor), (well, lip)]
        return np.array([*low, *zip(y, z, strict=True), *zip(y_up, z_up, strict=True), *zip(y_top, z_top, strict=True)])


def skin(shape, tag):
    """Part name -> Mesh: a closed surface.

    Args:
        tag: part of a cell, from its row in half a ring, its s, and "side", "front" or "rear"
    """
    s = shape.stations()[::-1]
    half = np.stack([shape.half_ring(at) for at in s])
    x = np.broadcast_to((0.5 * shape.length_m - s)[:, None], half.shape[:2])
    left = np.stack([_bulged(shape, x, half[..., 1]), half[..., 0], half[..., 1]], axis=-1)
    ring = np.concatenate([left, left[:, -2:0:-1] * (1.0, -1.0, 1.0)], axis=1)
    rows = np.minimum(np.arange(ring.shape[1]), ring.shape[1] - 1 - np.arange(ring.shape[1]))
    tags = [[tag(row, at, "side") for row in rows] for at in 0.5 * (s[1:] + s[:-1])]
    pieces = [(grid(ring, closed=True), np.array(tags))]
    for end, outline, at in (("rear", left[0], s[0]), ("front", left[-1], s[-1])):
        face, tags = _face(outline, lambda row, column, end=end, at=at: tag(row, at, end, column))
        pieces.append((face if end == "front" else face.flipped(), tags))
    names = np.unique(np.concatenate([tags.ravel() for _, tags in pieces]))
    chosen = {
        name: [mesh.kept(mask) for mesh, tags in pieces if (mask := np.tile(tags.ravel() == name, 2)).any()]
        for name in names
    }
    return {str(name): join(*meshes) for name, meshes in chosen.items()}


def _bulged(shape, x, z):
    """X with both ends bent back towards their lowest and highest point."""
    low, high = z.min(), z[[0, -1]].max()
    bend = (2.0 * (z - low) / (high - low) - 0.9) ** 2
    out = np.clip((np.abs(x) - 0.5 * shape.length_m + shape.round_m) / shape.round_m, 0.0, 1.0)
    return x - np.sign(x) * shape.bulge * shape.round_m * out**2 * bend


def _face(outline, tag):
    """The flat end inside a half ring and its mirror image: a grid from the sill to the roof."""
    sides = outline[4:14]
    low, high = outline[[4, 3, 1, 0]], outline[13:17]
    share = np.linspace(0.0, 1.0, len(sides))[:, None]
    across = (1 - share) * (low[:, 1] / low[0, 1]) + share * (high[:, 1] / high[0, 1])
    points = np.repeat(sides[:, None], 4, axis=1)
    points[:, :, 1] *= across
    points[0], points[-1] = low, high
    whole = np.concatenate([points * (1.0, -1.0, 1.0), points[:, -2::-1]], axis=1)
    tags = np.array([[tag(row + 4, min(column, 5 - column)) for column in range(6)] for row in range(len(sides) - 1)])
    return grid(whole), tags


def lining(mesh, *, inwards_m):
    """What is seen from inside of a part of a skin: the same surface, a little further in."""
    return offset(mesh, -inwards_m).flipped()
