"""Limits of a SiPM's response in time: short and long pulses, and what is long past."""

import math

import numpy as np
import pytest

from lidarscene.physics.electronics import sipm, sipm_response

SIGMAS = math.sqrt(8.0 * math.log(2.0))


@pytest.mark.parametrize("fwhm_s", [0.5e-9, 5e-9, 20e-9, 80e-9])
def test_cells_of_a_weak_pulse_that_are_busy_at_once(fwhm_s):
    """Each photon keeps, in the dark, a cell busy for 20 ns: at any time those of the last 20 ns are, most of all when
    that window lies around the light's peak. By sums over the pulse.
    """
    dead_s = 20e-9
    time_s = np.linspace(-4.0, 4.0, 8001) * max(fwhm_s, dead_s)
    arrived = np.cumsum(np.exp(-0.5 * (time_s * SIGMAS / fwhm_s) ** 2))
    arrived /= arrived[-1]
    busy = arrived - np.interp(time_s - dead_s, time_s, arrived, left=0.0)
    fired = sipm_response.fired_by_pulse(
        peak=busy.max(), rate_hz=np.array([0.0]), pulse_fwhm_s=fwhm_s, dead_time_s=dead_s, cells=400.0
    )
    assert fired[0] == pytest.approx(1.0, rel=2e-3)
    lag_s = float(sipm_response.peak_lag_s(pulse_fwhm_s=np.array([fwhm_s]), dead_time_s=dead_s)[0])
    assert busy[np.searchsorted(time_s, lag_s)] == pytest.approx(busy.max(), rel=0.03)


def test_what_is_two_dead_times_ago_is_over():
    """More or fewer cells are busy before then than the background keeps."""
    residual = sipm_response.residual_busy(
        age_s=np.array([10.0, 25.0, 41.0, 60.0, 200.0]) * 1e-9, rate_hz=5e7, dead_time_s=20e-9, sigma_s=1e-10
    )
    assert residual[0] > 0.1 > -0.05 > residual[1]
    np.testing.assert_array_equal(residual[2:], 0.0)


@pytest.mark.parametrize("keys", [{}, {"crosstalk": 0.25}, {"afterpulse": 0.2, "afterpulse_to_dead_time": 1.5}])
def test_cells_in_steps_keep_their_balance(keys):
    """Nothing changes without light beyond the background's. With more of it, for long, the share with crosstalk is
    that of all firings, the fixed point of f (x + dx) / (1 - p f) with f ready.
    """
    busy = np.array([0.05, 0.3])
    steps = 50
    busy_share = sipm_response.busy_share_in_steps(rate=np.zeros((2, 500)), busy_share=busy, steps=steps, **keys)
    np.testing.assert_allclose(busy_share, busy[:, None] + 0.0 * busy_share, rtol=1e-9)
    if "afterpulse" in keys:
        return
    p, more = keys.get("crosstalk", 0.0), 0.4
    x = busy / (1.0 - busy) - p * busy
    expected = sipm.busy_share_correlated(
        firings=x + more, crosstalk=p, afterpulse=0.0 * x, afterpulse_to_dead_time=1.0 + 0.0 * x
    )
    busy_share = sipm_response.busy_share_in_steps(rate=np.full((2, 1000), more), busy_share=busy, steps=steps, **keys)
    np.testing.assert_allclose(busy_share[:, -1], expected, rtol=2e-3)


@pytest.mark.parametrize(
    ("keys", "avalanches"),
    [
        ({"crosstalk": 0.25}, 1.0 / 0.75),
        ({"afterpulse": 0.3, "afterpulse_to_dead_time": 1.5}, 1.0 / (1.0 - 0.3 * math.exp(-1.0 / 1.5))),
    ],
)
def test_weak_light_makes_so_many_avalanches_of_one(keys, avalanches):
    """The numbers in the dark: 1 / (1 - p) by crosstalk, and 1 / (1 - a e^(-tau / delay)) by afterpulses that find
    their cell ready again. The cells' busy time, summed, counts them.
    """
    steps = 50
    flash = np.zeros((1, 60 * steps))
    flash[0, 100] = 1e-4 * steps
    busy_share = sipm_response.busy_share_in_steps(rate=flash, busy_share=np.zeros(1), steps=steps, **keys)
    assert busy_share.sum() / steps == pytest.approx(1e-4 * avalanches, rel=2e-3)
