"""Pacing: packets leave when the sensor would have sent them; late ones go at up to twice its pace, and are counted."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from ...formats.packets.layouts import Packet

LATE_S = 0.01
"""Choice: delay of its last packet beyond which a frame counts as late."""

HURRY = 0.5
"""Choice: least gap between late packets, relative to their right gap: a reader's buffer is not flooded."""


class Clock(Protocol):
    """A clock that can be waited for."""

    def now_s(self) -> float:
        """Seconds since some instant."""

    def epoch_s(self) -> float:
        """Seconds since 1970."""

    def wait(self, seconds: float) -> None:
        """Wait this long, or until `stop` is called."""

    def stop(self) -> None:
        """End all waiting."""

    @property
    def stopped(self) -> bool:
        """Whether `stop` was called."""


class RealClock:
    """The machine's clock."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def now_s(self) -> float:
        """Seconds of the monotonic clock."""
        return time.monotonic()

    def epoch_s(self) -> float:
        """Seconds since 1970 by the system's clock."""
        return time.time()

    def wait(self, seconds: float) -> None:
        """Wait this long; returns at once when stopped."""
        self._event.wait(seconds)

    def stop(self) -> None:
        """End the waiting of every thread."""
        self._event.set()

    @property
    def stopped(self) -> bool:
        """Whether `stop` was called."""
        return self._event.is_set()


class Pacer:
    """Sends packets at their times.

    Attributes:
        packets: number of packets sent
        late_s: delay of the end of each frame [s]

    Args:
        send: function that sends a packet's payload
        clock: clock to wait by
        begin_s: time of the clock at which a packet of the time ``first_s`` is due
        slowness: seconds of the clock for a second of the packets' times: 1 is real time
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
        """Send the packets of a frame, each at its time; returns early where the clock is stopped.

        Args:
            is_frame: whether ``late_s`` gets an entry for them
        """
        for packet in packets:
            due_s = self._begin_s + (packet.time_s - self._first_s) * self._slowness
            # Each packet is due at its own time, however late those before were sent: so late ones catch up.
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
        """Number of frames that ended late."""
        return sum(late > LATE_S for late in self.late_s)
