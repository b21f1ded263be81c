"""What a histogram receiver reports, against histograms that are filled photon by photon and read by other code."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import photons
from helpers.run_seed import chosen
from helpers.trains import in_fog, train

from lidarscene.detection import receiver
from lidarscene.detection.outcomes import Outcome, Status
from lidarscene.detection.photon_counting import candidates
from lidarscene.detection.photon_counting import histograms as whole
from lidarscene.detection.photon_counting.bins import Bins
from lidarscene.detection.photon_counting.expectation import broaden
from lidarscene.detection.photon_counting.peaks import Peaks
from lidarscene.light.echoes import EchoTrain, SubEchoes
from lidarscene.light.waveform import waveform
from lidarscene.physics.photon_counting import matched_filter, pile_up
from lidarscene.physics.reference import photon_counting as reference_photon_counting
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.studies.ranging import plane

C = 299792458.0


def filtered(counts, sigma_ns, *, even, bin_ns=1.0, side=12):
    """Values of the filter, written out again, from bin ``side`` on: of counts above ``even`` ones in every bin."""
    template = np.exp(-0.5 * (np.arange(-side, side + 1) * bin_ns / (matched_filter.TEMPLATE * sigma_ns)) ** 2)
    template *= math.sqrt(1 + 1.44) / 1.2
    return np.lib.stride_tricks.sliding_window_view(counts - even, len(template), axis=-1) @ template


def even_of(pixel):
    """Mean counts of the background in a nanosecond."""
    return 1e-9 * float(np.ravel(pixel.count_rate_hz)[0])


def sigma_of(pixel):
    return 1e9 * float(np.ravel(pixel.sigma_s)[0])


SUNNY = {"illuminance_klux": 4.0}
"""Table 1's lens is wide: 3.6 MHz of background on each SPAD."""


@pytest.mark.parametrize(("illuminance_klux", "snr"), chosen(2, [(0.0, 6.0), (0.0, 8.0), (4.0, 6.0), (4.0, 8.0)]))
def test_the_share_that_is_found_is_the_probability(illuminance_klux, snr):
    """15,000 pulses: 4 standard errors, and 0.01 for the gain of the search for the highest bin."""
    counter = photons.sensor("histogram.stops=3")
    light = photons.echoes_of(counter, 60.0, photons=snr, count=100, illuminance_klux=illuminance_klux)
    point = counter.working_point(light.background_power_w, range_m=light.range_m)
    light = photons.echoes_of(
        counter,
        60.0,
        photons=float(counter.threshold(point)[0]) + (snr - 7.0),
        count=15_000,
        illuminance_klux=illuminance_klux,
    )
    detection = photons.detect(light, counter)
    expected = float(detection.detection_probability[0])
    assert 0.2 < expected < 0.9
    share = sum(photons.echo_of(stop).mean() for stop in detection.stops)
    assert share == pytest.approx(expected, abs=0.026)


@pytest.mark.parametrize(("spread", "least"), [(0.2, 0.5), (0.5, 0.7)])
def test_a_threshold_that_scatters_finds_as_many_as_its_probability(spread, least):
    """Echoes from 5 photons below the threshold to 5 above, 6,000 each: 4 standard errors, and 0.01 as above. Of the
    wider spread a quarter of the thresholds are the least.
    """
    counter = photons.sensor(
        f"histogram.stops=3 histogram.threshold_floor=14 histogram.threshold_spread={spread}",
        f"histogram.threshold_least={least}",
    )
    sharp = photons.sensor("histogram.stops=3", "histogram.threshold_floor=14")
    level = float(counter.threshold(counter.working_point(np.zeros(1)))[0])
    apart = []
    for above in (-5.0, 0.0, 5.0):
        light = photons.echoes_of(counter, 60.0, photons=level + above, count=6_000, illuminance_klux=0.0)
        detection, plain = (photons.detect(light, receiver) for receiver in (counter, sharp))
        share = sum(photons.echo_of(stop).mean() for stop in detection.stops)
        assert share == pytest.approx(float(detection.detection_probability[0]), abs=0.036)
        apart.append(float(detection.detection_probability[0] - plain.detection_probability[0]))
    # A sharp threshold loses more of the weak ones and keeps more of the strong ones.
    assert apart[0] > 0.04
    assert apart[2] < -0.04


def test_an_echo_without_photons_is_none_however_low_its_threshold_is_drawn():
    """A law of 3 photons, and below 1.4 for one point in six. In the dark these have no echo without a count: drawn
    and expected shares vanish with the light. 20,000 pulses each: 4 standard errors, and 15 % of the share for the law
    of a handful of counts, which (T96) takes for a continuous one.
    """
    counter = photons.sensor(
        "histogram.stops=3 histogram.threshold_floor=3 histogram.threshold_slope=0",
        "histogram.threshold_spread=0.8 histogram.threshold_least=0.2 detector.dark_count_rate_hz=0",
    )
    for signal in (1e-3, 0.03, 0.3, 1.0):
        light = photons.echoes_of(counter, 60.0, photons=signal, count=20_000, illuminance_klux=0.0)
        detection = photons.detect(light, counter)
        expected = float(detection.detection_probability[0])
        share = sum(photons.echo_of(stop).mean() for stop in detection.stops)
        assert share == pytest.approx(expected, rel=0.15, abs=4.0 * math.sqrt(signal / 20_000))
        assert expected <= -math.expm1(-signal) * (1.0 + 1e-9)


@pytest.mark.parametrize("name", chosen(1, ["os0-128", "os1-128", "os2-128"]))
def test_what_neighbours_do_not_see_either_is_no_echo_of_an_ouster(name):
    """10 % in 100 klux from where nearly all is found to 590 m: drawn shares are P_d, which grows with the signal and
    starts from the false alarms of a lone peak. Above 0.4 it is that of a sensor whose threshold scatters for all
    points alike. 2,000 pulses each: 4 standard errors, and 0.02 for (T96) of a few photons.
    """
    counter = load_sensor(name)
    alike = load_sensor(name, overrides=["histogram.lone_factor=1"])
    range_m = np.array([15.0, 20.0, 30.0, 40.0, 50.0, 65.0, 100.0, 590.0])
    light = plane.echoes_of_plane(counter, plane.Target(), np.repeat(range_m, 2000))
    detection = photons.detect(light, counter)
    share = np.any([photons.echo_of(stop) for stop in detection.stops], axis=0).reshape(-1, 2000).mean(axis=1)
    expected = np.asarray(detection.detection_probability).reshape(-1, 2000)[:, 0]
    error = 4.0 * np.sqrt(expected * (1.0 - expected) / 2000)
    assert (np.abs(share - expected) < error + 0.02).all()
    by_signal = np.argsort(np.asarray(detection.snr)[::2000])
    assert (np.diff(expected[by_signal]) >= 0.0).all()
    # A lone peak in one of the bins that are searched is rarer still than one in 10^8.
    point = counter.working_point(light.background_power_w[:1])
    lone = counter.histogram.threshold_of_noise(counter.threshold(point), 0.0)
    alarms = float(np.ravel(point.false_alarm_probability(lone))[0])
    assert alarms * (2 * counter.histogram.reach + 1) < 1e-8
    assert expected[-1] < 1e-8
    plain = np.asarray(photons.detect(light, alike).detection_probability).reshape(-1, 2000)[:, 0]
    high = plain > 0.4
    np.testing.assert_allclose(expected[high], plain[high], rtol=1e-9)
    assert (expected[~high] < plain[~high]).all()
    assert plain[-1] > 30.0 * expected[-1]


def passing_share(rng, counter, light, points):
    """Share of histograms, filled firing by firing, whose filter passes the threshold where the receiver searches."""
    pixel, histogram = counter.pixel(light.background_power_w[:1]), counter.histogram
    bin_ns, reach, search = 1e9 * histogram.bin_s, histogram.reach, histogram.search
    rate, dead = 1e-9 * float(pixel.rate_hz[0]), 1e9 * float(counter.detector.dead_time_s)
    trials = int(float(counter.detector.spads) * float(histogram.shots))
    sigma = 1e9 * float(counter.laser.pulse_fwhm_s) / 2.354820045
    side = reach - search - 1
    even = trials * rate / (1.0 + rate * dead) * bin_ns
    point = counter.working_point(light.background_power_w[:1], range_m=light.range_m[:1])
    level, echo = (float(counter.threshold(point)[0]), float(np.ravel(pixel.detections(light.peak_power_w[:1]))[0]))
    detections, at_once = 0, 100
    for _ in range(points // at_once):
        place = (reach + 4 + rng.random()) * bin_ns
        counts = photons.renewal_counts(
            rng,
            (at_once, trials),
            rate_per_ns=rate,
            dead=dead,
            bins=2 * reach + 9,
            bin_ns=bin_ns,
            echo=(echo, place, sigma),
        )
        values = filtered(counts, math.hypot(sigma, bin_ns / math.sqrt(12.0)), even=even, bin_ns=bin_ns, side=side)
        first = reach + 4 - side - search - 1
        detections += int((values[:, first : first + 2 * search + 3].max(axis=1) >= level).sum())
    return detections / points


def sunlit(rate_mhz, dead_ns, fwhm_ns, above, count, *overrides):
    """A sensor of the tests in the sun and echoes ``above`` so many sigmas above its threshold."""
    counter = photons.sensor(
        f"detector.dead_time_ns={dead_ns}", f"laser.pulse_fwhm_ns={fwhm_ns}", "histogram.stops=3", *overrides
    )
    dark = counter.pixel(np.zeros(1))
    light = photons.echoes_of(counter, 60.0, photons=1.0, count=count, illuminance_klux=0.0)
    light.background_power_w[:] = (1e6 * rate_mhz - float(dark.rate_hz[0])) / float(dark.per_watt)
    point = counter.working_point(light.background_power_w, range_m=light.range_m)
    light.peak_power_w[:] = point.response.power_w(counter.threshold(point) + above * point.noise.deviation)
    return counter, light


def sony_plane(reflectivity, range_m, count):
    counter = load_sensor("sony-spad-189x600")
    target = plane.Target(reflectivity=reflectivity)
    return counter, plane.echoes_of_plane(counter, target, np.full(count, range_m))


SUN = {
    "1 MHz, 50 ns": lambda n: sunlit(1.0, 50.0, 4.0, 0.0, n),
    "20 MHz, 12 ns": lambda n: sunlit(20.0, 12.0, 4.0, 0.0, n),
    "60 MHz, 5 ns": lambda n: sunlit(60.0, 5.0, 4.0, 0.0, n),
    "60 MHz, 5 ns, bins of 1.1 sigmas": lambda n: sunlit(60.0, 5.0, 4.0, 0.0, n, "histogram.bin_ns=2"),
    "100 MHz, 12 ns": lambda n: sunlit(100.0, 12.0, 4.0, 0.0, n),
    "150 MHz, 20 ns": lambda n: sunlit(150.0, 20.0, 4.0, 0.0, n),
    "300 MHz, 10 ns, few SPADs": lambda n: sunlit(300.0, 10.0, 4.0, 0.0, n, "detector.spads=16", "histogram.shots=200"),
    "50 MHz, as blind as the pulse is long": lambda n: sunlit(50.0, 3.0, 3.0, 0.0, n),
    "jitter": lambda n: sunlit(40.0, 12.0, 2.0, 0.0, n, "histogram.bin_ns=0.5", "detector.jitter_ps=600"),
    "dark, bins of 1.35 sigmas": lambda n: sunlit(0.5, 12.0, 4.0, 0.0, n, "histogram.bin_ns=2.5"),
    "first photons": lambda n: sunlit(2.0, 12.0, 4.0, 0.0, n, "detector.stamps='first'"),
    "pairs": lambda n: sunlit(10.0, 12.0, 4.0, 0.0, n, "detector.coincidence=2", "detector.spads=32"),
    "triples": lambda n: sunlit(20.0, 12.0, 4.0, 0.0, n, "detector.coincidence=3"),
    "half of the SPADs": lambda n: sunlit(0.002, 12.0, 4.0, -30.0, n, "histogram.threshold_floor=1600"),
    "Coates": lambda n: sunlit(60.0, 12.0, 4.0, 0.0, n, "histogram.coates=true"),
    "Coates, 500 ns": lambda n: sunlit(
        2.0, 500.0, 4.0, 0.0, n, "histogram.coates=true", "histogram.threshold_floor=60"
    ),
    "Sony, 80 %, 216.6 m": lambda n: sony_plane(0.8, 216.6, n),
    "Sony, 80 %, 249 m": lambda n: sony_plane(0.8, 249.0, n),
    "Sony, 30 %, 195.5 m": lambda n: sony_plane(0.3, 195.5, n),
    "Sony, 10 %, 156.6 m": lambda n: sony_plane(0.1, 156.6, n),
}
"""Light from lambda tau = 0.05 to 3 on sensors of the tests, at the threshold, and on the Sony array."""


@pytest.mark.parametrize("case", chosen(3, list(SUN)))
def test_the_share_found_in_strong_sun_is_the_probability(case):
    """6,000 echoes over the places in a bin: 4 standard errors (false alarms of 6e-5 each), and 0.01 for the gain of
    the search (T98). A background that is 3 % off makes 0.3 to 0.6, a shadow to first order 0.05 to 0.6.
    """
    counter, light = SUN[case](6000)
    light.range_m[:] += np.linspace(0.0, 0.15, 6000) * 1e9 * counter.histogram.bin_s
    detection = photons.detect(light, counter)
    share = np.any([photons.echo_of(stop) for stop in detection.stops], axis=0).mean()
    expected = float(np.mean(detection.detection_probability))
    assert 0.05 < expected < 0.95
    assert share == pytest.approx(expected, abs=0.01 + 4.0 * math.sqrt(expected * (1.0 - expected) / 6000))


@pytest.mark.parametrize(
    "case", chosen(1, ["60 MHz, 5 ns", "150 MHz, 20 ns", "300 MHz, 10 ns, few SPADs", "Sony, 80 %, 216.6 m"])
)
def test_the_share_found_in_strong_sun_is_that_of_photons_one_by_one(case):
    """Every SPAD followed from one firing to the next, 500 histograms: 4 standard errors of both shares."""
    counter, light = SUN[case](6000)
    light.range_m[:] += np.linspace(0.0, 0.15, 6000)
    detection = photons.detect(light, counter)
    share = np.any([photons.echo_of(stop) for stop in detection.stops], axis=0).mean()
    simulated_share = passing_share(np.random.default_rng(6), counter, light, 500)
    assert share == pytest.approx(simulated_share, abs=4.0 * math.sqrt(0.25 / 500 + 0.25 / 6000))


def test_the_share_of_first_photons_found_is_that_of_photons_one_by_one():
    """Rationale: a receiver has one threshold a point, by the counts of its window (T110), and does not know how far
    the echo is, where fewer SPADs are left to count the sun. Reference: the first photon of each SPAD and shot, 800
    histograms, a threshold by their own counts. Tolerance: 4 standard errors of both shares, and 0.01 for the gain of
    the search (T98). By the rate at the echo's place the share is 0.13 off.
    """
    counter, light = sunlit(2.0, 12.0, 4.0, 0.0, 6000, "detector.stamps='first'")
    light.range_m[:] = 45.0 + np.linspace(0.0, 0.15, 6000)
    found = np.any([photons.echo_of(stop) for stop in photons.detect(light, counter).stops], axis=0).mean()
    pixel, rng = counter.pixel(light.background_power_w[:1], range_m=light.range_m[:1]), np.random.default_rng(6)
    rate, trials = 1e-9 * float(pixel.rate_hz[0]), 64 * 50
    lit = -math.expm1(-float(np.ravel(pixel.detections(light.peak_power_w[:1]))[0]))
    values, counts = [], 0
    for _ in range(800):
        place = 2e9 * 45.0 / C + rng.random()
        times = rng.exponential(1.0 / rate, trials)
        echo = np.where(rng.random(trials) < lit, rng.normal(place, 4.0 / 2.354820045, trials), np.inf)
        row, _ = np.histogram(np.minimum(times, echo), bins=1000, range=(0.0, 1000.0))
        near = int(place) - 17
        even = trials * rate * math.exp(-rate * place)
        values.append(filtered(row[near : near + 35], sigma_of(pixel), even=even).max())
        counts += (times < 1000.0).sum() / 800
    level = 4.0 + 0.3 * math.sqrt(counts)
    share = (np.array(values) >= level).mean()
    assert 0.1 < share < 0.9
    assert found == pytest.approx(share, abs=0.01 + 4.0 * math.sqrt(0.25 / 800 + 0.25 / 6000))


@pytest.mark.parametrize(
    ("rate_mhz", "dead_ns", "apart_m", "above", "keys"),
    chosen(
        2,
        [
            (0.01, 20.0, 2.85, 2.0, ()),
            (20.0, 20.0, 3.45, 0.0, ()),
            (20.0, 20.0, 4.8, 0.0, ()),
            (20.0, 20.0, 6.3, 0.0, ()),
            (60.0, 12.0, 2.9, 0.0, ()),
            (60.0, 12.0, 3.8, 0.0, ()),
            (1.0, 12.0, 3.0, 12.0, ("detector.stamps='first'",)),
        ],
    ),
)
def test_a_second_echo_is_found_as_often_as_its_probability(rate_mhz, dead_ns, apart_m, above, keys):
    """Rationale: an echo of one detection has fired its SPADs, which are blind, or back and more than in even light,
    when the second comes, so many sigmas above its threshold if it came alone.
    Tolerance: 4 standard errors of 6,000 pulses, and 0.02 as for an echo alone. By the light alone P_d is up to 0.45
    off.
    """
    counter, count = photons.sensor(f"detector.dead_time_ns={dead_ns}", "histogram.stops=3", *keys), 6000
    dark = counter.pixel(np.zeros(1))
    background_w = (1e6 * rate_mhz - float(dark.rate_hz[0])) / float(dark.per_watt)
    point = counter.working_point(np.full(1, background_w), range_m=np.full(1, 30.0 + apart_m))
    second_w = float(np.ravel(point.response.power_w(counter.threshold(point) + above * point.noise.deviation))[0])
    range_m = 30.0 + np.linspace(0.0, 0.15, count)[:, None] + np.array([0.0, apart_m])
    light = train(range_m, np.array([1.0 / float(dark.detections(1.0)), second_w]), background_w=background_w)
    share, probabilities = 0.0, []
    for stop in photons.detect(light, counter).stops:
        second = photons.echo_of(stop) & (np.abs(stop.true_range_m - range_m[:, 1]) < 0.5)
        share, probabilities = share + second.mean(), [*probabilities, *np.asarray(stop.detection_probability)[second]]
    # All pulses have nearly the same.
    expected = float(np.median(probabilities))
    assert 0.05 < expected < 0.99
    assert share == pytest.approx(expected, abs=0.02 + 4.0 * math.sqrt(expected * (1.0 - expected) / count))


def test_an_echo_one_dead_time_behind_another_is_found_and_has_its_own_revived_spads():
    """Rationale: SPADs that the first echo fired come back while the second lasts, which meets part of them, and all
    come back together once more. Reference: every SPAD followed from one firing to the next, 200 histograms.
    Tolerance: 4 standard errors, and 0.06 for the course that the third peak's bins follow.
    """
    counter = photons.sensor(
        "histogram.keep='all'", "histogram.window_us=0.5", "detector.spads=16", "histogram.shots=120"
    )
    dark, tau_m, count = counter.pixel(np.zeros(1)), 12e-9 * C / 2.0, 2000
    background_w = (40e6 - float(dark.rate_hz[0])) / float(dark.per_watt)
    range_m = 30.0 + np.linspace(0.0, 0.15, count)[:, None] + np.array([0.0, tau_m])
    light = train(range_m, np.full(2, 5.0 / float(dark.detections(1.0))), background_w=background_w)
    behind_m = [
        np.where(np.asarray(stop.reported), np.asarray(stop.range_m) - range_m[:, 1], np.inf)
        for stop in photons.detect(light, counter).stops
    ]
    pixel, rng = counter.pixel(np.array([background_w])), np.random.default_rng(3)
    level = float(counter.threshold(counter.working_point(np.array([background_w])))[0])
    options = {"rate_per_ns": 0.04, "dead": 12.0, "bins": 116, "bin_ns": 1.0}
    echo = (np.full(2, 5.0), np.array([40.5, 52.5]), 4.0 / 2.354820045)
    counts = photons.renewal_counts(rng, (200, 16 * 120), echo=echo, **options)
    values = filtered(counts, sigma_of(pixel), even=even_of(pixel))
    peaks = (values[:, 1:-1] > values[:, :-2]) & (values[:, 1:-1] >= values[:, 2:]) & (values[:, 1:-1] >= level)
    place_m = (np.arange(1, 91) + 12.5 - 52.5) * 1e-9 * C / 2.0
    for low, high in ((-0.5, 0.5), (0.5, 1.6)):
        found = np.any([(low * tau_m < m) & (m < high * tau_m) for m in behind_m], axis=0).mean()
        simulated = peaks[:, (low * tau_m < place_m) & (place_m < high * tau_m)].any(axis=1).mean()
        assert simulated > 0.5
        assert found == pytest.approx(simulated, abs=0.06 + 4.0 * math.sqrt(0.25 / 200 + 0.25 / count))


def test_coincidences_in_the_dark_are_found_as_often_as_their_probability():
    """Pairs of SPADs crowd in the middle of an echo, whose peak is narrower behind the filter: noise gains less on it.

    30,000 echoes, 4 standard errors (0.012), and 0.012 as for SPADs alone; with an echo's own width it is 0.032 off.
    """
    keys = ("detector.coincidence=2", "detector.spads=16", "histogram.shots=200")
    counter, light = sunlit(0.1, 12.0, 4.0, 0.0, 1, *keys)
    expected = float(photons.detect(light, counter).detection_probability[0])
    range_m = light.range_m + np.linspace(0.0, 0.15, 30_000)
    echoes = train(range_m[:, None], light.peak_power_w[0], background_w=light.background_power_w[0])
    pixel = counter.pixel(echoes.background_power_w)
    bins = Bins(
        pixel=pixel,
        wave=waveform(*broaden(echoes, counter, pixel.sigma_s)),
        seed=3,
        pulse=np.arange(30_000, dtype=np.uint32),
    )
    peak = bins.highest(np.zeros(30_000), 2.0 * range_m / C)
    level = float(counter.threshold(counter.working_point(light.background_power_w[:1]))[0])
    assert (peak.value >= level).mean() == pytest.approx(expected, abs=0.012 + 2.0 / math.sqrt(30_000))


def test_a_threshold_that_scatters_has_the_false_alarms_of_its_thresholds():
    """40,000 empty windows against the mean rate over a log-normal distribution; few have two, so 3 % beside 4 sigma.

    Many thresholds of so wide a distribution lie at the least one.
    """
    counter = photons.sensor(
        "histogram.threshold_floor=18.0 histogram.threshold_slope=0.0 histogram.threshold_spread=0.12",
        "histogram.threshold_least=0.8 histogram.stops=4",
    )
    sky = photons.echoes_of(counter, 60.0, count=40_000, illuminance_klux=1.0)
    sky.has_surface[:], sky.peak_power_w[:] = False, 0.0
    detection = photons.detect(sky, counter)
    ours = sum((stop.reported & (stop.status == Status.FALSE_ALARM)).mean() for stop in detection.stops)
    point = counter.working_point(sky.background_power_w[:1])
    drawn = 18.0 * np.maximum(np.exp(0.12 * np.random.default_rng(0).standard_normal(200_000)), 0.8)
    rate_hz = np.asarray(counter.false_alarm_rate_hz(point, drawn))
    expected = float(rate_hz.mean()) * float(counter.tdc.listening_s)
    sharp = float(np.ravel(counter.false_alarm_rate_hz(point, np.array([18.0])))[0]) * float(counter.tdc.listening_s)
    assert 0.005 < expected < 0.2
    assert expected > 1.5 * sharp
    assert ours == pytest.approx(expected, rel=0.05, abs=4.0 * math.sqrt(expected / 40_000))
    # One that asks the neighbours scatters for echoes alone.
    asking = photons.sensor(
        "histogram.threshold_floor=14.4 histogram.threshold_slope=0.0 histogram.threshold_spread=0.12",
        "histogram.lone_factor=1.25 histogram.stops=4",
    )
    detection = photons.detect(sky, asking)
    of_noise = sum((stop.reported & (stop.status == Status.FALSE_ALARM)).mean() for stop in detection.stops)
    assert of_noise == pytest.approx(sharp, rel=0.05, abs=4.0 * math.sqrt(sharp / 40_000))


@pytest.mark.parametrize("estimator", ["matched_filter", "centroid"])
@pytest.mark.parametrize(("photons_of_echo", "klux"), [(400.0, 0.0), (400.0, 4.0), (60.0, 1.0)])
def test_precision_is_close_to_the_bound(estimator, photons_of_echo, klux):
    """sigma 1.0 to 1.2 times Cramer and Rao's, without rounding; 8,000 pulses give it to 0.8 %. Between 0.98 and 1.2,
    as the bins' places are even. The centroid knows the pulse's length alone, so it is close to it in the dark only.
    """
    counter = photons.sensor("detector.spads=4000", f"histogram.estimator='{estimator}'")
    light = photons.echoes_of(counter, 40.0, photons=photons_of_echo, count=8_000, illuminance_klux=klux)
    light.range_m[:] += np.linspace(0.0, 0.3, 8_000)
    stop = photons.detect(light, counter).stops[0]
    detected = photons.echo_of(stop)
    pixel = counter.pixel(light.background_power_w)
    rate_hz, sigma_s = float(np.mean(pixel.count_rate_hz)), float(pixel.sigma_s)
    bound_s = reference_photon_counting.bound_s(
        signal=photons_of_echo, rate_hz=rate_hz, sigma_s=sigma_s, bin_s=float(counter.histogram.bin_s)
    )
    ratio = (stop.range_m - light.range_m)[detected].std() / (0.5 * C * float(np.mean(bound_s)))
    if estimator == "matched_filter" or klux == 0.0:
        assert 0.98 < ratio < 1.2
    else:
        assert ratio > 1.0


def test_false_alarms_are_as_many_as_in_whole_histograms():
    """2000 whole windows of Poisson counts, filtered and searched by other code; 4 standard errors."""
    counter = photons.sensor("histogram.threshold_floor=0.0", "histogram.threshold_slope=0.27", "histogram.stops=4")
    sky = photons.echoes_of(counter, 60.0, count=40_000, **SUNNY)
    sky.has_surface[:], sky.peak_power_w[:] = False, 0.0
    detection = photons.detect(sky, counter)
    ours = sum((stop.reported & (stop.status == Status.FALSE_ALARM)).sum() for stop in detection.stops) / 40_000
    pixel = counter.pixel(sky.background_power_w[:1])
    point = counter.working_point(sky.background_power_w[:1])
    level = float(counter.threshold(point)[0])
    counts = np.random.default_rng(4).poisson(even_of(pixel), 2_000_000)
    values = filtered(counts, sigma_of(pixel), even=even_of(pixel))
    theirs = ((values[1:] > level) & (values[:-1] <= level)).sum() / 2000
    assert 0.05 < theirs < 2.0
    # Dead times narrow the noise here by some percent; Poisson counts do not have that.
    share = float(pixel.variance_share[0])
    assert share > 0.97
    assert ours == pytest.approx(theirs, abs=4 * math.sqrt(theirs / 2000) + 0.1 * theirs)
    assert (detection.outcome == Outcome.NO_SURFACE).all()


def trains(counter, ranges_m, powers_w, count):
    """Pulses of several sub-echoes each."""
    lanes = {"range_m": np.tile(ranges_m, count), "peak_power_w": np.tile(powers_w, count)}
    part = SubEchoes(**lanes, count=len(ranges_m))
    return EchoTrain(
        parts=(part,),
        surfaces=len(ranges_m),
        has_surface=np.ones(count, bool),
        background_power_w=np.full(count, 1e-10),
    )


def test_a_sure_echo_is_as_sure_with_another_one_far_away():
    """P_d of stronger and stronger echoes becomes 1 without a leap, also beside a weak one. It is not followed closer
    than 1e-11.
    """
    counter = photons.sensor("histogram.threshold_spread=0.2")
    powers_w = photons.echoes_of(counter, 30.0, count=300).peak_power_w * np.geomspace(1e-4, 10.0, 300)
    for second in (0.0, 0.01):
        light = trains(counter, [30.0, 60.0], [1.0, second], 300)
        (part,) = light.parts
        part = dataclasses.replace(part, peak_power_w=part.peak_power_w * np.repeat(powers_w, 2))
        chance = np.asarray(photons.detect(dataclasses.replace(light, parts=(part,)), counter).detection_probability)
        assert chance.min() < 0.5
        assert chance.max() == 1.0
        assert not ((chance > 1.0 - 1e-11) & (chance < 1.0)).any()
        assert chance[chance < 1.0].max() > 1.0 - 1e-5


def test_two_boards_are_two_returns_and_the_first_shades_the_second():
    """SPADs that the first board fired are blind for 12 ns: behind it, at 1.2 m, the second has fewer photons by what
    dead time says, exp(-Lambda); at 6 m it has all. Tolerance: 3 % of photons, 4000 pulses.
    """
    counter = photons.sensor("histogram.stops=2", "detector.spads=100")
    pixel = counter.pixel(np.full(1, 1e-10))
    one_w = float(np.ravel(pixel.power_w(1500.0 * np.ones(1)))[0])
    light = -math.log(1 - 1500.0 / float(pixel.trials) / float(pixel.free[0]))
    for apart, unshaded_share in ((1.2, math.exp(-light)), (6.0, 1.0)):
        train = trains(counter, [30.0, 30.0 + apart], [one_w, one_w], 4000)
        stops = photons.detect(train, counter, seed=1).stops
        assert all(photons.echo_of(stop).all() for stop in stops)
        assert stops[1].amplitude.mean() / stops[0].amplitude.mean() == pytest.approx(unshaded_share, rel=0.05)
        assert stops[1].true_range_m.mean() == pytest.approx(30.0 + apart, abs=0.03)


@pytest.mark.parametrize(("background_w", "apart"), chosen(1, [(1e-12, 1.8), (1e-12, 2.0), (1e-10, 2.0)]))
def test_echoes_that_merge_are_found_as_often_as_their_broad_peak(background_w, apart):
    """Two boards ``apart`` widths of the filter's output: whole histograms, filtered and searched by other code,
    against P_d. 4 standard errors of 1200 pulses and 0.02 of the law (T98a); a lone echo's is 0.12 to 0.17 too low.
    """
    counter, count = photons.sensor("histogram.window_us=0.2", "detector.spads=400"), 1200
    pixel = counter.pixel(np.full(1, background_w))
    point = counter.working_point(np.full(1, background_w))
    level = float(counter.threshold(point)[0])
    step_m = 0.5 * C * apart * float(pixel.sigma_s) * matched_filter.OUTPUT_WIDTH
    one_w = float(np.ravel(point.response.power_w(np.full(1, 0.5 * level * math.exp(apart**2 / 8.0))))[0])
    range_m = 25.0 + np.linspace(0.0, 0.15, count)[:, None] + np.array([0.0, step_m])
    light = train(range_m, np.full((count, 2), one_w), background_w=background_w)
    pulse = np.arange(count, dtype=np.uint32)
    expected = float(np.mean(receiver.detect(light, counter, seed=1, pulse=pulse).detection_probability))
    assert 0.4 < expected < 0.8
    counts = whole.histograms(light, counter, seed=1, pulse=pulse).counts
    values = filtered(counts, sigma_of(pixel), even=even_of(pixel))
    middle = 1e9 * (2.0 * range_m.mean(axis=1) / C)
    near = np.abs(np.arange(values.shape[1]) + 12.5 - middle[:, None]) < 5.0
    above_share = (np.where(near, values, 0.0).max(axis=1) >= level).mean()
    assert above_share == pytest.approx(expected, abs=4.0 * math.sqrt(0.25 / count) + 0.02)


@pytest.mark.parametrize(
    ("rate_mhz", "detections", "overrides"),
    [
        (0.001, 0.1, ()),
        (0.001, 1.5, ()),
        (20.0, 0.2, ()),
        (20.0, 0.2, ("histogram.estimator='centroid'",)),
        (0.001, 1.5, ("detector.stamps='first'", "histogram.coates=true")),
    ],
)
def test_ranges_have_no_bias_over_the_places_in_a_bin(rate_mhz, detections, overrides):
    """Rationale: walk by pile-up and shadow are taken off, and a peak lies between bins. Mean error of the range of
    4,000 echoes in tenths of a bin, 150 mm: within 5 mm, for the tables of (T101), and 4.5 standard
    errors. The walk is some 0.1 m at 1.5 detections, a receiver of bins alone is off by 75 mm.
    """
    counter = photons.sensor("detector.spads=400", "detector.dead_time_ns=20", *overrides)
    dark = counter.pixel(np.zeros(1))
    range_m = 40.0 + np.linspace(0.0, 0.45, 4000)
    light = photons.echoes_of(counter, 40.0, photons=1.0, count=4000, illuminance_klux=0.0)
    light.range_m[:] = range_m
    light.peak_power_w[:] = detections / float(dark.detections(1.0))
    light.background_power_w[:] = (1e6 * rate_mhz - float(dark.rate_hz[0])) / float(dark.per_watt)
    stop = photons.detect(light, counter).stops[0]
    assert photons.echo_of(stop).all()
    apart = np.asarray(stop.range_m) - range_m
    bin_m = 0.5 * C * 1e-9
    tenth = (10.0 * (range_m / bin_m % 1.0)).astype(int)
    number = np.bincount(tenth)
    assert (np.abs(np.bincount(tenth, apart) / number) < 5e-3 + 4.5 * apart.std() / np.sqrt(number)).all()


@pytest.mark.parametrize("detections", [0.3, 3.0, 100.0, 5000.0])
def test_the_raw_range_of_strong_echoes_is_short_by_their_pile_up(detections):
    """Rationale: the first of many photons fire all SPADs, up to 3.7 sigmas before the peak: farther than the filter
    would look for it there. Reference: (T101), 4 standard errors and 2 %: firings crowd within one bin, half a
    sigma long.
    """
    counter = photons.sensor("histogram.walk='raw'", "detector.dark_count_rate_hz=0")
    pixel = counter.pixel(np.zeros(1))
    light = photons.echoes_of(counter, 40.0, photons=1.0, count=2000, illuminance_klux=0.0)
    light.range_m[:] = 40.0 + np.linspace(0.0, 0.45, 2000)
    light.peak_power_w[:] = detections / float(pixel.detections(1.0))
    stop = photons.detect(light, counter).stops[0]
    assert photons.echo_of(stop).all()
    apart = np.asarray(stop.range_m) - light.range_m
    expected = (
        0.5
        * C
        * float(pixel.sigma_s)
        * float(np.ravel(pile_up.shift(detections=np.array([detections]), sun=pixel.sun, dead=pixel.blind_sigmas))[0])
    )
    assert apart.mean() == pytest.approx(expected, abs=4.0 * apart.std() / math.sqrt(2000) - 0.02 * expected)


@pytest.mark.parametrize(("rate_mhz", "detections"), chosen(2, [(1.0, 3.0), (60.0, 3.0), (60.0, 10.0), (200.0, 10.0)]))
def test_the_place_of_a_strong_echo_scatters_as_that_of_single_firings(rate_mhz, detections):
    """Rationale: in the sun a strong echo draws more SPADs than are free before it, so its peak is high and not narrow.
    Reference: 300 histograms of SPADs followed from one firing to the next, filtered and searched here; 4 standard
    errors, and a tenth for places that are not linear in the counts.
    """
    counter = photons.sensor("detector.spads=300", "histogram.shots=10", "detector.dead_time_ns=20")
    dark = counter.pixel(np.zeros(1))
    pixel = counter.pixel(np.maximum(1e6 * rate_mhz - dark.rate_hz, 0.0) / dark.per_watt)
    sigma_ns = 1e9 * float(pixel.sigma_s)
    lead, bin_ns, count = 6.0 * sigma_ns, 0.25 * sigma_ns, 300
    counts = photons.renewal_counts(
        np.random.default_rng(12),
        (count, int(float(np.ravel(pixel.trials)[0]))),
        rate_per_ns=1e-9 * float(pixel.rate_hz[0]),
        dead=20.0,
        bins=int(2.0 * lead / bin_ns),
        bin_ns=bin_ns,
        echo=(detections, lead, sigma_ns),
    )
    places = lead + sigma_ns * np.arange(-5.0, 2.0, 0.05)
    middles = bin_ns * (np.arange(counts.shape[1]) + 0.5)
    template = np.exp(-0.5 * ((middles[:, None] - places) / (matched_filter.TEMPLATE * sigma_ns)) ** 2)
    even = counts[:, :4].mean()
    values = (counts - even) @ template
    best = np.clip(values.argmax(axis=1), 1, len(places) - 2)
    low, top, high = (values[np.arange(count), best + k] for k in (-1, 0, 1))
    place_ns = places[best] + 0.5 * (low - high) / (low - 2.0 * top + high) * (places[1] - places[0])
    power_w = detections / pixel.detections(1.0)
    deviation_ns = 1e9 * float(np.ravel(pixel.place_deviation_s(pixel.counts(pixel.detections(power_w))))[0])
    assert deviation_ns == pytest.approx(place_ns.std(), rel=0.1 + 4.0 / math.sqrt(2.0 * count))


def test_echoes_that_nearly_merge_have_as_many_returns_as_peaks():
    """Reference: peaks above the threshold in whole histograms of as many counts, which are drawn as well: 4 standard
    errors of the difference of two shares of 500 pulses.
    """
    counter = photons.sensor(
        "detector.spads=400", "histogram.window_us=0.4", "histogram.threshold_floor=25", "histogram.stops=2"
    )
    pixel = counter.pixel(np.full(1, 1e-12))
    powers = [float(np.ravel(pixel.power_w(n * np.ones(1)))[0]) for n in (100.0, 150.0)]
    light = trains(counter, [30.0, 31.0], powers, 500)
    light.background_power_w[:] = 1e-12
    stops = photons.detect(light, counter).stops
    pulse = np.arange(500, dtype=np.uint32)
    counts = whole.histograms(light, counter, seed=1, pulse=pulse).counts
    values = filtered(counts, sigma_of(pixel), even=even_of(pixel))
    level = float(np.ravel(counter.threshold(counter.working_point(light.background_power_w[:1])))[0])
    top = (values[:, 1:-1] > values[:, :-2]) & (values[:, 1:-1] >= values[:, 2:]) & (values[:, 1:-1] >= level)
    two = (top.sum(axis=1) >= 2).mean()
    assert np.asarray(stops[0].reported).all()
    assert 0.3 < two < 0.7
    assert np.asarray(stops[1].reported).mean() == pytest.approx(two, abs=4.0 * math.sqrt(2.0 * 0.25 / 500))


def two_echoes(rate_mhz, bin_ns, photons_of_echoes, apart_m, count):
    """A sensor of the tests with a pulse of 3 ns, and two echoes of so many photons, over the places in a bin."""
    counter = photons.sensor(
        "histogram.window_us=0.4", "histogram.stops=4", f"histogram.bin_ns={bin_ns}", "laser.pulse_fwhm_ns=3"
    )
    dark = counter.pixel(np.zeros(1))
    background_w = max(1e6 * rate_mhz - float(dark.rate_hz[0]), 0.0) / float(dark.per_watt)
    power_w = counter.working_point(np.full(1, background_w)).response.power_w(np.array(photons_of_echoes))
    start_m = 25.0 + np.linspace(0.0, 1.0, count, endpoint=False) * (0.5 * C * float(counter.histogram.bin_s))
    range_m = start_m[:, None] + np.array([0.0, apart_m])
    return counter, train(range_m, np.tile(power_w, (count, 1)), background_w=background_w), range_m


def peaks_of_events(rng, counter, light, apart_m, points):
    """(2,) mean number of peaks above the threshold nearer to the first and to the second echo.

    SPADs followed from one firing to the next; filtered and searched by other code than the receiver's.
    """
    pixel, histogram = counter.pixel(light.background_power_w[:1]), counter.histogram
    bin_ns, dead = 1e9 * float(histogram.bin_s), 1e9 * float(counter.detector.dead_time_s)
    rate, sigma = 1e-9 * float(pixel.rate_hz[0]), 1e9 * float(counter.laser.pulse_fwhm_s) / 2.354820045
    trials, side = int(float(pixel.trials)), histogram.reach - histogram.search - 1
    even, broad = trials * rate / (1.0 + rate * dead) * bin_ns, math.hypot(sigma, bin_ns / math.sqrt(12.0))
    level = float(counter.threshold(counter.working_point(light.background_power_w[:1]))[0])
    detections, apart_ns = pixel.detections(light.parts[0].peak_power_w[:2]), 2e9 * apart_m / C
    lead, total, at_once = 8.0 * sigma + side * bin_ns, np.zeros(2), 25
    for number in range(points // at_once):
        place = lead + (number + rng.random()) * at_once / points * bin_ns
        counts = photons.renewal_counts(
            rng,
            (at_once, trials),
            rate_per_ns=rate,
            dead=dead,
            bins=int((2.0 * lead + apart_ns) / bin_ns) + 4,
            bin_ns=bin_ns,
            echo=(detections, place + np.array([0.0, apart_ns]), sigma),
        )
        values = filtered(counts, broad, even=even, bin_ns=bin_ns, side=side)
        middle = values[:, 1:-1]
        top = (middle > values[:, :-2]) & (middle >= values[:, 2:]) & (middle >= level)
        time_ns = (np.arange(middle.shape[1]) + side + 1.5) * bin_ns - place
        near = (time_ns > -4.0 * sigma) & (time_ns < apart_ns + 4.0 * sigma)
        first = np.abs(time_ns) < np.abs(time_ns - apart_ns)
        total += [(top & near & where).sum() for where in (first, ~first)]
    return total / points


@pytest.mark.parametrize(
    ("rate_mhz", "bin_ns", "photons_of_echoes", "apart_m"),
    chosen(
        3,
        [
            (0.001, 1.0, (150.0, 150.0), 0.4),
            (0.001, 1.0, (150.0, 150.0), 0.7),
            (0.001, 0.5, (15.0, 150.0), 1.0),
            (0.001, 1.0, (150.0, 15.0), 1.0),
            (0.001, 1.0, (50.0, 150.0), 0.9),
            (5.0, 0.5, (50.0, 150.0), 0.8),
            (5.0, 0.5, (150.0, 50.0), 0.9),
            (5.0, 1.0, (30.0, 30.0), 0.7),
            (5.0, 1.0, (150.0, 15.0), 1.15),
            (5.0, 1.0, (30.0, 150.0), 2.0),
        ],
    ),
)
def test_echoes_that_merge_or_lie_on_a_flank_are_found_as_often_as_by_photons(
    rate_mhz, bin_ns, photons_of_echoes, apart_m
):
    """400 histograms of SPADs one by one against 2,000 points: 4 standard errors of either echo's returns, 1e-3 false
    alarms of the test. Where candidates are only the expected peaks, and none may lie at a search's end, an echo of
    15 photons 1 m before one of 150 is never found, for 0.5, and two of 150 have 1.5 returns for 1.7.

    P_d of the returns against their share: 4 standard errors, and 0.06 of the law: the template ends at 3 sigmas, and
    values are taken for jointly normal.
    """
    counter, light, range_m = two_echoes(rate_mhz, bin_ns, photons_of_echoes, apart_m, 2000)
    stops = photons.detect(light, counter).stops
    simulated = peaks_of_events(np.random.default_rng(7), counter, light, apart_m, 400)
    echo = np.stack([photons.echo_of(stop) for stop in stops])
    place = np.stack([stop.range_m for stop in stops]) - range_m[:, 0]
    probability = np.stack([np.asarray(stop.detection_probability) for stop in stops])
    first = np.abs(place) < np.abs(place - apart_m)
    # Of which echo a peak is that lies half way between is chance of the place in a bin.
    shares = [(simulated.sum(), echo)] if apart_m < 0.5 else zip(simulated, (echo & first, echo & ~first), strict=True)
    for expected, where in shares:
        share = where.sum() / 2000
        spread = max(expected * (1.0 - min(expected, 0.99)), 0.01)  # 0.01: a share of 1 has no other error
        assert share == pytest.approx(expected, abs=4.0 * math.sqrt(spread / 400 + spread / 2000))
    # Equal echoes that merge are one, wherever its peak lies: P_d of all returns together is their number.
    if echo.sum() < 1.01 * 2000:
        assert probability[echo].mean() == pytest.approx(1.0, abs=0.06)
    elif photons_of_echoes[0] == photons_of_echoes[1]:
        assert 2.0 * probability[echo].mean() == pytest.approx(echo.sum() / 2000, abs=0.12)
    else:
        for where in (echo & first, echo & ~first):
            share = where.sum() / 2000
            error = 4.0 * math.sqrt(share * (1.0 - share) / 2000)
            assert probability[where].mean() == pytest.approx(share, abs=0.06 + error)


def test_an_echo_on_a_flank_keeps_its_distance():
    """An echo of 15 photons on the flank of one of 150, 1 m or 6.7 ns behind it: it is visited after that one's peak.
    With a separation of 11 ns the first return is kept, as it is of peaks, in every of 1,000 points.
    """

    def ranges(separation_ns):
        counter, light, range_m = two_echoes(0.001, 1.0, (15.0, 150.0), 1.0, 1000)
        converter = dataclasses.replace(counter.tdc, dead_time_s=1e-9 * separation_ns)
        stops = photons.detect(light, dataclasses.replace(counter, tdc=converter)).stops
        return np.stack([np.where(photons.echo_of(stop), stop.range_m - range_m[:, 0], np.nan) for stop in stops])

    anywhere, apart = ranges(0.0), ranges(11.0)
    assert 0.2 < (np.isfinite(anywhere).sum(axis=0) == 2).mean() < 0.5
    assert (np.isfinite(apart).sum(axis=0) == 1).all()
    np.testing.assert_array_equal(np.nanmin(anywhere, axis=0), np.nanmin(apart, axis=0))


@pytest.mark.parametrize(("photons_of_echoes", "limit"), [((10.0, 3.0), "blanking_s"), ((3.0, 10.0), "window_s")])
def test_an_echo_on_a_flank_does_not_bring_back_one_that_is_left_out(photons_of_echoes, limit):
    """An echo of 3 photons 0.6 m behind or before one of 10, which is blanked or beyond the window: the peak that is
    found for it is often the other one, and no return.
    """
    counter, light, range_m = two_echoes(0.001, 1.0, photons_of_echoes, 0.6, 1000)
    middle_m = range_m[:, 0].mean() + 0.3
    converter = dataclasses.replace(counter.tdc, **{limit: middle_m / (0.5 * C)})
    stops = photons.detect(light, dataclasses.replace(counter, tdc=converter)).stops
    place_m = np.concatenate([stop.range_m[photons.echo_of(stop)] for stop in stops])
    assert len(place_m) > 30
    assert ((place_m >= middle_m) == (limit == "blanking_s")).all()


def test_which_of_two_boards_is_kept():
    """Boards of 600 and 1,500 photons, 3 m apart: the strongest, the first and the last, and one that lies nearer
    to the return before than the least separation is none. The source is the brighter one's number.
    """

    def detect_with(*overrides):
        counter = photons.sensor(
            "detector.spads=100", "histogram.window_us=0.6", "histogram.threshold_floor=100", *overrides
        )
        pixel = counter.pixel(np.full(1, 1e-10))
        powers = [float(np.ravel(pixel.power_w(n * np.ones(1)))[0]) for n in (600.0, 1500.0)]
        return photons.detect(trains(counter, [30.0, 33.0], powers, 50), counter)

    for keep, place_m in (("strongest", 33.0), ("first", 30.0), ("last", 33.0)):
        result = detect_with(f"histogram.keep='{keep}'")
        np.testing.assert_allclose(result.stops[0].true_range_m, place_m, atol=0.01)
        assert (np.asarray(result.source) == 1).all()
    two_boards = detect_with("histogram.stops=2", "histogram.separation_ns=18")
    assert all(photons.echo_of(stop).all() for stop in two_boards.stops)
    alone = detect_with("histogram.stops=2", "histogram.separation_ns=22")
    assert photons.echo_of(alone.stops[0]).all()
    assert not np.asarray(alone.stops[1].reported).any()
    np.testing.assert_allclose(alone.stops[0].true_range_m, 30.0, atol=0.01)


@pytest.mark.parametrize(
    ("keep", "photons_of_boards", "ranges_m"),
    [
        ("strongest_and_last", (600.0, 1500.0, 900.0), (33.0, 36.0)),
        ("strongest_and_last", (600.0, 900.0, 1500.0), (33.0, 36.0)),
        ("strongest_and_last", (1500.0, 900.0, 600.0), (30.0, 36.0)),
        ("strongest_and_last", (1500.0,), (30.0,)),
        ("all", (600.0, 1500.0, 900.0), (30.0, 33.0, 36.0)),
    ],
)
def test_histograms_keep_two_returns_or_all_as_comparators_do(keep, photons_of_boards, ranges_m):
    """The strongest and the last peak, the second strongest if these are one; or every peak. In order of time."""
    counter = photons.sensor(
        "detector.spads=100", "histogram.window_us=0.6", "histogram.threshold_floor=100", f"histogram.keep='{keep}'"
    )
    pixel = counter.pixel(np.full(1, 1e-10))
    powers = [float(np.ravel(pixel.power_w(n * np.ones(1)))[0]) for n in photons_of_boards]
    boards_m = [30.0 + 3.0 * number for number in range(len(powers))]
    stops = photons.detect(trains(counter, boards_m, powers, 50), counter).stops
    assert len(stops) == {"strongest_and_last": 2, "all": 16}[keep]
    for stop, range_m in zip(stops, ranges_m, strict=False):
        assert photons.echo_of(stop).all()
        np.testing.assert_allclose(stop.true_range_m, range_m, atol=0.01)
    assert not any(np.asarray(stop.reported).any() for stop in stops[len(ranges_m) :])


def test_what_comes_while_the_receiver_is_blanked_is_none():
    """Blanked for 210 ns, 31.5 m: of boards at 30 and 33 m the second alone is returned, and first photons count only
    from then on.
    """
    counter = photons.sensor(
        "histogram.stops=2 detector.spads=100 histogram.blanking_ns=210 detector.stamps='first'",
        "histogram.window_us=0.4 histogram.threshold_floor=100",
    )
    pixel = counter.pixel(np.full(1, 1e-10))
    power_w = 0.5 / float(np.ravel(pixel.detections(1.0))[0])
    light = trains(counter, [30.0, 33.0], [power_w, power_w], 50)
    stops = photons.detect(light, counter).stops
    np.testing.assert_allclose(stops[0].true_range_m, 33.0, atol=0.01)
    assert not np.asarray(stops[1].reported).any()
    counts = whole.histograms(light, counter, seed=1, pulse=np.arange(50, dtype=np.uint32)).expected
    assert (counts[:, :210] == 0.0).all()
    rate = float(pixel.rate_hz[0])
    assert counts[0, 210] == pytest.approx(float(pixel.trials) * rate * 1e-9, rel=1e-2)


def test_what_lies_beyond_the_unambiguous_range_folds_back_and_says_so():
    counter = photons.spinning()
    unambiguous = 0.5 * C * 1.8e-6
    light = photons.echoes_of(counter, 300.0, photons=200.0, count=500, illuminance_klux=0.1)
    stop = photons.detect(light, counter).stops[0]
    assert (stop.status == Status.ALIASED).all()
    assert stop.range_m.mean() == pytest.approx(300.0 - unambiguous, abs=0.01)
    np.testing.assert_allclose(stop.true_range_m, 300.0, atol=1e-3)
    # The first of 54 shots has no pulse before it.
    assert stop.amplitude.mean() == pytest.approx(200.0 * 53 / 54, rel=0.02)


def test_coates_correction_straightens_the_photons_of_strong_echoes():
    """Two detections a shot and SPAD: corrected counts are in proportion to the light to 1 %, raw ones 0.43 of it."""
    ratios = {}
    for coates in ("true", "false"):
        counter = photons.sensor(f"histogram.coates={coates}", "detector.stamps='first'", "detector.spads=1000")
        light = photons.echoes_of(counter, 5.0, count=4000, illuminance_klux=1.0)
        pixel = counter.pixel(light.background_power_w, range_m=light.range_m)
        unit = float(np.ravel(pixel.detections(1.0))[0])
        light.peak_power_w[:] = 2.0 / unit
        stop = photons.detect(light, counter).stops[0]
        ratios[coates] = stop.amplitude.mean() / (2.0 * float(pixel.trials))
    assert ratios["true"] == pytest.approx(1.0, abs=0.01)
    assert ratios["false"] == pytest.approx((1 - math.exp(-2.0)) / 2.0, rel=0.03)


def test_coincidence_keeps_the_dark_and_loses_the_weak():
    """Two of 64 SPADs in a nanosecond: background falls with the square of the light, and P_d is that of the draws:
    4 standard errors of 2000.
    """
    counter = photons.sensor("detector.coincidence=2", "histogram.shots=400")
    light = photons.echoes_of(counter, 40.0, photons=30.0, count=2000, illuminance_klux=0.5)
    pixel = counter.pixel(light.background_power_w[:1])
    alone = photons.sensor("histogram.shots=400").pixel(light.background_power_w[:1])
    per_bin = float(alone.count_share[0])
    assert float(pixel.count_share[0]) == pytest.approx(
        1 - (1 - per_bin) ** 64 - 64 * per_bin * (1 - per_bin) ** 63, rel=1e-3
    )
    detection = photons.detect(light, counter)
    stop = detection.stops[0]
    assert photons.echo_of(stop).mean() == pytest.approx(float(detection.detection_probability[0]), abs=0.045)
    assert stop.amplitude.mean() == pytest.approx(30.0, rel=0.05)


@pytest.mark.parametrize("dark_hz", [0.0, 1000.0])
@pytest.mark.parametrize("klux", [0.0, 20.0])
def test_more_light_is_never_less_likely_to_be_found(dark_hz, klux):
    """Up to an echo that fires every SPAD, where counts have next to no variance."""
    counter = photons.sensor(f"detector.dark_count_rate_hz={dark_hz}")
    light = photons.echoes_of(counter, 10.0, count=400, illuminance_klux=klux)
    light = dataclasses.replace(light, peak_power_w=light.peak_power_w * np.geomspace(1e-6, 30.0, 400))
    probability = np.asarray(photons.detect(light, counter).detection_probability)
    assert probability[0] < 0.1
    assert (np.diff(probability) >= -1e-9).all()
    assert probability[-1] == pytest.approx(1.0)


IN_THE_SUN = ("detector.dead_time_ns=5", "detector.dark_count_rate_hz=6e7")


@pytest.mark.parametrize(
    ("name", "keys", "lights"),
    chosen(
        1,
        [
            ("os1-128", (), (0.3, 2.0, 8.0, 100.0, 1000.0)),
            ("sony-spad-189x600", (), (0.3, 2.0, 8.0, 16.0, 40.0)),
            ("os1-128", ("detector.spads=16", "detector.coincidence=2"), (0.3, 1.0, 4.0, 16.0)),
            ("os1-128", ("detector.spads=16", *IN_THE_SUN), (1.0, 2.7, 8.0)),
        ],
    ),
)
def test_corrected_walk_leaves_nothing(name, keys, lights):
    """Mean error of the range over detections on a SPAD, from weak echoes to those that fire all in every shot.

    An eighth of the deviation (it is drawn to 1e-2 of it), 1 mm of table and bins, and four standard errors. Left alone
    the shift is 3 to 39 cm; corrected by photons, which end where all SPADs fire, 4 cm from 8 detections on and 36 cm
    at 1000; of SPADs together, not at all.
    """
    counter, shots = load_sensor(name, overrides=list(keys)), 3000
    range_m = 30.0 + np.linspace(0.0, 0.6, shots)
    light = plane.echoes_of_plane(counter, plane.Target(illuminance_klux=0.0), range_m)
    for detections in lights:
        power_w = detections / np.ravel(counter.pixel(light.background_power_w).detections(1.0))[0]
        lit = dataclasses.replace(light, peak_power_w=np.full(shots, power_w))
        stop = photons.detect(lit, counter, seed=4).stops[0]
        is_echo = stop.reported & (np.abs(stop.range_m - range_m) < 2.0)
        assert is_echo.mean() > 0.95
        error_m = (stop.range_m - range_m)[is_echo]
        assert abs(error_m.mean()) < 1e-3 + (0.125 + 4.0 / math.sqrt(shots)) * error_m.std(), detections


def revived_scene(lambda_tau, dead_ns, detections, count, *keys):
    """A sensor of 16 SPADs and 120 shots in the sun, and strong echoes at 30 m."""
    counter = photons.sensor(
        f"detector.spads=16 histogram.shots=120 histogram.stops=2 detector.dead_time_ns={dead_ns}",
        "histogram.threshold_slope=0.33",
        *keys,
    )
    dark = counter.pixel(np.zeros(1))
    light = photons.echoes_of(counter, 30.0, photons=1.0, count=count, illuminance_klux=0.0)
    light.range_m[:] = 30.0 + np.linspace(0.0, 0.15, count)
    light.background_power_w[:] = max(1e9 * lambda_tau / dead_ns - float(dark.primary_hz[0]), 0.0) / float(
        dark.per_watt
    )
    light.peak_power_w[:] = detections / float(dark.detections(1.0))
    return counter, light


def is_revived(stop):
    return np.asarray(stop.reported) & (np.asarray(stop.status) == Status.REVIVED)


REVIVED = [
    (0.27, 20.0, 5.0),
    (0.55, 10.0, 5.0),
    (0.55, 20.0, 5.0),
    (1.1, 20.0, 5.0),
    (1.1, 20.0, 1.0),
    (0.4, 20.0, 50.0),
]
"""lambda tau, tau [ns] and Lambda."""


@pytest.mark.parametrize("case", chosen(2, list(REVIVED)))
def test_spads_that_come_back_together_make_a_return(case):
    """Shares of points with a return a dead time behind the echo: SPADs followed from one firing to the next, 200
    histograms, and 3,000 drawn. 4 standard errors of both (one run in 15,000 fails), and 0.02 for a wider search in
    those. Their ranges: 4 standard errors, and 0.1 m, half of a sigma.
    """
    counter, light = revived_scene(*case, 3000)
    detection = photons.detect(light, counter)
    first, second = detection.stops
    assert photons.echo_of(first).mean() > 0.99
    revived = is_revived(second)
    pixel = counter.pixel(light.background_power_w[:1])
    rate, dead, echo = 1e-9 * float(pixel.rate_hz[0]), case[1], case[2]
    sigma, trials = 4.0 / 2.354820045, 16 * 120
    side = counter.histogram.reach - counter.histogram.search - 1
    even = trials * rate / (1.0 + rate * dead)
    level = float(counter.threshold(counter.working_point(light.background_power_w[:1]))[0])
    rng, place = np.random.default_rng(8), 40.5
    bins = math.ceil(place + dead + 10.0 * sigma)
    counts = photons.renewal_counts(
        rng, (200, trials), rate_per_ns=rate, dead=dead, bins=bins, bin_ns=1.0, echo=(echo, place, sigma)
    )
    values = filtered(counts, sigma_of(pixel), even=even, side=side)
    behind = np.arange(values.shape[1]) + side + 0.5 - place
    values[:, (behind < dead - 2.0 * sigma) | (behind > dead + 5.0 * sigma)] = -np.inf
    passes = values.max(axis=1) >= level
    share = passes.mean()
    error = 4.0 * math.sqrt(0.25 / 200 + 0.25 / 3000) * 2.0 * math.sqrt(max(share * (1.0 - share), 0.01))
    assert revived.mean() == pytest.approx(share, abs=0.02 + error)
    if share > 0.2:
        far = 0.5e-9 * C * behind[values.argmax(axis=1)][passes]
        ours = (second.range_m - light.range_m)[revived]
        error = 4.0 * math.sqrt(far.var() / len(far) + ours.var() / len(ours))
        assert ours.mean() == pytest.approx(far.mean(), abs=0.1 + error)
        np.testing.assert_allclose(second.true_range_m[revived], light.range_m[revived], atol=1e-3)


HUMPS = {
    "27 MHz us": (0.27, 20.0, 5.0, ()),
    "short": (0.55, 10.0, 5.0, ()),
    "50 photons": (1.1, 20.0, 50.0, ()),
    "500 photons": (0.3, 20.0, 500.0, ()),
    "pairs": (0.55, 20.0, 5.0, ("detector.coincidence=2",)),
    "pairs, 50 photons": (0.3, 20.0, 50.0, ("detector.coincidence=2",)),
    "afterpulses": (0.4, 20.0, 50.0, ("detector.afterpulse=0.05", "detector.afterpulse_ns=30")),
    "afterpulses in the dark": (0.02, 20.0, 5.0, ("detector.afterpulse=0.05", "detector.afterpulse_ns=30")),
}
"""lambda tau, tau [ns], Lambda, and keys."""


@pytest.mark.parametrize("case", chosen(2, list(HUMPS)))
def test_spads_that_come_back_make_a_hump_as_high_as_of_photons_one_by_one(case):
    """The highest value of the filter where SPADs come back: mean and deviation over 200 histograms of SPADs that are
    followed from one firing to the next, and 2,000 drawn ones, searched in the same bins.

    Tolerance: 4.5 standard errors of each (one run in 100,000 fails), and 3 % of the mean for bins half a sigma long.
    Afterpulses beside: a tenth of the deviation. Their absence is 0.4 to 2 deviations.
    """
    lambda_tau, dead_ns, detections, keys = HUMPS[case]
    counter, light = revived_scene(lambda_tau, dead_ns, detections, 2000, *keys)
    spads, shots = 16, 120
    # The middle of bin 200.
    light.range_m[:] = 0.5 * C * 200.5e-9
    pixel = counter.pixel(light.background_power_w)
    wave = waveform(*broaden(train(light.range_m[:, None], light.peak_power_w[:, None]), counter, pixel.sigma_s))
    bins = Bins(pixel=pixel, wave=wave, seed=3, pulse=np.arange(2000, dtype=np.uint32))
    echo = pile_up.firings(detections=np.full(2000, detections), sun=pixel.sun)
    hump = pile_up.hump(echo, sun=pixel.sun, dead=pixel.blind_sigmas)
    place = echo.mean + pixel.blind_sigmas + hump.place
    time_s = 200.5e-9 + place * pixel.sigma_s
    first, *_ = bins.draw(place, time_s, behind=True)
    drawn = np.asarray(bins.highest(place, time_s, behind=True).value)
    reach, search = counter.histogram.reach, counter.histogram.search
    side = reach - search - 1
    begin = 60
    options = {
        "rate_per_ns": 1e-9 * float(np.ravel(pixel.primary_hz)[0]),
        "dead": dead_ns,
        "bins": begin + math.ceil(dead_ns) + 30,
        "bin_ns": 1.0,
        "echo": (detections, begin + 0.5, 4.0 / 2.354820045),
        "afterpulse": (0.05, 30.0) if counter.detector.afterpulse else (0.0, 1.0),
    }
    least = counter.detector.coincidence
    rows, trials = (200, spads * shots) if least == 1 else (200 * shots, spads)
    counts = photons.renewal_counts(np.random.default_rng(8), (rows, trials), **options)
    if least > 1:
        counts = (counts >= least).reshape(200, shots, -1).sum(axis=1)
    values = filtered(counts, sigma_of(pixel), even=even_of(pixel), side=side)
    middle = begin + int(first[0]) - 200 + reach - side
    searched = values[:, middle - search : middle + search + 2].max(axis=1)
    of_afterpulses = 0.1 * drawn.std() if counter.detector.afterpulse else 0.0
    error = 4.5 * math.sqrt(searched.var() / 200 + drawn.var() / 2000)
    assert drawn.mean() == pytest.approx(searched.mean(), rel=0.03, abs=error + of_afterpulses + 0.03 * searched.mean())
    assert drawn.std() == pytest.approx(searched.std(), rel=4.5 * math.sqrt(0.5 / 200 + 0.5 / 2000) + 0.05)


def test_no_spads_come_back_in_the_dark_or_from_weak_echoes_or_where_none_can():
    """The strongest of all peaks is an echo; SPADs that fire once never come back; Coates' correction knows of them."""
    for case in ((0.0, 20.0, 5.0), (1.1, 20.0, 0.02)):
        counter, light = revived_scene(*case, 1000)
        assert not any(is_revived(stop).any() for stop in photons.detect(light, counter).stops)
    counter, light = revived_scene(1.1, 20.0, 5.0, 1000)
    for keys in (["histogram.stops=1"], ["detector.stamps='first'"], ["histogram.coates=true"]):
        receiver = photons.sensor(
            "detector.spads=16 histogram.shots=120 histogram.stops=2 detector.dead_time_ns=20",
            "histogram.threshold_slope=0.33",
            *keys,
        )
        assert not any(is_revived(stop).any() for stop in photons.detect(light, receiver).stops)


def test_another_board_where_spads_come_back_is_an_echo_alone():
    """The board at the hump of a stronger one is a return of its own light, and the only one there."""
    counter, light = revived_scene(1.1, 20.0, 5.0, 500)
    background, first_w = float(light.background_power_w[0]), float(light.peak_power_w[0])
    ranges = np.tile([30.0, 33.3], (500, 1))
    powers = np.tile([first_w, first_w], (500, 1))
    pulse = np.arange(500, dtype=np.uint32)
    stops = receiver.detect(train(ranges, powers, background_w=background), counter, seed=1, pulse=pulse).stops
    near = [(np.abs(stop.range_m - 33.3) < 1.0) & stop.reported for stop in stops]
    assert (np.sum(near, axis=0) == 1).all()
    assert not any((is_revived(stop) & here).any() for stop, here in zip(stops, near, strict=True))


def test_a_wall_in_fog_is_a_peak_beside_that_of_the_air():
    """Reference: the highest points of the light on a grid. Near the lenses both are one."""
    counter = photons.sensor("histogram.window_us=0.6")
    for wall_m, count in ((2.0, 1), (6.0, 2), (20.0, 2)):
        fog = in_fog(counter, np.ones(2), wall_m=wall_m)
        light = Peaks.of(fog, counter, seed=0, pulse=np.arange(2, dtype=np.uint32))
        rises = np.diff([light.filtered.at(np.full(2, place))[0][0] for place in np.arange(-60.0, 10.0, 0.2)]) > 0.0
        assert np.count_nonzero(rises[:-1] & ~rises[1:]) == count
        assert candidates._find_peaks(light).count.tolist() == [count] * 2
