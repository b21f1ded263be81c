"""Footprints: where the rays of a beam are, and that they spread as the beam does."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.mistakes import told
from scipy.stats import ncx2, norm

from lidarscene import load_sensor
from lidarscene.light.beams import Beams, reported_beams
from lidarscene.light.echoes import Echoes
from lidarscene.light.footprint import footprint, points, spread, sweep, with_sweep
from lidarscene.light.pulse_train import join_echoes
from lidarscene.physics.eye_safety import beam_diameter_m
from lidarscene.physics.optics import beam
from lidarscene.sensor.sensor_model import Halo

PROFILES = ("gaussian", "top_hat")
MANY = (3, 5, 7, 16, 19, 64, 256)
ROTATION = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def laser(*overrides):
    return load_sensor("table1-apd", overrides=[f"laser.{override}" for override in overrides]).laser


def share_beyond(profile, distance):
    """Power of a beam of radius 1 beyond a knife edge: of a Gaussian, and of the segment of a disc."""
    if profile == "gaussian":
        return norm.sf(2.0 * distance)
    return (np.arccos(distance) - distance * np.sqrt(1.0 - distance**2)) / math.pi


def edge_error(profile, places):
    """Root mean square over 4000 edges of the difference between the rays beyond an edge and the power there."""
    random = np.random.default_rng(1)
    angle, distance = random.uniform(0.0, 2.0 * math.pi, 4000), random.uniform(-1.0, 1.0, 4000)
    beyond = places @ np.stack([np.cos(angle), np.sin(angle)]) > distance
    return float(np.sqrt(np.mean((beyond.mean(axis=0) - share_beyond(profile, distance)) ** 2)))


@pytest.mark.parametrize("profile", PROFILES)
def test_one_ray_is_the_axis(profile):
    np.testing.assert_array_equal(points(profile, 1), [[0.0, 0.0]])


@pytest.mark.parametrize("rays", [1, 2, *MANY])
def test_weights_sum_to_one(rays):
    assert math.fsum([footprint(laser(), rays).weight] * rays) == pytest.approx(1.0, rel=2e-16, abs=0.0)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("rays", MANY)
def test_centre_and_variance_are_the_beams(profile, rays):
    """Reference: w^2 / 4 on each axis, for both profiles (ISO 11146). Tolerance: rounding of an eigenvalue problem."""
    places = points(profile, rays)
    np.testing.assert_allclose(places.mean(axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(places.T @ places / rays, np.eye(2) / 4.0, atol=1e-14)


def test_rings_have_the_power_they_should():
    """The mean r^2 of a ring against the integral of r^2 over it, by a fine sum."""
    share = (np.arange(1_000_000) + 0.5) / 1_000_000
    for ring, square in ((beam.gaussian_ring, -0.5 * np.log(1.0 - share)), (beam.top_hat_ring, share)):
        for inside, outside in ((0.0, 0.2), (0.2, 0.7), (0.9, 1.0)):
            within = square[(share > inside) & (share < outside)].mean()
            # The sum's own error at the open end of a Gaussian: half a step times ln of the number of steps.
            assert ring(inside=inside, outside=outside) == pytest.approx(within, abs=1e-5)


@pytest.mark.parametrize("profile", PROFILES)
def test_knife_edges_converge_faster_than_random_rays(profile):
    """An edge splits N random rays to 1 / sqrt(N); these to about N^-3/4, as evenly spread points do (Beck 1987)."""
    error = [edge_error(profile, points(profile, rays)) for rays in MANY[2:]]
    slope = np.polyfit(np.log(MANY[2:]), np.log(error), 1)[0]
    assert -0.85 < slope < -0.65
    assert error[0] < 0.075  # seven rays: less than the 1/7 that one ray weighs
    assert error[-1] < 0.005


def fan(shape, direction=(1.0, 0.0, 0.0), rotation=ROTATION):
    """The rays of one pulse from the origin: origins and directions, (rays, 3)."""
    rays = shape.rays
    alike = Beams(
        pulse=np.zeros(rays, dtype=np.uint32),
        origin_m=(np.zeros(rays),) * 3,
        direction=tuple(np.full(rays, x) for x in direction),
        aperture_m2=1.0,
    )
    spread_out = spread(alike, shape, ray=np.arange(rays), rotation=rotation)
    return np.stack(spread_out.origin_m, axis=1), np.stack(spread_out.direction, axis=1)


def spot(shape, distance, **places):
    """(rays, 2) places to the left of and above the axis on a screen across it."""
    origin, direction = fan(shape, **places)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, rtol=1e-14)
    return (origin + direction * ((distance - origin[:, 0]) / direction[:, 0])[:, None])[:, 1:]


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("distance", [0.0, 0.5, 2.0, 5.0, 20.0, 300.0])
def test_every_ray_follows_the_gaussian_beam(profile, distance):
    """w(z)^2 = w_0^2 + (theta z)^2 on each ray and not only on average; reference: the width of eye safety."""
    shape = footprint(laser("divergence_mrad=3", "exit_diameter_mm=8", f"beam_profile='{profile}'"), 19)
    radius = np.linalg.norm(points(profile, 19), axis=1)
    width = 0.5 * beam_diameter_m(exit_diameter_m=8e-3, divergence_rad=3e-3, distance_m=distance)
    np.testing.assert_allclose(np.linalg.norm(spot(shape, distance), axis=1), radius * width, rtol=1e-12)


def test_ellipse():
    """Far away the spot's variances are (w / 2)^2 on each axis; 1e-6 is what the exit adds at 1 km."""
    shape = footprint(laser("divergence_mrad=4", "divergence_elevation_mrad=1"), 64)
    places = spot(shape, 1000.0)
    np.testing.assert_allclose(places.T @ places / 64, np.diag([1.0, 0.0625]), rtol=1e-5, atol=1e-9)


def test_axes_are_azimuth_and_elevation():
    """A wide fan to the left of a sensor stays level, in any pose of the sensor."""
    shape = footprint(laser("divergence_mrad=4", "divergence_elevation_mrad=0.01"), 16)
    _, direction = fan(shape, direction=(0.0, 1.0, 0.0))
    assert np.ptp(direction[:, 2]) < 2e-5
    assert np.ptp(direction[:, 0]) > 3e-3
    # Standing on its nose, x down and z forward: level is now the world's y-z plane.
    _, direction = fan(shape, direction=(0.0, 1.0, 0.0), rotation=(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0))
    assert np.ptp(direction[:, 0]) < 2e-5
    assert np.ptp(direction[:, 2]) > 3e-3


@pytest.mark.parametrize("z", [1.0, -1.0])
def test_straight_up_and_down_have_axes_too(z):
    _, direction = fan(footprint(laser("divergence_mrad=4"), 7), direction=(0.0, 0.0, z))
    assert np.isfinite(direction).all()
    np.testing.assert_allclose(direction[:, :2].std(axis=0), 1e-3, rtol=1e-5)


def test_one_ray_leaves_the_beams_as_they_are():
    origin, direction = fan(footprint(laser("divergence_mrad=4", "exit_diameter_mm=8"), 1))
    np.testing.assert_array_equal(origin, [[0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(direction, [[1.0, 0.0, 0.0]])


def test_both_array_types_agree(mi):
    import drjit as dr

    shape = footprint(laser("divergence_mrad=3", "divergence_elevation_mrad=1", "exit_diameter_mm=8"), 19)
    origin, direction = fan(shape, direction=(0.6, 0.0, 0.8))
    ray = dr.arange(mi.UInt32, 19)
    alike = Beams(
        pulse=ray,
        origin_m=(mi.Float(0.0),) * 3,
        direction=(mi.Float(0.6), mi.Float(0.0), mi.Float(0.8)),
        aperture_m2=1.0,
    )
    on_device = spread(alike, shape, ray=ray, rotation=ROTATION)
    for computed, expected in ((on_device.origin_m, origin), (on_device.direction, direction)):
        np.testing.assert_allclose(np.stack([x.numpy() for x in computed], axis=1), expected, atol=2e-7)  # float32


def test_a_beam_finer_than_light_is_refused():
    """905 nm from 1 mm spread by 4 lambda / (pi d) = 1.152 mrad."""
    with told("divergence_mrad | >= 1.15 | 1 mm | 0.5"):
        laser("exit_diameter_mm=1", "divergence_mrad=0.5")
    quality = beam.beam_quality(exit_diameter_m=1e-3, divergence_rad=4 * 905e-9 / (math.pi * 1e-3), wavelength_m=905e-9)
    assert quality == pytest.approx(1.0, rel=1e-12)
    assert laser("exit_diameter_mm=1", "divergence_mrad=1.16").divergence_rad == pytest.approx(1.16e-3)


def test_eye_safety_takes_the_narrow_axis():
    beam_of = laser("divergence_mrad=4", "divergence_elevation_mrad=1")
    assert beam_of.least_divergence_rad == 1e-3
    assert replace(beam_of, divergence_elevation_rad=None).least_divergence_rad == 4e-3


def train_of(range_m, power_w, shape):
    """The rays of pulses put together."""
    lanes = np.broadcast_to(range_m, power_w.shape).ravel()
    light = Echoes(
        has_surface=power_w.ravel() > 0.0,
        range_m=lanes,
        peak_power_w=power_w.ravel(),
        background_power_w=np.ones(power_w.size),
        white_w_m2=np.ones(power_w.size),
    )
    count = len(power_w)
    beams = Beams(pulse=np.arange(count), origin_m=(0.0,) * 3, direction=(1.0, 0.0, 0.0), aperture_m2=1.0)
    return join_echoes([light], beams, rays=shape.rays, skirt=shape.skirt)


@pytest.mark.parametrize("rays", [4, 7, 16, 64])
@pytest.mark.parametrize("share", [1e-4, 0.05, 0.9])
def test_a_halo_takes_its_share(rays, share):
    """Weights sum to one: what all rays see alike is the same with a halo, background too. To rounding."""
    shape = footprint(laser(), rays, Halo(share=share, divergence_rad=20e-3))
    assert shape.skirt.count == rays // 2
    whole = train_of(20.0, np.ones((5, rays)), shape)
    power = whole.parts[0].peak_power_w.reshape(5, rays)
    np.testing.assert_allclose(power.sum(axis=1), 1.0, rtol=1e-14)
    np.testing.assert_allclose(power[:, rays - rays // 2 :].sum(axis=1), share, rtol=1e-14)
    np.testing.assert_allclose(whole.background_power_w, 1.0, rtol=1e-14)


@pytest.mark.parametrize("rays", [1, 2, 3])
def test_few_rays_have_no_halo(rays):
    assert footprint(laser(), rays, Halo(share=0.1, divergence_rad=1e-2)).skirt is None


def test_a_bright_disc_beside_the_beam():
    """Rationale: bloom. A disc 8 mrad off the axis sees the halo only, and of that a Gaussian's integral over it.

    Reference: the noncentral chi-square of a Gaussian of the deviation w / 2 over a disc. 256 rays of the halo leave
    N^-3/4, 2 % of the whole, in each pulse, and 200 pulses turn the pattern, so that their mean is better; each
    pulse has another pattern.
    """
    share, wide, rays, pulses = 1e-3, 20e-3, 512, 200
    shape = footprint(laser("divergence_mrad=2"), rays, Halo(share=share, divergence_rad=wide))
    lanes = np.repeat(np.arange(pulses), rays)
    axes = Beams(
        pulse=lanes,
        origin_m=(np.zeros(len(lanes)),) * 3,
        aperture_m2=1.0,
        direction=(np.ones(len(lanes)), np.zeros(len(lanes)), np.zeros(len(lanes))),
    )
    out = spread(axes, shape, ray=np.tile(np.arange(rays), pulses), rotation=ROTATION)
    aside = np.stack(out.direction[1:]) / out.direction[0]
    deviation, radius = 0.25 * wide, 3e-3
    inside = np.hypot(aside[0] - 8e-3, aside[1]) < radius
    weight = shape.skirt.weight(np.tile(np.arange(rays), pulses), rays)
    collected = (inside * weight).reshape(pulses, rays).sum(axis=1)
    expected = share * ncx2.cdf((radius / deviation) ** 2, 2, (8e-3 / deviation) ** 2)
    assert collected.mean() == pytest.approx(expected, rel=0.03)
    assert np.abs(collected - expected).max() < 0.05 * share
    assert len(np.unique(collected)) > 3
    # Without a halo no light goes there at all.
    assert not inside[np.tile(np.arange(rays), pulses) < rays // 2].any()


def test_the_last_rays_are_the_halos():
    """Three of seven rays are a halo of its own width and Gaussian shape, whatever the core's: each points off the
    axis by its place times the tangent of its half angle.
    """
    sensor = load_sensor("table1-apd", overrides=["laser.divergence_mrad=2", "laser.beam_profile='top_hat'"])
    shape = footprint(sensor.laser, 7, Halo(share=0.2, divergence_rad=0.06))
    assert shape.skirt.count == 3
    lane = np.arange(7 * 5, dtype=np.uint32)
    rotation = tuple(np.eye(3).ravel())
    axes = reported_beams(sensor, pulse=lane // 7, origin_m=(0.0, 0.0, 0.0), rotation=rotation)
    rays = spread(axes, shape, ray=(lane % 7).astype(np.int64), rotation=rotation)
    along = sum(np.asarray(a) * np.asarray(b) for a, b in zip(axes.direction, rays.direction, strict=True))
    off = np.sqrt(1.0 / np.asarray(along, float) ** 2 - 1.0).reshape(5, 7)
    slopes = np.array([math.tan(1e-3)] * 4 + [math.tan(0.03)] * 3)
    place = np.hypot(*shape.points.values.T)
    np.testing.assert_allclose(off, np.tile(slopes * place, (5, 1)), rtol=2e-2, atol=1e-4)
    # Both have the variance 1 / 4 on each axis; a Gaussian's outermost third lies farther out than a disc's edge.
    np.testing.assert_allclose(shape.points.values[4:], points("gaussian", 3))
    np.testing.assert_allclose(shape.points.values[:4], points("top_hat", 4))


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("rays", [4, 5, 8, 16, 64, 256])
def test_sweep_is_even_and_has_nothing_to_do_with_the_beam(profile, rays):
    """Mean 0, variance 1/12, no covariance with the beam's axes: variances add. Tolerance: rounding. A ray is beyond an
    even sweep's end by what the stretching takes, less than a sixth.
    """
    places = with_sweep(points(profile, rays))
    np.testing.assert_array_equal(places[:, :2], points(profile, rays))
    np.testing.assert_allclose(places.mean(axis=0), 0.0, atol=1e-14)
    np.testing.assert_allclose(places.T @ places / rays, np.diag([0.25, 0.25, 1.0 / 12.0]), atol=1e-13)
    assert np.abs(places[:, 2]).max() < 0.5 * (1.0 + 1.0 / 6.0)


@pytest.mark.parametrize(("rays", "limit"), [(16, 0.061), (64, 0.023), (256, 0.009)])
@pytest.mark.parametrize("sweep_radii", [1.0, 3.0])
def test_edges_through_a_swept_beam(rays, limit, sweep_radii):
    """Light beyond edges of all angles and distances: a Gaussian, convolved with the sweep by 200 beams side by side.
    Limits: a sixth above what sqrt(3) gives; rays at random would be 0.11, 0.054 and 0.027 off.
    """
    number = np.arange(1000)
    angle, distance = math.pi * (number * (math.sqrt(5.0) - 1.0) % 2.0), (number + 0.5) / 500.0 - 1.0
    places = with_sweep(points("gaussian", rays))
    across = np.stack([np.cos(angle), np.sin(angle)])
    beyond = (places[:, :2] + sweep_radii * places[:, 2:] * (1.0, 0.0)) @ across > distance
    shots = sweep_radii * ((np.arange(200) + 0.5) / 200.0 - 0.5)
    expected = np.mean([share_beyond("gaussian", distance - shot * across[0]) for shot in shots], axis=0)
    assert np.sqrt(np.mean((beyond.mean(axis=0) - expected) ** 2)) < limit


def test_sweep_turns_the_head():
    """The axes keep their elevation and are even in azimuth, for a sensor that lies on its side too; one ray stands."""
    azimuth, elevation, swept = 0.4, 0.3, 0.1
    direction = np.array([math.cos(azimuth), math.sin(azimuth), 0.0]) * math.cos(elevation)
    direction[2] = math.sin(elevation)
    on_its_side = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    shape = footprint(laser("divergence_mrad=2"), 16, sweep_rad=swept)
    for turned in (np.eye(3), on_its_side):
        axes = Beams(
            pulse=np.zeros(16, dtype=np.uint32),
            origin_m=(0.0, 0.0, 0.0),
            direction=tuple(np.full(16, x) for x in turned @ direction),
            aperture_m2=1.0,
        )
        out = sweep(axes, shape, ray=np.arange(16), rotation=tuple(turned.ravel()))
        x, y, z = turned.T @ np.stack(out.direction)
        np.testing.assert_allclose(np.arcsin(z), elevation, rtol=1e-12)
        np.testing.assert_allclose(np.arctan2(y, x), azimuth + swept * shape.points.values[:, 2], rtol=1e-12)
    single = footprint(laser("divergence_mrad=2"), 1, sweep_rad=swept)
    assert single.sweep_rad is None
    assert sweep(axes, single, ray=np.arange(16), rotation=ROTATION) is axes
