"""Files of each format as programs that are not ours read them."""

import sqlite3
import struct
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.formats import PLACED, file_of, need, osi_messages, rotated, value_at

from lidarscene.cloud.points import PointCloud
from lidarscene.formats import pcd
from lidarscene.formats.described import LARGEST
from lidarscene.formats.registry import FORMATS
from lidarscene.maths import rotations

N = 50


def finite(values: np.ndarray) -> np.ndarray:
    """As formats without infinity have them."""
    return np.clip(values, -LARGEST, LARGEST) if values.dtype.kind == "f" else values


# --- PCD --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["pcd", "pcd-compressed", "ascii"])
@pytest.mark.parametrize("n", [1, N])
def test_pcd_in_open3d(tmp_path: Path, kind: str, n: int, open3d: ModuleType) -> None:
    """Reference: Open3D's tensor reader, which knows every field."""
    if kind != "ascii":
        need(kind)
    cloud = small_cloud(n)
    cloud.save(tmp_path / "a.pcd", format="pcd" if kind == "ascii" else kind, ascii=kind == "ascii")
    theirs = open3d.t.io.read_point_cloud(str(tmp_path / "a.pcd"))
    np.testing.assert_array_equal(theirs.point["positions"].numpy(), cloud.xyz_m)
    for column in cloud.columns[3:]:
        values = cloud.column(column.name)
        came = theirs.point[column.name].numpy()[:, 0]
        np.testing.assert_array_equal(came, finite(values) if kind == "ascii" else values)


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
        assert lzf.decompress(pcd._runs(data), size) == data


# --- LAS --------------------------------------------------------------------------------------------


def test_las_byte_by_byte(tmp_path: Path) -> None:
    """Reference: the LAS 1.4 R15 specification, offsets of the public header and of point format 6."""
    need("las")
    cloud = small_cloud(N, metadata=PLACED, channel=np.arange(N))
    cloud.save(tmp_path / "a.las")
    data = (tmp_path / "a.las").read_bytes()
    assert data[:4] == b"LASF"
    assert (data[24], data[25], data[104]) == (1, 4, 6)
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
        "time_s": np.repeat([0.0, 1e-5, 2e-5], [1, 3, 2]), "return_number": [1, 1, 2, 3, 1, 2],
        "azimuth_rad": np.repeat([0.1, 0.2, 0.3], [1, 3, 2]), "elevation_rad": np.zeros(6),
        "channel": np.zeros(6),
    }  # fmt: skip
    small_cloud(6, **columns).save(tmp_path / "a.las")
    las = laspy.read(tmp_path / "a.las")
    assert list(las.number_of_returns) == [1, 3, 3, 3, 2, 2]
    assert list(las.return_number) == [1, 1, 2, 3, 1, 2]


# --- E57 --------------------------------------------------------------------------------------------


def test_e57_in_pye57(tmp_path: Path, library: Any) -> None:
    need("e57")
    pye57 = library("pye57")
    cloud = small_cloud(N)
    cloud.save(tmp_path / "a.e57")
    file = pye57.E57(str(tmp_path / "a.e57"))
    header = file.get_header(0)
    assert header.point_count == N
    raw = file.read_scan_raw(0, ignore_unsupported_fields=True)
    for i, axis in enumerate("XYZ"):
        np.testing.assert_array_equal(raw[f"cartesian{axis}"], cloud.xyz_m[:, i])
    np.testing.assert_array_equal(raw["intensity"], cloud.intensity)
    np.testing.assert_array_equal(raw["rowIndex"], cloud.channel)
    for column in cloud.columns[3:]:
        if f"ls:{column.name}" in header.point_fields:
            came = e57_field(pye57, file, header, f"ls:{column.name}")
            np.testing.assert_array_equal(came, finite(cloud.column(column.name)).astype(float))
    np.testing.assert_array_equal(e57_field(pye57, file, header, "timeStamp"), cloud.time_s)
    np.testing.assert_array_equal(e57_field(pye57, file, header, "returnIndex"), cloud.return_number - 1.0)
    assert len(header.point_fields) == len(cloud.columns)
    file.close()


def e57_field(pye57: Any, file: Any, header: Any, name: str) -> np.ndarray:
    values = np.zeros(header.point_count)
    buffers = pye57.libe57.VectorSourceDestBuffer()
    buffers.append(pye57.libe57.SourceDestBuffer(file.image_file, name, values, len(values), True, True))
    reader = header.points.reader(buffers)
    reader.read()
    reader.close()
    return values


def test_e57_pose_puts_the_scan_into_the_world(
    tmp_path: Path, library: Any, street_cloud: PointCloud
) -> None:
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


# --- KITTI and nuScenes -----------------------------------------------------------------------------


def test_kitti_and_nuscenes(tmp_path: Path, library: Any, street_cloud: PointCloud) -> None:
    """Reference: pykitti's reader, and the reshape of the nuScenes devkit: five float32 a point."""
    street_cloud.save(tmp_path / "a.bin")
    street_cloud.save(tmp_path / "a.pcd.bin")
    own = street_cloud.in_sensor_frame()
    kitti = library("pykitti.utils").load_velo_scan(str(tmp_path / "a.bin"))
    np.testing.assert_array_equal(kitti[:, :3], own.xyz_m)
    np.testing.assert_array_equal(kitti[:, 3], own.intensity)
    nuscenes = np.fromfile(tmp_path / "a.pcd.bin", dtype=np.float32).reshape(-1, 5)
    np.testing.assert_array_equal(nuscenes[:, :4], kitti)
    np.testing.assert_array_equal(nuscenes[:, 4], own.channel)


# --- Parquet and NPZ --------------------------------------------------------------------------------


def test_parquet_in_duckdb(tmp_path: Path, library: Any) -> None:
    need("parquet")
    duckdb = library("duckdb")
    cloud = small_cloud(N)
    cloud.save(tmp_path / "a.parquet")
    columns = duckdb.sql(f"SELECT * FROM '{tmp_path / 'a.parquet'}'").fetchnumpy()
    assert list(columns) == [c.name for c in cloud.columns]
    for name, values in columns.items():
        np.testing.assert_array_equal(np.asarray(values), cloud.column(name), strict=True)


def test_npz_is_an_archive_of_columns(tmp_path: Path) -> None:
    cloud = small_cloud(N)
    cloud.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert set(archive.files) == {"lidarscene", *(c.name for c in cloud.columns)}
        np.testing.assert_array_equal(archive["snr"], cloud.snr)


# --- ROS 2 ------------------------------------------------------------------------------------------

LAYOUTS = {
    "velodyne": {"x": (0, 7), "y": (4, 7), "z": (8, 7), "intensity": (12, 7), "ring": (16, 4), "time": (18, 7)},
    "ouster": {"x": (0, 7), "y": (4, 7), "z": (8, 7), "intensity": (16, 7), "t": (20, 6), "reflectivity": (24, 4),
               "ring": (26, 4), "ambient": (28, 4), "range": (32, 6)},
}  # fmt: skip
NUMPY = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def messages(path: Path, library: Any) -> dict[str, Any]:
    """Messages by topic, decoded by mcap_ros2 from the definitions that the file holds."""
    if path.suffix == ".mcap":
        reader, decoder = library("mcap.reader"), library("mcap_ros2.decoder")
        with open(path, "rb") as file:
            made = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
            return {channel.topic: message for _, channel, _, message in made.iter_decoded_messages()}
    dynamic = library("mcap_ros2._dynamic")
    connection = sqlite3.connect(path)
    try:
        definitions = dict(
            connection.execute("SELECT topic_type, encoded_message_definition FROM message_definitions")
        )
        query = "SELECT name, type, data FROM messages JOIN topics ON topics.id = messages.topic_id"
        return {
            topic: dynamic.generate_dynamic(kind, definitions[kind])[kind](data)
            for topic, kind, data in connection.execute(query)
        }
    finally:
        connection.close()


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_point_cloud_2(
    tmp_path: Path, library: Any, street_cloud: PointCloud, suffix: str, layout: str
) -> None:
    """Reference: the fields of both drivers, and mcap_ros2 as reader; rosbags wrote."""
    name = {".mcap": "mcap", ".db3": "rosbag2"}[suffix] + ("-ouster" if layout == "ouster" else "")
    need(name)
    path = file_of(tmp_path, name)
    street_cloud.save(path, format=name)
    came = messages(path, library)
    points, own = came["/points"], street_cloud.in_sensor_frame()
    fields = {field.name: (field.offset, field.datatype) for field in points.fields}
    assert {name: fields[name] for name in LAYOUTS[layout]} == LAYOUTS[layout]
    assert (points.header.frame_id, points.height, points.width) == ("lidar", 1, len(own))
    assert points.row_step == points.width * points.point_step == len(points.data)
    rows = np.frombuffer(
        bytes(points.data),
        np.dtype(
            {
                "names": list(fields),
                "formats": [NUMPY[kind] for _, kind in fields.values()],
                "offsets": [offset for offset, _ in fields.values()],
                "itemsize": points.point_step,
            }
        ),
    )
    np.testing.assert_array_equal(np.stack([rows[a] for a in "xyz"], axis=-1), own.xyz_m)
    np.testing.assert_array_equal(rows["intensity"], own.intensity)
    np.testing.assert_array_equal(rows["ring"], own.channel)
    if layout == "velodyne":
        np.testing.assert_array_equal(rows["time"], own.time_s.astype(np.float32))
    else:
        np.testing.assert_array_equal(rows["t"], np.rint(own.time_s * 1e9))
        np.testing.assert_allclose(rows["range"], 1e3 * own.range_m, atol=0.51)
    for column in own.columns:
        if column.name not in (*LAYOUTS[layout], "channel", "time"):
            np.testing.assert_array_equal(rows[column.name], own.column(column.name))
    check_transform(came["/tf"].transforms[0], street_cloud)


def check_transform(stamped: Any, cloud: PointCloud) -> None:
    """`map` to `lidar` is where the sensor stands: it takes its points into the world."""
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("map", "lidar")
    t, q = stamped.transform.translation, stamped.transform.rotation
    turned = rotated((q.w, q.x, q.y, q.z), cloud.in_sensor_frame().xyz_m.astype(float))
    np.testing.assert_allclose(turned + np.array([t.x, t.y, t.z]), cloud.xyz_m, atol=2e-5)


def test_a_bag_of_several_frames(tmp_path: Path, library: Any) -> None:
    need("mcap")
    reader, decoder = library("mcap.reader"), library("mcap_ros2.decoder")
    from lidarscene.formats.ros import write_ros

    frames = [small_cloud(n, metadata={"frame_start_s": repr(0.1 * n)}) for n in (3, 5)]
    write_ros(tmp_path / "a.mcap", iter(frames))
    with open(tmp_path / "a.mcap", "rb") as file:
        made = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        came = [(m.log_time, d.header.stamp, d.width) for _, _, m, d in made.iter_decoded_messages()]
    assert [(log, stamp.sec * 10**9 + stamp.nanosec, n) for log, stamp, n in came] == [
        (300_000_000, 300_000_000, 3),
        (500_000_000, 500_000_000, 5),
    ]


# --- OSI --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("truth", [False, True])
def test_osi_in_betterosi(tmp_path: Path, library: Any, truth: bool) -> None:
    """Reference: betterosi, from the OSI group's own definitions."""
    columns = {"channel": np.arange(N) * 1000, "sensor_index": np.zeros(N)}
    cloud = small_cloud(N, truth=truth, metadata={"frame_start_s": "2.25"}, **columns)
    cloud.save(tmp_path / "a.osi")
    (data,) = osi_messages(tmp_path / "a.osi", "SensorData", library)
    assert (data.timestamp.seconds, data.timestamp.nanos) == (2, 250_000_000)
    (lidar,) = data.feature_data.lidar_sensor
    assert lidar.header.number_of_valid_detections == len(lidar.detection) == N
    get = lambda *path: np.array([value_at(one, path) for one in lidar.detection])  # noqa: E731
    np.testing.assert_array_equal(get("position", "distance"), cloud.range_m)
    np.testing.assert_array_equal(get("position", "azimuth"), cloud.azimuth_rad)
    np.testing.assert_array_equal(get("position", "elevation"), cloud.elevation_rad)
    np.testing.assert_array_equal(get("existence_probability"), cloud.detection_probability)
    np.testing.assert_array_equal(get("beam_id", "value"), cloud.channel)
    np.testing.assert_array_equal(get("classification"), np.where(cloud.status, 3, 0))
    assert get("intensity").max() == pytest.approx(100.0)
    np.testing.assert_allclose(get("intensity"), 100.0 * cloud.intensity / cloud.intensity.max(), rtol=1e-6)
    np.testing.assert_allclose(
        get("echo_pulse_width"), 149_896_229.0 * cloud.pulse_width_s.astype(float), rtol=1e-12
    )
    if truth:
        np.testing.assert_array_equal(get("reflectivity"), cloud.reflectivity)
        np.testing.assert_array_equal(
            get("radial_velocity"), -cloud.radial_velocity_m_s
        )  # towards the sensor
        expected = [int(body) + 1 if body >= 0 else 2**64 - 1 for body in cloud.body]
        assert [one.object_id.value for one in lidar.detection] == expected
    else:
        assert not lidar.detection[0].has_field("object_id")


def test_sensors_of_a_rig_are_apart_in_osi(tmp_path: Path, library: Any) -> None:
    """Rationale: positions are in each sensor's own frame."""
    cloud = small_cloud(N)
    assert 0 < np.count_nonzero(cloud.sensor_index) < N
    cloud.save(tmp_path / "a.osi")
    (data,) = osi_messages(tmp_path / "a.osi", "SensorData", library)
    lidars = data.feature_data.lidar_sensor
    assert [one.header.sensor_id.value for one in lidars] == [0, 1]
    for index, one in enumerate(lidars):
        came = [d.position.distance for d in one.detection]
        np.testing.assert_array_equal(came, cloud.range_m[cloud.sensor_index == index])


def test_an_empty_osi_frame(tmp_path: Path, library: Any) -> None:
    small_cloud(0).save(tmp_path / "a.osi")
    (data,) = osi_messages(tmp_path / "a.osi", "SensorData", library)
    assert len(data.feature_data.lidar_sensor[0].detection) == 0


# --- all --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("n", [0, 1])
def test_clouds_of_no_point_and_of_one_can_be_written(tmp_path: Path, name: str, n: int) -> None:
    need(name)
    small_cloud(n, truth=False).save(file_of(tmp_path, name), format=name)
    assert file_of(tmp_path, name).is_file()


@pytest.mark.parametrize("name", FORMATS)
def test_the_same_cloud_gives_the_same_file(tmp_path: Path, name: str) -> None:
    """Rationale: a repeated run must not look like a change. LAS has today's date in bytes 90 to 94."""
    need(name)
    data = []
    for folder in ("a", "b"):
        path = file_of(tmp_path / folder, name)
        small_cloud(N).save(path, format=name)
        data.append(path.read_bytes())
    assert data[0] == data[1]


def test_quaternions_and_angles() -> None:
    """Reference: the quaternion turns vectors as the matrix does, and the angles make the matrix again.

    Turns by 180 degrees about each axis are in, where a formula by w alone fails. Tolerance: float64 rounding.
    """
    rng = np.random.default_rng(7)
    turns = [np.diag(d) for d in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])]
    for _ in range(50):
        q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turns.append(q * np.sign(np.linalg.det(q)))
    for turn in turns:
        q = rotations.quaternion(turn)
        assert q[0] >= 0
        np.testing.assert_allclose(rotated(q, np.eye(3)), np.asarray(turn).T, atol=1e-14)
        yaw, pitch, roll = rotations.yaw_pitch_roll_rad(turn)
        cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (np.cos, np.sin))
        z, y = (
            np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]),
            np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]),
        )
        np.testing.assert_allclose(z @ y @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]]), turn, atol=1e-14)
