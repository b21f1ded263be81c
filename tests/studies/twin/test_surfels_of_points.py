"""Quads of a list of points."""

from typing import Any

import numpy as np
import pytest
from helpers.twins import COLUMNS, HEIGHT_M, RINGS, room_sweep

from lidarscene.recordings.sweep import Sweep
from lidarscene.studies.twin import surfels, tuning
from lidarscene.studies.twin.apparent_reflectivity import ReflectivityGauge, largest_reflectivity, scattering_law
from lidarscene.studies.twin.surfels import BRIGHT, GROUND, SMOOTH

GROUND_PLANE = np.array([-HEIGHT_M, 0.0, 0.0])


def sweep_of_points(**changed: Any) -> Sweep:
    plain = room_sweep()
    return Sweep(
        range_m=plain.range_m.ravel(),
        direction=plain.direction.reshape(-1, 3),
        recorded=np.ones(RINGS * COLUMNS, bool),
        intensity=np.asarray(plain.reflectivity).ravel(),
        metadata={"format": "velodyne pcap"},
        **changed,
    )


def test_quads_of_a_list_lie_on_the_room(open3d: Any) -> None:
    sweep = sweep_of_points()
    quads = surfels.surfels_of_points(sweep, ReflectivityGauge.from_sweep(sweep), GROUND_PLANE)
    smooth = quads.corners_m[quads.kind == SMOOTH]
    assert len(smooth) > 0.6 * len(sweep.range_m)
    x, y, z = np.moveaxis(np.abs(smooth), -1, 0)
    off_m = np.min([np.abs(x - 10.0), np.abs(y - 8.0), np.abs(z - HEIGHT_M)], axis=0)
    assert np.quantile(off_m, 0.9) < 1e-4
    ground = quads.corners_m[quads.kind == GROUND]
    assert np.all(ground[..., 2] == pytest.approx(-HEIGHT_M - tuning.BELOW_M))


def test_reflectivities_are_those_of_the_intensities(open3d: Any) -> None:
    """A quarter of the law of incidence is off where 20 neighbours span a corner; the median is not."""
    sweep = sweep_of_points()
    quads = surfels.surfels_of_points(sweep, ReflectivityGauge.from_sweep(sweep), None)
    straight = (np.abs(quads.corners_m[:, :, 0] + 10.0).max(axis=1) < 1e-3) & (
        np.abs(quads.corners_m[:, :, 1]).max(axis=1) < 2.0
    )
    assert straight.sum() > 50
    assert np.median(quads.reflectivity[straight]) == pytest.approx(0.4, rel=0.02)


def list_of(points_m: Any, apparent: Any) -> Sweep:
    """Points as a Velodyne lists them, whose intensity is the apparent reflectivity in per cent."""
    range_m = np.linalg.norm(points_m, axis=1)
    return Sweep(
        range_m=range_m,
        direction=points_m / range_m[:, None],
        recorded=np.ones(len(points_m), bool),
        intensity=100.0 * np.asarray(apparent),
        metadata={"format": "velodyne pcap"},
    )


def test_a_slanted_wall_has_one_reflectivity_but_where_no_matt_wall_is_so_bright(open3d: Any) -> None:
    """A wall of 0.3 seen at 0 to 78 degrees. Two of its points return more than a white wall can there: the one
    ahead returns that of twice a white board, the one aside less than a white board, but too much for its angle.
    """
    step_m = 0.3
    y, z = (axis.ravel() for axis in np.meshgrid(np.arange(-30, 31) * step_m, np.arange(-3, 4) * step_m))
    wall_m = np.stack([np.full_like(y, 2.0), y, z], axis=1)
    cos = 2.0 / np.linalg.norm(wall_m, axis=1)
    apparent = 0.3 * scattering_law(cos)
    ahead, aside = (int(np.argmin(np.hypot(y - place_m, z))) for place_m in (0.0, 8.7))
    apparent[ahead], apparent[aside] = 2.0, 0.95 * largest_reflectivity()
    sweep = list_of(wall_m, apparent)
    quads = surfels.surfels_of_points(sweep, ReflectivityGauge.from_sweep(sweep), None)
    bright = np.isin(np.arange(len(y)), (ahead, aside))
    assert np.array_equal(quads.kind, np.where(bright, BRIGHT, SMOOTH))
    np.testing.assert_allclose(quads.reflectivity[~bright], 0.3, rtol=1e-6)
    np.testing.assert_allclose(quads.reflectivity[[ahead, aside]], apparent[[ahead, aside]], rtol=1e-6)
    normal = np.cross(quads.corners_m[:, 1] - quads.corners_m[:, 0], quads.corners_m[:, 3] - quads.corners_m[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    facing = np.where(bright[:, None], sweep.direction, [[1.0, 0.0, 0.0]])
    np.testing.assert_allclose(np.abs(np.einsum("ni,ni->n", normal, facing)), 1.0, rtol=1e-6)
    # Four neighbours are a step away, the fifth is a diagonal: half way to it on each side.
    inner = (np.abs(y) < 8.0) & (np.abs(z) < 0.5) & ~bright
    width = np.linalg.norm(quads.corners_m[inner, 0] - quads.corners_m[inner, 1], axis=1)
    np.testing.assert_allclose(width, np.sqrt(2.0) * step_m, rtol=1e-6)


@pytest.mark.parametrize("bright", [0.15, 3.0])
def test_the_completed_ground_is_the_grounds_alone(open3d: Any, bright: float) -> None:
    """A sloping ground to 10 m with a wall behind: the ground ends where its returns do, as bright as they are, but no
    brighter than matt white.
    """
    steps = np.arange(-19, 20) * 0.5
    x, y = (axis.ravel() for axis in np.meshgrid(steps, steps))
    x, y = x[np.hypot(x, y) < 10.0], y[np.hypot(x, y) < 10.0]
    ground = np.array([-1.8, 0.02, -0.05])
    ground_m = np.stack([x, y, ground[0] + ground[1] * x + ground[2] * y], axis=1)
    up = np.array([-ground[1], -ground[2], 1.0])
    cos = np.abs(ground_m @ up) / np.linalg.norm(ground_m, axis=1) / np.linalg.norm(up)
    y, z = (axis.ravel() for axis in np.meshgrid(np.arange(-30, 31) * 0.5, np.arange(2, 20) * 0.5))
    wall_m = np.stack([np.full_like(y, 40.0), y, z], axis=1)
    apparent = np.concatenate([bright * scattering_law(cos), np.full(len(y), 0.7)])
    sweep = list_of(np.concatenate([ground_m, wall_m]), apparent)
    quads = surfels.surfels_of_points(sweep, ReflectivityGauge.from_sweep(sweep), ground)
    sides_m = np.linalg.norm(np.diff(quads.corners_m[quads.kind != GROUND], axis=1), axis=2)
    np.testing.assert_allclose(sides_m, np.repeat(sides_m[:, :1], 3, axis=1))  # squares, however they lean
    completed = quads.kind == GROUND
    corners_m = quads.corners_m[completed]
    level_m = ground[0] + corners_m[..., :2] @ ground[1:] - tuning.BELOW_M
    np.testing.assert_allclose(corners_m[..., 2], level_m, atol=1e-9)
    reach_m = np.hypot(corners_m[..., 0], corners_m[..., 1]).max()
    assert 8.0 < reach_m < 10.5 + np.sqrt(0.5) * tuning.CELL_M
    np.testing.assert_allclose(quads.reflectivity[completed], min(bright, largest_reflectivity()), rtol=0.02)


def test_squares_are_square_whatever_their_normals() -> None:
    """Normals over the whole sphere: sides of twice the half width, at right angles to each other and the normal."""
    turn = np.arange(50.0)
    z = np.linspace(-1.0, 1.0, 50)
    normal = np.stack([np.sqrt(1.0 - z**2) * np.cos(turn), np.sqrt(1.0 - z**2) * np.sin(turn), z], axis=1)
    corners_m = surfels._squares(np.full((50, 3), 7.0), normal, np.full(50, 0.3))
    sides = np.diff(corners_m, axis=1)
    np.testing.assert_allclose(np.linalg.norm(sides, axis=2), 0.6)
    np.testing.assert_allclose(np.einsum("nsi,ni->ns", sides, normal), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ni,ni->n", sides[:, 0], sides[:, 1]), 0.0, atol=1e-12)
    np.testing.assert_allclose(corners_m.mean(axis=1), 7.0)
