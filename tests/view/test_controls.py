"""Controls: what they offer, and that a setting is the same as a change of the files."""

import math
from pathlib import Path
from typing import Any

import pytest
from helpers.mistakes import refused, told

from lidarscene import load_scene, load_sensor
from lidarscene.catalog import path_of
from lidarscene.sensor.detectors import Apd, Sipm
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.view.controls import Control, Equipment

SIPM = "SiPM of Table 1"


def parts(sensor: Sensor) -> tuple[Any, ...]:
    """What can be compared: scanners and poses are equal only to themselves."""
    return sensor.laser, sensor.optics, sensor.detector, sensor.tdc


@pytest.fixture
def equipment(scene_file: Path) -> Equipment:
    return Equipment(load_scene(scene_file), "table1-apd", ["laser.peak_power_w=60"])


def test_files_as_they_are(equipment: Equipment) -> None:
    scene, sensor = equipment.with_settings({})
    assert scene.sun == equipment.scene.sun
    assert parts(sensor) == parts(load_sensor("table1-apd", overrides=["laser.peak_power_w=60"]))
    values = {control.key: control.value for control in equipment.controls({})}
    assert values == pytest.approx(
        {
            "sun.azimuth_deg": 180,
            "sun.elevation_deg": 45,
            "sun.illuminance_klux": 100,
            "laser.peak_power_w": 60,
            "optics.aperture_radius_mm": 25,
            "detector.gain": 80,
            "tdc.threshold_to_noise": 5,
        }
    )
    for control in equipment.controls({}):
        assert control.low < control.value < control.high


def test_every_control_does_what_the_file_would(equipment: Equipment) -> None:
    """Rationale: the sensor's keys go through the reader of sensor files; here they are compared with --set."""
    for detector in ("", SIPM):
        chosen = {"detector": detector} if detector else {}
        for control in equipment.controls(chosen):
            value = math.sqrt(control.low * control.high) if control.log else 0.5 * (control.low + control.high)
            scene, sensor = equipment.with_settings({**chosen, control.key: value})
            before = equipment.with_settings(chosen)
            if control.key.startswith("sun."):
                assert (scene.sun != before[0].sun) is (not math.isclose(value, control.value))
                assert parts(sensor) == parts(before[1])
                continue
            keeps_apd = control.key.startswith(("laser", "optics")) or not detector
            file_sensor = load_sensor(
                "table1-apd" if keeps_apd else "table1-sipm",
                overrides=["laser.peak_power_w=60", f"{control.key}={value!r}"],
            )
            part = control.key.split(".")[0]
            if part == "tdc":
                assert sensor.tdc.threshold_to_noise == file_sensor.tdc.threshold_to_noise == pytest.approx(value)
            else:
                assert getattr(sensor, part) == getattr(file_sensor, part)


def test_the_other_detector_comes_with_its_threshold(equipment: Equipment) -> None:
    _, sensor = equipment.with_settings({"detector": SIPM, "detector.pde": 0.3, "laser.peak_power_w": 70})
    assert isinstance(sensor.detector, Sipm)
    assert sensor.detector.pde == 0.3
    assert sensor.laser.peak_power_w == 70
    sipm_equipment = Equipment(equipment.scene, "table1-sipm", ["tdc.threshold_to_noise=7"])
    _, apd_sensor = sipm_equipment.with_settings({"detector": "APD of Table 1"})
    assert isinstance(apd_sensor.detector, Apd)
    assert apd_sensor.tdc.threshold_to_noise == 5
    assert sipm_equipment.sensor.tdc.threshold_to_noise == 7


test_mistakes_are_told_in_one_line = refused(
    lambda settings, equipment: equipment.with_settings(settings),
    ({"laser.colour": 1}, "laser.colour | sun.azimuth_deg"),
    ({"detector.pde": 0.2}, "detector.pde | control"),
    ({"detector": "eye"}, "detector | APD, its own, SiPM of Table 1 | eye"),
    ({"laser.peak_power_w": "much"}, "laser.peak_power_w | number | 'much'"),
    ({"laser.peak_power_w": math.inf}, "laser.peak_power_w | number | inf"),
    ({"laser.peak_power_w": True}, "laser.peak_power_w | number | True"),
    ({"laser.peak_power_w": -1}, "laser.peak_power_w | >= 1e-06 | -1.0"),
    ({"detector.gain": 0.5}, "detector.gain | >= 1 | 0.5"),
    ({"sun.illuminance_klux": -1}, "sun.illuminance_klux | >= 0 | -1"),
    ({"sun.illuminance_klux": 1e5}, "sun.illuminance_klux | <= 10000 | 100000 | 100?"),
    ({"sun.elevation_deg": 91}, "sun.elevation_deg | <= 90 | 91"),
)


def test_a_fixed_threshold_stays_with_its_own_detector(equipment: Equipment, tmp_path: Path) -> None:
    """Rationale: amperes of an APD's comparator mean nothing to a SiPM's cells."""
    text = path_of("sensors", "table1-apd").read_text(encoding="utf-8")
    path = tmp_path / "fixed.toml"
    path.write_text(text.replace("threshold_to_noise = 5", "threshold_level = 1e-6"), encoding="utf-8")
    fixed = Equipment(equipment.scene, str(path))
    assert fixed.sensor.tdc.threshold_level == 1e-6
    _, sensor = fixed.with_settings({"detector": SIPM})
    assert (sensor.tdc.threshold_level, sensor.tdc.threshold_to_noise) == (None, 5)


def test_a_counting_sensor_with_another_detector_has_that_ones_bandwidth(equipment: Equipment) -> None:
    counting = Equipment(equipment.scene, "os1-128")
    _, sensor = counting.with_settings({"detector": "APD of Table 1"})
    assert sensor.tdc.bandwidth_hz == load_sensor("table1-apd").tdc.bandwidth_hz
    assert sensor.histogram is None


@pytest.mark.parametrize(("value", "refused"), [(0.9, True), (1.0, False), (9.0, False), (9.1, True)])
def test_what_may_be_typed(value: float, refused: bool) -> None:
    control = Control(key="a.b", label="", unit="", low=2.0, high=3.0, value=2.5, least=1.0, most=9.0)
    if refused:
        with told("a.b | >= 1 | 0.9" if value < 1.0 else "a.b | <= 9 | 9.1"):
            control.check(value)
    else:
        control.check(value)
