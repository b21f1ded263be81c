"""The time-domain SiPM on the device: the same numbers as on numpy, and no kernel for a new number."""

import numpy as np
import pytest
from helpers import chain
from helpers.run_seed import chosen

from lidarscene.detection import receiver
from lidarscene.light import beams, echoes
from lidarscene.rendering.stages import ambient_of

pytestmark = pytest.mark.usefixtures("mi")

RASTER = [*chain.raster(30, 20, 0.1), "detector.statistics='time_domain'"]


def scene():
    return chain.scene(chain.facing(range_m=60.0, theta_deg=30.0, size_m=60.0), chain.ball(at=(30.0, 3.0, 0.0)))


CORRELATED = ["detector.crosstalk=0.1", "detector.afterpulse=0.1", "detector.afterpulse_ns=20"]


@pytest.mark.parametrize(
    ("counting", "more"), chosen(1, [("gaussian", []), ("binomial", []), ("gaussian", CORRELATED)])
)
def test_numpy_and_device_agree(counting, more):
    """A table in float32, as everything else on the device: SNR to 2e-4, the same points kept."""
    sensor = chain.sensor(
        "table1-sipm", *RASTER, f"detector.counting='{counting}'", *more, "tdc.threshold_to_noise=3.5", "tdc.walk='raw'"
    )
    lanes = chain.run_stages(scene(), sensor, seed=9)
    pulse = np.arange(sensor.scanner.pulses, dtype=np.uint32)
    light = echoes.receive(
        beams.fire(sensor, pulse=pulse, origin_m=(0.0, 0.0, 0.0), rotation=tuple(np.eye(3, dtype=np.float32).ravel())),
        lanes.hits,
        sensor,
        ambient_of(scene(), sensor),
    )
    detection = receiver.detect(light, sensor, seed=9, pulse=pulse)
    assert (detection.snr > 5.0).sum() > 1000
    np.testing.assert_allclose(detection.snr, lanes.detection.snr, rtol=2e-4, atol=1e-6)
    assert np.mean(detection.outcome != lanes.detection.outcome) < 2e-4
    host, device = detection.stops[0], lanes.detection.stops[0]
    in_both = host.reported & device.reported & (host.status == 0) & (device.status == 0)
    assert in_both.sum() > 1000
    difference = np.abs(host.range_m - device.range_m)[in_both]
    assert np.quantile(difference, 0.999) < 2e-3
