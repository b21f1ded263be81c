"""Packets of Hesai's Pandar64.

A packet (`layouts.PANDAR64_PACKET`) has 6 blocks of 64 distances and reflectivities, each with an azimuth of the head,
and ends with its turns in a minute, the microsecond of the second, the mode of returns and the second. The maker's
driver (HesaiLidar_General_SDK at d7f39ee, CalcL64PointXYZIT) counts times back from the packet's end: a block's azimuth
is that of the head 54.668 us after its first laser fires, and the stamp is 42.58 us after the azimuth of the last
block. With two returns blocks come in pairs, the last and the strongest.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np

from ...maths.arrays import Numbers
from ...scan.spinning import Spinning
from ...sensor.sensor_model import Sensor
from .firings import Firings
from .layouts import (
    DUAL,
    FULL_TURN,
    HESAI_PORT,
    HESAI_START,
    LAST,
    PANDAR64_AZIMUTH_US,
    PANDAR64_BLOCKS,
    PANDAR64_CYCLE_S,
    PANDAR64_LASERS,
    PANDAR64_PACKET,
    PANDAR64_STAMP_US,
    POINT,
    STRONGEST,
    Packet,
)
from .packet_encoder import head_deg, last_and_strongest

STEP_M = 0.004
"""Source: Hesai's Pandar64 user manual; step of the distances."""


class Pandar64Encoder:
    """Packets of frame after frame; firings that do not fill a packet wait for the next frame."""

    port = HESAI_PORT
    needs_ambient = False
    description = None

    def __init__(self, sensor: Sensor) -> None:
        assert isinstance(sensor.scanner, Spinning)
        self._scanner: Spinning = sensor.scanner
        self._dual = sensor.tdc.stops > 1
        self._mode = DUAL if self._dual else LAST if sensor.tdc.keep == "last" else STRONGEST
        self._turn_deg = 360.0 / (self._scanner.cycles * self._scanner.cycle_s) * 1e-6 * PANDAR64_AZIMUTH_US
        self._waiting: list[Numbers] = []

    @property
    def _firings(self) -> int:
        return PANDAR64_BLOCKS // 2 if self._dual else PANDAR64_BLOCKS

    def packets(self, frame: Firings) -> list[Packet]:
        """Packets that are full when the frame ends."""
        rows = np.concatenate([*self._waiting, self._rows(frame)])
        full_rows = len(rows) // self._firings * self._firings
        self._waiting = [rows[full_rows:]]
        return self._encode(rows[:full_rows].reshape(-1, self._firings))

    def flush(self) -> list[Packet]:
        """Last packet, filled up with firings without any return."""
        rows = np.concatenate([np.zeros(0, _ROW), *self._waiting])
        self._waiting = []
        if not len(rows):
            return []
        filler = np.zeros(self._firings - len(rows), _ROW)
        following = np.arange(1, len(filler) + 1)
        filler["time_s"] = rows["time_s"][-1] + following * self._scanner.cycle_s
        filler["number"] = rows["number"][-1] + following
        return self._encode(np.concatenate([rows, filler]).reshape(1, -1))

    def _rows(self, frame: Firings) -> Numbers:
        rows = np.zeros(len(frame), _ROW)
        rows["number"], rows["time_s"] = frame.number + np.arange(len(frame)), frame.time_s
        for name, values in last_and_strongest(frame, step_m=STEP_M, two_returns=self._dual).items():
            rows["points"][name] = values
        return rows

    def _encode(self, rows: Numbers) -> list[Packet]:
        payloads = np.zeros(len(rows), PANDAR64_PACKET)
        payloads["start"] = int.from_bytes(HESAI_START)
        payloads["lasers"], payloads["block_count"] = PANDAR64_LASERS, PANDAR64_BLOCKS
        payloads["first_block"], payloads["step_mm"] = int(self._dual), round(1e3 * STEP_M)
        clockwise_deg = self._turn_deg - head_deg(self._scanner, rows["number"].ravel()).reshape(rows.shape)
        azimuth = np.rint(100.0 * clockwise_deg).astype(np.int64) % FULL_TURN
        step = 2 if self._dual else 1
        for return_index in range(step):
            blocks = payloads["blocks"][:, return_index::step]
            blocks["azimuth"], blocks["points"] = azimuth, rows["points"][:, :, return_index]
        payloads["turns_per_minute"] = round(60.0 / self._scanner.frame_s)
        payloads["mode"], payloads["factory"] = self._mode, 0x42
        stamps_us = np.rint(1e6 * rows["time_s"][:, -1] + PANDAR64_STAMP_US).astype(np.int64)
        payloads["stamp"] = stamps_us % 1_000_000
        payloads["utc"] = [_utc(second) for second in (stamps_us // 1_000_000).tolist()]
        return [
            Packet(1e-6 * stamp, payload.tobytes()) for stamp, payload in zip(stamps_us.tolist(), payloads, strict=True)
        ]


_ROW = np.dtype([("number", "i8"), ("time_s", "f8"), ("points", POINT, (2, PANDAR64_LASERS))])
"""Firing of all lasers: points of the last return, and of the strongest."""


def _utc(second: int) -> tuple[int, ...]:
    """Year within its century, month, day, hour, minute and second."""
    utc = datetime.fromtimestamp(second, UTC)
    return utc.year % 100, utc.month, utc.day, utc.hour, utc.minute, utc.second


def match_pandar64(sensor: Sensor) -> Pandar64Encoder | None:
    """Encoder for a sensor whose lasers and firing times are those of a Pandar64; None for another."""
    scanner = sensor.scanner
    if not isinstance(scanner, Spinning) or scanner.lasers != PANDAR64_LASERS:
        return None
    first = scanner.lasers_by_place.values[:2]
    spread_us = 1e6 * float(scanner.firing_s[-1] - scanner.firing_s[0])
    same_cycle = math.isclose(scanner.cycle_s, PANDAR64_CYCLE_S, rel_tol=2e-3)
    # Lasers 11 and 39 fire first; the last fires 51.048 us later, 3.62 us before the head's azimuth is read.
    alike = math.isclose(spread_us, PANDAR64_AZIMUTH_US - 3.62, abs_tol=0.1) and set(first.tolist()) == {11.0, 39.0}
    return Pandar64Encoder(sensor) if alike and same_cycle else None
