"""Files that are none, that unpack to far more than they are, or are nested beyond measure: one short line each."""

import os
import struct
import zipfile
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import need
from helpers.mistakes import told
from helpers.scene_text import scene_of

from lidarscene import PointCloud, load_scene
from lidarscene.errors import InputError
from lidarscene.files import inputs
from lidarscene.files.inputs import require_file, require_unpacked
from lidarscene.files.toml import read_toml
from lidarscene.kernel.world.mitsuba_xml import load_shapes
from lidarscene.scan.pattern import read_pattern
from lidarscene.scene.meshes.reading import read_mesh
from lidarscene.scene.poses import read_poses
from lidarscene.sensor.optics import read_transmittance


def _pattern(path: Path) -> object:
    return read_pattern(path, frame_s=1.0, jitter_rad=None, encoder_rad=None)


READERS: dict[str, Callable[[Path], object]] = {
    "a.toml": load_scene,
    "a.xml": load_scene,
    "b.xml": lambda path: load_shapes(path, {}, {}, 905e-9),
    "a.glb": read_mesh,
    "a.obj": read_mesh,
    "a.csv": read_poses,
    "a.txt": read_poses,
    "b.csv": read_transmittance,
    "c.csv": _pattern,
    "a.npz": _pattern,
    "a.ply": PointCloud.load,
    "a.pcd": PointCloud.load,
    "b.npz": PointCloud.load,
    "a.parquet": PointCloud.load,
    "a.las": PointCloud.load,
    "a.laz": PointCloud.load,
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names on this system")
@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kind", ["pipe", "zero", "folder"])
def test_what_is_no_file_is_not_opened(tmp_path: Path, name: str, kind: str) -> None:
    """Rationale: who opens a pipe waits for its writer, and /dev/zero has no end."""
    path = tmp_path / name
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "zero":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    with told(f"{path} | {'a folder' if kind == 'folder' else 'device or pipe'}"):
        READERS[name](path)


@pytest.mark.parametrize("name", READERS)
def test_names_that_name_nothing(tmp_path: Path, name: str) -> None:
    for path, named in (
        (tmp_path / "none" / name, f"none/{name} | no such file"),
        (tmp_path / f"a\0{name}", "NUL character"),
        (tmp_path / f"{'x' * 20_000}{name}", "no such file"),
    ):
        with told(named):
            READERS[name](path)


def test_a_file_that_the_system_makes_up() -> None:
    if not Path("/proc/self/status").exists():
        pytest.skip("no /proc on this system")
    with told("/proc/self/status | device or pipe"):
        require_file("/proc/self/status")


@pytest.mark.parametrize("name", ["b.npz", "a.npz", "a.3mf", "a.zip"])
def test_bombs_in_archives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """A hundredth of the 6 GB that a file of 6 MB can hold, and a hundredth of what is free."""
    monkeypatch.setattr(inputs, "FREE_UNPACKED", inputs.FREE_UNPACKED // 100)
    with zipfile.ZipFile(tmp_path / name, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("lidarscene.npy", bytes(60_000_000))
    with told(f"{name} | 100 times its size | 0.06 GB"):
        READERS.get(name, read_mesh)(tmp_path / name)


def test_bombs_in_columns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A column of one number, repeated, and one that says that it is longer than it is."""
    need("parquet")
    need("pcd-compressed")
    import pyarrow
    from pyarrow import parquet

    monkeypatch.setattr(inputs, "FREE_UNPACKED", 1 << 20)
    small_cloud(3).save(tmp_path / "a.parquet")
    metadata = parquet.read_schema(tmp_path / "a.parquet").metadata
    table = pyarrow.table({"x": np.zeros(1 << 20, np.float32)}).replace_schema_metadata(metadata)
    parquet.write_table(table, tmp_path / "a.parquet")
    with told("a.parquet | 100 times its size"):
        PointCloud.load(tmp_path / "a.parquet")
    small_cloud(3).save(tmp_path / "a.pcd", format="pcd-compressed")
    data = (tmp_path / "a.pcd").read_bytes()
    start = data.index(b"binary_compressed\n") + len("binary_compressed\n")
    (tmp_path / "a.pcd").write_bytes(data[: start + 4] + struct.pack("<I", 2**32 - 1) + data[start + 8 :])
    with told("a.pcd | 100 times its size"):
        PointCloud.load(tmp_path / "a.pcd")


@pytest.mark.parametrize(("offset", "number"), [(100, 2**32 - 1), (243, 2**32 - 1), (100, None)])
def test_records_that_a_las_file_has_no_room_for(tmp_path: Path, offset: int, number: int | None) -> None:
    """A VLR has 54 bytes at least, and one more is told than there is room for. Rationale: laspy looks for each."""
    need("las")
    small_cloud(10).save(tmp_path / "a.las")
    data = bytearray((tmp_path / "a.las").read_bytes())
    number = number or len(data) // 54 + 1
    struct.pack_into("<I", data, offset, number)
    (tmp_path / "a.las").write_bytes(data)
    with told(f"a.las | records | {number}"):
        PointCloud.load(tmp_path / "a.las")


@pytest.mark.parametrize("depth", [150, 20_000])
def test_deep_xml(tmp_path: Path, depth: int) -> None:
    """Rationale: Mitsuba follows it with its stack."""
    (tmp_path / "a.xml").write_text(f"<scene version='3.0.0'>{'<a>' * depth}{'</a>' * depth}</scene>")
    with told("a.xml | XML | 100 deep"):
        load_shapes(tmp_path / "a.xml", {}, {}, 905e-9)


def test_files_that_include_ten_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(8):
        inside = f"<include filename='{number + 1}.xml'/>" * 10
        (tmp_path / f"{number}.xml").write_text(f"<scene version='3.0.0'>{inside}</scene>")
    (tmp_path / "8.xml").write_text("<scene version='3.0.0'/>")
    with told("8.xml | include"):
        load_shapes(tmp_path / "0.xml", {}, {}, 905e-9)


@pytest.mark.parametrize("text", ["a = " + "[" * 90 + "]" * 90, ".".join("a" * 500) + " = 1", "[" * 50_000])
def test_deep_toml(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.toml").write_text(text)
    with told("a.toml | TOML"):
        read_toml(tmp_path / "a.toml")


def test_long_texts_are_shortened(tmp_path: Path) -> None:
    with told("a.toml | key | ... "):
        scene_of(tmp_path, "a" * 20_000 + " = 1", "a.toml")


def test_a_text_file_of_gigabytes(tmp_path: Path) -> None:
    with (tmp_path / "a.toml").open("wb") as file:
        file.truncate(3 << 30)
    with told("a.toml | TOML file | 64 MiB | 3072 MiB"):
        load_scene(tmp_path / "a.toml")


@pytest.mark.parametrize(
    ("packed", "unpacked", "is_data"),
    [
        (1, 2**27, True),
        (1, 2**27 + 1, False),
        (2**24, 100 * 2**24, True),
        (2**24, 100 * 2**24 + 1, False),
        (2**20, 2**27, True),
    ],
)
def test_how_much_data_may_unpack_to(packed: int, unpacked: int, is_data: bool) -> None:
    """128 MiB whatever the size, and a hundred times the size whatever that is."""
    with nullcontext() if is_data else pytest.raises(ValueError, match="must unpack to at most 100 times its size"):
        require_unpacked(packed, unpacked)


def test_a_file_of_the_largest_size_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(bytes(2**20))
    require_file(path, largest=2**20)
    with pytest.raises(InputError, match="must be a file of at most 1 MiB, got 1 MiB"):
        require_file(path, largest=2**20 - 1)
