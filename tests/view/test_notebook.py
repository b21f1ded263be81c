"""Clouds and scenes in a notebook: the page in a frame of its own, by a method too."""

import html
import re

import pytest
from helpers.clouds import small_cloud
from helpers.drawn_street import street
from helpers.mistakes import refused
from helpers.small_scene import COARSE, SCENE

import lidarscene
from lidarscene.errors import OptionWarning
from lidarscene.view import html_page, notebook
from lidarscene.view.page_sources import Clouds


def framed_page(viewed: object) -> str:
    """The page in the frame."""
    frame = re.fullmatch(
        r'<iframe srcdoc="([^"]*)" width="100%" height="(\d+)"[^>]*></iframe>(?:<p>[^<]*</p>)?', viewed._repr_html_()
    )
    assert frame, "must be one frame"
    return html.unescape(frame[1])


def test_a_cloud_is_a_page_in_a_frame(tmp_path):
    cloud = street(step_deg=3.0)
    viewed = cloud.view(height_px=400)
    text = framed_page(viewed)
    assert text.startswith("<!DOCTYPE html>")
    assert {"blob-stage", "blob-frame-0"} <= set(re.findall(r'id="(blob-[^"]+)"', text))
    assert 'height="400"' in viewed._repr_html_()
    viewed.save(tmp_path / "a.html")
    assert (tmp_path / "a.html").read_text() == text
    assert re.match(r"Viewed\(.*: [0-9.]+ MB; ", repr(viewed))


def test_a_large_page_is_not_put_into_a_notebook(monkeypatch):
    monkeypatch.setattr(notebook, "LARGE_BYTES", 1000)
    fallback = small_cloud().view()._repr_html_()
    assert "<iframe" not in fallback
    assert "save it" in fallback


def test_a_scene_is_rendered_by_its_sensor(mi, tmp_path, monkeypatch):
    """The sensor is a coarse one: the page of a whole frame is tested by `view --save`."""
    (tmp_path / "s.toml").write_text(SCENE)
    live = notebook.Live
    monkeypatch.setattr(notebook, "Live", lambda scene, sensor: live(scene, sensor=sensor, overrides=COARSE))
    viewed = lidarscene.load_scene(tmp_path / "s.toml").view()
    assert "blob-frame-0" in framed_page(viewed)
    assert viewed._repr_html_().endswith("pip install 'lidarscene[notebook]'</p>")


test_what_cannot_be_viewed = refused(
    lambda options: small_cloud().view(**options),
    ({"sensor": 3}, "view | sensor | catalogue name or a file | int"),
    ({"sensor": lidarscene.load_sensor("table1-apd")}, "view | sensor | catalogue name or a file | Sensor"),
    ({"scene": 3}, "scene | a name, a file, a Scene, (vertices, faces) or a mesh | int"),
)


def test_a_large_page_is_warned_of(tmp_path, monkeypatch):
    small_cloud(9).save(tmp_path / "a.ply")
    monkeypatch.setattr(html_page, "LARGE_BYTES", 1000)
    with pytest.warns(OptionWarning, match=r"save .*a\.html: the page has 0 MB, and browsers take long to open it"):
        html_page.save(Clouds([tmp_path / "a.ply"]), tmp_path / "a.html")
    assert (tmp_path / "a.html").exists()
