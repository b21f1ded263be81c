"""The numbers of docs/validation.md, computed apart from this code, to their six digits."""

import math

import pytest
from helpers.table_1 import field_of_view_sr

from lidarscene import load_sensor
from lidarscene.physics.electronics import range_limit, sipm, tdc
from lidarscene.physics.reference import optics as reference_optics
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import RangeStatus, Target

SIX_DIGITS = 1.0e-5  # the table prints six digits: half a unit of the last is 5e-6 at worst, for a leading 1
TABLE_1 = Target()

# The published (27), without the one-cell floor, is the reference of Fig. 6.
APD = load_sensor("table1-apd")
SIPM = load_sensor("table1-sipm")


def six(value):
    return pytest.approx(value, rel=SIX_DIGITS)


def light():
    return plane.echoes_of_plane(APD, TABLE_1, 100.0)


def test_photon_energy():
    assert APD.laser.photon_energy_j == six(2.19497e-19)


def test_optical_powers():
    assert light().background_power_w[0] == six(2.50992e-8)
    assert light().peak_power_w[0] == six(1.94643e-7)


def test_lambertian_forms_agree_with_the_stage():
    """(5) and (8) written out, against the scene's form with f_r = rho / pi."""
    optics, detector = APD.optics, APD.detector
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
    assert echo == pytest.approx(light().peak_power_w[0], rel=1e-12)
    assert sun == pytest.approx(light().background_power_w[0], rel=1e-12)


def test_sipm_counts():
    """(22)-(24) at 100 m."""
    d = SIPM.detector
    background = sipm.background_photons(
        power_w=light().background_power_w[0], dead_time_s=d.dead_time_s, photon_energy_j=APD.laser.photon_energy_j
    )
    signal = sipm.signal_photons(
        peak_power_w=light().peak_power_w[0], pulse_fwhm_s=6e-9, photon_energy_j=APD.laser.photon_energy_j
    )
    busy = d.cells * sipm.fired_share_published(photons=background, pde=d.pde, cells=d.cells)
    assert background == six(686.093)
    assert busy == six(125.701)
    assert signal == six(2660.31)
    point = SIPM.working_point(light().background_power_w)
    assert point.response.signal(light().peak_power_w)[0] == six(210.769)


@pytest.mark.parametrize(("sensor", "expected"), [(APD, 61.4618), (SIPM, 22.7009)])
def test_snr_at_100_m(sensor, expected):
    assert plane.snr(sensor, TABLE_1, 100.0)[0] == six(expected)


@pytest.mark.parametrize(
    ("klux", "apd_m", "sipm_m"),
    [(100, 350.605, 280.871), (50, 414.464, 347.782), (10, 593.591, 539.426), (1, 817.209, 971.009)],
)
def test_maximum_range(klux, apd_m, sipm_m):
    target = Target(illuminance_klux=klux)
    for sensor, expected in ((APD, apd_m), (SIPM, sipm_m)):
        maximum_m, status = plane.maximum_range_m(sensor, target)
        assert status == RangeStatus.FOUND
        assert maximum_m == six(expected)


def test_illuminance_of_equal_range():
    assert plane.equal_range_illuminance_klux(APD, SIPM, TABLE_1) == six(3.22191)


def test_false_alarms_and_correct_probability():
    p_false = tdc.false_alarm_probability(threshold=5.0, noise=1.0)
    assert p_false == six(2.86652e-7)
    comparisons = tdc.comparisons(window_s=4e-6, bandwidth_hz=100e6)
    p_correct = tdc.correct_probability(p_false=p_false, p_detect=0.5, comparisons=comparisons)
    assert 1.0 - p_correct == pytest.approx(1.0 - 0.9997713, abs=5e-8)  # seven digits printed


def closed_forms(**changes):
    light_and_optics = (
        range_limit.Plane(reflectivity=0.1, sun_irradiance_w_m2=29.4, transmittance=0.98, cos_sun=0.5),
        range_limit.Transceiver(
            peak_power_w=45.0,
            aperture_m2=APD.optics.aperture_m2,
            focal_over_radius=300.0,
            threshold_to_noise=5.0,
            photon_energy_j=APD.laser.photon_energy_j,
            efficiency_laser=0.7206,
            efficiency_sun=0.7986,
        ),
    )
    apd_m = range_limit.maximum_range_apd_m(
        *light_and_optics, quantum_efficiency=0.7, excess_noise=80**0.3, bandwidth_hz=167e6, **changes
    )
    sipm_m = range_limit.maximum_range_sipm_m(
        *light_and_optics, pulse_fwhm_s=6e-9, pde=0.22, dead_time_s=6e-9, **changes
    )
    return apd_m, sipm_m


def test_derived_closed_forms():
    apd_m, sipm_m = closed_forms()
    assert apd_m == six(352.751)
    assert sipm_m == six(308.667)


def test_size_of_the_errata_in_the_closed_forms():
    """The factor 1 / cos theta_s is worth, at 60 degrees, sqrt(2) in range, and 1/2 for 1/sqrt(2) a factor 2^(-1/4)."""
    derived, printed = closed_forms(), closed_forms(as_printed=True)
    assert printed[0] / derived[0] == pytest.approx(math.sqrt(2.0) * 2.0**-0.25, rel=1e-12)
    assert printed[1] / derived[1] == pytest.approx(math.sqrt(2.0), rel=1e-12)


def test_closed_forms_are_upper_bounds():
    """They leave out every noise but the background's, so the exact range is shorter."""
    for sensor, bound in zip((APD, SIPM), closed_forms(), strict=True):
        assert 0.8 * bound < plane.maximum_range_m(sensor, TABLE_1)[0] < bound


def test_steady_state_cells_of_table_1():
    """docs/theory.md 6: 109.6 busy cells and a variance of 79.6, against 125.7 and 86.2 as printed."""
    for photons, busy in ((1, 0.22), (50, 10.7), (200, 39.7), (686.093, 109.6), (2000, 209.5)):
        share = sipm.busy_share_steady_state(
            photons=photons, pde=0.22, cells=400.0, dark_count_rate_hz=0.0, dead_time_s=6e-9
        )
        assert 400.0 * share == pytest.approx(busy, rel=5e-3)  # the printed values carry three digits
    share = sipm.busy_share_steady_state(
        photons=686.093, pde=0.22, cells=400.0, dark_count_rate_hz=0.0, dead_time_s=6e-9
    )
    assert sipm.busy_variance_steady_state(busy_share=share, cells=400.0) == pytest.approx(79.6, abs=0.05)
    assert sipm.fired_variance_published(fired=125.701, cells=400.0) == pytest.approx(86.2, abs=0.05)


def test_one_cell_floor_at_no_light():
    """(27) alone would have the SiPM see 4105 m in the dark; a comparator cannot see less than one cell."""
    dark = Target(illuminance_klux=0.0)
    floored = load_sensor("table1-sipm", overrides=["detector.cell_floor=1"])
    assert plane.maximum_range_m(SIPM, dark)[0] == pytest.approx(4105.0, rel=2e-3)
    assert plane.maximum_range_m(floored, dark)[0] < 2600.0


def test_claims_of_figure_6():
    """The APD is ahead at every range at 100 klux; SNR falls as 1/R^2 far out; the SiPM saturates close in."""
    ranges = [5.0 * 1.2**k for k in range(25)]
    assert (plane.snr(APD, TABLE_1, ranges) > plane.snr(SIPM, TABLE_1, ranges)).all()
    for sensor in (APD, SIPM):
        near, far = plane.snr(sensor, TABLE_1, [1000.0, 2000.0])
        assert near / far == pytest.approx(4.0, rel=7e-3)  # the SiPM is 0.5 % short of linear at 1 km
    close = plane.snr(SIPM, TABLE_1, [1.0, 5.0])
    assert close[0] / close[1] < 1.01


def test_range_without_light_or_limit_is_a_status():
    assert plane.maximum_range_m(APD, Target(reflectivity=0.0))[1] == RangeStatus.NEVER_DETECTED
    silent = load_sensor("table1-sipm", overrides=["detector.dark_count_rate_hz=0"])
    assert plane.maximum_range_m(silent, Target(illuminance_klux=0.0))[1] == RangeStatus.NO_LIMIT
