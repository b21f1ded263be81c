"""Multi-echo on the device: the same as on numpy, compiled once, and (5) whatever the number of rays."""

import dataclasses

import numpy as np
import pytest
from helpers import launches, trains
from helpers.run_seed import chosen

from lidarscene.light import echoes
from lidarscene.light.waveform import sample_power_and_signal, waveform
from lidarscene.physics.optics import radiometry

pytestmark = pytest.mark.usefixtures("mi")

COUNT = 3000
ADC = ("sampler.type='adc'", "sampler.rate_mhz=1000", "sampler.bits=16", "sampler.full_scale=1e-3")
LEVELS = ("sampler.type='multi_level_tdc'", "sampler.levels=[2, 4, 8]")
CASES = {
    "apd": ("table1-apd", "tdc.stops=3"),
    "sipm": ("table1-sipm", "tdc.stops=2"),
    "counted cells": ("table1-sipm", "detector.counting='binomial'"),
    "filtered": ("table1-apd", "receiver.response='single_pole'", "receiver.ac_coupling_khz=500"),
    "strongest": ("table1-apd", "tdc.stops=2", "tdc.keep='strongest'", "tdc.dead_time_ns=15"),
    "last": ("table1-sipm", "tdc.keep='last'"),
    "fraction": ("table1-apd", "tdc.stops=3", "tdc.timing='constant_fraction'"),
    "peak": ("table1-sipm", "tdc.timing='peak'", "tdc.keep='strongest_and_last'"),
    "matched filter": ("table1-apd", "tdc.timing='matched_filter'", "tdc.stops=2", "tdc.dead_time_ns=15"),
    "levels": ("table1-apd", *LEVELS),
    "adc": ("table1-apd", *ADC),
    "centroid": ("table1-sipm", *ADC, "sampler.full_scale=400", "sampler.estimator='centroid'"),
}


SUB_ECHOES = {"filtered": 2, "peak": 3, "matched filter": 3, "fraction": 3, "strongest": 4, "last": 4, "levels": 4}
"""Of a pulse: with an undershoot for each of seven, the kernel alone would take as long as all others. Its size grows
with those of the sub-echoes, so that seven are left to two cases.
"""


@pytest.mark.parametrize("case", chosen(5, list(CASES)))
def test_device_and_numpy_agree(case):
    """Single precision: up to three picoseconds of 400 ns, 1e-5 of a probability. A sample on the edge of a step or a
    tick of the clock may fall on the other side: of the ADC's times 1 % may differ, by what its noise does.
    """
    equipped = trains.sensor(*CASES[case])
    range_m, power = trains.random_trains(COUNT, SUB_ECHOES.get(case, 7), equipped, seed=9)
    light = trains.train(range_m.astype(np.float32), power.astype(np.float32))
    expected, detection = trains.detect(light, equipped), trains.detect_on_device(light, equipped)
    assert np.mean(detection.outcome != expected.outcome) < 1e-3
    np.testing.assert_allclose(detection.snr, expected.snr, rtol=1e-5)
    # The binomial tail's own single-precision error is some 1e-4 (`maths.special.binomial_tail`).
    close = 3e-4 if case == "counted cells" else 1e-5
    np.testing.assert_allclose(detection.detection_probability, expected.detection_probability, atol=close)
    sampled = equipped.sampler is not None and hasattr(equipped.sampler, "samples")
    for stop, expected_stop in zip(detection.stops, expected.stops, strict=True):
        assert np.mean(stop.reported != expected_stop.reported) < 1e-3
        in_both = (
            stop.reported
            & expected_stop.reported
            & (stop.status == expected_stop.status)
            & (stop.source == expected_stop.source)
        )
        assert in_both.sum() > 0.995 * expected_stop.reported.sum()
        apart = np.abs(stop.range_m - expected_stop.range_m)[in_both]
        assert np.quantile(apart, 0.9 if sampled else 0.998) < (0.02 if sampled else 4e-4)
        np.testing.assert_allclose(
            stop.true_range_m[in_both], expected_stop.true_range_m[in_both], rtol=2e-6, atol=1e-4
        )
        if not sampled:
            assert np.quantile(np.abs(stop.amplitude[in_both] / expected_stop.amplitude[in_both] - 1.0), 0.998) < 2e-4


@pytest.mark.parametrize("edge", [False, True])
def test_fog_agrees(edge):
    """Device and NumPy agree on fog that ends at one surface, or 0.4 of it at a nearer one: the sum of both parts."""
    range_m = np.linspace(0.0, 150.0, 1501)
    shape = echoes.LookupTable((range_m / 3.0) ** 2 / (1.0 + (range_m / 3.0) ** 3) * np.exp(-range_m / 10.0))
    equipped = trains.sensor("table1-apd", "tdc.stops=3", "tdc.walk='raw'")
    distance, power = trains.random_trains(500, 3, equipped, seed=2)
    air = echoes.Volume(
        shape=shape,
        far_m=150.0,
        hump_m=echoes.hump_of(shape, 150.0),
        scale=np.random.default_rng(4).uniform(0.0, 3e-7, 500).astype(np.float32),
        end_m=distance.max(axis=1).astype(np.float32),
        extinction_per_m=0.05,
    )
    if edge:
        air = dataclasses.replace(air, edge=(distance.min(axis=1).astype(np.float32), np.full(500, 0.4, np.float32)))
    light = trains.train(distance.astype(np.float32), power.astype(np.float32), volume=air)
    if edge:
        place, near = np.linspace(-20.0, 20.0, 500), dataclasses.replace(air, end_m=air.edge[0], edge=None)
        ends = [
            waveform(dataclasses.replace(light, volume=part), equipped)
            for part in (near, dataclasses.replace(air, edge=None))
        ]
        expected_w = 0.4 * ends[0].air_w(place) + 0.6 * ends[1].air_w(place)
        np.testing.assert_allclose(waveform(light, equipped).air_w(place), expected_w, rtol=1e-6, atol=1e-15)
    expected, detection = trains.detect(light, equipped), trains.detect_on_device(light, equipped)
    fogs = 0
    for stop, expected_stop in zip(detection.stops, expected.stops, strict=True):
        # The table's slopes have corners, where single precision may see another peak: 1 % of the pulses.
        assert np.mean(stop.reported != expected_stop.reported) < 0.01
        in_both = stop.reported & expected_stop.reported
        if in_both.any():
            assert np.quantile(np.abs(stop.range_m - expected_stop.range_m)[in_both], 0.97) < 2e-3
        fogs += int(np.sum(stop.source[in_both] < 0))
    assert fogs > 50


@pytest.mark.parametrize("overrides", [(), CASES["filtered"][1:]])
def test_derivatives_are_those_of_the_power(overrides):
    """Derivatives with and without an undershoot against differences, good to 1e-4 of the peak over 0.01 of a place;
    the part of an air that swings by sin(R / 1.5 m) against its own derivatives, good to (0.13)^2 / 6 over half steps.
    """
    equipped = trains.sensor("table1-apd", *overrides)
    range_m, power = trains.random_trains(200, 3, equipped, seed=11)
    lit = power.any(axis=1)  # a pulse without any sub-echo has its places at the lens, where the air begins
    range_m, power = range_m[lit], power[lit]
    bare = waveform(trains.train(range_m, power), equipped)
    place = np.random.default_rng(3).uniform(-3.0, 15.0, len(power))
    step, peak = 0.01, power.max()
    before, centre, after = (bare.at(place + shift)[0] for shift in (-step, 0.0, step))
    _, slope, bend = bare.at(place)
    np.testing.assert_allclose(slope, (after - before) / (2.0 * step), atol=1e-4 * peak)
    np.testing.assert_allclose(bend, (after - 2.0 * centre + before) / step**2, atol=1e-3 * peak)

    shape = echoes.LookupTable(1.5 + np.sin(np.linspace(0.0, 150.0, 30_001) / 1.5))
    air = echoes.Volume(
        shape=shape,
        far_m=150.0,
        hump_m=(0.0, 150.0),
        scale=np.full(len(power), peak),
        end_m=np.full(len(power), 1e4),
        extinction_per_m=0.0,
    )
    wave = waveform(trains.train(range_m, power, volume=air), equipped)
    swing, by_place = wave.range_m(place) / 1.5, wave.unit_m / 1.5
    derivatives = wave.at(place)
    parts = 1.5 + np.sin(swing), by_place * np.cos(swing), -(by_place**2) * np.sin(swing)
    for derivative, bare_value, part in zip(derivatives, (centre, slope, bend), parts, strict=True):
        np.testing.assert_allclose(derivative - bare_value, peak * part, atol=4e-3 * peak * np.abs(part).max())


COUPLED = ("receiver.ac_coupling_khz=500",)


def behind_a_high_pass(time, powers, arrivals, rate):
    """Gaussian pulses behind s - k * s, by small exact steps of K' = w (s - K); times in sigma_p."""
    light = sum(p * np.exp(-0.5 * (time - a) ** 2) for p, a in zip(powers, arrivals, strict=True))
    decay = np.exp(-rate * (time[1] - time[0]))
    slow_part = np.zeros_like(light)
    for k in range(1, len(time)):
        slow_part[k] = decay * slow_part[k - 1] + (1.0 - decay) * 0.5 * (light[k] + light[k - 1])
    return light - slow_part


@pytest.mark.parametrize("coupling_khz", [500, 5000])
def test_pulses_behind_a_high_pass(coupling_khz):
    """There are three pulses, the last one weak: value and slopes are those of a high pass in small steps, from whose
    time w the places count, and whose lone peak is one: to the 1.4e-4 of the undershoot's own form.
    """
    equipped = trains.sensor("table1-apd", f"receiver.ac_coupling_khz={coupling_khz}")
    rate = float(equipped.coupling_rate)
    assert rate == pytest.approx(2.0 * np.pi * 1e3 * coupling_khz * trains.SIGMA_S)
    arrivals, powers = np.array([0.0, 6.0, 20.0]), np.array([1e-6, 3e-6, 1e-7])
    wave = waveform(trains.train(30.0 + trains.SIGMA_M * arrivals[None], powers[None]), equipped)
    time = np.arange(-10.0, 45.0, 2e-3)
    lone = behind_a_high_pass(time[time < 10.0], [1.0], [0.0], rate)
    expected = behind_a_high_pass(time, powers, arrivals, rate) / lone.max()
    assert time[np.argmax(lone)] == pytest.approx(-rate, abs=rate**2 + 2e-3)
    slope = np.gradient(expected, time)
    references = expected, slope, np.gradient(slope, time)
    for filtered, reference in zip(wave.at(time + rate), references, strict=True):
        np.testing.assert_allclose(filtered[10:-10], reference[10:-10], atol=4e-4 * powers.max())
    # Far behind them the baseline is as low as the areas of the pulses say, and recovers.
    area = np.sqrt(2.0 * np.pi) * rate * (powers * np.exp(0.5 * rate**2 - rate * (40.0 - arrivals))).sum()
    filtered = wave.at(np.array([40.0 + rate]))[0][0]
    assert filtered == pytest.approx(-area / lone.max(), rel=1e-3)


@pytest.mark.parametrize("foggy", [False, True])
@pytest.mark.parametrize("overrides", [(), COUPLED, ("receiver.response='gaussian'", *COUPLED)])
@pytest.mark.parametrize("recurrent", [False, True])
def test_even_places_see_all_light(overrides, foggy, recurrent):
    """A comb of places has the power of the waveform there, place by place: pulses, their undershoot and the air. So
    has the finely sampled signal, at the time of one place.
    """
    equipped = trains.sensor("table1-apd", *overrides)
    range_m, power = trains.random_trains(60, 3, equipped, seed=5)
    lit = np.flatnonzero(power.any(axis=1))[:40]  # the others have their places at the lens, where the air begins
    range_m, power = range_m[lit], power[lit]
    air = None
    if foggy:
        course = echoes.LookupTable(1.5 + np.sin(np.linspace(0.0, 150.0, 30_001) / 3.0))
        air = echoes.Volume(
            shape=course,
            far_m=150.0,
            hump_m=(0.0, 150.0),
            scale=np.full(40, 0.3 * power.max()),
            end_m=np.full(40, 1e4),
            extinction_per_m=0.0,
        )
    light = trains.train(range_m, power, volume=air)
    wave = waveform(light, equipped)
    start, spacing = np.full(40, -2.0), np.full(40, 0.4)
    comb = wave.comb(start, spacing, start + 12 * spacing, recurrent=recurrent)
    parts = tuple(comb.parts)
    for number in range(25):
        place = start + number * spacing
        expected_w = wave.at(place)[0]
        np.testing.assert_allclose(comb.power_w(place, parts), expected_w, atol=1e-9 * power.max())
        parts = comb.advance(parts)
        if number == 12:
            point = equipped.working_point(light.background_power_w)
            times_s = radiometry.time_of_flight_s(range_m=wave.range_m(place))
            signal = np.diagonal(sample_power_and_signal(light, equipped, times_s)[1])
            np.testing.assert_allclose(
                signal, point.response.signal(expected_w), atol=1e-6 * point.response.signal(power.max()).max()
            )
    assert np.all((wave.air_w(start) > 0.0) == foggy)


def test_a_clipped_pulse_has_the_undershoot_of_what_passes():
    """The baseline behind it is low by the signal's area: of a pulse that clips no more than at the clipping level."""
    equipped = trains.sensor("table1-apd", *COUPLED, "detector.saturation_ua=5")
    point = equipped.working_point(np.array([trains.BACKGROUND_W]))
    clips_w = float(np.ravel(point.response.power_w(5e-6))[0])
    behind = [
        waveform(trains.train(np.full((1, 1), 30.0), np.full((1, 1), watts)), equipped).at(np.array([10.0]))[0][0]
        for watts in (0.5 * clips_w, clips_w, 100.0 * clips_w)
    ]
    assert behind[0] < 0.0
    assert behind[1] == pytest.approx(2.0 * behind[0], rel=2e-2)  # half of its own peak passes as it is
    assert behind[2] == pytest.approx(behind[1], rel=1e-9)


def test_an_amplifier_changes_no_light():
    """The optical power of fog is the same whatever follows the detector: to what fog bends over a pulse's width."""
    times_s = radiometry.time_of_flight_s(range_m=np.linspace(8.0, 30.0, 50))
    powers = []
    for overrides in ((), ("receiver.response='single_pole'", "tdc.bandwidth_mhz=60")):
        equipped = trains.sensor("table1-apd", *overrides)
        powers.append(sample_power_and_signal(trains.in_fog(equipped, np.ones(1)), equipped, times_s)[0][0])
    assert equipped.peak_share < 0.9
    np.testing.assert_allclose(powers[1], powers[0], rtol=0.015)


@pytest.mark.parametrize("case", ["apd", "filtered", "levels", "adc"])
def test_a_second_frame_compiles_nothing(case):
    """Other numbers in the sensor, other trains, another seed: the same kernel, with all its loops."""
    equipped, count = trains.sensor(*CASES[case]), SUB_ECHOES.get(case, 7)
    with launches.launched() as before:
        trains.detect_on_device(trains.train(*trains.random_trains(500, count, equipped, seed=1)), equipped)
    changed = trains.sensor(
        *CASES[case], "tdc.bandwidth_mhz=150", "tdc.dead_time_ns=3", "detector.gain=70", "laser.pulse_fwhm_ns=5.9"
    )
    with launches.launched(after=before):
        trains.detect_on_device(trains.train(*trains.random_trains(500, count, changed, seed=2)), changed, seed=5)
