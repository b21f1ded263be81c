"""`render --waveforms` and `--ambient`: what the files hold, frame by frame, and mistakes."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BEAMS, COARSE, Run
from PIL import Image

from lidarscene.outputs.light import AmbientImage
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.sensor.sensor_model import Sensor

pytestmark = pytest.mark.usefixtures("mi")


def test_waveforms_of_chosen_pulses(run: Run, wall: str, tmp_path: Path) -> None:
    """Pulse 115 of the coarse raster is on the wall, 10 m off; pulse 0 in the sky."""
    options = ("--waveforms", "w.npz", "--pulses", "115,0,2-4", "--json")
    ran = run("render", wall, "-o", "a.npz", *options, *COARSE)
    assert (ran.code, ran.err) == (0, "")
    assert json.loads(ran.out)["waveforms"] == "w.npz"
    with np.load(tmp_path / "w.npz") as archive:
        waveforms = dict(archive)
    assert waveforms["pulse"].tolist() == [0, 2, 3, 4, 115]
    assert waveforms["power_w"].shape == waveforms["signal"].shape == (5, len(waveforms["time_s"]))
    peak = waveforms["signal"].argmax(axis=1)
    # A sample is 0.056 m long.
    assert waveforms["range_m"][peak[4]] == pytest.approx(10.0, abs=0.06)
    assert waveforms["signal"][4].max() > waveforms["threshold"][4]
    assert not waveforms["power_w"][0].any()
    assert str(waveforms["unit"]) == "A"


def test_a_few_pulses_of_each_frame(run: Run, wall: str, tmp_path: Path) -> None:
    wide = ("--rays", "3", "--set", "laser.divergence_mrad=0.1")
    ran = run("render", wall, "-o", "d", "--frames", "2", "--waveforms", "w.npz", *wide, *COARSE)
    assert (ran.code, ran.err) == (0, "")
    for number in (0, 1):
        with np.load(tmp_path / f"w_000{number}.npz") as archive:
            pulse = archive["pulse"]
        assert len(pulse) == 9
        assert pulse[0] == number * BEAMS
        assert pulse[-1] == (number + 1) * BEAMS - 1


def test_ambient_of_every_pulse(run: Run, wall: str, tmp_path: Path) -> None:
    """The image is the counts by ring and azimuth, the picture the image in steps."""
    for name in ("a.npz", "a.png"):
        ran = run("render", wall, "-o", "c.npz", "--ambient", name, "--background-rays", "4", *COARSE)
        assert (ran.code, ran.err) == (0, "")
    with np.load(tmp_path / "a.npz") as archive:
        ambient = dict(archive)
    assert ambient["pulse"].tolist() == list(range(BEAMS))
    assert ambient["image"].shape == (11, 21)
    assert sorted(ambient["image"].ravel()) == sorted(ambient["counts"])
    row = np.searchsorted(-ambient["elevation_deg"], -np.degrees(ambient["elevation_rad"])) - 1
    column = np.searchsorted(-ambient["azimuth_deg"], -np.degrees(ambient["azimuth_rad"])) - 1
    np.testing.assert_array_equal(ambient["image"][row, column], ambient["counts"])
    picture = Image.open(io.BytesIO((tmp_path / "a.png").read_bytes()))
    step = int(picture.info["Description"].split()[3])
    np.testing.assert_array_equal(np.asarray(picture), np.minimum(np.rint(ambient["image"] / step), 65535))


def ambient(path: Path, sensor: Sensor, counts: Any) -> None:
    """Write these counts of a sensor's pulses."""
    image = AmbientImage()
    image(np.arange(len(counts), dtype=np.uint32), counts.astype(np.uint64))
    image.save(path, sensor)


@pytest.mark.parametrize(("level", "step"), [(0, 1), (30_000, 1), (65_536, 3), (100_000, 4)])
def test_the_sun_is_white_and_the_rest_has_room(tmp_path: Path, level: int, step: int) -> None:
    """A step is a 65,535th of twice the 99th percentile, and never less than a count. One pulse in 231 sees the sun."""
    counts = np.full(BEAMS, level)
    counts[17] = 10_000_000
    coarse = [word.removeprefix("--set=") for word in COARSE]
    ambient(tmp_path / "a.png", load_sensor("table1-apd", overrides=coarse), counts)
    picture = Image.open(tmp_path / "a.png")
    assert picture.info["Description"].startswith(f"one step is {step} count")
    levels = np.asarray(picture)
    assert levels.max() == 65_535
    assert np.count_nonzero(levels == 65_535) == 1
    assert np.count_nonzero(levels == round(level / step)) == BEAMS - 1


def test_the_channel_of_every_pulse(tmp_path: Path) -> None:
    """Two firings of a Pandar64, whose lasers do not fire in the order of their numbers."""
    sensor = load_sensor("pandar64")
    ambient(tmp_path / "a.npz", sensor, np.arange(128))
    with np.load(tmp_path / "a.npz") as archive:
        channel = archive["channel"]
    assert sorted(channel.tolist()) == sorted([*range(64)] * 2)
    assert channel[:2].tolist() == channel[64:66].tolist() == [11, 39]  # by the user manual's table of firing
    assert (sensor.scanner.channel(np.arange(128, dtype=np.uint32)) == channel).all()
