"""Clouds written piece by piece: the bytes of the whole cloud's file, whole or not at all."""

import importlib
import itertools
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.clouds import assert_same, small_cloud
from helpers.formats import need, written
from helpers.mistakes import told
from helpers.run_seed import chosen

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.errors import InputError, OutputError
from lidarscene.formats import las, parquet
from lidarscene.formats.cloud_description import library_errors
from lidarscene.formats.registry import FORMATS

STREAMED = [name for name, format_of_file in FORMATS.items() if format_of_file.stream]
CUTS = ([0, 100], [0, 1, 1, 37, 100], [0, 0, 50, 100, 100], [0, 33, 66, 99, 100])


@pytest.mark.parametrize("truth", chosen(1, [False, True]))
@pytest.mark.parametrize("cuts", CUTS, ids=str)
@pytest.mark.parametrize("name", STREAMED)
def test_pieces_make_the_file_of_the_whole(tmp_path, monkeypatch, name, cuts, truth):
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
    """The disk is full by the system's own limit of the size of files, which numbers without a pattern reach however
    they are packed.
    """
    need(name)
    resource = importlib.import_module("resource")
    cloud = small_cloud(50_000, intensity=np.random.default_rng(1).random(50_000, np.float32))
    path = tmp_path / "new" / f"a{FORMATS[name].suffix}"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with told(f"{path} | File too large", OutputError):
            written(path, name, [cloud] * 3)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(("free", "message"), [(0, "No space left on device (read failed)"), (1 << 30, "read failed")])
def test_a_library_in_trouble_on_a_full_disk(tmp_path, monkeypatch, free, message):
    """It says in its own words that something failed: why is known by the room that there is."""
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    with pytest.raises(OutputError) as caught, library_errors(tmp_path / "a"):
        raise RuntimeError("read failed\n**** a page of details")
    assert str(caught.value) == f"{tmp_path / 'a'}: cannot be written: {message}"
