"""What measures a pulse: against the Cramer-Rao bound, closed forms of widths, and quantisation."""

import math

import numpy as np
import pytest
import trains
from scipy.stats import chi2, norm
from trains import FWHM_S, SIGMA_M, SIGMA_S, detect, sensor, train

from lidarscene.errors import InputError
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics import sampling

HALF_C = 0.5 * SPEED_OF_LIGHT_M_S
SHOTS = 20_000

# An amplifier so noisy that the echo's own noise is nothing, and so fast that samples know nothing of one another.
WHITE = ["tdc.bandwidth_mhz=2000", "detector.circuit_noise_na=1e6", "tdc.threshold_to_noise=7"]
ADC = ["sampler.type='adc'", "sampler.rate_mhz=1000", "sampler.bits=20", "sampler.full_scale=100"]
LEVELS = ["sampler.type='multi_level_tdc'", "sampler.levels=[2, 4, 8, 16]"]


def readings(snr, *overrides, sub_echoes=((0.0, 1.0),), name="table1-apd", seed=6):
    """Errors of the range [m], amplitudes over the peak, widths [s] of echoes at SNR ``snr`` anywhere on the clock.

    sub_echoes  places behind the first [m] and shares of the power
    """
    equipped = sensor(name, *overrides)
    range_m = np.random.default_rng(1).uniform(50.0, 60.0, SHOTS)
    offsets, shares = np.array(sub_echoes).T
    power = trains.power_at_snr(equipped, snr)
    light = train(range_m[:, None] + offsets, np.broadcast_to(power * shares, (SHOTS, len(shares))))
    stop = detect(light, equipped, seed=seed).stops[0]
    kept = stop.reported & (stop.status == 0)
    assert kept.mean() > 0.99
    width_s = np.zeros(SHOTS) if stop.width_s is None else stop.width_s
    signal = float(equipped.working_point(light.background_power_w[:1]).signal(np.array([power]))[0])
    return (stop.range_m - range_m)[kept], stop.amplitude[kept] / signal, width_s[kept]


@pytest.mark.parametrize("snr", [30.0, 100.0, 300.0])
def test_matched_filter_reaches_the_cramer_rao_bound(snr):
    """At a high SNR, to 5 %: no unbiased estimate does better, and white noise is what a matched filter is for.

    Chi-square at 1e-4 on either side, bias by a z-test at 1e-4. At SNR 30 and below the bound itself is a limit.
    """
    error, amplitude, _ = readings(snr, *WHITE, *ADC)
    bound = HALF_C * sampling.least_time_deviation_s(snr=snr, rate_hz=1e9, pulse_fwhm_s=FWHM_S)
    count = len(error)
    low, high = (math.sqrt(chi2.ppf(p, count - 1) / (count - 1)) for p in (1e-4, 1.0 - 1e-4))
    assert low * bound < error.std() < 1.05 * high * bound
    assert abs(error.mean()) < norm.isf(0.5e-4) * error.std() / math.sqrt(count)
    # Of the amplitude: sigma over the root of the sum of g^2, rate sqrt(pi) sigma_p samples.
    assert amplitude.std() == pytest.approx(
        1.0 / snr / math.sqrt(1e9 * math.sqrt(math.pi) * SIGMA_S), rel=0.05
    )


def test_the_bound_is_that_of_the_sum_over_samples():
    """Its integral over time against the sum at any phase of the clock."""
    for phase in (0.0, 0.3, 0.7):
        time = (np.arange(-40, 41) + phase) * 1e-9 / SIGMA_S
        information = ((time * np.exp(-0.5 * time**2)) ** 2).sum() / SIGMA_S**2
        bound = sampling.least_time_deviation_s(snr=50.0, rate_hz=1e9, pulse_fwhm_s=FWHM_S)
        assert bound == pytest.approx(1.0 / math.sqrt(information) / 50.0, rel=1e-9)


@pytest.mark.parametrize("snr", [30.0, 100.0, 300.0])
def test_the_centroid_is_unbiased(snr):
    """Cut at the same level on both sides: a z-test at 1e-4; and it cannot be better than the bound."""
    error, _, _ = readings(snr, *WHITE, *ADC, "sampler.estimator='centroid'")
    assert abs(error.mean()) < norm.isf(0.5e-4) * error.std() / math.sqrt(len(error))
    bound = HALF_C * sampling.least_time_deviation_s(snr=snr, rate_hz=1e9, pulse_fwhm_s=FWHM_S)
    assert error.std() > bound


def test_quantisation_noise():
    """Coarse steps add step / sqrt(12) to the noise of a sample, which the matched filter passes on to the amplitude.

    8 bits of 2560 sigma are steps of 10 sigma, 2.9 sigma of noise; the pulse's 30 sigma per sample move it over many
    steps, so that errors are evenly spread: 10 % for what is left of the steps' own pattern.
    """
    snr, sigma = (
        300.0,
        float(sensor("table1-apd", *WHITE).working_point(np.array([trains.BACKGROUND_W])).noise[0]),
    )
    coarse = ["sampler.bits=8", f"sampler.full_scale={2560.0 * sigma!r}"]
    _, amplitude, _ = readings(snr, *WHITE, *ADC, *coarse)
    noise = math.hypot(1.0, sampling.quantisation_noise(step=10.0))
    gain = math.sqrt(1e9 * math.sqrt(math.pi) * SIGMA_S)
    assert amplitude.std() == pytest.approx(noise / snr / gain, rel=0.1)
    steps = np.random.default_rng(2).uniform(-50.0, 50.0, 1_000_000)
    error = sampling.quantised(signal=steps, step=1.0, full_scale=100.0) - steps
    assert error.std() == pytest.approx(
        sampling.quantisation_noise(step=1.0), rel=2e-3
    )  # 1e6 errors: 1e-3 / sqrt(2)


def test_an_adc_that_is_full_clips():
    """The centroid stays, since both sides are cut alike; the amplitude is full scale."""
    sigma = float(sensor("table1-apd", *WHITE).working_point(np.array([trains.BACKGROUND_W])).noise[0])
    error, amplitude, _ = readings(
        1000.0, *WHITE, *ADC, f"sampler.full_scale={500.0 * sigma!r}", "sampler.estimator='centroid'"
    )
    np.testing.assert_allclose(amplitude, 0.5, rtol=1e-9)
    assert abs(error.mean()) < norm.isf(0.5e-4) * error.std() / math.sqrt(len(error))


@pytest.mark.parametrize("name", ["table1-apd", "table1-sipm"])
def test_levels_know_width_amplitude_and_walk(name):
    """Far above the noise: the width over the threshold is 2 sigma_p sqrt(2 ln(P / P_U)), the middle of it the peak,
    whatever the height: the walk error is gone. Means over 20 000 shots, to five of their deviations and 1 %.
    """
    quiet = [f"detector.circuit_noise_na={1e3}"] if name == "table1-apd" else []
    for snr in (15.0, 30.0):
        error, amplitude, width = readings(snr, *quiet, *LEVELS, "tdc.threshold_to_noise=6", name=name)
        equipped = sensor(name, *quiet, "tdc.threshold_to_noise=6")
        point = equipped.working_point(np.array([trains.BACKGROUND_W]))
        ratio = trains.power_at_snr(equipped, snr) / float(point.power_w(equipped.threshold(point))[0])
        wanted = 2.0 * SIGMA_S * math.sqrt(2.0 * math.log(ratio))
        assert width.mean() == pytest.approx(wanted, abs=5.0 * width.std() / math.sqrt(SHOTS) + 0.01 * wanted)
        assert abs(error.mean()) < 5.0 * error.std() / math.sqrt(SHOTS)
        assert amplitude.mean() == pytest.approx(1.0, abs=0.02)


def test_levels_tell_a_broad_echo_from_a_tall_one():
    """A surface that leans over 3 m: the width says so, and the middle is still its middle.

    The TDC alone takes off the walk of a clean pulse of that height and is early.
    """
    leaning = [(offset, 1.0 / 16) for offset in np.linspace(-1.5, 1.5, 16)]
    quiet = ["detector.circuit_noise_na=1e3"]
    flat = readings(100.0, *quiet, *LEVELS)
    broad = readings(100.0, *quiet, *LEVELS, sub_echoes=leaning)
    alone = readings(100.0, *quiet, sub_echoes=leaning)
    assert broad[2].mean() > flat[2].mean() + 5e-9
    assert abs(broad[0].mean()) < 0.02
    assert alone[0].mean() < -0.1


@pytest.mark.parametrize("walk", ["raw", "none"])
def test_levels_without_walk_correction_are_the_tdc(walk):
    """Raw and known walks are those of the first comparator, shot by shot."""
    for one, other in zip(
        readings(50.0, *LEVELS, f"tdc.walk='{walk}'")[:1],
        readings(50.0, f"tdc.walk='{walk}'")[:1],
        strict=True,
    ):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_two_pulses_in_one_window_are_read_apart():
    """Two echoes 4 m apart, with the waveform below half of the threshold between them: each at its own place."""
    equipped = sensor("table1-apd", *WHITE, *ADC, "tdc.stops=2")
    power = trains.power_at_snr(equipped, 200.0)
    found = detect(train(np.full((200, 2), (50.0, 54.0)), np.full((200, 2), power)), equipped)
    for stop, place in zip(found.stops, (50.0, 54.0), strict=True):
        here = stop.reported & (stop.status == 0)
        assert here.mean() > 0.98
        assert np.median(stop.range_m[here]) == pytest.approx(place, abs=0.05 * SIGMA_M)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["sampler.type='adc'"], "key 'sampler.rate_mhz' is missing"),
        ([*ADC, "sampler.rate_mhz=100"], "sampler.rate_mhz: at least 166.667 was expected"),
        (["sampler.type='multi_level_tdc'", "sampler.levels=[4, 2]"], "rising numbers were expected"),
        (["sampler.type='multi_level_tdc'", "sampler.levels=[1]"], "levels"),
        (["tdc.keep='all'", "tdc.stops=2"], "stops: not together with"),
        (
            ["sampler.type='adc'", "sampler.rate_mhz=43000", "sampler.bits=8", "sampler.full_scale=1"],
            "sampler.rate_mhz: at most 42625 was expected (1024 samples in four pulse widths), 43000 came",
        ),
    ],
)
def test_mistakes_are_told(overrides, message):
    with pytest.raises(InputError) as told:
        sensor("table1-apd", *overrides)
    assert message in str(told.value), str(told.value)
    assert "\n" not in str(told.value)
