"""Quads of a sweep."""

import numpy as np
import pytest
from helpers.twins import COLUMNS, HEIGHT_M, RINGS, WHITE_M2, directions, room_sweep

from lidarscene.maths.arrays import Numbers
from lidarscene.maths.pose import Pose
from lidarscene.recordings.sweep import Second, Sweep
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.studies import recorded
from lidarscene.studies.twin import surfels, tuning
from lidarscene.studies.twin.apparent_reflectivity import ReflectivityGauge, scattering_law
from lidarscene.studies.twin.planes import align_columns
from lidarscene.studies.twin.surfels import (
    BRIGHT,
    FILLED,
    GROUND,
    KINDS,
    ROUGH,
    SMOOTH,
    Surfels,
    _quads,
    surfels_of_grid,
)

GROUND_PLANE = np.array([-HEIGHT_M, 0.0, 0.0])


def surfels_of(sweep: Sweep, ground: Numbers | None = None) -> Surfels:
    return surfels_of_grid(align_columns(sweep), ReflectivityGauge.from_sweep(sweep), ground)


def kinds(quads: Surfels) -> list[int]:
    return [int(n) for n in np.bincount(quads.kind, minlength=len(KINDS))]


def off_room_m(corners_m: Numbers) -> Numbers:
    """Distance of points to the nearest of the room's planes."""
    x, y, z = np.moveaxis(np.abs(corners_m), -1, 0)
    return np.min([np.abs(x - 10.0), np.abs(y - 8.0), np.abs(z - HEIGHT_M)], axis=0)


def test_quads_lie_on_the_room_and_are_as_wide_as_pixels() -> None:
    """Rationale: off corners the fit is exact, and all that remains is rounding."""
    quads = surfels_of(room_sweep())
    assert len(quads) == RINGS * COLUMNS
    smooth = quads.corners_m[quads.kind == SMOOTH]
    assert np.quantile(off_room_m(smooth), 0.9) < 1e-4
    straight = smooth[np.abs(np.abs(smooth[:, 0, 0]) - 10.0) < 1e-3]
    straight = straight[np.abs(straight[:, :, 1]).max(axis=1) < 1.0]
    width = np.linalg.norm(straight[:, 0] - straight[:, 1], axis=1)
    assert np.median(width) == pytest.approx(10.0 * 2.0 * np.pi / COLUMNS * 1.04, rel=0.02)


def test_a_hole_is_filled_no_brighter_than_the_lost_pulse_allows() -> None:
    """The lost pulse reported a tenth of its neighbours' signal, half of which may be its echo."""
    plain = room_sweep()
    range_m, signal, reflectivity = (np.array(values) for values in (plain.range_m, plain.signal, plain.reflectivity))
    range_m[6, 45], signal[6, 45], reflectivity[6, 45] = np.nan, 0.1 * signal[6, 45], 0.0
    quads = surfels_of(room_sweep(range_m=range_m, signal=signal, reflectivity=reflectivity))
    assert kinds(quads)[FILLED] == 1
    hole_m = quads.corners_m[quads.kind == FILLED].mean(axis=(0, 1))
    near = np.linalg.norm(quads.corners_m.mean(axis=1) - hole_m, axis=1)
    neighbours = quads.reflectivity[(near < 0.5) & (quads.kind == SMOOTH)]
    assert quads.reflectivity[quads.kind == FILLED][0] == pytest.approx(0.05 * np.median(neighbours), rel=0.05)


def test_a_pulse_lost_before_a_bright_sky_is_as_far_below_the_threshold_in_the_twin() -> None:
    """Four times the median NEAR_IR is twice its threshold, so half of the strength; a dark one gains nothing."""
    bounds = []
    for light in (1.0, 4.0, 0.25):
        plain = room_sweep()
        range_m, signal, reflectivity = (
            np.array(values) for values in (plain.range_m, plain.signal, plain.reflectivity)
        )
        near_ir = np.full(plain.shape, 500.0)
        range_m[6, 45], signal[6, 45], reflectivity[6, 45] = np.nan, 0.1 * signal[6, 45], 0.0
        near_ir[6, 45] *= light
        quads = surfels_of(room_sweep(range_m=range_m, signal=signal, reflectivity=reflectivity, near_ir=near_ir))
        bounds.append(quads.reflectivity[quads.kind == FILLED][0])
    assert np.array(bounds) / bounds[0] == pytest.approx([1.0, 0.5, 1.0])


@pytest.mark.parametrize("lost_signal", [69.3, 0.0, None])
def test_no_lost_echo_is_stronger_than_the_threshold_that_lost_it(lost_signal: float | None) -> None:
    """A lost pulse of ten times the threshold of its NEAR_IR: other light, so the hole has half of the threshold.

    Rationale: where its SIGNAL is 0 the hole was as bright as what is beside it. With and without signals it is in
    photons that the sensor would count of a white wall there. It is that of an os0-128 at a NEAR_IR of 900,
    0.202 (900 + 54 x 5.2)^0.5 = 6.93 photons.
    """
    plain = room_sweep()
    sensor = load_sensor("os0-128", overrides=["scanner.columns_per_turn=1024"])
    range_m, signal, reflectivity = (np.array(values) for values in (plain.range_m, plain.signal, plain.reflectivity))
    white = recorded.white_m2(sensor, range_m[6, 45:46])[0] / (0.98 * range_m[6, 45]) ** 2
    range_m[6, 45], signal[6, 45], reflectivity[6, 45] = np.nan, lost_signal or 0.0, 0.0
    near_ir = np.full(plain.shape, 900.0)
    signals = None if lost_signal is None else signal
    sweep = room_sweep(range_m=range_m, signal=signals, reflectivity=reflectivity, near_ir=near_ir)
    quads = surfels_of_grid(align_columns(sweep), ReflectivityGauge.from_sweep(sweep, sensor), None)
    hole = quads.kind == FILLED
    assert hole.sum() == 1
    # It is on the wall across y. Between two of 200 ranges the gauge is a straight line.
    law = scattering_law(np.abs(sweep.direction[6, 45, 1]))
    np.testing.assert_allclose(quads.reflectivity[hole] * law, 0.5 * 6.93 / white, rtol=0.05)


@pytest.mark.parametrize("strength", ["reflectivity", "intensity", "silent"])
def test_a_hole_wider_than_its_neighbours_in_the_row_is_as_bright_as_those_above_and_below(strength: str) -> None:
    """Rationale: without the signal of lost pulses nothing bounds them, and the middle of the hole has no neighbour in
    its row; "silent": with signals, of which the lost ones are 0. What is filled is the wall, of one reflectivity.
    """
    plain = room_sweep()
    hole = (6, np.arange(-8, 8))  # about the normal of the wall behind
    values = {name: np.array(getattr(plain, name), float) for name in ("range_m", "signal", "reflectivity")}
    values["range_m"][hole], values["signal"][hole], values["reflectivity"][hole] = np.nan, 0.0, 0.0
    if strength == "intensity":
        values["intensity"] = values["reflectivity"]
    changed: dict[str, Numbers | None] = dict(values)
    if strength != "silent":
        changed["signal"] = None
    if strength == "intensity":
        changed["reflectivity"] = None
    quads = surfels_of(room_sweep(**changed))
    assert kinds(quads)[BRIGHT] == 0
    assert kinds(quads)[FILLED] == 16
    filled = quads.kind == FILLED
    hole_m = quads.corners_m[filled].mean(axis=(0, 1))
    near = np.linalg.norm(quads.corners_m.mean(axis=1) - hole_m, axis=1) < 3.0
    wall = np.median(quads.reflectivity[near & (quads.kind == SMOOTH)])
    # Neighbours are up to 12 degrees off the wall's normal, whose cosine is 0.978: their light is less by so much.
    np.testing.assert_allclose(quads.reflectivity[filled], wall, rtol=0.03)


def test_a_surface_fades_beside_a_lost_pulse() -> None:
    """Rationale: halfway to a lost pulse that allows a twentieth, there is the mean of 1 and 1/20."""
    plain = room_sweep()
    range_m, signal, reflectivity = (np.array(values) for values in (plain.range_m, plain.signal, plain.reflectivity))
    range_m[6, 45], signal[6, 45], reflectivity[6, 45] = np.nan, 0.1 * signal[6, 45], 0.0
    quads = surfels_of(room_sweep(range_m=range_m, signal=signal, reflectivity=reflectivity))
    quads_of_all = surfels_of(plain)
    assert kinds(quads)[ROUGH] - kinds(quads_of_all)[ROUGH] == 2
    hole = quads.corners_m[quads.kind == FILLED].mean(axis=(0, 1))
    distance_m = np.linalg.norm(quads.corners_m.mean(axis=1) - hole, axis=1)
    edges = (quads.kind == ROUGH) & (distance_m < 0.3)
    assert edges.sum() == 2
    # From a half of the neighbour's half to a half of the hole's: their middles are where the two pixels meet.
    x, y, _ = np.moveaxis(quads.corners_m.mean(axis=1), -1, 0)
    aside_deg = np.degrees(np.arctan2(y, x) - np.arctan2(hole[1], hole[0]))
    np.testing.assert_allclose(np.sort(aside_deg[edges]), [-180.0 / COLUMNS, 180.0 / COLUMNS], rtol=0.1)
    neighbours = quads.reflectivity[(quads.kind == SMOOTH) & (distance_m < 0.5)]
    np.testing.assert_allclose(quads.reflectivity[edges], 0.525 * np.median(neighbours), rtol=0.05)


def test_an_echo_that_was_withheld_leaves_a_hole() -> None:
    range_m = np.array(room_sweep().range_m)
    range_m[6, 45] = np.nan  # its reflectivity stays
    assert len(surfels_of(room_sweep(range_m=range_m))) == RINGS * COLUMNS - 1


def test_the_ground_is_completed_behind_a_box_and_where_nothing_came_back() -> None:
    plain = room_sweep()
    lowest = slice(RINGS - 12, RINGS)
    range_m, signal, reflectivity = (np.array(layer) for layer in (plain.range_m, plain.signal, plain.reflectivity))
    range_m[lowest, 40:60] = 3.0  # a box before the ground
    for values, value in ((range_m, np.nan), (signal, 0.0), (reflectivity, 0.0)):
        values[lowest, 200:220] = value  # nothing at all
    quads = surfels_of(room_sweep(range_m=range_m, signal=signal, reflectivity=reflectivity), GROUND_PLANE)
    ground = quads.corners_m[quads.kind == GROUND]
    assert len(ground) > 100
    assert np.abs(ground[..., 2] + HEIGHT_M).max() < 1e-6
    azimuth = np.degrees(np.arctan2(ground[..., 1].mean(axis=1), ground[..., 0].mean(axis=1)))
    behind_box = (azimuth > 120.0) & (azimuth < 140.5)
    is_lost = (azimuth > -40.5) & (azimuth < -19.0)
    assert behind_box.sum() > 50
    assert is_lost.sum() > 50


@pytest.mark.parametrize(("power_w", "least", "most"), [(33.0, 0, 0), (1e-6, 100, 130)])
def test_ground_that_no_receiver_can_have_lost_is_hidden_by_something(power_w: float, least: int, most: int) -> None:
    """The carrier's hood: 6 x 20 pulses without a return from ground metres away. A weak sensor may have lost them."""
    plain = room_sweep()
    hood = slice(RINGS - 6, RINGS), slice(200, 220)
    range_m, intensity = np.array(plain.range_m), np.array(plain.reflectivity, float)
    range_m[hood], intensity[hood] = np.nan, np.nan
    sweep = room_sweep(range_m=range_m, intensity=intensity, signal=None, reflectivity=None)
    sensor = load_sensor("vlp-16", overrides=[f"laser.peak_power_w={power_w}"])
    quads = surfels_of_grid(align_columns(sweep), ReflectivityGauge.from_sweep(sweep, sensor), GROUND_PLANE)
    near = quads.corners_m[quads.kind == GROUND].mean(axis=1)
    azimuth = np.degrees(np.arctan2(near[:, 1], near[:, 0]))
    in_hood = (azimuth > -40.5) & (azimuth < -19.0) & (np.hypot(near[:, 0], near[:, 1]) < 7.0)
    assert least <= in_hood.sum() <= most


def test_no_ground_is_seen_through_a_roof() -> None:
    """A car's dark side gave nothing back below returns of a roof: the ground there is hidden, not black."""
    plain = room_sweep()
    range_m, signal, reflectivity = (np.array(layer) for layer in (plain.range_m, plain.signal, plain.reflectivity))
    range_m[10:13, 40:60] = 4.0
    for values, value in ((range_m, np.nan), (signal, 0.0), (reflectivity, 0.0)):
        values[13:20, 40:60] = value
    quads = surfels_of(room_sweep(range_m=range_m, signal=signal, reflectivity=reflectivity), GROUND_PLANE)
    ground = quads.corners_m[quads.kind == GROUND].mean(axis=1)
    azimuth = np.degrees(np.arctan2(ground[:, 1], ground[:, 0]))
    elevation = np.degrees(np.arctan2(ground[:, 2], np.hypot(ground[:, 0], ground[:, 1])))
    hidden = (azimuth > 123.0) & (azimuth < 137.0) & (elevation < -9.5) & (elevation > -17.0)
    assert not hidden.any()


def test_a_beam_between_a_near_and_a_far_return_meets_either() -> None:
    """Every second column is at 5 m. Borders are drawn evenly, half a half width to either side, and quads 4 % wider
    than pixels, so the nearer one reaches beyond half way in 0.54 of 5,700 cases, with a standard deviation of 0.007.
    Between 8,225 such pairs of columns of a recorded OS2 the nearer one was met in 0.53, of 2,155 of an OS1 in 0.54.
    """
    plain = room_sweep()
    is_near = np.broadcast_to(np.arange(COLUMNS) % 2 == 0, plain.shape)
    sweep = room_sweep(range_m=np.where(is_near, 5.0, plain.range_m))
    quads = surfels_of_grid(align_columns(sweep), ReflectivityGauge.from_sweep(sweep), None, tuning.BORDER)
    middle, ends = quads.corners_m.mean(axis=1), quads.corners_m[:, :2]
    near = (np.abs(np.linalg.norm(middle, axis=1) - 5.0) < 0.1) & (middle[:, 2] > -1.2) & (middle[:, 0] > -4.8)
    azimuth = np.degrees(np.arctan2(ends[near, :, 1], ends[near, :, 0])) / (360.0 / COLUMNS)
    # Near columns have even numbers of steps from straight behind, so half way to their neighbours is an odd half.
    column = 2.0 * np.rint(azimuth.mean(axis=1, keepdims=True) / 2.0)
    # A quad to either side of a column begins at its middle.
    reach = np.abs((azimuth - column + 180.0) % 360.0 - 180.0).max(axis=1)
    assert np.mean(reach > 0.5) == pytest.approx(0.54, abs=0.021)
    assert (reach.min(), reach.max()) == pytest.approx((0.26, 0.78), abs=0.01)


@pytest.mark.parametrize(("step_m", "joins"), [(0.3, True), (0.4, False)])
def test_a_beam_between_two_returns_of_a_surface_meets_the_line_between_them(step_m: float, joins: bool) -> None:
    """Every second column is farther. At 10 m the way across the beam is 0.17 m, twice of which is 0.35 m."""
    grid = align_columns(
        room_sweep(range_m=np.broadcast_to(10.0 + step_m * (np.arange(COLUMNS) % 2), (RINGS, COLUMNS)))
    )
    facing = -grid.sweep.direction
    for side, column in ((1, 99), (-1, 101)):
        normal = surfels._leaning(grid, grid.sweep.range_m, facing, side)[5, 100]
        here, there = (grid.sweep.xyz_m[5, number] for number in (100, column))
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        assert (abs(normal @ (there - here)) < 1e-9) == joins


def test_borders_leave_no_gap_and_are_half_way_beside_a_lost_pulse() -> None:
    plain = room_sweep()
    range_m = np.array(plain.range_m)
    range_m[6, 45] = np.nan
    left, right = surfels._borders(align_columns(room_sweep(range_m=range_m)), tuning.BORDER)
    np.testing.assert_allclose(np.roll(left, -1, axis=1) - right, 2.0)  # columns go to the right
    assert (left[6, 45], left[6, 46], right[6, 44]) == (1.0, 1.0, -1.0)
    assert np.abs(left - 1.0).max() == pytest.approx(tuning.BORDER, rel=0.01)


def test_two_returns_share_the_pixel() -> None:
    """Each covers half of the beam, so each reflects twice of what it would alone."""
    plain = room_sweep()
    far = np.full(plain.shape, np.nan)
    far[6, 2] = plain.range_m[6, 2] + 2.0
    share = np.full(plain.shape, 0.0)
    share[6, 2] = plain.signal[6, 2]
    quads = surfels_of(room_sweep(second=Second(range_m=far, signal=share, reflectivity=share)))
    assert len(quads) == RINGS * COLUMNS + 1
    width = np.linalg.norm(quads.corners_m[:, 0] - quads.corners_m[:, 1], axis=1)
    reach = np.linalg.norm(quads.corners_m.mean(axis=1), axis=1)
    beyond = int(np.argmin(np.abs(reach - far[6, 2])))
    assert width[beyond] == pytest.approx(far[6, 2] * 2.0 * np.pi / COLUMNS, rel=0.1)
    halves = np.flatnonzero(np.abs(width / reach / (np.pi / COLUMNS * 1.04) - 1.0) < 0.3)
    assert len(halves) == 1


def test_brighter_than_white_is_square_to_its_beam() -> None:
    plain = room_sweep()
    signal = np.array(plain.signal)
    signal[6, 52] *= 40.0
    quads = surfels_of(room_sweep(signal=signal))
    is_bright = quads.kind == BRIGHT
    assert is_bright.sum() == 1
    a, b, c, d = quads.corners_m[is_bright][0]
    normal = np.cross(b - a, d - a)
    middle = (a + b + c + d) / 4.0
    assert abs(normal @ middle) / np.linalg.norm(normal) / np.linalg.norm(middle) > 0.9999
    assert quads.reflectivity[is_bright][0] == pytest.approx(0.4 * plain.reflectivity[6, 52], rel=0.1)


def test_moved_quads_are_where_the_sensor_sees_them() -> None:
    """A quarter turn to the left, and 5 m ahead: what was ahead is on the left."""
    corners_m = np.array([[[2.0, 0.0, 1.0]] * 4])
    quads = Surfels(corners_m=corners_m, reflectivity=np.ones(1), kind=np.zeros(1, int))
    placed = quads.placed(Pose.from_degrees(position_m=(5.0, 0.0, 0.0), yaw_deg=90.0))
    np.testing.assert_allclose(placed.corners_m[0, 0], [5.0, 2.0, 1.0], atol=1e-12)


def test_quads_of_uneven_rings_end_where_the_next_begin() -> None:
    """A wall around the sensor, rings at 12, 10, 4 and 2 degrees: a quad reaches half way to the rings beside it."""
    elevation = np.radians([12.0, 10.0, 4.0, 2.0])[:, None]
    azimuth = np.radians(np.arange(360.0))[None, :]
    parts = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    direction = np.stack(np.broadcast_arrays(*parts), axis=-1)
    shape = direction.shape[:2]
    range_m = np.broadcast_to(10.0 / np.cos(elevation), shape)
    sweep = Sweep(range_m=range_m, recorded=np.ones(shape, bool), direction=direction, includes_lost=True)
    corners_m = surfels_of_grid(align_columns(sweep), None, None).corners_m
    up_deg = np.degrees(np.arctan2(corners_m[..., 2], np.linalg.norm(corners_m[..., :2], axis=-1)))
    ends = np.stack([up_deg.max(axis=1), up_deg.min(axis=1)], axis=1)
    expected = np.array([[13.0, 11.0], [11.0, 7.0], [7.0, 3.0], [3.0, 1.0]])
    ring = np.argmin(np.abs(ends.mean(axis=1)[:, None] - expected.mean(axis=1)), axis=1)
    # A twenty-fifth wider than half of the largest gap, 3 degrees.
    np.testing.assert_allclose(ends, expected[ring], atol=0.15)


@pytest.mark.parametrize("second_m", [2.0, -2.0])
def test_the_nearer_of_two_returns_hides_half_of_the_other(second_m: float) -> None:
    """Ahead, where walls are square to the beam. The pixel returned a quarter each of what a white board would."""
    plain = room_sweep()
    column = COLUMNS // 2  # straight ahead
    row = int(np.argmin(np.abs(plain.direction[:, column, 2])))
    range_m, signal = np.full(plain.shape, np.nan), np.zeros(plain.shape)
    range_m[row, column] = plain.range_m[row, column] + second_m
    first = np.array(plain.signal)
    first[row, column] = 0.25 * WHITE_M2 / plain.range_m[row, column] ** 2
    signal[row, column] = 0.25 * WHITE_M2 / range_m[row, column] ** 2
    quads = surfels_of(room_sweep(signal=first, second=Second(range_m=range_m, signal=signal)))
    middle = quads.corners_m.mean(axis=1)
    in_columns = np.abs(np.arctan2(middle[:, 1], middle[:, 0])) < 0.6 * np.pi / COLUMNS * 2.0
    level = np.abs(
        middle[:, 2] / np.hypot(middle[:, 0], middle[:, 1]) - np.tan(np.arcsin(plain.direction[row, column, 2]))
    )
    halved = np.flatnonzero(
        in_columns & (level < 0.005) & (quads.kind == ROUGH) & (np.abs(quads.reflectivity - 0.5) < 0.05)
    )
    reach_m = np.linalg.norm(middle[halved], axis=1)
    width = np.linalg.norm(quads.corners_m[halved, 0] - quads.corners_m[halved, 1], axis=1) / reach_m
    order = np.argsort(reach_m)
    assert len(halved) == 2
    np.testing.assert_allclose(reach_m[order], sorted([10.0, 10.0 + second_m]), rtol=0.01)
    np.testing.assert_allclose(width[order] / (2.0 * np.pi / COLUMNS * 1.04), [0.5, 1.0], rtol=0.05)


def test_ground_that_slopes_is_completed_along_its_slope_a_step_behind_what_stands_on_it() -> None:
    """z = -1.8 + 0.05 x - 0.03 y. A box hides it from 6 m on, less than 0.3 m before the ground at one ring."""
    slope = np.array([-1.8, 0.05, -0.03])
    direction = directions()
    up = np.array([-slope[1], -slope[2], 1.0])
    with np.errstate(divide="ignore"):
        meets_m = slope[0] / (direction @ up)
    far = ~((meets_m > 0.0) & (meets_m < 25.0))
    box = np.zeros(meets_m.shape, bool)
    box[-8:, 100:110] = True
    range_m = np.where(far, np.nan, meets_m)
    range_m = np.where(box, range_m - np.where(np.arange(COLUMNS) < 105, 0.2, 0.5), range_m)
    cos = np.abs(direction @ up) / np.linalg.norm(up)
    signal = np.where(far, 0.0, WHITE_M2 * 0.3 * cos / meets_m**2)
    reflectivity = np.where(far, 0.0, 30.0 * cos)
    quads = surfels_of(room_sweep(range_m=range_m, signal=signal, reflectivity=reflectivity), slope)
    ground = quads.corners_m[quads.kind == GROUND]
    level_m = slope[0] + ground[..., :2] @ slope[1:]
    assert len(ground) > 40
    np.testing.assert_allclose(ground[..., 2], level_m, atol=1e-6)
    middle = ground.mean(axis=1)
    azimuth_deg = np.degrees(np.arctan2(middle[:, 1], middle[:, 0]))
    near = np.linalg.norm(middle, axis=1) < 0.9 * np.nanmin(meets_m[-9][100:110])
    behind_wall = near & (azimuth_deg > 70.0 - 0.5) & (azimuth_deg < 80.5)
    # Columns go clockwise from behind: 105 to 109 are at 75 to 71 degrees.
    assert set(np.rint(azimuth_deg[behind_wall]).astype(int)) == {71, 72, 73, 74, 75}
    assert np.linalg.norm(middle, axis=1).max() < 1.3 * 25.0 * 1.01


def test_ground_leans_as_one_where_rings_are_off_their_angles() -> None:
    """Rationale: rings 0.06 degrees off made asphalt at 40 m lean 0.8 to 1.6 times as much, and scatter with it."""
    direction, off_rad = directions(), np.radians(0.15) * (-1.0) ** np.arange(RINGS)[:, None]
    aimed_rad = np.arcsin(direction[..., 2]) + off_rad
    with np.errstate(divide="ignore"):
        range_m = np.where(aimed_rad < np.radians(-9.0), -HEIGHT_M / np.sin(aimed_rad), np.nan)
    quads = surfels_of(room_sweep(range_m=range_m), GROUND_PLANE)
    corner, left, _, right = np.moveaxis(quads.corners_m[quads.kind == SMOOTH], 1, 0)
    normal = np.cross(left - corner, right - corner)
    assert len(normal) > 1000
    np.testing.assert_allclose(np.abs(normal[:, 2]) / np.linalg.norm(normal, axis=1), 1.0, atol=1e-9)


def test_no_ground_is_seen_above_the_foot_of_a_wall() -> None:
    """All is lost above a wall's lowest returns, windows and sky: what is next below is a wall, so no ground shows."""
    plain = room_sweep()
    elevation_deg = np.degrees(np.arcsin(plain.direction[:, 0, 2]))
    is_lost = np.zeros(plain.shape, bool)
    is_lost[elevation_deg > -8.5, 170:190] = True  # straight ahead the wall's foot is at -10.2 degrees
    range_m, signal, reflectivity = (
        np.where(is_lost, empty, values)
        for values, empty in ((plain.range_m, np.nan), (plain.signal, 0.0), (plain.reflectivity, 0.0))
    )
    quads = surfels_of(room_sweep(range_m=range_m, signal=signal, reflectivity=reflectivity), GROUND_PLANE)
    ground = quads.corners_m[quads.kind == GROUND].mean(axis=1)
    straight_ahead = np.abs(np.degrees(np.arctan2(ground[:, 1], ground[:, 0]))) < 9.0
    above = np.degrees(np.arctan2(ground[:, 2], np.hypot(ground[:, 0], ground[:, 1]))) > -8.5
    assert not np.any(straight_ahead & above)


def test_corners_of_a_grazing_quad_stay_near_its_middle() -> None:
    """A plane at a cosine of 0.02 runs off within a pixel: corners are at 10 m times or over 1.6 at most."""
    grid = align_columns(room_sweep())
    direction = grid.sweep.direction[6, 52]
    up = np.cross(np.cross(direction, [0.0, 0.0, 1.0]), direction)
    normal = 0.9998 * up / np.linalg.norm(up) - 0.02 * direction
    chosen = np.zeros(grid.sweep.shape, bool)
    chosen[6, 52] = True
    quads = _quads(
        grid,
        chosen,
        np.full(grid.sweep.shape, 10.0),
        np.broadcast_to(normal, (*grid.sweep.shape, 3)),
        np.full(grid.sweep.shape, 0.01),
        SMOOTH,
    )
    reach_m = np.linalg.norm(quads.corners_m[0], axis=-1)
    assert (reach_m.min(), reach_m.max()) == (pytest.approx(6.25, rel=0.1), pytest.approx(16.0))


def test_reflectivities_are_the_apparent_ones_over_the_law_of_incidence() -> None:
    """The room is Lambertian: of its ground, far aslant, the apparent reflectivity is 0.3 cos."""
    quads = surfels_of(room_sweep())
    middle = quads.corners_m.mean(axis=1)
    ground = (quads.kind == SMOOTH) & (np.abs(middle[:, 2] + HEIGHT_M) < 1e-3)
    cos = HEIGHT_M / np.linalg.norm(middle[ground], axis=1)
    assert ground.sum() > 200
    assert np.median(cos) < 0.4
    ratio = quads.reflectivity[ground] / (0.3 * cos / scattering_law(cos))
    assert np.quantile(np.abs(ratio - 1.0), 0.8) < 0.03


@pytest.mark.parametrize("side", [1, -1])
def test_what_leans_to_its_neighbour_on_a_plane_is_that_plane(side: int) -> None:
    """Whatever the given normals are aside; the rise along the column is theirs. Columns are beside each other."""
    plane = np.array([0.6, 0.3, -0.2])
    azimuth, elevation = np.meshgrid(np.linspace(0.5, 0.3, 9), np.linspace(0.2, -0.2, 5))
    direction = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    )
    sweep = Sweep(range_m=6.0 / (direction @ plane), recorded=np.ones((5, 9), bool), direction=direction)
    to_left = np.stack([-np.sin(azimuth), np.cos(azimuth), 0.0 * azimuth], axis=-1)
    given = -plane + 0.2 * to_left
    leaning = surfels._leaning(align_columns(sweep), sweep.range_m, given, side)[:, 1:-1]
    np.testing.assert_allclose(leaning, np.broadcast_to(-plane / 0.7, leaning.shape), atol=1e-9)
