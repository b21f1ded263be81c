"""Packets of Ouster's OS0, OS1 and OS2, encoded by the maker's ouster-sdk, and the metadata that go with them.

A packet has 16 columns; a pixel has range, reflectivity, signal and near infrared, as the profile has them. The range
counts from as far behind the axis as the beam leaves before it (`recordings.units.ouster_unit` has the equation).
"""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np

from ...errors import InputError
from ...files.optional import import_optional
from ...maths.arrays import Numbers
from ...maths.pose import Pose
from ...physics.constants import STANDARD_GRAVITY_M_S2
from ...scan.spinning import Spinning
from ...sensor.imu import Imu, ImuSamples
from ...sensor.sensor_model import Sensor
from .firings import Firings
from .layouts import OUSTER_IMU_PACKET, OUSTER_IMU_PORT, OUSTER_MODES, OUSTER_PORT, Packet
from .packet_encoder import head_deg

COLUMNS_PER_PACKET = 16
FIRMWARE = {"LEGACY": "v3.1.0", "ACCEL32_GYRO32_NMEA": "v3.2.0"}
"""Profile of the IMU -> firmware that the metadata name: a release that has it and all of the profiles below."""

IMU_PACKET_SAMPLES = 8
"""Samples in a packet of the synchronous profile, whose frames hold a whole number of packets."""

PROFILES = {
    "default": ("RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL"),
    "low-rate": ("RNG15_RFL8_NIR8", "RNG15_RFL8_NIR8_DUAL"),
    "legacy": ("LEGACY", "LEGACY"),
}
"""Profiles by our names: the maker's names, with one return and with two."""

LARGEST = {"RANGE": 2**19 - 1, "REFLECTIVITY": 255, "SIGNAL": 65535, "NEAR_IR": 65535}
LARGEST_OF = {"RNG15_RFL8_NIR8": {"RANGE": 8 * (2**15 - 1), "NEAR_IR": 16 * 255}, "LEGACY": {"RANGE": 2**20 - 1}}
"""Largest values of the fields, and those that differ, by the start of a profile's name."""


class OusterEncoder:
    """Packets of frame after frame, each of which is a whole number of packets."""

    port = OUSTER_PORT
    needs_ambient = True

    def __init__(self, sensor: Sensor, profile: str) -> None:
        assert isinstance(sensor.scanner, Spinning)
        self._scanner: Spinning = sensor.scanner
        self._dual = sensor.tdc.stops > 1 and profile != "legacy"
        self._profile = PROFILES[profile][self._dual]
        self._imu_packets = _synchronous_packets(sensor.imu, self._scanner.frame_s)
        self._text = json.dumps(_metadata(sensor, self._scanner, self._profile, self._imu_packets), indent=1)
        self._core: Any = import_optional("ouster.sdk.core", extra="ouster")
        self._core.init_logger("critical")  # its warnings would stand between our own lines
        self._info = self._core.SensorInfo(self._text)
        self._format = self._core.PacketFormat.from_info(self._info)

    @property
    def description(self) -> tuple[str, str]:
        """The sensor's metadata."""
        return self._text, ".json"

    def packets(self, frame: Firings) -> list[Packet]:
        """Packets of the whole frame."""
        lidar_frame = self._core.LidarFrame(self._info)
        lidar_frame.frame_id = frame.number // len(frame) % (self._format.max_frame_id + 1)
        lidar_frame.timestamp[:] = np.rint(1e9 * frame.time_s).astype(np.int64).clip(0)
        lidar_frame.measurement_id[:] = np.arange(len(frame))
        lidar_frame.status[:] = 1
        if frame.imu is not None and self._imu_packets:
            self._put_imu(lidar_frame, frame, frame.imu)
        for name, values in self._fields(frame).items():
            if name in lidar_frame.fields:
                lidar_frame.field(name)[:] = values.T
        encoded = self._core.frame_to_packets(lidar_frame, self._format, self._info.init_id, self._info.sn)
        payloads: dict[bool, list[bytes]] = {False: [], True: []}
        for packet in encoded:
            payloads[isinstance(packet, self._core.ImuPacket)].append(bytes(packet.buf))
        last = np.arange(1, len(payloads[False]) + 1) * COLUMNS_PER_PACKET - 1
        packets = [
            Packet(float(time), payload) for time, payload in zip(frame.time_s[last], payloads[False], strict=True)
        ]
        if frame.imu is not None and self._imu_packets:
            sent_s = frame.imu.time_s[IMU_PACKET_SAMPLES - 1 :: IMU_PACKET_SAMPLES].tolist()
            timed = zip(sent_s, payloads[True], strict=True)
            packets += [Packet(time_s, payload, OUSTER_IMU_PORT) for time_s, payload in timed]
        elif frame.imu is not None:
            packets += _legacy_imu_packets(frame.imu)
        return sorted(packets)

    def _put_imu(self, lidar_frame: Any, frame: Firings, samples: ImuSamples) -> None:
        """Put the samples of a frame into the maker's fields, each with the column that was measured then."""
        stamps_ns = np.rint(1e9 * samples.time_s).astype(np.int64).clip(0)
        column = np.searchsorted(frame.time_s, samples.time_s, side="right") - 1
        values = {
            "IMU_ACC": samples.specific_force_m_s2,
            "IMU_GYRO": samples.angular_velocity_rad_s,
            "IMU_TIMESTAMP": stamps_ns,
            "IMU_MEASUREMENT_ID": column.clip(0),
            "IMU_STATUS": 1,
            "IMU_PACKET_TIMESTAMP": stamps_ns[IMU_PACKET_SAMPLES - 1 :: IMU_PACKET_SAMPLES],
        }
        for name, array in values.items():
            lidar_frame.field(name)[...] = array

    def flush(self) -> list[Packet]:
        """No packets: none waits for the next frame."""
        return []

    def _fields(self, frame: Firings) -> dict[str, Numbers]:
        """(columns, rows) arrays by the maker's names of the fields."""
        largest = LARGEST | next(
            (differing for start, differing in LARGEST_OF.items() if self._profile.startswith(start)), {}
        )
        behind_m = 1e-3 * _beam_origin_mm(self._scanner)

        def clipped(values: Numbers, name: str) -> Numbers:
            return np.rint(values).clip(0, largest[name])

        fields = {"NEAR_IR": clipped(frame.ambient, "NEAR_IR")}
        for index, end in enumerate(("", "2")):
            range_m = frame.range_m[..., index]
            millimetres = np.rint(1e3 * (range_m + behind_m))
            fields[f"RANGE{end}"] = np.where((range_m > 0.0) & (millimetres <= largest["RANGE"]), millimetres, 0.0)
            fields[f"REFLECTIVITY{end}"] = clipped(frame.intensity[..., index], "REFLECTIVITY")
            fields[f"SIGNAL{end}"] = clipped(frame.signal[..., index], "SIGNAL")
        return fields


def _synchronous_packets(imu: Imu | None, frame_s: float) -> int:
    """IMU packets in a frame; 0 of a rate that the synchronous profile cannot have, as the 100 Hz of the legacy one."""
    if imu is None:
        return 0
    packets = imu.rate_hz * frame_s / IMU_PACKET_SAMPLES
    return round(packets) if packets >= 1.0 and abs(packets - round(packets)) < 1e-9 else 0


def _legacy_imu_packets(samples: ImuSamples) -> list[Packet]:
    """One packet for each sample."""
    payloads = np.zeros(len(samples), OUSTER_IMU_PACKET)
    for stamp in ("system_ns", "force_ns", "angular_ns"):
        payloads[stamp] = np.rint(1e9 * samples.time_s).astype(np.int64).clip(0)
    payloads["force_g"] = samples.specific_force_m_s2 / STANDARD_GRAVITY_M_S2
    payloads["angular_deg_s"] = np.degrees(samples.angular_velocity_rad_s)
    return [
        Packet(time_s, payload.tobytes(), OUSTER_IMU_PORT)
        for time_s, payload in zip(samples.time_s.tolist(), payloads, strict=True)
    ]


def match_ouster(sensor: Sensor, profile: str) -> OusterEncoder | None:
    """Encoder for a sensor whose lasers all fire at once and that counts photons, as an Ouster; None for another."""
    scanner = sensor.scanner
    if not isinstance(scanner, Spinning) or np.ptp(scanner.firing_s) > 0.0 or sensor.histogram is None:
        return None
    return OusterEncoder(sensor, profile)


def _metadata(sensor: Sensor, scanner: Spinning, profile: str, imu_packets: int) -> dict[str, Any]:
    """Metadata in the words of the sensor's own json.

    Raises:
        InputError: for a sensor that no Ouster can be
    """
    imu_profile = "ACCEL32_GYRO32_NMEA" if imu_packets else "LEGACY"
    firmware = FIRMWARE[imu_profile]
    mode = f"{scanner.cycles}x{round(1.0 / scanner.frame_s)}"
    if mode not in OUSTER_MODES:
        raise InputError(
            f"sensor '{sensor.name}': an Ouster's packets must have columns and turns of "
            f"{', '.join(OUSTER_MODES)}, got {mode}"
        )
    rows = scanner.lasers
    start_rad = np.radians(head_deg(scanner, np.array([0]))[0])
    cos, sin = round(float(np.cos(start_rad)), 9), round(float(np.sin(start_rad)), 9)
    start = (np.zeros(rows),) * 3 if scanner.start_m is None else [coordinate.values for coordinate in scanner.start_m]
    forward_mm, left_mm, up_mm = (1e3 * np.asarray(coordinate_m) for coordinate_m in start)
    if np.ptp(forward_mm) > 1e-6 or np.ptp(up_mm) > 1e-6 or np.abs(left_mm).max() > 1e-6:
        raise InputError(
            f"sensor '{sensor.name}': an Ouster's beams must leave from one height and one place before the axis"
        )
    origin_mm = _beam_origin_mm(scanner)
    number = re.search(r"os-?([012])", sensor.name, re.IGNORECASE)
    family = f"OS-{number[1]}" if number else "OS-1"
    metadata = {
        "prod_line": f"{family}-{rows}",
        "prod_sn": "1",
        "prod_pn": "",
        "status": "RUNNING",
        "image_rev": f"ousteros-image-prod-bootes-{firmware}",
        "build_rev": firmware,
        "build_date": "",
        "initialization_id": 1,
        "udp_port_lidar": OUSTER_PORT,
        "udp_port_imu": OUSTER_IMU_PORT,
        "lidar_mode": mode,
        "json_calibration_version": 4,
        "hostname": "",
        "client_version": "lidarscene",
        "beam_altitude_angles": np.degrees(scanner.elevation_rad.values).tolist(),
        "beam_azimuth_angles": (-np.degrees(scanner.azimuth_rad.values)).tolist(),
        "lidar_origin_to_beam_origin_mm": origin_mm,
        "beam_to_lidar_transform": [1, 0, 0, origin_mm, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
        "lidar_to_sensor_transform": [cos, -sin, 0, 0, sin, cos, 0, 0, 0, 0, 1, float(up_mm[0]), 0, 0, 0, 1],
        "imu_to_sensor_transform": _matrix_mm(Pose() if sensor.imu is None else sensor.imu.pose),
        "data_format": {
            "columns_per_frame": scanner.cycles,
            "columns_per_packet": COLUMNS_PER_PACKET,
            "column_window": [0, scanner.cycles - 1],
            "pixels_per_column": rows,
            # Where pixels of one direction stand in a picture: as many columns on as the laser looks back.
            "pixel_shift_by_row": np.rint(-scanner.azimuth_rad.values / (2.0 * np.pi) * scanner.cycles)
            .astype(int)
            .tolist(),
            "udp_profile_imu": imu_profile,
            "udp_profile_lidar": profile,
        },
    }
    imu_format = {"imu_measurements_per_packet": IMU_PACKET_SAMPLES, "imu_packets_per_frame": imu_packets}
    return metadata | ({"imu_data_format": imu_format} if imu_packets else {})


def _matrix_mm(pose: Pose) -> list[float]:
    """(4, 4) matrix of a pose row by row, in millimetres."""
    rows = np.column_stack([pose.rotation, 1e3 * pose.position_m]).round(9)
    return [*rows.ravel().tolist(), 0, 0, 0, 1]


def _beam_origin_mm(scanner: Spinning) -> float:
    return 0.0 if scanner.start_m is None else float(1e3 * scanner.start_m[0].values[0])
