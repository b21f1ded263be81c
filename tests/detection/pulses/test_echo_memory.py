"""What earlier echoes of a pulse leave in the detector: cells simulated one by one, an amplifier's charge by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import trains
from helpers.run_seed import chosen
from helpers.trains import SIGMA_S, detect, sensor, train
from scipy.special import erf

from lidarscene.detection.pulses.echo_memory import Residue
from lidarscene.detection.sampled_waveforms import sample_with_memory
from lidarscene.light.waveform import sample_power_and_signal
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics import sipm_response
from lidarscene.physics.electronics.pulse_sums import SIGMAS_PER_FWHM

DEAD_S, FWHM_S, CELLS, PDE, DARK_HZ = 20e-9, 3e-9, 400, 0.22, 2007.0
SIGMA_PULSE_S = FWHM_S / SIGMAS_PER_FWHM
KEYS = ("detector.dead_time_ns=20", "laser.pulse_fwhm_ns=3", "tdc.stops=4", "detector.cell_floor=1", "tdc.lsb_ps=0")
IN_TIME, STEADY = (f"detector.statistics='{statistics}'" for statistics in ("time_domain", "steady_state"))
DIM_W, BRIGHT_W = 2.5e-9, 2.5e-8
"""Background at which a ready cell fires 0.13 and 1.3 times in a dead time."""


def rate_hz(equipped, background_w):
    """Firings of a ready cell."""
    return background_w / equipped.laser.photon_energy_j * PDE / CELLS + DARK_HZ


def counts(equipped, background_w, powers_w, arrivals_s, *, shots=200, step_s=0.25e-9):
    """(times,) and (shots, times) busy cells above the background's mean: each cell by itself, in continuous time.

    A ready cell fires when its hazard has grown by a number that is drawn from the exponential law, and is ready again
    a dead time later. Stepping through the time instead would have a revived cell wait half a step too little: at the
    end of a flash's dead time, where some 50 cells revive in a ns, 6 cells too many are busy for steps of 0.25 ns.
    """
    random, energy_j = np.random.default_rng(2), equipped.laser.photon_energy_j
    rate = rate_hz(equipped, background_w)
    busy = rate * DEAD_S / (1.0 + rate * DEAD_S)
    times_s = np.arange(-8.0 * SIGMA_PULSE_S, arrivals_s[-1] + 1.2 * DEAD_S, step_s)[1:]
    begin_s, end_s = times_s[0] - step_s, times_s[-1]
    # A straight line between points 0.01 sigma apart: the hazard is good to 1e-5 of a flash.
    fine_s = np.linspace(begin_s, end_s, math.ceil((end_s - begin_s) / (0.01 * SIGMA_PULSE_S)))
    hazard = rate * (fine_s - begin_s)
    for power, arrival in zip(powers_w, arrivals_s, strict=True):
        flash = power / energy_j * PDE / CELLS * SIGMA_PULSE_S * math.sqrt(2.0 * math.pi)
        hazard += 0.5 * flash * (1.0 + erf((fine_s - arrival) / (math.sqrt(2.0) * SIGMA_PULSE_S)))
    shot = np.repeat(np.arange(shots), CELLS)
    changes = np.zeros((shots, len(times_s) + 1))
    # Stationary at first: busy with that probability, for how long still evenly between none and all.
    was_busy = random.random(len(shot)) < busy
    ready_s = begin_s + np.where(was_busy, DEAD_S * random.random(len(shot)), 0.0)
    np.add.at(changes, (shot[was_busy], 0), 1.0)
    np.add.at(changes, (shot[was_busy], np.searchsorted(times_s, ready_s[was_busy])), -1.0)
    while len(shot):
        due = np.interp(ready_s, fine_s, hazard) + random.exponential(size=len(shot))
        fires = (ready_s < end_s) & (due < hazard[-1])
        shot, fired_s = shot[fires], np.interp(due[fires], hazard, fine_s)
        ready_s = fired_s + DEAD_S
        np.add.at(changes, (shot, np.searchsorted(times_s, fired_s)), 1.0)
        np.add.at(changes, (shot, np.searchsorted(times_s, ready_s)), -1.0)
    return times_s, np.cumsum(changes, axis=1)[:, :-1] - CELLS * busy


def echoes(equipped, background_w, signals, apart_m, *, pulses=400):
    """What is detected of boards whose lone echoes have these peaks, their powers and their arrivals."""
    point = equipped.working_point(np.array([background_w]))
    powers = [float(point.response.power_w(np.array([signal]))[0]) for signal in signals]
    range_m = 30.0 + apart_m * np.arange(len(signals))
    light = train(np.tile(range_m, (pulses, 1)), np.tile(powers, (pulses, 1)), background_w=background_w)
    return detect(light, equipped), powers, 2.0 * (range_m - 30.0) / SPEED_OF_LIGHT_M_S


def mean_returns(detection):
    """Mean number of echoes reported of a pulse."""
    return sum(float(np.mean(stop.reported & (stop.status == 0))) for stop in detection.stops)


@pytest.mark.parametrize(("apart_m", "expected"), [(2.0, 1), (2.8, 1), (4.0, 2)])
def test_second_board_within_the_dead_time(apart_m, expected):
    """Rationale: the count stays up for the dead time, so a comparator sees one edge of boards 2.0 and 2.8 m apart and
    two of boards 4.0 m apart (26.7 ns). Reference: cells simulated one by one. An edge of theirs counts if the count
    was below the level for 4 ns: it jitters around the level on its way through it. Both to 0.05.
    """
    equipped = sensor("table1-sipm", IN_TIME, *KEYS)
    detection, powers, arrivals = echoes(equipped, DIM_W, (100.0, 100.0), apart_m)
    assert mean_returns(detection) == pytest.approx(expected, abs=0.05)
    _, count = counts(equipped, DIM_W, powers, arrivals, shots=60)
    level = float(equipped.threshold(equipped.working_point(np.array([DIM_W])))[0])
    high = count >= level
    window = np.lib.stride_tricks.sliding_window_view(high, 17, axis=1)
    fresh = window[..., -1] & ~window[..., :-1].any(axis=-1)
    assert fresh.sum(axis=1).mean() == pytest.approx(expected, abs=0.05)
    # What others compute, who let every echo find all cells ready.
    forgetful, _, _ = echoes(sensor("table1-sipm", STEADY, *KEYS), DIM_W, (100.0, 100.0), apart_m)
    assert mean_returns(forgetful) == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize(
    ("background_w", "signals", "apart_m"),
    [(DIM_W, (150.0, 70.0), 4.0), (DIM_W, (150.0, 150.0), 4.0), (BRIGHT_W, (100.0, 100.0), 5.0)],
)
def test_peak_of_the_second_echo(background_w, signals, apart_m):
    """Rationale: cells that revive together are none of them busy with sunlight, and more are ready. Reference: the
    mean count of cells simulated one by one. Tolerance 1 %, and five standard errors of both means.
    """
    equipped = sensor("table1-sipm", IN_TIME, *KEYS)
    detection, powers, arrivals = echoes(equipped, background_w, signals, apart_m)
    time_s, count = counts(equipped, background_w, powers, arrivals)
    peak = np.searchsorted(time_s, arrivals[1] + 2.0 * SIGMA_PULSE_S)
    stop = detection.stops[1]
    is_echo = stop.reported & (stop.status == 0)
    assert is_echo.mean() > 0.9
    lone = equipped.working_point(np.array([background_w])).noise.deviation[0]
    found, expected = stop.snr[is_echo] * lone, count[:, peak]
    error = math.hypot(*(float(np.std(values)) / math.sqrt(len(values)) for values in (found, expected)))
    assert found.mean() == pytest.approx(expected.mean(), abs=0.01 * expected.mean() + 5.0 * error)


@pytest.mark.parametrize("background_w", [DIM_W, BRIGHT_W])
def test_what_an_echo_leaves(background_w):
    """(T45b) against cells simulated one by one, from the pulse's end to two dead times: 3.2 cells of 110, and five
    standard errors of 800 shots, 0.354 at most.

    But for the revival itself: cells of a strong pulse fire before its peak, and revive a third of a ns earlier.
    """
    equipped = sensor("table1-sipm", IN_TIME, *KEYS)
    point = equipped.working_point(np.array([background_w]))
    power = float(point.response.power_w(np.array([110.0]))[0])
    time_s, count = counts(equipped, background_w, [power, 0.0], np.array([0.0, 1.1 * DEAD_S]), shots=800)
    memory = {"rate_hz": rate_hz(equipped, background_w), "dead_time_s": DEAD_S}
    fired = sipm_response.fired_by_pulse(peak=110.0, pulse_fwhm_s=FWHM_S, cells=CELLS, **memory)
    later = (time_s > 2.5 * SIGMA_PULSE_S) & (np.abs(time_s - DEAD_S) > 3.0 * SIGMA_PULSE_S)
    later &= time_s < 2.0 * DEAD_S
    expected = fired * sipm_response.residual_busy(age_s=time_s[later], sigma_s=SIGMA_PULSE_S, **memory)
    np.testing.assert_allclose(count.mean(axis=0)[later], expected, atol=5.0)
    assert expected.min() < (-8.0 if background_w == DIM_W else -30.0)


@pytest.mark.parametrize("background_w", [DIM_W, BRIGHT_W])
def test_the_signal_of_a_waveform_is_the_mean_count(background_w):
    """Two boards 2.8 m apart, against cells simulated one by one.

    A cell is busy or not, and 400 of them in 800 shots have a mean with a standard error of 0.354 cells at most. 5.7 of
    them are 2.0 cells, which the 211 times pass by chance 3e-6 of the time. The steps of the waveform itself add 0.15.
    """
    equipped = sensor("table1-sipm", IN_TIME, *KEYS)
    point = equipped.working_point(np.array([background_w]))
    powers = [float(point.response.power_w(np.array([cells]))[0]) for cells in (150.0, 100.0)]
    range_m = np.array([30.0, 32.8])
    arrivals = 2.0 * (range_m - 30.0) / SPEED_OF_LIGHT_M_S
    time_s, count = counts(equipped, background_w, powers, arrivals, shots=800)
    light = train(range_m[None], np.array([powers]), background_w=background_w)
    # The count of a step is at its end.
    shifted_s = time_s + 2.0 * 30.0 / SPEED_OF_LIGHT_M_S
    _, (signal,) = sample_with_memory(light, equipped, shifted_s)
    np.testing.assert_allclose(signal, count.mean(axis=0), atol=2.2)
    _, (forgetful,) = sample_power_and_signal(light, equipped, shifted_s)
    assert np.abs(forgetful - signal).max() > 50.0


def test_the_paper_forgets():
    """(27) knows no second echo: the sensors of the paper, and clipping without a recovery time, have no memory."""
    background = np.array([DIM_W])
    assert sensor("table1-sipm").working_point(background).memory is None
    for name, keys in (("table1-sipm", ()), ("table1-apd", ("detector.saturation_ua=50",))):
        equipped = sensor(name, "tdc.stops=2", *keys)
        detection, _, _ = echoes(equipped, DIM_W, (40e-6, 40e-6) if "apd" in name else (150.0, 150.0), 6.0)
        np.testing.assert_allclose(detection.stops[0].snr, detection.stops[1].snr, rtol=1e-6)


@pytest.mark.parametrize(("recovery_ns", "apart_m", "expected"), [(5.0, 6.0, 1), (5.0, 20.0, 2), (20.0, 20.0, 1)])
def test_a_clipped_amplifier_is_blind_for_the_next_echo(recovery_ns, apart_m, expected):
    """Rationale: it holds a clipped pulse's charge until t_S + tau ln(s / U), and sees no edge before. Reference: that
    time by hand, after a plate 100 times above clipping.
    """
    equipped = sensor("table1-apd", "detector.saturation_ua=50", f"detector.recovery_ns={recovery_ns}", "tdc.stops=3")
    detection, _, arrivals = echoes(equipped, 2.5e-8, (5e-3, 10e-6), apart_m)
    level = float(equipped.threshold(equipped.working_point(np.array([2.5e-8])))[0])
    blind_s = SIGMA_S * math.sqrt(2.0 * math.log(100.0)) + recovery_ns * 1e-9 * math.log(5e-3 / level)
    assert (blind_s > arrivals[1]) == (expected == 1)
    assert mean_returns(detection) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize(("signal_a", "expected"), [(10e-6, 1), (40e-6, 2)])
def test_a_peak_on_charge_counts_from_the_charge(signal_a, expected):
    """The next pulse is one of its own if it rises by a threshold out of the charge, which drains meanwhile."""
    keys = ("detector.saturation_ua=50", "detector.recovery_ns=10", "tdc.stops=3", "tdc.timing='peak'")
    detection, _, _ = echoes(sensor("table1-apd", *keys), 2.5e-8, (5e-3, signal_a), 9.5)
    assert mean_returns(detection) == pytest.approx(expected, abs=0.02)


def test_charge_adds_to_the_next_echo():
    """What is left drains as exp(-t / tau) and carries the next echo: its peak by hand, to rounding."""
    equipped = sensor("table1-apd", "detector.saturation_ua=50", "detector.recovery_ns=5", "tdc.stops=3")
    detection, _, arrivals = echoes(equipped, 2.5e-8, (5e-3, 1.5e-6), 9.5)
    point = equipped.working_point(np.array([2.5e-8]))
    since_s = arrivals[1] - SIGMA_S * math.sqrt(2.0 * math.log(100.0))
    expected = (1.5e-6 + 5e-3 * math.exp(-since_s / 5e-9)) / float(point.noise.deviation[0])
    assert expected > 1.04 * 1.5e-6 / float(point.noise.deviation[0])
    stop = detection.stops[1]
    is_echo = stop.reported & (stop.status == 0)
    assert is_echo.mean() > 0.9
    np.testing.assert_allclose(stop.snr[is_echo], expected, rtol=1e-6)


@pytest.mark.parametrize(
    "equipment",
    chosen(
        1,
        [
            ("table1-sipm", IN_TIME, *KEYS),
            ("table1-apd", "detector.saturation_ua=5", "detector.recovery_ns=5", "tdc.stops=4"),
        ],
    ),
)
def test_on_the_device(mi, equipment):
    """Three echoes up to 5 m apart: outcomes of pulses as numpy has them but for 1 in 200, ranges to 2 mm.

    Cells are whole, so that single precision moves a crossing by a cell now and then: of some 1,400 echoes five, by
    five deviations of these at most 18.
    """
    equipped, random, count = sensor(*equipment), np.random.default_rng(4), 2000
    point = equipped.working_point(np.array([DIM_W]))
    power = point.response.power_w(point.noise.deviation * 60.0)[0] * random.uniform(0.1, 1.5, (count, 3))
    light = train(30.0 + np.cumsum(random.uniform(1.0, 5.0, (count, 3)), axis=1), power, background_w=DIM_W)
    host = detect(light, equipped)
    device = trains.detect_on_device(light, equipped)
    assert 1.05 < sum(stop.reported.mean() for stop in device.stops) < 2.8
    for host_stop, device_stop in zip(host.stops[:2], device.stops[:2], strict=True):
        assert np.sum(host_stop.reported != device_stop.reported) < 18
        off_m = np.abs(host_stop.range_m - device_stop.range_m)[host_stop.reported & device_stop.reported]
        assert np.sum(off_m > 2e-3) < 18


@pytest.mark.parametrize(
    ("background_w", "signals", "arrivals_ns"),
    [
        (DIM_W, (50.0, 50.0, 50.0, 120.0), (0.0, 5.0, 10.0, 15.0)),  # all cells that fired are still busy
        (DIM_W, (90.0, 20.0, 20.0, 120.0), (0.0, 27.0, 32.0, 37.0)),  # those of the first have long revived
        (BRIGHT_W, (90.0, 30.0, 100.0), (0.0, 13.0, 26.0)),
    ],
)
def test_peak_behind_several_echoes(background_w, signals, arrivals_ns):
    """The brightest pulse comes last, and finds what those before have left: the SNR of the waveform is that of the
    most cells busy at a time. Reference: cells simulated one by one. 10 %: all but the last echo before count as
    one; and five deviations of the mean of 240 shots, of 150 cells to 12.
    """
    equipped = sensor("table1-sipm", IN_TIME, *KEYS)
    point = equipped.working_point(np.array([background_w]))
    powers = [float(point.response.power_w(np.array([signal]))[0]) for signal in signals]
    arrivals = 1e-9 * np.array(arrivals_ns)
    range_m = 30.0 + 0.5 * SPEED_OF_LIGHT_M_S * arrivals
    detection = detect(train(range_m[None], np.array([powers]), background_w=background_w), equipped)
    time_s, count = counts(equipped, background_w, powers, arrivals, shots=240)
    last = np.abs(time_s - arrivals[-1] - 2e-9) < 4e-9
    assert detection.snr[0] * point.noise.deviation[0] == pytest.approx(count[:, last].mean(axis=0).max(), rel=0.126)


def test_what_is_left_counts_as_signal_for_the_walk():
    """A sensor knows nothing of the charge: it takes off the walk of a lone pulse as high as what it measures, shot by
    shot, to rounding: sigma_p sqrt(2 ln(A / U)).
    """
    keys = ("detector.saturation_ua=50", "detector.recovery_ns=5", "tdc.stops=3", "tdc.edges='rising'")
    read = []
    for walk in ("corrected", "raw"):
        equipped = sensor("table1-apd", *keys, f"tdc.walk='{walk}'")
        detection, _, _ = echoes(equipped, 2.5e-8, (5e-3, 3e-6), 9.5)
        read.append(detection.stops[1])
    corrected, raw = read
    is_echo = corrected.reported & (corrected.status == 0)
    assert is_echo.mean() > 0.9
    level = float(equipped.threshold(equipped.working_point(np.array([2.5e-8])))[0])
    early_s = SIGMA_S * np.sqrt(2.0 * np.log(corrected.amplitude[is_echo] / level))
    np.testing.assert_allclose(
        (corrected.range_m - raw.range_m)[is_echo], 0.5 * SPEED_OF_LIGHT_M_S * early_s, rtol=1e-9
    )


@pytest.mark.parametrize("order", [(1.0, 2.0, 3.0), (1.0, 3.0, 2.0), (3.0, 2.0, 1.0)])
def test_the_snr_of_a_pulse_is_that_of_its_brightest_echo(order):
    """Wherever that is among others far from it."""
    equipped = sensor("table1-apd")
    light = train(np.array([[40.0, 60.0, 80.0]]), 10.0 * trains.power_at_snr(equipped, 1.0) * np.array([order]))
    assert detect(light, equipped).snr[0] == pytest.approx(30.0, rel=1e-6)


@pytest.mark.parametrize(
    ("keys", "avalanches"),
    [
        (("detector.crosstalk=0.25",), 1.0 / 0.75),
        (("detector.afterpulse=0.3", "detector.afterpulse_ns=30"), 1.0 / (1.0 - 0.3 * math.exp(-20.0 / 30.0))),
    ],
)
def test_the_signal_of_a_waveform_counts_avalanches_that_others_cause(keys, avalanches):
    """A weak echo in the dark, over half a microsecond; also of one that comes while the pulse still leaves."""
    areas = []
    for more in ((), keys):
        equipped = sensor("table1-sipm", IN_TIME, *KEYS, "detector.dark_count_rate_hz=0", *more)
        for range_m in (30.0, 0.0):
            light = train(np.full((1, 1), range_m), np.full((1, 1), 1e-10), background_w=1e-16)
            after_s = np.linspace(-10e-9, 600e-9, 20_001) + 2.0 * range_m / SPEED_OF_LIGHT_M_S
            areas.append(np.trapezoid(sample_with_memory(light, equipped, after_s)[1][0], after_s))
    assert areas[1] == pytest.approx(areas[0], rel=0.02)
    assert areas[3] == pytest.approx(areas[2], rel=0.02)
    assert areas[2] / areas[0] == pytest.approx(avalanches, rel=0.02)


def test_the_signal_of_a_clipped_waveform_drains():
    """The signal fades, behind the light's fall to the clipping level, by a factor of e in each recovery time."""
    equipped = sensor("table1-apd", "detector.saturation_ua=50", "detector.recovery_ns=20")
    point = equipped.working_point(np.array([DIM_W]))
    light = train(np.full((1, 1), 30.0), np.full((1, 1), float(np.ravel(point.response.power_w(5e-3))[0])))
    released_s = SIGMA_S * math.sqrt(2.0 * math.log(100.0)) + 2.0 * 30.0 / SPEED_OF_LIGHT_M_S
    since_s = np.array([100e-9, 120e-9, 160e-9])
    _, (signal,) = sample_with_memory(light, equipped, released_s + since_s)
    np.testing.assert_allclose(signal, 5e-3 * np.exp(-since_s / 20e-9), rtol=0.03)


def test_what_a_rise_finds_can_be_undone():
    """Signal and power of the point that it meets are inverse, on what is held and with half of the cells."""
    bare = sensor("table1-sipm", STEADY, *KEYS).working_point(np.array([DIM_W]))
    working_point = Residue(floor=np.zeros(1), held=np.array([20.0]), share=np.array([0.5])).working_point(bare)
    power = np.geomspace(1e-10, 1e-7, 20)
    assert working_point.response.signal(power)[0] == pytest.approx(20.0 + 0.5 * bare.response.signal(power)[0])
    np.testing.assert_allclose(working_point.response.power_w(working_point.response.signal(power)), power, rtol=1e-9)


@pytest.mark.parametrize("background_w", [5e-7, 4e-5], ids=["bright", "blinding"])
def test_cells_in_strong_light_stay_finite_on_the_device(mi, background_w):
    """Fog before a wall meets a memory that is still empty, and exp(r t) of the time until the wall, from which places
    count, overflowed in single precision. A ready cell fires 14 and 1,100 times in a dead time.

    Tolerance: single precision knows the ready share, 1 / 1,100, to 6e-5, and a count to ten times that.
    """
    equipped = sensor("table1-sipm", IN_TIME, *KEYS, "detector.cells=700")
    light = trains.in_fog(equipped, np.geomspace(0.1, 1e3, 60), wall_m=40.0)
    light = replace(light, background_power_w=np.full(60, background_w))
    host = detect(light, equipped)
    assert np.isfinite(host.snr).all()
    np.testing.assert_allclose(trains.detect_on_device(light, equipped).snr, host.snr, rtol=1e-3)
