"""Page: one HTML file with all its code in it; blobs go into it to make a file that needs nothing else."""

from __future__ import annotations

import base64
import gzip
import html
import warnings
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

from ..errors import OptionWarning
from ..files.atomic import atomic_output
from .page_sources import Source

SCRIPTS = ("blob.js", "camera.js", "shaders.js", "renderer.js", "legend.js", "panel.js", "viewer.js")
"""In the order in which they use each other."""


def page(title: str, blobs: Mapping[str, bytes] | None = None) -> str:
    """The page; ``blobs`` by name go into it, compressed, and what is not there is asked of the server."""
    embedded = "\n".join(
        f'<script type="application/octet-stream" id="blob-{name}">{_encode_blob(blob)}</script>'
        for name, blob in (blobs or {}).items()
    )
    return _fill_template(
        _read_static("page.html"),
        {
            "STYLE": _read_static("page.css"),
            "SCRIPT": "\n".join(_read_static(name) for name in SCRIPTS),
            "BLOBS": embedded,
            "TITLE": html.escape(title),
        },
    )


LARGE_BYTES = 50_000_000
"""A page beyond this takes a browser many seconds to open, and most mails refuse it."""


def standalone_page(source: Source) -> str:
    """Everything that a source shows in one page."""
    blobs = {"stage": source.stage()}
    blobs |= {f"frame-{number}": source.frame(number) for number in range(len(source.frames))}
    return page(source.title, blobs)


def save(source: Source, path: Path) -> None:
    """Everything that a source shows in one file. Warns of a large one. Raises OutputError."""
    text = standalone_page(source)
    if len(text) > LARGE_BYTES:
        warnings.warn(
            OptionWarning(
                "{save} {0}: the page has {1:.0f} MB, and browsers take long to open it: give fewer frames, or a cloud "
                "of fewer points",
                path,
                len(text) / 1e6,
            ),
            stacklevel=2,
        )
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _read_static(name: str) -> str:
    return resources.files(__package__).joinpath("static", name).read_text(encoding="utf-8")


def _encode_blob(blob: bytes) -> str:
    # The same content makes the same file: no time stamp.
    return base64.b64encode(gzip.compress(blob, 6, mtime=0)).decode("ascii")


def _fill_template(template: str, values: Mapping[str, str]) -> str:
    for name, value in values.items():
        template = template.replace(f"<!--{name}-->", value).replace(f"/*{name}*/", value)
    return template
