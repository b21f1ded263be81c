"""Several sub-echoes to a pulse: against the lone echo's closed form, and two Gaussians by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import trains
from helpers.premises import premise
from helpers.run_seed import chosen
from helpers.trains import FWHM_S, SIGMA_M, SIGMA_S, detect, power_at_snr, sensor, train
from scipy.optimize import brentq
from scipy.stats import binomtest, ks_2samp, norm

from lidarscene.detection.outcomes import Outcome, Status
from lidarscene.light.echoes import Echoes, Volume, hump_of
from lidarscene.light.footprint import points
from lidarscene.light.waveform import sample_power_and_signal, waveform
from lidarscene.maths.arrays import LookupTable
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics import pulse_sums, tdc
from lidarscene.physics.optics import pulse as pulse_shape

HALF_C = 0.5 * SPEED_OF_LIGHT_M_S
PICOSECOND_M = HALF_C * 1e-12
FWHM_M = HALF_C * FWHM_S

SENSORS = {
    "apd": ("table1-apd", "tdc.threshold_to_noise=3.5"),
    "sipm": ("table1-sipm", "tdc.threshold_to_noise=3.5"),
    "counted cells": ("table1-sipm", "tdc.threshold_to_noise=3.5", "detector.counting='binomial'"),
    "in time": ("table1-sipm", "tdc.threshold_to_noise=3.5", "detector.statistics='time_domain'"),
    "filtered": ("table1-apd", "tdc.threshold_to_noise=3.5", "receiver.response='gaussian'", "tdc.edges='both'"),
    "filtered cells": ("table1-sipm", "tdc.threshold_to_noise=3.5", "receiver.response='single_pole'"),
    "raw": ("table1-apd", "tdc.threshold_to_noise=3.5", "tdc.walk='raw'", "tdc.stops=3", "tdc.jitter_ps=40"),
    "no walk": ("table1-apd", "tdc.threshold_to_noise=3.5", "tdc.walk='none'", "tdc.lsb_ps=100"),
    "clipped": ("table1-apd", "tdc.threshold_to_noise=3.5", "detector.saturation_ua=50", "detector.recovery_ns=5"),
    **{
        rule: ("table1-apd", "tdc.threshold_to_noise=3.5", "tdc.edges='both'", f"tdc.timing='{rule}'")
        for rule in ("leading_edge", "constant_fraction", "peak", "matched_filter")
    },
}

# A comparator at half an ampere whose noise is 2e-4 of that: times and places without noise.
LOUD = ["tdc.threshold_to_noise=1", "tdc.walk='raw'", "tdc.stops=4"]


def test_the_highest_pulse_is_that_behind_the_matched_filter():
    """A longer echo of less power is higher there: SNR and P_d of the pulse are its own; without the filter, not."""
    for timing, at in (("matched_filter", 1), ("constant_fraction", 0)):
        equipped = sensor("table1-apd", f"tdc.timing='{timing}'")
        power = power_at_snr(equipped, 4.3)
        near, far = ([50.0], [power]), ([60.0, 60.0 + 1.9 * SIGMA_M], [0.72 * power] * 2)
        alone = [detect(train(np.array([range_m]), np.array([power_w])), equipped) for range_m, power_w in (near, far)]
        both = detect(train(np.array([near[0] + far[0]]), np.array([near[1] + far[1]])), equipped)
        assert alone[0].snr[0] != pytest.approx(alone[1].snr[0], rel=0.05)
        for name in ("snr", "detection_probability"):
            assert getattr(both, name)[0] == pytest.approx(getattr(alone[at], name)[0], rel=1e-5)


@pytest.mark.parametrize("sub_echoes", [1, 3, 16])
@pytest.mark.parametrize("name", chosen(6, list(SENSORS)))
def test_sub_echoes_at_one_range_are_one_echo(name, sub_echoes):
    """The lone echo's closed form, pulse by pulse, with false alarms; 1 ps and 1e-5 are asked, and rounding is left: of
    differences between places of 10^4 sigmas, 1e-10.
    """
    equipped = sensor(*SENSORS[name])
    random = np.random.default_rng(3)
    count = 4000
    range_m = random.uniform(2.0, 500.0, count)
    power = np.minimum(power_at_snr(equipped, 60.0) * random.uniform(0.3, 3.0, count) * (100.0 / range_m) ** 2, 1e-3)
    power[::17] = 0.0
    weight = random.dirichlet(np.ones(sub_echoes), count)
    light = train(range_m[:, None], power[:, None] * weight)
    lone = Echoes(
        has_surface=power > 0.0, range_m=range_m, peak_power_w=power, background_power_w=light.background_power_w
    )
    expected = detect(lone, equipped, seed=0)
    detection = detect(light, equipped)
    np.testing.assert_array_equal(detection.outcome, expected.outcome)
    np.testing.assert_allclose(detection.snr, expected.snr, rtol=1e-9)
    np.testing.assert_allclose(detection.detection_probability, expected.detection_probability, atol=1e-9)
    for stop, expected_stop in zip(detection.stops, expected.stops, strict=True):
        np.testing.assert_array_equal(stop.reported, expected_stop.reported)
        reported = expected_stop.reported
        np.testing.assert_array_equal(stop.status[reported], expected_stop.status[reported])
        np.testing.assert_allclose(
            stop.range_m[reported], expected_stop.range_m[reported], rtol=0.0, atol=1e-4 * PICOSECOND_M
        )
        np.testing.assert_allclose(stop.amplitude[reported], expected_stop.amplitude[reported], rtol=1e-9)
        if equipped.tdc.both_edges:
            np.testing.assert_allclose(stop.width_s[reported], expected_stop.width_s[reported], rtol=1e-9, atol=2e-15)
        echo = reported & (expected_stop.status == 0)
        np.testing.assert_allclose(stop.snr[echo], expected.snr[echo], rtol=1e-9)
        np.testing.assert_allclose(stop.true_range_m[echo], range_m[echo], rtol=1e-12)
        assert ((stop.source[echo] >= 0) & (stop.source[echo] < sub_echoes)).all()


def two_boards(separation, *, weights=(0.5, 0.5)):
    """Half a spot on each of two boards, at SNR 1000 and thresholds in shares of one full echo's peak."""
    equipped = sensor("table1-apd", *LOUD)
    peak = power_at_snr(equipped, 1e7)
    light = train(np.array([[100.0, 100.0 + separation * SIGMA_M]]), peak * np.array([weights]))
    point = equipped.working_point(light.background_power_w)
    return (
        equipped,
        light,
        float(point.response.signal(peak)[0] if np.ndim(point.response.signal(peak)) else point.response.signal(peak)),
    )


def at_level(equipped, share, full):
    """A fixed threshold at this share of a full echo's peak."""
    return replace(equipped, tdc=replace(equipped.tdc, threshold_to_noise=None, threshold_level=share * full))


@pytest.mark.parametrize("separation", [0.5, 1.9, 2.5, 3.0, 3.5, 5.0])
@pytest.mark.parametrize("share", [0.05, 0.2, 0.35, 0.45, 0.499])
def test_two_boards_merge_or_separate(separation, share):
    """Two equal Gaussians have a dip only beyond 2 sigma, of 2 exp(-d^2 / 8) / 2 of a full echo's peak in the middle.

    Noise is 1e-4 of the level here; no case lies within 1 % of its limit. Tolerance of a crossing: five deviations
    of that noise over the slope at the level.
    """
    equipped, light, full = two_boards(separation)
    dip = math.exp(-(separation**2) / 8.0)
    assert abs(dip / share - 1.0) > 0.01
    apart = separation > 2.0 and dip < share

    def waveform_at(place):
        return 0.5 * (np.exp(-0.5 * place**2) + np.exp(-0.5 * (place - separation) ** 2)) - share

    highest = waveform_at(np.linspace(-1.0, separation + 1.0, 20_001)).max()
    detection = detect(light, at_level(equipped, share, full))
    assert sum(int(stop.reported[0]) for stop in detection.stops) == (0 if highest < 0.0 else 1 + apart)
    if highest < 0.0:
        return
    middle = 0.5 * separation
    edges = [brentq(waveform_at, -8.0, 0.0 if separation > 2.0 else middle)]
    if apart:
        edges.append(brentq(waveform_at, middle, separation))
    for edge, stop, source in zip(edges, detection.stops, (0, 1), strict=False):
        slope = (waveform_at(edge + 1e-6) - waveform_at(edge - 1e-6)) / 2e-6
        tolerance = 5.0 * 1e-3 * share / slope
        assert (stop.range_m[0] - 100.0) / SIGMA_M == pytest.approx(edge, abs=tolerance)
        if apart:
            assert stop.source[0] == source


def test_energy_is_conserved():
    """The waveform's integral is the sum of the pulses' energies, wherever they are (a sum over steps of sigma / 5
    of Gaussians is exact to rounding).
    """
    equipped = sensor("table1-apd")
    range_m, power = trains.random_trains(50, 9, equipped, seed=1)
    time_s = np.arange(-10.0 * SIGMA_S, 2.0 * 120.0 / SPEED_OF_LIGHT_M_S, SIGMA_S / 5.0)
    watts, signal = sample_power_and_signal(train(range_m, power), equipped, time_s)
    energy = watts.sum(axis=1) * SIGMA_S / 5.0
    alone = pulse_shape.pulse_energy_j(peak_power_w=power, fwhm_s=FWHM_S).sum(axis=1)
    np.testing.assert_allclose(energy, alone, rtol=1e-12)
    point = equipped.working_point(np.full(50, trains.BACKGROUND_W))
    np.testing.assert_allclose(signal, point.response.signal(watts), rtol=1e-14)


@pytest.mark.parametrize("rays", [19, 64, 256])
@pytest.mark.parametrize("tilt_deg", [0.0, 45.0, 75.0])
def test_a_tilted_board_widens_the_echo(tilt_deg, rays):
    """sigma^2 = sigma_p^2 + (w tan(theta) / c)^2: the second moment with any number of rays, since theirs is exact;
    the width at half maximum, as many rays resolve the Gaussian, to what an edge split by them is off (test_footprint).
    """
    radius, tangent = 0.3, math.tan(math.radians(tilt_deg))
    across = points("gaussian", rays)[:, 0] * radius
    equipped = sensor("table1-apd")
    time_s = 2.0 * 100.0 / SPEED_OF_LIGHT_M_S + np.arange(-60.0, 60.0, 0.02) * SIGMA_S
    watts = sample_power_and_signal(
        train((100.0 + across * tangent)[None], np.full((1, rays), 1e-6 / rays)), equipped, time_s
    )[0][0]
    mean = (watts * time_s).sum() / watts.sum()
    variance = (watts * (time_s - mean) ** 2).sum() / watts.sum()
    # Across the beam the power has the deviation w / 2, so times have w tangent / c; variances add.
    fwhm_s = math.hypot(FWHM_S, pulse_sums.SIGMAS_PER_FWHM * radius * tangent / SPEED_OF_LIGHT_M_S)
    assert math.sqrt(variance) * pulse_sums.SIGMAS_PER_FWHM == pytest.approx(fwhm_s, rel=1e-9)
    above_half_s = time_s[watts >= 0.5 * watts.max()]
    assert np.ptp(above_half_s) == pytest.approx(fwhm_s, rel=0.1 if rays < 64 else 0.03)


@pytest.mark.parametrize("snr", [(5.2, 4.6), (8.0, 5.5)])
def test_each_return_has_its_own_probability(snr):
    """Two echoes far apart trip with their own P_d, independently: binomial tests at 1e-4 each."""
    equipped = sensor("table1-apd", "tdc.stops=2")
    count = 30_000
    power = [power_at_snr(equipped, echo_snr) for echo_snr in snr]
    detection = detect(train(np.full((count, 2), (100.0, 140.0)), np.full((count, 2), power)), equipped, seed=2)
    tripped = []
    for echo, range_m in enumerate((100.0, 140.0)):
        near_board = [s.reported & (s.status == 0) & (np.abs(s.range_m - range_m) < 10.0) for s in detection.stops]
        tripped.append(near_board[0] | near_board[1])
        probability = {
            float(p) for s, mask in zip(detection.stops, near_board, strict=True) for p in s.detection_probability[mask]
        }
        assert max(probability) - min(probability) < 1e-12
        assert binomtest(int(tripped[echo].sum()), count, max(probability)).pvalue > 1e-4
    both_count = int((tripped[0] & tripped[1]).sum())
    assert binomtest(both_count, count, tripped[0].mean() * tripped[1].mean()).pvalue > 1e-4


def three_echoes(*overrides):
    """Strong, stronger, weak at 100, 110 and 130 m, all of them far above the threshold; 40 m is 267 ns."""
    equipped = sensor("table1-apd", *trains.QUIET, *overrides)
    power = [power_at_snr(equipped, echo_snr) for echo_snr in (2000.0, 4000.0, 500.0)]
    detection = detect(train(np.full((50, 3), (100.0, 110.0, 130.0)), np.full((50, 3), power)), equipped)
    return [np.where(stop.reported, np.rint(stop.true_range_m), 0.0) for stop in detection.stops], detection


@pytest.mark.parametrize(
    ("overrides", "ranges"),
    [
        (["tdc.stops=1"], [100.0]),
        (["tdc.stops=2"], [100.0, 110.0]),
        (["tdc.stops=4"], [100.0, 110.0, 130.0, 0.0]),
        (["tdc.keep='all'"], [100.0, 110.0, 130.0] + [0.0] * 13),
        (["tdc.keep='last'"], [130.0]),
        (["tdc.keep='last'", "tdc.stops=2"], [110.0, 130.0]),
        (["tdc.keep='last'", "tdc.stops=4"], [100.0, 110.0, 130.0, 0.0]),
        (["tdc.keep='strongest'"], [110.0]),
        (["tdc.keep='strongest'", "tdc.stops=2"], [100.0, 110.0]),
        (["tdc.stops=3", "tdc.dead_time_ns=80"], [100.0, 130.0, 0.0]),
        (["tdc.stops=3", "tdc.dead_time_ns=250"], [100.0, 0.0, 0.0]),
        (["tdc.stops=3", "tdc.window_us=0.8"], [100.0, 110.0, 0.0]),
        (["tdc.keep='last'", "tdc.window_us=0.8"], [110.0]),
    ],
)
def test_which_crossings_are_kept(overrides, ranges):
    kept_ranges, detection = three_echoes(*overrides)
    for stop, expected_m in zip(kept_ranges, ranges, strict=True):
        np.testing.assert_array_equal(stop, expected_m)
    assert set(detection.outcome) == {int(Outcome.KEPT)}


SAMPLES = ["sampler={type='adc', rate_mhz=1000, bits=14, full_scale=1e-4}"]


@pytest.mark.parametrize("keys", [["tdc.timing='peak'"], SAMPLES])
@pytest.mark.parametrize("dead_time_ns", [0.0, 30.0])
def test_noise_chooses_between_two_echoes_of_like_strength(keys, dead_time_ns):
    """Rationale: the pixel of a sensor at rest whose beam is on an edge jumps from one surface to the other, whether
    they are two returns or, within a dead time, one. Reference: amplitudes of each echo alone, half a deviation apart,
    whose difference is normal; the larger is reported. Tolerance: 4.5 standard errors of 2,000 pulses, and 0.01 for
    the deviations of theirs.
    """
    equipped = sensor("table1-apd", *keys, "tdc.keep='strongest'", f"tdc.dead_time_ns={dead_time_ns}", *trains.QUIET)
    count, range_m, power_w = 2000, np.array([100.0, 102.2]), power_at_snr(equipped, 200.0)
    alone = [detect(train(np.full((count, 1), r), np.full((count, 1), power_w)), equipped).stops[0] for r in range_m]
    sigma = np.std(alone[0].amplitude)
    powers_w = power_w * np.array([1.0, 1.0 + 0.5 * sigma / np.mean(alone[0].amplitude)])
    stop = detect(train(np.tile(range_m, (count, 1)), np.tile(powers_w, (count, 1))), equipped, seed=7).stops[0]
    assert stop.reported.all()
    expected = norm.cdf(0.5 / math.sqrt(2.0))
    assert np.mean(stop.true_range_m > 101.1) == pytest.approx(expected, abs=0.01 + 4.5 * math.sqrt(0.24 / count))
    larger = 0.5 * expected + math.sqrt(2.0) * norm.pdf(0.5 / math.sqrt(2.0))
    measured = (np.mean(stop.amplitude) - np.mean(alone[0].amplitude)) / sigma
    assert measured == pytest.approx(larger, abs=0.01 + 4.5 * math.sqrt(2.0 / count))


@pytest.mark.parametrize("keys", [["tdc.timing='peak'"], ["tdc.keep='strongest'"], SAMPLES])
def test_of_peaks_within_a_dead_time_the_highest_is_reported(keys):
    """Three alike, far enough apart that they share no noise. Reference: the highest of three, of pulses of one echo.
    Kolmogorov and Smirnov at 1e-6.
    """
    equipped = sensor("table1-apd", *keys, "tdc.dead_time_ns=60", *trains.QUIET)
    count, range_m, power_w = 4000, np.array([100.0, 102.2, 104.4]), power_at_snr(equipped, 200.0)
    stop = detect(train(np.tile(range_m, (count, 1)), np.full((count, 3), power_w)), equipped).stops[0]
    alone = detect(train(np.full((3 * count, 1), 100.0), np.full((3 * count, 1), power_w)), equipped, seed=7).stops[0]
    assert ks_2samp(stop.amplitude, alone.amplitude.reshape(count, 3).max(axis=1)).pvalue > 1e-6


def test_noise_that_two_peaks_share_does_not_choose():
    """Noise of 20 kHz changes by 0.1 % of its deviation from one to the other, and half a one is between them."""
    overrides = ["tdc.timing='peak'", "tdc.dead_time_ns=30", "tdc.bandwidth_mhz=0.02", *trains.QUIET]
    equipped = sensor("table1-apd", *overrides)
    powers_w = power_at_snr(equipped, 200.0) * np.array([1.0, 1.0 + 0.5 / 200.0])
    light = train(np.tile([100.0, 102.2], (500, 1)), np.tile(powers_w, (500, 1)))
    assert (detect(light, equipped).stops[0].true_range_m > 101.1).all()


def test_within_a_dead_time_a_peak_below_the_threshold_is_none():
    """Two echoes at the threshold, whose slow noise is nearly the same at both: the point is of one that trips alone.

    Each trips by a deviate of its own, the same with and without a dead time.
    """
    equipped = sensor("table1-apd", "tdc.timing='peak'", "tdc.stops=2", "tdc.bandwidth_mhz=2", *trains.QUIET)
    power_w = power_at_snr(equipped, 50.0) * np.array([0.99, 1.01])
    light = train(np.tile([100.0, 102.2], (500, 1)), np.tile(power_w, (500, 1)))
    apart, together = (
        np.stack([np.where(stop.reported, stop.true_range_m, 0.0) for stop in detect(light, one).stops])
        for one in (equipped, replace(equipped, tdc=replace(equipped.tdc, dead_time_s=40e-9)))
    )
    assert ((apart > 0.0).sum(axis=0) == 1).sum() > 100
    assert (together[1] == 0.0).all()
    np.testing.assert_array_equal(together[0] > 0.0, apart[0] > 0.0)
    assert (together[0] == apart).any(axis=0).all()


def test_an_echo_that_rounds_to_no_range_holds_no_dead_time():
    equipped = sensor("table1-apd", "tdc.timing='peak'", "tdc.lsb_ps=1000", "tdc.dead_time_ns=80", *trains.QUIET)
    power_w = power_at_snr(equipped, 1000.0)
    (stop,) = detect(train(np.full((20, 2), (0.03, 5.0)), np.full((20, 2), (2.0 * power_w, power_w))), equipped).stops
    np.testing.assert_array_equal(stop.true_range_m, 5.0)


def test_outcomes():
    equipped = sensor("table1-apd", *trains.QUIET, "tdc.window_us=0.8")
    power = power_at_snr(equipped, 2000.0) * np.array([[0.0, 0.0], [1e-3, 1e-3], [0.0, 1.0], [1.0, 1.0]])
    detection = detect(train(np.array([[50.0, 130.0]]), power), equipped)
    expected = [Outcome.NO_SURFACE, Outcome.BELOW_THRESHOLD, Outcome.OUT_OF_WINDOW, Outcome.KEPT]
    np.testing.assert_array_equal(detection.outcome, [int(outcome) for outcome in expected])


def fog(scale_w, *, end_m):
    """A bump that rises within 3 m and falls as exp(-r / 10 m)."""
    range_m = np.linspace(0.0, 150.0, 3001)
    course = (range_m / 3.0) ** 2 / (1.0 + (range_m / 3.0) ** 2) * np.exp(-range_m / 10.0)
    return volume(course, scale_w, end_m)


def volume(course, scale_w, end_m):
    """Air of this course over the 3001 ranges up to 150 m."""
    shape = LookupTable(course / course.max())
    return Volume(
        shape=shape,
        far_m=150.0,
        hump_m=hump_of(shape, 150.0),
        scale=np.atleast_1d(scale_w),
        end_m=np.atleast_1d(end_m),
        extinction_per_m=0.05,
    )


def test_fog_trips_and_hides():
    """Fog above the threshold is the first return; what stands in it is found once the waveform has fallen again.

    The hard target at 60 m sees 0.3 % of the bump: two returns; at 8 m it sits on the bump and the comparator is still
    high: one. Reference for the place of the bump's crossing: the table, searched by hand.
    """
    equipped = sensor("table1-apd", *trains.QUIET, "tdc.walk='raw'", "tdc.stops=3")
    power = power_at_snr(equipped, 2000.0)
    for distance, stops in ((60.0, 2), (8.0, 1)):
        air = fog(power, end_m=distance)
        light = train(np.array([[distance]]), np.array([[power]]), volume=air)
        detection = detect(light, equipped)
        assert sum(int(stop.reported[0]) for stop in detection.stops) == stops
        first = detection.stops[0]
        assert first.source[0] == -1
        assert first.status[0] == Status.WEATHER
        range_m = np.linspace(0.0, 5.0, 500_001)
        # 50 of 2000: the level; 10 % of it is what noise moves it by in five deviations.
        crossed = range_m[np.argmax(air.shape.at(range_m / 150.0) >= 50.0 / 2000.0)]
        assert first.range_m[0] == pytest.approx(crossed, abs=0.1 * crossed)
        if stops == 2:
            assert detection.stops[1].source[0] == 0
            assert detection.stops[1].true_range_m[0] == pytest.approx(60.0, abs=1e-3)


def lights(light, air, range_m):
    """Power at the times of these ranges of the surfaces, of the drops and of the fog, pulse by pulse, by hand."""
    pulses = [
        part.peak_power_w.reshape(-1, part.count)[:, :, None]
        * np.exp(-0.5 * ((range_m - part.range_m.reshape(-1, part.count)[:, :, None]) / SIGMA_M) ** 2)
        for part in light.parts
    ]
    end_m = air.end_m[:, None]
    before_end = norm.sf((range_m - end_m) / SIGMA_M - (2.0 * 0.05 + 2.0 / end_m) * SIGMA_M)  # (T37)
    spread = air.scale[:, None] * before_end * np.interp(range_m, np.linspace(0.0, 150.0, 3001), air.shape.values)
    return *(part.sum(axis=1) for part in pulses), spread


def upward_crossings(power, level):
    """Bins at which a waveform comes over a level."""
    return np.flatnonzero((power[1:] >= level) & (power[:-1] < level)) + 1


def test_a_weak_surface_that_ends_the_fog_is_crossed():
    """The fog ends at the surface, so that its light falls while that of the surface rises: both together have a peak
    up to two sigma_p before the surface, where the surface's own light is not concave.

    Each pulse is scaled to have the level halfway between that peak and the valley before it, which are 1 % apart or
    more: ten deviations of the noise from either. By hand in bins of 4 mm; six deviations of the light at the crossing.
    """
    equipped, _, full = two_boards(1.0)
    equipped = at_level(equipped, 0.05, full)
    point = equipped.working_point(np.array([trains.BACKGROUND_W]))
    level_w = float(np.ravel(point.response.power_w(equipped.threshold(point)))[0])
    wall_m, range_m, bins_m = 25.0, np.arange(0.0, 40.0, 0.004), np.linspace(0.0, 150.0, 3001)
    course = np.exp(-bins_m / 20.0) / (1.0 + np.exp((7.0 - bins_m) / 0.7))

    def fog_and_wall(walls_w, scale_w):
        air = volume(course, scale_w, np.full(len(scale_w), wall_m))
        return train(np.full((len(scale_w), 1), wall_m), (walls_w * scale_w)[:, None], volume=air), air

    walls_w = np.linspace(0.02, 0.6, 117)
    whole = sum(lights(*fog_and_wall(walls_w, np.ones(len(walls_w))), range_m=range_m))
    # Between the first fog and the surface the light falls, and if the surface is bright enough rises and falls again.
    rises = (np.diff(whole) > 0.0) & (np.abs(range_m[1:] - 20.0) < 5.5)
    valley = np.argmax(rises, axis=1)
    peak = rises.shape[1] - np.argmax(rises[:, ::-1], axis=1)
    lane = np.flatnonzero(rises.any(axis=1))
    lane = lane[whole[lane, valley[lane]] < 0.99 * whole[lane, peak[lane]]]
    assert (wall_m - range_m[peak[lane]] > 1.05 * SIGMA_M).sum() > 5
    scale_w = 2.0 * level_w / (whole[lane, valley[lane]] + whole[lane, peak[lane]])
    detection = detect(fog_and_wall(walls_w[lane], scale_w)[0], equipped)
    for number, pulse in enumerate(lane):
        stops = [float(stop.range_m[number]) for stop in detection.stops if stop.reported[number]]
        assert len(stops) == 2
        assert stops[0] < 15.0
        assert range_m[valley[pulse]] < stops[1] < range_m[peak[pulse]]
        crossed_w = scale_w[number] * np.interp(stops[1], range_m, whole[pulse])
        assert crossed_w == pytest.approx(level_w, rel=6.0 * 5e-4)


def test_a_crossing_is_of_the_light_that_makes_it():
    """Two surfaces and two drops in fog, of any brightness, over bins of 4 mm: take some of it away, does the crossing
    stay?

    Where the air alone crosses too, within sigma_p / 10, the point is the air's; where it does not within a pulse width
    it is a surface's, unless the air's light rises by half as much as theirs over the sigma_p before. In between,
    6 % of all, both have a part in it. Of what is the air's fog and drops are told apart alike.

    The true range of a surface is the mean of the surfaces by their light at the next peak, that of fog the crossing,
    that of drops up to 11 sigma_p behind it: 100 levels high they come to 1e-5 of their peak 6 before it, where fog
    leaves that little to the level, and a drop a thousand times as bright takes the peak of one 4.6 before it.

    Noise is 5e-4 of the level. A crossing lies where the light comes through six deviations of it, which 1,300
    crossings leave by chance 3e-6 of the time; pulses with a peak or a valley among them may be crossed or not, and are
    left out.
    """
    random, count = premise(12), 400
    equipped, _, full = two_boards(1.0)
    equipped = at_level(replace(equipped, tdc=replace(equipped.tdc, stops=8)), 0.05, full)
    point = equipped.working_point(np.array([trains.BACKGROUND_W]))
    threshold = equipped.threshold(point)
    model = {"noise": point.noise.deviation, "kappa_1": point.noise.kappa_1, "kappa_2": point.noise.kappa_2}
    low_w, level_w, high_w = sorted(
        float(np.ravel(point.response.power_w(tdc.crossing_level(threshold=threshold, deviate=deviate, **model)))[0])
        for deviate in (-6.0, 0.0, 6.0)
    )
    walls_m, drops_m = random.uniform(7.5, 30.0, (2, count, 2))
    walls_w, drops_w = level_w * 10.0 ** random.uniform(-1.0, 2.0, (2, count, 2))
    walls_m[::3] = random.uniform(7.5, 12.0, (len(walls_m[::3]), 2))
    drops_w *= random.uniform(size=(count, 1)) < 0.5
    end_m = walls_m.max(axis=1)
    drops_w[drops_m > end_m[:, None]] = 0.0
    bins_m = np.linspace(0.0, 150.0, 3001)
    course = np.exp(-bins_m / 20.0) / (1.0 + np.exp((7.0 - bins_m) / 0.7))
    top = 10.0 ** random.uniform(-0.5, 1.0, count)
    top = np.where(np.abs(top - 1.0) < 0.1, 2.0 * top, top)  # a flat top at the level is crossed anywhere
    air = volume(course, level_w * top, end_m)
    light = train(walls_m, walls_w, volume=air)
    light = replace(light, parts=(*light.parts, *train(drops_m, drops_w).parts))
    detection = detect(light, equipped)
    range_m = np.arange(0.0, 40.0, 0.004)
    by_kind = {"surface": 0, "drop": 0, "fog": 0}
    judged = crossings = unclear = 0
    for pulse, (walls, drops, spread) in enumerate(zip(*lights(light, air, range_m), strict=True)):
        of_air, even = (range_m[upward_crossings(light_w, level_w)] for light_w in (drops + spread, spread))
        whole = walls + drops + spread
        turns = (whole[1:-1] - whole[:-2]) * (whole[2:] - whole[1:-1]) < 0.0
        if (turns & (whole[1:-1] > low_w) & (whole[1:-1] < high_w)).any():
            unclear += 1
            continue
        begun, crossings_m, ended = (range_m[upward_crossings(whole, one_w)] for one_w in (low_w, level_w, high_w))
        stops = [stop for stop in detection.stops if stop.reported[pulse]]
        stops_m = np.array([float(stop.range_m[pulse]) for stop in stops])
        assert len(stops) == len(crossings_m)
        assert (begun - 0.004 <= stops_m).all()
        assert (stops_m <= ended).all()
        for crossing, stop_m, stop in zip(crossings_m, stops_m, stops, strict=True):

            def apart(candidates_m, crossing=crossing):
                return np.abs(candidates_m - crossing).min(initial=math.inf)

            crossings += 1
            at_crossing = np.searchsorted(range_m, crossing)
            before = at_crossing - round(SIGMA_M / 0.004)
            by_air, by_walls = (light_w[at_crossing] - light_w[before] for light_w in (drops + spread, walls))
            if 0.1 * SIGMA_M < apart(of_air) < FWHM_M or (apart(of_air) >= FWHM_M and by_air > 0.5 * by_walls):
                continue
            judged += 1
            source, true_m = int(stop.source[pulse]), float(stop.true_range_m[pulse])
            if apart(of_air) >= FWHM_M:
                by_kind["surface"] += 1
                assert stop.status[pulse] == Status.ECHO
                assert source in (0, 1)
                # Half a bin of the peak's place moves the mean of two, four sigma_p apart at most, by 0.02 sigma_p.
                peak_m = range_m[at_crossing + int(np.argmax(np.diff(whole[at_crossing:]) < 0.0))]
                light_w = walls_w[pulse] * np.exp(-0.5 * ((peak_m - walls_m[pulse]) / SIGMA_M) ** 2)
                mean_m = light_w @ walls_m[pulse] / light_w.sum()
                assert true_m == pytest.approx(mean_m, abs=0.03 * SIGMA_M)
                continue
            assert stop.status[pulse] == Status.WEATHER
            assert source in (-1, 2, 3)
            if apart(even) < 0.1 * SIGMA_M:
                by_kind["fog"] += 1
                assert source == -1
                assert true_m == pytest.approx(stop_m, abs=0.02 * SIGMA_M)
            elif apart(even) > FWHM_M:
                by_kind["drop"] += 1
                assert source in (2, 3)
                assert stop_m < true_m < stop_m + 11.0 * SIGMA_M
    # Of streams without number some 2 pulses, 94 +/- 1.1 % of 490 crossings, and 39 of drops: five deviations and more.
    assert unclear < 0.05 * count
    assert judged > 0.88 * crossings
    assert min(by_kind.values()) > 10


def test_a_crossing_in_a_valley_is_of_what_rises_behind_it():
    """Two surfaces on fog that brightens to the right. Where noise lets the first pass and finds the valley behind it
    over the level, fog alone rises in that valley, and what makes the crossing is the second.
    """
    equipped, count = sensor("table1-apd", "tdc.threshold_to_noise=6", "tdc.walk='raw'"), 2000
    power = power_at_snr(equipped, 6.0)
    course = np.exp(-((np.linspace(0.0, 150.0, 3001) - 14.0) ** 2) / 18.0)
    air = volume(course, np.full(count, 0.3 * power), np.full(count, 11.1))
    light = train(np.full((count, 2), (10.0, 11.1)), np.full((count, 2), power), volume=air)
    range_m = np.arange(10.2, 10.9, 0.001)
    lone_light = train(np.array([[10.0, 11.1]]), np.full((1, 2), power), volume=volume(course, 0.3 * power, 11.1))
    watts = sample_power_and_signal(lone_light, equipped, range_m / HALF_C)[0][0]
    valley_m = range_m[np.argmin(watts)]
    first = detect(light, equipped).stops[0]
    in_valley = first.reported & (np.abs(first.range_m - valley_m) < 0.005)
    assert in_valley.sum() > 100
    assert np.all(first.status[in_valley] == Status.ECHO)
    assert np.all(first.source[in_valley] == 1)


def test_fog_ends_at_the_surface():
    """There is no light behind the surface; before it the waveform is the table's."""
    equipped = sensor("table1-apd")
    air = fog(1e-6, end_m=20.0)
    light = train(np.array([[20.0]]), np.array([[0.0]]), volume=air)
    watts, _ = sample_power_and_signal(light, equipped, 2.0 / SPEED_OF_LIGHT_M_S * np.array([5.0, 15.0, 20.0, 25.0]))
    course = 1e-6 * air.shape.at(np.array([5.0, 15.0, 20.0]) / 150.0)
    # (T37): at the surface kappa sigma = (2 alpha + 2 / 20 m) sigma more than half of it.
    at_surface = norm.cdf((2.0 * 0.05 + 2.0 / 20.0) * SIGMA_M)
    np.testing.assert_allclose(watts[0], [course[0], course[1], at_surface * course[2], 0.0], rtol=1e-9, atol=1e-15)


def test_the_hump_is_where_a_course_is_concave():
    air = fog(1.0, end_m=100.0)
    start, end = air.hump_m
    bend = np.diff(air.shape.values, n=2)
    place = np.arange(1, 3000) * 0.05
    assert (bend[(place < start) | (place > end)] >= -1e-7).all()
    assert 0.0 <= start < 4.0 < end < 40.0


REACH = 13.0
"""Farthest pulse that `pulse_sums.comb_parts` takes, in sigma_p from the middle of its places."""


@pytest.mark.parametrize(("kind", "samples"), [("float64", 25), ("float32", 25), ("float32", 1024)])
def test_even_places_by_factors(kind, samples):
    """Compared with an exponential for each pulse and place.

    Tolerance, in units of the last place: exponents reach 140 where a pulse still counts, places 50 sigma_p times a
    slope of 8, with factors or without: 350 together. Each place multiplies by a factor, and both round: 2 more. Pulses
    farther than the reach from the middle are left out: each has at most this share of its height at the last place.
    """
    good_to = (350 + 2 * samples) * np.finfo(kind).eps
    random, spread = np.random.default_rng(3), 4.0 * pulse_sums.SIGMAS_PER_FWHM
    pulses, count = 500, 12
    start = random.uniform(-40.0, 40.0, pulses).astype(kind)
    spacing = np.asarray(spread / (samples - 1), dtype=kind)
    middle = start + np.asarray(0.5 * spread, dtype=kind)
    centres = random.uniform(-50.0, 50.0, (count, pulses)).astype(kind)
    centres[:4] = (middle + random.uniform(-5.0, 5.0, (4, pulses))).astype(kind)
    heights = (1e-7 * random.uniform(0.0, 1.0, (count, pulses)) ** 3).astype(kind)
    heights[1], centres[1] = 0.0, 0.0
    left_out = heights.sum(axis=0, dtype=float) * math.exp(-0.5 * (REACH - 0.5 * spread) ** 2)
    parts, growths = pulse_sums.comb_parts(
        start=start, spacing=spacing, middle=middle, centres=list(centres), heights=list(heights)
    )
    for number in range(samples):
        places = (start + np.asarray(number, dtype=kind) * spacing).astype(kind)
        computed = pulse_sums.even_sum(place=places, middle=middle, parts=parts)
        exact = start.astype(float) + number * spacing.astype(float)
        expected = pulse_sums.sum_of_pulses(
            place=exact, centres=list(centres.astype(float)), heights=list(heights.astype(float))
        )[0]
        scale = np.maximum(expected, 1e-3 * heights.max(axis=0))
        assert np.all(np.abs(computed - expected) < good_to * scale + left_out)
        parts = [part * growth for part, growth in zip(parts, growths, strict=True)]


@pytest.mark.parametrize(("second", "stop_count"), [(2.5, 1), (3.5, 1), (4.5, 2), (6.0, 2)])
def test_fixed_levels_see_a_rise_only_if_it_reaches_one_of_them(second, stop_count):
    """A board of 6 thresholds, and one behind it, 3.4 sigma later: the light between them is 1.8 to 2.8 thresholds. So
    the next edge is where the sum reaches the second level, of 4 thresholds.

    Noise is 2 % of the threshold, 4 % on the light; the first board's light adds 2 % to the second's peak.

    Args:
        second: peak of the second board, in thresholds
    """
    equipped = sensor(
        "table1-apd",
        *trains.QUIET,
        "tdc.stops=2",
        "tdc.dead_time_ns=0",
        "sampler.type='multi_level_tdc'",
        "sampler.levels=[4]",
    )
    level = power_at_snr(equipped, 50.0)
    light = train(np.array([[60.0, 60.0 + 3.4 * SIGMA_M]]), level * np.array([[6.0, second]]))
    stops = detect(light, equipped).stops
    assert sum(int(stop.reported[0]) for stop in stops) == stop_count
    assert [int(stop.source[0]) for stop in stops[:stop_count]] == [0, 1][:stop_count]


def test_a_comparator_that_missed_a_rise_is_low():
    """The case is `test_a_crossing_in_a_valley_is_of_what_rises_behind_it`, behind a bright surface: that the
    comparator tripped there before says nothing of the rise that it missed, and it trips in the valley behind that as
    often.
    """
    equipped = sensor("table1-apd", "tdc.threshold_to_noise=6", "tdc.walk='raw'", "tdc.stops=2")
    count, power = 2000, power_at_snr(equipped, 6.0)
    course = np.exp(-((np.linspace(0.0, 150.0, 3001) - 14.0) ** 2) / 18.0)
    air = volume(course, np.full(count, 0.3 * power), np.full(count, 11.1))
    light = train(np.full((count, 3), (4.0, 10.0, 11.1)), np.full((count, 3), (40.0 * power, power, power)), volume=air)
    second = detect(light, equipped).stops[1]
    range_m = np.arange(10.2, 10.9, 0.001)
    lone_light = train(np.array([[10.0, 11.1]]), np.full((1, 2), power), volume=volume(course, 0.3 * power, 11.1))
    valley_m = range_m[np.argmin(sample_power_and_signal(lone_light, equipped, range_m / HALF_C)[0][0])]
    assert (second.reported & (np.abs(second.range_m - valley_m) < 0.005)).sum() > 100


def test_even_light_has_no_range_but_that_which_is_reported():
    """The light is that of fog, in front of the lens too: without walk and noise to speak of the true range is the
    reported one, of an edge, of a peak and of the middle of its samples; none is below 0.
    """
    quiet = ["detector.circuit_noise_na=1e6", "tdc.threshold_to_noise=1e4", "tdc.walk='raw'"]
    adc = ["sampler.type='adc'", "sampler.rate_mhz=1000", "sampler.bits=20", "sampler.full_scale=100"]
    for overrides in ([], ["tdc.timing='peak'"], adc):
        equipped = sensor("table1-apd", *quiet, *overrides)
        power = power_at_snr(equipped, 3e4)
        first = detect(train(np.array([[60.0]]), np.array([[0.0]]), volume=fog(power, end_m=60.0)), equipped).stops[0]
        assert first.status[0] == Status.WEATHER
        # The time of a peak has a deviation of 0.0093.
        assert first.true_range_m[0] == pytest.approx(float(first.range_m[0]), abs=0.05 * SIGMA_M)
    equipped = sensor("table1-apd", *quiet[:2])
    near = replace(
        volume(np.exp(-np.linspace(0.0, 150.0, 3001) / 3.0), power_at_snr(equipped, 1e6), 60.0),
        near_m=-0.2,
        hump_m=(-0.2, 1.0),
    )
    light = train(np.array([[60.0]]), np.array([[0.0]]), volume=near)
    corrected, raw = (detect(light, equipment).stops[0] for equipment in (equipped, sensor("table1-apd", *quiet)))
    assert corrected.reported[0]
    assert corrected.true_range_m[0] == 0.0
    assert not raw.reported[0]  # its time is before the pulse


def test_light_that_rises_slowly_trips_where_it_reaches_the_level():
    """The course grows as exp(r / 5 m) up to 60 m and ends there: 23 m before its end it is a hundredth of that, far
    before the first place where it can have a peak. There is no light before where the course begins.
    """
    quiet = ["detector.circuit_noise_na=1e6", "tdc.threshold_to_noise=1e4", "tdc.walk='raw'"]
    equipped = sensor("table1-apd", *quiet)
    grid = np.linspace(0.0, 150.0, 3001)
    course = np.where(grid < 60.0, np.exp((grid - 60.0) / 5.0), np.exp(-(((grid - 60.0) / 2.0) ** 2)))
    air = volume(course, power_at_snr(equipped, 1e6), 100.0)
    first = detect(train(np.array([[120.0]]), np.array([[0.0]]), volume=air), equipped).stops[0]
    # The table is straight over 0.05 m: its level is (0.05 / 5)^2 / 8 of itself too high.
    assert first.range_m[0] == pytest.approx(60.0 - 5.0 * math.log(100.0), abs=2e-3)
    begins = replace(air, near_m=30.0, hump_m=(30.0, 150.0), shape=LookupTable(np.linspace(1.0, 0.0, 3001)))
    wave = waveform(train(np.array([[120.0]]), np.array([[0.0]]), volume=begins), equipped)
    before, behind = ((distance_m - wave.origin_m) / wave.unit_m for distance_m in (29.9, 30.1))
    assert wave.air_w(before) == 0.0
    assert wave.air_w(behind) == pytest.approx(0.999 * power_at_snr(equipped, 1e6), rel=1e-3)
