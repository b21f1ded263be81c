"""Parts of another sensor: what goes with each, and that every way to ask for one gives the same sensor."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.run_seed import chosen

from lidarscene import Sensor, catalog, load_sensor
from lidarscene.files.overrides import toml_text
from lidarscene.sensor.rig_file import load_rig
from lidarscene.sensor.sensor_file import files_of_sensor
from lidarscene.studies.ranging.subjects import subjects

HELD = ("window_s", "blanking_s", "keep", "stops")
"""Fields of the converter that stay when the detector is another's."""


def held(tdc: Any) -> dict[str, Any]:
    return {name: getattr(tdc, name) for name in HELD}


@pytest.mark.parametrize(
    ("name", "donor"), [("apd-905", "sipm-905"), ("apd-905", "vlp-16"), ("vlp-16", "sipm-905"), ("at128", "livox-avia")]
)
def test_a_detector_comes_with_its_electronics(name: str, donor: str) -> None:
    """Amplifier, threshold and sampler are the donor's; beam, lens, scan, window and kept returns stay."""
    own, other = load_sensor(name), load_sensor(donor)
    exchanged = own.with_detector(donor)
    for field in ("detector", "receiver", "histogram"):
        assert getattr(exchanged, field) == getattr(other, field)
    assert exchanged.tdc == dataclasses.replace(other.tdc, **held(own.tdc))
    assert (exchanged.sampler is None) == (other.sampler is None)
    for field in ("laser", "optics", "intensity", "name"):
        assert getattr(exchanged, field) == getattr(own, field)
    assert exchanged.scanner.pulses == own.scanner.pulses


@pytest.mark.parametrize("name", chosen(12, catalog.names("sensors")))
def test_a_saved_sensor_is_the_sensor(name: str, tmp_path: Path) -> None:
    """Reference: the sensor itself, with what was replaced, from another folder than its files."""
    sensor = load_sensor(name).replace("laser.divergence_mrad=2.5", peak_power_w=33.0)
    assert sensor.laser.peak_power_w == 33.0
    (tmp_path / "elsewhere").mkdir()
    sensor.save(tmp_path / "elsewhere/mine.toml")
    saved = load_sensor(tmp_path / "elsewhere/mine.toml")
    for field in dataclasses.fields(Sensor):
        if field.name != "origin":
            assert repr(getattr(saved, field.name)) == repr(getattr(sensor, field.name))


def test_spads_come_with_their_histogram_and_go_with_it() -> None:
    """No converter of the own sensor is left behind, none is missing: the window is then the donor's."""
    counting = load_sensor("apd-905").with_detector("os1-128")
    assert counting.histogram is not None
    assert counting.detector == load_sensor("os1-128").detector
    timing = load_sensor("os1-128").with_detector("sipm-905")
    assert timing.histogram is None
    assert timing.tdc == load_sensor("sipm-905").tdc


def test_the_rate_of_the_pulses_goes_with_the_scanner() -> None:
    own, other = load_sensor("apd-905"), load_sensor("vlp-16")
    rate_hz = own.laser.repetition_rate_hz
    assert own.with_laser("vlp-16").laser == dataclasses.replace(other.laser, repetition_rate_hz=rate_hz)
    scanning = own.with_scanner("vlp-16")
    assert scanning.laser == dataclasses.replace(own.laser, repetition_rate_hz=other.laser.repetition_rate_hz)
    assert scanning.scanner.pulses == other.scanner.pulses
    assert own.with_optics("vlp-16").optics.focal_length_m == other.optics.focal_length_m
    assert own.with_optics("vlp-16").laser == own.laser


def test_every_way_to_ask_gives_the_same_sensor(tmp_path: Path) -> None:
    """Python, `--set` in any order, a table in place of a name, a subject of `range` and a rig beside the donor."""
    expected = load_sensor("apd-905").with_detector("sipm-905").replace("detector.cells=1600")
    changes = ["detector.cells=1600", "detector=sipm-905"]
    (subject,) = subjects(["apd-905"], changes)
    (tmp_path / "theirs.toml").write_bytes(catalog.path_of("sensors", "sipm-905").read_bytes())
    rig = tmp_path / "rig.toml"
    rig.write_text(
        '[[sensors]]\nlabel = "a"\nsensor = "apd-905"\nset = ["detector=theirs.toml", "detector.cells=1600"]\n'
    )
    ways: list[Sensor] = [
        load_sensor("apd-905", overrides=changes),
        load_sensor("apd-905", overrides=changes[::-1]),
        load_sensor("apd-905", overrides={"detector": Path(tmp_path / "theirs.toml"), "detector.cells": 1600}),
        load_sensor("apd-905").replace(detector="sipm-905").replace(changes[0]),
        subject.sensor(),
        load_rig(rig).sensors[0].sensor,
    ]
    for sensor in ways:
        assert (sensor.detector, sensor.tdc, sensor.laser) == (expected.detector, expected.tdc, expected.laser)
    assert expected.detector.cells == 1600


def test_what_was_changed_before_is_replaced_with_its_part() -> None:
    """A gain that was set means nothing to the SiPM that comes later; the power stays."""
    changed = load_sensor("apd-905", overrides=["detector.gain=60", "laser.peak_power_w=10", "tdc.window_us=2"])
    exchanged = changed.with_detector("sipm-905")
    assert exchanged.detector == load_sensor("sipm-905").detector
    assert exchanged.laser.peak_power_w == 10.0
    assert exchanged.tdc.window_s == pytest.approx(2e-6)
    assert exchanged.with_detector("apd-905").detector == load_sensor("apd-905").detector


def test_sources_and_uncertainties_are_those_of_the_numbers() -> None:
    own, other = load_sensor("apd-905"), load_sensor("sipm-905")
    exchanged = own.with_detector("sipm-905")
    assert "detector.gain" not in exchanged.sources
    for key in ("detector.pde", "tdc.threshold_to_noise", "tdc.bandwidth_mhz"):
        assert exchanged.source_of(key) == other.source_of(key)
    for key in ("laser.peak_power_w", "tdc.window_us"):
        assert exchanged.source_of(key) == own.source_of(key)
    theirs = {key for key in other.uncertainty if key.startswith(("detector.", "tdc."))}
    ours = {key for key in own.uncertainty if not key.startswith(("detector.", "tdc."))}
    assert set(exchanged.uncertainty) == theirs | ours
    # Neither does a table in place of the file's leave those of its numbers behind.
    detector = {"type": "sipm", "cells": 9, "radius_mm": 0.1, "pde": 0.2, "dead_time_ns": 6, "dark_count_rate_hz": 9}
    replaced = own.replace(f"detector={toml_text(detector)}")
    assert not [key for key in replaced.uncertainty if key.startswith("detector.")]


def test_files_of_a_part_lie_beside_the_sensor_that_names_them(tmp_path: Path) -> None:
    """The pattern of the donor is found from its folder, and is one of the files that the sensor rests on."""
    folder = tmp_path / "theirs"
    folder.mkdir()
    rows = "".join(f"{azimuth},0,{number * 2e-5:.6f}\n" for number, azimuth in enumerate((-5, 0, 5)))
    (folder / "rose.csv").write_text(f"azimuth_deg,elevation_deg,time_s\n{rows}")
    text = catalog.path_of("sensors", "apd-905").read_text(encoding="utf-8")
    before, after = text.split("[scanner]")
    rose = '[scanner]\ntype = "table"\nfile = "rose.csv"\nframe_ms = 1\n\n[detector]'
    (folder / "rose.toml").write_text(before + rose + after.split("[detector]")[1], encoding="utf-8")
    change = f"scanner={folder / 'rose.toml'}"
    sensor = load_sensor("apd-905", overrides=[change])
    assert sensor.scanner.pulses == 3
    np.testing.assert_allclose(sensor.scanner.angles(np.arange(3))[0], np.radians([-5, 0, 5]), atol=1e-6)
    own = catalog.path_of("sensors", "apd-905")
    assert set(files_of_sensor(own, overrides=[change])) == {own, folder / "rose.toml", folder / "rose.csv"}


def test_the_range_is_that_of_the_detector_alone() -> None:
    """The echo is the same; only what the detector makes of it differs, so a SiPM's range is another."""
    own = load_sensor("my-apd")
    exchanged = own.with_detector("sipm-905")
    background_w = np.array([1e-9])
    noise = [float(sensor.working_point(background_w).noise.deviation[0]) for sensor in (own, exchanged)]
    assert not math.isclose(*noise)
    by_hand = dataclasses.replace(load_sensor("sipm-905"), laser=own.laser, optics=own.optics)
    assert noise[1] == pytest.approx(float(by_hand.working_point(background_w).noise.deviation[0]), rel=1e-12)
