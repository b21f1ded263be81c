"""Reflectivity from visible colour: the level is the material's, the contrast that of the published spectra."""

import numpy as np
import pytest

from lidarscene.materials import colour


def by_colour(red, wavelength_m=905e-9, reflectivity=0.3):
    return colour.reflectivity_by_colour(
        red=np.asarray(red), mean_red=0.2, reflectivity=reflectivity, wavelength_m=wavelength_m
    )


def test_the_mean_colour_has_the_material_s_reflectivity():
    assert by_colour([0.2])[0] == pytest.approx(0.3, rel=1e-12)


def test_contrast_follows_the_wavelength():
    """Half the red is 2^-0.93 at 905 nm, 2^-0.849 at 1550 nm, and between 1064 and 1550 nm what lies between."""
    assert by_colour([0.1])[0] == pytest.approx(0.3 * 2.0**-0.93, rel=1e-12)
    assert by_colour([0.1], 1550e-9)[0] == pytest.approx(0.3 * 2.0**-0.849, rel=1e-12)
    assert by_colour([0.1], 1307e-9)[0] == pytest.approx(0.3 * 2.0**-0.884, rel=1e-12)


def test_black_stays_black_and_nothing_is_above_one():
    np.testing.assert_array_equal(by_colour([0.0, 1.0], reflectivity=0.9), [0.0, 1.0])
