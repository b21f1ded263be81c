"""Sending: the frames of a simulator, one after the other, as packets over UDP.

Frames are rendered by the thread that calls, to which Mitsuba's state belongs; another one sends. So a frame is
computed while those before it are sent.
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

from ...errors import InputError, OutputError
from ...formats.packets.firings import Firings, FiringsBuilder
from ...formats.packets.layouts import Packet
from ...formats.packets.packet_encoder import PacketEncoder
from ...rendering.frame import PULSE_NUMBERS
from ...rendering.options import FrameOptions, Observers
from ...rendering.simulator import Simulator
from .pacing import LATE_S, Clock, Pacer, RealClock

AHEAD = 3
"""Frames that are computed before they are due: a frame may take longer than its time now and then."""

TOLD_EVERY_S = 1.0
SWITCH_S = 0.0005
"""How long Python may keep the sending thread from running: its default of 5 ms is four packets of a VLP-16."""

POLL_S = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """What was sent: late_s is how late each frame ended [s]; ``ended`` says why it ended by itself, or is ""."""

    packets: int
    late_s: Sequence[float]
    ended: str

    def as_text(self) -> str:
        """In one line or two."""
        late = 1e3 * np.asarray(self.late_s or [0.0])
        told = (
            f"sent {len(self.late_s):,} frames, {self.packets:,} packets; frames ended late by "
            f"{np.median(late):.1f} ms (median), {np.percentile(late, 99):.1f} ms (99 %), {late.max():.1f} ms at most; "
            f"{int((late > 1e3 * LATE_S).sum())} by more than {1e3 * LATE_S:g} ms"
        )
        return f"{told}\n{self.ended}" if self.ended else told


@contextmanager
def udp(host: str, port: int) -> Iterator[Callable[[bytes], object]]:
    """What sends a payload there. Raises InputError for a host that is not known, OutputError where nothing leads."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError):
        raise InputError(f"--udp {host}:{port}: no such host") from None
    with socket.socket(family, kind) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

        def send(payload: bytes) -> object:
            try:
                return sock.sendto(payload, address)
            except OSError as error:
                raise OutputError(f"--udp {host}:{port}: cannot be sent: {error.strerror or error}") from None

        yield send


class _Rest(list[Packet]):
    """What is left in the end: no frame of its own."""


class _Queue:
    """Frames from one thread to the other; at most AHEAD wait, beside the one that is being sent."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._frames: deque[Sequence[Packet] | None] = deque()
        self._changed = threading.Condition()
        self.failed: BaseException | None = None

    def put(self, frame: Sequence[Packet] | None) -> bool:
        """Add a frame, or None after the last one, once there is room; False where no one takes them any more."""
        with self._changed:
            while len(self._frames) >= AHEAD and not self._clock.stopped:
                self._changed.wait(POLL_S)  # one without end cannot be interrupted on Windows
            self._frames.append(frame)
            self._changed.notify_all()
        return not self._clock.stopped

    def get(self) -> Sequence[Packet] | None:
        """The next one; None after the last, and where the clock was stopped."""
        with self._changed:
            while not self._frames and not self._clock.stopped:
                self._changed.wait(POLL_S)
            frame = self._frames.popleft() if self._frames and not self._clock.stopped else None
            self._changed.notify_all()
            return frame


class MotionEnded(InputError):
    """Raised where a motion of the scene does not last for another frame."""


def frames_of(
    simulator: Simulator, frame: FrameOptions, *, needs_ambient: bool, frames: int | None = None
) -> Iterator[Firings]:
    """Frame after frame, from the one of ``frame`` on.

    frames  how many; None: until a motion of the scene ends, which raises MotionEnded
    """
    scanner = simulator.sensor.scanner
    # Pulses have numbers below 2^31: VLS-128 has sent as many after a quarter of an hour, and begins anew.
    most = PULSE_NUMBERS // scanner.pulses
    for count in itertools.count() if frames is None else range(frames):
        turn, number = divmod(frame.number + count, most)
        asked = replace(
            frame,
            number=number,
            seed=(frame.seed + turn) % 2**32,
            coordinates="sensor",
            begin_s=frame.begin_s + turn * most * scanner.frame_s,
        )
        gathering = FiringsBuilder(simulator.sensor, number)
        told = Observers(ambient=gathering.ambient if needs_ambient else None)
        try:
            simulator.stream(gathering.add, asked, told)
        except InputError as error:
            raise MotionEnded(str(error)) if count else error from None
        yield gathering.firings()


def send_frames(
    frames: Iterator[Firings],
    maker: PacketEncoder,
    send: Callable[[bytes], object],
    *,
    frame_s: float,
    rate_hz: float | None = None,
    clock: Clock | None = None,
    told: Callable[[str], object] = lambda _: None,
) -> Sent:
    """Send frames until there are no more, or until KeyboardInterrupt.

    frame_s  from frame to frame, by their times
    rate_hz  frames in a second; None: as their times say, real time
    told     is told in a line when frames end late, once a second at most
    """
    clock = clock or RealClock()
    slowness = 1.0 if rate_hz is None else 1.0 / (rate_hz * frame_s)
    queue, ended = _Queue(clock), list[str]()
    frames = _until_motion_ends(frames, ended)
    # The first ones take longest, since kernels are compiled: they are there before the clock starts.
    ready = list(itertools.islice(frames, AHEAD))
    lead_s = frame_s * slowness
    # Packets bear the times at which they leave.
    epoch_s = clock.epoch_s() + lead_s
    pacer = Pacer(send, clock, begin_s=clock.now_s() + lead_s, first_s=epoch_s, slowness=slowness)
    later_s = epoch_s - float(ready[0].time_s[0])
    sender = threading.Thread(target=_send, args=(queue, pacer, clock, told), daemon=True)
    switch_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    sender.start()
    try:
        for one in itertools.chain(ready, frames):
            if not queue.put(maker.packets(replace(one, time_s=one.time_s + later_s))):
                break
        queue.put(_Rest(maker.flush()))
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
    """The frames; why there are no more is added to ``ended``, if a motion is."""
    try:
        yield from frames
    except MotionEnded as error:
        ended.append(str(error))


def _send(queue: _Queue, pacer: Pacer, clock: Clock, told: Callable[[str], object]) -> None:
    """What the sending thread does."""
    told_s = -TOLD_EVERY_S
    try:
        while (packets := queue.get()) is not None:
            pacer.frame(packets, is_frame=not isinstance(packets, _Rest))
            late_s = pacer.late_s[-1] if pacer.late_s else 0.0
            if late_s > LATE_S and clock.now_s() - told_s >= TOLD_EVERY_S:
                told_s = clock.now_s()
                told(f"{late_s:.3g} s behind after {len(pacer.late_s)} frames, of which {pacer.late_frames} ended late")
    except BaseException as error:
        queue.failed = error
        clock.stop()
