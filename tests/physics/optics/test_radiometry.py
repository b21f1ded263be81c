"""Times of flight, and the lidar equation over a hemisphere."""

import numpy as np
import pytest

from lidarscene.physics.optics import radiometry
from lidarscene.physics.reference import optics as reference_optics


def test_time_of_flight():
    assert radiometry.range_from_time_of_flight_m(time_of_flight_s=1e-6) == pytest.approx(149.896229)
    assert radiometry.time_of_flight_s(range_m=149.896229) == pytest.approx(1e-6)
    assert reference_optics.time_of_flight_from_beat_s(beat_frequency_hz=1e6, chirp_rate_hz_s=1e12) == 1e-6


def test_lambertian_intensity_integrates_to_the_reflected_power():
    """(3): the intensity rho P cos / pi over the hemisphere gives rho P back."""
    cosines = np.linspace(0.0, 1.0, 20_001)
    intensity = reference_optics.lambertian_intensity_w_sr(
        reflectivity=0.3, transmittance=1.0, peak_power_w=45.0, cos_incidence=cosines
    )
    assert 2 * np.pi * np.trapezoid(intensity, cosines) == pytest.approx(0.3 * 45.0, rel=1e-6)
