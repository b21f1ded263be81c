"""Bins around an echo against the histogram of the whole window, read by other code."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import photons
from helpers.run_seed import chosen
from helpers.trains import in_fog, on_device, train

from lidarscene.detection.photon_counting.bins import Bins
from lidarscene.detection.photon_counting.expectation import broaden
from lidarscene.detection.photon_counting.histograms import histograms
from lidarscene.kernel.device import transfer
from lidarscene.light.waveform import waveform
from lidarscene.physics.optics import radiometry
from lidarscene.physics.photon_counting import matched_filter

C = 299792458.0
COUNT = 500


@pytest.mark.parametrize("background_w", [0.0, 2e-10])
@pytest.mark.parametrize(
    ("overrides", "power_w", "close"),
    [
        ((), 1e-9, 4.0),
        # One in five SPADs fires: the first are free again while the pulse lasts, or not, if only their first counts.
        (("detector.dead_time_ns=4",), 4e-9, 16.0),
        (("detector.dead_time_ns=4", "detector.stamps='first'"), 4e-9, 16.0),
    ],
)
def test_peak_and_photons_are_those_of_the_whole_histogram(overrides, power_w, close, background_w):
    """The same random number makes the same count where as many SPADs are free: all but 5 % of the values agree to 2 %
    of the brightest, and the means to 1 %.
    """
    counter = photons.sensor("histogram.window_us=0.4", *overrides)
    pulse = np.arange(COUNT, dtype=np.uint32)
    range_m = 30.0 + np.linspace(0.0, 0.15, COUNT)
    light = train(range_m[:, None], np.full((COUNT, 1), power_w), background_w=background_w)
    pixel = counter.pixel(light.background_power_w, range_m=range_m)
    bins = Bins(pixel=pixel, wave=waveform(*broaden(light, counter, pixel.sigma_s)), seed=3, pulse=pulse)
    time_s = radiometry.time_of_flight_s(range_m=range_m)
    peak = bins.highest(np.zeros(COUNT), time_s)
    whole = histograms(light, counter, seed=3, pulse=pulse)
    w = 1e9 * matched_filter.TEMPLATE * float(pixel.sigma_s)
    template = np.exp(-0.5 * (np.arange(-12, 13) / w) ** 2) * math.sqrt(1.0 + 1.44) / 1.2
    first = 190
    near = whole.counts[:, first - 12 : first + 32]
    values = np.stack([np.convolve(window, template, "valid") for window in near])
    values -= float(np.mean(pixel.count_rate_hz)) * 1e-9 * template.sum()
    theirs = values.max(axis=1)
    assert theirs.mean() > 150.0
    assert (np.abs(peak.value - theirs) < close).mean() > 0.95
    assert np.mean(peak.value) == pytest.approx(theirs.mean(), rel=0.01)
    found_s = 1e-9 * (first + values.argmax(axis=1) + 0.5)
    assert (np.abs(peak.time_s - found_s) < 0.6e-9).mean() > 0.95
    assert np.asarray(peak.exists).all()


def echoes_in_sun(counter, range_m, detections, *, rate_hz):
    """Light of so many pulses: echoes at these ranges, and background that a free SPAD detects at this rate."""
    dark = counter.pixel(np.zeros(1))
    background_w = (rate_hz - float(dark.rate_hz[0])) / float(dark.per_watt)
    power_w = np.asarray(detections) / float(dark.detections(1.0))
    return lambda count: train(np.tile(range_m, (count, 1)), np.tile(power_w, (count, 1)), background_w=background_w)


def bins_of(counter, light, place_m):
    """Bins of the pulses of some light, and the number and place of the first and the middle around one range."""
    count = len(light.background_power_w)
    range_m = np.full(count, place_m)
    pixel = counter.pixel(light.background_power_w, range_m=range_m)
    wave = waveform(*broaden(light, counter, pixel.sigma_s))
    bins = Bins(pixel=pixel, wave=wave, seed=3, pulse=np.arange(count, dtype=np.uint32))
    time_s = radiometry.time_of_flight_s(range_m=range_m)
    place = 2.0 * (place_m - wave.origin_m) / C / pixel.sigma_s
    return bins, time_s, place


def mean_counts(counter, light_of, place_m, *, count=10_000):
    """Mean counts of the drawn bins around an echo, and those of the whole histogram's course."""
    bins, time_s, place = bins_of(counter, light_of(count), place_m)
    first, drawn, _ = bins.draw(place, time_s)
    whole = histograms(light_of(1), counter, seed=3, pulse=np.zeros(1, dtype=np.uint32)).expected[0]
    return np.mean(drawn, axis=1), whole[int(first[0]) : int(first[0]) + len(drawn)]


SUNS = [(60.0, 5.0, 4.0), (100.0, 5.3, 4.0), (50.0, 3.0, 3.0), (73.3, 6.0, 4.5)]


@pytest.mark.parametrize(
    ("rate_mhz", "dead_ns", "fwhm_ns", "detections", "coincidence"),
    chosen(4, [(*sun, detections, least) for sun in SUNS for detections in (0.0, 0.1) for least in (1, 2)]),
)
def test_drawn_bins_have_their_means_in_strong_sun(rate_mhz, dead_ns, fwhm_ns, detections, coincidence):
    """Rationale: SPADs come alive while the bins are drawn: those that the sun fired before, evenly over a dead time.
    Reference: the course of the free SPADs in eight steps a bin.
    Tolerance: 0.3 % of each bin, twice that for pairs of firings, and 4.5 standard errors of 10,000 pulses; all bins
    together to 0.1 % and their error. Half a bin too late is 1 to 3 %.
    """
    counter = photons.sensor(
        f"detector.dead_time_ns={dead_ns} laser.pulse_fwhm_ns={fwhm_ns} histogram.window_us=0.4",
        f"detector.coincidence={coincidence}",
    )
    light_of = echoes_in_sun(counter, [30.0], [detections], rate_hz=1e6 * rate_mhz)
    drawn, expected = mean_counts(counter, light_of, 30.0)
    error = 4.5 / np.sqrt(10_000 * expected)
    assert (np.abs(drawn / expected - 1.0) < 0.003 * coincidence + error).all()
    total = 4.5 / math.sqrt(10_000 * expected.sum())
    assert drawn.sum() == pytest.approx(expected.sum(), rel=0.001 * coincidence + total)


@pytest.mark.parametrize("rate_mhz", chosen(1, [0.01, 5.0]))
@pytest.mark.parametrize(
    ("stamps", "apart_m", "within"),
    [("first", 3.0, 0.003), ("first", 9.0, 0.003), ("all", 3.0, 0.003), ("all", 6.0, 0.01), ("all", 9.0, 0.003)],
)
def test_spads_that_a_nearer_echo_has_fired_are_missing_in_the_bins_of_the_next(stamps, apart_m, within, rate_mhz):
    """Rationale: of the free SPADs exp(-0.8) are left behind an echo of 0.8 detections, for 40 ns or 6 m, or for ever.
    Reference: the course of the free SPADs through the whole window.
    Tolerance: of the sum of the bins 0.3 %, and 1 % where they come back while the second echo fires. In the sun too:
    SPADs that the echo has fired are not there for the sun, and so fewer of the sun's are blind behind it; when they
    are back together, more are free than in even light. That is 4 to 6 % of the counts.
    """
    counter = photons.sensor("detector.dead_time_ns=40", "histogram.window_us=0.4", f"detector.stamps='{stamps}'")
    light_of = echoes_in_sun(counter, [30.0, 30.0 + apart_m], [0.8, 0.3], rate_hz=1e6 * rate_mhz)
    drawn, expected = mean_counts(counter, light_of, 30.0 + apart_m)
    error = 4.5 / math.sqrt(1e4 * expected.sum())
    assert drawn.sum() == pytest.approx(expected.sum(), rel=within + error)


STRONG = [(20.0, 12.0, 2.0), (60.0, 12.0, 2.0), (20.0, 20.0, 5.0), (60.0, 20.0, 5.0), (20.0, 10.0, 5.0)]
DEAD_TIMES = (0.7, 0.95, 1.1, 1.4, 1.7, 2.1, 2.6, 3.3)


@pytest.mark.parametrize(
    ("rate_mhz", "dead_ns", "detections", "dead_times"),
    chosen(5, [(*strong, dead_times) for strong in STRONG for dead_times in DEAD_TIMES]),
)
def test_drawn_bins_behind_a_strong_echo_have_their_means(rate_mhz, dead_ns, detections, dead_times):
    """Rationale: SPADs that an echo has fired come back together, the sun fires more of them than of others, and these
    come back together too. Reference: the course of the free SPADs in eight steps a bin.
    Tolerance: 4.5 standard errors of 400 pulses in each of some 22 bins (of 40 runs of all cases fewer than one fails),
    2.5 % of a bin for the sun within the first echo, which is of first order, and 2 % of a bin in even light where the
    edges of that echo, as wide as in bins, come back. All bins: 1.2 % and 4.5 standard errors.
    """
    counter = photons.sensor(f"detector.dead_time_ns={dead_ns}", "histogram.window_us=0.4", "detector.spads=512")
    apart_m = 0.5e-9 * C * dead_ns * dead_times
    light_of = echoes_in_sun(counter, [30.0, 30.0 + apart_m], [detections, 0.1], rate_hz=1e6 * rate_mhz)
    drawn, expected = mean_counts(counter, light_of, 30.0 + apart_m, count=400)
    even = float(np.ravel(counter.pixel(light_of(1).background_power_w).count_share)[0]) * 512 * 50
    error = 4.5 * np.sqrt(expected / 400)
    assert (np.abs(drawn - expected) < error + 0.025 * expected + 0.02 * even).all()
    assert drawn.sum() == pytest.approx(expected.sum(), rel=0.012, abs=4.5 * math.sqrt(expected.sum() / 400))


@pytest.mark.parametrize("dead_times", [4.4, 5.6, 7.2])
def test_bins_far_behind_an_echo_in_strong_sun_have_their_means(dead_times):
    """Rationale: at lambda tau of 1.8 the SPADs that an echo has fired come back together several times over.
    Reference: the course of the free SPADs. Tolerance: 0.4 % and 4.5 standard errors of 2,000 pulses.
    """
    counter = photons.sensor("detector.dead_time_ns=12", "histogram.window_us=0.4")
    light_of = echoes_in_sun(counter, [30.0, 30.0 + 1.8 * dead_times], [2.0, 1e-9], rate_hz=150e6)
    drawn, expected = mean_counts(counter, light_of, 30.0 + 1.8 * dead_times, count=2000)
    assert drawn.sum() == pytest.approx(expected.sum(), rel=0.004 + 4.5 / math.sqrt(2000 * expected.sum()))


@pytest.mark.parametrize("dead_times", [0.95, 1.6])
def test_drawn_bins_behind_a_strong_echo_are_those_of_photons_one_by_one(dead_times):
    """Rationale: as above. Reference: 300,000 SPADs, each followed from one firing to the next.
    Tolerance: 4.5 standard errors of each of some 22 bins, and 2.5 % of it.
    """
    counter = photons.sensor("detector.dead_time_ns=12", "histogram.window_us=0.4")
    light = echoes_in_sun(counter, [30.0, 30.0 + 1.8 * dead_times], [2.0, 1e-9], rate_hz=60e6)(2000)
    bins, time_s, place = bins_of(counter, light, 30.0 + 1.8 * dead_times)
    first, drawn, _ = bins.draw(place, time_s)
    early = 40
    echo_ns = early + 2e9 * 30.0 / C - 1e9 * float(first[0] * counter.histogram.bin_s)
    echo = 2.0, echo_ns, 1e9 * float(counter.laser.pulse_fwhm_s) / 2.354820045
    options = {"rate_per_ns": 0.06, "dead": 12.0, "bins": early + len(drawn), "bin_ns": 1.0, "echo": echo}
    counts = photons.renewal_counts(np.random.default_rng(5), (100, 3200), **options)[:, early:]
    error = 4.5 * np.hypot(counts.std(axis=0) / 10.0, np.std(drawn, axis=1) / math.sqrt(2000))
    simulated = counts.mean(axis=0)
    assert (np.abs(np.mean(drawn, axis=1) - simulated) < error + 0.025 * simulated).all()


@pytest.mark.parametrize(
    ("stamps", "dead_ns", "scale", "within"),
    chosen(
        2,
        [
            ("first", 12.0, 0.02, 0.005),
            ("all", 20.0, 0.02, 0.005),
            ("all", 20.0, 0.2, 0.02),
            ("all", 300.0, 0.02, 0.005),
        ],
    ),
)
def test_spads_that_fog_has_fired_are_missing_in_the_bins_of_a_wall(stamps, dead_ns, scale, within):
    """Rationale: fog before the wall fires a third of the SPADs or more, of which those of the last dead time are
    blind. Reference: the course of the free SPADs through the whole window.
    Tolerance: 0.5 % for twelve steps of the fog's light, and 4.5 standard errors; 2 % where a tenth of the SPADs come
    free in the bins, which is taken for an even return.
    """
    counter = photons.sensor(
        f"detector.dead_time_ns={dead_ns}", f"detector.stamps='{stamps}'", "histogram.window_us=0.4"
    )

    def light_of(count):
        light = in_fog(counter, np.full(count, scale), wall_m=20.0)
        return dataclasses.replace(light, background_power_w=np.zeros(count))

    drawn, expected = mean_counts(counter, light_of, 20.0)
    error = 4.5 / math.sqrt(1e4 * expected.sum())
    assert drawn.sum() == pytest.approx(expected.sum(), rel=within + error)


@pytest.mark.parametrize("rate_mhz", [0.001, 2.0, 20.0])
def test_photons_of_an_echo_and_the_flank_of_one(rate_mhz):
    """Rationale: counts of the echo around its peak, whatever the sun, are those of `Macropixel.counts`; a search that
    begins on an echo's flank finds no peak there.
    Tolerance: 4.5 standard errors of 4,000 echoes of 0.1 detections, and 1 % for shadows at 20 MHz, else 0.3 %.
    """
    counter = photons.sensor("detector.dead_time_ns=20")
    light = echoes_in_sun(counter, [30.0], [0.1], rate_hz=1e6 * rate_mhz)(4000)
    bins, time_s, place = bins_of(counter, light, 30.0)
    anywhere = (-np.ones(4000), np.ones(4000))
    peak = bins.highest(place, time_s, limits_s=anywhere)
    expected = float(np.ravel(bins.pixel.counts(0.1))[0])
    scatter = np.std(peak.photons) / math.sqrt(4000)
    within = 0.01 if rate_mhz > 10.0 else 0.003
    assert peak.photons.mean() == pytest.approx(expected, abs=4.5 * scatter + within * expected)
    assert peak.exists.mean() > 0.99
    for side in (-1.0, 1.0):
        off_peak = bins.highest(place + side * 6e-9 / bins.pixel.sigma_s, time_s + side * 6e-9, limits_s=anywhere)
        assert (off_peak.exists & (off_peak.value > 0.25 * expected)).mean() < 0.01
    # Bins are drawn in pairs from an even one, so a search 3.3 ns late begins with the echo's bin where that is odd.
    # Its place between bins follows from both of its sides there too: to 0.1 ns and 4.5 standard
    # errors (0.08 ns at 20 MHz), where a neighbour left out is 0.5.
    odd_m = 30.15
    light = echoes_in_sun(counter, [odd_m], [0.1], rate_hz=1e6 * rate_mhz)(4000)
    bins, time_s, place = bins_of(counter, light, odd_m)
    late = bins.highest(place + 3.3e-9 / bins.pixel.sigma_s, time_s + 3.3e-9, limits_s=anywhere)
    falling = late.exists
    assert falling.mean() > 0.2
    early_s = late.time_s[falling] - bins.highest(place, time_s).time_s[falling]
    assert abs(np.mean(early_s)) < 1e-10 + 4.5 * np.std(early_s) / math.sqrt(len(early_s))


@pytest.mark.parametrize(("rate_mhz", "dead_ns"), chosen(1, [(100.0, 5.3), (150.0, 20.0)]))
def test_drawn_bins_have_means_and_covariances_of_photons_one_by_one(rate_mhz, dead_ns):
    """Rationale: counts within a dead time exclude each other, those a dead time apart attract each other, and the
    filter's noise is the sum of both. Reference: 800 histograms of 3,200 SPADs and shots, each followed from one firing
    to the next, without any formula of the simulation.
    Tolerance: 4.5 standard errors of each of 24 bins' means; of the filter's variance in its middle 4 standard errors,
    20 % of it. Independent bins have 1.4 to 2 times as much: the variance is 0.71 of theirs at most, and its standard
    error in 4,000 pulses is 2.2 % of it: 0.85 is 9 of them above, and 6.7 below 1.
    """
    counter = photons.sensor(f"detector.dead_time_ns={dead_ns}", "histogram.window_us=0.4")
    light = echoes_in_sun(counter, [30.0], [0.1], rate_hz=1e6 * rate_mhz)(4000)
    bins, time_s, place = bins_of(counter, light, 30.0)
    first, counts, _ = bins.draw(place, time_s)
    drawn, bin_s = np.array(counts).T, counter.histogram.bin_s
    echo = 0.1, 1e9 * float(time_s[0] - first[0] * bin_s), 1e9 * float(counter.laser.pulse_fwhm_s) / 2.354820045
    options = {"rate_per_ns": 1e-3 * rate_mhz, "dead": dead_ns, "bins": drawn.shape[1], "bin_ns": 1.0, "echo": echo}
    counts = photons.renewal_counts(np.random.default_rng(12), (800, 3200), **options)
    error = 4.5 * np.hypot(counts.std(axis=0) / math.sqrt(800), drawn.std(axis=0) / math.sqrt(4000))
    assert (np.abs(drawn.mean(axis=0) - counts.mean(axis=0)) < error).all()
    w = matched_filter.TEMPLATE * 1e9 * float(bins.pixel.sigma_s)
    template = np.exp(-0.5 * ((np.arange(drawn.shape[1]) - echo[1]) / w) ** 2)
    variances = [np.var(values @ template) for values in (drawn, counts)]
    assert variances[0] == pytest.approx(variances[1], rel=4.0 * math.sqrt(2.0 / 800 + 2.0 / 4000))
    assert variances[0] < 0.85 * np.sum(template**2 * counts.mean(axis=0))


@pytest.mark.parametrize("rate_mhz", [0.01, 20.0, 60.0])
def test_weak_light_before_the_bins_is_not_followed(rate_mhz):
    """Rationale: an echo of a few thousandths of a detection before a strong one costs the kernel most where the SPADs
    are followed through it, and changes no count that can be seen.
    Reference: the course of the free SPADs, which knows the weak echo.
    Tolerance: 0.2 % of all counts of the strong one, the share of the SPADs that may be left out, and 4.5 standard
    errors of 10,000 pulses.
    """
    counter = photons.sensor("detector.dead_time_ns=12", "histogram.window_us=0.4")
    for detections, is_followed in ((1.9e-3, False), (2.1e-3, True)):
        light_of = echoes_in_sun(counter, [30.0, 34.0], [detections, 0.1], rate_hz=1e6 * rate_mhz)
        bins, time_s, place = bins_of(counter, light_of(1), 34.0)
        assert bool(np.any(bins.draw(place, time_s)[2].shaded)) == is_followed
        drawn, expected = mean_counts(counter, light_of, 34.0)
        error = 4.5 / math.sqrt(10_000 * expected.sum())
        assert drawn.sum() == pytest.approx(expected.sum(), rel=0.002 + error)


@pytest.mark.parametrize(
    ("rate_mhz", "apart_m", "within"),
    chosen(2, [(0.01, 4.5, 0.02), (0.01, 7.0, 0.02), (5.0, 5.5, 0.001), (20.0, 7.0, 0.001)]),
)
def test_bins_behind_an_echo_have_its_afterpulses(rate_mhz, apart_m, within):
    """Rationale: an echo of 2 detections, and SPADs that fire again after 5 % of their firings, 30 ns later on average:
    in the dark 23 to 37 counts in the bins 7 and 4.5 m behind it, in place of 0.7.
    Reference: the course of the free SPADs, with its afterpulses.
    In the sun they are fewer: SPADs that the echo fires are not there for the sun, and have none of its afterpulses
    for a while. Tolerance: 4.5 standard errors; 2 % of the echo's afterpulses in the dark, whose light is taken to be
    at its mean; in the sun, where they are a hundredth of the counts, 0.1 % of all.
    """
    keys = ("detector.dead_time_ns=12", "histogram.window_us=0.4")
    counter = photons.sensor(*keys, "detector.afterpulse=0.05", "detector.afterpulse_ns=30")
    light_of = echoes_in_sun(counter, [30.0, 30.0 + apart_m], [2.0, 1e-9], rate_hz=1e6 * rate_mhz)
    drawn, expected = mean_counts(counter, light_of, 30.0 + apart_m, count=4000)
    error = 4.5 / math.sqrt(4000 * expected.sum())
    assert drawn.sum() == pytest.approx(expected.sum(), rel=within + error)
    _, without = mean_counts(photons.sensor(*keys), light_of, 30.0 + apart_m, count=1)
    assert expected.sum() > without.sum() * 1.01


@pytest.mark.parametrize("detections", [0.005, 2.0])
def test_spads_that_come_free_are_followed_where_bins_see_them(monkeypatch, detections):
    """Rationale: with a dead time of 14 of 24 bins only SPADs that fire before an echo's peak come free in its bins. Of
    an echo of 0.005 detections these are fewer than may be left out, and no packet of such echoes follows them; of 2
    detections they are more.
    """
    counter = photons.sensor("detector.dead_time_ns=14", "histogram.window_us=0.4")
    bins, time_s, place = bins_of(counter, echoes_in_sun(counter, [30.0], [detections], rate_hz=1e4)(10), 30.0)
    followed, revived = [], Bins._revived

    def follow(self, state, rates):
        followed.append(float(state.number[0]))
        return revived(self, state, rates)

    monkeypatch.setattr(Bins, "_revived", follow)
    bins.draw(place, time_s)
    assert bool(followed) == (detections > 1.0)
    assert all(number > 13.0 for number in followed)


def test_a_share_of_no_afterpulses_changes_no_count():
    """Drawn and expected bins are the same bits as without the keys, here 3 m behind an echo in the sun."""
    keys = ("detector.dead_time_ns=12", "histogram.window_us=0.4")
    none = photons.sensor(*keys, "detector.afterpulse=0", "detector.afterpulse_ns=30")
    counter = photons.sensor(*keys)
    light_of = echoes_in_sun(counter, [30.0, 33.0], [2.0, 0.3], rate_hz=20e6)
    same, without = (mean_counts(each, light_of, 33.0, count=100) for each in (none, counter))
    np.testing.assert_array_equal(same[0], without[0])
    np.testing.assert_array_equal(same[1], without[1])


def test_bins_behind_an_echo_are_the_same_in_single_precision():
    """Rationale: light of the bins and of those one to three dead times before grows by constant factors, whose
    products must stay within single precision at any distance, here with bins of 1.4 sigmas.
    Tolerance: of the mean of 100 pulses 0.5 %, for bins whose share is a rounding off.
    """
    counter = photons.sensor("histogram.bin_ns=2.6", "detector.dead_time_ns=15", "histogram.window_us=0.6")
    apart_m = np.repeat(np.array([1.5, 2.2, 2.6, 3.0, 3.4, 4.0, 5.0, 6.5, 8.0, 40.0]), 100)
    unit = float(np.ravel(counter.pixel(np.zeros(1)).detections(1.0))[0])
    light = train(21.0 + apart_m[:, None] * [0.0, 1.0], np.array([1.0, 0.3]) / unit, background_w=3e-11)
    pulse, time_s = np.arange(1000, dtype=np.uint32), radiometry.time_of_flight_s(range_m=21.0 + apart_m)

    def photons_of(light, counter, pulse, time_s, apart_s):
        pixel = counter.pixel(light.background_power_w)
        wave = waveform(*broaden(light, counter, pixel.sigma_s))
        return np.asarray(
            Bins(pixel=pixel, wave=wave, seed=3, pulse=pulse).highest(apart_s / pixel.sigma_s, time_s).photons
        )

    apart_s = radiometry.time_of_flight_s(range_m=apart_m)
    expected = photons_of(light, counter, pulse, time_s, apart_s)
    computed = photons_of(
        on_device(light),
        transfer.opaque(counter),
        transfer.unsigned_numbers(pulse),
        *(transfer.from_numpy(times) for times in (time_s, apart_s)),
    )
    means = [values.reshape(-1, 100).mean(axis=1) for values in (computed, expected)]
    np.testing.assert_allclose(means[0], means[1], rtol=5e-3)
