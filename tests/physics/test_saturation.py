"""A clipped pulse: its waveform on a fine grid against the closed forms, and what a frame makes of it."""

import chain
import numpy as np
import pytest

from lidarscene import returns
from lidarscene.analysis import ranging
from lidarscene.analysis.ranging import Target
from lidarscene.physics import saturation
from lidarscene.returns import Outcome

FWHM_S, RECOVERY_S = 6e-9, 2e-9
SHOTS = 20_000
CLIPPED = "detector.saturation_ua=50"


def shots(sensor, range_m, reflectivity=0.8):
    light = ranging.echoes_of_plane(sensor, Target(reflectivity=reflectivity), np.full(SHOTS, range_m))
    return light, returns.detect(light, sensor, seed=3, pulse=np.arange(SHOTS, dtype=np.uint32))


@pytest.mark.parametrize("signal", [0.5, 0.99, 1.5, 10.0, 1e3])
@pytest.mark.parametrize("recovery_s", [0.0, 0.5e-9, RECOVERY_S, 20e-9])
def test_width_of_the_waveform(signal, recovery_s):
    """Reference: time above the level on a grid of 1 ps. Tolerance: two of its steps."""
    time = np.arange(-40e-9, 300e-9, 1e-12)
    pulse = {"signal": np.array(signal), "saturation": 1.0, "fwhm_s": FWHM_S, "recovery_s": recovery_s}
    wave = saturation.clipped_waveform(time_s=time, **pulse)
    assert wave.max() <= 1.0
    for level in (0.05, 0.4, 0.9):
        above = 1e-12 * np.count_nonzero(wave > level)
        assert saturation.width_at_level_s(level=level, **pulse) == pytest.approx(above, abs=2e-12)


def test_width_grows_with_the_logarithm():
    """Ten times the overdrive, tau ln 10 longer plus what the Gaussian's own flanks add."""
    widths = [
        saturation.width_at_level_s(
            level=0.1, signal=np.array(s), saturation=1.0, fwhm_s=FWHM_S, recovery_s=20e-9
        )
        for s in (10.0, 100.0, 1000.0)
    ]
    steps = np.diff(widths) - 20e-9 * np.log(10.0)
    assert (steps > 0.0).all()
    assert (steps < 5e-9).all()


@pytest.mark.parametrize("range_m", [5.0, 20.0, 50.0])
def test_walk_bias_of_shots(range_m):
    """Reference: the mean of a frame's ranges, through `returns.detect`.

    The same frame without clipping has its own small bias, from noise on a curved edge, taken off; what is left
    is counted, four standard errors.
    """
    clipped, free = chain.sensor("table1-apd", CLIPPED), chain.sensor("table1-apd")
    (light, found), (_, reference) = shots(clipped, range_m), shots(free, range_m)
    point = clipped.working_point(light.background_power_w)
    expected = saturation.walk_bias_m(
        threshold=clipped.threshold(point)[0], signal=point.signal(light.peak_power_w)[0],
        saturation=50e-6, fwhm_s=FWHM_S,
    )  # fmt: skip
    moved = found.stops[0].range_m - reference.stops[0].range_m
    assert expected < -0.05
    assert abs(moved.mean() - expected) < 4.0 * moved.std() / np.sqrt(SHOTS) + 1e-4
    assert found.stops[0].amplitude.max() == pytest.approx(50e-6)


def test_weak_echoes_keep_their_bits():
    """Far below the level nothing changes, not even the last bit."""
    (_, found), (_, reference) = (shots(chain.sensor("table1-apd", *one), 300.0) for one in ([CLIPPED], []))
    for name in ("reported", "status", "range_m", "amplitude"):
        np.testing.assert_array_equal(getattr(found.stops[0], name), getattr(reference.stops[0], name))


def test_a_threshold_above_the_level_is_never_crossed():
    """Neither by an echo nor by noise, which would cross a threshold of 1 sigma all the time."""
    sensor = chain.sensor("table1-apd", "detector.saturation_ua=0.3", "tdc.threshold_to_noise=1")
    light, found = shots(sensor, 20.0)
    assert sensor.threshold(sensor.working_point(light.background_power_w))[0] > 0.3e-6
    assert not found.stops[0].reported.any()
    assert (found.detection_probability == 0.0).all()
    assert (found.outcome == Outcome.BELOW_THRESHOLD).all()


def test_on_the_device(mi):
    """The middle of a frame on a near wall: clipped, as numpy has it."""
    sensor = chain.sensor("table1-apd", *chain.NARROW, CLIPPED)
    stop = chain.run(chain.scene(chain.facing(range_m=5.0)), sensor).detection.stops[0]
    np.testing.assert_allclose(stop.amplitude, 50e-6, rtol=1e-6)
    assert (stop.range_m < 4.7).all()


def test_sipm_does_not_clip():
    sensor = chain.sensor("table1-sipm")
    assert sensor.working_point(np.array([1e-8])).saturation is None
