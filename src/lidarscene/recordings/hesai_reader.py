"""Recordings of Hesai's sensors: packets out of pcap files and ROS bags, as the makers' manuals have them.

A packet has blocks of the distances and reflectivities of all lasers, each block with an azimuth of the head. With two
or three returns, blocks of one firing follow each other. Layouts and delays are those of the maker's
HesaiLidar_General_SDK at d7f39ee (Pandar64) and of tier4/nebula at 606ac41f (the others). Angles and firing times are
those of the catalogue's sensor, which are nominal or another unit's; a unit's own are in the CSV that Hesai gives
with it. Azimuths are clockwise from the sensor's y axis, ahead; here they are counter-clockwise from x, forward.

The azimuths of an AT128 are those of its mirror, whose faces carry the beams past 90 degrees, ahead. Where a face
begins differs by 10 degrees between units, so its packets are read with the unit's file of corrections only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, OptionError
from ..formats.cloud_description import input_errors
from ..formats.packets.layouts import (
    FULL_TURN,
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
from .pcap_reader import MOST_LOST, Packets, in_order, turns_of
from .recording import Recording
from .sweep import Second, Sweep
from .units.hesai_unit import MirrorCorrections, read_hesai, read_mirror


@dataclass(frozen=True, kw_only=True)
class PacketFormat:
    """Packets of one model; bytes, in which the fields of the tail count from its start.

    Attributes:
        name: product
        sensor: the catalogue's sensor
        protocol: major and minor version; None: the header has none
        header: length of the header
        mark: length of the mark before each block's azimuth
        fine: length of what follows that azimuth: 1 for 256ths of its unit
        point: length of a point: distance, reflectivity, and perhaps more
        gap: length of what stands between the last block and the tail
        mode: place of the return mode in the tail
        turns_per_minute: place of the speed in the tail
        stamp: place of the time in the tail
        cycle_s: time from firing to firing
        azimuth_us: delay of a block's azimuth after its first laser
        stamp_us: delay of the packet's stamp after the first laser of the last firing, or of the first one
        stamps_first: whether the stamp is of the first firing
        step_mm: step of the distances; None: the header's
        phase: of the tail: 1 if a packet with several returns has the first firing of a cycle, else 0; None: a cycle is
            one firing
        flags: the header's bits that choose the layout; None: they choose nothing
        speed_deg_s: turn of the beams for each count of `turns_per_minute`
        has_mirror: whether azimuths are those of a mirror's encoder, and directions need the unit's file of corrections
        tells_silence: whether a distance of 0 means a laser that did not fire, and one of `LEAST_STEPS` or less no
            return
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
    fine: int = 0
    point: int = 4
    gap: int = 0
    azimuth_us: float = 0.0
    step_mm: int | None = None
    phase: int | None = None
    stamps_first: bool = False
    flags: int | None = None
    speed_deg_s: float = 6.0
    has_mirror: bool = False
    tells_silence: bool = False

    @property
    def block_bytes(self) -> int:
        """Length of a block: its mark, azimuth and points."""
        return self.mark + 2 + self.fine + self.point * self.lasers

    @property
    def tail(self) -> int:
        """Place of the tail."""
        return self.header + self.blocks * self.block_bytes + self.gap

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Layout of a packet up to the last field that is read."""
        points = np.dtype(
            {"names": ["distance", "reflectivity"], "formats": ["<u2", "u1"], "offsets": [0, 2], "itemsize": self.point}
        )
        azimuths = ["azimuth", "fine"] if self.fine else ["azimuth"]
        block = np.dtype(
            {
                "names": [*azimuths, "points"],
                "formats": [*["<u2", "u1"][: len(azimuths)], (points, self.lasers)],
                "offsets": [*[self.mark, self.mark + 2][: len(azimuths)], self.mark + 2 + self.fine],
                "itemsize": self.block_bytes,
            }
        )
        fields: dict[str, tuple[Any, int]] = {
            "blocks": ((block, self.blocks), self.header),
            "turns_per_minute": ("<u2", self.tail + self.turns_per_minute),
            "stamp": ("<u4", self.tail + self.stamp),
            "mode": ("u1", self.tail + self.mode),
        }
        if self.step_mm is None:
            fields["step_mm"] = ("u1", 9 if self.protocol else 5)
        if self.phase is not None:
            fields["phase"] = ("u1", self.tail + self.phase)
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
            return all(payload[block * self.block_bytes :][:2] == BLOCK_START for block in range(self.blocks))
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
"""Source: tier4/nebula; bytes and times that its models have in common."""

FORMATS = (
    PacketFormat(
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
    PacketFormat(
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
    PacketFormat(name="PandarXT16", sensor="pandarxt-16", lasers=16, blocks=8, **_XT),
    PacketFormat(name="PandarXT32", sensor="pandarxt-32", lasers=32, blocks=8, **_XT),
    PacketFormat(name="XT32M2X", sensor="xt32m2x", lasers=32, blocks=6, **_XT),
    PacketFormat(
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
    PacketFormat(
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
        PacketFormat(
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
    PacketFormat(
        name="AT128",
        sensor="at128",
        lasers=128,
        blocks=2,
        protocol=(4, 3),
        fine=1,
        gap=4,
        mode=24,
        turns_per_minute=18,  # tenths, of the mirror
        stamp=20,
        cycle_s=1.0 / 24_000.0,
        stamp_us=50.915,
        speed_deg_s=1.2,
        has_mirror=True,
    ),
)
"""Models whose packets are read."""


def format_of(payload: bytes) -> PacketFormat | None:
    """Find the model whose packet this is; None for another."""
    return next((layout for layout in FORMATS if layout.fits(payload)), None)


def is_hesai(payload: bytes) -> bool:
    """True if a payload is a packet of measurements, of a model that is read or of another."""
    return len(payload) > 500 and (payload[:2] == HESAI_START or format_of(payload) is not None)


def open_hesai(path: Path, metadata: Path | None, packets: Packets) -> Recording:
    """Open the turns of these packets; ``metadata`` is the unit's table of angles, CSV.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    layout = _format(path, packets)
    packets, azimuths, passed_s = in_order(
        packets.where(layout.fits),
        azimuth_at=layout.header + layout.mark,
        stamp_at=layout.tail + layout.stamp,
        period_s=1.0,
    )
    mirror = _beams(layout, metadata).mirror
    turns = turns_of(azimuths, passed_s) if mirror is None else mirror.sweeps_of(0.01 * azimuths)
    scans = [packets[turn] for turn in turns]
    return recording_of_scans(path, metadata, scans, name="hesai pcap")


def recording_of_scans(path: Path, metadata: Path | None, scans: Sequence[Sequence[Packet]], *, name: str) -> Recording:
    """Recording of which each of these runs of packets is a frame.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    layout = _format(path, scans[0])
    beams = _beams(layout, metadata)
    mode = RETURNS.get(int(_rows(layout, scans[0])["mode"][0]), 1)
    recording_metadata = {"format": name, "sensor": layout.name, "mode": ("single", "dual", "triple")[mode - 1]}
    first = next(packet for packet in scans[0] if layout.fits(packet.payload))
    first_late_s = first.time_s - 1e-6 * float(_rows(layout, [first])["stamp"][0])

    def read(frame: int) -> Sweep:
        with input_errors(path, folder=True):
            packets = [packet for packet in scans[frame] if layout.fits(packet.payload)]
            if not packets:
                raise ValueError(f"must have packets of a {layout.name} in this turn, got none")
            stamps_s = np.array([packet.time_s for packet in packets])
            rows = _rows(layout, packets)
            # The sensor's clock gives the time within a second, the recorder's clock the second of the first packet.
            # Where they are half a second apart, each packet by itself would be of one second or of the next.
            late_s = stamps_s - 1e-6 * rows["stamp"]
            second = np.rint(first_late_s) + np.rint(late_s - first_late_s)
            return _sweep(layout, *_with_lost(rows, second), beams, recording_metadata | {"frame": str(frame)})

    return Recording(path=path, count=len(scans), read=read, metadata=recording_metadata)


def _format(path: Path, packets: Sequence[Packet]) -> PacketFormat:
    """Find the model of the first packet that is one of Hesai's.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
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


def _rows(layout: PacketFormat, packets: Sequence[Packet]) -> Numbers:
    """(packets,) fields."""
    dtype = layout.dtype
    return np.frombuffer(b"".join(packet.payload[: dtype.itemsize] for packet in packets), dtype)


def _with_lost(rows: Numbers, second: Numbers) -> tuple[Numbers, Numbers]:
    """(packets,) fields and seconds with those of lost packets, whose points are empty and whose seconds are NaN."""
    passed_s = np.diff(second + 1e-6 * rows["stamp"])
    usual_s = float(np.median(passed_s)) if len(passed_s) else 0.0
    steps = np.rint(passed_s / usual_s) if usual_s > 0.0 else np.ones(len(passed_s))
    # A clock that is set meanwhile leaves nothing out.
    number = np.cumsum(np.r_[0, np.where((steps > 1) & (steps < MOST_LOST), steps, 1)]).astype(np.int64)
    every = np.arange(number[-1] + 1)
    came = np.isin(every, number)
    filled = rows[np.searchsorted(number, every, side="right") - 1]
    azimuths = np.unwrap(rows["blocks"]["azimuth"].astype(np.float64), axis=0, period=FULL_TURN)
    between = np.stack([np.interp(every, number, azimuth) for azimuth in azimuths.T], axis=-1)
    filled["blocks"]["azimuth"] = np.rint(between) % FULL_TURN
    filled["blocks"]["points"]["distance"][~came] = 0
    seconds = np.full(len(every), np.nan)
    seconds[number] = second
    return filled, seconds


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamCalibration:
    """Bank of beams of a unit.

    Attributes:
        elevation: (lasers,) against the head [rad]
        azimuth: (lasers,) against the head [rad]
        firing_s: (phases, lasers) delays in a firing; NaN: the laser does not fire in this phase
        mirror: corrections of a unit with a mirror, which replace elevation and azimuth
    """

    elevation: Numbers
    azimuth: Numbers
    firing_s: Numbers
    mirror: MirrorCorrections | None = None


def _beams(layout: PacketFormat, metadata: Path | None) -> BeamCalibration:
    """Beams of a unit, or the catalogue's without ``metadata``.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    nominal = _nominal_beams(layout)
    if layout.has_mirror:
        if metadata is None:
            raise OptionError(
                "{metadata}: must name the unit's file of corrections (.dat) for packets of an {0}, got none",
                layout.name,
            )
        mirror = read_mirror(metadata)
        _check_channels(layout, metadata, len(mirror.elevation_deg))
        return replace(nominal, mirror=mirror)
    if metadata is None:
        return nominal
    unit = read_hesai(metadata).lists
    _check_channels(layout, metadata, len(unit["elevation_deg"]))
    return replace(nominal, elevation=np.radians(unit["elevation_deg"]), azimuth=np.radians(unit["azimuth_offset_deg"]))


def _check_channels(layout: PacketFormat, metadata: Path, channels: int) -> None:
    if channels != layout.lasers:
        raise InputError(f"{metadata}: must have the {layout.lasers} channels of {layout.name}, got {channels}")


@cache
def _nominal_beams(layout: PacketFormat) -> BeamCalibration:
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
    return BeamCalibration(elevation=elevation, azimuth=azimuth, firing_s=firing_s)


def _sweep(
    layout: PacketFormat, rows: Numbers, second: Numbers, beams: BeamCalibration, metadata: dict[str, str]
) -> Sweep:
    mode = int(rows["mode"][0])
    returns = RETURNS.get(mode, 1)
    firings = layout.blocks // returns
    blocks = rows["blocks"][:, : firings * returns]
    first_phase: Numbers = np.zeros(len(rows), np.int64)
    if layout.phase is not None and returns > 1:
        first_phase = 1 - (rows["phase"] & 1)
    phase = (first_phase[:, None] + np.arange(firings)) % len(beams.firing_s)
    firing_s = beams.firing_s[phase]
    number = np.arange(firings) - (0 if layout.stamps_first else firings - 1)
    begin_s = (second + 1e-6 * rows["stamp"] - 1e-6 * layout.stamp_us)[:, None] + layout.cycle_s * number
    time_s = begin_s[..., None] + firing_s
    speed_deg_s = layout.speed_deg_s * rows["turns_per_minute"][:, None, None]
    turn_deg = speed_deg_s * (np.nan_to_num(firing_s) - 1e-6 * layout.azimuth_us)
    direction = _directions(layout, beams, blocks[:, ::returns], turn_deg)
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
    fired = by_laser(np.isfinite(time_s))
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


def _directions(layout: PacketFormat, beams: BeamCalibration, blocks: Numbers, turn_deg: Numbers) -> Numbers:
    """(packets, firings, lasers, 3) directions of blocks (packets, firings), whose lasers fire ``turn_deg`` later."""
    block_deg = 0.01 * blocks["azimuth"]
    if layout.fine:
        block_deg = block_deg + (0.01 / 256.0) * blocks["fine"]
    if beams.mirror is None:
        elevation: Numbers = np.broadcast_to(beams.elevation, turn_deg.shape)
        azimuth = beams.azimuth - np.radians(block_deg[..., None] + turn_deg)
    else:
        elevation_deg, azimuth_deg = beams.mirror.angles_deg(block_deg)
        elevation, azimuth = np.radians(elevation_deg), np.radians(azimuth_deg - turn_deg)
    return np.stack(direction_from_angles(azimuth_rad=azimuth, elevation_rad=elevation), axis=-1)


def _main_block(mode: int, first_m: Numbers, second_m: Numbers) -> int:
    """Block of a firing that has the strongest return, or the first where the strongest is not among them: 0 or 1.

    A last return is never nearer than the strongest, and sensors of one mode differ in their order.
    """
    if mode == LAST_AND_STRONGEST:
        return int(np.sum(second_m > first_m) <= np.sum(first_m > second_m))
    return int(mode == FIRST_AND_STRONGEST)
