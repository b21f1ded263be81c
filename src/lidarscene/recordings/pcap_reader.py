"""Read the UDP packets of a pcap file, and find the turns of a spinning sensor among them."""

from __future__ import annotations

import mmap
import struct
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import overload

import numpy as np

from ..errors import OptionWarning, warn
from ..formats.packets.layouts import FULL_TURN, Packet
from ..maths.arrays import Numbers

MAGIC = {
    b"\xd4\xc3\xb2\xa1": ("<", 1e-6),
    b"\xa1\xb2\xc3\xd4": (">", 1e-6),
    b"\x4d\x3c\xb2\xa1": ("<", 1e-9),
    b"\xa1\xb2\x3c\x4d": (">", 1e-9),
}
"""Source: pcap's file format; first bytes -> (order of its bytes, unit of the fraction of a second)."""

HEADER_BYTES, RECORD_BYTES = 24, 16
LOOPBACK, ETHERNET, IP_ALONE, COOKED, COOKED_2 = (4, None), (14, 12), (0, None), (16, 14), (20, 0)
LINKS: Mapping[int, tuple[int, int | None]] = {
    **dict.fromkeys((0, 108), LOOPBACK),
    **dict.fromkeys((12, 101, 228), IP_ALONE),
    **{1: ETHERNET, 113: COOKED, 276: COOKED_2},
}
"""Source: tcpdump.org; link type -> bytes before IP, and place of the protocol among them."""

TAGS = (b"\x81\x00", b"\x88\xa8")
"""Source: IEEE 802.1Q; protocols of tags of virtual networks, 4 bytes each."""

UDP = 17

LONGEST_PACKET = 262_144
"""Source: libpcap, MAXIMUM_SNAPLEN; bytes of the longest packet that is captured. A longer one is damage."""

LATEST_S = 0.1
"""Choice: time by which a network hands a packet on too late, at most; a clock that goes farther back was set."""

MOST_LOST = 5_000
"""Choice: firings or packets that one frame may lack between two others: those of a turn at the lowest speed."""


class Packets(Sequence[Packet]):
    """Packets of a file, each read when it is indexed: those of a long drive do not fit into memory."""

    def __init__(self, data: mmap.mmap, time_s: Numbers, start: Numbers, stop: Numbers) -> None:
        self._data, self.time_s, self._start, self._stop = data, time_s, start, stop

    def __len__(self) -> int:
        return len(self.time_s)

    @overload
    def __getitem__(self, index: int) -> Packet: ...
    @overload
    def __getitem__(self, index: slice | Numbers) -> Packets: ...
    def __getitem__(self, index: int | slice | Numbers) -> Packet | Packets:
        """Read one packet, or select those of a slice or a mask."""
        if isinstance(index, int):
            return Packet(float(self.time_s[index]), self._data[self._start[index] : self._stop[index]])
        return Packets(self._data, self.time_s[index], self._start[index], self._stop[index])

    def where(self, predicate: Callable[[bytes], bool]) -> Packets:
        """Packets whose payload satisfies ``predicate``."""
        return self[np.fromiter((predicate(packet.payload) for packet in self), bool, len(self))]


def packets_of(path: Path, predicate: Callable[[bytes], bool] = lambda _: True) -> Packets:
    """UDP packets of one sender whose payload satisfies ``predicate``; ValueError if it is no pcap or is damaged.

    The sender is that of the first such packet, with the port that it sends to; a warning names it if there are others.
    """
    times, starts, stops = array("d"), array("q"), array("q")
    data = map_file(path)
    senders: dict[tuple[str, int], None] = {}
    for time_s, link, record in records_of(data, path):
        datagram = udp_datagram(data, record, link)
        if datagram is None or not predicate(data[datagram[1]]):
            continue
        sender, place = datagram
        senders.setdefault(sender)
        if sender == next(iter(senders)):
            times.append(time_s)
            starts.append(place.start)
            stops.append(place.stop)
    if len(senders) > 1:
        (address, port), *others = senders
        warn(
            OptionWarning(
                "{0}: has packets of {1} sensors; read are those from {2} to port {3}, others are from {4}",
                path,
                len(senders),
                address,
                port,
                ", ".join(f"{address} to {port}" for address, port in others),
            )
        )
    return Packets(data, *(np.array(values) for values in (times, starts, stops)))


def json_beside(path: Path) -> Path:
    """Path of an Ouster's metadata beside a recording: NAME.json, or NAME_0.json of the maker's newer tools."""
    newer = path.with_name(f"{path.stem}_0.json")
    plain = path.with_suffix(".json")
    return newer if newer.is_file() and not plain.is_file() else plain


def metadata_of(path: Path, metadata: Path | None) -> Path | None:
    """Find the maker's description of a unit: ``metadata``, else the OSF itself, else the json beside it, else None."""
    if metadata is None and path.suffix.lower() == ".osf":
        return path
    description = json_beside(path)
    return metadata or (description if description.is_file() else None)


def map_file(path: Path) -> mmap.mmap:
    """Map a file's bytes into memory, where each is read on access; ValueError for an empty one."""
    with open(path, "rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def records_of(data: mmap.mmap, path: Path) -> Iterator[tuple[float, int, slice]]:
    """Yield time [s], link type and slice of each record; ValueError for a file that is no pcap or is damaged.

    A recorder that is broken off leaves a part of its last packet: a warning says that it is left out.
    """
    header = data[:HEADER_BYTES]
    if header[:4] == b"\x0a\x0d\x0d\x0a":
        raise ValueError("must be a pcap, got a pcapng; Wireshark's 'editcap -F pcap' turns one into the other")
    if header[:4] not in MAGIC or len(header) < HEADER_BYTES:
        raise ValueError("must be a pcap: its first bytes are of none")
    order, fraction_unit_s = MAGIC[header[:4]]
    link = struct.unpack_from(order + "I", header, 20)[0] & 0xFFFF
    if link not in LINKS:
        raise ValueError(f"must be a pcap of Ethernet or IP, got link type {link}")
    offset, count, record = HEADER_BYTES, 0, struct.Struct(order + "IIII")
    while offset < len(data):
        start = offset + RECORD_BYTES
        seconds, fraction_steps, size = record.unpack_from(data, offset)[:3] if start <= len(data) else (0, 0, 0)
        if size > LONGEST_PACKET:
            raise ValueError(f"damaged: packet {count + 1} must have at most {LONGEST_PACKET} bytes, got {size}")
        if start + size > len(data):
            if not count:
                raise ValueError("truncated: it ends within packet 1")
            warn(OptionWarning("{0}: ends within packet {1}, which is left out", path, count + 1))
            return
        yield seconds + fraction_unit_s * fraction_steps, link, slice(start, start + size)
        offset, count = start + size, count + 1


def udp_datagram(
    data: mmap.mmap, record: slice, link: int, *, whole: bool = True
) -> tuple[tuple[str, int], slice] | None:
    """Address of the sender and port of the receiver of a packet of UDP over IPv4, and the slice of its payload.

    None for other packets and for fragments, but for the first one of each if not ``whole``.
    """
    start, end = record.start, record.stop
    link_bytes, protocol_at = LINKS[link]
    offset = start + link_bytes
    if protocol_at is not None and data[start + protocol_at : start + protocol_at + 2] in TAGS:
        offset += 4
        while data[offset - 2 : offset] in TAGS:
            offset += 4
    if end < offset + 28 or data[offset] >> 4 != 4 or data[offset + 9] != UDP:
        return None
    # More fragments follow, or an offset among them.
    if struct.unpack_from(">H", data, offset + 6)[0] & (0x3FFF if whole else 0x1FFF):
        return None
    address = ".".join(str(number) for number in data[offset + 12 : offset + 16])
    offset += 4 * (data[offset] & 15)  # length of the IPv4 header, in words of four bytes
    if end < offset + 8:
        return None
    # UDP counts its own header of eight bytes; a wrong count neither cuts that nor reaches into the next record.
    port, length = struct.unpack_from(">HH", data, offset + 2)
    return (address, port), slice(offset + 8, min(max(offset + length, offset + 8), end))


def in_order(packets: Packets, *, azimuth_at: int, stamp_at: int, period_s: float) -> tuple[Packets, Numbers, Numbers]:
    """Packets by the sensor's clock, the azimuths [0.01 degrees] at their starts, and the times between them [s].

    A network may hand a packet on after a later one. One that was captured twice, at a bridge and at the port behind
    it, counts once.

    Args:
        azimuth_at: place of the azimuth in a payload, uint16
        stamp_at: place of the stamp in a payload, uint32, microseconds
        period_s: time after which stamps begin again
    """
    numbers = (
        struct.unpack_from("<H", payload, azimuth_at) + struct.unpack_from("<I", payload, stamp_at)
        for _, payload, _ in packets
    )
    azimuths, stamps_us = np.fromiter(numbers, np.dtype((np.int64, 2)), len(packets)).T
    passed_s = 1e-6 * np.diff(stamps_us)
    passed_s += period_s * np.rint((np.diff(packets.time_s) - passed_s) / period_s)
    passed_s[passed_s < -LATEST_S] = period_s  # the clock was set back, where a turn must end
    time_s = np.cumsum(np.r_[0.0, passed_s])
    order = np.argsort(time_s, kind="stable")
    at_once = np.flatnonzero(np.diff(time_s[order]) < 0.5e-6) + 1  # of one stamp
    numbers_of = order.tolist()
    again = [n for n in at_once.tolist() if packets[numbers_of[n - 1]].payload == packets[numbers_of[n]].payload]
    order = np.delete(order, again)
    return packets[order], azimuths[order], np.diff(time_s[order])


def turns_of(azimuths: Sequence[int] | Numbers, passed_s: Sequence[float] | Numbers) -> list[slice]:
    """Slices of the packets of each turn, by the azimuth [0.01 degrees] at the start of each packet.

    A turn ends where the sensor is back at the direction of the recording's first packet, and where packets of half a
    turn or more are missing. The last one may be incomplete.

    Args:
        passed_s: time from each packet to the next
    """
    if len(azimuths) < 2:
        return [slice(0, 1)][: len(azimuths)]
    steps: Numbers = np.diff(np.asarray(azimuths, np.int64))
    # The shorter way round, so that sensors that turn either way are counted, and the turns that the clock tells.
    forward: Numbers = (steps + FULL_TURN // 2) % FULL_TURN - FULL_TURN // 2
    usual, usual_s = np.median(forward), np.median(passed_s)
    if usual_s > 0.0:
        forward = forward + FULL_TURN * np.rint((np.asarray(passed_s) / usual_s * usual - forward) / FULL_TURN)
    turn_number = np.abs(np.cumsum(np.r_[0, forward])) // FULL_TURN
    starts = np.flatnonzero(np.diff(turn_number, prepend=-1))
    return [slice(int(start), int(stop)) for start, stop in zip(starts, [*starts[1:], len(turn_number)], strict=True)]
