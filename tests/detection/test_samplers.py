"""What measures a pulse: against the Cramer-Rao bound, closed forms of widths, and quantisation."""

import math

import numpy as np
import pytest
from helpers import trains
from helpers.trains import FWHM_S, SIGMA_M, SIGMA_S, detect, sensor, train
from scipy.optimize import brentq
from scipy.stats import chi2, kstest, norm

from lidarscene.detection import returns
from lidarscene.errors import InputError
from lidarscene.light.echoes import Echoes
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics import sampling, saturation

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


def alone(equipped, snr, road, *, seed=6, widths=False):
    """One echo of this SNR at 100 m, many times, by either road: ranges and amplitudes, its power, working point,
    and the widths if asked for.
    """
    power, every = trains.power_at_snr(equipped, snr), np.ones(SHOTS)
    if road == "several":
        stop = detect(train(100.0 * every[:, None], power), equipped, seed=seed).stops[0]
    else:
        light = Echoes(
            found=every > 0.0, range_m=100.0 * every, peak_power_w=power * every,
            background_power_w=trains.BACKGROUND_W * every,
        )  # fmt: skip
        pulse = np.arange(SHOTS, dtype=np.uint32)
        stop = returns.detect(light, equipped, seed=seed, pulse=pulse).stops[0]
    kept = stop.reported & (stop.status == 0)
    assert kept.mean() > 0.999  # a false alarm or two
    point = equipped.working_point(np.array([trains.BACKGROUND_W]))
    found = stop.range_m[kept], stop.amplitude[kept], power, point
    return (*found, stop.width_s[kept]) if widths else found


def sigma_of(point, signal):
    """(13) by hand."""
    return np.sqrt(point.noise[0] ** 2 + point.kappa_1 * signal + point.kappa_2 * signal**2)


def deviate_at(equipped, point, level):
    """z of s + z sigma(s) = U."""
    return (equipped.threshold(point)[0] - level) / sigma_of(point, level)


@pytest.mark.parametrize("road", ["one", "several"])
@pytest.mark.parametrize(("name", "snr"), [("table1-apd", 30.0), ("table1-sipm", 20.0)])
def test_noise_of_the_tdcs_amplitude(name, snr, road):
    """A pole of bandwidth B keeps exp(-2 pi B t) of the edge's deviate for the peak, t later; the rest is new.

    The raw range tells the edge's deviate of each shot: a level s = signal(P g(t)) was reached where s + z sigma(s)
    = U. What the peak has beyond that must be standard normal and know nothing of z: Kolmogorov and Smirnov, and a
    correlation, at 1e-4 each. B is 20 MHz, so that half of the deviate is kept.
    """
    equipped = sensor(name, "tdc.bandwidth_mhz=20", "tdc.walk='raw'")
    range_m, amplitude, power, point = alone(equipped, snr, road)
    early_s = (range_m - 100.0) / HALF_C
    deviate = deviate_at(equipped, point, point.signal(power * np.exp(-0.5 * (early_s / SIGMA_S) ** 2)))
    assert kstest(deviate, "norm").pvalue > 1e-4
    peak = point.signal(np.array([power]))[0]
    of_peak = (amplitude - peak) / sigma_of(point, peak)
    kept = np.exp(-2.0 * math.pi * 20e6 * np.abs(early_s))
    assert 0.3 < kept.mean() < 0.7
    fresh = (of_peak - kept * deviate) / np.sqrt(1.0 - kept**2)
    assert kstest(fresh, "norm").pvalue > 1e-4
    assert abs(np.corrcoef(fresh, deviate)[0, 1]) < norm.isf(0.5e-4) / math.sqrt(SHOTS)


@pytest.mark.parametrize("road", ["one", "several"])
@pytest.mark.parametrize(("name", "snr"), [("table1-apd", 12.0), ("table1-sipm", 12.0)])
def test_noise_of_the_trailing_edge(name, snr, road):
    """What the pole keeps of the first edge's deviate until the last one is in that; the rest is new.

    The raw range tells the first deviate, range and width the place of the last edge and so its deviate. Half of the
    time between them is taken as before the peak: both edges by the first one's level. Tests at 1e-4 as above.
    """
    equipped = sensor(name, "tdc.bandwidth_mhz=10", "tdc.walk='raw'", "tdc.edges='both'")
    range_m, _, power, point, width_s = alone(equipped, snr, road, widths=True)
    early_s = (range_m - 100.0) / HALF_C
    first, last = (
        deviate_at(equipped, point, point.signal(power * np.exp(-0.5 * (t / SIGMA_S) ** 2)))
        for t in (early_s, early_s + width_s)
    )
    kept = np.exp(-2.0 * math.pi * 10e6 * 2.0 * np.abs(early_s))
    assert 0.4 < kept.mean() < 0.8
    fresh = (last - kept * first) / np.sqrt(1.0 - kept**2)
    assert kstest(fresh, "norm").pvalue > 1e-4
    assert abs(np.corrcoef(fresh, first)[0, 1]) < norm.isf(0.5e-4) / math.sqrt(SHOTS)


@pytest.mark.parametrize("road", ["one", "several"])
@pytest.mark.parametrize("name", ["table1-apd", "table1-sipm"])
def test_walk_that_the_amplitude_tells(name, road):
    """Shot by shot: corrected less raw is how long before its peak a pulse of the measured height is at U.

    Reference: t = sigma_p sqrt(2 ln(P / P_U)); of the APD the ratio of powers is that of the signals, of N free cells
    it is ln(1 - s / N) / ln(1 - U / N). Tolerance: rounding.
    """
    raw_m, raw_amplitude, _, _ = alone(sensor(name, "tdc.walk='raw'"), 15.0, road)
    equipped = sensor(name)
    range_m, amplitude, _, point = alone(equipped, 15.0, road)
    level = equipped.threshold(point)[0]
    np.testing.assert_array_equal(raw_amplitude, amplitude)
    ratio = amplitude / level
    if name == "table1-sipm":
        free = 400.0 - point.busy[0]
        ratio = np.log1p(-amplitude / free) / np.log1p(-level / free)
    np.testing.assert_allclose(
        range_m - raw_m, HALF_C * SIGMA_S * np.sqrt(2.0 * np.log(ratio)), rtol=1e-9, atol=1e-9
    )


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


@pytest.mark.parametrize("bandwidth_mhz", [50.0, 167.0])
def test_noise_of_samples_in_a_row(bandwidth_mhz):
    """A pole of bandwidth B keeps rho = exp(-2 pi B / rate) of a sample's noise for the next one.

    Reference: the variance that samples with correlations rho^|i - j| and the weights g / sum(g^2) have, and the range
    with the slope's weights; 6 % for 20 000 shots and samples that are cut at four pulse widths. White noise would be
    off by 30 % and more.
    """
    snr, options = 200.0, [f"tdc.bandwidth_mhz={bandwidth_mhz}", *WHITE[1:], *ADC]
    error_m, amplitude, _ = readings(snr, *options)
    place = np.arange(-30, 31) * 1e-9 / SIGMA_S
    pulse, slope = np.exp(-0.5 * place**2), place * np.exp(-0.5 * place**2)
    rho = np.exp(-2.0 * math.pi * bandwidth_mhz * 1e6 * 1e-9) ** np.abs(
        np.subtract.outer(np.arange(61), np.arange(61))
    )
    wanted = math.sqrt(pulse @ rho @ pulse) / (pulse @ pulse) / snr
    assert wanted > 1.3 / math.sqrt(pulse @ pulse) / snr
    assert amplitude.std() == pytest.approx(wanted, rel=0.06)
    wanted_m = HALF_C * SIGMA_S * math.sqrt(slope @ rho @ slope) / (slope @ slope) / snr
    assert error_m.std() == pytest.approx(wanted_m, rel=0.06)


def test_width_that_samples_tell():
    """Samples over the threshold, anywhere on the clock: on average rate times the time that the pulse is over it.

    To five deviations of the mean, and 1 % for noise at the edges; each is a whole number of samples.
    """
    for snr in (30.0, 100.0):
        _, _, width_s = readings(snr, *WHITE, *ADC)
        wanted_s = 2.0 * SIGMA_S * math.sqrt(2.0 * math.log(snr / 7.0))
        assert width_s.mean() == pytest.approx(
            wanted_s, abs=5.0 * width_s.std() / math.sqrt(SHOTS) + 0.01 * wanted_s
        )
        np.testing.assert_allclose(width_s * 1e9, np.rint(width_s * 1e9), atol=1e-9)


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


@pytest.mark.parametrize(("name", "snr"), [("table1-apd", 50.0), ("table1-sipm", 20.0)])
@pytest.mark.parametrize("walk", ["raw", "none"])
def test_levels_without_walk_correction_are_the_tdc(walk, name, snr):
    """Raw and known walks are those of the first comparator, shot by shot; a known one is that of a clean pulse."""
    by_levels = readings(snr, *LEVELS, f"tdc.walk='{walk}'", name=name)[0]
    alone_m = readings(snr, f"tdc.walk='{walk}'", name=name)[0]
    np.testing.assert_allclose(by_levels, alone_m, atol=1e-9)
    if walk == "none":
        equipped = sensor(name)
        point = equipped.working_point(np.array([trains.BACKGROUND_W]))
        ratio = trains.power_at_snr(equipped, snr) / point.power_w(equipped.threshold(point))[0]
        raw_m = readings(snr, *LEVELS, "tdc.walk='raw'", name=name)[0]
        np.testing.assert_allclose(
            by_levels - raw_m, HALF_C * SIGMA_S * math.sqrt(2.0 * math.log(ratio)), atol=1e-9
        )


@pytest.mark.parametrize(
    ("name", "recovery_s"), [("table1-sipm", None), ("table1-apd", None), ("table1-apd", 5e-9)]
)
def test_walk_that_the_levels_tell(name, recovery_s):
    """Shot by shot: half of the width of an even pulse, also of a SiPM, whose cells saturate but whose edges pass a
    level at the same power. Of a pulse that drains, what a clean one of this width is early by.

    Reference: the width of a clean pulse (`width_at_level_s`, which a grid of 1 ps holds) solved for its peak by SciPy.
    """
    drains = (
        [] if recovery_s is None else ["detector.saturation_ua=2", f"detector.recovery_ns={1e9 * recovery_s}"]
    )
    options = [*LEVELS, *drains]
    snr = 20.0 if name == "table1-sipm" else 200.0
    error_m, _, width_s = readings(snr, *options, name=name)
    raw_m, _, _ = readings(snr, *options, "tdc.walk='raw'", name=name)
    early_s = 0.5 * width_s
    if recovery_s is not None:
        equipped = sensor(name, *options)
        point = equipped.working_point(np.array([trains.BACKGROUND_W]))
        level = equipped.threshold(point)[0]
        error_m, raw_m, width_s = error_m[:200], raw_m[:200], width_s[:200]

        def too_wide_s(overdrive, width_s):
            return width_s - saturation.width_at_level_s(
                level=level,
                signal=level * np.exp(overdrive),
                saturation=2e-6,
                fwhm_s=FWHM_S,
                recovery_s=recovery_s,
            )

        overdrives = np.array([brentq(too_wide_s, 1e-9, 80.0, args=(one,), xtol=1e-12) for one in width_s])
        assert np.exp(overdrives.mean()) * level > 4e-6  # they do clip
        early_s = SIGMA_S * np.sqrt(2.0 * overdrives)
        assert np.abs(early_s / (0.5 * width_s) - 1.0).min() > 0.05
    # Of the table: bisection to 1e-7 of the overdrive.
    np.testing.assert_allclose(error_m - raw_m, HALF_C * early_s, rtol=1e-6, atol=1e-9)


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
        2.0 * snr, *WHITE, *ADC, "tdc.threshold_to_noise=50", "sampler.estimator='centroid'",
        sub_echoes=((0.0, 0.5), (places * SIGMA_M, 0.5)),
    )  # fmt: skip
    crossing = -math.sqrt(2.0 * math.log(snr / 50.0))
    spacing, width = 1e-9 / SIGMA_S, FWHM_S / SIGMA_S
    centroids = []
    for phase in (np.arange(500) + 0.5) / 500.0:
        at = crossing - width + spacing * (phase + np.arange(25))
        height = snr * (np.exp(-0.5 * at**2) + np.exp(-0.5 * (at - places) ** 2))
        kept = (height >= 50.0) & ((at < 0.5 * places) | (not apart))
        centroids.append((at * height)[kept].sum() / height[kept].sum())
    assert (np.mean(centroids) < 0.01) == apart
    tolerance = 5.0 * error_m.std() / math.sqrt(len(error_m)) + 0.01 * SIGMA_M
    assert error_m.mean() == pytest.approx(np.mean(centroids) * SIGMA_M, abs=tolerance)


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
        ([*ADC, "sampler.rate_mhz=100"], "sampler.rate_mhz: must be >= 166.667"),
        (
            ["sampler.type='multi_level_tdc'", "sampler.levels=[4, 2]"],
            "levels: must be rising numbers, got [4.0, 2.0]",
        ),
        (["sampler.type='multi_level_tdc'", "sampler.levels=[1]"], "levels"),
        (["tdc.keep='all'", "tdc.stops=2"], "stops: not together with"),
        (
            ["sampler.type='adc'", "sampler.rate_mhz=43000", "sampler.bits=8", "sampler.full_scale=1"],
            "sampler.rate_mhz: must be <= 42625 (1024 samples in four pulse widths), got 43000",
        ),
    ],
)
def test_mistakes_are_told(overrides, message):
    with pytest.raises(InputError) as told:
        sensor("table1-apd", *overrides)
    assert message in str(told.value), str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(("rate_mhz", "samples"), [(1e3 / 6.0, 5), (41e3, 985), (42625, 1024)])
def test_rates_at_their_limits(rate_mhz, samples):
    """One sample in a pulse of 6 ns is the least that is taken, 1024 in four pulse widths the most, ends included."""
    adc = sensor("table1-apd", *ADC, f"sampler.rate_mhz={rate_mhz!r}").sampler
    assert (adc.samples, adc.rate_hz) == (samples, rate_mhz * 1e6)
    assert adc.room > samples
    outside = rate_mhz + math.copysign(0.01, samples - 100)
    if samples in (5, 1024):
        with pytest.raises(InputError, match=r"sampler\.rate_mhz: must be [<>]="):
            sensor("table1-apd", *ADC, f"sampler.rate_mhz={outside!r}")
