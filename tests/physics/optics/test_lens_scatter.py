"""Share of a channel's light that lenses scatter onto the detector of another."""

import numpy as np
import pytest

from lidarscene.physics.optics.lens_scatter import stray_share


def test_share_by_angle():
    """(T122) at its marks: whole at no angle, half at the half angle, a tenth at three of them, and the veil beyond."""
    angle = np.array([0.0, 0.02, 0.06, 1e6])
    share = stray_share(angle_rad=angle, near=4e-4, half_angle_rad=0.02, veil=1e-5)
    np.testing.assert_allclose(share, [4.1e-4, 2.1e-4, 0.5e-4, 1e-5], rtol=1e-12)


def test_law_is_that_of_a_polished_surface():
    """Far from the axis Harvey and Shack's law, b (1 + (theta / l)^2)^(s / 2), falls by 10^s for each decade."""
    nearer, farther = (stray_share(angle_rad=angle, near=1.0, half_angle_rad=1e-3, veil=0.0) for angle in (0.5, 5.0))
    assert farther / nearer == pytest.approx(1e-2, rel=1e-5)
