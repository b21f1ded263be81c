"""Which pulses a receiver finds and keeps: walls behind fog, orders of returns."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import trains
from helpers.readings import on_light
from helpers.run_seed import chosen
from scipy.constants import c
from scipy.signal import find_peaks
from scipy.stats import kstest, norm

from lidarscene import load_sensor
from lidarscene.detection.outcomes import Status
from lidarscene.light.waveform import sample_power_and_signal

ADC = ("sampler.type='adc'", "sampler.rate_mhz=1000", "sampler.bits=14", "sampler.full_scale=1e-4")
LEVELS = ("sampler.type='multi_level_tdc'", "sampler.levels=[2, 4, 8, 18, 32, 64]")
"""Of the fog and the wall of `behind_fog` only the wall reaches 18 thresholds."""


def behind_fog(*overrides):
    """Stops of 300 beams on a wall of 30 % at 25 m in fog of 80 m visibility, by a sensor with two lenses.

    The wall is some 20 thresholds high, a third more than the fog at its brightest and 20 times the fog before it,
    which is over the threshold up to the wall.
    """
    sensor = load_sensor("biaxial-905", overrides=["tdc.stops=1", *overrides])
    return trains.detect(trains.in_fog(sensor, np.ones(300), wall_m=25.0), sensor).stops


def is_wall(stop):
    """Whether a stop is the wall, within 0.5 m: a leading edge has 7 cm of noise, and fog before it bends it by 9."""
    return stop.reported & (stop.status == Status.ECHO) & (np.abs(stop.range_m - 25.0) < 0.5)


@pytest.mark.parametrize(
    "overrides",
    [
        ("tdc.keep='strongest'",),
        ("tdc.keep='last'",),
        ("tdc.keep='last'", *ADC),
        ("tdc.keep='last'", *LEVELS),
        ("tdc.keep='strongest'", *LEVELS),
    ],
)
def test_a_wall_behind_fog_is_found(overrides):
    """Noise at its top, 21.5 thresholds high, is 0.67 of a threshold; at that of the fog, 15.4 high, 0.58: the first is
    five deviations over the level at 18, the other four below it, so that not one of 300 beams in 300 runs is mistaken.
    """
    (stop,) = behind_fog(*overrides)
    assert is_wall(stop).mean() > 0.98


@pytest.mark.parametrize(
    "overrides", [("tdc.keep='strongest_and_last'", "tdc.stops=2"), ("tdc.stops=2", *ADC), ("tdc.stops=2", *LEVELS)]
)
def test_fog_and_the_wall_behind_it(overrides):
    """Two stops hold both. What is no wall is fog: no surface stands between."""
    fog, wall = behind_fog(*overrides)
    assert is_wall(wall).mean() > 0.99
    assert (fog.status[fog.reported & ~is_wall(fog)] == Status.WEATHER).all()


@pytest.mark.parametrize("estimator", ["matched_filter", "centroid"])
def test_samples_of_a_wall_stand_on_fog(estimator):
    """An ADC takes the fog off its samples and adds it to the height: that is the peak of the finely sampled waveform.

    Tolerance: half of the fog there, which counted twice would be off by all of it; it is five thresholds high.
    """
    sampler = (*ADC, f"sampler.estimator='{estimator}'")
    sensor = load_sensor("biaxial-905", overrides=["tdc.stops=1", "tdc.keep='last'", *sampler])
    light = trains.in_fog(sensor, np.ones(300), wall_m=15.0)
    (stop,) = trains.detect(light, sensor).stops
    range_m = np.arange(10.0, 16.0, 0.005)
    signal = sample_power_and_signal(light, sensor, 2.0 / c * range_m)[1][0]
    fog = signal[range_m < 14.0].min()
    assert fog > 4.0 * float(sensor.threshold(sensor.working_point(light.background_power_w))[0])
    assert np.median(stop.amplitude) == pytest.approx(signal.max(), abs=0.5 * fog)


def test_a_comparator_s_first_edge_is_the_fog():
    """The comparator works as a real one: it stays high up to the wall, which makes no edge of its own."""
    (stop,) = behind_fog()
    assert (stop.status == Status.WEATHER).all()
    assert stop.range_m.max() < 6.0


def random_trains(sensor, pulses, *, seed):
    """Sub-echoes at random places, up to sixteen thresholds of 5000 deviations high.

    In two of five pulses some neighbours are 2.5 to 4.5 sigma_p apart, each at least two thresholds high: light between
    them falls by a threshold, and mostly stays above one. Elsewhere that is rare.
    """
    range_m, power = trains.random_trains(pulses, 6, sensor, seed=seed, spread_m=12.0)
    power *= 4000.0
    random, close = np.random.default_rng(seed + 1), 2 * pulses // 5
    apart = random.uniform(2.5, 4.5, (close, 4)).cumsum(axis=1)
    range_m[:close, :4] = range_m[:close, :1] + apart * trains.SIGMA_M
    power[:close] = trains.power_at_snr(sensor, 5000.0) * random.uniform(2.0, 16.0, (close, 6))
    power[:close, 1:4] *= random.uniform(size=(close, 3)) < 0.7
    power[:close, 4:] = 0.0
    return trains.train(range_m, power)


@pytest.mark.parametrize(("keep", "dead_time_ns"), [("all", 0.0), ("strongest", 0.0), ("strongest", 30.0)])
def test_peaks_of_any_train(keep, dead_time_ns):
    """Compared with SciPy's peaks of finely sampled waveforms that stand out by a threshold on both sides.

    Noise is 2e-4 of the threshold. Trains with a peak whose height or prominence is within 5 % of it are left out, and
    with a valley on which the two rules differ: they ask how far the light falls between two peaks, SciPy to the next
    higher one. Of peaks nearer than the dead time both take the higher.
    """
    sensor = load_sensor(
        "table1-apd",
        overrides=[
            "tdc.timing='peak'",
            "tdc.threshold_to_noise=5000",
            "detector.circuit_noise_na=1e5",
            f"tdc.keep='{keep}'",
            f"tdc.dead_time_ns={dead_time_ns}",
        ],
    )
    light = random_trains(sensor, 300, seed=7)
    detection = trains.detect(light, sensor)
    point = sensor.working_point(light.background_power_w)
    threshold = sensor.threshold(point)
    step_s = 0.01 * trains.SIGMA_S
    judged = several = 0
    for pulse in range(300):
        ranges = light.parts[0].range_m.reshape(300, -1)[pulse]
        time_s = np.arange(2.0 * ranges.min() / c - 30e-9, 2.0 * ranges.max() / c + 30e-9, step_s)
        lone_light = replace(
            light,
            background_power_w=light.background_power_w[:1],
            parts=(
                replace(
                    light.parts[0], range_m=ranges, peak_power_w=light.parts[0].peak_power_w.reshape(300, -1)[pulse]
                ),
            ),
        )
        signal = sample_power_and_signal(lone_light, sensor, time_s)[1][0] / threshold[pulse]
        peaks, about = find_peaks(signal, height=1.0, prominence=0.0)
        low = np.array([signal[a : b + 1].min() for a, b in itertools.pairwise(peaks)])
        doubtful = (np.abs(about["prominences"] - 1.0) < 0.05).any() or (low < 1.05).any()
        if doubtful or (about["peak_heights"] < 1.05).any():
            continue
        distance = max(dead_time_ns * 1e-9 / step_s, 1.0)
        peaks, _ = find_peaks(signal, height=1.0, prominence=1.0, distance=distance)
        if dead_time_ns and len(peaks) > 2:
            continue
        if keep == "strongest":
            if len(peaks) > 1 and np.diff(np.sort(signal[peaks]))[-1] < 0.005:
                continue  # two are as strong: noise says which is the stronger
            peaks = peaks[[np.argmax(signal[peaks])]] if len(peaks) else peaks
        measured_m = [float(stop.range_m[pulse]) for stop in detection.stops if stop.reported[pulse]]
        assert measured_m == pytest.approx(list(0.5 * c * time_s[peaks]), abs=0.05 * trains.SIGMA_M)
        judged, several = judged + 1, several + (len(peaks) > 1)
    # On average 100 are judged, and 60 have several; a binomial's deviation is 8 of these, and 7.
    assert judged > 40
    assert keep == "strongest" or several > 25


ECHOES = ((100.0, 2000.0), (110.0, 4000.0), (130.0, 500.0))
"""Ranges and SNR; 10 m are 67 ns."""


@pytest.mark.parametrize(
    ("overrides", "ranges"),
    [
        (["tdc.keep='strongest_and_last'"], [110.0, 130.0]),
        (["tdc.keep='strongest_and_last'", "tdc.window_us=0.8"], [100.0, 110.0]),
        # Peaks at least a dead time apart: the higher of two that are nearer.
        (["tdc.timing='peak'", "tdc.stops=3", "tdc.dead_time_ns=80"], [110.0, 130.0, 0.0]),
        (["tdc.timing='peak'", "tdc.stops=3", "tdc.dead_time_ns=250"], [110.0, 0.0, 0.0]),
        (["tdc.stops=3", "tdc.dead_time_ns=80"], [100.0, 130.0, 0.0]),
    ],
)
def test_orders_of_returns(overrides, ranges):
    sensor = load_sensor("table1-apd", overrides=[*trains.QUIET, *overrides])
    distances, snr = (np.array(column) for column in zip(*ECHOES, strict=True))
    power = trains.power_at_snr(sensor, 1.0) * snr
    detection = trains.detect(trains.train(np.tile(distances, (20, 1)), np.tile(power, (20, 1))), sensor)
    for stop, expected_ranges in zip(detection.stops, ranges, strict=True):
        np.testing.assert_array_equal(np.where(stop.reported, np.rint(stop.true_range_m), 0.0), expected_ranges)


CLEAN = ("detector.circuit_noise_na=1e6", "tdc.threshold_to_noise=1e4")


@pytest.mark.parametrize(
    ("peaks", "expected"),
    chosen(
        3,
        [
            # Peaks and the valleys between them, in thresholds, and those that are pulses of their own: each rises by a
            # threshold over the lowest light since the last one, which is a threshold over that itself.
            ([6.0, 2.0, 3.2], [0, 1]),
            ([6.0, 2.0, 2.9], [0]),
            ([6.0, 2.0, 2.6, 2.4, 3.2], [0, 2]),  # 1.2 over the valley before a bump that is none
            ([6.0, 2.0, 2.5, 2.3, 2.9], [0]),  # neither bump is one
            ([2.0, 1.8, 2.5], [1]),  # of two that are one the higher
            ([2.5, 1.8, 2.0], [0]),
            ([1.5, 0.3, 1.4], [0, 1]),  # below the threshold in between
        ],
    ),
)
def test_pulses_by_their_valleys(peaks, expected):
    """The rule of (T75) on light in straight lines from peak to valley, 3 m apart. SciPy's prominences say the same.

    The place of a corner is good to the differences that stand for the slope of such light.
    """
    sensor = load_sensor("table1-apd", overrides=["tdc.timing='peak'", "tdc.keep='all'", *CLEAN])
    corners = [(45.0, 0.0), *((50.0 + 3.0 * i, height) for i, height in enumerate(peaks))]
    corners.append((corners[-1][0] + 5.0, 0.0))
    light, fine_m, power = on_light(sensor, [(30.0, 0.0)], corners)
    tops, _ = find_peaks(power, height=1.0, prominence=1.0 - 1e-9)
    assert list(fine_m[tops]) == pytest.approx([50.0 + 6.0 * i for i in expected], abs=0.02)
    detection = trains.detect(light, sensor)
    kept = [stop for stop in detection.stops if stop.reported[0]]
    assert [float(stop.range_m[0]) for stop in kept] == pytest.approx(
        [50.0 + 6.0 * i for i in expected], abs=0.3 * trains.SIGMA_M
    )
    threshold = float(sensor.threshold(sensor.working_point(light.background_power_w))[0])
    heights = [float(stop.amplitude[0]) / threshold for stop in kept]
    assert heights == pytest.approx([peaks[2 * i] for i in expected], rel=0.01)


@pytest.mark.parametrize(("other", "kept_m"), [(3.2, 50.0), (3.6, 60.0)])
def test_a_pulse_that_rises_further_is_as_strong_as_its_highest_peak(other, kept_m):
    """Peaks of 3.1 and 3.4 thresholds, 2.7 in the valley between, are one pulse, which its first edge times."""
    sensor = load_sensor("table1-apd", overrides=["tdc.keep='strongest'", "tdc.walk='raw'", *CLEAN])
    light, fine_m, power = on_light(sensor, [(50.0, 3.0), (50.0 + 2.6 * trains.SIGMA_M, 3.3), (60.0, other)], [])
    (stop,) = trains.detect(light, sensor).stops
    edge_m = fine_m[(fine_m < kept_m) & (power < 1.0)][-1]
    assert stop.range_m[0] == pytest.approx(edge_m, abs=0.01 * trains.SIGMA_M)
    threshold = float(sensor.threshold(sensor.working_point(light.background_power_w))[0])
    highest = power[np.abs(fine_m - kept_m) < 2.0].max()
    assert stop.amplitude[0] == pytest.approx(highest * threshold, rel=0.01)


@pytest.mark.parametrize(("timing", "points"), [("leading_edge", 0), ("peak", 1)])
def test_light_that_began_in_the_blanking_has_no_edge(timing, points):
    """A bump of half a threshold on it makes none either; a receiver that times peaks sees its peak."""
    overrides = ["tdc.keep='strongest'", f"tdc.timing='{timing}'", "tdc.blanking_ns=330", *CLEAN]
    sensor = load_sensor("table1-apd", overrides=overrides)
    light, *_ = on_light(sensor, [(55.0, 0.5)], [(44.0, 0.0), (45.0, 2.0), (58.0, 1.9), (59.0, 0.0)])
    (stop,) = trains.detect(light, sensor).stops
    assert int(stop.reported[0]) == points


@pytest.mark.parametrize("rate", [2.0, 25.0])
def test_the_last_and_the_highest_of_many_alarms(rate):
    """Crossings of an empty window are a Poisson process of ``rate`` in it: from the last one to the window's end the
    time is exponential, and so are the heights of all, of which the highest is kept, as steep as at 2.5 deviations at
    least. Kolmogorov and Smirnov at 1e-6.
    """
    plain = load_sensor("table1-apd").tdc
    probability = rate / (plain.bandwidth_hz * plain.window_s)
    tnr = float(norm.isf(-math.expm1(-probability)))
    sensor = load_sensor("table1-apd", overrides=[f"tdc.threshold_to_noise={tnr!r}", "tdc.keep='strongest_and_last'"])
    light = trains.train(np.full((6000, 1), 50.0), np.zeros((6000, 1)))
    detection = trains.detect(light, sensor, seed=5)
    times = np.stack([np.where(stop.reported, stop.range_m, -1.0) for stop in detection.stops]).max(axis=0)
    has_alarm = times >= 0.0
    assert abs(has_alarm.mean() + math.expm1(-rate)) < 5.0 * math.sqrt(math.exp(-rate) / 6000) + 1e-9
    waits = (sensor.tdc.window_s - times[has_alarm] * 2.0 / c) / sensor.tdc.window_s * rate
    none = math.exp(-rate)
    assert kstest(waits, lambda x: -np.expm1(-np.asarray(x)) / (1.0 - none)).pvalue > 1e-6
    point = sensor.working_point(light.background_power_w[:1])
    level, sigma = float(sensor.threshold(point)[0]), float(point.noise.deviation[0])
    highest = np.stack([np.where(stop.reported, stop.amplitude, 0.0) for stop in detection.stops]).max(axis=0)
    excess = (highest[has_alarm] - level) * max(level, 2.5 * sigma) / sigma**2
    assert kstest(excess, lambda x: (np.exp(-rate * np.exp(-np.asarray(x))) - none) / (1.0 - none)).pvalue > 1e-6
