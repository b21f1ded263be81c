"""LAS and LAZ: byte by byte, as LASzip reads them, and written piece by piece."""

import itertools
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import assert_same, small_cloud
from helpers.formats import PLACED, file_of, need, written
from helpers.mistakes import told

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats import las
from lidarscene.recordings.opening import open_recording

N = 50


def test_las_byte_by_byte(tmp_path: Path) -> None:
    """Reference: the LAS 1.4 R15 specification, offsets of the public header and of point format 6."""
    need("las")
    cloud = small_cloud(N, metadata=PLACED, channel=np.arange(N))
    cloud.save(tmp_path / "a.las")
    data = (tmp_path / "a.las").read_bytes()
    assert data[:4] == b"LASF"
    assert (data[24], data[25], data[104]) == (1, 4, 6)
    assert data[6] & 16  # "WKT", which table 4 asks of this point format: PDAL and QGIS refuse others
    (start,) = struct.unpack_from("<I", data, 96)
    (size,) = struct.unpack_from("<H", data, 105)
    (count,) = struct.unpack_from("<Q", data, 247)
    scale, offset = struct.unpack_from("<3d", data, 131), struct.unpack_from("<3d", data, 155)
    assert count == N
    assert offset == (1.0, 2.0, 3.0)
    rows = np.frombuffer(data, np.uint8, count=N * size, offset=start).reshape(N, size)
    xyz = rows[:, :12].copy().view("<i4") * scale + offset
    np.testing.assert_allclose(xyz, cloud.xyz_m, rtol=0, atol=0.51 * scale[0])
    peak = rows[:, 12:14].copy().view("<u2")[:, 0] / 65535.0 * cloud.intensity.max()
    np.testing.assert_allclose(peak, cloud.intensity, rtol=0, atol=0.51 / 65535.0 * cloud.intensity.max())
    assert set(rows[:, 14] & 15) <= {1}  # return numbers 0 and 1 of the made-up cloud
    expected = np.where(cloud.status != 0, 7, np.where(cloud.class_id < 0, 1, 64 + cloud.class_id))
    np.testing.assert_array_equal(rows[:, 16], expected)
    np.testing.assert_array_equal(rows[:, 22:30].copy().view("<f8")[:, 0], cloud.time_s)
    # Behind the 30 bytes of the format: every column but the positions, in order and exact.
    types = [(c.name, cloud.column(c.name).dtype) for c in cloud.columns[3:]]
    extra = np.ascontiguousarray(rows[:, 30:]).view(np.dtype(types))[:, 0]
    for name, _ in types:
        np.testing.assert_array_equal(extra[name], cloud.column(name))


def test_laz_in_laszip(tmp_path: Path, library: Any) -> None:
    """Reference: LASzip itself; we compress with lazrs, which is another program."""
    need("laz")
    library("laszip")
    laspy = library("laspy")
    cloud = small_cloud(N)
    cloud.save(tmp_path / "a.laz")
    theirs = laspy.read(tmp_path / "a.laz", laz_backend=laspy.LazBackend.Laszip)
    np.testing.assert_allclose(theirs.xyz, cloud.xyz_m, rtol=0, atol=0.51e-5)
    np.testing.assert_array_equal(theirs["snr"], cloud.snr)
    np.testing.assert_array_equal(theirs["body"], cloud.body)


def test_las_counts_returns_of_a_pulse(tmp_path: Path, library: Any) -> None:
    """Three pulses of 1, 3 and 2 returns."""
    need("las")
    laspy = library("laspy")
    columns = {
        "time_s": np.repeat([0.0, 1e-5, 2e-5], [1, 3, 2]),
        "return_number": [1, 1, 2, 3, 1, 2],
        "azimuth_rad": np.repeat([0.1, 0.2, 0.3], [1, 3, 2]),
        "elevation_rad": np.zeros(6),
        "channel": np.zeros(6),
    }
    small_cloud(6, **columns).save(tmp_path / "a.las")
    las = laspy.read(tmp_path / "a.las")
    assert list(las.number_of_returns) == [1, 3, 3, 3, 2, 2]
    assert list(las.return_number) == [1, 1, 2, 3, 1, 2]


@pytest.mark.parametrize("name", ["las", "laz"])
@pytest.mark.parametrize("n", [0, 1, 100])
def test_las_keeps_all_but_the_last_digits_of_positions(tmp_path: Path, name: str, n: int) -> None:
    """Tolerance: half of the step that LAS has, and float32 of 100 m."""
    need(name)
    cloud = small_cloud(n)
    cloud.save(file_of(tmp_path, name))
    loaded = PointCloud.load(file_of(tmp_path, name))
    np.testing.assert_allclose(loaded.xyz_m, cloud.xyz_m, rtol=0, atol=0.5 * las.STEP_M + 4e-6)
    assert loaded.xyz_m.dtype == np.float32
    rounded = {"xyz_m": cloud.xyz_m, "range_m": cloud.range_m}
    assert_same(loaded.__class__(**{f: getattr(loaded, f) for f in loaded.__dataclass_fields__} | rounded), cloud)


def test_las_refuses_what_its_integers_cannot_hold(tmp_path: Path) -> None:
    need("las")
    far = np.zeros((2, 3), np.float64)
    far[1, 0] = 3e4
    with told("a.las | 21475 m"):
        small_cloud(2, xyz_m=far).save(tmp_path / "a.las")


def test_laz_does_not_show_how_it_was_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More points than the 50,000 of a chunk of LAZ, in pieces that end within chunks, against one write of all."""
    need("laz")
    cloud = small_cloud(120_000)
    pieces = [cloud.select(slice(*ends)) for ends in itertools.pairwise([0, 49_999, 50_001, 60_000, 120_000])]
    streamed = written(tmp_path / "pieces.laz", "laz", pieces)
    monkeypatch.setattr(las, "PIECE_POINTS", 10**9)
    cloud.save(tmp_path / "whole.laz")
    assert streamed == (tmp_path / "whole.laz").read_bytes()


def test_las_does_not_cut_a_pulse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pulses of three returns in pieces of four points and more: number_of_returns is that of the pulse."""
    need("las")
    import laspy

    monkeypatch.setattr(las, "PIECE_POINTS", 4)
    pulse, angle = np.repeat(np.arange(5.0), 3), np.repeat(np.zeros(5, np.float32), 3)
    cloud = small_cloud(
        15,
        time_s=pulse,
        channel=angle.astype(np.int32),
        azimuth_rad=angle,
        elevation_rad=angle,
        return_number=np.tile(np.array([1, 2, 3], np.uint8), 5),
    )
    cloud.save(tmp_path / "a.las")
    assert np.array(laspy.read(tmp_path / "a.las").number_of_returns).tolist() == 15 * [3]


def test_las_intensity_is_of_the_largest_of_all_pieces(tmp_path: Path) -> None:
    """The second piece holds the largest: the first one's points are put in order afterwards."""
    need("las")
    import laspy

    low = small_cloud(2, intensity=np.array([1.0, 2.0], np.float32))
    written(tmp_path / "a.las", "las", [low, small_cloud(1, intensity=np.array([4.0], np.float32))])
    # Rounded to 16 bits: a quarter and a half of 65535 are 16383.75 and 32767.5, which goes to the even neighbour.
    assert laspy.read(tmp_path / "a.las").intensity.tolist() == [16384, 32768, 65535]


def test_las_says_nothing_wrong_of_least_and_largest(tmp_path: Path) -> None:
    """What the header declares of extra bytes holds for all points, or is not declared."""
    need("las")
    import laspy

    small_cloud(100).save(tmp_path / "a.las")
    las_file = laspy.read(tmp_path / "a.las")
    for extra in las_file.header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs:
        values = np.asarray(las_file[extra.format_name()])
        assert not extra.min_is_relevant() or extra.min[0] <= values.min()
        assert not extra.max_is_relevant() or extra.max[0] >= values.max()


@pytest.mark.parametrize("lost", [1, 2.5])
def test_a_las_that_ends_within_its_points_is_told(tmp_path: Path, lost: float) -> None:
    """Rationale: laspy reads as many points as there are, and says nothing if the last one is whole."""
    need("las")
    path = tmp_path / "a.las"
    small_cloud(9).save(path)
    data = path.read_bytes()
    points, size = *struct.unpack_from("<I", data, 96), *struct.unpack_from("<H", data, 105)
    path.write_bytes(data[: points + size * 9 - int(lost * size)])
    for read in (PointCloud.load, lambda path: open_recording(path)[0]):
        with told(f"a.las | 9 points | {9 - math.ceil(lost)}"):
            read(path)


@pytest.mark.parametrize(
    ("place", "named"),
    [
        ("count", "chunks | bytes | 4294967295"),
        ("table", "in the file"),
        ("layer", "within the file"),
        ("items", "bytes | 0"),
    ],
)
def test_a_laz_with_a_wrong_table_of_chunks(tmp_path: Path, place: str, named: str) -> None:
    """lazrs asks for the memory of all chunks first, and ends the process where there is none."""
    need("laz")
    path = tmp_path / "a.laz"
    small_cloud().save(path)
    data = bytearray(path.read_bytes())
    (points,) = struct.unpack_from("<I", data, 96)  # offset to point data
    (table,) = struct.unpack_from("<q", data, points)
    if place == "count":
        struct.pack_into("<I", data, table + 4, 2**32 - 1)
    elif place == "layer":  # the size of the first, after the first point and the number of points
        (point_bytes,) = struct.unpack_from("<H", data, 105)
        struct.pack_into("<I", data, points + 8 + point_bytes + 4, 2**31)
    elif place == "items":  # none in the record of LASzip: 54 bytes of header, then 32 before their number
        struct.pack_into("<H", data, data.index(b"laszip encoded") - 2 + 54 + 32, 0)
    else:
        struct.pack_into("<q", data, points, 2**40)
    path.write_bytes(data)
    with told(f"a.laz | {named}"):
        PointCloud.load(path)


def test_las_standard_fields_at_their_ends(tmp_path: Path, library: Any) -> None:
    """Steps of 0.006 degrees up to 180, classes up to 255, and pulses told apart by each of what a pulse has."""
    need("las")
    columns = {
        "azimuth_rad": np.radians([-180.0, 180.0, 0.6, 0.6, 0.6, 0.6, 0.6]),
        "elevation_rad": [0, 0, 0, 0, 0.1, 0.1, 0.1],
        "channel": [0, 0, 0, 1, 1, 1, 1],
        "time_s": [0, 0, 0, 0, 0, 1e-6, 1e-6],
        "return_number": [1, 1, 1, 1, 1, 1, 2],
        "class_id": [0, 1, 190, 191, 192, 250, -1],
        "status": [0] * 7,
        "intensity": [0.0, 1, 2, 3, 4, 0.5, 8],
    }
    arrays = {name: np.array(values) for name, values in columns.items()}
    small_cloud(7, class_names=(), **arrays).save(tmp_path / "a.las")
    las = library("laspy").read(tmp_path / "a.las")
    np.testing.assert_array_equal(las["scan_angle"], [-30_000, 30_000, 100, 100, 100, 100, 100])
    np.testing.assert_array_equal(las.classification, [64, 65, 254, 255, 255, 255, 1])
    np.testing.assert_array_equal(las.number_of_returns, [1, 1, 1, 1, 1, 2, 2])
    np.testing.assert_array_equal(las.intensity, np.rint(np.array(columns["intensity"]) / 8 * 65_535))


def test_las_returns_beyond_fifteen(tmp_path: Path, library: Any) -> None:
    """Four bits: the number of a return is never above that of all."""
    need("las")
    zeros = {name: np.zeros(17) for name in ("azimuth_rad", "elevation_rad", "channel", "time_s")}
    small_cloud(17, return_number=np.arange(1, 18), **zeros).save(tmp_path / "a.las")
    las = library("laspy").read(tmp_path / "a.las")
    np.testing.assert_array_equal(las.return_number, np.minimum(np.arange(1, 18), 15))
    np.testing.assert_array_equal(las.number_of_returns, np.full(17, 15))


def test_las_of_what_was_selected(tmp_path: Path, library: Any) -> None:
    """The third return of a pulse alone is one of three or more; the largest intensity may be that of any piece."""
    need("las")
    third_return = small_cloud(1, return_number=np.array([3]), intensity=np.array([4.0], np.float32))
    written(tmp_path / "a.las", "las", [third_return, small_cloud(1, intensity=np.array([1.0], np.float32))])
    las = library("laspy").read(tmp_path / "a.las")
    assert (las.return_number[0], las.number_of_returns[0]) == (3, 3)
    assert list(las.intensity) == [65_535, 16_384]
