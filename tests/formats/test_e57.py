"""E57: as pye57 reads it, and without any library."""

import re
import struct
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import need
from scipy.spatial.transform import Rotation

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats import e57

N = 50


def test_e57_pose_puts_the_scan_into_the_world(tmp_path: Path, library: Any, street_cloud: PointCloud) -> None:
    """The same scan in both frames: read with the pose, and read as it is. Tolerance: float32 of 40 m."""
    need("e57")
    pye57 = library("pye57")
    placed = []
    for cloud in (street_cloud, street_cloud.in_sensor_frame()):
        cloud.save(tmp_path / "a.e57")
        file = pye57.E57(str(tmp_path / "a.e57"))
        scan = file.read_scan(0, ignore_missing_fields=True)
        placed.append(np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=-1))
        file.close()
    np.testing.assert_allclose(placed[0], street_cloud.xyz_m, atol=1e-9)
    np.testing.assert_allclose(placed[1], street_cloud.xyz_m, atol=2e-5)


def test_e57_without_its_library(tmp_path: Path) -> None:
    """Reference: ASTM E2807: pages of 1020 bytes and a checksum, an XML section where the header says."""
    need("e57")
    small_cloud(N).save(tmp_path / "a.e57")
    data = (tmp_path / "a.e57").read_bytes()
    assert data[:8] == b"ASTM-E57"
    pages = np.frombuffer(data, np.uint8).reshape(-1, 1024)[:, :1020]
    start, length = struct.unpack_from("<QQ", data, 24)
    logical = start // 1024 * 1020 + start % 1024
    root = ElementTree.fromstring(pages.tobytes()[logical : logical + length])
    prototype = root.find(".//{*}points/{*}prototype")
    assert prototype is not None
    names = [element.tag for element in prototype]
    assert "{http://www.astm.org/COMMIT/E57/2010-e57-v1.0}cartesianX" in names
    assert "{https://lidarscene.invalid/e57/1}snr" in names
    head = {element.tag.split("}")[1]: (element.text or "").strip() for element in root}
    assert head["formatName"] == "ASTM E57 3D Imaging Data File"
    assert (head["versionMajor"], head["versionMinor"] or "0") == ("1", "0")
    assert re.fullmatch(r"\{[0-9a-fA-F-]{36}\}", head["guid"])
    assert head["guid"] != root.findtext(".//{*}data3D//{*}guid")


def test_e57_says_how_far_it_reaches(tmp_path: Path) -> None:
    """Reference: the scan's own entries in the XML section, and the least and largest of the points."""
    need("e57")
    cloud = small_cloud(N, ring=np.arange(3, 3 + N), return_number=np.full(N, 3))
    cloud.save(tmp_path / "a.e57")
    root = xml_of(tmp_path / "a.e57")

    def entry(name: str) -> float:
        return float(root.findtext(f".//{{*}}{name}") or 0.0)

    for column, axis in enumerate("xyz"):
        values = cloud.xyz_m[:, column]
        ends = [entry(f"{axis}{end}") for end in ("Minimum", "Maximum")]
        np.testing.assert_allclose(ends, [values.min(), values.max()])
        assert ends[0] < ends[1]
    assert [entry("rowMaximum"), entry("returnMinimum"), entry("returnMaximum")] == [N + 2, 0, 2]
    assert entry("intensityMaximum") == pytest.approx(cloud.intensity.max())
    assert entry("intensityMinimum") == 0.0


def test_e57_blocks_do_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, library: Any) -> None:
    need("e57")
    monkeypatch.setattr(e57, "BLOCK_POINTS", 8)
    cloud = small_cloud(19)
    cloud.save(tmp_path / "a.e57")
    file = library("pye57").E57(str(tmp_path / "a.e57"))
    raw = file.read_scan_raw(0, ignore_unsupported_fields=True)
    for i, axis in enumerate("XYZ"):
        np.testing.assert_array_equal(raw[f"cartesian{axis}"], cloud.xyz_m[:, i])
    file.close()


def test_e57_pose_by_its_names(tmp_path: Path) -> None:
    """Reference: SciPy's quaternion. pye57 goes by the order of the entries, other readers by w, x, y and z."""
    need("e57")
    turn = Rotation.from_euler("ZYX", [50.0, -20.0, 10.0], degrees=True)
    rows = np.column_stack([turn.as_matrix(), [1.0, 2.0, 3.0]]).ravel().tolist()
    metadata = {"frame": "sensor", "sensor_to_world": " ".join(map(repr, rows))}
    small_cloud(N, metadata=metadata).save(tmp_path / "a.e57")
    pose = xml_of(tmp_path / "a.e57").find(".//{*}pose")
    assert pose is not None
    numbers = {
        part: {axis: float(pose.findtext(f"{{*}}{part}/{{*}}{axis}") or 0.0) for axis in axes}
        for part, axes in (("rotation", "xyzw"), ("translation", "xyz"))
    }
    assert numbers["translation"] == {"x": 1.0, "y": 2.0, "z": 3.0}
    np.testing.assert_allclose(list(numbers["rotation"].values()), turn.as_quat(canonical=True), atol=1e-12)


def xml_of(path: Path) -> ElementTree.Element:
    """The XML section: pages of 1020 bytes and a checksum, and where the header says that it is (ASTM E2807)."""
    data = path.read_bytes()
    pages = np.frombuffer(data, np.uint8).reshape(-1, 1024)[:, :1020]
    start, length = struct.unpack_from("<QQ", data, 24)
    logical = start // 1024 * 1020 + start % 1024
    return ElementTree.fromstring(pages.tobytes()[logical : logical + length])
