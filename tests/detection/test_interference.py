"""Other lidars: counts and peaks of their false points against Poisson and log-normal statistics drawn by numpy."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import chain, photons, trains
from helpers.mistakes import told
from helpers.scene_text import scene_of
from helpers.trains import detect
from scipy.constants import c, h
from scipy.stats import ks_2samp, kstest, norm, spearmanr

from lidarscene.detection.outcomes import Outcome, Status
from lidarscene.light.echoes import Interference
from lidarscene.physics.electronics import crosstalk
from lidarscene.rendering.stages import ambient_of
from lidarscene.scene.scene import Interferer
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import Target

SHOTS = 60_000
SIGMAS = 4.0  # two-sided 6e-5 for each count
MEDIAN_W, SPREAD_DB = 4e-8, 6.0


def light_among_lidars(sensor, *sources, range_m=None):
    """Light of shots at nothing, or at a wall, with these lidars about."""
    light = plane.echoes_of_plane(sensor, Target(), np.full(SHOTS, range_m or 100.0))
    if range_m is None:
        light = replace(light, has_surface=np.zeros(SHOTS, bool), peak_power_w=np.zeros(SHOTS))
    return replace(light, interference=sources)


def detect_shots(sensor, light, seed=5):
    return detect(light, sensor, seed=seed)


def lidar(rate_hz, median_w=MEDIAN_W):
    return Interference(rate_hz=rate_hz, peak_power_w=median_w, spread_db=SPREAD_DB)


def count_stops(detection, status):
    return sum(int(np.sum(stop.reported & (stop.status == status))) for stop in detection.stops)


def needed_w(sensor, light):
    point = sensor.working_point(light.background_power_w)
    return float(point.response.power_w(sensor.threshold(point))[0])


@pytest.mark.parametrize("name", ["table1-apd", "table1-sipm"])
def test_false_points_of_one_stop(name):
    """Reference: 1 - exp(-nu q T), with q counted among numpy's own log-normal peaks. Noise has 2e-4 alarms a shot
    or fewer, within the tolerance.
    """
    sensor = chain.sensor(name)
    light = light_among_lidars(sensor, lidar(1e5))
    peaks = MEDIAN_W * 10.0 ** (0.1 * SPREAD_DB * np.random.default_rng(2).normal(size=10**6))
    q = np.mean(peaks >= needed_w(sensor, light))
    assert 0.2 < q < 0.8
    expected = 1.0 - np.exp(-1e5 * q * sensor.tdc.window_s)
    share = count_stops(detect_shots(sensor, light), Status.INTERFERENCE) / SHOTS
    assert abs(share - expected) < SIGMAS * np.sqrt(expected / SHOTS) + 5e-4


@pytest.mark.parametrize(("floor", "keep"), [(10.0, "first"), (10.0, "strongest"), (17.0, "first")])
def test_a_pulse_arrives_in_one_of_the_shots_that_are_summed(floor, keep):
    """Reference: 20 windows of 16 SPADs each; numpy's own log-normal peaks fire 16 (1 - exp(-Lambda)) of them, Lambda
    detectable photons each, and do so in one window. Of 17 counts none are capable. In the dark.
    """
    sensor = photons.sensor(
        "histogram.shots=20 detector.spads=16 detector.dark_count_rate_hz=0 histogram.threshold_slope=0",
        f"histogram.threshold_floor={floor} histogram.keep='{keep}'",
    )
    light = light_among_lidars(sensor, lidar(2e4))
    light = replace(light, background_power_w=np.zeros(SHOTS))
    peaks_w = MEDIAN_W * 10.0 ** (0.1 * SPREAD_DB * np.random.default_rng(2).normal(size=10**6))
    energy_j = peaks_w * 4e-9 * np.sqrt(np.pi / (4.0 * np.log(2.0)))
    fired = -np.expm1(-energy_j / (h * c / 905e-9) * 0.2 / 16)
    q = np.mean(16 * fired >= floor)
    stop = detect_shots(sensor, light).stops[0]
    theirs = stop.reported & (stop.status == Status.INTERFERENCE)
    expected = -np.expm1(-20 * 2e4 * q * sensor.tdc.window_s)
    assert abs(theirs.mean() - expected) <= SIGMAS * np.sqrt(expected / SHOTS)
    assert (stop.amplitude[theirs] < 16.01).all()


def test_peaks_are_the_tail_of_theirs():
    """Reference: numpy's peaks beyond the threshold, by Kolmogorov and Smirnov; one in 10 000 fails."""
    sensor = chain.sensor("table1-apd")
    light = light_among_lidars(sensor, lidar(1e5))
    stop = detect_shots(sensor, light).stops[0]
    amplitude = stop.amplitude[stop.reported & (stop.status == Status.INTERFERENCE)]
    peaks = MEDIAN_W * 10.0 ** (0.1 * SPREAD_DB * np.random.default_rng(3).normal(size=200_000))
    point = sensor.working_point(np.zeros(1) + light.background_power_w[0])
    tail = point.response.signal(peaks[peaks >= needed_w(sensor, light)])
    assert ks_2samp(amplitude, tail).pvalue > 1e-4
    ranges = stop.range_m[stop.reported & (stop.status == Status.INTERFERENCE)]
    assert ranges.max() < 600.0  # the window
    first_half = np.mean(ranges < 300.0)
    assert first_half == pytest.approx(0.5, abs=0.05)  # 0.1 arrivals a window: nearly even


def test_rates_add_up():
    """Three lidars of one kind are one at their sum, and noise keeps its own: 3 stops, three kinds counted."""
    sensor = chain.sensor("table1-apd", "tdc.stops=3", "tdc.threshold_to_noise=3.5")
    three = detect_shots(sensor, light_among_lidars(sensor, lidar(1e4), lidar(2e4), lidar(3e4)))
    one_lidar = detect_shots(sensor, light_among_lidars(sensor, lidar(6e4)), seed=6)
    none = detect_shots(sensor, light_among_lidars(sensor), seed=7)
    a, b = count_stops(three, Status.INTERFERENCE), count_stops(one_lidar, Status.INTERFERENCE)
    assert abs(a - b) < SIGMAS * np.sqrt(a + b)
    noise, alone = count_stops(three, Status.FALSE_ALARM), count_stops(none, Status.FALSE_ALARM)
    assert abs(noise - alone) < SIGMAS * np.sqrt(noise + alone)
    assert min(a, noise) > 3000


def test_of_two_lidars_each_has_its_share():
    """A strong one in three pulses: so many points are too strong for the weak one."""
    sensor = chain.sensor("table1-apd")
    detection = detect_shots(sensor, light_among_lidars(sensor, lidar(2e5, 1e-6), lidar(1e5, 1e-2)))
    stop = detection.stops[0]
    theirs = stop.reported & (stop.status == Status.INTERFERENCE)
    point = sensor.working_point(np.array([0.0]))
    strong = stop.amplitude[theirs] > point.response.signal(np.array([1e-4]))[0]
    assert abs(strong.mean() - 1.0 / 3.0) < SIGMAS * np.sqrt(2.0 / 9.0 / theirs.sum())


def test_the_strongest_of_two_lidars_come_by_themselves():
    """A converter that keeps the strongest: with mu = nu q T of each, exp(-2 mu) of the shots are quiet, and
    (1 - exp(-mu))^2 have pulses of both, told apart by a median that is 40 dB stronger.
    """
    sensor = chain.sensor("table1-apd", "tdc.keep='strongest'", "tdc.stops=2", "tdc.threshold_to_noise=8")
    shots, rate_hz = 20_000, 2e5
    light = trains.train(np.full((shots, 1), 20.0), 0.0, background_w=0.0)
    light = replace(light, interference=(lidar(rate_hz, 1e-6), lidar(rate_hz, 1e-2)))
    stops = trains.detect(light, sensor, seed=5).stops
    strong_a = float(sensor.working_point(np.zeros(1)).response.signal(np.array([1e-4]))[0])
    interfered = [stop.reported & (stop.status == Status.INTERFERENCE) for stop in stops]
    none = 1.0 - np.exp(-rate_hz * sensor.tdc.window_s)
    for mask, expected in (
        (~interfered[0], (1.0 - none) ** 2),
        # Of two that are kept the strongest comes from the strong lidar if there is one.
        (np.any([s & (stop.amplitude > strong_a) for s, stop in zip(interfered, stops, strict=True)], axis=0), none),
    ):
        assert abs(mask.mean() - expected) < SIGMAS * np.sqrt(expected * (1.0 - expected) / shots)


@pytest.mark.parametrize("keep", ["first", "last"])
def test_height_and_time_of_noise_alarms(keep):
    """The excess over U is exponential with the mean sigma^2 / U, and knows nothing of the time: Kolmogorov and
    Smirnov, and Spearman's ranks, at 1e-4 each.
    """
    sensor = chain.sensor("table1-apd", "tdc.threshold_to_noise=3.3", f"tdc.keep='{keep}'")
    shots = 40_000
    light = trains.train(np.full((shots, 1), 20.0), 0.0)
    stop = trains.detect(light, sensor, seed=5).stops[0]
    reported = stop.reported
    assert 0.2 < reported.mean() < 0.9
    point = sensor.working_point(light.background_power_w[:1])
    level = sensor.threshold(point)[0]
    excess = (stop.amplitude[reported] - level) * level / point.noise.deviation[0] ** 2
    assert kstest(excess, "expon").pvalue > 1e-4
    assert spearmanr(excess, stop.range_m[reported]).pvalue > 1e-4


def test_width_of_another_lidars_pulse():
    """The width is that of one of ours of that height: 2 sigma_p sqrt(2 ln(A / U)), to rounding."""
    sensor = chain.sensor("table1-apd", "tdc.edges='both'")
    light = light_among_lidars(sensor, lidar(1e6))
    stop = detect_shots(sensor, light).stops[0]
    theirs = stop.reported & (stop.status == Status.INTERFERENCE)
    point = sensor.working_point(light.background_power_w[:1])
    ratio = stop.amplitude[theirs] / sensor.threshold(point)[0]
    assert theirs.sum() > 1000
    np.testing.assert_allclose(
        stop.width_s[theirs], 2.0 * trains.SIGMA_S * np.sqrt(2.0 * np.log(ratio)), rtol=1e-9, atol=1e-15
    )


def test_an_early_pulse_hides_the_echo():
    """One stop: a wall at 300 m is seen unless theirs came within 2 us, probability exp(-nu q t)."""
    sensor = chain.sensor("table1-apd")
    light = light_among_lidars(sensor, lidar(2e5, 1e-5), range_m=150.0)
    detection = detect_shots(sensor, light)
    kept_share = np.mean(detection.outcome == Outcome.KEPT)
    assert kept_share == pytest.approx(np.exp(-2e5 * 1e-6), abs=SIGMAS * 0.4 / np.sqrt(SHOTS) + 1e-3)
    assert np.mean(detection.outcome == Outcome.HIDDEN) > 0.1


def test_without_lidars_the_bits_stay():
    """One that is too weak to trip leaves every number of a frame as it is without."""
    sensor = chain.sensor("table1-apd", "tdc.stops=2", "tdc.threshold_to_noise=3.5")
    weak, none = (detect_shots(sensor, light_among_lidars(sensor, *lidars)) for lidars in ([lidar(1e5, 1e-20)], []))
    for a, b in zip(weak.stops, none.stops, strict=True):
        for name in ("reported", "status", "range_m", "amplitude"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_tail_formulas():
    """Q of the decibels, and its inverse at the ends of the draw."""
    q = crosstalk.tripping_probability(needed_power_w=np.array([1e-8, 1e-7]), median_power_w=1e-8, spread_db=5.0)
    np.testing.assert_allclose(q, norm.sf([0.0, 2.0]), rtol=1e-8)
    least = crosstalk.tripping_power_w(uniform=np.array([1.0]), probability=q[1], median_power_w=1e-8, spread_db=5.0)
    assert least[0] == pytest.approx(1e-7, rel=1e-6)


def test_in_a_scene(mi):
    """Irradiance times aperture times efficiency is the power, on the device; the status comes through."""
    sensor = chain.sensor("table1-apd", *chain.NARROW)
    described = replace(
        chain.scene(chain.ball(at=(-50.0, 0.0, 0.0))), interferers=(Interferer(rate_hz=1e7, irradiance_w_m2=1e-2),)
    )
    lanes = chain.run_stages(described, sensor)
    power = 1e-2 * sensor.optics.aperture_m2 * sensor.optics.efficiency_laser
    assert lanes.light.interference[0].peak_power_w == pytest.approx(power, rel=1e-6)
    assert (lanes.detection.stops[0].status == Status.INTERFERENCE).all()


SCENE = """
[[bodies]]
name = "plate"
primitive = "plane"
size_m = [4, 4]
material = "asphalt"
"""


def test_scene_file(tmp_path):
    text = '[[interference]]\nkind = "lamps"\nirradiance_w_m2 = 0.5\n' * 2
    text += '[[interference]]\nkind = "lidar"\nrate_hz = 1e4\nirradiance_w_m2 = 1e-3\n'
    scene = scene_of(tmp_path, SCENE + text)
    assert scene.lamps_w_m2 == 1.0
    assert scene.interferers == (Interferer(rate_hz=1e4, irradiance_w_m2=1e-3, spread_db=6.0),)
    assert ambient_of(scene, chain.sensor("table1-apd")).lamps_w_m2 == 1.0
    with told("interference"):
        scene_of(tmp_path, SCENE + text.replace("lidar", "radar"))


def test_of_three_lidars_the_last_has_its_share_and_its_peaks():
    """The strongest is the last: its share of the points is that of its pulses, and their peaks are its own, by
    Kolmogorov and Smirnov at 1e-6; none is higher than where the amplifier clips.
    """
    sensor = chain.sensor("table1-apd", "detector.saturation_ua=30", "tdc.edges='rising'")
    sources = lidar(1e5, 1e-6), lidar(5e4, 1e-6), lidar(5e4, 2e-3)
    stop = detect_shots(sensor, light_among_lidars(sensor, *sources)).stops[0]
    theirs = stop.reported & (stop.status == Status.INTERFERENCE)
    amplitude = stop.amplitude[theirs]
    assert amplitude.max() == pytest.approx(30e-6, rel=1e-12)
    unclipped = chain.sensor("table1-apd")
    stop = detect_shots(unclipped, light_among_lidars(unclipped, *sources)).stops[0]
    theirs = stop.reported & (stop.status == Status.INTERFERENCE)
    point = unclipped.working_point(np.array([0.0]))
    power = point.response.power_w(stop.amplitude[theirs])
    strong = power > 4.5e-5  # 16 dB from either median, 2.7 deviations
    expected = 0.25 * norm.sf(-16.5 / SPREAD_DB) + 0.75 * norm.sf(16.5 / SPREAD_DB)
    deviation = np.sqrt(expected * (1.0 - expected) / theirs.sum())
    assert abs(strong.mean() - expected) < norm.isf(0.5e-6) * deviation
    levels = 10.0 * np.log10(power[power > 2e-3] / 2e-3) / SPREAD_DB
    assert kstest(2.0 * norm.sf(levels), "uniform").pvalue > 1e-6


def test_each_lidars_pulses_are_drawn_apart():
    """Two lidars and a converter that keeps the strongest four: no two of its points are at one time."""
    sensor = chain.sensor("table1-apd", "tdc.keep='strongest'", "tdc.stops=4", "tdc.threshold_to_noise=8")
    light = trains.train(np.full((2000, 1), 20.0), 0.0, background_w=0.0)
    light = replace(light, interference=(lidar(1e6, 1e-5), lidar(1e6, 1e-5)))
    stops = trains.detect(light, sensor, seed=5).stops
    assert all(stop.reported.mean() > 0.8 for stop in stops)
    ranges = np.sort(np.stack([np.where(stop.reported, stop.range_m, np.nan) for stop in stops]), axis=0)
    # 2000 pulses have 12,000 pairs within 600 m: one of 1e-9 m has a probability of 1e-8 or so.
    assert np.nanmin(np.diff(ranges, axis=0)) > 1e-9
