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
