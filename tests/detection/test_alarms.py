"""False alarms among the stops of the converter."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import photons, trains
from helpers.trains import detect, sensor, train
from scipy.stats import norm

from lidarscene.detection import receiver
from lidarscene.detection.outcomes import Status
from lidarscene.light.echoes import Echoes
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S

HALF_C = 0.5 * SPEED_OF_LIGHT_M_S


@pytest.mark.parametrize("keep", ["first", "last", "strongest", "strongest_and_last"])
def test_false_alarms_by_what_is_kept(keep):
    """Alarms in an empty window against brute force: a Poisson number, even times, exponential heights.

    Means of time and excess of the kept ones over 12 000 pulses, z-tests at 1e-4 each: as both of a pulse go together,
    a mean's variance is up to twice that of as many single ones.
    """
    equipped = sensor("table1-apd", "tdc.threshold_to_noise=3.3", "tdc.stops=2", f"tdc.keep='{keep}'")
    count = 12_000
    detection = detect(train(np.full((count, 1), 50.0), np.zeros((count, 1))), equipped, seed=4)
    point = equipped.working_point(np.array([trains.BACKGROUND_W]))
    threshold = float(equipped.threshold(point)[0])
    p_false, window = norm.sf(3.3), equipped.tdc.window_s
    expected = -np.log1p(-p_false) * equipped.tdc.bandwidth_hz * window
    scale = float(point.noise.deviation[0]) ** 2 / threshold
    random = np.random.default_rng(8)
    times, excess = [], []
    for _ in range(count):
        number = random.poisson(expected)
        time, height = random.uniform(0.0, window, number), random.exponential(scale, number)
        early, strong = np.argsort(time), np.argsort(-height)
        kept = {"first": early[:2], "last": early[-2:], "strongest": strong[:2]}.get(keep)
        if kept is None:  # the second strongest where the last is the strongest
            kept = [*early[-1:], *strong[~np.isin(strong, early[-1:])][:1]]
        times.append(time[kept])
        excess.append(height[kept])
    simulated = np.concatenate(times), np.concatenate(excess)
    reported = [stop.reported for stop in detection.stops]
    measured = (
        np.concatenate([s.range_m[k] / HALF_C for s, k in zip(detection.stops, reported, strict=True)]),
        np.concatenate([s.amplitude[k] - threshold for s, k in zip(detection.stops, reported, strict=True)]),
    )
    limit = norm.isf(0.5e-4)
    for a, b in zip(measured, simulated, strict=True):
        error = math.sqrt(2.0) * math.hypot(a.std() / math.sqrt(len(a)), b.std() / math.sqrt(len(b)))
        assert abs(a.mean() - b.mean()) < limit * error
    # Numbers of kept alarms have at most a Poisson number's variance.
    assert abs(len(measured[0]) - len(simulated[0])) < limit * math.sqrt(2.0 * len(simulated[0]))
    in_both = detection.stops[0].reported & detection.stops[1].reported
    assert (detection.stops[0].range_m[in_both] <= detection.stops[1].range_m[in_both]).all()


@pytest.mark.parametrize("tnr", [0.1, 1.0])
def test_the_highest_alarm_over_a_low_threshold_is_as_high_as_noise(tnr):
    """Highest of as many normal deviates as there are comparisons, 3.2 of them: to half a deviation."""
    equipped = sensor("table1-apd", f"tdc.threshold_to_noise={tnr}", "tdc.keep='strongest'")
    detection = detect(train(np.full((2000, 1), 50.0), np.zeros((2000, 1))), equipped)
    (stop,), sigma = detection.stops, equipped.working_point(np.array([trains.BACKGROUND_W])).noise.deviation
    comparisons = round(equipped.tdc.window_s * equipped.tdc.bandwidth_hz)
    highest = np.random.default_rng(3).normal(size=(2000, comparisons)).max(axis=1)
    assert stop.reported.all()
    assert np.mean(stop.amplitude / sigma) == pytest.approx(highest.mean(), abs=0.5)


def test_an_alarm_is_beside_the_strongest_echo():
    """Its source and true range are those of the pulse's strongest sub-echo, the second of three."""
    equipped = sensor("table1-apd", "tdc.threshold_to_noise=3.3", "tdc.stops=2", "tdc.window_us=2")
    power = trains.power_at_snr(equipped, 1.0) * np.array([0.2, 0.4, 0.3])
    detection = detect(train(np.tile((50.0, 70.0, 90.0), (4000, 1)), np.tile(power, (4000, 1))), equipped)
    for stop in detection.stops:
        alarms = stop.reported & (stop.status == Status.FALSE_ALARM)
        assert alarms.any()
        np.testing.assert_allclose(stop.true_range_m[alarms], 70.0)
        assert (stop.source[alarms] == 1).all()


LOW, LSB_PS, JITTER_PS = "tdc.threshold_to_noise=3.3", 800.0, 300.0
SAMPLER = ("sampler.type='multi_level_tdc'", "sampler.levels=[2, 4]")


def alarm_times(equipped, light):
    """(pulse, stop, time [s]) of the echoes and of the false alarms of pulses."""
    pulse = np.arange(len(light.background_power_w), dtype=np.uint32)
    found = {Status.ECHO: [], Status.FALSE_ALARM: []}
    for number, stop in enumerate(receiver.detect(light, equipped, seed=2, pulse=pulse).stops):
        for status, times in found.items():
            mask = np.asarray(stop.reported) & (np.asarray(stop.status) == status)
            times += [(k, number, t) for k, t in zip(pulse[mask], np.asarray(stop.range_m)[mask] / HALF_C, strict=True)]
    return found[Status.ECHO], found[Status.FALSE_ALARM]


def boards(equipped, *, of_train, count=3000):
    """Light of pulses at boards from 40 to 70 m."""
    ranges, power = np.linspace(40.0, 70.0, count), np.full(count, trains.power_at_snr(equipped, 12.0))
    light = train(ranges[:, None], power[:, None])
    if of_train:
        return light
    return Echoes(
        range_m=ranges, peak_power_w=power, background_power_w=light.background_power_w, has_surface=light.has_surface
    )


RECEIVERS = {
    "single echo": (lambda *keys: sensor("table1-apd", LOW, "tdc.stops=3", *keys), False),
    "rises": (lambda *keys: sensor("table1-apd", LOW, "tdc.stops=3", *keys), True),
    "strongest": (lambda *keys: sensor("table1-apd", LOW, "tdc.stops=3", "tdc.keep='strongest'", *keys), True),
    "sampler": (lambda *keys: sensor("table1-apd", LOW, "tdc.stops=3", *SAMPLER, *keys), True),
    "cells": (lambda *keys: sensor("table1-sipm", "tdc.threshold_to_noise=2.5", "tdc.stops=3", *keys), True),
}


@pytest.mark.parametrize("name", [*RECEIVERS, "histogram"])
def test_alarms_lie_on_the_clocks_grid_as_echoes_do(name):
    """A converter has one clock, so that the last digits of a range do not tell noise from signal."""
    if name == "histogram":
        low = ("histogram.threshold_floor=0", "histogram.threshold_slope=0.27", "histogram.stops=4")
        equipped = photons.sensor(*low, f"histogram.lsb_ps={LSB_PS}")
        light = photons.echoes_of(equipped, 60.0, photons=60.0, illuminance_klux=4.0)
    else:
        sensor_with, of_train = RECEIVERS[name]
        equipped = sensor_with(f"tdc.lsb_ps={LSB_PS}", f"tdc.jitter_ps={JITTER_PS}")
        light = boards(equipped, of_train=of_train)
    found = alarm_times(equipped, light)
    for times in found:
        steps = np.array([time_s for _, _, time_s in times]) / (1e-12 * LSB_PS)
        assert len(steps) > 200
        assert np.abs(steps - np.rint(steps)).max() < 1e-6


@pytest.mark.parametrize("separation_ns", [0.0, 40.0])
def test_false_peaks_of_a_histogram_are_held_apart(separation_ns):
    """Rationale: of two peaks a bin between them is lower, and of nearer ones than the separation the first counts.
    Reference: of a Poisson process of rate r at most r / (1 + r d) a second are taken where each one stops others for a
    time d. Tolerance: 4.5 standard errors of a Poisson number.
    """
    low = ("histogram.threshold_floor=0", "histogram.threshold_slope=0.2", "histogram.keep='all'")
    equipped = photons.sensor(*low, f"histogram.separation_ns={separation_ns}")
    light = photons.echoes_of(equipped, 60.0, photons=60.0, illuminance_klux=4.0, count=1000)
    light = replace(light, peak_power_w=0.0 * light.peak_power_w)
    times = np.array([(pulse, time_s) for pulse, _, time_s in alarm_times(equipped, light)[1]])
    times = times[np.lexsort(times.T[::-1])]
    apart_s = np.diff(times[:, 1])[np.diff(times[:, 0]) == 0]
    least_s = max(1e-9 * separation_ns, 2.0 * float(equipped.histogram.bin_s))
    assert apart_s.min() >= least_s * (1.0 - 1e-6)
    point = equipped.working_point(light.background_power_w[:1])
    rate_hz = float(equipped.false_alarm_rate_hz(point, equipped.threshold(point))[0])
    expected = 1000 * rate_hz / (1.0 + rate_hz * least_s) * float(equipped.tdc.listening_s)
    assert expected > 2000
    assert len(times) == pytest.approx(expected, abs=4.5 * math.sqrt(expected))


@pytest.mark.parametrize("name", list(RECEIVERS))
def test_alarms_have_the_converters_jitter(name):
    """Compared with the same alarms without it: mean and standard deviation, z-tests at 1e-4 each."""
    sensor_with, of_train = RECEIVERS[name]
    exact, jittered = (
        {(pulse, stop): time_s for pulse, stop, time_s in alarm_times(equipped, boards(equipped, of_train=of_train))[1]}
        for equipped in (sensor_with("tdc.blanking_ns=10", f"tdc.jitter_ps={ps}") for ps in (0.0, JITTER_PS))
    )
    # Jitter moves no crossing, so the same alarms have the same stops.
    assert exact.keys() == jittered.keys()
    error = np.array([jittered[key] - exact[key] for key in exact]) / (1e-12 * JITTER_PS)
    limit = norm.isf(0.5e-4)
    assert abs(error.mean()) < limit / math.sqrt(len(error))
    assert abs(error.std() - 1.0) < limit / math.sqrt(2.0 * len(error))


def test_an_alarm_that_the_clock_moves_before_the_pulse_is_none():
    """The alarm is like an echo there: time counts from the pulse, and 0 stands for no return."""
    equipped = sensor("table1-apd", LOW, "tdc.lsb_ps=1e6", "tdc.window_us=2", "tdc.stops=3")
    stops = detect(train(np.full((4000, 1), 50.0), np.zeros((4000, 1))), equipped).stops
    reported = np.concatenate([np.asarray(stop.range_m)[np.asarray(stop.reported)] for stop in stops])
    assert np.unique(np.rint(reported / HALF_C / 1e-6)).tolist() == [1.0, 2.0]
