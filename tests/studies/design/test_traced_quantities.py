"""Traced quantities of design studies: expected points and detected bodies, against frames with drawn points."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidarscene.kernel.rays.trace import trace
from lidarscene.rendering import stages
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene_file import load_scene
from lidarscene.studies.design.design_study import load_study

pytestmark = pytest.mark.usefixtures("mi")

SCENE = """
[sun]
illuminance_klux = 100
[[bodies]]
name = "far"
class = "pedestrian"
primitive = "box"
size_m = [0.2, 0.6, 1.7]
position_m = [215.0, -4.0, 0.0]
material = "asphalt"
[[bodies]]
name = "near"
class = "pedestrian"
primitive = "box"
size_m = [0.2, 0.6, 1.7]
position_m = [60.0, 4.0, 0.0]
material = "asphalt"
[[bodies]]
name = "wall"
class = "building"
primitive = "box"
size_m = [0.2, 60.0, 20.0]
position_m = [260.0, 0.0, 0.0]
material = "asphalt"
"""

STUDY = """
sensor = "table1-apd"
scene = "scene.toml"
[set]
"laser.peak_power_w" = 8
"scanner.azimuth_fov_deg" = 12
"scanner.elevation_fov_deg" = 3
"scanner.azimuth_step_deg" = 0.1
"scanner.elevation_step_deg" = 0.1
[free]
"detector.gain" = { low = 5, high = 150 }
[objectives]
walls = { maximize = "body_points", class = "building" }
people = { maximize = "bodies_detected", class = "pedestrian", least_points = 3 }
night = { maximize = "body_points", illuminance_klux = 0 }
"""


def test_expected_points_are_the_mean_of_drawn_frames(tmp_path: Path) -> None:
    """40 frames: the mean number of points on the wall within 4 standard errors of their own scatter, which has a
    false-alarm rate of 1e-4; a body is detected in as many frames as the probability says, within 4 binomial errors.
    """
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    _, evaluator = load_study(tmp_path / "study.toml")
    values = {"detector.gain": 60.0}
    expected = evaluator(values)
    (sensor,) = evaluator.space.sensors(values).values()
    simulator = Simulator(load_scene(tmp_path / "scene.toml"), sensor)
    walls, detected = [], []
    for seed in range(40):
        cloud = simulator.render(seed=seed)
        assert cloud.body is not None
        counts = np.bincount(cloud.body[cloud.body >= 0], minlength=3)
        walls.append(counts[2])
        detected.append((counts[:2] >= 3).mean())
    assert 100.0 < np.mean(walls) < 0.9 * 61 * 121
    error = np.std(walls, ddof=1) / np.sqrt(len(walls))
    assert np.mean(walls) == pytest.approx(expected["walls"], abs=4.0 * error)
    share = expected["people"]
    assert 0.5 < share < 1.0
    # The near one is always detected: the scatter is that of the far one, half of a body.
    far = 2.0 * share - 1.0
    assert np.mean(detected) == pytest.approx(share, abs=2.0 * np.sqrt(far * (1.0 - far) / 40) + 1e-9)
    assert expected["night"] > expected["walls"]


@pytest.mark.parametrize("key", ['"tdc.window_us" = 1.7', '"tdc.blanking_ns" = 420'])
def test_no_point_is_expected_where_the_converter_does_not_listen(key: str, tmp_path: Path) -> None:
    """A window up to 255 m, before the wall, and a blanking up to 63 m, behind the nearer person: both lost theirs in
    every frame, and were counted. Limits as in the test above.
    """
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    text = STUDY.replace("[free]", f"{key}\n[free]").replace("least_points = 3", "least_points = 10")
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    _, evaluator = load_study(tmp_path / "study.toml")
    values = {"detector.gain": 60.0}
    expected = evaluator(values)
    (sensor,) = evaluator.space.sensors(values).values()
    cloud = Simulator(load_scene(tmp_path / "scene.toml"), sensor).render()
    assert cloud.body is not None
    echoes = cloud.body[cloud.status == 0]
    near, wall = ((echoes == cloud.body_names.index(name)).sum() for name in ("near", "wall"))
    if "window" in key:
        assert (wall, expected["walls"]) == (0, 0.0)
        assert near > 20
    else:
        assert near == 0
        assert expected["people"] < 0.5
        assert wall == pytest.approx(expected["walls"], abs=4.0 * np.sqrt(expected["walls"]))


def test_rays_are_traced_once_where_nothing_free_moves_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Gain, power, threshold and light trace nothing new; mounting and wavelength do. Every quantity is that of a fresh
    bench to 1e-5, which single precision sums in another order.
    """
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    keys = (
        '"tdc.threshold_to_noise" = { low = 4, high = 7 }\n"laser.peak_power_w" = { low = 2, high = 20 }\n'
        '"mounting.yaw_deg" = { low = -3, high = 3 }\n"laser.wavelength_nm" = { low = 900, high = 950 }\n'
    )
    text = STUDY.replace('"laser.peak_power_w" = 8\n', "").replace("[objectives]", f"{keys}[objectives]")
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    traces = 0

    def counted(*arguments: Any, **options: Any) -> Any:
        nonlocal traces
        traces += 1
        return trace(*arguments, **options)

    monkeypatch.setattr(stages, "trace", counted)
    _, evaluator = load_study(tmp_path / "study.toml")
    values: dict[str, Any] = evaluator.space.values(np.full(len(evaluator.space.free), 0.5))
    first = evaluator(values)
    assert traces == 1
    changed = values | {"detector.gain": 20.0, "laser.peak_power_w": 5.0, "tdc.threshold_to_noise": 6.0}
    again = evaluator(changed)
    assert traces == 1
    assert again["walls"] < 0.9 * first["walls"]
    _, fresh = load_study(tmp_path / "study.toml")
    assert again == pytest.approx(fresh(changed), rel=1e-5)
    for number, key in enumerate(("mounting.yaw_deg", "laser.wavelength_nm")):
        evaluator(changed | {key: values[key] + 1.0})
        assert traces == 3 + number
    assert evaluator(values) == first
    assert traces == 4
