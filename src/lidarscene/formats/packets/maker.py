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


class Maker(Protocol):
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


def turns_clockwise(scanner: Spinning) -> bool:
    """Whether the azimuths of firings fall, as makers count them."""
    return (
        math.sin(
            math.radians(float(head_deg(scanner, np.array([1]))[0] - head_deg(scanner, np.array([0]))[0]))
        )
        < 0
    )
