"""Thin surfaces: sun and sky from behind, against boards lit from the front and closed forms."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import chain

from lidarscene.kernel.world.mitsuba_world import build_world
from lidarscene.materials.material import Material, Spectrum
from lidarscene.maths.trajectory import Course
from lidarscene.physics.optics import radiometry
from lidarscene.rendering.stages import ambient_of
from lidarscene.scene.scene import Sun

pytestmark = pytest.mark.usefixtures("mi")

MIDDLE = 4
RHO, TAU = 0.46, 0.5
ELEVATION_DEG = 30.0
BEHIND = Sun(azimuth_rad=0.0, elevation_rad=math.radians(ELEVATION_DEG), illuminance_klux=100.0)
IN_FRONT = Sun(azimuth_rad=math.pi, elevation_rad=math.radians(ELEVATION_DEG), illuminance_klux=100.0)

# Single precision in some twenty operations.
CLOSE = {"rel": 1e-5}


def leaf(**parameters):
    values = {"transmittance": Spectrum.constant(TAU)} | parameters
    return Material(name="leaf", bsdf="diffuse", reflectivity=Spectrum.constant(RHO), parameters=values)


def trace_bodies(*bodies, sun=BEHIND, sky=0.0, material=None):
    described = chain.scene(*bodies, materials=(material or leaf(),), sun=sun, sky=sky)
    return chain.run_stages(described, chain.sensor("table1-apd", *chain.NARROW))


def expected_w(radiance_over_sun):
    """(8) by hand, of this radiance for a sun of 1 W/m2, through Table 1's receiver and air."""
    sensor = chain.sensor("table1-apd")
    sun = ambient_of(chain.scene(chain.facing(range_m=1.0), sun=BEHIND), sensor).sun_irradiance_w_m2
    return radiometry.background_power_w(
        radiance_w_m2_sr=radiance_over_sun * sun,
        aperture_m2=sensor.optics.aperture_m2,
        field_of_view_sr=math.pi * (sensor.detector.radius_m / sensor.optics.focal_length_m) ** 2,
        transmittance=0.98,
        efficiency=sensor.optics.efficiency_sun,
    )


def test_sunlight_from_behind_comes_through():
    """tau E cos(theta_s) / pi, while the echo is that of the reflectivity alone."""
    leaf, opaque = trace_bodies(chain.facing(range_m=20.0, material="leaf")), trace_bodies(chain.facing(range_m=20.0))
    cosine = math.cos(math.radians(ELEVATION_DEG))
    assert leaf.light.background_power_w[MIDDLE] == pytest.approx(expected_w(TAU * cosine / math.pi), **CLOSE)
    assert leaf.hits.lit[MIDDLE]
    assert leaf.hits.cos_sun[MIDDLE] == pytest.approx(-cosine, **CLOSE)
    assert opaque.light.background_power_w[MIDDLE] == 0.0
    assert not opaque.hits.lit[MIDDLE]
    ratio = leaf.light.peak_power_w[MIDDLE] / opaque.light.peak_power_w[MIDDLE]
    assert ratio == pytest.approx(RHO / 0.1, **CLOSE)


def test_sunlight_from_the_front_is_reflected():
    leaf = trace_bodies(chain.facing(range_m=20.0, material="leaf"), sun=IN_FRONT)
    cosine = math.cos(math.radians(ELEVATION_DEG))
    assert leaf.light.background_power_w[MIDDLE] == pytest.approx(expected_w(RHO * cosine / math.pi), **CLOSE)


@pytest.mark.parametrize("sun", [BEHIND, IN_FRONT])
def test_either_side_may_be_in_shadow(sun):
    """What stands between the leaf and the sun, on whichever side that is."""
    side = 1.0 if sun is BEHIND else -1.0
    screen = chain.facing(range_m=20.0 + 2.0 * side, at=(0.0, 0.0, 3.0), size_m=4.0)
    leaf = trace_bodies(chain.facing(range_m=20.0, material="leaf"), screen, sun=sun)
    assert not leaf.hits.lit[MIDDLE]
    assert leaf.light.background_power_w[MIDDLE] == 0.0


def test_the_sky_is_on_both_sides():
    """(rho + tau) E_sky / pi; the reflectivity that the truth tells stays rho."""
    night = Sun(azimuth_rad=0.0, elevation_rad=math.radians(-30.0), illuminance_klux=100.0)
    leaf = trace_bodies(chain.facing(range_m=20.0, material="leaf"), run_floor(), sun=night, sky=0.3)
    assert leaf.light.background_power_w[MIDDLE] == pytest.approx(expected_w((RHO + TAU) * 0.3 / math.pi), **CLOSE)
    assert leaf.hits.reflectivity[MIDDLE] == pytest.approx(RHO, rel=1e-6)


def run_floor():
    """A level board below, which keeps a sun below the horizon from the leaf."""
    floor = chain.facing(range_m=0.0, size_m=200.0)
    pose = dataclasses.replace(floor.pose, position_m=np.array([0.0, 0.0, -4.0]), rotation=np.eye(3))
    return dataclasses.replace(floor, name="floor", pose=pose)


def test_a_porous_leaf_lets_the_same_share_through():
    """What of a porous surface is met is all leaf, from behind as from the front."""
    whole = trace_bodies(chain.facing(range_m=20.0, material="leaf"))
    porous = trace_bodies(chain.facing(range_m=20.0, material="leaf"), material=leaf(cover=0.7))
    hit = porous.hits.has_surface
    assert hit.any()
    np.testing.assert_allclose(porous.light.background_power_w[hit], whole.light.background_power_w[hit], rtol=1e-5)


def test_a_moving_leaf():
    body = chain.facing(range_m=20.0, material="leaf")
    moving = dataclasses.replace(body, motion=Course(start=body.pose))
    still, moved = trace_bodies(body), trace_bodies(moving)
    np.testing.assert_allclose(moved.light.background_power_w, still.light.background_power_w, rtol=1e-5)


def test_opaque_worlds_have_no_such_table():
    """Nothing is looked up where nothing is thin."""
    described = chain.scene(chain.facing(range_m=20.0))
    assert build_world(described, wavelength_m=905e-9).shape_transmittance is None
