"""A few facts of an object: one line for a prompt, a small table for a notebook.

Scenes and sensors hold arrays of millions of numbers, which nobody wants printed.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping
from typing import Any


def facts_line(kind: str, name: str, facts: Mapping[str, str]) -> str:
    """Such as `Scene('car': bodies 12, triangles 34,567)`."""
    return f"{kind}({name!r}: {', '.join(f'{key} {value}' for key, value in facts.items())})"


def facts_table(kind: str, name: str, facts: Mapping[str, str]) -> str:
    """The same as HTML."""
    rows = "".join(f"<tr><th>{html.escape(k)}</th><td>{html.escape(v)}</td></tr>" for k, v in facts.items())
    return f"<table><caption>{html.escape(f'{kind} {name}')}</caption>{rows}</table>"


_VIEWERS: list[Callable[..., Any]] = []
"""Who views clouds and scenes. They stand above all that can be seen, so they say themselves that they are there."""


def view_with(viewer: Callable[..., Any]) -> None:
    """Let `show_with_viewer` call this one; `lidarscene` itself does so."""
    _VIEWERS[:] = [viewer]


def show_with_viewer(viewable: object, **options: Any) -> Any:
    """What the viewer makes of a cloud or a scene."""
    return _VIEWERS[0](viewable, **options)
