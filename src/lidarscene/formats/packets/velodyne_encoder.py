"""Packets of Velodyne's VLP-16, HDL-32E and VLS-128.

A packet (`layouts.VELODYNE_PACKET`) has 12 blocks of 32 distances and reflectivities, each with the azimuth of the head
when its first laser fires, and ends with the microsecond of the hour, the mode of returns and the model. With two
returns the blocks come in pairs: the last return, then the strongest, or the second strongest if the strongest is the
last.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from ...scan.spinning import Spinning
from ...sensor.sensor_model import Sensor
from .layouts import VELODYNE_BANKS, VELODYNE_EMPTY, VELODYNE_PACKET, VELODYNE_POINTS, VELODYNE_PORT, Packet
from .packet_encoder import BlockEncoder

HOUR_US = 3_600_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """Timing and packet layout of one of Velodyne's sensors.

    Attributes:
        code: last byte of its packets
        cycle_us: time from firing to firing
        firing_us: delay of each laser within a firing
        step_m: step of the distances
        firings: firings in a packet with one return, and with two
        stamp_us: delay of a packet's stamp after its first laser fired. That of a VLS-128 is taken when its fourth
            group fires: velodyne-decoder takes off 7 us at 2.89 us a group, so 6.46 us at 2.667 us
    """

    name: str
    code: int
    lasers: int
    cycle_us: float
    firing_us: tuple[float, ...]
    step_m: float
    firings: tuple[int, int]
    stamp_us: float = 0.0


MODELS = (
    Model(
        name="vlp-16",
        code=0x22,
        lasers=16,
        cycle_us=55.296,
        step_m=0.002,
        firings=(24, 12),
        firing_us=tuple(2.304 * laser for laser in range(16)),
    ),
    Model(
        name="hdl-32e",
        code=0x21,
        lasers=32,
        cycle_us=46.08,
        step_m=0.002,
        firings=(12, 6),
        firing_us=tuple(1.152 * laser for laser in range(32)),
    ),
    Model(
        name="vls-128",
        code=0xA1,
        lasers=128,
        cycle_us=55.3,
        step_m=0.004,
        firings=(3, 1),
        firing_us=tuple(2.665 * (laser // 8 + laser // 64) for laser in range(128)),
        stamp_us=6.46,
    ),
)


class VelodyneEncoder(BlockEncoder):
    """Packets of one of Velodyne's sensors, frame after frame."""

    port = VELODYNE_PORT

    def __init__(self, sensor: Sensor, model: Model) -> None:
        super().__init__(sensor, firings=model.firings, step_m=model.step_m)
        self._model = model

    def _encode(self, rows: Numbers) -> list[Packet]:
        model, lasers = self._model, self._model.lasers
        payloads = np.zeros(len(rows), VELODYNE_PACKET)
        returns = 2 if self._dual else 1
        firings = rows.shape[1]
        blocks = firings * lasers // VELODYNE_POINTS
        azimuth = self._azimuth(rows["number"])
        for return_index in range(returns):
            # Blocks of 32 lasers: two firings of a VLP-16, a quarter of one of a VLS-128.
            points = rows["points"][:, :, return_index].reshape(len(rows), blocks, VELODYNE_POINTS)
            return_blocks = payloads["blocks"][:, return_index : blocks * returns : returns]
            return_blocks["points"] = points
            first = np.arange(blocks) * VELODYNE_POINTS // lasers
            return_blocks["azimuth"] = azimuth[:, first]
            return_blocks["bank"] = [
                VELODYNE_BANKS[block * VELODYNE_POINTS % lasers // VELODYNE_POINTS] for block in range(blocks)
            ]
        payloads["blocks"]["bank"][:, blocks * returns :] = VELODYNE_EMPTY
        stamps = np.rint(1e6 * rows["time_s"][:, 0] + model.stamp_us)
        payloads["stamp"] = (stamps % HOUR_US).astype(np.uint32)
        payloads["mode"], payloads["model"] = self._mode, model.code
        sent_s = rows["time_s"][:, -1] + 1e-6 * model.firing_us[-1]
        return [Packet(time, payload.tobytes()) for time, payload in zip(sent_s.tolist(), payloads, strict=True)]


def match_velodyne(sensor: Sensor) -> VelodyneEncoder | None:
    """Encoder for a sensor whose cycle and firing times are those of one of `MODELS`; None for another."""
    scanner = sensor.scanner
    if not isinstance(scanner, Spinning):
        return None
    firing_us = 1e6 * (scanner.firing_s - scanner.firing_s[0])[np.argsort(scanner.lasers_by_place.values)]
    for model in MODELS:
        same_cycle = math.isclose(1e6 * scanner.cycle_s, model.cycle_us, rel_tol=2e-3)
        if scanner.lasers == model.lasers and same_cycle:
            return VelodyneEncoder(sensor, model) if np.abs(firing_us - model.firing_us).max() < 0.1 else None
    return None
