"""Probability of a false alarm in one comparison, with several laws of an avalanche's noise."""

from __future__ import annotations

import dataclasses
import math
from typing import Literal, get_args

import numpy as np

from lidarscene.physics.constants import ELEMENTARY_CHARGE_C
from lidarscene.physics.electronics import apd, mcintyre
from lidarscene.physics.reference import mcintyre as reference_mcintyre
from lidarscene.sensor.detectors import Apd
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.studies.ranging.plane import Target
from lidarscene.studies.ranging.statistics import background_w, mean_over_points

Tail = Literal["gaussian", "mcintyre", "webb", "exact"]
TAILS: tuple[Tail, ...] = get_args(Tail)


def false_alarm_probability(sensor: Sensor, target: Target, *, sky: bool = False, tail: Tail | None = None) -> float:
    """P_f of one comparison, with the target's background. With `false_alarms = "crossings"` it sets no rate.

    Args:
        sky: True for the sky in place of the target; it is dark unless the target's light has a diffuse share
        tail: statistics of the noise; None: the sensor's own. For an APD also "gaussian" (9), "mcintyre" (saddle point,
            as `detector.tail`), "webb" (Webb's approximation of the electrons, averaged over the amplifier's noise) or
            "exact" (McIntyre's probabilities summed)
    """
    background = background_w(sensor, target, sky=sky)
    point = sensor.working_point(background)
    threshold = sensor.threshold(point)
    if tail is None:
        return float(np.ravel(mean_over_points(sensor, threshold, point.false_alarm_probability))[0])
    diode = sensor.detector
    if not isinstance(diode, Apd) or tail not in TAILS:
        raise ValueError(f"tail must be one of {', '.join(TAILS)}, for an APD, got '{tail}'")
    if tail == "gaussian" or tail == "mcintyre":
        changed = dataclasses.replace(sensor, detector=dataclasses.replace(diode, tail=tail))
        return false_alarm_probability(changed, target, sky=sky)
    numbers = electrons(sensor, float(background[0]))
    excess = float(np.ravel(threshold)[0]) * numbers.pop("per_ampere")
    excess_noise = numbers.pop("excess_noise")
    if tail == "exact":
        return reference_mcintyre.tail_probability_exact(excess=excess, **numbers)
    return webb_with_amplifier(excess, excess_noise=excess_noise, **numbers)


def electrons(sensor: Sensor, background_power_w: float) -> dict[str, float]:
    """An APD's background in electrons of one resolution time, for `mcintyre.tail_probability`.

    Also ``per_ampere``, electrons per ampere, and ``excess_noise``, F.

    Raises:
        ValueError: without an APD
    """
    diode = sensor.detector
    if not isinstance(diode, Apd):
        raise ValueError(f"the detector of '{sensor.name}' has no avalanche of McIntyre's kind")
    bandwidth = float(sensor.tdc.bandwidth_hz)
    per_ampere = float(mcintyre.resolution_time_s(bandwidth_hz=bandwidth) / ELEMENTARY_CHARGE_C)
    responsivity = apd.responsivity_a_w(
        quantum_efficiency=diode.quantum_efficiency, photon_energy_j=sensor.laser.photon_energy_j
    )
    primary_a = float(responsivity * background_power_w + diode.bulk_dark_current_a)
    excess = float(diode.excess_noise)
    ratio = mcintyre.ionisation_ratio(gain=diode.gain, excess_noise=excess)
    return {
        "primaries": primary_a * per_ampere,
        "gain": float(diode.gain),
        "ionisation_ratio": float(ratio),
        "amplifier": math.sqrt(diode.unmultiplied_variance_a2(bandwidth)) * per_ampere,
        "per_ampere": per_ampere,
        "excess_noise": excess,
    }


def webb_with_amplifier(
    excess: float, *, primaries: float, gain: float, ionisation_ratio: float, amplifier: float, excess_noise: float
) -> float:
    """Webb's tail, averaged over the amplifier's Gaussian noise."""
    # Weighted mean over an even grid of normal deviates; beyond 8 sigma lie 1e-15 of them.
    deviates = np.linspace(-8.0, 8.0, 3201)
    weight = np.exp(-0.5 * deviates**2)
    tail = reference_mcintyre.webb_tail(
        excess=excess - amplifier * deviates, primaries=primaries, gain=gain, excess_noise=excess_noise
    )
    return float((weight * tail).sum() / weight.sum())
