"""PCD: as Open3D reads it, and its header against the specification."""

import struct
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import PLACED, clipped_to_finite, need
from helpers.mistakes import told

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats import pcd

N = 50


@pytest.mark.parametrize("n", [1, N])
def test_text_in_open3d(tmp_path: Path, n: int, open3d: ModuleType) -> None:
    """Reference: Open3D's tensor reader, which knows every field; binary files are in test_oracles.py."""
    cloud = small_cloud(n)
    cloud.save(tmp_path / "a.pcd", ascii=True)
    theirs = open3d.t.io.read_point_cloud(str(tmp_path / "a.pcd"))
    np.testing.assert_array_equal(theirs.point["positions"].numpy(), cloud.xyz_m)
    for column in cloud.columns[3:]:
        stored = theirs.point[column.name].numpy()[:, 0]
        np.testing.assert_array_equal(stored, clipped_to_finite(cloud.column(column.name)))


@pytest.mark.parametrize("kind", ["pcd", "pcd-compressed", "ascii"])
def test_a_map_in_open3d_and_pypcd4(tmp_path: Path, kind: str, open3d: ModuleType, library: Any) -> None:
    """Reference: two readers, of which Open3D's old one gives zeros for fields of 8 bytes. In UTM they have the points
    from the viewpoint on, which is whole metres, without a turn.
    """
    if kind != "ascii":
        need(kind)
    origin_m = np.array([654_321.7, 5_234_567.2, 412.3])
    xyz_m = origin_m + small_cloud(N).xyz_m.astype(float)
    metadata = PLACED | {"sensor_position_m": " ".join(map(repr, origin_m.tolist()))}
    path = tmp_path / "a.pcd"
    small_cloud(N, xyz_m=xyz_m, metadata=metadata).save(
        path, format="pcd" if kind == "ascii" else kind, ascii=kind == "ascii"
    )
    viewpoint = path.read_bytes().split(b"VIEWPOINT ")[1].split(b"\n")[0].decode().split()
    assert [float(word) for word in viewpoint] == [654_322.0, 5_234_567.0, 412.0, 1.0, 0.0, 0.0, 0.0]
    place_m = np.array([float(word) for word in viewpoint[:3]])
    legacy = np.asarray(open3d.io.read_point_cloud(str(path)).points)
    pypcd4 = library("pypcd4").PointCloud.from_path(path).numpy(("x", "y", "z"))
    for theirs in (legacy, pypcd4):
        np.testing.assert_allclose(place_m + theirs.astype(float), xyz_m, rtol=0.0, atol=1e-5)


def test_pcd_header(tmp_path: Path) -> None:
    """Reference: the specification of PCD 0.7: the order of the entries, and the viewpoint as place and quaternion."""
    small_cloud(3, metadata=PLACED).save(tmp_path / "a.pcd")
    head = (tmp_path / "a.pcd").read_bytes().split(b"DATA binary\n")[0].decode().splitlines()
    words = [line.split(" ") for line in head if not line.startswith("#")]
    entries = "VERSION FIELDS SIZE TYPE COUNT WIDTH HEIGHT VIEWPOINT POINTS"
    assert " ".join(w[0] for w in words) == entries
    viewpoint = [float(w) for w in words[7][1:]]
    np.testing.assert_allclose(viewpoint, [1, 2, 3, 0.5**0.5, 0, 0, 0.5**0.5], atol=1e-15)
    assert max(map(len, head)) < 1024


def test_bytes_that_do_not_compress(library: Any) -> None:
    """Reference: the LZF library takes our runs apart. Lengths around the run's, for which they differ."""
    lzf = library("lzf")
    rng = np.random.default_rng(3)
    for size in (1, 31, 32, 33, 64, 1000):
        data = rng.bytes(size)
        assert lzf.compress(data) is None
        assert lzf.decompress(pcd._uncompressed_runs(data), size) == data


def test_pcd_counts_its_points(tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    for ascii in (False, True):
        small_cloud(5).save(path, ascii=ascii)
        path.write_bytes(path.read_bytes().replace(b"POINTS 5", b"POINTS 6"))
        with told("a.pcd"):
            PointCloud.load(path)


def test_an_array_of_other_programs_is_rows_by_columns(tmp_path: Path) -> None:
    """WIDTH is the length of a row, HEIGHT the number of rows (PCD 0.7)."""
    head = "VERSION 0.7\nFIELDS x\nSIZE 4\nTYPE F\nCOUNT 1\nWIDTH 3\nHEIGHT 2\nPOINTS 6\nDATA binary\n"
    (tmp_path / "a.pcd").write_bytes(head.encode() + np.arange(6, dtype="<f4").tobytes())
    columns, shape = pcd.pcd_columns(tmp_path / "a.pcd")
    assert shape == (2, 3)
    assert columns["x"].tolist() == [0, 1, 2, 3, 4, 5]


def test_a_compressed_file_begins_with_both_lengths(tmp_path: Path, library: Any) -> None:
    """PCD 0.7: the compressed length, then the whole one, 32 bits each; then column after column."""
    need("pcd-compressed")
    cloud = small_cloud(N)
    cloud.save(tmp_path / "a.pcd", format="pcd-compressed")
    _, body = (tmp_path / "a.pcd").read_bytes().split(b"DATA binary_compressed\n", 1)
    packed, size = struct.unpack_from("<II", body)
    assert packed == len(body) - 8 < size == N * sum(cloud.column(c.name).itemsize for c in cloud.columns)
    unpacked = library("lzf").decompress(body[8:], size)
    np.testing.assert_array_equal(np.frombuffer(unpacked, "<f4", N), cloud.xyz_m[:, 0])
