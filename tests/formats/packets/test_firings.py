"""Frames pulse by pulse: each return at its firing and laser, the strongest first, whatever the pieces."""

import numpy as np
import pytest
from helpers.packets import firings_of, points, random_frame

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats.packets.firings import FiringsBuilder
from lidarscene.sensor.sensor_file import load_sensor


@pytest.mark.parametrize("name", ["vlp-16", "pandar64"])
def test_pieces_make_the_frame(name: str) -> None:
    """A later frame, of lasers that fire in the order of their numbers and of others."""
    sensor = load_sensor(name)
    cloud = random_frame(sensor, number=2, second=True)
    parts = np.array_split(np.random.default_rng(0).permutation(len(cloud)), 3)
    frame = firings_of(sensor, *map(cloud.select, parts), number=2)
    scanner = sensor.scanner
    assert frame.number == 2 * scanner.cycles
    assert np.count_nonzero(frame.range_m) == len(cloud)
    cycle = ((cloud.time_s + 1e-9) // scanner.cycle_s).astype(int)
    is_second = cloud.return_number == 2
    for rows, number in ((~is_second, 1), (is_second, 2)):
        stored = frame.range_m[cycle[rows], cloud.channel[rows]]
        assert (stored == cloud.range_m[rows, None]).any(axis=1).all(), number
    signal = frame.signal
    assert (signal[..., 0] >= signal[..., 1]).all()
    np.testing.assert_allclose(
        frame.time_s, 2 * scanner.frame_s + scanner.cycle_s * np.arange(scanner.cycles), atol=1e-9
    )


@pytest.mark.parametrize(
    ("signals", "kept_signals", "ranges_m"),
    [
        ((20.0, 5.0, 30.0), [30.0, 20.0], [13.0, 11.0]),
        ((20.0, 5.0, 10.0), [20.0, 10.0], [11.0, 13.0]),
        ((20.0, 10.0, 5.0), [20.0, 10.0], [11.0, 12.0]),
    ],
)
def test_of_three_returns_the_two_strongest_stay(signals, kept_signals, ranges_m):
    sensor = load_sensor("vlp-16")
    columns = [
        points(sensor, np.array([5]), np.array([10.0 + number]), 0, return_number=number) for number in (1, 2, 3)
    ]
    for column, signal in zip(columns, signals, strict=True):
        column["signal"] = np.array([signal], np.float32)
    together = {name: np.concatenate([column[name] for column in columns]) for name in columns[0]}
    frame = firings_of(sensor, PointCloud(**together, metadata={"frame": "sensor"}))
    assert frame.signal[0, 5].tolist() == kept_signals
    assert frame.range_m[0, 5].tolist() == ranges_m


def test_the_stronger_of_two_is_that_of_the_higher_snr_where_nothing_counts_photons() -> None:
    sensor = load_sensor("vlp-16")
    parts = [points(sensor, np.array([5]), np.array([10.0 + n]), 0, return_number=n) for n in (1, 2)]
    for part, snr in zip(parts, (7.0, 9.0), strict=True):
        part["snr"], part["signal"] = np.array([snr], np.float32), np.zeros(1, np.float32)
    frame = firings_of(sensor, *(PointCloud(**part, metadata={"frame": "sensor"}) for part in parts))
    assert frame.range_m[0, 5].tolist() == [12.0, 11.0]


def test_a_cycle_may_begin_before_its_first_laser_fires() -> None:
    """The cycle takes 97.7 us, in which all lasers of an OS1 fire after 80 us."""
    sensor = load_sensor(
        "os1-128", overrides={"scanner.columns_per_turn": 1024, "scanner.firing_time_us": [80.0] * 128}
    )
    frame = firings_of(sensor, PointCloud(**points(sensor, np.array([0, 128]), np.array([10.0, 20.0]), 0)))
    laser = int(sensor.scanner.channel(np.zeros(1, np.uint32))[0])
    assert frame.range_m[:2, laser, 0].tolist() == [10.0, 20.0]


@pytest.mark.parametrize("number", [1, 3])
def test_background_is_of_lost_pulses_too(number: int) -> None:
    """Background stands by laser, though pulses come in the order of firing."""
    sensor = load_sensor("pandar64")
    gathering = FiringsBuilder(sensor, number)
    pulse = np.arange(sensor.scanner.pulses, dtype=np.uint32) + number * sensor.scanner.pulses
    gathering.ambient(pulse, sensor.scanner.channel(pulse).astype(np.uint64))
    assert (gathering.firings().ambient == np.arange(64)).all()
