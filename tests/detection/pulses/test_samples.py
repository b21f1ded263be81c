"""What an ADC reads of a pulse: against the Cramer-Rao bound, the noise of samples in a row, and quantisation."""

import math

import numpy as np
import pytest
from helpers import trains
from helpers.readings import ADC, CLEAN, SHOTS, WHITE, on_light, readings
from helpers.trains import FWHM_S, SIGMA_M, SIGMA_S, detect, sensor, train
from scipy.stats import chi2, norm

from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics import sampling
from lidarscene.physics.reference import electronics as reference_electronics

HALF_C = 0.5 * SPEED_OF_LIGHT_M_S


@pytest.mark.parametrize("snr", [30.0, 100.0, 300.0])
def test_matched_filter_reaches_the_cramer_rao_bound(snr):
    """Deviation at a high SNR, to 5 %: no unbiased estimate does better, and white noise is what a matched filter is
    for.

    Chi-square at 1e-4 on either side, bias by a z-test at 1e-4. At SNR 30 and below the bound itself is a limit.
    """
    error, amplitude, _ = readings(snr, *WHITE, *ADC)
    bound = HALF_C * reference_electronics.least_time_deviation_s(snr=snr, rate_hz=1e9, pulse_fwhm_s=FWHM_S)
    count = len(error)
    low, high = (math.sqrt(chi2.ppf(p, count - 1) / (count - 1)) for p in (1e-4, 1.0 - 1e-4))
    assert low * bound < error.std() < 1.05 * high * bound
    assert abs(error.mean()) < norm.isf(0.5e-4) * error.std() / math.sqrt(count)
    # Of the amplitude: sigma over the root of the sum of g^2, rate sqrt(pi) sigma_p samples.
    assert amplitude.std() == pytest.approx(1.0 / snr / math.sqrt(1e9 * math.sqrt(math.pi) * SIGMA_S), rel=0.05)


def test_the_bound_is_that_of_the_sum_over_samples():
    """Its integral over time against the sum at any phase of the clock."""
    for phase in (0.0, 0.3, 0.7):
        time = (np.arange(-40, 41) + phase) * 1e-9 / SIGMA_S
        information = ((time * np.exp(-0.5 * time**2)) ** 2).sum() / SIGMA_S**2
        bound = reference_electronics.least_time_deviation_s(snr=50.0, rate_hz=1e9, pulse_fwhm_s=FWHM_S)
        assert bound == pytest.approx(1.0 / math.sqrt(information) / 50.0, rel=1e-9)


@pytest.mark.parametrize("snr", [30.0, 100.0, 300.0])
def test_the_centroid_is_unbiased(snr):
    """Cut at the same level on both sides: a z-test at 1e-4; and it cannot be better than the bound."""
    error, _, _ = readings(snr, *WHITE, *ADC, "sampler.estimator='centroid'")
    assert abs(error.mean()) < norm.isf(0.5e-4) * error.std() / math.sqrt(len(error))
    bound = HALF_C * reference_electronics.least_time_deviation_s(snr=snr, rate_hz=1e9, pulse_fwhm_s=FWHM_S)
    assert error.std() > bound


@pytest.mark.parametrize("bandwidth_mhz", [50.0, 167.0])
def test_noise_of_samples_in_a_row(bandwidth_mhz):
    """A pole of bandwidth B keeps rho = exp(-2 pi B / rate) of a sample's noise for the next one.

    Reference: the variance that samples with correlations rho^|i - j| and the weights g / sum(g^2) have, and the range
    with the slope's weights; 6 % for 8000 shots (0.8 %) and samples that are cut at four pulse widths. White noise
    would be off by 30 % and more.
    """
    snr, options = 200.0, [f"tdc.bandwidth_mhz={bandwidth_mhz}", *WHITE[1:], *ADC]
    error_m, amplitude, _ = readings(snr, *options)
    place = np.arange(-30, 31) * 1e-9 / SIGMA_S
    pulse, slope = np.exp(-0.5 * place**2), place * np.exp(-0.5 * place**2)
    rho = np.exp(-2.0 * math.pi * bandwidth_mhz * 1e6 * 1e-9) ** np.abs(np.subtract.outer(np.arange(61), np.arange(61)))
    expected = math.sqrt(pulse @ rho @ pulse) / (pulse @ pulse) / snr
    assert expected > 1.3 / math.sqrt(pulse @ pulse) / snr
    assert amplitude.std() == pytest.approx(expected, rel=0.06)
    wanted_m = HALF_C * SIGMA_S * math.sqrt(slope @ rho @ slope) / (slope @ slope) / snr
    assert error_m.std() == pytest.approx(wanted_m, rel=0.06)


def test_width_that_samples_tell():
    """Samples over the threshold, anywhere on the clock: on average rate times the time that the pulse is over it.

    To five deviations of the mean, and 1 % for noise at the edges; each is a whole number of samples.
    """
    for snr in (30.0, 100.0):
        _, _, width_s = readings(snr, *WHITE, *ADC)
        wanted_s = 2.0 * SIGMA_S * math.sqrt(2.0 * math.log(snr / 7.0))
        assert width_s.mean() == pytest.approx(wanted_s, abs=5.0 * width_s.std() / math.sqrt(SHOTS) + 0.01 * wanted_s)
        np.testing.assert_allclose(width_s * 1e9, np.rint(width_s * 1e9), atol=1e-9)


def test_quantisation_noise():
    """Coarse steps add step / sqrt(12) to the noise of a sample, which the matched filter passes on to the amplitude.

    8 bits of 2560 sigma are steps of 10 sigma, 2.9 sigma of noise; the pulse's 30 sigma per sample move it over many
    steps, so that errors are evenly spread: 10 % for what is left of the steps' own pattern.
    """
    snr, sigma = (
        300.0,
        float(sensor("table1-apd", *WHITE).working_point(np.array([trains.BACKGROUND_W])).noise.deviation[0]),
    )
    coarse = ["sampler.bits=8", f"sampler.full_scale={2560.0 * sigma!r}"]
    _, amplitude, _ = readings(snr, *WHITE, *ADC, *coarse)
    noise = math.hypot(1.0, 10.0 / math.sqrt(12.0))
    gain = math.sqrt(1e9 * math.sqrt(math.pi) * SIGMA_S)
    assert amplitude.std() == pytest.approx(noise / snr / gain, rel=0.1)
    steps = np.random.default_rng(2).uniform(-50.0, 50.0, 1_000_000)
    error = sampling.quantise(signal=steps, step=1.0, full_scale=100.0) - steps
    assert error.std() == pytest.approx(1.0 / math.sqrt(12.0), rel=2e-3)  # 1e6 errors: 1e-3 / sqrt(2)


def test_an_adc_that_is_full_clips():
    """The centroid stays, since both sides are cut alike; the amplitude is full scale."""
    sigma = float(sensor("table1-apd", *WHITE).working_point(np.array([trains.BACKGROUND_W])).noise.deviation[0])
    error, amplitude, _ = readings(
        1000.0, *WHITE, *ADC, f"sampler.full_scale={500.0 * sigma!r}", "sampler.estimator='centroid'"
    )
    np.testing.assert_allclose(amplitude, 0.5, rtol=1e-9)
    assert abs(error.mean()) < norm.isf(0.5e-4) * error.std() / math.sqrt(len(error))


@pytest.mark.parametrize(("dip", "apart"), [(0.7, False), (0.3, True)])
def test_samples_end_below_half_of_the_threshold(dip, apart):
    """Two equal echoes with a dip between them, in thresholds: the window closes below a half and not above it.

    Reference: the centroid of a waveform without noise at all phases of the clock, of all samples of the window that
    are over the threshold or of those of the first echo. The threshold is 50 of the noise: half of it is 10 off the
    dip. Tolerance: five deviations of the mean and 1 % of sigma_p.
    """
    snr = 1400.0
    places = math.sqrt(8.0 * math.log(2.0 * snr / (50.0 * dip)))  # exp(-d^2 / 8) twice is the dip
    error_m, _, _ = readings(
        2.0 * snr,
        *WHITE,
        *ADC,
        "tdc.threshold_to_noise=50",
        "sampler.estimator='centroid'",
        sub_echoes=((0.0, 0.5), (places * SIGMA_M, 0.5)),
    )
    crossing = -math.sqrt(2.0 * math.log(snr / 50.0))
    spacing, width = 1e-9 / SIGMA_S, FWHM_S / SIGMA_S
    centroids = []
    for phase in (np.arange(500) + 0.5) / 500.0:
        sample_place = crossing - width + spacing * (phase + np.arange(25))
        height = snr * (np.exp(-0.5 * sample_place**2) + np.exp(-0.5 * (sample_place - places) ** 2))
        in_window = (height >= 50.0) & ((sample_place < 0.5 * places) | (not apart))
        centroids.append((sample_place * height)[in_window].sum() / height[in_window].sum())
    assert (np.mean(centroids) < 0.01) == apart
    tolerance = 5.0 * error_m.std() / math.sqrt(len(error_m)) + 0.01 * SIGMA_M
    assert error_m.mean() == pytest.approx(np.mean(centroids) * SIGMA_M, abs=tolerance)


def test_two_pulses_in_one_window_are_read_apart():
    """Two echoes 4 m apart, with the waveform below half of the threshold between them: each at its own place."""
    equipped = sensor("table1-apd", *WHITE, *ADC, "tdc.stops=2")
    power = trains.power_at_snr(equipped, 200.0)
    detection = detect(train(np.full((200, 2), (50.0, 54.0)), np.full((200, 2), power)), equipped)
    for stop, place in zip(detection.stops, (50.0, 54.0), strict=True):
        is_echo = stop.reported & (stop.status == 0)
        assert is_echo.mean() > 0.98
        assert np.median(stop.range_m[is_echo]) == pytest.approx(place, abs=0.05 * SIGMA_M)


def clean_pulses(height, *overrides, tick_s=1e-9, phases=97):
    """Errors in sigma_p, first returns, ranges and U of lone pulses of a height in U, over the phases of a clock."""
    equipped = sensor("table1-apd", *CLEAN, *ADC, f"sampler.rate_mhz={1e-6 / tick_s!r}", *overrides)
    range_m = 60.0 + HALF_C * tick_s * (np.arange(phases) + 0.5) / phases
    point = equipped.working_point(np.array([trains.BACKGROUND_W]))
    level = equipped.threshold(point)
    stop = detect(train(range_m[:, None], height * float(point.response.power_w(level)[0])), equipped).stops[0]
    assert stop.reported.all()
    return (stop.range_m - range_m) / SIGMA_M, stop, range_m, float(level[0])


CENTROID = "sampler.estimator='centroid'"


def test_samples_are_taken_at_the_ticks_of_the_clock():
    """A pulse that is over the threshold for less than a tick: its one sample is at a tick, a multiple of 1 ns after
    the pulse left, and it is over the threshold; without such a sample the crossing is all that is known.
    """
    height = 1.015
    error, stop, range_m, _ = clean_pulses(height, CENTROID)
    reach = math.sqrt(2.0 * math.log(height))  # 0.17 sigma_p: half of the time over the threshold, less than a tick
    tick = 1e-9 / SIGMA_S
    assert 2.0 * reach < tick
    ticks = stop.range_m / HALF_C / 1e-9
    sampled = stop.width_s > 0.0
    np.testing.assert_array_equal(stop.width_s[sampled], 1e-9)
    np.testing.assert_allclose(ticks[sampled], np.rint(ticks[sampled]), atol=1e-6)
    np.testing.assert_allclose(error[~sampled], -reach, atol=0.01)  # noise of 1e-4 over the slope of 0.17
    nearest = np.rint(range_m / HALF_C / 1e-9) * 1e-9 * HALF_C
    inside = np.abs(nearest - range_m) / SIGMA_M
    clear = np.abs(inside - reach) > 0.01
    np.testing.assert_array_equal(sampled[clear], (inside < reach)[clear])


def test_the_matched_filter_goes_uphill_from_one_sample():
    """Pulses with one sample over the threshold, up to 0.39 sigma_p off: two steps of Newton's method on exp(-x^2 / 4)
    go from x to x^3 / 2 and on to nothing.

    The window begins 2.4 sigma_p before the crossing, where exp(-x^2) / sqrt(pi) = 2e-3 of the slope's weight is left.
    """
    off = 0.5 * 2e-9 / SIGMA_S
    height = math.exp(0.5 * off**2)
    error, _, _, _ = clean_pulses(height, tick_s=2e-9)
    assert 0.5 * off**3 > 0.025
    assert np.abs(error).max() < 4e-3


def test_a_sample_at_the_threshold_is_over_it():
    """Steps of a quarter of the threshold: a sample counts from 3.5 steps on, and 4 of them are the threshold.

    Reference: the pulse at the ticks, rounded by hand; samples within six deviations of the noise
    (4e-4 steps each) of a half step may go either way.
    """
    level = clean_pulses(1.2, CENTROID)[3]
    _, stop, range_m, _ = clean_pulses(1.2, CENTROID, "sampler.bits=3", f"sampler.full_scale={2.0 * level!r}")
    step = level / 4.0
    time_s = 1e-9 * np.arange(380, 440)
    signal = 1.2 * level * np.exp(-0.5 * ((time_s - range_m[:, None] / HALF_C) / SIGMA_S) ** 2)
    steps = np.rint(signal / step)
    halves = np.abs(signal / step - np.floor(signal / step) - 0.5)
    sure = np.where(signal > 3.0 * step, halves, 1.0).min(axis=1) > 6.0 * 4e-4
    assert sure.mean() > 0.9
    counted = np.where(steps >= 4, steps, 0.0)
    assert (counted == 4).any(axis=1).mean() > 0.5
    np.testing.assert_allclose(stop.width_s[sure], 1e-9 * (counted > 0).sum(axis=1)[sure])
    expected_m = (counted * time_s).sum(axis=1) / counted.sum(axis=1) * HALF_C
    np.testing.assert_allclose(stop.range_m[sure], expected_m[sure], atol=1e-6)
    np.testing.assert_allclose(stop.amplitude[sure], step * counted.max(axis=1)[sure])


def test_samples_end_soon_after_the_crossing():
    """A weak pulse and a strong one 4.7 sigma_p behind it: the light is below half of the threshold from 1.7 to 2.6
    sigma_p after the crossing, with two samples at least. The centroid is the weak pulse's.
    """
    equipped = sensor("table1-apd", *CLEAN, *ADC, CENTROID)
    light, _, _ = on_light(equipped, [(60.0, 1.05), (60.0 + 4.7 * SIGMA_M, 10.0)], [])
    first = detect(light, equipped).stops[0]
    assert first.range_m[0] == pytest.approx(60.0, abs=0.3 * SIGMA_M)


def test_samples_of_a_pulse_on_light_that_lasts():
    """What the light has is taken off: the range is that of the pulse alone. The centroid moves by 0.07 sigma_p if one
    side has one sample more, at the threshold; the matched filter by its noise.

    The amplitude is the whole height. Behind a matched filter light that lasts is int g / int g^2 = sqrt(2) times as
    high as before it.
    """
    for overrides, gain, good_to in (([CENTROID], 1.0, 0.07), ([], math.sqrt(2.0), 0.01)):
        equipped = sensor("table1-apd", *CLEAN, *ADC, *overrides, "tdc.stops=2", "tdc.keep='strongest'")
        light, _, _ = on_light(equipped, [(50.0, 9.0), (60.0, 4.0)], [(50.0, 0.0), (51.0, 1.5), (80.0, 1.5)])
        second = detect(light, equipped).stops[1]
        point = equipped.working_point(light.background_power_w)
        level = equipped.threshold(point)[0]
        assert second.range_m[0] == pytest.approx(60.0, abs=good_to * SIGMA_M)
        assert second.amplitude[0] / level == pytest.approx(4.0 + 1.5 * gain, rel=0.01)


def test_samples_of_slow_light_are_those_of_its_peak():
    """Light over tens of metres trips the comparator far before its peak: the samples lie around that.

    The window ends three pulse widths behind 4.7 sigma_p before the peak and begins one before.
    """
    equipped = sensor("table1-apd", *CLEAN, *ADC)
    corners = [(30.0, 0.0), (59.0, 2.9), (60.0, 3.0), (61.0, 2.9), (90.0, 0.0)]
    light, _, _ = on_light(equipped, [(60.0, 0.0)], corners)
    first = detect(light, equipped).stops[0]
    assert first.reported[0]
    # Light that hardly bends in the window has no maximum there: the middle of the samples stays.
    begin = math.ceil((60.0 - 4.71 * SIGMA_M - 0.5 * SPEED_OF_LIGHT_M_S * FWHM_S) / HALF_C / 1e-9)
    middle_m = (begin + 0.5 * (equipped.sampler.samples - 1)) * 1e-9 * HALF_C
    assert first.range_m[0] == pytest.approx(middle_m, abs=0.3 * SIGMA_M)


def test_noise_of_two_pulses_of_a_shot_is_their_own():
    """Two equal echoes a whole number of ticks apart: their errors know nothing of each other, at 1e-6."""
    equipped = sensor("table1-apd", *WHITE, *ADC, "tdc.stops=2")
    power, apart_m = trains.power_at_snr(equipped, 100.0), 200 * 1e-9 * HALF_C
    light = train(np.full((2000, 2), (60.0, 60.0 + apart_m)), np.full((2000, 2), power))
    first, second = detect(light, equipped).stops
    in_both = first.reported & second.reported & (first.status == 0) & (second.status == 0)
    assert in_both.mean() > 0.99
    together = np.corrcoef(first.range_m[in_both], second.range_m[in_both])[0, 1]
    assert abs(together) < norm.isf(0.5e-6) / math.sqrt(in_both.sum())


def test_samples_have_the_noise_of_their_light():
    """Shot noise grows along the pulse: the height by least squares has the variance sum g^2 sigma(s)^2 / (sum g^2)^2.

    An amplifier without noise of its own, and so fast that samples know nothing of one another: 6 % for 8000 shots.
    """
    keys = ["tdc.bandwidth_mhz=2000", "detector.circuit_noise_na=0", "detector.load_resistance_ohm=1e9"]
    snr = 60.0
    equipped = sensor("table1-apd", *keys, *ADC, "sampler.full_scale=1e-3")
    _, amplitude, _ = readings(snr, *keys, *ADC, "sampler.full_scale=1e-3", "tdc.threshold_to_noise=7")
    point = equipped.working_point(np.array([trains.BACKGROUND_W])).unfiltered
    kappa = float(point.noise.kappa_1) / (snr * float(point.noise.deviation[0]))
    place = np.arange(-30, 31) * 1e-9 / SIGMA_S
    pulse = np.exp(-0.5 * place**2)
    variance = (pulse**2 * (snr**-2 + kappa * pulse)).sum() / (pulse**2).sum() ** 2
    assert variance > 2.0 * snr**-2 / (pulse**2).sum()
    assert amplitude.std() == pytest.approx(math.sqrt(variance), rel=0.06)


def test_samples_of_a_clipped_pulse_are_clipped():
    """The highest is the clipping level, to a step."""
    equipped = sensor(
        "table1-apd",
        *ADC,
        "detector.circuit_noise_na=1e4",
        "tdc.threshold_to_noise=100",
        CENTROID,
        "detector.saturation_ua=5e3",
        "sampler.full_scale=1",
    )
    light = train(np.full((50, 1), 60.0), np.full((50, 1), trains.power_at_snr(equipped, 1e4)))
    stop = detect(light, equipped).stops[0]
    np.testing.assert_allclose(stop.amplitude, 5e-3, atol=1.0 / 2**20)
