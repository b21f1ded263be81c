"""Lists of points on the grid of their sensor, made from a room in closed form by the sensor's own beams."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.twins import HALF_M, HEIGHT_M

from lidarscene.catalog import path_of
from lidarscene.recordings.sweep import Sweep
from lidarscene.sensor.sensor_file import load_sensor, sensor_from_tables
from lidarscene.studies.twin.planes import has_grid
from lidarscene.studies.twin.recorded_beams import with_recorded_beams
from lidarscene.studies.twin.sensor_grid import grid_of, on_grid, rows_of


def points_of(sensor: Any, *, from_origin: bool = False) -> tuple[Any, Any]:
    """Points (n, 3) of a frame in the room of `helpers.twins`, in the order of firing, and their channels."""
    scanner = sensor.scanner
    pulse = np.arange(scanner.pulses, dtype=np.uint32)
    direction = np.stack([np.asarray(x, np.float64) for x in scanner.direction(pulse)], axis=-1)
    start = None if from_origin else scanner.offset_m(pulse)
    exit_m = np.zeros_like(direction) if start is None else np.stack([np.asarray(x, float) for x in start], axis=-1)
    walls = [(0, HALF_M[0]), (0, -HALF_M[0]), (1, HALF_M[1]), (1, -HALF_M[1]), (2, -HEIGHT_M)]
    with np.errstate(divide="ignore"):
        ways_m = np.stack([(offset_m - exit_m[:, axis]) / direction[:, axis] for axis, offset_m in walls])
    range_m = np.where(ways_m > 0.0, ways_m, np.inf).min(axis=0)
    return exit_m + range_m[:, None] * direction, np.asarray(scanner.channel(pulse))


def list_of(xyz_m: Any, **fields: Any) -> Sweep:
    range_m = np.linalg.norm(xyz_m, axis=-1)
    recorded = np.ones(range_m.shape, bool)
    return Sweep(range_m=range_m, recorded=recorded, direction=xyz_m / range_m[..., None], **fields)


def small(name: str, *more: str) -> Any:
    """A sensor of the catalogue that turns four times as fast, so with a quarter of its firings."""
    return load_sensor(name, overrides=["scanner.rotation_hz=-40", *more])


def text_of(name: str) -> str:
    return path_of("sensors", name).read_text(encoding="utf-8")


def in_order(xyz_m: Any, row: Any) -> Any:
    """Points with their rows, in an order of their own."""
    values = np.column_stack([xyz_m, row])
    return values[np.lexsort(values.round(6).T)]


@pytest.mark.parametrize("by_ring", [False, True])
def test_a_list_in_eight_rows_is_no_grid(by_ring: bool) -> None:
    """Rationale: a file of 8 rows, each of a part of the points, was taken for a turn of 8 lasers."""
    sensor = small("vlp-16")
    xyz_m, channel = points_of(sensor)
    if by_ring:
        xyz_m = xyz_m[np.argsort(channel, kind="stable")]
    in_rows = list_of(xyz_m.reshape(8, -1, 3))
    assert not has_grid(in_rows)
    assert np.array_equal(on_grid(in_rows, sensor.scanner).range_m, on_grid(list_of(xyz_m), sensor.scanner).range_m)


@pytest.mark.parametrize("has_rings", [False, True])
@pytest.mark.parametrize("name", ["vlp-16", "hdl-64e"])
def test_every_point_has_a_pixel_in_the_row_of_its_channel(name: str, has_rings: bool) -> None:
    """An HDL-64E's beams start up to 0.2 m above its origin: seen from there a row looks like its neighbours."""
    sensor = small(name)
    xyz_m, channel = points_of(sensor)
    kept = np.random.default_rng(0).permutation(len(channel))[: len(channel) * 9 // 10]
    # Drivers number rings in their own way, here from the bottom up.
    ring = np.argsort(np.argsort(rows_of(sensor.scanner).elevation_rad))[channel[kept]]
    grid = grid_of(list_of(xyz_m[kept], ring=ring if has_rings else None), sensor.scanner)
    sweep = grid.sweep
    assert has_grid(sweep)
    assert np.array_equal(np.unique(channel), np.arange(sweep.shape[0]))
    row, _ = np.nonzero(sweep.has_return)
    found, expected = in_order(sweep.xyz_m[sweep.has_return], row), in_order(xyz_m[kept], channel[kept])
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert sweep.lost.sum() == sweep.range_m.size - len(kept)
    np.testing.assert_allclose(grid.elevation_rad, rows_of(sensor.scanner).elevation_rad, atol=3e-5)
    azimuth = np.unwrap(np.arctan2(sweep.direction[..., 1], sweep.direction[..., 0]), axis=1)
    assert np.abs(np.diff(azimuth) * sweep.shape[1] / (2.0 * np.pi) - 1.0).max() < 0.6


def test_rings_in_the_order_of_the_file_and_of_an_array_are_rings() -> None:
    """KITTI's files go ring by ring; an array of rows by columns has NaN where pulses were lost."""
    sensor = small("hdl-64e")
    xyz_m, channel = points_of(sensor)
    azimuth = np.arctan2(xyz_m[:, 1], xyz_m[:, 0]) % (2.0 * np.pi)
    height = -rows_of(sensor.scanner).elevation_rad[channel]
    # A unit whose elevations are a row off: without rings every point would get the next one's.
    xyz_m = np.column_stack([xyz_m[:, :2], xyz_m[:, 2] + 0.006 * np.linalg.norm(xyz_m, axis=1)])
    by_ring = np.lexsort((azimuth, height))
    counts = []
    for sweep in (list_of(xyz_m[by_ring]), list_of(xyz_m[by_ring].reshape(64, -1, 3))):
        grid = grid_of(sweep, sensor.scanner)
        row, _ = np.nonzero(grid.sweep.has_return)
        np.testing.assert_allclose(
            in_order(grid.sweep.xyz_m[grid.sweep.has_return], row), in_order(xyz_m, channel), atol=1e-5
        )
        counts.append(grid.sweep.has_return.sum())
    assert counts == [len(xyz_m)] * 2


def test_points_of_drivers_that_know_no_exits_start_at_the_origin() -> None:
    sensor = small("hdl-32e")
    by_exit, by_origin = (
        grid_of(list_of(points_of(sensor, from_origin=from_origin)[0]), sensor.scanner) for from_origin in (False, True)
    )
    assert by_exit.sweep.origin_m is not None
    assert by_origin.sweep.origin_m is None
    text, note = with_recorded_beams(text_of("hdl-32e"), by_origin, "by-origin.bin")
    assert "all from one point" in note
    assert sensor_from_tables(tomllib.loads(text), where="sensor.toml").scanner.offset_m(np.arange(3)) is None


def test_the_beams_of_a_unit_are_in_its_file() -> None:
    """A unit that turns 20 times a second, with its own elevations and azimuths; 450 firings for the file's 1800."""
    elevation_deg = tomllib.loads(text_of("pandar64"))["scanner"]["elevation_deg"]
    unit_deg = [angle + 0.05 * (number % 3 - 1) for number, angle in enumerate(elevation_deg)]
    unit = load_sensor(
        "pandar64",
        overrides={"scanner": {"elevation_deg": unit_deg, "columns_per_turn": 450, "start_azimuth_deg": 0.3}},
    )
    xyz_m, _ = points_of(unit)
    text, note = with_recorded_beams(
        text_of("pandar64"), grid_of(list_of(xyz_m), load_sensor("pandar64").scanner), "unit.pcd"
    )
    assert "450 columns a turn" in note
    scanner = sensor_from_tables(tomllib.loads(text), where="sensor.toml").scanner
    assert scanner.pulses == unit.scanner.pulses
    fired, own = (
        np.stack([np.asarray(x) for x in each.direction(np.arange(each.pulses, dtype=np.uint32))], axis=-1)
        for each in (scanner, unit.scanner)
    )
    # Columns may be counted from another one, by whole steps.
    step = 2.0 * np.pi / 450
    turn = (np.arctan2(own[:, 1], own[:, 0]) - np.arctan2(fired[:, 1], fired[:, 0])) / step
    assert np.abs(turn - np.rint(turn)).max() < 0.02
    np.testing.assert_allclose(np.arcsin(fired[:, 2]), np.arcsin(own[:, 2]), atol=2e-5)


def test_a_sector_stays_a_sector() -> None:
    """Points ahead, as data sets cut them to the picture of a camera: nothing is known beside, above and below."""
    sensor = load_sensor("pandar64")
    xyz_m, channel = points_of(sensor)
    azimuth = np.degrees(np.arctan2(xyz_m[:, 1], xyz_m[:, 0]))
    is_cut = (np.abs(azimuth) < 40.0) & (rows_of(sensor.scanner).elevation_rad[channel] > np.radians(-10.0))
    grid = grid_of(list_of(xyz_m[is_cut]), sensor.scanner)
    assert np.degrees(grid.sector_rad or ()) == pytest.approx((-40.0, 80.0), abs=0.3)
    assert grid.sweep.recorded.sum() == pytest.approx(is_cut.sum(), rel=0.01)
    text, note = with_recorded_beams(text_of("pandar64"), grid, "cut.bin")
    assert "a sector of 80 degrees" in note
    cut = sensor_from_tables(tomllib.loads(text), where="sensor.toml").scanner
    assert cut.pulses == pytest.approx(64 * 400, rel=0.01)
    x, y, _ = cut.direction(np.arange(cut.pulses, dtype=np.uint32))
    assert np.median(np.abs(np.degrees(np.arctan2(y, x)))) == pytest.approx(20.0, abs=1.0)


def test_two_returns_of_a_pulse_are_one_pixel_and_neighbours_are_two() -> None:
    sensor = small("vlp-16")
    xyz_m, channel = points_of(sensor)
    azimuth = np.arctan2(xyz_m[:, 1], xyz_m[:, 0])
    # Every other column is half a step late, so that both are as near to one column.
    late = 0.45 * 2.0 * np.pi / 452 * (np.arange(len(xyz_m)) // 16 % 2)
    turned = np.column_stack(
        [
            np.cos(late) * xyz_m[:, 0] - np.sin(late) * xyz_m[:, 1],
            np.sin(late) * xyz_m[:, 0] + np.cos(late) * xyz_m[:, 1],
            xyz_m[:, 2],
        ]
    )
    assert azimuth.shape == channel.shape
    grid = grid_of(list_of(np.concatenate([turned, 1.5 * turned])), sensor.scanner)
    assert grid.sweep.has_return.sum() == pytest.approx(len(xyz_m), rel=0.01)


def test_points_of_no_rows_are_on_a_raster(tmp_path: Path) -> None:
    """A Livox draws rosettes: its points get the cells of a raster, of which few are empty."""
    sensor = load_sensor("livox-mid-360")
    xyz_m, _ = points_of(sensor)
    sweep = on_grid(list_of(xyz_m), sensor.scanner)
    assert has_grid(sweep)
    assert 0.3 < sweep.has_return.sum() / len(xyz_m) < 0.7
    walls_m = np.abs(sweep.xyz_m[sweep.has_return]) - [*HALF_M, HEIGHT_M]
    np.testing.assert_allclose(np.abs(walls_m).min(axis=1), 0.0, atol=1e-6)


def test_what_is_not_of_the_sensor_is_one_line() -> None:
    xyz_m, channel = points_of(small("hdl-64e"))
    with told("64 rings | 16 channels"):
        on_grid(list_of(xyz_m, ring=channel), load_sensor("vlp-16").scanner)
    empty = Sweep(range_m=np.full(3, np.nan), recorded=np.ones(3, bool), direction=np.ones((3, 3)))
    with told("returns | none"):
        on_grid(empty, load_sensor("vlp-16").scanner)
