"""A day at 20 frames a second: times, directions, noise and numbers of pulses are as right as those of the first frame.

The numbers of pulses on the device begin again after 2^31, in whole frames: 13 minutes of an OS1-128.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import chain, launches
from helpers.run_seed import chosen

from lidarscene import Simulator, catalog
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats.packets.packet_encoder import head_deg
from lidarscene.maths.arrays import Numbers
from lidarscene.outputs.streams import missed_stream
from lidarscene.rendering.frame import PULSE_NUMBERS
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.studies.budget import pulses_of

DAY = 24 * 3600 * 20
"""Number of a frame a day later, at 20 Hz; with fewer frames a second it is later still."""

RASTER = ("scanner.azimuth_step_deg=0.6", "scanner.elevation_step_deg=0.6")


@pytest.mark.parametrize("name", catalog.names("sensors"))
def test_times_and_directions_of_every_sensor(name: str) -> None:
    """The time since the frame's start is the first frame's to a nanosecond.

    The mechanism a day later, with pulses counted from the last rollover, looks where pulses counted from frame 0 look.
    Where all frames are alike that is where the first frame looks.
    """
    scanner = load_sensor(name).scanner
    place = np.linspace(0, scanner.pulses - 1, 500).astype(np.int64)
    pulse = DAY * scanner.pulses + place
    since_s = scanner.time_s(pulse) - scanner.time_s(pulse[:1])
    np.testing.assert_allclose(since_s, scanner.time_s(place), rtol=0.0, atol=1e-9)
    assert scanner.time_s(pulse[:1])[0] == pytest.approx(DAY * scanner.frame_s, rel=1e-13)
    frames = PULSE_NUMBERS // scanner.pulses
    earlier = DAY // frames * frames * scanner.pulses
    moved = scanner.at_phase(scanner.phase(earlier))
    assert_look_alike(scanner.direction(pulse), moved.direction((pulse - earlier).astype(np.uint32)))
    np.testing.assert_array_equal(scanner.channel(pulse), moved.channel((pulse - earlier).astype(np.uint32)))
    if not scanner.phase(0):
        assert_look_alike(scanner.direction(pulse), scanner.direction(place))


def assert_look_alike(directions: Any, expected: Any) -> None:
    for component, reference in zip(directions, expected, strict=True):
        np.testing.assert_allclose(component, reference, rtol=0.0, atol=1e-6)


def noise_m(cloud: PointCloud, pulse: Numbers, pulses: int) -> Numbers:
    """(pulses,) error of the range of each pulse's echo; NaN without one."""
    echo = cloud.column("status") == 0
    noise = np.full(pulses, np.nan)
    noise[pulse[echo] % pulses] = (cloud.column("range") - cloud.column("true_range"))[echo]
    return noise


@pytest.mark.parametrize(
    ("name", "overrides"),
    chosen(1, [("table1-apd", RASTER), ("vlp-16", ()), ("livox-mid-360", ())]),
    ids=lambda value: str(value),
)
def test_frames_a_day_later(name: str, overrides: tuple[str, ...], mi: Any) -> None:
    """Nothing is compiled or recorded anew; points say what the scanner says in double precision; noise is new.

    Also against the frame of the last rollover before, whose pulses have the same numbers on the device.
    """
    simulator = Simulator(chain.scene(chain.ball(at=(0.0, 0.0, 0.0), radius_m=15.0)), chain.sensor(name, *overrides))
    scanner = simulator.sensor.scanner
    pulses, frames = scanner.pulses, PULSE_NUMBERS // scanner.pulses
    noise: list[Numbers] = []
    with launches.launched() as before:
        simulator.render(number=1, points=lambda *_: None)
    with launches.launched(after=before):
        for number in (0, DAY - frames, DAY):
            of_points: list[Numbers] = []
            cloud = simulator.render(number=number, points=lambda pulse, _, to=of_points: to.append(pulse))
            (pulse,) = of_points
            assert (pulse // pulses == number).all()
            off = cloud.azimuth_rad - np.asarray(scanner.angles(pulse)[0])
            assert np.abs(np.remainder(off + np.pi, 2.0 * np.pi) - np.pi).max() < 4e-6
            np.testing.assert_array_equal(cloud.channel, scanner.channel(pulse))
            first_s = scanner.time_s(np.array([number * pulses]))
            np.testing.assert_allclose(cloud.time_s, scanner.time_s(pulse) - first_s, rtol=0.0, atol=1e-9)
            np.testing.assert_array_equal(pulses_of(cloud, scanner), pulse)
            noise.append(noise_m(cloud, pulse, pulses))
    assert set(simulator._chain.recordings) == {1}
    first, middle, last = noise
    count = np.isfinite(last).sum()
    assert count == pytest.approx(np.isfinite(first).sum(), abs=0.02 * count)
    assert np.nanstd(last) == pytest.approx(np.nanstd(first), rel=0.1)
    assert abs(np.nanmean(last) - np.nanmean(first)) < 6.0 * np.nanstd(first) / np.sqrt(count / 2)
    for other in (first, middle):
        both = np.isfinite(last) & np.isfinite(other)
        assert both.sum() > 0.5 * count
        assert abs(np.corrcoef(last[both], other[both])[0, 1]) < 6.0 / np.sqrt(both.sum())


def test_what_numbers_pulses(mi: Any, tmp_path: Path) -> None:
    """Missed pulses, background and waveforms a day later: 64-bit numbers that go on from frame to frame."""
    simulator = Simulator(chain.scene(chain.facing(range_m=20.0)), chain.sensor("table1-apd", *RASTER))
    scanner = simulator.sensor.scanner
    first = DAY * scanner.pulses
    missed: list[Numbers] = []
    ambient: list[Numbers] = []
    with missed_stream(tmp_path / "missed.npz", simulator.sensor) as append:

        def take(pulse: Numbers, outcome: Numbers) -> None:
            missed.append(pulse)
            append(pulse, outcome)

        simulator.render(number=DAY, missed=take, ambient=lambda pulse, _: ambient.append(pulse))
    np.testing.assert_array_equal(np.concatenate(ambient), first + np.arange(scanner.pulses))
    with np.load(tmp_path / "missed.npz") as file:
        np.testing.assert_array_equal(file["pulse"], np.concatenate(missed))
        assert 0 <= file["time_s"].min() <= file["time_s"].max() < scanner.frame_s
        np.testing.assert_array_equal(file["channel"], scanner.channel(file["pulse"] - first))
    waveforms = simulator.waveforms([3, 70], number=DAY)
    np.testing.assert_array_equal(waveforms.pulse, [first + 3, first + 70])
    np.testing.assert_allclose(waveforms.signal, simulator.waveforms([3, 70]).signal, rtol=1e-6)


def test_histograms_have_noise_of_their_own(mi: Any) -> None:
    """Counts of a waveform are those of its frame; one rollover before, the device numbers its pulse the same."""
    simulator = Simulator(chain.scene(chain.facing(range_m=20.0)), chain.sensor("rs-e1"))
    frames = PULSE_NUMBERS // simulator.sensor.scanner.pulses
    chosen = range(simulator.sensor.scanner.pulses // 2, simulator.sensor.scanner.pulses // 2 + 50)
    day, earlier, again = (simulator.waveforms(chosen, number=n).counts for n in (DAY, DAY - frames, DAY))
    np.testing.assert_array_equal(day, again)
    counted = (day > 0) | (earlier > 0)
    assert np.mean(day[counted] != earlier[counted]) > 0.5


def test_heads_in_packets() -> None:
    """Firings are counted in 64 bits: the azimuth of a packet is that of the cloud's points."""
    scanner: Any = load_sensor("vlp-16").scanner
    firing = 2**33 + 12_345 + np.arange(50)
    azimuth = np.degrees(scanner.angles(firing * scanner.lasers)[0])
    off = head_deg(scanner, firing) - azimuth
    assert np.abs(np.remainder(off + 180.0, 360.0) - 180.0).max() < 1e-4
