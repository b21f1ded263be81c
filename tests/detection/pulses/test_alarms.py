"""False alarms among the stops of the converter."""

import math

import numpy as np
import pytest
from helpers import trains
from helpers.trains import detect, sensor, train
from scipy.stats import norm

from lidarscene.detection.outcomes import Status
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S

HALF_C = 0.5 * SPEED_OF_LIGHT_M_S


@pytest.mark.parametrize("keep", ["first", "last", "strongest"])
def test_false_alarms_by_what_is_kept(keep):
    """Alarms in an empty window against brute force: a Poisson number, even times, exponential heights.

    Means of time and excess of the kept ones over 12 000 pulses, z-tests at 1e-4 each.
    """
    equipped = sensor("table1-apd", "tdc.threshold_to_noise=3.3", "tdc.stops=2", f"tdc.keep='{keep}'")
    count = 12_000
    detection = detect(train(np.full((count, 1), 50.0), np.zeros((count, 1))), equipped, seed=4)
    point = equipped.working_point(np.array([trains.BACKGROUND_W]))
    threshold = float(equipped.threshold(point)[0])
    p_false, window = norm.sf(3.3), equipped.tdc.window_s
    expected = -np.log1p(-p_false) * equipped.tdc.bandwidth_hz * window
    scale = float(point.noise.deviation[0]) ** 2 / threshold
    random = np.random.default_rng(8)
    times, excess = [], []
    for _ in range(count):
        number = random.poisson(expected)
        time, height = random.uniform(0.0, window, number), random.exponential(scale, number)
        order = np.argsort({"first": time, "last": -time, "strongest": -height}[keep])[:2]
        times.append(np.sort(time[order]))
        excess.append(height[order])
    simulated = np.concatenate(times), np.concatenate(excess)
    reported = [stop.reported for stop in detection.stops]
    measured = (
        np.concatenate([s.range_m[k] / HALF_C for s, k in zip(detection.stops, reported, strict=True)]),
        np.concatenate([s.amplitude[k] - threshold for s, k in zip(detection.stops, reported, strict=True)]),
    )
    limit = norm.isf(0.5e-4)
    for a, b in zip(measured, simulated, strict=True):
        error = math.hypot(a.std() / math.sqrt(len(a)), b.std() / math.sqrt(len(b)))
        assert abs(a.mean() - b.mean()) < limit * error
    # Numbers of kept alarms have at most a Poisson number's variance.
    assert abs(len(measured[0]) - len(simulated[0])) < limit * math.sqrt(2.0 * len(simulated[0]))
    in_both = detection.stops[0].reported & detection.stops[1].reported
    assert (detection.stops[0].range_m[in_both] <= detection.stops[1].range_m[in_both]).all()


def test_an_alarm_is_beside_the_strongest_echo():
    """Its source and true range are those of the pulse's strongest sub-echo, the second of three."""
    equipped = sensor("table1-apd", "tdc.threshold_to_noise=3.3", "tdc.stops=2", "tdc.window_us=2")
    power = trains.power_at_snr(equipped, 1.0) * np.array([0.2, 0.4, 0.3])
    detection = detect(train(np.tile((50.0, 70.0, 90.0), (4000, 1)), np.tile(power, (4000, 1))), equipped)
    for stop in detection.stops:
        alarms = stop.reported & (stop.status == Status.FALSE_ALARM)
        assert alarms.any()
        np.testing.assert_allclose(stop.true_range_m[alarms], 70.0)
        assert (stop.source[alarms] == 1).all()
