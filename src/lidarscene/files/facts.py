"""A few facts of an object: one line for a prompt, a small table for a notebook.

Scenes and sensors hold arrays of millions of numbers, too long to print. A `Picture` is what plots return.
"""

from __future__ import annotations

import html
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from ..maths.attributes import HintedAttributes
from .atomic import atomic_output


def facts_line(kind: str, name: str, facts: Mapping[str, str]) -> str:
    """Line of text such as `Scene('car': bodies 12, triangles 34,567)`."""
    return f"{kind}({name!r}: {', '.join(f'{key} {value}' for key, value in facts.items())})"


def facts_table(kind: str, name: str, facts: Mapping[str, str]) -> str:
    """Table of the same facts as HTML."""
    rows = "".join(f"<tr><th>{html.escape(key)}</th><td>{html.escape(fact)}</td></tr>" for key, fact in facts.items())
    return f"<table><caption>{html.escape(f'{kind} {name}')}</caption>{rows}</table>"


@dataclass(frozen=True, slots=True)
class Picture(HintedAttributes):
    """A PNG in memory: a notebook shows it, and `save` writes it."""

    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("show", "savefig"), "a notebook shows it; picture.save(path)"),
        **dict.fromkeys(
            ("size", "shape", "array", "to_numpy", "data"), "matplotlib.image.imread(io.BytesIO(picture.png))"
        ),
        **dict.fromkeys(
            ("fig", "figure", "ax", "axes", "title", "set_title"), "a picture is drawn; picture.save(path)"
        ),
    }

    png: bytes = field(repr=False)

    @classmethod
    def drawn(cls, draw: Callable[[Path], object]) -> Picture:
        """Picture that a function draws to a path."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "picture.png"
            draw(path)
            return cls(path.read_bytes())

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the PNG.

        Raises:
            OutputError: if a result cannot be written
        """
        with atomic_output(path) as temporary:
            temporary.write_bytes(self.png)

    def _repr_png_(self) -> bytes:
        return self.png
