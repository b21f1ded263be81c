"""Known scenes: a unit is rendered, forgotten, and fitted; slopes; undetermined directions."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.drawn_scenes import GROUPS, REFLECTIVITY_SIGMA, drawn_report, drawn_unit, published_sensor, unit_of
from helpers.mistakes import told
from scipy import special

from lidarscene.light.echoes import EchoTrain, SubEchoes
from lidarscene.studies.fit import tuning
from lidarscene.studies.fit.estimates import MOST_EVALUATIONS
from lidarscene.studies.fit.on_scene import likelihood
from lidarscene.studies.fit.on_scene.known_scene import PARAMETERS, KnownScene, Observations, predict
from lidarscene.studies.fit.on_scene.likelihood import ParameterFit, _held_covariance, fit_parameters, prediction_slopes
from lidarscene.studies.ranging.plane import Target, echoes_of_plane

TRUTH = drawn_unit(0)


@cache
def drawn_recording() -> tuple[KnownScene, Observations]:
    return drawn_report(unit_of(TRUTH), 0, pulses=4000)


@pytest.fixture(scope="module")
def fit(mi) -> ParameterFit:
    return fit_parameters(*drawn_recording(), reflectivity_sigma=REFLECTIVITY_SIGMA)


def deviations(fit: ParameterFit) -> list[float]:
    return [
        (estimate.value - math.exp(TRUTH[estimate.key])) / estimate.sigma
        for estimate in fit.estimates
        if estimate.key in TRUTH
    ]


LUCK = {"scatter_floor", "histogram.threshold_spread", "histogram.threshold_pedestal"}
"""Parameters that are found or held as the draw falls: the clock scatters by 0.3 mm, far below the photons, and few
returns lie where the spread of the threshold differs from its pedestal."""


def test_the_truth_is_found_again(fit: ParameterFit) -> None:
    """Ten numbers; the chance that one of them is 5 sigma off is 6e-6, that six are 2 sigma off, 3e-6.

    The unit is up to 35 % from the published one, and twelve reflectivities are 5 % from what is believed.
    """
    assert fit.solved.evaluations <= MOST_EVALUATIONS
    far = np.abs(deviations(fit))
    assert len(far) >= len(TRUTH) - len(LUCK)
    assert far.max() < 5.0
    assert np.sum(far > 2.0) <= 5
    # Each is known well enough to say something: better than what was drawn.
    sigmas = {estimate.key: estimate.sigma for estimate in fit.estimates}
    assert sigmas["near_field_m"] < 0.01
    assert sigmas["laser.peak_power_w"] < 0.1


def test_what_cannot_be_told_apart_is_held_and_named(fit: ParameterFit) -> None:
    held = {"optics.efficiency_laser", "detector.pde", "detector.jitter_ps", "scatter_floor"}
    assert held <= set(fit.held) | LUCK
    assert set(fit.held) <= held | LUCK
    assert "optics.efficiency_laser +1 %: laser.peak_power_w -1 %" in fit.null
    assert "detector.pde +1 %: laser.peak_power_w -1 %, optics.sun_irradiance_w_m2 -1 %" in fit.null
    assert set(fit.names) | set(fit.held) == set(PARAMETERS)


def test_without_known_reflectivities_the_power_is_not_invented(mi) -> None:
    """Rationale: brighter surfaces before a weaker laser and a weaker sun look the same."""
    fit = fit_parameters(*drawn_recording())
    assert "optics.sun_irradiance_w_m2" in fit.held
    assert "optics.sun_irradiance_w_m2 +1 %: laser.peak_power_w +1 %" in fit.null
    estimates = {estimate.key: estimate for estimate in fit.estimates}
    # The near field needs no reflectivity.
    near = estimates["near_field_m"]
    assert abs(near.value - math.exp(TRUTH["near_field_m"])) < 4.0 * near.sigma


def test_slopes_are_those_of_differences(mi) -> None:
    """Promise: 1e-3, of each parameter's largest slope. Central differences of 1e-4 are good to 1e-7."""
    scene, _ = drawn_report(published_sensor(), 1, pulses=200)
    values = {name: 0.05 * (-1.0) ** k for k, name in enumerate(PARAMETERS)}
    surfaces = np.linspace(-0.1, 0.1, GROUPS)
    exact_law, exact = prediction_slopes(scene, values, surfaces)
    stepped_law, differences = prediction_slopes(scene, values, surfaces, exact=False)
    np.testing.assert_array_equal(np.asarray(exact_law.signal), np.asarray(stepped_law.signal))
    for name in PARAMETERS:
        for exact_slope, difference in zip(exact[name], differences[name], strict=True):
            np.testing.assert_allclose(exact_slope, difference, atol=1e-3 * max(float(np.abs(difference).max()), 1e-12))
    assert np.abs(exact["laser.peak_power_w"][0]).max() > 1.0
    assert np.abs(exact["histogram.threshold_pedestal"][1]).max() > 0.01


def test_the_light_of_a_render_is_a_scene() -> None:
    """Pulses without a surface are left out; of two echoes the stronger one counts, with its near field given back."""
    sensor = published_sensor()
    overlap = sensor.optics.overlap
    assert overlap is not None
    light = EchoTrain(
        parts=tuple(
            SubEchoes(range_m=np.array(ranges), peak_power_w=np.array(powers), count=1)
            for ranges, powers in (([3.0, 1.0, 5.0], [1e-9, 0.0, 1e-9]), ([4.0, 1.0, 60.0], [2e-9, 0.0, 1e-10]))
        ),
        surfaces=2,
        has_surface=np.array([True, False, True]),
        background_power_w=np.array([1e-9, 2e-9, 3e-9]),
    )
    scene = KnownScene.from_light(light, sensor, np.array([7, 8, 9]), spot_over_field=0.5)
    np.testing.assert_array_equal(scene.range_m, [4.0, 5.0])
    np.testing.assert_array_equal(scene.group, [7, 9])
    np.testing.assert_array_equal(scene.background_w, [1e-9, 3e-9])
    share = np.asarray(overlap.share(np.array([4.0, 5.0])))
    np.testing.assert_allclose(scene.power_w, np.array([2e-9, 1e-9]) / share, rtol=1e-12)
    rays = replace(light, parts=(replace(light.parts[0], count=3),))
    with told("one ray | several", ValueError):
        KnownScene.from_light(rays, sensor, np.zeros(3, int), spot_over_field=0.5)


def test_a_number_that_runs_off_does_not_hold_up_the_others(mi) -> None:
    """Rationale: a floor of 3 mm, where there is none, goes to zero for ever. Once it stopped the rest.

    Of a floor of zero a half of all draws would find one above zero: the ranges of strong echoes are 15 % nearer to the
    truth than photons allow, so that none does. That makes the pulse two sigmas shorter; each number is then within
    five of its sigmas but for one run in 10^5.
    """
    truth = drawn_unit(3)
    scene, reported = drawn_report(unit_of(truth), 3000)
    strong = reported.signal > np.nanquantile(reported.signal, 0.8)
    error_m = reported.range_m - scene.range_m
    reported = replace(reported, range_m=scene.range_m + np.where(strong, 0.85, 1.0) * error_m)
    fit = fit_parameters(replace(scene, floor_m=3e-3), reported, reflectivity_sigma=REFLECTIVITY_SIGMA)
    assert "scatter_floor" in fit.held
    assert fit.values["scatter_floor"] < -math.log(5.0)  # it is none, and stays so
    assert any(line.startswith("scatter_floor: alone, beyond a factor of 5") for line in fit.null)
    assert fit.solved.evaluations < 20
    for estimate in fit.estimates:
        shortened = 2.0 if estimate.key == "laser.pulse_fwhm_ns" else 0.0
        sigmas = (estimate.value - math.exp(truth[estimate.key])) / estimate.sigma
        assert abs(sigmas + shortened) < 5.0, estimate.key


def test_a_range_of_something_else_counts_for_nothing(fit: ParameterFit) -> None:
    """Rationale: scenes have edges. One pulse in twenty, a metre off, would be a floor in which the pulse is lost."""
    scene, reported = drawn_recording()
    wrong = np.arange(len(reported.has_return)) % 20 == 0
    moved = replace(reported, range_m=reported.range_m + 1.0 * wrong)
    shifted_fit = fit_parameters(scene, moved, reflectivity_sigma=REFLECTIVITY_SIGMA)
    pulse, clean = (
        next(estimate for estimate in way.estimates if estimate.key == "laser.pulse_fwhm_ns")
        for way in (shifted_fit, fit)
    )
    assert pulse.sigma < 1.5 * clean.sigma
    assert abs(pulse.value - math.exp(TRUTH["laser.pulse_fwhm_ns"])) < 4.0 * pulse.sigma


def test_what_is_held_widens_what_moves_with_it() -> None:
    """Four parameters, the last with a prior of a factor of e: the others' block of the whole inverse is what they have
    without it, and what comes with it. The fourth of a product adds nothing.
    """
    rng = np.random.default_rng(5)
    slopes = rng.normal(size=(4, 40))
    slopes[3] = 0.9 * slopes[0] + 0.03 * slopes[3]
    matrix = slopes @ slopes.T
    joint = np.linalg.inv(matrix + np.diag([0.0, 0.0, 0.0, 1.0]))[:3, :3]
    conditional = np.linalg.inv(matrix[:3, :3])
    held_part = _held_covariance(matrix, [0, 1, 2], [3])
    np.testing.assert_allclose(conditional + held_part, joint, rtol=1e-9)
    assert held_part[0, 0] > 10.0 * conditional[0, 0]
    slopes[3] = slopes[0]
    np.testing.assert_array_equal(_held_covariance(slopes @ slopes.T, [0, 1, 2], [3]), 0.0)


def test_what_is_held_is_a_part_of_the_stated_sigmas(fit: ParameterFit) -> None:
    """Rationale: the jitter is held, and not known; a longer pulse scatters ranges as it does."""
    conditional = np.diag(np.linalg.inv(fit.solved.slope))
    stated = np.diag(fit.solved.covariance)
    pulse = fit.names.index("laser.pulse_fwhm_ns")
    assert np.all(stated >= conditional)
    assert stated[pulse] > 1.0001 * conditional[pulse]


def grey_surfaces(group: np.ndarray) -> KnownScene:
    """Pulses on surfaces of 30 % from 8 to 16 m, by group."""
    target, range_m = Target(reflectivity=0.3, illuminance_klux=30.0), np.geomspace(8.0, 16.0, len(group))
    light = echoes_of_plane(published_sensor(), target, range_m)
    return KnownScene.from_light(light, published_sensor(), group, spot_over_field=0.5)


def test_the_information_of_sun_and_power_is_that_of_counts() -> None:
    """Strong echoes of one surface each, well known: Poisson's N'^2 / N of the background, S^2 / V of the signal.

    What is expected is what was reported, so that neither asks for a step. What the scatter of the range adds, half of
    its slope's square each, is left: below 3 %.
    """
    scene, count = grey_surfaces(np.arange(60)), 60
    values = {"laser.peak_power_w": 0.0, "optics.sun_irradiance_w_m2": 0.0}
    law = predict(scene, values)
    dark = np.asarray(predict(replace(scene, background_w=0.0 * scene.background_w), values).near_ir)
    signal, near_ir = np.asarray(law.signal), np.asarray(law.near_ir)
    reported = Observations(has_return=np.ones(count, bool), signal=signal, near_ir=near_ir, range_m=scene.range_m)
    surfaces = np.zeros(count)
    strong = likelihood._strong_mask(scene, reported, values, surfaces)
    assert strong.all()
    step = likelihood._step(scene, reported, values, surfaces, strong, 1e9)
    of_power, of_sun = np.diag(step.matrix)
    assert of_sun == pytest.approx(np.sum((near_ir - dark) ** 2 / near_ir), rel=0.05)
    assert of_power == pytest.approx(np.sum(signal**2 / np.asarray(law.variance)), rel=0.05)
    # Brighter surfaces by a tenth than is believed, of which nothing is known beforehand: no power, no sun.
    brighter = predict(scene, values, np.full(count, 0.1))
    moved = replace(reported, signal=np.asarray(brighter.signal), near_ir=np.asarray(brighter.near_ir))
    free = likelihood._step(scene, moved, values, surfaces, strong, 0.0)
    np.testing.assert_allclose(free.surface_score / free.surface_curvature, 0.1, rtol=0.1)
    assert np.linalg.eigvalsh(free.matrix)[0] < 1e-3 * of_sun
    pulled = likelihood._step(scene, reported, values, np.full(count, 0.1), strong, 1e9)
    np.testing.assert_allclose(pulled.surface_score / pulled.surface_curvature, -0.1, rtol=0.01)


def test_ranges_that_scatter_as_the_law_says_ask_for_no_other_pulse() -> None:
    """Distances whose square is the capped mean of a normal number's: none; a tenth more asks for a longer pulse."""
    scene, count = grey_surfaces(np.zeros(60, int)), 60
    values = {"laser.peak_power_w": 0.0, "scatter_floor": 0.0}
    scene = replace(scene, floor_m=0.02)
    law = predict(scene, values)
    scores = []
    for factor in (0.9, 1.0, 1.1):
        off_m = factor * math.sqrt(likelihood.MEAN_SQUARE) * np.asarray(law.sigma_m)
        reported = Observations(
            has_return=np.ones(count, bool),
            signal=np.asarray(law.signal),
            near_ir=np.asarray(law.near_ir),
            range_m=scene.range_m + off_m,
        )
        step = likelihood._step(scene, reported, values, np.zeros(1), np.ones(count, bool), 1e9)
        scores.append(step.score[1])
    # Of sigma's logarithm the floor moves floor^2 / sigma^2: a step of some 0.1 where ranges scatter a tenth more.
    slope = (0.02 / np.asarray(law.sigma_m)) ** 2
    moved = scores[2] / step.matrix[1, 1] * np.sum(slope**2) / np.sum(slope)
    assert moved == pytest.approx((1.1**2 - 1.0) / likelihood._SLOPE, rel=2e-3)
    assert moved == pytest.approx(0.1, rel=0.25)
    assert scores[0] < -1.0 < 1.0 < scores[2]
    assert abs(scores[1]) < 1e-6 * scores[2]


def test_moments_of_a_capped_square() -> None:
    """Moments of a normal number's square, at most nine, over its mean: by a sum over its quantiles."""
    share = (np.arange(1_000_000) + 0.5) / 1_000_000
    square = special.ndtri(share) ** 2
    capped = np.minimum(square, tuning.SQUARE_CAP)
    assert capped.mean() == pytest.approx(likelihood.MEAN_SQUARE, rel=1e-4)
    assert np.var(capped / capped.mean()) == pytest.approx(likelihood._VARIANCE, rel=1e-4)
    # d mean(min(x^2 / s^2, 9)) / d ln s, at one.
    wide, narrow = (np.minimum(square * math.exp(-2.0 * log_sigma), 9.0).mean() for log_sigma in (1e-3, -1e-3))
    assert (narrow - wide) / 2e-3 / capped.mean() == pytest.approx(likelihood._SLOPE, rel=1e-3)


def test_a_signal_far_off_pulls_no_harder_than_four_sigmas() -> None:
    """One of sixty a hundred sigmas too strong; and what fires most of the SPADs tells no signal."""
    count = 60
    light = echoes_of_plane(published_sensor(), Target(reflectivity=0.3, illuminance_klux=30.0), np.full(count, 12.0))
    scene = KnownScene.from_light(light, published_sensor(), np.zeros(count, int), spot_over_field=0.5)
    values = {"laser.peak_power_w": 0.0}
    law = predict(scene, values)
    signal, sigma = np.asarray(law.signal), np.sqrt(np.asarray(law.variance))
    reported = Observations(
        has_return=np.ones(count, bool),
        signal=signal + np.where(np.arange(count) == 7, 100.0 * sigma, 0.0),
        near_ir=np.full(count, np.nan),
        range_m=scene.range_m + math.sqrt(likelihood.MEAN_SQUARE) * np.asarray(law.sigma_m),
    )
    assert likelihood._strong_mask(scene, reported, values, np.zeros(1)).all()
    step = likelihood._step(scene, reported, values, np.zeros(1), np.ones(count, bool), 1e12)
    assert step.score[0] == pytest.approx(4.0 * signal[7] / sigma[7], rel=0.02)
    assert not likelihood._strong_mask(scene, reported, {"laser.peak_power_w": 6.0}, np.zeros(1)).any()
