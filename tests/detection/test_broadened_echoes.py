"""Echoes that a leaning surface lengthens, and edges that noise crosses more than once, through the receiver."""

import numpy as np
import pytest
from helpers import chain, trains
from helpers.run_seed import chosen
from helpers.trains import detect

from lidarscene.detection.report import Detection
from lidarscene.light.echoes import EchoTrain, SubEchoes
from lidarscene.maths.special import normal_tail_inverse
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import Target

BEAM = ["laser.divergence_mrad=3", "tdc.jitter_ps=0", "tdc.lsb_ps=0"]
COUNT = 4000


def on_a_slope(sensor: Sensor, target: Target, range_m: float) -> Detection:
    light = plane.echoes_of_plane(sensor, target, np.full(COUNT, range_m))
    return detect(light, sensor, seed=3)


def many_rays(sensor: Sensor, target: Target, range_m: float, rays: int = 64) -> EchoTrain:
    """The same light as that of rays at even quantiles of the spot, which share the power."""
    whole = plane.echoes_of_plane(sensor, target, np.full(COUNT, range_m))
    quantile = normal_tail_inverse((np.arange(rays) + 0.5) / rays)
    half_rad = 0.5 * float(sensor.laser.divergence_rad)
    tangent = np.sqrt(1.0 / target.cos_incidence**2 - 1.0)
    ranges = range_m * (1.0 + 0.5 * half_rad * tangent * quantile / quantile.std())
    part = SubEchoes(
        range_m=np.tile(ranges, COUNT), peak_power_w=np.repeat(np.asarray(whole.peak_power_w) / rays, rays), count=rays
    )
    return EchoTrain(
        parts=(part,),
        surfaces=rays,
        has_surface=whole.has_surface,
        background_power_w=whole.background_power_w,
        white_w_m2=whole.white_w_m2,
    )


@pytest.mark.parametrize("timing", ["peak", "constant_fraction", "matched_filter"])
def test_one_ray_of_a_slope_is_measured_as_many(timing: str) -> None:
    """Heights to 3 %, deviations of the range to 10 %: those of 4,000 pulses are sure to 1.1 %, and 64 rays end where
    the Gaussian's tails go on.
    """
    sensor = chain.sensor("table1-apd", *BEAM, f"tdc.timing='{timing}'")
    target = Target(cos_incidence=float(np.cos(np.radians(84.0))), reflectivity=8.0)
    lone = on_a_slope(sensor.replace("laser.slope_broadening=true"), target, 60.0)
    light = many_rays(sensor, target, 60.0)
    spread = detect(light, sensor, seed=4)
    plain = on_a_slope(sensor, target, 60.0)
    height, of_rays, whole = (float(np.mean(found.stops[0].amplitude)) for found in (lone, spread, plain))
    assert height < 0.8 * whole
    assert height == pytest.approx(of_rays, rel=0.03)
    one, several = (stop.range_m[stop.reported & (stop.status == 0)] for stop in (lone.stops[0], spread.stops[0]))
    assert np.std(one) == pytest.approx(float(np.std(several)), rel=0.1)


def test_intensity_is_the_peak_or_the_energy() -> None:
    """Energy reads what the surface has without the slope's length; a peak as much less as the echo is longer."""
    target, keys = Target(cos_incidence=0.06, reflectivity=1.0), [*BEAM, "laser.slope_broadening=true"]
    scale = "intensity={kind='range_corrected', reference_m=10}"
    light = plane.echoes_of_plane(chain.sensor("table1-apd", *keys), target, 60.0)
    peak, energy = (
        np.median(on_a_slope(chain.sensor("table1-apd", *keys, scale, *more), target, 60.0).stops[0].intensity)
        for more in ([], ["intensity.measures='energy'"])
    )
    assert light.broadening is not None
    assert energy / peak == pytest.approx(float(np.ravel(light.broadening)[0]), rel=1e-3)


@pytest.mark.parametrize("snr", chosen(1, [9.0, 30.0]))
def test_chatter_loses_pulses_as_sampled_noise_does(snr: float) -> None:
    """Gaussian pulses in sampled noise: the share that crosses the threshold upwards once only, before the peak.

    The amplifier is so noisy that the echo's own noise does not count. Further
    crossings are not quite independent of each other: 0.03, and four standard errors.
    """
    mhz, quiet_echo = 150.0, "detector.circuit_noise_na=1e5"
    sensor = chain.sensor("table1-apd", "tdc.threshold_to_noise=6", f"tdc.chatter_mhz={mhz}", quiet_echo)
    light = trains.train(np.full((COUNT, 1), 50.0), np.full((COUNT, 1), trains.power_at_snr(sensor, snr)))
    detection = trains.detect(light, sensor)
    kept = np.mean(detection.stops[0].reported)
    assert kept == pytest.approx(float(np.mean(detection.detection_probability)), abs=4 * np.sqrt(0.25 / COUNT))
    step_s, samples = 0.05e-9, 2048
    spectrum = np.fft.rfft(np.random.default_rng(6).standard_normal((COUNT, samples)))
    spectrum[:, np.fft.rfftfreq(samples, step_s) > np.sqrt(3.0) * 1e6 * mhz] = 0.0
    noise = np.fft.irfft(spectrum, samples)
    time_s = (np.arange(samples) - samples // 2) * step_s
    signal = snr * np.exp(-0.5 * (time_s / trains.SIGMA_S) ** 2) + noise / noise.std()
    rising = (signal[:, 1:] >= 6.0) & (signal[:, :-1] < 6.0) & (time_s[1:] < 0.0)
    assert kept == pytest.approx(np.mean(rising.sum(axis=1) == 1), abs=0.03 + 4 * np.sqrt(0.5 / COUNT))


@pytest.mark.parametrize(
    ("key", "target"),
    [
        ("tdc.chatter_mhz=500", Target(cos_incidence=0.1, reflectivity=0.4)),
        # Studies and the column of clouds left out that a matched filter passes long echoes better: 0.08 for 0.44.
        ("tdc.timing='matched_filter'", Target(cos_incidence=0.03, reflectivity=0.5)),
    ],
)
def test_probabilities_of_studies_and_clouds_are_the_shares_kept(key: str, target: Target) -> None:
    """Shares to 4 sigma."""
    sensor = chain.sensor("table1-apd", *BEAM, "laser.slope_broadening=true", key)
    rendered = on_a_slope(sensor, target, 60.0)
    expected = plane.detection_probability(sensor, target, 60.0)
    assert 0.2 < expected < 0.95
    assert float(rendered.detection_probability[0]) == pytest.approx(expected, rel=1e-4)
    assert float(rendered.snr[0]) == pytest.approx(plane.snr(sensor, target, 60.0), rel=1e-4)
    assert float(np.mean(rendered.stops[0].reported)) == pytest.approx(expected, abs=4 * np.sqrt(0.25 / COUNT))
