"""Footprint: a Laser and a number of rays in, where in the beam each of these rays runs out; Beams in, sub-rays out.

Lanes are pulse-major: lane = pulse lane * rays + ray. Every ray carries the same share of the pulse, but for those of
a halo, which come last in their pulse and share what that has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..maths.arrays import Lanes, Numbers, Table, xp
from ..maths.vectors import Vector, cross, dot, mixed, unit
from ..physics.optics import beam
from ..sensor.model import Halo, Laser
from .beams import Beams

_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
_GOLDEN_WORD = 2654435769
"""2^32 over the golden ratio: its multiples, as 32-bit words, are spread evenly."""

_LEAST_WITH_HALO = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Skirt:
    """The rays of a halo, the last ones of each pulse.

    count  how many
    share  of the pulse in all of them
    slope  tangent of the half divergence
    """

    count: int
    share: Lanes
    slope: Lanes

    def weight(self, ray: Lanes, rays: int) -> Lanes:
        """Share of the pulse in each of its rays."""
        core = rays - self.count
        return xp(ray, self.share).where(
            ray < core, (1.0 - self.share) * (1.0 / core), self.share * (1.0 / self.count)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Footprint:
    """The rays that stand for a beam, and the beam's measures on its two axes (azimuth and elevation, unturned).

    points         (rays, 2) place of each ray in the beam, in radii of the beam
    exit_radius_m  where the beam leaves the sensor, the same on both axes; 0: from a point
    slope          tangent of the half divergence, on each axis
    turn_rad       of the axes about the beam, from the left to the top
    skirt          of them those of a halo, or None
    """

    points: Table
    exit_radius_m: Lanes
    slope: tuple[Lanes, Lanes]
    turn_rad: Lanes
    skirt: Skirt | None = None

    @property
    def rays(self) -> int:
        """Rays of a pulse."""
        return len(self.points.values)

    @property
    def weight(self) -> float:
        """Share of the pulse in each ray, if there is no halo."""
        return 1.0 / self.rays


@dataclass(frozen=True, slots=True, kw_only=True)
class Aim:
    """Where beams point and how they widen, and the receiver that sent them: what tells how much of one that is
    mirrored straight back is received.

    across         two unit vectors of each ray's beam, along its axes
    exit_radius_m, slope  as of a `Footprint`
    profile        "gaussian" or "top_hat"
    aperture_m2    of the receiver, whose axis is the beam's
    """

    across: tuple[Vector, Vector]
    exit_radius_m: Lanes
    slope: tuple[Lanes, Lanes]
    profile: str
    aperture_m2: Lanes


def aim(axes: Beams, shape: Footprint, *, profile: str, rotation: tuple[Lanes, ...]) -> Aim:
    """Of the beams whose axes these are."""
    return Aim(
        across=_axes(axes.direction, shape.turn_rad, rotation),
        exit_radius_m=shape.exit_radius_m,
        slope=shape.slope,
        profile=profile,
        aperture_m2=axes.aperture_m2,
    )


def footprint(laser: Laser, rays: int, halo: Halo | None = None) -> Footprint:
    """A beam as so many rays; a single one is its axis. Of four and more half go to the halo, if there is one."""
    second = (
        laser.divergence_rad if laser.divergence_elevation_rad is None else laser.divergence_elevation_rad
    )
    places, skirt = points(laser.profile, rays), None
    if halo is not None and rays >= _LEAST_WITH_HALO:
        count = rays // 2
        places = np.concatenate([points(laser.profile, rays - count), points("gaussian", count)])
        skirt = Skirt(count=count, share=halo.share, slope=math.tan(0.5 * halo.divergence_rad))
    return Footprint(
        skirt=skirt,
        points=Table(places),
        exit_radius_m=0.5 * (laser.exit_diameter_m or 0.0),
        slope=(math.tan(0.5 * laser.divergence_rad), math.tan(0.5 * second)),
        turn_rad=laser.beam_rotation_rad,
    )


def points(profile: str, rays: int) -> Numbers:
    """(rays, 2) places in a round beam of radius 1, each for the same share of its power.

    profile  "gaussian" or "top_hat"

    A spiral with the golden angle (Vogel, Mathematical Biosciences 44, 179, 1979): the beam is cut into rings of
    equal power and each has one ray, at the ring's mean r^2. The pattern is then moved and stretched a little, so
    that its centre is 0 and its variance 1/4 on both axes, as the beam's are: the mean range of a plane and what
    its slope does to the echo's width are right with any number of rays from 3 on. (Two rays have no width on one
    axis, and one has none at all.)
    """
    ring = {"gaussian": beam.gaussian_ring, "top_hat": beam.top_hat_ring}[profile]
    number = np.arange(rays)
    radius = np.sqrt(ring(inside=number / rays, outside=(number + 1) / rays))
    angle = _GOLDEN_ANGLE * number
    spiral: Numbers = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    spiral -= spiral.mean(axis=0)
    if rays < 3:
        return spiral
    variance, axes = np.linalg.eigh(spiral.T @ spiral / rays)
    stretched = 0.5 * spiral @ (axes / np.sqrt(variance)) @ axes.T
    return np.asarray(stretched)


def spread(rays: Beams, shape: Footprint, *, ray: Lanes, rotation: tuple[Lanes, ...]) -> Beams:
    """Beams of whole pulses to sub-rays: lane by lane, each pulse already on as many lanes as it has rays.

    ray       (n,) number of the ray in its pulse
    rotation  nine numbers, row by row: sensor frame to tracing frame

    A ray that starts q w_0 off the axis leaves with the slope theta q turned by a right angle, so that it is at
    |q| sqrt(w_0^2 + theta^2 z^2) after z: on every ray of a round beam the Gaussian beam's law holds, although rays
    are straight. These are the straight lines on hyperboloids around the axis. An elliptical beam has the right
    width on both axes; its spot stands askew where it is neither near nor far.
    """
    if shape.rays == 1:
        return rays
    a, b = _axes(rays.direction, shape.turn_rad, rotation)
    first, second = shape.points.at_row(ray)
    slope = shape.slope
    if shape.skirt is not None:
        first, second, slope = _with_skirt(rays, shape, shape.skirt, ray, first, second)
    start = mixed(shape.exit_radius_m * first, a, shape.exit_radius_m * second, b)
    aside = mixed(-slope[0] * second, a, slope[1] * first, b)
    return replace(
        rays,
        origin_m=mixed(1.0, rays.origin_m, 1.0, start),
        direction=unit(mixed(1.0, rays.direction, 1.0, aside)),
    )


def _with_skirt(
    rays: Beams, shape: Footprint, skirt: Skirt, ray: Lanes, first: Lanes, second: Lanes
) -> tuple[Lanes, Lanes, tuple[Lanes, Lanes]]:
    """Places and slopes of rays some of which are a halo's: those are turned about the axis from pulse to pulse, since
    few rays that are the same for all pulses would see everything bright so many times.
    """
    ops = xp(ray, first)
    outer = ray >= shape.rays - skirt.count
    word = ops.uint32(rays.pulse) * ops.uint32(_GOLDEN_WORD + 0 * ray)
    angle = ops.where(outer, ops.float32(word) * (2.0 * math.pi / 2.0**32), 0.0)
    cos, sin = ops.cos(angle), ops.sin(angle)
    slope = ops.where(outer, skirt.slope, shape.slope[0]), ops.where(outer, skirt.slope, shape.slope[1])
    return cos * first - sin * second, sin * first + cos * second, slope


def _axes(direction: Vector, turn_rad: Lanes, rotation: tuple[Lanes, ...]) -> tuple[Vector, Vector]:
    """Across the beam: growing azimuth and growing elevation of the sensor, both turned."""
    left: Vector = (rotation[1], rotation[4], rotation[7])
    up: Vector = (rotation[2], rotation[5], rotation[8])
    aside = cross(up, direction)
    ops = xp(*aside, turn_rad)
    steep = dot(aside, aside) < 1e-10  # straight up or down there is no azimuth
    x, y, z = (ops.where(steep, other, own) for other, own in zip(left, aside, strict=True))
    azimuth = unit((x, y, z))
    elevation = cross(direction, azimuth)
    cos, sin = ops.cos(turn_rad), ops.sin(turn_rad)
    return mixed(cos, azimuth, sin, elevation), mixed(-sin, azimuth, cos, elevation)
