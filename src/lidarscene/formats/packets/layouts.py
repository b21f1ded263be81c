"""Byte layouts of the makers' packets, for the encoders here and the readers in `recordings`.

All numbers are little-endian unless a type says otherwise. Sources: Velodyne VLP-16 user manual, 63-9243 Rev. E, 9;
HDL-32E, 63-9277; VLS-128, 63-9480. Hesai Pandar64 user manual, 3.1, and the maker's HesaiLidar_General_SDK at d7f39ee,
ParseL64Data. Ouster's packets are encoded and decoded by the maker's ouster-sdk; only its modes stand here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Packet(NamedTuple):
    """A UDP payload and its time [s]: when it leaves the simulated sensor, or when a recorder received it.

    Attributes:
        port: UDP port that it is sent to; None: that of the sensor's points
    """

    time_s: float
    payload: bytes
    port: int | None = None


FULL_TURN = 36_000
"""Azimuth of a full turn, in the hundredths of a degree that Velodyne and Hesai count."""

STRONGEST, LAST, DUAL = 0x37, 0x38, 0x39
"""Modes of returns, as Velodyne and Hesai number them."""

POINT = [("distance", "<u2"), ("reflectivity", "u1")]
"""Fields of a point in the packets of Velodyne and Pandar64."""

VELODYNE_PORT = 2368
VELODYNE_BLOCKS, VELODYNE_POINTS = 12, 32
VELODYNE_BANKS = (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)
"""First bytes of a block, by the bank of 32 lasers that it holds."""

VELODYNE_EMPTY = 0xFFFF
"""First bytes of a block without lasers: the last four of a VLS-128 with two returns."""

VELODYNE_BLOCK = np.dtype([("bank", "<u2"), ("azimuth", "<u2"), ("points", POINT, VELODYNE_POINTS)])
VELODYNE_PACKET = np.dtype(
    [("blocks", VELODYNE_BLOCK, VELODYNE_BLOCKS), ("stamp", "<u4"), ("mode", "u1"), ("model", "u1")]
)

HESAI_PORT = 2368
HESAI_START = b"\xee\xff"
"""First bytes of every packet of a Hesai."""

PANDAR64_BLOCKS, PANDAR64_LASERS = 6, 64

PANDAR64_CYCLE_S = 0.1 / 1800
"""Source: HesaiLidar_General_SDK; time from block to block, at any rate at which the head turns."""

PANDAR64_AZIMUTH_US, PANDAR64_STAMP_US = 54.668, 97.248
"""Source: HesaiLidar_General_SDK; delay of a block's azimuth, and of the packet's stamp, after the first laser of the
block, or of the last block."""

PANDAR64_BLOCK = np.dtype([("azimuth", "<u2"), ("points", POINT, PANDAR64_LASERS)])
PANDAR64_PACKET = np.dtype(
    [
        ("start", ">u2"),
        ("lasers", "u1"),
        ("block_count", "u1"),
        ("first_block", "u1"),
        ("step_mm", "u1"),
        ("reserved", "u1", 2),
        ("blocks", PANDAR64_BLOCK, PANDAR64_BLOCKS),
        ("reserved2", "u1", 8),
        ("turns_per_minute", "<u2"),
        ("stamp", "<u4"),
        ("mode", "u1"),
        ("factory", "u1"),
        ("utc", "u1", 6),
    ]
)

OUSTER_PORT, OUSTER_IMU_PORT = 7502, 7503

OUSTER_IMU_PACKET = np.dtype(
    [
        ("system_ns", "<u8"),
        ("force_ns", "<u8"),
        ("angular_ns", "<u8"),
        ("force_g", "<f4", 3),
        ("angular_deg_s", "<f4", 3),
    ]
)
"""Legacy IMU packet of 48 bytes (Ouster, firmware user manual, IMU data legacy)."""

OUSTER_MODES = ("512x10", "512x20", "1024x10", "1024x20", "2048x10", "4096x5")
"""Columns a turn and turns a second of the firmware."""
