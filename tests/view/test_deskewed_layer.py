"""The points of a file with and without the sensor's own motion, in the world; or why there is one layer."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.scene_text import scene_of
from helpers.small_scene import COARSE, SCENE

from lidarscene import Simulator, deskewed, load_sensor
from lidarscene.view import page_sources
from lidarscene.view.blob import unpack_blob
from lidarscene.view.page_sources import Clouds

SPEED_M_S = 150.0  # a frame of the raster is short
EGO = f"[ego]\nposition_m = [-2.0, 0.5, 0.0]\nyaw_deg = 5.0\nspeed_m_s = {SPEED_M_S}\n"


@pytest.fixture
def moving(mi: Any, tmp_path: Path) -> Simulator:
    """The vehicle drives, and what it meets stands still."""
    return Simulator(scene_of(tmp_path, SCENE + EGO), load_sensor("table1-apd", overrides=COARSE))


@pytest.mark.parametrize("coordinates", ["world", "vehicle", "sensor"])
def test_deskewed_points_of_a_file(moving: Simulator, tmp_path: Path, coordinates: str) -> None:
    """Reference: what the simulator knows, which need not find the way of the sensor from its place at the start.

    Tolerance: positions of 10 m in single precision, turned and added.
    """
    moving.render(coordinates=coordinates, number=1).save(tmp_path / "a.ply")
    header, arrays = unpack_blob(Clouds([tmp_path / "a.ply"], scene=moving.scene, overrides=COARSE).frame(0))
    cloud = moving.render(coordinates="world", number=1)
    expected = deskewed(cloud, moving.motion).xyz_m
    deskewed_m = arrays["still"].reshape(-1, 3)
    np.testing.assert_allclose(deskewed_m, expected, atol=1e-4)
    moved_m = np.linalg.norm(deskewed_m - arrays["xyz"].reshape(-1, 3), axis=1)
    np.testing.assert_allclose(moved_m, SPEED_M_S * cloud.time_s, atol=1e-4)
    assert moved_m.max() > 0.1
    assert header["layers"] == ""


def test_why_there_is_one_layer(moving: Simulator, tmp_path: Path) -> None:
    """One layer is left without the scene, over one that stands still, of several sensors; what did not move lacks
    nothing.
    """
    cloud = moving.render(coordinates="world")
    assert page_sources.deskewed_positions_m(cloud, None) == (None, page_sources.NO_SCENE)
    standing_scene = scene_of(tmp_path, SCENE)
    assert page_sources.deskewed_positions_m(cloud, standing_scene) == (None, page_sources.OTHER_SCENE)
    rig = dataclasses.replace(cloud, sensor_names=("left", "right"))
    assert page_sources.deskewed_positions_m(rig, moving.scene) == (None, page_sources.SEVERAL)
    assert page_sources.deskewed_positions_m(deskewed(cloud, moving.motion), moving.scene) == (None, "")


def test_a_frame_and_itself_deskewed_are_one_with_two_layers(moving: Simulator, tmp_path: Path) -> None:
    """The layers are shown without the scene, from the file that `render --deskew` writes beside; not from one of other
    points.
    """
    cloud = moving.render(coordinates="world")
    still = deskewed(cloud, moving.motion)
    names = ("frame_0000.ply", "frame_0000.deskewed.ply", "frame_0001.ply", "frame_0001.deskewed.ply")
    for name, points in zip(names, (cloud, still, cloud, still.select(np.arange(len(still)) > 0)), strict=True):
        points.save(tmp_path / name)
    clouds = Clouds([tmp_path / name for name in names])
    assert clouds.frames == names[::2]
    header, arrays = unpack_blob(clouds.frame(0))
    np.testing.assert_array_equal(arrays["still"].reshape(-1, 3), still.xyz_m.astype(np.float32))
    np.testing.assert_array_equal(arrays["xyz"].reshape(-1, 3), cloud.xyz_m.astype(np.float32))
    assert header["layers"] == ""
    header, arrays = unpack_blob(clouds.frame(1))
    assert ("still" in arrays, header["layers"]) == (False, page_sources.NO_SCENE)
    assert Clouds([tmp_path / names[1]]).frames == names[1:2]  # alone it is a frame
