"""Working points: power and signal there and back, and counted cells by SciPy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.false_alarms import false_alarm_probability
from helpers.run_seed import chosen
from scipy.constants import e
from scipy.integrate import quad
from scipy.stats import binom

from lidarscene import catalog, load_sensor
from lidarscene.sensor.detectors import Spad
from lidarscene.studies.ranging import plane


@pytest.mark.parametrize(
    ("overrides", "rtol"),
    [
        (["detector.statistics='steady_state'"], 1e-9),
        (["detector.statistics='published'"], 1e-9),
        (["detector.statistics='time_domain'"], 5e-3),  # a table, there and back
        ([], 1e-12),
    ],
)
def test_a_working_point_finds_the_power_of_its_own_signal(overrides, rtol):
    """Up to two thirds of the free cells. (22) as printed and derived are 3e-4 apart: neither undoes the other."""
    sensor = load_sensor("table1-sipm" if overrides else "table1-apd", overrides=overrides)
    point = sensor.working_point(np.array([2.5e-8]))
    power = np.geomspace(1e-9, 1.5e-7, 25)
    assert not overrides or 0.5 < point.response.signal(power).max() / (point.response.largest[0] + 0.5) < 0.99
    np.testing.assert_allclose(point.response.power_w(point.response.signal(power)), power, rtol=rtol)


def lamps(name):
    """A catalogue sensor and the light on its target: by night, in the brightest sun, and where nothing makes noise."""
    sensor = load_sensor(name)
    yield from ((sensor, plane.Target(illuminance_klux=klux)) for klux in (0.0, 130.0))
    if isinstance(sensor.detector, Spad):
        for pixel in ({}, {"stamps": "first"}, {"spads": 16.0, "coincidence": 16}, {"spads": 4.0, "coincidence": 8}):
            still = replace(sensor.detector, dark_count_rate_hz=0.0, **pixel)
            yield replace(sensor, detector=still), plane.Target(illuminance_klux=0.0)


@pytest.mark.parametrize("name", chosen(12, catalog.names("sensors")))
def test_every_light_has_a_working_point(name):
    """Also SPADs that never count, too few to fire together: what vanishes with the light has a limit, not 0 / 0."""
    for sensor, target in lamps(name):
        light = plane.echoes_of_plane(sensor, target, np.geomspace(0.5, 500.0, 12))
        point = sensor.working_point(light.background_power_w, range_m=light.range_m)
        threshold, signal = sensor.threshold(point), point.response.signal(light.peak_power_w)
        snr = plane.snr(sensor, target, light.range_m)
        assert (snr >= 0.0).all()
        assert np.isfinite(snr).all()
        assert np.isfinite(threshold).all()
        alarm = false_alarm_probability(sensor, target)
        found = point.detection_probability(threshold, signal, point.noise.at(signal))
        for probability in (alarm, false_alarm_probability(sensor, target, sky=True), found):
            assert np.all((probability >= 0.0) & (probability <= 1.0))


def test_counted_cells_by_scipy():
    """The least count that is not below the level: whole numbers themselves trip, and what is above them does not.

    Levels on a grid that meets whole numbers, over backgrounds of a few and of many busy cells.
    """
    sensor = load_sensor("table1-sipm", overrides=["detector.counting='binomial'"])
    for background_w in (1e-10, 2.5e-8):
        point = sensor.working_point(np.array([background_w]))
        busy = float(point.counts.busy[0])
        count = np.repeat(np.arange(math.ceil(busy) + 1, math.ceil(busy) + 12), 4)
        threshold = count - np.tile([0.75, 0.5, 0.25, 0.0], 11) - busy
        alarm = point.false_alarm_probability(threshold)
        np.testing.assert_allclose(alarm, binom.sf(count - 1, 400, busy / 400), rtol=1e-6)
        probability = point.detection_probability(threshold, np.array([20.0]), None)
        np.testing.assert_allclose(probability, binom.sf(count - 1, 400, (busy + 20.0) / 400), rtol=1e-6)


def response(kind, cutoff_hz):
    """h(t) of the low pass, of unit area, and the time by which all of it has come."""
    if kind == "single_pole":
        rate = 2.0 * math.pi * cutoff_hz
        return lambda t: rate * math.exp(-rate * t) if t >= 0.0 else 0.0, 30.0 / rate
    sigma = math.sqrt(math.log(2.0)) / (2.0 * math.pi * cutoff_hz)
    return lambda t: math.exp(-0.5 * (t / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi)), 10.0 * sigma


@pytest.mark.parametrize("cutoff_mhz", [60.0, 200.0])
@pytest.mark.parametrize("kind", ["gaussian", "single_pole"])
def test_shot_noise_of_a_filtered_pulse_by_campbell(kind, cutoff_mhz):
    """Electrons that come at random, each with the response e M h(t): the mean is e M int r h, the variance e^2 M^2 F
    int r h^2 (N. R. Campbell, 1909), at the pulse's filtered peak.

    Behind a single pole the light filtered by h^2 peaks earlier than the pulse: 3.5 % more is taken at most.
    """
    sensor = load_sensor(
        "table1-apd", overrides=[f"receiver.response='{kind}'", f"receiver.bandwidth_mhz={cutoff_mhz}"]
    )
    point, detector, power_w = sensor.working_point(np.array([2.5e-8])), sensor.detector, 1e-6
    impulse, longest_s = response(kind, 1e6 * cutoff_mhz)
    sigma_s = 6e-9 / math.sqrt(8.0 * math.log(2.0))
    per_second = power_w / sensor.laser.photon_energy_j * detector.quantum_efficiency

    def convolve_at(at_s, power):
        low, high = max(at_s - longest_s, -8.0 * sigma_s), min(at_s + longest_s, 8.0 * sigma_s)
        return quad(
            lambda t: math.exp(-0.5 * (t / sigma_s) ** 2) * impulse(at_s - t) ** power,
            low,
            high,
            limit=200,
            points=[min(at_s, high)],
        )[0]

    times = np.linspace(-1.0, 4.0, 201) * sigma_s
    at_s = times[int(np.argmax([convolve_at(instant_s, 1) for instant_s in times]))]
    signal = e * detector.gain * per_second * convolve_at(at_s, 1)
    assert float(point.response.signal(np.array([power_w]))[0]) == pytest.approx(signal, rel=1e-3)
    variance = (e * detector.gain) ** 2 * detector.excess_noise * per_second * convolve_at(at_s, 2)
    kappa_variance = float(point.noise.kappa_1 * signal)
    assert variance * 0.995 < kappa_variance < variance * (1.005 if kind == "gaussian" else 1.036)


@pytest.mark.parametrize("kind", ["gaussian", "single_pole"])
def test_noise_of_filtered_cells_is_theirs_in_one_share(kind):
    """A cell is up from its firing to its revival, with light and without: of the variance of their number the filter
    leaves the same share, at any light. The least level is a cell's own height behind the filter.
    """
    keys = ["tdc.bandwidth_mhz=60", "detector.statistics='steady_state'", "detector.cell_floor=1"]
    bare, filtered = (
        load_sensor("table1-sipm", overrides=[*keys, *more]).working_point(np.array([2.5e-8]))
        for more in ([], [f"receiver.response='{kind}'"])
    )
    shares = []
    for power_w in (0.0, 2e-8, 6e-8, 1.2e-7):
        variances = []
        for point in (bare, filtered):
            signal = float(np.ravel(point.response.signal(np.array([power_w])))[0])
            kappas = (float(np.ravel(kappa)[0]) for kappa in (point.noise.kappa_1, point.noise.kappa_2))
            kappa_1, kappa_2 = kappas
            variances.append(float(point.noise.deviation[0]) ** 2 + kappa_1 * signal + kappa_2 * signal**2)
        shares.append(variances[1] / variances[0])
    assert 0.2 < shares[0] < 0.9
    np.testing.assert_allclose(shares, shares[0], rtol=1e-9)
    cutoff_hz = 60e6 / {"gaussian": 0.5 * math.sqrt(math.pi / math.log(2.0)), "single_pole": 0.5 * math.pi}[kind]
    impulse, longest_s = response(kind, cutoff_hz)
    dead_s = float(load_sensor("table1-sipm").detector.dead_time_s)
    # A symmetric response is highest when its middle is in the middle of the cell's time, a pole's at its end.
    start, end = (-0.5 * dead_s, 0.5 * dead_s) if kind == "gaussian" else (0.0, dead_s)
    height = quad(impulse, max(start, -longest_s), min(end, longest_s))[0]
    assert float(bare.least_threshold) == 1.0
    assert float(filtered.least_threshold) == pytest.approx(height * float(bare.least_threshold), rel=1e-6)


@pytest.mark.parametrize("name", ["table1-sipm", "table1-apd"])
def test_a_filter_takes_levels_of_light_where_light_goes(name):
    """Where the width begins to tell more than the height, and where the height ends, are some power of light: behind
    the filter they are the signal that this power has there. An amplifier clips behind it, at its own level.
    """
    clips = ["detector.saturation_ua=5"] if name == "table1-apd" else []
    bare, filtered = (
        load_sensor(name, overrides=["tdc.bandwidth_mhz=60", *clips, *more]).working_point(np.array([2.5e-8]))
        for more in ([], ["receiver.response='gaussian'"])
    )
    power = np.array([1e-8])
    assert filtered.response.signal(power)[0] < 0.95 * bare.response.signal(power)[0]
    np.testing.assert_allclose(filtered.response.power_w(filtered.response.signal(power)), power, rtol=5e-3)
    if name == "table1-apd":
        assert filtered.response.knee == filtered.response.saturation == bare.response.saturation == pytest.approx(5e-6)
        return
    share = float(filtered.response.signal(power)[0] / bare.response.signal(power)[0])
    for key in ("knee", "largest"):
        np.testing.assert_allclose(getattr(filtered.response, key), share * getattr(bare.response, key), rtol=1e-9)
    # No light is inferred beyond the last half of a cell.
    threshold = {"width_s": None, "threshold": 5.0, "pulse_fwhm_s": 6e-9}
    np.testing.assert_allclose(
        filtered.response.inferred_power_w(np.array([1e9]), **threshold),
        filtered.response.power_w(filtered.response.largest),
    )


def test_nothing_trips_at_the_clipping_level():
    """Neither noise nor an echo passes a threshold where the output never gets."""
    sensor = load_sensor("table1-apd", overrides=["detector.saturation_ua=1"])
    point = sensor.working_point(np.array([2.5e-8]))
    sigma = np.full(2, 1e-7)
    threshold = np.array([1e-6 * (1.0 - 1e-9), 1e-6 * (1.0 + 1e-9)])
    for values in (
        point.detection_probability(threshold, np.full(2, 5e-6), sigma),
        point.false_alarm_probability(0.0 * point.noise.deviation + threshold),
        point.crossing_rate_hz(0.0 * point.noise.deviation + threshold, 1e8),
    ):
        assert values[0] >= 0.0
        assert values[1] == 0.0
    assert point.detection_probability(threshold, np.full(2, 5e-6), sigma)[0] > 0.99


@pytest.mark.parametrize("tail", ["mcintyre", "gaussian"])
def test_alarms_behind_a_matched_filter_are_those_of_as_many_deviations(tail):
    """The filter's noise is smaller; at the same threshold to noise it passes as often as before the filter."""
    sensor = load_sensor("table1-apd", overrides=[f"detector.tail='{tail}'", "tdc.timing='matched_filter'"])
    point = sensor.working_point(np.array([2.5e-8]))
    raw = point.unfiltered
    assert point.noise.deviation[0] < 0.9 * raw.noise.deviation[0]
    for ratio in (3.0, 5.0):
        pairs = [
            (
                working_point.false_alarm_probability(ratio * working_point.noise.deviation)[0],
                working_point.crossing_rate_hz(ratio * working_point.noise.deviation, 1e8)[0],
            )
            for working_point in (point, raw)
        ]
        np.testing.assert_allclose(*pairs, rtol=1e-9)


@pytest.mark.parametrize("more", [["receiver.response='gaussian'"], ["tdc.timing='matched_filter'"]])
def test_cells_behind_a_filter_cross_as_rice_says(more):
    """No whole cells rise and fall there: B' / sqrt(3) exp(-TNR^2 / 2)."""
    sensor = load_sensor("table1-sipm", overrides=["tdc.false_alarms='crossings'", *more])
    point = sensor.working_point(np.array([2.5e-8]))
    rates = sensor.false_alarm_rate_hz(point, np.array([4.0, 5.0]) * point.noise.deviation[0])
    bandwidth_hz = sensor.crossing_bandwidth_hz
    np.testing.assert_allclose(rates, bandwidth_hz / math.sqrt(3.0) * np.exp([-8.0, -12.5]), rtol=1e-9)


def test_all_free_cells_fired_have_no_noise_of_their_own():
    """A binomial number that is certain, on the cells that background and dark counts left, as printed."""
    sensor = load_sensor("table1-sipm", overrides=["detector.statistics='published'"])
    point = sensor.working_point(np.array([2.5e-8]))
    free = float(point.response.largest[0]) + 0.5
    assert free < 350.0
    for share in (0.5, 1.0):
        variance = (
            float(np.ravel(point.noise.kappa_1)[0]) * share * free
            + float(np.ravel(point.noise.kappa_2)[0]) * (share * free) ** 2
        )
        assert variance == pytest.approx(free * share * (1.0 - share), abs=1e-9 * free)
