"""Weather, rays, frame and seed of a live scene: as files and options would have them, and the command for it."""

import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import refused, told
from helpers.scene_text import scene_of
from helpers.small_scene import COARSE, SCENE

import lidarscene
from lidarscene import PointCloud, load_scene
from lidarscene.cli.main import main
from lidarscene.rendering.render_options import FrameOptions
from lidarscene.view.blob import unpack_blob
from lidarscene.view.live_conditions import BUDGET, FOG, FRAME, RAYS, SEED, WEATHER, command, conditions, controls
from lidarscene.view.page_sources import Live

RAIN, SNOW = "weather.rain_mm_h", "weather.snow_mm_h"
MOVING = SCENE + "[bodies.motion]\nspeed_m_s = 20.0\n[ego]\nposition_m = [-70.0, 0.5, 0.0]\nspeed_m_s = 15.0\n"


@pytest.fixture
def scene(scene_file: Path) -> Any:
    return load_scene(scene_file)


def test_as_the_files_have_it(scene: Any) -> None:
    combined = conditions(scene, FrameOptions(seed=3), {})
    assert combined.scene.air.weather == scene.air.weather
    assert (combined.frame.seed, combined.frame.number, combined.trace.rays, combined.budget) == (3, 0, 1, True)
    values = {control.key: control.value for control in controls(scene, FrameOptions(seed=3))}
    assert values == dict.fromkeys(WEATHER, 0.0) | {FOG: 50.0, RAYS: 1.0, FRAME: 0.0, SEED: 3.0}


def test_settings_are_those_of_files_and_options(scene: Any, scene_file: Path) -> None:
    file_scene = load_scene(scene_file, overrides={FOG: 0.2, RAIN: 5.0, SNOW: 1.5})
    combined = conditions(scene, FrameOptions(), {FOG: 0.2, RAIN: 5, SNOW: 1.5, RAYS: 4, SEED: 9, FRAME: 2, BUDGET: 0})
    assert combined.scene.air.weather == file_scene.air.weather
    assert (combined.frame.seed, combined.frame.number, combined.trace.rays, combined.budget) == (9, 2, 4, False)
    assert conditions(file_scene, FrameOptions(), {FOG: 50}).scene.air.weather.fog_visibility_m is None


test_mistakes_are_one_line = refused(
    lambda settings, scene: conditions(scene, FrameOptions(), settings),
    ({RAYS: 1.5}, "run.rays | whole number | 1.5"),
    ({RAYS: 0}, "run.rays | >= 1 | 0"),
    ({SEED: 2.0**32}, "run.seed | <= 4.29497e+09 | 4.29497e+09"),
    ({RAIN: -1}, "weather.rain_mm_h | >= 0 | -1"),
    ({FOG: "thick"}, "weather.fog_visibility_km | number | 'thick'"),
)


def test_the_command_renders_what_is_shown(mi, scene_file, tmp_path, monkeypatch):
    """Rationale: copied, run and read again, it gives the points of the page."""
    monkeypatch.chdir(tmp_path)
    live = Live(load_scene(scene_file), overrides=COARSE, scene_argument=str(scene_file))
    settings = {"sun.elevation_deg": 20.0, "laser.peak_power_w": 30.0, RAIN: 8.0, RAYS: 2, SEED: 5}
    header, arrays = unpack_blob(live.render(settings))
    words = shlex.split(header["command"])
    assert words[:3] == ["lidarscene", "render", str(scene_file)]
    assert main(words[1:]) == 0
    cloud = PointCloud.load("out.ply")
    np.testing.assert_array_equal(cloud.range_m, arrays["range"])
    np.testing.assert_array_equal(cloud.snr, arrays["snr"])
    typed = "lidarscene render car -o out --frames 4 --sensor vlp-16"
    assert shlex.join(command("car", "vlp-16", (), {FRAME: 3})) == typed
    assert command("car", "vlp-16", (), {FOG: 50.0, "sensor": "vlp-16", BUDGET: 0})[5:] == ["--sensor", "vlp-16"]
    header, arrays = unpack_blob(live.render({"detector": "SiPM of Table 1", "detector.pde": 0.3}))
    assert "--set detector=table1-sipm" in header["command"]
    assert main(shlex.split(header["command"])[1:]) == 0
    np.testing.assert_array_equal(PointCloud.load("out.ply").snr, arrays["snr"])
    own = ("detector.gain=60", "laser.peak_power_w=9")
    words = command("car", "apd-905", own, {}, donor_name="sipm-905")
    assert words[-4:] == ["--set", "detector=sipm-905", "--set", "laser.peak_power_w=9"]


def test_another_sensor_and_budgets_only_where_asked(mi: Any, scene_file: Path) -> None:
    live = Live(load_scene(scene_file), overrides=COARSE)
    with_budget, without = (unpack_blob(live.render({BUDGET: has_budget})) for has_budget in (1, 0))
    assert "echo_power" in with_budget[1]
    assert "echo_power" not in without[1]
    np.testing.assert_array_equal(with_budget[1]["snr"], without[1]["snr"])
    header, arrays = unpack_blob(live.render({"sensor": "vlp-16", BUDGET: 1}))
    cloud = lidarscene.render(scene_file, "vlp-16")
    np.testing.assert_array_equal(arrays["range"], cloud.range_m)
    assert header["choices"]["sensor"][0] == "table1-apd"
    assert header["title"].endswith(" · vlp-16")
    # The sensor reports 0 to 255, its comparator sees amperes.
    fields = {field["name"]: field for field in header["fields"]}
    assert {fields[name]["unit"] for name in ("peak_signal", "noise", "noise_at_peak", "threshold")} == {"A"}
    assert (fields["intensity"]["unit"], fields["intensity"]["symbol"]) == ("of 255", "")
    with told("sensor | table1-apd | eye"):
        live.render({"sensor": "eye"})


def test_a_moving_scene_opens_at_its_sensor(mi: Any, tmp_path: Path) -> None:
    """The view rides on the vehicle, 70 m off the world's origin; surfaces stand as the frame begins.

    The second frame begins 4.62 ms later: 231 pulses at 50 kHz, in which the vehicle drives 69.3 mm.
    """
    live = Live(scene_of(tmp_path, MOVING), overrides=COARSE)
    header, arrays = unpack_blob(live.stage())
    assert header["camera"]["eye"] == pytest.approx([-74.0, -2.5, 4.8])
    later, moved = unpack_blob(live.stage(1))
    assert later["camera"]["eye"][0] - header["camera"]["eye"][0] == pytest.approx(15.0 * 231 / 50e3)
    shift_m = (moved["vertices"] - arrays["vertices"]).reshape(-1, 3)
    assert shift_m.max() == pytest.approx(20.0 * 231 / 50e3, abs=1e-5)
    assert (np.abs(shift_m).max(axis=1) == 0.0).any()


def test_raw_and_deskewed_are_two_layers(mi: Any, tmp_path: Path) -> None:
    scene = scene_of(tmp_path, MOVING.replace("-70.0", "0.0"))
    _, arrays = unpack_blob(Live(scene, overrides=COARSE).frame(0))
    simulator = lidarscene.Simulator(scene, lidarscene.load_sensor("table1-apd", overrides=COARSE))
    cloud = simulator.render()
    deskewed_cloud = lidarscene.deskewed(cloud, simulator.motion, length_s=simulator.sensor.scanner.frame_s)
    np.testing.assert_allclose(arrays["still"].reshape(-1, 3), deskewed_cloud.xyz_m, atol=1e-5)
    assert np.abs(deskewed_cloud.xyz_m - cloud.xyz_m).max() > 0.01
    assert "still" not in unpack_blob(Live(scene_of(tmp_path, SCENE), overrides=COARSE).frame(0))[1]


def test_the_camera_stays_in_the_room(mi: Any, tmp_path: Path) -> None:
    """A closed room of 12 x 8 x 3 m around the sensor, without a view of its own: the eye is within the walls."""
    room = scene_of(
        tmp_path,
        '[sensor]\nposition_m = [-4.0, 0.0, 1.6]\n[[bodies]]\nname = "room"\nprimitive = "box"\n'
        'size_m = [12.0, 8.0, 3.0]\nposition_m = [0.0, 0.0, 1.5]\nmaterial = "concrete"\n',
    )
    header, _ = unpack_blob(Live(room, overrides=COARSE).stage())
    eye = np.array(header["camera"]["eye"])
    assert (np.abs(eye - [0.0, 0.0, 1.5]) < [6.0, 4.0, 1.5]).all()


def test_the_sliders_stand_where_the_weather_is(scene_file: Path) -> None:
    """Fog in kilometres, rain and snow in millimetres an hour, each its own."""
    foggy = load_scene(scene_file, overrides={FOG: 0.5, RAIN: 7.0, SNOW: 2.0})
    values = {control.key: control.value for control in controls(foggy, FrameOptions())}
    assert (values[FOG], values[RAIN], values[SNOW]) == (pytest.approx(0.5), 7.0, 2.0)
