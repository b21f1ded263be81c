"""A receiver that sums shots, on the device and through the whole chain."""

import dataclasses

import numpy as np
import pytest
from helpers import chain, photons, trains
from helpers.run_seed import chosen

from lidarscene.detection.outcomes import Status
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Air
from lidarscene.scene.weather import Weather

pytestmark = pytest.mark.usefixtures("mi")

RASTER = chain.raster(10, 6, 0.2)


def scene(**options):
    return chain.scene(
        chain.facing(range_m=30.0, theta_deg=30.0, size_m=60.0), chain.ball(at=(15.0, 1.0, 0.0)), **options
    )


def test_numpy_and_device_agree():
    """6,000 boards from 10 to 60 m. Single precision moves counts at the edge of a uniform number: 1 % of the points
    may be others, and ranges differ by 1 mm where the same bins were counted.
    """
    counter = photons.sensor("histogram.stops=2", "detector.coincidence=1")
    light = photons.echoes_of(counter, 20.0, count=6_000, illuminance_klux=5.0)
    light.range_m[:] = np.linspace(10.0, 60.0, 6_000)
    light.peak_power_w[:] *= (20.0 / light.range_m) ** 2
    host = photons.detect(light, counter, seed=4)
    device = trains.detect_on_device(light, counter, seed=4)
    assert 0.2 < photons.echo_of(host.stops[0]).mean() < 1.0
    np.testing.assert_allclose(host.snr, device.snr, rtol=1e-3)
    np.testing.assert_allclose(host.detection_probability, device.detection_probability, atol=2e-3)
    # Both stops together: the second alone has some twenty echoes, of which one more or less is 5 %.
    ours, theirs = (np.stack([photons.echo_of(stop) for stop in stops]) for stops in (host.stops, device.stops))
    in_both = ours & theirs
    assert in_both.sum() > 0.98 * ours.sum()
    range_m = [np.stack([np.asarray(stop.range_m) for stop in stops])[in_both] for stops in (host.stops, device.stops)]
    assert (np.abs(range_m[0] - range_m[1]) < 1e-3).mean() > 0.98


def test_many_spads_together_in_the_dark_have_a_signal_to_noise_ratio():
    """Eight that fire in one bin by themselves, 1e-44 of all bins, are none in single precision."""
    counter = photons.sensor("detector.spads=16", "detector.coincidence=8")
    light = photons.echoes_of(counter, 20.0, count=32, illuminance_klux=0.0)
    light.peak_power_w[::2] = 0.0
    device = trains.detect_on_device(light, counter, seed=1)
    assert (device.snr[::2] == 0.0).all()
    assert np.isfinite(device.snr).all()
    assert (device.snr[1::2] > 0.0).all()


def test_spads_that_come_back_are_found_on_the_device_too():
    """2,000 strong echoes in the sun, a third with a hump above the threshold: 1 % may be others, as above."""
    counter = photons.sensor(
        "detector.spads=16 histogram.shots=120 histogram.stops=2 detector.dead_time_ns=20",
        "histogram.threshold_slope=0.33",
    )
    light = photons.echoes_of(counter, 30.0, count=2_000, illuminance_klux=0.0)
    dark = counter.pixel(np.zeros(1))
    light.range_m[:] += np.linspace(0.0, 0.15, 2_000)
    light.background_power_w[:] = 27.5e6 / float(dark.per_watt)
    light.peak_power_w[:] = 5.0 / float(dark.detections(1.0))
    host = photons.detect(light, counter, seed=4)
    device = trains.detect_on_device(light, counter, seed=4)
    ours, theirs = (
        np.any([stop.reported & (stop.status == Status.REVIVED) for stop in detection.stops], axis=0)
        for detection in (host, device)
    )
    assert 0.2 < ours.mean() < 0.6
    assert (ours == theirs).mean() > 0.99


def test_echoes_on_flanks_are_those_of_numpy():
    """1,000 pairs of echoes, 15 photons before 150, from 0.4 to 2 m apart: 1 % of the points may be others, as above,
    and P_d differs by 0.01 where a peak just begins or ends to exist in single precision, in 1 % of them.
    """
    counter = photons.sensor("histogram.stops=2", "laser.pulse_fwhm_ns=3", "histogram.window_us=0.4")
    power_w = counter.working_point(np.full(1, 1e-12)).response.power_w(np.array([15.0, 150.0]))
    range_m = 25.0 + np.stack([np.zeros(1_000), np.linspace(0.4, 2.0, 1_000)], axis=1)
    light = trains.train(range_m, np.tile(power_w, (1_000, 1)), background_w=1e-12)
    host = photons.detect(light, counter, seed=4)
    device = trains.detect_on_device(light, counter, seed=4)
    both = photons.echo_of(host.stops[1])
    assert 0.5 < both.mean() < 0.9
    same = both == photons.echo_of(device.stops[1])
    assert same.mean() > 0.99
    for ours, theirs in zip(host.stops, device.stops, strict=True):
        where = same & photons.echo_of(ours)
        assert (np.abs(ours.range_m - theirs.range_m)[where] < 1e-3).mean() > 0.98
        assert (np.abs(ours.detection_probability - theirs.detection_probability)[where] < 0.01).mean() > 0.98


def test_echoes_are_found_as_often_as_their_probabilities_say():
    """12,648 beams of eight frames: 4 standard errors of the sum of P_d. Ten frames have 0.0002 +- 0.0029 more than
    it says, and 0.021 less if a comparator reads the filter's P_d.
    """
    counter = photons.sensor(*RASTER, "histogram.stops=2", "laser.peak_power_w=0.007")
    frames = [chain.run_stages(scene(klux=10.0), counter, seed=seed).detection for seed in range(8)]
    p = np.concatenate([np.asarray(frame.detection_probability, dtype=np.float64) for frame in frames])
    detected = np.concatenate([np.any([photons.echo_of(stop) for stop in frame.stops], axis=0) for frame in frames])
    assert 0.5 < p.mean() < 0.9
    error = np.sqrt(np.sum(p * (1.0 - p))) / len(p)
    assert detected.mean() == pytest.approx(p.mean(), abs=4.0 * error)


def test_columns_are_photons():
    """SIGNAL and NEAR_IR are whole photons."""
    counter = photons.sensor(*RASTER, "histogram.stops=2", "laser.peak_power_w=0.02")
    cloud = Simulator(scene(klux=10.0), counter).render(seed=2)
    echo = cloud.status == Status.ECHO
    assert 300 < echo.sum() <= 1.01 * counter.scanner.pulses  # noise may cut an echo in two
    assert cloud.metadata["intensity_unit"] == "photons"
    np.testing.assert_array_equal(cloud.signal, np.rint(cloud.intensity))
    assert (cloud.signal[echo] > 0.0).all()
    assert (cloud.ambient == np.rint(cloud.ambient)).all()
    assert np.abs(np.median((cloud.range_m - cloud.true_range_m)[echo])) < 0.03


@pytest.mark.parametrize("rays", chosen(1, [1, 4]))
def test_fog_and_several_rays_go_through_the_same_receiver(rays):
    """Walls behind fog are found, and points of the fog are of the weather. The SPADs that it fires before a wall are
    missing from the wall's echo, which looks weaker than it is: 0.16 m of its walk of 0.33 m are left.
    """
    counter = photons.sensor(
        *RASTER, "histogram.stops=3", "laser.peak_power_w=10", "laser.divergence_mrad=2", "histogram.keep='strongest'"
    )
    cloud = Simulator(scene(air=Air(weather=Weather(fog_visibility_m=150.0))), counter, rays=rays).render(seed=1)
    kinds = np.bincount(cloud.status, minlength=len(Status))
    assert kinds[Status.WEATHER] > 100
    assert kinds[Status.ECHO] > 500
    walls = cloud.status == Status.ECHO
    assert np.abs(np.median((cloud.range_m - cloud.true_range_m)[walls])) < 0.2
    fog = cloud.range_m[cloud.status == Status.WEATHER]
    assert len(np.unique(fog)) > 0.99 * len(fog)


def test_echoes_from_beyond_the_unambiguous_range_are_labelled():
    board = chain.facing(range_m=300.0, size_m=80.0)
    counter = photons.sensor(*RASTER, "histogram.shots=40", "histogram.pulse_period_us=1.8", "laser.peak_power_w=200")
    counter = dataclasses.replace(counter, tdc=dataclasses.replace(counter.tdc, window_s=1.8e-6))
    cloud = Simulator(chain.scene(board), counter).render(seed=1)
    far = cloud.true_range_m > 290.0
    assert far.sum() > 100
    assert (cloud.status[far] == Status.ALIASED).mean() > 0.95
    folded = cloud.status == Status.ALIASED
    np.testing.assert_allclose((cloud.true_range_m - cloud.range_m)[folded], 269.81, atol=1.0)


def test_no_light_but_the_echo():
    """There is no noise without sun and dark counts; every number stays one, and the surfaces are found."""
    counter = photons.sensor(*RASTER, "detector.dark_count_rate_hz=0")
    dark = chain.scene(chain.facing(range_m=10.0, size_m=60.0), klux=0.0)
    cloud = Simulator(dark, counter).render(seed=2)
    assert len(cloud) > 0.99 * counter.scanner.pulses
    assert np.isfinite(cloud.snr).all()
    assert cloud.detection_probability.min() > 0.99
