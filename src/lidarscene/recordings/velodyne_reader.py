"""Recordings of Velodyne sensors: packets out of pcap files and ROS bags, decoded by velodyne-decoder.

The decoder gives points with the number of their firing, in which every channel fires once. So a firing without a point
of a channel is a lost pulse. Its direction is interpolated between the same channel's points before and after. The
decoder does not count the firings of lost packets, but times tell of them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..files.optional import import_optional
from ..formats.cloud_description import input_errors
from ..formats.packets.layouts import VELODYNE_BANKS, VELODYNE_PACKET, Packet
from ..maths.arrays import Numbers
from .pcap_reader import MOST_LOST, Packets, in_order, turns_of
from .recording import Recording
from .sweep import Second, Sweep

FIRST_BYTES = tuple(bank.to_bytes(2, "little") for bank in VELODYNE_BANKS[:2])
"""First bytes of a packet, whose first block is of the first or the second bank."""

X, Y, Z, INTENSITY, TIME, COLUMN, RING, RETURN = range(8)
"""Columns of the decoder's array of points."""

LAST_RETURN = 2
"""Value of the decoder's column RETURN for the last of two returns; 1 is the strongest, 3 a return that is both."""

AZIMUTH_AT, STAMP_AT, STAMPS_S = 2, 1200, 3600.0
"""Source: VLP-16 user manual, 9; places of the first azimuth and of the stamp in a packet, and the hour after which
stamps begin again."""

WARM_UP_PACKETS = 2
"""Packets before a frame from which the decoder measures how fast the sensor turns, and how long a packet lasts."""

CHANNELS = (16, 32, 64, 128)
"""Numbers of channels of all models. That of a recording is the next above its highest channel with a point, since the
channels above that may have seen only sky."""


def is_velodyne(payload: bytes) -> bool:
    """True if a payload is a packet of measurements."""
    return len(payload) == VELODYNE_PACKET.itemsize and payload[:2] in FIRST_BYTES


def open_velodyne(path: Path, metadata: Path | None, packets: Packets) -> Recording:
    """Open the turns of these packets; ``metadata`` is the unit's calibration, YAML.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    packets, *moves = in_order(packets, azimuth_at=AZIMUTH_AT, stamp_at=STAMP_AT, period_s=STAMPS_S)
    return recording_of_scans(path, metadata, [packets[turn] for turn in turns_of(*moves)], name="velodyne pcap")


def recording_of_scans(path: Path, metadata: Path | None, scans: Sequence[Sequence[Packet]], *, name: str) -> Recording:
    """Recording of which each of these runs of packets is a frame.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    decoder = import_optional("velodyne_decoder", extra="velodyne")
    config = decoder.Config()
    if metadata is not None:
        with input_errors(metadata):
            config.calibration = decoder.Calibration.read(str(metadata))
    model = decoder.ScanDecoder(config)
    if scans:
        with input_errors(path, folder=True):
            _decode(decoder, model, scans[0])
    recording_metadata = {"format": name, "sensor": f"{getattr(model.model_id, 'name', 'Velodyne')}"}
    recording_metadata["mode"] = getattr(model.return_mode, "name", "").lower()

    def read(frame: int) -> Sweep:
        with input_errors(path, folder=True):
            scan = decoder.ScanDecoder(config)
            if frame:  # so that a frame is the same whether frames are read in order or not
                _decode(decoder, scan, scans[frame - 1][-WARM_UP_PACKETS:])
            start_s, points = _decode(decoder, scan, scans[frame])
            return sweep_of_points(points, start_s=start_s, metadata=recording_metadata | {"frame": str(frame)})

    return Recording(path=path, count=len(scans), read=read, metadata=recording_metadata)


def _decode(decoder: Any, scan: Any, packets: Sequence[Packet]) -> tuple[float, Numbers]:
    """Stamp of the sensor's clock [s] that times count from, or of the start without a point, and (n, 8) points.

    Without packets there are none: the decoder would end Python.
    """
    whole = [packet for packet in packets if is_velodyne(packet.payload)]
    if not whole:
        return 0.0, np.zeros((0, 8))
    stamp, points = scan.decode([decoder.VelodynePacket(packet.time_s, packet.payload) for packet in whole])
    if not len(points):
        return 1e-6 * struct.unpack_from("<I", whole[0].payload, STAMP_AT)[0], np.zeros((0, 8))
    return float(stamp.device), np.asarray(points, np.float64)


def sweep_of_points(points: Numbers, *, start_s: float, metadata: Mapping[str, str]) -> Sweep:
    """Sweep of channels by firings from the decoder's (n, 8) points; without any point it counts no firings."""
    if not len(points):
        none, directions = np.zeros((CHANNELS[0], 0)), np.zeros((CHANNELS[0], 0, 3))
        return Sweep(range_m=none, recorded=none, direction=directions, start_s=start_s, metadata=metadata)
    channels = int(points[:, RING].max()) + 1
    rows = min(count for count in CHANNELS if count >= channels)
    firings = _firings(points, channels)
    points = points.copy()
    points[:, COLUMN] = firings[points[:, COLUMN].astype(np.int64)]
    shape = (rows, columns) = (rows, int(firings[-1]) + 1)
    recorded = np.broadcast_to(np.isin(np.arange(columns), firings), shape)
    first = _lay_out(points, points[:, RETURN] != LAST_RETURN, shape)
    last = _lay_out(points, points[:, RETURN] == LAST_RETURN, shape)
    # The decoder may drop the stronger of two returns: the last one is then the only one.
    only_last = np.isnan(first[..., X]) & ~np.isnan(last[..., X])
    first[only_last], last[only_last] = last[only_last], np.nan
    range_m = np.sqrt(np.sum(first[..., :3] ** 2, axis=-1))
    direction, time_s = _interpolate(first, range_m)
    second = None
    if np.isfinite(last[..., X]).any():
        second = Second(range_m=np.sqrt(np.sum(last[..., :3] ** 2, axis=-1)), intensity=last[..., INTENSITY])
    first_s = np.nanmin(time_s)
    return Sweep(
        range_m=range_m,
        recorded=recorded,
        direction=direction,
        time_s=np.where(recorded, time_s - first_s, np.nan),
        intensity=first[..., INTENSITY],
        second=second,
        ring=np.broadcast_to(np.arange(rows)[:, None], shape),
        column=np.broadcast_to(np.arange(columns), shape),
        start_s=start_s + first_s,
        includes_lost=True,
        metadata=metadata,
    )


def _firings(points: Numbers, channels: int) -> Numbers:
    """(columns,) numbers of the decoder's firings, counting those of lost packets, which it leaves out.

    A channel whose time from point to point is longer than the decoder's firings take has the lost ones between them.
    """
    count = int(points[:, COLUMN].max()) + 1
    time_s = _lay_out(points, slice(None), (channels, count))[..., TIME]
    columns = [np.flatnonzero(np.isfinite(row)) for row in time_s]
    times = [row[hits] for row, hits in zip(time_s, columns, strict=True)]
    cycle_s = _rate(columns, times) or math.inf
    lost = np.full(count - 1, math.inf)
    for hits, stamps_s in zip(columns, times, strict=True):
        steps = np.diff(hits)
        between = slice(hits[0], hits[-1]) if len(hits) else slice(0)
        lost[between] = np.minimum(lost[between], np.repeat(np.rint(np.diff(stamps_s) / cycle_s) - steps, steps))
    lost[~((lost > 0) & (lost < MOST_LOST))] = 0  # nothing, or a clock that is set meanwhile
    lost[1:][lost[:-1] > 0] = 0  # the same ones, which no channel places between two firings
    return np.cumsum(np.r_[0, 1 + lost]).astype(np.int64)


def _lay_out(points: Numbers, mask: Numbers | slice, shape: tuple[int, int]) -> Numbers:
    """(rows, columns, 8) array with the selected points at their channel and firing, NaN elsewhere."""
    selected = points[mask]
    array = np.full((*shape, points.shape[1]), np.nan)
    array[selected[:, RING].astype(np.int64), selected[:, COLUMN].astype(np.int64)] = selected
    return array


def _interpolate(first: Numbers, range_m: Numbers) -> tuple[Numbers, Numbers]:
    """Directions (rows, columns, 3) and times (rows, columns) of all pulses, from the points of the same channel.

    Azimuth, z component and time are interpolated linearly between two points; before the first and after the last they
    are extrapolated at the median rate of all channels. NaN for a channel without any point.
    """
    with np.errstate(invalid="ignore"):
        direction = first[..., :3] / range_m[..., None]
    time_s = first[..., TIME].copy()
    columns = [np.flatnonzero(np.isfinite(row)) for row in range_m]
    azimuths = [np.unwrap(np.arctan2(*direction[row, hits, 1::-1].T)) for row, hits in enumerate(columns)]
    times = [time_s[row, hits] for row, hits in enumerate(columns)]
    azimuth_rate, time_rate = _rate(columns, azimuths), _rate(columns, times)
    firings = np.arange(range_m.shape[1], dtype=np.float64)
    for row, (hits, azimuth) in enumerate(zip(columns, azimuths, strict=True)):
        if not len(hits):
            continue
        misses = np.setdiff1d(firings, hits).astype(np.int64)
        beyond_hits = firings[misses] - firings[misses].clip(hits[0], hits[-1])
        azimuth_rad = np.interp(firings[misses], hits, azimuth) + beyond_hits * azimuth_rate
        height = np.interp(firings[misses], hits, direction[row, hits, 2])
        level = np.sqrt(1.0 - height**2)
        direction[row, misses] = np.stack([level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), height], axis=-1)
        time_s[row, misses] = np.interp(firings[misses], hits, time_s[row, hits]) + beyond_hits * time_rate
    return direction, time_s


def _rate(columns: Sequence[Numbers], values: Sequence[Numbers]) -> float:
    """Median change of the values from one firing to the next, over all channels."""
    steps = [
        np.diff(channel_values)[np.diff(hits) == 1]
        for hits, channel_values in zip(columns, values, strict=True)
        if len(hits) > 1
    ]
    all_steps = np.concatenate([*steps, np.zeros(0)])
    return float(np.median(all_steps)) if len(all_steps) else 0.0
