"""Panes and water films: published values, limits, and sums that are counted instead of summed."""

import math

import numpy as np
import pytest

from lidarscene.materials.material_file import catalogue_material
from lidarscene.physics.optics import dielectrics
from lidarscene.physics.reference import optics as reference_optics


def test_fresnel_reflectance():
    """Normal incidence ((n - 1) / (n + 1))^2, all of it at grazing; no in-plane light at Brewster's angle."""
    r = dielectrics.fresnel_reflectance(cos_incidence=np.array([1.0, 0.0]), index=1.5)
    np.testing.assert_allclose(r, [0.04, 1.0], rtol=1e-12)
    brewster = math.cos(math.atan(1.5))
    across = ((1.5**2 - 1) / (1.5**2 + 1)) ** 2
    r = dielectrics.fresnel_reflectance(cos_incidence=np.float64(brewster), index=1.5)
    assert r == pytest.approx(across / 2, rel=1e-12)


@pytest.mark.parametrize("index", [1.2, 1.33, 1.5, 2.0])
def test_diffuse_fresnel_reflectance(index):
    """Walsh's closed form (Duntley, J. Opt. Soc. Am. 32, 61, 1942), and the mean over a million equal shares."""
    n, square = index, index**2
    closed = (
        0.5
        + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
        + square * (square - 1) ** 2 / (square + 1) ** 3 * math.log((n - 1) / (n + 1))
        - 2 * n**3 * (square + 2 * n - 1) / ((square + 1) * (n**4 - 1))
        + 8 * n**4 * (n**4 + 1) / ((square + 1) * (n**4 - 1) ** 2) * math.log(n)
    )
    value = reference_optics.diffuse_fresnel_reflectance(index)
    assert value == pytest.approx(closed, rel=1e-6)
    cosines = np.sqrt((np.arange(1_000_000) + 0.5) / 1e6)  # equal shares of 2 mu dmu
    counted = dielectrics.fresnel_reflectance(cos_incidence=cosines, index=index).mean()
    assert value == pytest.approx(counted, rel=1e-5)


@pytest.mark.parametrize("internal", [1.0, 0.8, 0.3])
@pytest.mark.parametrize("surface", [0.04, 0.5])
def test_a_pane_is_the_sum_of_its_passages(surface, internal):
    """Light followed from face to face until 1e-15 of it is left."""
    inside, mirrored, through, at_front = 1.0 - surface, surface, 0.0, False
    while inside > 1e-15:
        inside *= internal
        if at_front:
            mirrored += inside * (1.0 - surface)
        else:
            through += inside * (1.0 - surface)
        inside, at_front = inside * surface, not at_front
    assert dielectrics.pane_transmittance(surface=surface, internal=internal) == pytest.approx(through, rel=1e-12)
    assert dielectrics.pane_reflectance(surface=surface, internal=internal) == pytest.approx(mirrored, rel=1e-12)
    if internal == 1.0:
        assert mirrored == pytest.approx(2 * surface / (1 + surface), rel=1e-12)
        assert mirrored + through == pytest.approx(1.0, rel=1e-12)


def test_passage_through_glass():
    """exp(-4 pi k d / lambda) straight across; at an angle the way is longer by Snell's law."""
    depth = dielectrics.optical_depth(index_k=1e-5, thickness_m=4e-3, wavelength_m=905e-9)
    assert depth == pytest.approx(4 * math.pi * 1e-5 * 4e-3 / 905e-9, rel=1e-12)
    inside = math.asin(math.sin(math.radians(60.0)) / 1.5)
    transmittance = dielectrics.internal_transmittance(depth=depth, cos_incidence=np.float64(0.5), index=1.5)
    assert transmittance == pytest.approx(math.exp(-depth / math.cos(inside)), rel=1e-12)


def test_wet_surfaces():
    """Black stays black and white white; between it is darker."""
    reflected = 1.0 - (1.0 - reference_optics.diffuse_fresnel_reflectance(1.33)) / 1.33**2
    assert reference_optics.wet_reflectivity(dry=0.0, index=1.33) == 0.0
    # All comes back of a white base: the mirror's 2 % are not in the diffuse part.
    assert reference_optics.wet_reflectivity(dry=1.0, index=1.33) == pytest.approx(1.0 - 0.02006, abs=1e-4)
    for dry in (0.1, 0.3, 0.6):
        assert 0.4 * dry < reference_optics.wet_reflectivity(dry=dry, index=1.33) < dry
    # Followed up and down through the film, bounce by bounce.
    up, out = (1.0 - 0.02006) * 0.3, 0.0
    for _ in range(100):
        out, up = out + up * (1.0 - reflected), up * reflected * 0.3
    assert reference_optics.wet_reflectivity(dry=0.3, index=1.33) == pytest.approx(out, rel=1e-4)


@pytest.mark.parametrize("name", ["asphalt", "concrete"])
def test_wet_roads_of_the_catalogue(name):
    """Their values are those of dry ones by the formula, with the water's absorption where it counts (1550 nm)."""
    from scipy.special import expn

    for wavelength_nm, index_k in ((905, 6.0e-7), (1550, 9.86e-5)):
        depth = dielectrics.optical_depth(index_k=index_k, thickness_m=0.2e-3, wavelength_m=wavelength_nm * 1e-9)
        dry, wet = (catalogue_material(kind).at(wavelength_nm * 1e-9)["reflectivity"] for kind in (name, f"{name}_wet"))
        reflectivity = reference_optics.wet_reflectivity(
            dry=dry, index=1.33, internal=math.exp(-depth), internal_diffuse=2.0 * float(expn(3, depth))
        )
        assert wet == pytest.approx(reflectivity, abs=1e-4)  # four digits in the file
