"""What a sensor and its NEAR_IR say before a scene is traced."""

import numpy as np
import pytest

from lidarscene.sensor.catalogue import load_sensor
from lidarscene.studies.fit.near_field import spot_over_field
from lidarscene.studies.fit.on_scene.laid import _power_w

ONE_LENS = (
    "optics.overlap.transmitter_offset_mm=[0, 0]", "optics.overlap.focus_at_m=1e6", "optics.overlap.scattered_share=0",
)  # fmt: skip


def test_the_spot_is_told_of_one_lens_on_the_axis_only() -> None:
    """Rationale: with two lenses the law of defocus is not the sensor's, and its own curve is stretched."""
    sensor = load_sensor("os0-128", overrides=ONE_LENS)
    field = float(sensor.detector.radius_m / sensor.optics.focal_length_m)
    assert spot_over_field(sensor) == pytest.approx(0.5 * sensor.laser.divergence_rad / field)
    for name in ("os0-128", "os1-128", "os2-128"):
        assert spot_over_field(load_sensor(name)) is None
    assert spot_over_field(load_sensor("vlp-16")) is None


def test_the_background_counts_what_was_recorded() -> None:
    sensor = load_sensor("os1-128")
    near_ir = np.array([200.0, 900.0, 5000.0])
    power_w = _power_w(sensor, near_ir)
    counts = np.asarray(sensor.background_counts(power_w)[0]) * float(sensor.tdc.ambient_s)
    np.testing.assert_allclose(counts, near_ir, rtol=1e-3)
    assert _power_w(sensor, np.zeros(1)) == [0.0]
