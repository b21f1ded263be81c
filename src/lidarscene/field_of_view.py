"""Field of view: a Sensor in, directions all over what its receiver sees out; their background in, each pulse's out."""

from __future__ import annotations

import math
from dataclasses import replace

from .arrays import Array, Table, xp
from .beams import Beams
from .echoes import Ambient, receive, sun_disc_w
from .footprint import Footprint, points
from .hits import Hits
from .physics.sunlight import SUN_RADIUS_RAD
from .scan.vectors import Vector, dot, mixed
from .sensor import Sensor


def field_of_view(sensor: Sensor, rays: int) -> Footprint:
    """Directions that share the receiver's field of view evenly: the detector's disc, seen through the lens.

    They start in the middle of the lens: the background's patch is sharp only where the lens is focused, far away.
    """
    slope = float(sensor.detector.radius_m) / float(sensor.optics.focal_length_m)
    return Footprint(
        points=Table(points("top_hat", rays)), exit_radius_m=0.0, slope=(slope, slope), turn_rad=0.0
    )


def background_power_w(
    axes: Beams, rays: Beams, hits: Hits, sensor: Sensor, ambient: Ambient, *, count: int
) -> Array:
    """(n,) mean over what the rays of each pulse see, and as much of the sun's disc as is not hidden.

    axes   of the receiver, n of them; rays, hits  ``count`` of each, lane = pulse lane * count + number
    """
    light = receive(rays, hits, sensor, replace(ambient, sun_direction=None))
    ops = xp(light.background_power_w)
    total = sum(ops.column(light.background_power_w, number, count) for number in range(count))
    mean = total * (1.0 / count)
    if ambient.sun_direction is None:
        return mean
    return mean + _free_share(rays, hits, ambient.sun_direction, count) * sun_disc_w(axes, sensor, ambient)


def _free_share(rays: Beams, hits: Hits, sun: Vector, count: int) -> Array:
    """(n,) share of the rays towards the disc that meet nothing; without any there the nearest one stands for it."""
    apart = mixed(1.0, rays.direction, -1.0, sun)
    square = dot(apart, apart)  # the chord, as in `sun_disc_w`
    ops = xp(square)
    nearest, by_nearest, free, inside = math.inf, 0.0, 0.0, 0.0
    for number in range(count):
        own = ops.column(square, number, count)
        sees = ops.where(ops.column(hits.found, number, count), 0.0, 1.0)
        by_nearest = ops.where(own < nearest, sees, by_nearest)
        nearest = ops.where(own < nearest, own, nearest)
        on_disc = ops.where(own < SUN_RADIUS_RAD * SUN_RADIUS_RAD, 1.0, 0.0)
        free, inside = free + on_disc * sees, inside + on_disc
    return ops.where(inside > 0.0, free / ops.where(inside > 0.0, inside, 1.0), by_nearest)
