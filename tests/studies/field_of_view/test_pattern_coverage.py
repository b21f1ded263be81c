"""Fields of view against closed forms, other people's numbers and brute force."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.documentation import compare, numbers, table
from helpers.mistakes import told
from scipy.spatial import cKDTree

from lidarscene import load_sensor, scan
from lidarscene.maths.pose import Pose
from lidarscene.maths.vectors import convex_hull
from lidarscene.studies.field_of_view import field_of_view_figures as figures
from lidarscene.studies.field_of_view import pattern_coverage, reach
from lidarscene.studies.field_of_view import spacing as fov_spacing
from lidarscene.studies.field_of_view.sphere_cells import SphereCells
from lidarscene.studies.ranging.plane import Target, detection_probability, detection_range_m

DEG = math.pi / 180.0


def raster(columns=101, rows=51, step_deg=0.2, rate_hz=50e3):
    step = step_deg * DEG
    return scan.Raster(columns=columns, rows=rows, azimuth_step_rad=step, elevation_step_rad=step, rate_hz=rate_hz)


def mid40():
    """HELIOS++'s prisms for the Livox Mid-40."""
    wedges = [
        scan.Wedge.create(
            rate_hz=100e3, angle_rad=angle * DEG, index=1.51, rotation_hz=turns, phase_rad=0.0, tilted=face
        )
        for angle, turns, face in ((18.7481, -121.5657, "out"), (17.9634, 77.7430, "in"))
    ]
    return scan.Risley.create(rate_hz=100e3, frame_hz=10.0, wedges=wedges)


def vlp16():
    """VLP-16 user manual 63-9243."""
    order = (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)
    return scan.Spinning.create(
        rotation_hz=-10.0,
        cycle_s=55.296e-6,
        bank=scan.Bank(elevation_rad=[e * DEG for e in order], firing_s=[2.304e-6 * n for n in range(16)]),
    )


def study_cells(scanner, cells, time_s, kind="outline"):
    mask, _ = pattern_coverage.field_cells(scanner, cells, time_s, kind=kind)
    return pattern_coverage.cell_maps(pattern_coverage.fired_pulses(scanner, time_s), cells, mask)


@pytest.fixture(scope="module")
def covered_by_mid40():
    return study_cells(mid40(), SphereCells.of_size(0.28), 1.4).coverage(TIMES_S)


# --- cells ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [0.28, 0.5, 7.0])
def test_cells_are_of_equal_solid_angle_and_fill_the_sphere(size):
    cells = SphereCells.of_size(size)
    area = cells.square_degrees(np.arange(cells.count))
    assert area.sum() == pytest.approx(129600.0 / math.pi, rel=1e-9)
    _, elevation = cells.middle_deg(np.arange(cells.count))
    np.testing.assert_allclose(area[np.abs(elevation) < 45.0], size**2, rtol=0.02)


def test_a_cell_holds_its_middle():
    cells = SphereCells.of_size(1.7)
    all_cells = np.arange(cells.count)
    np.testing.assert_array_equal(cells.locate(*cells.middle_deg(all_cells)), all_cells)


def test_a_cell_reaches_as_far_to_each_side_of_its_middle():
    """49 % of its width and height to the left, to the right, up and down are still in it, 51 % are not."""
    cells = SphereCells.of_size(1.0)
    cell = cells.locate(np.array([0.0, 17.3, -179.9, 101.0]), np.array([0.0, 33.3, -12.0, 61.0]))
    azimuth, elevation = cells.middle_deg(cell)
    width = 360.0 / cells.columns[cells.row_of(cell)]
    for side in (-1.0, 1.0):
        assert np.array_equal(cells.locate(azimuth + 0.49 * side * width, elevation + 0.49 * side), cell)
        assert not np.any(cells.locate(azimuth + 0.51 * side * width, elevation) == cell)


def test_outline_is_the_convex_hull():
    rng = np.random.default_rng(4)
    points = rng.normal(size=(500, 2)) * (20.0, 5.0)
    outline = convex_hull(points)
    x, y = (np.append(a, a[0]) for a in outline.T)
    assert np.all(
        np.diff(x)[:, None] * (points[:, 1] - y[:-1, None]) - np.diff(y)[:, None] * (points[:, 0] - x[:-1, None])
        >= -1e-9
    )
    assert {tuple(p) for p in outline} <= {tuple(p) for p in points}
    for line in (points * (1.0, 0.0), points * (0.0, 1.0), points[:, :1] * (1.0, 2.0), points[:1]):
        assert {tuple(p) for p in convex_hull(line)} == {min(map(tuple, line)), max(map(tuple, line))}


# --- closed forms of a raster -----------------------------------------------------------------------


def test_density_of_a_raster():
    """1 / (step in azimuth times step in elevation), over cos(elevation): the density in solid angle."""
    cells, scanner = SphereCells.of_size(2.0), raster(columns=401, rows=201)
    mask = study_cells(scanner, cells, scanner.frame_s)
    azimuth, elevation = cells.middle_deg(mask.cell)
    inner = (np.abs(azimuth) < 36.0) & (np.abs(elevation) < 17.0)
    expected = 25.0 / np.cos(elevation[inner] * DEG)
    assert inner.sum() > 300
    # The cells' width is no whole number of steps, so they hold a column more or less.
    assert mask.density[inner].mean() == pytest.approx(expected.mean(), rel=2e-3)
    assert mask.density[inner] == pytest.approx(expected, rel=0.12)


@pytest.mark.parametrize("kind", ["outline", "reached"])
@pytest.mark.parametrize("size", [0.2, 0.28, 1.0])
def test_a_raster_is_covered_after_one_frame(kind, size):
    scanner = raster()
    study = study_cells(scanner, SphereCells.of_size(size), scanner.frame_s, kind)
    before, after = study.coverage(np.array([0.5 * scanner.frame_s, scanner.frame_s]))
    assert after == 1.0
    # A row of cells that has begun counts whole.
    assert 0.47 < before < 0.5 + size / 10.0


def test_revisit_of_a_raster_is_a_frame():
    """Cells as large as the step hold one pulse of each frame."""
    scanner = raster()
    study = study_cells(scanner, SphereCells.of_size(0.2), 3.0 * scanner.frame_s)
    assert np.all(study.pulses % 3 == 0)
    assert study.revisit_s == pytest.approx(scanner.frame_s, rel=1e-9)


def test_visits_are_told_apart_by_time():
    """Two rows of a cell are two visits, neighbouring columns are one."""
    scanner = raster()
    study = study_cells(scanner, SphereCells.of_size(0.41), 2.0 * scanner.frame_s)
    line_s = 101 / 50e3
    assert np.isclose(study.revisit_s[:, None], [scanner.frame_s, line_s]).any(axis=1).mean() < 0.5
    # Two lines in each of two frames: three gaps between the first and the last of four visits.
    four = (scanner.frame_s + line_s) / 3.0
    assert np.isclose(study.revisit_s, four, rtol=1e-3).mean() > 0.8


def test_spacing_of_a_raster():
    spacing = fov_spacing.nearest_deg(pattern_coverage.fired_pulses(raster(), 1.0).until(raster().frame_s).direction)
    # In a row off the horizon the columns are closer than the rows by the cosine.
    assert spacing.max() == pytest.approx(0.2, rel=1e-4)
    assert spacing.min() == pytest.approx(0.2 * math.cos(5.0 * DEG), rel=1e-3)


# --- other people's numbers -------------------------------------------------------------------------

TIMES_S = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.4])


def test_coverage_of_the_mid40_prisms(covered_by_mid40):
    """docs/fov.md: HELIOS++'s prisms at 0.28 degrees, by another program with another mask."""
    covered = 100.0 * covered_by_mid40
    reference = np.array([19.7, 36.1, 49.0, np.nan, 69.8, 83.8, 88.3, 92.7])
    assert np.nanmax(np.abs(covered - reference)) < 2.0
    # The maker's published curve, of the real prisms: until the model's phases nearly repeat.
    published = np.array([20.0, 35.0, 48.0, 59.0, 68.0, 81.5, 92.5, 98.0])
    assert np.max(np.abs(covered - published)) < 5.0
    (model_row, *_) = table("fov.md", "time (s)")
    compare("fov.md", [numbers(cell)[0] for cell in model_row[1:]], covered)


def test_coverage_of_the_mid40_does_not_hang_on_the_mask(covered_by_mid40):
    reached = study_cells(mid40(), SphereCells.of_size(0.28), 1.4, "reached").coverage(TIMES_S)
    assert covered_by_mid40 == pytest.approx(reached, abs=0.005)


def test_point_rate_and_plateau_of_the_vlp16():
    """289 352 points a second by the manual; 16 lines plateau at about 14 % by Livox."""
    assert pattern_coverage.rate_hz(vlp16()) == pytest.approx(289_352, abs=1.0)
    first, last = study_cells(vlp16(), SphereCells.of_size(0.28), 0.3).coverage(np.array([0.101, 0.3]))
    assert last == first
    assert first == pytest.approx(0.148, abs=5e-4)  # docs/fov.md; Livox: about 0.14


# --- nearest neighbours -----------------------------------------------------------------------------


@pytest.mark.parametrize("scanner", [mid40(), vlp16(), raster()], ids=["mid40", "vlp16", "raster"])
def test_nearest_neighbours_are_a_trees(scanner):
    direction = pattern_coverage.fired_pulses(scanner, 0.1).direction
    lanes = np.unique(np.linspace(0, len(direction) - 1, 3000).astype(int))
    chord = cKDTree(direction).query(direction[lanes], k=2)[0][:, 1]
    np.testing.assert_allclose(
        fov_spacing.nearest_deg(direction, queries=3000), np.degrees(2.0 * np.arcsin(0.5 * chord)), atol=1e-9
    )


def test_nearest_neighbours_at_the_limits():
    assert len(fov_spacing.nearest_deg(np.array([[1.0, 0.0, 0.0]]))) == 0
    assert fov_spacing.nearest_deg(np.array([[1.0, 0, 0], [1.0, 0, 0]])) == pytest.approx([0.0, 0.0])
    assert fov_spacing.nearest_deg(np.array([[1.0, 0, 0], [-1.0, 0, 0]])) == pytest.approx([180.0, 180.0])


# --- range ------------------------------------------------------------------------------------------


def sensor_with_scanner(scanner, **changes):
    return replace(load_sensor("table1-apd"), scanner=scanner, **changes)


def test_range_map_is_the_range_at_each_cells_aperture():
    sensor = sensor_with_scanner(mid40())
    study = study_cells(sensor.scanner, SphereCells.of_size(0.5), 0.3)
    limit = reach.range_map_m(sensor, study, Target())
    seen_cells = np.flatnonzero(np.isfinite(study.share[:, 0]))
    for place in seen_cells[:: len(seen_cells) // 5]:
        echo, background = map(float, study.share[place])
        # Prisms leave the background: it is that of the lens.
        assert background == 1.0
        expected, _ = detection_range_m(sensor, Target(aperture_share=echo, background_share=background), 0.9)
        assert limit[place] == pytest.approx(expected, rel=1e-4)
    assert np.array_equal(np.isnan(limit), study.pulses == 0)
    azimuth, elevation = SphereCells.of_size(0.5).middle_deg(study.cell)
    off_axis_deg = np.hypot(azimuth, elevation)
    assert np.nanmin(limit[off_axis_deg < 3.0]) > np.nanmax(limit[off_axis_deg > 18.0])


def test_ground_around_a_spinning_head():
    """Blind below -15 degrees: nearer than height / tan 15 deg; two of the same see the same."""
    sensor = sensor_with_scanner(vlp16(), mounting=Pose(position_m=np.array([0.0, 0.0, 1.9])))
    cells = SphereCells.of_size(0.28)
    study = study_cells(sensor.scanner, cells, 0.2)
    lying = sensor_with_scanner(vlp16())
    view = reach.ground_view([sensor, sensor, lying], cells, [study] * 3, Target(), half_m=20.0, step_m=0.1)
    assert view.nearest_blind_m() == pytest.approx(1.9 / math.tan(15.0 * DEG), abs=0.2)
    assert set(np.unique(view.count)) == {0, 2}
    assert view.square_metres[2] == 0.0


def test_cells_between_pulses_see_the_ground_by_the_aperture_of_the_others():
    """The outline's cells that no pulse met have no share of their own: the mean of those that were met is theirs."""
    sensor = sensor_with_scanner(vlp16(), mounting=Pose(position_m=np.array([0.0, 0.0, 1.9])))
    cells = SphereCells.of_size(0.28)
    study = study_cells(sensor.scanner, cells, 0.2)
    shares = np.where(np.arange(2 * len(study.cell)) // 2 % 2 == 0, 0.25, np.nan).reshape(-1, 2)
    views = [
        reach.ground_view([sensor], cells, [replace(study, share=share)], Target(), half_m=20.0, step_m=0.5)
        for share in (shares, np.full(shares.shape, 0.25), np.full(shares.shape, 1e-9))
    ]
    assert np.array_equal(views[0].is_seen, views[1].is_seen)
    assert not views[2].is_seen.any()  # an aperture of nothing sees nothing
    # 1600 places of a quarter of a square metre, but those nearer than the lowest beam.
    assert views[1].square_metres[0] == pytest.approx(1600.0 - math.pi * (1.9 / math.tan(15.0 * DEG)) ** 2, rel=0.02)


def test_the_nearest_place_that_is_seen_and_its_area():
    """Places a metre apart: one sensor sees one at 1.5 m ahead and 0.5 m aside, another two farther off."""
    axis = np.array([-1.5, -0.5, 0.5, 1.5])
    is_seen = np.zeros((2, 4, 4), bool)
    is_seen[0, 2, 3] = True
    is_seen[1, 3, 3] = is_seen[1, 0, 0] = True
    view = reach.GroundView(x_m=2.0 * axis, y_m=2.0 * axis, is_seen=is_seen)
    assert view.nearest_blind_m() == pytest.approx(2.0 * math.hypot(1.5, 0.5))
    assert view.square_metres.tolist() == [4.0, 8.0]
    assert view.count.sum() == 3


def test_the_farthest_ground_is_where_its_slant_echo_is_still_detected():
    """A laser too weak for 20 m: ground is met at a cosine of height over distance."""
    weak = sensor_with_scanner(vlp16(), mounting=Pose(position_m=np.array([0.0, 0.0, 1.9])))
    weak = replace(weak, laser=replace(weak.laser, peak_power_w=1.0))
    cells = SphereCells.of_size(0.28)
    study = study_cells(weak.scanner, cells, 0.2)
    view = reach.ground_view([weak], cells, [study], Target(), half_m=30.0, step_m=0.5)
    away_m = np.hypot(np.hypot(view.x_m[None, :], view.y_m[:, None]), 1.9)
    farthest_m = float(away_m[view.is_seen[0]].max())
    assert 8.0 < farthest_m < 25.0

    def probability(distance_m):
        return float(detection_probability(weak, Target(cos_incidence=1.9 / distance_m), distance_m)[0])

    assert probability(farthest_m) >= 0.9 > probability(farthest_m + 0.75)


# --- the rest ---------------------------------------------------------------------------------------


def test_an_image_shows_each_cell():
    cells = SphereCells.of_size(1.0)
    study = study_cells(raster(), cells, 0.2)
    image, outside, (left, right, low, high) = figures.cell_raster(cells, study.cell, study.cell.astype(float))
    assert set(np.unique(image[~outside]).astype(int)) == set(study.cell.tolist())
    assert left < -10.0 < 10.0 < right
    assert low < -5.0 < 5.0 < high


def test_too_many_pulses_are_refused():
    with told("times_s | 1000 s"):
        pattern_coverage.fired_pulses(mid40(), 1000.0)
