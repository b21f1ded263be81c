"""Captures: packets of frame after frame in one pcap file, as a recorder beside the sensor would write it.

The format is libpcap's (pcap-savefile(5)): a header of 24 bytes, then each packet behind its time and length. A packet
is Ethernet, IPv4 and UDP around what the sensor sends. An Ouster's payload is longer than a network's frames: here it
is one datagram that was never cut.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ...errors import InputError
from ...files.atomic import atomic_output
from .firings import Firings
from .packet_encoder import Packet, PacketEncoder

HEADER = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 262_144, 1)
"""Microseconds, version 2.4, packets of up to 256 KiB, Ethernet."""

SOURCE, TARGET = bytes([192, 168, 1, 201]), bytes([255, 255, 255, 255])
ETHERNET = b"\xff" * 6 + b"\x60\x76\x88\x00\x00\x01" + b"\x08\x00"


def record_of(packet: Packet, port: int) -> bytes:
    """A packet as it stands in the file."""
    udp = struct.pack(">HHHH", port, port, 8 + len(packet.payload), 0)  # 0: no checksum
    head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 28 + len(packet.payload), 0, 0, 64, 17, 0, SOURCE, TARGET)
    total = sum(struct.unpack(">10H", head))
    total = (total & 0xFFFF) + (total >> 16)
    head = head[:10] + struct.pack(">H", ~(total + (total >> 16)) & 0xFFFF) + head[12:]
    frame = ETHERNET + head + udp + packet.payload
    seconds, part_us = divmod(math.floor(1e6 * packet.time_s), 1_000_000)
    return struct.pack("<IIII", seconds % 2**32, part_us, len(frame), len(frame)) + frame


@contextmanager
def capture(path: str | os.PathLike[str], maker: PacketEncoder) -> Iterator[Callable[[Firings], None]]:
    """Write the frames that are appended in the block, and what the maker's readers need beside them.

    maker  of `select_encoder.select_encoder`, for this file alone
    """
    with atomic_output(path) as temporary, open(temporary, "wb") as file:
        file.write(HEADER)

        def write(packets: Sequence[Packet]) -> None:
            file.write(b"".join(record_of(packet, maker.port) for packet in packets))

        yield lambda frame: write(maker.packets(frame))
        write(maker.rest())
        file.flush()
        if maker.description is not None:
            text, ending = maker.description
            with atomic_output(beside(path, ending)) as described:
                described.write_text(text, encoding="utf-8", newline="\n")


def beside(path: str | os.PathLike[str], ending: str) -> Path:
    """Where the description of a capture is."""
    return Path(path).with_suffix(ending)


def refuse(path: str | os.PathLike[str], *_: object) -> None:
    """What a cloud alone gets. Raises InputError."""
    raise InputError(
        f"{os.fspath(path)}: packets have the lost pulses too, which a cloud does not; "
        "`lidarscene render -o` or lidarscene.record() writes them"
    )
