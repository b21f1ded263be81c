"""What of a mirrored beam lands on the receiver: against Rice's distribution, fine grids, and a beam in space."""

import math

import numpy as np
import pytest
from scipy.stats import ncx2

from lidarscene.physics.optics import glint, radiometry

A_M = 12.5e-3


def share(off_m, radius_m, *, profile="gaussian", turn=0.6):
    aside = (off_m * math.cos(turn), off_m * math.sin(turn))
    radii_m = radius_m if isinstance(radius_m, tuple) else (radius_m, radius_m)
    return glint.share_on_aperture(profile=profile, aside_m=aside, spot_radius_m=radii_m, aperture_radius_m=A_M)


@pytest.mark.parametrize(("wide", "off_by"), [(0.7, 7e-3), (1.0, 6e-4), (1.5, 3e-5), (3.0, 1e-6), (20.0, 1e-9)])
def test_round_gaussian_spots_against_rice(wide, off_by):
    """scipy's non-central chi-squared: the distance from a point of a Gaussian. Tolerances: the cubature's own."""
    off = np.linspace(0.0, 3.0 * wide + 1.0, 101) * A_M
    expected = ncx2.cdf((2.0 / wide) ** 2, 2, (2.0 * off / (wide * A_M)) ** 2)
    np.testing.assert_allclose(share(off, wide * A_M), expected, rtol=0, atol=off_by * expected.max())


def integrate_on_grid(density, points=2000):
    """A density over the aperture by midpoints of fine squares: its edge is good to 1e-4."""
    line = (np.arange(points) + 0.5) / points * 2.0 - 1.0
    x, y = A_M * line[:, None], A_M * line[None, :]
    inside = line[:, None] ** 2 + line[None, :] ** 2 < 1.0
    return float((density(x, y) * inside).sum() * (2.0 * A_M / points) ** 2)


@pytest.mark.parametrize("off_m", [0.0, 8e-3, 25e-3, 60e-3])
def test_elliptical_spots_against_a_grid(off_m):
    w1, w2 = 14e-3, 40e-3
    x0, y0 = off_m * math.cos(0.6), off_m * math.sin(0.6)

    def density(x, y):
        return 2.0 / (math.pi * w1 * w2) * np.exp(-2.0 * (((x + x0) / w1) ** 2 + ((y + y0) / w2) ** 2))

    peak = 2.0 * A_M**2 / (w1 * w2)
    assert share(off_m, (w1, w2)) == pytest.approx(integrate_on_grid(density), abs=5e-4 * peak)


@pytest.mark.parametrize(("wide", "off_m"), [(0.8, 0.0), (0.8, 15e-3), (3.0, 10e-3), (3.0, 35e-3), (3.0, 60e-3)])
def test_top_hats_against_a_grid(wide, off_m):
    w = wide * A_M
    x0, y0 = off_m * math.cos(0.6), off_m * math.sin(0.6)
    expected = integrate_on_grid(lambda x, y: ((x + x0) ** 2 + (y + y0) ** 2 < w * w) / (math.pi * w * w))
    assert share(off_m, w, profile="top_hat") == pytest.approx(expected, abs=2e-3)


def test_a_beam_of_no_width_comes_back_whole_or_not():
    """Unknown divergences are 0: what lands inside the aperture comes back, blurred over a third of its radius."""
    for profile in ("gaussian", "top_hat"):
        assert share(0.0, 0.0, profile=profile) == pytest.approx(1.0, abs=0.02)
        assert share(2.0 * A_M, 0.0, profile=profile) == pytest.approx(0.0, abs=0.02)
    assert share(np.linspace(0.0, 1.0, 50) * A_M, 0.0).max() <= 1.0


def test_its_echo_has_no_range_in_it():
    """(5) with the apparent backscatter is P_t eta tau^2 S, whatever the range and the aperture."""
    for range_m, aperture_m2 in ((3.0, 5e-4), (80.0, 2e-3)):
        power = radiometry.echo_power_w(
            peak_power_w=75.0,
            backscatter_per_sr=glint.apparent_backscatter_per_sr(share=0.04, range_m=range_m, aperture_m2=aperture_m2),
            range_m=range_m,
            transmittance=0.9,
            aperture_m2=aperture_m2,
            efficiency=0.8,
        )
        assert power == pytest.approx(75.0 * 0.8 * 0.9**2 * 0.04, rel=1e-12)
