"""Notebook cells that show the page for a cloud or a scene."""

from __future__ import annotations

import functools
import html
import os
import sys
import tempfile
import webbrowser
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from ..cloud.point_cloud import PointCloud
from ..errors import InputError, warn
from ..files.arguments import checks_arguments
from ..files.atomic import put_text
from ..files.optional import is_installed
from ..formats.registry import readable_suffixes
from ..maths.attributes import HintedAttributes
from ..scene.scene import Scene
from ..scene.scene_file import SceneChoice, load_scene
from .html_page import LARGE_BYTES, standalone_page
from .page_sources import Clouds, Live, Source
from .widget import widget_of

STILL = "<p>its sliders render the scene anew with: pip install 'lidarscene[notebook]'</p>"
"""Line below the page of a scene where anywidget is not installed."""


class Viewed(HintedAttributes):
    """Page that a notebook shows in an iframe, live where anywidget is installed; `save` writes it as one file."""

    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("open", "display"), "viewed.show()"),
        **dict.fromkeys(("html", "to_html", "url", "export", "write"), 'viewed.save("a.html")'),
    }

    def __init__(self, source: Source, *, height_px: int, note: str = "") -> None:
        self._note = note
        self._source, self._title, self._height_px = source, source.title, height_px
        self._widget = widget_of(source, height_px=height_px) if is_installed("anywidget") else None

    @functools.cached_property
    def _page(self) -> str:
        return standalone_page(self._source)

    def _repr_mimebundle_(self, **formats: Any) -> Any:
        """The widget, where anywidget is installed: its page is live. Else `_repr_html_` is shown."""
        return None if self._widget is None else self._widget._repr_mimebundle_(**formats)

    def __repr__(self) -> str:
        return f"Viewed({self._title}: {len(self._page) / 1e6:.1f} MB; a notebook shows it, save() writes a page)"

    def _repr_html_(self) -> str:
        if len(self._page) > LARGE_BYTES:
            return html.escape(f"{self!r}; too large for a notebook: save it, or view fewer points")
        # The page is a document of its own: its styles and names meet none of the notebook's.
        return (
            f'<iframe srcdoc="{html.escape(self._page, quote=True)}" width="100%" height="{self._height_px}" '
            f'style="border:0" title="{html.escape(self._title, quote=True)}"></iframe>' + self._note
        )

    def show(self) -> None:
        """Show the page: in the notebook, or else in the browser, from a temporary file."""
        if "ipykernel" in sys.modules:
            sys.modules["IPython"].display.display(self)
            return
        path = Path(tempfile.mkdtemp(prefix="lidarscene-")) / "view.html"
        self.save(path)
        if not webbrowser.open(path.as_uri()):
            warn(f"there is no browser here; the page is {path}")

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page.

        Raises:
            OutputError: if a result cannot be written
        """
        put_text(Path(path), self._page)


@checks_arguments
def view(
    content: PointCloud | SceneChoice,
    *,
    scene: SceneChoice | None = None,
    sensor: str | None = None,
    height_px: int = 620,
) -> Viewed:
    """Make the page of a cloud or a scene, given by its name or file too; outside a notebook it opens in the browser.

    Args:
        scene: of a cloud: where it was made
        sensor: catalogue name or file

    Raises:
        InputError: if a file, a key or a value cannot be understood
        BackendError: if Mitsuba has no back end that works on this machine
    """
    if isinstance(content, str | os.PathLike) and Path(content).suffix.lower() in readable_suffixes():
        content = PointCloud.load(content)
    elif not isinstance(content, PointCloud):
        content = load_scene(content)
    viewed = view_in_notebook(content, scene=scene, sensor=sensor, height_px=height_px)
    if "ipykernel" not in sys.modules:
        viewed.show()
    return viewed


def view_in_notebook(
    content: PointCloud | Scene, *, scene: SceneChoice | None = None, sensor: str | None = None, height_px: int
) -> Viewed:
    """Make the object that `PointCloud.view` and `Scene.view` return.

    Raises:
        InputError: if a file, a key or a value cannot be understood
        BackendError: if Mitsuba has no back end that works on this machine
    """
    if sensor is not None and not isinstance(sensor, str | os.PathLike):
        raise InputError(f"view: sensor: must be a catalogue name or a file, got {type(sensor).__name__}")
    if isinstance(content, Scene):
        return Viewed(Live(content, sensor=sensor), height_px=height_px, note=STILL)
    surroundings = None if scene is None else load_scene(scene)
    return Viewed(_CloudsInMemory([content], scene=surroundings, sensor=sensor), height_px=height_px)


class _CloudsInMemory(Clouds):
    """Clouds in memory in place of files."""

    def __init__(self, clouds: Sequence[PointCloud], **options: Any) -> None:
        self._clouds = tuple(clouds)
        super().__init__([Path(f"cloud {number}") for number in range(len(clouds))], **options)

    def _read(self, path: Path) -> PointCloud:
        return self._clouds[int(path.name.split()[1])]
