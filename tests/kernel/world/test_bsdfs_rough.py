"""Rough matt surfaces as Mitsuba's plug-in: the formula from both sides, and through the whole chain."""

import math

import numpy as np
import pytest
from helpers import chain
from helpers.mistakes import told

from lidarscene.kernel.world import bsdfs
from lidarscene.materials.material import Material, Spectrum
from lidarscene.physics.optics import reflection

pytestmark = pytest.mark.usefixtures("mi")

MIDDLE = 4
VALUES = {"name": "road", "bsdf": "diffuse", "reflectivity": 0.2, "facet_slope_deg": 40.0}
RELIEF = reflection.relief(math.radians(40.0))


def scattered_per_sr(mi, bsdf, incoming, outgoing):
    import drjit as dr

    surface = dr.zeros(mi.SurfaceInteraction3f, 1)
    surface.wi = mi.Vector3f(*(float(x) for x in incoming))
    return float(bsdf.eval(mi.BSDFContext(), surface, mi.Vector3f(*(float(x) for x in outgoing)), True)[0][0])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_plug_in_is_the_formula(mi, side):
    """Seen from both sides, and nothing through it. Single precision: 1e-5."""
    bsdf = mi.load_dict(bsdfs.bsdf_dict(VALUES))
    rng = np.random.default_rng(0)
    for _ in range(20):
        incoming, outgoing = (v / np.linalg.norm(v) for v in np.abs(rng.normal(size=(2, 3))))
        incoming[0] *= rng.choice([-1.0, 1.0])
        expected = outgoing[2] * reflection.rough_diffuse_per_sr(
            reflectivity=0.2,
            relief=RELIEF,
            cos_in=incoming[2],
            cos_out=outgoing[2],
            cos_between=float(incoming @ outgoing),
        )
        turned = np.array([1.0, 1.0, side])
        assert scattered_per_sr(mi, bsdf, incoming * turned, outgoing * turned) == pytest.approx(expected, rel=1e-5)
        assert scattered_per_sr(mi, bsdf, incoming * turned, -outgoing * turned) == 0.0


def test_sampling_matches_its_density(mi):
    """The weight times the density is the value, for every sample: what a path tracer relies on."""
    import drjit as dr

    bsdf = mi.load_dict(bsdfs.bsdf_dict(VALUES))
    surface = dr.zeros(mi.SurfaceInteraction3f, 500)
    surface.wi = dr.normalize(mi.Vector3f(0.6, 0.0, 0.5))
    pair = mi.Point2f(np.random.default_rng(0).random((2, 500)).astype(np.float32))
    sample, weight = bsdf.sample(mi.BSDFContext(), surface, mi.Float(0.5), pair)
    value, density = bsdf.eval_pdf(mi.BSDFContext(), surface, sample.wo)
    np.testing.assert_allclose(weight[0].numpy() * density.numpy(), value[0].numpy(), rtol=1e-4, atol=1e-7)


def material(**parameters):
    return Material(name="road", bsdf="diffuse", reflectivity=Spectrum.constant(0.2), parameters=parameters)


def test_beam_and_sun_see_the_same_relief():
    """A board at 70 degrees: echo and sunlight are those of the formula, over a Lambertian board's (1e-4: float32)."""
    sensor = chain.sensor("table1-apd", *chain.NARROW)
    body = chain.facing(range_m=30.0, theta_deg=70.0, material="road")
    matt, rough = (
        chain.run_stages(chain.scene(body, materials=(rough_material,)), sensor).hits
        for rough_material in (material(), material(facet_slope_deg=40.0))
    )
    cos, cos_sun = (float(value[MIDDLE]) for value in (rough.cos_incidence, rough.cos_sun))
    assert rough.lit[MIDDLE]
    assert float(rough.reflectivity[MIDDLE]) == pytest.approx(0.2)
    expected = reflection.rough_diffuse_per_sr(
        reflectivity=0.2, relief=RELIEF, cos_in=cos, cos_out=cos, cos_between=1.0
    )
    assert float(rough.backscatter_per_sr[MIDDLE]) == pytest.approx(expected * cos, rel=1e-4)
    assert float(matt.backscatter_per_sr[MIDDLE]) == pytest.approx(0.2 / math.pi * cos, rel=1e-4)
    # The sun's direction is the scene's: what is asked of the formula is the angle between beam and sun.
    between = float(np.dot(chain.scene(body).sun.direction, [-1.0, 0.0, 0.0]))
    from_sun = reflection.rough_diffuse_per_sr(
        reflectivity=0.2, relief=RELIEF, cos_in=cos, cos_out=cos_sun, cos_between=between
    )
    assert float(rough.sun_scatter_per_sr[MIDDLE]) == pytest.approx(from_sun * cos_sun, rel=1e-3)
    assert float(rough.sun_scatter_per_sr[MIDDLE]) != pytest.approx(float(matt.sun_scatter_per_sr[MIDDLE]), rel=0.01)


def test_more_light_than_came_is_an_error():
    with told("'road' | reflectivity | <= 0.865 | facet_slope_deg | 40 | 0.9"):
        bsdfs.bsdf_dict(VALUES | {"reflectivity": 0.9})
    with told("'road' | reflectivity | <= 0.519 | facet_slope_deg | 40 | 0.6"):
        bsdfs.bsdf_dict(VALUES | {"reflectivity": 0.6, "transmittance": 0.4})


def test_a_density_is_one_over_all_directions(mi):
    """Gauss-Legendre of 64 cosines, of a density that does not depend on the angle around the normal."""
    import drjit as dr

    nodes, weights = np.polynomial.legendre.leggauss(64)
    cosines = 0.5 * (nodes + 1.0)
    surface = dr.zeros(mi.SurfaceInteraction3f, 64)
    surface.wi = dr.normalize(mi.Vector3f(0.6, 0.0, 0.5))
    out = mi.Vector3f(mi.Float(np.sqrt(1.0 - cosines**2)), 0.0, mi.Float(cosines))
    density = mi.load_dict(bsdfs.bsdf_dict(VALUES)).pdf(mi.BSDFContext(), surface, out).numpy()
    assert 2.0 * np.pi * 0.5 * (weights @ density) == pytest.approx(1.0, rel=1e-5)
