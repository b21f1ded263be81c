"""PLY files: exactly what went in comes out, other programs read them, broken ones are refused."""

import os
import struct
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.clouds import assert_same, small_cloud, small_columns
from helpers.mistakes import mistakes, told

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats import ply
from lidarscene.formats.cloud_columns import columns_of
from lidarscene.formats.ply import PLY_TYPES

COLUMNS = columns_of(truth=True, vectors=False)
OPEN3D_DTYPES = ("float32", "float64", "uint8", "int32")
"""Types that Open3D reads from PLY by the older words; it skips others with a warning."""


def header_of(path: Path) -> list[str]:
    return path.read_bytes().split(b"end_header\n")[0].decode("ascii").splitlines()


def test_a_file_is_read_by_the_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: a cloud of 100 million points is never twice in memory. No block is larger than it may be, and the
    last one is as large as what is left.
    """
    monkeypatch.setattr(ply, "BLOCK_POINTS", 8)
    sizes: list[int] = []
    read = np.fromfile

    def read_and_count(file: Any, dtype: Any, count: int) -> Any:
        sizes.append(count)
        return read(file, dtype, count=count)

    small_cloud(27).save(tmp_path / "a.ply")
    monkeypatch.setattr(np, "fromfile", read_and_count)
    assert_same(PointCloud.load(tmp_path / "a.ply"), small_cloud(27))
    assert sizes == [8, 8, 8, 3]


@pytest.mark.parametrize("ascii", [False, True])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_header(tmp_path: Path, dtype: Any, ascii: bool) -> None:
    cloud = small_cloud(xyz_m=small_columns()["xyz_m"].astype(dtype))
    cloud.save(tmp_path / "a.ply", ascii=ascii)
    lines = header_of(tmp_path / "a.ply")
    assert lines[:3] == [
        "ply",
        "format ascii 1.0" if ascii else "format binary_little_endian 1.0",
        "comment lidarscene 2",
    ]
    assert "comment sensor test" in lines
    assert "comment unit time s" in lines
    assert "comment class 1 car" in lines
    start = lines.index("element vertex 7")
    position = PLY_TYPES[np.dtype(dtype).name]
    assert lines[start + 1 :] == [
        f"property {position if c.name in 'xyz' else PLY_TYPES[c.dtype]} {c.name}" for c in COLUMNS
    ]


def test_no_column_is_of_a_type_that_readers_skip() -> None:
    """docs/conventions.md; the places are float or double."""
    assert {column.dtype for column in columns_of(truth=True, vectors=True)} <= set(OPEN3D_DTYPES)


@pytest.mark.parametrize("ascii", [False, True])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_open3d_reads_everything(tmp_path: Path, dtype: Any, ascii: bool, open3d: ModuleType) -> None:
    cloud = small_cloud(
        50, xyz_m=small_columns(50)["xyz_m"].astype(dtype), metadata={"scene": "ä" * 3000 + "\nend_header"}
    )
    path = tmp_path / "a.ply"
    cloud.save(path, ascii=ascii)
    legacy = open3d.io.read_point_cloud(str(path))
    np.testing.assert_allclose(np.asarray(legacy.points), cloud.xyz_m, rtol=1e-7)
    tensor = open3d.t.io.read_point_cloud(str(path))
    assert set(tensor.point) == {"positions"} | {column.name for column in COLUMNS[3:]}
    np.testing.assert_array_equal(tensor.point["positions"].numpy(), cloud.xyz_m, strict=True)
    largest = np.finfo(np.float32).max
    for c in COLUMNS[3:]:
        values = cloud.column(c.name)[:, None]
        if ascii and c.dtype == "float32":
            values = np.where(np.isinf(values), largest, values)
        np.testing.assert_array_equal(tensor.point[c.name].numpy(), values, strict=True)


@pytest.mark.parametrize("ascii", [False, True])
def test_every_truncation_is_noticed(tmp_path: Path, ascii: bool) -> None:
    """Rationale: a copy that broke off must never pass for a frame with fewer points.

    Text is cut at each byte of its points, where half a number is a number too.
    """
    complete, cut = tmp_path / "a.ply", tmp_path / "b.ply"
    small_cloud(3).save(complete, ascii=ascii)
    data = complete.read_bytes()
    points = data.index(b"end_header") if ascii else len(data)
    for size in (*range(0, points, 7), *range(points, len(data))):
        cut.write_bytes(data[:size])
        with told("b.ply"):
            PointCloud.load(cut)
    cut.write_bytes(data + b"\n")
    with told("b.ply | longer"):
        PointCloud.load(cut)


def test_truncation_says_what_was_expected(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    small_cloud(3).save(path)
    size = path.stat().st_size
    os.truncate(path, size - 10)
    with told(f"{path} | {size} bytes | 3 points | {size - 10}"):
        PointCloud.load(path)
    small_cloud(3).save(path, ascii=True)
    os.truncate(path, path.stat().st_size - 1)
    with told("a.ply | 3 lines of points | 2"):
        PointCloud.load(path)


@mistakes(
    r"""
    ply\n -> plo\n | PLY file
    ply\n -> \tPNG\n | PLY file
    comment lidarscene 2\n -> comment lidarscene 9\n | 'comment lidarscene 2'
    property float snr\n -> | properties | lidarscene
    property float snr\n -> property double snr\n | properties | lidarscene
    element vertex 3 -> element vertex -3 | header near | 'format
    element vertex 3 -> element face 3 | header near | 'format
    element vertex 3 -> element vertex 999999999999999999 | truncated
    little -> big | header
    comment frame sensor -> comment frame moon | 'frame' | 'sensor'
    """
)
def test_foreign_and_damaged_files(tmp_path: Path, given: str, named: str) -> None:
    path = tmp_path / "a.ply"
    small_cloud(3).save(path)
    old, _, new = given.encode().partition(b" -> " if " -> " in given else b" ->")
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with told(f"a.ply | {named}"):
        PointCloud.load(path)


def test_damaged_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    small_cloud(3).save(path, ascii=True)
    head, body = path.read_text().split("end_header\n")
    for damaged in (body.replace(" ", " x", 1), "\n\n" + body, body.replace(" ", " 1 ", 1), "nan" + body):
        path.write_text(head + "end_header\n" + damaged)
        with told("a.ply"):
            PointCloud.load(path)


def test_missing_file(tmp_path: Path) -> None:
    with told("none.ply | no such file"):
        PointCloud.load(tmp_path / "none.ply")
    with told("folder"):
        PointCloud.load(tmp_path, format="ply")


def test_writing_takes_no_step_for_each_point(tmp_path: Path) -> None:
    """Rationale: 10 million points are a second's work for NumPy, and minutes for lines of Python.

    What is counted is lines and calls, of Python and of C: as many for 10,000 points as for 10, both one block.
    """

    def steps(points: int) -> int:
        cloud, calls = small_cloud(points), [0]

        def count(*_: Any) -> Any:
            calls[0] += 1
            return count

        before = sys.gettrace(), sys.getprofile()
        sys.settrace(count)
        sys.setprofile(count)
        try:
            cloud.save(tmp_path / "a.ply")
        finally:
            sys.setprofile(before[1])
            sys.settrace(before[0])
        return calls[0]

    steps(10)  # the first of a process imports and caches
    # What other tests left is sometimes collected meanwhile.
    assert 100 < steps(10_000) < steps(10) + 1000


@pytest.mark.parametrize("ascii", [False, True])
def test_colours_for_viewers(tmp_path: Path, ascii: bool) -> None:
    """Reference: trimesh, which shows them; our own reader gives the same cloud as without them."""
    import trimesh

    cloud = small_cloud(9)
    cloud.save(tmp_path / "c.ply", colour_by="class", ascii=ascii)
    cloud.save(tmp_path / "p.ply", ascii=ascii)
    drawn = trimesh.load(tmp_path / "c.ply")
    np.testing.assert_array_equal(drawn.visual.vertex_colors[:, :3], cloud.colours("class"))
    with_colours, plain = (PointCloud.load(tmp_path / name) for name in ("c.ply", "p.ply"))
    for column in plain.columns:
        np.testing.assert_array_equal(with_colours.column(column.name), plain.column(column.name))
    with told("colours | ply"):
        cloud.save(tmp_path / "c.npz", colour_by="class")


def test_every_scalar_type_of_ply(tmp_path: Path) -> None:
    """Turk's file format, and the names that later programs gave the same types; least and largest number of each."""
    types = {
        "i1": ("char", "int8"),
        "u1": ("uchar", "uint8"),
        "i2": ("short", "int16"),
        "u2": ("ushort", "uint16"),
        "i4": ("int", "int32"),
        "u4": ("uint", "uint32"),
        "f4": ("float", "float32"),
        "f8": ("double", "float64"),
    }
    fields = [(f"{name}_", kind) for kind, names in types.items() for name in names]
    for word, order in (("binary_little_endian", "<"), ("binary_big_endian", ">")):
        rows = np.zeros(2, [(name, order + kind) for name, kind in fields])
        for name, kind in fields:
            limits = np.iinfo(kind) if kind[0] in "iu" else np.finfo(kind)
            rows[name] = [limits.min, limits.max]
        lines = [f"property {name[:-1]} {name}" for name, _ in fields]
        head = "\n".join(["ply", f"format {word} 1.0", "element vertex 2", *lines, "end_header", ""])
        (tmp_path / "a.ply").write_bytes(head.encode() + rows.tobytes())
        columns = ply.ply_columns(tmp_path / "a.ply")
        assert list(columns) == [name for name, _ in fields]
        for name, values in columns.items():
            np.testing.assert_array_equal(values, rows[name])


def test_columns_of_ours_in_another_reader(tmp_path: Path) -> None:
    """What is no cloud: trimesh finds the places, and the bytes are little-endian."""
    columns = {"x": np.float32([1, 2]), "y": np.float32([3, 4]), "z": np.float32([5, 6]), "n": np.int32([7, -8])}
    ply.write_columns(tmp_path / "a.ply", columns, comments=["Maß"])
    np.testing.assert_array_equal(trimesh.load(tmp_path / "a.ply").vertices, [[1, 3, 5], [2, 4, 6]])
    assert (tmp_path / "a.ply").read_bytes().endswith(struct.pack("<fffi", 2, 4, 6, -8))


def test_text_of_the_shortest_numbers(tmp_path: Path) -> None:
    """Two bytes each, a digit and what stands behind it: as many points as a file has room for."""
    zeros = {name: np.zeros_like(values) for name, values in small_columns(400).items()}
    cloud = PointCloud(**zeros)
    cloud.save(tmp_path / "a.ply", ascii=True)
    assert (tmp_path / "a.ply").read_bytes().endswith(b"\n" + b" ".join([b"0"] * len(COLUMNS)) + b"\n")
    assert len(PointCloud.load(tmp_path / "a.ply")) == 400
