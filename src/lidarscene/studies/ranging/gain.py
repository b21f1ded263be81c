"""Gain of an avalanche photodiode for the best signal-to-noise ratio, in closed form and by search.

The closed form shows what the gain depends on; the search is exact. Their difference is what the closed form neglects.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from ...physics.electronics import apd
from ...sensor.detectors import Apd
from ...sensor.sensor_model import Sensor
from . import plane
from .plane import Target

_HIGHEST = 1e6
"""Choice: largest gain that is tried: no diode reaches it."""


@dataclass(frozen=True, slots=True)
class BestGain:
    """Gains for the best SNR under one background.

    Attributes:
        closed_form: from d SNR / dM = 0: `physics.electronics.apd.best_gain` or `best_gain_mcintyre`; at least one, inf
            if only multiplied noise limits and there is no excess noise
        searched: maximum of the exact SNR, from 1 to 1e6
        snr_share: the sensor's SNR at its own gain over that at the searched one
    """

    closed_form: float
    searched: float
    snr_share: float


def best_gain(sensor: Sensor, target: Target, *, range_m: float = 100.0) -> BestGain:
    """Compute the best gain for this target.

    Args:
        range_m: distance of the target; it matters only through the air's extinction, which dims the background too

    Raises:
        ValueError: for a detector without gain
    """
    diode = sensor.detector
    if not isinstance(diode, Apd):
        raise ValueError(f"the detector of '{sensor.name}' has no gain to choose")

    def snr_at(gain: float) -> float:
        tuned = dataclasses.replace(sensor, detector=dataclasses.replace(diode, gain=gain))
        return float(plane.snr(tuned, target, range_m)[0])

    from scipy.optimize import minimize_scalar

    peak = minimize_scalar(
        lambda log_gain: -snr_at(math.exp(log_gain)),
        bounds=(0.0, math.log(_HIGHEST)),
        method="bounded",
        options={"xatol": 1e-9},
    )
    searched = math.exp(peak.x)
    share = snr_at(float(diode.gain)) / snr_at(searched)
    return BestGain(_closed_form(sensor, diode, target, range_m), searched, share)


def _closed_form(sensor: Sensor, diode: Apd, target: Target, range_m: float) -> float:
    """Best gain from the parts of the noise (18): multiplied noise, at gain one, and unmultiplied noise."""
    background = float(np.ravel(plane.echoes_of_plane(sensor, target, range_m).background_power_w)[0])
    bandwidth = float(sensor.tdc.bandwidth_hz)
    responsivity = apd.responsivity_a_w(
        quantum_efficiency=diode.quantum_efficiency, photon_energy_j=sensor.laser.photon_energy_j
    )
    per_ampere = apd.shot_variance_per_ampere_a(gain=1.0, excess_noise=1.0, bandwidth_hz=bandwidth)
    parts = {
        "multiplied_variance_a2": float(per_ampere * (responsivity * background + diode.bulk_dark_current_a)),
        "unmultiplied_variance_a2": float(diode.unmultiplied_variance_a2(bandwidth)),
    }
    if parts["unmultiplied_variance_a2"] <= 0.0:
        return 1.0
    if parts["multiplied_variance_a2"] <= 0.0:
        return math.inf
    if diode.ionisation_ratio is not None:
        ratio = float(diode.ionisation_ratio)
        if ratio <= 0.0:  # F = 2 - 1 / M: M = 2 c / (a + b)
            gain = 2.0 * parts["unmultiplied_variance_a2"] / parts["multiplied_variance_a2"]
        else:
            gain = float(apd.best_gain_mcintyre(ionisation_ratio=min(ratio, 1.0 - 1e-9), **parts))
    elif diode.excess_noise_index == 0.0:
        return math.inf
    else:
        assert diode.excess_noise_index is not None
        gain = float(apd.best_gain(excess_noise_index=diode.excess_noise_index, **parts))
    return max(gain, 1.0)
