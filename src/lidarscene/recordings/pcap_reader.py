"""UDP packets of a pcap file, and the turns of a spinning sensor among them."""

from __future__ import annotations

import mmap
import struct
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload

import numpy as np

from ..maths.arrays import Numbers

MAGIC = {
    b"\xd4\xc3\xb2\xa1": ("<", 1e-6),
    b"\xa1\xb2\xc3\xd4": (">", 1e-6),
    b"\x4d\x3c\xb2\xa1": ("<", 1e-9),
    b"\xa1\xb2\x3c\x4d": (">", 1e-9),
}
"""First bytes of a pcap: order of its bytes, and unit of the fraction of a second."""

HEADER, RECORD = 24, 16
ETHERNET, RAW_IP, COOKED = 1, 101, 113
_LINK_BYTES = {ETHERNET: 14, RAW_IP: 0, COOKED: 16}
UDP = 17

FULL_TURN = 36_000
"""Hundredths of a degree, as Velodyne and Hesai count azimuths."""


@dataclass(frozen=True, slots=True)
class Packet:
    """A UDP payload and when it was received, by the clock of who recorded it [s]."""

    stamp_s: float
    payload: bytes


class Packets(Sequence[Packet]):
    """Packets of a file that stay there until each is asked for: a drive has more of them than memory."""

    def __init__(self, data: mmap.mmap, stamp_s: Numbers, start: Numbers, stop: Numbers) -> None:
        self._data, self._stamp_s, self._start, self._stop = data, stamp_s, start, stop

    def __len__(self) -> int:
        return len(self._stamp_s)

    @overload
    def __getitem__(self, place: int) -> Packet: ...
    @overload
    def __getitem__(self, place: slice | Numbers) -> Packets: ...
    def __getitem__(self, place: int | slice | Numbers) -> Packet | Packets:
        """One packet, or those of a slice or a mask."""
        if isinstance(place, int):
            return Packet(float(self._stamp_s[place]), self._data[self._start[place] : self._stop[place]])
        return Packets(self._data, self._stamp_s[place], self._start[place], self._stop[place])

    def where(self, wanted: Callable[[bytes], bool]) -> Packets:
        """Those for whose payload ``wanted`` holds."""
        return self[np.fromiter((wanted(one.payload) for one in self), bool, len(self))]


def packets_of(path: Path, wanted: Callable[[bytes], bool] = lambda _: True) -> Packets:
    """The UDP packets for whose payload ``wanted`` holds; ValueError for a file that is none or is cut off."""
    stamps, starts, stops = array("d"), array("q"), array("q")
    data = mapped(path)
    for stamp_s, link, place in records_of(data):
        found = _udp_payload(data, place, link)
        if found is not None and wanted(data[found]):
            stamps.append(stamp_s)
            starts.append(found.start)
            stops.append(found.stop)
    return Packets(data, *(np.array(one) for one in (stamps, starts, stops)))


def json_beside(path: Path) -> Path:
    """Where an Ouster's metadata are, beside a recording: NAME.json, or NAME_0.json of the maker's newer tools."""
    newer = path.with_name(f"{path.stem}_0.json")
    plain = path.with_suffix(".json")
    return newer if newer.is_file() and not plain.is_file() else plain


def metadata_of(path: Path, given: Path | None) -> Path | None:
    """What the maker says of a recording's unit: the file that is given, else the json beside it; None without."""
    beside = json_beside(path)
    return given or (beside if beside.is_file() else None)


def mapped(path: Path) -> mmap.mmap:
    """A file's bytes, read as they are asked for; ValueError for an empty one."""
    with open(path, "rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def records_of(data: mmap.mmap) -> Iterator[tuple[float, int, slice]]:
    """Yield time [s], link type and place of each record; ValueError for a file that is no pcap or is cut off."""
    header = data[:HEADER]
    if header[:4] == b"\x0a\x0d\x0d\x0a":
        raise ValueError("must be a pcap, got a pcapng; Wireshark's 'editcap -F pcap' turns one into the other")
    if header[:4] not in MAGIC or len(header) < HEADER:
        raise ValueError("must be a pcap: its first bytes are of none")
    order, fraction = MAGIC[header[:4]]
    link = struct.unpack_from(order + "I", header, 20)[0] & 0xFFFF
    if link not in _LINK_BYTES:
        raise ValueError(f"must be a pcap of Ethernet or IP, got link type {link}")
    at, count, record = HEADER, 0, struct.Struct(order + "IIII")
    while at < len(data):
        start = at + RECORD
        seconds, part, size = record.unpack_from(data, at)[:3] if start <= len(data) else (0, 0, len(data))
        if start + size > len(data):
            raise ValueError(f"truncated: it ends within packet {count + 1}")
        yield seconds + fraction * part, link, slice(start, start + size)
        at, count = start + size, count + 1


def _udp_payload(data: mmap.mmap, record: slice, link: int) -> slice | None:
    """Place of the payload in a packet of IPv4 that is not one of several fragments."""
    start, end = record.start, record.stop
    at = start + _LINK_BYTES[link]
    if link == ETHERNET and data[start + 12 : start + 14] == b"\x81\x00":  # a tag of a virtual network
        at += 4
    if end < at + 28 or data[at] >> 4 != 4 or data[at + 9] != UDP:
        return None
    if struct.unpack_from(">H", data, at + 6)[0] & 0x3FFF:
        return None
    at += 4 * (data[at] & 15)
    if end < at + 8:
        return None
    length = struct.unpack_from(">H", data, at + 4)[0]
    return slice(at + 8, min(max(at + length, at + 8), end))


def turns_of(azimuths: Sequence[int] | Numbers) -> list[slice]:
    """Packets of each turn, from the azimuth [0.01 degrees] at the start of each packet.

    A turn ends where the sensor is back at the direction of the recording's first packet. The last one may be
    incomplete.
    """
    if not len(azimuths):
        return []
    steps: Numbers = np.diff(np.asarray(azimuths, np.int64))
    forward: Numbers = (steps + FULL_TURN // 2) % FULL_TURN - FULL_TURN // 2
    turned = np.abs(np.cumsum(np.r_[0, forward])) // FULL_TURN
    starts = np.flatnonzero(np.diff(turned, prepend=-1))
    return [slice(int(a), int(b)) for a, b in zip(starts, [*starts[1:], len(turned)], strict=True)]
