"""Beams: a sensor and its pose in, the rays of some pulses out."""

from __future__ import annotations

from dataclasses import dataclass

from ..maths import random
from ..maths.arrays import Lanes, Numbers
from ..maths.pose import direction_from_angles
from ..maths.vectors import Vector, across, mixed, unit
from ..sensor.model import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Beams:
    """Rays in firing order, numpy or Dr.Jit, in the frame in which they are traced.

    pulse        (n,) uint32, pulse number in the frame
    origin_m     (x, y, z), each a scalar or (n,)
    direction    (x, y, z), each (n,), unit length
    aperture_m2  effective receiving aperture A(theta_r) of (4), a scalar or (n,)
    background_aperture_m2  that goes with the detector's own field of view in (8), or None: the same
    """

    pulse: Lanes
    origin_m: Vector
    direction: Vector
    aperture_m2: Lanes
    background_aperture_m2: Lanes | None = None


def fire(
    sensor: Sensor,
    *,
    pulse: Lanes,
    origin_m: Vector,
    rotation: tuple[Lanes, ...],
    seed: Lanes = 0,
) -> Beams:
    """The rays of these pulses, where they really go: with the scanner's pointing jitter.

    pulse     (n,) uint32 pulse numbers
    origin_m  position of the sensor in the tracing frame, for all pulses or, of a sensor that moves, for each
    rotation  nine numbers, row by row: sensor frame to tracing frame; the same
    seed      of the jitter, 32 bits
    """
    direction = sensor.scanner.direction(pulse)
    if sensor.scanner.jitter_rad is not None:
        direction = _jittered(direction, sensor.scanner.jitter_rad, seed=seed, pulse=pulse)
    return _placed(sensor, pulse, direction, origin_m, rotation)


def reported(sensor: Sensor, *, pulse: Lanes, origin_m: Vector, rotation: tuple[Lanes, ...]) -> Beams:
    """The rays of these pulses as the sensor believes them to be: by the angles that it reports."""
    azimuth, elevation = sensor.scanner.angles(pulse)
    direction = direction_from_angles(azimuth_rad=azimuth, elevation_rad=elevation)
    return _placed(sensor, pulse, direction, origin_m, rotation)


def _placed(
    sensor: Sensor,
    pulse: Lanes,
    direction: Vector,
    origin_m: Vector,
    rotation: tuple[Lanes, ...],
) -> Beams:
    """Rays in the tracing frame, from directions in the sensor's."""
    start = sensor.scanner.offset_m(pulse)
    if start is not None:
        x, y, z = (o + moved for o, moved in zip(origin_m, _turned(rotation, start), strict=True))
        origin_m = x, y, z
    return Beams(
        pulse=pulse,
        origin_m=origin_m,
        direction=_turned(rotation, direction),
        aperture_m2=sensor.optics.aperture_m2 * sensor.scanner.aperture_share(pulse),
        background_aperture_m2=sensor.optics.aperture_m2 * sensor.scanner.background_share(pulse),
    )


def _turned(r: tuple[Lanes, ...], v: Vector) -> Vector:
    """A vector by a rotation of nine numbers."""
    x, y, z = (r[3 * i] * v[0] + r[3 * i + 1] * v[1] + r[3 * i + 2] * v[2] for i in range(3))
    return x, y, z


def _jittered(direction: Vector, jitter_rad: Lanes, *, seed: Lanes, pulse: Lanes) -> Vector:
    """Gaussian pointing noise on both axes across the beam."""
    words = random.words(seed=seed, stage=random.Stage.POINTING, pulse=pulse)
    u, v = across(direction)
    first, second = random.normal_pair(words)
    aside = mixed(jitter_rad * first, u, jitter_rad * second, v)
    return unit(mixed(1.0, direction, 1.0, aside))


def firing_time_s(sensor: Sensor, pulse: Numbers) -> Numbers:
    """(n,) float64 emission time of each pulse since the frame's first; float32 would lose nanoseconds."""
    return sensor.scanner.time_s(pulse)
