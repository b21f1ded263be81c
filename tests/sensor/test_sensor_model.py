"""The receiver's frequency response on a sensor: noise and peaks, the matched bandwidth, keys of the file."""

import dataclasses
import math
import pickle

import numpy as np
import pytest
from helpers.run_seed import chosen, run_seed
from scipy.optimize import minimize_scalar

from lidarscene import Outcome, load_sensor
from lidarscene.detection.receiver import detect
from lidarscene.errors import OptionWarning
from lidarscene.physics.amplifier import high_pass
from lidarscene.physics.electronics import sampling
from lidarscene.sensor.sensor_model import MATCHED_WIDTHS, warn_of_doubts
from lidarscene.studies.ranging import plane, sensitivities
from lidarscene.studies.ranging.plane import Target

BACKGROUND_W = 2.5e-8
KINDS = ["gaussian", "single_pole"]
ADC = ["sampler.type='adc'", "sampler.bits=12", "sampler.full_scale=1"]


def sensor(kind, *overrides, name="table1-apd", bandwidth_mhz=None):
    width = [] if bandwidth_mhz is None else [f"receiver.bandwidth_mhz={bandwidth_mhz!r}"]
    return load_sensor(name, overrides=[f"receiver.response='{kind}'", *width, *overrides])


def range_m(kind, bandwidth_mhz, *overrides):
    return plane.maximum_range_m(sensor(kind, *overrides, bandwidth_mhz=bandwidth_mhz), Target())[0]


# --- bandwidth --------------------------------------------------------------------------------------


def test_without_a_response_narrower_is_farther_without_end():
    """Table 1: the paper's receiver filters the noise alone."""
    ranges_m = [range_m("none", mhz) for mhz in (400.0, 167.0, 50.0, 10.0, 5.0)]
    assert [round(reach_m) for reach_m in ranges_m] == [282, 351, 474, 709, 843]
    assert ranges_m[1] == plane.maximum_range_m(load_sensor("table1-apd"), Target())[0]


@pytest.mark.parametrize(("kind", "best"), [("gaussian", 0.3120), ("single_pole", 0.1812)])
def test_matched_bandwidth_is_best(kind, best):
    """SNR in white noise goes with share / sqrt(f): of a Gaussian filter it is best where filter and pulse are alike.

    A search on R_max, which is flat there: 1 %.
    """
    optimum = minimize_scalar(lambda log: -range_m(kind, math.exp(log)), bounds=(1.0, 6.0), method="bounded")
    assert math.exp(optimum.x) * 1e-3 * 6.0 == pytest.approx(best, rel=0.01)
    assert range_m(kind, best / 6e-3 / 3.0) < range_m(kind, best / 6e-3) > range_m(kind, best / 6e-3 * 3.0)


def test_one_number_is_enough():
    """The low pass of a sensor without `receiver.bandwidth_mhz` has the bandwidth of its noise."""
    paper, filtered = load_sensor("table1-apd"), sensor("gaussian")
    light = np.array([BACKGROUND_W])
    assert filtered.working_point(light).noise.deviation[0] == paper.working_point(light).noise.deviation[0]
    assert filtered.cutoff_hz == pytest.approx(167e6 / 1.0645, rel=1e-4)
    assert sensor("gaussian", bandwidth_mhz=100.0).tdc.bandwidth_hz == pytest.approx(1.0645 * 100e6, rel=1e-4)
    assert sensor("single_pole", bandwidth_mhz=100.0).tdc.bandwidth_hz == pytest.approx(1.5708e8, rel=1e-4)
    assert sensor("none", bandwidth_mhz=100.0).tdc.bandwidth_hz == pytest.approx(1e8)


def test_closed_forms_follow():
    """An upper bound by as much as without a response, for both detectors; 0.002 is the weight of other noise."""
    for name in ("table1-apd", "table1-sipm"):
        shares = []
        for kind in ("none", *KINDS):
            equipped = sensor(kind, name=name, bandwidth_mhz=80.0)
            shares.append(plane.maximum_range_m(equipped, Target())[0] / plane.closed_form_range_m(equipped, Target()))
        assert 0.9 < shares[0] < 1.0
        assert shares[1:] == pytest.approx([shares[0]] * len(KINDS), abs=0.002)


@pytest.mark.parametrize("kind", KINDS)
def test_sensitivity_to_the_bandwidth(kind):
    """`tdc.bandwidth_hz` is pulse and noise in one number; central differences over the key of the file."""
    lidar = sensor(kind, bandwidth_mhz=90.0)
    table = sensitivities.sensitivities(lidar, Target(), probability=0.5, method="differences")
    elasticity = {row.parameter: row.range_elasticity for row in table.rows}["tdc.bandwidth_hz"]
    expected = math.log(range_m(kind, 90.0 * 1.001) / range_m(kind, 90.0 / 1.001)) / (2.0 * math.log(1.001))
    assert elasticity == pytest.approx(expected, rel=1e-3)


# --- noise and peaks --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_noise_of_cells_by_random_cells(kind):
    """Cells that fire at random are rectangles of the dead time; filtered, they vary as the sensor says: 3 %.

    Few of them, as in weak light: where most are busy, one cell's rectangles are not independent.
    """
    equipped = sensor(kind, name="table1-sipm", bandwidth_mhz=50.0)
    plain = load_sensor("table1-sipm")
    light = np.array([1e-10])
    share = (equipped.working_point(light).noise.deviation / plain.working_point(light).noise.deviation)[0]
    step_s, count = 0.25e-9, 1 << 18
    fired = np.random.default_rng(2).poisson(0.02, count)
    busy = np.convolve(fired, np.ones(24))[:count]  # 6 ns
    ratio = np.fft.rfftfreq(count, step_s) / 50e6
    passes = 2.0 ** (-0.5 * ratio**2) if kind == "gaussian" else 1.0 / (1.0 + 1j * ratio)
    filtered = np.fft.irfft(np.fft.rfft(busy) * passes, count)
    assert share == pytest.approx(filtered.std() / busy.std(), rel=0.03)


@pytest.mark.parametrize("name", ["table1-apd", "table1-sipm"])
@pytest.mark.parametrize("kind", KINDS)
def test_signal_and_power_are_inverse(kind, name):
    point = sensor(kind, "receiver.ac_coupling_khz=200", name=name).working_point(np.array([BACKGROUND_W]))
    power = np.geomspace(1e-9, 1e-7, 20)
    np.testing.assert_allclose(point.response.power_w(point.response.signal(power)), power, rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_peak_of_a_sipm_is_lowered_behind_the_cells(kind):
    """The peak is lower in any light: what is filtered is the number of cells, which saturates before."""
    filtered, plain = sensor(kind, name="table1-sipm"), load_sensor("table1-sipm")
    background = np.array([BACKGROUND_W])
    for power in (1e-9, 1e-7, 1e-3):
        share = filtered.working_point(background).response.signal(power) / plain.working_point(
            background
        ).response.signal(power)
        assert share[0] == pytest.approx(float(filtered.low_pass_share), rel=1e-12)


# --- the file ---------------------------------------------------------------------------------------


def test_samples_cover_the_received_pulse():
    """Four widths, of the wider pulse."""
    adc = ("sampler.type='adc'", "sampler.rate_mhz=1000", "sampler.bits=10", "sampler.full_scale=1e-3")
    plain, wide = (sensor(kind, *adc, bandwidth_mhz=30.0) for kind in ("none", "gaussian"))
    assert plain.sampler.samples == 25
    assert wide.sampler.samples == math.ceil(24.0 / float(wide.low_pass_share) - 1e-9) + 1


def test_a_slow_amplifier_is_told():
    """The amplifier is told in one line, for each response; 0.35 / 6 ns is 58.3 MHz."""
    assert sensor("none", bandwidth_mhz=58.4).doubts == ()
    slow = sensor("none", bandwidth_mhz=50.0)
    with pytest.warns(OptionWarning) as noted:
        warn_of_doubts([slow, slow, sensor("gaussian", bandwidth_mhz=50.0), load_sensor("table1-apd")])
    assert [str(warning.message).partition("; ")[2] for warning in noted] == [
        'receiver.response = "none" lets the pulse pass whole, so ranges come out too long',
        "it leaves 69 % of the peak",
    ]
    assert str(noted[0].message).startswith(
        "'table1-apd': a bandwidth of 50 MHz is slow for a pulse of 6 ns, which needs 58.3; "
    )


def test_a_filter_with_more_noise_than_raw_samples_is_told():
    """2 pi 110 MHz 4 ns / 2.355 is 1.174; at 1.75 the variance (T78) is that before the filter."""
    assert float(sampling.matched_noise_share(x=MATCHED_WIDTHS)) == pytest.approx(1.0, abs=2e-3)
    (doubt,) = load_sensor("vlp-16", overrides=["tdc.bandwidth_mhz=110"]).doubts
    assert doubt == (
        "'vlp-16': the matched filter of a pulse of 4 ns has more noise than raw samples with a bandwidth of 110 MHz: "
        "2 pi B sigma_p is 1.17, and must be 1.75 (164 MHz) or more"
    )
    assert load_sensor("vlp-16", overrides=["tdc.bandwidth_mhz=164"]).doubts == ()
    # One line says that a receiver is too slow, whatever comes behind it.
    (slow,) = load_sensor("vlp-16", overrides=["tdc.bandwidth_mhz=50"]).doubts
    assert "is slow for a pulse" in slow


@pytest.mark.parametrize(
    ("counts", "off", "told"),
    chosen(1, [(1.3, (0.16, 0.25), True), (1.6, (0.02, 0.1), True), (2.0, (0.0, 0.06), False)]),
)
def test_whole_counts_at_a_low_threshold_are_told(counts: float, off: tuple[float, float], told: bool) -> None:
    """SPADs in pairs at the range of P_d 0.3, in the dark: the share found is off by as much as is said."""
    overrides = ["detector.spads=16", "detector.coincidence=2", "histogram.shots=9", "histogram.threshold_slope=0"]
    sensor = load_sensor("rs-e1", overrides=[*overrides, f"histogram.threshold_floor={counts}"])
    assert [f"{counts:g} counts" in doubt for doubt in sensor.doubts] == [True] * told
    target, pulse = Target(illuminance_klux=0.0), np.arange(8000, dtype=np.uint32)
    # Over a bin, so that echoes lie anywhere in it.
    ranges = plane.detection_range_m(sensor, target, 0.3)[0] + np.linspace(-0.075, 0.075, len(pulse))
    found = detect(plane.echoes_of_plane(sensor, target, ranges), sensor, seed=run_seed(), pulse=pulse)
    share = np.mean(found.outcome != Outcome.BELOW_THRESHOLD)
    assert off[0] <= abs(share - 0.3) <= off[1]


def test_coupling_alone_lowers_the_peak():
    filtered = sensor("none", "receiver.ac_coupling_khz=1000")
    rate = 2.0 * math.pi * 1e6 * 6e-9 / math.sqrt(8.0 * math.log(2.0))
    assert filtered.peak_share == high_pass.peak_share(rate=filtered.coupling_rate)
    assert filtered.peak_share == pytest.approx(1.0 - math.sqrt(0.5 * math.pi) * rate, abs=2.0 * rate**2)
    assert dataclasses.replace(filtered, receiver=load_sensor("table1-apd").receiver).peak_share == 1.0


# --- what follows from the parts --------------------------------------------------------------------


def test_bandwidths_of_white_noise():
    """The least of the amplifier's, half of an ADC's rate and half over the dead time of cells."""
    assert load_sensor("table1-apd", overrides=["tdc.bandwidth_mhz=90"]).noise_bandwidth_hz == 90e6
    slow = load_sensor("table1-apd", overrides=["tdc.bandwidth_mhz=900", *ADC, "sampler.rate_mhz=400"])
    assert slow.noise_bandwidth_hz == 200e6
    cells = load_sensor("table1-sipm", overrides=["tdc.bandwidth_mhz=900", "detector.dead_time_ns=20"])
    assert cells.noise_bandwidth_hz == pytest.approx(25e6)


@pytest.mark.parametrize(
    ("kind", "filtering", "band_hz"),
    [
        ("none", ["tdc.timing='matched_filter'"], 80e6),
        ("gaussian", ["tdc.timing='matched_filter'"], 80e6),
        ("single_pole", ["tdc.timing='matched_filter'"], 80e6),
        ("none", [*ADC, "sampler.rate_mhz=170"], 80e6),
        ("none", [*ADC, "sampler.rate_mhz=170", "tdc.bandwidth_mhz=500"], 85e6),
    ],
)
def test_crossings_behind_a_matched_filter_by_the_spectrum(kind, filtering, band_hz):
    """Rice's f_rms of the filtered noise, from sums over exp(-(2 pi f sigma)^2) up to B, sigma the received pulse's; of
    samples up to half of their rate.
    """
    equipped = sensor(kind, "tdc.false_alarms='crossings'", "tdc.bandwidth_mhz=80", *filtering)
    sigma_s = float(equipped.received_fwhm_s) / math.sqrt(8.0 * math.log(2.0))
    assert (sigma_s > 1.03 * 6e-9 / math.sqrt(8.0 * math.log(2.0))) == (kind != "none")
    frequency = (np.arange(20_000) + 0.5) / 20_000 * band_hz
    spectrum = np.exp(-((2.0 * math.pi * frequency * sigma_s) ** 2))
    rms_hz = math.sqrt((frequency**2 * spectrum).sum() / spectrum.sum())
    point = equipped.working_point(np.array([BACKGROUND_W]))
    rate_hz = equipped.false_alarm_rate_hz(point, 5.0 * point.noise.deviation)[0]
    assert rate_hz == pytest.approx(rms_hz * math.exp(-12.5), rel=1e-5)
    # A lone pulse keeps its height, noise that share of its variance.
    ratio = float((point.noise.deviation / point.unfiltered.noise.deviation)[0]) ** 2
    assert ratio == pytest.approx(2.0 * spectrum.mean(), rel=1e-5)


@pytest.mark.parametrize("tail", ["mcintyre", "gaussian"])
def test_a_gaussian_filter_crosses_more_often_than_an_ideal_one(tail):
    """The rate is sqrt(6 / pi) times as high at the same noise (`physics.electronics.tdc.rice_rate_hz`), whatever the
    tail of its heights.
    """
    rates = []
    for kind in ("none", "gaussian"):
        equipped = sensor(kind, "tdc.false_alarms='crossings'", f"detector.tail='{tail}'")
        point = equipped.working_point(np.array([BACKGROUND_W]))
        rates.append(float(equipped.false_alarm_rate_hz(point, 5.0 * point.noise.deviation)[0]))
    assert rates[1] / rates[0] == pytest.approx(math.sqrt(6.0 / math.pi), rel=1e-6)


def test_noise_of_a_gaussian_filter_after_a_time():
    """Its response with itself: exp(-(t / 2 sigma_h)^2), of the spectrum 2^-(nu / f)^2 in sums."""
    equipped = sensor("gaussian", bandwidth_mhz=80.0)
    frequency = np.linspace(0.0, 800e6, 80_001)
    spectrum = 2.0 ** -((frequency / 80e6) ** 2)
    for lag_s in (1e-9, 4e-9):
        expected = (spectrum * np.cos(2.0 * math.pi * frequency * lag_s)).sum() / spectrum.sum()
        assert equipped.noise_correlation(lag_s) == pytest.approx(expected, abs=1e-4)


def test_peak_behind_both_filters_by_small_steps():
    """A low pass and then a high pass, of a pulse sampled finely: to w^2 of the second one's form."""
    equipped = sensor("gaussian", "receiver.ac_coupling_khz=2000", bandwidth_mhz=80.0)
    time_s = np.arange(-60e-9, 60e-9, 2e-11)
    sigma_s = 6e-9 / math.sqrt(8.0 * math.log(2.0))
    wide_s = math.hypot(sigma_s, math.sqrt(math.log(2.0)) / (2.0 * math.pi * 80e6))
    light = sigma_s / wide_s * np.exp(-0.5 * (time_s / wide_s) ** 2)
    decay, slow_part, passed = math.exp(-2.0 * math.pi * 2e6 * 2e-11), 0.0, []
    for sample in light:
        slow_part = decay * slow_part + (1.0 - decay) * sample
        passed.append(sample - slow_part)
    assert equipped.peak_share == pytest.approx(max(passed), rel=2e-3)
    assert equipped.received_fwhm_s == pytest.approx(6e-9 * wide_s / sigma_s, rel=1e-6)


def test_a_round_spot_for_an_elliptical_beam():
    """Half of the mean divergence, and half of the exit."""
    keys = ["laser.divergence_mrad=3", "laser.divergence_elevation_mrad=1", "laser.exit_diameter_mm=8"]
    spot = load_sensor("table1-apd", overrides=keys).laser.spot
    assert (spot.half_divergence_rad, spot.exit_radius_m) == pytest.approx((1e-3, 4e-3))


@pytest.mark.parametrize(
    ("overrides", "peaks", "width"),
    [
        ([], False, False),
        (["tdc.keep='last'"], True, False),
        (["tdc.timing='peak'"], True, False),
        (["tdc.edges='both'"], False, True),
        (["sampler.type='multi_level_tdc'", "sampler.levels=[2]"], True, True),
    ],
)
def test_what_a_receiver_looks_for(overrides, peaks, width):
    """Edges or peaks, and how long a pulse lasts."""
    equipped = load_sensor("table1-apd", overrides=overrides)
    assert (equipped.finds_peaks, equipped.measures_width) == (peaks, width)


def test_in_the_dark_one_cell_is_the_least_level():
    equipped = load_sensor("table1-sipm", overrides=["detector.dark_count_rate_hz=0", "detector.cell_floor=1"])
    point = equipped.working_point(np.array([1e-16]))
    assert 5.0 * point.noise.deviation[0] < 0.5
    assert equipped.threshold(point)[0] == 1.0


def test_a_copy_of_another_process_is_built_anew_from_its_file():
    """A sensor that went through pickle, as to a worker, still knows its file; one with replaced parts has none."""
    sensor = pickle.loads(pickle.dumps(load_sensor("vlp-16", overrides="laser.peak_power_w=50")))
    assert sensor.replace("laser.pulse_fwhm_ns=5").laser.peak_power_w == 50.0
    assert dataclasses.replace(sensor, name="mine").origin is None
