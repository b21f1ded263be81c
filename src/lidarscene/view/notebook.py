"""Notebook: a cloud or a scene in, the page inside of a cell out."""

from __future__ import annotations

import html
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..cloud.points import PointCloud
from ..errors import InputError
from ..files.atomic import put_text
from ..scene.file import load_scene
from ..scene.model import Scene
from ..sensor.model import Sensor
from .page import LARGE_BYTES, saved
from .sources import Clouds, Live, Source

HEIGHT_PX = 620


class Shown:
    """A page that a notebook shows in a frame of its own; `save` writes it as a file that needs nothing else."""

    def __init__(self, source: Source, *, height_px: int) -> None:
        self._title, self._page, self._height_px = source.title, saved(source), height_px

    def __repr__(self) -> str:
        return (
            f"Shown({self._title}: {len(self._page) / 1e6:.1f} MB; a notebook shows it, save() writes a page)"
        )

    def _repr_html_(self) -> str:
        if len(self._page) > LARGE_BYTES:
            return html.escape(f"{self!r}; too large for a notebook: save it, or show fewer points")
        # The page is a document of its own: its styles and names meet none of the notebook's.
        return (
            f'<iframe srcdoc="{html.escape(self._page, quote=True)}" width="100%" height="{self._height_px}" '
            f'style="border:0" title="{html.escape(self._title, quote=True)}"></iframe>'
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page. Raises OutputError."""
        put_text(Path(path), self._page)


def show(
    what: PointCloud | Scene | str | os.PathLike[str],
    *,
    scene: Scene | str | os.PathLike[str] | None = None,
    sensor: str | Sensor | None = None,
    height_px: int = HEIGHT_PX,
) -> Shown:
    """Show a cloud, or a scene as its sensor sees it, in a notebook: the page of `lidarscene view`.

    what       a cloud; or a `Scene`, its name or file, which is rendered once
    scene      of a cloud: where it was made, whose surfaces are shown too
    sensor     catalogue name or file; of a cloud what it names, of a scene its own if None
    height_px  of the frame in the notebook
    Raises InputError for what cannot be shown.
    """
    if isinstance(sensor, Sensor):
        raise InputError("show: sensor: must be a catalogue name or a file, got a Sensor")
    if isinstance(what, PointCloud):
        around = None if scene is None else load_scene(scene)
        return Shown(_Held([what], scene=around, sensor=sensor), height_px=height_px)
    if scene is not None:
        raise InputError("show: scene goes with a cloud")
    if not isinstance(what, (Scene, str, os.PathLike)):
        raise InputError(f"show: must be a PointCloud or a Scene, got {type(what).__name__}")
    return Shown(Live(load_scene(what), sensor=sensor), height_px=height_px)


class _Held(Clouds):
    """Clouds that are no files."""

    def __init__(self, clouds: Sequence[PointCloud], **options: Any) -> None:
        self._clouds = tuple(clouds)
        super().__init__([Path(f"cloud {number}") for number in range(len(clouds))], **options)

    def _read(self, number: int) -> PointCloud:
        return self._clouds[number]
