"""Captures: other readers of pcap find the packets, their times and ports; a file is there whole or not at all."""

import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers.mistakes import told
from helpers.packets import firings_of, packets_of, random_frame

from lidarscene.formats.packets.layouts import Packet
from lidarscene.formats.packets.pcap import HEADER, pcap_stream, record_of
from lidarscene.formats.packets.select_encoder import select_encoder
from lidarscene.sensor.sensor_file import load_sensor


def test_another_reader_finds_payloads_times_and_ports(library: Callable[[str], Any], tmp_path: Path) -> None:
    """dpkt comes with velodyne-decoder."""
    dpkt = library("dpkt")
    packets = [Packet(0.0, b"first"), Packet(1234.567891, bytes(33_024)), Packet(1e9 + 0.5, b"")]
    path = tmp_path / "a.pcap"
    path.write_bytes(HEADER + b"".join(record_of(packet, 2368) for packet in packets))
    with open(path, "rb") as file:
        stored = [(stamp, dpkt.ethernet.Ethernet(frame)) for stamp, frame in dpkt.pcap.Reader(file)]
    assert [float(stamp) for stamp, _ in stored] == pytest.approx([packet.time_s for packet in packets], abs=1e-6)
    for (_, frame), packet in zip(stored, packets, strict=True):
        assert (frame.ip.udp.data, frame.ip.udp.dport) == (packet.payload, 2368)
        right, frame.ip.sum = frame.ip.sum, 0
        assert dpkt.ip.IP(bytes(frame.ip)).sum == right


def test_headers_are_those_of_a_sensor_that_sends_to_all(library: Callable[[str], Any], tmp_path: Path) -> None:
    """Packets go from its address to the broadcast ones of Ethernet and IP (RFC 919); frames are whole, and the file
    says so: a reader may cut them at its snapshot length. A stamp is the microsecond that has begun, of 32 bits of
    seconds.
    """
    dpkt = library("dpkt")
    path = tmp_path / "a.pcap"
    path.write_bytes(HEADER + record_of(Packet(3e9 + 0.999_999_75, bytes(1206)), 2368))
    with open(path, "rb") as file:
        reader = dpkt.pcap.Reader(file)
        assert reader.snaplen >= 65_535 + 14
        ((_, raw),) = list(reader)
    seconds, part_us, stored, sent = struct.unpack_from("<IIII", path.read_bytes(), len(HEADER))
    assert (seconds, part_us, stored, sent) == (3_000_000_000, 999_999, len(raw), len(raw))
    frame = dpkt.ethernet.Ethernet(raw)
    assert (frame.dst, frame.ip.dst, frame.ip.p) == (b"\xff" * 6, b"\xff" * 4, 17)
    assert frame.src[0] & 1 == 0  # of one, not of many (IEEE 802)
    assert frame.ip.src == bytes([192, 168, 1, 201])
    assert frame.ip.ttl == 64


def test_what_waits_in_the_end_is_written(tmp_path: Path) -> None:
    """A frame of 1808 firings is 75 packets of 24 and a third of one."""
    sensor = load_sensor("vlp-16")
    with pcap_stream(tmp_path / "a.pcap", select_encoder(sensor)) as take:
        take(firings_of(sensor))
    size = 16 + 14 + 28 + 1206
    assert (tmp_path / "a.pcap").stat().st_size == len(HEADER) + 76 * size


@pytest.mark.parametrize("size", [0, 5, 1206, 47_201, 47_202, 47_203, 65_507])
def test_words_of_an_ip_header_add_up_to_nothing(size: int) -> None:
    """RFC 1071, 1: all 16-bit words of a header, its checksum too, have a ones' complement sum of 0xFFFF, that is
    a sum that 0xFFFF divides. With 47,201 to 47,203 bytes the carry of the sum carries once more.
    """
    frame = record_of(Packet(0.0, bytes(size)), 2368)[16:]
    header = frame[14:34]
    assert struct.unpack(">10H", header)[1] == len(frame) - 14 == 28 + size
    assert sum(struct.unpack(">10H", header)) % 0xFFFF == 0


def test_a_capture_has_the_packets_of_all_frames(library: Callable[[str], Any], tmp_path: Path) -> None:
    library("velodyne_decoder")
    from lidarscene.recordings.opening import open_recording

    sensor = load_sensor("vlp-16")
    clouds = [random_frame(sensor, number=number) for number in range(3)]
    with pcap_stream(tmp_path / "a.pcap", select_encoder(sensor)) as take:
        for number, cloud in enumerate(clouds):
            take(firings_of(sensor, cloud, number=number))
    expected = b"".join(record_of(packet, 2368) for packet in packets_of(select_encoder(sensor), sensor, clouds))
    assert (tmp_path / "a.pcap").read_bytes() == HEADER + expected
    with open_recording(tmp_path / "a.pcap") as recording:
        assert len(recording) == 3
        assert sum(sweep.has_return.sum() for sweep in recording) == sum(map(len, clouds))
        assert recording.metadata["sensor"] == "VLP16"


def test_a_frame_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def fail() -> None:
        with pcap_stream(tmp_path / "a.pcap", select_encoder(load_sensor("vlp-16"))):
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert os.listdir(tmp_path) == []


def test_a_cloud_alone_is_refused(tmp_path: Path) -> None:
    cloud = random_frame(load_sensor("vlp-16"))
    with told("a.pcap | lost pulses"):
        cloud.save(tmp_path / "a.pcap")
