"""Packets of Velodyne's VLP-16, HDL-32E and VLS-128.

A packet has 12 blocks of 32 distances and reflectivities, each with the azimuth of the head when its first laser fires,
and ends with the microsecond of the hour, the mode of returns and the model (VLP-16 user manual, 63-9243 Rev. E, 9;
HDL-32E, 63-9277; VLS-128, 63-9480). With two returns the blocks come in pairs, the last one and the strongest, or the
second strongest if the strongest is the last.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from ...scan.spinning import Spinning
from ...sensor.model import Sensor
from .firings import Firings
from .packet_encoder import Packet, head_deg, last_and_other

PORT = 2368
BLOCKS, POINTS = 12, 32
FULL_TURN = 36_000
HOUR_US = 3_600_000_000
STRONGEST, LAST, DUAL = 0x37, 0x38, 0x39
BANKS = (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)
"""First bytes of a block: which 32 lasers it has."""

EMPTY = 0xFFFF
"""Of a block without lasers: the last four of a VLS-128 with two returns."""

BLOCK = np.dtype(
    [("bank", "<u2"), ("azimuth", "<u2"), ("points", [("distance", "<u2"), ("reflectivity", "u1")], POINTS)]
)
PACKET = np.dtype([("blocks", BLOCK, BLOCKS), ("stamp", "<u4"), ("mode", "u1"), ("model", "u1")])


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """One of Velodyne's sensors.

    code        last byte of its packets
    cycle_us    from firing to firing
    step_m      of its distances
    firings     in a packet; half of them with two returns, or for a VLS-128 one
    stamp_us    of a packet after its first laser fired. That of a VLS-128 is taken when its fourth group fires:
                velodyne-decoder takes off 7 us at 2.89 us a group, so 6.46 us at 2.667 us
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
        cycle_us=53.3,
        step_m=0.004,
        firings=(3, 1),
        firing_us=tuple(2.665 * (laser // 8 + laser // 64) for laser in range(128)),
        stamp_us=6.46,
    ),
)


class VelodyneEncoder:
    """Packets of frame after frame; what does not fill a packet waits for the next frame."""

    port = PORT
    needs_ambient = False
    description = None

    def __init__(self, sensor: Sensor, model: Model) -> None:
        assert isinstance(sensor.scanner, Spinning)
        self._scanner: Spinning = sensor.scanner
        self._model, self._dual = model, sensor.tdc.stops > 1
        self._mode = DUAL if self._dual else LAST if sensor.tdc.keep == "last" else STRONGEST
        self._waiting: list[Numbers] = []

    def packets(self, frame: Firings) -> list[Packet]:
        """Those that are full when the frame ends."""
        rows = np.concatenate([*self._waiting, self._rows(frame)])
        size = self._model.firings[self._dual]
        whole = len(rows) // size * size
        self._waiting = [rows[whole:]]
        return self._packed(rows[:whole].reshape(-1, size))

    def rest(self) -> list[Packet]:
        """The last packet, filled up with firings of which nothing came back."""
        rows = np.concatenate([*self._waiting, self._none()])
        size = self._model.firings[self._dual]
        if not len(rows):
            return []
        missing = np.arange(1, size - len(rows) + 1)
        more = np.zeros(len(missing), rows.dtype)
        more["time_s"] = rows["time_s"][-1] + missing * self._scanner.cycle_s
        more["azimuth"] = self._azimuth(rows["number"][-1] + missing)
        self._waiting = []
        return self._packed(np.concatenate([rows, more]).reshape(1, size))

    def _none(self) -> Numbers:
        points = [("distance", "<u2"), ("reflectivity", "u1")]
        kinds = [("number", "i8"), ("time_s", "f8"), ("azimuth", "<u2")]
        return np.zeros(0, np.dtype([*kinds, ("points", points, (2, self._model.lasers))]))

    def _rows(self, frame: Firings) -> Numbers:
        """A row for each firing: number, time, azimuth, and points of the last and the strongest return."""
        rows = np.zeros(len(frame), self._none().dtype)
        rows["number"] = frame.number + np.arange(len(frame))
        rows["time_s"] = frame.time_s
        rows["azimuth"] = self._azimuth(rows["number"])
        for name, values in last_and_other(frame, step_m=self._model.step_m, both=self._dual).items():
            rows["points"][name] = values
        return rows

    def _azimuth(self, number: Numbers) -> Numbers:
        """(n,) hundredths of a degree, clockwise from x, at the start of each firing."""
        return np.rint(-100.0 * head_deg(self._scanner, number)).astype(np.int64) % FULL_TURN

    def _packed(self, rows: Numbers) -> list[Packet]:
        """Packets of (packets, firings) rows."""
        model, lasers = self._model, self._model.lasers
        made = np.zeros(len(rows), PACKET)
        returns = 2 if self._dual else 1
        firings = rows.shape[1]
        blocks = firings * lasers // POINTS
        for place in range(returns):
            # Blocks of 32 lasers: two firings of a VLP-16, a quarter of one of a VLS-128.
            points = rows["points"][:, :, place].reshape(len(rows), blocks, POINTS)
            chosen = made["blocks"][:, place : blocks * returns : returns]
            chosen["points"] = points
            first = np.arange(blocks) * POINTS // lasers
            chosen["azimuth"] = rows["azimuth"][:, first]
            chosen["bank"] = [BANKS[block * POINTS % lasers // POINTS] for block in range(blocks)]
        made["blocks"]["bank"][:, blocks * returns :] = EMPTY
        stamps = np.rint(1e6 * rows["time_s"][:, 0] + model.stamp_us)
        made["stamp"] = (stamps % HOUR_US).astype(np.uint32)
        made["mode"], made["model"] = self._mode, model.code
        sent_s = rows["time_s"][:, -1] + 1e-6 * model.firing_us[-1]
        return [Packet(time, one.tobytes()) for time, one in zip(sent_s.tolist(), made, strict=True)]


def match_velodyne(sensor: Sensor) -> VelodyneEncoder | None:
    """The packets of a sensor that fires as one of these models does; None for another."""
    scanner = sensor.scanner
    if not isinstance(scanner, Spinning):
        return None
    firing_us = 1e6 * (scanner.firing_s - scanner.firing_s[0])[np.argsort(scanner.lasers_by_place.values)]
    for model in MODELS:
        same_cycle = math.isclose(1e6 * scanner.cycle_s, model.cycle_us, rel_tol=2e-3)
        if scanner.lasers == model.lasers and same_cycle:
            return VelodyneEncoder(sensor, model) if np.abs(firing_us - model.firing_us).max() < 0.1 else None
    return None
