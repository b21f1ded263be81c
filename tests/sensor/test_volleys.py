"""Which pulses leave together, and the shares of stray light among them."""

import numpy as np
import pytest
from helpers import volley

from lidarscene import load_sensor
from lidarscene.sensor.volleys import find_volleys

STRAY = ["optics.stray.share=1e-4", "optics.stray.half_angle_deg=1"]


def volleys_of(sensor):
    return find_volleys(sensor.scanner, sensor.optics.stray)


def test_shares_of_a_head_that_fires_at_once():
    """(T122) for lasers a degree apart, typed out; its own light is no stray light. Single precision of directions."""
    volleys = volleys_of(volley.sensor())
    assert (volleys.line, volleys.size) == (16, 16)
    rows = np.arange(16.0)
    apart = np.abs(rows[:, None] - rows)
    expected = np.where(apart > 0.0, 1e-4 + 1e-3 / (1.0 + (apart / 2.0) ** 2), 0.0)
    np.testing.assert_allclose(volleys.share.values, expected, rtol=1e-5)
    assert (volleys.first.values == 0.0).all()
    assert volleys.largest_sum == pytest.approx(expected.sum(axis=1).max(), rel=1e-5)


@pytest.mark.parametrize(("name", "size"), [("vls-128", 8), ("pandar64", 2), ("hdl-64e", 2), ("os1-128", 128)])
def test_volleys_of_real_heads(name, size):
    """A volley has as many as leave at each instant of a cycle; each pulse has the light of all others of its own and
    no more.
    """
    sensor = load_sensor(name, overrides=STRAY)
    volleys = volleys_of(sensor)
    line = sensor.scanner.line_pulses
    assert (volleys.line, volleys.size) == (line, size)
    time_s = sensor.scanner.time_s(np.arange(line, dtype=np.uint32))
    source = volleys.first.values.astype(int)[:, None] + np.arange(size)
    lit = volleys.share.values > 0.0
    for place in range(line):
        others = np.flatnonzero(time_s == time_s[place])
        assert sorted([*source[place][lit[place]], place]) == list(others)


def test_volleys_of_unequal_size():
    """Five lasers of which two and three fire together: the smaller volley's missing third has no share."""
    volleys = volleys_of(
        volley.sensor("scanner.elevation_deg=[0, 1, 2, 3, 4]", "scanner.firing_time_us=[0, 5, 0, 5, 5]")
    )
    assert volleys.first.values.tolist() == [0.0, 0.0, 2.0, 2.0, 2.0]
    assert (volleys.share.values > 0.0).tolist() == [
        [False, True, False],
        [True, False, False],
        [False, True, True],
        [True, False, True],
        [True, True, False],
    ]


def test_each_channel_counts_with_its_own_responsivity():
    """The shares are of light: a channel that counts half of it counts half of the stray light, too."""
    keys = "scanner.elevation_deg=[0, 1]", "scanner.responsivity=[1.0, 0.5]"
    plain, unequal = (volleys_of(volley.sensor(*keys[:count])).share.values for count in (1, 2))
    np.testing.assert_allclose(unequal[0], 2.0 * plain[0], rtol=1e-6)
    np.testing.assert_allclose(unequal[1], 0.5 * plain[1], rtol=1e-6)
