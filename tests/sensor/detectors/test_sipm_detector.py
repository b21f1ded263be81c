"""Few busy cells of many, in double and in single precision."""

import numpy as np
import pytest
from helpers import trains

from lidarscene import load_sensor
from lidarscene.kernel.device import transfer


@pytest.mark.parametrize("cells", [400, 10**6])
def test_few_busy_ones_of_many_cells_keep_their_digits(cells, mi):
    """Noise that rises through 1.3 cells at night, in double and in single precision; all less the free ones are not
    the busy ones there.
    """
    equipped = load_sensor("sipm-905", overrides=[f"detector.cells={cells}", "detector.dark_count_rate_hz=100"])
    rates = [
        sensor.working_point(dark).crossing_rate_hz(1.3 + dark, 1.0)
        for sensor, dark in ((equipped, np.zeros(2)), (transfer.opaque(equipped), mi.Float([0.0, 0.0])))
    ]
    np.testing.assert_allclose(rates[1].numpy(), rates[0], rtol=1e-5)


def test_a_count_behind_a_slow_high_pass_passes_the_threshold_as_without_one():
    """Pulse by pulse: P_d, and the place at which the count passes it. The high pass takes 7e-5 of a peak."""
    in_time = ("detector.statistics='time_domain'", "tdc.threshold_to_noise=4")
    plain, coupled = (trains.sensor("table1-sipm", *in_time, *high) for high in ((), ("receiver.ac_coupling_khz=1",)))
    power_w = trains.power_at_snr(plain, 5.0)
    light = trains.train(np.full((500, 1), 100.0), np.full((500, 1), power_w))
    by_plain, by_coupled = (trains.detect(light, equipped) for equipped in (plain, coupled))
    assert by_plain.stops[0].reported.mean() > 0.5
    np.testing.assert_allclose(by_coupled.detection_probability, by_plain.detection_probability, rtol=1e-3)
    assert np.median(np.abs(by_coupled.stops[0].range_m - by_plain.stops[0].range_m)) < 1e-4
