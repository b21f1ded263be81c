"""Mesh cache: the pieces of a mesh file as plain arrays, so that the next start needs no mesh library.

Importing trimesh and reading a car takes half of the start-up time. An entry is named by a hash of the file's
name and content and the version of trimesh, so it is never out of date. Only files that refer to no others
are cached, and OBJ files, whose material files are hashed with them. Beyond `LARGEST_BYTES` the least recently used
entries are removed. `files.cache_folder` says where the cache is. Any failure of the cache means that the mesh
is read from its file.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib import metadata
from pathlib import Path

import numpy as np

from ...errors import InputError, OutputError
from ...files.atomic import atomic_output
from ...files.cache_folder import cache_folder
from ...files.inputs import LARGEST_TEXT, read_file, require_archive, require_file
from ...maths.arrays import Numbers
from .reflectivity_patterns import Cutout, ReflectivityPattern


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkingClips:
    """Animations of a mesh file that a walker plays.

    Attributes:
        walk: name of that of one stride, from a foot's contact to its next
        standing: name of one that begins as the walker stands; None: the walker stops as the stride is
        unit_m: length of the walker in the scene that is one in the file
    """

    walk: str
    standing: str | None = None
    unit_m: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stride:
    """Vertices of a piece over one stride, on the spot.

    Attributes:
        vertices_m: (k + 1, v, 3) float32, at k even instants and at the first of the next stride
        period_s: time of the stride
    """

    vertices_m: Numbers
    period_s: float


MIRRORS = "mirrors"
"""Source: nuScenes' instructions to annotators (extremities) and OSI's `MovingObject`: boxes of vehicles leave out
their outside mirrors. Beginning of the names of a mesh's pieces that are these: programs number equal names."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SubMesh:
    """One piece of a mesh file, placed by the file's own node transforms.

    Attributes:
        vertices_m: (v, 3) float64; faces (f, 3) integers
        keys: names of its material, geometry and node
        grey: mean of its base colour if the file has one, else None
        pattern: reflectivity pattern, if it was read; not cached
        cutout: image of its gaps, if it has some; such a file is not cached
        stride: how it walks, if that was read
    """

    vertices_m: Numbers
    faces: Numbers
    keys: tuple[str, ...]
    grey: float | None = None
    pattern: ReflectivityPattern | None = None
    cutout: Cutout | None = None
    stride: Stride | None = None

    @property
    def in_box(self) -> bool:
        """Whether boxes of labels enclose the piece."""
        return not any(key.startswith(MIRRORS) for key in self.keys)

    def of_its_faces(self) -> SubMesh:
        """The piece without vertices that no face names, as where primitives of a file share one list of them."""
        used = np.zeros(len(self.vertices_m), dtype=bool)
        used[self.faces] = True
        if used.all():
            return self
        pattern, cutout = self.pattern, self.cutout
        if pattern is not None and pattern.uv is None:
            pattern = replace(pattern, values=pattern.values[used])
        elif pattern is not None and pattern.uv is not None:
            pattern = replace(pattern, uv=pattern.uv[used])
        if cutout is not None:
            cutout = replace(cutout, uv=cutout.uv[used])
        stride = self.stride and replace(self.stride, vertices_m=self.stride.vertices_m[:, used])
        faces = (np.cumsum(used) - 1)[self.faces]
        return replace(
            self, vertices_m=self.vertices_m[used], faces=faces, pattern=pattern, cutout=cutout, stride=stride
        )


LARGEST_BYTES = 2 << 30
"""Largest size of all entries together: some 30 million triangles."""

_LAYOUT = 6
"""Version of an entry's layout and of our own reading; a new number invalidates all old entries."""


def read_cached(path: Path, read: Callable[[], list[SubMesh]], clips: WalkingClips | None = None) -> list[SubMesh]:
    """Pieces of this mesh file, from the cache or else from ``read``, whose result is then cached.

    Args:
        clips: animations that ``read`` reads, too
    """
    entry = _entry(path, clips)
    if entry is None:
        return read()
    with suppress(Exception):  # a missing, damaged or foreign entry counts as none
        pieces = _load(entry)
        with suppress(OSError):  # a folder that may only be read
            os.utime(entry)  # when it was used last
        return pieces
    pieces = read()
    if not pieces or any(piece.cutout is not None for piece in pieces):
        return pieces
    with suppress(OSError, OutputError):
        _save(entry, pieces)
        _evict(entry)
    return pieces


def _entry(path: Path, clips: WalkingClips | None) -> Path | None:
    """Path of the file's cache entry, or None if it cannot be cached."""
    where, suffix = cache_folder("meshes"), path.suffix.lower()
    if where is None or suffix not in (".glb", ".ply", ".stl", ".off", ".obj"):
        return None
    try:
        content = path.read_bytes()
        if suffix == ".glb" and b'"uri"' in content:  # refers to another file
            return None
        # With the file's name: a piece without a name of its own gets that.
        digest = hashlib.sha256(f"{_LAYOUT} {_reader()} {path.name} {clips}".encode())
        for part in (content, *(_materials(path.parent, content) if suffix == ".obj" else ())):
            digest.update(hashlib.sha256(part).digest())
    except OSError:
        return None
    return where / f"{digest.hexdigest()}.npz"


@cache
def _reader() -> str:
    """Version of trimesh, cached because each look-up parses the package's metadata."""
    return metadata.version("trimesh")


def _materials(folder: Path, obj: bytes) -> Iterator[bytes]:
    """Yield name and content of the material files of an OBJ file; missing files are skipped."""
    for names in re.findall(rb"^\s*mtllib[ \t]+(.*?)\s*$", obj, re.MULTILINE):
        # Several names, or one with spaces in it.
        for name in dict.fromkeys((names, *names.split())):
            with suppress(InputError, ValueError):
                library = read_file(folder / os.fsdecode(name), "a material file", largest=LARGEST_TEXT)
                yield name + b"\n" + library


def _evict(newest: Path) -> None:
    """Remove the least recently used entries until the rest fits into `LARGEST_BYTES`; ``newest`` stays."""
    entries = []
    for entry in newest.parent.glob("*.npz"):
        with suppress(FileNotFoundError):  # another process removes, too
            status = entry.stat()
            entries.append((entry == newest, status.st_mtime_ns, status.st_size, entry))
    size = sum(entry_facts[2] for entry_facts in entries)
    for is_newest, _, entry_bytes, entry in sorted(entries):
        if size <= LARGEST_BYTES or is_newest:
            return
        entry.unlink(missing_ok=True)
        size -= entry_bytes


def _save(entry: Path, pieces: list[SubMesh]) -> None:
    """Write pieces as an entry.

    Raises:
        OSError: if the system refuses
        OutputError: if a result cannot be written
    """
    # One array of each kind: to read one from an archive takes longer than to part it.
    strides = [None if piece.stride is None else piece.stride.vertices_m.reshape(-1, 3) for piece in pieces]
    arrays = {
        "vertices_m": [piece.vertices_m for piece in pieces],
        "faces": [piece.faces for piece in pieces],
        "stride_m": [np.zeros((0, 3), np.float32), *(stride for stride in strides if stride is not None)],
    }
    descriptions = [
        {
            "keys": piece.keys,
            "grey": piece.grey,
            "period_s": None if piece.stride is None else piece.stride.period_s,
            "counts": [len(piece.vertices_m), len(piece.faces), 0 if stride is None else len(stride)],
        }
        for piece, stride in zip(pieces, strides, strict=True)
    ]
    # Of an entry that a power failure damages, the check sums are wrong.
    with atomic_output(entry, synced=False) as temporary, temporary.open("wb") as file:
        rows = {kind: np.concatenate(parts) for kind, parts in arrays.items()}
        np.savez(file, allow_pickle=False, about=np.array(json.dumps(descriptions)), **rows)


def _load(entry: Path) -> list[SubMesh]:
    """Read the pieces of an entry. Raises an exception for anything else."""
    require_file(entry, "a cache entry")
    with entry.open("rb") as raw:
        require_archive(raw)
        with np.load(raw, allow_pickle=False) as file:
            descriptions = json.loads(str(file["about"]))
            kinds = {"vertices_m": "f", "faces": "iu", "stride_m": "f"}
            counts = np.cumsum([description["counts"] for description in descriptions], axis=0)
            parted = [
                np.split(_rows_of_three(file[name], kind), ends)[:-1]
                for (name, kind), ends in zip(kinds.items(), counts.T, strict=True)
            ]
    return [
        SubMesh(
            vertices_m=vertices_m,
            faces=faces,
            keys=tuple(str(key) for key in description["keys"]),
            grey=None if description["grey"] is None else float(description["grey"]),
            stride=None
            if description["period_s"] is None
            else Stride(vertices_m=stride_m.reshape(-1, *vertices_m.shape), period_s=float(description["period_s"])),
        )
        for description, vertices_m, faces, stride_m in zip(descriptions, *parted, strict=True)
    ]


def _rows_of_three(array: Numbers, kinds: str) -> Numbers:
    """The array, if it is (n, 3) of these kinds of numbers.

    Raises:
        ValueError: if a value is not allowed
    """
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in kinds:
        raise ValueError(f"must be (n, 3) numbers, got {array.shape} of {array.dtype}")
    return array
