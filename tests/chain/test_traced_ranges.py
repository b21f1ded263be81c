"""docs/validation.md, check 2: traced ranges against closed forms, wherever in the world the scene lies."""

import numpy as np
import pytest
from helpers import chain

from lidarscene.maths.pose import Pose

pytestmark = pytest.mark.usefixtures("mi")

CHECK_2 = 1e-6  # single precision: a float32 has 6e-8
PLACES_M = ((0.0, 0.0, 0.0), (1234.5, -987.6, 12.3), (4.5e5, 5.1e6, 300.0))  # the last: a UTM northing
SENSOR = chain.sensor("table1-apd", *chain.raster(10, 10, 0.1))


def trace_hits(body, place):
    """Range and direction (float64 of the rays as traced) of every ray that hit."""
    lanes = chain.run_stages(chain.scene(body, pose=Pose.from_degrees(position_m=place)), SENSOR)
    direction = lanes.direction.astype(np.float64)
    length = np.linalg.norm(direction, axis=1)
    hit = lanes.hits.has_surface
    # The tracer's t counts direction vectors; those are unit to float32 rounding.
    return ((lanes.hits.range_m.astype(np.float64) * length)[hit], (direction / length[:, None])[hit], hit)


def largest_relative_error(measured, expected):
    return np.max(np.abs(measured / expected - 1.0))


@pytest.mark.parametrize("place", PLACES_M)
@pytest.mark.parametrize("range_m", [1.0, 3.0, 20.0, 100.0, 500.0])
def test_tilted_plane(range_m, place):
    theta = 40.0
    body = chain.facing(range_m=range_m, theta_deg=theta, at=place, size_m=0.4 * range_m)
    measured, direction, hit = trace_hits(body, place)
    normal = np.array([-np.cos(np.radians(theta)), -np.sin(np.radians(theta)), 0.0])
    expected = -range_m * np.cos(np.radians(theta)) / (direction @ normal)
    assert hit.all()
    assert largest_relative_error(measured, expected) < CHECK_2


@pytest.mark.parametrize("place", PLACES_M)
@pytest.mark.parametrize("range_m", [1.0, 3.0, 20.0, 100.0, 500.0])
def test_sphere(range_m, place):
    radius, distance = 0.05 * range_m, 1.05 * range_m
    measured, direction, hit = trace_hits(chain.ball(at=np.add(place, (distance, 0.0, 0.0)), radius_m=radius), place)
    along = direction[:, 0] * distance
    inside = along**2 - distance**2 + radius**2
    # Rays that graze within 1 % of the radius are left to the silhouette.
    clear = inside > (0.14 * radius) ** 2
    expected = along - np.sqrt(np.maximum(inside, 0.0))
    assert 500 < clear.sum() <= hit.sum()
    assert largest_relative_error(measured[clear], expected[clear]) < CHECK_2


@pytest.mark.parametrize("place", PLACES_M)
@pytest.mark.parametrize("range_m", [1.0, 3.0, 20.0, 100.0, 500.0])
def test_box(range_m, place):
    """Compared with the slab method in float64, the box turned by 30 degrees."""
    size, yaw = np.array([0.06, 0.08, 0.05]) * range_m, 30.0
    centre = np.array([1.04 * range_m, 0.0, 0.0])
    measured, direction, on_box = trace_hits(chain.box(at=np.array(place) + centre, size_m=size, yaw_deg=yaw), place)
    turn = Pose.from_degrees(yaw_deg=yaw).rotation
    origin, local = -centre @ turn, direction @ turn
    with np.errstate(divide="ignore"):
        to_low, to_high = (-size / 2 - origin) / local, (size / 2 - origin) / local
    near, far = np.minimum(to_low, to_high).max(axis=1), np.maximum(to_low, to_high).min(axis=1)
    assert on_box.sum() > 500
    assert np.mean(near > far) < 0.01  # rays that graze an edge may go either way
    hit = near <= far
    assert largest_relative_error(measured[hit], near[hit]) < CHECK_2


def test_large_ground_close_by():
    """A 400 m road under a sensor 1.8 m up: primitives are cut up so that near hits keep their digits."""
    from lidarscene.scene.meshes.primitives import plane_mesh
    from lidarscene.scene.scene import Body, Part

    vertices, faces = plane_mesh(size_m=(400.0, 400.0))
    road = Body(name="road", class_name="road", parts=(Part(vertices_m=vertices, faces=faces, material="grey"),))
    pose = Pose.from_degrees(position_m=(3.0, 5.0, 1.8), pitch_deg=-60.0)
    lanes = chain.run_stages(chain.scene(road, pose=pose), SENSOR)
    direction = lanes.direction.astype(np.float64)
    assert lanes.hits.has_surface.all()
    assert largest_relative_error(lanes.hits.range_m, 1.8 / -direction[:, 2]) < CHECK_2


def test_misses_are_named():
    lanes = chain.run_stages(chain.scene(chain.ball(at=(0.0, 0.0, -50.0))), SENSOR)
    assert not lanes.hits.has_surface.any()
    assert (lanes.hits.face == -1).all()
    assert (lanes.light.peak_power_w == 0.0).all()
