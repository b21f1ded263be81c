"""Noise of the range that neighbouring columns share."""

import dataclasses

import numpy as np
import pytest
from helpers import chain, photons, trains
from helpers.mistakes import refused, told
from helpers.run_seed import chosen

from lidarscene import Simulator
from lidarscene.detection import receiver
from lidarscene.maths.pose import Pose
from lidarscene.physics.photon_counting import shared_shots
from lidarscene.rendering.render_options import FrameOptions

WEIGHTS = (1.0, 0.56, 0.35, 0.28, 0.14, 0.08, 0.05)
RECORDED = (0.59, 0.38, 0.26, 0.13, 0.07, 0.03)
"""Of two frames of an OS0-128 (firmware 3.0.1) at rest, 1 to 6 columns apart, from 1024 photons on."""
COLUMNS = 4000
ROWS = 2


@pytest.fixture
def seed():
    """Seed of a frame, another one in each run."""
    return int(np.random.default_rng(40).integers(2**31))


def head(weights=WEIGHTS, *overrides):
    """A head of two beams; without weights its columns share nothing."""
    shared = () if weights is None else (f"histogram.column_weights={list(weights)}",)
    return photons.spinning(*shared, *overrides)


def errors_mm(counter, light, *, seed=1, pulse=None):
    """(columns, rows) reported less true range [mm], NaN without an echo."""
    stop = photons.detect(light, counter, seed=seed).stops[0]
    error = np.where(photons.echo_of(stop), 1e3 * (np.asarray(stop.range_m) - light.range_m), np.nan)
    return error.reshape(-1, ROWS)


def walls(counter, snr_photons, *, count=COLUMNS * ROWS, **target):
    """A board with every pulse somewhere within a bin."""
    light = photons.echoes_of(counter, 30.0, photons=snr_photons, count=count, **target)
    light.range_m[:] += np.linspace(0.0, 0.6, count)
    return light


def correlation(error, columns):
    """Correlation of the errors so many columns apart, and how many pairs there are."""
    ahead, behind = error[columns:].ravel(), error[: len(error) - columns].ravel()
    both = np.isfinite(ahead + behind)
    return np.corrcoef(ahead[both], behind[both])[0, 1], both.sum()


def test_the_correlation_is_the_recorded_one_and_the_closed_form():
    """(T177) of the weights is the record, which has two digits; of n equal weights it is 1 - m / n."""
    np.testing.assert_allclose(shared_shots.correlation(WEIGHTS, np.arange(1, 8)), [*RECORDED, 0.0], atol=0.006)
    np.testing.assert_allclose(shared_shots.correlation([1, 1, 1, 1], np.arange(5)), [1.0, 0.75, 0.5, 0.25, 0.0])


@pytest.mark.parametrize(("photons_of_echo", "klux"), [(25.0, 0.0), (60.0, 5.0), (900.0, 0.0)])
def test_columns_share_noise_that_is_as_large_as_before(photons_of_echo, klux, seed):
    """Correlations to 4.5 / sqrt(pairs), widened by (1 + 2 sum rho^2)^1/2 = 1.45 since the pairs are correlated: seven
    of them are wrong once in 20,000 runs. The deviation is that of drawn bins to 6 %: (T176) is good to 3 %, and its
    standard error is 1 %.
    """
    counter, alone = head(), head(None)
    light = walls(counter, photons_of_echo, illuminance_klux=klux)
    shared, drawn = errors_mm(counter, light, seed=seed), errors_mm(alone, light, seed=seed)
    for columns, expected in enumerate((*RECORDED, 0.0), start=1):
        measured, pairs = correlation(shared, columns)
        assert measured == pytest.approx(expected, abs=0.006 + 1.45 * 4.5 / np.sqrt(pairs))
    assert abs(np.corrcoef(shared.T[:, np.isfinite(shared).all(axis=1)])[0, 1]) < 1.45 * 4.5 / np.sqrt(COLUMNS)
    assert np.nanstd(shared) == pytest.approx(np.nanstd(drawn), rel=0.06)
    assert abs(np.nanmean(shared)) < 0.05 * np.nanstd(shared) * 4.5
    np.testing.assert_array_equal(np.isfinite(shared), np.isfinite(drawn))


def test_shots_one_by_one_have_that_correlation():
    """Mean arrival of all photons of three columns, shot by shot: 2/3 and 1/3 (T177), 4.5 standard errors."""
    rng = np.random.default_rng(41)
    counts = rng.poisson(0.8, size=(COLUMNS, 54))
    sums = np.array([rng.normal(size=count).sum() for count in counts.sum(axis=1)])
    window = np.ones(3)
    mean = np.convolve(sums, window, "valid") / np.convolve(counts.sum(axis=1), window, "valid")
    for columns, expected in ((1, 2 / 3), (2, 1 / 3), (3, 0.0)):
        measured = np.corrcoef(mean[columns:], mean[:-columns])[0, 1]
        assert measured == pytest.approx(expected, abs=4.5 * 1.5 / np.sqrt(COLUMNS))
        assert shared_shots.correlation(window, columns) == pytest.approx(expected)


def test_neighbours_on_other_surfaces_share_the_noise_and_not_the_range(seed):
    """Columns in turn at 20 and 30 m, every fifth without an echo: no range moves towards another, to 4.5 standard
    errors, and the noise is shared as if all were one wall.
    """
    counter = head()
    light = walls(counter, 400.0, illuminance_klux=0.0)
    column = np.arange(COLUMNS * ROWS) // ROWS
    light.range_m[column % 2 == 0] -= 10.0
    light.peak_power_w[column % 5 == 0] = 0.0
    error = errors_mm(counter, light, seed=seed)
    assert np.isnan(error[::5]).all()
    near, far = error[::2], error[1::2]
    for side in (near, far):
        finite = np.isfinite(side).sum()
        assert abs(np.nanmean(side)) < 4.5 * 2.0 * np.nanstd(side) / np.sqrt(finite)
    for columns, expected in ((1, 0.59), (2, 0.38)):
        measured, pairs = correlation(error, columns)
        assert measured == pytest.approx(expected, abs=0.006 + 1.45 * 4.5 / np.sqrt(pairs))


@pytest.mark.parametrize("step_mm", chosen(1, [0.0, 6.0, 24.0]))
def test_columns_count_less_where_a_surface_leans(step_mm, seed):
    """Boards whose ranges differ by so much from column to column: size and correlation of the noise are those of
    drawn numbers in a mean whose weights fall with the difference, to 5 standard errors, and the ranges have no bias.
    """
    weights, sigmas, apart = np.array([1.0, 0.5, 0.33, 0.25]), 3.0, np.arange(-3, 4)
    counter = head(weights.tolist(), f"histogram.column_range_sigmas={sigmas}")
    light = walls(counter, 400.0, illuminance_klux=0.0)
    slope = 1e-3 * step_mm / light.range_m / counter.sweep_rad
    error = errors_mm(counter, dataclasses.replace(light, row_slope=slope), seed=seed)
    alone = np.nanstd(errors_mm(head(None), light, seed=seed))
    level = weights[np.abs(apart)]
    counted = level * np.exp(-0.5 * (apart * step_mm / (sigmas * alone)) ** 2)
    white = np.random.default_rng(seed).normal(size=400_000)
    noise, of_level = (np.convolve(white, taps / taps.sum(), "valid") for taps in (counted, level))
    # Correlated numbers have larger errors: of seven weights at most 1.6 times as large.
    error_of_deviation = 1.6 / np.sqrt(2.0 * error.size)
    expected = alone * np.std(noise) / np.std(of_level)
    assert np.nanstd(error) == pytest.approx(expected, rel=0.06 + 5.0 * error_of_deviation)
    measured, pairs = correlation(error, 1)
    assert measured == pytest.approx(np.corrcoef(noise[1:], noise[:-1])[0, 1], abs=5.0 * 1.6 / np.sqrt(pairs))
    assert abs(np.nanmean(error)) < 5.0 * 2.3 * np.nanstd(error) / np.sqrt(error.size)


@pytest.mark.parametrize("step_mm", [0.0, 12.0])
@pytest.mark.parametrize("photons_of_echo", chosen(2, [25.0, 100.0, 900.0]))
def test_weak_returns_take_more_columns_into_the_mean(photons_of_echo, step_mm, seed):
    """Up to 400 photons the noise is that without the key times S / 400, or 0.18, wherever the surface leans; the
    numbers are the same.
    """
    reach = "histogram.column_range_sigmas=3"
    light = walls(head(), photons_of_echo, illuminance_klux=0.0)
    slope = 1e-3 * step_mm / light.range_m / head().sweep_rad
    light = dataclasses.replace(light, row_slope=slope)
    few, many = (
        errors_mm(head(WEIGHTS, reach, *keys), light, seed=seed) for keys in ((), ("histogram.column_photons=400",))
    )
    known = np.isfinite(few)
    expected = min(max(photons_of_echo / 400.0, 0.18), 1.0)
    # What drawn bins are off (T176), by up to three deviations, is left over; whole millimetres have none of it.
    assert np.polyfit(few[known], many[known], 1)[0] == pytest.approx(expected, abs=0.02)
    assert np.nanstd(many) == pytest.approx(expected * np.nanstd(few), rel=0.03)
    np.testing.assert_array_equal(np.isfinite(many), known)


@pytest.mark.parametrize("surface", ["wall", "floor"])
def test_a_rendered_surface_leans_along_the_row_alone(surface, mi, seed):
    """A wall 6 m off that the turned sensor sees at 50 to 60 degrees to its side: the errors over (T176a) of its
    tangent are as large as those of columns that all count. A floor is as far all along a row, however flat it is seen.
    """
    yaw_deg = 20.0
    if surface == "wall":
        body = chain.facing(range_m=6.0, size_m=60.0)
    else:
        body = dataclasses.replace(chain.facing(range_m=6.0, size_m=60.0), pose=Pose(position_m=(0.0, 0.0, -1.5)))
    scene = chain.scene(body, klux=1.0, pose=Pose.from_degrees(yaw_deg=yaw_deg))
    scatter = []
    for sigmas in (1e4, 2.0):
        counter = chain.sensor("os0-128-rev7", f"histogram.column_range_sigmas={sigmas}")
        cloud = Simulator(scene, counter).render(FrameOptions(seed=seed))
        aside = np.abs(cloud.azimuth_rad + np.radians(yaw_deg))
        chosen = (cloud.status == 0) & (cloud.range_m < 20.0)
        if surface == "wall":
            chosen &= (np.degrees(aside) > 50.0) & (np.degrees(aside) < 60.0)
        step_m = cloud.true_range_m * counter.sweep_rad * (np.tan(aside) if surface == "wall" else 0.0)
        window = {number: float(weight) for number, weight in counter.histogram.window.items()}
        error = (cloud.range_m - cloud.true_range_m) * np.sqrt(cloud.signal)
        # All columns count in the first: its scatter is that of a level surface.
        noise = shared_shots.shares(window, step_m * np.sqrt(cloud.signal) / (sigmas * max(scatter, default=1.0)))[1]
        error = error / noise
        scatter.append(np.std(error[chosen & (np.abs(error) < 1.0)]))
        assert chosen.sum() > 5000
        if surface == "wall" and scatter[1:]:
            assert np.median(noise[chosen]) > 1.5
    assert scatter[0] == pytest.approx(scatter[1], rel=5.0 * 2.0 / np.sqrt(2 * 5000))


def test_any_part_of_a_frame_has_the_numbers_of_the_whole_frame():
    """Every third pulse alone, as the lanes of a chunk or of a field of view may be."""
    counter = head()
    light = walls(counter, 400.0, count=900, illuminance_klux=0.0)
    pulse = np.arange(900, dtype=np.uint32)
    whole = receiver.detect(light, counter, seed=3, pulse=pulse).stops[0].range_m
    names = ("range_m", "peak_power_w", "background_power_w", "has_surface")
    part = dataclasses.replace(light, **{name: np.broadcast_to(getattr(light, name), 900)[::3] for name in names})
    np.testing.assert_array_equal(receiver.detect(part, counter, seed=3, pulse=pulse[::3]).stops[0].range_m, whole[::3])
    other = receiver.detect(light, counter, seed=4, pulse=pulse).stops[0].range_m
    assert (other != whole).mean() > 0.9


def test_numpy_and_device_share_the_same_noise(mi):
    """3,000 boards: ranges differ by 1 mm where single precision draws another bin, in 1 % of them at most."""
    counter = head()
    light = walls(counter, 150.0, count=3_000, illuminance_klux=2.0)
    host = photons.detect(light, counter, seed=4).stops[0]
    device = trains.detect_on_device(light, counter, seed=4).stops[0]
    both = photons.echo_of(host) & photons.echo_of(device)
    assert both.mean() > 0.95
    assert (np.abs(np.asarray(host.range_m) - np.asarray(device.range_m))[both] < 1e-3).mean() > 0.99


def test_echoes_that_fire_nearly_all_spads_keep_their_noise():
    """What the walk's correction leaves of them is no noise that columns share."""
    counter, alone = head(), head(None)
    brightest = float(np.ravel(counter.working_point(np.zeros(1)).response.largest)[0])
    light = walls(counter, 0.95 * brightest, count=400, illuminance_klux=0.0)
    np.testing.assert_array_equal(errors_mm(counter, light), errors_mm(alone, light))


def test_a_parabola_through_a_ring_shows_less_than_the_noise():
    """(T178) against drawn noise: the scatter of five points, every second column, to four standard errors."""
    white = np.random.default_rng(42).normal(size=200_000)
    w = np.asarray(WEIGHTS) / np.linalg.norm(WEIGHTS)
    noise = np.convolve(white, w, "valid")
    patches = noise[: len(noise) // 10 * 10].reshape(-1, 10)[:, ::2].T
    bend = np.vander(np.arange(5) - 2.0, 3)
    rest = patches - bend @ np.linalg.lstsq(bend, patches, rcond=None)[0]
    measured = np.sqrt((rest**2).sum(axis=0).mean() / 2.0)
    expected = shared_shots.scatter_share(WEIGHTS, points=5, step=2)
    assert measured == pytest.approx(expected, rel=4.0 * 0.5 / np.sqrt(patches.shape[1]) * 1.5)
    assert expected == pytest.approx(0.74, abs=0.01)


test_mistakes_are_a_line = refused(
    photons.spinning,
    ("histogram.column_weights=[1.0]", "column_weights | at least 2 | [1.0]"),
    ("histogram.column_weights=[0.0, 1.0]", "column_weights | own column | > 0 | 0"),
    ("histogram.column_weights=[1.0, 0.5]", "histogram.estimator=centroid", "column_weights | matched_filter"),
    ("histogram.column_range_sigmas=12", "column_range_sigmas | none"),
    ("histogram.column_range_sigmas=0", "column_range_sigmas | 0.01 | 0"),
    ("histogram.column_photons=400", "column_photons | column_weights | none"),
    where="histogram",
)


def test_a_scanner_without_columns_is_refused():
    tables = photons.tables("livox-mid-40")
    tables["histogram"]["column_weights"] = [1.0, 0.5]
    with told("columns"):
        photons.sensor_from_tables(tables, where="test")


def test_columns_that_do_not_turn_about_an_axis_share_noise_at_any_range():
    shared = "histogram.column_weights=[1.0, 0.5]"
    assert photons.sensor(shared).histogram.column_range_sigmas is None
    with told("histogram.column_range_sigmas | spinning"):
        photons.sensor(shared, "histogram.column_range_sigmas=12")
