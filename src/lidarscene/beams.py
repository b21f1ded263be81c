"""Beams: a sensor and its pose in, the rays of some pulses out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .arrays import Array
from .geometry import direction_from_angles
from .sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Beams:
    """Rays in firing order, numpy or Dr.Jit, in the frame in which they are traced.

    pulse        (n,) uint32, pulse number in the frame
    origin_m     (x, y, z), each a scalar or (n,)
    direction    (x, y, z), each (n,), unit length
    aperture_m2  effective receiving aperture A(theta_r) of (4); one for all pulses of a raster
    """

    pulse: Array
    origin_m: tuple[Array, Array, Array]
    direction: tuple[Array, Array, Array]
    aperture_m2: Array


def fire(
    sensor: Sensor, *, pulse: Array, origin_m: tuple[Array, Array, Array], rotation: tuple[Array, ...]
) -> Beams:
    """The rays of these pulses.

    pulse     (n,) uint32 pulse numbers
    origin_m  position of the sensor in the tracing frame
    rotation  nine numbers, row by row: sensor frame to tracing frame
    """
    azimuth, elevation = sensor.scanner.angles(pulse)
    x, y, z = direction_from_angles(azimuth_rad=azimuth, elevation_rad=elevation)
    r = rotation
    direction = tuple(r[3 * i] * x + r[3 * i + 1] * y + r[3 * i + 2] * z for i in range(3))
    return Beams(
        pulse=pulse,
        origin_m=origin_m,
        direction=(direction[0], direction[1], direction[2]),
        aperture_m2=sensor.optics.aperture_m2,
    )


def firing_time_s(sensor: Sensor, pulse: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """(n,) float64 emission time of each pulse since the frame's first; float32 would lose nanoseconds."""
    return np.asarray(pulse, dtype=np.float64) / float(sensor.laser.repetition_rate_hz)
