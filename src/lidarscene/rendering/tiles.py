"""Tiles: the order in which the pulses of a chunk are traced, so that rays traced together are neighbours both ways.

The CPU traces eight rays at a time. Eight consecutive pulses lie in a row: those of a line run along many surfaces,
those of a bank of lasers spread over its whole field. Eight in a block meet more of the same surfaces
(ARCHITECTURE.md). Only the order in which pulses are computed changes; points leave in firing order.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..kernel.device import transfer
from ..kernel.rays.kept_lanes import NO_PULSE
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
"""Least pulses of a frame that is tiled; a shorter one takes no time in any order."""

HEIGHT = 8
"""Scan lines of a tile; a packet of width w spans PACKET / w of them."""

UPRIGHT = 1.1
"""Choice: weight of a horizontal angle relative to a vertical one in the girth of a packet."""

CACHED = 2
"""Chunks whose order and times are cached: frames have chunks of two sizes at most, and mostly one chunk."""


@dataclass(frozen=True, slots=True, eq=False)
class Tiling:
    """Division of a scanner's lines into tiles.

    Attributes:
        line: pulses of a line
        along: (2, line) indices that sort a line by direction, for even and for odd lines
        width: pulses of a tile along the line
    """

    line: int
    along: Numbers
    width: int

    @classmethod
    def from_scanner(cls, scanner: Scanner) -> Tiling | None:
        """Choose the tiles of a scanner; None without adjacent scan lines, or if these are too few or too long."""
        line = scanner.line_pulses
        if line is None or scanner.pulses < max(HEIGHT * line, FEWEST) or 2 * HEIGHT * line > LONGEST:
            return None
        x, y, z = (np.asarray(c) for c in scanner.direction(np.arange(2 * line, dtype=np.uint32)))
        direction = np.stack([np.broadcast_to(c, 2 * line) for c in (x, y, z)], axis=-1).reshape(2, line, 3)
        # The axis along which the directions of a line differ most puts them in order.
        axis = int(np.ptp(direction[0], axis=0).argmax())
        along = np.argsort(direction[:, :, axis], axis=1, kind="stable")
        lines = np.take_along_axis(direction, along[:, :, None], axis=1)
        # The packet with the least girth. Of two with the same girth the upright one meets fewer surfaces: walls and
        # posts stand.
        in_line = _typical_angle(lines[0, :-1], lines[0, 1:]) * (1.0 / UPRIGHT if axis == 2 else UPRIGHT)
        between_lines = _typical_angle(lines[0], lines[1])
        widths = [width for width in (1, 2, 4, 8) if width <= line]
        width = min(widths, key=lambda width: width * in_line + PACKET // width * between_lines)
        return cls(line, along, width)

    @property
    def band(self) -> int:
        """Pulses of a row of tiles; chunks of a multiple of it are divided alike."""
        return HEIGHT * self.line

    @property
    def step(self) -> int:
        """Pulses of whole bands that are whole packets on every CPU: chunks of a multiple of it are traced alike."""
        return math.lcm(self.band, LANES)

    def order(self, count: int) -> Numbers:
        """Pulse numbers tile by tile, (count,) uint32, from the start of a line on; pulses that fill no band follow."""
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
        remainder = np.arange(bands * self.band, count, dtype=np.uint32)
        return np.concatenate([np.concatenate(parts, axis=1).ravel(), remainder])


def _typical_angle(first: Numbers, second: Numbers) -> float:
    """Median angle between unit vectors [rad], both (n, 3); the chord, which is the angle for small ones."""
    if not len(first):
        return 0.0
    # numpy.median would import numpy.ma, which takes longer than all of this.
    apart = np.sort(np.linalg.norm(np.asarray(first, np.float64) - second, axis=-1), axis=None)
    return float(apart[(len(apart) - 1) // 2] + apart[len(apart) // 2]) / 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """Permutation between pulse order and lanes of a chunk.

    Attributes:
        pulse: (n,) uint32 pulse of each lane, counted from the chunk's first; `NO_PULSE` of a lane without one
        lane: uint32 lane of each pulse, the inverse
        device_pulse: ``pulse`` on the device
        device_lane: ``lane`` on the device
    """

    pulse: Numbers
    lane: Numbers
    device_pulse: Any
    device_lane: Any

    @classmethod
    def from_pulses(cls, pulse: Numbers, lane: Numbers) -> Order:
        """Build from the pulse of each lane, and the lane of each pulse."""
        return cls(pulse, lane, transfer.unsigned_numbers(pulse), transfer.unsigned_numbers(lane))

    def on_device(self, first: int) -> Any:
        """Pulse numbers of the lanes, (n,) on the device, of a chunk that begins at pulse ``first``."""
        return self.device_pulse + transfer.opaque_uint32(first)


@dataclass(frozen=True, slots=True, eq=False)
class DevicePulses:
    """Some pulses of a frame, on the device.

    Attributes:
        number: (n,) UInt32 pulse number of each lane
        departures: gives `Frame.departures`; called only where something moves
        order: permutation of the lanes; None: lanes in the order of numbers
    """

    number: Any
    departures: Callable[[], tuple[Any, Any]]
    order: Order | None = None


class Numbering:
    """Pulses of each chunk; their order and times, the same in every frame, are cached for `CACHED` chunks.

    Attributes:
        clock: the scanner's, on the device
        whole: pulses of a frame that stay in one chunk
    """

    def __init__(self, scanner: Scanner, *, tiled: bool, whole: int = 1) -> None:
        """Number the pulses of a scanner; a chunk of more than a frame is several whole frames, each in an order alike.

        Args:
            tiled: in tiles where the scanner's lines allow
            whole: pulses of a frame that stay in one chunk: those of a line, if its channels see each other's light
        """
        self.whole, self._scanner = whole, scanner
        self._tiling = Tiling.from_scanner(scanner) if tiled else None
        self._orders: dict[int, Order] = {}
        self._departures: dict[tuple[int, int], tuple[Any, Any]] = {}
        self.clock = transfer.opaque(scanner.clock, double=True)

    @property
    def step(self) -> int:
        """Pulses of which chunks should be a multiple, to be traced alike."""
        return math.lcm(self.whole, LANES if self._tiling is None else self._tiling.step)

    @property
    def goes_together(self) -> bool:
        """Whether several frames can be one chunk: lines that stay in one chunk must end with a packet of rays."""
        return self.whole == 1 or self.whole % LANES == 0

    @property
    def frame_lanes(self) -> int:
        """Lanes of each of several frames of a chunk: whole packets of rays, so that the next frame begins one."""
        return -(-self._scanner.pulses // LANES) * LANES

    def pulses(self, frame: Frame, first: int, count: int) -> DevicePulses:
        """Pulses of a chunk of a frame: ``count`` from number ``first`` on."""
        order = self.lane_order(count)
        number = transfer.counter(first, count) if order is None else order.on_device(first)

        def departures() -> tuple[Any, Any]:
            key = first - frame.first_pulse, count
            if key not in self._departures:
                self._departures = _with_entry(self._departures, key, self.chosen(frame, number).departures())
            return self._departures[key]

        return DevicePulses(number, departures, order)

    def chosen(self, frame: Frame, number: Any) -> DevicePulses:
        """Pulses of a frame by their numbers, (n,) on the device."""

        def departures() -> tuple[Any, Any]:
            leaving = frame.departures(number, self.clock)
            transfer.start(leaving)
            return leaving

        return DevicePulses(number, departures)

    def lane_order(self, count: int) -> Order | None:
        """Order of the lanes of a chunk of ``count`` pulses; None: in the order of numbers."""
        frames = max(count // self._scanner.pulses, 1)
        gap = np.full(self.frame_lanes - self._scanner.pulses if frames > 1 else 0, NO_PULSE, np.uint32)
        if self._tiling is None and not len(gap):
            return None
        if count not in self._orders:
            pulses = count // frames
            place = np.arange(pulses, dtype=np.uint32) if self._tiling is None else self._tiling.order(pulses)
            numbers, lane = np.arange(frames, dtype=np.uint32), inverse(place)
            pulse_of_lane = np.concatenate(
                [part for number in numbers for part in (place + number * np.uint32(self._scanner.pulses), gap)]
            )
            lane_of_pulse = np.concatenate([lane + number * np.uint32(pulses + len(gap)) for number in numbers])
            self._orders = _with_entry(self._orders, count, Order.from_pulses(pulse_of_lane, lane_of_pulse))
        return self._orders[count]


def _with_entry(cache: dict[Any, Any], key: Any, value: Any) -> dict[Any, Any]:
    """Copy of a cache with this entry added; of the others the latest stay, `CACHED` in all."""
    return dict([*cache.items()][1 - CACHED :]) | {key: value}
