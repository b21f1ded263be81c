"""Store: the folder of a job, with a cloud and a row for each frame, by key; a frame is done when it has its row."""

from __future__ import annotations

import functools
import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
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
        """File with one row for each frame of the jobs that were run here."""
        return self.folder / "manifest.parquet"

    def cloud(self, key: str, format: str) -> Path:
        """File of the cloud of this key."""
        return self.folder / "frames" / key[:2] / f"{key}{FORMATS[format].suffix}"

    def _row(self, key: str) -> Path:
        return self.folder / "rows" / key[:2] / f"{key}.json"

    def row(self, key: str, *, read: bool = True) -> dict[str, Any] | None:
        """Row of a frame that is done; None if it is not, or if a file of it has changed since it was written.

        Args:
            read: whether files are read to compare their hashes; else only sizes are compared
        """
        entry = self.entry(key)
        if entry is None:
            return None
        try:
            whole = all(_is_whole(self.folder / file["file"], file, read) for file in (entry, *entry.get("beside", ())))
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return entry if whole else None

    def entry(self, key: str) -> dict[str, Any] | None:
        """Row of a frame as it was written, whatever has become of its files; None without one."""
        try:
            entry = json.loads(self._row(key).read_bytes())
        except (OSError, ValueError, RecursionError):
            return None
        return entry if isinstance(entry, dict) else None

    @contextmanager
    def claim(self, key: str) -> Iterator[bool]:
        """Claim a frame until the block ends; False if another process has the claim.

        A claim is a lock on one byte of one file, at an offset from the key: the system releases it when the process
        ends in any way, and it holds across machines that share the folder. Where there are no locks every process
        gets the claim: a frame may then be rendered twice, to the same bytes.
        """
        try:
            import fcntl

            file = _claims(self.folder)
            offset = int(key[:15], 16)
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, offset)
        except (BlockingIOError, PermissionError):
            yield False
            return
        except (ImportError, OSError, ValueError):
            yield True
            return
        try:
            yield True
        finally:
            fcntl.lockf(file, fcntl.LOCK_UN, 1, offset)

    def finish(self, key: str, files: Sequence[Path], counts: dict[str, Any]) -> None:
        """Write the row of a frame whose files are written, the cloud the first.

        Raises:
            OutputError: if a result cannot be written
        """
        entry, *beside = (
            {"file": file.relative_to(self.folder).as_posix(), "bytes": file.stat().st_size, "sha256": _digest(file)}
            for file in files
        )
        if beside:
            entry["beside"] = beside
        with atomic_output(self._row(key), synced=False) as temporary:  # a lost row costs only this frame
            temporary.write_text(json_text(entry | counts), encoding="utf-8")


def _is_whole(file: Path, entry: Mapping[str, Any], read: bool) -> bool:
    """Whether a file is as it was when its entry was written."""
    return bool(file.stat().st_size == entry["bytes"] and not (read and _digest(file) != entry["sha256"]))


@functools.cache
def _claims(folder: Path) -> int:
    """Descriptor of the file of all claims, open until the process ends: closing it would release all of them."""
    folder.mkdir(parents=True, exist_ok=True)
    return os.open(folder / ".claims", os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)


def _digest(cloud: Path) -> str:
    """Hash of a file's content: a flipped bit would leave the size as it was."""
    with cloud.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
