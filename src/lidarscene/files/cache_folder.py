"""Folder for files kept between runs: `LIDARSCENE_CACHE`, else the user's cache folder.

An empty `LIDARSCENE_CACHE` turns the cache off. Results do not depend on it, only the time they take.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

VARIABLE = "LIDARSCENE_CACHE"


def cache_folder(name: str) -> Path | None:
    """Folder for files of one kind, which need not exist; None if the cache is off or the user has no folder."""
    folder = os.environ.get(VARIABLE)
    if folder is not None:
        return Path(folder) / name if folder else None
    with suppress(RuntimeError):  # no home
        base = os.environ.get("LOCALAPPDATA" if os.name == "nt" else "XDG_CACHE_HOME")
        return (Path(base) if base else Path.home() / ".cache") / "lidarscene" / name
    return None
