"""The Gaussian pulse against numerical derivatives and integrals."""

import numpy as np
import pytest

from lidarscene.physics.optics import pulse
from lidarscene.physics.reference import optics as reference_optics


def test_pulse():
    """Half its peak at half its width; its edge inverts; its area is the energy."""
    assert pulse.gaussian_pulse(time_s=3e-9, fwhm_s=6e-9) == pytest.approx(0.5)
    levels = np.array([1e-4, 0.1, 0.5, 0.99])
    times = pulse.leading_edge_time_s(level=levels, fwhm_s=6e-9)
    np.testing.assert_allclose(pulse.gaussian_pulse(time_s=times, fwhm_s=6e-9), levels, rtol=1e-12)
    step = 1e-15
    slope = (
        pulse.gaussian_pulse(time_s=times + step, fwhm_s=6e-9) - pulse.gaussian_pulse(time_s=times - step, fwhm_s=6e-9)
    ) / (2 * step)
    np.testing.assert_allclose(reference_optics.leading_edge_slope_per_s(level=levels, fwhm_s=6e-9), slope, rtol=1e-5)
    grid = np.linspace(-30e-9, 30e-9, 60_001)
    area = np.trapezoid(pulse.gaussian_pulse(time_s=grid, fwhm_s=6e-9), grid)
    assert pulse.pulse_energy_j(peak_power_w=45.0, fwhm_s=6e-9) == pytest.approx(45.0 * area, rel=1e-9)


@pytest.mark.parametrize("incidence_deg", [0.0, 60.0, 87.0])
def test_an_echo_is_as_long_as_rays_over_the_spot_make_it(incidence_deg):
    """Deviation of arrivals: a Gaussian spot of 3 mrad at 40 m, its rays met by a plane, and the pulse's own.

    Of 200,000 rays a deviation is sure to 0.2 %; rays of a beam are parallel in the closed form, which at 87 degrees is
    0.5 % off.
    """
    across = 0.25 * 3e-3 * np.random.default_rng(2).standard_normal(200_000)  # the 1/e^2 radius is two deviations
    tangent = np.tan(np.radians(incidence_deg))
    range_m = 40.0 / (1.0 - np.tan(across) * tangent)
    unit_m = 0.3
    found = pulse.slope_broadening(
        spot_rad=np.array(1.5e-3), range_m=40.0, cos_incidence=np.cos(np.radians(incidence_deg)), unit_m=unit_m
    )
    assert found == pytest.approx(np.hypot(unit_m, range_m.std()) / unit_m, rel=0.008)
