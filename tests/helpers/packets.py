"""Frames of a spinning sensor in a world of random ranges, without tracing: what packets must give back."""

from dataclasses import replace
from typing import Any

import numpy as np

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats.cloud_columns import COLUMNS, MEASURED
from lidarscene.formats.packets.firings import Firings, FiringsBuilder
from lidarscene.formats.packets.layouts import Packet
from lidarscene.formats.packets.packet_encoder import PacketEncoder
from lidarscene.formats.packets.select_encoder import select_encoder
from lidarscene.maths.pose import direction_from_angles
from lidarscene.sensor.sensor_model import Sensor

KINDS = {column.attribute: column.dtype for column in COLUMNS}


def random_frame(sensor: Sensor, *, number: int = 0, farthest_m: float = 120.0, second: bool = False) -> PointCloud:
    """A cloud in the sensor's frame; of three pulses in ten nothing came back, of a half of the others two returns."""
    rng = np.random.default_rng(20 + number)
    scanner = sensor.scanner
    pulse = np.arange(scanner.pulses) + number * scanner.pulses
    echo_pulses = pulse[rng.random(len(pulse)) < 0.7]
    parts = [points(sensor, echo_pulses, rng.uniform(1.0, farthest_m, len(echo_pulses)), number)]
    if second:
        has_second = rng.random(len(echo_pulses)) < 0.5
        behind_m = parts[0]["range_m"][has_second] + rng.uniform(1.0, 8.0, has_second.sum())
        parts.append(points(sensor, echo_pulses[has_second], behind_m, number, return_number=2))
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    start_s = float(scanner.time_s(pulse[:1])[0])
    return PointCloud(**columns, metadata={"frame": "sensor", "frame_start_s": repr(start_s)})


def points(sensor: Sensor, pulse: Any, ranges_m: Any, number: int, *, return_number: int = 1) -> dict[str, Any]:
    """Columns of points of these pulses of a frame."""
    scanner, rng = sensor.scanner, np.random.default_rng(return_number)
    azimuth, elevation = scanner.angles(pulse)
    range_m = ranges_m.astype(np.float32)
    direction = np.stack(direction_from_angles(azimuth_rad=azimuth, elevation_rad=elevation), axis=-1)
    offset = scanner.offset_m(pulse)
    start = np.zeros((len(pulse), 3)) if offset is None else np.stack(offset, axis=-1)
    first_s = scanner.time_s(np.array([number * scanner.pulses]))[0]
    columns = {
        "xyz_m": start + range_m[:, None] * direction,
        "range_m": range_m,
        "intensity": rng.integers(0, 256, len(pulse)),
        "signal": rng.integers(1, 60_000, len(pulse)),
        "snr": rng.uniform(5.0, 90.0, len(pulse)),
        "time_s": scanner.time_s(pulse) - first_s,
        "channel": scanner.channel(pulse),
        "ring": sensor.rings(np.asarray(scanner.channel(pulse))),
        "azimuth_rad": azimuth,
        "elevation_rad": elevation,
        "return_number": np.full(len(pulse), return_number),
    }
    return {
        name: columns[name].astype(KINDS.get(name, "float64") if name != "xyz_m" else "float64")
        if name in columns
        else np.zeros(len(pulse), KINDS[name])
        for name in MEASURED
    }


def firings_of(sensor: Sensor, *clouds: PointCloud, number: int = 0, ambient: Any = None) -> Firings:
    """Firings of a frame of these clouds, or of random ranges; ``ambient`` are counts of its first pulses."""
    gathering = FiringsBuilder(sensor, number)
    for cloud in clouds or (random_frame(sensor, number=number),):
        gathering.add(cloud)
    if ambient is not None:
        gathering.ambient(np.arange(len(ambient), dtype=np.uint32) + number * sensor.scanner.pulses, ambient)
    return gathering.firings()


def cut_short(sensor: Sensor, count: int, kind: np.dtype[np.void], number: int = 0) -> list[tuple[list[float], Any]]:
    """Times and contents of the packets of a frame that ends after some firings, and of the first two of the whole."""
    firings, maker = firings_of(sensor, number=number), select_encoder(sensor)
    names = ("range_m", "intensity", "signal", "ambient", "time_s")
    filled = maker.packets(replace(firings, **{name: getattr(firings, name)[:count] for name in names}))
    filled += maker.flush()
    assert maker.flush() == []
    return [
        ([packet.time_s for packet in packets], np.frombuffer(b"".join(packet.payload for packet in packets), kind))
        for packets in (filled, select_encoder(sensor).packets(firings)[:2])
    ]


def packets_of(maker: PacketEncoder, sensor: Sensor, clouds: list[PointCloud], ambient: Any = None) -> list[Packet]:
    """Packets of these frames, the rest too; ``ambient`` are counts of every pulse of each."""
    frames = (firings_of(sensor, cloud, number=number, ambient=ambient) for number, cloud in enumerate(clouds))
    return [*(packet for frame in frames for packet in maker.packets(frame)), *maker.flush()]
