"""Echoes that fluctuate: which do, how much, and whether frames hold what their columns promise."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import chain
from helpers.run_seed import chosen
from helpers.shots import simulated_shots
from scipy import stats

from lidarscene import load_sensor
from lidarscene.detection import receiver
from lidarscene.detection.outcomes import Status
from lidarscene.light.fluctuations import FluctuationLaw, fluctuate
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Air
from lidarscene.scene.weather import Weather
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import Target

SPECKLED = ["laser.divergence_mrad=1", "laser.speckle={}"]
PULSES = 20_000


def test_nothing_fluctuates_by_default() -> None:
    assert FluctuationLaw.of(load_sensor("mems-1550"), Air()) is None
    assert plane.fluctuation_variance(load_sensor("mems-1550"), Target(), 50.0) is None


def test_variance_by_hand() -> None:
    """1550 nm, 0.5 mrad and a lens of 2.5 mm: y = (pi 0.5e-3 2.5e-3 / 1550e-9)^2, M = 2 (1 + y), 26 %.

    With turbulence both factors are independent.
    """
    sensor, square = load_sensor("mems-1550", overrides=SPECKLED), (math.pi * 0.5e-3 * 2.5e-3 / 1550e-9) ** 2
    speckle = 1.0 / (2.0 * (1.0 + square))
    assert plane.fluctuation_variance(sensor, Target(), 50.0) == pytest.approx(speckle, rel=1e-9)
    assert math.sqrt(speckle) == pytest.approx(0.26, abs=0.005)
    at = {"range_m": np.float64(100.0), "cos_incidence": 1.0, "aperture_m2": sensor.optics.aperture_m2}
    calm, stirred = (FluctuationLaw.of(sensor, Air(structure_constant=cn2)) for cn2 in (0.0, 1e-12))
    bare = FluctuationLaw.of(load_sensor("mems-1550"), Air(structure_constant=1e-12))
    product = (1.0 + calm.variance(**at)) * (1.0 + bare.variance(**at))
    assert 1.0 + stirred.variance(**at) == pytest.approx(product, rel=1e-9)


def test_energies_of_summed_pulses_even_out() -> None:
    """r^2 of one pulse, r^2 / n of n that a point sums; independent of the speckle of its surface."""
    one = load_sensor("table1-apd", overrides=["laser.energy_spread=0.1"])
    assert plane.fluctuation_variance(one, Target(), 50.0) == pytest.approx(0.01, rel=1e-9)
    summed = load_sensor("os1-128", overrides=["laser.energy_spread=0.1"])
    assert summed.histogram is not None
    expected = 0.01 / float(summed.histogram.shots)
    assert plane.fluctuation_variance(summed, Target(), 50.0) == pytest.approx(expected, rel=1e-9)
    both = load_sensor("mems-1550", overrides=[*SPECKLED, "laser.energy_spread=0.1"])
    speckle = plane.fluctuation_variance(load_sensor("mems-1550", overrides=SPECKLED), Target(), 50.0)
    assert speckle is not None
    assert plane.fluctuation_variance(both, Target(), 50.0) == pytest.approx((1.0 + speckle) * 1.01 - 1.0, rel=1e-9)


@pytest.mark.parametrize("keys", [[], ["tdc.keep='strongest'"]])
def test_the_energy_of_a_pulse_moves_its_amplitude_and_its_crossing(keys: list[str]) -> None:
    """Rationale: an edge of more energy is higher, and crosses the threshold earlier. Reference: of a Gaussian edge
    that crosses a share q of its peak, t = -FWHM sqrt(ln(1 / q) / (4 ln 2)), and dt / d ln P = FWHM^2 / (8 ln 2 t);
    noise at the threshold, of 1 %, moves it as much as another energy does. Tolerance: 4 standard errors of a deviation
    of 20,000 pulses (2 %), and 1 % for the curvature of t.
    """
    spread, fixed = 0.02, ["tdc.walk='raw'", "tdc.lsb_ps=0", "tdc.jitter_ps=0", "laser.peak_power_w=100"]
    keys = [*keys, "tdc.threshold_to_noise=1e4"]
    sensor = load_sensor("table1-apd", overrides=[*fixed, *keys, f"laser.energy_spread={spread}"])
    target = Target(illuminance_klux=0.0)
    light = plane.echoes_of_plane(sensor, target, np.full(PULSES, 5.0))
    variance, pulse = plane.fluctuation_variance(sensor, target, light.range_m), np.arange(PULSES, dtype=np.uint32)
    detection = receiver.detect(fluctuate(light, variance, seed=5, pulse=pulse), sensor, seed=5, pulse=pulse)
    first = detection.stops[0]
    assert np.asarray(first.reported).all()
    assert np.std(first.amplitude) / np.mean(first.amplitude) == pytest.approx(spread, rel=0.03)
    point, fwhm_s = sensor.working_point(light.background_power_w), float(sensor.laser.pulse_fwhm_s)
    level = sensor.threshold(point)
    share = float(np.ravel(point.response.power_w(level) / light.peak_power_w)[0])
    noise = float(np.ravel(point.noise.at(level) / level)[0])
    edge_s = fwhm_s * math.sqrt(math.log(1.0 / share) / (4.0 * math.log(2.0)))
    slope_m = 0.5 * 299792458.0 * fwhm_s**2 / (8.0 * math.log(2.0) * edge_s)
    assert np.std(first.range_m) == pytest.approx(slope_m * math.hypot(spread, noise), rel=0.03)
    expected = -spread / math.hypot(spread, noise)
    assert np.corrcoef(first.range_m, first.amplitude)[0, 1] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("detector", chosen(2, ["table1-apd", "table1-sipm", "os1-128", "hdl-32e"]))
@pytest.mark.parametrize("variance", chosen(1, [0.05, 0.5]))
def test_the_share_found_is_the_column(detector: str, variance: float) -> None:
    """Comparator, cells, histogram and samples: the share of points of a fluctuating echo at P_d of some 0.6.

    Tolerance: four sigma of the binomial, 6e-5 false alarms of the test, and 0.005 for the quadrature and for noise
    that trips by itself.
    """
    sensor, target = load_sensor(detector), Target()
    range_m = 0.95 * plane.maximum_range_m(sensor, target)[0]
    light = plane.echoes_of_plane(sensor, target, range_m * np.ones(PULSES))
    pulse = np.arange(PULSES, dtype=np.uint32)
    drawn = fluctuate(light, np.full(PULSES, variance), seed=5, pulse=pulse)
    detection = receiver.detect(drawn, sensor, seed=5, pulse=pulse)
    calm = receiver.detect(light, sensor, seed=5, pulse=pulse)
    found = np.mean(np.asarray(detection.outcome) == 0)
    probability = np.asarray(detection.detection_probability)
    assert np.ptp(probability) < 1e-6  # the column is that of all powers, not of the drawn one
    calm_gap = np.mean(np.asarray(calm.outcome) == 0) - np.mean(calm.detection_probability)
    assert found - calm_gap == pytest.approx(probability[0], abs=4.0 * math.sqrt(0.5 / PULSES) + 0.005)
    np.testing.assert_allclose(detection.snr, calm.snr, rtol=1e-6)  # that of the mean echo
    assert abs(probability[0] - calm.detection_probability[0]) > 0.002


def test_a_strong_echo_is_lost_as_the_gamma_distribution_says() -> None:
    """P_d is, without noise to speak of, the share of powers above the threshold: scipy's gamma distribution.

    Tolerance: 0.02, the worst of the quadrature for so steep a step, and 4 sigma of the drawn share.
    """
    variance, sensor = 1.0, load_sensor("table1-apd", overrides=["tdc.threshold_to_noise=40"])
    target = Target(illuminance_klux=0.0)
    range_m = 0.5 * plane.maximum_range_m(sensor, target)[0]
    light = plane.echoes_of_plane(sensor, target, range_m * np.ones(PULSES))
    point = sensor.working_point(light.background_power_w)
    level = float(np.ravel(point.response.power_w(sensor.threshold(point)) / light.peak_power_w)[0])
    pulse = np.arange(PULSES, dtype=np.uint32)
    drawn = fluctuate(light, np.full(PULSES, variance), seed=7, pulse=pulse)
    detection = receiver.detect(drawn, sensor, seed=7, pulse=pulse)
    expected = stats.gamma.sf(level, 1.0 / variance, scale=variance)
    assert 0.7 < expected < 0.85
    assert detection.detection_probability[0] == pytest.approx(expected, abs=0.02)
    assert np.mean(detection.outcome == 0) == pytest.approx(expected, abs=0.005 + 4.0 * math.sqrt(0.2 / PULSES))


def test_studies_agree_with_shots() -> None:
    """`range` and its simulated shots, with speckle. Four sigma: 6e-5."""
    sensor, shots = load_sensor("mems-1550", overrides=SPECKLED), 40_000
    range_m = 0.9 * plane.maximum_range_m(sensor, Target())[0]
    expected = float(plane.detection_probability(sensor, Target(), range_m)[0])
    found = simulated_shots(sensor, Target(), range_m, shots=shots, seed=2).echoes / shots
    calm = load_sensor("mems-1550", overrides=SPECKLED[:1])
    calm_gap = simulated_shots(calm, Target(), range_m, shots=shots, seed=2).echoes / shots - float(
        plane.detection_probability(calm, Target(), range_m)[0]
    )
    assert found - calm_gap == pytest.approx(expected, abs=4.0 * math.sqrt(0.5 / shots) + 1e-3)
    assert float(plane.detection_probability(calm, Target(), range_m)[0]) - expected > 0.05


@pytest.mark.usefixtures("mi")
@pytest.mark.parametrize("rays", [1, 5])
def test_frames_fluctuate(rays: int) -> None:
    """Amplitudes of a near wall scatter by speckle and turbulence together, SNR and P_d do not, in one ray and several.

    Tolerance: four sigma of a variance from 6,561 pulses, 4 sqrt(2 / 6,561) = 7 %, and 3 % for noise and angles.
    """
    raster = [f"scanner.{axis}_{key}" for axis in ("azimuth", "elevation") for key in ("fov_deg=8", "step_deg=0.1")]
    keys = [*raster, "laser.divergence_mrad=1", "optics.aperture_radius_mm=3", "detector.gain=20"]
    described = chain.scene(chain.facing(range_m=20.0, size_m=8.0), klux=0.0, air=Air(structure_constant=1e-11))
    sensor = chain.sensor("table1-apd", *keys, "laser.speckle={}")
    cloud = Simulator(described, sensor, rays=rays).render(seed=4)
    calm = Simulator(dataclasses.replace(described, air=Air()), chain.sensor("table1-apd", *keys), rays=rays).render(
        seed=4
    )
    law = FluctuationLaw.of(sensor, described.air)
    aperture_m2 = sensor.optics.aperture_m2
    expected = law.variance(range_m=np.float64(20.0), cos_incidence=1.0, aperture_m2=aperture_m2)
    relative = cloud.intensity / calm.intensity
    assert len(cloud) == len(calm)
    assert np.var(relative) == pytest.approx(expected, rel=0.1)
    assert np.mean(relative) == pytest.approx(1.0, abs=4.0 * math.sqrt(expected / len(cloud)) + 0.002)
    np.testing.assert_allclose(cloud.snr, calm.snr, rtol=1e-3)


@pytest.mark.usefixtures("mi")
def test_returns_of_weather_have_their_mean() -> None:
    """Drops in front of a wall: SNR of echoes and weather is that of calm air, though both scatter.

    Of two drops in one pulse speckle may lift the other one over the threshold: in one pulse of a thousand at most.
    """
    raster = [f"scanner.{axis}_{key}" for axis in ("azimuth", "elevation") for key in ("fov_deg=8", "step_deg=0.1")]
    rain = Air(weather=Weather(rain_mm_h=80.0))
    described = chain.scene(chain.facing(range_m=40.0, size_m=12.0), klux=0.0, air=rain)
    calm, stirred = (
        Simulator(described, chain.sensor("table1-apd", *raster, "laser.divergence_mrad=2", *more)).render(seed=4)
        for more in ([], ["laser.speckle={}"])
    )
    _, first, second = np.intersect1d(calm.time_s, stirred.time_s, return_indices=True)
    alike = calm.status[first] == stirred.status[second]
    weather = alike & (calm.status[first] == int(Status.WEATHER))
    assert weather.sum() > 20
    close = np.isclose(stirred.snr[second][weather], calm.snr[first][weather], rtol=2e-3)
    assert np.count_nonzero(~close) <= 3 + 1e-3 * len(close)
