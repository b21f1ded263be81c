"""Least thresholds and factors of lone echoes, drawn by hand, are found again; where they are rare, nothing is said."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lidarscene.maths.arrays import Numbers
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.studies.fit.estimates import Solution
from lidarscene.studies.fit.recorded_pulses import BLOCK_COLUMNS, RecordedPulses
from lidarscene.studies.fit.threshold import Threshold, filter_variance
from lidarscene.studies.fit.threshold_ends import _chances, fit_least, fit_lone_factor

SHAPE = (32, 2000)
NEAR_IR, PEDESTAL, SLOPE = 400.0, 200.0, 0.25
MEDIAN = SLOPE * math.sqrt(NEAR_IR + PEDESTAL)
LAW = Threshold(
    solved=Solution(value=np.array([math.log(SLOPE), PEDESTAL, math.log(0.2)]), slope=np.eye(3), scores=np.eye(3)),
    near_ir=NEAR_IR,
    held_out=np.zeros((0, 3)),
)


def recorded(ratio: Numbers, returned: Numbers) -> RecordedPulses:
    """Pulses of these signals over the median threshold; all returns are 20 m away."""
    columns = np.arange(SHAPE[1])
    return RecordedPulses(
        range_m=np.where(returned, 20.0, np.nan),
        recorded=np.ones(SHAPE, bool),
        signal=MEDIAN * ratio,
        near_ir=np.full(SHAPE, NEAR_IR),
        reflectivity=None,
        azimuth_rad=np.zeros(SHAPE),
        frame=np.zeros(SHAPE[1], int),
        block=columns // BLOCK_COLUMNS,
    )


def lone_pulses(factor: float, share: float) -> RecordedPulses:
    """Sky whose noise is half the threshold, and so many peaks of 1.2 to 6 thresholds without neighbours."""
    random = np.random.default_rng(4)
    ratio = np.where(random.random(SHAPE) < share, np.exp(random.uniform(math.log(1.2), math.log(6.0), SHAPE)), 0.5)
    chance = 1.0 / (1.0 + (ratio / factor) ** -10.0)
    return recorded(ratio, (random.random(SHAPE) < chance) & (ratio > 1.0))


@pytest.mark.parametrize("factor", [1.7, 2.6])
def test_factor_of_lone_echoes(factor: float) -> None:
    """Half return at the factor; some 1400 pulses, so that it is known to 1 %. Five sigma: 1 in a million."""
    estimate = fit_lone_factor(lone_pulses(factor, 0.03), LAW)
    assert estimate is not None
    assert 0.002 < estimate.sigma / factor < 0.04
    assert abs(estimate.value - factor) < 5.0 * estimate.sigma


def test_few_lone_echoes_say_nothing() -> None:
    """Twelve peaks in the mean, of which three of four are fitted, and half return: fewer than ten of either."""
    assert fit_lone_factor(lone_pulses(2.0, 2e-4), LAW) is None


def surface_pulses(least: float, spread: float, filter_sigma: float, seed: int = 9) -> RecordedPulses:
    """A wall, of which three of ten pulses are near the threshold, (T111) typed out with the filter's own scatter."""
    random = np.random.default_rng(seed)
    weak = np.exp(random.uniform(math.log(0.2), math.log(1.5), SHAPE))
    ratio = np.where(random.random(SHAPE) < 0.3, weak, 4.0)
    output = ratio + filter_sigma * random.standard_normal(SHAPE)
    met = np.exp(np.maximum(spread * random.standard_normal(SHAPE), math.log(least)))
    return recorded(ratio, output > met)


@pytest.mark.parametrize(("least", "spread"), [(0.7, 0.3), (0.55, 0.4)])
def test_least_threshold(least: float, spread: float) -> None:
    """The threshold is found within five sigma, and two steps of the grid of 1 % that the filter's scatter, in steps of
    sigma / 20, needs. Of one block its error is not known.
    """
    sensor = load_sensor("os1-128")
    filter_sigma = math.sqrt(filter_variance(sensor, photons=MEDIAN, near_ir=NEAR_IR)) / MEDIAN
    pulses = surface_pulses(least, spread, filter_sigma)
    estimate, of_one_block = (
        fit_least(each, LAW, sensor, spread) for each in (pulses, replace(pulses, block=0 * pulses.block))
    )
    assert estimate is not None
    assert estimate.sigma < 0.1
    assert abs(estimate.value - least) < 5.0 * estimate.sigma + 0.02 * least
    assert of_one_block is not None
    assert math.isinf(of_one_block.sigma)


def test_a_threshold_without_an_end_has_no_least() -> None:
    """Rationale: the least of many returns is always somewhere; only a likelihood knows a law that ends there.

    A difference of ln L by two sigma comes by chance in 1 of 20, so of eight walls one may have a least one: four of
    them do in one of 2000 runs.
    """
    sensor = load_sensor("os1-128")
    filter_sigma = math.sqrt(filter_variance(sensor, photons=MEDIAN, near_ir=NEAR_IR)) / MEDIAN
    estimates = [fit_least(surface_pulses(1e-6, 0.3, filter_sigma, seed), LAW, sensor, 0.3) for seed in range(8)]
    assert sum(estimate is not None for estimate in estimates) < 4


def test_chances_by_draws() -> None:
    """(T183) and 200 000 draws of it, whose shares have 1.1e-3: five sigma, and the steps of the sum."""
    random = np.random.default_rng(2)
    ratio = np.array([0.5, 0.8, 1.1])
    output = ratio[:, None] + 0.12 * random.standard_normal((3, 200_000))
    met = np.exp(np.maximum(0.3 * random.standard_normal((3, 200_000)), math.log(0.7)))
    chance, loss = _chances(ratio, 0.3, 0.12, np.array([0.7]))
    np.testing.assert_allclose(chance[:, 0], (output > met).mean(axis=1), atol=6e-3)
    np.testing.assert_allclose(chance + loss, 1.0)
