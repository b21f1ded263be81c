"""Every format: what comes back, what is refused, and that a file appears whole or not at all."""

import os
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import street
from helpers.clouds import assert_same, small_cloud, small_columns
from helpers.formats import PLACED, file_of, need
from helpers.mistakes import told
from helpers.run_seed import chosen

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.errors import InputError, LidarSceneError
from lidarscene.files import optional
from lidarscene.formats import las
from lidarscene.formats.cloud_columns import OF_VECTORS
from lidarscene.formats.registry import FORMATS, SUFFIXES, format_of

READ = [name for name, format_of_file in FORMATS.items() if format_of_file.read]
EXACT = [name for name in READ if name not in ("las", "laz")]
WAYS = [(name, {}) for name in EXACT] + [(name, {"ascii": True}) for name in EXACT if FORMATS[name].text]


@pytest.mark.parametrize("truth", [False, True])
@pytest.mark.parametrize("dtype", chosen(1, [np.float32, np.float64]))
@pytest.mark.parametrize("n", [0, 1, 100])
@pytest.mark.parametrize(("name", "options"), WAYS)
def test_round_trip(tmp_path: Path, name: str, options: dict[str, bool], n: int, dtype: Any, truth: bool) -> None:
    need(name)
    path = file_of(tmp_path, name)
    cloud = small_cloud(n, truth=truth, xyz_m=small_columns(n)["xyz_m"].astype(dtype))
    cloud.save(path, format=name, **options)
    assert_same(PointCloud.load(path, format=name), cloud)
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize(("name", "options"), [way for way in WAYS if FORMATS[way[0]].text])
def test_blocks_do_not_show(tmp_path, monkeypatch, name, options):
    """Infinity of both signs, too, for which text has no word."""
    monkeypatch.setattr(f"lidarscene.formats.{name}.BLOCK_POINTS", 8)
    for n in (7, 8, 9, 24):
        snr = np.resize(np.float32([np.inf, -np.inf, 0.1, -3.4e38]), n)
        time_s = np.resize([1 / 3, 0.1, 2.0**53 + 2, 5e-324], n)
        cloud = small_cloud(n, snr=snr, time_s=time_s)
        cloud.save(file_of(tmp_path, name), format=name, **options)
        assert_same(PointCloud.load(file_of(tmp_path, name)), cloud)


@pytest.mark.parametrize("name", READ)
def test_any_text_survives(tmp_path: Path, name: str) -> None:
    """Rationale: names come from file names and editors. More than 64 kB of them must not break a header."""
    need(name)
    metadata = {"scene": "Straße\n\r\t\\n end_header TextureFile 雪 \udce9 # VERSION", "two words": " s ", "empty": ""}
    metadata |= {"long": "abcé " * 20000} | dict.fromkeys(("unit", "+", "class"), "reserved")
    cloud = small_cloud(3, metadata=metadata, class_names=("", " a b ", "long " * 500))
    cloud.save(file_of(tmp_path, name), format=name)
    loaded = PointCloud.load(file_of(tmp_path, name), format=name)
    assert (loaded.metadata, loaded.class_names) == (cloud.metadata, cloud.class_names)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("n", [0, 1])
def test_clouds_of_no_point_and_of_one_can_be_written(tmp_path: Path, name: str, n: int) -> None:
    need(name)
    small_cloud(n, truth=False).save(file_of(tmp_path, name), format=name)
    assert file_of(tmp_path, name).is_file()


@pytest.mark.parametrize("name", [name for name in FORMATS if name != "rrd"])
def test_the_same_cloud_gives_the_same_file(tmp_path: Path, name: str) -> None:
    """Rationale: a repeated run must not look like a change. LAS has today's date in bytes 90 to 94; Rerun stamps each
    row of a log with the time at which it was written.
    """
    need(name)
    data = []
    for folder in ("a", "b"):
        path = file_of(tmp_path / folder, name)
        small_cloud(50).save(path, format=name)
        data.append(path.read_bytes())
    assert data[0] == data[1]


@pytest.mark.parametrize("name", FORMATS)
def test_normals_are_in_a_file_of_all_columns(tmp_path: Path, name: str) -> None:
    """Two clouds that differ in a normal alone have the same file only in formats that lack columns."""
    need(name)
    data = []
    for folder, x in (("a", 0.0), ("b", 1.0)):
        vectors = {attribute: np.full(7, x, np.float32) for attribute in OF_VECTORS}
        path = file_of(tmp_path / folder, name)
        small_cloud(**vectors).save(path, format=name)
        data.append(path.read_bytes())
    assert (data[0] != data[1]) == FORMATS[name].all_columns


def test_suffix_names_the_format() -> None:
    """The longest suffix counts, in any case; a name wins over the suffix."""
    assert format_of("a/b.pcd.bin") is FORMATS["nuscenes"]
    assert format_of("a/b.PCD.BIN") is FORMATS["nuscenes"]
    assert format_of("a/b.bin") is FORMATS["kitti"]
    assert format_of("b.pcd") is FORMATS["pcd"]
    assert format_of("b.mcap") is FORMATS["mcap"]
    assert format_of("b.ply", "osi") is FORMATS["osi"]
    with told(f"b.abc | '.abc' | {', '.join(SUFFIXES)}"):
        format_of("b.abc")
    with told("a folder"):
        format_of(os.curdir)
    with told(f"format 'ascii' | {', '.join(FORMATS)}"):
        format_of("b.ply", "ascii")


@pytest.mark.parametrize("name", sorted(set(FORMATS) - set(READ)))
def test_written_only_formats_say_so(tmp_path: Path, name: str) -> None:
    with told(f"written only | {', '.join(READ)}"):
        PointCloud.load(file_of(tmp_path, name), format=name)


def test_only_text_formats_take_ascii(tmp_path: Path) -> None:
    with told("a.npz | text"):
        small_cloud().save(tmp_path / "a.npz", ascii=True)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", [name for name, format_of_file in FORMATS.items() if format_of_file.extra])
def test_a_missing_package_is_told_with_what_to_type(tmp_path, monkeypatch, name):
    extra = FORMATS[name].extra
    for module in list(sys.modules):
        if module.partition(".")[0] in optional.EXTRAS[extra]:
            monkeypatch.setitem(sys.modules, module, None)
    for module in optional.EXTRAS[extra]:
        monkeypatch.setitem(sys.modules, module, None)
    for action in (FORMATS[name].require, lambda: small_cloud().save(file_of(tmp_path, name), format=name)):
        with told(f"pip install 'lidarscene[{extra}]' | pip install", LidarSceneError):
            action()
    assert os.listdir(tmp_path) == []


def test_extras_are_those_of_pyproject() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    for extra, packages in optional.EXTRAS.items():
        declared = {line.split(">")[0] for line in project["optional-dependencies"][extra]}
        assert declared == set(" ".join(packages.values()).split())
    groups = re.findall(r"[\w-]+", " ".join(project["optional-dependencies"]["all"]))
    groups += re.findall(r"[\w-]+", " ".join(project["optional-dependencies"]["recordings"]))
    assert {"lidarscene", "all", *groups} == {"lidarscene", *project["optional-dependencies"]}


@pytest.mark.parametrize("name", [name for name in READ if name != "ply"])
def test_truncated_and_foreign_files_are_refused(tmp_path: Path, name: str) -> None:
    """Rationale: a copy that broke off must never pass for a frame with fewer points."""
    need(name)
    path, damaged = file_of(tmp_path, name), tmp_path / f"b{FORMATS[name].suffix}"
    small_cloud(30).save(path, format=name)
    data = path.read_bytes()
    # The last bytes of a LAZ are its chunk table, without which a reader may still find the points.
    for size in np.linspace(0, len(data) - 40, 25, dtype=int):
        damaged.write_bytes(data[:size])
        with told(damaged.name):
            PointCloud.load(damaged, format=name)
    damaged.write_bytes(b"something else entirely\n" * 100)
    with told(damaged.name):
        PointCloud.load(damaged, format=name)
    with told("none | no such file"):
        PointCloud.load(tmp_path / "none", format=name)


@pytest.mark.parametrize("name", ["npz", "parquet", "las", "pcd"])
def test_files_of_other_programs_are_refused(tmp_path: Path, name: str) -> None:
    need(name)
    path = file_of(tmp_path, name)
    if name == "npz":
        np.savez(path, x=np.zeros(3))
    elif name == "parquet":
        import pyarrow
        import pyarrow.parquet

        pyarrow.parquet.write_table(pyarrow.table({"x": [1.0]}), path)
    elif name == "las":
        import laspy

        laspy.LasData(laspy.LasHeader(version="1.4", point_format=6)).write(path)
    else:
        header = "VERSION 0.7\nFIELDS x\nSIZE 4\nTYPE F\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii"
        path.write_text(f"# .PCD v0.7 - Point Cloud Data file format\n{header}\n1\n")
    with pytest.raises(InputError, match=r"not (a point cloud of|written by) lidarscene"):
        PointCloud.load(path)


def test_coordinates_of_a_map_survive(tmp_path: Path) -> None:
    """Rationale: UTM. LAS counts from near the sensor; tolerance: half a step, and float64 of 5e6 m. PCD counts in
    float32 from whole metres near the sensor; tolerance: half a step of that at 100 m.
    """
    xyz_m = np.array([[400000.123456, 5000000.654321, 12.0], [400100.5, 5000001.5, 13.0]])
    metadata = PLACED | {"sensor_position_m": "400000.4 5000000.4 10"}
    cloud = small_cloud(2, xyz_m=xyz_m, metadata=metadata)
    for name in EXACT:
        need(name)
        cloud.save(file_of(tmp_path, name), format=name)
        close_m = 4e-6 if name.startswith("pcd") else 0.0
        loaded = PointCloud.load(file_of(tmp_path, name), format=name)
        np.testing.assert_allclose(loaded.xyz_m, xyz_m, rtol=0.0, atol=close_m)
    need("las")
    cloud.save(tmp_path / "a.las")
    loaded = PointCloud.load(tmp_path / "a.las")
    np.testing.assert_allclose(loaded.xyz_m, xyz_m, rtol=0, atol=0.5 * las.STEP_M + 2e-9)


def test_in_sensor_frame() -> None:
    """A sensor turned to the left by 90 degrees: what lies to the world's left is in front of it."""
    cloud = small_cloud(1, xyz_m=np.array([[1.0, 12.0, 3.5]]), metadata=PLACED).in_sensor_frame()
    np.testing.assert_allclose(cloud.xyz_m, [[10.0, 0.0, 0.5]])
    assert cloud.metadata == {"frame": "sensor"}
    assert cloud.in_sensor_frame() is cloud
    world, in_sensor_frame = street.cloud("world"), street.cloud("sensor")
    # float32 of 40 m, on two ways.
    np.testing.assert_allclose(world.in_sensor_frame().xyz_m, in_sensor_frame.xyz_m, atol=2e-5)


def test_a_cloud_that_does_not_know_its_sensor_cannot_be_turned(tmp_path: Path) -> None:
    metadata = {"frame": "world", "sensor_position_m": "1 2 3"}
    for name in ("kitti", "nuscenes", "osi"):
        if name != "osi":  # angles and ranges are the sensor's own in any frame
            with told("sensor"):
                small_cloud(metadata=metadata).save(file_of(tmp_path, name))
    bad = small_cloud(metadata=PLACED | {"sensor_rotation": "1 2"})
    with told("'sensor_rotation' | 9 numbers | '1 2'", ValueError):
        bad.in_sensor_frame()
