"""Write packets of frame after frame into one pcap file, as a recorder beside the sensor would.

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
from .layouts import Packet
from .packet_encoder import PacketEncoder

HEADER = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 262_144, 1)
"""Header of the file: stamps in microseconds, version 2.4, packets of up to 256 KiB, Ethernet."""

SOURCE, TARGET = bytes([192, 168, 1, 201]), bytes([255, 255, 255, 255])
ETHERNET = b"\xff" * 6 + b"\x60\x76\x88\x00\x00\x01" + b"\x08\x00"


def record_of(packet: Packet, port: int) -> bytes:
    """Record of a packet in the file: time, length, Ethernet, IPv4 and UDP headers, payload."""
    udp = struct.pack(">HHHH", port, port, 8 + len(packet.payload), 0)  # 0: no checksum
    head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 28 + len(packet.payload), 0, 0, 64, 17, 0, SOURCE, TARGET)
    # The checksum of IPv4 (RFC 791): one's complement of the one's complement sum of the header's 16-bit words.
    total = sum(struct.unpack(">10H", head))
    total = (total & 0xFFFF) + (total >> 16)
    head = head[:10] + struct.pack(">H", ~(total + (total >> 16)) & 0xFFFF) + head[12:]
    frame = ETHERNET + head + udp + packet.payload
    seconds, part_us = divmod(math.floor(1e6 * packet.time_s), 1_000_000)
    return struct.pack("<IIII", seconds % 2**32, part_us, len(frame), len(frame)) + frame


@contextmanager
def pcap_stream(path: str | os.PathLike[str], encoder: PacketEncoder) -> Iterator[Callable[[Firings], None]]:
    """Write the frames that are appended in the block, and what the maker's readers need beside them.

    Args:
        encoder: one from `select_encoder`, for this file alone
    """
    with atomic_output(path) as temporary, open(temporary, "wb") as file:
        file.write(HEADER)

        def write(packets: Sequence[Packet]) -> None:
            file.write(b"".join(record_of(packet, packet.port or encoder.port) for packet in packets))

        yield lambda frame: write(encoder.packets(frame))
        write(encoder.flush())
        file.flush()
        if encoder.description is not None:
            text, ending = encoder.description
            with atomic_output(description_path(path, ending)) as description:
                description.write_text(text, encoding="utf-8", newline="\n")


def description_path(path: str | os.PathLike[str], ending: str) -> Path:
    """Path of the file that describes a capture."""
    return Path(path).with_suffix(ending)


def refuse_cloud(path: str | os.PathLike[str], *_: object) -> None:
    """Raise InputError: a cloud alone does not have the lost pulses that packets hold."""
    raise InputError(
        f"{os.fspath(path)}: packets have the lost pulses too, which a cloud does not; "
        "`lidarscene render -o` or lidarscene.record() writes them"
    )
