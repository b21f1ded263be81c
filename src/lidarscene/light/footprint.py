"""Footprint: the rays over a beam's cross section that stand for the beam.

A beam is wider than a ray: its spot can lie across an edge and return two echoes. So each pulse is traced with several
rays, each with the same share of its power. Rays of a halo come last in their pulse and share the halo's power
(docs/theory_light.md 4).

Lanes are pulse-major: lane = pulse lane * rays + ray. The rays of a pulse are then neighbours in memory and in the
scene, and ray i of all pulses is every ``rays``-th lane.

Symbols: q place of a ray in units of the beam radius, w_0 radius at the exit, theta half divergence, z distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ..maths.arrays import Lanes, LookupTable, Numbers, xp
from ..maths.units import STATIC
from ..maths.vectors import Vector, cross, dot, unit, weighted_sum
from ..physics.optics import beam
from ..sensor.sensor_model import Halo, Laser
from .beams import Beams

_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
_GOLDEN_WORD = 2654435769
"""2^32 over the golden ratio: its multiples, as 32-bit words, are spread evenly."""

_LEAST_WITH_HALO = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Skirt:
    """The rays of a beam's halo, which are the last ones of each pulse; theory (T49a).

    Attributes:
        count: number of them in each pulse
        share: share of the pulse's power in all of them together
        slope: tangent of the halo's half divergence
    """

    count: int = field(metadata=STATIC)
    share: Lanes
    slope: Lanes

    def weight(self, ray: Lanes, rays: int) -> Lanes:
        """Share of the pulse's power in a ray, for ``ray`` of 0 to ``rays`` - 1."""
        core = rays - self.count
        # The core's rays share what the halo leaves; both shares add up to 1 over the rays of a pulse.
        return xp(ray, self.share).where(ray < core, (1.0 - self.share) * (1.0 / core), self.share * (1.0 / self.count))


@dataclass(frozen=True, slots=True, kw_only=True)
class Footprint:
    """The rays that stand for a beam, and the beam's measures on its two axes, azimuth and elevation.

    Attributes:
        points: (rays, 2) place q of each ray in the beam, in radii of the beam; (rays, 3) with that in the sweep
        exit_radius_m: w_0, radius of the beam at the sensor, the same on both axes; 0: the beam leaves from a point
        slope: tangent of the half divergence on each axis
        skirt: the rays of a halo, or None
        sweep_rad: angle over which the head sweeps the beam while it sums shots, or None: it stands
    """

    points: LookupTable
    exit_radius_m: Lanes
    slope: tuple[Lanes, Lanes]
    skirt: Skirt | None = None
    sweep_rad: Lanes | None = None

    @property
    def rays(self) -> int:
        """Number of rays of a pulse."""
        return len(self.points.values)

    @property
    def weight(self) -> float:
        """Share of the pulse's power in each ray, without a halo."""
        return 1.0 / self.rays


@dataclass(frozen=True, slots=True, kw_only=True)
class Aim:
    """Geometry of beams and their receiver for specular returns, whose share at the receiver it determines.

    Attributes:
        across: two unit vectors across each beam, along its axes
        exit_radius_m: as of a `Footprint`
        slope: as of a `Footprint`
        profile: "gaussian" or "top_hat"
        aperture_m2: aperture of the receiver, whose axis is that of the beam
    """

    across: tuple[Vector, Vector]
    exit_radius_m: Lanes
    slope: tuple[Lanes, Lanes]
    profile: str
    aperture_m2: Lanes


def aim(axes: Beams, shape: Footprint, *, profile: str, rotation: tuple[Lanes, ...]) -> Aim:
    """`Aim` of the beams with these axes; ``rotation`` as of `spread`."""
    return Aim(
        across=_axes(axes.direction, rotation),
        exit_radius_m=shape.exit_radius_m,
        slope=shape.slope,
        profile=profile,
        aperture_m2=axes.aperture_m2,
    )


def polarisation(axes: Beams, laser: Laser, *, rotation: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
    """Axis along which the light of each beam swings, and the share of it that does.

    Args:
        rotation: as of `spread`
    """
    azimuth, elevation = _axes(axes.direction, rotation)
    angle_rad = laser.polarisation.angle_rad
    ops = xp(*azimuth, angle_rad)
    return weighted_sum(ops.cos(angle_rad), azimuth, ops.sin(angle_rad), elevation), laser.polarisation.share


def footprint(laser: Laser, rays: int, halo: Halo | None = None, sweep_rad: float = 0.0) -> Footprint:
    """Distribute a number of rays over the cross section of a beam, and over the sweep of its head.

    A single ray is the beam's axis. If there is a halo, half of four or more rays belong to it.
    """
    second = laser.divergence_rad if laser.divergence_elevation_rad is None else laser.divergence_elevation_rad
    sweeps = rays > 1 and sweep_rad > 0.0

    def places(profile: str, count: int) -> Numbers:
        return with_sweep(points(profile, count)) if sweeps else points(profile, count)

    table, skirt = places(laser.profile, rays), None
    if halo is not None and rays >= _LEAST_WITH_HALO:
        count = rays // 2
        table = np.concatenate([places(laser.profile, rays - count), places("gaussian", count)])
        skirt = Skirt(count=count, share=halo.share, slope=math.tan(0.5 * halo.divergence_rad))
    return Footprint(
        skirt=skirt,
        sweep_rad=sweep_rad if sweeps else None,
        points=LookupTable(table),
        exit_radius_m=0.5 * (laser.exit_diameter_m or 0.0),
        slope=(math.tan(0.5 * laser.divergence_rad), math.tan(0.5 * second)),
    )


def points(profile: str, rays: int) -> Numbers:
    """(rays, 2) places in a round beam of radius 1, each for the same share of its power.

    A spiral with the golden angle (Vogel, Mathematical Biosciences 44, 179, 1979), theory (T47): the beam is cut into
    rings of equal power, and each ring has one ray at its mean r^2.

    Args:
        profile: "gaussian" or "top_hat"
    """
    ring = {"gaussian": beam.gaussian_ring, "top_hat": beam.top_hat_ring}[profile]
    number = np.arange(rays)
    radius = np.sqrt(ring(inside=number / rays, outside=(number + 1) / rays))
    angle = _GOLDEN_ANGLE * number
    spiral: Numbers = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # Give the pattern the beam's moments: mean 0 and variance 1/4 on both axes. A plane's mean range, and what its
    # slope does to the width of the echo, are then exact. Two rays lie on a line and one is a point, so from 3 rays
    # on.
    spiral -= spiral.mean(axis=0)
    if rays < 3:
        return spiral
    variance, axes = np.linalg.eigh(spiral.T @ spiral / rays)
    stretched = 0.5 * spiral @ (axes / np.sqrt(variance)) @ axes.T
    return np.asarray(stretched)


def with_sweep(places: Numbers) -> Numbers:
    """(rays, 3) places in a beam, (rays, 2), with a place in an even sweep from -1/2 to 1/2; theory (T125).

    Mean and variance of the sweep are exact: 0 and 1/12. From four rays on it has nothing to do with the place in the
    beam, so both variances add.
    """
    rays = len(places)
    # A Kronecker sequence beside the spiral's angles. Multiples of sqrt(3) are not tied to those of the golden angle by
    # whole numbers, so the rays spread over ring, angle and sweep alike.
    place = (np.arange(rays) + 0.5) * math.sqrt(3.0) % 1.0
    independent_of = np.column_stack([np.ones(rays), places]) if rays > 3 else np.ones((rays, 1))
    place -= independent_of @ np.linalg.lstsq(independent_of, place, rcond=None)[0]
    return np.column_stack([places, place * math.sqrt(rays / (12.0 * (place @ place)))])


def sweep(axes: Beams, shape: Footprint, *, ray: Lanes, rotation: tuple[Lanes, ...]) -> Beams:
    """Turn the axes of beams about the sensor's upright axis to where the head is when their ray stands for the light.

    Args:
        axes: as of `spread`
        ray: as of `spread`
        rotation: as of `spread`
    """
    if shape.sweep_rad is None:
        return axes
    # The exits, centimetres off the axis, move by less than 0.1 mm.
    ops, up = xp(ray, *axes.direction), (rotation[2], rotation[5], rotation[8])
    angle = shape.points.at_row(ray)[2] * shape.sweep_rad
    cos, sin = ops.cos(angle), ops.sin(angle)
    along = weighted_sum(dot(up, axes.direction) * (1.0 - cos), up, sin, cross(up, axes.direction))
    return replace(axes, direction=weighted_sum(cos, axes.direction, 1.0, along))


def spread(rays: Beams, shape: Footprint, *, ray: Lanes, rotation: tuple[Lanes, ...]) -> Beams:
    """Spread the rays of a footprint around the axes of beams, lane by lane; theory (T48).

    An elliptical beam has the right width on both axes, but its spot is rotated between the near and the far field.

    Args:
        rays: axes of the beams, each already repeated on as many lanes as the footprint has rays
        ray: (n,) number of the ray in its pulse
        rotation: nine numbers, row by row: sensor to tracing coordinates
    """
    if shape.rays == 1:
        return rays
    a, b = _axes(rays.direction, rotation)
    first, second = shape.points.at_row(ray)[:2]
    slope = shape.slope
    if shape.skirt is not None:
        first, second, slope = _add_skirt(rays, shape, shape.skirt, ray, first, second)
    # Rays are straight, but a Gaussian beam's radius follows a hyperbola. The straight lines on a hyperboloid follow it
    # too: a ray that starts at q w_0 leaves with the slope theta q turned by a right angle. Offset and slope are then
    # perpendicular, and after z the distance from the axis is |q| sqrt(w_0^2 + theta^2 z^2).
    start = weighted_sum(shape.exit_radius_m * first, a, shape.exit_radius_m * second, b)
    deflection = weighted_sum(-slope[0] * second, a, slope[1] * first, b)
    return replace(
        rays,
        origin_m=weighted_sum(1.0, rays.origin_m, 1.0, start),
        direction=unit(weighted_sum(1.0, rays.direction, 1.0, deflection)),
    )


def _add_skirt(
    rays: Beams, shape: Footprint, skirt: Skirt, ray: Lanes, first: Lanes, second: Lanes
) -> tuple[Lanes, Lanes, tuple[Lanes, Lanes]]:
    """Places and slopes of the rays of a footprint with a halo."""
    # The halo's few rays see a bright reflector from far around it. With the same pattern in every pulse each would
    # paint its own copy of it, so the pattern is turned about the axis from pulse to pulse. The pulse number times
    # 2^32 / golden ratio, in 32 bits, spreads the angles of consecutive pulses evenly over the circle.
    ops = xp(ray, first)
    outer = ray >= shape.rays - skirt.count
    word = ops.uint32(rays.pulse) * ops.uint32(_GOLDEN_WORD + 0 * ray)
    angle = ops.where(outer, ops.float32(word) * (2.0 * math.pi / 2.0**32), 0.0)
    cos, sin = ops.cos(angle), ops.sin(angle)
    slope = ops.where(outer, skirt.slope, shape.slope[0]), ops.where(outer, skirt.slope, shape.slope[1])
    return cos * first - sin * second, sin * first + cos * second, slope


def _axes(direction: Vector, rotation: tuple[Lanes, ...]) -> tuple[Vector, Vector]:
    """Two unit vectors across the beam, towards growing azimuth and growing elevation."""
    left: Vector = (rotation[1], rotation[4], rotation[7])
    up: Vector = (rotation[2], rotation[5], rotation[8])
    across_beam = cross(up, direction)
    ops = xp(*across_beam)
    steep = dot(across_beam, across_beam) < 1e-10  # straight up or down azimuth is undefined: take the sensor's left
    x, y, z = (ops.where(steep, fallback, component) for fallback, component in zip(left, across_beam, strict=True))
    azimuth = unit((x, y, z))
    return azimuth, cross(direction, azimuth)
