"""Tiles: in which order the pulses of a chunk are traced, so that rays traced together are neighbours both ways.

The CPU traces eight rays at a time. Eight that follow each other in firing order lie in a row: those of a line run
along many surfaces, those of a bank of lasers spread over its whole field. Eight in a block share more of what they
meet (docs/architecture.md). Only the order in which pulses are computed changes; points leave in firing order.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..kernel.device import transfer
from ..maths.arrays import Numbers, inverse
from ..scan.base import Scanner
from .frame import Frame

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

KEPT = 2
"""Chunks whose order and times are kept: frames have chunks of two sizes at most, and mostly one chunk."""


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


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """In which order the pulses of a chunk are on the lanes.

    pulse          (n,) uint32, of each lane, from the chunk's first one
    lane           (n,) uint32, of each pulse
    device_pulse, device_lane  the same, on the device
    """

    pulse: Numbers
    lane: Numbers
    device_pulse: Any
    device_lane: Any

    @classmethod
    def of(cls, pulse: Numbers) -> Order:
        """From the pulses of the lanes."""
        lane = inverse(pulse)
        return cls(pulse, lane, transfer.unsigned_numbers(pulse), transfer.unsigned_numbers(lane))

    def on_device(self, first: int) -> Any:
        """(n,) pulse numbers of the lanes of a chunk whose first one is given."""
        return self.device_pulse + transfer.opaque_uint32(first)


@dataclass(frozen=True, slots=True, eq=False)
class Pulses:
    """Some pulses of a frame, on the device.

    number  (n,) UInt32, one for each lane
    times   gives (n,) when they leave, in seconds after the frame's first one; asked for where something moves
    order   of the lanes; None: that of the numbers
    """

    number: Any
    times: Callable[[], Any]
    order: Order | None = None


class Numbering:
    """The pulses of each chunk, and what of them is the same in every frame: kept for the last `KEPT` chunks."""

    def __init__(self, scanner: Scanner, *, tiled: bool) -> None:
        self._tiling = Tiling.of(scanner) if tiled else None
        self._orders: dict[int, Order] = {}
        self._times: dict[tuple[int, int], Any] = {}

    @property
    def step(self) -> int:
        """Chunks of a multiple of it are traced alike."""
        return LANES if self._tiling is None else self._tiling.step

    def pulses(self, now: Frame, first: int, count: int) -> Pulses:
        """Of a chunk of a frame, from its first number on."""
        order = self.order_of(count)

        def times() -> Any:
            key = first - now.first_pulse, count
            if key not in self._times:
                place = np.arange(count, dtype=np.uint32) if order is None else order.pulse
                self._times = _kept(self._times, key, now.times(place + np.uint32(first)))
            return self._times[key]

        number = transfer.counter(first, count) if order is None else order.on_device(first)
        return Pulses(number, times, order)

    def order_of(self, count: int) -> Order | None:
        """Of a chunk of so many pulses; None: that of their numbers."""
        if self._tiling is None:
            return None
        if count not in self._orders:
            self._orders = _kept(self._orders, count, Order.of(self._tiling.order(count)))
        return self._orders[count]


def _kept(known: dict[Any, Any], key: Any, value: Any) -> dict[Any, Any]:
    """With this entry, and of the others those that came last: `KEPT` in all."""
    return dict([*known.items()][1 - KEPT :]) | {key: value}
