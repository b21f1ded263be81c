"""Working points: power and signal there and back, and counted cells by SciPy."""

import math

import numpy as np
import pytest
from scipy.stats import binom

from lidarscene import load_sensor


@pytest.mark.parametrize(
    ("overrides", "rtol"),
    [
        (["detector.statistics='steady_state'"], 1e-9),
        (["detector.statistics='published'"], 1e-9),
        (["detector.statistics='time_domain'"], 5e-3),  # a table, there and back
        ([], 1e-12),
    ],
)
def test_a_working_point_finds_the_power_of_its_own_signal(overrides, rtol):
    """Up to two thirds of the free cells. (22) as printed and derived are 3e-4 apart: neither undoes the other."""
    sensor = load_sensor("table1-sipm" if overrides else "table1-apd", overrides=overrides)
    point = sensor.working_point(np.array([2.5e-8]))
    power = np.geomspace(1e-9, 1.5e-7, 25)
    assert not overrides or 0.5 < point.signal(power).max() / (400.0 - point.busy[0]) < 0.99
    np.testing.assert_allclose(point.power_w(point.signal(power)), power, rtol=rtol)


def test_counted_cells_by_scipy():
    """The least count that is not below the level: whole numbers themselves trip, and what is above them does not.

    Levels on a grid that meets whole numbers, over backgrounds of a few and of many busy cells.
    """
    sensor = load_sensor("table1-sipm", overrides=["detector.counting='binomial'"])
    for background_w in (1e-10, 2.5e-8):
        point = sensor.working_point(np.array([background_w]))
        busy = float(point.busy[0])
        count = np.repeat(np.arange(math.ceil(busy) + 1, math.ceil(busy) + 12), 4)
        threshold = count - np.tile([0.75, 0.5, 0.25, 0.0], 11) - busy
        alarm = point.false_alarm_probability(threshold)
        np.testing.assert_allclose(alarm, binom.sf(count - 1, 400, busy / 400), rtol=1e-6)
        found = point.detection_probability(threshold, np.array([20.0]), None)
        np.testing.assert_allclose(found, binom.sf(count - 1, 400, (busy + 20.0) / 400), rtol=1e-6)
