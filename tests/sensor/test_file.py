"""Sensor files: units, poses, overrides."""

import math
from pathlib import Path

import numpy as np
import pytest

from lidarscene import catalog
from lidarscene.errors import InputError
from lidarscene.maths.pose import Pose, direction_from_angles
from lidarscene.scan import Raster
from lidarscene.sensor.catalogue import load_sensor
from lidarscene.sensor.detectors import Apd, Sipm
from lidarscene.sensor.file import PoseFile, read_sensor


def test_table_1_in_si_units() -> None:
    """Reference: Table 1 of the paper, converted by hand."""
    sensor = load_sensor("table1-apd")
    assert sensor.laser.wavelength_m == pytest.approx(905e-9, rel=1e-15)
    assert sensor.laser.peak_power_w == 45
    assert sensor.laser.pulse_fwhm_s == pytest.approx(6e-9, rel=1e-15)
    assert sensor.laser.repetition_rate_hz == 50e3
    assert sensor.optics.aperture_radius_m == 0.025
    assert sensor.optics.focal_length_m == 0.03
    assert (sensor.optics.efficiency_laser, sensor.optics.efficiency_sun) == (0.7206, 0.7986)
    assert sensor.optics.sun_irradiance_w_m2 == 29.4
    assert sensor.tdc.window_s == pytest.approx(4e-6, rel=1e-15)
    assert sensor.tdc.bandwidth_hz == 167e6
    assert sensor.tdc.threshold_to_noise == 5
    assert isinstance(sensor.detector, Apd)
    assert sensor.detector.radius_m == pytest.approx(1e-4, rel=1e-15)
    assert sensor.detector.bulk_dark_current_a == pytest.approx(1e-10, rel=1e-15)
    assert isinstance(sensor.scanner, Raster)
    assert (sensor.scanner.columns, sensor.scanner.rows) == (601, 126)
    assert sensor.scanner.azimuth_step_rad == pytest.approx(math.radians(0.2), rel=1e-15)


def test_sipm_in_si_units() -> None:
    detector = load_sensor("table1-sipm", overrides=["detector.dead_time_ns=30"]).detector
    assert isinstance(detector, Sipm)
    assert detector.dead_time_s == pytest.approx(30e-9, rel=1e-15)


def test_overrides_reach_numbers_texts_lists_and_tables() -> None:
    sensor = load_sensor(
        "table1-apd",
        overrides=[
            "detector.gain=60", "name=mine", "mounting.position_m=[0, 0, 1.5]", "mounting.yaw_deg=90",
            "tdc={ window_us = 2, bandwidth_mhz = 100, threshold_level = 1e-6, stops = 3, walk = 'raw' }",
        ],
    )  # fmt: skip
    assert isinstance(sensor.detector, Apd)
    assert (sensor.detector.gain, sensor.name) == (60, "mine")
    np.testing.assert_allclose(sensor.mounting.position_m, [0, 0, 1.5])
    np.testing.assert_allclose(sensor.mounting.rotation @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    assert (sensor.tdc.threshold_to_noise, sensor.tdc.threshold_level) == (None, 1e-6)
    assert (sensor.tdc.stops, sensor.tdc.walk) == (3, "raw")


def test_overrides_may_complete_a_file(tmp_path: Path) -> None:
    text = (catalog.folder("sensors") / "table1-apd.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("gain = 80\n", ""), encoding="utf-8")
    with pytest.raises(InputError, match=r"mine\.toml: key 'detector\.gain' is missing"):
        read_sensor(path)
    detector = load_sensor(path, overrides=["detector.gain=70"]).detector
    assert isinstance(detector, Apd)
    assert detector.gain == 70


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (["detector.afterpulse=0.1"], "afterpulse, afterpulse_ns: must be given together"),
        (["detector.crosstalk=0.1", "detector.statistics='published'"], "must be left out with statistics"),
        (["detector.crosstalk=0.1", "detector.statistics='time_domain'", "detector.counting='binomial'"],
         "must be left out with counting"),
    ],
)  # fmt: skip
def test_cells_that_fire_others_are_checked(keys: list[str], words: str) -> None:
    with pytest.raises(InputError, match=words):
        load_sensor("table1-sipm", overrides=keys)


def looks(pose: Pose) -> np.ndarray:
    return pose.rotation @ [1.0, 0.0, 0.0]


def test_positive_yaw_looks_left_and_positive_pitch_looks_up() -> None:
    """Rationale: x forward, y left, z up; Rz(yaw) Ry(-pitch) Rx(roll). Reference: exact."""
    left = PoseFile(yaw_deg=30).pose()
    np.testing.assert_allclose(looks(left), [math.sqrt(0.75), 0.5, 0], atol=1e-15)
    up = PoseFile(pitch_deg=30).pose()
    np.testing.assert_allclose(looks(up), [math.sqrt(0.75), 0, 0.5], atol=1e-15)
    both = looks(PoseFile(yaw_deg=50, pitch_deg=20, roll_deg=70).pose())
    np.testing.assert_allclose(
        both, direction_from_angles(azimuth_rad=math.radians(50), elevation_rad=math.radians(20)), atol=1e-15
    )


def test_positive_roll_turns_left_to_up() -> None:
    """Rationale: right-handed about the viewing direction, so the left side goes up."""
    rolled = PoseFile(roll_deg=90).pose()
    np.testing.assert_allclose(rolled.rotation @ [0, 1, 0], [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(looks(rolled), [1, 0, 0], atol=1e-15)


def test_the_window_ends_before_the_next_pulse() -> None:
    """An echo of the pulse before would be taken for one of this pulse: the model has no such echoes."""
    load_sensor("table1-apd", overrides=["tdc.window_us=20"])
    with pytest.raises(InputError, match=r"tdc.window_us: must be <= 20, the pulse period, got 20.1"):
        load_sensor("table1-apd", overrides=["tdc.window_us=20.1"])
