"""Stray light of channels that fire together, on trains by hand."""

import dataclasses

import numpy as np
import pytest
from helpers import photons, trains, volley
from helpers.mistakes import told
from helpers.trains import detect

from lidarscene.detection import receiver
from lidarscene.detection.outcomes import Outcome, Status
from lidarscene.kernel.device import transfer
from lidarscene.light.echoes import Echoes
from lidarscene.light.stray_light import Crosstalk, add_stray_light, channel_light, reaches_others
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S

SENSOR = volley.sensor()
ROWS = volley.LASERS
RANDOM = np.random.default_rng(12)
SIGMA_M = 0.5 * SPEED_OF_LIGHT_M_S * 4e-9 / 2.3548200450309493


def shares():
    """(T122) of the helper's head, typed out: a degree from row to row."""
    apart = np.abs(np.arange(ROWS)[:, None] - np.arange(ROWS))
    return np.where(apart > 0, 1e-4 + 1e-3 / (1.0 + (apart / 2.0) ** 2), 0.0)


def with_stray(train, sensor=SENSOR, crosstalk=None, pulse=None):
    """The train of whole lines with the light of other channels."""
    crosstalk = crosstalk or Crosstalk.from_sensor(sensor)
    light = channel_light(train, crosstalk)
    pulse = np.arange(len(light.power_w), dtype=np.uint32) if pulse is None else pulse
    return add_stray_light(train, light, crosstalk, pulse=pulse)


def stray_of(train, **options):
    """Range and power of the stray light of each pulse."""
    part = with_stray(train, **options).parts[-1]
    return np.asarray(part.range_m), np.asarray(part.peak_power_w)


def test_a_sign_is_a_wall_in_every_neighbour():
    """One bright channel of the second of three lines: its range in all others of that line, with their shares of its
    power, and nothing in other lines or in itself.
    """
    power = np.zeros((3 * ROWS, 1))
    power[ROWS + 5] = 1e-3
    range_m, stray_w = stray_of(trains.train(37.0, power))
    expected = np.zeros((3, ROWS))
    expected[1] = 1e-3 * shares()[:, 5]
    np.testing.assert_allclose(stray_w.reshape(3, ROWS), expected, rtol=1e-5)
    np.testing.assert_array_equal(range_m[stray_w > 0.0], 37.0)


def test_light_is_conserved():
    """Nothing of the stray light is lost at one range: it adds up to the sum of all powers, each with the shares of all
    others, to the rounding of single precision in the table's directions.
    """
    power = RANDOM.exponential(size=(4 * ROWS, 1))
    _, stray_w = stray_of(trains.train(50.0, power))
    assert stray_w.sum() == pytest.approx((power.reshape(4, ROWS) * shares().sum(axis=0)).sum(), rel=1e-5)


@pytest.mark.parametrize(
    ("overrides", "sigma_m"),
    [((), SIGMA_M), (("receiver.response='gaussian'", "tdc.bandwidth_mhz=47.9404567"), 2.0 * SIGMA_M)],
)
def test_light_from_several_ranges(overrides, sigma_m):
    """Sources spread over some widths of the pulse: the range of the strongest, and the sum of Gaussians there, which
    is the second road: pulse by pulse, (T123) written out. The low pass makes pulses twice as long.
    """
    power, place = RANDOM.exponential(size=(2, ROWS)), 50.0 + RANDOM.normal(scale=2.0 * SIGMA_M, size=(2, ROWS))
    range_m, stray_w = stray_of(
        trains.train(place.reshape(-1, 1), power.reshape(-1, 1)), sensor=volley.sensor(*overrides)
    )
    for line in range(2):
        for row in range(ROWS):
            reached = shares()[row] * power[line]
            strongest = place[line][np.argmax(reached)]
            course = np.sum(reached * np.exp(-0.5 * ((place[line] - strongest) / sigma_m) ** 2))
            assert range_m[line * ROWS + row] == strongest
            assert stray_w[line * ROWS + row] == pytest.approx(course, rel=1e-5)


def test_several_echoes_of_a_channel_are_one():
    """Others see the wall's of a source's echoes: of that, and of a weaker one four metres before it. Two halves at one
    range are a whole, and of an echo a deviation of the pulse behind them exp(-1/2) is there at their time.
    """
    ranges = np.tile([[16.0, 20.0, 20.0 + SIGMA_M, 20.0]], (ROWS, 1))
    powers = np.zeros((ROWS, 4))
    powers[3] = 0.9e-3, 1e-3, 0.8e-3, 1e-3
    range_m, stray_w = stray_of(trains.train(ranges, powers))
    np.testing.assert_allclose(stray_w, (2e-3 + 0.8e-3 * np.exp(-0.5)) * shares()[:, 3], rtol=1e-5)
    np.testing.assert_array_equal(range_m[stray_w > 0.0], 20.0)


def test_light_of_the_air_stays_with_its_channel():
    """Drops are sub-echoes that are no surfaces: the other channels do not see them."""
    train = trains.train(np.tile([[20.0, 5.0]], (ROWS, 1)), np.tile([[0.0, 1.0]], (ROWS, 1)))
    assert (stray_of(dataclasses.replace(train, surfaces=1))[1] == 0.0).all()


def test_lines_without_strong_echoes_are_left_alone():
    """Where no echo is that strong, the stray light of every channel is below a tenth of what it finds in the dark."""
    crosstalk = Crosstalk.from_sensor(SENSOR)
    point = SENSOR.working_point(np.zeros(1))
    dark_w = float(np.ravel(point.response.power_w(SENSOR.threshold(point)))[0])
    weak = trains.train(50.0, np.full((ROWS, 1), 0.999 * crosstalk.least_w))
    assert 0.09 * dark_w < stray_of(weak)[1].max() < 0.1 * dark_w
    for factor, reaches in ((0.999, False), (1.001, True)):
        ray = Echoes(
            has_surface=np.ones(1, bool),
            range_m=np.full(1, 50.0),
            peak_power_w=np.full(1, factor * crosstalk.least_w),
            background_power_w=np.zeros(1),
        )
        assert np.all(reaches_others([ray], crosstalk) == reaches)


def test_faint_echoes_add_nothing_to_a_bright_line():
    """A channel that a line has for its brightness, and all others just below and just above the power from which on
    they count. Left out is less than a hundredth of what a detector finds in the dark, for each channel.
    """
    crosstalk = Crosstalk.from_sensor(SENSOR)
    point = SENSOR.working_point(np.zeros(1))
    dark_w = float(np.ravel(point.response.power_w(SENSOR.threshold(point)))[0])
    power = np.zeros((ROWS, 1))
    power[5] = 2.0 * crosstalk.least_w
    _, alone_w = stray_of(trains.train(50.0, power))
    added_w = []
    for factor in (0.999, 1.001):
        _, stray_w = stray_of(trains.train(50.0, np.where(power > 0.0, power, factor * crosstalk.faint_w)))
        added_w.append(stray_w - alone_w)
    assert (added_w[0] == 0.0).all()
    others = shares().sum(axis=1) - shares()[:, 5]
    np.testing.assert_allclose(added_w[1], 1.001 * crosstalk.faint_w * others, rtol=1e-3)
    assert 0.005 * dark_w < added_w[1].max() < 0.0101 * dark_w


def test_stray_light_that_is_too_faint_to_compute_is_none():
    """Single precision loses the peak's shape of a millionth of the least power that a detector finds in the dark: a
    sub-echo of 1e-18 W made the receiver miss strong ones. (A neighbour gets 7e-12 W with a share of 1e-5.)
    """
    power = np.zeros((ROWS, 1))
    power[5] = 1e-6
    for share, is_lit in ((1e-12, False), (1e-5, True)):
        sensor = volley.sensor(f"optics.stray.share={share}", "optics.stray.veil=0")
        _, stray_w = stray_of(trains.train(37.0, power), sensor=sensor, crosstalk=Crosstalk.from_sensor(sensor))
        assert (stray_w[4] > 0.0) == is_lit


@pytest.mark.parametrize("keys", [(), ("tdc.keep='strongest'",), ("tdc.timing='peak'", "tdc.keep='last'")])
def test_points_of_stray_light(keys):
    """Ten channels see nothing of their own, five a wall of 0.1 uW at 70 m, one a sign of 1 mW at 30 m: all have a
    point at 30 m, of stray light but for the sign's own; walls stay echoes. An APD with a threshold of 8 sigma finds
    1e-7 W surely and has no false alarms (1e-15 a comparison).
    """
    sensor = volley.sensor(*keys)
    ranges, powers = np.full((ROWS, 1), 70.0), np.zeros((ROWS, 1))
    powers[11:] = 1e-6
    ranges[5], powers[5] = 30.0, 1e-3
    train = with_stray(trains.train(ranges, powers), sensor)
    detection = detect(train, sensor, seed=3)
    status = np.stack([np.where(stop.reported, stop.status, -1) for stop in detection.stops])
    at_m = np.stack([stop.range_m for stop in detection.stops])
    true_m = np.stack([stop.true_range_m for stop in detection.stops])
    stray = status == Status.STRAY
    dark = np.arange(ROWS) != 5
    assert (stray.sum(axis=0) == dark).all()
    np.testing.assert_allclose(at_m[stray], 30.0, atol=0.2)
    np.testing.assert_allclose(true_m[stray], 30.0, atol=1e-3)
    echo = status == Status.ECHO
    assert (echo.sum(axis=0)[11:] == 1).all()
    np.testing.assert_allclose(at_m[:, 11:][echo[:, 11:]], 70.0, atol=0.3)
    assert echo.sum() == ROWS - 11 + 1
    assert (detection.outcome[:5] == Outcome.NO_SURFACE).all()
    assert (detection.outcome[11:] == Outcome.KEPT).all()


def test_points_of_stray_light_in_a_histogram():
    """SPADs that sum shots, two returns a point: a sign that fires all of them at 30 m, walls of 300 photons at 70 m in
    five channels. Each channel but the sign's has a return of stray light of its expected photons, 400 and more: within
    five standard errors, so that one run in 100,000 fails. Walls stay echoes.
    """
    sensor = photons.spinning(
        f"scanner.elevation_deg={[float(row) for row in range(ROWS)]}",
        "scanner.columns_per_turn=1024 histogram.stops=2 histogram.threshold_floor=20 detector.spads=4096",
        "optics.stray.share=1e-2 optics.stray.half_angle_deg=2 optics.stray.veil=1e-3",
    )
    point = sensor.working_point(np.zeros(1))
    wall_w, least_w = (float(np.ravel(point.response.power_w(np.array([count])))[0]) for count in (300.0, 400.0))
    sign_w = least_w / (10.0 * shares()[15, 5])
    ranges, powers = np.full((ROWS, 1), 70.0), np.zeros((ROWS, 1))
    powers[11:] = wall_w
    ranges[5], powers[5] = 30.0, sign_w
    train = with_stray(trains.train(ranges, powers, background_w=0.0), sensor)
    detection = detect(train, sensor, seed=3)
    status = np.stack([np.where(stop.reported, stop.status, -1) for stop in detection.stops])
    stray = status == Status.STRAY
    dark = np.arange(ROWS) != 5
    assert (stray.sum(axis=0) == dark).all()
    assert ((status == Status.ECHO).sum(axis=0) == ((np.arange(ROWS) == 5) | (np.arange(ROWS) > 10))).all()
    counted = np.stack([stop.amplitude for stop in detection.stops])[stray]
    expected = np.broadcast_to(point.response.signal(train.parts[-1].peak_power_w), stray.shape)[stray]
    assert np.abs((counted - expected) / np.sqrt(expected)).max() < 5.0
    np.testing.assert_allclose(np.stack([stop.range_m for stop in detection.stops])[stray], 30.0, atol=0.2)


def glare(*keys, sign=5):
    """A head that withholds beside 500 photons, within 2.5 m; a sign of 3,000 photons in a channel at 30 m, walls of 40
    photons in the others, a metre farther from row to row.

    Returns:
        the sensor, the train and the ranges
    """
    sensor = photons.spinning(
        f"scanner.elevation_deg={[float(row) for row in range(ROWS)]}",
        "scanner.columns_per_turn=1024 detector.spads=4096 optics.stray.share=0",
        "optics.stray.glare_photons=500 optics.stray.glare_reach_m=2.5",
        *keys,
    )
    point = sensor.working_point(np.zeros(1))
    sign_w, wall_w = (float(np.ravel(point.response.power_w(np.array([count])))[0]) for count in (3000.0, 40.0))
    ranges, powers = 30.0 + 1.0 * (np.arange(ROWS) - sign)[:, None], np.full((ROWS, 1), wall_w)
    powers[sign] = sign_w
    return sensor, trains.train(ranges, powers, background_w=0.0), ranges[:, 0]


def withheld_beside(sensor, train, pulse, crosstalk=None):
    """Detection of whole lines without what lies beside a glaring echo."""
    crosstalk = crosstalk or Crosstalk.from_sensor(sensor)
    light = channel_light(train, crosstalk)
    whole = add_stray_light(train, light, crosstalk, pulse=pulse)
    return receiver.detect(whole, sensor, seed=3, pulse=pulse, channels=light, crosstalk=crosstalk)


def test_returns_beside_a_glaring_one_are_withheld():
    """(T200): walls within 2.5 m of the sign are hidden, those beyond and the sign are kept. Reported ranges scatter by
    60 mm, an eighth of what is left to the edge. With a wall in the place of the sign all are kept.
    """
    sensor, train, ranges = glare()
    pulse = np.arange(ROWS, dtype=np.uint32)
    detection = withheld_beside(sensor, train, pulse)
    hidden = (np.abs(ranges - 30.0) < 2.5) & (np.arange(ROWS) != 5)
    assert hidden.sum() == 4
    np.testing.assert_array_equal(detection.stops[0].reported, ~hidden)
    np.testing.assert_array_equal(detection.outcome, np.where(hidden, Outcome.HIDDEN, Outcome.KEPT))
    dim = dataclasses.replace(train.parts[0], peak_power_w=np.full(ROWS, train.parts[0].peak_power_w.min()))
    without_sign = withheld_beside(sensor, dataclasses.replace(train, parts=(dim,)), pulse)
    assert without_sign.stops[0].reported.all()


def test_only_a_glaring_echo_of_the_same_volley_hides_others():
    """Rows 0 to 3 of a column fire 4 us before the others: a sign in row 10 hides all of these, and not row 3, whose
    range is near enough.
    """
    times = [0.0] * 4 + [4.0] * (ROWS - 4)
    sensor, train, _ = glare(f"scanner.firing_time_us={times}", "optics.stray.glare_reach_m=7.5", sign=10)
    detection = withheld_beside(sensor, train, np.arange(ROWS, dtype=np.uint32))
    np.testing.assert_array_equal(np.flatnonzero(~detection.stops[0].reported), [4, 5, 6, 7, 8, 9, 11, 12, 13, 14, 15])


def test_glaring_echoes_have_their_lines_traced_together():
    """These lines would be left to themselves without stray light: a sign's photons call for them, a wall's do not."""
    sensor, train, _ = glare()
    crosstalk = Crosstalk.from_sensor(sensor)
    part = train.parts[0]
    echoes = Echoes(
        has_surface=train.has_surface,
        range_m=part.range_m,
        peak_power_w=part.peak_power_w,
        background_power_w=train.background_power_w,
    )
    np.testing.assert_array_equal(reaches_others([echoes], crosstalk), np.arange(ROWS) == 5)


def test_glare_is_the_same_on_the_device(mi):
    """Kept and withheld on NumPy and Dr.Jit."""
    sensor, train, _ = glare()
    pulse = np.arange(ROWS, dtype=np.uint32)
    host = withheld_beside(sensor, train, pulse)
    crosstalk = transfer.opaque(Crosstalk.from_sensor(sensor))
    device = withheld_beside(transfer.opaque(sensor), trains.on_device(train), transfer.counter(0, ROWS), crosstalk)
    np.testing.assert_array_equal(device.stops[0].reported.numpy(), host.stops[0].reported)


def test_more_photons_than_spads_count_never_glare():
    """4096 SPADs in 54 shots count 221,184 at most, so no echo glares from 1e6 on."""
    sensor, train, _ = glare("optics.stray.glare_photons=1e6")
    assert Crosstalk.from_sensor(sensor).glare_w == np.inf
    assert withheld_beside(sensor, train, np.arange(ROWS, dtype=np.uint32)).stops[0].reported.all()


def test_glare_needs_photons():
    with told("optics.stray.glare_photons | [histogram]"):
        volley.sensor("optics.stray.glare_photons=500")


def test_stray_light_on_top_of_an_echo_is_an_echo_while_it_is_less():
    """The range is the sign's own: a wall brighter than the stray light stays an echo; one dimmer than it becomes a
    point of stray light at the same place.
    """
    ranges, powers = np.full((ROWS, 1), 30.0), np.zeros((ROWS, 1))
    powers[5] = 1e-2
    reached = 1e-2 * shares()[:, 5]
    powers[6], powers[7] = 2.0 * reached[6], 0.5 * reached[7]
    train = with_stray(trains.train(ranges, powers))
    detection = detect(train, SENSOR, seed=3)
    status = detection.stops[0].status
    assert status[[5, 6, 7]].tolist() == [Status.ECHO, Status.ECHO, Status.STRAY]
