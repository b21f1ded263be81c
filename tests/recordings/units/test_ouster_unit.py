"""Metadata of Ousters: the written sensor's beams are those of the maker's own table."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.recordings import OUSTER

from lidarscene.physics.optics.radiometry import range_from_time_of_flight_m
from lidarscene.recordings.units.unit_file import read_unit, write_unit
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.sensor.sensor_model import Sensor

JSON = OUSTER.with_suffix(".json")
RANGE_M = 50.0


def write_and_load(folder: Path, source: Path = JSON, mode: str | None = None) -> Sensor:
    write_unit(read_unit(source, mode), source, folder / "unit.toml")
    return load_sensor(str(folder / "unit.toml"))


@pytest.mark.parametrize("mode", ["512x10", "1024x20", "2048x10"])
def test_points_are_those_of_the_makers_table(tmp_path: Path, library: Callable[[str], Any], mode: str) -> None:
    """Rationale: 2 mm at 50 m is the acceptance; single precision of the beams is worth 0.02 mm there."""
    core = library("ouster.sdk.core")
    scanner = write_and_load(tmp_path, mode=mode).scanner
    content = json.loads(JSON.read_text())
    wide = int(mode.partition("x")[0])
    content["data_format"] |= {"columns_per_frame": wide, "column_window": [0, wide - 1]}
    info = core.SensorInfo(json.dumps(content | {"lidar_mode": mode}))
    rows, columns = info.format.pixels_per_column, info.format.columns_per_frame
    expected = np.asarray(
        core.XYZLut(info, use_extrinsics=False)(np.full((rows, columns), int(1e3 * RANGE_M), np.uint32))
    )
    pulse = np.arange(scanner.pulses)
    beams = np.stack(scanner.angles(pulse), axis=-1)
    direction = np.stack(
        [np.cos(beams[:, 1]) * np.cos(beams[:, 0]), np.cos(beams[:, 1]) * np.sin(beams[:, 0]), np.sin(beams[:, 1])],
        axis=-1,
    )
    # The maker counts the range from n behind the exit.
    behind_m = 1e-3 * info.beam_to_lidar_transform[0, 3]
    ours = np.stack(scanner.offset_m(pulse), axis=-1) + (RANGE_M - behind_m) * direction
    assert expected.shape == (rows, columns, 3)
    np.testing.assert_allclose(ours.reshape(columns, rows, 3).transpose(1, 0, 2), expected, atol=1e-4)


def test_modes_give_columns_turns_and_the_rate(tmp_path: Path) -> None:
    sensor = write_and_load(tmp_path, mode="512x20")
    assert (sensor.scanner.pulses, sensor.scanner.frame_s) == (512 * 32, 0.05)
    assert float(sensor.laser.repetition_rate_hz) == pytest.approx(512 * 32 * 20)
    assert sensor.name == "OS-0-32-U1 992137000142"
    assert sensor.sources["scanner"] == "unit-specific: os0-32-one-packet.json"
    assert write_and_load(tmp_path).scanner.pulses == 1024 * 32


def test_ranges_have_the_steps_of_their_profile(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """Steps by the bits that the maker's own library reads; rationale: an OS1-128's of 8 mm told it from its twin."""
    core = library("ouster.sdk.core")
    content, steps_mm = json.loads(JSON.read_text()), {}
    for name in (name for name in core.UDPProfileLidar.__members__ if "RNG" in name):
        content["data_format"]["udp_profile_lidar"] = name
        (tmp_path / "unit.json").write_text(json.dumps(content))
        mask = core.PacketFormat(core.SensorInfo(json.dumps(content))).field_value_mask("RANGE")
        step_s = write_and_load(tmp_path, tmp_path / "unit.json").tdc.least_significant_bit_s
        steps_mm[name] = mask & -mask
        step_mm = 1e3 * range_from_time_of_flight_m(time_of_flight_s=step_s)
        assert step_mm == pytest.approx(steps_mm[name], rel=1e-5), name
    assert set(steps_mm.values()) == {1, 8}


def test_first_firmware_does_not_say_where_the_beams_begin(tmp_path: Path) -> None:
    """Rationale: the maker's library takes 27.67 mm for an OS0 then (firmware 1.14)."""
    old = {key: value for key, value in json.loads(JSON.read_text()).items() if "origin" not in key}
    old.pop("beam_to_lidar_transform", None)
    source = tmp_path / "old.json"
    source.write_text(json.dumps(old), encoding="utf-16")  # as of PowerShell
    assert read_unit(source).lists["forward_mm"][0] == 27.67


@pytest.mark.parametrize(
    ("firmware", "product", "model"),
    [
        ({"build_rev": "v3.0.1"}, "OS-0-128", "os0-128-rev7"),
        (
            {"build_rev": "767798045", "image_rev": "ousteros-image-dev-bootes-v3.1.0-alpha.1+2023"},
            "OS-1-128",
            "os1-128-rev7",
        ),
        ({"build_rev": "", "image_rev": "ousteros-image-prod-bootes-v3.2.0-rc.5+2025"}, "OS-DOME-128", "osdome-128"),
        ({"build_rev": "v2.5.2", "image_rev": "ousteros-image-prod-aries-v2.5.2+2023"}, "OS-2-128", "os2-128"),
        ({"build_rev": "", "image_rev": ""}, "OS-2-128", "os2-128"),
    ],
)
def test_firmware_3_is_of_revision_7(tmp_path: Path, firmware: dict[str, str], product: str, model: str) -> None:
    source = tmp_path / "a.json"
    source.write_text(json.dumps(json.loads(JSON.read_text()) | firmware | {"prod_line": product}))
    assert read_unit(source).model == model


def test_what_is_wrong_is_one_line(tmp_path: Path) -> None:
    source = tmp_path / "a.json"

    def check(named: str, mode: str | None = None, **changes: object) -> None:
        source.write_text(json.dumps(json.loads(JSON.read_text()) | changes))
        with told(named):
            write_unit(read_unit(source, mode), source, tmp_path / "a.toml")
        assert not (tmp_path / "a.toml").exists()

    check("beam_azimuth_angles | 32 entries | beam_altitude_angles | 2", beam_azimuth_angles=[0.0, 1.0])
    check("lidar_mode | 512x10 | 'fast'", lidar_mode="fast")
    check("lidar_mode | 512x10 | '10x'", mode="10x")
    on_its_side = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]
    check("lidar_to_sensor_transform | z", lidar_to_sensor_transform=on_its_side)
    check("32 beams | like", prod_line="XX")
    for key in ("lidar_to_sensor_transform", "beam_to_lidar_transform"):
        check(f"{key} | 16 numbers | [1, 2]", **{key: [1, 2]})
        check(f"{key}[15] | finite number | None", **{key: [1] * 15 + [None]})
    check("beam_azimuth_angles[1] | finite number | 'x'", beam_azimuth_angles=[1, "x"])
    source.write_text("{")
    with told("a.json"):
        read_unit(source)


@pytest.mark.parametrize("window", [None, 5, [], "all", [0, 90000]])
def test_an_odd_azimuth_window_is_a_comment(tmp_path: Path, window: object) -> None:
    source = tmp_path / "a.json"
    source.write_text(json.dumps(json.loads(JSON.read_text()) | {"azimuth_window": window}))
    assert f"azimuth window {window} in millidegrees is not taken over" in read_unit(source).comments[1]


@pytest.mark.parametrize("key", ["build_rev", "prod_sn", "prod_line"])
@pytest.mark.parametrize(
    "text", ['v2\nmounting.position_m = [9, 9, 9]\n# "', '"\nlaser = 1 #', "a\x00b\x7f\u2028c", "\ud800", "\\", "'''"]
)
def test_text_of_the_metadata_stays_text(tmp_path: Path, key: str, text: str) -> None:
    """Rationale: the file comes from anyone. It must not set a key of the file that is written."""
    source = tmp_path / "a\n.json"
    source.write_text(json.dumps(json.loads(JSON.read_text()) | {key: text}))
    write_unit(read_unit(source), source, tmp_path / "a.toml", like="os1-128")
    written = tomllib.loads((tmp_path / "a.toml").read_text(encoding="utf-8"))
    source.write_text(JSON.read_text())
    write_unit(read_unit(source), source, tmp_path / "b.toml", like="os1-128")
    plain = tomllib.loads((tmp_path / "b.toml").read_text(encoding="utf-8"))
    for tables in (written, plain):
        del tables["name"], tables["description"]
    if key == "prod_line":  # it also says which heads have which exits
        del written["scanner"], plain["scanner"]
    assert written == plain


def test_transforms_of_the_metadata(tmp_path: Path) -> None:
    """A head whose zero is to the left, beams 5 mm above the lidar's middle; and a file that names no product has the
    origin of an OS1 of the first generation (ouster_client: default_lidar_origin_to_beam_origin_mm, 12.163).
    """
    content = json.loads(JSON.read_text())
    source = tmp_path / "a.json"
    turned = [0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1]
    beams = [1, 0, 0, 27.0, 0, 1, 0, 0, 0, 0, 1, 5.0, 0, 0, 0, 1]
    source.write_text(json.dumps(content | {"lidar_to_sensor_transform": turned, "beam_to_lidar_transform": beams}))
    unit = read_unit(source)
    assert unit.scanner["start_azimuth_deg"] == 90.0
    assert (unit.lists["forward_mm"][0], unit.lists["height_mm"][0]) == pytest.approx((27.0, 41.18))
    old = {key: value for key, value in content.items() if "origin" not in key and key != "prod_line"}
    old.pop("beam_to_lidar_transform", None)
    source.write_text(json.dumps(old))
    assert read_unit(source).lists["forward_mm"][0] == 12.163


def test_a_units_clock_takes_the_place_of_its_models(tmp_path: Path) -> None:
    """An HDL-32E has a time for each firing, an Ouster columns for each turn: a file has one of them."""
    write_unit(read_unit(JSON), JSON, tmp_path / "a.toml", like="hdl-32e")
    scanner = tomllib.loads((tmp_path / "a.toml").read_text())["scanner"]
    assert scanner["columns_per_turn"] == 1024
    assert "cycle_us" not in scanner
    assert load_sensor(str(tmp_path / "a.toml")).scanner.cycles == 1024
