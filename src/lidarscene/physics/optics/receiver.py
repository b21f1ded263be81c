"""The share of the laser's spot that falls on the detector: field of view, parallax, defocus. Small angles.

Close to a sensor the spot leaves the field of view or is out of focus, so near echoes are weaker than (5) says. All
quantities are angles seen from the receiver's lens, in radians. A lens of radius r_A, focused at R_f, sends the ray
that reaches its point u from direction theta to the angle (place on the detector over f)

    theta - u (1/R - 1/R_f)

So a point at R is imaged to an evenly filled disc of radius r_A |1/R - 1/R_f| about its direction, and the detector
is the disc of radius r_PD / f. The spot is round. Its centre is on the transmitter's axis, at o (1/R - 1/R_0) for
axes a distance o apart that cross at R_0. The detector's share of the light is the spot, smeared by the first disc,
over the second. With f for the distance of the detector, R_f must be far beyond f.

Symbols: R range, R_f focus, R_0 crossing of the axes, o offset, phi field of view, b blur, w spot radius.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from ...maths.arrays import Lanes, xp
from ...maths.special import expm1

_BOUNDARY = 128  # points on half of a circle's boundary: good to 1e-8 for spots as narrow as `_NARROWEST`

_NARROWEST = 20.0
"""Accuracy bought: largest sqrt(radius x distance) of a circle over the spot's radius; narrower spots are widened."""

_RADII = 32  # circles that stand for the blur: 5e-4 for a top hat, 5e-5 for a Gaussian, usually far better


def spot_radius_rad(*, exit_radius_m: Lanes, half_divergence_rad: Lanes, range_m: Lanes) -> Lanes:
    """Angular radius of the spot, sqrt((w_0 / R)^2 + theta^2), for a beam with its waist w_0 at the exit."""
    exit_angle = exit_radius_m / range_m
    square = exit_angle * exit_angle + half_divergence_rad * half_divergence_rad
    return xp(square).sqrt(square)


def parallax_rad(*, offset_m: Lanes, crossing_m: Lanes, range_m: Lanes) -> Lanes:
    """Angle between the spot's centre and the receiver's axis, o |1/R - 1/R_0|. R_0 = inf: parallel axes."""
    return xp(range_m).abs(offset_m * (1.0 / range_m - 1.0 / crossing_m))


def blur_radius_rad(*, aperture_radius_m: Lanes, focus_m: Lanes, range_m: Lanes) -> Lanes:
    """Angular radius of the disc to which the lens images a point at R, r_A |1/R - 1/R_f|."""
    return xp(range_m).abs(aperture_radius_m * (1.0 / range_m - 1.0 / focus_m))


def circles_overlap(*, first_radius: Lanes, second_radius: Lanes, distance: Lanes) -> Lanes:
    """Area that two circles share, in the square of the lengths' unit (T159).

    The sum of two circular segments, whose half angles follow from the law of cosines.
    """
    ops = xp(first_radius, second_radius, distance)
    smaller = ops.minimum(first_radius, second_radius)
    inside = distance <= ops.abs(first_radius - second_radius)
    disjoint = distance >= first_radius + second_radius
    d = ops.where(inside | disjoint, first_radius + second_radius, distance)

    def segment(radius: Lanes, opposite_radius: Lanes) -> Lanes:
        cosine = (d * d + radius * radius - opposite_radius * opposite_radius) / ops.maximum(2.0 * d * radius, 1e-30)
        cosine = ops.minimum(ops.maximum(cosine, -1.0), 1.0)
        sine = ops.sqrt(1.0 - cosine * cosine)
        return radius * radius * (ops.atan2(sine, cosine) - cosine * sine)

    segments = segment(first_radius, second_radius) + segment(second_radius, first_radius)
    return ops.where(inside, math.pi * smaller * smaller, ops.where(disjoint, 0.0, segments))


def gaussian_in_circle(*, spot_radius: Lanes, circle_radius: Lanes, distance: Lanes) -> Lanes:
    r"""Share of a Gaussian spot (radius at 1/e^2) within a circle whose centre is a distance off.

    1 - Q_1(2 d / w, 2 r / w) with Marcum's Q (the distribution of Rice); 1 - exp(-2 r^2 / w^2) on the axis. Computed
    as an integral along the circle's boundary (Green's theorem). Its integrand is smooth and periodic, so evenly
    spaced points converge exponentially:

    .. math:: \frac{1}{\pi}\int_0^\pi \frac{1 - e^{-2\rho^2/w^2}}{\rho^2}\,r\,(r + d \cos t)\,dt,
              \qquad \rho^2 = r^2 + d^2 + 2 r d \cos t

    Spots narrower than sqrt(r d) / 20 (or r / 1000) count as that wide, which blurs the circle's edge by as much.
    """
    ops = xp(spot_radius, circle_radius, distance)
    r, d = circle_radius, distance
    wide = ops.maximum(ops.maximum(spot_radius, ops.sqrt(r * d) / _NARROWEST), 1e-3 * r + 1e-12)
    scale = 2.0 / (wide * wide)
    mean, swing, least = r * r + d * d, 2.0 * r * d, 1e-12 * (wide * wide)
    total: Lanes = 0.0
    for k in range(_BOUNDARY):
        cosine = math.cos(math.pi * (k + 0.5) / _BOUNDARY)
        square = ops.maximum(mean + swing * cosine, least)
        total = total - expm1(-scale * square) / square * (r * (r + d * cosine))
    return ops.minimum(ops.maximum(total / _BOUNDARY, 0.0), 1.0)


def top_hat_in_circle(*, spot_radius: Lanes, circle_radius: Lanes, distance: Lanes) -> Lanes:
    """Share of an evenly lit disc within a circle whose centre is a distance off: shared area over the disc's."""
    ops = xp(spot_radius, circle_radius, distance)
    spot = ops.maximum(spot_radius, 1e-6 * circle_radius)
    area = circles_overlap(first_radius=spot, second_radius=circle_radius, distance=distance)
    return area / (math.pi * spot * spot)


def spot_share(*, profile: str, spot_rad: Lanes, off_axis_rad: Lanes, field_rad: Lanes, blur_rad: Lanes) -> Lanes:
    r"""Share of the spot's light that falls on the detector, in or out of focus.

    It is the mean of `reference.optics.point_share` over the spot. As a function of the distance r from the axis, that
    falls to zero between |b - phi| and b + phi (blur b, field phi), and its slope is the chord c(r) that the two
    circles share. Integration by parts makes the mean an average over the light within circles of these radii, which
    both profiles have in closed form:

    .. math:: \frac{1}{\pi b^2}\int_{|b-\varphi|}^{b+\varphi} c(r)\,P(r)\,dr

    Args:
        profile: "gaussian" (radius at 1/e^2) or "top_hat"
        off_axis_rad: angle of the spot's centre off the axis, `parallax_rad`
        blur_rad: `blur_radius_rad`; 0 in focus
    """
    within = {"gaussian": gaussian_in_circle, "top_hat": top_hat_in_circle}[profile]
    spot = {"spot_radius": spot_rad, "distance": off_axis_rad}
    ops = xp(spot_rad, off_axis_rad, field_rad, blur_rad)
    # `each` puts the circles of all places side by side: as many blurs as places.
    blur_of_each = blur_rad + 0.0 * (spot_rad + off_axis_rad)
    share = _share_with_blur(lambda r: within(circle_radius=r, **spot), field_rad, blur_of_each)
    return ops.minimum(ops.maximum(share, 0.0), 1.0)


def gaussian_share_on_axis(*, spot_rad: Lanes, field_rad: Lanes, blur_rad: Lanes) -> Lanes:
    """`spot_share` of a Gaussian spot on the axis, where the light within a circle needs no sum of its own."""
    return _share_with_blur(
        lambda r: -expm1(-2.0 * r * r / (spot_rad * spot_rad)), field_rad, blur_rad + 0.0 * spot_rad
    )


def _share_with_blur(within: Callable[[Lanes], Lanes], field_rad: Lanes, blur_rad: Lanes) -> Lanes:
    """The share, by the integral of `spot_share`; ``within``: P(r), the spot's light within a circle."""
    ops = xp(field_rad, blur_rad)
    blur = ops.maximum(blur_rad, 1e-6 * field_rad)
    least, near = ops.minimum(blur, field_rad), ops.abs(blur - field_rad)
    # Substituting r^2 = near^2 + half (1 - cos t) makes the chord smooth and periodic in t, so a plain sum converges.
    # Near its start 1 / r^2 may be steep. What the sum misses there is known, because c(r) integrates to pi least^2,
    # and it is added at the start.
    half = 2.0 * blur * field_rad
    steps = [math.pi * (k + 0.5) / _RADII for k in range(_RADII)]
    squares = [near * near + half * (1.0 - math.cos(t)) for t in steps]
    *lights, nearest = ops.each(within, [*map(ops.sqrt, squares), near])
    total: Lanes = 0.0
    missing: Lanes = math.pi * least * least
    for t, square, light in zip(steps, squares, lights, strict=True):
        weight = (0.5 * math.pi / _RADII * math.sin(t) ** 2) * half * half / square
        total, missing = total + weight * light, missing - weight
    total = total + missing * nearest
    return total / (math.pi * blur * blur)
