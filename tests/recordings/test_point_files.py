"""Files of points: of data sets, of other programs, of ours, and folders of them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import PLACED, need
from helpers.mistakes import told

from lidarscene.errors import OptionWarning
from lidarscene.recordings.opening import open_recording

ROWS = np.array([[3, 0, 0, 0.5, 2], [0, 4, 0, 0.25, 7], [0, 0, -5, 0, 9]], np.float32)
RANGES = [3.0, 4.0, 5.0]

PLY = """\
ply
format {order} 1.0
comment of another program
element vertex 3
property double x
property float y
property float z
property uchar ring
element face 0
property list uchar int vertex_indices
end_header
"""

PCD = """\
VERSION 0.7
FIELDS x y _ z rgb3
SIZE 4 4 2 4 1
TYPE F F U F U
COUNT 1 1 2 1 3
WIDTH {width}
HEIGHT {height}
VIEWPOINT 0 0 0 1 0 0 0
POINTS 4
DATA binary
"""


def test_kitti_and_nuscenes_are_rows_of_float32(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(ROWS[:, :4].tobytes())
    (tmp_path / "a.pcd.bin").write_bytes(ROWS.tobytes())
    kitti, nuscenes = (open_recording(tmp_path / name)[0] for name in ("a.bin", "a.pcd.bin"))
    for sweep in (kitti, nuscenes):
        np.testing.assert_array_equal(sweep.range_m, RANGES)
        np.testing.assert_array_equal(sweep.xyz_m, ROWS[:, :3])
        assert sweep.intensity is not None
        np.testing.assert_array_equal(sweep.intensity, ROWS[:, 3])
        assert not sweep.includes_lost
    assert kitti.ring is None
    assert nuscenes.ring is not None
    assert nuscenes.ring.tolist() == [2, 7, 9]


def test_markers_of_lost_pulses_in_nuscenes_are_no_points(tmp_path: Path) -> None:
    """They were at the origin, and moved with the car."""
    rows = np.array([[0.5, 0.3, 0, 9, 1], [0, 0, 0, 9, 1], [0.9, 0.9, 0, 9, 1]], np.float32)
    (tmp_path / "a.pcd.bin").write_bytes(rows.tobytes())
    (tmp_path / "a.bin").write_bytes(rows[:, :4].tobytes())
    nuscenes, kitti = (open_recording(tmp_path / name)[0] for name in ("a.pcd.bin", "a.bin"))
    assert nuscenes.range_m.tolist() == pytest.approx([1.2728], abs=1e-4)
    assert kitti.has_return.sum() == 2


def test_a_sweep_of_argoverse_2(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """Written by pyarrow with the columns and types of the data set: half floats, and nanoseconds from the start."""
    library("pyarrow")
    import pyarrow
    from pyarrow import feather

    columns = {
        "x": np.array([3.0, 0.0, -4.0], np.float16),
        "y": np.array([0.0, 4.0, 3.0], np.float16),
        "z": np.array([0.0, 3.0, 12.0], np.float16),
        "intensity": np.array([10, 255, 0], np.uint8),
        "laser_number": np.array([0, 63, 31], np.uint8),
        "offset_ns": np.array([2_654_000, 2_656_303, 104_000_000], np.int32),
    }
    path = tmp_path / "315966265259836000.feather"
    feather.write_feather(pyarrow.table(columns), path)
    sweep = open_recording(path)[0]
    assert sweep.range_m.tolist() == pytest.approx([3.0, 5.0, 13.0])
    assert sweep.intensity is not None
    assert sweep.intensity.tolist() == [10.0, 255.0, 0.0]
    assert sweep.ring is not None
    assert sweep.ring.tolist() == [0, 63, 31]
    assert sweep.time_s is not None
    assert sweep.time_s.tolist() == pytest.approx([0.0, 2.303e-6, 0.101346], abs=1e-12)
    path.write_bytes(path.read_bytes()[:-40])
    with told("feather"):
        open_recording(path)[0]


def test_ply_of_another_program(tmp_path: Path) -> None:
    for order, sign in (("binary_little_endian", "<"), ("binary_big_endian", ">"), ("ascii", "")):
        header = PLY.format(order=order).encode()
        dtype = np.dtype([("x", f"{sign}f8"), ("y", f"{sign}f4"), ("z", f"{sign}f4"), ("ring", "u1")])
        rows = np.array([(*row[:3], row[4]) for row in ROWS.tolist()], dtype)
        text = "".join(f"{x} {y} {z} {ring}\n" for x, y, z, ring in rows.tolist()).encode()
        body = rows.tobytes() if sign else text
        path = tmp_path / "a.ply"
        for lines in (header.replace(b"\n", b"\r\n"), header):
            path.write_bytes(lines + body)
            sweep = open_recording(path)[0]
            np.testing.assert_array_equal(sweep.xyz_m, ROWS[:, :3])
            assert sweep.ring is not None
            assert sweep.ring.tolist() == [2, 7, 9]
        path.write_bytes(header + body[:-8])
        with told("a.ply"):
            open_recording(path)[0]


def test_pcd_of_another_program_and_its_lost_pulses(tmp_path: Path) -> None:
    dtype = np.dtype([("x", "<f4"), ("y", "<f4"), ("pad", "<u2", 2), ("z", "<f4"), ("rgb", "u1", 3)])
    rows = np.zeros(4, dtype)
    for axis, name in enumerate("xyz"):
        rows[name][:3] = ROWS[:, axis]
    rows["x"][3] = np.nan
    path = tmp_path / "a.pcd"
    path.write_bytes(PCD.format(width=2, height=2).encode() + rows.tobytes())
    array = open_recording(path)[0]
    assert array.shape == (2, 2)
    assert array.lost.tolist() == [[False, False], [False, True]]
    path.write_bytes(PCD.format(width=4, height=1).encode() + rows.tobytes())
    assert open_recording(path)[0].range_m.tolist() == RANGES
    whole = path.read_bytes()
    path.write_bytes(whole + b"\0" * 12)
    with pytest.warns(OptionWarning, match=r"a\.pcd: 12 bytes after the points are left out"):
        assert open_recording(path)[0].range_m.tolist() == RANGES
    path.write_bytes(whole[:-1])
    with told("a.pcd | 76 bytes | 75"):
        open_recording(path)[0]


@pytest.mark.parametrize("end", ["", "\n", "\r\n\r\n"])
def test_text_of_another_program_ends_as_it_likes(tmp_path: Path, end: str) -> None:
    header = PCD.format(width=3, height=1).replace("POINTS 4\nDATA binary", "POINTS 3\nDATA ascii")
    text = "\n".join(f"{x} {y} 0 0 {z} 1 2 3" for x, y, z in ROWS[:, :3].tolist())
    (tmp_path / "a.pcd").write_text(header + text + end, newline="")
    np.testing.assert_array_equal(open_recording(tmp_path / "a.pcd")[0].xyz_m, ROWS[:, :3])


@pytest.mark.parametrize("name", ["las", "laz"])
@pytest.mark.parametrize(("version", "point_format"), [("1.2", 1), ("1.3", 3), ("1.4", 8)])
def test_las_of_another_program(
    tmp_path: Path, library: Callable[[str], Any], name: str, version: str, point_format: int
) -> None:
    """Headers of 227, 235 and 375 bytes: what follows the short ones is no part of them."""
    laspy = library("laspy")
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.offsets = [40_000.0, 0.0, 0.0]  # all bits of the first point's x are set
    las = laspy.LasData(header)
    las.x, las.y, las.z = ROWS[:, :3].astype(float).T
    las.write(tmp_path / f"a.{name}")
    np.testing.assert_allclose(open_recording(tmp_path / f"a.{name}")[0].xyz_m, ROWS[:, :3], atol=0.005)


@pytest.mark.parametrize("name", ["ply", "pcd", "las", "laz"])
def test_our_own_files_are_recordings_too(tmp_path: Path, name: str) -> None:
    """Points are in the sensor's frame with its pose, without the true reflectivity.

    Rationale: `twin` of a rendered cloud took the world's origin for the sensor, and reflectivities for percents.
    """
    need(name)
    metadata = PLACED | {"sensor_to_world": "0 -1 0 1  1 0 0 2  0 0 1 3"}
    cloud, path = small_cloud(metadata=metadata), tmp_path / f"a.{name}"
    cloud.save(path)
    sweep = open_recording(path)[0]
    assert sweep.reflectivity is None
    assert sweep.pose is not None
    assert sweep.pose.position_m.tolist() == [1.0, 2.0, 3.0]
    cloud = cloud.in_sensor_frame()
    # LAS holds positions in steps of 10 um.
    np.testing.assert_allclose(sweep.xyz_m, cloud.xyz_m, atol=1e-5 if name in ("las", "laz") else 1e-7, rtol=1e-6)
    assert sweep.ring is not None
    np.testing.assert_array_equal(sweep.ring, cloud.ring)
    assert sweep.time_s is not None
    np.testing.assert_allclose(sweep.time_s + sweep.start_s, cloud.time_s, atol=1e-12)


def test_a_folder_is_frames_by_the_numbers_in_their_names(tmp_path: Path) -> None:
    for number in (2, 10, 1):
        (tmp_path / f"{number}.bin").write_bytes((ROWS[:, :4] * number).tobytes())
        (tmp_path / f"._{number}.bin").write_bytes(b"\0\5\x16\7")  # of macOS
    assert [float(sweep.range_m[0]) for sweep in open_recording(tmp_path)] == [3.0, 6.0, 30.0]
    (tmp_path / "3.pcd.bin").write_bytes(ROWS.tobytes())
    with pytest.warns(OptionWarning, match=r"several formats .* one sensor: \.bin, \.pcd\.bin"):
        open_recording(tmp_path)


def test_what_is_damaged_is_told(tmp_path: Path, library: Callable[[str], Any]) -> None:
    whole = PCD.format(width=4, height=1).encode() + bytes(76)
    five = np.random.default_rng(5).normal(scale=20.0, size=(40, 5)).astype("<f4")
    five[:, 3:] = np.abs(five[:, 3:])
    for name, content, named in (
        ("a.bin", bytes(17), "rows of 16 bytes | x, y, z, intensity | 17 bytes"),
        ("d.bin", five.tobytes(), "x, y, z, intensity | float32 | .pcd.bin | negative"),
        ("e.bin", five[:, :4].astype("<f8").tobytes(), "x, y, z, intensity | float32 | .pcd.bin | negative"),
        ("f.pcd.bin", five.astype("<f8").tobytes(), "x, y, z, intensity, ring | float32 | negative"),
        ("b.bin", b"", "points or packets | empty"),
        ("c.bin", bytes(32), "points | none"),
        ("a.abc", b"1", ".pcap | .osf"),
        ("a.pcd", whole.replace(b"binary", b"BINARY"), "DATA | binary_compressed | BINARY"),
        ("b.pcd", whole.replace(b"POINTS", b"#"), "'POINTS'"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement face 1\nend_header\n", "PLY | 'vertex'"),
    ):
        (tmp_path / name).write_bytes(content)
        with told(f"{name} | {named}"):
            open_recording(tmp_path / name)[0]
    with told("nothing.bin | recording"):
        open_recording(tmp_path / "nothing.bin")
