"""Reflectivity from the strength of echoes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.twins import room_sweep

from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.studies import recorded
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import Target
from lidarscene.studies.twin.apparent_reflectivity import ReflectivityGauge, is_explained, scattering_law, withheld_mask
from lidarscene.studies.twin.tuning import LEAST_REFLECTIVITY


def test_the_law_is_that_of_rough_matt_surfaces() -> None:
    """(T7a) straight back: rho (cos + K sin^2), with K of 45 degrees by Oren's and Nayar's formula."""
    square = (math.pi / 4.0) ** 2
    strength = 0.45 * square / (square + 0.09) / (1.0 - 0.5 * square / (square + 0.33))
    cos = np.array([1.0, 0.5, 0.1])
    assert scattering_law(cos) == pytest.approx(cos + strength * (1.0 - cos**2))


def test_a_near_field_is_taken_out() -> None:
    """Signals fall with a near field; the maker's reflectivities, in whole per cent, know of none."""
    plain = room_sweep()
    near = 1.0 / (1.0 + (9.0 / plain.range_m) ** 4)
    bright = 2.0 * plain.reflectivity
    sweep = room_sweep(signal=2.0 * plain.signal * near, reflectivity=np.rint(bright))
    gauge = ReflectivityGauge.from_sweep(sweep)
    assert gauge is not None
    assert gauge.field == "signal"
    apparent = gauge.apparent(sweep, sweep.range_m)
    error = apparent / (bright / 100.0) - 1.0
    # A quarter of an octave is interpolated, and steps of 1 % stand on 4 and more.
    assert np.median(np.abs(error)) < 0.03
    assert np.quantile(np.abs(error), 0.95) < 0.1


def test_brighter_than_white_comes_from_the_signal() -> None:
    """An Ouster's reflectivity above 100 is logarithmic."""
    plain = room_sweep()
    signal, reflectivity = np.array(plain.signal), np.array(plain.reflectivity)
    truth = float(reflectivity[10, 10]) * 50.0 / 100.0
    signal[10, 10] *= 50.0
    reflectivity[10, 10] = 200.0
    sweep = room_sweep(signal=signal, reflectivity=reflectivity)
    gauge = ReflectivityGauge.from_sweep(sweep)
    assert gauge is not None
    assert gauge.apparent(sweep, sweep.range_m)[10, 10] == pytest.approx(truth, rel=0.1)


@pytest.mark.parametrize(
    ("form", "assumed", "factor"),
    [("velodyne pcap", False, 0.01), ("pandar db3", False, 0.01), ("hesai pcap", False, 0.01), ("kitti", True, None)],
)
def test_intensities_are_of_a_known_unit_or_said_to_be_guessed(form: str, assumed: bool, factor: float | None) -> None:
    plain = room_sweep()
    sweep = room_sweep(signal=None, reflectivity=None, intensity=plain.reflectivity, metadata={"format": form})
    gauge = ReflectivityGauge.from_sweep(sweep)
    assert gauge is not None
    assert gauge.assumed == assumed
    apparent = gauge.apparent(sweep, sweep.range_m)
    if factor is None:
        assert np.median(apparent) == pytest.approx(0.2)
    else:
        assert apparent == pytest.approx(factor * np.asarray(plain.reflectivity))


@pytest.mark.parametrize(
    ("counts", "white_value", "median"),
    [([10.0, 40.0, 50.0], 200.0, 0.2), ([0.1, 0.4, 0.5], None, 0.2), ([10.0, 60.0, 70.0], 254.0, 60.0 / 254.0)],
)
def test_whole_numbers_of_a_sensor_have_a_white_value(
    counts: list[float], white_value: float | None, median: float
) -> None:
    """A median of 40 is 0.2 of 200, so that the sensor sends the recorded whole numbers again. One byte tells 254 from
    all that is brighter.
    """
    numbers = np.resize(counts, room_sweep().shape)
    sweep = room_sweep(signal=None, reflectivity=None, intensity=numbers, metadata={"format": "pcd"})
    gauge = ReflectivityGauge.from_sweep(sweep, load_sensor("pandar64"))
    assert gauge is not None
    assert gauge.white_value == white_value
    assert np.median(gauge.apparent(sweep, sweep.range_m)) == pytest.approx(median)


def test_a_return_that_reads_0_was_detected() -> None:
    """Half of the least step would be too dark far off for the sensor that saw it; near by it stays.

    Rationale: lost pulses read 0, too, and the twin of a PandarXT with two returns was a traceback.
    """
    sensor = load_sensor("hdl-64e")
    intensity = np.resize([0.4, 0.0, 0.4, 0.4, 0.01], room_sweep().shape)
    sweep = room_sweep(signal=None, reflectivity=None, intensity=intensity, metadata={"format": "kitti"})
    gauge = ReflectivityGauge.from_sweep(sweep, sensor)
    assert gauge is not None
    near, far = (gauge.apparent(sweep, np.full(sweep.shape, range_m)) for range_m in (1.0, 60.0))
    zero = intensity == 0.0
    assert near[~zero] == pytest.approx(far[~zero])
    assert far[zero].min() > near[zero].max()
    target = Target(reflectivity=far[zero][0], illuminance_klux=20.0, transmittance=1.0)
    assert plane.detection_margin(sensor, target, 60.0) == pytest.approx(1.25, rel=0.03)  # its own light adds noise
    assert np.isfinite(gauge.apparent(sweep, np.full(sweep.shape, np.nan))).all()


def test_a_table_is_continued() -> None:
    """The table goes on before its first bin as between the first two, beyond the last as the square of the range."""
    gauge = ReflectivityGauge(field="signal", range_m=np.array([5.0, 10.0]), per_count=np.array([1e-3, 2e-3]))
    sweep = room_sweep(signal=np.full((24, 360), 100.0))
    reflectivities = [float(gauge.apparent(sweep, np.full(sweep.shape, range_m))[0, 0]) for range_m in (2.5, 5.0, 20.0)]
    assert reflectivities == pytest.approx([0.05, 0.1, 0.8])


@pytest.mark.parametrize("scale", [0.5, 1.0, 3.2])
def test_a_sensor_sees_the_recorded_signals_again(scale: float) -> None:
    """Whatever the unit's firmware counts as a photon: reflectivity times the sensor's photons of a white target is
    SIGNAL, near field included. The recorded reflectivities say how the scales differ. By `studies.recorded`, which
    scales another target; between two of 200 ranges the law is a straight line.
    """
    sensor = load_sensor("os0-128-rev7")
    plain = room_sweep()
    # That one is in the air of the published ranges, 0.98 one way, and twins have clear air.
    white = recorded.white_m2(sensor, plain.range_m.ravel()).reshape(plain.shape) / (0.98 * plain.range_m) ** 2
    dim = scale * 0.3 * white
    point = sensor.working_point(np.zeros(1))
    signal = np.asarray(point.response.signal(dim * point.response.power_w(np.ones(1))))
    sweep = room_sweep(signal=signal, reflectivity=np.full(plain.shape, 30.0))
    gauge = ReflectivityGauge.from_sweep(sweep, sensor)
    assert gauge is not None
    assert gauge.by_sensor
    assert gauge.over_recorded == pytest.approx(scale, rel=0.07)
    # SPADs that have fired count up to 7 % too few of the brightest returns.
    np.testing.assert_allclose(gauge.apparent(sweep, sweep.range_m) * white, dim, rtol=0.05)


def test_points_without_company_have_no_part_in_the_table() -> None:
    """A third of the pulses, each alone at its range, have REFLECTIVITY of half as much more."""
    plain = room_sweep()
    columns = np.broadcast_to(np.arange(plain.shape[1]), plain.shape)
    alone = columns % 3 == 0
    range_m = np.where(alone, 16.0, 4.0)
    sweep = room_sweep(range_m=range_m, signal=0.3e5 / range_m**2, reflectivity=np.where(alone, 45.0, 30.0))
    gauge = ReflectivityGauge.from_sweep(sweep)
    assert gauge is not None
    assert gauge.range_m.max() < 8.0
    np.testing.assert_allclose(gauge.apparent(sweep, range_m)[~alone], 0.3, rtol=0.01)


@pytest.mark.parametrize("name", ["os0-128-rev7", "os2-128"])
def test_signals_without_reflectivities_are_the_sensors_own_photons(name: str) -> None:
    """Photons of 0.3 at 1 to 60 m, near field included; between two of 200 ranges the law is a straight line."""
    sensor = load_sensor(name)
    plain = room_sweep()
    range_m = np.geomspace(1.0, 60.0, plain.range_m.size).reshape(plain.shape)
    photons = 0.3 * recorded.white_m2(sensor, range_m.ravel()).reshape(plain.shape) / (0.98 * range_m) ** 2
    sweep = room_sweep(range_m=range_m, signal=photons, reflectivity=None)
    gauge = ReflectivityGauge.from_sweep(sweep, sensor)
    assert gauge is not None
    assert (gauge.field, gauge.by_sensor, gauge.assumed) == ("signal", True, False)
    np.testing.assert_allclose(gauge.apparent(sweep, range_m), 0.3, rtol=0.05)
    assert ReflectivityGauge.from_sweep(sweep) is None


def test_without_strengths_there_is_no_gauge() -> None:
    assert ReflectivityGauge.from_sweep(room_sweep(signal=None, reflectivity=None)) is None


def test_an_echo_without_a_range_was_dropped() -> None:
    plain = room_sweep()
    range_m, reflectivity = np.array(plain.range_m), np.array(plain.reflectivity)
    range_m[3, :2] = np.nan
    reflectivity[3, 1] = 0.0
    withheld = withheld_mask(room_sweep(range_m=range_m, reflectivity=reflectivity))
    assert np.argwhere(withheld).tolist() == [[3, 0]]


@pytest.mark.parametrize("reported", [200.0, 2.0])
def test_reflectivities_that_are_not_linear_do_not_calibrate(reported: float) -> None:
    """Two of three pixels report a logarithm above white, or a step of one or two counts; the third is calibrated."""
    shape = room_sweep().shape
    third = np.broadcast_to(np.arange(shape[1]) % 3 == 0, shape)
    signal = np.full(shape, 500.0)
    reflectivity = np.where(third, 50.0, reported)
    sweep = room_sweep(range_m=np.full(shape, 10.0), signal=signal, reflectivity=reflectivity)
    gauge = ReflectivityGauge.from_sweep(sweep)
    assert gauge is not None
    np.testing.assert_allclose(gauge.apparent(sweep, sweep.range_m), 0.5, rtol=1e-6)


def test_a_steep_table_is_continued_by_the_fourth_power_and_nothing_is_blacker_than_black() -> None:
    gauge = ReflectivityGauge(field="signal", range_m=np.array([5.0, 6.0]), per_count=np.array([1e-3, 1.0]))
    sweep = room_sweep(signal=np.full((24, 360), 1600.0))
    apparent = gauge.apparent(sweep, np.full(sweep.shape, 2.5))
    np.testing.assert_allclose(apparent, 1.6 / 16.0)
    for signal in (0.0, np.nan):
        dark = room_sweep(signal=np.full((24, 360), signal))
        np.testing.assert_allclose(gauge.apparent(dark, np.full(dark.shape, 5.0)), LEAST_REFLECTIVITY)


def test_a_makers_reflectivity_alone_is_in_per_cent() -> None:
    sweep = room_sweep(signal=None)
    gauge = ReflectivityGauge.from_sweep(sweep)
    assert gauge is not None
    assert sweep.reflectivity is not None
    np.testing.assert_allclose(gauge.apparent(sweep, sweep.range_m), 0.01 * sweep.reflectivity, rtol=1e-6)


def test_a_loss_is_explained_up_to_two_sigma_above_the_threshold() -> None:
    """(T208) by hand: of os0-128 U = 0.202 (900 + 54 x 5.2)^0.5 = 6.93 photons, and e^(2 (0.253^2 + 1/U)^0.5) 2.50."""
    sensor = load_sensor("os0-128", overrides=["scanner.columns_per_turn=1024"])
    shape = (24, 360)
    signal = np.full(shape, 17.0)
    signal[:, 1:3] = 17.8
    range_m = room_sweep().range_m.copy()
    range_m[:, :2] = np.nan
    sweep = room_sweep(range_m=range_m, signal=signal, near_ir=np.full(shape, 900.0))
    explained = is_explained(sweep, sensor)
    assert not explained[:, 1].any()
    assert explained[:, [0, *range(2, 360)]].all()
    assert is_explained(replace(sweep, near_ir=None), sensor).all()
    assert is_explained(sweep, load_sensor("vlp-16")).all()


def test_returns_whose_intensity_is_rounded_to_zero_are_of_half_a_step() -> None:
    """Rationale: of KITTI's returns beyond 50 m 76 % have intensity 0.00. As black they were lost in its twin."""
    plain = room_sweep()
    intensity = np.full(plain.shape, 0.3)
    intensity[3, 5], intensity[3, 6], intensity[3, 7] = 0.0, 0.01, np.nan
    sweep = room_sweep(signal=None, reflectivity=None, intensity=intensity)
    gauge = ReflectivityGauge.from_sweep(sweep)
    assert gauge is not None
    dark, least, unknown = gauge.apparent(sweep, sweep.range_m)[3, 5:8]
    assert (dark, least) == (pytest.approx(0.2 * 0.005 / 0.3), pytest.approx(0.2 * 0.01 / 0.3))
    assert unknown == LEAST_REFLECTIVITY
