"""Noise and gain of a diode against textbooks and counted electrons."""

import numpy as np
import pytest
from scipy.constants import e, k

from lidarscene import load_sensor
from lidarscene.physics.electronics import apd
from lidarscene.sensor.detectors import Apd


def test_thermal_noise_of_a_textbook_resistor():
    """sqrt(4 k T B / R) for 1 kohm, 290 K, 1 Hz is 4.0 pA: the number in every electronics book."""
    variance = apd.thermal_variance_a2(temperature_k=290.0, load_resistance_ohm=1000.0, bandwidth_hz=1.0)
    assert np.sqrt(variance) == pytest.approx(4.0e-12, rel=1e-3)


def test_shot_noise_of_counted_electrons():
    """2 e i B is the variance of the current of Poisson electrons averaged over 1 / (2 B)."""
    rng = np.random.default_rng(2)
    bandwidth, current = 167e6, 5e-9
    window = 1.0 / (2.0 * bandwidth)
    counted = rng.poisson(current * window / e, 400_000) * e / window
    variance = apd.light_shot_variance_a2(
        responsivity_a_w=1.0, gain=1.0, excess_noise=1.0, bandwidth_hz=bandwidth, power_w=current
    )
    # The variance of 4e5 Poisson numbers is good to 0.23 %; 4 standard errors.
    assert counted.var() == pytest.approx(variance, rel=0.01)


def test_dark_current_noise():
    variance = apd.dark_shot_variance_a2(
        surface_dark_current_a=1e-10, bulk_dark_current_a=2e-10, gain=10.0, excess_noise=3.0, bandwidth_hz=1e8
    )
    assert variance == pytest.approx(2 * e * 1e8 * (1e-10 + 2e-10 * 300.0), rel=1e-9)


def test_excess_noise_forms():
    """McIntyre: F = M for k = 1, F -> 2 for k = 0; the power law with x = 0.3 is 3.72 at M = 80."""
    assert apd.excess_noise_mcintyre(gain=80.0, ionisation_ratio=1.0) == pytest.approx(80.0)
    assert apd.excess_noise_mcintyre(gain=1e6, ionisation_ratio=0.0) == pytest.approx(2.0, rel=1e-5)
    assert apd.excess_noise_power_law(gain=80.0, index=0.3) == pytest.approx(80.0**0.3, rel=1e-12)


def test_best_gain_is_best():
    """The derived optimum against a search; the text's "optical equals electrical noise" misses it."""
    a_and_b, c, x = 3e-19, 4e-16, 0.3
    gains = np.geomspace(1.0, 1e4, 200_001)
    searched = gains[np.argmax(gains / np.sqrt(a_and_b * gains ** (2 + x) + c))]
    gain = apd.best_gain(multiplied_variance_a2=a_and_b, unmultiplied_variance_a2=c, excess_noise_index=x)
    assert gain == pytest.approx(searched, rel=1e-4)  # the grid's step
    assert a_and_b * gain ** (2 + x) / c == pytest.approx(2.0 / x, rel=1e-9)


def test_gain_from_bias():
    """Miller's formula; the printed one has V_bias / V_bd inside the power at n = 1 only."""
    assert apd.gain_from_bias_miller(bias_v=150.0, breakdown_v=160.0, exponent=1.0) == pytest.approx(16.0)
    assert apd.gain_from_bias(bias_v=150.0, breakdown_v=160.0, exponent=1.0) == pytest.approx(16.0)
    assert apd.gain_from_bias(bias_v=150.0, breakdown_v=160.0, exponent=0.5) == pytest.approx(4.0)


def test_mcintyre_detector_uses_its_ratio():
    plain = load_sensor("table1-apd").detector
    assert isinstance(plain, Apd)
    import dataclasses

    mcintyre = dataclasses.replace(plain, excess_noise_index=None, ionisation_ratio=0.02)
    assert mcintyre.excess_noise == pytest.approx(0.02 * 80 + 0.98 * (2 - 1 / 80))


def test_electrical_noise_floor_of_table_1():
    """Noise without light: thermal noise of 10 kohm and dark current, typed out."""
    sensor = load_sensor("table1-apd")
    excess = 80.0**0.3
    dark = 2 * e * (1e-10 + 1e-10 * 6400 * excess) * 167e6
    expected = np.sqrt(4 * k * 300.0 * 167e6 / 1e4 + dark)
    assert sensor.working_point(0.0).noise.deviation == pytest.approx(expected, rel=1e-9)
