"""Link budgets of points: a cloud with truth, its sensor and the scene's light in; watts and amperes out.

A budget explains a point's SNR. It runs the stages of the simulation on NumPy. A cloud does not hold its surfaces'
BSDFs, only the diffuse reflectivity. So from a cloud alone, the echo power (5) and the background (8) are those of a
Lambertian surface: exact for Lambertian materials, wrong for rough ones, coats, mirrors and retro-reflectors. If the
Lambertian echo does not match the cloud's SNR, P_r is computed from the SNR instead. With a compiled world,
`kernel.rays.retraced_light.retraced_light` traces the light itself.

Symbols: P_r echo power, P_rs background power, sigma_0 noise without echo, U comparator level, P_d detection
probability.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..errors import InputError
from ..light.beams import Beams
from ..light.echoes import Ambient, Echoes, receive
from ..light.hits import Hits
from ..maths.arrays import Numbers
from ..scan import Scanner
from ..sensor.sensor_model import Sensor

SAME_SIGNAL = 1e-3
"""Accuracy bought: largest relative difference of two signals that count as equal: columns are single precision, and
the power cannot be recovered from the signal of a saturated SiPM."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Budget:
    """Light and electronics of each point; all (n,) float64. Signals are at the comparator, before an intensity scale.

    Attributes:
        echo_power_w: peak P_r: by (5) if it matches the cloud's SNR, else computed from the SNR; 0 without surface
        lambertian_power_w: P_r by (5) with rho cos(theta) / pi; 0 without surface
        background_power_w: P_rs by (8), of a Lambertian surface unless the light is given, or of the sky
        noise: sigma_0, without an echo
        threshold: level U of the comparator
        signal: peak of the echo without noise
        noise_at_peak: sigma at the peak: with the echo's own shot noise
        detection_probability: P_d of that signal
        signal_unit: unit of signal, noises and threshold: "A", "cells" or "photons", by the detector
    """

    echo_power_w: Numbers
    lambertian_power_w: Numbers
    background_power_w: Numbers
    noise: Numbers
    threshold: Numbers
    signal: Numbers
    noise_at_peak: Numbers
    detection_probability: Numbers
    signal_unit: str


def budget_of(cloud: PointCloud, sensor: Sensor, ambient: Ambient, *, light: Echoes | None = None) -> Budget:
    """Compute the budget of every point, for the sensor that made the cloud.

    Args:
        light: traced light of the points' pulses; None: that of Lambertian surfaces

    Raises:
        InputError: for a cloud without truth
    """
    if not cloud.has_truth:
        raise InputError("budget: the cloud has no truth columns, from which it is computed")
    hits = _lambertian(cloud)
    # The columns do not say which beam looks into the sun, so sunlight straight into the lens is left out.
    # A drop right at the lens may be reported at range 0, where the lidar equation divides by zero.
    with np.errstate(divide="ignore", invalid="ignore"):
        lambertian = receive(_beams(cloud, sensor), hits, sensor, replace(ambient, sun_direction=None))
    light = light or lambertian
    background = np.broadcast_to(light.background_power_w, len(cloud))
    point = sensor.working_point(background, range_m=np.asarray(hits.range_m))
    threshold = np.broadcast_to(sensor.threshold(point), len(cloud))
    noise = np.broadcast_to(point.noise.deviation, len(cloud))
    has_surface = np.asarray(hits.has_surface)
    signal = np.where(has_surface, cloud.snr * noise, 0.0)
    # A saturated signal does not determine the power, so the traced or Lambertian power stays if it matches.
    gain = sensor.height_gain(lambertian.curvature)
    explained = np.abs(point.response.signal(light.peak_power_w * gain) - signal) <= SAME_SIGNAL * signal
    power = np.where(explained, light.peak_power_w, point.response.power_w(signal) / gain)
    at_peak = point.noise.at(signal)
    probability = point.detection_probability(threshold, signal, at_peak) * sensor.steadiness(
        point.noise, threshold, signal, lambertian.curvature
    )
    return Budget(
        echo_power_w=np.where(has_surface, power, 0.0),
        lambertian_power_w=np.asarray(lambertian.peak_power_w),
        background_power_w=np.asarray(light.background_power_w),
        noise=noise,
        threshold=threshold,
        signal=signal,
        noise_at_peak=np.asarray(at_peak),
        detection_probability=np.where(has_surface, np.broadcast_to(probability, len(cloud)), 0.0),
        signal_unit=sensor.detector.unit,
    )


def _lambertian(cloud: PointCloud) -> Hits:
    """Convert the truth columns to hits on Lambertian surfaces, in double precision."""
    columns = {name: cloud.column(name).astype(np.float64) for name in ("true_range", "reflectivity")}
    has_surface = np.isfinite(columns["true_range"])
    cos_incidence = np.where(has_surface, np.cos(cloud.column("incidence_angle").astype(np.float64)), 0.0)
    cos_sun = np.where(has_surface, np.cos(cloud.column("sun_angle").astype(np.float64)), 0.0)
    lit = has_surface & (cos_sun > 0.0) & (cloud.column("in_shadow") == 0)
    per_sr = columns["reflectivity"] / math.pi
    return Hits(
        has_surface=has_surface,
        range_m=np.where(has_surface, columns["true_range"], 1.0),
        cos_incidence=cos_incidence,
        backscatter_per_sr=per_sr * cos_incidence,
        sun_scatter_per_sr=np.where(lit, per_sr * cos_sun, 0.0),
        reflectivity=columns["reflectivity"],
        cos_sun=cos_sun,
        lit=lit,
        face=np.where(has_surface, 0, -1),
    )


def _beams(cloud: PointCloud, sensor: Sensor) -> Beams:
    """Beams of the points; only their receiving apertures matter here."""
    scanner, pulse = sensor.scanner, np.arange(sensor.scanner.pulses, dtype=np.uint32)
    shares = [np.asarray(share_of(pulse)) for share_of in (scanner.aperture_share, scanner.background_share)]
    if any(share.ndim for share in shares):
        pulse = pulses_of(cloud, scanner)
        shares = [np.asarray(share_of(pulse)) for share_of in (scanner.aperture_share, scanner.background_share)]
    laser, background = (np.broadcast_to(sensor.optics.aperture_m2 * share, len(cloud)) for share in shares)
    return Beams(
        pulse=pulse,
        origin_m=(0.0, 0.0, 0.0),
        direction=(1.0, 0.0, 0.0),
        aperture_m2=laser,
        background_aperture_m2=background,
    )


def pulses_of(cloud: PointCloud, scanner: Scanner) -> Numbers:
    """(n,) int64 pulse of each point: the pulse of its channel that is nearest in time, then in azimuth."""
    first = int(cloud.metadata.get("frame_number", "0")) * scanner.pulses
    pulse = np.arange(first, first + scanner.pulses, dtype=np.int64)
    times, rank = np.unique(scanner.time_s(pulse) - scanner.time_s(pulse[:1]), return_inverse=True)
    channel = np.asarray(scanner.channel(pulse), dtype=np.int64)
    width = int(channel.max()) + 1
    # Angles lie within -pi to pi, so steps of 8 keep the groups apart.
    keys = (rank * width + channel) * 8.0 + scanner.angles(pulse)[0]
    order = np.argsort(keys, kind="stable")
    point_keys = (_nearest(times, cloud.time_s) * width + cloud.channel) * 8.0 + cloud.azimuth_rad
    return np.asarray(pulse[order[_nearest(keys[order], point_keys)]])


def _nearest(rising: Numbers, values: Numbers) -> Numbers:
    """Index of the nearest of the ``rising`` numbers, for each value."""
    above = np.searchsorted(rising, values).clip(1, max(len(rising) - 1, 1))
    below = above - 1
    above = np.minimum(above, len(rising) - 1)
    return np.asarray(np.where(values - rising[below] <= rising[above] - values, below, above))
