"""Recordings of Hesai's spinning sensors: packets out of pcap files and ROS bags, as the makers' manuals have them.

A packet has blocks of the distances and reflectivities of all lasers, each block with an azimuth of the head. With two
or three returns, blocks of one firing follow each other. Layouts and delays are those of the maker's
HesaiLidar_General_SDK at d7f39ee (Pandar64) and of tier4/nebula at 606ac41f (the others). Angles and firing times are
those of the catalogue's sensor, which are nominal or another unit's; a unit's own are in the CSV that Hesai gives
with it. Azimuths are clockwise from the sensor's y axis, ahead; here they are counter-clockwise from x, forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..formats.cloud_description import input_errors
from ..formats.packets.layouts import (
    HESAI_START,
    PANDAR64_AZIMUTH_US,
    PANDAR64_BLOCKS,
    PANDAR64_CYCLE_S,
    PANDAR64_LASERS,
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """Packets of one model; bytes, in which the fields of the tail count from its start.

    name        product
    sensor      the catalogue's sensor
    protocol    major and minor version; None: the header has none
    header      length of the header
    mark        length of the mark before each block's azimuth
    point       length of a point: distance, reflectivity, and perhaps more
    gap         length of what stands between the last block and the tail
    mode, turns_per_minute, stamp  of the tail
    cycle_s     time from firing to firing
    azimuth_us  delay of a block's azimuth after its first laser
    stamp_us    delay of the packet's stamp after the first laser of the last firing, or of the first one
    stamps_first  whether the stamp is of the first firing
    step_mm     step of the distances; None: the header's
    phase       of the tail: 1 if a packet with several returns has the first firing of a cycle, else 0; None: a cycle
                is one firing
    flags       the header's bits that choose the layout; None: they choose nothing
    tells_silence  whether a distance of 0 means a laser that did not fire, and one of `LEAST_STEPS` or less no return
    """

    name: str
    sensor: str
    lasers: int
    blocks: int
    protocol: tuple[int, int] | None
    mode: int
    turns_per_minute: int
    stamp: int
    cycle_s: float
    stamp_us: float
    header: int = 12
    mark: int = 0
    point: int = 4
    gap: int = 0
    azimuth_us: float = 0.0
    step_mm: int | None = None
    phase: int | None = None
    stamps_first: bool = False
    flags: int | None = None
    tells_silence: bool = False

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Layout of a packet up to the last field that is read."""
        points = np.dtype(
            {"names": ["distance", "reflectivity"], "formats": ["<u2", "u1"], "offsets": [0, 2], "itemsize": self.point}
        )
        block_bytes = self.mark + 2 + self.point * self.lasers
        block = np.dtype(
            {
                "names": ["azimuth", "points"],
                "formats": ["<u2", (points, self.lasers)],
                "offsets": [self.mark, self.mark + 2],
                "itemsize": block_bytes,
            }
        )
        tail = self.header + self.blocks * block_bytes + self.gap
        fields: dict[str, tuple[Any, int]] = {
            "blocks": ((block, self.blocks), self.header),
            "turns_per_minute": ("<u2", tail + self.turns_per_minute),
            "stamp": ("<u4", tail + self.stamp),
            "mode": ("u1", tail + self.mode),
        }
        if self.step_mm is None:
            fields["step_mm"] = ("u1", 9 if self.protocol else 5)
        if self.phase is not None:
            fields["phase"] = ("u1", tail + self.phase)
        ends = [offset + np.dtype(kind).itemsize for kind, offset in fields.values()]
        return np.dtype(
            {
                "names": list(fields),
                "formats": [kind for kind, _ in fields.values()],
                "offsets": [offset for _, offset in fields.values()],
                "itemsize": max(ends),
            }
        )

    def fits(self, payload: bytes) -> bool:
        """Whether a payload is a packet of this model, with more behind it or without."""
        if len(payload) < self.dtype.itemsize:
            return False
        if not self.header:  # no header, but a mark before each block
            block_bytes = self.mark + 2 + self.point * self.lasers
            return all(payload[block * block_bytes :][:2] == BLOCK_START for block in range(self.blocks))
        if payload[:2] != HESAI_START:
            return False
        if self.protocol is None:
            return payload[2:4] == bytes([self.lasers, self.blocks])
        if self.flags is not None and payload[FLAGS] & LAYOUT_FLAGS != self.flags:
            return False
        return (*payload[2:4], *payload[6:8]) == (*self.protocol, self.lasers, self.blocks)


FLAGS, LAYOUT_FLAGS = 11, 0x24
"""Byte of a header with its flags, and those of a noise byte in each point and of functional safety before the tail."""

BLOCK_START = b"\xff\xee"
"""First bytes of each block of a Pandar40P."""

RETURNS = {0x33: 1, 0x34: 1, 0x37: 1, 0x38: 1, 0x39: 2, 0x3A: 2, 0x3B: 2, 0x3C: 2, 0x3D: 3, 0x3E: 2}
"""Mode of returns -> blocks of a firing."""

LEAST_STEPS = 3
"""Distances of an OT128 that say why there is no return: too close, too close for the far field, nothing came back."""

LAST_AND_STRONGEST, FIRST_AND_STRONGEST = 0x39, 0x3C
"""Modes of two returns in which the strongest may stand in the second block of a firing."""

_XT: dict[str, Any] = {
    "protocol": (6, 1),
    "mode": 10,
    "turns_per_minute": 11,
    "stamp": 19,
    "cycle_s": 50e-6,
    "stamp_us": -6.0,
}
FORMATS = (
    Format(
        name="Pandar40P",
        sensor="pandar40p",
        lasers=40,
        blocks=10,
        protocol=None,
        header=0,
        mark=2,
        point=3,
        mode=14,
        turns_per_minute=8,
        stamp=10,
        cycle_s=PANDAR64_CYCLE_S,
        azimuth_us=54.67,
        stamp_us=83.25,
        step_mm=4,
    ),
    Format(
        name="Pandar64",
        sensor="pandar64",
        lasers=PANDAR64_LASERS,
        blocks=PANDAR64_BLOCKS,
        protocol=None,
        header=8,
        point=3,
        mode=14,
        turns_per_minute=8,
        stamp=10,
        cycle_s=PANDAR64_CYCLE_S,
        azimuth_us=PANDAR64_AZIMUTH_US,
        stamp_us=PANDAR64_STAMP_US,
    ),
    Format(name="PandarXT16", sensor="pandarxt-16", lasers=16, blocks=8, **_XT),
    Format(name="PandarXT32", sensor="pandarxt-32", lasers=32, blocks=8, **_XT),
    Format(name="XT32M2X", sensor="xt32m2x", lasers=32, blocks=6, **_XT),
    Format(
        name="PandarQT",
        sensor="pandarqt",
        lasers=64,
        blocks=4,
        protocol=(3, 1),
        mode=16,
        turns_per_minute=10,
        stamp=12,
        cycle_s=0.5e-3 / 3.0,
        stamp_us=-38.02,
        stamps_first=True,
    ),
    Format(
        name="QT128C2X",
        sensor="qt128c2x",
        lasers=128,
        blocks=2,
        protocol=(3, 2),
        gap=21,
        mode=12,
        turns_per_minute=13,
        stamp=21,
        cycle_s=1.0 / 9000.0,
        stamp_us=-9.6,
        phase=5,
    ),
    *(
        Format(
            name="OT128",
            sensor="ot128",
            lasers=128,
            blocks=2,
            protocol=(1, 4),
            point=4 if has_noise else 3,
            gap=21 if has_safety else 4,
            flags=0x20 * has_noise | 0x04 * has_safety,
            mode=12,
            turns_per_minute=13,
            stamp=21,
            cycle_s=PANDAR64_CYCLE_S,
            stamp_us=-45.724,
            tells_silence=True,
        )
        for has_noise in (False, True)
        for has_safety in (False, True)
    ),
)
"""Models whose packets are read."""


def format_of(payload: bytes) -> Format | None:
    """Find the model whose packet this is; None for another."""
    return next((layout for layout in FORMATS if layout.fits(payload)), None)


def is_hesai(payload: bytes) -> bool:
    """True if a payload is a packet of measurements, of a model that is read or of another."""
    return len(payload) > 500 and (payload[:2] == HESAI_START or format_of(payload) is not None)


def open_hesai(path: Path, metadata: Path | None, packets: Sequence[Packet]) -> Recording:
    """Open the turns of these packets; ``metadata`` is the unit's table of angles, CSV. Raises InputError."""
    layout = _format(path, packets)
    packets = [packet for packet in packets if layout.fits(packet.payload)]
    first_azimuths = _rows(layout, packets)["blocks"]["azimuth"][:, 0]
    scans = [packets[turn] for turn in turns_of(first_azimuths)]
    return recording_of_scans(path, metadata, scans, name="hesai pcap")


def recording_of_scans(path: Path, metadata: Path | None, scans: Sequence[Sequence[Packet]], *, name: str) -> Recording:
    """Recording of which each of these runs of packets is a frame. Raises InputError."""
    layout = _format(path, scans[0])
    angles = _angles(layout, metadata)
    mode = RETURNS.get(int(_rows(layout, scans[0])["mode"][0]), 1)
    recording_metadata = {"format": name, "sensor": layout.name, "mode": ("single", "dual", "triple")[mode - 1]}

    def read(frame: int) -> Sweep:
        with input_errors(path, folder=True):
            packets = [packet for packet in scans[frame] if layout.fits(packet.payload)]
            if not packets:
                raise ValueError(f"must have packets of a {layout.name} in this turn, got none")
            stamps_s = np.array([packet.time_s for packet in packets])
            return _sweep(layout, _rows(layout, packets), stamps_s, angles, recording_metadata | {"frame": str(frame)})

    return Recording(path=path, count=len(scans), read=read, metadata=recording_metadata)


def _format(path: Path, packets: Sequence[Packet]) -> Format:
    """Find the model of the first packet that is one of Hesai's. Raises InputError."""
    with input_errors(path, folder=True):
        if not packets:
            raise ValueError("must have packets, got none in the first turn")
        for packet in packets:
            if (layout := format_of(packet.payload)) is not None:
                return layout
        first = packets[0].payload
        names = ", ".join(dict.fromkeys(layout.name for layout in FORMATS))
        raise ValueError(
            f"must be packets of {names}, got protocol {first[2]}.{first[3]}, {first[6]} lasers, {first[7]} blocks, "
            f"{len(first)} bytes"
        )


def _rows(layout: Format, packets: Sequence[Packet]) -> Numbers:
    """(packets,) fields."""
    dtype = layout.dtype
    return np.frombuffer(b"".join(packet.payload[: dtype.itemsize] for packet in packets), dtype)


Angles = tuple[Numbers, Numbers, Numbers]


def _angles(layout: Format, metadata: Path | None) -> Angles:
    """(lasers,) elevations and azimuths against the head's [rad], and (phases, lasers) delays in a firing [s].

    A laser that does not fire in a phase has a delay of NaN.
    """
    elevation, azimuth, firing_s = (values.copy() for values in _nominal_angles(layout))
    if metadata is not None:
        unit = read_hesai(metadata).lists
        if len(unit["elevation_deg"]) != layout.lasers:
            raise InputError(
                f"{metadata}: must have {layout.lasers} channels of a {layout.name}, got {len(unit['elevation_deg'])}"
            )
        elevation, azimuth = np.radians(unit["elevation_deg"]), np.radians(unit["azimuth_offset_deg"])
    return elevation, azimuth, firing_s


@cache
def _nominal_angles(layout: Format) -> Angles:
    scanner = load_sensor(layout.sensor).scanner
    assert isinstance(scanner, Spinning)
    number = scanner.lasers_by_place.values.astype(np.int64)
    elevation, azimuth = np.zeros(layout.lasers), np.zeros(layout.lasers)
    elevation[number], azimuth[number] = scanner.elevation_rad.values, scanner.azimuth_rad.values
    phases = round(scanner.cycle_s / layout.cycle_s)
    # Times of a file are rounded: one that begins a firing may lie a little before it.
    phase = np.floor(scanner.firing_s / layout.cycle_s + 1e-3).astype(np.int64)
    firing_s = np.full((phases, layout.lasers), np.nan)
    firing_s[phase, number] = scanner.firing_s - scanner.firing_s[0] - phase * layout.cycle_s
    return elevation, azimuth, firing_s


def _sweep(layout: Format, rows: Numbers, stamps_s: Numbers, angles: Angles, metadata: dict[str, str]) -> Sweep:
    elevation, azimuth, firing_s_by_phase = angles
    mode = int(rows["mode"][0])
    returns = RETURNS.get(mode, 1)
    firings = layout.blocks // returns
    blocks = rows["blocks"][:, : firings * returns]
    first_phase: Numbers = np.zeros(len(rows), np.int64)
    if layout.phase is not None and returns > 1:
        first_phase = 1 - (rows["phase"] & 1)
    phase = (first_phase[:, None] + np.arange(firings)) % len(firing_s_by_phase)
    firing_s = firing_s_by_phase[phase]
    per_second_deg = 6.0 * rows["turns_per_minute"][:, None, None].astype(np.float64)
    delay_s = np.nan_to_num(firing_s)
    head_deg = 0.01 * blocks["azimuth"][:, ::returns, None] - per_second_deg * (1e-6 * layout.azimuth_us - delay_s)
    # The sensor's clock gives the time within a second, the recorder's clock the second.
    part_s = 1e-6 * rows["stamp"]
    second = np.rint(stamps_s - part_s)
    number = np.arange(firings) - (0 if layout.stamps_first else firings - 1)
    begin_s = (second + part_s - 1e-6 * layout.stamp_us)[:, None] + layout.cycle_s * number
    time_s = begin_s[..., None] + firing_s
    beam_azimuth = azimuth - np.radians(head_deg)
    beam_elevation = np.broadcast_to(elevation, beam_azimuth.shape)
    direction = np.stack(direction_from_angles(azimuth_rad=beam_azimuth, elevation_rad=beam_elevation), axis=-1)
    step_mm: Numbers | float = rows["step_mm"][:, None, None] if layout.step_mm is None else float(layout.step_mm)
    steps = blocks["points"]["distance"]
    metres = 1e-3 * step_mm * steps.astype(np.float64)
    metres[steps <= (LEAST_STEPS if layout.tells_silence else 0)] = np.nan
    reflectivity = blocks["points"]["reflectivity"]

    def by_laser(values: Numbers) -> Numbers:
        """Reshape (packets, firings, lasers, ...) to (lasers, firings, ...)."""
        return np.moveaxis(values.reshape(-1, *values.shape[2:]), 0, 1)

    place = _main_block(mode, metres[:, ::returns], metres[:, 1::returns]) if returns > 1 else 0
    range_m, second_return = by_laser(metres[:, place::returns]), None
    if returns > 1:
        other_m = by_laser(metres[:, 1 - place :: returns])
        is_other = other_m != range_m
        second_return = Second(
            range_m=np.where(is_other, other_m, np.nan),
            intensity=by_laser(reflectivity[:, 1 - place :: returns]).astype(np.float32),
        )
    fired = by_laser(np.isfinite(firing_s))
    if layout.tells_silence:
        fired = by_laser(steps[:, ::returns] != 0)
    start_s = float(np.nanmin(time_s))
    shape = range_m.shape
    return Sweep(
        range_m=range_m,
        recorded=fired | np.isfinite(range_m),
        direction=by_laser(direction),
        time_s=by_laser(time_s) - start_s,
        intensity=by_laser(reflectivity[:, place::returns]),
        second=second_return,
        ring=np.broadcast_to(np.arange(layout.lasers)[:, None], shape),
        column=np.broadcast_to(np.arange(shape[1]), shape),
        start_s=start_s,
        includes_lost=True,
        metadata=metadata,
    )


def _main_block(mode: int, first_m: Numbers, second_m: Numbers) -> int:
    """Block of a firing that has the strongest return, or the first where the strongest is not among them: 0 or 1.

    A last return is never nearer than the strongest, and sensors of one mode differ in their order.
    """
    if mode == LAST_AND_STRONGEST:
        return int(np.sum(second_m > first_m) <= np.sum(first_m > second_m))
    return int(mode == FIRST_AND_STRONGEST)
