"""The protocol of an encoder of packets, and what the encoders of all makers share."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np

from ...errors import OptionWarning, warn
from ...maths.arrays import Numbers
from ...scan.spinning import Spinning
from ...sensor.sensor_model import Sensor
from .firings import Firings
from .layouts import DUAL, FULL_TURN, LAST, POINT, STRONGEST, Packet


class PacketEncoder(Protocol):
    """Encoder of one sensor's packets, frame after frame."""

    @property
    def port(self) -> int:
        """UDP port that the packets are sent to."""

    @property
    def needs_ambient(self) -> bool:
        """True if the packets hold the background of every pulse."""

    @property
    def description(self) -> tuple[str, str] | None:
        """Text that the maker's readers need beside the packets, and the suffix of its file; None: nothing."""

    def packets(self, frame: Firings) -> list[Packet]:
        """Packets of a frame, in order of time; firings that do not fill a packet wait for the next frame."""

    def flush(self) -> list[Packet]:
        """Packets still buffered after the last frame."""


class BlockEncoder(ABC):
    """Packets of blocks with the last and the strongest return; firings that do not fill one wait for the next frame.

    Args:
        firings: of a packet with one return, and with two
        step_m: of the distances
    """

    needs_ambient = False
    description = None

    def __init__(self, sensor: Sensor, *, firings: tuple[int, int], step_m: float) -> None:
        assert isinstance(sensor.scanner, Spinning)
        self._scanner: Spinning = sensor.scanner
        self._dual = sensor.tdc.stops > 1
        self._mode = DUAL if self._dual else LAST if sensor.tdc.keep == "last" else STRONGEST
        self._firings, self._step_m = firings[self._dual], step_m
        points = ("points", POINT, (2, self._scanner.lasers))
        self._waiting = np.zeros(0, np.dtype([("number", "i8"), ("time_s", "f8"), points]))

    @abstractmethod
    def _encode(self, rows: Numbers) -> list[Packet]:
        """Encode (packets, firings) rows: number, time, and points of the last and the strongest return."""

    def packets(self, frame: Firings) -> list[Packet]:
        """Packets that are full when the frame ends."""
        rows = np.concatenate([self._waiting, self._rows(frame)])
        full_rows = len(rows) // self._firings * self._firings
        self._waiting = rows[full_rows:]
        return self._encode(rows[:full_rows].reshape(-1, self._firings))

    def flush(self) -> list[Packet]:
        """Last packet, filled up with firings without any return."""
        rows, self._waiting = self._waiting, self._waiting[:0]
        if not len(rows):
            return []
        following = np.arange(1, self._firings - len(rows) + 1)
        filler = np.zeros(len(following), rows.dtype)
        filler["time_s"] = rows["time_s"][-1] + following * self._scanner.cycle_s
        filler["number"] = rows["number"][-1] + following
        return self._encode(np.concatenate([rows, filler]).reshape(1, -1))

    def _rows(self, frame: Firings) -> Numbers:
        rows = np.zeros(len(frame), self._waiting.dtype)
        rows["number"], rows["time_s"] = frame.number + np.arange(len(frame)), frame.time_s
        for name, values in last_and_strongest(frame, step_m=self._step_m, two_returns=self._dual).items():
            rows["points"][name] = values
        return rows

    def _azimuth(self, number: Numbers, later_deg: float = 0.0) -> Numbers:
        """Hundredths of a degree, clockwise from x, of the head so much after the start of these firings."""
        turned_deg = later_deg - head_deg(self._scanner, number.ravel()).reshape(number.shape)
        return np.rint(100.0 * turned_deg).astype(np.int64) % FULL_TURN


def head_deg(scanner: Spinning, number: Numbers) -> Numbers:
    """(n,) azimuths of the head as read when these firings begin, degrees counter-clockwise from x, float64."""
    angle = np.asarray(scanner.head.angle_rad(number), np.float64)
    step = scanner.encoder_rad
    return np.degrees(angle if step is None else np.rint(angle / float(step)) * float(step))


def last_and_strongest(frame: Firings, *, step_m: float, two_returns: bool) -> dict[str, Numbers]:
    """(firings, 2, lasers) distances in steps, uint16, and reflectivities, uint8, of two returns of each pulse.

    First the last one, then the strongest, or the second strongest if the strongest is the last. A lone return is both;
    so is the strongest without ``two_returns``. 0 where nothing came back, and for distances above 65535 steps, of
    which a warning says that they are left out.
    """
    distance, most = np.rint(frame.range_m / step_m), np.iinfo(np.uint16).max
    if np.any(distance > most):
        last_m = f"{most * step_m:.2f}"
        warn(OptionWarning("packets of this sensor end at {0} m: returns beyond are left out", last_m))
    distance = np.where(distance <= most, distance, 0.0).astype(np.uint16)
    reflectivity = np.rint(frame.intensity).clip(0, 255).astype(np.uint8)
    first, second = distance[..., 0], distance[..., 1]
    farther = (second > first) & two_returns
    only_first = (second == 0) | (not two_returns)
    returns = {}
    for name, values in (("distance", distance), ("reflectivity", reflectivity)):
        last = np.where(farther, values[..., 1], values[..., 0])
        strongest = np.where(only_first | farther, values[..., 0], values[..., 1])
        returns[name] = np.stack([last, strongest], axis=1)
    return returns


def turns_clockwise(scanner: Spinning) -> bool:
    """True if the head turns clockwise seen from above, as all of these makers' do."""
    # By the head itself: two firings may lie within one step of the encoder.
    first, second = np.asarray(scanner.head.angle_rad(np.arange(2)), np.float64)
    return math.sin(second - first) < 0.0
