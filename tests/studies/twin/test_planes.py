"""Planes through pixels and their neighbours, against a room in closed form."""

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.twins import COLUMNS, RINGS, directions, room, room_sweep, towards

from lidarscene.maths.arrays import Numbers
from lidarscene.maths.pose import Pose
from lidarscene.recordings.sweep import Second, Sweep
from lidarscene.studies.twin.planes import Planes, align_columns, fit_planes, select_columns


def truth_of(sweep: Sweep) -> Numbers:
    """Normals of the room, in the grid's order, towards the sensor."""
    grid = align_columns(sweep)
    x, y, z = np.moveaxis(np.abs(grid.sweep.xyz_m), -1, 0)
    axis = np.argmin([np.abs(x - 10.0), np.abs(y - 8.0), np.abs(z - 1.8)], axis=0)
    normal = np.zeros((*sweep.shape, 3))
    np.put_along_axis(normal, axis[..., None], 1.0, axis=-1)
    return normal * -np.sign(np.einsum("...i,...i", normal, grid.sweep.direction))[..., None]


@pytest.fixture(scope="module")
def exact() -> tuple[Sweep, Planes]:
    sweep = room_sweep(shear_deg=4.0)
    return sweep, fit_planes(align_columns(sweep))


def test_planes_of_a_room_are_exact(exact: tuple[Sweep, Planes]) -> None:
    """Rationale: without noise only corners, where windows span two planes, may be off; 0.1 mm is rounding and more."""
    sweep, planes = exact
    smooth = planes.smooth()
    assert smooth.mean() > 0.6
    off_mm = 1e3 * np.abs(planes.range_m - align_columns(sweep).sweep.range_m)[smooth]
    assert np.quantile(off_mm, 0.9) < 0.1
    cos = np.einsum("...i,...i", planes.normal, truth_of(sweep))[smooth]
    assert np.quantile(cos, 0.1) > 1.0 - 1e-6


def test_rows_that_are_ahead_are_turned_back() -> None:
    """An Ouster's rows are up to six columns apart: neighbours in the array are none in space."""
    grid = align_columns(room_sweep(shear_deg=4.0))
    azimuth = np.arctan2(grid.sweep.direction[..., 1], grid.sweep.direction[..., 0])
    spread_rad = np.angle(np.exp(1j * (azimuth - azimuth[:1])))
    assert np.abs(np.degrees(spread_rad)).max() < 1e-6
    assert np.degrees(grid.step_rad) == pytest.approx(-360.0 / COLUMNS)


def test_noise_is_averaged_and_not_bent() -> None:
    """Rationale: 15 neighbours leave a quarter of 20 mm, Cauchy's weights a third; 3000 of them are sure to 1 mm."""
    noisy, exact = room_sweep(noise_m=0.02, seed=4), room_sweep()
    planes = fit_planes(align_columns(noisy))
    smooth = planes.smooth()
    range_error_m = (planes.range_m - align_columns(exact).sweep.range_m)[smooth]
    # Grazing planes stretch the noise of the normal; the median pixel is what a surfel is.
    assert 1.4826 * np.median(np.abs(range_error_m)) < 0.4 * 0.02
    assert abs(np.median(range_error_m)) < 2e-3


def test_a_pole_before_a_wall_is_none_of_it() -> None:
    sweep = room_sweep()
    range_m = np.array(sweep.range_m)
    range_m[:, 100] = 3.0
    planes = fit_planes(align_columns(room_sweep(range_m=range_m)))
    wall_m, pole = planes.range_m[:8, 98], planes.range_m[:8, 100]
    assert np.abs(wall_m - range_m[:8, 98]).max() < 0.02
    assert not np.any(np.abs(pole - 3.0) > 0.1)


def test_a_hole_in_a_wall_is_found_and_the_sky_is_none() -> None:
    sweep = room_sweep()
    range_m = np.array(sweep.range_m)
    range_m[5, 45], range_m[:3] = np.nan, np.nan
    planes = fit_planes(align_columns(room_sweep(range_m=range_m)))
    assert planes.range_m[5, 45] == pytest.approx(sweep.range_m[5, 45], abs=0.01)
    assert not planes.has_plane[0].any()


def test_columns_are_taken_of_all_arrays() -> None:
    sweep = room_sweep(second=Second(range_m=np.ones((RINGS, COLUMNS))))
    half = select_columns(sweep, slice(1, None, 2))
    assert half.shape == (RINGS, COLUMNS // 2)
    assert half.second is not None
    assert half.second.range_m.shape == half.shape
    assert np.array_equal(half.direction, directions()[:, 1::2])


def test_a_list_of_points_has_no_grid() -> None:
    sweep = room_sweep()
    flat = Sweep(
        range_m=sweep.range_m.ravel(), recorded=np.ones(RINGS * COLUMNS, bool), direction=sweep.direction.reshape(-1, 3)
    )
    with told("rows and columns"):
        align_columns(flat)


def test_uneven_rings_end_half_way_to_the_next() -> None:
    """Rings at 10, 8, 2 and -1 degrees, given from below: a ring ends half way to the ring above, and below."""
    elevation = np.radians([-1.0, 2.0, 8.0, 10.0])[:, None]
    azimuth = np.radians(np.arange(0.0, 360.0, 2.0))[None, :]
    direction = towards(azimuth, elevation)
    shape = direction.shape[:2]
    grid = align_columns(Sweep(range_m=np.ones(shape), recorded=np.ones(shape, bool), direction=direction))
    np.testing.assert_allclose(np.degrees(grid.above_rad), [1.0, 1.0, 3.0, 1.5])
    np.testing.assert_allclose(np.degrees(grid.below_rad), [1.0, 3.0, 1.5, 1.5])


def test_planes_are_met_from_the_beams_exit() -> None:
    """Beams that start half a metre aside of the origin: the plane's range counts from there."""
    start_m = np.array([0.5, -0.3, 0.2])
    range_m, _, _ = room(directions(), Pose(position_m=start_m))
    sweep = room_sweep(range_m=range_m, origin_m=np.broadcast_to(start_m, (RINGS, COLUMNS, 3)))
    planes = fit_planes(align_columns(sweep))
    off_mm = 1e3 * np.abs(planes.range_m - align_columns(sweep).sweep.range_m)[planes.smooth()]
    assert np.quantile(off_mm, 0.9) < 0.1


def test_a_pixel_off_the_plane_of_its_neighbours_has_none() -> None:
    """A post 0.3 m before a wall, one pixel wide and all rings high, is a plane of its own; one pixel of it is none."""
    range_m = np.array(room_sweep().range_m)
    range_m[5, 180] -= 0.3
    planes = fit_planes(align_columns(room_sweep(range_m=range_m)))
    assert not planes.has_plane[5, 180]
    assert planes.has_plane[5, [179, 181]].all()


def test_a_slanted_pole_is_no_plane() -> None:
    """One pixel wide, it leaves the plane's other direction open: most of its window is the wall behind."""
    range_m = np.array(room_sweep().range_m)
    range_m[:, 100] = 3.0 + 0.05 * np.arange(RINGS)
    grid = align_columns(room_sweep(range_m=range_m))
    planes = fit_planes(grid)
    rings = slice(4, 12)
    has_plane = planes.has_plane[rings, 100]
    np.testing.assert_allclose(planes.normal[rings, 100][has_plane], -grid.sweep.direction[rings, 100][has_plane])


@pytest.mark.parametrize(("tilt_deg", "smooth"), [(7.5, True), (8.5, False)])
def test_normals_that_agree_within_eight_degrees_are_smooth(tilt_deg: float, smooth: bool) -> None:
    """Fifteen normals on a cone about one direction: the length of their mean is the cosine of the cone's angle."""
    tilt = np.radians(tilt_deg)
    turn = np.linspace(0.0, 2.0 * np.pi, 15, endpoint=False).reshape(3, 5)
    normal = np.stack(
        [np.full((3, 5), np.cos(tilt)), np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn)], axis=-1
    )
    assert Planes(range_m=np.ones((3, 5)), normal=normal).smooth()[1, 2] == smooth


@pytest.mark.parametrize("off_deg", [0.0, 0.06])
def test_flat_ground_far_off_is_a_plane(off_deg: float) -> None:
    """Ground 2.4 m below, at 3 to 8 degrees, rings 0.17 degrees apart: a ring is a metre behind the one before.

    A ring whose elevation the maker's table has 0.06 degrees wrong lies as far before or behind the others' plane; its
    surface stays where it was recorded.
    """
    elevation = np.radians(np.arange(-8.0, -3.0, 0.17))[:, None]
    azimuth = -2.0 * np.pi * np.arange(1800)[None, :] / 1800
    parts = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    direction = np.stack(np.broadcast_arrays(*parts), axis=-1)
    true_deg = np.degrees(elevation) + off_deg * (np.arange(len(elevation)) == 20)[:, None]
    range_m = -2.4 / np.sin(np.radians(true_deg)) + np.zeros_like(azimuth)
    sweep = Sweep(range_m=range_m, recorded=np.ones_like(range_m, bool), direction=direction)
    grid = align_columns(sweep)
    planes, inner = fit_planes(grid), slice(2, -2)
    assert np.quantile(planes.normal[inner, ..., 2], 0.05) > np.cos(np.radians(2.0))
    assert np.abs(planes.range_m - grid.sweep.range_m)[inner].max() < 0.05
