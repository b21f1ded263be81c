"""What a sensor and its NEAR_IR say before a scene is traced."""

import numpy as np
import pytest

from lidarscene.light.echoes import EchoTrain, SubEchoes
from lidarscene.maths.arrays import Numbers
from lidarscene.recordings.sweep import Sweep
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.studies.fit.near_field import spot_over_field
from lidarscene.studies.fit.on_scene import pulses_on_scene as laid_module
from lidarscene.studies.fit.on_scene.pulses_on_scene import _lay_frame, _power_w

ONE_LENS = (
    "optics.overlap.transmitter_offset_mm=[0, 0]",
    "optics.overlap.focus_at_m=1e6",
    "optics.overlap.scattered_share=0",
)


def test_the_spot_is_told_of_one_lens_on_the_axis_only() -> None:
    """Rationale: with two lenses the law of defocus is not the sensor's, and its own curve is stretched."""
    sensor = load_sensor("os0-128", overrides=ONE_LENS)
    field = float(sensor.detector.radius_m / sensor.optics.focal_length_m)
    assert spot_over_field(sensor) == pytest.approx(0.5 * sensor.laser.divergence_rad / field)
    for name in ("os0-128", "os1-128", "os2-128"):
        assert spot_over_field(load_sensor(name)) is None
    assert spot_over_field(load_sensor("vlp-32c")) is None


def test_the_background_counts_what_was_recorded() -> None:
    sensor = load_sensor("os1-128")
    near_ir = np.array([200.0, 900.0, 5000.0])
    power_w = _power_w(sensor, near_ir)
    counts = np.asarray(sensor.background_counts(power_w)[0]) * float(sensor.tdc.ambient_s)
    np.testing.assert_allclose(counts, near_ir, rtol=1e-3)
    assert _power_w(sensor, np.zeros(1)) == [0.0]


class Lit:
    """A simulator whose scene is a wall at 10 m; what it sends back of every pulse is the pulse's number."""

    def __init__(self, sensor: Sensor, range_m: Numbers) -> None:
        self.sensor, self._range_m = sensor, range_m

    def light(self, **_: object) -> EchoTrain:
        pulses = self.sensor.scanner.pulses
        parts = [
            SubEchoes(range_m=self._range_m, peak_power_w=1e-12 * np.arange(1.0, pulses + 1.0), count=1),
            SubEchoes(range_m=np.full(pulses, 1.0), peak_power_w=np.ones(pulses), count=1),  # of rain, not a surface
        ]
        return EchoTrain(
            parts=tuple(parts),
            surfaces=1,
            has_surface=np.arange(pulses) % 7 != 0,
            background_power_w=np.full(pulses, 2e-9),
        )


def test_each_pulse_is_laid_on_its_own_light() -> None:
    """16 rows and 96 columns: pulses that met nothing, and echoes that were withheld, are left out; patches are of 8
    rows and 20 columns, and no two frames share one; what another scene shows elsewhere tells no signal and no range.
    """
    sensor = load_sensor("os1-128", overrides=["scanner.columns_per_turn=512"])
    numbers = np.arange(sensor.scanner.pulses).reshape(512, 128).T[:16, :96]
    direction = np.stack(
        [np.asarray(x, float) for x in sensor.scanner.direction(numbers.ravel().astype(np.uint32))], -1
    )
    shape = numbers.shape
    withheld = np.zeros(shape, bool)
    withheld[3, 5] = True
    sweep = Sweep(
        range_m=np.where(withheld, np.nan, 10.0),
        recorded=np.ones(shape, bool),
        direction=direction.reshape(*shape, 3),
        signal=100.0 + numbers,
        near_ir=np.full(shape, 300.0),
        reflectivity=np.full(shape, 20.0),
        includes_lost=True,
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(laid_module, "match_pulses", lambda *_: (numbers, np.zeros(shape)))
        pulses = sensor.scanner.pulses
        rough = np.where(np.arange(pulses) % 5 == 0, 12.0, 10.0)
        smooth_light, two = Lit(sensor, np.full(pulses, 10.0)), Lit(sensor, rough)
        single_frame, smooth, second = (
            _lay_frame(simulators, sweep, None, number=frame)
            for simulators, frame in (([smooth_light], 0), ([smooth_light, two], 0), ([smooth_light], 1))
        )
    is_fitted = ((numbers % 7 != 0) & ~withheld).T
    pulse = numbers.T[is_fitted]
    np.testing.assert_allclose(single_frame.reported.signal, 100.0 + pulse)
    np.testing.assert_allclose(single_frame.scene.range_m, 10.0)
    # The sensor's own near field is given back, the same for all at one range.
    share = single_frame.scene.power_w / (1e-12 * (pulse + 1.0))
    np.testing.assert_allclose(share, share[0])
    assert not single_frame.scene.light_measured
    np.testing.assert_allclose(single_frame.reported.near_ir, 300.0)
    assert np.unique(single_frame.scene.group).size == 2 * 5  # of 96 columns five blocks
    assert np.unique(single_frame.block).size == 5
    assert not np.intersect1d(single_frame.scene.group, second.scene.group).size
    assert not np.intersect1d(single_frame.block, second.block).size
    assert np.array_equal(np.isnan(smooth.reported.signal), pulse % 5 == 0)
    assert np.array_equal(np.isnan(smooth.reported.range_m), pulse % 5 == 0)
    assert smooth.reported.has_return.all()
    # Of a twin the background is that of NEAR_IR, which then tells nothing more.
    assert smooth.scene.light_measured
    assert np.isnan(smooth.reported.near_ir).all()
    counts = np.asarray(sensor.background_counts(smooth.scene.background_w)[0]) * float(sensor.tdc.ambient_s)
    np.testing.assert_allclose(counts, 300.0, rtol=1e-3)
    assert np.mean(single_frame.fitted) == pytest.approx(0.8, abs=0.05)  # the fourth of five blocks is held out
