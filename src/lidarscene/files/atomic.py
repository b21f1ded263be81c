"""Write files that appear whole or not at all.

A run of hours may be killed at any moment, and a half-written cloud looks like a whole one. So a file is written beside
its target, synced to disk and renamed: on one file system a rename is atomic. A file with its final name is complete.
Several processes may write the same file, on any machines that share its disk: each has a temporary file of its own,
and the last rename stays.
"""

from __future__ import annotations

import hashlib
import math
import os
import platform
import re
import shutil
import stat
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ..errors import OutputError
from .inputs import current_folder

LONGEST_NAME = 255
"""Bytes of a file's name, on all file systems in use."""

ABANDONED_S = 7 * 86400.0
"""Choice: age from which a temporary file counts as abandoned where nobody can know whether its process lives."""

ATTEMPTS = 5
"""How often a temporary file is made before its folder counts as missing."""

_MARK = re.compile(r"(?:folder\.)?([0-9a-f]{8})-(\d+)-(\d+)-[0-9a-f]{8}\.part")
"""What the name of a temporary file has behind the target's: by `_part_of`."""

_PART_BYTES = len(f"..folder.{0:08x}-{2**32}-{2**64}-{0:08x}.part")
"""What the name of a temporary file has beside the target's."""

_ours: set[Path] = set()
"""Files that this process is writing."""


@contextmanager
def atomic_output(path: str | os.PathLike[str], *, synced: bool = True) -> Iterator[Path]:
    """Yield the path of an empty temporary file beside ``path``; it becomes ``path`` when the block ends without error.

    Missing folders are made. If anything goes wrong, a kill included, ``path`` is what it was before. An OSError
    becomes one OutputError that names the path. A file that is replaced hands its mode on. Links are followed. What a
    killed process leaves, `.NAME.MARK.part`, is removed by the next write to the same name: at once where that process
    is known to be dead, else after `ABANDONED_S`.

    Args:
        synced: wait until the disk has the data; else a power failure may lose or empty the file
    """
    target = _target(path)
    if target in _ours:
        raise OutputError(f"{path}: is being written by another thread of this process")
    temporary = _part_of(target)
    new_folders: list[Path] = []
    _ours.add(target)
    try:
        new_folders = _make(temporary, _file_like(target))
        _remove_stale(target, temporary)
        yield temporary
        if synced:
            _sync(temporary, os.O_RDWR)
        _replace(temporary, target)
        if synced:
            with suppress(OSError):  # some file systems cannot sync a folder
                _sync(target.parent, os.O_RDONLY)
    except OSError as error:
        _remove(temporary, new_folders)
        raise _unwritable(path, error) from error
    except BaseException:
        _remove(temporary, new_folders)
        raise
    finally:
        _ours.discard(target)


def put_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file, atomically: UTF-8, with line feeds. Bytes of a name that are no text are escaped.

    Raises:
        OutputError: if a result cannot be written
    """
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def put_arrays(path: str | os.PathLike[str], arrays: Mapping[str, Any]) -> None:
    """Write NumPy's arrays by name, compressed, atomically.

    Raises:
        OutputError: if a result cannot be written
    """
    import numpy as np

    with atomic_output(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


@contextmanager
def atomic_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield the path of an empty temporary folder; its files move to ``path`` when the block ends without error.

    Other files of ``path`` stay. A new folder appears whole; into one that is there each file moves whole. If anything
    goes wrong, ``path`` is what it was, and the error names it. What a killed process leaves goes as by
    `atomic_output`.
    """
    target = _folder_target(path)
    # Inside an existing folder: it may be the mount point of another disk, onto which nothing can be renamed.
    beside_path = target / target.name if target.exists() else target
    temporary = _part_of(beside_path)
    new_folders: list[Path] = []
    try:
        new_folders = _make(temporary, Path.mkdir)
        _remove_stale(beside_path, temporary)
        yield temporary
        if not target.exists():
            try:
                os.replace(temporary, target)
            except OSError:
                if not target.is_dir():  # else another process has just made it
                    raise
        for file in sorted(temporary.rglob("*")) if temporary.exists() else ():
            moved = target / file.relative_to(temporary)
            if file.is_dir():
                moved.mkdir(exist_ok=True)
            else:
                _replace(file, moved)
    except OSError as error:
        _remove(temporary, new_folders)
        raise _unwritable(path, error) from error
    except OutputError as error:
        _remove(temporary, new_folders)
        raise OutputError(str(error).replace(str(temporary), os.fspath(path))) from error
    except BaseException:
        _remove(temporary, new_folders)
        raise
    _remove(temporary, [])


@contextmanager
def folder_beside(temporary: Path) -> Iterator[Path]:
    """Yield a folder beside a temporary of `atomic_output`, for a library that writes nothing else; then remove it."""
    name, mark, suffix = temporary.name.rsplit(".", 2)
    folder = temporary.with_name(f"{name}.folder.{mark}.{suffix}")
    folder.mkdir(0o700)  # the file that is replaced may be private
    try:
        yield folder
    finally:
        _remove(folder, [])


def _folder_target(path: str | os.PathLike[str]) -> Path:
    """Folder that this path names or would make, links followed."""
    target = _followed(path)
    if target.exists() and not target.is_dir():
        raise OutputError(f"{path}: cannot be written: must be a folder, got a file")
    return target


def name_path_in_errors(path: str | os.PathLike[str], append: Callable[..., None]) -> Callable[..., None]:
    """Wrap a function so that its OSError becomes an OutputError that names this path.

    For several files that are written at once: each `atomic_output` would report the errors of the others as its own.
    """

    def append_or_name(*arguments: Any, **keywords: Any) -> None:
        try:
            append(*arguments, **keywords)
        except OSError as error:
            raise _unwritable(path, error) from error

    return append_or_name


def _unwritable(path: str | os.PathLike[str], error: OSError) -> OutputError:
    return OutputError(f"{path}: cannot be written: {error.strerror or error}")


def require_writable(path: str | os.PathLike[str]) -> None:
    """Raise the OutputError that writing this file would raise, before hours of work go into its content."""
    target = _target(path)
    probe = _part_of(target)
    new_folders: list[Path] = []
    try:
        new_folders = _make(probe, _file_like(target))
    except OSError as error:
        raise _unwritable(path, error) from error
    finally:
        _remove(probe, new_folders)


def _target(path: str | os.PathLike[str]) -> Path:
    """Return the regular file that this path names or would make, links followed.

    Raises:
        OutputError: if a result cannot be written
    """
    target = _followed(path)
    if reason := _obstacle(target):
        raise OutputError(f"{path}: cannot be written: {reason}")
    return target


def _followed(path: str | os.PathLike[str]) -> Path:
    """Return what this path names or would make, links followed.

    A link into a folder that is not there is refused: the disk that it leads to may not be mounted, and the folder
    would be made on another.

    Raises:
        OutputError: if a result cannot be written
    """
    try:
        with suppress(FileNotFoundError, NotADirectoryError):
            os.stat(path)
    except ValueError:
        raise OutputError(f"{path}: cannot be written: its name has a NUL character") from None
    except OSError as error:
        raise _unwritable(path, error) from error
    for place in (Path(path), *Path(path).parents):
        if place.is_symlink() and not (end := Path(os.path.realpath(place))).parent.exists():
            raise OutputError(f"{path}: cannot be written: '{place}' is a link to '{end}', whose folder is not there")
    return Path(os.path.realpath(path if os.path.isabs(path) else current_folder(OutputError) / path))


def _obstacle(target: Path) -> str:
    """Return why this cannot become a file, as far as can be seen without trying; "" if nothing is in the way."""
    if target.is_dir():
        return "must be the name of a file, got a folder"
    if target.exists() and not target.is_file():
        return "must be the name of a file, got a device or pipe"
    if target.exists() and not os.access(target, os.W_OK):
        return "the file is write-protected"
    nearest = next(folder for folder in target.parents if folder.exists())
    return "" if nearest.is_dir() else f"'{nearest}' is a file, not a folder"


def _make(temporary: Path, make: Callable[[Path], object]) -> list[Path]:
    """Make a temporary file or folder, and return the folders that were missing, deepest first."""
    attempts = ATTEMPTS
    while True:
        attempts -= 1
        new_folders: list[Path] = []
        try:
            new_folders = _make_folders(temporary.parent)
            make(temporary)
            return new_folders
        except BaseException as error:
            _remove(temporary, new_folders)
            # Another process removes a folder that it has made and does not need.
            if not (attempts and isinstance(error, FileNotFoundError)):
                raise


def _file_like(target: Path) -> Callable[[Path], object]:
    """Return a function that makes a new file that nobody may read who may not read the target."""
    mode = _mode(target)
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
    return lambda path: os.close(os.open(path, flags, 0o666 if mode is None else mode | stat.S_IRUSR | stat.S_IWUSR))


def _mode(path: Path) -> int | None:
    """Permissions of a file; None without one."""
    try:
        return stat.S_IMODE(path.stat().st_mode)
    except FileNotFoundError:
        return None


def _replace(temporary: Path, target: Path) -> None:
    """Rename a file; one that it replaces hands its mode on."""
    mode = _mode(target)
    if mode is not None and mode != _mode(temporary):
        temporary.chmod(mode)
    os.replace(temporary, target)


def _make_folders(folder: Path) -> list[Path]:
    """Make this folder and return those that were missing, deepest first."""
    missing_folders = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        _remove(None, missing_folders)
        raise
    return missing_folders


def _part_prefix(target: Path) -> str:
    """Start of the names of temporary files of this target: its name, or a hash of it where that leaves no room."""
    name = target.name
    if len(os.fsencode(name)) > LONGEST_NAME - _PART_BYTES:
        name = hashlib.sha256(os.fsencode(name)).hexdigest()[:32]
    return f".{name}."


def _part_of(target: Path) -> Path:
    """Path of a new temporary file of this target: it names this process among those of all machines, and is random."""
    pid = os.getpid()
    mark = f"{_place()}-{pid}-{_start_of(pid)}-{os.urandom(4).hex()}.part"
    return target.with_name(_part_prefix(target) + mark)


def _place() -> str:
    """Hash of where a PID means something: the host, since it booted, and its PID namespace. Random if unknown."""
    place = platform.node()
    if sys.platform == "linux":
        try:
            boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
            place += boot + os.readlink("/proc/self/ns/pid")
        except OSError:
            return os.urandom(4).hex()
    return hashlib.sha256(place.encode()).hexdigest()[:8]


def _start_of(pid: int) -> int:
    """When a process was started [ticks since the boot], which tells it from later ones of its PID; 0 if unknown."""
    try:
        if os.readlink("/proc/self") != str(os.getpid()):
            return 0  # PIDs there are those of another namespace
        return int(Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[19])
    except (OSError, ValueError, IndexError):
        return 0


def _remove_stale(target: Path, temporary: Path) -> None:
    """Remove what dead processes left of earlier writes to this name.

    Args:
        temporary: a new file: it tells the time of the disk, which may be another machine's
    """
    prefix, now_s = _part_prefix(target), temporary.stat().st_mtime
    names: list[str] = []
    with suppress(OSError):  # whoever may write into a folder need not be allowed to list it
        names = os.listdir(target.parent)
    for name in names:
        if name.startswith(prefix) and (mark := _MARK.fullmatch(name, len(prefix))):
            place, pid, start = mark.groups()
            part = target.with_name(name)
            is_dead = place == _place() and not _is_alive(int(pid), int(start))
            if is_dead or now_s - _changed_s(part) > ABANDONED_S:
                _remove(part, [])


def _is_alive(pid: int, start: int) -> bool:
    """False if the process of this PID and start is known to have ended.

    Never on Windows, where `os.kill` with 0 would end it.
    """
    if os.name == "nt":
        return True
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    now = _start_of(pid)
    return 0 in (start, now) or start == now


def _changed_s(part: Path) -> float:
    """When a temporary file, or the newest file in a temporary folder, was written [s]; never if it has just gone."""
    try:
        return max(path.stat().st_mtime for path in (part, *part.rglob("*")))
    except OSError:
        return math.inf


def _sync(path: Path, flags: int) -> None:
    """Wait until the file is on the disk."""
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _remove(temporary: Path | None, folders: list[Path]) -> None:
    """Remove a temporary file or folder, and folders that were made for it, where they are empty."""
    if temporary is not None:
        with suppress(OSError):
            if temporary.is_dir() and not temporary.is_symlink():
                shutil.rmtree(temporary)
            else:
                temporary.unlink()
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
