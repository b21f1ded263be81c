"""What the packets of every maker have in common."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from ...maths.arrays import Numbers
from ...scan.spinning import Spinning
from .firings import Firings


class Packet(NamedTuple):
    """A UDP payload and when it leaves the sensor, by the clock of the scene [s]."""

    time_s: float
    payload: bytes


class PacketEncoder(Protocol):
    """Packets of one sensor, frame after frame."""

    @property
    def port(self) -> int:
        """That they are sent to."""

    @property
    def needs_ambient(self) -> bool:
        """Whether they have the background of every pulse."""

    @property
    def description(self) -> tuple[str, str] | None:
        """What the maker's readers need beside the packets, and how the name of its file ends; None: nothing."""

    def packets(self, frame: Firings) -> list[Packet]:
        """In order of time; what does not fill a packet waits for the next frame."""

    def rest(self) -> list[Packet]:
        """What waits, in the end."""


def head_deg(scanner: Spinning, number: Numbers) -> Numbers:
    """(n,) azimuths of the head as read when these firings begin, degrees counter-clockwise from x, float64."""
    angle = np.asarray(scanner.head.angle_rad(number.astype(np.uint32)), np.float64)
    step = scanner.encoder_rad
    return np.degrees(angle if step is None else np.rint(angle / float(step)) * float(step))


def last_and_other(frame: Firings, *, step_m: float, both: bool) -> dict[str, Numbers]:
    """(firings, 2, lasers) distances in steps, uint16, and reflectivities, uint8, of two returns of each pulse.

    First the last one, then the strongest, or the second strongest if the strongest is the last. A lone return is both;
    so is the strongest unless ``both`` are asked for. 0 where nothing came back, and beyond what a distance can say.
    """
    distance = np.rint(frame.range_m / step_m)
    distance = np.where(distance <= np.iinfo(np.uint16).max, distance, 0.0).astype(np.uint16)
    reflectivity = np.rint(frame.intensity).clip(0, 255).astype(np.uint8)
    first, second = distance[..., 0], distance[..., 1]
    farther = (second > first) & both
    alone = (second == 0) | (not both)
    made = {}
    for name, values in (("distance", distance), ("reflectivity", reflectivity)):
        last = np.where(farther, values[..., 1], values[..., 0])
        other = np.where(alone | farther, values[..., 0], values[..., 1])
        made[name] = np.stack([last, other], axis=1)
    return made


def turns_clockwise(scanner: Spinning) -> bool:
    """Whether the azimuths of firings fall, as makers count them."""
    # By the head itself: an encoder may say the same of two firings.
    first, second = np.asarray(scanner.head.angle_rad(np.arange(2, dtype=np.uint32)), np.float64)
    return math.sin(second - first) < 0.0
