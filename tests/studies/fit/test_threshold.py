"""The spread of a threshold, apart from what the filter adds to the width of the law."""

import math

import numpy as np
import pytest

from lidarscene.detection.photon_counting.bins import BOX, BOX_SHARE
from lidarscene.physics.photon_counting.matched_filter import SCALE, TEMPLATE
from lidarscene.sensor.catalogue import load_sensor
from lidarscene.studies.fit.estimates import Solved
from lidarscene.studies.fit.threshold import NORMAL, Threshold, filter_variance

SENSOR = load_sensor("os1-128")


def test_the_filter_scatters_so_much_at_one_signal() -> None:
    """Photons of 40,000 histograms, one by one, weighed both ways: residual variance about the regression, to 3 %."""
    photons, near_ir, count = 12.0, 600.0, 40_000
    random = np.random.default_rng(3)
    sigma_s = float(SENSOR.pixel(0.0).sigma_s)
    half = 8.0
    noise = near_ir * 2.0 * half * sigma_s / float(SENSOR.tdc.ambient_s)
    filtered, boxed = np.zeros(count), np.zeros(count)
    for mean, place in (
        (noise, lambda n: random.uniform(-half, half, n)),
        (photons, random.standard_normal),
    ):
        number = random.poisson(mean, count)
        at, of = place(number.sum()), np.repeat(np.arange(count), number)
        filtered += np.bincount(of, SCALE * np.exp(-0.5 * (at / TEMPLATE) ** 2), minlength=count)
        boxed += np.bincount(of, (np.abs(at) < BOX) / BOX_SHARE, minlength=count)
    slope = np.cov(filtered, boxed)[0, 1] / np.var(boxed)
    left = np.var(filtered - slope * boxed)
    assert filter_variance(SENSOR, photons=photons, near_ir=near_ir) == pytest.approx(left, rel=0.03)


def test_the_spread_is_what_is_left_of_the_width() -> None:
    def of(width: float) -> Threshold:
        solved = Solved(
            value=np.array([1.0, -8.0, 0.0]) / width, slope=1e6 * np.eye(3), scores=np.zeros((4, 3))
        )
        return Threshold(
            solved=solved, near_ir=400.0, expected=np.zeros(0), found=np.zeros(0), pulses=np.zeros(0)
        )

    own = filter_variance(SENSOR, photons=8.0, near_ir=400.0)
    found = of(2.0).spread(SENSOR)
    assert found is not None
    assert found.value == pytest.approx(math.sqrt((2.0 * NORMAL) ** 2 - own))
    assert of(0.9 * math.sqrt(own) / NORMAL).spread(SENSOR) is None
