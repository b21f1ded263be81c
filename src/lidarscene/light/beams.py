"""Beams: the rays along which pulses leave a sensor.

A sensor cannot measure its own pointing jitter. So there are two kinds of rays: those along which the light really goes
(`fire`), and those that follow from the angles that the sensor reports (`reported_beams`).

Symbols: A(theta_r) effective receiving aperture (4).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..maths import random
from ..maths.arrays import Lanes, Numbers
from ..maths.pose import direction_from_angles
from ..maths.random import Seed
from ..maths.vectors import Vector, perpendicular_pair, unit, weighted_sum
from ..sensor.sensor_model import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Beams:
    """Rays in firing order, in tracing coordinates, NumPy or Dr.Jit.

    Attributes:
        pulse: (n,) uint32 pulse numbers
        origin_m: (x, y, z), each a scalar or (n,)
        direction: (x, y, z), each (n,), unit length
        aperture_m2: effective receiving aperture A(theta_r) of (4), a scalar or (n,)
        background_aperture_m2: aperture that goes with the detector's field of view in (8); None: the same
        laser_share: share of the laser's power that leaves a worn sensor
        receiver_share: share of the light on its window that enters
    """

    pulse: Lanes
    origin_m: Vector
    direction: Vector
    aperture_m2: Lanes
    background_aperture_m2: Lanes | None = None
    laser_share: Lanes = 1.0
    receiver_share: Lanes = 1.0


def fire(sensor: Sensor, *, pulse: Lanes, origin_m: Vector, rotation: tuple[Lanes, ...], seed: Seed = 0) -> Beams:
    """True rays of these pulses, with the scanner's pointing jitter.

    Args:
        pulse: (n,) uint32 pulse numbers
        origin_m: (x, y, z) position of the sensor in tracing coordinates: scalars, or (n,) each if the sensor moves
        rotation: nine numbers, row by row, sensor to tracing coordinates: scalars, or (n,) each if the sensor moves
        seed: 32-bit frame seed, for the jitter
    """
    # The mechanism's true direction; the encoders of the sensor do not see the jitter that is added to it.
    direction = sensor.scanner.direction(pulse)
    if sensor.scanner.jitter_rad is not None:
        direction = _add_jitter(direction, sensor.scanner.jitter_rad, seed=seed, pulse=pulse)
    if sensor.wear is None:
        return _place_rays(sensor, pulse, direction, origin_m, rotation)
    laser_share, receiver_share = sensor.wear.shares(direction, sensor.scanner.channel(pulse))
    rays = _place_rays(sensor, pulse, sensor.wear.turn(direction), origin_m, rotation)
    return replace(rays, laser_share=laser_share, receiver_share=receiver_share)


def reported_beams(sensor: Sensor, *, pulse: Lanes, origin_m: Vector, rotation: tuple[Lanes, ...]) -> Beams:
    """Rays of these pulses by the angles that the sensor reports; arguments as of `fire`."""
    # From encoder readings alone: rounded to their steps, and without the jitter.
    azimuth, elevation = sensor.scanner.angles(pulse)
    direction = direction_from_angles(azimuth_rad=azimuth, elevation_rad=elevation)
    return _place_rays(sensor, pulse, direction, origin_m, rotation)


def _place_rays(
    sensor: Sensor, pulse: Lanes, direction: Vector, origin_m: Vector, rotation: tuple[Lanes, ...]
) -> Beams:
    """Transform directions in sensor coordinates to rays in tracing coordinates."""
    start = sensor.scanner.offset_m(pulse)
    # Some scanners send their pulses from points off the sensor's origin; the offset turns with the sensor.
    if start is not None:
        x, y, z = (o + moved for o, moved in zip(origin_m, _rotate(rotation, start), strict=True))
        origin_m = x, y, z
    # Optics that trade aperture for field of view, such as rotating wedges, dim the echo and not the background. So
    # each has a share of its own (4), (8).
    return Beams(
        pulse=pulse,
        origin_m=origin_m,
        direction=_rotate(rotation, direction),
        aperture_m2=sensor.optics.aperture_m2 * sensor.scanner.aperture_share(pulse),
        background_aperture_m2=sensor.optics.aperture_m2 * sensor.scanner.background_share(pulse),
    )


def _rotate(r: tuple[Lanes, ...], v: Vector) -> Vector:
    """Rotate a vector by a matrix of nine numbers, row by row."""
    x, y, z = (r[3 * i] * v[0] + r[3 * i + 1] * v[1] + r[3 * i + 2] * v[2] for i in range(3))
    return x, y, z


def _add_jitter(direction: Vector, jitter_rad: Lanes, *, seed: Seed, pulse: Lanes) -> Vector:
    """Add Gaussian pointing noise on both axes across the beam."""
    # Jitter is a small angle: add a small vector across the beam and restore unit length.
    words = random.words(seed=seed, stage=random.Stage.POINTING, pulse=pulse)
    u, v = perpendicular_pair(direction)
    first, second = random.normal_pair(words)
    offset = weighted_sum(jitter_rad * first, u, jitter_rad * second, v)
    return unit(weighted_sum(1.0, direction, 1.0, offset))


def firing_time_s(sensor: Sensor, pulse: Numbers) -> Numbers:
    """(n,) float64 emission time of each pulse by the scanner's clock, s; float32 would lose nanoseconds."""
    return sensor.scanner.time_s(pulse)
