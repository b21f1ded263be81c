"""Maximum range for arrays of conditions: its statuses, its limits, its closed form.

tests/studies/paper/test_claims.py has it by hand, in all light and of two reflectivities.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.trains import detect
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lidarscene import load_sensor
from lidarscene.detection.outcomes import Outcome
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.conditions import Conditions
from lidarscene.studies.ranging.plane import RangeStatus, Target
from lidarscene.studies.ranging.range_summary import range_report

APD = load_sensor("table1-apd")
SIPM = load_sensor("table1-sipm")
BOTH = pytest.mark.parametrize("name", ["table1-apd", "table1-sipm"])

# Nothing is random from run to run.
steady = settings(derandomize=True, max_examples=40, database=None)


def sensor_with(name, **changes):
    return load_sensor(name, overrides=[f"{key.replace('__', '.')}={value!r}" for key, value in changes.items()])


def reach(sensor, **target):
    return plane.maximum_range_m(sensor, Target(**target))[0]


# --- arrays -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("sensor", [APD, SIPM], ids=["apd", "sipm"])
def test_arrays_are_many_scalars(sensor):
    """Reference: the scalar call. Tolerance: the bisection's own 1e-12."""
    klux, share = np.array([0.0, 0.1, 30.0]), np.array([[0.0], [0.1], [0.9]])
    limit, status = plane.maximum_range_m(
        sensor, Target(illuminance_klux=klux, reflectivity=share, extinction_per_m=1e-4)
    )
    assert limit.shape == status.shape == (3, 3)
    for row in range(3):
        for column in range(3):
            target = Target(
                illuminance_klux=float(klux[column]), reflectivity=float(share[row, 0]), extinction_per_m=1e-4
            )
            scalar_limit, alone_status = plane.maximum_range_m(sensor, target)
            assert limit[row, column] == pytest.approx(scalar_limit, rel=1e-11)
            assert status[row, column] == alone_status


def test_sensors_stack():
    gains = [10.0, 80.0, 300.0]
    sensors = [sensor_with("table1-apd", detector__gain=gain) for gain in gains]
    stack = plane.stack_sensors(sensors)
    assert stack is not None
    assert plane.conditions_shape(stack, Target()) == (3,)
    limit, status = plane.maximum_range_m(stack, Target())
    assert limit == pytest.approx([reach(sensor) for sensor in sensors], rel=1e-11)
    assert (status == RangeStatus.FOUND).all()


def test_samplers_stack():
    """Rationale: samples at less than twice the bandwidth let less noise pass."""
    sensors = [sensor_with("vlp-16", sampler__rate_mhz=rate, tdc__bandwidth_mhz=200) for rate in (250, 320, 500)]
    limit, _ = plane.maximum_range_m(plane.stack_sensors(sensors), Target())
    assert limit == pytest.approx([plane.maximum_range_m(sensor, Target())[0] for sensor in sensors], rel=1e-11)
    assert limit[0] != limit[2]


def test_what_differs_in_words_does_not_stack():
    assert plane.stack_sensors([APD, SIPM]) is None
    assert plane.stack_sensors([SIPM, sensor_with("table1-sipm", detector__statistics="time_domain")]) is None


def test_scalars_stay_scalars():
    limit, status = plane.maximum_range_m(APD, Target())
    assert isinstance(limit, float)
    assert status is RangeStatus.FOUND


# --- statuses ---------------------------------------------------------------------------------------


def test_every_status_has_its_case():
    quiet = sensor_with("table1-sipm", detector__cell_floor=0, detector__dark_count_rate_hz=0)
    limit, status = plane.maximum_range_m(quiet, Target(illuminance_klux=np.array([0.0, 10.0])))
    assert list(status) == [RangeStatus.NO_LIMIT, RangeStatus.FOUND]
    assert limit[0] == math.inf
    hazy = Target(illuminance_klux=0.0, extinction_per_m=1e-3)  # an echo of e^-600 is still an echo
    assert plane.maximum_range_m(quiet, hazy) == (math.inf, RangeStatus.NO_LIMIT)
    limit, status = plane.maximum_range_m(APD, Target(reflectivity=np.array([0.0, 0.1])))
    assert list(status) == [RangeStatus.NEVER_DETECTED, RangeStatus.FOUND]
    assert limit[0] == 0.0


def test_a_threshold_above_all_free_cells_is_saturated():
    """10 cells under 100 klux: 0.6 are free on average, and five sigma are 3.8."""
    assert plane.maximum_range_m(sensor_with("table1-sipm", detector__cells=10), Target()) == (
        0.0,
        RangeStatus.SATURATED,
    )
    level = sensor_with("table1-sipm", tdc__threshold_to_noise=40.0)
    assert plane.maximum_range_m(level, Target())[1] == RangeStatus.SATURATED


def test_what_is_blinded_close_by_may_see_farther_off():
    """Rationale: in fog the sun on the target fades with range, too. Few cells: blind at 1 m, seeing at 8 m."""
    few_cells, fog = (
        sensor_with("table1-sipm", detector__cells=10, optics__efficiency_laser=1.0),
        Target(transmittance=1.0, extinction_per_m=0.5),
    )
    margin = plane.detection_margin(few_cells, fog, [1.0, 8.0])
    assert margin[0] < 1.0 < margin[1]
    limit, status = plane.maximum_range_m(few_cells, fog)
    assert status == RangeStatus.FOUND
    assert plane.detection_margin(few_cells, fog, [limit * 0.999])[0] > 1.0
    assert (plane.detection_margin(few_cells, fog, np.geomspace(limit * 1.001, 1e6, 500)) < 1.0).all()


@steady
@given(
    name=st.sampled_from(["table1-apd", "table1-sipm"]),
    reflectivity=st.floats(0.0, 1.0),
    klux=st.floats(0.0, 1e5),
    cosine=st.floats(0.0, 1.0),
    sun=st.floats(-1.0, 1.0),
    extinction=st.floats(0.0, 10.0),
    aperture=st.floats(0.0, 1.5),
)
@example(name="table1-apd", reflectivity=0.1, klux=1.0, cosine=1.0, sun=5e-324, extinction=0.0, aperture=1.0)
@example(name="table1-sipm", reflectivity=5e-324, klux=1.0, cosine=1.0, sun=1.0, extinction=1e-3, aperture=1.0)
def test_never_nan(name, reflectivity, klux, cosine, sun, extinction, aperture):
    """Rationale: NaN is always a bug. The status says what 0 and inf mean."""
    target = Target(
        reflectivity=reflectivity,
        illuminance_klux=klux,
        cos_incidence=cosine,
        cos_sun=sun,
        extinction_per_m=extinction,
        aperture_share=aperture,
    )
    sensor = APD if name == "table1-apd" else SIPM
    limit, status = plane.maximum_range_m(sensor, target)
    assert limit >= 0.0
    assert (limit == 0.0) == (status in (RangeStatus.NEVER_DETECTED, RangeStatus.SATURATED))
    assert (limit == math.inf) == (status == RangeStatus.NO_LIMIT)
    ranges = np.geomspace(0.01, 1e6, 50)
    for values in (plane.snr(sensor, target, ranges), plane.detection_probability(sensor, target, ranges)):
        assert not np.isnan(values).any()
    assert not np.isnan(plane.closed_form_range_m(sensor, target))


# --- limits -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("statistics", "tolerance"), [("published", 1e-4), ("steady_state", 1e-4), ("time_domain", 2.5e-3)]
)
def test_many_cells_are_the_approximation(statistics, tolerance):
    """N -> infinity: (27), published or derived, becomes (28), and its range the closed form.

    1e9 cells: 1e-4; in the time domain half of the table's 0.5 %.
    """
    many_cells = sensor_with(
        "table1-sipm", detector__cells=10**9, detector__dark_count_rate_hz=0.0, detector__statistics=statistics
    )
    assert reach(many_cells) == pytest.approx(plane.closed_form_range_m(many_cells, Target()), rel=tolerance)


def test_no_sun_is_a_limit_not_a_jump():
    """E_sun -> 0: what is left is electrical noise (APD), dark counts or one cell (SiPM)."""
    for sensor in (APD, SIPM, sensor_with("table1-sipm", detector__cell_floor=0.0)):
        assert reach(sensor, illuminance_klux=1e-9) == pytest.approx(reach(sensor, illuminance_klux=0.0), rel=1e-4)
    assert plane.closed_form_range_m(APD, Target(illuminance_klux=0.0)) == math.inf


def test_a_diffuse_sky_is_more_background():
    assert reach(APD, diffuse_share=0.3) < reach(APD)


# --- air and closed forms ---------------------------------------------------------------------------


@BOTH
def test_extinction_is_the_transmittance_at_the_limit(name):
    """A fixed transmittance of the value exp(-alpha R) at the range R gives R too."""
    sensor, alpha = load_sensor(name), 2e-3
    limit = reach(sensor, transmittance=1.0, extinction_per_m=alpha)
    assert reach(sensor, transmittance=math.exp(-alpha * limit)) == pytest.approx(limit, rel=1e-9)


@BOTH
@pytest.mark.parametrize("alpha", [1e-9, 1e-4, 1e-2, 5.0])
def test_closed_form_with_extinction(name, alpha):
    """R = R_0 exp(-3/4 alpha R). Tolerance: rounding."""
    sensor = load_sensor(name)
    clear = plane.closed_form_range_m(sensor, Target(transmittance=0.9))
    limit = plane.closed_form_range_m(sensor, Target(transmittance=0.9, extinction_per_m=alpha))
    assert limit == pytest.approx(clear * math.exp(-0.75 * alpha * limit), rel=1e-12)


def test_closed_form_of_arrays():
    ranges_m = plane.closed_form_range_m(APD, Target(illuminance_klux=np.array([0.0, 100.0]), reflectivity=0.1))
    assert ranges_m[0] == math.inf
    assert ranges_m[1] == pytest.approx(352.751, rel=1e-5)
    assert plane.closed_form_range_m(APD, Target(reflectivity=0.0)) == 0.0
    with pytest.raises(ValueError, match="fixed threshold"):
        plane.closed_form_range_m(replace(APD, tdc=replace(APD.tdc, threshold_to_noise=None)), Target())


def test_effective_aperture_counts_as_aperture():
    """A(theta_r) of (4) is in the echo and in the sunlight alike."""
    small = sensor_with("table1-apd", optics__aperture_radius_mm=25.0 * math.sqrt(0.6))
    assert reach(APD, aperture_share=0.6) == pytest.approx(reach(small), rel=1e-11)


def test_equal_ranges_need_a_change_of_places():
    with pytest.raises(ValueError, match="do not change places between 10 and 100"):
        plane.equal_range_illuminance_klux(APD, SIPM, Target(), low_klux=10, high_klux=100)


def test_the_sky_adds_to_the_sun_in_the_closed_form():
    """Half of the sun's light aslant and a quarter from all of the sky are three quarters of it."""
    for sensor in (APD, SIPM):
        with_sky = plane.closed_form_range_m(sensor, Target(cos_sun=0.5, diffuse_share=0.25))
        assert with_sky == pytest.approx(plane.closed_form_range_m(sensor, Target(cos_sun=0.75)))


def test_an_amplifier_shortens_the_closed_form_as_it_shortens_the_snr():
    """SNR falls as the square of the range, in light that drowns all other noise: (R / R')^2 is the ratio of both."""
    bright = Target(illuminance_klux=1e5)
    slow, bare = (sensor_with("table1-sipm", receiver__response=response) for response in ("single_pole", "none"))
    snrs = [float(plane.snr(sensor, bright, 20.0)[0]) for sensor in (slow, bare)]
    ranges = [plane.closed_form_range_m(sensor, bright) for sensor in (slow, bare)]
    assert abs(snrs[0] / snrs[1] - 1.0) > 0.01
    assert slow.response.noise != pytest.approx(1.0, abs=0.01)
    assert (ranges[0] / ranges[1]) ** 2 == pytest.approx(snrs[0] / snrs[1], rel=1e-3)


def test_a_black_target_is_not_detected_even_without_noise():
    """A comparator's level of zero is reached by nothing at all; an echo is not nothing."""
    quiet = sensor_with(
        "table1-sipm", detector__statistics="published", detector__dark_count_rate_hz=0.0, detector__cell_floor=0
    )
    assert plane.maximum_range_m(quiet, Target(reflectivity=0.0, illuminance_klux=0.0)) == (
        0.0,
        RangeStatus.NEVER_DETECTED,
    )


def test_two_lenses_see_nothing_right_before_them_and_have_a_range():
    limit, status = plane.maximum_range_m(load_sensor("biaxial-905"), Target())
    assert status == RangeStatus.FOUND
    assert limit > 20.0


def test_the_closed_form_takes_a_share_of_the_aperture_for_a_smaller_one():
    half = sensor_with("table1-apd", optics__aperture_radius_mm=12.5)
    assert plane.closed_form_range_m(APD, Target(aperture_share=0.25)) == pytest.approx(
        plane.closed_form_range_m(half, Target())
    )


def test_what_is_reported_ends_with_the_window():
    """Computed by hand: 1 us is 149.896 m; behind a blanking of 3 us nothing is left of 350 m. Two roads: boards on
    both sides of the end, of which the comparator takes the nearer one alone.
    """
    near = sensor_with("table1-apd", tdc__window_us=1, tdc__walk="raw", tdc__lsb_ps=0, tdc__jitter_ps=0)
    end_m = 0.5 * SPEED_OF_LIGHT_M_S * 1e-6
    assert plane.reported_range_m(near, Target(), 0.9) == (pytest.approx(end_m, rel=1e-12), RangeStatus.WINDOW)
    assert plane.maximum_range_m(near, Target())[0] == pytest.approx(350.605, abs=1e-3)
    boards_m = np.array([end_m - 2.0, end_m + 4.0])  # an edge crosses up to 1.5 m before its peak
    light = plane.echoes_of_plane(near, Target(), boards_m)
    detection = detect(light, near, seed=0)
    assert list(detection.outcome) == [Outcome.KEPT, Outcome.OUT_OF_WINDOW]
    blind = sensor_with("table1-apd", tdc__blanking_ns=3000)
    assert plane.reported_range_m(blind, Target(), 0.9) == (0.0, RangeStatus.NEVER_DETECTED)
    sun = Target(illuminance_klux=np.array([0.0, 1.0, 100.0, 1e4]))
    limit, status = plane.reported_range_m(APD, sun, 0.9)
    assert [RangeStatus(int(code)) for code in status] == [RangeStatus.WINDOW] * 2 + [RangeStatus.FOUND] * 2
    np.testing.assert_array_equal(limit[2:], plane.detection_range_m(APD, sun, 0.9)[0][2:])


@pytest.mark.parametrize("name", ["table1-apd", "sipm-905", "os1-128", "biaxial-905"])
@pytest.mark.parametrize("probability", [0.5, 0.9, 0.99])
def test_the_range_has_the_probability_that_was_asked_for(name, probability):
    """P_d there, and nowhere farther; several conditions at once are those one by one."""
    sensor, klux = load_sensor(name), np.array([1.0, 30.0, 100.0])
    limits, statuses = plane.detection_range_m(sensor, Target(illuminance_klux=klux), probability)
    assert (statuses == RangeStatus.FOUND).all()
    for limit, light in zip(limits, klux, strict=True):
        target = Target(illuminance_klux=float(light))
        assert plane.detection_probability(sensor, target, limit)[0] == pytest.approx(probability, abs=1e-8)
        farther = np.geomspace(1.0001 * limit, 1e6, 300)
        assert (plane.detection_probability(sensor, target, farther) < probability).all()
        assert plane.detection_range_m(sensor, target, probability)[0] == pytest.approx(limit, rel=1e-11)


@pytest.mark.parametrize(
    ("name", "falls"), [("table1-sipm", True), ("sipm-905", True), ("rs-e1", False), ("table1-apd", False)]
)
def test_a_sensor_that_the_sun_on_white_blinds_is_named_first(name: str, falls: bool) -> None:
    """The first line says so where the white plane has a lower P_d than the dark one at the range of that."""
    sensor = load_sensor(name)
    report = range_report([(name, sensor)], Conditions())
    sentence = f"{name} sees white planes less far than dark ones under 100 klux"
    assert str(report).startswith(sentence) == falls
    dark_m, _ = plane.detection_range_m(sensor, plane.Target(reflectivity=0.1), 0.9)
    seen = [
        float(plane.detection_probability(sensor, plane.Target(reflectivity=r), float(dark_m))[0]) for r in (0.1, 0.8)
    ]
    assert (seen[1] < seen[0]) == falls
