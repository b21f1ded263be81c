"""Limits of a SiPM's response in time: short and long pulses, and what is long past."""

import math

import numpy as np
import pytest

from lidarscene.physics.electronics import sipm_response

SIGMAS = math.sqrt(8.0 * math.log(2.0))


@pytest.mark.parametrize("fwhm_s", [0.5e-9, 5e-9, 20e-9, 80e-9])
def test_cells_of_a_weak_pulse_that_are_busy_at_once(fwhm_s):
    """In the dark each photon keeps a cell busy for 20 ns: at any time those of the last 20 ns are, most of all when
    that window lies around the light's peak. By sums over the pulse.
    """
    dead_s = 20e-9
    time_s = np.linspace(-4.0, 4.0, 8001) * max(fwhm_s, dead_s)
    come = np.cumsum(np.exp(-0.5 * (time_s * SIGMAS / fwhm_s) ** 2))
    come /= come[-1]
    busy = come - np.interp(time_s - dead_s, time_s, come, left=0.0)
    fired = sipm_response.fired_by_pulse(
        peak=busy.max(), rate_hz=np.array([0.0]), pulse_fwhm_s=fwhm_s, dead_time_s=dead_s
    )
    assert fired[0] == pytest.approx(1.0, rel=2e-3)
    lag_s = float(sipm_response.peak_lag_s(pulse_fwhm_s=np.array([fwhm_s]), dead_time_s=dead_s)[0])
    assert busy[np.searchsorted(time_s, lag_s)] == pytest.approx(busy.max(), rel=0.03)


def test_what_is_two_dead_times_ago_is_over():
    """Before, more or fewer cells are busy than the background keeps."""
    left = sipm_response.left_busy(
        age_s=np.array([10.0, 25.0, 41.0, 60.0, 200.0]) * 1e-9, rate_hz=5e7, dead_time_s=20e-9, sigma_s=1e-10
    )
    assert left[0] > 0.1 > -0.05 > left[1]
    np.testing.assert_array_equal(left[2:], 0.0)
