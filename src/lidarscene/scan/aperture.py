"""Effective aperture A(theta_r) / A(0) of (4): geometry of what stops the received beam.

The paper says that the aperture depends on the scanning method and gives no law; these are the laws of the scanners.
They are plain geometry of parallel light, for numpy and Dr.Jit. Receiver and laser look the same way through the
scanner (coaxial), so the laser's direction is that of the received beam.

Symbols: i angle of incidence on a mirror, r_m mirror radius, t polar angle, E eccentric angle.
"""

from __future__ import annotations

import math

from ..maths.arrays import Lanes, xp


def mirror_share(*, cos_incidence: Lanes, cos_at_rest: Lanes) -> Lanes:
    """The mirror is the stop: its projected area goes with the cosine of the angle of incidence.

    Above 1 where the mirror faces the beam more than at rest; 0 where it shows its back.
    """
    return xp(cos_incidence).maximum(cos_incidence, 0.0) / cos_at_rest


def round_mirror_share(*, cos_incidence: Lanes, mirror_radius_m: Lanes, lens_radius_m: Lanes) -> Lanes:
    r"""A round mirror in front of a round lens: the part of the lens's disc that the mirror's ellipse covers.

    The mirror projects to an ellipse with half axes a = r_m and b = r_m cos i around the lens's centre. If the lens's
    radius r is between b and a, the outlines cross at the polar angle t with cos^2 t = (1 - (b/r)^2) / (1 - (b/a)^2).
    A quarter of the overlap is then a sector of the disc, t r^2 / 2, and one of the ellipse with eccentric angle E,
    tan E = (a / b) tan t:

    .. math:: A = 2 \left(r^2 t + a b\,(\pi/2 - E)\right)

    1 if the mirror covers the lens; the ellipse's own area if it lies inside.
    """
    ops = xp(cos_incidence, mirror_radius_m, lens_radius_m)
    a = mirror_radius_m / lens_radius_m
    b = a * ops.maximum(cos_incidence, 1e-6)
    # Where the outlines do not cross, the clipping gives t = pi/2 (whole disc) or t = 0 (whole ellipse).
    square = (1.0 - b * b) / ops.maximum(1.0 - (b / a) * (b / a), 1e-9)
    cos_t = ops.sqrt(ops.minimum(ops.maximum(square, 0.0), 1.0))
    cos_t = ops.where(a < 1.0, 1.0, cos_t)
    sin_t = ops.sqrt(1.0 - cos_t * cos_t)
    t, eccentric = ops.atan2(sin_t, cos_t), ops.atan2(a * sin_t, b * cos_t)
    return 2.0 / math.pi * (t + a * b * (0.5 * math.pi - eccentric))


def slit_share(*, left: Lanes, right: Lanes) -> Lanes:
    """Part of a unit disc between two straight edges, at -left and +right of its centre (in radii)."""
    share = _side_share(left) + _side_share(right) - 1.0
    return xp(share).maximum(share, 0.0)


def _side_share(distance: Lanes) -> Lanes:
    """Part of a unit disc on the near side of a straight edge at this signed distance from its centre."""
    ops = xp(distance)
    x = ops.minimum(ops.maximum(distance, -1.0), 1.0)
    return 0.5 + (x * ops.sqrt(1.0 - x * x) + ops.asin(x)) / math.pi
