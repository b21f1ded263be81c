"""Tiles: in which order the pulses of a chunk are traced, so that rays traced together are neighbours both ways.

The CPU traces eight rays at a time. Eight that follow each other in firing order lie in a row: those of a line run
along many surfaces, those of a bank of lasers spread over its whole field. Eight in a block share more of what they
meet (docs/architecture.md). Only the order in which pulses are computed changes; points leave in firing order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..maths.arrays import Numbers
from ..scan.base import Scanner

PACKET = 8
"""Rays that the CPU traces together: single precision in 256 bits."""

LANES = 16
"""The most rays that a CPU traces together, in 512 bits: chunks begin at a multiple of it."""

LONGEST = 2**20
"""Rays of the longest band: chunks are no shorter, and would no longer bound the memory."""

FEWEST = 2**11
"""Pulses of a frame that is worth it; a shorter one is done in a moment, in whatever order."""

HEIGHT = 8
"""Lines of a tile, of which a packet takes as many as its width leaves it."""

UPRIGHT = 1.1
"""How much more an angle across counts than one upwards."""


@dataclass(frozen=True, slots=True, eq=False)
class Tiling:
    """How the scan lines of a scanner are cut up.

    line   pulses of a line
    along  (2, line) places in a line from one end of its directions to the other, of even and of odd lines
    width  pulses of a tile along the line
    """

    line: int
    along: Numbers
    width: int

    @classmethod
    def of(cls, scanner: Scanner) -> Tiling | None:
        """None where pulses follow no lines that lie side by side, or where these are too few or too long."""
        line = scanner.line_pulses
        if line is None or scanner.pulses < max(HEIGHT * line, FEWEST) or 2 * HEIGHT * line > LONGEST:
            return None
        x, y, z = (np.asarray(c) for c in scanner.direction(np.arange(2 * line, dtype=np.uint32)))
        direction = np.stack([np.broadcast_to(c, 2 * line) for c in (x, y, z)], axis=-1).reshape(2, line, 3)
        # The axis along which the directions of a line differ most puts them in order.
        axis = int(np.ptp(direction[0], axis=0).argmax())
        along = np.argsort(direction[:, :, axis], axis=1, kind="stable")
        lines = np.take_along_axis(direction, along[:, :, None], axis=1)
        # Of two shapes with the same girth the upright one has more in common: walls and posts stand, streets are long.
        beside = _typical_angle(lines[0, :-1], lines[0, 1:]) * (1.0 / UPRIGHT if axis == 2 else UPRIGHT)
        below = _typical_angle(lines[0], lines[1])
        widths = [width for width in (1, 2, 4, 8) if width <= line]
        width = min(widths, key=lambda width: width * beside + PACKET // width * below)
        return cls(line, along, width)

    @property
    def band(self) -> int:
        """Pulses of a row of tiles; chunks of a multiple of it are cut alike."""
        return HEIGHT * self.line

    @property
    def step(self) -> int:
        """Pulses of whole bands that are whole packets on every CPU: chunks of a multiple of it are traced alike."""
        return math.lcm(self.band, LANES)

    def order(self, count: int) -> Numbers:
        """(count,) uint32 pulses, from the first of a line on, tile by tile; what fills no band stays as it is."""
        bands = count // self.band
        grid = np.arange(bands * self.band, dtype=np.uint32).reshape(bands, HEIGHT, self.line)
        for parity in (0, 1):
            grid[:, parity::2] = grid[:, parity::2][:, :, self.along[parity]]
        whole = self.line // self.width * self.width
        tiles = grid[:, :, :whole].reshape(bands, HEIGHT, whole // self.width, self.width)
        parts = [
            tiles.swapaxes(1, 2).reshape(bands, HEIGHT * whole),
            grid[:, :, whole:].reshape(bands, self.band - HEIGHT * whole),
        ]
        rest = np.arange(bands * self.band, count, dtype=np.uint32)
        return np.concatenate([np.concatenate(parts, axis=1).ravel(), rest])


def _typical_angle(one: Numbers, other: Numbers) -> float:
    """Between unit vectors, the median."""
    if not len(one):
        return 0.0
    # numpy.median would import numpy.ma, which takes longer than all of this.
    apart = np.sort(np.linalg.norm(np.asarray(one, np.float64) - other, axis=-1), axis=None)
    return float(apart[(len(apart) - 1) // 2] + apart[len(apart) // 2]) / 2.0
