"""Store: the folder of a job. A cloud and a row for each frame, by key; a frame is done when its row says so."""

from __future__ import annotations

import functools
import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..files.atomic import atomic_output
from ..files.json_text import json_text
from ..formats.registry import FORMATS


@dataclass(frozen=True, slots=True)
class Store:
    """Frames in a folder that all workers see, spread over 256 folders by their keys."""

    folder: Path

    @property
    def manifest(self) -> Path:
        """One row for each frame of the job that was run last."""
        return self.folder / "manifest.parquet"

    def cloud(self, key: str, format: str) -> Path:
        """Where the cloud of this key is."""
        return self.folder / "frames" / key[:2] / f"{key}{FORMATS[format].suffix}"

    def _row(self, key: str) -> Path:
        return self.folder / "rows" / key[:2] / f"{key}.json"

    def row(self, key: str, *, read: bool = True) -> dict[str, Any] | None:
        """What is known of a frame that is done; None if it is not, or if its cloud is not as it was written.

        read  the cloud too, to compare its hash; else only its size is compared
        """
        try:
            found: dict[str, Any] = json.loads(self._row(key).read_bytes())
            cloud = self.folder / found["file"]
            whole = cloud.stat().st_size == found["bytes"] and not (read and _digest(cloud) != found["sha256"])
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return None
        return found if whole else None

    @contextmanager
    def claimed(self, key: str) -> Iterator[bool]:
        """Whether no other process is at this frame; none will be until the block ends.

        A claim is a lock on one byte of one file, by the key: the system lets go of it when the process ends, however
        it ends, and keeps it across machines that share the folder. Where there are no locks everyone has every
        claim: a frame may then be rendered twice, to the same bytes.
        """
        try:
            import fcntl

            file = _claims(self.folder)
            at = int(key[:15], 16)
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, at)
        except (BlockingIOError, PermissionError):
            yield False
            return
        except (ImportError, OSError, ValueError):
            yield True
            return
        try:
            yield True
        finally:
            fcntl.lockf(file, fcntl.LOCK_UN, 1, at)

    def finish(self, key: str, cloud: Path, told: dict[str, Any]) -> None:
        """Write the row of a frame whose cloud is there. Raises OutputError."""
        about = {
            "file": cloud.relative_to(self.folder).as_posix(),
            "bytes": cloud.stat().st_size,
            "sha256": _digest(cloud),
        }
        with atomic_output(self._row(key), synced=False) as temporary:  # one that is lost costs this frame
            temporary.write_text(json_text(about | told), encoding="utf-8")


@functools.cache
def _claims(folder: Path) -> int:
    """The file of all claims, open until the process ends: to close it would let go of all of them."""
    folder.mkdir(parents=True, exist_ok=True)
    return os.open(folder / ".claims", os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)


def _digest(cloud: Path) -> str:
    """Hash of a file's content: a bit that has flipped leaves its size as it was."""
    with cloud.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
