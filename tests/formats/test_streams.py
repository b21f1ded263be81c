"""Clouds written piece by piece: the bytes of the whole cloud's file, whole or not at all."""

import importlib
import itertools
import os
from pathlib import Path

import numpy as np
import pytest
from helpers.clouds import assert_same, small_cloud
from helpers.formats import need

from lidarscene.cloud.points import PointCloud
from lidarscene.errors import InputError, OutputError
from lidarscene.formats import las, parquet
from lidarscene.formats.registry import FORMATS

STREAMED = [name for name, one in FORMATS.items() if one.stream]
CUTS = ([0, 100], [0, 1, 1, 37, 100], [0, 0, 50, 100, 100], [0, 33, 66, 99, 100])


def written(path: Path, name: str, pieces: list[PointCloud]) -> bytes:
    with FORMATS[name].stream(path) as append:
        for piece in pieces:
            append(piece)
    return path.read_bytes()


def test_which_formats_can() -> None:
    assert STREAMED == ["ply", "pcd", "las", "laz", "kitti", "nuscenes", "parquet"]


@pytest.mark.parametrize("truth", [False, True])
@pytest.mark.parametrize("cuts", CUTS, ids=str)
@pytest.mark.parametrize("name", STREAMED)
def test_pieces_make_the_file_of_the_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, cuts: list[int], truth: bool
) -> None:
    """Row groups and blocks of 30 points, so that pieces are both smaller and larger than they are."""
    need(name)
    monkeypatch.setattr(parquet, "GROUP_POINTS", 30)
    monkeypatch.setattr(las, "BLOCK_POINTS", 30)
    cloud = small_cloud(100, truth=truth)
    suffix = FORMATS[name].suffix
    cloud.save(tmp_path / f"whole{suffix}", format=name)
    pieces = [cloud.select(slice(*ends)) for ends in itertools.pairwise(cuts)]
    assert written(tmp_path / f"pieces{suffix}", name, pieces) == (tmp_path / f"whole{suffix}").read_bytes()


@pytest.mark.parametrize("name", STREAMED)
def test_no_points(tmp_path: Path, name: str) -> None:
    need(name)
    path, none = tmp_path / f"a{FORMATS[name].suffix}", small_cloud(0)
    written(path, name, [none, none])
    if FORMATS[name].read:
        assert_same(PointCloud.load(path), none)
    else:  # rows and nothing else
        assert path.read_bytes() == b""


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
        15, time_s=pulse, channel=angle.astype(np.int32), azimuth_rad=angle, elevation_rad=angle,
        return_number=np.tile(np.array([1, 2, 3], np.uint8), 5),
    )  # fmt: skip
    cloud.save(tmp_path / "a.las")
    assert np.array(laspy.read(tmp_path / "a.las").number_of_returns).tolist() == 15 * [3]


@pytest.mark.parametrize("name", STREAMED)
def test_a_block_that_fails_leaves_what_was_there(tmp_path: Path, name: str) -> None:
    need(name)
    path = tmp_path / f"a{FORMATS[name].suffix}"
    path.write_bytes(b"before")

    def failing() -> None:
        with FORMATS[name].stream(path) as append:
            append(small_cloud(10))
            raise InputError("enough")

    with pytest.raises(InputError, match="enough"):
        failing()
    assert path.read_bytes() == b"before"
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.skipif(os.name == "nt", reason="no limit of a file's size")
@pytest.mark.parametrize("name", STREAMED)
def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path: Path, name: str) -> None:
    """By the system's own limit of the size of files, which numbers without a pattern reach however they are packed."""
    need(name)
    resource = importlib.import_module("resource")
    cloud = small_cloud(50_000, intensity=np.random.default_rng(1).random(50_000, np.float32))
    path = tmp_path / "new" / f"a{FORMATS[name].suffix}"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(OutputError) as error:
            written(path, name, [cloud] * 3)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert str(error.value) == f"{path}: cannot be written: File too large"
    assert os.listdir(tmp_path) == []


def test_row_groups_are_of_one_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need("parquet")
    import pyarrow.parquet

    monkeypatch.setattr(parquet, "GROUP_POINTS", 30)
    written(tmp_path / "a.parquet", "parquet", [small_cloud(25)] * 4)
    file = pyarrow.parquet.ParquetFile(tmp_path / "a.parquet")
    assert [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)] == [30, 30, 30, 10]


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
