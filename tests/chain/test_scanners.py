"""Scanners in the whole chain: times, channels, places, apertures and pointing in the cloud."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import chain, scanners
from helpers.run_seed import chosen

from lidarscene import Simulator
from lidarscene.light import beams
from lidarscene.maths.pose import direction_from_angles
from lidarscene.scene.scene import Air, Sun

pytestmark = pytest.mark.usefixtures("mi")

RADIUS_M = 20.0


def ball_around(**changes):
    """The sensor in the middle of a big ball without sun and air: every direction has the same range."""
    return chain.scene(
        chain.ball(at=(0.0, 0.0, 0.0), radius_m=RADIUS_M), klux=0.0, air=Air(transmittance=1.0), **changes
    )


def equip(scanner, *overrides):
    return dataclasses.replace(chain.sensor("table1-apd", *overrides), scanner=scanner)


def render_cloud(scanner, *overrides, seed=0):
    return Simulator(ball_around(), equip(scanner, *overrides)).render(seed=seed, chunk=1999)


@pytest.mark.parametrize("name", chosen(5, list(scanners.ALL)))
def test_every_scanner_renders(name):
    """One echo for every pulse, its time and channel from the scanner, its place where the angles say."""
    scanner = scanners.ALL[name]()
    cloud = render_cloud(scanner, "tdc.threshold_to_noise=8")
    assert len(cloud) == scanner.pulses
    pulse = scanners.frame(scanner)
    np.testing.assert_array_equal(cloud.time_s, scanner.time_s(pulse))
    np.testing.assert_array_equal(cloud.channel, scanner.channel(pulse))
    assert cloud.time_s.dtype == np.float64
    direction = np.stack(
        direction_from_angles(azimuth_rad=cloud.azimuth_rad, elevation_rad=cloud.elevation_rad), axis=1
    )
    start = 0.0 if scanner.offset_m(pulse) is None else np.stack(scanner.offset_m(pulse), axis=1)
    np.testing.assert_allclose(cloud.xyz_m, start + direction * cloud.range_m[:, None], atol=2e-5)
    np.testing.assert_allclose(cloud.true_range_m, RADIUS_M, atol=0.013)  # VLP-16's exits are 11 mm off
    true = start + direction * cloud.true_range_m[:, None]
    np.testing.assert_allclose(np.linalg.norm(true, axis=1), RADIUS_M, atol=1e-4)


@pytest.mark.parametrize("name", ["mirror_step", "mirror_round", "polygon", "mid40", "flash", "lissajous_pair"])
def test_the_echo_goes_with_the_aperture(name):
    """Rationale: one range, one reflectivity, normal incidence, no background: by (5) only A(theta_r) is left.
    Reference: the share. Tolerance: single precision.
    """
    scanner = scanners.ALL[name]()
    lanes = chain.run_stages(ball_around(), equip(scanner))
    power = lanes.light.peak_power_w
    share = scanner.aperture_share(scanners.frame(scanner))
    optics = chain.sensor("table1-apd").optics
    expected = 45.0 * 0.1 / math.pi / RADIUS_M**2 * optics.aperture_m2 * optics.efficiency_laser * share
    np.testing.assert_allclose(power, expected, rtol=2e-4)  # the ball is a little off 1 in cos(incidence)
    assert np.ptp(power) > 0.03 * power.max()


def test_the_background_goes_with_the_aperture():
    """Rationale: (8) has A(theta_r) too. Sky in all directions: only the share is left."""
    scanner = scanners.polygon()
    behind = chain.ball(at=(-50.0, 0.0, 0.0))
    described = chain.scene(behind, klux=100.0, sky=0.1, air=Air(transmittance=1.0))
    lanes = chain.run_stages(described, equip(scanner))
    share = scanner.aperture_share(scanners.frame(scanner))
    np.testing.assert_allclose(
        lanes.light.background_power_w / lanes.light.background_power_w.max(), share / share.max(), rtol=1e-5
    )


def test_jitter_moves_the_beam_and_not_what_is_reported():
    """Gaussian on both axes, by seed and pulse. Tolerance: four standard errors of 28 928 pulses."""
    sigma = 2e-3
    exact, shaky = scanners.vlp16(start_m=None), scanners.vlp16(start_m=None, jitter_rad=sigma)
    pulse = scanners.frame(exact)
    place = {"origin_m": (0.0, 0.0, 0.0), "rotation": tuple(float(x) for x in np.eye(3).ravel())}

    def fire_directions(scanner, seed):
        return np.stack(beams.fire(equip(scanner), pulse=pulse, seed=seed, **place).direction, axis=1)

    straight, bent = fire_directions(exact, 0), fire_directions(shaky, 0)
    np.testing.assert_allclose(np.linalg.norm(bent, axis=1), 1.0, atol=3e-7)
    off = (bent - straight).astype(float)
    level = np.stack([-straight[:, 1], straight[:, 0], 0 * straight[:, 0]], axis=1)
    level /= np.linalg.norm(level, axis=1)[:, None]
    for axis in (level, np.cross(straight, level)):
        aside = np.sum(off * axis, axis=1)
        assert aside.std() == pytest.approx(sigma, rel=4 / math.sqrt(2 * len(pulse)))
        assert abs(aside.mean()) < 4 * sigma / math.sqrt(len(pulse))
    np.testing.assert_array_equal(fire_directions(shaky, 0), bent)
    assert np.mean(np.abs(fire_directions(shaky, 1) - bent).max(axis=1) < 1e-6) < 0.01
    for shaky_angle, exact_angle in zip(shaky.angles(pulse), exact.angles(pulse), strict=True):
        np.testing.assert_array_equal(shaky_angle, exact_angle)


def test_encoders_place_points_where_they_read():
    """Rationale: the beam goes on turning between the encoder's steps, the reported azimuth does not."""
    step = 2e-3
    cloud = render_cloud(scanners.vlp16(start_m=None, encoder_rad=step), "tdc.threshold_to_noise=8")
    steps = cloud.azimuth_rad[np.abs(cloud.azimuth_rad) < math.pi - step] / step  # half a turn is no whole step
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)
    azimuth = np.arctan2(cloud.xyz_m[:, 1], cloud.xyz_m[:, 0])
    off = np.remainder(azimuth - cloud.azimuth_rad + math.pi, 2 * math.pi) - math.pi
    np.testing.assert_allclose(off, 0.0, atol=1e-6)


@pytest.mark.parametrize(("name", "even"), [("mid40", True), ("mirror_step", False), ("polygon", False)])
def test_sky_in_all_directions(mi, name, even):
    """Even through prisms, whose echo is not; a mirror or a facet takes of both alike."""
    scanner = scanners.ALL[name]()
    described = chain.scene(chain.ball(at=(-50.0, 0.0, 0.0)), sky=0.1, sun=Sun(azimuth_rad=math.pi))
    light = chain.run_stages(described, dataclasses.replace(chain.sensor("table1-apd"), scanner=scanner)).light
    relative = light.background_power_w / light.background_power_w.max()
    assert (np.ptp(relative) < 1e-5) == even
    pulse = scanners.frame(scanner)
    share = np.broadcast_to(scanner.background_share(pulse), len(pulse))
    np.testing.assert_allclose(relative, share / share.max(), rtol=1e-5)
