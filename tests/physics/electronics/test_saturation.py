"""A clipped pulse: its waveform on a fine grid against the closed forms, and what a frame makes of it."""

import math

import numpy as np
import pytest
from helpers import chain, trains
from helpers.trains import detect
from scipy.stats import norm

from lidarscene.detection import receiver
from lidarscene.detection.outcomes import Outcome
from lidarscene.physics.electronics import saturation, tdc
from lidarscene.physics.reference import electronics as reference_electronics
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import Target

FWHM_S, RECOVERY_S = 6e-9, 2e-9
SHOTS = 20_000
CLIPPED = "detector.saturation_ua=50"
RISING = "tdc.edges='rising'"
STEADY = "detector.statistics='steady_state'"  # solved for the light in closed form


def shots(sensor, range_m, reflectivity=0.8):
    light = plane.echoes_of_plane(sensor, Target(reflectivity=reflectivity), np.full(SHOTS, range_m))
    return light, detect(light, sensor, seed=3)


@pytest.mark.parametrize("signal", [0.5, 0.99, 1.5, 10.0, 1e3])
@pytest.mark.parametrize("recovery_s", [0.0, 0.5e-9, RECOVERY_S, 20e-9])
def test_width_of_the_waveform(signal, recovery_s):
    """Reference: time above the level on a grid of 1 ps. Tolerance: two of its steps."""
    time = np.arange(-40e-9, 300e-9, 1e-12)
    pulse = {"signal": np.array(signal), "saturation": 1.0, "fwhm_s": FWHM_S, "recovery_s": recovery_s}
    wave = reference_electronics.clipped_waveform(time_s=time, **pulse)
    assert wave.max() <= 1.0
    for level in (0.05, 0.4, 0.9):
        above = 1e-12 * np.count_nonzero(wave > level)
        assert reference_electronics.width_at_level_s(level=level, **pulse) == pytest.approx(above, abs=2e-12)


@pytest.mark.parametrize("range_m", [5.0, 20.0, 50.0])
def test_walk_bias_of_shots(range_m):
    """Reference: the mean of a frame's ranges, through `detection.receiver.detect`.

    The same frame without clipping has its own small bias, from noise on a curved edge, taken off; what is left
    is counted, four standard errors.
    """
    clipped, free = chain.sensor("table1-apd", CLIPPED, RISING), chain.sensor("table1-apd")
    (light, detection), (_, reference) = shots(clipped, range_m), shots(free, range_m)
    point = clipped.working_point(light.background_power_w)
    expected = reference_electronics.walk_bias_m(
        threshold=clipped.threshold(point)[0],
        signal=point.response.signal(light.peak_power_w)[0],
        saturation=50e-6,
        fwhm_s=FWHM_S,
    )
    moved = detection.stops[0].range_m - reference.stops[0].range_m
    assert expected < -0.05
    assert abs(moved.mean() - expected) < 4.0 * moved.std() / np.sqrt(SHOTS) + 1e-4
    assert detection.stops[0].amplitude.max() == pytest.approx(50e-6)


def test_weak_echoes_keep_their_bits():
    """Far below the level nothing changes, not even the last bit."""
    (_, detection), (_, reference) = (
        shots(chain.sensor("table1-apd", *overrides), 300.0) for overrides in ([CLIPPED], [])
    )
    for name in ("reported", "status", "range_m", "amplitude", "intensity"):
        np.testing.assert_array_equal(getattr(detection.stops[0], name), getattr(reference.stops[0], name))


def test_a_threshold_above_the_level_is_never_crossed():
    """Neither by an echo nor by noise, which would cross a threshold of 1 sigma all the time."""
    sensor = chain.sensor("table1-apd", "detector.saturation_ua=0.3", "tdc.threshold_to_noise=1")
    light, detection = shots(sensor, 20.0)
    assert sensor.threshold(sensor.working_point(light.background_power_w))[0] > 0.3e-6
    assert not detection.stops[0].reported.any()
    assert (detection.detection_probability == 0.0).all()
    assert (detection.outcome == Outcome.BELOW_THRESHOLD).all()


def test_on_the_device(mi):
    """The middle of a frame on a near wall: clipped, as numpy has it."""
    sensor = chain.sensor("table1-apd", *chain.NARROW, CLIPPED, RISING)
    stop = chain.run_stages(chain.scene(chain.facing(range_m=5.0)), sensor).detection.stops[0]
    np.testing.assert_allclose(stop.amplitude, 50e-6, rtol=1e-6)
    assert (stop.range_m < 4.7).all()


def test_sipm_does_not_clip():
    sensor = chain.sensor("table1-sipm")
    assert sensor.working_point(np.array([1e-8])).response.saturation is None


def test_a_width_tells_the_peak():
    """Solved for the peak: what `width_at_level_s` made of it. Newton's method squares 1e-5 to 1e-10."""
    signal = np.geomspace(0.2, 1e5, 40)
    for recovery_s in (0.0, RECOVERY_S, 20e-9):
        shape = {"level": 0.1, "saturation": 1.0, "fwhm_s": FWHM_S, "recovery_s": recovery_s}
        width_s = reference_electronics.width_at_level_s(signal=signal, **shape)
        assert (np.diff(width_s) > 0.0).all()
        np.testing.assert_allclose(
            saturation.overdrive_of_width(width_s=width_s, **shape), np.log(signal / 0.1), rtol=1e-9
        )
    # Clipping makes a pulse longer at once: widths between those just below and above S are of a peak at S.
    shape = {"level": 0.1, "saturation": 1.0, "fwhm_s": FWHM_S, "recovery_s": 20e-9}
    below_s, above_s = reference_electronics.width_at_level_s(signal=np.array([1.0, 1.0 + 1e-9]), **shape)
    assert above_s > 2.0 * below_s
    assert saturation.overdrive_of_width(width_s=0.5 * (below_s + above_s), **shape) == pytest.approx(np.log(10.0))
    even = reference_electronics.width_at_level_s(
        level=0.1, signal=signal, saturation=np.inf, fwhm_s=FWHM_S, recovery_s=0.0
    )
    np.testing.assert_allclose(
        saturation.overdrive_of_symmetric_width(width_s=even, fwhm_s=FWHM_S), np.log(signal / 0.1), rtol=1e-12
    )


@pytest.mark.parametrize("recovery_ns", [None, 5.0])
@pytest.mark.parametrize("rays", ["one sub-echo", "several"])
@pytest.mark.parametrize("range_m", [5.0, 20.0])
def test_width_and_range_of_a_clipped_echo(range_m, rays, recovery_ns):
    """Rationale: what makers calibrate for. The pulse is as wide as the closed form says, and its range is right.

    Reference: (T45) and the true range. Noise: five standard errors; the level is that of a mean noise, which a
    curved edge makes wider by less than 0.5 %. Bias: the threshold's noise at TNR 5 on two curved flanks.
    """
    keys = [CLIPPED] + ([] if recovery_ns is None else [f"detector.recovery_ns={recovery_ns}"])
    sensor = chain.sensor("table1-apd", *keys)
    light = plane.echoes_of_plane(sensor, Target(reflectivity=0.8), np.full(SHOTS, range_m))
    pulse = np.arange(SHOTS, dtype=np.uint32)
    if rays == "several":
        whole = trains.train(
            range_m, light.peak_power_w[:, None] * [0.25, 0.75], background_w=light.background_power_w[0]
        )
        detection = receiver.detect(whole, sensor, seed=3, pulse=pulse)
    else:
        detection = receiver.detect(light, sensor, seed=3, pulse=pulse)
    point, stop = sensor.working_point(light.background_power_w), detection.stops[0]
    expected_s = reference_electronics.width_at_level_s(
        level=sensor.threshold(point)[0],
        signal=point.response.signal(light.peak_power_w)[0],
        saturation=50e-6,
        fwhm_s=FWHM_S,
        recovery_s=0.0 if recovery_ns is None else recovery_ns * 1e-9,
    )
    is_echo = stop.reported & (stop.status == 0)
    assert is_echo.mean() > 0.99
    error_s = 5.0 * stop.width_s[is_echo].std() / np.sqrt(SHOTS)
    assert stop.width_s[is_echo].mean() == pytest.approx(expected_s, abs=error_s + 5e-3 * expected_s)
    assert abs(stop.range_m[is_echo].mean() - range_m) < 0.02
    assert stop.amplitude[is_echo].max() == pytest.approx(50e-6)


@pytest.mark.parametrize("range_m", [3.0, 10.0, 30.0])
def test_ranges_of_a_full_sipm(range_m):
    """Rationale: near echoes fire all cells, whose number then tells no power. Reference: what is left by (T44),
    where the amplitude tells half a cell less than all; and nothing, where both edges are timed.

    Bias of the unsaturated flank's noise: 20 mm, one ninth of the standard deviation.
    """
    target, pulse = Target(reflectivity=0.8), np.arange(SHOTS, dtype=np.uint32)
    bias_m = {}
    for edges in ("rising", "both"):
        sensor = chain.sensor("table1-sipm", STEADY, f"tdc.edges='{edges}'")
        light = plane.echoes_of_plane(sensor, target, np.full(SHOTS, range_m))
        stop = receiver.detect(light, sensor, seed=3, pulse=pulse).stops[0]
        bias_m[edges] = (stop.range_m - range_m)[stop.status == 0].mean()
    point = sensor.working_point(light.background_power_w[:1])
    free = float(point.response.largest[0]) + 0.5
    assert point.response.signal(light.peak_power_w[:1])[0] > free - 0.5
    expected = reference_electronics.walk_bias_m(
        threshold=point.response.power_w(sensor.threshold(point))[0],
        signal=light.peak_power_w[0],
        saturation=-np.log(0.5 / free) * 400.0 / 0.22 * 2.0 * sensor.laser.photon_energy_j / FWHM_S,
        fwhm_s=FWHM_S,
    )
    assert expected < -0.2
    assert bias_m["rising"] == pytest.approx(expected, abs=0.02)
    assert abs(bias_m["both"]) < 0.02


def test_a_full_sipm_tells_the_power_of_half_a_cell_less():
    """Let n of N cells be free: -ln(0.5 / n) N / PDE photons, twice the pulse's mean power; the same above."""
    sensor = chain.sensor("table1-sipm", STEADY)
    point = sensor.working_point(np.array([2.5e-8]))
    free = point.response.largest[0] + 0.5
    full_w = -np.log(0.5 / free) * 400.0 / 0.22 * 2.0 * sensor.laser.photon_energy_j / FWHM_S
    for cells, power_w in ((free - 0.5, full_w), (free - 0.2, full_w), (free, full_w), (free - 1.0, None)):
        inferred_w = point.response.inferred_power_w(
            np.array([cells]), width_s=None, threshold=None, pulse_fwhm_s=FWHM_S
        )[0]
        expected = power_w or -np.log(1.0 / free) * full_w / -np.log(0.5 / free)
        assert inferred_w == pytest.approx(expected, rel=1e-9)


def test_width_of_noise_peaks():
    """Their mean is the time above the threshold over the number of crossings (Rice), to the first order in
    1 / TNR^2: 1 / 25 at TNR 5.
    """
    rate, tnr = 167e6, 5.0
    heights = tnr + np.random.default_rng(1).exponential(1.0 / tnr, 200_000)
    mean_s = tdc.excursion_width_s(height=heights, threshold=tnr, bandwidth_hz=rate).mean()
    rice = norm.sf(tnr) / tdc.rice_rate_hz(threshold=tnr, noise=1.0, bandwidth_hz=rate)
    assert mean_s == pytest.approx(rice, rel=1.0 / tnr**2)


@pytest.mark.parametrize("recovery_ns", [1.0, 8.0])
@pytest.mark.parametrize("signal", [0.5, 1.5, 20.0])
def test_the_course_of_a_lone_pulse_is_its_waveform(signal, recovery_ns):
    """Tolerance: 2 % of S, for the steps of 1/32 of the pulse; what is added later begins on top of what is held."""
    step_s = FWHM_S / 32
    time_s = step_s * np.arange(-96, 640)
    shape = {"saturation": 1.0, "recovery_s": 1e-9 * recovery_ns}
    light = signal * np.exp(-4.0 * math.log(2.0) * (time_s / FWHM_S) ** 2)
    course = saturation.clipped_course(signal=light[None], step_s=step_s, **shape)[0]
    lone = reference_electronics.clipped_waveform(time_s=time_s, signal=np.array(signal), fwhm_s=FWHM_S, **shape)
    # A step of the drain and the place of the release.
    np.testing.assert_allclose(course, lone, atol=0.02 + 1.5 * step_s / shape["recovery_s"] * (signal > 1.0))
    later = 0.2 * np.exp(-4.0 * math.log(2.0) * ((time_s - 8.0 * FWHM_S) / FWHM_S) ** 2)
    with_later = saturation.clipped_course(signal=(light + later)[None], step_s=step_s, **shape)[0]
    np.testing.assert_allclose(with_later - course, later * (course < 0.8), atol=0.02)


def test_charge_is_whole_until_it_drains():
    """All is held before the light has fallen back, however early; then a factor of e in each recovery time."""
    charge = saturation.remaining_charge(
        held=5.0, since_s=np.array([-20.0, 0.0, 2.0, 4.0]) * 1e-9, recovery_s=RECOVERY_S
    )
    np.testing.assert_allclose(charge, [5.0, 5.0, 5.0 / math.e, 5.0 / math.e**2])
