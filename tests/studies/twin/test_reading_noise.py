"""Noise of readings, and surfaces without it."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.twins import room_sweep

from lidarscene.maths.arrays import Numbers
from lidarscene.physics.photon_counting import shared_shots
from lidarscene.sensor.histogram import LEAST_REST
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.studies.fit.products import scatter_c_mm
from lidarscene.studies.twin import reading_noise
from lidarscene.studies.twin.apparent_reflectivity import white_signal
from lidarscene.studies.twin.planes import align_columns, fit_planes
from lidarscene.studies.twin.reading_noise import INDEPENDENT, LAGS, ReadingNoise, surface_without_noise, without_noise
from lidarscene.studies.twin.surfels import SMOOTH, surfels_of_grid
from lidarscene.studies.twin.tuning import MOST_BEAM_M

SHAPE = (16, 1024)


def rows_of_noise(seed: int, weights: Numbers) -> Numbers:
    """Normal numbers of deviation 1, which columns share by these weights."""
    drawn = np.random.default_rng(seed).normal(0.0, 1.0, (SHAPE[0], SHAPE[1] + len(weights) - 1))
    return np.stack([np.convolve(row, weights, "valid") for row in drawn]) / np.sqrt(weights @ weights)


def test_noise_of_photons_is_theirs() -> None:
    """Poisson's, and (T176b) of c / sqrt(SIGNAL) with some more from the light of 20 klux. 512 pairs tell a deviation
    to 3 %, five times of which are allowed; a bin of the power is a tenth of its decade wide.
    """
    sensor = load_sensor("os0-128")
    range_m = np.broadcast_to(np.geomspace(4.0, 12.0, SHAPE[1]), SHAPE)
    noise = ReadingNoise.of(sensor, range_m, np.full(SHAPE, 0.5), 1e-2)
    assert noise is not None
    photons = 0.5 * white_signal(sensor, range_m)
    np.testing.assert_allclose(noise.log_strength * np.sqrt(photons), 1.0, atol=0.15)
    assert sensor.histogram is not None
    share = sensor.histogram.noise_left(photons)
    ratio = noise.range_m * np.sqrt(photons) / (1e-3 * scatter_c_mm(sensor) * share)
    assert 0.85 < ratio.min() < ratio.max() < 1.35


def test_noise_of_intensities_has_the_energy_and_the_steps() -> None:
    """A grey board of a Pandar64 reads 50, in whole numbers: 1.85 % of energy, and a step's 1 / sqrt(12)."""
    sensor = load_sensor("pandar64")
    noise = ReadingNoise.of(sensor, np.full(SHAPE, 10.0), np.full(SHAPE, 0.5), 1e-2)
    assert noise is not None
    assert np.median(noise.log_strength) == pytest.approx(np.hypot(0.0185, 50.0**-1 / np.sqrt(12.0)), rel=0.1)


@pytest.mark.parametrize("shared", [1, 4])
@pytest.mark.parametrize("texture", [0.0, 1.0, 3.0])
def test_a_surface_keeps_its_texture_and_no_noise(texture: float, shared: int) -> None:
    """The deviations from the mean of a row's neighbours have the mean square that the texture alone has, to 4 %.

    Of mere noise 1 to 2 % is left, 16 to 19 % before places below its mean square made up for those above. A mean of
    15 pixels keeps 7 % of it, and 24 % of what four columns share.
    """
    weights = np.ones(shared)
    correlation = np.maximum(1.0 - np.arange(LAGS) / shared, 0.0)
    surface = texture * rows_of_noise(1, np.ones(1))
    kept = without_noise(surface + rows_of_noise(2, weights), np.ones(SHAPE), correlation)

    def rough(values: Numbers) -> float:
        return float(np.mean((values - np.mean([np.roll(values, k, axis=1) for k in range(-2, 3)], axis=0)) ** 2))

    noise = rough(rows_of_noise(2, weights))
    assert rough(kept) == pytest.approx(rough(surface), rel=0.04, abs=(0.4 if texture else 0.08) * noise)
    assert rough(kept) < rough(surface + rows_of_noise(2, weights))
    if texture == 0.0:
        assert np.var(kept) < (0.12 if shared == 1 else 0.27) * np.var(rows_of_noise(2, weights))


def test_pixels_without_neighbours_stay_as_recorded() -> None:
    """Two on either side in the row, and seven more for means."""
    values = rows_of_noise(3, np.ones(1))
    values[5, 100] = np.nan
    kept = without_noise(values, np.ones(SHAPE), INDEPENDENT)
    np.testing.assert_array_equal(kept[5, 98:103], values[5, 98:103])
    assert np.all(kept[5, [96, 97, 103, 104]] != values[5, [96, 97, 103, 104]])
    np.testing.assert_allclose(without_noise(values, np.zeros(SHAPE), INDEPENDENT), values, atol=1e-12)


def test_a_sensor_that_sees_hardly_any_of_the_boards_says_no_noise() -> None:
    assert ReadingNoise.of(load_sensor("os0-128"), np.full(SHAPE, 2000.0), np.full(SHAPE, 0.5), 1e-2) is None


@pytest.mark.parametrize(("off_cm", "least_m", "most_m"), [(4.0, 0.05, MOST_BEAM_M), (6.0, 0.0, 0.0)])
def test_a_return_far_off_its_plane_along_the_beam_stands_on_it(off_cm: float, least_m: float, most_m: float) -> None:
    """Ground that is seen flat: 4 and 6 cm off the plane are 0.15 and 0.23 m along the beam, and no noise.

    It is no longer a pixel of the smooth surface, and it alone.
    """
    sensor, grid = load_sensor("os0-128"), align_columns(room_sweep())
    smooth_before = int(np.sum(surfels_of_grid(grid, None, None, sensor=sensor).kind == SMOOTH))
    planes = fit_planes(grid)
    flat = planes.has_plane & (np.abs(planes.normal[..., 2]) > 0.999) & (grid.sweep.range_m > 6.0)
    row, column = np.argwhere(flat)[len(np.argwhere(flat)) // 2]
    range_m = np.array(grid.sweep.range_m)
    range_m[row, column] -= 0.01 * off_cm / -float(grid.sweep.direction[row, column] @ planes.normal[row, column])
    grid = replace(grid, sweep=replace(grid.sweep, range_m=range_m))
    planes = fit_planes(grid)
    kept_m, _, smooth = surface_without_noise(sensor, grid, planes, np.full(range_m.shape, 0.3))
    assert planes.smooth()[row, column]
    assert not smooth[row, column]
    assert np.sum(surfels_of_grid(grid, None, None, sensor=sensor).kind == SMOOTH) == smooth_before - 1
    assert planes.range_m[row, column] - range_m[row, column] > MOST_BEAM_M
    assert least_m <= planes.range_m[row, column] - kept_m[row, column] <= most_m


def test_a_corner_stays_where_it_was_recorded() -> None:
    """The plane of a pixel in a corner of the room is that of neither wall, 0.1 m and more from it along the beam."""
    grid = align_columns(room_sweep())
    planes = fit_planes(grid)
    kept_m, *_ = surface_without_noise(load_sensor("os0-128"), grid, planes, np.full(grid.sweep.range_m.shape, 0.3))
    off = planes.has_plane & ~planes.smooth() & (np.abs(planes.range_m - grid.sweep.range_m) > 0.1)
    assert off.sum() > 100
    np.testing.assert_allclose(kept_m[off], grid.sweep.range_m[off], atol=5e-3)


def test_noise_of_beams_that_miss_leaves_surfaces_that_lean() -> None:
    """A floor 1.8 m below, from which beams of a Pandar64 that are off by 45 urad return 45e-6 R tan(beta) away."""
    sensor, grid = load_sensor("pandar64"), align_columns(room_sweep())
    planes = fit_planes(grid)
    floor = planes.has_plane & (planes.normal[..., 2] > 0.9999) & (grid.sweep.range_m > 5.0)
    range_m = grid.sweep.range_m[floor]
    expected = 45e-6 * range_m * np.sqrt((range_m / 1.8) ** 2 - 1.0)
    noise = reading_noise.pointing_noise_m(sensor, reading_noise._lean_m(grid, planes))
    np.testing.assert_allclose(noise[floor], expected, rtol=0.02)
    assert reading_noise.pointing_noise_m(load_sensor("os0-128"), range_m) == 0.0


def test_noise_that_grows_with_the_lean_along_the_row_leaves_the_surface() -> None:
    """Where walls lean, an OS0-128 of revision 7 reads them with more noise than those it faces, by (T176a)."""
    sensor = load_sensor("os0-128-rev7")
    assert sensor.histogram is not None
    assert sensor.histogram.column_range_sigmas is not None
    grid = align_columns(room_sweep())
    planes = fit_planes(grid)
    level_m = np.full(grid.sweep.shape, 3e-3)
    apparent = np.full(level_m.shape, 0.3)
    noise = reading_noise._noise_on_planes(level_m, apparent, sensor, grid, planes)
    x, y, _ = np.moveaxis(grid.sweep.direction * grid.sweep.range_m[..., None], -1, 0)
    across = planes.has_plane & (np.abs(np.abs(x) - 10.0) < 1e-6)
    lean = np.abs(y / x)
    step_m = grid.sweep.range_m * lean * sensor.sweep_rad
    window = {number: float(weight) for number, weight in sensor.histogram.window.items()}
    expected = 3e-3 * shared_shots.shares(window, step_m / (3e-3 * float(sensor.histogram.column_range_sigmas)))[1]
    middle = across & (lean < 0.7) & (np.abs(planes.normal[..., 0]) > 0.9999)
    np.testing.assert_allclose(noise[middle], expected[middle], rtol=0.05)
    assert expected[middle].max() > 1.2 * 3e-3
    assert reading_noise._noise_on_planes(level_m, apparent, load_sensor("os0-128"), grid, planes) is level_m
    # Weak returns have less noise, but columns count less by that of their own light.
    weak = load_sensor("os0-128-rev7", overrides=["histogram.column_photons=1e6"])
    left = reading_noise._noise_on_planes(LEAST_REST * level_m, apparent, weak, grid, planes)
    np.testing.assert_allclose(left[planes.has_plane], LEAST_REST * noise[planes.has_plane], rtol=1e-9)
