"""Packets of Hesai's Pandar64.

A packet has 6 blocks of 64 distances and reflectivities, each with an azimuth of the head, and ends with its turns in a
minute, the microsecond of the second, the mode of returns and the second (Pandar64 user manual, 3.1; the maker's
HesaiLidar_General_SDK at d7f39ee, ParseL64Data and CalcL64PointXYZIT). That counts times back from the packet's end: a
block's azimuth is the head's 54.668 us after its first laser fires, and the stamp is 42.58 us after that of the last
block. With two returns blocks come in pairs, the last and the strongest.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np

from ...maths.arrays import Numbers
from ...scan.spinning import Spinning
from ...sensor.model import Sensor
from .firings import Firings
from .packet_encoder import Packet, head_deg, last_and_other

PORT = 2368
BLOCKS, LASERS = 6, 64
FULL_TURN = 36_000
STEP_M = 0.004
STRONGEST, LAST, DUAL = 0x37, 0x38, 0x39
CYCLE_S = 0.1 / 1800
"""From block to block, however fast the head turns."""

AZIMUTH_US, STAMP_US = 54.668, 97.248
"""After the first laser of a block, and of the last block, fires: its azimuth, and the packet's stamp."""

BLOCK = np.dtype([("azimuth", "<u2"), ("points", [("distance", "<u2"), ("reflectivity", "u1")], LASERS)])
PACKET = np.dtype(
    [
        ("start", ">u2"),
        ("lasers", "u1"),
        ("blocks_", "u1"),
        ("first_block", "u1"),
        ("step_mm", "u1"),
        ("reserved", "u1", 2),
        ("blocks", BLOCK, BLOCKS),
        ("reserved2", "u1", 8),
        ("turns_per_minute", "<u2"),
        ("stamp", "<u4"),
        ("mode", "u1"),
        ("factory", "u1"),
        ("utc", "u1", 6),
    ]
)


class Pandar64Encoder:
    """Packets of frame after frame; what does not fill a packet waits for the next frame."""

    port = PORT
    needs_ambient = False
    description = None

    def __init__(self, sensor: Sensor) -> None:
        assert isinstance(sensor.scanner, Spinning)
        self._scanner: Spinning = sensor.scanner
        self._dual = sensor.tdc.stops > 1
        self._mode = DUAL if self._dual else LAST if sensor.tdc.keep == "last" else STRONGEST
        self._turn_deg = 360.0 / (self._scanner.cycles * self._scanner.cycle_s) * 1e-6 * AZIMUTH_US
        self._waiting: list[Numbers] = []

    @property
    def _firings(self) -> int:
        return BLOCKS // 2 if self._dual else BLOCKS

    def packets(self, frame: Firings) -> list[Packet]:
        """Those that are full when the frame ends."""
        rows = np.concatenate([*self._waiting, self._rows(frame)])
        whole = len(rows) // self._firings * self._firings
        self._waiting = [rows[whole:]]
        return self._packed(rows[:whole].reshape(-1, self._firings))

    def rest(self) -> list[Packet]:
        """The last packet, filled up with firings of which nothing came back."""
        rows = np.concatenate([np.zeros(0, _ROW), *self._waiting])
        self._waiting = []
        if not len(rows):
            return []
        more = np.zeros(self._firings - len(rows), _ROW)
        missing = np.arange(1, len(more) + 1)
        more["time_s"] = rows["time_s"][-1] + missing * self._scanner.cycle_s
        more["number"] = rows["number"][-1] + missing
        return self._packed(np.concatenate([rows, more]).reshape(1, -1))

    def _rows(self, frame: Firings) -> Numbers:
        rows = np.zeros(len(frame), _ROW)
        rows["number"], rows["time_s"] = frame.number + np.arange(len(frame)), frame.time_s
        for name, values in last_and_other(frame, step_m=STEP_M, both=self._dual).items():
            rows["points"][name] = values
        return rows

    def _packed(self, rows: Numbers) -> list[Packet]:
        made = np.zeros(len(rows), PACKET)
        made["start"], made["lasers"], made["blocks_"] = 0xEEFF, LASERS, BLOCKS
        made["first_block"], made["step_mm"] = int(self._dual), round(1e3 * STEP_M)
        turned_deg = self._turn_deg - head_deg(self._scanner, rows["number"].ravel()).reshape(rows.shape)
        azimuth = np.rint(100.0 * turned_deg).astype(np.int64) % FULL_TURN
        step = 2 if self._dual else 1
        for place in range(step):
            blocks = made["blocks"][:, place::step]
            blocks["azimuth"], blocks["points"] = azimuth, rows["points"][:, :, place]
        made["turns_per_minute"] = round(60.0 / self._scanner.frame_s)
        made["mode"], made["factory"] = self._mode, 0x42
        stamps_us = np.rint(1e6 * rows["time_s"][:, -1] + STAMP_US).astype(np.int64)
        made["stamp"] = stamps_us % 1_000_000
        made["utc"] = [_utc(second) for second in (stamps_us // 1_000_000).tolist()]
        return [Packet(1e-6 * stamp, one.tobytes()) for stamp, one in zip(stamps_us.tolist(), made, strict=True)]


_ROW = np.dtype(
    [("number", "i8"), ("time_s", "f8"), ("points", [("distance", "<u2"), ("reflectivity", "u1")], (2, LASERS))]
)
"""A firing of all lasers: the last return, and the strongest other."""


def _utc(second: int) -> tuple[int, ...]:
    """Year within its century, month, day, hour, minute and second."""
    at = datetime.fromtimestamp(second, UTC)
    return at.year % 100, at.month, at.day, at.hour, at.minute, at.second


def match_pandar64(sensor: Sensor) -> Pandar64Encoder | None:
    """The packets of a sensor that fires as a Pandar64 does; None for another."""
    scanner = sensor.scanner
    if not isinstance(scanner, Spinning) or scanner.lasers != LASERS:
        return None
    first = scanner.lasers_by_place.values[:2]
    spread_us = 1e6 * float(scanner.firing_s[-1] - scanner.firing_s[0])
    same_cycle = math.isclose(scanner.cycle_s, CYCLE_S, rel_tol=2e-3)
    alike = math.isclose(spread_us, AZIMUTH_US - 3.62, abs_tol=0.1) and set(first.tolist()) == {11.0, 39.0}
    return Pandar64Encoder(sensor) if alike and same_cycle else None
