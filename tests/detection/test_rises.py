"""Rises of waveforms with light of the air: where the first one begins, against fine bins."""

import numpy as np
import pytest
from helpers import trains
from scipy.constants import c

from lidarscene import load_sensor
from lidarscene.light.waveform import sample_power_and_signal
from lidarscene.maths import random as noise
from lidarscene.physics.electronics import pulse_sums, tdc

RAW = "tdc.walk='raw'"
LENSES = {
    "top hat": ("laser.peak_power_w=1000", "laser.pulse_fwhm_ns=2"),
    "gaussian": (
        "laser.beam_profile='gaussian'",
        "laser.peak_power_w=150",
        "optics.overlap.transmitter_offset_mm=[60, 0]",
    ),
    "coaxial": ("optics.overlap.transmitter_offset_mm=[0, 0]", "laser.peak_power_w=0.35"),
}


@pytest.mark.parametrize("lenses", LENSES)
def test_fog_is_crossed_where_it_reaches_the_level(lenses):
    """Fog seen by two lenses rises convexly over metres before its first concave place. Reference: bins of a
    250th of a pulse, and the level that each pulse's own noise sets. Tolerance: straight lines between bins.
    All ranges differ, since the noise does.
    """
    equipped = load_sensor("biaxial-905", overrides=[RAW, *LENSES[lenses]])
    count = 60
    light = trains.in_fog(equipped, 10.0 ** np.linspace(-0.3, 0.3, count))
    stop = trains.detect(light, equipped).stops[0]
    fwhm = equipped.laser.pulse_fwhm_s
    time_s = np.arange(-4.0 * fwhm, 2.0 * 25.0 / c, 4e-3 * fwhm)
    _, signal = sample_power_and_signal(light, equipped, time_s)
    point = equipped.working_point(light.background_power_w)
    words = noise.words(seed=0, stage=1, pulse=np.arange(count), draw=0)
    level = tdc.crossing_level(
        threshold=equipped.threshold(point),
        deviate=noise.normal_pair(words)[0],
        noise=point.noise.deviation,
        kappa_1=point.noise.kappa_1,
        kappa_2=point.noise.kappa_2,
    )
    # A range before 0, of light that came back while the pulse was still leaving, is reported as 0.
    judged = np.flatnonzero(stop.reported & (stop.range_m > 0.0))
    assert len(judged) > count // 4
    assert len(np.unique(stop.range_m[judged])) == len(judged)
    for pulse in judged:
        edge = int(np.argmax(signal[pulse] >= level[pulse]))
        crossed = np.interp(level[pulse], signal[pulse, edge - 1 : edge + 1], time_s[edge - 1 : edge + 1])
        assert stop.range_m[pulse] == pytest.approx(0.5 * c * crossed, abs=2e-4)


@pytest.mark.parametrize("name", ["vlp-16", "table1-apd"])
def test_a_lone_echo_needs_no_search(name):
    """What a receiver makes of pulses with one echo is what it makes of them with a second one without light.

    From echoes below the threshold to clipped ones; pulses without an echo among them. Tolerance: the search finds
    the peak to 1e-10 of a pulse's width.
    """
    equipped = load_sensor(name, overrides=["tdc.keep='last'"])
    peak_w = 10.0 ** np.linspace(-9.0, -2.0, 400)
    peak_w[::10] = 0.0
    range_m = np.linspace(2.0, 90.0, len(peak_w))
    alone = trains.detect(trains.train(range_m[:, None], peak_w[:, None]), equipped)
    nothing = np.zeros_like(peak_w)
    searched = trains.detect(
        trains.train(np.stack([range_m, nothing], axis=1), np.stack([peak_w, nothing], axis=1)), equipped
    )
    assert 100 < np.sum(alone.stops[0].reported) < 380
    for field in ("reported", "status", "range_m", "amplitude", "intensity", "snr", "detection_probability", "source"):
        direct, by_search = (getattr(detection.stops[0], field) for detection in (alone, searched))
        np.testing.assert_allclose(direct, by_search, rtol=1e-8, err_msg=field)
    np.testing.assert_array_equal(alone.outcome, searched.outcome)
    np.testing.assert_allclose(alone.detection_probability, searched.detection_probability, rtol=1e-8)


def test_the_search_does_not_stop_where_the_air_begins():
    """A course that is exactly zero up to 0 and then u^2, with differences over a step for its slope, as a table has.

    The first guess is the middle of the bracket, at -0.3: the light there is nothing and its slope is not. Newton's
    step from there is no step at all, and a search that trusts it ends on the spot.
    """

    def course(place):
        return np.maximum(place, 0.0) ** 2

    def shape(place):
        before, centre, after = course(place - 0.5), course(place), course(place + 0.5)
        return centre, after - before, 4.0 * (after - 2.0 * centre + before)

    peak = np.array([10.0])
    top = (course(peak), np.zeros(1), np.array([-1e-3]))
    place = pulse_sums.crossing(
        shape, np.array([50.0]), far=np.array([-10.6]), peak=peak, top=top, mask=np.array([True])
    )
    assert place[0] == pytest.approx(np.sqrt(50.0), abs=1e-4)
