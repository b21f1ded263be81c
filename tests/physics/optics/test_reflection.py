"""Rough matt reflection: the closed form against the integral over V-grooves, energy, reciprocity, published values."""

import math

import numpy as np
import pytest

from lidarscene.physics.optics import reflection

STRAIGHT_BACK = range(0, 84, 3)
AROUND = [(i, o, p) for i in (0, 30, 60, 75) for o in (15, 45, 65) for p in range(0, 181, 45)]


def direction(theta_deg, phi_deg=0.0):
    theta, phi = np.radians(theta_deg), np.radians(phi_deg)
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0.0 * phi])


def per_sr(slope_deg, incoming, outgoing, reflectivity=1.0):
    return reflection.rough_diffuse_per_sr(
        reflectivity=reflectivity,
        relief=reflection.relief(math.radians(slope_deg)),
        cos_in=incoming[2],
        cos_out=outgoing[2],
        cos_between=np.tensordot(incoming, outgoing, 1),
    )


def grooves_per_sr(slope_deg, incoming, outgoing):
    """f_r of V-grooves of white matt facets, by the integral that Oren and Nayar (1994) start from.

    Facets of all azimuths, the density of their slope Gaussian per solid angle; shadowing and masking by Torrance
    and Sparrow; no light from facet to facet. A sum over 90 x 90 facets, good to 2e-3.
    """
    theta, phi = np.meshgrid(np.arange(90) + 0.5, np.arange(90) * 4.0, indexing="ij")
    facet = direction(theta, phi)
    weight = np.exp(-0.5 * (theta / slope_deg) ** 2) * np.sin(np.radians(theta))
    to_in, to_out = np.tensordot(incoming, facet, 1), np.tensordot(outgoing, facet, 1)
    facing = (to_in > 0) & (to_out > 0)
    to_in, to_out = np.where(facing, to_in, 1.0), np.where(facing, to_out, 1.0)
    open_share = np.minimum(
        1.0, 2.0 * facet[2] * np.minimum(incoming[2] / to_in, outgoing[2] / to_out)
    )  # of the facet, neither in shadow nor hidden
    sent = np.where(facing, to_in * to_out * open_share / (facet[2] * incoming[2] * outgoing[2]), 0.0)
    return float((weight * sent).sum() / weight.sum() / math.pi)


@pytest.mark.parametrize("slope_deg", [20, 30, 45])
def test_straight_back_it_is_the_integral_over_grooves(slope_deg):
    """Agreement to 8 % of the brightness at normal incidence, from 0 to 81 degrees: what the published fit is worth.

    Lambert's law is 28 % (20 degrees of slope) to 64 % (45) off, by the same measure.
    """
    normal = direction(0)
    closed = np.array([per_sr(slope_deg, direction(t), direction(t)) * direction(t)[2] for t in STRAIGHT_BACK])
    exact = np.array(
        [grooves_per_sr(slope_deg, direction(t), direction(t)) * direction(t)[2] for t in STRAIGHT_BACK]
    ) / (grooves_per_sr(slope_deg, normal, normal) * math.pi)
    assert np.abs(closed - exact).max() < 0.08 / math.pi
    lambert = np.cos(np.radians(STRAIGHT_BACK)) / math.pi
    assert np.abs(lambert - exact).max() > 0.2 / math.pi


@pytest.mark.parametrize("slope_deg", [20, 30, 45])
def test_into_all_directions_it_is_the_integral_over_grooves(slope_deg):
    """Root mean square 0.07 of the brightness at normal incidence; without the sign of s it is 0.13 or more."""

    def error(model):
        whole = grooves_per_sr(slope_deg, direction(0), direction(0)) * math.pi
        wrong = [
            model(direction(i), direction(o, p)) - grooves_per_sr(slope_deg, direction(i), direction(o, p)) / whole
            for i, o, p in AROUND
        ]
        return math.pi * math.sqrt(np.mean(np.square(wrong)))

    assert error(lambda a, b: per_sr(slope_deg, a, b)) < 0.07
    assert error(lambda a, b: max(per_sr(slope_deg, a, b), 1.0 / math.pi)) > 0.1


@pytest.mark.parametrize(("slope_deg", "exponent", "over_lambert"), [(30, 0.27, 4.5), (45, 0.20, 5.7)])
def test_a_road_hardly_darkens_at_flat_angles(slope_deg, exponent, over_lambert):
    """f_r cos(theta) from 70 to 83 degrees as a power of the cosine, and over a Lambertian of the same reflectivity."""
    returned = [per_sr(slope_deg, direction(t), direction(t)) * direction(t)[2] for t in (70, 83)]
    power = math.log(returned[1] / returned[0]) / math.log(direction(83)[2] / direction(70)[2])
    assert power == pytest.approx(exponent, abs=0.01)
    assert returned[1] * math.pi / direction(83)[2] == pytest.approx(over_lambert, abs=0.05)


def hemisphere():
    """Directions of equal solid angle, (3, n), and that solid angle."""
    z, phi = np.meshgrid((np.arange(400) + 0.5) / 400, np.arange(90) * 4.0, indexing="ij")
    directions = direction(np.degrees(np.arccos(z.ravel())), phi.ravel())
    return directions, 2.0 * math.pi / z.size


@pytest.mark.parametrize("slope_deg", [10, 30, 60])
def test_energy(slope_deg):
    """The hemispherical reflectance at normal incidence is the reflectivity; none beyond 1 at the largest allowed.

    Tolerance: the sum over the hemisphere.
    """
    outgoing, solid_angle = hemisphere()
    white = reflection.largest_reflectivity(math.radians(slope_deg))

    def reflectance(theta_deg):
        return float((per_sr(slope_deg, direction(theta_deg), outgoing, white) * outgoing[2]).sum() * solid_angle)

    assert reflectance(0) == pytest.approx(white, rel=1e-4)
    along = [reflectance(theta) for theta in (30, 60, 80, 89.9)]
    assert max(along) < 1.001
    assert along[-1] == pytest.approx(1.0, abs=0.005)


def test_straight_down_it_is_lambert_from_all_sides():
    for theta in (0, 40, 80):
        assert per_sr(40, direction(0), direction(theta)) == pytest.approx(1.0 / math.pi, rel=1e-12)
    assert per_sr(1e-6, direction(70), direction(70)) == pytest.approx(1.0 / math.pi, rel=1e-9)


def test_reciprocal():
    for i, o, p in AROUND:
        forth = per_sr(35, direction(i), direction(o, p))
        assert forth == pytest.approx(per_sr(35, direction(o, p), direction(i)), rel=1e-12)
        assert forth > 0.0
