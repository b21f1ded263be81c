"""Table 1 between stages and closed forms; tests/studies/paper/test_claims.py has its numbers."""

import pytest
from helpers.table_1 import field_of_view_sr

from lidarscene import load_sensor
from lidarscene.physics.reference import optics as reference_optics
from lidarscene.studies.paper.numbers import closed_forms
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import RangeStatus, Target

APD, SIPM, TABLE_1 = load_sensor("table1-apd"), load_sensor("table1-sipm"), Target()


def test_lambertian_forms_agree_with_the_stage():
    """(5) and (8) written out, against the scene's form with f_r = rho / pi."""
    optics, detector, light = APD.optics, APD.detector, plane.echoes_of_plane(APD, TABLE_1, 100.0)
    echo = reference_optics.lambertian_echo_power_w(
        peak_power_w=45.0,
        reflectivity=0.1,
        cos_incidence=1.0,
        range_m=100.0,
        transmittance=0.98,
        aperture_m2=optics.aperture_m2,
        efficiency=0.7206,
    )
    sun = reference_optics.lambertian_sun_power_w(
        sun_irradiance_w_m2=29.4,
        reflectivity=0.1,
        cos_sun=0.5,
        aperture_m2=optics.aperture_m2,
        field_of_view_sr=field_of_view_sr(detector.radius_m, optics.focal_length_m),
        transmittance=0.98,
        efficiency=0.7986,
    )
    assert echo == pytest.approx(light.peak_power_w[0], rel=1e-12)
    assert sun == pytest.approx(light.background_power_w[0], rel=1e-12)


def test_closed_forms_are_upper_bounds():
    """They leave out every noise but the background's, so the exact range is shorter."""
    for sensor, bound in zip((APD, SIPM), closed_forms(as_printed=False), strict=True):
        assert 0.8 * bound < plane.maximum_range_m(sensor, TABLE_1)[0] < bound


def test_range_without_light_or_limit_is_a_status():
    assert plane.maximum_range_m(APD, Target(reflectivity=0.0))[1] == RangeStatus.NEVER_DETECTED
    silent = load_sensor("table1-sipm", overrides=["detector.dark_count_rate_hz=0"])
    assert plane.maximum_range_m(silent, Target(illuminance_klux=0.0))[1] == RangeStatus.NO_LIMIT
