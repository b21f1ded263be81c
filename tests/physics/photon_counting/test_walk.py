"""Calibration of the walk by pile-up: against photons one by one, and its tables against what they are made of."""

import math

import numpy as np
import pytest
from scipy.special import ndtri

from lidarscene.physics.photon_counting import walk
from lidarscene.physics.photon_counting.matched_filter import SCALE, TEMPLATE

ARRAYS = {
    "long dead time": {"bin_sigmas": 0.56, "dead_sigmas": 8.0, "spads": 256.0, "coincidence": 1, "side": 6},
    "short dead time": {"bin_sigmas": 0.52, "dead_sigmas": 3.1, "spads": 9.0, "coincidence": 1, "side": 6},
    "two together": {"bin_sigmas": 0.56, "dead_sigmas": 8.0, "spads": 16.0, "coincidence": 2, "side": 6},
    "three together": {"bin_sigmas": 0.8, "dead_sigmas": 8.0, "spads": 16.0, "coincidence": 3, "side": 4},
    "once in a shot": {"bin_sigmas": 0.56, "dead_sigmas": math.inf, "spads": 16.0, "coincidence": 1, "side": 6},
}


@pytest.mark.parametrize("name", list(ARRAYS))
@pytest.mark.parametrize("centroid", [False, True])
def test_tables_give_back_the_shift(name, centroid):
    """Height, narrowing and sun of an echo give its shift, to 0.02 sigma; 0.07 where SPADs fire twice.

    Between the nodes in light and sun. Suns are those of dead times up to a fifth of the dead time.
    """
    sensor = walk.Filtering(**ARRAYS[name], centroid=centroid)
    calibrated = walk.calibrate(sensor)
    suns = np.array([0.0, 0.013, 0.06])
    lights = np.array([0.004, 0.06, 0.4, 1.3, 3.0, 9.0, 30.0, 70.0])
    if calibrated.alike is not None:
        lights = lights[lights < calibrated.alike[0]]
    course = walk.expected_course(lights, suns, sensor)
    shift = calibrated.at(height=course.height, narrowing=course.narrowing, sun=suns + 0.0 * course.height)
    np.testing.assert_allclose(shift, course.shift, atol=0.07 if sensor.dead_sigmas < 4.0 else 0.02)


def drawn_peak(light, coincidence, *, shots, random, bin_sigmas=0.56, spads=16, side=6):
    """Shift, height and narrowing of a histogram of SPADs that fire once in an echo, photon by photon."""
    phases = random.uniform(-0.5, 0.5, shots)
    # The first photon comes when the light that has arrived exceeds an exponential number.
    arrived = random.exponential(size=(shots, spads)) / light
    time = ndtri(np.where(arrived < 1.0, arrived, 1.0))
    reach = math.ceil(6.0 / bin_sigmas) + side
    bins = np.arange(-reach, reach + 1)
    peaks = []
    for low in np.linspace(-0.5, 0.5, 8, endpoint=False):  # echoes of one place in a bin share a histogram
        rows = (phases >= low) & (phases < low + 0.125)
        middle = low + 0.0625
        number = np.floor(time[rows] / bin_sigmas + middle + 0.5)
        number = np.where(np.isfinite(number), number, 999).astype(int)
        fired = np.stack([(number == k).sum(axis=1) for k in bins], axis=1)
        counts = (fired if coincidence == 1 else fired >= coincidence).sum(axis=0) / rows.sum()
        counts = counts / (spads if coincidence == 1 else 1)
        offset = (bins[:, None] - bins) * bin_sigmas / TEMPLATE
        values = counts @ (SCALE * np.exp(-0.5 * offset**2) * (np.abs(bins[:, None] - bins) <= side))
        best = int(np.argmax(values))
        before, top, after = np.log(values[best - 1 : best + 2])
        away = 0.5 * (before - after) / (before - 2.0 * top + after)
        place = best - reach + away
        box = np.clip(walk.BOX / bin_sigmas + 0.5 - np.abs(bins - place), 0.0, 1.0) @ counts
        height = math.exp(top - 0.25 * (before - after) * away)
        peaks.append(((place - middle) * bin_sigmas, height, height / box))
    return np.mean(peaks, axis=0)


@pytest.mark.parametrize("coincidence", [1, 2])
@pytest.mark.parametrize("light", [0.5, 3.0, 30.0])
def test_expected_course_by_photons(light, coincidence):
    """First photons of a Gaussian echo, filtered: the shift to 0.03 sigma, height and narrowing to 1.5 and 1 %.

    Light that is even within a bin costs up to 0.02 sigma and 1 %; 30,000 shots are good to 0.002 sigma (single SPADs)
    and 0.006 (two together).
    """
    sensor = walk.Filtering(**ARRAYS["two together"] | {"coincidence": coincidence}, centroid=False)
    shift, height, narrowing = drawn_peak(light, coincidence, shots=30_000, random=np.random.default_rng(4))
    course = walk.expected_course(np.array([light]), np.array([0.0]), sensor)
    assert course.shift[0, 0] == pytest.approx(shift, abs=0.03)
    assert course.height[0, 0] == pytest.approx(height, rel=0.015)
    assert course.narrowing[0, 0] == pytest.approx(narrowing, rel=0.01)


def test_look_alikes_are_named():
    """Pixels whose SPADs fire twice in an echo, or count together, cannot tell all powers apart; others can."""
    assert walk.calibrate(walk.Filtering(**ARRAYS["long dead time"], centroid=False)).alike is None
    low, high = walk.calibrate(walk.Filtering(**ARRAYS["short dead time"], centroid=False)).alike
    assert 50.0 < low < high < 2000.0
    together = walk.calibrate(walk.Filtering(**ARRAYS["two together"], centroid=False))
    assert 1.0 < together.alike[0] < 3.0
    assert 2.0 < together.residual < 4.0
