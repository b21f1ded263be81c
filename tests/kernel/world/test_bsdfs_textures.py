"""Reflectivity that varies over a mesh, as the beams see it: at vertices, by images, over several bodies."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import chain, launches
from helpers.mistakes import told

from lidarscene.kernel.world.bsdfs import texture_key
from lidarscene.kernel.world.mitsuba_world import build_world
from lidarscene.materials.material import Material, Spectrum
from lidarscene.maths.trajectory import Course
from lidarscene.scene.meshes.reflectivity_patterns import ReflectivityPattern

pytestmark = pytest.mark.usefixtures("mi")

RANGE_M = 20.0
SENSOR = chain.sensor("table1-apd", *chain.raster(4, 4, 0.5))
ROUGH = Material(name="road", bsdf="diffuse", reflectivity=Spectrum.constant(0.3), parameters={"facet_slope_deg": 30.0})
MATT = Material(name="wall", bsdf="diffuse", reflectivity=Spectrum.constant(0.3))


def wall(pattern_of, *, material=MATT, range_m=RANGE_M, at=(0.0, 0.0, 0.0)):
    """A wall across the beams with a pattern made of its vertices, and its (v, 2) y and z in the world."""
    body = chain.facing(range_m=range_m, material=material.name, at=at)
    (part,) = body.parts
    places = body.pose.apply(part.vertices_m)[:, 1:]
    return dataclasses.replace(body, parts=(dataclasses.replace(part, pattern=pattern_of(places)),))


def slope(places):
    return ReflectivityPattern(kind="reflectivity", values=0.4 + 0.05 * places[:, 0] + 0.02 * places[:, 1])


def places_hit(lanes):
    """(n, 2) y and z at which the beams meet the wall."""
    _, y, z = np.array(lanes.direction, dtype=float).T
    return np.stack([y, z], axis=1) * np.asarray(lanes.hits.range_m, dtype=float)[:, None]


@pytest.mark.parametrize("moves", [False, True], ids=["still", "moving"])
@pytest.mark.parametrize("material", [MATT, ROUGH], ids=["matt", "rough"])
def test_vertices(material, moves):
    """Reflectivity is linear over the triangles, and echo and sunlight follow it; 1e-4: the hit in single precision.

    A wall that moves stands beside another body in the scene of what moves, away from its own origin.
    """
    other = chain.box(at=(-20.0, 0.0, 0.0))

    def scene_of(body):
        bodies = [
            dataclasses.replace(body, motion=Course(start=body.pose)) if moves else body for body in (body, other)
        ]
        return chain.scene(*bodies, materials=(material,))

    flat = chain.run_stages(scene_of(wall(lambda _: None, material=material)), SENSOR)
    lanes = chain.run_stages(scene_of(wall(slope, material=material)), SENSOR)
    y, z = places_hit(lanes).T
    expected = 0.4 + 0.05 * y + 0.02 * z
    assert np.ptp(expected) > 0.05
    np.testing.assert_allclose(lanes.hits.reflectivity, expected, rtol=1e-4)
    for quantity in ("backscatter_per_sr", "sun_scatter_per_sr"):
        ratio = np.asarray(getattr(lanes.hits, quantity)) / np.asarray(getattr(flat.hits, quantity))
        np.testing.assert_allclose(ratio, expected / 0.3, rtol=1e-4)


def test_an_image_and_its_orientation():
    """Halves of an image: the left one is where u is small. Colours scale 0.3 by (red / mean)^0.93 at 905 nm."""

    def halves(places):
        uv = np.stack([0.5 + places[:, 0] / 4.0, 0.5 - places[:, 1] / 4.0], axis=1)
        image = np.tile(np.repeat([0.1, 0.3], 50), (100, 1))
        image[50:] *= 2.0
        return ReflectivityPattern(kind="colour", values=image, uv=uv, mean=0.2)

    lanes = chain.run_stages(chain.scene(wall(halves), materials=(MATT,)), SENSOR)
    y, z = places_hit(lanes).T
    red = np.where(y < 0, 0.1, 0.3) * np.where(z < 0, 2.0, 1.0)
    clear = (np.abs(y) > 0.1) & (np.abs(z) > 0.1)  # of the seams, where pixels of 4 cm blend
    assert {*np.sign(y[clear])} == {*np.sign(z[clear])} == {-1.0, 1.0}
    np.testing.assert_allclose(
        np.asarray(lanes.hits.reflectivity)[clear], (0.3 * (red / 0.2) ** 0.93)[clear], rtol=1e-3
    )


def test_bodies_share_a_mesh_and_keep_their_values():
    """A wall with a pattern, one with another behind and one without: each beam sees that of the body it meets."""
    front = wall(slope, range_m=RANGE_M)
    behind = wall(lambda p: ReflectivityPattern(kind="reflectivity", values=np.full(len(p), 0.7)), range_m=30.0)
    plain = wall(lambda _: None, range_m=40.0)
    bodies = [dataclasses.replace(body, name=name) for body, name in ((front, "a"), (behind, "b"), (plain, "c"))]
    world = build_world(chain.scene(*bodies, materials=(MATT,)), wavelength_m=905e-9)
    assert len(world.scene.shapes()) == 2, "one mesh with values of its vertices, and one without"
    for order in (bodies[1:], bodies[2:]):
        lanes = chain.run_stages(chain.scene(*order, materials=(MATT,)), SENSOR)
        np.testing.assert_allclose(lanes.hits.reflectivity, 0.7 if len(order) == 2 else 0.3, rtol=1e-6)


@pytest.mark.parametrize("transmittance", [0.0, 0.4])
def test_no_more_light_than_came(transmittance):
    """A rough surface of 30 degrees cannot have 1, nor what it transmits: the values end where the energy does."""
    material = dataclasses.replace(ROUGH, parameters={"facet_slope_deg": 30.0, "transmittance": transmittance})
    lanes = chain.run_stages(
        chain.scene(
            wall(lambda p: ReflectivityPattern(kind="reflectivity", values=np.ones(len(p))), material=material),
            materials=(material,),
        ),
        SENSOR,
    )
    relief = 0.45 * math.radians(30) ** 2 / (math.radians(30) ** 2 + 0.09)
    relief /= 1.0 - 0.5 * math.radians(30) ** 2 / (math.radians(30) ** 2 + 0.33)
    limit = 1.0 / (1.0 + relief * (0.5 - 2.0 / (3.0 * math.pi)))
    np.testing.assert_allclose(lanes.hits.reflectivity, (1.0 - transmittance) * limit, rtol=1e-5)


def test_only_diffuse_materials_vary():
    metal = Material(name="metal", bsdf="conductor", reflectivity=Spectrum.constant(0.5), parameters={"roughness": 0.3})
    with told("'metal' | diffuse | reflectivity | conductor"):
        build_world(chain.scene(wall(slope, material=metal), materials=(metal,)), wavelength_m=905e-9)


def test_a_part_and_a_pattern_of_different_size():
    with told("pattern | 4 vertices | 2"):
        wall(lambda _: ReflectivityPattern(kind="reflectivity", values=np.zeros(2)))


def test_another_pattern_compiles_nothing():
    """Values are data: the kernels of one wall serve another with other values."""
    described = [
        chain.scene(
            wall(lambda p, k=k: ReflectivityPattern(kind="reflectivity", values=np.full(len(p), k))), materials=(MATT,)
        )
        for k in (0.2, 0.4)
    ]
    chain.run_stages(described[0], SENSOR)
    with launches.launched() as before:
        chain.run_stages(described[0], SENSOR)
    with launches.launched(after=before):
        chain.run_stages(described[1], SENSOR)


def test_what_may_be_one_mesh():
    """Values of vertices lie with a mesh; an image is one for all of it, scaled by its mean."""
    image, other_image = (
        ReflectivityPattern(kind="colour", values=np.full((2, 2), v), uv=np.zeros((3, 2))) for v in (0.2, 0.4)
    )
    values = ReflectivityPattern(kind="reflectivity", values=np.full(3, 0.2))
    keys = [
        texture_key(pattern) for pattern in (None, values, image, other_image, dataclasses.replace(image, mean=0.5))
    ]
    assert len(set(keys)) == 5
    assert texture_key(dataclasses.replace(values, values=np.full(3, 0.4))) == texture_key(values)
