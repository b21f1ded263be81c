"""The ideal raster: where its rows and columns begin, and how many there are."""

import math

import numpy as np
import pytest

from lidarscene.scan import Raster

DEG = math.pi / 180.0


@pytest.mark.parametrize(("fov_deg", "step_deg", "count"), [(120.0, 0.2, 601), (0.3, 0.1, 4), (1.0, 0.3, 4)])
def test_rows_go_down_and_each_to_the_right(fov_deg: float, step_deg: float, count: int) -> None:
    """Both edges are in where the step divides the field, whatever the rounding of their quotient."""
    scanner = Raster.create(
        azimuth_fov_rad=fov_deg * DEG,
        elevation_fov_rad=1.0 * DEG,
        azimuth_step_rad=step_deg * DEG,
        elevation_step_rad=0.5 * DEG,
        rate_hz=1e5,
    )
    assert (scanner.columns, scanner.rows) == (count, 3)
    azimuth, elevation = (
        np.asarray(angle, float).reshape(3, count) / DEG
        for angle in scanner.angles(np.arange(3 * count, dtype=np.uint32))
    )
    edge = 0.5 * (count - 1) * step_deg
    np.testing.assert_allclose(azimuth, np.tile(np.linspace(edge, -edge, count), (3, 1)), atol=1e-5)
    np.testing.assert_allclose(elevation, np.repeat([[0.5], [0.0], [-0.5]], count, axis=1), atol=1e-6)
