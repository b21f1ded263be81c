"""A dirty window: diffracted light against a Fourier transform and Airy's pattern, drops by counting."""

import math

import numpy as np
import pytest
from scipy.special import j1

from lidarscene.physics.optics import window


@pytest.mark.parametrize("covered", [0.02, 0.1, 0.4])
def test_what_grains_diffract_is_what_a_transform_finds(covered):
    """The light behind a mask of random opaque cells: the transform's entry at 0 is the undeviated light. The power
    there scatters by 2 sqrt(s / (1 - s) / cells): 2e-3 at most with 512^2 cells, taken five times.
    """
    cells = np.random.default_rng(1).random((512, 512)) >= covered
    power = np.abs(np.fft.fft2(cells.astype(float))) ** 2
    undeviated = power[0, 0] / power.sum()
    assert 1.0 - undeviated**2 == pytest.approx(window.diffracted_share(covered=covered), abs=0.01)
    assert undeviated == pytest.approx(1.0 - covered, abs=0.01)


def test_the_angle_is_that_of_airys_pattern():
    """The pattern (2 J_1(x) / x)^2 at half of the full angle is 1/e^2; the constant has four digits."""
    angle = window.diffraction_angle_rad(wavelength_m=905e-9, grain_m=50e-6)
    x = math.pi * 50e-6 * 0.5 * angle / 905e-9
    assert (2.0 * j1(x) / x) ** 2 == pytest.approx(math.exp(-2.0), rel=1e-3)
