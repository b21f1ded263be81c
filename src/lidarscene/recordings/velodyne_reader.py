"""Recordings of Velodyne sensors: packets out of pcap files and ROS bags, decoded by velodyne-decoder.

The decoder gives points with the number of their firing; every channel fires once in each. So a firing without a point
of a channel is a lost pulse. Its direction comes from the same channel's points before and after.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..files.optional import optional
from ..formats.described import reading
from ..maths.arrays import Numbers
from .pcap_reader import Packet, turns_of
from .recording import Recording
from .sweep import Second, Sweep

PACKET_BYTES = 1206
X, Y, Z, INTENSITY, TIME, COLUMN, RING, RETURN = range(8)
"""Columns of the decoder's points."""

STRONGEST, LAST, BOTH = 1, 2, 3
"""Values of its column RETURN."""

BEFORE = 2
"""Packets before a frame that tell the decoder how fast the sensor turns, and how long a packet lasts."""

CHANNELS = (16, 32, 64, 128)
"""Of all models, since the highest channels may see nothing but sky."""


def is_velodyne(payload: bytes) -> bool:
    """Whether a payload is a packet of measurements."""
    return len(payload) == PACKET_BYTES and payload[:2] in (b"\xff\xee", b"\xff\xdd")


def open_velodyne(path: Path, metadata: Path | None, packets: Sequence[Packet]) -> Recording:
    """Open the turns of these packets; ``metadata`` is the unit's calibration, YAML. Raises InputError."""
    turns = turns_of([struct.unpack_from("<H", packet.payload, 2)[0] for packet in packets])
    return recording_of_scans(path, metadata, [packets[turn] for turn in turns], name="velodyne pcap")


def recording_of_scans(path: Path, metadata: Path | None, scans: Sequence[Sequence[Packet]], *, name: str) -> Recording:
    """A frame of each of these runs of packets."""
    decoder = optional("velodyne_decoder", extra="velodyne")
    config = decoder.Config()
    if metadata is not None:
        with reading(metadata):
            config.calibration = decoder.Calibration.read(str(metadata))
    model = decoder.ScanDecoder(config)
    if scans:
        with reading(path, folder=True):
            _decoded(decoder, model, scans[0])
    about = {"format": name, "sensor": f"{getattr(model.model_id, 'name', 'Velodyne')}"}
    about["mode"] = getattr(model.return_mode, "name", "").lower()

    def read(frame: int) -> Sweep:
        with reading(path, folder=True):
            scan = decoder.ScanDecoder(config)
            if frame:  # so that a frame is the same whether it is read after the one before or sought
                _decoded(decoder, scan, scans[frame - 1][-BEFORE:])
            start_s, points = _decoded(decoder, scan, scans[frame])
            return sweep_of_points(points, start_s=start_s, metadata=about | {"frame": str(frame)})

    return Recording(path=path, count=len(scans), read=read, metadata=about)


def _decoded(decoder: Any, scan: Any, packets: Sequence[Packet]) -> tuple[float, Numbers]:
    """Stamp of the sensor's clock, and the points."""
    stamp, points = scan.decode([decoder.VelodynePacket(one.stamp_s, one.payload) for one in packets])
    return float(stamp.device), np.asarray(points, np.float64)


def sweep_of_points(points: Numbers, *, start_s: float, metadata: Mapping[str, str]) -> Sweep:
    """The array of firings behind the decoder's points. Raises ValueError if there are none."""
    if not len(points):
        raise ValueError("must have points, got none in this turn")
    channels, columns = int(points[:, RING].max()) + 1, int(points[:, COLUMN].max()) + 1
    rows = min(count for count in CHANNELS if count >= channels)
    shape = (rows, columns)
    first = _laid(points, points[:, RETURN] != LAST, shape)
    last = _laid(points, points[:, RETURN] == LAST, shape)
    # A pulse of which the stronger of two returns was filtered away still has the other.
    alone = np.isnan(first[..., X]) & ~np.isnan(last[..., X])
    first[alone], last[alone] = last[alone], np.nan
    range_m = np.sqrt(np.sum(first[..., :3] ** 2, axis=-1))
    direction, time_s = _filled(first, range_m)
    second = None
    if np.isfinite(last[..., X]).any():
        second = Second(range_m=np.sqrt(np.sum(last[..., :3] ** 2, axis=-1)), intensity=last[..., INTENSITY])
    began_s = np.nanmin(time_s)
    return Sweep(
        range_m=range_m,
        recorded=np.ones(shape, bool),
        direction=direction,
        time_s=time_s - began_s,
        intensity=first[..., INTENSITY],
        second=second,
        ring=np.broadcast_to(np.arange(rows)[:, None], shape),
        column=np.broadcast_to(np.arange(columns), shape),
        start_s=start_s + began_s,
        knows_lost=True,
        metadata=metadata,
    )


def _laid(points: Numbers, mask: Numbers, shape: tuple[int, int]) -> Numbers:
    """(rows, columns, 8) the points at their pulses, NaN elsewhere."""
    chosen = points[mask]
    laid = np.full((*shape, points.shape[1]), np.nan)
    laid[chosen[:, RING].astype(np.int64), chosen[:, COLUMN].astype(np.int64)] = chosen
    return laid


def _filled(first: Numbers, range_m: Numbers) -> tuple[Numbers, Numbers]:
    """Directions and times of all pulses: those without a point from the points of their channel.

    Between two points azimuth, height and time go evenly; before the first and after the last they go on at the
    sensor's own rate. NaN for a channel without any point.
    """
    with np.errstate(invalid="ignore"):
        direction = first[..., :3] / range_m[..., None]
    time_s = first[..., TIME].copy()
    found = [np.flatnonzero(np.isfinite(row)) for row in range_m]
    azimuths = [np.unwrap(np.arctan2(*direction[row, at, 1::-1].T)) for row, at in enumerate(found)]
    turning, ticking = (
        _rate(found, values) for values in (azimuths, [time_s[row, at] for row, at in enumerate(found)])
    )
    every = np.arange(range_m.shape[1], dtype=np.float64)
    for row, (there, azimuth) in enumerate(zip(found, azimuths, strict=True)):
        if not len(there):
            continue
        gaps = np.setdiff1d(every, there).astype(np.int64)
        outside = every[gaps] - every[gaps].clip(there[0], there[-1])
        across = np.interp(every[gaps], there, azimuth) + outside * turning
        up = np.interp(every[gaps], there, direction[row, there, 2])
        level = np.sqrt(1.0 - up**2)
        direction[row, gaps] = np.stack([level * np.cos(across), level * np.sin(across), up], axis=-1)
        time_s[row, gaps] = np.interp(every[gaps], there, time_s[row, there]) + outside * ticking
    return direction, time_s


def _rate(found: Sequence[Numbers], values: Sequence[Numbers]) -> float:
    """Median change from one firing to the next."""
    steps = [np.diff(one)[np.diff(at) == 1] for at, one in zip(found, values, strict=True) if len(at) > 1]
    together = np.concatenate([*steps, np.zeros(0)])
    return float(np.median(together)) if len(together) else 0.0
