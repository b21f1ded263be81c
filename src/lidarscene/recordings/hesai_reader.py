"""Recordings of Hesai's PandarXT-32 and OT128: packets out of pcap files and ROS bags, decoded by hydra4.

hydra4 gives only the points that came back, so the sweeps have no lost pulses. Its axes are Hesai's own, x to the right
and y forward; here they are turned to x forward and y left.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..files.optional import import_optional
from ..formats.cloud_description import input_errors
from ..formats.packets.layouts import HESAI_START, Packet
from .pcap_reader import turns_of
from .recording import Recording
from .sweep import Sweep

MODELS = {(6, 1, 32, 8): "PandarXT32", (1, 4, 128, 2): "PandarOT128"}
"""(protocol's major and minor version, lasers, blocks) -> decoder of hydra4: all PandarXT share a version."""

LEAST_M, LARGEST_M = 0.0, 1000.0
AZIMUTH_OFFSET = 12
"""Byte of a packet at which its first azimuth stands."""


def is_hesai(payload: bytes) -> bool:
    """True if a payload is a packet of measurements."""
    return len(payload) > 500 and payload[:2] == HESAI_START


def open_hesai(path: Path, metadata: Path | None, packets: Sequence[Packet]) -> Recording:
    """Open the turns of these packets; ``metadata`` is the unit's table of angles, CSV. Raises InputError."""
    azimuths = [struct.unpack_from("<H", packet.payload, AZIMUTH_OFFSET)[0] for packet in packets]
    return recording_of_scans(path, metadata, [packets[turn] for turn in turns_of(azimuths)], name="hesai pcap")


def recording_of_scans(path: Path, metadata: Path | None, scans: Sequence[Sequence[Packet]], *, name: str) -> Recording:
    """Recording of which each of these runs of packets is a frame. Raises InputError."""
    with input_errors(path, folder=True):
        first = scans[0][0].payload
        protocol = (*first[2:4], *first[6:8])
        if protocol not in MODELS:
            raise ValueError(
                "must be packets of a PandarXT-32 (protocol 6.1, 32 lasers, 8 blocks) or OT128 (1.4, 128, 2), "
                f"got protocol {protocol[0]}.{protocol[1]}, {protocol[2]} lasers, {protocol[3]} blocks"
            )
        hydra = import_optional("hydra4.decoders", extra="hesai")
        model = MODELS[protocol]
        table = Path(hydra.__file__).parents[1] / "calibrations" / f"{_file_name(model)}.csv"
        make = getattr(hydra, model)
    with input_errors(metadata or table):
        decoder = make(metadata or table, LEAST_M, LARGEST_M)
    for attribute in ("block_offset_single", "block_offset_dual"):
        # hydra4 0.2 adds the microseconds of a PandarXT-32's blocks to seconds.
        offsets = getattr(decoder, attribute, ())
        if any(abs(offset) > 1.0 for offset in offsets):
            setattr(decoder, attribute, [1e-6 * offset for offset in offsets])
    recording_metadata = {"format": name, "sensor": model}

    def read(frame: int) -> Sweep:
        with input_errors(path, folder=True):
            return _sweep(decoder, scans[frame], recording_metadata | {"frame": str(frame)})

    return Recording(path=path, count=len(scans), read=read, metadata=recording_metadata)


def _file_name(model: str) -> str:
    return f"pandar_{model.removeprefix('Pandar').lower()}"


def _sweep(decoder: Any, packets: Sequence[Packet], metadata: dict[str, str]) -> Sweep:
    points = [
        point for packet in packets for block in decoder(SimpleNamespace(data=packet.payload)) for point in block.points
    ]
    if not points:
        raise ValueError("must have points, got none in this turn")
    right, forward, up, intensity, ring, _, stamps = np.array(points, np.float64).T
    xyz_m = np.stack([forward, -right, up], axis=-1)
    range_m = np.sqrt(np.sum(xyz_m**2, axis=-1))
    start_s = float(stamps.min())
    return Sweep(
        range_m=range_m,
        recorded=np.ones(len(range_m), bool),
        direction=xyz_m / range_m[:, None],
        time_s=stamps - start_s,
        intensity=intensity,
        ring=ring,
        start_s=start_s,
        metadata=metadata,
    )
