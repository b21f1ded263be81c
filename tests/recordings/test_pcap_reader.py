"""Packets of pcap files, and turns."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.child import assert_ended
from helpers.mistakes import told
from helpers.recordings import pcap

from lidarscene.errors import OptionWarning
from lidarscene.recordings.pcap_reader import metadata_of, packets_of, turns_of


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("nanoseconds", [False, True])
def test_payloads_and_times_of_both_orders_and_clocks(tmp_path: Path, order: str, nanoseconds: bool) -> None:
    path = pcap(tmp_path / "a.pcap", [b"first", b"second"], order=order, nanoseconds=nanoseconds)
    packets = packets_of(path)
    assert [packet.payload for packet in packets] == [b"first", b"second"]
    assert packets[1].time_s == pytest.approx(100.001, abs=1e-9)
    assert [packet.payload for packet in packets_of(path, lambda payload: payload != b"first")] == [b"second"]


IP = 20
"""Bytes of a header of IPv4 without options."""


def datagram(payload: bytes, *, options: bytes = b"", protocol: int = 17, fragment: int = 0, after: int = 0) -> bytes:
    """An IPv4 packet of UDP, with ``after`` bytes that fill up a short frame behind it."""
    udp = struct.pack(">HHHH", 2368, 2368, 8 + len(payload), 0) + payload
    size, words = IP + len(options) + len(udp), (IP + len(options)) // 4
    head = struct.pack(">BBHHHBBH8s", 0x40 | words, 0, size, 0, fragment, 64, protocol, 0, bytes(8))
    return head + options + udp + bytes(after)


def payloads_in_capture(path: Path, link: int, frames: list[bytes]) -> list[bytes]:
    """Payloads of these frames in a pcap of a link type."""
    content = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)
    for frame in frames:
        content += struct.pack("<IIII", 100, 0, len(frame), len(frame)) + frame
    path.write_bytes(content)
    return [packet.payload for packet in packets_of(path)]


IP_FOLLOWS, TAG, OUTER_TAG = b"\x08\x00", b"\x81\x00\x00\x2a", b"\x88\xa8\x00\x07"
"""What follows: IPv4, or a tag of a virtual network (IEEE 802.1Q: 0x8100, then its number 42; 0x88A8 is around it)."""

PLAIN = bytes(12) + IP_FOLLOWS
"""Head of Ethernet."""


@pytest.mark.parametrize(
    ("link", "before"),
    [
        (0, bytes(4)),
        (1, PLAIN),
        (1, bytes(12) + TAG + IP_FOLLOWS),
        (1, bytes(12) + OUTER_TAG + TAG + IP_FOLLOWS),
        (12, b""),
        (101, b""),
        (108, bytes(4)),
        (113, bytes(14) + IP_FOLLOWS),
        (113, bytes(14) + TAG + IP_FOLLOWS),
        (228, b""),
        (276, IP_FOLLOWS + bytes(18)),
        (276, TAG[:2] + bytes(18) + TAG[2:] + IP_FOLLOWS),
    ],
)
def test_payloads_of_every_link(tmp_path: Path, link: int, before: bytes) -> None:
    """Link types of tcpdump.org: Ethernet has 14 bytes before IP, raw IP none, Linux cooked capture 16 and, as
    `tcpdump -i any` makes it today, 20, the loopback of macOS and OpenBSD 4; each tag has 4 more. A frame is filled up
    to 60 bytes, and a header of IP may have options: neither belongs to a payload.
    """
    frames = [datagram(b"first", after=13), datagram(b"second", options=bytes(8)), datagram(b"")]
    assert payloads_in_capture(tmp_path / "a.pcap", link, [before + frame for frame in frames]) == [
        b"first",
        b"second",
        b"",
    ]


def test_what_is_no_whole_datagram_is_passed_over(tmp_path: Path) -> None:
    """TCP, ICMP, IPv6, the first and a later fragment (RFC 791: bit 13 says more follow, those below are the place)."""
    invalid = [
        datagram(b"tcp", protocol=6),
        datagram(b"icmp", protocol=1),
        b"\x60" + datagram(b"six")[1:],
        datagram(b"more", fragment=0x2000),
        datagram(b"later", fragment=0x0001),
    ]
    complete = datagram(b"whole", fragment=0x4000)  # which must not be cut
    assert payloads_in_capture(tmp_path / "a.pcap", 1, [PLAIN + payload for payload in (*invalid, complete)]) == [
        b"whole"
    ]


def test_another_sensor_is_told_and_left_out(tmp_path: Path) -> None:
    """Two sensors take turns; each sends the same packets."""
    one, two = (datagram(b"%d" % number) for number in range(2))
    other = two[:15] + b"\x07" + two[16:]  # RFC 791: the last byte of the sender
    with pytest.warns(OptionWarning, match=r"a\.pcap: .* 2 sensors; .* 0\.0\.0\.0 to port 2368, .* 0\.0\.0\.7 to 2368"):
        found = payloads_in_capture(tmp_path / "a.pcap", 101, [one, other, two, other, one])
    assert found == [b"0", b"1", b"0"]


def test_what_is_damaged_is_told(tmp_path: Path) -> None:
    path = pcap(tmp_path / "a.pcap", [b"first", b"second"])
    content = path.read_bytes()
    second = len(content) - 16 - 14 - IP - 8 - len(b"second")
    for size in (24 + 7, 24 + 16 + 7):
        path.write_bytes(content[:size])
        with told("packet 1", ValueError):
            packets_of(path)
    path.write_bytes(content[: second + 8] + struct.pack("<I", 262_145) + content[second + 12 :])
    with told("packet 2 | 262145 | 262144", ValueError):
        packets_of(path)
    path.write_bytes(content[: second + 8] + struct.pack("<I", 262_144) + content[second + 12 :])
    with pytest.warns(OptionWarning, match="packet 2"):
        packets_of(path)
    for start, named in ((b"\x0a\x0d\x0d\x0a", "pcap | pcapng"), (b"none", "pcap | first bytes")):
        path.write_bytes(start + content[4:])
        with told(named, ValueError):
            packets_of(path)


@pytest.mark.parametrize("cut", [1, 6 + 8 + IP, 6 + 8 + IP + 14 + 15])
def test_whole_packets_are_read_before_a_cut(tmp_path: Path, cut: int) -> None:
    """A recorder that was broken off: within the payload, within the headers, within that of the record."""
    path = pcap(tmp_path / "a.pcap", [b"first", b"second"])
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.warns(OptionWarning, match=r"a\.pcap: ends within packet 2, which is left out"):
        packets = packets_of(path)
    assert [packet.payload for packet in packets] == [b"first"]


def test_a_turn_ends_where_the_recording_began() -> None:
    for sign in (1, -1):
        azimuths = [(35_000 + sign * 1000 * number) % 36_000 for number in range(80)]
        assert turns_of(azimuths, np.ones(len(azimuths) - 1)) == [slice(0, 36), slice(36, 72), slice(72, 80)]
    assert turns_of([], []) == []
    assert turns_of([100], []) == [slice(0, 1)]


MEMORY = """
import json, sys, tracemalloc
from lidarscene.recordings.pcap_reader import packets_of
# Before Python 3.12.9 and 3.13.2 tracemalloc can end a process in which Dr.Jit starts threads.
assert "drjit" not in sys.modules
tracemalloc.start()
packets = packets_of({path!r})
turn = packets.where(lambda payload: payload[0] != 7)[100:150]
payload = turn[3].payload
_, peak = tracemalloc.get_traced_memory()
print(json.dumps([len(packets), len(turn), payload[0], len(payload), peak]))
"""


def test_packets_stay_in_the_file(tmp_path: Path, run_python: Any) -> None:
    """Rationale: a drive is larger than memory. Of 5 MB of packets 24 bytes each are held, and what is asked for."""
    path = pcap(tmp_path / "a.pcap", [bytes([number % 256]) * 1200 for number in range(4000)])
    process = run_python(MEMORY.format(path=str(path)))
    assert_ended(process, stderr=None)
    *read, peak = json.loads(process.stdout)
    assert read == [4000, 50, 104, 1200]
    assert peak < 1e6


def test_whose_metadata(tmp_path: Path) -> None:
    """The file that is given; else NAME.json, else NAME_0.json of newer tools, else none."""
    path, explicit = tmp_path / "a.pcap", tmp_path / "b.json"
    plain, newer = tmp_path / "a.json", tmp_path / "a_0.json"
    assert metadata_of(path, None) is None
    assert metadata_of(path, explicit) == explicit
    newer.touch()
    assert metadata_of(path, None) == newer
    plain.touch()
    assert metadata_of(path, None) == plain
    assert metadata_of(path, explicit) == explicit


def test_a_head_that_trembles_does_not_turn() -> None:
    """Half a turn forward, a hundredth back now and then, across the seam: it is one turn, not forty."""
    azimuths = [(35_900 + 10 * number - 21 * (number % 3 == 2)) % 36_000 for number in range(40)]
    assert turns_of(azimuths, np.ones(len(azimuths) - 1)) == [slice(0, 40)]
