"""Store: the folder of a job. A cloud and a row for each frame, by key; a frame is done when its row says so."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..files.atomic import atomic_output
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

    def row(self, key: str) -> dict[str, Any] | None:
        """What is known of a frame that is done; None if it is not, or if its cloud is not as it was written."""
        try:
            found: dict[str, Any] = json.loads(self._row(key).read_bytes())
            whole = (self.folder / found["file"]).stat().st_size == found["bytes"]
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return found if whole else None

    def finish(self, key: str, cloud: Path, told: dict[str, Any]) -> None:
        """Write the row of a frame whose cloud is there. Raises OutputError."""
        about = {"file": cloud.relative_to(self.folder).as_posix(), "bytes": cloud.stat().st_size}
        with atomic_output(self._row(key), synced=False) as temporary:  # one that is lost costs this frame
            temporary.write_text(json.dumps(about | told), encoding="utf-8")
