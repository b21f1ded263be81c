"""Specular returns: a pane or mirror normal to the beam reflects it into the receiver, and the path ends with an echo.

Such a surface has no diffuse reflection, so a BSDF evaluated back along the ray is zero, and the reflected ray itself
almost never meets the small aperture. Yet the real echo may be the brightest of the frame. So the share of the
reflected spot that falls on the aperture is computed in closed form (docs/theory_glass.md 1), and written as the
f_r cos(theta) that a rough surface would need to send back as much.

Symbols: R range (m); delta angle between beam and surface normal; spot radius at 2 R (m); a aperture radius (m).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from ...maths.arrays import Mask, xp
from ...physics.optics import glint, receiver
from ..device.backend import mitsuba
from .meeting import Meeting, Moment
from .onward import BeamPath

_WIDTHS = 3.0
"""Accuracy bought: reach of a spot beyond the aperture's edge, in its radii (1/e^2). If the spot's centre is farther
away, the path goes on instead: a Gaussian beam has fallen to exp(-2 * 3^2) = 1.5e-8 there, and would look no brighter
than a board of a few per cent."""


def specular_return(
    moment: Moment, path: BeamPath, meeting: Meeting, further: BeamPath, active: Mask
) -> tuple[Any, BeamPath]:
    """Find where the reflected beam comes back to the receiver.

    Args:
        path: the path up to the pane or mirror
        further: the path beyond it, as it reflects
        active: (n,) where it reflects. Paths that were reflected before do not come back: what they see of the sensor
            is not traced

    Returns:
        (n,) flags, and the path that ends there
    """
    import drjit as dr

    mi = mitsuba()
    aim = moment.aim
    if aim is None:
        return mi.Bool(False), path
    # The normal is in the frame of the body that was met; the beam's axes are in the traced frame.
    normal = mi.Vector3f(meeting.direction_outside(meeting.surface.n))
    range_m = path.length_m + meeting.t
    # The surface mirrors the aperture to a place 2 R away along its normal. Seen across the beam that image is
    # 2 R sin(delta) off the axis: the component of the normal along each of the two axes across the beam. Components
    # keep their precision at small angles; 1 - cos(delta) would lose it in single precision.
    aside = [2.0 * range_m * dr.dot(normal, mi.Vector3f(*axis)) for axis in aim.across]
    spot = [
        2.0
        * range_m
        * receiver.spot_radius_rad(exit_radius_m=aim.exit_radius_m, half_divergence_rad=slope, range_m=2.0 * range_m)
        for slope in aim.slope
    ]
    # An ellipse about the aperture, as far as the spot reaches; outside of it the share is not worth asking for.
    ops = xp(range_m)
    aperture = ops.sqrt(aim.aperture_m2 * (1.0 / math.pi))
    reach = [off / (aperture + _WIDTHS * width) for off, width in zip(aside, spot, strict=True)]
    near = reach[0] * reach[0] + reach[1] * reach[1] < 1.0
    share = glint.share_on_aperture(
        profile=aim.profile, aside_m=(aside[0], aside[1]), spot_radius_m=(spot[0], spot[1]), aperture_radius_m=aperture
    )
    # An echo's power goes with throughput^2, once there and once back. Here the panes before the surface are passed
    # twice and the surface reflects once: T (T R) = throughput^2 with throughput = sqrt(T * T R).
    through = ops.sqrt(mi.Float(path.throughput) * further.throughput)
    bright = glint.apparent_backscatter_per_sr(share=share, range_m=range_m, aperture_m2=aim.aperture_m2)
    comes_back = active & ~mi.Bool(path.mirrored) & near & (bright > 0.0)
    ended = dataclasses.replace(path, throughput=through, glint_per_sr=dr.select(comes_back, bright, 0.0))
    return comes_back, ended
