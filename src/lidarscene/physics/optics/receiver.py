"""What of the laser's spot falls on the detector: field of view, parallax, defocus. Geometric optics, small angles.

All of it in angles seen from the receiver's lens, in radians. A lens of radius r_A and focal length f that is focused
at R_f sends the ray that reaches its point u from direction theta to the angle (place on the detector over f)

    theta - u (1/R - 1/R_f)

so a point at R is imaged to a disc of radius r_A |1/R - 1/R_f| about its direction, evenly filled, and the detector is
the disc of radius r_PD / f. The spot is round, centred where the transmitter's axis is: at o (1/R - 1/R_0) with the
axes o apart and crossing at R_0. The share of the light that the detector gets is the spot, smeared by the first
disc, over the second. With f for the distance of the detector, R_f is well beyond f.
"""

from __future__ import annotations

import math

from ...maths.arrays import Lanes, xp
from ...maths.special import expm1

_BOUNDARY = 128  # points on half of a circle's boundary: good to 1e-8 for spots as narrow as below
_NARROWEST = (
    20.0  # a circle, and how far off it is, over the spot's radius: narrower spots count as this wide
)
_RADII = 32  # circles that stand for the blur: 5e-4 for a top hat, 5e-5 for a Gaussian, mostly far better


def field_of_view_half_angle_rad(*, detector_radius_m: Lanes, focal_length_m: Lanes) -> Lanes:
    """Half angle of the receiver's field of view, atan(r_PD / f); 3.3 mrad at Table 1."""
    return xp(detector_radius_m, focal_length_m).atan2(detector_radius_m, focal_length_m)


def spot_radius_rad(*, exit_radius_m: Lanes, half_divergence_rad: Lanes, range_m: Lanes) -> Lanes:
    """Angular radius of the spot, sqrt((w_0 / R)^2 + theta^2): a beam with its waist w_0 where it leaves."""
    near = exit_radius_m / range_m
    square = near * near + half_divergence_rad * half_divergence_rad
    return xp(square).sqrt(square)


def parallax_rad(*, offset_m: Lanes, crossing_m: Lanes, range_m: Lanes) -> Lanes:
    """Angle between the spot's centre and the receiver's axis, o |1/R - 1/R_0|; R_0 = inf: axes side by side."""
    return xp(range_m).abs(offset_m * (1.0 / range_m - 1.0 / crossing_m))


def blur_radius_rad(*, aperture_radius_m: Lanes, focus_m: Lanes, range_m: Lanes) -> Lanes:
    """Radius of the disc to which the lens images a point at R, r_A |1/R - 1/R_f|, over the focal length."""
    return xp(range_m).abs(aperture_radius_m * (1.0 / range_m - 1.0 / focus_m))


def circles_overlap(*, first_radius: Lanes, second_radius: Lanes, distance: Lanes) -> Lanes:
    """Area that two circles have in common, in the square of the unit of the three lengths.

    The sum of two circular segments whose half angles are the law of cosines (any handbook: "lens").
    """
    ops = xp(first_radius, second_radius, distance)
    least = ops.minimum(first_radius, second_radius)
    inside = distance <= ops.abs(first_radius - second_radius)
    apart = distance >= first_radius + second_radius
    d = ops.where(inside | apart, first_radius + second_radius, distance)

    def segment(own: Lanes, other: Lanes) -> Lanes:
        cosine = (d * d + own * own - other * other) / ops.maximum(2.0 * d * own, 1e-30)
        cosine = ops.minimum(ops.maximum(cosine, -1.0), 1.0)
        sine = ops.sqrt(1.0 - cosine * cosine)
        return own * own * (ops.atan2(sine, cosine) - cosine * sine)

    both = segment(first_radius, second_radius) + segment(second_radius, first_radius)
    return ops.where(inside, math.pi * least * least, ops.where(apart, 0.0, both))


def gaussian_in_circle(*, spot_radius: Lanes, circle_radius: Lanes, distance: Lanes) -> Lanes:
    r"""Share of a Gaussian spot (radius at 1/e^2) within a circle whose centre is a distance off.

    1 - Q_1(2 d / w, 2 r / w) with Marcum's Q (the distribution of Rice): 1 - exp(-2 r^2 / w^2) on the axis. Here as
    an integral along the circle's boundary, by Green's theorem, whose integrand is smooth and periodic, so that
    evenly spaced points converge exponentially:

    .. math:: \frac{1}{\pi}\int_0^\pi \frac{1 - e^{-2\rho^2/w^2}}{\rho^2}\,r\,(r + d \cos t)\,dt,
              \qquad \rho^2 = r^2 + d^2 + 2 r d \cos t

    Spots narrower than sqrt(r d) / 20 (or r / 1000) count as that wide: the circle's edge is then blurred by so much.
    """
    ops = xp(spot_radius, circle_radius, distance)
    r, d = circle_radius, distance
    wide = ops.maximum(ops.maximum(spot_radius, ops.sqrt(r * d) / _NARROWEST), 1e-3 * r + 1e-12)
    scale = 2.0 / (wide * wide)
    total: Lanes = 0.0
    for k in range(_BOUNDARY):
        cosine = math.cos(math.pi * (k + 0.5) / _BOUNDARY)
        square = ops.maximum(r * r + d * d + 2.0 * r * d * cosine, 1e-12 * (wide * wide))
        total = total - expm1(-scale * square) / square * (r * (r + d * cosine))
    return ops.minimum(ops.maximum(total / _BOUNDARY, 0.0), 1.0)


def top_hat_in_circle(*, spot_radius: Lanes, circle_radius: Lanes, distance: Lanes) -> Lanes:
    """Share of an evenly lit disc within a circle whose centre is a distance off: the lens over the disc."""
    ops = xp(spot_radius, circle_radius, distance)
    spot = ops.maximum(spot_radius, 1e-6 * circle_radius)
    area = circles_overlap(first_radius=spot, second_radius=circle_radius, distance=distance)
    return area / (math.pi * spot * spot)


def point_share(*, off_axis_rad: Lanes, field_rad: Lanes, blur_rad: Lanes) -> Lanes:
    """Share of the light of one point that falls on the detector: how much of its disc the field of view covers.

    off_axis_rad  between the point's direction and the receiver's axis
    """
    return top_hat_in_circle(spot_radius=blur_rad, circle_radius=field_rad, distance=off_axis_rad)


def spot_share(
    *, profile: str, spot_rad: Lanes, off_axis_rad: Lanes, field_rad: Lanes, blur_rad: Lanes
) -> Lanes:
    r"""Share of the spot's light that falls on the detector, out of focus too.

    profile       "gaussian" (radius at 1/e^2) or "top_hat"
    off_axis_rad  of the spot's centre, `parallax_rad`
    blur_rad      `blur_radius_rad`; 0 in focus

    `point_share` over the spot. It falls from its value on the axis to zero between |b - phi| and b + phi (blur b,
    field phi), and its slope is the chord that the two circles share, c(r). By parts that is an average of what lies
    within circles of these radii, which both profiles have in closed form:

    .. math:: \frac{1}{\pi b^2}\int_{|b-\varphi|}^{b+\varphi} c(r)\,P(r)\,dr
    """
    within = {"gaussian": gaussian_in_circle, "top_hat": top_hat_in_circle}[profile]
    ops = xp(spot_rad, off_axis_rad, field_rad, blur_rad)
    blur = ops.maximum(blur_rad, 1e-6 * field_rad)
    least, near = ops.minimum(blur, field_rad), ops.abs(blur - field_rad)
    spot = {"spot_radius": spot_rad, "distance": off_axis_rad}
    # In r^2 = near^2 + half (1 - cos t) the chord is smooth and periodic; what the sum misses near its start, where
    # 1 / r^2 may be steep, is known, since c(r) has the integral pi least^2.
    half = 2.0 * blur * field_rad
    total: Lanes = 0.0
    missing: Lanes = math.pi * least * least
    for k in range(_RADII):
        t = math.pi * (k + 0.5) / _RADII
        square = near * near + half * (1.0 - math.cos(t))
        weight = (0.5 * math.pi / _RADII * math.sin(t) ** 2) * half * half / square
        total = total + weight * within(circle_radius=ops.sqrt(square), **spot)
        missing = missing - weight
    total = total + missing * within(circle_radius=near, **spot)
    return ops.minimum(ops.maximum(total / (math.pi * blur * blur), 0.0), 1.0)


def blind_range_m(
    *, offset_m: Lanes, exit_radius_m: Lanes, aperture_radius_m: Lanes, field_rad: Lanes, edge_rad: Lanes
) -> Lanes:
    """Range below which nothing of the spot reaches the detector: two axes side by side, focus at infinity.

    There o / R = phi + theta + (r_A + w_0) / R: the spot's inner edge, blurred, leaves the field of view. 0 where the
    axes are closer than the radii of exit and lens together. Beams of straight edges, ``edge_rad`` from the axis, that
    start ``exit_radius_m`` wide.
    """
    ops = xp(offset_m, aperture_radius_m, field_rad, edge_rad)
    return ops.maximum(offset_m - aperture_radius_m - exit_radius_m, 0.0) / (field_rad + edge_rad)
