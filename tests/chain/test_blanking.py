"""Blanking: what crosses before the converter listens is not there, echo or alarm, on numpy."""

import math

import numpy as np
import pytest
from helpers import trains
from helpers.run_seed import chosen

from lidarscene.detection.outcomes import Outcome, Status
from lidarscene.light.echoes import Echoes
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics import tdc

BLANKING_NS = 40.0
SHORTEST_M = 0.5 * SPEED_OF_LIGHT_M_S * BLANKING_NS * 1e-9  # 5.996 m


def one_echo(range_m, power_w, equipped):
    """The same through the closed form of a lone pulse."""
    of_each = np.full(200, range_m)
    light = Echoes(
        has_surface=of_each > 0.0,
        range_m=of_each,
        peak_power_w=0.0 * of_each + power_w,
        background_power_w=0.0 * of_each + trains.BACKGROUND_W,
    )
    return trains.detect(light, equipped, seed=0)


def one_of_many(range_m, power_w, equipped):
    return trains.detect(trains.train(np.full((200, 1), range_m), power_w), equipped)


@pytest.mark.parametrize("road", [one_echo, one_of_many])
def test_the_shortest_range_is_half_the_way_that_light_goes(road):
    """An echo whose edge crosses 0.1 ns (15 mm) before the end of the blanking is lost, 0.1 ns later it is there.

    No noise that matters: 300 times the noise over a threshold of 50.
    """
    plain = trains.sensor("table1-apd", *trains.QUIET, "tdc.walk='raw'", "tdc.jitter_ps=0", "tdc.lsb_ps=0")
    blind = trains.sensor("table1-apd", *trains.QUIET, f"tdc.blanking_ns={BLANKING_NS}", "tdc.walk='raw'")
    # Of the strong edge: how far before its peak it crosses, from the sensor without blanking.
    power = trains.power_at_snr(plain, 300.0)
    free = road(20.0, power, plain)
    early_m = 20.0 - np.asarray(free.stops[0].range_m)
    ranges = SHORTEST_M + early_m.max() + 0.015, SHORTEST_M + early_m.min() - 0.015
    after, before = (road(r, power, blind) for r in ranges)
    assert np.all(after.outcome == Outcome.KEPT)
    assert np.all(before.outcome == Outcome.OUT_OF_WINDOW)
    assert not np.any(before.stops[0].reported)


def test_a_blanked_echo_takes_no_stop_and_starts_no_dead_time():
    options = [*trains.QUIET, f"tdc.blanking_ns={BLANKING_NS}", "tdc.dead_time_ns=100"]
    equipped = trains.sensor("table1-apd", *options)
    power = trains.power_at_snr(equipped, 300.0)
    detection = trains.detect(trains.train(np.tile([[3.0, 10.0]], (50, 1)), power), equipped)
    assert np.all(detection.stops[0].reported)
    # Within 5 cm: jitter of an edge 250 noises above the threshold is a tenth of that.
    np.testing.assert_allclose(detection.stops[0].range_m, 10.0, atol=0.05)
    sighted = trains.sensor("table1-apd", *trains.QUIET, "tdc.dead_time_ns=100", "tdc.stops=2")
    first = trains.detect(trains.train(np.tile([[3.0, 10.0]], (50, 1)), power), sighted)
    np.testing.assert_allclose(first.stops[0].range_m, 3.0, atol=0.05)
    assert not np.any(first.stops[1].reported)


@pytest.mark.parametrize("keep", ["first", "last", "strongest"])
def test_alarms_come_only_while_the_converter_listens(keep):
    """Quiet with exp(-lambda (window - blanking)) and never before. Threshold 3 of the noise, half of the window blind.

    20 000 pulses; 4.5 sigma of a share: 7e-6 false alarms a test.
    """
    options = ["tdc.threshold_to_noise=3", "tdc.window_us=4", "tdc.blanking_ns=2000", f"tdc.keep='{keep}'"]
    equipped = trains.sensor("table1-apd", *options)
    pulses = 20_000
    detection = trains.detect(trains.train(np.full((pulses, 1), 20.0), 0.0), equipped, seed=5)
    point = equipped.working_point(np.array([trains.BACKGROUND_W]))
    p_false = point.false_alarm_probability(equipped.threshold(point))
    rate = float(tdc.false_alarm_rate_hz(p_false=p_false, bandwidth_hz=equipped.tdc.bandwidth_hz)[0])
    quiet = math.exp(-rate * 2e-6)
    assert 0.05 < quiet < 0.95
    reported = np.asarray(detection.stops[0].reported)
    assert abs(np.mean(~reported) - quiet) < 4.5 * math.sqrt(quiet * (1.0 - quiet) / pulses)
    times = 2.0 / SPEED_OF_LIGHT_M_S * np.asarray(detection.stops[0].range_m)[reported]
    assert times.min() >= 2e-6
    assert times.max() < 4e-6
    assert np.all(np.asarray(detection.stops[0].status)[reported] == Status.FALSE_ALARM)


def test_no_blanking_is_the_default_and_takes_crossings_before_time_zero():
    """An echo from 0.3 m: its edge crosses before the middle of its pulse has left."""
    equipped = trains.sensor("table1-apd", *trains.QUIET)
    assert equipped.tdc.blanking_s == 0.0
    detection = trains.detect(trains.train(np.full((20, 1), 0.3), trains.power_at_snr(equipped, 3000.0)), equipped)
    assert np.all(detection.stops[0].reported)


@pytest.mark.parametrize("road", [one_echo, one_of_many])
def test_no_echo_has_the_range_zero(road):
    """Rationale: a converter counts from the pulse, and 0 stands for no return in makers' formats. A strong echo from
    0.2 m crosses 2 sigma, 0.7 m of range, before its peak: raw, its time would be before the pulse.
    """
    plain = trains.sensor("table1-apd", *trains.QUIET, "tdc.walk='raw'")
    power = trains.power_at_snr(plain, 300.0)
    detection = road(0.2, power, plain)
    assert np.all(detection.outcome == Outcome.OUT_OF_WINDOW)
    assert not np.any(detection.stops[0].reported)
    corrected = trains.sensor("table1-apd", *trains.QUIET)
    again = road(0.2, power, corrected)
    # Six deviations of the walk-corrected edge, 11.5 mm.
    np.testing.assert_allclose(again.stops[0].range_m[again.stops[0].reported], 0.2, atol=0.07)
    assert np.all(again.stops[0].reported)


@pytest.mark.parametrize("sampler", [[], ["tdc.keep='strongest'"]])
def test_what_comes_before_the_pulse_takes_no_stop(sampler):
    """The converter sees a blanked echo: the second one is the first that is reported."""
    plain = trains.sensor("table1-apd", *trains.QUIET, "tdc.walk='raw'", "tdc.dead_time_ns=100", *sampler)
    power = trains.power_at_snr(plain, 300.0)
    detection = trains.detect(trains.train(np.tile([[0.2, 10.0]], (50, 1)), power), plain)
    assert np.all(detection.stops[0].reported)
    assert np.all(np.abs(np.asarray(detection.stops[0].range_m) - 9.5) < 0.5)


@pytest.mark.parametrize("name", chosen(1, ["table1-sipm", "os1-128", "mems-1550"]))
def test_fog_piles_no_points_up_at_zero(name):
    """Rationale: light of fog in front of the lens is strongest near it, and noise moves it across the pulse."""
    equipped = trains.sensor(name, *(["histogram.blanking_ns=0"] if "os1" in name else []))
    light = trains.in_fog(equipped, np.geomspace(0.3, 30.0, 400))
    detection = trains.detect(light, equipped, seed=3)
    reported = np.asarray(detection.stops[0].reported)
    assert reported.sum() > 40
    assert np.asarray(detection.stops[0].range_m)[reported].min() > 0.0


@pytest.mark.parametrize("name", ["os0-128", "os1-128"])
def test_an_ouster_sees_through_the_fog_before_its_window(name):
    """Rationale: light that the lens scatters makes the fog of the first centimetres its strongest echo, from which the
    least range of 30 cm keeps it. A wall of 50 % in 8 m behind it is found by most pulses, within 0.3 m.
    """
    equipped = trains.sensor(name)
    light = trains.in_fog(equipped, np.ones(200), wall_m=8.0, reflectivity=0.5)
    near, shielded = (
        trains.detect(light, sensor, seed=3).stops[0]
        for sensor in (trains.sensor(name, "histogram.blanking_ns=0"), equipped)
    )
    assert np.median(np.asarray(near.range_m)[np.asarray(near.reported)]) < 0.3
    found = np.asarray(shielded.range_m)[np.asarray(shielded.reported)]
    assert len(found) > 100
    np.testing.assert_allclose(found, 8.0, atol=0.3)


@pytest.mark.parametrize("snr", [100.0, 4000.0])
def test_the_window_bounds_the_crossing(snr):
    """Rationale: a window of 60 ns is 9.0 m for a weak echo; the edge of a strong one comes earlier, by
    t = FWHM sqrt(ln(P / P_U) / (4 ln 2)), and its middle may lie as much behind. Tolerance: 1 cm, a step of the boards,
    and 7 cm for noise of a fiftieth of the threshold.
    """
    equipped = trains.sensor("table1-apd", "tdc.window_us=0.06", "tdc.lsb_ps=0", "tdc.jitter_ps=0", *trains.QUIET)
    range_m = np.arange(8.5, 11.5, 0.01)
    light = trains.train(range_m[:, None], np.full((len(range_m), 1), trains.power_at_snr(equipped, snr)))
    found_m = range_m[np.asarray(trains.detect(light, equipped).stops[0].reported)]
    early_s = trains.FWHM_S * math.sqrt(math.log(snr / 50.0) / (4.0 * math.log(2.0)))
    last_m = 0.5 * SPEED_OF_LIGHT_M_S * (60e-9 + early_s)
    spread_m = 0.5 * SPEED_OF_LIGHT_M_S * trains.FWHM_S / 50.0 * 4.0
    assert found_m.max() == pytest.approx(last_m, abs=0.01 + spread_m)
