"""Effective aperture A(theta_r) / A(0) of (4), from what stops the beam: the laws that the scanners use.

All are plain geometry of parallel light and hold for numpy and Dr.Jit alike. Receiver and laser look the same
way through the scanner (coaxial), so what narrows the received beam is what the laser's pulse leaves by.
"""

from __future__ import annotations

import math

from ..maths.arrays import Lanes, xp


def mirror_share(*, cos_incidence: Lanes, cos_at_rest: Lanes) -> Lanes:
    """The mirror is the stop: its area projects on the beam with the cosine of the angle of incidence.

    Above 1 where the mirror turns to face the beam more than at rest; 0 where it shows its back.
    """
    return xp(cos_incidence).maximum(cos_incidence, 0.0) / cos_at_rest


def round_mirror_share(*, cos_incidence: Lanes, mirror_radius_m: Lanes, lens_radius_m: Lanes) -> Lanes:
    r"""A round mirror before a round lens: the part of the lens's disc that the mirror's ellipse covers.

    The mirror projects to an ellipse of half axes a = r_m and b = r_m cos i around the lens's centre. With the
    lens's radius r between b and a the outlines cross at the polar angle t, cos^2 t = (1 - (b/r)^2) / (1 - (b/a)^2),
    and a quarter of the overlap is a sector of the disc (t r^2 / 2) and one of the ellipse, whose eccentric angle
    is E, tan E = (a / b) tan t:

    .. math:: A = 2 \left(r^2 t + a b\,(\pi/2 - E)\right)

    1 where the mirror covers the lens, its own ellipse where it lies inside.
    """
    ops = xp(cos_incidence, mirror_radius_m, lens_radius_m)
    a = mirror_radius_m / lens_radius_m
    b = a * ops.maximum(cos_incidence, 1e-6)
    # Outside b < r < a the clipping makes t pi/2 (only the disc) or 0 (only the ellipse).
    square = (1.0 - b * b) / ops.maximum(1.0 - (b / a) * (b / a), 1e-9)
    cos_t = ops.sqrt(ops.minimum(ops.maximum(square, 0.0), 1.0))
    cos_t = ops.where(a < 1.0, 1.0, cos_t)
    sin_t = ops.sqrt(1.0 - cos_t * cos_t)
    t, eccentric = ops.atan2(sin_t, cos_t), ops.atan2(a * sin_t, b * cos_t)
    return 2.0 / math.pi * (t + a * b * (0.5 * math.pi - eccentric))


def slit_share(*, left: Lanes, right: Lanes) -> Lanes:
    """The part of a unit disc between two straight edges, at -left and +right of its centre (radii)."""
    share = _side_share(left) + _side_share(right) - 1.0
    return xp(share).maximum(share, 0.0)


def _side_share(distance: Lanes) -> Lanes:
    """The part of a unit disc on the near side of a straight edge at this signed distance."""
    ops = xp(distance)
    x = ops.minimum(ops.maximum(distance, -1.0), 1.0)
    return 0.5 + (x * ops.sqrt(1.0 - x * x) + ops.asin(x)) / math.pi
