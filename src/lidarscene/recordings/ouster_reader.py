"""Recordings of Ouster sensors: pcap with its json, and OSF, read by the maker's ouster-sdk."""

from __future__ import annotations

import shutil
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ..errors import InputError, OptionError
from ..files.optional import import_optional
from ..formats.cloud_description import input_errors
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from .pcap_reader import json_beside, map_file, records_of, udp_datagram
from .recording import Recording
from .sweep import Second, Sweep

LONGEST_HEADER_BYTES = 32
"""Source: Ouster's packet formats: header of the newer ones, which has the serial; the oldest has none."""

VALID = 1
"""Bit of a column's status that is set if its packet was received."""


def open_ouster(path: Path, metadata: Path | None, sensor_index: int = 0) -> Recording:
    """Open the frames of one sensor of the file; incomplete frames at either end count.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    sdk = import_optional("ouster.sdk", extra="ouster")
    core = import_optional("ouster.sdk.core", extra="ouster")
    core.init_logger("critical")  # its warnings would stand between our own lines
    options: dict[str, Any] = {}
    metadata_file = path
    with ExitStack() as resources:
        if path.suffix.lower() == ".pcap":
            metadata_file = _description(path, metadata)
            with input_errors(metadata_file):
                info = core.SensorInfo(metadata_file.read_text())
            options = {"meta": [str(metadata_file)]}
            _require_one_sensor(path, core.PacketFormat.from_info(info), info)
        elif metadata is not None:
            raise OptionError("{metadata} {0}: needs a pcap; an OSF contains its metadata", metadata)
        with input_errors(path):
            file = path if options else _path_with_index(path, sensor_index, resources)
            source = sdk.open_source(str(file), index=True, collate=False, sensor_idx=sensor_index, **options)
            resources.callback(source.close)
            info = source.sensor_info[0]
            direction, origin_m = beams(core, info)
        if not len(source) and options:
            raise InputError(f"{path}: must have packets as {metadata_file} describes them, got none of that kind")
        open_source = resources.pop_all()
    recording_metadata = {
        "format": f"ouster {path.suffix.lower()[1:]}",
        "sensor": str(info.prod_line),
        "serial": str(info.sn),
        "firmware": str(info.fw_rev),
        "mode": str(info.config.lidar_mode),
        "profile": str(info.format.udp_profile_lidar),
    }

    def read(frame: int) -> Sweep:
        with input_errors(path):
            try:
                scan = source[frame][0]
            except IndexError:  # of ouster-sdk, where the file's checksum does not fit
                raise ValueError(f"frame {frame} is damaged") from None
            return _sweep(scan, info, (direction, origin_m), recording_metadata | {"frame": str(frame)})

    return Recording(
        path=path,
        count=len(source),
        read=read,
        close_file=open_source.close,
        metadata=recording_metadata,
        unit_json=str(info.to_json_string()),
    )


def _path_with_index(path: Path, sensor_index: int, resources: ExitStack) -> Path:
    """Path of the OSF, or of a copy if it has no index: ouster-sdk would write one into the recording.

    Raises:
        ValueError: if the file has no sensor of this index
    """
    osf = import_optional("ouster.sdk.osf", extra="ouster")
    source = osf.OsfFrameSetSource(str(path))
    has_index, sensors = source.is_indexed, len(source.sensor_info)
    source.close()
    if sensor_index >= sensors:
        raise ValueError(f"sensor must be 0 to {sensors - 1}, got {sensor_index}")
    if has_index:
        return path
    folder = resources.enter_context(TemporaryDirectory(prefix="lidarscene-"))
    return Path(shutil.copy(path, folder))


def _require_one_sensor(path: Path, layout: Any, info: Any) -> None:
    """Raise InputError for a damaged pcap, or one with two sensors that only their addresses tell apart.

    ouster-sdk would silently read the frames before the damage, and the packets of both as of one.
    """
    senders: dict[str, None] = {}
    port = info.config.udp_port_lidar
    with input_errors(path):
        data = map_file(path)
        for _, link, record in records_of(data, path):
            datagram = udp_datagram(data, record, link, whole=False)
            if datagram is None or datagram[0][1] != port:
                continue
            header = data[datagram[1]][:LONGEST_HEADER_BYTES]
            if len(header) == LONGEST_HEADER_BYTES and not layout.prod_sn(header) and not layout.init_id(header):
                senders[datagram[0][0]] = None
        if len(senders) > 1:
            got = f"those from {', '.join(senders)}, without serials"
            one = f"'tcpdump -r {path.name} -w one.pcap src host {next(iter(senders))}' keeps one"
            raise ValueError(f"must have packets of one sensor at port {port}, got {got}: {one}")


def beams(core: Any, info: Any) -> tuple[Numbers, Numbers]:
    """(rows, columns, 3) unit directions, and origins [m] from which ranges count, in the sensor's frame.

    The maker's table gives the point at any range r as ``direction * r + origin``, so two ranges give both.
    """
    table = core.XYZLut(info, use_extrinsics=False)
    shape = info.format.pixels_per_column, info.format.columns_per_frame
    origin_m = np.asarray(table(np.ones(shape, np.uint32)))  # one millimetre: none for a range of zero
    far_m = np.asarray(table(np.full(shape, 1_000_001, np.uint32)))
    direction = (far_m - origin_m) / 1000.0
    return direction, origin_m - 1e-3 * direction


def _description(path: Path, metadata: Path | None) -> Path:
    """Path of the json of a pcap.

    Raises:
        InputError: if there is none
    """
    if metadata is not None:
        if not metadata.is_file():
            raise InputError(f"{metadata}: no such metadata file")
        return metadata
    description = json_beside(path)
    if not description.is_file():
        must = "must have the sensor's metadata as {1} beside it, or as {metadata}"
        raise OptionError(f"{{0}}: {must}", path, description.name)
    return description


def _sweep(frame: Any, info: Any, tables: tuple[Numbers, Numbers], metadata: dict[str, str]) -> Sweep:
    rows, columns = shape = (frame.h, frame.w)
    received = (np.asarray(frame.status) & VALID) != 0
    recorded = np.broadcast_to(received, shape)
    stamps = np.asarray(frame.timestamp, np.int64)
    start_ns = int(stamps[received].min()) if received.any() else 0
    time_s = np.where(received, 1e-9 * (stamps - start_ns), np.nan)
    direction, origin_m = tables
    fields = set(frame.fields)

    if "RANGE" not in fields:
        raise ValueError("must have frames of a lidar, with RANGE, got others")

    def scalar(name: str) -> Numbers | None:
        """Field of the frame; None if it is missing, or zero everywhere, as a recorder writes what it lacks."""
        if name not in fields or not np.any(frame.field(name)):
            return None
        return np.where(recorded, frame.field(name), np.nan)

    def metres(name: str) -> Numbers:
        millimetres = np.asarray(frame.field(name), np.float64)
        return np.where(recorded & (millimetres > 0.0), 1e-3 * millimetres, np.nan)

    second = None
    if "RANGE2" in fields:
        second = Second(range_m=metres("RANGE2"), signal=scalar("SIGNAL2"), reflectivity=scalar("REFLECTIVITY2"))
    return Sweep(
        range_m=metres("RANGE"),
        recorded=recorded,
        direction=direction,
        origin_m=origin_m,
        time_s=np.broadcast_to(time_s, shape),
        signal=scalar("SIGNAL"),
        near_ir=scalar("NEAR_IR"),
        reflectivity=scalar("REFLECTIVITY"),
        second=second,
        ring=np.broadcast_to(np.arange(rows)[:, None], shape),
        column=np.broadcast_to(np.arange(columns), shape),
        start_s=1e-9 * start_ns,
        pose=_pose(frame, info, received),
        includes_lost=True,
        metadata=metadata,
    )


def _pose(frame: Any, info: Any, received: Numbers) -> Pose | None:
    """Pose of the sensor in the world at the first column received; None where the recording has no poses."""
    poses = np.asarray(frame.body_to_world)
    if not received.any() or np.array_equal(poses, np.broadcast_to(np.eye(4), poses.shape)):
        return None
    matrix = poses[int(np.argmax(received))] @ np.asarray(info.sensor_to_body)
    return Pose(position_m=matrix[:3, 3], rotation=matrix[:3, :3])
