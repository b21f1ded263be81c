"""Noise and gain of a diode against textbooks and counted electrons."""

import numpy as np
import pytest
from scipy.constants import e

from lidarscene import load_sensor
from lidarscene.physics.electronics import apd
from lidarscene.sensor.detectors import Apd


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


def test_mcintyre_detector_uses_its_ratio():
    plain = load_sensor("table1-apd").detector
    assert isinstance(plain, Apd)
    import dataclasses

    mcintyre = dataclasses.replace(plain, excess_noise_index=None, ionisation_ratio=0.02)
    assert mcintyre.excess_noise == pytest.approx(0.02 * 80 + 0.98 * (2 - 1 / 80))
