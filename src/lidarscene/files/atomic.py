"""Write files that appear whole or not at all.

A run of hours may be killed at any moment, and a half-written cloud looks like a whole one. So a file is written beside
its target, synced to disk and renamed: on one file system a rename is atomic. A file with its final name is complete.
"""

from __future__ import annotations

import glob
import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ..errors import OutputError

LONGEST_NAME = 255
"""Bytes of a file's name, on all file systems in use."""

_PART_BYTES = len(f"..folder.{2**32}.part")
"""What the name of a temporary file has beside the target's."""

_ours: set[Path] = set()
"""Temporary files that this process is writing."""


@contextmanager
def atomic_output(path: str | os.PathLike[str], *, synced: bool = True) -> Iterator[Path]:
    """Yield the path of an empty temporary file beside ``path``; it becomes ``path`` when the block ends without error.

    Missing folders are made. If anything goes wrong, a kill included, ``path`` is what it was before. An OSError
    becomes one OutputError that names the path. What a killed process leaves, `.NAME.PID.part`, is removed by the next
    write to the same name.

    synced  wait until the disk has the data; else a power failure may lose or empty the file
    """
    target = _target(path)
    temporary = target.with_name(_part_prefix(target) + f"{os.getpid()}.part")
    if temporary in _ours:
        raise OutputError(f"{path}: is being written by another thread of this process")
    new_folders: list[Path] = []
    _ours.add(temporary)
    try:
        new_folders = _make_folders(target.parent)
        _remove_stale(target)
        with open(temporary, "wb"):
            pass
        yield temporary
        if synced:
            _sync(temporary, os.O_RDWR)
        os.replace(temporary, target)
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
        _ours.discard(temporary)


def put_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file, atomically: UTF-8, with line feeds. Raises OutputError."""
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


@contextmanager
def atomic_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield the path of an empty temporary folder; its files move to ``path`` when the block ends without error.

    Other files of ``path`` stay. A new folder appears whole; into one that is there each file moves whole. If anything
    goes wrong, ``path`` is what it was, and the error names it. What a killed process leaves is removed by the next
    write.
    """
    target = _folder_target(path)
    # Inside an existing folder: it may be the mount point of another disk, onto which nothing can be renamed.
    beside_path = target / target.name if target.exists() else target
    temporary = beside_path.with_name(_part_prefix(target) + f"{os.getpid()}.part")
    new_folders: list[Path] = []
    try:
        new_folders = _make_folders(temporary.parent)
        _remove_stale(beside_path)
        temporary.mkdir()
        yield temporary
        if not target.exists():
            os.replace(temporary, target)
        for file in sorted(temporary.rglob("*")) if temporary.exists() else ():
            moved = target / file.relative_to(temporary)
            if file.is_dir():
                moved.mkdir(exist_ok=True)
            else:
                os.replace(file, moved)
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
    end = f".{os.getpid()}.part"
    folder = temporary.with_name(f"{temporary.name.removesuffix(end)}.folder{end}")
    folder.mkdir()
    try:
        yield folder
    finally:
        _remove(folder, [])


def _folder_target(path: str | os.PathLike[str]) -> Path:
    """Folder that this path names or would make, links followed."""
    target = Path(os.path.realpath(path))
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
    probe = target.with_name(_part_prefix(target) + f"{os.getpid()}.part")
    new_folders: list[Path] = []
    try:
        new_folders = _make_folders(target.parent)
        with open(probe, "wb"):
            pass
    except OSError as error:
        raise _unwritable(path, error) from error
    finally:
        _remove(probe, new_folders)


def _target(path: str | os.PathLike[str]) -> Path:
    """Return the regular file that this path names or would make, links followed."""
    try:
        target = Path(os.path.realpath(path))
        reason = _obstacle(target)
    except ValueError:
        raise OutputError(f"{path}: cannot be written: its name has a NUL character") from None
    except OSError as error:
        reason = error.strerror or str(error)
    if reason:
        raise OutputError(f"{path}: cannot be written: {reason}")
    return target


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


def _remove_stale(target: Path) -> None:
    """Remove what dead processes of this machine left of earlier writes to this name."""
    prefix, suffix = _part_prefix(target), ".part"
    for name in glob.glob(glob.escape(prefix) + "*" + suffix, root_dir=target.parent, include_hidden=True):
        pid = name[len(prefix) : -len(suffix)].rpartition(".")[2]
        if pid.isdecimal() and not _is_alive(int(pid)):
            _remove(target.parent / name, [])


def _is_alive(pid: int) -> bool:
    """True if a process of this number runs; always on Windows, where `os.kill` with 0 would end it."""
    if os.name == "nt":
        return True
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True


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
