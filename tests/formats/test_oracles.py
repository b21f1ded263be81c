"""Every field of every format as a reader that is not ours has it, by value, of three points whose truth is known.

`KNOWN` has a row for each column of clouds, and `FIELDS` one for each field of each format: what the reader of
`READERS` must find there. A column, a field or a format without a row fails. Packets hold pulses, not points: the
maker's decoders read them in `tests/formats/packets`.
"""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from helpers.formats import file_of, need

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats.cloud_columns import COLUMNS
from lidarscene.formats.registry import BAGS, FORMATS, ROS_LAYOUTS

LARGEST = 3.4028234663852886e38
"""The largest float32, which stands for infinity where a format has none."""

SENSOR_M = np.array([654_321.25, 5_234_567.5, 412.0])
"""Place of the sensor on a map, UTM."""

LOCAL_M = np.array([[10.0, 0.0, 0.0], [0.0, 20.0, -1.5], [-30.5, 4.25, 2.0]])
"""The points as the sensor sees them: it looks to the east."""

STAMP_NS = 1_767_225_602_500_000_000
"""2026-01-01T00:00:02.5Z: the frame begins at 2.5 s."""

KNOWN: dict[str, Any] = {
    "x": (SENSOR_M + LOCAL_M)[:, 0],
    "y": (SENSOR_M + LOCAL_M)[:, 1],
    "z": (SENSOR_M + LOCAL_M)[:, 2],
    "range": [10.0, 20.0625, 30.875],
    "intensity": [60.0, 100.0, 20.0],
    "pulse_width": [2.0**-28, 2.0**-27, 0.0],
    "signal": [400.0, 1000.0, 12.0],
    "snr": [20.0, 7.5, 6.25],
    "detection_probability": [1.0, 0.96875, 0.75],
    "ambient": [3.0, 0.0, 8.0],
    "time": [0.0, 0.03125, 0.0625],
    "channel": [5, 3, 4],
    "ring": [0, 2, 1],
    "azimuth": [0.0, 1.5, 3.0],
    "elevation": [0.0, -0.0625, 0.0625],
    "return_number": [1, 2, 1],
    "status": [0, 0, 1],
    "sensor_index": [0, 0, 0],
    "true_range": [10.125, 20.0, np.inf],
    "incidence_angle": [0.25, 0.5, 1.5],
    "reflectivity": [0.5, 0.125, 0.0],
    "sun_angle": [1.0, 1.25, 1.5],
    "in_shadow": [0, 1, 0],
    "interactions": [0, 2, 0],
    "ghost": [0, 1, 0],
    "wear": [0.0, 0.25, 0.0],
    "radial_velocity": [-4.0, 1.5, 0.0],
    "body": [1, 0, -1],
    "class": [1, 0, -1],
    "material": [0, 1, -1],
    "normal_x": [-1.0, 0.0, 0.0],
    "normal_y": [0.0, -1.0, 0.0],
    "normal_z": [0.0, 0.0, 0.0],
    "velocity_x": [-4.0, 0.0, 0.0],
    "velocity_y": [0.0, 1.5, 0.0],
    "velocity_z": [0.0, 0.0, 0.0],
}
"""Column -> its values at the three points: an echo, a second return behind glass, and a false alarm."""


def known_cloud(driver: str = "") -> PointCloud:
    attributes = {column.attribute: np.array(KNOWN[column.name]) for column in COLUMNS[3:]}
    metadata = {
        "frame": "world",
        "frame_start_s": "2.5",
        "intensity_unit": "of 255",
        "sensor_position_m": " ".join(map(repr, SENSOR_M.tolist())),
        "sensor_rotation": "1 0 0 0 1 0 0 0 1",
        "ring_rows": "2 1 0",  # ring 0 is on top
    }
    return PointCloud(
        xyz_m=SENSOR_M + LOCAL_M,
        sensor_names=("roof",),
        body_names=("road", "car"),
        class_names=("road", "car"),
        material_names=("asphalt", "paint"),
        metadata=metadata | ({"driver": driver} if driver else {}),
        **attributes,
    )


Fields = dict[str, Any]

LOCAL = dict(zip("xyz", LOCAL_M.T, strict=True))
TIMES_NS = STAMP_NS + 1e9 * np.array(KNOWN["time"])


def known(*without: str, **fields: Any) -> Fields:
    """Every column by its own name but these, and these fields beside."""
    return {name: values for name, values in KNOWN.items() if name not in without} | fields


E57_NAMES = {"time": "timeStamp", "intensity": "intensity", "ring": "rowIndex"} | {
    axis: f"cartesian{axis.upper()}" for axis in "xyz"
}

FIELDS: dict[str, Fields] = {
    "ply": known(),
    "pcd": known(),
    "pcd-compressed": known(),
    "npz": known(),
    "parquet": known(
        status=["echo", "echo", "false alarm"],
        sensor_index=["roof", "roof", "roof"],
        body=["car", "road", None],
        material=["asphalt", "paint", None],
        **{"class": ["car", "road", None]},
    ),
    "las": known(
        "intensity",
        "return_number",
        echo_peak=KNOWN["intensity"],
        **{"return": KNOWN["return_number"]},
        intensity=[39321, 65535, 13107],  # of the largest value, in 16 bits
        return_number=[1, 2, 1],
        number_of_returns=[1, 2, 1],  # of their pulses, and no fewer than the number of the return
        classification=[65, 64, 7],  # 64 + class; 7 is noise
        gps_time=KNOWN["time"],
        scan_angle=[0, 14324, 28648],  # the azimuth in steps of 0.006 degrees
    ),
    "e57": {
        E57_NAMES.get(name, f"ls:{name}"): np.minimum(values, LARGEST)
        for name, values in known("return_number").items()
    }
    | {"returnIndex": [0, 1, 0], "returnCount": [1, 2, 1]},  # as LAS's number_of_returns
    "kitti": LOCAL | {"intensity": KNOWN["intensity"]},
    "nuscenes": LOCAL | {"intensity": KNOWN["intensity"], "ring": [2, 0, 1]},  # rising, as an HDL-32E's
    "velodyne": known(**LOCAL),
    "ouster": known(
        "time",
        **LOCAL,
        t=[0, 31_250_000, 62_500_000],
        intensity=KNOWN["signal"],
        reflectivity=KNOWN["intensity"],
        range=[10_000, 20_062, 30_875],
    ),
    "hesai": known(**LOCAL, timestamp=1e-9 * TIMES_NS),  # good to 0.2 us in float64
    "robosense": known(**LOCAL, timestamp=1e-9 * TIMES_NS),
    "livox": known(**LOCAL, timestamp=TIMES_NS, tag=[0, 16, 0], line=KNOWN["ring"]),
    "livox-custom": LOCAL
    | {"offset_time": [0, 31_250_000, 62_500_000], "reflectivity": [60, 100, 20], "tag": [0, 16, 0], "line": [0, 2, 1]},
    "rrd": known(**LOCAL),
    "osi": {
        "position.distance": np.linalg.norm(LOCAL_M, axis=1),
        "position.azimuth": np.arctan2(LOCAL_M[:, 1], LOCAL_M[:, 0]),
        "position.elevation": np.arcsin(LOCAL_M[:, 2] / np.linalg.norm(LOCAL_M, axis=1)),
        "existence_probability": KNOWN["detection_probability"],
        "intensity": [60.0, 100.0, 20.0],  # percent of the largest
        "classification": [1, 1, 3],  # other, other, clutter
        "beam_id": KNOWN["channel"],
        "object_id": [2, 1, 2**64 - 1],  # body + 1
        "reflectivity": KNOWN["reflectivity"],
        "radial_velocity": [4.0, -1.5, 0.0],  # positive towards the sensor
        "echo_pulse_width": 149_896_229.0 * np.array(KNOWN["pulse_width"]),
    },
}
"""Format, or layout of ROS's points -> field of its file -> what a reader must find there."""

SAME = {"laz": "las", "osi-mcap": "osi", "mcap": "velodyne", "rosbag2": "velodyne"} | {
    f"{storage}-{layout}": layout for storage in ("mcap", "rosbag2") for layout in ROS_LAYOUTS
}
"""Format -> the one with the same fields."""

LAS_OTHERS = {"synthetic", "key_point", "withheld", "overlap", "scanner_channel", "scan_direction_flag"}
LAS_OTHERS |= {"edge_of_flight_line", "user_data", "point_source_id"}
"""Standard fields of LAS that stay 0."""


def ply_by_open3d(path: Path, library: Any) -> Fields:
    points = library("open3d").t.io.read_point_cloud(str(path)).point
    arrays = {name: points[name].numpy() for name in points}
    columns = dict(zip("xyz", arrays.pop("positions").T, strict=True))
    if "normals" in arrays:
        columns |= {f"normal_{axis}": values for axis, values in zip("xyz", arrays.pop("normals").T, strict=True)}
    return columns | {name: values[:, 0] for name, values in arrays.items()}


def pcd_by_open3d(path: Path, library: Any) -> Fields:
    """Its viewpoint by the text of the header, since Open3D leaves it out."""
    place = path.read_bytes().split(b"VIEWPOINT ")[1].split()[:3]
    columns = ply_by_open3d(path, library)
    return columns | {axis: columns[axis].astype(float) + float(word) for axis, word in zip("xyz", place, strict=True)}


def pcd_by_pypcd4(path: Path, library: Any) -> Fields:
    read = library("pypcd4").PointCloud.from_path(path)
    columns = {name: read.pc_data[name] for name in read.fields}
    place = read.metadata.viewpoint[:3]
    return columns | {axis: columns[axis].astype(float) + float(at) for axis, at in zip("xyz", place, strict=True)}


def las_by_laspy(path: Path, library: Any) -> Fields:
    read = library("laspy").read(path)
    names = [name for name in read.point_format.dimension_names if name not in {"X", "Y", "Z"} | LAS_OTHERS]
    assert not any(np.any(read[name]) for name in LAS_OTHERS)
    return {name: np.asarray(read[name]) for name in names} | {axis: np.asarray(getattr(read, axis)) for axis in "xyz"}


def e57_by_pye57(path: Path, library: Any) -> Fields:
    pye57 = library("pye57")
    file = pye57.E57(str(path))
    header = file.get_header(0)
    fields = {}
    for name in header.point_fields:
        fields[name] = np.zeros(header.point_count)
        buffers = pye57.libe57.VectorSourceDestBuffer()
        buffers.append(pye57.libe57.SourceDestBuffer(file.image_file, name, fields[name], 3, True, True))
        reader = header.points.reader(buffers)
        reader.read()
        reader.close()
    file.close()
    return fields


def kitti_by_pykitti(path: Path, library: Any) -> Fields:
    return dict(zip(("x", "y", "z", "intensity"), library("pykitti.utils").load_velo_scan(str(path)).T, strict=True))


def nuscenes_by_numpy(path: Path, library: Any) -> Fields:
    """Rows of five float32, as the devkit's LidarPointCloud.from_file reads them."""
    rows = np.fromfile(path, np.float32).reshape(-1, 5)
    return dict(zip(("x", "y", "z", "intensity", "ring"), rows.T, strict=True))


def npz_by_numpy(path: Path, library: Any) -> Fields:
    with np.load(path) as archive:
        return {name: archive[name] for name in archive.files if name != "lidarscene"}


def parquet_by_duckdb(path: Path, library: Any) -> Fields:
    return dict(library("duckdb").sql(f"SELECT * FROM '{path}'").fetchnumpy())


def parquet_by_pandas(path: Path, library: Any) -> Fields:
    frame = library("pandas").read_parquet(path)
    return {name: frame[name].to_numpy() for name in frame}


NUMPY = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def bag_by_rosbags(path: Path, library: Any) -> Fields:
    typesys = library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with library("rosbags.highlevel").AnyReader([path], default_typestore=store) as bag:
        connection, _, raw = next(part for part in bag.messages() if not part[0].topic.startswith("/tf"))
        message = bag.deserialize(raw, connection.msgtype)
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == STAMP_NS
    if hasattr(message, "timebase"):
        names = [name for name in vars(message.points[0]) if not name.startswith("_")]
        return {name: np.array([getattr(point, name) for point in message.points]) for name in names}
    fields = {field.name: (NUMPY[field.datatype], field.offset) for field in message.fields}
    rows = np.frombuffer(bytes(message.data), np.uint8).reshape(message.width, message.point_step)
    return {
        name: rows[:, offset : offset + np.dtype(kind).itemsize].copy().view(kind)[:, 0]
        for name, (kind, offset) in fields.items()
    }


def rrd_by_rerun(path: Path, library: Any) -> Fields:
    library("rerun")
    from rerun import chunk

    part = next(part for part in chunk.RrdReader(path).stream() if str(part.entity_path).endswith("/points"))
    batch = part.to_record_batch()
    theirs = {"log_time", "scene_time", "rerun.controls.RowId", "Points3D:colors", "Points3D:positions"}
    columns = {name: np.array(batch[name][0].as_py()) for name in batch.schema.names if name not in theirs}
    return columns | dict(zip("xyz", np.array(batch["Points3D:positions"][0].as_py()).T, strict=True))


def osi_by_betterosi(path: Path, library: Any) -> Fields:
    (data,) = library("betterosi").read(str(path), osi_message_type="SensorData")
    (lidar,) = data.feature_data.lidar_sensor
    fields: dict[str, list[float]] = {}
    for detection in lidar.detection:
        for field in type(detection).desc().fields:
            value = getattr(detection, field.name) if detection.has_field(field.name) else None
            if field.name == "position":
                for name in ("distance", "azimuth", "elevation"):
                    fields.setdefault(f"position.{name}", []).append(getattr(value, name))
            elif value is not None:
                fields.setdefault(field.name, []).append(getattr(value, "value", value))
    return {name: np.array(values) for name, values in fields.items()}


READERS: dict[str, tuple[Callable[[Path, Any], Fields], ...]] = {
    "ply": (ply_by_open3d,),
    "pcd": (pcd_by_open3d, pcd_by_pypcd4),
    "pcd-compressed": (pcd_by_open3d, pcd_by_pypcd4),
    "las": (las_by_laspy,),
    "e57": (e57_by_pye57,),
    "kitti": (kitti_by_pykitti,),
    "nuscenes": (nuscenes_by_numpy,),
    "npz": (npz_by_numpy,),
    "parquet": (parquet_by_duckdb, parquet_by_pandas),
    "rrd": (rrd_by_rerun,),
    "osi": (osi_by_betterosi,),
} | dict.fromkeys(("velodyne", *ROS_LAYOUTS), (bag_by_rosbags,))
"""Key of `FIELDS` -> readers of such files by others."""


def test_the_tables_are_whole() -> None:
    """A column or a format that is new has no row yet: say what it means to those who read it."""
    assert [*KNOWN] == [column.name for column in COLUMNS]
    assert {SAME.get(name, name) for name in FORMATS | BAGS} == FIELDS.keys() == READERS.keys()


TOLERANCES = dict.fromkeys([*"xyz", *(f"cartesian{axis}" for axis in "XYZ")], 6e-6)
"""Of places: a step of LAS, and float32 of 30 m. Stamps are as good as float64, all else as float32."""

WAYS = [(name, read) for name in FORMATS | BAGS for read in READERS[SAME.get(name, name)]]


@pytest.mark.parametrize(("name", "read"), WAYS, ids=[f"{name}-{read.__name__}" for name, read in WAYS])
def test_fields_have_their_values(tmp_path, library, request, name, read):
    need(name)
    if "open3d" in read.__name__:
        module: ModuleType = request.getfixturevalue("open3d")  # through its door
        library = {"open3d": module}.__getitem__
    path = file_of(tmp_path, name)
    known_cloud().save(path, format=name)
    found, expected = read(path, library), FIELDS[SAME.get(name, name)]
    assert found.keys() == expected.keys()
    for field, values in expected.items():
        close = TOLERANCES.get(field, 0.0)
        relative = {"timestamp": 5e-16}.get(field, 0.0 if close else 1e-6)
        if any(isinstance(value, str) for value in values):  # names, and none for -1
            assert [value if isinstance(value, str) else None for value in found[field]] == values
            continue
        theirs, ours = np.asarray(found[field], np.float64), np.asarray(values, np.float64)
        np.testing.assert_allclose(theirs, ours, rtol=relative, atol=close, err_msg=field)
