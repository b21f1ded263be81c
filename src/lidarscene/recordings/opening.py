"""Open a recording: the reader is found by what the file's name ends in, and imported then."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from ..errors import InputError
from .recording import Recording


def open_recording(path: str | os.PathLike[str], metadata: str | os.PathLike[str] | None = None) -> Recording:
    """Open a recording.

    metadata  the sensor's own description where the maker keeps it apart (Ouster: json); None: the file of the
              recording's name beside it, if there is one
    Raises InputError, in one line, for a file that is missing, empty, damaged or of no known kind.
    """
    file = Path(path)
    if not file.exists():
        raise InputError(f"{file}: no such recording")
    suffix = next((one for one in READERS if file.name.lower().endswith(one)), None)
    if suffix is None:
        raise InputError(
            f"{file}: must be a recording that ends in {', '.join(READERS)}, got '{file.suffix}'"
        )
    recording = READERS[suffix](file, None if metadata is None else Path(metadata))
    if not recording.count:
        raise InputError(f"{file}: must have frames of a lidar, got none")
    return recording


def _ouster(path: Path, metadata: Path | None) -> Recording:
    from .ouster import open_ouster

    return open_ouster(path, metadata)


READERS: dict[str, Callable[[Path, Path | None], Recording]] = {".pcap": _ouster, ".osf": _ouster}
"""Reader by what a file's name ends in."""
