"""Notebook cells that show the page for a cloud or a scene."""

from __future__ import annotations

import html
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..cloud.point_cloud import PointCloud
from ..errors import InputError
from ..files.atomic import put_text
from ..scene.scene import Scene
from ..scene.scene_file import load_scene
from .html_page import LARGE_BYTES, standalone_page
from .page_sources import Clouds, Live, Source


class Viewed:
    """Page that a notebook shows in an iframe; `save` writes it as a self-contained file."""

    def __init__(self, source: Source, *, height_px: int) -> None:
        self._title, self._page, self._height_px = source.title, standalone_page(source), height_px

    def __repr__(self) -> str:
        return f"Viewed({self._title}: {len(self._page) / 1e6:.1f} MB; a notebook shows it, save() writes a page)"

    def _repr_html_(self) -> str:
        if len(self._page) > LARGE_BYTES:
            return html.escape(f"{self!r}; too large for a notebook: save it, or view fewer points")
        # The page is a document of its own: its styles and names meet none of the notebook's.
        return (
            f'<iframe srcdoc="{html.escape(self._page, quote=True)}" width="100%" height="{self._height_px}" '
            f'style="border:0" title="{html.escape(self._title, quote=True)}"></iframe>'
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page.

        Raises:
            OutputError: if a result cannot be written
        """
        put_text(Path(path), self._page)


def view_in_notebook(
    content: PointCloud | Scene,
    *,
    scene: Scene | str | os.PathLike[str] | None = None,
    sensor: str | None = None,
    height_px: int,
) -> Viewed:
    """Make the object that `PointCloud.view` and `Scene.view` return.

    Raises:
        InputError: if a file, a key or a value cannot be understood
        BackendError: if Mitsuba has no back end that works on this machine
    """
    if sensor is not None and not isinstance(sensor, str | os.PathLike):
        raise InputError(f"view: sensor: must be a catalogue name or a file, got {type(sensor).__name__}")
    if isinstance(content, Scene):
        return Viewed(Live(content, sensor=sensor), height_px=height_px)
    surroundings = None if scene is None else load_scene(scene)
    return Viewed(_CloudsInMemory([content], scene=surroundings, sensor=sensor), height_px=height_px)


class _CloudsInMemory(Clouds):
    """Clouds in memory in place of files."""

    def __init__(self, clouds: Sequence[PointCloud], **options: Any) -> None:
        self._clouds = tuple(clouds)
        super().__init__([Path(f"cloud {number}") for number in range(len(clouds))], **options)

    def _read(self, path: Path) -> PointCloud:
        return self._clouds[int(path.name.split()[1])]
