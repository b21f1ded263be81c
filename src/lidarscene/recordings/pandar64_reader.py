"""Recordings of Hesai's Pandar64: packets as the maker's HesaiLidar_General_SDK at d7f39ee reads them.

No package on PyPI decodes them. Angles and firing times are those of the catalogue's sensor, which
are nominal; a unit's own are in the CSV that Hesai gives with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..formats.cloud_description import input_errors
from ..formats.packets.layouts import (
    DUAL,
    HESAI_START,
    PANDAR64_AZIMUTH_US,
    PANDAR64_BLOCKS,
    PANDAR64_CYCLE_S,
    PANDAR64_LASERS,
    PANDAR64_PACKET,
    PANDAR64_STAMP_US,
    Packet,
)
from ..maths.arrays import Numbers
from ..maths.pose import direction_from_angles
from ..scan.spinning import Spinning
from ..sensor.sensor_file import load_sensor
from .pcap_reader import turns_of
from .recording import Recording
from .sweep import Second, Sweep
from .units.hesai_unit import read_hesai

NAME = "pandar64"


def is_pandar64(payload: bytes) -> bool:
    """True if a payload is a packet of measurements, with its sequence number behind it or without."""
    return (
        payload[:4] == HESAI_START + bytes([PANDAR64_LASERS, PANDAR64_BLOCKS])
        and len(payload) >= PANDAR64_PACKET.itemsize
    )


def open_pandar64(path: Path, metadata: Path | None, packets: Sequence[Packet]) -> Recording:
    """Open the turns of these packets; ``metadata`` is the unit's table of angles, CSV. Raises InputError."""
    with input_errors(path):
        rows = np.frombuffer(
            b"".join(packet.payload[: PANDAR64_PACKET.itemsize] for packet in packets), PANDAR64_PACKET
        )
    stamps_s = np.array([packet.time_s for packet in packets])
    turns = turns_of(rows["blocks"]["azimuth"][:, 0])
    angles = _angles(metadata)
    recording_metadata = {
        "format": "hesai pcap",
        "sensor": "Pandar64",
        "mode": "dual" if rows["mode"][0] == DUAL else "single",
    }

    def read(frame: int) -> Sweep:
        turn = turns[frame]
        with input_errors(path):
            return _sweep(rows[turn], stamps_s[turn], angles, recording_metadata | {"frame": str(frame)})

    return Recording(path=path, count=len(turns), read=read, metadata=recording_metadata)


def _angles(metadata: Path | None) -> tuple[Numbers, Numbers, Numbers]:
    """(64,) elevations [rad], azimuths against the head's, counter-clockwise [rad], and delays in a block [s]."""
    scanner = load_sensor(NAME).scanner
    assert isinstance(scanner, Spinning)
    number = scanner.lasers_by_place.values.astype(np.int64)
    elevation, azimuth, firing_s = (np.zeros(PANDAR64_LASERS) for _ in range(3))
    elevation[number], azimuth[number] = scanner.elevation_rad.values, scanner.azimuth_rad.values
    firing_s[number] = scanner.firing_s - scanner.firing_s[0]
    if metadata is not None:
        unit = read_hesai(metadata).lists
        if len(unit["elevation_deg"]) != PANDAR64_LASERS:
            raise InputError(
                f"{metadata}: must have {PANDAR64_LASERS} channels of a Pandar64, got {len(unit['elevation_deg'])}"
            )
        elevation, azimuth = np.radians(unit["elevation_deg"]), np.radians(unit["azimuth_offset_deg"])
    return elevation, azimuth, firing_s


def _sweep(
    rows: Numbers, stamps_s: Numbers, angles: tuple[Numbers, Numbers, Numbers], metadata: dict[str, str]
) -> Sweep:
    elevation, azimuth, firing_s = angles
    step = 2 if rows["mode"][0] == DUAL else 1
    blocks = rows["blocks"]
    per_second_deg = 6.0 * rows["turns_per_minute"][:, None, None].astype(np.float64)
    head_deg = 0.01 * blocks["azimuth"][:, ::step, None] - per_second_deg * (1e-6 * PANDAR64_AZIMUTH_US - firing_s)
    last_block = np.arange(PANDAR64_BLOCKS // step)[::-1]
    # The sensor's clock gives the time within a second, the recorder's clock the second.
    part_s = 1e-6 * rows["stamp"]
    second = np.rint(stamps_s - part_s)
    block_start_s = (second + part_s - 1e-6 * PANDAR64_STAMP_US)[:, None] - PANDAR64_CYCLE_S * last_block
    time_s = block_start_s[..., None] + firing_s
    beam_azimuth = azimuth - np.radians(head_deg)
    beam_elevation = np.broadcast_to(elevation, beam_azimuth.shape)
    direction = np.stack(direction_from_angles(azimuth_rad=beam_azimuth, elevation_rad=beam_elevation), axis=-1)
    points = blocks["points"]
    metres = 1e-3 * rows["step_mm"][:, None, None] * points["distance"].astype(np.float64)
    metres[metres == 0.0] = np.nan
    reflectivity = points["reflectivity"]

    def by_laser(values: Numbers) -> Numbers:
        """Reshape (packets, blocks, lasers, ...) to (lasers, firings, ...)."""
        return np.moveaxis(values.reshape(-1, *values.shape[2:]), 0, 1)

    range_m, second_return = by_laser(metres[:, step - 1 :: step]), None
    if step == 2:
        second_m = by_laser(metres[:, ::step])
        is_second = second_m != range_m
        second_return = Second(
            range_m=np.where(is_second, second_m, np.nan),
            intensity=by_laser(reflectivity[:, ::step]).astype(np.float32),
        )
    start_s = float(time_s.min())
    shape = range_m.shape
    return Sweep(
        range_m=range_m,
        recorded=np.ones(shape, bool),
        direction=by_laser(direction),
        time_s=by_laser(time_s) - start_s,
        intensity=by_laser(reflectivity[:, step - 1 :: step]),
        second=second_return,
        ring=np.broadcast_to(np.arange(PANDAR64_LASERS)[:, None], shape),
        column=np.broadcast_to(np.arange(shape[1]), shape),
        start_s=start_s,
        includes_lost=True,
        metadata=metadata,
    )
