"""A few facts of an object: one line for a prompt, a small table for a notebook.

Scenes and sensors hold arrays of millions of numbers, too long to print.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping
from typing import Any


def facts_line(kind: str, name: str, facts: Mapping[str, str]) -> str:
    """Line of text such as `Scene('car': bodies 12, triangles 34,567)`."""
    return f"{kind}({name!r}: {', '.join(f'{key} {value}' for key, value in facts.items())})"


def facts_table(kind: str, name: str, facts: Mapping[str, str]) -> str:
    """Table of the same facts as HTML."""
    rows = "".join(f"<tr><th>{html.escape(key)}</th><td>{html.escape(fact)}</td></tr>" for key, fact in facts.items())
    return f"<table><caption>{html.escape(f'{kind} {name}')}</caption>{rows}</table>"


_VIEWERS: list[Callable[..., Any]] = []
"""Function that views clouds and scenes, if one is registered: it stands in a higher tier, so it registers itself."""


def register_viewer(viewer: Callable[..., Any]) -> None:
    """Register the function that `show_with_viewer` calls; `lidarscene/__init__.py` does so."""
    _VIEWERS[:] = [viewer]


def show_with_viewer(viewable: object, **options: Any) -> Any:
    """View a cloud or a scene with the registered viewer, and return its result."""
    return _VIEWERS[0](viewable, **options)
