"""What measures a pulse: against the Cramer-Rao bound, closed forms of widths, and quantisation."""

import math

import numpy as np
import pytest
from helpers import trains
from helpers.mistakes import told
from helpers.readings import ADC, CLEAN, SHOTS, on_light, readings
from helpers.trains import FWHM_S, SIGMA_M, SIGMA_S, detect, sensor, train
from scipy.optimize import brentq
from scipy.stats import kstest, norm

from lidarscene.detection import receiver
from lidarscene.light.echoes import Echoes
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.reference import electronics as reference_electronics

HALF_C = 0.5 * SPEED_OF_LIGHT_M_S
LEVELS = ["sampler.type='multi_level_tdc'", "sampler.levels=[2, 4, 8, 16]"]


def lone_echoes(equipped, snr, road, *, seed=6, widths=False):
    """One echo of this SNR at 100 m, many times, by either road: ranges and amplitudes, its power, working point,
    and the widths if asked for.
    """
    power, ones = trains.power_at_snr(equipped, snr), np.ones(SHOTS)
    if road == "several":
        stop = detect(train(100.0 * ones[:, None], power), equipped, seed=seed).stops[0]
    else:
        light = Echoes(
            has_surface=ones > 0.0,
            range_m=100.0 * ones,
            peak_power_w=power * ones,
            background_power_w=trains.BACKGROUND_W * ones,
        )
        pulse = np.arange(SHOTS, dtype=np.uint32)
        stop = receiver.detect(light, equipped, seed=seed, pulse=pulse).stops[0]
    is_echo = stop.reported & (stop.status == 0)
    assert is_echo.mean() > 0.999  # a false alarm or two
    point = equipped.working_point(np.array([trains.BACKGROUND_W]))
    measured = stop.range_m[is_echo], stop.amplitude[is_echo], power, point
    return (*measured, stop.width_s[is_echo]) if widths else measured


def sigma_of(point, signal):
    """(13) by hand."""
    return np.sqrt(point.noise.deviation[0] ** 2 + point.noise.kappa_1 * signal + point.noise.kappa_2 * signal**2)


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
    range_m, amplitude, power, point = lone_echoes(equipped, snr, road)
    early_s = (range_m - 100.0) / HALF_C
    deviate = deviate_at(equipped, point, point.response.signal(power * np.exp(-0.5 * (early_s / SIGMA_S) ** 2)))
    assert kstest(deviate, "norm").pvalue > 1e-4
    peak = point.response.signal(np.array([power]))[0]
    of_peak = (amplitude - peak) / sigma_of(point, peak)
    correlation = np.exp(-2.0 * math.pi * 20e6 * np.abs(early_s))
    assert 0.3 < correlation.mean() < 0.7
    fresh = (of_peak - correlation * deviate) / np.sqrt(1.0 - correlation**2)
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
    range_m, _, power, point, width_s = lone_echoes(equipped, snr, road, widths=True)
    early_s = (range_m - 100.0) / HALF_C
    first, last = (
        deviate_at(equipped, point, point.response.signal(power * np.exp(-0.5 * (t / SIGMA_S) ** 2)))
        for t in (early_s, early_s + width_s)
    )
    correlation = np.exp(-2.0 * math.pi * 10e6 * 2.0 * np.abs(early_s))
    assert 0.4 < correlation.mean() < 0.8
    fresh = (last - correlation * first) / np.sqrt(1.0 - correlation**2)
    assert kstest(fresh, "norm").pvalue > 1e-4
    assert abs(np.corrcoef(fresh, first)[0, 1]) < norm.isf(0.5e-4) / math.sqrt(SHOTS)


@pytest.mark.parametrize("road", ["one", "several"])
@pytest.mark.parametrize("name", ["table1-apd", "table1-sipm"])
def test_walk_that_the_amplitude_tells(name, road):
    """Shot by shot: corrected less raw is how long before its peak a pulse of the measured height is at U.

    Reference: t = sigma_p sqrt(2 ln(P / P_U)); of the APD the ratio of powers is that of the signals, of N free cells
    it is ln(1 - s / N) / ln(1 - U / N). Tolerance: rounding.
    """
    raw_m, raw_amplitude, _, _ = lone_echoes(sensor(name, "tdc.walk='raw'"), 15.0, road)
    equipped = sensor(name)
    range_m, amplitude, _, point = lone_echoes(equipped, 15.0, road)
    level = equipped.threshold(point)[0]
    np.testing.assert_array_equal(raw_amplitude, amplitude)
    ratio = amplitude / level
    if name == "table1-sipm":
        free = point.response.largest[0] + 0.5
        ratio = np.log1p(-amplitude / free) / np.log1p(-level / free)
    np.testing.assert_allclose(range_m - raw_m, HALF_C * SIGMA_S * np.sqrt(2.0 * np.log(ratio)), rtol=1e-9, atol=1e-9)


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
        ratio = trains.power_at_snr(equipped, snr) / point.response.power_w(equipped.threshold(point))[0]
        raw_m = readings(snr, *LEVELS, "tdc.walk='raw'", name=name)[0]
        np.testing.assert_allclose(by_levels - raw_m, HALF_C * SIGMA_S * math.sqrt(2.0 * math.log(ratio)), atol=1e-9)


@pytest.mark.parametrize(("name", "recovery_s"), [("table1-sipm", None), ("table1-apd", None), ("table1-apd", 5e-9)])
def test_walk_that_the_levels_tell(name, recovery_s):
    """Shot by shot: half of the width of an even pulse, also of a SiPM, whose cells saturate but whose edges pass a
    level at the same power. Of a pulse that drains, what a clean one of this width is early by.

    Reference: the width of a clean pulse (`width_at_level_s`, which a grid of 1 ps holds) solved for its peak by SciPy.
    """
    drains = [] if recovery_s is None else ["detector.saturation_ua=2", f"detector.recovery_ns={1e9 * recovery_s}"]
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
            return width_s - reference_electronics.width_at_level_s(
                level=level, signal=level * np.exp(overdrive), saturation=2e-6, fwhm_s=FWHM_S, recovery_s=recovery_s
            )

        overdrives = np.array([brentq(too_wide_s, 1e-9, 80.0, args=(width,), xtol=1e-12) for width in width_s])
        assert np.exp(overdrives.mean()) * level > 4e-6  # they do clip
        early_s = SIGMA_S * np.sqrt(2.0 * overdrives)
        assert np.abs(early_s / (0.5 * width_s) - 1.0).min() > 0.05
    # Of the table: bisection to 1e-7 of the overdrive.
    np.testing.assert_allclose(error_m - raw_m, HALF_C * early_s, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("rate_mhz", "samples"), [(1e3 / 6.0, 5), (41e3, 985), (42625, 1024)])
def test_rates_at_their_limits(rate_mhz, samples):
    """One sample in a pulse of 6 ns is the least that is taken, 1024 in four pulse widths the most, ends included."""
    adc = sensor("table1-apd", *ADC, f"sampler.rate_mhz={rate_mhz!r}").sampler
    assert (adc.samples, adc.rate_hz) == (samples, rate_mhz * 1e6)
    assert adc.room > samples
    outside = rate_mhz + math.copysign(0.01, samples - 100)
    if samples in (5, 1024):
        with told("sampler.rate_mhz"):
            sensor("table1-apd", *ADC, f"sampler.rate_mhz={outside!r}")


def crossing_ranges(fine_m, power, level, peak_m):
    """Ranges at which light comes over a level before a peak and falls below it behind."""
    above = power >= level
    top = int(np.argmin(np.abs(fine_m - peak_m)))
    assert above[top]
    return fine_m[top - int(np.argmin(above[top::-1]))], fine_m[top + int(np.argmin(above[top:]))]


@pytest.mark.parametrize(
    ("lasting", "level", "highest"),
    [
        ([], 1.0, 2.0),
        # Light before the pulse only: it starts at 2 U, the lowest level above that light.
        ([(55.0, 0.0), (55.5, 1.5), (59.0, 1.4), (60.0, 0.0)], 2.0, 2.0),
        # Light behind it only, which hides where it falls below U.
        ([(60.0, 0.0), (61.5, 1.5), (80.0, 1.4)], 2.0, 2.0),
        # On both sides.
        ([(55.0, 0.0), (55.5, 1.5), (80.0, 1.4)], 2.0, 2.0),
    ],
    ids=["alone", "before", "behind", "both"],
)
def test_levels_of_a_pulse_on_other_light(lasting, level, highest):
    """The middle of both crossings of the lowest level that the pulse alone passes, to noise and bins of sigma_p / 500;
    the amplitude is no more than the next level. Reference: the waveform in bins, searched by hand. Other pulses stand
    before it and behind.
    """
    equipped = sensor("table1-apd", *CLEAN, *LEVELS, "tdc.stops=3", "tdc.keep='strongest'")
    light, fine_m, power = on_light(equipped, [(55.0, 7.0), (60.0, 2.3), (70.0, 7.0)], lasting)
    second = detect(light, equipped).stops[1]
    point = equipped.working_point(light.background_power_w)
    up_m, down_m = crossing_ranges(fine_m, power, level, 60.0)
    assert second.range_m[0] == pytest.approx(0.5 * (up_m + down_m), abs=0.004 * SIGMA_M)
    assert second.width_s[0] == pytest.approx((down_m - up_m) / HALF_C, abs=0.008 * SIGMA_S)
    up_m, down_m = crossing_ranges(fine_m, power, highest, 60.0)
    assert power.max() > 6.0
    by_width = highest * math.exp((down_m - up_m) ** 2 / (8.0 * SIGMA_M**2))
    expected = min(by_width, 4.0) if lasting else by_width
    assert second.amplitude[0] / equipped.threshold(point)[0] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(
    ("lasting", "base"),
    [
        ([(59.8, 0.0), (60.4, 2.3), (80.0, 2.3)], 0.0),
        ([(55.0, 0.0), (55.5, 1.5), (59.0, 1.4), (60.2, 1.4), (61.2, 2.4), (80.0, 2.3)], 1.0),
    ],
)
def test_levels_that_light_behind_a_pulse_holds_say_nothing(lasting, base):
    """The pulse is read as the TDC alone reads it: where it crosses, later by the walk of what it is over its ``base``.

    The light behind it rises once more by a threshold, and to no level. Reference: the waveform in bins, and sigma_p
    sqrt(2 ln((s - base) / U)) with s its peak. The place of a peak beside a corner of other light is good to the
    differences that stand for that light's slope: 2 % of the height.
    """
    equipped = sensor("table1-apd", *CLEAN, *LEVELS, "tdc.stops=3", "tdc.keep='strongest'")
    light, fine_m, power = on_light(equipped, [(55.0, 7.0), (60.0, 2.3), (70.0, 1.2)], lasting)
    second = detect(light, equipped).stops[1]
    near = np.abs(fine_m - 60.0) < 4.0 * SIGMA_M
    peak_m, peak = fine_m[near][np.argmax(power[near])], power[near].max()
    assert 3.1 < peak < 3.9
    up_m, _ = crossing_ranges(fine_m, power, 1.0 + base, peak_m)
    walk_m = SIGMA_M * math.sqrt(2.0 * math.log(peak - base))
    assert second.range_m[0] == pytest.approx(up_m + walk_m, abs=0.02 * SIGMA_M)
    point = equipped.working_point(light.background_power_w)
    assert second.amplitude[0] / equipped.threshold(point)[0] == pytest.approx(peak, rel=0.03)


@pytest.mark.parametrize(("top", "expected"), [(1.7, 2.0), (3.0, 4.0), (5.0, 8.0), (20.0, 8.0)])
def test_levels_take_air_for_no_more_than_the_next_one(top, expected):
    """Light over 12 m: its width says thousands of times its height. Above the highest level another is assumed, as far
    from it as that is from the one before.
    """
    equipped = sensor("table1-apd", *CLEAN, "sampler.type='multi_level_tdc'", "sampler.levels=[2, 4]")
    lasting = [(50.0, 0.0), (51.0, 0.95 * top), (57.0, top), (63.0, 0.95 * top), (64.0, 0.0)]
    light, _, _ = on_light(equipped, [(50.0, 0.0)], lasting)
    first = detect(light, equipped).stops[0]
    point = equipped.working_point(light.background_power_w)
    assert first.amplitude[0] / equipped.threshold(point)[0] == pytest.approx(expected, rel=1e-9)


def test_levels_above_where_an_amplifier_clips_are_not_there():
    """Two sensors that differ in such a level alone read strong pulses alike, shot by shot."""
    clips = ["detector.circuit_noise_na=1e4", "tdc.threshold_to_noise=100", "detector.saturation_ua=5e3"]
    results = [
        readings(2e4, *clips, "sampler.type='multi_level_tdc'", f"sampler.levels={levels}")
        for levels in ("[2, 4]", "[2, 4, 8]")
    ]
    for two_levels, three_levels in zip(*results, strict=True):
        np.testing.assert_array_equal(two_levels, three_levels)
    assert results[0][1].mean() > 0.9


def test_a_pulse_that_grazes_the_levels_has_neither_width_nor_walk():
    """Noise lets the leading edge pass the threshold and not the trailing one: the crossing is all that is known, as a
    sensor that takes off no walk reports it, and the amplitude is the threshold.
    """
    light = train(np.full((4000, 1), 60.0), trains.power_at_snr(sensor("table1-apd"), 6.0))
    corrected, raw = (
        detect(light, sensor("table1-apd", *LEVELS, "tdc.threshold_to_noise=6", f"tdc.walk='{walk}'")).stops[0]
        for walk in ("corrected", "raw")
    )
    grazes = corrected.reported & (corrected.status == 0) & (corrected.width_s == 0.0)
    assert grazes.sum() > 400
    np.testing.assert_allclose(corrected.range_m[grazes], raw.range_m[grazes], atol=1e-9)
    assert np.ptp(corrected.amplitude[grazes]) == 0.0
    assert corrected.amplitude[grazes].min() == corrected.amplitude[corrected.reported].min()


@pytest.mark.parametrize("name", ["pandar64", "vls-128"])
@pytest.mark.parametrize("overdrive", [3.0, 30.0, 300.0, 3e3, 1e5])
def test_clipped_samples_have_no_bias(name, overdrive):
    """The mean range of a clipped pulse is true to a sixth of its deviation and four standard errors (6e-5).

    By the window's samples alone, which end before the pulse does, the mean is 13 to 35 cm short from 300 times on. The
    pulse is as wide as the light and the drained charge (T45).
    """
    equipped, shots = sensor(name), 1000
    point = equipped.working_point(np.array([trains.BACKGROUND_W]))
    power = point.response.power_w(overdrive * point.response.saturation)
    range_m = 30.0 + np.linspace(0.0, 0.6, shots)  # two ticks of the clock
    stop = detect(train(range_m[:, None], power), equipped, seed=11).stops[0]
    is_echo = stop.reported & (stop.status == 0)
    assert is_echo.mean() > 0.99
    error_m = (stop.range_m - range_m)[is_echo]
    assert abs(error_m.mean()) < (0.16 + 4.0 / math.sqrt(shots)) * error_m.std()
    assert error_m.std() < 0.05
    width_s = reference_electronics.width_at_level_s(
        level=equipped.threshold(point)[0],
        signal=overdrive * point.response.saturation,
        saturation=point.response.saturation,
        fwhm_s=equipped.laser.pulse_fwhm_s,
        recovery_s=point.response.recovery_s,
    )
    assert stop.width_s[is_echo].mean() == pytest.approx(float(np.ravel(width_s)[0]), rel=0.05)
