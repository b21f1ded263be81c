"""Calibrations of Velodynes: points of the maker's packets lie on the written sensor's beams."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import told

from lidarscene.recordings.units.unit_beams import Unit
from lidarscene.recordings.units.unit_file import read_unit, write_unit
from lidarscene.recordings.units.velodyne_unit import read_velodyne
from lidarscene.sensor.sensor_file import load_sensor

AZIMUTH = 4500
"""Of every block [0.01 degrees], so that nothing turns between firings."""

XML = """<?xml version="1.0"?>
<boost_serialization><DB>
<enabled_><item>1</item><item>1</item><item>0</item></enabled_>
<points_><count>3</count>
{points}
</points_></DB></boost_serialization>
"""
POINT = """<item><px><id_>{0}</id_><rotCorrection_>{1}</rotCorrection_><vertCorrection_>{2}</vertCorrection_>
<vertOffsetCorrection_>{3}</vertOffsetCorrection_><horizOffsetCorrection_>{4}</horizOffsetCorrection_></px></item>"""


def hdl64_packet() -> bytes:
    blocks = b"".join(
        struct.pack("<HH", 0xEEFF if block % 2 == 0 else 0xDDFF, AZIMUTH) + struct.pack("<HB", 10_000, 99) * 32
        for block in range(12)
    )
    return blocks + struct.pack("<IBB", 1000, 0, 0)


def channel_lists(unit: Unit) -> dict[str, np.ndarray]:
    zero = (0.0,) * len(unit.lists["elevation_deg"])
    return {
        key: np.array(unit.lists.get(key, zero))
        for key in ("elevation_deg", "azimuth_offset_deg", "forward_mm", "left_mm", "height_mm")
    }


def test_points_of_an_hdl64_lie_on_the_beams(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """Rationale: 2 mm is the acceptance. The decoder corrects x and y of near points apart, by the calibration's
    distances at two points, which is no property of a beam: it is switched off by making the two equal.
    """
    decoder, yaml = library("velodyne_decoder"), library("yaml")
    bundled = Path(decoder.__file__).parent / "calibrations" / "HDL-64E_S2.1-sztaki.yml"
    content = yaml.safe_load(bundled.read_text())
    for laser in content["lasers"]:
        laser["dist_correction_x"] = laser["dist_correction_y"] = laser["dist_correction"]
    path = tmp_path / "unit.yaml"
    path.write_text(yaml.safe_dump(content))
    config = decoder.Config()
    config.calibration, config.model = decoder.Calibration.read(str(path)), decoder.Model.HDL64E_S2
    packets = [decoder.VelodynePacket(1e-3 * number, hdl64_packet()) for number in range(4)]
    _, points = decoder.ScanDecoder(config).decode(packets)
    unit = channel_lists(read_velodyne(path))
    by_height = np.argsort(unit["elevation_deg"], kind="stable")
    laser = by_height[points[:, 6].astype(int)]
    assert set(laser) == set(range(64))
    chosen = {key: values[laser] for key, values in unit.items()}
    up, head = np.radians(chosen["elevation_deg"]), -np.radians(AZIMUTH / 100.0)
    across = head + np.radians(chosen["azimuth_offset_deg"])
    direction = np.stack([np.cos(up) * np.cos(across), np.cos(up) * np.sin(across), np.sin(up)], axis=-1)
    ahead, left = 1e-3 * chosen["forward_mm"], 1e-3 * chosen["left_mm"]
    start = np.stack(
        [
            np.cos(head) * ahead - np.sin(head) * left,
            np.sin(head) * ahead + np.cos(head) * left,
            1e-3 * chosen["height_mm"],
        ],
        axis=-1,
    )
    from_exit = points[:, :3].astype(np.float64) - start
    range_m = np.sum(from_exit * direction, axis=-1)
    assert range_m.min() > 20.0
    miss_m = np.linalg.norm(from_exit - range_m[:, None] * direction, axis=-1)
    assert miss_m.max() < 1e-4


def test_the_written_file_has_the_models_timing(tmp_path: Path, library: Callable[[str], Any]) -> None:
    decoder = library("velodyne_decoder")
    source = Path(decoder.__file__).parent / "calibrations" / "VLP-16.yml"
    report = write_unit(read_unit(source), source, tmp_path / "unit.toml")
    unit, model = load_sensor(str(tmp_path / "unit.toml")).scanner, load_sensor("vlp-16").scanner
    assert report.endswith("VLP-16, 16 beams, else as vlp-16")
    pulse = np.arange(model.pulses)
    np.testing.assert_array_equal(unit.time_s(pulse), model.time_s(pulse))
    np.testing.assert_allclose(unit.angles(pulse), model.angles(pulse), atol=1e-6)


def test_lists_for_another_number_of_lasers_are_left_out(tmp_path: Path) -> None:
    source = tmp_path / "db.xml"
    source.write_text(XML.format(points="".join(POINT.format(n, 0, n, 0, 0) for n in range(3))))
    report = write_unit(read_unit(source), source, tmp_path / "unit.toml", like="vlp-16")
    assert "firing_time_us: left out, since the model has it for another number of lasers" in report
    assert load_sensor(str(tmp_path / "unit.toml")).scanner.lasers == 2


def test_xml_is_in_degrees_and_centimetres(tmp_path: Path) -> None:
    path = tmp_path / "db.xml"
    points = [POINT.format(0, 90, -10, 20, 2.6), POINT.format(1, 0, 5, 0, 0), POINT.format(2, 0, 0, 0, 0)]
    path.write_text(XML.format(points="".join(points)))
    unit = channel_lists(read_velodyne(path))
    np.testing.assert_allclose(unit["elevation_deg"], [-10.0, 5.0])
    np.testing.assert_allclose(unit["azimuth_offset_deg"], [90.0, 0.0])
    # 2.6 cm to the left in a head that is turned to the left is 2.6 cm back.
    np.testing.assert_allclose(unit["forward_mm"], [-26.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(unit["left_mm"], [0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(unit["height_mm"], [200.0, 0.0])


def test_an_exit_next_to_an_axis_is_on_it(tmp_path: Path) -> None:
    """Rationale: 26 mm turned by 0.2 degrees are 0.09 mm aside, which a sensor file takes for metres; 0.1 mm is nothing
    against the 2 mm to which points are known.
    """
    path = tmp_path / "db.xml"
    points = [POINT.format(0, 0.2, -10, 20, 2.6), POINT.format(1, 0.3, 5, 0, 2.6), POINT.format(2, 0, 0, 0, 0)]
    path.write_text(XML.format(points="".join(points)))
    assert read_velodyne(path).lists["forward_mm"] == (0.0, pytest.approx(-0.1361, abs=1e-4))
    write_unit(read_unit(path), path, tmp_path / "unit.toml", like="vlp-16")
    assert load_sensor(str(tmp_path / "unit.toml")).scanner.lasers == 2


def test_what_is_no_calibration_is_told(tmp_path: Path, library: Callable[[str], Any]) -> None:
    library("yaml")
    for name, text, named in (
        ("a.yaml", "colour: red", "Velodyne | 'lasers' | none"),
        ("a.yaml", "lasers: [{laser_id: 1, vert_correction: 0}]", "lasers 0, 1, 2 | 1"),
        ("a.yaml", "lasers: [{laser_id: 0}]", "laser 0 | vert_correction"),
        ("a.xml", "<a><b></a>", "read"),
        ("a.txt", "", "json | Ouster | YAML or XML | Velodyne | CSV or dat | Hesai | '.txt'"),
    ):
        path = tmp_path / name
        path.write_text(text)
        with told(f"{name} | {named}"):
            read_unit(path)


ODD = (" ", "ten", "nan", "inf", "-inf", "1e999", "1,5", "0x10", "true", "[1]")


def test_odd_numbers_of_xml_are_told_by_laser_and_key(tmp_path: Path) -> None:
    """Nothing at all is zero, as the maker's program writes it."""
    path = tmp_path / "db.xml"
    for column, key in enumerate(
        ("id_", "rotCorrection_", "vertCorrection_", "vertOffsetCorrection_", "horizOffsetCorrection_")
    ):
        for odd in ODD:
            laser: list[Any] = [1, 0, 5, 0, 0]
            laser[column] = odd
            path.write_text(XML.format(points=POINT.format(0, 0, -10, 0, 0) + POINT.format(*laser)))
            kind = "whole" if key == "id_" else "finite"
            with told(f"db.xml | laser 1 | {key} | {kind} number | {odd!r}"):
                read_unit(path)


def test_odd_flags_of_xml_are_told(tmp_path: Path) -> None:
    path = tmp_path / "db.xml"
    text = XML.format(points=POINT.format(0, 0, -10, 0, 0))
    for odd in ODD:
        path.write_text(text.replace("<item>0</item>", f"<item>{odd}</item>"))
        with told(f"db.xml | enabled_ 2 | whole number | {odd!r}"):
            read_unit(path)


def test_odd_numbers_of_yaml_are_told_by_laser_and_key(tmp_path: Path, library: Callable[[str], Any]) -> None:
    yaml = library("yaml")
    path = tmp_path / "unit.yaml"
    keys = ("laser_id", "vert_correction", "rot_correction", "vert_offset_correction", "horiz_offset_correction")
    for key in keys:
        for odd in ("", "ten", "true", "[1]", "1,5", ".nan", ".inf", "-.inf", "~", "2024-01-01"):
            laser = dict.fromkeys(keys, "1") | {key: odd}
            path.write_text("lasers:\n-\n" + "".join(f"    {name}: {text}\n" for name, text in laser.items()))
            kind = "whole" if key == "laser_id" else "finite"
            with told(f"unit.yaml | laser 0 | {key} | {kind} number | {yaml.safe_load(odd)!r}"):
                read_unit(path)
    path.write_text("lasers: [1]")
    with told("unit.yaml | laser 0 | table | 1"):
        read_unit(path)
