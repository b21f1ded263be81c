"""Extinction by visibility against published numbers."""

import math

import pytest

from lidarscene.physics.optics import air


def test_kruse_and_kim():
    """Check 8: 8.9e-5 per metre at 905 nm and 23 km. Kim's fog is grey; both agree in clear air."""
    clear = {"visibility_m": 23_000.0, "wavelength_m": 905e-9}
    assert air.extinction_from_visibility_per_m(**clear, model="kruse") == pytest.approx(8.9e-5, rel=5e-3)
    assert air.extinction_from_visibility_per_m(**clear, model="kim") == pytest.approx(8.9e-5, rel=5e-3)
    fog = {"visibility_m": 200.0, "wavelength_m": 905e-9}
    assert air.extinction_from_visibility_per_m(**fog, model="kim") == pytest.approx(3.912 / 200.0)
    kruse = 3.912 / 200.0 * (0.905 / 0.55) ** (-0.585 * 0.2 ** (1 / 3))
    assert air.extinction_from_visibility_per_m(**fog, model="kruse") == pytest.approx(kruse)


def test_kim_is_continuous_and_visibility_means_two_percent():
    """And has the exponents of his formula, by hand."""
    assert [air.kim_exponent(km) for km in (0.75, 1.5, 4.0)] == pytest.approx([0.25, 0.58, 0.98])
    for edge in (0.5, 1.0, 6.0):
        assert air.kim_exponent(edge - 1e-9) == pytest.approx(air.kim_exponent(edge + 1e-9), abs=1e-6)
    alpha = air.extinction_from_visibility_per_m(visibility_m=5e3, wavelength_m=550e-9)
    assert air.transmittance(fixed=1.0, extinction_per_m=alpha, range_m=5e3) == pytest.approx(0.02, rel=1e-3)


def test_fixed_transmittance_and_extinction_multiply():
    alpha = -math.log(0.9) / 100.0
    assert air.transmittance(fixed=0.98, extinction_per_m=alpha, range_m=200.0) == pytest.approx(0.98 * 0.81)
