"""The statistic by which the scatter of a law is held to what was not fitted."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.drawn_scenes import published_sensor

from lidarscene.studies.fit.estimates import Solution
from lidarscene.studies.fit.fit_report import law_rows
from lidarscene.studies.fit.on_scene.held_out_bins import HeldOutBins, capped_scatter, judge
from lidarscene.studies.fit.on_scene.known_scene import KnownScene, Observations, predict
from lidarscene.studies.fit.on_scene.likelihood import MEAN_SQUARE, ParameterFit
from lidarscene.studies.fit.on_scene.pulses_on_scene import PulsesOnScene
from lidarscene.studies.ranging.plane import Target, echoes_of_plane


def test_the_scatter_of_a_law_that_holds_is_one() -> None:
    """400 sets of 200 normal numbers: mean to 4 standard errors, and a deviation that `LEAST_PULSES` make 11 % of."""
    random = np.random.default_rng(0)
    scatters = np.array([capped_scatter(residuals) for residuals in random.standard_normal((400, 200))])
    assert np.mean(scatters) == pytest.approx(1.0, abs=0.012)
    assert np.std(np.log(scatters)) * np.sqrt(200) == pytest.approx(0.75, rel=0.15)


def test_a_tail_of_other_surfaces_counts_little() -> None:
    """Rationale: one pulse in twenty a hundred sigmas off is left out; four sigmas off, it counts as three."""
    numbers = np.random.default_rng(1).standard_normal(10_000)
    far, moderate = numbers.copy(), numbers.copy()
    far[::20], moderate[::20] = 100.0, 4.0
    assert capped_scatter(far) == pytest.approx(1.0, abs=0.02)
    assert 1.1 < capped_scatter(moderate) < 1.3


def test_a_ratio_is_held_to_the_limits_of_the_table() -> None:
    """Rationale: limits that grew with the uncertainty of few pulses, to 0.65 and 1.53, hid misses."""
    for ratio, held in ((1.24, True), (1.26, False), (0.81, True), (0.79, False)):
        *_, row = law_rows(None, None, np.array([[50.0, 1e-2 * ratio, 1e-2]]), missing="")
        assert row.verdict is held


def test_the_error_of_the_signal_is_over_what_was_recorded() -> None:
    judged_by_hand = HeldOutBins(
        signal=np.array([[10.0, 100.0, 50.0], [20.0, 100.0, 110.0]]),
        kept_shares=np.array([[0.2, 0.5, 90.0]]),
        scatter=np.zeros((0, 3)),
    )
    assert judged_by_hand.signal_error == pytest.approx(0.3)
    assert judged_by_hand.share_error == pytest.approx(0.3)


POWER = "laser.peak_power_w"


def fit_of_published() -> ParameterFit:
    """The published sensor."""
    return ParameterFit(
        solved=Solution(value=np.zeros(1), slope=np.ones((1, 1)), scores=np.zeros((9, 1))),
        names=(POWER,),
        held=(),
        null=(),
        values={POWER: 0.0},
        reflectivity=np.zeros(1),
    )


def wall_pulses(**changed: Any) -> PulsesOnScene:
    """A dark wall from 8 to 30 m that returns what is expected of it, its ranges a sigma off."""
    count = 1600
    light = echoes_of_plane(
        published_sensor(), Target(reflectivity=0.2, illuminance_klux=5.0), np.geomspace(8.0, 30.0, count)
    )
    scene = KnownScene.from_light(light, published_sensor(), np.zeros(count, int), spot_over_field=0.5)
    law = predict(scene, {})
    signs = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
    reported = Observations(
        has_return=np.ones(count, bool),
        signal=np.asarray(law.signal),
        near_ir=np.asarray(law.near_ir),
        range_m=scene.range_m + signs * np.asarray(law.sigma_m),
    )
    return PulsesOnScene(scene=scene, reported=replace(reported, **changed), block=np.zeros(count, int))


def test_signal_and_scatter_by_bins() -> None:
    """Twice the expected signal; every third return is of something else, a metre off, and does not count."""
    plain = wall_pulses()
    is_spoilt = np.arange(1600) % 3 == 0
    spoilt = replace(
        plain.reported,
        signal=2.0 * plain.reported.signal * np.where(is_spoilt, 9.0, 1.0),
        range_m=plain.reported.range_m + 1.0 * is_spoilt,
    )
    result = judge(replace(plain, reported=spoilt), fit_of_published())
    assert len(result.signal) == 8
    np.testing.assert_allclose(result.signal[:, 1] / result.signal[:, 2], 2.0)
    assert result.signal_error == pytest.approx(0.5)
    # All are one sigma off: a normal law's capped mean square is MEAN_SQUARE, theirs is 1.
    np.testing.assert_allclose(result.scatter[:, 1] / result.scatter[:, 2], MEAN_SQUARE**-0.5, rtol=1e-6)


def test_only_weak_pulses_tell_of_the_threshold() -> None:
    """Far above it none is lost; those would be but a share of one in the last bin."""
    strong = wall_pulses(has_return=np.zeros(1600, bool))
    assert judge(strong, fit_of_published()).share_error is None
