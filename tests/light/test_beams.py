"""Rays of a sensor: where they point, how they jitter, and what aperture they have."""

import numpy as np
from scipy.stats import kstest, norm

from lidarscene import load_sensor
from lidarscene.light import beams
from lidarscene.maths.pose import rotation_matrix

PULSE = np.arange(4000, dtype=np.uint32)
TURN = rotation_matrix(yaw_rad=0.7, pitch_rad=0.4, roll_rad=-0.3)


def test_rays_turn_and_move_with_the_sensor():
    """Directions and starts are the sensor's, by the matrix."""
    sensor = load_sensor("vlp-16")
    pulse = PULSE[:100]
    rays = beams.fire(sensor, pulse=pulse, origin_m=(1.0, 2.0, 3.0), rotation=tuple(TURN.ravel()))
    expected = TURN @ np.array(sensor.scanner.direction(pulse))
    np.testing.assert_allclose(np.array(rays.direction), expected, atol=1e-6)


def test_jitter_is_gaussian_on_two_axes():
    """Jitter of 1 mrad: both components across the beam are normal and know nothing of each other, at 1e-6; the rays
    stay unit vectors.
    """
    sensor = load_sensor("table1-apd", overrides=["scanner.jitter_mrad=1"])
    identity = tuple(np.eye(3).ravel())
    true = np.array(beams.fire(sensor, pulse=PULSE, origin_m=(0.0,) * 3, rotation=identity, seed=4).direction)
    reported = np.array(beams.reported_beams(sensor, pulse=PULSE, origin_m=(0.0,) * 3, rotation=identity).direction)
    np.testing.assert_allclose(np.linalg.norm(true, axis=0), 1.0, atol=1e-6)
    left = np.stack([-reported[1], reported[0], np.zeros(len(PULSE))]) / np.hypot(reported[0], reported[1])
    up = np.cross(reported, left, axis=0)
    across = np.einsum("in,in->n", true, left), np.einsum("in,in->n", true, up)
    for component in across:
        assert kstest(np.asarray(component, float) / 1e-3, "norm").pvalue > 1e-6
    assert abs(np.corrcoef(*across)[0, 1]) < norm.isf(0.5e-6) / np.sqrt(len(PULSE))


def test_wedges_dim_the_echo_and_not_the_background():
    """Refraction trades aperture for field of view: the background's aperture is the lens itself."""
    sensor = load_sensor("livox-mid-40")
    rays = beams.fire(sensor, pulse=PULSE, origin_m=(0.0,) * 3, rotation=tuple(np.eye(3).ravel()))
    np.testing.assert_allclose(rays.background_aperture_m2 + 0.0 * PULSE, sensor.optics.aperture_m2)
    share = np.asarray(rays.aperture_m2) / sensor.optics.aperture_m2
    np.testing.assert_allclose(share, sensor.scanner.aperture_share(PULSE))
    assert np.ptp(share) > 1e-3
