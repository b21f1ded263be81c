"""Detection statistics of a sensor on a target: detection curves, detection against false alarms, simulated shots.

The formulas are those of `physics.electronics.tdc` and of the detector's working point, which `render` uses too.
Shots are simulated by `detection.receiver.detect`, on numpy with made-up echoes. No tracing, no LLVM.

Symbols: TNR threshold over noise, P_d detection and P_f false-alarm probability.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal, get_args

import numpy as np

from ...detection.outcomes import Outcome, Status
from ...detection.receiver import detect
from ...light.fluctuations import fluctuate
from ...maths.arrays import Lanes, Numbers
from ...physics.constants import ELEMENTARY_CHARGE_C, SPEED_OF_LIGHT_M_S
from ...physics.electronics import apd, mcintyre, tdc
from ...physics.optics import radiometry, sunlight
from ...sensor.detectors import Apd, WorkingPoint
from ...sensor.sensor_model import Sensor
from . import plane
from .plane import Target

Tail = Literal["gaussian", "mcintyre", "webb", "exact"]
TAILS: tuple[Tail, ...] = get_args(Tail)


_DEVIATES = [NormalDist().inv_cdf((k + 0.5) / 200.0) for k in range(200)]
"""Quantiles of the standard normal distribution at 200 equally likely places."""


@dataclass(frozen=True, slots=True)
class OperatingCurve:
    """Receiver operating characteristic: detection and false alarms over the threshold. All (n,), one for each
    threshold.

    threshold_to_noise     TNR
    false_alarms_per_shot  mean number of noise crossings in the whole window
    quiet_probability      probability of a whole window without any
    detection_probability  P_d of the echo
    correct_probability    (10): correct returns among all, for a target at the end of the window
    """

    threshold_to_noise: Numbers
    false_alarms_per_shot: Numbers
    quiet_probability: Numbers
    detection_probability: Numbers
    correct_probability: Numbers


@dataclass(frozen=True, slots=True)
class FalsePoints:
    """Expected false alarms among the points of one frame.

    per_pulse  mean number reported for one pulse
    per_frame  per_pulse times the pulses of a frame, all of them on the same target or sky
    """

    per_pulse: float
    per_frame: float


@dataclass(frozen=True, slots=True)
class ShotCounts:
    """Counts of simulated shots: reported echoes and reported false alarms."""

    shots: int
    echoes: int
    false_alarms: int

    @property
    def correct_share(self) -> float:
        """Correct returns among all; 1 if nothing was returned."""
        returned = self.echoes + self.false_alarms
        return self.echoes / returned if returned else 1.0


def detection_curve(sensor: Sensor, target: Target, snr: Numbers, *, own_noise: bool = True) -> Numbers:
    """(n,) P_d of echoes with these signal-to-noise ratios, under the target's background.

    own_noise   False leaves out the echo's own shot noise, so that P_d = Q(TNR - SNR) for a Gaussian
    """
    point = sensor.working_point(_background_w(sensor, target))
    signal = np.asarray(snr, dtype=np.float64) * point.noise.deviation
    sigma = point.noise.at(signal) if own_noise else point.noise.deviation + 0.0 * signal
    return np.asarray(point.detection_probability(sensor.threshold(point), signal, sigma))


def operating_curve(sensor: Sensor, target: Target, range_m: float, threshold_to_noise: Numbers) -> OperatingCurve:
    """Detection and false alarms for a target at this range, over the threshold."""
    ratios = np.asarray(threshold_to_noise, dtype=np.float64)
    varied = dataclasses.replace(sensor.tdc, threshold_to_noise=ratios, threshold_level=None)
    tuned = dataclasses.replace(sensor, tdc=varied)
    light = plane.echoes_of_plane(sensor, target, range_m)
    point = tuned.working_point(light.background_power_w, range_m=light.range_m)
    threshold = tuned.threshold(point) + 0.0 * ratios  # the shape of the ratios, also where they do not matter
    variance = plane.fluctuation_variance(sensor, target, light.range_m)
    p_detect = np.asarray(plane.expected_probability(point, threshold, light.peak_power_w + 0.0 * ratios, variance))
    rate_hz = np.asarray(_alarms_hz(sensor, point, threshold))
    p_false = -np.expm1(-rate_hz / sensor.tdc.bandwidth_hz)  # of one comparison, as in (10)
    comparisons = tdc.comparisons(window_s=sensor.tdc.listening_s, bandwidth_hz=sensor.tdc.bandwidth_hz)
    mean = rate_hz * sensor.tdc.listening_s
    return OperatingCurve(
        threshold_to_noise=ratios,
        false_alarms_per_shot=mean,
        quiet_probability=np.exp(-mean),
        detection_probability=p_detect,
        correct_probability=np.asarray(
            tdc.correct_probability(p_false=p_false, p_detect=p_detect, comparisons=comparisons)
        ),
    )


def detection_probability(sensor: Sensor, target: Target, range_m: float) -> float:
    """P_d of the target at this range."""
    light = plane.echoes_of_plane(sensor, target, range_m)
    point = sensor.working_point(light.background_power_w, range_m=light.range_m)
    variance = plane.fluctuation_variance(sensor, target, light.range_m)
    probability = plane.expected_probability(point, sensor.threshold(point), light.peak_power_w, variance)
    return float(np.ravel(probability)[0])


def false_alarm_probability(sensor: Sensor, target: Target, *, sky: bool = False, tail: Tail | None = None) -> float:
    """P_f of one comparison, with the target's background. With `false_alarms = "crossings"` it sets no rate.

    sky    True for the sky in place of the target; it is dark unless the target's light has a diffuse share
    tail   statistics of the noise; None: the sensor's own. For an APD also "gaussian" (9), "mcintyre" (saddle point, as
           `detector.tail`), "webb" (Webb's approximation of the electrons, averaged over the amplifier's noise) or
           "exact" (McIntyre's probabilities summed)
    """
    background = _background_w(sensor, target, sky)
    point = sensor.working_point(background)
    threshold = sensor.threshold(point)
    if tail is None:
        return float(np.ravel(_mean_over_points(sensor, threshold, point.false_alarm_probability))[0])
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
        return mcintyre.tail_probability_exact(excess=excess, **numbers)
    return _webb_with_amplifier(excess, excess_noise=excess_noise, **numbers)


def false_points(sensor: Sensor, target: Target, range_m: float | None = None) -> FalsePoints:
    """Expected false points of a frame whose pulses all meet this target, or for a range of None the sky.

    Exact for the Poisson alarms of (10) and a converter of any number of stops: alarms before the echo may take its
    stop, and alarms after it need a stop that is still free.
    """
    point = sensor.working_point(_background_w(sensor, target, range_m is None))
    rate = float(np.ravel(_alarms_hz(sensor, point, sensor.threshold(point)))[0])
    blanking_s, window_s = float(sensor.tdc.blanking_s), float(sensor.tdc.window_s)
    stops = sensor.tdc.stops
    per_pulse = _mean_of_first(rate * (window_s - blanking_s), stops)
    arrival_s = math.inf if range_m is None else 2.0 * range_m / SPEED_OF_LIGHT_M_S
    if range_m is not None and blanking_s <= arrival_s < window_s:
        p_detect = detection_probability(sensor, target, range_m)
        before, after = rate * (arrival_s - blanking_s), rate * (window_s - arrival_s)
        # With n alarms before it, the echo takes a stop if n < stops; stops - 1 - n are then free for alarms after it.
        with_echo = _mean_of_first(before, stops) + sum(
            _poisson(before, n) * _mean_of_first(after, stops - 1 - n) for n in range(stops)
        )
        per_pulse = p_detect * with_echo + (1.0 - p_detect) * per_pulse
    return FalsePoints(per_pulse, per_pulse * sensor.scanner.pulses)


def simulated_shots(
    sensor: Sensor, target: Target, range_m: float | None, *, shots: int = 100_000, seed: int = 0
) -> ShotCounts:
    """Simulate pulses at a target, or for a range of None into the sky, by `receiver.detect` on NumPy."""
    ones = np.ones(shots)
    echoes = plane.echoes_of_plane(sensor, target, ones if range_m is None else range_m * ones)
    if range_m is None:
        background = _background_w(sensor, target, True) * ones
        echoes = dataclasses.replace(
            echoes, has_surface=ones < 0.0, peak_power_w=0.0 * ones, background_power_w=background
        )
    pulse = np.arange(shots, dtype=np.uint32)
    variance = plane.fluctuation_variance(sensor, target, echoes.range_m)
    if variance is not None:
        echoes = fluctuate(echoes, variance, seed=seed, pulse=pulse)
    detection = detect(echoes, sensor, seed=seed, pulse=pulse)
    alarms = sum(
        int(np.sum(np.asarray(stop.reported & (stop.status == int(Status.FALSE_ALARM))))) for stop in detection.stops
    )
    return ShotCounts(shots, int(np.sum(detection.outcome == int(Outcome.KEPT))), alarms)


def end_of_window(sensor: Sensor, range_m: float) -> Sensor:
    """The sensor with its window closed just after an echo of this range, as in (10)."""
    end_s = 2.0 * range_m / SPEED_OF_LIGHT_M_S + 0.5 * float(sensor.received_fwhm_s)
    return dataclasses.replace(sensor, tdc=dataclasses.replace(sensor.tdc, window_s=end_s))


def electrons(sensor: Sensor, background_power_w: float) -> dict[str, float]:
    """An APD's background in electrons of one resolution time, for `mcintyre.tail_probability`.

    Also ``per_ampere``, electrons per ampere, and ``excess_noise``, F. Raises ValueError without an APD.
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


def _background_w(sensor: Sensor, target: Target, sky: bool = False) -> Numbers:
    """(1,) light on the detector in W from the target or the sky."""
    if not sky:
        return np.asarray(plane.echoes_of_plane(sensor, target, 1.0).background_power_w)
    sun = sunlight.sun_irradiance_w_m2(
        irradiance_at_100_klux_w_m2=sensor.optics.sun_irradiance_w_m2, illuminance_klux=target.illuminance_klux
    )
    sky_irradiance = sunlight.sky_irradiance_w_m2(sun_irradiance_w_m2=sun, diffuse_share=target.diffuse_share)
    power = radiometry.background_power_w(
        radiance_w_m2_sr=sunlight.sky_radiance_w_m2_sr(sky_irradiance_w_m2=sky_irradiance),
        aperture_m2=sensor.optics.aperture_m2 * target.aperture_share,
        transmittance=target.transmittance,
        field_of_view_sr=radiometry.field_of_view_solid_angle_sr(
            detector_radius_m=sensor.detector.radius_m, focal_length_m=sensor.optics.focal_length_m
        ),
        efficiency=sensor.optics.efficiency_sun,
    )
    return np.atleast_1d(np.asarray(power, dtype=np.float64))


def _alarms_hz(sensor: Sensor, point: WorkingPoint, threshold: Lanes) -> Lanes:
    """Rate of false alarms."""
    return _mean_over_points(sensor, threshold, lambda level: sensor.false_alarm_rate_hz(point, level))


def _mean_over_points(sensor: Sensor, threshold: Lanes, formula: Callable[[Lanes], Lanes]) -> Lanes:
    """Mean of a formula over the thresholds that the noise of the points meets, where these scatter (T111)."""
    histogram = sensor.histogram
    if histogram is None:
        return formula(threshold)
    if histogram.threshold_spread is None or histogram.neighbours:
        return formula(histogram.threshold_of_noise(threshold, 0.0))
    values = [np.asarray(formula(histogram.threshold_of_noise(threshold, place))) for place in _DEVIATES]
    return np.asarray(np.mean(values, axis=0))


def _webb_with_amplifier(
    excess: float, *, primaries: float, gain: float, ionisation_ratio: float, amplifier: float, excess_noise: float
) -> float:
    """Webb's tail, averaged over the amplifier's Gaussian noise."""
    # Weighted mean over an even grid of normal deviates; beyond 8 sigma lie 1e-15 of them.
    deviates = np.linspace(-8.0, 8.0, 3201)
    weight = np.exp(-0.5 * deviates**2)
    tail = mcintyre.webb_tail(
        excess=excess - amplifier * deviates, primaries=primaries, gain=gain, excess_noise=excess_noise
    )
    return float((weight * tail).sum() / weight.sum())


def _poisson(mean: float, count: int) -> float:
    return math.exp(-mean) * mean**count / math.factorial(count)


def _mean_of_first(mean: float, stops: int) -> float:
    """Mean of min(N, stops) for Poisson N: the sum of P(N >= n) for n from 1 to stops."""
    at_least, total = -math.expm1(-mean), 0.0
    for n in range(1, stops + 1):
        total += at_least
        at_least = max(at_least - _poisson(mean, n), 0.0)
    return total
