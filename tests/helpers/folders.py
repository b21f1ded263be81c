"""Files that a command has written or begun, and a disk that is full."""

import errno
import os
import re
from pathlib import Path
from typing import Any

from lidarscene.files import atomic


def file_contents(folder: Path) -> dict[str, bytes]:
    """Bytes of every file below a folder, by its path from there."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def begun(folder: Path, pid: int) -> set[str]:
    """Names of the files below a folder whose temporary files a process has made."""
    pattern = re.compile(rf"\.(.+)\.[0-9a-f]{{8}}-{pid}-\d+-[0-9a-f]{{8}}\.part")
    names = (name for _, _, names in os.walk(folder) for name in names)  # `rglob` fails where a folder goes meanwhile
    return {match[1] for name in names if (match := pattern.fullmatch(name))}


def part_name(name: str, *, pid: int = 999_999_999, start: int = 1, place: str = "") -> str:
    """Name of a temporary file: of a process of this machine that has ended, or as said."""
    return f".{name}.{place or atomic._place()}-{pid}-{start}-{0:08x}.part"


def raise_disk_full(*_: Any, **__: Any) -> None:
    """Fail as a call that writes does."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
