"""The event simulation of a SiPM's cells against what is known of them without it.

Statistical comparisons are z-tests at fixed seeds: ``agree`` holds all elements of one comparison to one false-alarm
rate of 6e-5 (4 standard errors), Sidak-corrected.
"""

import dataclasses
import math

import numpy as np
import pytest
from helpers.run_seed import chosen
from scipy.integrate import trapezoid
from scipy.stats import binom, chisquare, norm

from lidarscene.physics.electronics import sipm, sipm_response
from validation.sipm_events.cells import CellArray, Light
from validation.sipm_events.coupled import fire_coupled
from validation.sipm_events.events import Avalanches, fire_independent, simulate
from validation.sipm_events.output import waveforms
from validation.sipm_events.table import response_by_equation, response_by_events
from validation.sipm_events.working_point import all_outputs, measure, moments, outputs, pulse_outputs

TAU = 6e-9
TABLE1 = CellArray(cells=400, pde=0.22, dead_time_s=TAU, dark_count_rate_hz=2007.0)
SILENT = dataclasses.replace(TABLE1, dark_count_rate_hz=0.0)
AT_100_M = Light(background_photons=686.093, signal_photons=2660.31, pulse_fwhm_s=6e-9)


def agree(measured, expected, error, *, false_alarm=6e-5):
    """Two-sided z-test on every element, Sidak-corrected to one false-alarm rate overall."""
    z = np.abs(np.asarray(measured) - np.asarray(expected)) / error
    alpha = -math.expm1(math.log1p(-false_alarm) / np.size(z))
    assert np.max(z) < norm.isf(0.5 * alpha), np.max(z)


def binomial_variance_error(*, share, cells, shots):
    """Standard error of a sample variance of binomial counts."""
    variance = cells * share * (1.0 - share)
    fourth = variance * (1.0 + 3.0 * (cells - 2.0) * share * (1.0 - share))
    return np.sqrt((fourth - variance**2) / shots)


@pytest.mark.parametrize(
    ("photons", "busy"), [(1.0, 0.22), (50.0, 10.7), (200.0, 39.7), (686.093, 109.6), (2000.0, 209.5)]
)
def test_busy_cells_are_binomial(photons, busy):
    """(T16): x / (1 + x), within its three digits; the counts are binomial, by mean and by Pearson's chi-square.

    Two samples two dead times apart: the start is stationary and stays so. Each check fails by chance in 6e-5.
    """
    shots = 2_500
    share = sipm.busy_share_steady_state(photons=photons, pde=0.22, cells=400, dark_count_rate_hz=0.0, dead_time_s=TAU)
    assert 400 * share == pytest.approx(busy, rel=5e-3)
    light = Light(background_photons=photons)
    time_s, wave = all_outputs(SILENT, light, start_s=0.0, end_s=2 * TAU, shots=shots, seed=1, steps=4)
    variance = sipm.busy_variance_steady_state(busy_share=share, cells=400)
    assert variance == pytest.approx(binom.var(400, share), rel=1e-12)
    agree(moments(time_s, wave).mean[[0, -1]], 400 * share, math.sqrt(variance / shots))
    for counts in (wave[:, 0], wave[:, -1]):
        expected, observed = binned(shots * binom.pmf(np.arange(401), 400, share), counts)
        assert chisquare(observed, expected).pvalue > 6e-5


def binned(expected, counts, least=20.0):
    """Expected and observed frequencies of counts 0, 1, ..., in bins of at least `least` expected ones each."""
    first = [0]
    for count in range(len(expected)):
        if expected[first[-1] : count].sum() >= least and expected[count:].sum() >= least:
            first.append(count)
    observed = np.bincount(np.rint(counts).astype(int), minlength=len(expected))
    return np.add.reduceat(expected, first), np.add.reduceat(observed, first)


@pytest.mark.parametrize(
    ("engine", "width"),
    chosen(2, [(fire_independent, 0.25), (fire_independent, 1.0), (fire_independent, 3.0), (fire_coupled, 1.0)]),
)
@pytest.mark.parametrize(("background", "signal"), [(10.0, 100.0), (686.093, 2660.31), (2000.0, 300.0)])
def test_the_count_is_binomial_all_along_the_pulse(engine, width, background, signal, monkeypatch):
    """Both engines against the busy share's equation, mean and variance at every fourth sample.

    The slow engine at one width: of the pulse both know nothing but `Rates`.
    """
    monkeypatch.setattr("validation.sipm_events.events.fire_independent", engine)
    shots = 1_000
    light = Light(background_photons=background, signal_photons=signal, pulse_fwhm_s=width * TAU)
    output = moments(*pulse_outputs(TABLE1, light, shots=shots, seed=3))
    x = background * 0.22 / 400 + 2007.0 * TAU
    whole = sipm_response.captured_photons(photons=signal, pulse_fwhm_s=1e-9, dead_time_s=1.0)
    time, busy = sipm_response.busy_share_over_time(
        background=np.array(x), flash=np.array(whole * 0.22 / 400), pulse_to_dead_time=width, steps=192
    )
    pick = slice(None, None, 4)
    share = np.interp(output.time_s[pick] / TAU, time, busy)
    variance = 400 * share * (1 - share)
    agree(output.mean[pick], 400 * share, np.sqrt(variance / shots))
    error = binomial_variance_error(share=share, cells=400, shots=shots)
    agree(output.variance[pick], variance, error)


def test_weak_background_gives_the_paper():
    """(23)-(27) where x is far below one, with a pulse far shorter than tau and (24) given its photons."""
    shots, background, whole = 20_000, 20.0, 300.0
    factor = sipm_response.captured_photons(photons=1.0, pulse_fwhm_s=0.02 * TAU, dead_time_s=TAU)
    assert factor == pytest.approx(2.128934, abs=1e-6)
    light = Light(background_photons=background, signal_photons=whole / factor, pulse_fwhm_s=0.02 * TAU)
    time_s, wave = pulse_outputs(TABLE1, light, shots=shots, seed=4, steps=200)
    output = moments(time_s, wave)
    busy = 400 * sipm.fired_share_published(photons=background, pde=0.22, cells=400)
    dark = sipm.dark_counts(cells=400, dark_count_rate_hz=2007.0, dead_time_s=TAU)
    variance = sipm.fired_variance_published(fired=busy, cells=400) + dark
    fired = (400 - busy - dark) * sipm.fired_share_published(photons=whole, pde=0.22, cells=400)
    # x = 0.011: (23) is x / 2 above the truth, (22) pde / 2N = 0.03 % below; statistics on top.
    error = math.sqrt(variance / shots)
    assert output.mean[0] == pytest.approx(busy + dark, rel=0.011 / 2, abs=4 * error)
    assert output.variance[0] == pytest.approx(variance, rel=0.011 / 2 + 4 * math.sqrt(2 / shots))
    signal = output.mean[-1] - output.mean[0]
    assert signal == pytest.approx(fired, rel=1e-3, abs=4 * math.sqrt(2 * output.variance[-1] / shots))
    snr = signal / math.sqrt(output.variance[0])
    assert snr == pytest.approx(fired / math.sqrt(variance), rel=0.03)


def test_detection_is_the_binomial_tail():
    """P_d at the peak and P_f of a sample by exact counting; the Gaussian of (9) is not enough at low light."""
    shots = 20_000
    light = Light(background_photons=30.0, signal_photons=30.0, pulse_fwhm_s=6e-9)
    # 6.5 cells are busy before: the level is 15.7, well off the whole numbers.
    measured = measure(TABLE1, light, threshold=9.2, shots=shots, seed=5)
    x = 30.0 * 0.22 / 400 + 2007.0 * TAU
    before = x / (1 + x)
    table = response_by_equation(TABLE1, background_photons=[30.0], signal_photons=[30.0], pulse_fwhm_s=6e-9)
    least = math.ceil(measured.before + 9.2)
    expected = binom.sf(least - 1, 400, table.mean[0, 0] / 400)
    assert 0.2 < expected < 0.9
    agree(measured.detection_probability, expected, math.sqrt(expected * (1 - expected) / shots))
    assert measured.tripped > measured.detection_probability
    p_false = binom.sf(least - 1, 400, before)
    # 321 samples a shot over 20 dead times: some 20 independent ones.
    error = math.sqrt(p_false / (shots / 10 * 20))
    agree(measured.false_alarm_probability, p_false, error)
    assert p_false > 3.0 * norm.sf(9.5 / measured.noise)


def upcrossing_rate(*, least, share, rate, tau, step):
    """Rate at which samples ``step`` apart pass from below ``least`` to it, two-sample joint of cells, exact."""
    cells = np.arange(401)
    # Busy at both: the same avalanche lasts, or the cell revives and fires again before the second sample.
    refired = (share / tau) * (step - (1 - np.exp(-rate * step)) / rate)
    at_both = share * (1 - step / tau) + refired
    stay, new = at_both / share, (share - at_both) / (1 - share)
    first = binom.pmf(cells, 400, share)
    up = 0.0
    for count in range(least):
        staying = binom.pmf(np.arange(count + 1), count, stay)
        refills = least - np.arange(count + 1)
        up += first[count] * np.sum(staying * binom.sf(refills - 1, 400 - count, new))
    return up / step


@pytest.mark.parametrize("steps", [1, 16])
def test_rate_of_false_alarms(steps):
    """First passages come at the rate of upward crossings while these are rare, on the sampling grid.

    A comparator that looks once in a dead time sees P_f B_w of (10); one that looks oftener sees more.
    """
    # No pulse, and so a short look for it.
    shots, light = 12_000, Light(background_photons=200.0, pulse_fwhm_s=0.2e-9)
    x = 200.0 * 0.22 / 400 + 2007.0 * TAU
    share, level = x / (1 + x), 17.0
    measured = measure(TABLE1, light, threshold=level, shots=shots, seed=6, steps=steps)
    least = math.ceil(400 * share + level)
    assert math.ceil(measured.before + level) == least
    expected = upcrossing_rate(least=least, share=share, rate=x / TAU, tau=TAU, step=TAU / steps)
    alarms = expected * 20 * TAU * shots / 10
    assert alarms > 50
    # Crossings come in clusters, and the first of a cluster ends the watch.
    assert 0.5 < measured.false_alarm_rate_hz / expected < 1.0 + 4 / math.sqrt(alarms)
    p_false = binom.sf(least - 1, 400, share)
    ratio = measured.false_alarm_rate_hz * TAU / p_false
    assert (0.7 < ratio < 1.3) if steps == 1 else ratio > 2.5


def test_timing_is_that_of_the_edge():
    """A strong echo crosses early, and its jitter is noise over slope: 10 % (counts are steps, an edge bends; the
    deviations of 2,000 shots are good to 1.6 % each).
    """
    measured = measure(TABLE1, AT_100_M, shots=2_000, seed=7, steps=32)
    light = AT_100_M
    time_s, wave = pulse_outputs(TABLE1, light, shots=2_000, seed=8, steps=32)
    edge = moments(time_s, wave)
    level = measured.before + measured.threshold
    crossing_s = np.interp(level, edge.mean[: np.argmax(edge.mean)], edge.time_s[: np.argmax(edge.mean)])
    slope = np.interp(crossing_s, edge.time_s, np.gradient(edge.mean, edge.time_s))
    noise = math.sqrt(np.interp(crossing_s, edge.time_s, edge.variance))
    assert measured.crossing_s == pytest.approx(crossing_s, abs=0.1e-9)
    assert measured.crossing_deviation_s == pytest.approx(noise / slope, rel=0.1)
    weak = measure(TABLE1, dataclasses.replace(light, signal_photons=600.0), shots=2_000, seed=7, steps=32)
    assert weak.crossing_s > measured.crossing_s + 1e-9
    assert weak.crossing_deviation_s > 1.5 * measured.crossing_deviation_s


def test_same_seed_same_shots():
    runs = [
        np.concatenate([w for _, w in outputs(TABLE1, AT_100_M, start_s=-TAU, end_s=0.0, shots=500, seed=s)])
        for s in (1, 1, 2)
    ]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert (runs[0] != runs[2]).any()


def test_recovery_weakens_and_the_engines_agree():
    """Both recoveries on, both engines: nothing is known in closed form but that they must agree."""
    array = dataclasses.replace(TABLE1, cells=200, recovery_s=4e-9, trigger_recovery_s=3e-9)
    light = Light(background_photons=500.0, signal_photons=500.0, pulse_fwhm_s=6e-9)
    shots = 400
    window = {"start_s": -6e-9, "end_s": 3e-9, "shots": shots, "seed": 9}
    step = TAU / 4
    outputs = []
    for engine in (fire_independent, fire_coupled):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("validation.sipm_events.events.fire_independent", engine)
            waves = [
                waveforms(array, a, shots=n, start_s=-6e-9, step_s=step, samples=7)
                for n, a in simulate(array, light, **window)
            ]
        outputs.append(moments(np.arange(7), np.concatenate(waves)))
    independent, coupled = outputs
    agree(independent.mean, coupled.mean, np.sqrt((independent.variance + coupled.variance) / shots))
    agree(independent.variance, coupled.variance, independent.variance * math.sqrt(4 / shots))
    x = 500.0 * 0.22 / 200
    assert independent.mean[0] < 0.9 * 200 * x / (1 + x)


def test_crosstalk_and_afterpulses_add_as_branching():
    """Cells are free in the dark: p of crosstalk makes 1 / (1 - p) avalanches of one, and so on.

    Every avalanche is followed by p_c + p_a others, so the mean grows by 1 / (1 - p_c - p_a), less the afterpulses
    that come in the dead time, exp(-tau / delay) of which survive.
    """
    array = CellArray(cells=400, pde=0.5, dead_time_s=TAU, crosstalk=0.15, afterpulse=0.2, afterpulse_s=20e-9)
    light = Light(background_photons=2.0)
    total, shots = 0, 5_000  # 4 errors are 5 %; 9 % are missing without avalanches of avalanches
    for _, avalanches in simulate(array, light, start_s=0.0, end_s=2 * TAU, shots=shots, seed=10):
        inside = (avalanches.time_s > 0.0) & (avalanches.time_s <= 2 * TAU)
        total += int(np.count_nonzero(inside))
    survive = 0.2 * math.exp(-TAU / 20e-9)
    expected = 2.0 * shots / (1 - 0.15 - survive)
    # Clusters of mean m: variance of the total about m^2 times that of a Poisson count. Cells are 99.2 % free.
    error = math.sqrt(expected) / (1 - 0.15 - survive)
    assert abs(total - expected) < 4 * error + 0.01 * expected


def test_exponential_shape_sums_by_campbell():
    """Shot noise: mean rate times area, variance rate times the area of the square; dead time is negligible."""
    array = CellArray(cells=10_000, pde=1.0, dead_time_s=1e-9, shape="exponential", rise_s=2e-9, fall_s=10e-9)
    light = Light(background_photons=20.0)
    shots = 800
    time_s, wave = all_outputs(array, light, start_s=0.0, end_s=0.0, shots=shots, seed=11)
    output = moments(time_s, wave)
    rate = 20.0 / 1e-9 / (1 + 20.0 / 10_000)
    t = np.linspace(0.0, 300e-9, 300_001)
    pulse = np.exp(-t / 10e-9) - np.exp(-t / 2e-9)
    pulse /= pulse.max()
    mean, variance = rate * trapezoid(pulse, t), rate * trapezoid(pulse**2, t)
    agree(output.mean[0], mean, math.sqrt(variance / shots) + 4e-4 * mean)
    assert output.variance[0] == pytest.approx(variance, rel=4 * math.sqrt(2 / shots) + 5e-3)


def test_a_lone_avalanche_has_its_shape():
    for array in (
        dataclasses.replace(TABLE1, shape="exponential", rise_s=1e-9, fall_s=4e-9),
        dataclasses.replace(TABLE1, shape="exponential", fall_s=4e-9),
    ):
        avalanche = Avalanches(shot=np.array([0]), time_s=np.array([0.3e-9]), gain=np.array([0.5]))
        wave = waveforms(array, avalanche, shots=1, start_s=0.0, step_s=0.01e-9, samples=2000)[0]
        assert wave.max() == pytest.approx(0.5, rel=5e-3)
        assert wave[:30].max() == 0.0
        assert wave[-1] / wave[-401] == pytest.approx(math.exp(-1.0), rel=1e-3)


def test_tables_by_events_and_by_equation():
    grid = {"background_photons": [20.0, 700.0], "signal_photons": [50.0, 1000.0], "pulse_fwhm_s": 6e-9}
    events = response_by_events(TABLE1, **grid, shots=2_000, seed=12)
    exact = response_by_equation(TABLE1, **grid, steps=96)
    # The peak is sought in a noisy mean, which lifts it by a fraction of its error.
    agree(events.mean, exact.mean, 1.3 * np.sqrt(exact.variance / 2_000))
    agree(events.variance, exact.variance, exact.variance * math.sqrt(2.5 / 2_000))
    agree(events.skewness, exact.skewness, 1.2 * math.sqrt(6 / 2_000))
    np.testing.assert_allclose(events.snr, exact.snr, rtol=0.06)


@pytest.mark.parametrize(
    "change", [{"shape": "triangle"}, {"shape": "exponential"}, {"crosstalk": 1.0}, {"dead_time_s": 0.0}]
)
def test_cells_that_cannot_be(change):
    with pytest.raises(ValueError, match=r"must be|needs"):
        dataclasses.replace(TABLE1, **change)


def test_the_output_peaks_within_a_dead_time_of_the_light() -> None:
    """Rationale: cells are busy for one dead time, 6 ns here, and most of those that fire do so in the pulse."""
    table = response_by_equation(TABLE1, background_photons=[30.0], signal_photons=[30.0], pulse_fwhm_s=2e-9)
    assert 0.0 < table.peak_time_s[0, 0] < 6e-9
