"""Sources: scenes that move, and clouds in other coordinates than the world's."""

from pathlib import Path
from typing import Any

import numpy as np
from helpers.small_scene import COARSE, SCENE

import lidarscene
from lidarscene import load_scene, load_sensor
from lidarscene.view.blob import unpack_blob
from lidarscene.view.page_sources import Clouds, Live

MOVING = """
[bodies.motion]
speed_m_s = 20.0
[ego]
position_m = [-2.0, 0.5, 0.0]
yaw_deg = 5.0
speed_m_s = 15.0
"""


def moving_scene(folder: Path) -> Path:
    """The ball, the last body of the file, and the vehicle drive."""
    path = folder / "moving.toml"
    path.write_text(SCENE.replace('name = "view"', 'name = "moving"') + MOVING)
    return path


def test_budgets_in_a_scene_that_moves(mi: Any, tmp_path: Path) -> None:
    """Rationale: the light behind the budget is traced with everything where it is when each pulse leaves, or SNR
    of the cloud and of the budget's formulas would differ. Tolerance: float32.
    """
    live = Live(load_scene(moving_scene(tmp_path)), overrides=COARSE)
    _, arrays = unpack_blob(live.frame(0))
    hit = np.isfinite(arrays["true_range"])
    assert hit.sum() > 60
    sensor = load_sensor("table1-apd", overrides=COARSE)
    signal = sensor.working_point(arrays["background_power"].astype(float)).response.signal(arrays["echo_power"])
    np.testing.assert_allclose((signal / arrays["noise"])[hit], arrays["snr"][hit], rtol=1e-5)
    assert np.abs(arrays["radial_velocity"][hit]).max() > 10


def test_clouds_stand_where_the_scene_has_their_sensor(mi: Any, tmp_path: Path) -> None:
    """One frame, later than the start, in three coordinate systems, over its scene: drawn in the same place."""
    path = moving_scene(tmp_path)
    scene, sensor = load_scene(path), load_sensor("table1-apd", overrides=COARSE)
    simulator = lidarscene.Simulator(scene, sensor)
    drawn = {}
    for frame in ("world", "vehicle", "sensor"):
        file = tmp_path / f"{frame}.ply"
        simulator.render(coordinates=frame, number=1).save(file)
        header, arrays = unpack_blob(Clouds([file], scene=scene, overrides=COARSE).frame(0))
        drawn[frame] = arrays["xyz"].reshape(-1, 3)
        np.testing.assert_allclose(header["sensor"], simulator.render(number=1).sensor_position_m, atol=1e-6)
    # Positions of 10 m in single precision, added up.
    np.testing.assert_allclose(drawn["vehicle"], drawn["world"], atol=5e-5)
    np.testing.assert_allclose(drawn["sensor"], drawn["world"], atol=5e-5)
