"""Picture of a sensor: where its pulses go, what its detector makes of light, and the echo over the distance.

The plane of the last two panels is that of `max_range`: 10 % reflectivity under 100 klux.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from ..figures.lines import COLOURS, GREY, INK
from ..figures.panels import draw_panels
from ..files.facts import Picture
from ..maths.arrays import Numbers
from ..sensor.sensor_model import Sensor
from .ranging import plane
from .ranging.conditions import PROBABILITY, Conditions

DOTS = 80_000
"""Accuracy bought: pulses of the pattern that are drawn, those that come first."""

POINTS = 300
"""Accuracy bought: points of a curve, which is smooth."""


def draw_sensor(sensor: Sensor) -> Picture:
    """See `Sensor.plot`."""
    target = Conditions().target()
    range_m = float(plane.detection_range_m(sensor, target, PROBABILITY)[0])
    farthest_m = 1.5 * range_m if 0.0 < range_m < np.inf else float(plane.window_m(sensor))
    distances_m = np.geomspace(0.02 * farthest_m, farthest_m, POINTS)
    light = plane.echoes_of_plane(sensor, target, distances_m)
    panels = [
        functools.partial(_pattern, sensor=sensor),
        functools.partial(_response, sensor=sensor, echo_w=np.asarray(light.peak_power_w), light=light),
        functools.partial(_budget, sensor=sensor, light=light, distances_m=distances_m, range_m=range_m),
    ]
    laser = f"{float(sensor.laser.wavelength_m) * 1e9:g} nm, {float(sensor.laser.peak_power_w):.3g} W"
    return draw_panels(panels, f"{sensor.name}: {laser}; a plane of 10 % under 100 klux")


def _pattern(axes: Any, *, sensor: Sensor) -> None:
    pulses = np.arange(min(sensor.scanner.pulses, DOTS))
    azimuth, elevation = (np.degrees(np.asarray(angle)) for angle in sensor.scanner.angles(pulses))
    axes.scatter(
        azimuth * np.ones(len(pulses)), elevation * np.ones(len(pulses)), s=2.0, linewidths=0, color=COLOURS[0]
    )
    axes.invert_xaxis()
    part = "of a frame" if len(pulses) == sensor.scanner.pulses else f"first of {sensor.scanner.pulses:,} a frame"
    _label(axes, f"azimuth, to the left [deg]; {len(pulses):,} pulses, {part}", "elevation [deg]")


def _response(axes: Any, *, sensor: Sensor, echo_w: Numbers, light: Any) -> None:
    """Signal over the echo's power, under the background of the nearest place of the plane."""
    background = np.broadcast_to(light.background_power_w, echo_w.shape)[0]
    point = sensor.working_point(background)
    power_w = np.geomspace(0.3 * echo_w.min(), 3.0 * echo_w.max(), POINTS)
    signal = np.asarray(point.response.measured(point.response.signal(power_w))) * np.ones(POINTS)
    axes.loglog(power_w, signal, color=COLOURS[0], label="signal")
    noise = np.asarray(point.noise.at(signal)) * np.ones(POINTS)
    axes.loglog(power_w, noise, color=COLOURS[1], label="noise at the peak")
    axes.axhline(float(np.mean(sensor.threshold(point))), color=GREY, linestyle=":", label="threshold")
    axes.legend(fontsize=8, frameon=False)
    _label(axes, "peak power on the detector [W]", f"signal [{sensor.detector.unit}]")


def _budget(axes: Any, *, sensor: Sensor, light: Any, distances_m: Numbers, range_m: float) -> None:
    """Power of echo and background over the distance, and the range."""
    ones = np.ones(len(distances_m))
    axes.loglog(distances_m, light.peak_power_w * ones, color=COLOURS[0], label="echo")
    axes.loglog(distances_m, light.background_power_w * ones, color=COLOURS[4], label="background")
    point = sensor.working_point(light.background_power_w, range_m=distances_m)
    least_w = np.asarray(point.response.power_w(sensor.threshold(point) * ones))
    axes.loglog(distances_m, least_w, color=GREY, linestyle=":", label="echo at the threshold")
    if 0.0 < range_m < np.inf:
        axes.axvline(range_m, color=COLOURS[1], label=f"range at P_d {PROBABILITY:g}: {range_m:.4g} m")
    axes.legend(fontsize=8, frameon=False)
    _label(axes, "distance [m]", "peak power on the detector [W]")


def _label(axes: Any, x: str, y: str) -> None:
    axes.set_xlabel(x, fontsize=9, color=INK)
    axes.set_ylabel(y, fontsize=9, color=INK)
