"""OSI: as betterosi reads it."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import osi_messages, value_at

from lidarscene.formats.osi import timestamp

N = 50


@pytest.mark.parametrize("truth", [False, True])
@pytest.mark.slow
def test_osi_in_betterosi(tmp_path: Path, library: Any, truth: bool) -> None:
    """Reference: betterosi, from the OSI group's own definitions."""
    columns = {"channel": np.arange(N) * 1000, "sensor_index": np.zeros(N)}
    cloud = small_cloud(N, truth=truth, metadata={"frame_start_s": "2.25"}, **columns)
    cloud.save(tmp_path / "a.osi")
    (data,) = osi_messages(tmp_path / "a.osi", "SensorData", library)
    assert (data.timestamp.seconds, data.timestamp.nanos) == (2, 250_000_000)
    (lidar,) = data.feature_data.lidar_sensor
    assert lidar.header.number_of_valid_detections == len(lidar.detection) == N
    get = lambda *path: np.array([value_at(detection, path) for detection in lidar.detection])  # noqa: E731
    np.testing.assert_array_equal(get("position", "distance"), cloud.range_m)
    np.testing.assert_array_equal(get("position", "azimuth"), cloud.azimuth_rad)
    np.testing.assert_array_equal(get("position", "elevation"), cloud.elevation_rad)
    np.testing.assert_array_equal(get("existence_probability"), cloud.detection_probability)
    np.testing.assert_array_equal(get("beam_id", "value"), cloud.channel)
    np.testing.assert_array_equal(get("classification"), np.where(cloud.status, 3, 0))
    assert get("intensity").max() == pytest.approx(100.0)
    np.testing.assert_allclose(get("intensity"), 100.0 * cloud.intensity / cloud.intensity.max(), rtol=1e-6)
    np.testing.assert_allclose(get("echo_pulse_width"), 149_896_229.0 * cloud.pulse_width_s.astype(float), rtol=1e-12)
    if truth:
        np.testing.assert_array_equal(get("reflectivity"), cloud.reflectivity)
        np.testing.assert_array_equal(get("radial_velocity"), -cloud.radial_velocity_m_s)  # towards the sensor
        expected = [int(body) + 1 if body >= 0 else 2**64 - 1 for body in cloud.body]
        assert [detection.object_id.value for detection in lidar.detection] == expected
    else:
        assert not lidar.detection[0].has_field("object_id")


def test_sensors_of_a_rig_are_apart_in_osi(tmp_path: Path, library: Any) -> None:
    """Rationale: positions are in each sensor's own frame."""
    cloud = small_cloud(N)
    assert 0 < np.count_nonzero(cloud.sensor_index) < N
    cloud.save(tmp_path / "a.osi")
    (data,) = osi_messages(tmp_path / "a.osi", "SensorData", library)
    lidars = data.feature_data.lidar_sensor
    assert [lidar.header.sensor_id.value for lidar in lidars] == [0, 1]
    for index, lidar in enumerate(lidars):
        distances_m = [d.position.distance for d in lidar.detection]
        np.testing.assert_array_equal(distances_m, cloud.range_m[cloud.sensor_index == index])


def test_an_empty_osi_frame(tmp_path: Path, library: Any) -> None:
    small_cloud(0).save(tmp_path / "a.osi")
    (data,) = osi_messages(tmp_path / "a.osi", "SensorData", library)
    assert len(data.feature_data.lidar_sensor[0].detection) == 0


def test_every_lidar_has_its_own_count_and_time(tmp_path: Path, library: Any) -> None:
    """1.001 s are 1,000,999,999.9999999 ns in floating point: the nearest whole number is right."""
    cloud = small_cloud(N, metadata={"frame_start_s": "1.001"})
    cloud.save(tmp_path / "a.osi")
    (data,) = osi_messages(tmp_path / "a.osi", "SensorData", library)
    assert (data.timestamp.seconds, data.timestamp.nanos) == (1, 1_000_000)
    lidars = data.feature_data.lidar_sensor
    for index, lidar in enumerate(lidars):
        time = lidar.header.measurement_time
        assert (time.seconds, time.nanos) == (1, 1_000_000)
        assert lidar.header.number_of_valid_detections == np.count_nonzero(cloud.sensor_index == index)


@pytest.mark.parametrize("seconds", [0.0, 1.001, 0.1 + 0.2, 1.1 - 0.2, 4.35, 1_700_000_000.57])
def test_times_are_to_the_nearest_nanosecond(seconds: float) -> None:
    """Reference: the number itself, as a fraction; a wire of fields 1 and 2, seven bits a byte."""
    content, numbers = timestamp(1, seconds), []
    offset = 2
    while offset < len(content):
        value, shift, offset = 0, 0, offset + 1
        while content[offset] & 0x80:
            value, shift, offset = value | (content[offset] & 0x7F) << shift, shift + 7, offset + 1
        numbers.append(value | content[offset] << shift)
        offset += 1
    seconds_part, nanoseconds = numbers
    assert nanoseconds < 10**9
    # A product of two doubles is rounded once: of 1.7e9 s to 256 ns.
    error_s = abs(Fraction(seconds_part) + Fraction(nanoseconds, 10**9) - Fraction(seconds))
    assert error_s <= Fraction(1, 2 * 10**9) + Fraction(seconds) * Fraction(2) ** -53
