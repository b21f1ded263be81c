"""Pulses through an amplifier: the chain's waveform against the sampled light behind the filter, by FFT."""

import math

import numpy as np
import pytest
from helpers.trains import BACKGROUND_W, detect, power_at_snr, sensor, train

from lidarscene.light.air_light import air_light
from lidarscene.light.waveform import sample_power_and_signal, waveform
from lidarscene.physics.amplifier import high_pass
from lidarscene.physics.optics import radiometry
from lidarscene.scene.weather import Weather

STEP_S, SAMPLES = 50e-12, 1 << 18  # 13 us: an undershoot of 100 kHz has recovered
TIME_S = STEP_S * np.arange(SAMPLES)


def filter_light(power_w, *, gaussian_hz=None, coupling_hz=None):
    """Sampled light behind the filters."""
    frequency = np.fft.rfftfreq(SAMPLES, STEP_S)
    passes = np.ones_like(frequency) + 0j
    if gaussian_hz is not None:
        passes *= 2.0 ** (-0.5 * (frequency / gaussian_hz) ** 2)
    if coupling_hz is not None:
        passes *= 1j * frequency / (coupling_hz + 1j * frequency)
    return np.fft.irfft(np.fft.rfft(power_w) * passes, SAMPLES)


@pytest.mark.parametrize(("coupling_khz", "good_to"), [(None, 1e-9), (100.0, 1e-4), (1000.0, 1e-3)])
def test_waveform_is_the_filtered_light(coupling_khz, good_to):
    """Four echoes behind a Gaussian filter of 40 MHz, and AC coupling; in shares of the highest peak.

    Without coupling the forms are exact. With it a pulse's places shift by w to first order, and 1 MHz is w = 0.03.
    """
    coupled = [] if coupling_khz is None else [f"receiver.ac_coupling_khz={coupling_khz}"]
    filtered = ["receiver.response='gaussian'", "receiver.bandwidth_mhz=40", *coupled]
    equipped = sensor("table1-apd", *filtered)
    light = train(np.array([[30.0, 31.0, 36.0, 80.0]]), np.array([[1e-6, 6e-7, 2e-7, 3e-8]]))
    (optical,), (signal,) = sample_power_and_signal(light, sensor("table1-apd"), TIME_S)
    expected = filter_light(signal, gaussian_hz=40e6, coupling_hz=None if coupling_khz is None else 1e3 * coupling_khz)
    (power,), (sampled,) = sample_power_and_signal(light, equipped, TIME_S)
    np.testing.assert_array_equal(power, optical)
    # AC coupling lets pulses peak early by w sigma_p, which the sensor is calibrated for.
    late_s = 0.0
    if coupling_khz is not None:
        late_s = float(equipped.coupling_rate * equipped.received_fwhm_s) / math.sqrt(8.0 * math.log(2.0))
    sampled = np.interp(TIME_S, TIME_S - late_s, sampled)
    assert np.abs(sampled - expected).max() < good_to * expected.max()
    # The comparator's waveform is the same signal, at any place.
    wave = waveform(light, equipped)
    place = np.linspace(-3.0, 150.0, 300)
    signal_at_places = equipped.working_point(light.background_power_w).response.signal(
        np.array([float(wave.at(np.array([instant]))[0][0]) for instant in place])
    )
    at_s = radiometry.time_of_flight_s(range_m=wave.origin_m + place * wave.unit_m)
    np.testing.assert_allclose(
        signal_at_places, np.interp(at_s, TIME_S + late_s, sampled), atol=max(good_to, 2e-4) * expected.max()
    )


def weak_behind_strong(*overrides, snr=2000.0):
    """Share of pulses in which an echo of SNR 15 is found 20 m behind a strong one."""
    equipped = sensor("table1-apd", "tdc.stops=2", "tdc.threshold_to_noise=6", *overrides)
    plain = sensor("table1-apd")
    power = np.array([[power_at_snr(plain, snr), power_at_snr(plain, 15.0)]])
    detection = detect(train(np.tile([[40.0, 60.0]], (400, 1)), np.tile(power, (400, 1))), equipped)
    far = [stop.reported & (np.abs(stop.range_m - 60.0) < 1.0) for stop in detection.stops]
    return np.mean(far[0] | far[1])


def test_a_weak_echo_behind_a_strong_one_is_lost():
    """2000 of noise leave an undershoot of 2000 x 0.02 = 40 at 500 kHz, of which 26 are left after 20 m.

    An amplifier that clips at 100 of noise couples no more than those. 400 pulses: P_d is 1 or 0 to 1e-9.
    """
    assert weak_behind_strong() == 1.0
    assert weak_behind_strong("receiver.ac_coupling_khz=500") == 0.0
    assert weak_behind_strong("receiver.ac_coupling_khz=20") == 1.0
    point = sensor("table1-apd").working_point(np.array([BACKGROUND_W]))
    clips = f"detector.saturation_ua={1e8 * float(point.noise.deviation[0])!r}"
    assert weak_behind_strong("receiver.ac_coupling_khz=500", clips) == 1.0


def test_undershoot_of_cells_is_that_of_the_cells_that_fired():
    """A SiPM in blinding light fires all of its cells, not all of the light."""
    equipped = sensor("table1-sipm", "receiver.ac_coupling_khz=500")
    light = train(np.array([[40.0]]), np.array([[1e-2]]))
    _, (signal,) = sample_power_and_signal(light, equipped, TIME_S)
    point = equipped.working_point(light.background_power_w)
    deepest = float(np.sqrt(2.0 * np.pi) * equipped.coupling_rate) * point.response.largest[0]
    # The light outshines the cells for some widths, in which the baseline begins to recover: 3 %.
    assert -signal.min() == pytest.approx(deepest, rel=0.05)


def test_one_echo_behind_coupling_is_where_it_was():
    """The search over the waveform, against the lone pulse without noise: peak and place to first order in w."""
    quiet = ["tdc.threshold_to_noise=50", "tdc.walk='none'"]
    coupled = sensor("table1-apd", *quiet, "receiver.ac_coupling_khz=200")
    power = np.full((200, 1), power_at_snr(coupled, 5000.0))
    stop = detect(train(np.full((200, 1), 50.0), power), coupled).stops[0]
    plain = detect(train(np.full((200, 1), 50.0), power), sensor("table1-apd", *quiet)).stops[0]
    assert stop.range_m.mean() == pytest.approx(plain.range_m.mean(), abs=2e-3)
    assert (stop.snr / plain.snr).mean() == pytest.approx(float(coupled.peak_share), rel=1e-4)


def test_fog_behind_the_filters():
    """The course of the air's light, against that of the plain sensor through the same filters.

    In units of a pulse's peak: the course over the share that is left of a pulse. 1 %: linear tables of 1/16 pulse.
    """
    fog = Weather(fog_visibility_m=60.0)
    plain = sensor("table1-apd", "tdc.window_us=1")
    filtered = sensor(
        "table1-apd",
        "tdc.window_us=1",
        "receiver.response='gaussian'",
        "receiver.bandwidth_mhz=40",
        "receiver.ac_coupling_khz=1000",
    )
    courses = []
    for equipped in (plain, filtered):
        air = air_light(fog, equipped, extinction_per_m=0.05)
        range_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=TIME_S)
        courses.append(np.interp(range_m, np.linspace(air.near_m, air.far_m, len(air.shape.values)), air.shape.values))
        courses[-1][range_m > air.far_m] = 0.0
    expected = filter_light(courses[0], gaussian_hz=40e6, coupling_hz=1e6) / float(filtered.peak_share)
    near = (TIME_S > 20e-9) & (TIME_S < 0.9e-6)
    assert np.abs(courses[1] - expected)[near].max() < 0.01 * expected.max()
    assert courses[1].min() < -0.02 * courses[1].max()
    assert filtered.coupling_rate < high_pass.WIDEST_RATE
