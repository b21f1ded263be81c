"""The mesh cache: the same pieces as from the file, never out of date, never in the way."""

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from lidarscene.files.cache_folder import VARIABLE, cache_folder
from lidarscene.scene.meshes import mesh_cache, reading
from lidarscene.scene.meshes.mesh_cache import SubMesh

CAR = Path(__file__).parents[3] / "assets" / "meshes" / "car.glb"

TRIANGLE_OFF = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"

IN_A_FRESH_PYTHON = """
import json, sys
from pathlib import Path
from lidarscene.scene.meshes.reading import read_mesh
pieces = read_mesh(Path(sys.argv[1] if len(sys.argv) > 1 else {path!r}))
print(json.dumps(["trimesh" in sys.modules, sum(len(p.faces) for p in pieces)]))
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache" / "meshes"


def assert_same(a: list[SubMesh], b: list[SubMesh]) -> None:
    assert [(p.keys, p.grey) for p in a] == [(p.keys, p.grey) for p in b]
    for submesh, other_submesh in zip(a, b, strict=True):
        np.testing.assert_array_equal(submesh.vertices_m, other_submesh.vertices_m, strict=True)
        np.testing.assert_array_equal(submesh.faces, other_submesh.faces, strict=True)


def test_the_cache_gives_what_the_file_gives(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from_file = reading.read_mesh(CAR)
    assert len(list(cache.iterdir())) == 1
    monkeypatch.setattr(reading, "_pieces", lambda path: pytest.fail("the file was read"))
    assert_same(reading.read_mesh(CAR), from_file)


def test_a_warm_start_needs_no_mesh_library(cache: Path, tmp_path: Path, run_python) -> None:
    trimesh.load_scene(CAR).to_mesh().export(tmp_path / "car.ply")
    code = IN_A_FRESH_PYTHON.format(path=str(tmp_path / "car.ply"))
    first, second = (json.loads(run_python(code, **{VARIABLE: str(cache.parent)}).stdout) for _ in range(2))
    assert first[0]
    assert not second[0]
    assert first[1] == second[1] > 1000


def test_a_changed_file_is_read_again(cache: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.off"
    path.write_text(TRIANGLE_OFF)
    assert reading.read_mesh(path)[0].vertices_m.max() == 1.0
    path.write_text("OFF\n3 1 0\n0 0 0\n2 0 0\n0 2 0\n3 0 1 2\n")
    assert reading.read_mesh(path)[0].vertices_m.max() == 2.0
    assert len(list(cache.iterdir())) == 2


@pytest.mark.parametrize("damage", [b"", b"not a zip", None])
def test_a_damaged_entry_is_made_again(cache: Path, damage: bytes | None) -> None:
    expected = reading.read_mesh(CAR)
    (entry,) = cache.iterdir()
    entry_bytes = entry.read_bytes()
    entry.write_bytes(entry_bytes[: len(entry_bytes) // 2] if damage is None else damage)
    assert_same(reading.read_mesh(CAR), expected)
    assert entry.read_bytes() == entry_bytes


def test_a_foreign_entry_counts_as_none(cache: Path) -> None:
    """A pipe in its place, and arrays of other shapes and types: the mesh is read from its file."""
    expected = reading.read_mesh(CAR)
    (entry,) = cache.glob("*.npz")
    about = json.dumps([{"keys": ["a"], "grey": None, "period_s": None, "counts": [3, 1, 0]}])
    for vertices, faces in (
        (np.zeros((3, 2)), np.zeros((1, 3), int)),
        (np.zeros((3, 3)), np.zeros(3, int)),
        (np.zeros((3, 3)), np.zeros((1, 3))),
        (np.array([["a"] * 3]), np.zeros((1, 3), int)),
    ):
        with entry.open("wb") as file:
            np.savez(file, about=np.array(about), vertices_m=vertices, faces=faces, stride_m=np.zeros((0, 3)))
        assert_same(reading.read_mesh(CAR), expected)
    entry.unlink()
    os.mkfifo(entry)
    assert_same(reading.read_mesh(CAR), expected)


def test_what_takes_from_other_files_is_not_kept(cache: Path, tmp_path: Path) -> None:
    trimesh.Scene(trimesh.creation.box()).export(tmp_path / "a.gltf")
    reading.read_mesh(tmp_path / "a.gltf")
    assert not cache.exists()


def test_an_obj_file_is_kept_with_its_materials(cache: Path, tmp_path: Path) -> None:
    """A colour that changes in the .mtl is a new entry, as is a file that was missing."""
    triangle = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n"
    (tmp_path / "a.obj").write_text(triangle)
    greys = [reading.read_mesh(tmp_path / "a.obj")[0].grey]
    for level in (0.2, 0.6, 0.6):
        (tmp_path / "a.mtl").write_text(f"newmtl red\nKd {level} {level} {level}\n")
        greys.append(reading.read_mesh(tmp_path / "a.obj")[0].grey)
    assert greys == [None, *(pytest.approx(level, abs=0.5 / 255) for level in (0.2, 0.6, 0.6))]
    assert len(list(cache.iterdir())) == 3


def test_a_copy_has_the_pieces_of_its_own_name(cache: Path, tmp_path: Path) -> None:
    """Rationale: a piece without a name is called as its file is, and materials go by that."""
    for name in ("a.obj", "b.obj", "a.ply", "b.ply"):
        trimesh.creation.box().export(tmp_path / name)
        for _ in range(2):
            assert meshes_of(tmp_path / name) == [name]


def meshes_of(path: Path) -> list[str]:
    return [piece.keys[0] for piece in reading.read_mesh(path)]


def test_what_was_not_used_for_longest_goes_first(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def entry_of(size: float) -> Path:
        """The entry that a triangle of this size has, read anew or from the cache."""
        path = tmp_path / "a.off"
        path.write_text(TRIANGLE_OFF.replace("1 0 0\n", f"{size} 0 0\n"))
        assert reading.read_mesh(path)[0].vertices_m.max() == max(size, 1.0)
        return max(cache.iterdir(), key=lambda path: path.stat().st_mtime_ns)

    first, second = entry_of(1.0), entry_of(2.0)
    for age, entry in ((20, first), (10, second)):
        os.utime(entry, ns=(0, time.time_ns() - age * 10**9))
    assert entry_of(1.0) == first  # used: now the second is the oldest
    monkeypatch.setattr(mesh_cache, "LARGEST_BYTES", 2 * first.stat().st_size + 10)
    third = entry_of(3.0)
    assert set(cache.iterdir()) == {first, third}
    monkeypatch.setattr(mesh_cache, "LARGEST_BYTES", 0)
    assert [entry_of(4.0)] == list(cache.iterdir())


def test_it_can_be_turned_off_and_may_be_unwritable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "")
    assert cache_folder("meshes") is None
    reading.read_mesh(CAR)
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "file"))
    reading.read_mesh(CAR)
    assert (tmp_path / "file").read_text() == "in the way"
