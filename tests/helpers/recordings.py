"""Small recordings, packet by packet as the makers' manuals have them, and pcap files of them."""

import struct
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from helpers.clouds import small_cloud
from helpers.formats import write_bag

DATA = Path(__file__).parents[1] / "recordings" / "data"
OUSTER = DATA / "os0-32-one-packet.pcap"
"""The first packet of a recording of an OS0-32-U1: 16 of 1024 columns, dual returns."""

VLP16, VLS128 = 0x22, 0xA1
STRONGEST = 0x37
FIRINGS = 24
"""Of all 16 lasers, in a packet of a VLP-16."""


def velodyne_packet(azimuths: Sequence[int], distances: Sequence[Sequence[int]], stamp_us: int = 0) -> bytes:
    """A packet of a VLP-16: 12 azimuths [0.01 degrees], 24 firings of 16 distances [2 mm], 0 where lost."""
    blocks = b""
    for block, azimuth in enumerate(azimuths):
        two_firings = [*distances[2 * block], *distances[2 * block + 1]]
        blocks += struct.pack("<HH", 0xEEFF, azimuth)
        blocks += b"".join(struct.pack("<HB", distance, 50 + laser % 16) for laser, distance in enumerate(two_firings))
    return blocks + struct.pack("<IBB", stamp_us, STRONGEST, VLP16)


def turns(packets: int, *, missing: Collection[tuple[int, int]] = (), start: int = 0) -> list[bytes]:
    """Packets of a VLP-16 at 10 Hz in a round room of 10 m; ``missing``: lasers and firings without return."""
    payloads = []
    for number in range(packets):
        azimuths = [(start + (12 * number + block) * 40) % 36_000 for block in range(12)]
        distances = [
            [0 if (laser, FIRINGS * number + firing) in missing else 5000 for laser in range(16)]
            for firing in range(FIRINGS)
        ]
        payloads.append(velodyne_packet(azimuths, distances, stamp_us=1327 * number))
    return payloads


def vls_packet(azimuth: int, step: int, stamp_us: int) -> bytes:
    """A packet of a VLS-128: 3 firings of 128 lasers in 4 blocks each, every one at 20 m (unit 4 mm)."""
    blocks = b"".join(
        struct.pack("<HH", group, (azimuth + firing * step) % 36_000) + struct.pack("<HB", 5000, 50) * 32
        for firing in range(3)
        for group in (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)
    )
    return blocks + struct.pack("<IBB", stamp_us, STRONGEST, VLS128)


def hesai_packet(azimuth: int, distance: int) -> bytes:
    """A packet of a PandarXT-32: 8 blocks 0.18 degrees apart, every channel at this distance [4 mm]."""
    body = b"".join(
        struct.pack("<H", (azimuth + 18 * block) % 36_000) + struct.pack("<HBB", distance, 30, 0) * 32
        for block in range(8)
    )
    header = struct.pack(">BBBBH", 0xEE, 0xFF, 6, 1, 0) + bytes([32, 8, 1, 4, 1, 0])
    tail = bytes(10) + bytes([0x37]) + bytes(2) + bytes([126, 1, 2, 3, 4, 5]) + struct.pack("<I", 250) + bytes(1)
    return header + body + tail + bytes(4)


def at128_corrections(
    path: Path,
    *,
    azimuth: Sequence[int],
    elevation: Sequence[int],
    face_start: Sequence[int] = (0, 120 * 25_600, 240 * 25_600),
    azimuth_shift: Sequence[int] = (0,) * 180,
    elevation_shift: Sequence[int] = (0,) * 180,
    unit: int = 1,
) -> Path:
    """The file of corrections of an AT128, all of whose lasers have the same corrections along the sweep.

    Angles are in 1/25,600 degrees, corrections in hundredths, both times ``unit``.
    """
    lasers, faces = len(elevation), len(face_start)
    content = bytes([0xEE, 0xFF, 1, 5, lasers, faces, faces, *range(8), unit])
    content += struct.pack(f"<{faces}I", *face_start) + struct.pack(f"<{faces}I", *face_start[1:], face_start[0])
    content += struct.pack(f"<{lasers}i", *azimuth) + struct.pack(f"<{lasers}i", *elevation)
    content += struct.pack("<180b", *azimuth_shift) * lasers + struct.pack("<180b", *elevation_shift) * lasers
    path.write_bytes(content + bytes(32))
    return path


def pcap(path: Path, payloads: Sequence[bytes], *, order: str = "<", nanoseconds: bool = False) -> Path:
    """A pcap of UDP packets over Ethernet, a millisecond apart."""
    magic = 0xA1B23C4D if nanoseconds else 0xA1B2C3D4
    content = bytearray(struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, 1))
    for number, payload in enumerate(payloads):
        udp = struct.pack(">HHHH", 2368, 2368, 8 + len(payload), 0) + payload
        ip = struct.pack(">BBHHHBBH8s", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0, bytes(8)) + udp
        frame = bytes(12) + b"\x08\x00" + ip
        part = number * (1_000_000 if nanoseconds else 1000)
        content += struct.pack(order + "IIII", 100, part, len(frame), len(frame)) + frame
    path.write_bytes(content)
    return path


def copy_to_mcap(path: Path, **options: Any) -> Path:
    """Two clouds of 3 and 5 points as an MCAP, by the writer of mcap with these options."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    source = path.with_suffix(".source.mcap")
    write_bag(source, small_cloud(3), small_cloud(5))
    with open(source, "rb") as original, open(path, "wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2", library="test")
        for schema, channel, message in make_reader(original).iter_messages():
            assert schema is not None
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
            channel_id = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            writer.add_message(channel_id, message.log_time, message.data, message.publish_time)
        writer.finish()
    return path


def scan_bag(path: Path, packets: int, scans: int = 1) -> Path:
    """A bag of `VelodyneScan` messages, as a Velodyne's driver records them. Needs rosbags."""
    from rosbags import rosbag2, typesys

    from lidarscene.formats.ros_bag import definition

    store, kind = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE), "velodyne_msgs/msg/VelodyneScan"
    store.register(typesys.get_types_from_msg(definition(kind), kind))
    stamp = store.types["builtin_interfaces/msg/Time"](sec=9, nanosec=0)
    header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="velodyne")
    messages = [
        store.types["velodyne_msgs/msg/VelodynePacket"](stamp=stamp, data=np.frombuffer(payload, np.uint8))
        for payload in turns(packets)
    ]
    with rosbag2.Writer(path, version=8) as writer:
        connection = writer.add_connection("/velodyne_packets", kind, typestore=store)
        for number in range(scans):
            scan = store.types[kind](header=header, packets=messages)
            writer.write(connection, number, store.serialize_cdr(scan, kind))
    return path
