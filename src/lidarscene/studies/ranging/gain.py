"""Gain of an avalanche photodiode for the best signal-to-noise ratio, in closed form and by search.

The closed form shows what the gain depends on; the search is exact. Their difference is what the closed form neglects.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...physics.electronics import apd
from ...sensor.detectors import Apd
from ...sensor.model import Sensor
from . import plane
from .plane import Target

_HIGHEST = 1e6


@dataclass(frozen=True, slots=True)
class BestGain:
    """Gains for the best SNR under one background.

    closed_form  from d SNR / dM = 0: `physics.electronics.apd.best_gain` or `best_gain_mcintyre`; at least one, inf if
                 only multiplied noise limits and there is no excess noise
    searched     by golden section on the exact SNR, from 1 to 1e6
    snr_share    the sensor's SNR at its own gain over that at the searched one
    """

    closed_form: float
    searched: float
    snr_share: float


def best_gain(sensor: Sensor, target: Target, *, range_m: float = 100.0) -> BestGain:
    """Compute the best gain for this target. Raises ValueError for a detector without gain.

    range_m   distance of the target; it matters only through the air's extinction, which dims the background too
    """
    diode = sensor.detector
    if not isinstance(diode, Apd):
        raise ValueError(f"the detector of '{sensor.name}' has no gain to choose")

    def snr_at(gain: float) -> float:
        tuned = dataclasses.replace(sensor, detector=dataclasses.replace(diode, gain=gain))
        return float(plane.snr(tuned, target, range_m)[0])

    searched = _golden_section(snr_at)
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


def _golden_section(function: Any) -> float:
    """Gain at the maximum of a unimodal function, by golden-section search on a logarithmic axis."""
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    low, high = 0.0, math.log(_HIGHEST)
    inner_low, inner_high = high - golden * (high - low), low + golden * (high - low)
    snr_low, snr_high = function(math.exp(inner_low)), function(math.exp(inner_high))
    while high - low > 1e-9:
        if snr_low >= snr_high:
            high, inner_high, snr_high = inner_high, inner_low, snr_low
            inner_low = high - golden * (high - low)
            snr_low = function(math.exp(inner_low))
        else:
            low, inner_low, snr_low = inner_low, inner_high, snr_high
            inner_high = low + golden * (high - low)
            snr_high = function(math.exp(inner_high))
    return float(np.exp(0.5 * (low + high)))
