"""Pacing, on a clock that stands still but where it is waited for: order, times, catching up, and what is told."""

import pytest

from lidarscene.formats.packets.layouts import Packet
from lidarscene.outputs.live.pacing import HURRY, LATE_S, Pacer


class FakeClock:
    """Only waiting, and work that a test makes take time, lets it go on."""

    def __init__(self) -> None:
        self.at_s, self.stopped = 50.0, False

    def now_s(self) -> float:
        return self.at_s

    def epoch_s(self) -> float:
        return 1e9 + self.at_s

    def wait(self, seconds: float) -> None:
        assert seconds > 0.0
        self.at_s += seconds

    def stop(self) -> None:
        self.stopped = True


class Sends:
    """What was sent, and when."""

    def __init__(self, clock: FakeClock) -> None:
        self.clock, self.sent = clock, list[tuple[float, bytes]]()

    def __call__(self, payload: bytes) -> None:
        self.sent.append((self.clock.at_s, payload))

    @property
    def times_s(self) -> list[float]:
        return [sent_at_s for sent_at_s, _ in self.sent]


def frame(number: int, packets: int = 4) -> list[Packet]:
    """Packets a quarter of a second apart, from second ``number`` on."""
    return [Packet(number + 0.25 * place, b"%d.%d" % (number, place)) for place in range(packets)]


def test_packets_leave_in_order_at_their_times() -> None:
    clock = FakeClock()
    sends = Sends(clock)
    pacer = Pacer(sends, clock, begin_s=60.0, first_s=0.0)
    for number in range(3):
        pacer.frame(frame(number))
    assert [payload for _, payload in sends.sent] == [packet.payload for n in range(3) for packet in frame(n)]
    assert sends.times_s == pytest.approx([60.0 + 0.25 * place for place in range(12)])
    assert (pacer.packets, pacer.late_s, pacer.late_frames) == (12, pytest.approx([0.0] * 3), 0)


def test_slow_motion_stretches_the_gaps() -> None:
    clock = FakeClock()
    sends = Sends(clock)
    Pacer(sends, clock, begin_s=60.0, first_s=0.0, slowness=4.0).frame(frame(0))
    assert sends.times_s == pytest.approx([60.0, 61.0, 62.0, 63.0])


def test_what_is_late_goes_at_twice_the_pace_until_it_has_caught_up() -> None:
    """The frame of second 1 is there only at 61.8 s, 0.8 s late; each packet catches up half a gap."""
    clock = FakeClock()
    sends = Sends(clock)
    pacer = Pacer(sends, clock, begin_s=60.0, first_s=0.0)
    pacer.frame(frame(0))
    clock.at_s = 61.8
    pacer.frame(frame(1))
    pacer.frame(frame(2))
    pacer.frame(frame(3))
    gaps = [b - a for a, b in zip(sends.times_s[4:], sends.times_s[5:], strict=False)]
    assert gaps == pytest.approx([0.25 * HURRY] * 6 + [0.2] + [0.25] * 4)
    assert pacer.late_s == pytest.approx([0.0, 0.8 - 3 * 0.125, 0.0, 0.0])
    assert pacer.late_frames == 1
    assert sends.times_s[-4:] == pytest.approx([63.0, 63.25, 63.5, 63.75])


def test_a_frame_a_little_late_is_not_counted() -> None:
    clock = FakeClock()
    pacer = Pacer(Sends(clock), clock, begin_s=60.0, first_s=0.0)
    clock.at_s = 60.0 + 0.9 * LATE_S
    pacer.frame(frame(0, packets=1))
    assert (pacer.late_s, pacer.late_frames) == (pytest.approx([0.9 * LATE_S]), 0)


def test_nothing_is_sent_once_the_clock_is_stopped() -> None:
    clock = FakeClock()
    sends = Sends(clock)
    pacer = Pacer(sends, clock, begin_s=60.0, first_s=0.0)
    pacer.frame(frame(0))
    clock.stop()
    pacer.frame(frame(1))
    assert (len(sends.sent), pacer.packets, len(pacer.late_s)) == (4, 4, 1)


def test_what_is_left_in_the_end_is_no_frame() -> None:
    clock = FakeClock()
    pacer = Pacer(Sends(clock), clock, begin_s=60.0, first_s=0.0)
    pacer.frame(frame(0))
    pacer.frame(frame(1, packets=1), is_frame=False)
    assert (pacer.packets, len(pacer.late_s)) == (5, 1)


def test_a_clock_that_wakes_early_makes_no_frame_early() -> None:
    class Early(FakeClock):
        def wait(self, seconds: float) -> None:
            self.at_s += 0.99 * seconds

    clock = Early()
    pacer = Pacer(Sends(clock), clock, begin_s=60.0, first_s=0.0)
    pacer.frame(frame(0))
    assert pacer.late_s == [0.0]
