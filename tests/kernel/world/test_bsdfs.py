"""Materials as Mitsuba BSDFs: how much comes back, from which side, against integrals and definitions."""

import math
from functools import cache

import numpy as np
import pytest
from helpers import chain
from helpers.mistakes import told
from helpers.run_seed import chosen

from lidarscene import catalog
from lidarscene.kernel.world import bsdfs
from lidarscene.materials.material import Material, Spectrum
from lidarscene.materials.material_file import catalogue_material

pytestmark = pytest.mark.usefixtures("mi")

MIDDLE = 4
LASER_M = 905e-9


def load_bsdf(mi, values):
    return mi.load_dict(bsdfs.bsdf_dict(values))


def evaluate_bsdf(mi, bsdf, incoming, outgoing):
    """f_r(in, out) |cos out| for unit vectors in the surface's frame; (n, 3) outgoing."""
    surface = mi.SurfaceInteraction3f()
    surface.wi = mi.Vector3f(*(float(x) for x in incoming))
    surface.uv = mi.Point2f(0.0)
    out = mi.Vector3f(np.asarray(outgoing, dtype=np.float32).T)
    return np.array(bsdf.eval(mi.BSDFContext(), surface, out, True)[0].numpy(), dtype=float)


def tilted_direction(angle_deg, azimuth_deg=0.0):
    a, b = math.radians(angle_deg), math.radians(azimuth_deg)
    return np.array([math.sin(a) * math.cos(b), math.sin(a) * math.sin(b), math.cos(a)])


@cache
def hemisphere(cosines, azimuths):
    """Directions of equal solid angle over the upper hemisphere, and that solid angle."""
    z = (np.arange(cosines) + 0.5) / cosines
    phi = (np.arange(azimuths) + 0.5) * 2.0 * np.pi / azimuths
    zz, pp = np.meshgrid(z, phi, indexing="ij")
    r = np.sqrt(1.0 - zz**2)
    directions = np.stack([r * np.cos(pp), r * np.sin(pp), zz], axis=-1).reshape(-1, 3)
    return directions, 2.0 * np.pi / len(directions)


def reflectance(mi, values, incoming=(0.0, 0.0, 1.0)):
    """Directional-hemispherical reflectance at normal incidence by a sum over the hemisphere."""
    directions, solid_angle = hemisphere(cosines=8000, azimuths=36)
    return evaluate_bsdf(mi, load_bsdf(mi, values), incoming, directions).sum() * solid_angle


def test_diffuse_reflectance_is_the_reflectivity(mi):
    assert reflectance(mi, {"bsdf": "diffuse", "reflectivity": 0.37}) == pytest.approx(0.37, rel=1e-4)


@pytest.mark.parametrize(
    ("reflectivity", "roughness"), [(0.05, 0.05), (0.05, 0.3), (0.4, 0.1), (0.6, 0.05), (0.6, 0.3)]
)
def test_coated_reflectance(mi, reflectivity, roughness):
    """The diffuse part at normal incidence is the reflectivity (0.5 %: the quadrature).

    The coat adds its 4 % of mirror light, less what a rough one masks.
    """
    coated = {"bsdf": "coated", "coat_ior": 1.5, "coat_roughness": roughness}
    coat = reflectance(mi, coated | {"reflectivity": 0.0})
    whole = reflectance(mi, coated | {"reflectivity": reflectivity})
    assert 0.025 < coat < 0.041
    assert whole - coat == pytest.approx(reflectivity, rel=0.005)


def test_a_coat_that_cannot_let_so_much_out_is_an_error(mi):
    values = {"name": "m", "bsdf": "coated", "coat_ior": 1.5, "coat_roughness": 0.5, "reflectivity": 0.85}
    with told("'m' | reflectivity | <= 0.512 | coat | 0.85"):
        bsdfs.bsdf_dict(values)


def test_conductor_reflectance(mi):
    """Aluminium at 905 nm: the Fresnel reflectance of its index, less a few percent of masking."""
    values = catalogue_material("brushed_aluminium").at(LASER_M)
    n, k = values["index_n"], values["index_k"]
    fresnel = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    assert reflectance(mi, values | {"roughness": 0.1}) == pytest.approx(fresnel, rel=0.03)


def test_clear_glass_sends_nothing_back(mi):
    glass = load_bsdf(mi, catalogue_material("clear_glass").at(LASER_M))
    assert evaluate_bsdf(mi, glass, tilted_direction(10), [tilted_direction(10)])[0] == 0.0


RETRO = {
    "bsdf": "retroreflector",
    "reflectivity": 0.1,
    "retro_coefficient_cd_per_lx_m2": 250.0,
    "retro_half_angle_deg": 0.39,
}


def coefficient(mi, *, observation_deg, entrance_deg, across=False):
    """R_A [cd/lx/m2] by its definition: the radiance over the illuminance of a plane across the beam, times
    the cosine that turns radiance into intensity per area of sheet.
    """
    incoming = tilted_direction(entrance_deg)
    turn = math.radians(observation_deg)
    side = np.array([0.0, 1.0, 0.0]) if across else np.cross([0.0, 1.0, 0.0], incoming)
    outgoing = incoming * math.cos(turn) + side * math.sin(turn)
    value = evaluate_bsdf(mi, load_bsdf(mi, RETRO), incoming, [outgoing])[0]
    # eval is f_r cos(out) = L cos(out) / (E_perp cos(in)), and R_A = L cos(out) / E_perp.
    return (value - RETRO["reflectivity"] * outgoing[2] / math.pi) * incoming[2]


@pytest.mark.parametrize("across", [False, True])
def test_retroreflector_gives_its_stated_coefficient(mi, across):
    """250 cd/lx/m2 at 0.2 degrees of observation and 4 of entrance, in any plane; 150 at 30 (D4956, type III)."""
    assert coefficient(mi, observation_deg=0.2, entrance_deg=4.0, across=across) == pytest.approx(250.0, rel=2e-3)
    assert coefficient(mi, observation_deg=0.2, entrance_deg=30.0, across=across) == pytest.approx(150.0, rel=5e-3)


def test_retroreflector_is_narrow(mi):
    """Half as bright at its half angle, nothing of it beyond 1.5 degrees."""
    peak = coefficient(mi, observation_deg=0.0, entrance_deg=4.0)
    assert coefficient(mi, observation_deg=0.39, entrance_deg=4.0) == pytest.approx(0.5 * peak, rel=5e-3)
    assert abs(coefficient(mi, observation_deg=1.5, entrance_deg=4.0)) < 1e-3 * peak


def test_retroreflector_conserves_energy(mi):
    """The lobe, integrated finely around the ray, and the diffuse part stay below one; no pole at grazing."""
    sheet = load_bsdf(mi, RETRO)
    for entrance in (0.0, 40.0, 80.0):
        incoming = tilted_direction(entrance)
        radii, around = np.linspace(0.0, math.radians(2.0), 400), np.arange(16) * np.pi / 8.0
        u, v = np.cross(incoming, [0.0, 1.0, 0.0]), np.array([0.0, 1.0, 0.0])
        side = np.outer(np.cos(around), u / np.linalg.norm(u)) + np.outer(np.sin(around), v)
        rings = np.cos(radii)[:, None, None] * incoming + np.sin(radii)[:, None, None] * side
        values = evaluate_bsdf(mi, sheet, incoming, rings.reshape(-1, 3)).reshape(400, 16).mean(axis=1)
        lobe = np.trapezoid(values * 2 * np.pi * np.sin(radii), radii)
        assert lobe + RETRO["reflectivity"] < 0.25


def test_retroreflector_is_reciprocal(mi):
    a, b = tilted_direction(20.0), tilted_direction(20.4, 0.5)
    forward = evaluate_bsdf(mi, load_bsdf(mi, RETRO), a, [b])[0] / b[2]
    backward = evaluate_bsdf(mi, load_bsdf(mi, RETRO), b, [a])[0] / a[2]
    assert forward == pytest.approx(backward, rel=1e-4)


def test_retroreflector_sampling_matches_its_density(mi):
    """The weight times the density is the value, for every sample: what a path tracer relies on."""
    import drjit as dr

    bsdf = load_bsdf(mi, RETRO)
    surface = dr.zeros(mi.SurfaceInteraction3f, 1000)
    surface.wi = mi.Vector3f(*(float(x) for x in tilted_direction(30.0)))
    rng = np.random.default_rng(0)
    pair = mi.Point2f(rng.random((2, 1000)).astype(np.float32))
    sample, weight = bsdf.sample(mi.BSDFContext(), surface, mi.Float(0.5), pair)
    value, density = bsdf.eval_pdf(mi.BSDFContext(), surface, sample.wo)
    np.testing.assert_allclose(weight[0].numpy() * density.numpy(), value[0].numpy(), rtol=1e-4, atol=1e-7)
    assert (sample.wo.z.numpy() > 0).all()


@pytest.mark.parametrize("name", chosen(8, catalog.names("materials")))
def test_every_material_of_the_catalogue_from_both_sides(mi, name):
    """Hit from the front and from behind, a surface sends the same light back (panes and mirrors: none; where it has
    gaps, chance says whether this pulse's ray meets it).
    """
    material = catalogue_material(name)
    sensor = chain.sensor("table1-apd", *chain.NARROW)
    front = chain.facing(range_m=30.0, theta_deg=20.0, material=name)
    part = front.parts[0]
    import dataclasses

    flipped = dataclasses.replace(front, parts=(dataclasses.replace(part, faces=part.faces[:, ::-1]),))
    sides = [chain.run_stages(chain.scene(body, materials=(material,)), sensor).hits for body in (front, flipped)]
    for quantity in ("backscatter_per_sr", "sun_scatter_per_sr", "cos_sun", "cos_incidence", "lit"):
        front_value, flipped_value = (getattr(hits, quantity)[MIDDLE] for hits in sides)
        assert front_value == pytest.approx(flipped_value, rel=1e-5)
    if "cover" in material.parameters:
        return
    ends_the_beam = material.bsdf not in ("glass", "mirror")
    assert (sides[0].backscatter_per_sr[MIDDLE] > 0.0) == ends_the_beam
    assert sides[0].lit[MIDDLE] == ends_the_beam


def test_number_plate_outshines_paint(mi):
    """A retro-reflector's echo is R_A pi / rho times that of a board: 3 orders of magnitude over 10 %."""
    plate = catalogue_material("retroreflective_sheeting")
    sensor = chain.sensor("table1-apd", *chain.NARROW)
    scene = chain.scene(chain.facing(range_m=30.0, material=plate.name), materials=(plate,))
    bright = chain.run_stages(scene, sensor).light.peak_power_w[MIDDLE]
    board = chain.run_stages(chain.scene(chain.facing(range_m=30.0)), sensor).light.peak_power_w[MIDDLE]
    assert 3_000.0 < bright / board < 30_000.0


def test_material_outside_its_table_is_a_clear_error():
    material = Material(
        name="m", bsdf="diffuse", reflectivity=Spectrum(wavelength_m=(850e-9, 1550e-9), value=(0.1, 0.3))
    )
    assert material.at(1200e-9)["reflectivity"] == pytest.approx(0.2)
    with told("'m' | reflectivity | 600 nm | 850 | 1550 nm"):
        material.at(600e-9)


@pytest.mark.parametrize("bsdf", ["diffuse", "coated", "retroreflector", "conductor", "mirror", "glass"])
def test_what_mirrors_the_sky_reflects_none_of_it_diffusely(bsdf):
    """However much of a beam it reflects."""
    mirrors = bsdf in ("conductor", "mirror", "glass")
    assert bsdfs.diffuse_share({"bsdf": bsdf, "reflectivity": 0.75}) == (0.0 if mirrors else 0.75)
