"""A Gaussian filter and a single pole: closed forms against the sampled pulse through the filter, by FFT."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from lidarscene.physics.amplifier.low_pass import LOW_PASSES

FWHM_S = 6e-9
SIGMA_S = FWHM_S / math.sqrt(8.0 * math.log(2.0))
STEP_S, SAMPLES = 1e-11, 1 << 16  # 0.66 us: the slowest filter has died away before the signal begins anew
TIME_S = STEP_S * (np.arange(SAMPLES) - SAMPLES // 4)
FREQUENCY_HZ = np.fft.rfftfreq(SAMPLES, STEP_S)
PULSE = np.exp(-0.5 * (TIME_S / SIGMA_S) ** 2)

TRANSFER = {
    "gaussian": lambda ratio: 2.0 ** (-0.5 * ratio**2) + 0j,
    "single_pole": lambda ratio: 1.0 / (1.0 + 1j * ratio),
}
KINDS = sorted(TRANSFER)


def low_pass_filter(values, kind, cutoff_hz):
    """A sampled signal behind the filter."""
    return np.fft.irfft(np.fft.rfft(values) * TRANSFER[kind](FREQUENCY_HZ / cutoff_hz), SAMPLES)


def impulse_response(kind, cutoff_hz):
    """h(t), of unit area."""
    if kind == "single_pole":
        rate = 2.0 * math.pi * cutoff_hz
        return np.where(TIME_S >= 0.0, rate * np.exp(-rate * np.maximum(TIME_S, 0.0)), 0.0)
    sigma = math.sqrt(math.log(2.0)) / (2.0 * math.pi * cutoff_hz)
    return np.exp(-0.5 * (TIME_S / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))


@pytest.mark.parametrize("cutoff_mhz", [5.0, 20.0, 58.0, 167.0, 900.0])
@pytest.mark.parametrize("kind", KINDS)
def test_peak_and_area_are_those_of_the_sampled_pulse(kind, cutoff_mhz):
    """1e-5: the samples are 10 ps apart, and a peak between two of them is 2e-6 higher."""
    cutoff_hz = cutoff_mhz * 1e6
    behind = low_pass_filter(PULSE, kind, cutoff_hz)
    share = float(LOW_PASSES[kind].peak_share(fwhm_s=FWHM_S, cutoff_hz=cutoff_hz))
    assert share == pytest.approx(behind.max(), rel=1e-5)
    assert behind.sum() == pytest.approx(PULSE.sum(), rel=1e-9)


def half_width_s(values):
    """Time between the two places at half the peak."""
    top = int(np.argmax(values))
    rise = np.interp(0.5 * values[top], values[:top], TIME_S[:top])
    fall = np.interp(-0.5 * values[top], -values[top:], TIME_S[top:])
    return fall - rise


@pytest.mark.parametrize(("ratio", "steeper", "width"), [(1.0, 1.03, 0.01), (0.64, 1.07, 0.02), (0.35, 1.2, 0.05)])
def test_edge_behind_a_single_pole(ratio, steeper, width):
    """How much the edge, at a fifth of the peak, is steeper than that of the Gaussian that stands for the pulse.

    As the module says it, to 1 % of the slope; the width at half of the peak is that of the Gaussian within 1, 2, 5 %.
    """
    cutoff_hz = ratio / FWHM_S
    behind = low_pass_filter(PULSE, "single_pole", cutoff_hz)
    share = float(LOW_PASSES["single_pole"].peak_share(fwhm_s=FWHM_S, cutoff_hz=cutoff_hz))
    top = int(np.argmax(behind))
    slope = np.interp(0.2 * share, behind[:top], np.gradient(behind, STEP_S)[:top])
    sigma = SIGMA_S / share
    gaussian = 0.2 * share * math.sqrt(2.0 * math.log(5.0)) / sigma
    assert slope / gaussian == pytest.approx(steeper, abs=0.01)
    assert half_width_s(behind) == pytest.approx(FWHM_S / share, rel=width)


@pytest.mark.parametrize("kind", KINDS)
def test_bandwidth_of_the_noise(kind):
    power = quad(lambda ratio: abs(TRANSFER[kind](ratio)) ** 2, 0.0, math.inf)[0]
    assert LOW_PASSES[kind].noise_ratio == pytest.approx(power, rel=1e-9)
    assert abs(TRANSFER[kind](1.0)) ** 2 == pytest.approx(0.5)


def filter_by_response(values, response):
    """Values filtered by an impulse response that is sampled around time 0."""
    return np.fft.irfft(np.fft.rfft(values) * np.fft.rfft(np.roll(response, -(SAMPLES // 4))), SAMPLES)


@pytest.mark.parametrize("cutoff_mhz", [20.0, 58.0, 167.0])
@pytest.mark.parametrize("kind", KINDS)
def test_noise_of_the_echo_is_filtered_by_the_square(kind, cutoff_mhz):
    """The noise is that at the peak of the filtered pulse; of a single pole the form is the largest, up to 3.5 %
    more.
    """
    cutoff_hz = cutoff_mhz * 1e6
    squared = impulse_response(kind, cutoff_hz) ** 2
    at_peak = filter_by_response(PULSE, squared / squared.sum())[np.argmax(low_pass_filter(PULSE, kind, cutoff_hz))]
    noise_share = float(LOW_PASSES[kind].echo_noise_share(fwhm_s=FWHM_S, cutoff_hz=cutoff_hz))
    assert -1e-5 < noise_share / at_peak - 1.0 < (1e-5 if kind == "gaussian" else 0.035)


@pytest.mark.parametrize("kind", KINDS)
def test_correlation_of_the_noise(kind):
    """Wiener-Khinchin: the transform of |H|^2. 2e-3: a single pole has noise beyond the highest frequency."""
    cutoff_hz = 50e6
    correlation = np.fft.irfft(abs(TRANSFER[kind](FREQUENCY_HZ / cutoff_hz)) ** 2, SAMPLES)
    lag = np.arange(0, 2000, 125)
    computed = LOW_PASSES[kind].correlation(lag_s=lag * STEP_S, cutoff_hz=cutoff_hz)
    np.testing.assert_allclose(computed, correlation[lag] / correlation[0], atol=2e-3)
    assert computed[0] == 1.0


@pytest.mark.parametrize("cutoff_mhz", [10.0, 58.0, 400.0])
@pytest.mark.parametrize("kind", KINDS)
def test_a_cell_and_the_noise_of_many(kind, cutoff_mhz):
    """A rectangle of 6 ns: its peak, and the area of its square over 6 ns (Campbell's theorem)."""
    cutoff_hz, long_s = cutoff_mhz * 1e6, 6e-9
    box = (np.abs(TIME_S - 0.5 * (long_s - STEP_S)) < 0.5 * long_s).astype(float)
    behind = low_pass_filter(box, kind, cutoff_hz)
    filtering = LOW_PASSES[kind]
    peak = float(filtering.box_peak_share(duration_s=long_s, cutoff_hz=cutoff_hz))
    noise = float(filtering.box_noise_share(duration_s=long_s, cutoff_hz=cutoff_hz))
    assert peak == pytest.approx(behind.max(), rel=5e-3)  # a sample more or less
    assert noise == pytest.approx((behind**2).sum() / box.sum(), rel=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_single_precision(kind):
    """Computed as on the device, from a filter of no use to one of no effect."""
    cutoff_hz = np.geomspace(1e5, 1e12, 400)
    double = LOW_PASSES[kind].peak_share(fwhm_s=FWHM_S, cutoff_hz=cutoff_hz)
    single = LOW_PASSES[kind].peak_share(fwhm_s=np.float32(FWHM_S), cutoff_hz=cutoff_hz.astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, double, rtol=3e-6)
    assert (np.diff(double) > -1e-12).all()
