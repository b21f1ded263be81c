"""Flash lidars against the laws of their projections."""

import numpy as np
import pytest
from helpers import scanners
from helpers.scanners import directions, shares

from lidarscene.scan.flash import LARGEST_HEIGHT

FLASH_HEIGHT = {
    "rectilinear": np.tan,
    "equidistant": lambda t: t,
    "equisolid": lambda t: 2 * np.sin(t / 2),
    "stereographic": lambda t: 2 * np.tan(t / 2),
    "orthographic": np.sin,
}


@pytest.mark.parametrize("projection", FLASH_HEIGHT)
def test_flash(projection):
    """Reference: the projection's own law, from the angle back to the pixel; solid angle by differences."""
    scanner = scanners.flash(projection=projection, falloff="pupil_and_pixel")
    direction, share = directions(scanner, scanners.frame(scanner)), shares(scanner, scanners.frame(scanner))
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, atol=2e-7)
    up, left = np.mgrid[20:-21:-1, 30:-31:-1] * 0.02
    t = np.arctan2(np.hypot(direction[:, 1], direction[:, 2]), direction[:, 0])
    height = FLASH_HEIGHT[projection]
    np.testing.assert_allclose(height(t), np.hypot(left, up).ravel(), atol=1e-6)
    cross = direction[:, 1] * up.ravel() - direction[:, 2] * left.ravel()
    np.testing.assert_allclose(cross, 0.0, atol=1e-7)
    t = np.maximum(t.astype(float), 1e-3)
    step = 1e-5
    slope = (height(t + step) - height(t - step)) / (2 * step)
    np.testing.assert_allclose(share, np.cos(t) * np.sin(t) / (height(t) * slope), rtol=2e-5)


@pytest.mark.parametrize("projection", FLASH_HEIGHT)
def test_a_lens_ends_at_a_right_angle(projection):
    """The largest height is that of 90 degrees; of a rectilinear lens, which has none there, beyond 88."""
    angle = np.radians(88.9) if projection == "rectilinear" else 0.5 * np.pi
    assert LARGEST_HEIGHT[projection] == pytest.approx(FLASH_HEIGHT[projection](angle), rel=0.05 * (angle < 1.56))
