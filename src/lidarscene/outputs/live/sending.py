"""Sending: consecutive frames of a simulator as packets over UDP.

The calling thread renders, since Mitsuba's state belongs to it; another thread sends. So a frame is computed while
those before it are sent.
"""

from __future__ import annotations

import itertools
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from ...errors import InputError, OptionError, OutputError
from ...formats.packets.firings import Firings, FiringsBuilder
from ...formats.packets.layouts import Packet
from ...formats.packets.packet_encoder import PacketEncoder
from ...rendering.render_options import FrameOptions, Observers
from ...rendering.simulator import Simulator
from .pacing import LATE_S, Clock, Pacer, RealClock

AHEAD = 3
"""Frames computed before they are due: now and then a frame takes longer than its time."""

REPORT_EVERY_S = 1.0
"""Choice: shortest time between two reports of late packets."""

SWITCH_S = 0.0005
"""Accuracy bought: Python's switch interval while sending; its default of 5 ms would delay four packets of a VLP-16."""

POLL_S = 0.5
"""Choice: longest wait at a time: on Windows one without a limit cannot be interrupted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """Result of `send_frames`.

    Attributes:
        packets: number of packets sent
        late_s: delay of the end of each frame [s]
        ended: why the frames ended by themselves, or ""
    """

    packets: int
    late_s: Sequence[float]
    ended: str

    def as_text(self) -> str:
        """One line of text, and another one for ``ended``."""
        late = 1e3 * np.asarray(self.late_s or [0.0])
        text = (
            f"sent {len(self.late_s):,} frames, {self.packets:,} packets; frames ended late by "
            f"{np.median(late):.1f} ms (median), {np.percentile(late, 99):.1f} ms (99 %), {late.max():.1f} ms at most; "
            f"{int((late > 1e3 * LATE_S).sum())} by more than {1e3 * LATE_S:g} ms"
        )
        return f"{text}\n{self.ended}" if self.ended else text


@contextmanager
def udp(host: str, port: int) -> Iterator[Callable[[bytes], object]]:
    """Open a socket: a function that sends a payload.

    Raises:
        InputError: for an unknown host
        OutputError: in sending
    """
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError):
        raise OptionError("{udp} {0}:{1}: no such host", host, port) from None
    # Readers of packets listen for IPv4, and "localhost" may have an address of IPv6 first.
    family, kind, _, _, address = min(addresses, key=lambda entry: entry[0] != socket.AF_INET)
    with socket.socket(family, kind) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

        def send(payload: bytes) -> object:
            try:
                return sock.sendto(payload, address)
            except OSError as error:
                raise OutputError(f"{host}:{port}: cannot be sent: {error.strerror or error}") from None

        yield send


class _FinalPackets(list[Packet]):
    """Packets still buffered after the last frame; they do not count as a frame."""


class _Queue:
    """Queue of frames between the threads; at most AHEAD wait, beside the one that is being sent."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._frames: deque[Sequence[Packet] | None] = deque()
        self._changed = threading.Condition()
        self.failed: BaseException | None = None

    def put(self, frame: Sequence[Packet] | None) -> bool:
        """Add a frame, or None after the last one, once there is room; False if the clock was stopped."""
        with self._changed:
            while len(self._frames) >= AHEAD and not self._clock.stopped:
                self._changed.wait(POLL_S)  # a wait without timeout cannot be interrupted on Windows
            self._frames.append(frame)
            self._changed.notify_all()
        return not self._clock.stopped

    def get(self) -> Sequence[Packet] | None:
        """Take the next frame; None after the last, and where the clock was stopped."""
        with self._changed:
            while not self._frames and not self._clock.stopped:
                self._changed.wait(POLL_S)
            frame = self._frames.popleft() if self._frames and not self._clock.stopped else None
            self._changed.notify_all()
            return frame


class MotionEnded(InputError):
    """Raised where a motion of the scene does not last for another frame."""


def render_firings(
    simulator: Simulator, frame: FrameOptions, *, needs_ambient: bool, frames: int | None = None
) -> Iterator[Firings]:
    """Render frames pulse by pulse, from the one of ``frame`` on.

    Args:
        frames: number of frames; None: until a motion of the scene ends, which raises MotionEnded
    """
    for count in itertools.count() if frames is None else range(frames):
        frame_options = replace(frame, number=frame.number + count, coordinates="sensor")
        gathering = FiringsBuilder(simulator.sensor, frame_options.number)
        observers = Observers(ambient=gathering.ambient if needs_ambient else None)
        try:
            simulator.stream(gathering.add, frame_options, observers)
        except InputError as error:
            raise MotionEnded(str(error)) if count else error from None
        yield gathering.firings()


def send_frames(
    frames: Iterator[Firings],
    encoder: PacketEncoder,
    send: Callable[[bytes], object],
    *,
    frame_s: float,
    rate_hz: float | None = None,
    clock: Clock | None = None,
    report: Callable[[str], object] = lambda _: None,
) -> Sent:
    """Send frames until there are no more, or until KeyboardInterrupt.

    Args:
        frame_s: time from frame to frame, by the packets' times
        rate_hz: frames sent in a second; None: real time, as the packets' times say
        report: called with a line of text when frames end late, once a second at most
    """
    clock = clock or RealClock()
    slowness = 1.0 if rate_hz is None else 1.0 / (rate_hz * frame_s)
    queue, ended = _Queue(clock), list[str]()
    frames = _until_motion_ends(frames, ended)
    # The first frames take longest, since kernels are compiled: they are rendered before the clock starts.
    ready = list(itertools.islice(frames, AHEAD))
    lead_s = frame_s * slowness
    # Packets bear the times at which they leave.
    epoch_s = clock.epoch_s() + lead_s
    pacer = Pacer(send, clock, begin_s=clock.now_s() + lead_s, first_s=epoch_s, slowness=slowness)
    later_s = epoch_s - float(ready[0].time_s[0])
    sender = threading.Thread(target=_send, args=(queue, pacer, clock, report), daemon=True)
    switch_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    sender.start()
    try:
        for firings in itertools.chain(ready, frames):
            if not queue.put(encoder.packets(replace(firings, time_s=firings.time_s + later_s))):
                break
        queue.put(_FinalPackets(encoder.flush()))
    except BaseException as error:
        clock.stop()
        if not isinstance(error, KeyboardInterrupt):
            raise
    finally:
        try:
            queue.put(None)
            while sender.is_alive():
                sender.join(POLL_S)
        except KeyboardInterrupt:
            clock.stop()
            sender.join()
        sys.setswitchinterval(switch_s)
    if queue.failed is not None:
        raise queue.failed
    return Sent(packets=pacer.packets, late_s=tuple(pacer.late_s), ended="".join(ended))


def _until_motion_ends(frames: Iterator[Firings], ended: list[str]) -> Iterator[Firings]:
    """Iterate over the frames; at the end of a motion stop, and append the reason to ``ended``."""
    try:
        yield from frames
    except MotionEnded as error:
        ended.append(str(error))


def _send(queue: _Queue, pacer: Pacer, clock: Clock, report: Callable[[str], object]) -> None:
    """Body of the sending thread: send frames from the queue until there is none."""
    reported_s = -REPORT_EVERY_S
    try:
        while (packets := queue.get()) is not None:
            pacer.frame(packets, is_frame=not isinstance(packets, _FinalPackets))
            late_s = pacer.late_s[-1] if pacer.late_s else 0.0
            if late_s > LATE_S and clock.now_s() - reported_s >= REPORT_EVERY_S:
                reported_s = clock.now_s()
                report(
                    f"{late_s:.3g} s behind after {len(pacer.late_s)} frames, of which {pacer.late_frames} ended late"
                )
    except BaseException as error:
        queue.failed = error
        clock.stop()
