"""The undershoot behind an echo: closed form against the sampled pulse through the filter, by FFT."""

import math

import numpy as np
import pytest

from lidarscene.physics.amplifier import high_pass

STEP = 0.05
PLACE = STEP * (np.arange(1 << 17) - (1 << 13))  # in sigma_p; 6100 long, some 12 recoveries at the lowest rate
PULSE = np.exp(-0.5 * PLACE**2)
RATES = [0.002, 0.016, 0.1]


def couple(values, rate):
    """Pulse behind H = i nu / (f + i nu), by FFT; a sample's share of the step keeps the discrete pulse whole."""
    ratio = 2.0 * math.pi * np.fft.rfftfreq(len(values), STEP) / rate
    return np.fft.irfft(np.fft.rfft(values) * (1j * ratio) / (1.0 + 1j * ratio), len(values))


@pytest.mark.parametrize("rate", RATES)
def test_undershoot_is_what_the_filter_takes_off(rate):
    """1e-4 of the depth: the transform repeats after 12 recoveries."""
    expected = PULSE - couple(PULSE, rate)
    undershoot, _, _ = high_pass.undershoot(place=PLACE, rate=rate)
    np.testing.assert_allclose(undershoot, expected, atol=1e-3 * expected.max())
    assert undershoot.sum() == pytest.approx(PULSE.sum(), rel=1e-3)  # nothing constant passes


@pytest.mark.parametrize("rate", RATES)
def test_derivatives_of_the_undershoot(rate):
    """Central differences; the form for Phi is not quite what its slope is taken of: 1.5e-3 of the largest."""
    place = np.linspace(-8.0, 60.0, 500)
    _, slope, bend = high_pass.undershoot(place=place, rate=rate)
    step = 0.01
    (before, before_slope, _), (after, after_slope, _) = (
        high_pass.undershoot(place=place + offset, rate=rate) for offset in (-step, step)
    )
    np.testing.assert_allclose(slope, (after - before) / (2.0 * step), atol=1.5e-3 * rate)
    np.testing.assert_allclose(bend, (after_slope - before_slope) / (2.0 * step), atol=1.5e-3 * rate)


@pytest.mark.parametrize("rate", RATES)
def test_peak_behind_the_filter(rate):
    """w^2 / 2 of the place is left out, so w^4 of the height; bins of 0.05 sigma_p miss 3e-4 of it."""
    remaining = PULSE - high_pass.undershoot(place=PLACE, rate=rate)[0]
    assert float(high_pass.peak_share(rate=rate)) == pytest.approx(remaining.max(), rel=5e-4)
    assert PLACE[np.argmax(remaining)] == pytest.approx(-rate, abs=1.3 * rate**2 + STEP)


def test_far_away_nothing_is_left():
    """Places that no pulse has are 1e30 away; the device has single precision."""
    with np.errstate(over="ignore"):
        for far in (-1e30, 1e30):
            parts = high_pass.undershoot(place=np.float32([far]), rate=np.float32(0.1))
            assert all(abs(float(part[0])) < 1e-30 for part in parts)


def test_samples_behind_the_filter():
    """A pulse, and a ramp, whose answer is (1 - exp(-omega t)) / omega."""
    coupling_hz, step_s = 1e6, 1e-9
    omega = 2.0 * math.pi * coupling_hz
    time = step_s * np.arange(2000)
    filtered = high_pass.filter_samples(values=time, step_s=step_s, coupling_hz=coupling_hz)
    np.testing.assert_allclose(filtered, -np.expm1(-omega * time) / omega, rtol=1e-9, atol=1e-20)
    sigma = 2.5e-9
    place = (time - 40e-9) / sigma
    pulse = np.exp(-0.5 * place**2)
    expected = pulse - high_pass.undershoot(place=place, rate=omega * sigma)[0]
    filtered = high_pass.filter_samples(values=pulse, step_s=step_s, coupling_hz=coupling_hz)
    np.testing.assert_allclose(filtered, expected, atol=3e-4)  # straight lines between samples 0.4 sigma_p apart
