"""Detection statistics: the formulas by SciPy, and shots through the comparator that `render` uses.

Comparisons of counts are z-tests of 4 standard errors, at fixed seeds.
"""

import dataclasses
import math

import numpy as np
import pytest
from helpers import false_alarms, photons
from helpers.shots import simulated_shots
from scipy.stats import binom, norm

from lidarscene import load_sensor
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics import tdc
from lidarscene.physics.reference import mcintyre as reference_mcintyre
from lidarscene.studies.ranging import plane, statistics
from lidarscene.studies.ranging.plane import Target

APD, SIPM = load_sensor("table1-apd"), load_sensor("table1-sipm")


def apd_with(*overrides):
    return load_sensor("table1-apd", overrides=list(overrides))


def tuned(sensor, ratios):
    """The sensor with thresholds at these TNR."""
    tdc_with = dataclasses.replace(sensor.tdc, threshold_to_noise=np.asarray(ratios), threshold_level=None)
    return dataclasses.replace(sensor, tdc=tdc_with)


@pytest.mark.parametrize("sensor", [APD, SIPM], ids=lambda s: s.name)
def test_detection_over_the_signal(sensor):
    """P_d = Q(5 - SNR) without the echo's own noise; with it the curve is flatter and meets it at SNR 5."""
    point = sensor.working_point(plane.echoes_of_plane(sensor, Target(), 1.0).background_power_w)
    noise, snr = point.noise, np.linspace(0.0, 12.0, 25)
    signal, threshold = snr * noise.deviation, sensor.threshold(point)
    own_noise = np.sqrt(noise.deviation**2 + noise.kappa_1 * signal + noise.kappa_2 * signal**2)
    plain = point.detection_probability(threshold, signal, noise.deviation * np.ones(25))
    np.testing.assert_allclose(plain, norm.sf(5.0 - snr), rtol=1e-8)
    probability = point.detection_probability(threshold, signal, own_noise)
    assert probability[10] == pytest.approx(0.5, rel=1e-9)
    assert (np.diff(probability) > 0.0).all()
    if sensor is APD:  # a SiPM's busy cells are quieter, not noisier, above the middle
        assert (probability[1:10] > plain[1:10]).all()
        assert (probability[11:] < plain[11:]).all()
    limit, _ = plane.maximum_range_m(sensor, Target())
    assert float(plane.detection_probability(sensor, Target(), float(limit))[0]) == pytest.approx(0.5, rel=1e-6)


def test_both_errors_over_the_threshold():
    """Compared with SciPy, threshold by threshold; and both errors grow against each other."""
    ratios = np.linspace(2.0, 8.0, 13)
    sensor = tuned(APD, ratios)
    light = plane.echoes_of_plane(APD, Target(), 340.0)
    point = sensor.working_point(light.background_power_w)
    m = 4e-6 * 167e6
    p_false = norm.sf(ratios)
    alarms_hz = sensor.false_alarm_rate_hz(point, sensor.threshold(point))
    np.testing.assert_allclose(alarms_hz * 4e-6, -m * np.log1p(-p_false), rtol=1e-6)
    signal = plane.snr(APD, Target(), 340.0) * point.noise.deviation
    sigma = np.sqrt(point.noise.deviation**2 + point.noise.kappa_1 * signal)
    p_detect = plane.detection_probability(sensor, Target(), 340.0)
    np.testing.assert_allclose(p_detect, norm.sf((ratios * point.noise.deviation - signal) / sigma), rtol=1e-8)
    quiet = (1.0 - p_false) ** (m - 1.0)
    correct = quiet * p_detect / (1.0 - quiet * (1.0 - p_detect))
    found = tdc.correct_probability(
        p_false=-np.expm1(-alarms_hz / 167e6),
        p_detect=p_detect,
        comparisons=tdc.comparisons(window_s=sensor.tdc.listening_s, bandwidth_hz=167e6),
    )
    np.testing.assert_allclose(found, correct, rtol=1e-6)
    assert (np.diff(p_detect) < 0.0).all()
    assert (np.diff(alarms_hz) < 0.0).all()


def test_false_alarms_of_counted_cells():
    """A SiPM counted exactly: steps, by SciPy's binomial."""
    sensor = tuned(load_sensor("table1-sipm", overrides=["detector.counting='binomial'"]), [3.0, 5.0])
    point = sensor.working_point(plane.echoes_of_plane(sensor, Target(illuminance_klux=1.0), 300.0).background_power_w)
    alarms_hz = sensor.false_alarm_rate_hz(point, sensor.threshold(point))
    busy, noise = float(point.counts.busy[0]), float(point.noise.deviation[0])
    for i, ratio in enumerate((3.0, 5.0)):
        p = binom.sf(math.ceil(ratio * noise + busy) - 1, 400, busy / 400.0)
        expected = -math.log1p(-p) * 4e-6 * 167e6
        assert alarms_hz[i] * 4e-6 == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("tail", ["gaussian", "mcintyre"])
@pytest.mark.parametrize("tnr", [3.2, 3.8])
def test_correct_probability_by_shots(tnr, tail):
    """(10) through `detection.receiver.detect`: P_d 0.5 at the end of the window, P_f with either tail."""
    sensor = apd_with(f"tdc.threshold_to_noise={tnr}", f"detector.tail='{tail}'")
    limit = float(plane.maximum_range_m(sensor, Target())[0])
    # The half of the pulse of 6 ns comes after the peak of an echo at the limit.
    ends = dataclasses.replace(sensor.tdc, window_s=2.0 * limit / SPEED_OF_LIGHT_M_S + 3e-9)
    sensor = dataclasses.replace(sensor, tdc=ends)
    tally = simulated_shots(sensor, Target(), limit, shots=80_000, seed=3)
    p_false = false_alarms.false_alarm_probability(sensor, Target())
    comparisons = float(sensor.tdc.window_s) * 167e6
    expected = tdc.correct_probability(p_false=p_false, p_detect=0.5, comparisons=comparisons)
    returned = tally.echoes + tally.false_alarms
    error = math.sqrt(returned * expected * (1.0 - expected))
    # The echo crosses up to 3 ns before or after its peak: half a comparison more or less.
    slack = 0.6 * p_false * expected * returned
    assert 0.1 < expected < 0.99
    assert abs(tally.echoes - returned * expected) < 4.0 * error + slack
    assert tally.correct_share == pytest.approx(float(expected), abs=0.01)


def test_tails_of_the_avalanche():
    """Gaussian, McIntyre's saddle point and exact sum, Webb's: at Table 1, in sunlight and in the dark."""
    p = {tail: false_alarms.false_alarm_probability(APD, Target(), tail=tail) for tail in false_alarms.TAILS}
    assert p["gaussian"] == pytest.approx(norm.sf(5.0), rel=1e-6)
    assert p["mcintyre"] == pytest.approx(p["exact"], rel=1e-3)
    assert p["exact"] == pytest.approx(1.0812e-5, rel=1e-3)
    assert p["webb"] == pytest.approx(p["exact"], rel=0.25)
    assert false_alarms.false_alarm_probability(APD, Target()) == p["gaussian"]
    assert false_alarms.false_alarm_probability(apd_with("detector.tail='mcintyre'"), Target()) == p["mcintyre"]
    dark = [false_alarms.false_alarm_probability(APD, Target(), sky=True, tail=t) for t in ("mcintyre", "exact")]
    assert dark[0] == pytest.approx(dark[1], rel=0.15)
    with pytest.raises(ValueError, match="for an APD"):
        false_alarms.false_alarm_probability(SIPM, Target(), tail="exact")
    with pytest.raises(ValueError, match="no avalanche"):
        false_alarms.electrons(SIPM, 1e-9)


def test_electrons_hold_the_variance_of_18():
    """Electrons in 1 / (2 B): their variance is that of (18), to rounding."""
    background = float(plane.echoes_of_plane(APD, Target(), 100.0).background_power_w[0])
    numbers = false_alarms.electrons(APD, background)
    variance = numbers["primaries"] * numbers["gain"] ** 2 * numbers["excess_noise"] + numbers["amplifier"] ** 2
    noise = float(APD.working_point(np.array([background])).noise.deviation[0])
    assert math.sqrt(variance) == pytest.approx(noise * numbers["per_ampere"], rel=1e-12)
    assert numbers["primaries"] == pytest.approx(241.5, abs=0.1)
    assert numbers["amplifier"] == pytest.approx(311.0, abs=1.0)


@pytest.mark.parametrize("tail", ["gaussian", "mcintyre"])
def test_array_conditions(tail):
    """A working point takes arrays of backgrounds, and each is its own."""
    sensor = apd_with(f"detector.tail='{tail}'")
    powers = np.array([0.0, 1e-10, 2.5e-8, 1e-6])
    point = sensor.working_point(powers)
    together = point.false_alarm_probability(sensor.threshold(point))
    for power, p in zip(powers, together, strict=True):
        single_point = sensor.working_point(np.array([power]))
        assert single_point.false_alarm_probability(sensor.threshold(single_point))[0] == p


@pytest.mark.parametrize("stops", [1, 3])
@pytest.mark.parametrize(
    ("range_m", "blanking_ns"),
    [(None, 0), (150.0, 0), (340.0, 0), (700.0, 0), (None, 800), (150.0, 800), (150.0, 1200)],
)
def test_false_points_per_frame(range_m, blanking_ns, stops):
    """Expected alarms among the points against counted ones: the sky, near, at the limit, beyond the window; with the
    end of the blanking before and after the echo of 150 m, which comes after 1000 ns.
    """
    sensor = apd_with("tdc.threshold_to_noise=3.3", f"tdc.stops={stops}", f"tdc.blanking_ns={blanking_ns}")
    shots = 50_000
    tally = simulated_shots(sensor, Target(), range_m, shots=shots, seed=5)
    expected = statistics.false_points(sensor, Target(), range_m)
    # Alarms are Poisson or fewer; the echo's edge comes up to 3 ns before its range.
    slack = 0.6 * shots * false_alarms.false_alarm_probability(sensor, Target())
    mean = expected.per_pulse * shots
    assert abs(tally.false_alarms - mean) < 4.0 * math.sqrt(mean) + slack
    assert expected.per_frame == expected.per_pulse * sensor.scanner.pulses


def test_false_points_at_table_1():
    """One frame of the catalogue's raster: some 14 false points where it sees nothing."""
    frame = statistics.false_points(APD, Target())
    m = 4e-6 * 167e6
    assert frame.per_pulse == pytest.approx(-math.expm1(m * math.log1p(-norm.sf(5.0))), rel=1e-9)
    assert frame.per_frame == pytest.approx(14.5, abs=0.1)


def test_no_alarms_without_noise():
    dark = dataclasses.replace(APD.detector, surface_dark_current_a=0.0, bulk_dark_current_a=0.0, temperature_k=0.0)
    silent = dataclasses.replace(APD, detector=dark)
    assert statistics.false_points(silent, Target()).per_frame == 0.0


def test_thresholds_that_scatter_trip_oftener():
    """False alarms fall like a Gaussian with the threshold: their mean over thresholds that scatter by a tenth, by
    Gauss and Hermite's sum, is that of 200 places to a few per cent.
    """
    sharp = photons.sensor()
    assert sharp.histogram is not None
    loose = dataclasses.replace(sharp, histogram=dataclasses.replace(sharp.histogram, threshold_spread=0.1))
    target = Target(illuminance_klux=20.0)
    point = sharp.working_point(plane.echoes_of_plane(sharp, target, 1.0).background_power_w)
    level = float(np.ravel(sharp.threshold(point))[0]) + 12.0
    place, weight = np.polynomial.hermite_e.hermegauss(80)
    rates = [float(np.ravel(sharp.false_alarm_rate_hz(point, np.array([level * math.exp(0.1 * x)])))[0]) for x in place]
    mean = float(np.dot(weight, rates) / weight.sum())
    rate_at_level = float(np.ravel(sharp.false_alarm_rate_hz(point, np.array([level])))[0])
    assert mean > 1.1 * rate_at_level
    assert float(np.ravel(statistics._alarms_hz(loose, point, np.array([level])))[0]) == pytest.approx(mean, rel=0.03)


def test_false_points_of_an_echo_that_is_found_half_of_the_time():
    """One stop: alarms before the echo where it is found, in all of the window where it is not; at the limit P_d is
    one half.
    """
    noisy = apd_with("tdc.threshold_to_noise=3.3")
    limit_m, _ = plane.maximum_range_m(noisy, Target())
    rate_hz = statistics.false_points(noisy, Target(), 1e5).per_pulse
    rate_hz = -math.log1p(-rate_hz) / noisy.tdc.window_s  # of a pulse without an echo
    before = -math.expm1(-rate_hz * 2.0 * limit_m / 299_792_458.0)
    without = -math.expm1(-rate_hz * noisy.tdc.window_s)
    assert without > 1.2 * before
    half = statistics.false_points(noisy, Target(), limit_m).per_pulse
    assert half == pytest.approx(0.5 * (before + without), rel=1e-6)


def test_webbs_tail_is_blurred_by_the_amplifier():
    """Mean of the electrons' tail over the amplifier's noise, by Gauss and Hermite's sum."""
    law = {"primaries": 200.0, "gain": 50.0, "excess_noise": 3.0}
    place, weight = np.polynomial.hermite_e.hermegauss(100)
    tails = reference_mcintyre.webb_tail(excess=8000.0 - 1500.0 * place, **law)
    mean = float(np.dot(weight, tails) / weight.sum())
    blurred = false_alarms.webb_with_amplifier(8000.0, ionisation_ratio=0.02, amplifier=1500.0, **law)
    assert blurred == pytest.approx(mean, rel=1e-6)
    assert blurred > 1.2 * float(reference_mcintyre.webb_tail(excess=8000.0, **law))
