"""Sending: every packet of every frame, in order and with the time at which it leaves; ends in each way it can."""

import itertools
import socket
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.packets import firings_of

from lidarscene.errors import InputError, OutputError
from lidarscene.formats.packets.firings import Firings
from lidarscene.formats.packets.layouts import VELODYNE_PACKET
from lidarscene.formats.packets.select_encoder import select_encoder
from lidarscene.outputs.live.sending import AHEAD, MotionEnded, Sent, render_firings, send_frames, udp
from lidarscene.rendering.render_options import FrameOptions
from lidarscene.sensor.sensor_file import load_sensor

SENSOR = load_sensor("vlp-16")


class Clock:
    """Goes on by waiting alone, in the thread that sends."""

    def __init__(self) -> None:
        self.at_s, self.stopped = 0.0, False

    def now_s(self) -> float:
        return self.at_s

    def epoch_s(self) -> float:
        return 3600.0 * 1000 + self.at_s

    def wait(self, seconds: float) -> None:
        self.at_s += seconds

    def stop(self) -> None:
        self.stopped = True


def firings(frames: int) -> Iterator[Firings]:
    return (firings_of(SENSOR, number=number) for number in range(frames))


def sent_of(frames: Iterator[Firings], send: Callable[[bytes], Any], **options: Any) -> Sent:
    clock = options.pop("clock", None) or Clock()
    return send_frames(frames, select_encoder(SENSOR), send, frame_s=SENSOR.scanner.frame_s, clock=clock, **options)


def test_every_packet_is_sent_in_order_with_the_time_it_leaves() -> None:
    payloads: list[bytes] = []
    clock, reports = Clock(), list[str]()
    transmission = sent_of(firings(4), payloads.append, clock=clock, report=reports.append)
    packets = np.frombuffer(b"".join(payloads), VELODYNE_PACKET)
    assert transmission.packets == len(packets) == -(-4 * SENSOR.scanner.cycles // 24)
    assert (len(transmission.late_s), max(transmission.late_s), transmission.ended, reports) == (
        4,
        pytest.approx(0.0),
        "",
        [],
    )
    # The first packet waits for one frame's time, in which the first frames are made packets.
    begin_us = 1e6 * SENSOR.scanner.frame_s
    np.testing.assert_allclose(packets["stamp"], begin_us + 1327.104 * np.arange(len(packets)), atol=0.51)
    assert 1e6 * clock.at_s == pytest.approx(begin_us + 1327.104 * len(packets), abs=60.0)


@pytest.mark.parametrize("rate_hz", [5.0, 40.0])
def test_the_rate_changes_the_pace_and_not_the_stamps(rate_hz: float) -> None:
    payloads: list[bytes] = []
    clock = Clock()
    sent_of(firings(2), payloads.append, clock=clock, rate_hz=rate_hz)
    stamps = np.frombuffer(b"".join(payloads), VELODYNE_PACKET)["stamp"].astype(float)
    np.testing.assert_allclose(np.diff(stamps), 1327.104, atol=1.0)
    assert clock.at_s == pytest.approx(3.0 / rate_hz, abs=0.002)


def test_frames_that_come_too_late_are_told_with_counts() -> None:
    """Sending takes longer than there is: a frame of 75 packets, 5 ms each, in 0.1 s."""
    clock, reports = Clock(), list[str]()

    def send(_: bytes) -> None:
        clock.at_s += 0.005

    transmission = sent_of(firings(12), send, clock=clock, report=reports.append)
    assert transmission.packets == -(-12 * SENSOR.scanner.cycles // 24)
    assert all(late_s > 0.01 for late_s in transmission.late_s)
    assert reports[0] == f"{transmission.late_s[0]:.3g} s behind after 1 frames, of which 1 ended late"
    # 4.5 s of sending, and a line a second.
    assert 3 <= len(reports) <= 6
    assert "12 by more than 10 ms" in transmission.as_text()


def test_the_end_of_a_motion_ends_it_with_a_word() -> None:
    def frames() -> Iterator[Firings]:
        yield from firings(2)
        raise MotionEnded("motion of body 'car': must have poses for the frame")

    transmission = sent_of(frames(), lambda _: None)
    assert len(transmission.late_s) == 2
    assert transmission.packets == -(-2 * SENSOR.scanner.cycles // 24)
    assert transmission.as_text().splitlines()[1].startswith("motion of body 'car'")


def test_ctrl_c_ends_it_without_an_error() -> None:
    def frames() -> Iterator[Firings]:
        yield from firings(AHEAD + 1)
        raise KeyboardInterrupt

    assert sent_of(frames(), lambda _: None).ended == ""


def test_errors_of_either_thread_are_raised() -> None:
    def frames() -> Iterator[Firings]:
        yield from firings(1)
        raise InputError("wrong")

    with pytest.raises(InputError, match="wrong"):
        sent_of(frames(), lambda _: None)

    def send(_: bytes) -> None:
        raise OutputError("unreachable")

    with pytest.raises(OutputError, match="unreachable"):
        sent_of(firings(9), send)


def test_udp_sends_and_tells_what_it_cannot(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(30.0)
        port = receiver.getsockname()[1]
        with udp("127.0.0.1", port) as send:
            send(b"one")
            assert receiver.recv(100) == b"one"
            with told(f"127.0.0.1:{port}", OutputError):
                send(bytes(70_000))
        # A system that names its address of IPv6 first, where no reader of packets listens.
        found = [(socket.AF_INET6, socket.SOCK_DGRAM, 17, "", ("::1", port, 0, 0))]
        found += socket.getaddrinfo("127.0.0.1", port, type=socket.SOCK_DGRAM)
        with monkeypatch.context() as patched:
            patched.setattr(socket, "getaddrinfo", lambda *_, **__: found)
            with udp("localhost", port) as send:
                send(b"two")
                assert receiver.recv(100) == b"two"
    with told("no such host"), udp("no host", 1):
        pass


def test_stamps_are_of_the_clock_whatever_the_frames_number() -> None:
    """Frames 3 and 4 of a scene leave now: the first stamp is a frame's time after the start."""
    payloads: list[bytes] = []
    sent_of(itertools.islice(firings(5), 3, None), payloads.append)
    stamps = np.frombuffer(b"".join(payloads), VELODYNE_PACKET)["stamp"].astype(float)
    assert stamps[0] == pytest.approx(1e6 * SENSOR.scanner.frame_s, abs=0.51)


def test_frames_go_on_where_numbers_on_the_device_begin_again() -> None:
    """The device counts no more than 2^31 pulses: the same seed, and firings counted on."""
    scanner = SENSOR.scanner
    last = 2**31 // scanner.pulses - 1
    requested_frames: list[FrameOptions] = []

    def record_frame(take: Any, frame: FrameOptions, tell: Any) -> None:
        requested_frames.append(frame)

    simulator: Any = SimpleNamespace(sensor=SENSOR, stream=record_frame)
    first = FrameOptions(number=last, seed=2**32 - 1, begin_s=5.0)
    firings_of_frames = list(render_firings(simulator, first, needs_ambient=False, frames=3))
    numbers = [last, last + 1, last + 2]
    assert [frame.number for frame in requested_frames] == numbers
    assert {(frame.seed, frame.begin_s) for frame in requested_frames} == {(2**32 - 1, 5.0)}
    assert [firings.number for firings in firings_of_frames] == [number * scanner.cycles for number in numbers]


def test_what_was_late_in_words() -> None:
    """There are 200 frames, of which one in fifty is 40 ms late and one 300 ms: the 99th percentile is 40 ms."""
    late_s = [0.001] * 195 + [0.04] * 4 + [0.3]
    words = Sent(packets=1_000, late_s=late_s, ended="").as_text()
    assert words == (
        "sent 200 frames, 1,000 packets; frames ended late by 1.0 ms (median), 40.0 ms (99 %), 300.0 ms at most; "
        "5 by more than 10 ms"
    )
