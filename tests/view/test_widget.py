"""The widget of notebooks: the page in a frame, whose questions Python answers; anywidget is a stand-in."""

import base64
import importlib.util
import json
import sys
import types
from pathlib import Path

import pytest
from helpers.chromium import Chromium
from helpers.clouds import small_cloud
from helpers.mistakes import told
from helpers.scene_text import scene_of
from helpers.small_scene import COARSE, SCENE

from lidarscene import LidarSceneError
from lidarscene.files import optional
from lidarscene.view import notebook, widget
from lidarscene.view.blob import unpack_blob
from lidarscene.view.html_page import page, read_static
from lidarscene.view.page_sources import Live


class StandIn:
    """What the widget uses of anywidget.AnyWidget."""

    def __init__(self) -> None:
        self.sent: list[tuple[dict[str, object], list[bytes]]] = []

    def on_msg(self, callback: object) -> None:
        self.callback = callback

    def send(self, content: dict[str, object], buffers: list[bytes]) -> None:
        self.sent.append((content, buffers))

    def _repr_mimebundle_(self, **_: object) -> dict[str, str]:
        return {"text/plain": "widget"}


@pytest.fixture
def anywidget(monkeypatch: pytest.MonkeyPatch) -> None:
    module = types.ModuleType("anywidget")
    module.AnyWidget = StandIn
    monkeypatch.setitem(sys.modules, "anywidget", module)
    monkeypatch.setattr(notebook, "is_installed", lambda name: name == "anywidget")


@pytest.mark.usefixtures("anywidget")
def test_a_cloud_is_a_widget_that_answers() -> None:
    viewed = small_cloud(5).view(height_px=333)
    made = viewed._widget
    assert viewed._repr_mimebundle_() == {"text/plain": "widget"}
    for name in ("stage", "frame-0"):
        made.callback(made, {"number": name, "name": name}, [])
        content, (blob,) = made.sent.pop()
        assert content == {"number": name}
        assert "title" in unpack_blob(blob)[0] or len(unpack_blob(blob)[1]["xyz"]) == 15
    for name, settings in (("frame-1", None), ("../etc", None), ("render", {}), ("render", [])):
        made.callback(made, {"number": 7, "name": name, "settings": settings}, [])
        content, blobs = made.sent.pop()
        assert (content["number"], blobs) == (7, [])
        assert "\n" not in content["error"]


def test_a_scene_is_rendered_anew(mi: object, tmp_path: Path) -> None:
    live = Live(scene_of(tmp_path, SCENE), overrides=COARSE)
    frames = [widget.answer(live, {"number": 1, "name": "render", "settings": {"run.seed": seed}}) for seed in (1, 2)]
    ranges = [unpack_blob(blob)[1]["xyz"].tolist() for _, (blob,) in frames]
    assert ranges[0] != ranges[1]


def test_without_anywidget_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "anywidget", None)
    with told("anywidget | pip install 'lidarscene[notebook]'", LidarSceneError):
        widget.widget_of(None, height_px=1)
    monkeypatch.setattr(notebook, "is_installed", lambda _: False)
    viewed = small_cloud(5).view()
    assert viewed._repr_mimebundle_() is None
    assert viewed._repr_html_().startswith("<iframe")


def test_the_group_is_that_of_the_project() -> None:
    assert optional.EXTRAS["notebook"] == {"anywidget": "anywidget"}


@pytest.mark.skipif(importlib.util.find_spec("anywidget") is None, reason="anywidget is not installed")
def test_anywidget_takes_it() -> None:
    viewed = small_cloud(5).view()
    assert "application/vnd.jupyter.widget-view+json" in str(viewed._repr_mimebundle_())


def test_the_page_in_the_frame_shows_what_python_sends(browser: Chromium, tmp_path: Path) -> None:
    """The browser runs our two halves of JavaScript; Python's answers stand ready beside them."""
    viewed = small_cloud(25).view()
    answers = {}
    for name in ("stage", "frame-0"):
        _, (blob,) = widget.answer(viewed._source, {"number": 1, "name": name})
        answers[name] = base64.b64encode(blob).decode()
    script = read_static("widget.js").replace("export default", "const widget =")
    text = json.dumps(page("a title")).replace("</", "<\\/")
    (tmp_path / "a.html").write_text(
        f"""<div id="cell"></div><script>
        const answers = {json.dumps(answers)}, asked = [];
        const listeners = [];
        const model = {{
          get: name => ({{ page: {text}, height_px: 400 }})[name],
          on: (_, listener) => listeners.push(listener),
          off: (_, listener) => listeners.splice(listeners.indexOf(listener), 1),
          send: ({{ number, name }}) => {{
            asked.push(name);
            const bytes = Uint8Array.from(atob(answers[name]), letter => letter.charCodeAt(0));
            for (const listener of listeners) listener({{ number }}, [new DataView(bytes.buffer)]);
          }},
        }};
        {script}
        const cell = document.getElementById("cell"), leave = widget.render({{ model, el: cell }});
        const within = id => cell.firstChild.contentDocument?.getElementById(id)?.textContent;
        </script>"""
    )
    browser.navigate((tmp_path / "a.html").as_uri())
    browser.until("(within('counts') ?? '').includes('25')")
    assert browser.value("asked.join()") == "stage,frame-0"
    assert browser.value("leave(), listeners.length") == 0
