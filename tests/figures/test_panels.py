"""Pictures of scenes and sensors: what is drawn where, by pixels and by what the panels are given."""

import io
import webbrowser
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.run_seed import chosen
from PIL import Image

from lidarscene import Scene, load_scene, load_sensor, sensors
from lidarscene.maths.pose import Pose
from lidarscene.scene.scene import Ball, Body
from lidarscene.view.notebook import Viewed


def coloured(picture: bytes) -> np.ndarray:
    """(n, 2) places, as shares of width and height from the lower left, of pixels that are bluer than grey."""
    image = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"), dtype=int)
    rows, columns = np.nonzero(image[..., 2] - image[..., 0] > 60)
    return np.stack([columns / image.shape[1], 1.0 - rows / image.shape[0]], axis=1)


@pytest.mark.parametrize(("y_m", "left"), [(8.0, True), (-8.0, False)])
def test_a_body_is_drawn_on_its_side(y_m: float, left: bool) -> None:
    ball = Body(
        name="ball",
        class_name="ball",
        parts=(Ball(radius_m=3.0, material="asphalt"),),
        pose=Pose.from_degrees(position_m=(12.0, y_m, 1.0)),
    )
    scene = Scene(bodies=(ball,), sensor_pose=Pose.from_degrees(position_m=(0.0, 0.0, 1.0)))
    places = coloured(scene.plot().png)
    plan, view = places[places[:, 0] < 0.5], places[(places[:, 0] > 0.55) & (places[:, 1] > 0.3)]
    assert (plan[:, 1].mean() > 0.55) == left, "up is y, from above"
    assert (view[:, 0].mean() < 0.775) == left, "left is left, from the sensor"
    gone = replace(scene, bodies=())
    assert len(coloured(gone.plot().png)) == 0


def test_shipped_scenes_are_drawn() -> None:
    for name in ("car", "glass"):
        assert len(coloured(load_scene(name).plot().png)) > 100


@pytest.mark.parametrize("name", [*chosen(1, sensors()), "table1-sipm", "sony-spad-189x600"])
def test_sensors_are_drawn(name: str) -> None:
    places = coloured(load_sensor(name).plot().png)
    for low in (0.0, 0.35, 0.68):
        inside = (places[:, 0] > low) & (places[:, 0] < low + 0.3)
        assert inside.any(), "each panel has its curve or dots"


def test_show_opens_the_page_in_the_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)

    class Page(Viewed):
        def __init__(self) -> None:
            self._title, self._page, self._height_px = "title", "<p>page</p>", 100

    Page().show()
    assert Path(opened[0].removeprefix("file://")).read_text() == "<p>page</p>"
