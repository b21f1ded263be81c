"""Detector formulas against slow, obvious simulations and published numbers."""

import math

import numpy as np
import pytest
from scipy.constants import e, k
from scipy.stats import binom

from lidarscene import load_sensor
from lidarscene.physics.electronics import apd, sipm
from lidarscene.physics.optics import air, pulse, radiometry, sunlight
from lidarscene.sensor.detectors import Apd


def test_thermal_noise_of_a_textbook_resistor():
    """sqrt(4 k T B / R) for 1 kohm, 290 K, 1 Hz is 4.0 pA: the number in every electronics book."""
    variance = apd.thermal_variance_a2(temperature_k=290.0, load_resistance_ohm=1000.0, bandwidth_hz=1.0)
    assert np.sqrt(variance) == pytest.approx(4.0e-12, rel=1e-3)


def test_shot_noise_of_counted_electrons():
    """2 e i B is the variance of the current of Poisson electrons averaged over 1 / (2 B)."""
    rng = np.random.default_rng(2)
    bandwidth, current = 167e6, 5e-9
    window = 1.0 / (2.0 * bandwidth)
    counted = rng.poisson(current * window / e, 400_000) * e / window
    variance = apd.light_shot_variance_a2(
        responsivity_a_w=1.0, gain=1.0, excess_noise=1.0, bandwidth_hz=bandwidth, power_w=current
    )
    # The variance of 4e5 Poisson numbers is good to 0.23 %; 4 standard errors.
    assert counted.var() == pytest.approx(variance, rel=0.01)


def test_dark_current_noise():
    variance = apd.dark_shot_variance_a2(
        surface_dark_current_a=1e-10, bulk_dark_current_a=2e-10, gain=10.0, excess_noise=3.0, bandwidth_hz=1e8
    )
    assert variance == pytest.approx(2 * e * 1e8 * (1e-10 + 2e-10 * 300.0), rel=1e-9)


def test_excess_noise_forms():
    """McIntyre: F = M for k = 1, F -> 2 for k = 0; the power law with x = 0.3 is 3.72 at M = 80."""
    assert apd.excess_noise_mcintyre(gain=80.0, ionisation_ratio=1.0) == pytest.approx(80.0)
    assert apd.excess_noise_mcintyre(gain=1e6, ionisation_ratio=0.0) == pytest.approx(2.0, rel=1e-5)
    assert apd.excess_noise_power_law(gain=80.0, index=0.3) == pytest.approx(80.0**0.3, rel=1e-12)


def test_best_gain_is_best():
    """The derived optimum against a search; the text's "optical equals electrical noise" misses it."""
    a_and_b, c, x = 3e-19, 4e-16, 0.3
    gains = np.geomspace(1.0, 1e4, 200_001)
    searched = gains[np.argmax(gains / np.sqrt(a_and_b * gains ** (2 + x) + c))]
    found = apd.best_gain(multiplied_variance_a2=a_and_b, unmultiplied_variance_a2=c, excess_noise_index=x)
    assert found == pytest.approx(searched, rel=1e-4)  # the grid's step
    assert a_and_b * found ** (2 + x) / c == pytest.approx(2.0 / x, rel=1e-9)


def test_gain_from_bias():
    """Miller's formula; the printed one has V_bias / V_bd inside the power at n = 1 only."""
    assert apd.gain_from_bias_miller(bias_v=150.0, breakdown_v=160.0, exponent=1.0) == pytest.approx(16.0)
    assert apd.gain_from_bias(bias_v=150.0, breakdown_v=160.0, exponent=1.0) == pytest.approx(16.0)
    assert apd.gain_from_bias(bias_v=150.0, breakdown_v=160.0, exponent=0.5) == pytest.approx(4.0)


def test_mcintyre_detector_uses_its_ratio():
    plain = load_sensor("table1-apd").detector
    assert isinstance(plain, Apd)
    import dataclasses

    mcintyre = dataclasses.replace(plain, excess_noise_index=None, ionisation_ratio=0.02)
    assert mcintyre.excess_noise == pytest.approx(0.02 * 80 + 0.98 * (2 - 1 / 80))


def test_electrical_noise_floor_of_table_1():
    """Without light: thermal noise of 10 kohm and dark current, typed out."""
    sensor = load_sensor("table1-apd")
    excess = 80.0**0.3
    dark = 2 * e * (1e-10 + 1e-10 * 6400 * excess) * 167e6
    expected = np.sqrt(4 * k * 300.0 * 167e6 / 1e4 + dark)
    assert sensor.working_point(0.0).noise == pytest.approx(expected, rel=1e-9)


def fire(rng, *, photons_per_dead_time, cells, pde, dead_steps, steps):
    """Slow and obvious: cells that each take a Poisson stream and are dead for tau after firing."""
    rate = photons_per_dead_time * pde / cells / dead_steps
    dead_for = np.zeros(cells, dtype=np.int64)
    busy = []
    for step in range(steps):
        dead_for = np.maximum(dead_for - 1, 0)
        fired = (dead_for == 0) & (rng.random(cells) < -np.expm1(-rate))
        dead_for[fired] = dead_steps
        if step > 6 * dead_steps and step % (2 * dead_steps) == 0:
            busy.append(np.count_nonzero(dead_for))
    return np.array(busy)


@pytest.mark.parametrize(("photons", "steps"), [(200.0, 120_000), (686.093, 48_000), (2000.0, 48_000)])
def test_busy_cells_in_steady_state(photons, steps):
    """x / (1 + x) and its binomial variance, against the cell array itself; (23) is far outside.

    The time step is tau / 200, which shortens the dead time by at most half a step: 0.3 % here.
    """
    rng = np.random.default_rng(11)
    busy = fire(rng, photons_per_dead_time=photons, cells=400, pde=0.22, dead_steps=200, steps=steps)
    share = sipm.busy_share_steady_state(
        photons=photons, pde=0.22, cells=400.0, dark_count_rate_hz=0.0, dead_time_s=6e-9
    )
    error = np.sqrt(400 * share * (1 - share) / len(busy))
    assert abs(busy.mean() - 400 * share) < 4.0 * error + 0.004 * 400 * share
    variance = sipm.busy_variance_steady_state(busy_share=share, cells=400.0)
    assert busy.var() == pytest.approx(variance, rel=4.0 * np.sqrt(2.0 / len(busy)))
    published = 400 * sipm.fired_share_published(photons=photons, pde=0.22, cells=400.0)
    assert published - busy.mean() > 4.0 * error


def test_fired_share_of_a_flash():
    """Independent cells under Poisson light fire with 1 - exp(-n pde / N); as printed it is pde / 2N lower."""
    rng = np.random.default_rng(4)
    photons, cells, pde = 300.0, 100, 0.22
    fired = np.mean(rng.poisson(photons * pde / cells, (20_000, cells)) > 0)
    exact = sipm.fired_share(photons=photons, pde=pde, cells=float(cells))
    assert fired == pytest.approx(exact, abs=4.0 * np.sqrt(0.25 / 2e6))
    printed = sipm.fired_share_published(photons=photons, pde=pde, cells=float(cells))
    assert 1.0 - np.log(1.0 - printed) / np.log(1.0 - exact) == pytest.approx(pde / (2 * cells), rel=0.01)


@pytest.mark.parametrize("name", ["fired_share", "fired_share_published"])
def test_response_and_its_inverse(name):
    inverse = {
        "fired_share": sipm.photons_for_share,
        "fired_share_published": sipm.photons_for_share_published,
    }
    photons = np.geomspace(1e-3, 5e3, 50)
    share = getattr(sipm, name)(photons=photons, pde=0.22, cells=400.0)
    np.testing.assert_allclose(inverse[name](share=share, pde=0.22, cells=400.0), photons, rtol=1e-6)


@pytest.mark.parametrize(
    ("overrides", "rtol"),
    [
        (["detector.statistics='steady_state'"], 1e-9),
        (["detector.statistics='published'"], 1e-9),
        (["detector.statistics='time_domain'"], 5e-3),  # a table, there and back
        ([], 1e-12),
    ],
)
def test_a_working_point_finds_the_power_of_its_own_signal(overrides, rtol):
    """Up to two thirds of the free cells. (22) as printed and derived are 3e-4 apart: neither undoes the other."""
    sensor = load_sensor("table1-sipm" if overrides else "table1-apd", overrides=overrides)
    point = sensor.working_point(np.array([2.5e-8]))
    power = np.geomspace(1e-9, 1.5e-7, 25)
    assert not overrides or 0.5 < point.signal(power).max() / (400.0 - point.busy[0]) < 0.99
    np.testing.assert_allclose(point.power_w(point.signal(power)), power, rtol=rtol)


def test_counted_cells_by_scipy():
    """The least count that is not below the level: whole numbers themselves trip, and what is above them does not.

    Levels on a grid that meets whole numbers, over backgrounds of a few and of many busy cells.
    """
    sensor = load_sensor("table1-sipm", overrides=["detector.counting='binomial'"])
    for background_w in (1e-10, 2.5e-8):
        point = sensor.working_point(np.array([background_w]))
        busy = float(point.busy[0])
        for count in np.arange(math.ceil(busy) + 1, math.ceil(busy) + 12):
            for level in (count - 0.75, count - 0.5, count - 0.25, float(count)):
                threshold = np.array([level - busy])
                alarm = point.false_alarm_probability(threshold)[0]
                assert alarm == pytest.approx(binom.sf(count - 1, 400, busy / 400), rel=1e-6)
                found = point.detection_probability(threshold, np.array([20.0]), None)[0]
                assert found == pytest.approx(binom.sf(count - 1, 400, (busy + 20.0) / 400), rel=1e-6)


def test_approximate_snr_of_few_photons():
    """(28) against (27) far from saturation, dark counts off: they meet to the cells' 1 %."""
    sensor = load_sensor(
        "table1-sipm",
        overrides=[
            "detector.statistics='published'",
            "detector.cells=4000000",
            "detector.dark_count_rate_hz=0",
        ],
    )
    point = sensor.working_point(2.5e-8)
    exact = point.signal(1e-7) / point.noise
    photon = sensor.laser.photon_energy_j
    approximate = sipm.snr_approximate(
        signal_photons=sipm.signal_photons(peak_power_w=1e-7, pulse_fwhm_s=6e-9, photon_energy_j=photon),
        background_photons=sipm.background_photons(power_w=2.5e-8, dead_time_s=6e-9, photon_energy_j=photon),
        pde=0.22,
    )
    assert exact == pytest.approx(approximate, rel=1e-3)


def test_photon_detection_efficiency_is_a_product():
    pde = sipm.photon_detection_efficiency(quantum_efficiency=0.5, trigger_probability=0.8, fill_factor=0.55)
    assert pde == pytest.approx(0.22)


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
    for edge in (0.5, 1.0, 6.0):
        assert air.kim_exponent(edge - 1e-9) == pytest.approx(air.kim_exponent(edge + 1e-9), abs=1e-6)
    alpha = air.extinction_from_visibility_per_m(visibility_m=5e3, wavelength_m=550e-9)
    assert air.transmittance(fixed=1.0, extinction_per_m=alpha, range_m=5e3) == pytest.approx(0.02, rel=1e-3)


def test_fixed_transmittance_and_extinction_multiply():
    alpha = air.extinction_from_transmittance_per_m(transmittance=0.9, range_m=100.0)
    assert air.transmittance(fixed=0.98, extinction_per_m=alpha, range_m=200.0) == pytest.approx(0.98 * 0.81)


def test_pulse():
    """Half its peak at half its width; its edge inverts; its area is the energy."""
    assert pulse.gaussian_pulse(time_s=3e-9, fwhm_s=6e-9) == pytest.approx(0.5)
    levels = np.array([1e-4, 0.1, 0.5, 0.99])
    times = pulse.leading_edge_time_s(level=levels, fwhm_s=6e-9)
    np.testing.assert_allclose(pulse.gaussian_pulse(time_s=times, fwhm_s=6e-9), levels, rtol=1e-12)
    step = 1e-15
    slope = (
        pulse.gaussian_pulse(time_s=times + step, fwhm_s=6e-9)
        - pulse.gaussian_pulse(time_s=times - step, fwhm_s=6e-9)
    ) / (2 * step)
    np.testing.assert_allclose(pulse.leading_edge_slope_per_s(level=levels, fwhm_s=6e-9), slope, rtol=1e-5)
    grid = np.linspace(-30e-9, 30e-9, 60_001)
    area = np.trapezoid(pulse.gaussian_pulse(time_s=grid, fwhm_s=6e-9), grid)
    assert pulse.pulse_energy_j(peak_power_w=45.0, fwhm_s=6e-9) == pytest.approx(45.0 * area, rel=1e-9)


def test_time_of_flight():
    assert radiometry.range_from_time_of_flight_m(time_of_flight_s=1e-6) == pytest.approx(149.896229)
    assert radiometry.time_of_flight_s(range_m=149.896229) == pytest.approx(1e-6)
    assert radiometry.time_of_flight_from_beat_s(beat_frequency_hz=1e6, chirp_rate_hz_s=1e12) == 1e-6


def test_sun_is_linear_in_illuminance():
    half = sunlight.sun_irradiance_w_m2(irradiance_at_100_klux_w_m2=29.4, illuminance_klux=50.0)
    assert half == pytest.approx(14.7)


def test_lambertian_intensity_integrates_to_the_reflected_power():
    """(3): the intensity rho P cos / pi over the hemisphere gives rho P back."""
    cosines = np.linspace(0.0, 1.0, 20_001)
    intensity = radiometry.lambertian_intensity_w_sr(
        reflectivity=0.3, transmittance=1.0, peak_power_w=45.0, cos_incidence=cosines
    )
    assert 2 * np.pi * np.trapezoid(intensity, cosines) == pytest.approx(0.3 * 45.0, rel=1e-6)
