"""HTML page with all its code in one file; with its blobs embedded it needs neither server nor network."""

from __future__ import annotations

import base64
import gzip
import html
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

from ..errors import OptionWarning, warn
from ..files.atomic import put_text
from .page_sources import Source

SCRIPTS = ("blob.js", "camera.js", "shaders.js", "renderer.js", "legend.js", "panel.js", "viewer.js")
"""Scripts in the order of their dependencies."""


def page(title: str, blobs: Mapping[str, bytes] | None = None) -> str:
    """Text of the page. ``blobs``, by name, are embedded compressed; the page fetches the others from the server."""
    embedded = "\n".join(
        f'<script type="application/octet-stream" id="blob-{name}">{_encode_blob(blob)}</script>'
        for name, blob in (blobs or {}).items()
    )
    return _fill_template(
        read_static("page.html"),
        {
            "STYLE": read_static("page.css"),
            "SCRIPT": "\n".join(read_static(name) for name in SCRIPTS),
            "BLOBS": embedded,
            "TITLE": html.escape(title),
        },
    )


LARGE_BYTES = 50_000_000
"""Size above which a page takes a browser many seconds to open, and most mail servers refuse it."""


def standalone_page(source: Source) -> str:
    """Page with all blobs of a source embedded."""
    blobs = {"stage": source.stage()}
    blobs |= {f"frame-{number}": source.frame(number) for number in range(len(source.frames))}
    return page(source.title, blobs)


def save(source: Source, path: Path) -> None:
    """Write the page with all blobs of a source; warn if it is large.

    Raises:
        OutputError: if a result cannot be written
    """
    text = standalone_page(source)
    if len(text) > LARGE_BYTES:
        warn(
            OptionWarning(
                "{save} {0}: the page has {1:.0f} MB, and browsers take long to open it: give fewer frames, or a cloud "
                "of fewer points",
                path,
                len(text) / 1e6,
            )
        )
    put_text(path, text)


def read_static(name: str) -> str:
    """Text of a file of the page."""
    return resources.files(__package__).joinpath("static", name).read_text(encoding="utf-8")


def _encode_blob(blob: bytes) -> str:
    # Without a time stamp the same content gives the same file.
    return base64.b64encode(gzip.compress(blob, 6, mtime=0)).decode("ascii")


def _fill_template(template: str, values: Mapping[str, str]) -> str:
    for name, value in values.items():
        template = template.replace(f"<!--{name}-->", value).replace(f"/*{name}*/", value)
    return template
