"""Daylight of a recording, from its background counts and a sensor file that says what they are worth."""

from __future__ import annotations

import numpy as np

from ...recordings.sweep import Sweep
from ...sensor.sensor_model import Sensor
from ..ranging.plane import Target, echoes_of_plane
from .apparent_reflectivity import ReflectivityGauge, largest_reflectivity


def illuminance_klux(sweep: Sweep, gauge: ReflectivityGauge | None, sensor: Sensor) -> float | None:
    """Illuminance of a uniform sky that explains the median recorded NEAR_IR on these reflectivities.

    None without NEAR_IR or strengths, or if the sensor has no such count or is blind to the sky.
    """
    window_s = getattr(sensor.tdc, "ambient_s", None)
    if sweep.near_ir is None or gauge is None or not window_s or sensor.histogram is None:
        return None

    def counts(klux: float, reflectivity: float) -> float:
        target = Target(
            reflectivity=reflectivity, illuminance_klux=klux, cos_sun=0.0, diffuse_share=1.0, transmittance=1.0
        )
        power = echoes_of_plane(sensor, target, 20.0 * np.ones(1)).background_power_w
        return float(np.ravel(sensor.background_counts(power)[0])[0]) * float(window_s)

    # Counts are linear in illuminance times reflectivity: dark counts and one lit target give the slope.
    dark, unit = counts(0.0, 0.2), 0.2 * 20.0
    per_unit = (counts(20.0, 0.2) - dark) / unit
    apparent = gauge.apparent(sweep, np.where(sweep.has_return, sweep.range_m, 1.0))
    usable = sweep.has_return & np.isfinite(sweep.near_ir) & (apparent > 0.02) & (apparent < largest_reflectivity())
    if not usable.any() or not per_unit > 0.0:
        return None
    return max(0.0, float(np.median((sweep.near_ir[usable] - dark) / apparent[usable])) / per_unit)
