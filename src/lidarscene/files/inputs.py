"""Input files: their order in a folder, and checks before they are read.

Devices, pipes, and archives that unpack to far more than their size are refused. A pipe blocks until another process
writes into it, /dev/zero has no end, and an archive of 6 MB may hold 6 GB. No user means one of these, and each would
stop the program without a message.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import zipfile
from pathlib import Path
from typing import IO

from ..errors import InputError, LidarSceneError

LARGEST_TEXT = 1 << 26
"""Bytes of a text file that is read whole, 64 MiB: a thousand times a scene of 400 bodies."""

LARGEST_PART = 1 << 29
"""Bytes of a file to which another one refers: a buffer of glTF, a texture."""

MOST_UNPACKED = 100
"""Largest ratio of unpacked to packed size: measured columns are noise, which packs to a tenth at best."""

FREE_UNPACKED = 1 << 27
"""Bytes that may be unpacked at any ratio, since 128 MiB do no harm, nor do a few copies of them."""

NOT_THERE = (errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG)


NOT_HIDDEN = "[!.]*"
"""Pattern of a folder's files that were put there: macOS adds `._NAME` to each on a disk of another system."""


def by_numbers(path: Path) -> list[tuple[int, str]]:
    """Return the key of a file's name that sorts frame_9 before frame_10."""
    return [(int(word), "") if word.isdecimal() else (-1, word) for word in re.split(r"(\d+)", path.name)]


def require_file(path: str | os.PathLike[str], kind: str = "a file", *, largest: int | None = None) -> None:
    """Raise InputError, in one line, unless this is a regular file of at most ``largest`` bytes.

    Args:
        kind: the kind of file that was expected, for the message: "a TOML file"
    """
    try:
        status = os.stat(path)
    except ValueError:
        raise InputError(f"{path}: must be the name of a file, got one with a NUL character") from None
    except OSError as error:
        if error.errno in NOT_THERE:
            raise InputError(f"{path}: no such file") from None
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if stat.S_ISDIR(status.st_mode):
        raise InputError(f"{path}: must be {kind}, got a folder")
    # Files of the kernel behave as devices: /proc/kmsg blocks until the kernel logs a line.
    if not stat.S_ISREG(status.st_mode) or os.path.realpath(path).startswith(("/proc/", "/sys/")):
        raise InputError(f"{path}: must be {kind}, got a device or pipe")
    if largest is not None and status.st_size > largest:
        raise InputError(
            f"{path}: must be {kind} of at most {largest / 2**20:.0f} MiB, got {status.st_size / 2**20:.0f} MiB"
        )


def current_folder(refusal: type[LidarSceneError] = InputError) -> Path:
    """Folder that this process is in.

    Raises:
        InputError: if it is gone; writers ask for an OutputError
    """
    try:
        return Path.cwd()
    except OSError as error:
        raise refusal(f"the current folder cannot be read ({error.strerror}); try: cd to another one") from None


def read_file(path: str | os.PathLike[str], kind: str, *, largest: int) -> bytes:
    """Read a regular file of at most ``largest`` bytes.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    require_file(path, kind, largest=largest)
    try:
        # The file may have grown since; and it is opened without waiting, should a pipe have taken its place.
        with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)), "rb") as file:
            return file.read(largest)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def require_unpacked(packed: int, unpacked: int) -> None:
    """Raise ValueError for data that unpack to more than `MOST_UNPACKED` times their packed size, in bytes."""
    if unpacked > max(FREE_UNPACKED, MOST_UNPACKED * packed):
        raise ValueError(
            f"must unpack to at most {MOST_UNPACKED} times its size, got {unpacked / 1e9:.3g} GB out of "
            f"{packed / 1e6:.3g} MB"
        )


def require_archive(file: IO[bytes]) -> None:
    """Check a zip archive, such as NPZ, by the sizes in its directory, beyond which no reader unpacks."""
    with zipfile.ZipFile(file) as archive:
        unpacked = sum(member.file_size for member in archive.infolist())
    require_unpacked(os.fstat(file.fileno()).st_size, unpacked)
    file.seek(0)
