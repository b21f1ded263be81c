"""Comparison with SimSiPM (MIT, `pip install SiPM`, tried with 2.1.0), another hand's event simulation.

No dependency: skipped where it is not installed. Its cells have no dead time, their charge recovers; ours are
given a dead time of a hundredth of the recovery. Release 2.1.0 lets the charge recover from the *first* hit of the
event in the cell, ours from the last avalanche, which empties the cell again. So what is compared is either flashes,
where nothing recovers, or the charge by our rule of their hits.
"""

import dataclasses
import math

import numpy as np
import pytest

from validation.sipm_events.cells import CellArray, Light
from validation.sipm_events.events import simulate
from validation.sipm_events.output import waveforms

SiPM = pytest.importorskip("SiPM", reason="SimSiPM is not installed: pip install SiPM")

RISE_NS, FALL_NS, STEP_NS = 1.0, 20.0, 0.5
CELLS = CellArray(
    cells=400,
    pde=1.0,
    dead_time_s=0.2e-9,
    recovery_s=FALL_NS * 1e-9,
    shape="exponential",
    rise_s=RISE_NS * 1e-9,
    fall_s=FALL_NS * 1e-9,
)
LENGTH_NS, PEAK_NS, EVENTS = 300.0, 150.0, 1000


def simsipm(dark_hz=0.0):
    """20 x 20 cells without noise, crosstalk, afterpulses or spread of gain."""
    properties = SiPM.SiPMProperties()
    for name, value in {
        "Size": 0.5,
        "Pitch": 25.0,
        "Sampling": STEP_NS,
        "SignalLength": LENGTH_NS,
        "RiseTime": RISE_NS,
        "FallTimeFast": FALL_NS,
        "RecoveryTime": FALL_NS,
        "Ccgv": 0.0,
        "Snr": 100.0,
        "PdeType": SiPM.SiPMProperties.PdeType.kNoPde,
    }.items():
        getattr(properties, f"set{name}")(value)
    for name in ("Xt", "Ap", "DXt", "Dcr"):
        getattr(properties, f"set{name}Off")()
    if dark_hz:
        properties.setDcrOn()
        properties.setDcr(dark_hz)
    assert properties.nCells() == 400
    sensor = SiPM.SiPMSensor(properties)
    sensor.rng().seed(1)
    return sensor


def their_waves(sensor, photons, fwhm_ns):
    random = np.random.default_rng(2)
    waves = []
    for _ in range(EVENTS):
        sensor.resetState()
        count = random.poisson(photons)
        sensor.addPhotons(list(random.normal(PEAK_NS, fwhm_ns / math.sqrt(8 * math.log(2)), count)))
        sensor.runEvent()
        waves.append(np.array(sensor.signal().waveform()))
    return np.array(waves)


def our_waves(array, light):
    start = -PEAK_NS * 1e-9
    samples = round(LENGTH_NS / STEP_NS)
    return np.concatenate(
        [
            waveforms(array, a, shots=n, start_s=start, step_s=STEP_NS * 1e-9, samples=samples)
            for n, a in simulate(array, light, start_s=start, end_s=start + LENGTH_NS * 1e-9, shots=EVENTS, seed=3)
        ]
    )


@pytest.mark.parametrize("photons", [40.0, 400.0, 1500.0])
def test_flash(photons):
    """Mean charge of a flash, linear to saturated: 4 standard errors of both, and 0.5 % for their sampling.

    Their pulse is sampled from each avalanche's own start, rounded to half a nanosecond.
    """
    energy = 2.0 * math.sqrt(math.pi / (4 * math.log(2)))
    light = Light(background_photons=0.0, signal_photons=photons / energy, pulse_fwhm_s=1e-12)
    flash = dataclasses.replace(CELLS, dead_time_s=1e-11)
    theirs = their_waves(simsipm(), photons, 1e-3).sum(axis=1)
    ours = our_waves(flash, light).sum(axis=1)
    error = math.hypot(theirs.std(), ours.std()) / math.sqrt(EVENTS)
    assert ours.mean() == pytest.approx(theirs.mean(), abs=4 * error + 5e-3 * theirs.mean())
    # A standard deviation is known to 1 / sqrt(2 n) = 2.2 % each.
    assert ours.std() == pytest.approx(theirs.std(), rel=4 * 0.032)
    fired = 400 * -math.expm1(-photons / 400)
    assert theirs.mean() / fired == pytest.approx(23.4 / STEP_NS, rel=0.02)


@pytest.mark.parametrize("photons", [40.0, 400.0, 1500.0])
def test_charge_of_a_long_pulse(photons):
    """A pulse as long as the recovery: sum of gains over their hits by our rule, and over our avalanches."""
    random, sensor = np.random.default_rng(4), simsipm()
    theirs = []
    for _ in range(300):
        sensor.resetState()
        sensor.addPhotons(list(random.normal(PEAK_NS, 20.0 / math.sqrt(8 * math.log(2)), random.poisson(photons))))
        sensor.runEvent()
        last, charge = dict[tuple[int, int], float](), 0.0
        for time, cell in sorted((hit.time(), (hit.row(), hit.col())) for hit in sensor.hits()):
            charge += -math.expm1(-(time - last.get(cell, -math.inf)) / FALL_NS)
            last[cell] = time
        theirs.append(charge)
    energy = 2.0 * math.sqrt(math.pi / (4 * math.log(2)))
    light = Light(background_photons=0.0, signal_photons=photons / energy, pulse_fwhm_s=20e-9)
    cells = dataclasses.replace(CELLS, dead_time_s=0.01e-9)
    ours = np.zeros(0)
    for count, avalanches in simulate(cells, light, start_s=-60e-9, end_s=60e-9, shots=3000, seed=5):
        ours = np.append(ours, np.bincount(avalanches.shot, weights=avalanches.gain, minlength=count))
    error = math.hypot(np.std(theirs) / math.sqrt(300), ours.std() / math.sqrt(3000))
    assert ours.mean() == pytest.approx(np.mean(theirs), abs=4 * error)
    assert ours.std() == pytest.approx(np.std(theirs), rel=4 * 0.043)


def test_dark_counts():
    """Mean level and its variance under dark counts alone, late enough that their array is stationary."""
    rate_hz = 2e5
    theirs = their_waves(simsipm(400 * rate_hz), 0.0, 1.0)[:, 400:].mean(axis=1)
    dark = dataclasses.replace(CELLS, dark_count_rate_hz=rate_hz)
    ours = our_waves(dark, Light(background_photons=0.0))[:, 400:].mean(axis=1)
    error = math.hypot(theirs.std(), ours.std()) / math.sqrt(EVENTS)
    assert ours.mean() == pytest.approx(theirs.mean(), abs=4 * error)
    assert ours.std() == pytest.approx(theirs.std(), rel=4 * 0.032)
