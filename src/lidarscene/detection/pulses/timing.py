"""Timing: the time that the TDC reports of a pulse, by one of four rules.

A comparator times the edge at its threshold. Receivers that measure more of the signal time a fraction of the peak,
the peak, or the peak behind a matched filter. All are closed forms of the pulse's own noise: nothing is sampled
(docs/theory.md 8, docs/theory_receivers.md 6).

Symbols: s peak signal, f fraction, z deviate of the edge, sigma_p standard deviation of the pulse and unit of places.
"""

from __future__ import annotations

from dataclasses import replace

from ...maths import random
from ...maths.arrays import Lanes, Mask, xp
from ...maths.random import Stage
from ...physics.electronics import sampling
from ...physics.electronics.pulse_sums import SIGMAS_PER_FWHM, crossing
from ...physics.optics import pulse as pulse_shape
from .. import comparator
from ..comparator import Trip
from ..rises import Rise
from ..shots import Received, Shots


def curvature(shots: Received, rise: Rise) -> Lanes:
    """-P'' / P at the peak of a rise, (n,): 1 of a pulse as it leaves, less of broader ones, 0 of none."""
    power, _, bend = rise.top
    return curvature_of(shots, power, bend, mask=rise.exists)


def curvature_of(shots: Received, power: Lanes, bend: Lanes, *, mask: Mask) -> Lanes:
    """-P'' / P of this power and second derivative by place, (n,); 1 where the ``mask`` is false."""
    ops, broadening = xp(power), shots.wave.broadening
    curved = ops.maximum(-bend, 0.0) / ops.maximum(power, 1e-37)
    return ops.where(mask, curved / (broadening * broadening), 1.0)


def amplitude(shots: Shots, trip: Trip, *, lag_s: Lanes) -> Lanes:
    """Measured peak, (n,) in signal units; its noise is correlated with that of the instant that is timed.

    Args:
        lag_s: (n,) time between the comparator's crossing and the peak
    """
    timing = shots.sensor.tdc.timing
    if timing == "constant_fraction":
        lag_s = _fraction_s(shots)
    elif timing != "leading_edge":
        # The peak itself is compared with the threshold: both share one deviate.
        lag_s = xp(trip.signal).full(trip.signal, 0.0)
    return comparator.amplitude(shots, trip, lag_s=lag_s)


def lone_pulse_time_s(
    shots: Shots,
    trip: Trip,
    *,
    arrival_s: Lanes,
    crossing_s: Lanes,
    measured: Lanes,
    power_w: Lanes,
    width_s: Lanes | None,
) -> Lanes:
    """Reported time of a single Gaussian echo, (n,) s.

    Args:
        arrival_s: (n,) time of its peak
        crossing_s: (n,) time at which it trips the comparator
        measured: (n,) measured amplitude, in signal units
        power_w: (n,) optical peak power without noise
        width_s: (n,) time over the threshold, or None: not measured
    """
    ops, timing = xp(arrival_s), shots.sensor.tdc.timing
    if timing == "leading_edge":
        return comparator.reported_s(shots, crossing_s, measured=measured, width_s=width_s, true_power_w=power_w)
    if timing == "constant_fraction":
        level = fraction_level(shots, trip, measured)
        share = ops.where(level < trip.signal, shots.point.response.power_w(level) / power_w, 1.0)
        early = pulse_shape.leading_edge_time_s(level=share, fwhm_s=_fwhm_s(shots))
        time_s = arrival_s + early - _fraction_walk_s(shots, measured, power_w, width_s)
    else:
        time_s = arrival_s + _peak_error_s(shots, trip, 1.0, draw=0)
    return comparator.converted_time_s(shots, time_s, height=measured)


def rise_time_s(
    shots: Received, rise: Rise, trip: Trip, *, place: Lanes, measured: Lanes, width_s: Lanes | None, mask: Mask
) -> tuple[Lanes, Lanes]:
    """Reported time of a rise, (n,) s, and the place on the waveform that was timed.

    Args:
        place: (n,) place at which it trips the comparator
        measured: (n,) measured amplitude, in signal units
        width_s: (n,) time over the threshold, or None: not measured
        mask: (n,) bool, lanes to time; results of other lanes are undefined
    """
    ops, timing = shots.ops, shots.sensor.tdc.timing
    pulse_w = ops.where(mask, _power_above_base_w(shots, rise, trip), 1.0)
    above = measured - trip.base
    if timing == "leading_edge":
        crossing_s = shots.time_s(place) + trip.count_lag_s
        reported = comparator.reported_s(
            shots, crossing_s, measured=above, width_s=width_s, true_power_w=pulse_w, draw=rise.number
        )
        return reported, place
    if timing == "constant_fraction":
        level = fraction_level(shots, trip, measured)
        reaches = mask & (level < trip.signal) & (level > shots.point.response.signal(rise.valley_w))
        place = crossing(
            shots.wave.at,
            ops.where(reaches, shots.point.response.power_w(level), 1.0),
            far=rise.valley,
            peak=rise.peak,
            top=rise.top,
            mask=reaches,
        )
        place = ops.where(reaches, place, ops.where(level < trip.signal, rise.valley, rise.peak))
        time_s = shots.time_s(place) - _fraction_walk_s(shots, above, pulse_w, width_s)
    else:
        place = rise.peak
        # Light on which the pulse stands does not bend: all that bends is the pulse's, of its own height.
        curved = curvature(shots, rise) * (rise.top[0] / ops.maximum(pulse_w, 1e-37))
        time_s = shots.time_s(place) + _peak_error_s(shots, trip, curved, draw=rise.number)
    return comparator.converted_time_s(shots, time_s, draw=rise.number, height=measured), place


def fraction_level(shots: Shots, trip: Trip, measured: Lanes) -> Lanes:
    """Noiseless signal at which an edge reaches the fraction of its measured peak, (n,): (T25) with that for U."""
    level = trip.base + shots.sensor.tdc.fraction * (measured - trip.base)
    return shots.point.noise.crossing_level(level, trip.deviate)


def _fraction_s(shots: Shots) -> Lanes:
    """Time from the fraction of a pulse's peak to the peak."""
    return -pulse_shape.leading_edge_time_s(level=shots.sensor.tdc.fraction, fwhm_s=_fwhm_s(shots))


def _fraction_walk_s(shots: Shots, measured: Lanes, true_power_w: Lanes, width_s: Lanes | None) -> Lanes:
    """Time from a pulse's peak to the fraction on its edge, negative, that the sensor takes off (``tdc.walk``).

    A detector that saturates lowers the peak and not the foot of a pulse, so the fraction of a strong one is early:
    "raw" takes off what a weak pulse needs.
    """
    sensor, point = shots.sensor, shots.point
    fraction, fwhm = sensor.tdc.fraction, _fwhm_s(shots)
    if sensor.tdc.walk == "raw":
        return -_fraction_s(shots)
    if sensor.tdc.walk == "corrected":
        power = point.response.inferred_power_w(measured, width_s=width_s, threshold=shots.threshold, pulse_fwhm_s=fwhm)
        level = fraction * measured
    else:
        power, level = true_power_w, fraction * point.response.measured(point.response.signal(true_power_w))
    return pulse_shape.leading_edge_time_s(level=point.response.power_w(level) / power, fwhm_s=fwhm)


def _peak_error_s(shots: Shots, trip: Trip, curved: Lanes, *, draw: Lanes) -> Lanes:
    """Error of a peak's time by noise, (n,) s."""
    point, sensor = shots.point, shots.sensor
    x = sampling.widths(bandwidth_hz=sensor.noise_bandwidth_hz, pulse_fwhm_s=_fwhm_s(shots))
    sigma, slope = trip.sigma, sampling.slope_noise(x=x)
    if sensor.matches:
        # The slope of the pulse looks away from its peak, where most of the echo's own noise is.
        off_peak = replace(point.noise, kappa_1=2.0 / 3.0 * point.noise.kappa_1, kappa_2=0.5 * point.noise.kappa_2)
        sigma = off_peak.at(trip.signal)
        slope = sampling.matched_slope_noise(x=x)
        curved = sampling.matched_curvature(curvature=curved)
    ops = xp(trip.signal)
    height = ops.maximum(trip.signal - trip.base, 1e-30)
    deviation = sampling.peak_deviation(noise_share=sigma / height, slope_noise=slope, curvature=curved) * (
        _fwhm_s(shots) / SIGMAS_PER_FWHM
    )
    # The derivative of stationary noise is independent of its value, and so of the peak's height.
    _, deviate = random.normal_pair(shots.words(Stage.TDC_JITTER, draw))
    return deviation * deviate


def _power_above_base_w(shots: Received, rise: Rise, trip: Trip) -> Lanes:
    """Peak power of a pulse above the light on which it stands, (n,)."""
    if isinstance(trip.base, float):
        return rise.top[0]
    base_w = shots.point.response.power_w(trip.base / shots.sensor.lasting_gain)
    return rise.top[0] - shots.ops.where(trip.base > 0.0, base_w, 0.0)


def _fwhm_s(shots: Shots) -> Lanes:
    """FWHM of the pulse that is timed."""
    return shots.sensor.received_fwhm_s
