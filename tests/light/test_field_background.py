"""Background over the receiver's field of view: closed forms of half fields, and where it must not matter."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import chain, panes

from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Sun

pytestmark = pytest.mark.usefixtures("mi")

BEHIND = Sun(azimuth_rad=math.pi, elevation_rad=math.radians(20.0), illuminance_klux=100.0)
CENTRE = 4
"""The beam of `chain.NARROW` that is on the axis."""


def half_wall(offset_m):
    """A wall whose right edge is ``offset_m`` left of the axis at 50 m; it fills all of the field to the left."""
    body = chain.facing(range_m=50.0, size_m=4.0, material="white")
    place = dataclasses.replace(body.pose, position_m=np.array([50.0, 2.0 + offset_m, 0.0]))
    return dataclasses.replace(body, pose=place)


def scene(*bodies, sky=0.0, sun=BEHIND):
    # What stands behind the sensor is seen by nobody: a scene has something in it.
    bodies = (*bodies, chain.box(at=(-20.0, 0.0, 0.0)))
    return chain.scene(*bodies, materials=(chain.diffuse("white", 0.8), panes.pane_material()), sun=sun, sky=sky)


def background_w(described, rays, sensor=None):
    sensor = sensor or chain.sensor("table1-apd", *chain.NARROW)
    return float(Simulator(described, sensor, background_rays=rays).waveforms([CENTRE]).background_w[0])


def test_half_of_the_field_on_a_bright_wall_is_half_of_its_light():
    """The axis sees the sky beside the wall, 0.5 mm off: black. Half of 400 rays are 1 % off at most."""
    described = scene(half_wall(0.0005))
    whole = background_w(scene(half_wall(-2.0)), None)
    assert background_w(described, None) == 0.0
    assert background_w(described, 400) == pytest.approx(0.5 * whole, rel=0.02)


def test_a_segment_of_the_field_has_its_share_of_the_area():
    """An edge at half the radius of the field: acos(1/2) / pi - sqrt(3) / (4 pi) = 19.55 % of a circle lie behind it,
    with sky in the rest.
    """
    sensor = chain.sensor("table1-apd", *chain.NARROW)
    radius_m = 50.0 * sensor.detector.radius_m / sensor.optics.focal_length_m
    share = math.acos(0.5) / math.pi - math.sqrt(3.0) / (4.0 * math.pi)
    wall, sky = background_w(scene(half_wall(-2.0), sky=0.3), None), background_w(scene(sky=0.3), None)
    mixed = background_w(scene(half_wall(0.5 * radius_m), sky=0.3), 400)
    # Tolerance: 3 of 400 rays on the other side of the edge.
    assert mixed == pytest.approx(share * wall + (1.0 - share) * sky, abs=3.0 / 400.0 * abs(wall - sky))


@pytest.mark.parametrize("footprint_rays", [1, 5])
def test_an_even_wall_looks_the_same_with_any_rays(footprint_rays):
    """(8) at any number. Tolerance: the rays' slant, 1e-5, and single precision of the sum."""
    described = scene(half_wall(-2.0))
    sensor = chain.sensor("table1-apd", *chain.NARROW, "laser.divergence_mrad=1")
    alone = background_w(described, None, sensor)
    for rays in (1, 7, 64):
        simulator = Simulator(described, sensor, rays=footprint_rays, background_rays=rays)
        assert simulator.waveforms([CENTRE]).background_w[0] == pytest.approx(alone, rel=1e-4)


def test_echoes_do_not_change():
    sensor = chain.sensor("table1-apd", *chain.NARROW)
    alone, many = (Simulator(scene(half_wall(-2.0)), sensor, background_rays=k).render() for k in (None, 1))
    for attribute in ("xyz_m", "range_m", "intensity", "snr", "ambient"):
        np.testing.assert_array_equal(getattr(alone, attribute), getattr(many, attribute))


def test_the_suns_disc_counts_once_and_hides_behind_walls():
    """Sun on the axis: the disc fills the field, by any number of rays. Behind a wall it is gone."""
    ahead = Sun(azimuth_rad=0.0, elevation_rad=0.0, illuminance_klux=100.0)
    open_sky = background_w(scene(sun=ahead), None)
    assert open_sky > 1e-3
    assert background_w(scene(sun=ahead), 19) == pytest.approx(open_sky, rel=1e-6)
    assert background_w(scene(half_wall(-2.0), sun=ahead), 19) == 0.0
    # Half of the disc behind the wall's edge, on the axis: half of it is left, a ray or two of 19 either way.
    half = background_w(scene(half_wall(0.0005), sun=ahead), 19)
    assert half == pytest.approx(0.5 * open_sky, abs=2.0 / 19.0 * open_sky)
    # A disc off the axis, all behind the wall that the axis looks past.
    aside = Sun(azimuth_rad=7e-3, elevation_rad=0.0, illuminance_klux=100.0)
    assert background_w(scene(half_wall(0.02), sun=aside), None) > 1e-4
    assert background_w(scene(half_wall(0.02), sun=aside), 64) == 0.0


def test_the_suns_disc_through_a_pane_loses_what_the_pane_reflects():
    """All but what both faces reflect of sun along the axis, by any number of rays. Tolerance: single precision."""
    ahead = Sun(azimuth_rad=0.0, elevation_rad=0.0, illuminance_klux=100.0)
    open_sky = background_w(scene(sun=ahead), 19)
    for rays in (None, 19):
        behind_pane = background_w(scene(panes.pane(5.0), sun=ahead), rays)
        assert behind_pane == pytest.approx((1.0 - panes.both_sides(1.0)) * open_sky, rel=1e-4)
