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
from .layouts import (
    HESAI_PORT,
    HESAI_START,
    PANDAR64_AZIMUTH_US,
    PANDAR64_BLOCKS,
    PANDAR64_CYCLE_S,
    PANDAR64_LASERS,
    PANDAR64_PACKET,
    PANDAR64_STAMP_US,
    Packet,
)
from .packet_encoder import BlockEncoder

STEP_M = 0.004
"""Source: Hesai's Pandar64 user manual; step of the distances."""


class Pandar64Encoder(BlockEncoder):
    """Packets of a Pandar64, frame after frame."""

    port = HESAI_PORT

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor, firings=(PANDAR64_BLOCKS, PANDAR64_BLOCKS // 2), step_m=STEP_M)
        self._turn_deg = 360.0 / (self._scanner.cycles * self._scanner.cycle_s) * 1e-6 * PANDAR64_AZIMUTH_US

    def _encode(self, rows: Numbers) -> list[Packet]:
        payloads = np.zeros(len(rows), PANDAR64_PACKET)
        payloads["start"] = int.from_bytes(HESAI_START)
        payloads["lasers"], payloads["block_count"] = PANDAR64_LASERS, PANDAR64_BLOCKS
        payloads["first_block"], payloads["step_mm"] = int(self._dual), round(1e3 * STEP_M)
        azimuth = self._azimuth(rows["number"], self._turn_deg)
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
