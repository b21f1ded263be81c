"""UDP packets of a pcap file, and the turns of a spinning sensor among them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..maths.arrays import Numbers

MAGIC = {
    b"\xd4\xc3\xb2\xa1": ("<", 1e-6), b"\xa1\xb2\xc3\xd4": (">", 1e-6),
    b"\x4d\x3c\xb2\xa1": ("<", 1e-9), b"\xa1\xb2\x3c\x4d": (">", 1e-9),
}  # fmt: skip
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


def packets_of(path: Path, wanted: Callable[[bytes], bool] = lambda _: True) -> list[Packet]:
    """Read the UDP packets for whose payload ``wanted`` holds; ValueError for a file that is none or is cut off."""
    found = []
    for stamp_s, link, frame in records_of(path):
        payload = _udp_payload(frame, link)
        if payload is not None and wanted(payload):
            found.append(Packet(stamp_s, payload))
    return found


def records_of(path: Path) -> Iterator[tuple[float, int, bytes]]:
    """Yield time [s], link type and bytes of each record; ValueError for a file that is no pcap or is cut off."""
    with open(path, "rb") as file:
        header = file.read(HEADER)
        if header[:4] == b"\x0a\x0d\x0d\x0a":
            raise ValueError(
                "must be a pcap, got a pcapng; Wireshark's 'editcap -F pcap' turns one into the other"
            )
        if header[:4] not in MAGIC or len(header) < HEADER:
            raise ValueError("must be a pcap: its first bytes are of none")
        order, fraction = MAGIC[header[:4]]
        link = struct.unpack_from(order + "I", header, 20)[0] & 0xFFFF
        if link not in _LINK_BYTES:
            raise ValueError(f"must be a pcap of Ethernet or IP, got link type {link}")
        count = 0
        while record := file.read(RECORD):
            seconds, part, size = (
                struct.unpack(order + "IIII", record)[:3] if len(record) == RECORD else (0, 0, -1)
            )
            frame = file.read(max(size, 0))
            if len(frame) != size:
                raise ValueError(f"truncated: it ends within packet {count + 1}")
            yield seconds + fraction * part, link, frame
            count += 1


def _udp_payload(frame: bytes, link: int) -> bytes | None:
    """Of a packet of IPv4 that is not one of several fragments."""
    at = _LINK_BYTES[link]
    if link == ETHERNET and frame[12:14] == b"\x81\x00":  # a tag of a virtual network
        at += 4
    if len(frame) < at + 28 or frame[at] >> 4 != 4 or frame[at + 9] != UDP:
        return None
    if struct.unpack_from(">H", frame, at + 6)[0] & 0x3FFF:
        return None
    at += 4 * (frame[at] & 15)
    length = struct.unpack_from(">H", frame, at + 4)[0]
    return frame[at + 8 : at + length]


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
