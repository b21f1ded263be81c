"""Pacing: packets leave when the sensor would have sent them; late ones go at up to twice its pace, and are counted."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from ...formats.packets.layouts import Packet

LATE_S = 0.01
"""A frame whose last packet leaves later than this is told."""

HURRY = 0.5
"""Least gap between packets that are late, of the gap that they should have: a reader's buffer is not flooded."""


class Clock(Protocol):
    """A clock that can be waited for."""

    def now_s(self) -> float:
        """Seconds since some instant."""

    def epoch_s(self) -> float:
        """Seconds since 1970."""

    def wait(self, seconds: float) -> None:
        """Until they are over, or less where `stop` was called."""

    def stop(self) -> None:
        """End all waiting."""

    @property
    def stopped(self) -> bool:
        """Whether it was stopped."""


class RealClock:
    """The machine's own."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def now_s(self) -> float:
        """Monotonic."""
        return time.monotonic()

    def epoch_s(self) -> float:
        """Of the system."""
        return time.time()

    def wait(self, seconds: float) -> None:
        """Ends at once when stopped."""
        self._event.wait(seconds)

    def stop(self) -> None:
        """For every thread."""
        self._event.set()

    @property
    def stopped(self) -> bool:
        """Whether it was stopped."""
        return self._event.is_set()


class Pacer:
    """Sends packets at their times.

    send      takes a packet's payload
    clock     that says when
    begin_s   by the clock, when a packet of the time ``first_s`` is due
    slowness  seconds of the clock for a second of the packets' times: 1 is real time

    packets, late_s  how many were sent, and how late each frame ended
    """

    def __init__(
        self, send: Callable[[bytes], object], clock: Clock, *, begin_s: float, first_s: float, slowness: float = 1.0
    ) -> None:
        self._send, self._clock, self._slowness = send, clock, slowness
        self._begin_s, self._first_s = begin_s, first_s
        self._due_s = self._sent_s = -np.inf
        self.packets = 0
        self.late_s: list[float] = []

    def frame(self, packets: Sequence[Packet], *, is_frame: bool = True) -> None:
        """Send these, one after the other; where the clock is stopped the rest is left.

        is_frame  whether they are counted as one
        """
        for packet in packets:
            due_s = self._begin_s + (packet.time_s - self._first_s) * self._slowness
            # All are due at times of their own, whatever became of those before: what is late can catch up.
            soonest_s = max(due_s, self._sent_s + HURRY * (due_s - self._due_s)) if self.packets else due_s
            if (wait_s := soonest_s - self._clock.now_s()) > 0.0:
                self._clock.wait(wait_s)
            if self._clock.stopped:
                return
            self._send(packet.payload)
            self._due_s, self._sent_s = due_s, self._clock.now_s()
            self.packets += 1
        if packets and is_frame:
            self.late_s.append(max(self._sent_s - self._due_s, 0.0))

    @property
    def late_frames(self) -> int:
        """How many ended late."""
        return sum(late > LATE_S for late in self.late_s)
