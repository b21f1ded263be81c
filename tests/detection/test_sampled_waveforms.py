"""Waveforms of chosen pulses, and background counts of every pulse, from the whole chain."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import chain
from helpers.mistakes import refused

from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics import tdc
from lidarscene.physics.optics import radiometry
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Air
from lidarscene.scene.weather import Weather

pytestmark = pytest.mark.usefixtures("mi")

BEAM = ["laser.divergence_mrad=3", "laser.exit_diameter_mm=10"]
FWHM_S = 6e-9
WALL_M = 50.0


def wall(**settings):
    return chain.scene(chain.facing(range_m=WALL_M, size_m=20.0), **settings)


def lidar_equation_w(sensor):
    return radiometry.echo_power_w(
        peak_power_w=sensor.laser.peak_power_w,
        backscatter_per_sr=0.1 / math.pi,
        range_m=WALL_M,
        transmittance=0.98,
        aperture_m2=sensor.optics.aperture_m2,
        efficiency=sensor.optics.efficiency_laser,
    )


@pytest.mark.parametrize("rays", [1, 7])
def test_a_walls_waveform_is_the_lidar_equations_gaussian(rays):
    """Peak, place, width by energy: P sqrt(pi / (4 ln 2)) FWHM. Tolerance: single precision, and 7 rays that are up to
    0.1 mm off: 1e-4.
    """
    sensor = chain.sensor("table1-apd", *chain.NARROW, *BEAM)
    arrival = 2.0 * WALL_M / SPEED_OF_LIGHT_M_S
    times = arrival + np.linspace(-20e-9, 20e-9, 4001)
    waveforms = Simulator(wall(), sensor, rays=rays).waveforms([4], times)
    peak = lidar_equation_w(sensor)
    assert waveforms.power_w.shape == waveforms.signal.shape == (1, 4001)
    assert waveforms.power_w[0, 2000] == pytest.approx(peak, rel=1e-4)
    energy = np.trapezoid(waveforms.power_w[0].astype(np.float64), times)
    assert energy == pytest.approx(peak * FWHM_S * math.sqrt(math.pi / (4.0 * math.log(2.0))), rel=1e-4)
    np.testing.assert_allclose(waveforms.range_m, 0.5 * SPEED_OF_LIGHT_M_S * times)
    point = sensor.working_point(waveforms.background_w.astype(np.float64))
    np.testing.assert_allclose(
        waveforms.signal[0], point.response.signal(waveforms.power_w[0].astype(np.float64)), rtol=1e-5
    )
    assert waveforms.threshold[0] == pytest.approx(float(sensor.threshold(point)[0]), rel=1e-6)
    assert waveforms.unit == "A"


def test_the_waveform_crosses_where_the_point_is():
    """The sensor is quiet and leaves the walk in: signal = threshold at the reported time.

    Tolerance: five deviations of the noise at the threshold, with the echo's own, over the slope there (one of 2e5 runs
    of nine pulses), and a millimetre of grid and single precision.
    """
    options = ["tdc.threshold_to_noise=50", "tdc.walk='raw'", "tdc.jitter_ps=0", "tdc.lsb_ps=0"]
    sensor = chain.sensor("table1-apd", *chain.NARROW, *options, "laser.peak_power_w=2000")
    simulator = Simulator(wall(), sensor)
    cloud = simulator.render(seed=1)
    waveforms = simulator.waveforms(range(9), 2.0 / SPEED_OF_LIGHT_M_S * np.linspace(48.0, 50.0, 2001))
    assert len(cloud) == 9
    point = sensor.working_point(waveforms.background_w.astype(np.float64))
    noise = tdc.noise_at_level(
        level=waveforms.threshold, noise=point.noise.deviation, kappa_1=point.noise.kappa_1, kappa_2=point.noise.kappa_2
    )
    for pulse in range(9):
        crossing = np.interp(waveforms.threshold[pulse], waveforms.signal[pulse], waveforms.range_m)
        slope = np.interp(crossing, waveforms.range_m, np.gradient(waveforms.signal[pulse], waveforms.range_m))
        assert cloud.range_m[pulse] == pytest.approx(crossing, abs=5.0 * noise[pulse] / slope + 1e-3)


def test_pulses_are_those_of_the_frame_in_rising_order():
    """Chosen or all together: the same waveforms; numbers go on with the frames."""
    sensor = chain.sensor("table1-sipm", *chain.NARROW, *BEAM)
    wet = dataclasses.replace(wall(), air=Air(weather=Weather(fog_visibility_m=100.0, rain_mm_h=20.0)))
    simulator = Simulator(wet, sensor, rays=3)
    times = np.linspace(0.0, 400e-9, 500)
    all_pulses = simulator.waveforms(range(9), times, seed=3, number=2)
    chosen = simulator.waveforms([7, 2, 3], times, seed=3, number=2)
    assert chosen.pulse.tolist() == [20, 21, 25]
    assert chosen.unit == "cells"
    for name in ("power_w", "signal", "threshold", "background_w", "channel", "azimuth_rad", "elevation_rad"):
        np.testing.assert_array_equal(getattr(chosen, name), getattr(all_pulses, name)[[2, 3, 7]])
    # Fog's light comes first, and rain differs from pulse to pulse.
    assert all_pulses.power_w[:, times < 100e-9].max() > 1e-9
    assert not np.array_equal(all_pulses.power_w[0], all_pulses.power_w[1])


def test_without_times_it_is_the_window():
    sensor = chain.sensor("table1-apd", *chain.NARROW, "tdc.window_us=1")
    waveforms = Simulator(wall(), sensor).waveforms([0])
    step = np.diff(waveforms.time_s)
    assert waveforms.time_s[0] == 0.0
    assert 1e-6 - FWHM_S / 16 < waveforms.time_s[-1] <= 1e-6
    np.testing.assert_allclose(step, FWHM_S / 16)


test_pulses_that_are_none = refused(
    lambda pulses: Simulator(wall(), chain.sensor("table1-apd", *chain.NARROW)).waveforms(pulses),
    ([9], "0 | 8 | 9"),
    ([-1], "0 | 8 | -1"),
    ([], "0"),
    where="pulses",
)


def test_ambient_counts_of_every_pulse():
    """Mean photoelectrons by the closed form of a sunlit wall, of pulses with and without points; whatever the chunk.

    5 sigma of the mean of 441 Poisson numbers: 6e-7 false alarms.
    """
    fine = [
        f"scanner.{axis}_{key}_deg={value}"
        for axis in ("azimuth", "elevation")
        for key, value in (("fov", 2.0), ("step", 0.1))
    ]
    sensor = chain.sensor("table1-apd", *fine, "laser.peak_power_w=1e-3")
    simulator = Simulator(wall(), sensor)
    pulses, counts = [], []

    def gather(pulse, values):
        pulses.append(pulse)
        counts.append(values)

    cloud = simulator.render(seed=4, chunk=100, ambient=gather)
    assert len(cloud) < 50
    pulse, all_counts = np.concatenate(pulses), np.concatenate(counts)
    np.testing.assert_array_equal(pulse, np.arange(441))
    background = simulator.waveforms([220]).background_w[0]
    rate, _ = sensor.background_counts(background)
    mean = float(rate * sensor.tdc.ambient_s)
    # The aperture falls with the cosine of the scan angle, 1.5e-4 at a degree.
    assert abs(all_counts.mean() - mean) < 5.0 * math.sqrt(mean / 441) + 1e-3 * mean
    assert 0.7 < all_counts.var() / mean < 1.4
