"""PointCloud: what is checked at birth, what selections and joins keep, what Open3D gets."""

import copy
import json
import os
import pickle
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from helpers.child import assert_ended
from helpers.clouds import NAMES, assert_same, chunk_of, small_cloud, small_columns
from helpers.mistakes import calls, told

from lidarscene.cloud import interop
from lidarscene.cloud.builder import CloudBuilder
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.cloud.rig_clouds import merge_clouds
from lidarscene.detection.outcomes import Status
from lidarscene.errors import LidarSceneError
from lidarscene.formats.category_array import UnknownNameWarning
from lidarscene.formats.cloud_columns import COLUMNS, DTYPES, MEASURED, OF_VECTORS, STATUS_NAMES, TRUTH, columns_of
from lidarscene.formats.cloud_columns import NAMES as NAMES_OF
from lidarscene.maths.arrays import Numbers
from lidarscene.maths.pose import Pose

TESTS = Path(__file__).parents[1]


def test_columns_name_every_array_once() -> None:
    assert len({c.name for c in COLUMNS}) == len(COLUMNS)
    assert [c.attribute for c in COLUMNS[2:]] == [*MEASURED, *TRUTH, *OF_VECTORS]
    assert {c.dtype for c in COLUMNS} <= set(DTYPES)


def test_arrays_are_read_only_and_not_copied() -> None:
    columns = small_columns()
    cloud = PointCloud(**columns)
    for attribute, values in columns.items():
        assert np.shares_memory(getattr(cloud, attribute), values)
        with pytest.raises(ValueError, match="read-only"):
            getattr(cloud, attribute)[0] = 0
        values[:1] = values[1:2]  # the owner's array stays as it was


def test_position_is_single_or_double() -> None:
    columns = small_columns()
    assert PointCloud(**columns).xyz_m.dtype == np.float32
    for dtype in (np.float64, np.int64, np.float16):
        changed = columns | {"xyz_m": columns["xyz_m"].astype(dtype)}
        assert PointCloud(**changed).xyz_m.dtype == np.float64


test_wrong_columns = calls(
    *(
        (lambda changes=changes: small_cloud(**changes), named, ValueError)
        for changes, named in (
            ({"snr": np.zeros(6)}, "PointCloud.snr | (7,) | (6,)"),
            ({"xyz_m": np.zeros((7, 2))}, "PointCloud.xyz_m | (7, 3) | (7, 2)"),
            ({"snr": np.array([1, 2, np.nan, 4, 5, 6, np.inf])}, "PointCloud.snr | NaN at 1 places"),
            ({"xyz_m": np.array([[np.inf, 1.0, 2.0]] * 7)}, "PointCloud.xyz_m | infinite at 7 places"),
            ({"status": np.full(7, 256)}, "PointCloud.status | uint8"),
            ({"status": np.full(7, -1)}, "PointCloud.status | uint8"),
            ({"body": None, "material": None}, "truth | missing | body, material"),
            ({"body": np.full(7, 3)}, "PointCloud.body | 3 to 3 | 0 to 2"),
            ({"class_id": np.full(7, -2)}, "PointCloud.class_id | -2 to -2"),
            ({"metadata": {"frame": "world"}}, "'sensor_position_m' | 'x y z' | 'world' | ''"),
            ({"metadata": {"frame": "world", "sensor_position_m": "1 2 inf"}}, "'sensor_position_m' | '1 2 inf'"),
            ({"metadata": {"frame": "car"}}, "'frame' | 'sensor' | 'world' | 'car'"),
            ({"metadata": {"": "nothing"}}, "keys | 1 to 100 characters"),
        )
    ),
    (lambda: PointCloud.concatenate([]), "parts", ValueError),
    (
        lambda: PointCloud.concatenate([small_cloud(), small_cloud(class_names=("car", "road"))]),
        "different",
        ValueError,
    ),
    (
        lambda: PointCloud.concatenate([small_cloud(), small_cloud().without_truth()]),
        "body, class_id, ghost",
        ValueError,
    ),
    (lambda: CloudBuilder().append({"range_m": np.zeros(1)}), "snr", ValueError),
)
test_wrong_names = calls(
    (lambda: small_cloud().column("speed"), "'speed' | x, y, z, range, intensity"),
    (lambda: small_cloud().without_truth().column("body"), "'body'"),
    (lambda: small_cloud(9)[9], "cloud[9] | 9 points"),
    (lambda: small_cloud(9)[1.5], "cloud[1.5] | name of a column | slice"),  # type: ignore[call-overload]
    (lambda: small_cloud()["rang"], "'rang' | range?"),
    (lambda: small_cloud()[["x", "rang"]], "'rang' | range?"),
    (lambda: small_cloud(9)[np.ones(4, bool)], "mask of 4 | 9 points"),
    (lambda: small_cloud().select("car"), "keyword | cloud.select(class_='car')"),
    (lambda: small_cloud().select(), "select | mask"),
    (lambda: small_cloud()["class"] == ["car", "road"], "class | one name | isin"),
    *((lambda name=name: small_cloud().save(name), f"{name} | .ply") for name in ("a.unknown", "a", "a.ply.gz")),
    *((lambda name=name: PointCloud.load(name), f"{name} | .ply") for name in ("a.unknown", "a", "a.ply.gz")),
)


@pytest.mark.parametrize("attribute", ["body", "class_id", "material", "sensor_index"])
def test_indices_at_their_limits(attribute: str) -> None:
    """-1 has no name and every name its number: the last of each is taken, the next one is not."""
    last = len(NAMES[NAMES_OF[attribute]]) - 1
    for index in (-2, -1, 0, last, last + 1):
        if attribute == "sensor_index" and index < 0:  # unsigned
            continue
        among_others = {attribute: np.array([0, 0, index, 0, 0, 0, 0])}
        if -1 <= index <= last:
            assert getattr(small_cloud(**among_others), attribute)[2] == index
            continue
        with told(f"PointCloud.{attribute} | {min(index, 0)} | {max(index, 0)}", ValueError):
            small_cloud(**among_others)


def test_names_are_optional() -> None:
    assert len(small_cloud(body_names=(), class_names=(), material_names=(), metadata={})) == 7


def test_sensor_position() -> None:
    assert small_cloud().sensor_position_m.tolist() == [0, 0, 0]
    world = {"frame": "world", "sensor_position_m": "1 -2.5 3e2"}
    assert small_cloud(metadata=world).sensor_position_m.tolist() == [1, -2.5, 300]


def test_without_truth() -> None:
    bare = small_cloud().without_truth()
    assert not bare.has_truth
    assert [c.attribute for c in bare.columns[2:]] == list(MEASURED)
    assert bare.body is None
    assert_same(bare, small_cloud(truth=False))


@pytest.mark.parametrize("index", [slice(2, 5), [4, 0], np.arange(7) % 2 == 0, np.zeros(0, np.int64)])
def test_select(index: Any) -> None:
    cloud = small_cloud()
    chosen = cloud.select(index)
    for c in cloud.columns:
        np.testing.assert_array_equal(chosen.column(c.name), cloud.column(c.name)[index], strict=True)
    assert chosen.metadata == cloud.metadata
    assert chosen.body_names == cloud.body_names


def test_concatenate_is_the_inverse_of_select() -> None:
    cloud = small_cloud()
    parts = [cloud.select(slice(0, 3)), cloud.select(slice(3, 3)), cloud.select(slice(3, None))]
    assert_same(PointCloud.concatenate(parts), cloud)
    assert len(parts) == 3
    assert_same(PointCloud.concatenate(parts, consume=True), cloud)
    assert parts == []


MEMORY = """
import json, sys, tracemalloc
from helpers.clouds import NAMES, chunk_of, small_columns
from lidarscene.cloud.builder import CloudBuilder
from lidarscene.cloud.point_cloud import PointCloud
# Before Python 3.12.9 and 3.13.2 tracemalloc can end a process in which Dr.Jit starts threads.
assert "drjit" not in sys.modules

def built(chunks, **options):
    builder = CloudBuilder(**options)
    for chunk in chunks:
        builder.append(chunk)
    return builder

tracemalloc.start()
builder = built(small_columns({n}, seed=seed) for seed in range({count}))
tracemalloc.reset_peak()
before, _ = tracemalloc.get_traced_memory()
cloud = PointCloud(**builder.fields(**NAMES))
_, peak = tracemalloc.get_traced_memory()
tracemalloc.stop()
assert len(cloud) == {count} * {n}

chunks = [chunk_of({n}) for _ in range({count})]
tracemalloc.start()
cloud = PointCloud(**built(chunks, capacity={count} * {n}).fields())
taken, _ = tracemalloc.get_traced_memory()
tracemalloc.stop()
assert cloud.radial_velocity_m_s.strides == cloud.sensor_index.strides == (0,)
assert len(cloud.radial_velocity_m_s) == {count} * {n}
print(json.dumps([peak - before, taken]))
"""


def test_memory_of_a_builder(run_python: Any) -> None:
    """The points and one column: 50 million points must not be there twice. Tolerance: the widest column and 64 KB.

    Columns of one value take none, however many chunks there are; the others do, to half a byte a point.
    """
    changing_columns = [c for c in columns_of(truth=True, vectors=False) if c.absent is None]
    size = sum(np.dtype(c.dtype).itemsize for c in changing_columns)
    count, n = 20, 20_000
    path = os.pathsep.join((str(TESTS.parent / "src"), str(TESTS)))
    process = run_python(MEMORY.format(count=count, n=n), PYTHONPATH=path)
    assert_ended(process, stderr=None)
    join, changing = json.loads(process.stdout)
    assert join < count * n * 12 + 65536
    assert size * count * n <= changing < (size + 0.5) * count * n


def test_builder_of_nothing_is_an_empty_cloud() -> None:
    cloud = PointCloud(**CloudBuilder().fields(metadata={"sensor": "a"}))
    assert (len(cloud), cloud.has_truth, cloud.metadata) == (0, True, {"sensor": "a"})


def test_repr_is_one_line() -> None:
    cloud = small_cloud(status=[0, 0, 1, 0, 0, 1, 0])
    assert repr(cloud).startswith("PointCloud(7 points: 5 echoes, 2 false alarms; x ")
    assert repr(cloud).endswith("m; sensor 'test')")
    assert repr(small_cloud(0)) == "PointCloud(0 points: 0 echoes, 0 false alarms; sensor 'test')"


def test_survives_pickle_and_copy() -> None:
    """Rationale: clouds travel between the processes of a training pipeline, and are as read-only there."""
    for copied in (pickle.loads(pickle.dumps(small_cloud())), copy.deepcopy(small_cloud()), copy.copy(small_cloud())):
        assert_same(copied, small_cloud())
        assert not any(column.flags.writeable for column in copied._arrays().values())


@pytest.mark.parametrize("n", [0, 7])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_to_open3d(n: int, dtype: Any, open3d: ModuleType) -> None:
    cloud = small_cloud(n, xyz_m=small_columns(n)["xyz_m"].astype(dtype))
    theirs = cloud.to_open3d()
    assert set(theirs.point) == {"positions"} | {c.name for c in cloud.columns[3:]}
    np.testing.assert_array_equal(theirs.point["positions"].numpy(), cloud.xyz_m, strict=True)
    for c in cloud.columns[3:]:
        values = cloud.column(c.name)[:, None]
        np.testing.assert_array_equal(theirs.point[c.name].numpy(), values, strict=True)


def test_to_open3d_with_colours_and_as_it_was(open3d: ModuleType) -> None:
    """Reference: the colours of pictures, from 0 to 1; the older class has positions and colours alone."""
    cloud = small_cloud(7)
    expected = cloud.colours("range") / 255.0
    theirs = cloud.to_open3d(colour_by="range")
    np.testing.assert_allclose(theirs.point["colors"].numpy(), expected, atol=1e-6)
    old = cloud.to_open3d(colour_by="range", legacy=True)
    assert type(old) is open3d.geometry.PointCloud
    np.testing.assert_allclose(np.asarray(old.points), cloud.xyz_m)
    np.testing.assert_allclose(np.asarray(old.colors), expected, atol=1e-6)
    assert not cloud.to_open3d(legacy=True).has_colors()


def test_without_open3d_the_error_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def closed() -> ModuleType:
        raise LidarSceneError("try: pip install open3d")

    monkeypatch.setattr(interop, "open3d", closed)
    with pytest.raises(LidarSceneError, match="pip install open3d"):
        small_cloud().to_open3d()


def used_memory(size: int) -> Numbers:
    """Bytes that something else has left."""
    return np.full(size, 171, np.uint8)


@pytest.mark.parametrize(("capacity", "memory"), [(0, None), (30, None), (30, used_memory), (10, used_memory)])
@pytest.mark.parametrize("order", [(0.0, 0.0, 1.0, 1.0), (0.0, 1.0, 1.0), (1.0, 1.0, 1.0, None), (None, 1.0, 1.0)])
def test_values_that_change_are_kept(order, capacity, memory):
    """Constant chunks of another value, and chunks of many values (None), wherever they come; in any memory."""
    parts = [small_columns(7, seed=3) if value is None else chunk_of(7, velocity=value) for value in order]
    builder = CloudBuilder(capacity=capacity, memory=memory)
    for part in parts:
        builder.append(part)
    cloud = PointCloud(**builder.fields())
    for name in ("radial_velocity_m_s", "sensor_index", "range_m"):
        np.testing.assert_array_equal(getattr(cloud, name), np.concatenate([part[name] for part in parts]))


def test_of_a_rig_the_first_sensor_counts() -> None:
    """Place, turn and start are those of the first; the world is one and the same."""
    metadata = {
        "frame": "vehicle",
        "sensor_position_m": "1 2 3 4 5 6",
        "sensor_rotation": "0 -1 0 1 0 0 0 0 1 1 0 0 0 1 0 0 0 1",
        "frame_start_s": "0.5 0.75",
        "sensor_to_world": "1 0 0 10 0 0 -1 20 0 1 0 30",
    }
    cloud = small_cloud(metadata=metadata)
    assert cloud.sensor_place.position_m.tolist() == [1, 2, 3]
    assert cloud.sensor_place.rotation.tolist() == [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    assert cloud.frame_start_s == 0.5
    assert cloud.sensor_to_world is not None
    assert cloud.sensor_to_world.rotation.tolist() == [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    # The sensor itself, from the frame of the points into the world, is where it stands there.
    place = cloud.frame_to_world
    assert place is not None
    np.testing.assert_allclose(place.apply(np.array([[1.0, 2.0, 3.0]])), [[10.0, 20.0, 30.0]], atol=1e-12)
    # Its own x is y of the vehicle and x of the world.
    np.testing.assert_allclose(place.rotation @ [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("frames", [("sensor", "sensor"), ("world", "vehicle")])
def test_clouds_in_frames_of_their_own_are_not_merged(frames: tuple[str, str]) -> None:
    parts = [small_cloud(metadata={"frame": frame, "sensor_position_m": "0 0 0"}) for frame in frames]
    with told("one frame | world or vehicle", ValueError):
        merge_clouds(parts, ["a", "b"])


def test_columns_and_points_by_brackets() -> None:
    cloud = small_cloud(9)
    np.testing.assert_array_equal(cloud["range"], cloud.range_m)
    assert cloud.xyz is cloud.xyz_m
    assert_same(cloud[cloud["range"] > 1.0], cloud.select(cloud.range_m > 1.0))
    assert_same(cloud[2:5], cloud.select(slice(2, 5)))
    rows = np.asarray(cloud)
    assert rows.dtype.names == tuple(column.name for column in cloud.columns)
    np.testing.assert_array_equal(rows["snr"], cloud.snr)
    assert (cloud[-1], cloud[np.int64(5)]) == (rows[8], rows[5])
    assert list(cloud) == list(rows)
    assert cloud.shape == rows.shape
    np.testing.assert_array_equal(cloud[["x", "y", "z"]], cloud.xyz_m, strict=True)
    assert cloud.to_numpy(["range", "class"]).dtype == np.float64


def test_columns_are_attributes_by_their_names_in_files() -> None:
    cloud: Any = small_cloud(9)
    for column in cloud.columns:
        if column.name != "class":
            np.testing.assert_array_equal(getattr(cloud, column.name), cloud[column.name])
            assert column.name in dir(cloud)
    assert cloud.points is cloud.xyz_m
    assert not hasattr(cloud.without_truth(), "true_range")
    with pytest.raises(AttributeError, match=r"no 'rangee'; did you mean range[?]"):
        _ = cloud.rangee
    assert not hasattr(cloud, "rays")


def test_codes_compare_by_name_and_by_code() -> None:
    cloud: Any = small_cloud(50)
    for column, names in (("class", cloud.class_names), ("body", cloud.body_names), ("status", STATUS_NAMES)):
        codes = np.asarray(cloud[column])
        for code, name in enumerate(names):
            np.testing.assert_array_equal(cloud[column] == name, codes == code, strict=True)
            np.testing.assert_array_equal(cloud[column] != name, codes != code, strict=True)
            np.testing.assert_array_equal(cloud[column] == code, codes == code, strict=True)
        either = (codes == 0) | (codes == 1)
        for mask in (
            cloud[column].isin(names[:2]),
            np.isin(cloud[column], names[:2]),
            cloud[column].isin([0, names[1]]),
        ):
            np.testing.assert_array_equal(mask, either)
        named = cloud[column].as_names()
        assert named.tolist() == [names[code] if code >= 0 else "" for code in codes]
        copied = pickle.loads(pickle.dumps(cloud[column]))
        known = codes >= 0
        assert (copied[known] == named[known]).all()
        assert type(cloud[column] + 1) is np.ndarray
        assert isinstance(cloud[column].max(), np.integer)
    chosen = cloud.select(class_=cloud.class_names[0], status=["echo", 1])
    mask = (cloud.class_id == 0) & np.isin(cloud.status, (0, 1))
    assert_same(chosen, cloud.select(mask))
    assert_same(cloud.select(slice(0, 20), class_=0), cloud.select(slice(0, 20)).select(class_=0))
    assert_same(cloud[cloud["status"] == "false alarm"], cloud.select(cloud.status == Status.FALSE_ALARM))


def test_a_name_that_no_point_can_have_is_said() -> None:
    cloud = small_cloud(9)
    with pytest.warns(UnknownNameWarning, match="status: nothing is named 'ecko' here; did you mean echo[?] "):
        assert not (cloud["status"] == "ecko").any()
    with pytest.warns(UnknownNameWarning, match="class: nothing is named 'lorry' here; the choices are"):
        assert len(cloud.select(class_="lorry")) == 0


def test_transform_moves_points_vectors_and_sensor() -> None:
    unit = np.array([0.6, 0.0, -0.8], np.float32)
    vectors = {name: np.full(9, unit[axis % 3]) for axis, name in enumerate(OF_VECTORS)}
    cloud = small_cloud(9, **vectors)
    pose = Pose.from_degrees(position_m=(10.0, -2.0, 1.0), yaw_deg=30.0, pitch_deg=5.0, roll_deg=-3.0)
    matrix = np.vstack([np.column_stack([pose.rotation, pose.position_m]), [0, 0, 0, 1]])
    for moved in (cloud.transform(pose), cloud.transform(matrix)):
        np.testing.assert_allclose(moved.xyz_m, cloud.xyz_m @ pose.rotation.T + pose.position_m, atol=1e-12)
        np.testing.assert_allclose(moved.normals, cloud.normals @ pose.rotation.T, atol=1e-6)
        np.testing.assert_allclose(moved.sensor_position_m, pose.apply(cloud.sensor_position_m[None])[0])
        np.testing.assert_allclose(moved.in_sensor_frame().xyz_m, cloud.in_sensor_frame().xyz_m, atol=1e-4)
    for wrong in (np.eye(3), 2.0 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), "abc"):
        with told("pose | Pose"):
            cloud.transform(wrong)


def test_sum_joins_clouds() -> None:
    a, b = small_cloud(3), small_cloud(4)
    assert_same(sum([a, b]), a + b)


def test_clouds_are_added_by_the_names_of_what_they_hit() -> None:
    a = small_cloud(3)
    b = replace(a, body_names=tuple(reversed(a.body_names)))
    both = a + b
    assert len(both) == 6
    names = [[cloud.body_names[number] if number >= 0 else "" for number in cloud.body] for cloud in (both, a, b)]
    assert names[0] == names[1] + names[2]
    assert both.metadata == a.metadata
    np.testing.assert_array_equal((a + a).range_m, np.concatenate([a.range_m, a.range_m]))
    moved = replace(a, metadata={**a.metadata, "frame": "sensor", "sensor_to_world": "1 0 0 5 0 1 0 0 0 0 1 0"})
    still = replace(a, metadata={**a.metadata, "frame": "sensor", "sensor_to_world": "1 0 0 0 0 1 0 0 0 0 1 0"})
    with told("coordinates | 'sensor' | 1 0 0 5"):
        moved + still
    with told("truth and vectors"):
        a + a.without_truth()
    with pytest.raises(TypeError):
        a + 3


def test_a_range_image_and_a_plot(tmp_path: Path) -> None:
    cloud = small_cloud(9)
    images = cloud.range_image()
    shown = images["point"] >= 0
    np.testing.assert_array_equal(images["range"][shown], cloud.range_m[images["point"][shown]])
    picture = cloud.plot("range", size_px=(320, 180))
    picture.save(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes() == picture._repr_png_()
    assert picture.png.startswith(b"\x89PNG")
