"""Glints: where a pane or mirror throws the beam back onto the receiver, its way ends there, with an echo."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from ...maths.arrays import xp
from ...physics.optics import glint, receiver
from ..device.backend import mitsuba
from .meeting import Meeting, Moment
from .onward import Way

_WIDTHS = 3.0
"""Spots whose centre is farther from the aperture's edge than this many radii go on instead: a Gaussian beam has
fallen to 1.5e-8 there, and would look no brighter than a board of a few per cent."""


def returned(moment: Moment, way: Way, met: Meeting, further: Way, active: Any) -> tuple[Any, Way]:
    """Where the mirrored beam comes back to the receiver, and the way as it ends there.

    further  the way beyond the pane or mirror, as that reflects it
    active   where it does. Ways that something has mirrored before do not come back: what they see of the sensor is
             not traced
    """
    import drjit as dr

    mi = mitsuba()
    aim = moment.aim
    if aim is None:
        return mi.Bool(False), way
    normal = mi.Vector3f(met.surface.n)
    for (_, place), here in zip(moment.moving, met.here, strict=True):
        normal = dr.select(here, mi.Vector3f(*place.vector(tuple(normal))), normal)
    range_m = way.length_m + met.t
    # The sensor's image is 2 R away along the normal: across the beam it is 2 R sin(delta) off its axis. Components
    # keep their precision at small angles, cosines would not.
    aside = [2.0 * range_m * dr.dot(normal, mi.Vector3f(*axis)) for axis in aim.across]
    spot = [
        2.0 * range_m
        * receiver.spot_radius_rad(
            exit_radius_m=aim.exit_radius_m, half_divergence_rad=slope, range_m=2.0 * range_m
        )
        for slope in aim.slope
    ]  # fmt: skip
    ops = xp(range_m)
    aperture = ops.sqrt(aim.aperture_m2 * (1.0 / math.pi))
    reach = [off / (aperture + _WIDTHS * width) for off, width in zip(aside, spot, strict=True)]
    near = reach[0] * reach[0] + reach[1] * reach[1] < 1.0
    share = glint.share_on_aperture(
        profile=aim.profile, aside_m=(aside[0], aside[1]), spot_radius_m=(spot[0], spot[1]),
        aperture_radius_m=aperture,
    )  # fmt: skip
    # There by the way, back by the way once more, and one reflection between them.
    through = ops.sqrt(mi.Float(way.throughput) * further.throughput)
    bright = glint.apparent_backscatter_per_sr(share=share, range_m=range_m, aperture_m2=aim.aperture_m2)
    back = active & ~mi.Bool(way.mirrored) & near & (bright > 0.0)
    ended = dataclasses.replace(way, throughput=through, glint_per_sr=dr.select(back, bright, 0.0))
    return back, ended
