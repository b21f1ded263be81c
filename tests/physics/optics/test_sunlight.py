"""Sunlight in the band."""

import pytest

from lidarscene.physics.optics import sunlight


def test_sun_is_linear_in_illuminance():
    half = sunlight.sun_irradiance_w_m2(irradiance_at_100_klux_w_m2=29.4, illuminance_klux=50.0)
    assert half == pytest.approx(14.7)
