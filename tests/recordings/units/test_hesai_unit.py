"""Tables of angles of Hesais: points of the decoder lie on the written sensor's beams."""

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.recordings import DATA, at128_corrections, hesai_packet

from lidarscene.recordings.units.unit_file import read_unit, write_unit
from lidarscene.sensor.sensor_file import load_sensor


def table(path: Path, rows: int = 32) -> Path:
    lines = [f"{n + 1},{15.0 - n * 0.97:.3f},{0.1 * (n % 3) - 1.2:.3f}" for n in range(rows)]
    path.write_text("\n".join(["Laser id,Elevation,Azimuth", *lines]) + "\n")
    return path


def test_points_of_the_decoder_lie_on_the_beams(tmp_path: Path, library: Callable[[str], Any]) -> None:
    decoders = library("hydra4.decoders")
    path = table(tmp_path / "angles.csv")
    decoder = decoders.PandarXT32(path, 0.0, 1000.0)
    block = next(iter(decoder(SimpleNamespace(data=hesai_packet(4500, 12_500)))))
    right, ahead, up, _, ring, *_ = np.array(block.points, np.float64).T
    write_unit(read_unit(path), path, tmp_path / "unit.toml", like="pandar64")
    lists = read_unit(path).lists
    elevation = np.radians(np.array(lists["elevation_deg"]))[ring.astype(int)]
    azimuth = np.radians(np.array(lists["azimuth_offset_deg"]))[ring.astype(int)] - np.radians(45.0)
    direction = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    np.testing.assert_allclose(50.0 * np.array(direction), [ahead, -right, up], atol=1e-4)
    assert load_sensor(str(tmp_path / "unit.toml")).scanner.lasers == 32


@pytest.mark.parametrize("name", ["Laser id", "Channel"])
def test_a_table_as_units_send_it(tmp_path: Path, name: str) -> None:
    """Table with a first line of its version and a last of its hash, as in the maker's SDK; lines in any order."""
    path = table(tmp_path / "angles.csv")
    lists = read_unit(path).lists
    _, *lines = path.read_text().splitlines()
    rows = ["EEFF,1,1", f"{name},Elevation,Azimuth", *reversed(lines), f"{'eab278' * 10},,"]
    path.write_text("\r\n".join(rows), newline="")
    assert read_unit(path).lists == lists


def table_of(path: Path, name: str, shift_deg: float = 0.0) -> Path:
    """Table of the catalogue's sensor, from the top; a unit's may be off by some tenths of a degree."""
    elevation_deg = np.sort(np.degrees(load_sensor(name).scanner.elevation_rad.values))[::-1] + shift_deg
    lines = [f"{number + 1},{angle:.3f},0" for number, angle in enumerate(elevation_deg)]
    path.write_text("\n".join(["Laser id,Elevation,Azimuth", *lines]) + "\n")
    return path


@pytest.mark.parametrize("name", ["pandar64", "pandarqt", "pandarxt-32", "xt32m2x", "pandar40p", "ot128"])
@pytest.mark.parametrize("shift_deg", [0.0, 0.5])
def test_the_model_is_the_one_with_the_nearest_elevations(tmp_path: Path, name: str, shift_deg: float) -> None:
    path = table_of(tmp_path / "angles.csv", name, shift_deg)
    text = write_unit(read_unit(path), path, tmp_path / "unit.toml")
    assert text.endswith(f"beams, else as {name}")


def test_a_model_that_the_catalogue_lacks_needs_a_like_and_warns(tmp_path: Path) -> None:
    """The same number of lasers is not enough; with `like` the report says whose laser the file has."""
    path = table(tmp_path / "angles.csv", rows=64)
    with told("64 beams | like"):
        write_unit(read_unit(path), path, tmp_path / "unit.toml")
    text = write_unit(read_unit(path), path, tmp_path / "unit.toml", like="pandar64")
    assert text.splitlines()[-1] == (
        "warning: laser, optics, detector and timing are of the pandar64, another product: the catalogue lacks this one"
    )
    path = table_of(tmp_path / "qt.csv", "pandarqt")
    text = write_unit(read_unit(path), path, tmp_path / "unit.toml", like="pandar64")
    assert text.endswith("another product: the catalogue has this one as pandarqt")


def test_corrections_of_an_at128_are_its_angles(tmp_path: Path) -> None:
    """The catalogue's unit: its angles to their rounding, the mean correction ahead to that of 0.12 degrees."""
    keys = ("azimuth", "elevation", "face_start", "azimuth_shift", "elevation_shift", "unit")
    recorded = json.loads((DATA / "at128.json").read_text())
    path = at128_corrections(tmp_path / "a.dat", **{key: recorded[key] for key in keys})
    text = write_unit(read_unit(path), path, tmp_path / "unit.toml")
    assert text.endswith("128 beams, else as at128")
    scanner, catalogue = (load_sensor(name).scanner for name in (str(tmp_path / "unit.toml"), "at128"))
    np.testing.assert_allclose(
        np.degrees(scanner.elevation_rad.values - catalogue.elevation_rad.values), 0.0, atol=2e-3
    )
    np.testing.assert_allclose(np.degrees(scanner.azimuth_rad.values - catalogue.azimuth_rad.values), 0.0, atol=1e-4)
    np.testing.assert_array_equal(scanner.firing_s, catalogue.firing_s)
    assert (scanner.pulses, scanner.frame_s) == (catalogue.pulses, catalogue.frame_s)


def test_what_is_no_table_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    for text, named in (
        ("", "a.csv | columns | Elevation and Azimuth | none"),
        ("a,b\n1,2\n", "a.csv | columns | Elevation and Azimuth | a, b"),
        ("Elevation,Azimuth\n1,x\n", "a.csv | line 2 | azimuth | finite number | 'x'"),
        ("Elevation,Azimuth\nnan,1\n", "a.csv | line 2 | elevation | finite number | 'nan'"),
        ("Elevation,Azimuth\n1\n", "a.csv | line 2 | azimuth | finite number | ''"),
        ("Elevation,Azimuth\n", "a.csv | channel | none"),
    ):
        path.write_text(text)
        with told(named):
            read_unit(path)
