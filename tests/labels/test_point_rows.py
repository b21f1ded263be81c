"""Rows of points that are made on the device: those of the cloud in NumPy, to the bit."""

from pathlib import Path

import numpy as np
import pytest
from helpers import launches, rounding
from helpers.run_seed import chosen

from lidarscene import load_scene, load_sensor
from lidarscene.kernel.rays import device_columns
from lidarscene.labels import kitti_dataset
from lidarscene.labels.boxes import CountedPoints
from lidarscene.labels.files import DONT_CARE
from lidarscene.labels.point_rows import PointRows
from lidarscene.outputs.streams import row_reader
from lidarscene.rendering.render_options import FrameOptions
from lidarscene.rendering.simulator import Simulator

pytestmark = pytest.mark.usefixtures("mi")

ROWS = ["scanner.elevation_step_deg=0.7", "scanner.azimuth_step_deg=0.5", "tdc.threshold_to_noise=3.5"]


def rows_of(sim: Simulator, frame: FrameOptions, dataset: str, *, deskew: bool, own_car: bool) -> list[PointRows]:
    pieces: list[PointRows] = []
    reader = row_reader(sim, frame, dataset, deskew=deskew, own_car=own_car)
    sim.stream(pieces.append, frame, read=reader)
    assert all(isinstance(piece, PointRows) for piece in pieces)
    return pieces


def counted_columns(rows: PointRows) -> list[np.ndarray]:
    assert isinstance(rows.labels, CountedPoints)
    return [*rows.labels.columns, rows.labels.time_s]


@pytest.mark.parametrize(
    ("scene", "pose", "coordinates", "deskew", "own_car"),
    chosen(
        1,
        [
            *(("drive", None, coordinates, True, True) for coordinates in ("world", "sensor")),
            ("drive", (-6.0, 0.0, 2.5), "vehicle", False, False),
            ("car", (4000.0, -3000.0, 2.0), "world", True, False),
        ],
    ),
)
def test_rows_are_those_of_the_cloud(monkeypatch, scene, pose, coordinates, deskew, own_car):
    """Bodies that move, the vehicle's own or none of these, and false alarms; in pieces, as a GPU copies them, and far
    from the origin, where coordinates are in double precision. Another frame compiles nothing.
    """
    described = load_scene(scene)
    sim = Simulator(described, load_sensor("table1-apd", overrides=ROWS), pose=pose)
    frames = [FrameOptions(number=number, chunk=4000, coordinates=coordinates) for number in (1, 2)]
    runs, is_far = [], scene == "car"
    for frame, is_cuda in zip(frames, (False, True), strict=True):
        cloud = sim.render(frame)
        if not own_car:
            assert is_far or np.isin(cloud.body, described.own_bodies).sum() > 20
            cloud = cloud.without_bodies(described.own_bodies)
        cloud = sim.without_motion(cloud, frame) if deskew else cloud
        expected = PointRows.of_cloud(cloud, described, "semantickitti")
        assert len({*expected.labels.tolist()}) >= (1 if is_far else 6)
        assert cloud.xyz_m.itemsize == (8 if is_far else 4)
        monkeypatch.setattr(device_columns, "is_cuda", lambda is_cuda=is_cuda: is_cuda)
        with launches.launched() as kernels:
            pieces, boxed = (
                rows_of(sim, frame, dataset, deskew=deskew, own_car=own_car) for dataset in ("semantickitti", "kitti")
            )
        runs.append(kernels)
        assert len(pieces) > 2
        rows = np.concatenate([piece.rows for piece in pieces])
        assert (rows.dtype, rows.shape) == (np.float32, expected.rows.shape)
        rounding.assert_same(rows, expected.rows)
        np.testing.assert_array_equal(np.concatenate([piece.labels for piece in pieces]), expected.labels, strict=True)
        # KITTI's have the same rows, and what its boxes are counted of.
        np.testing.assert_array_equal(np.concatenate([piece.rows for piece in boxed]), rows, strict=True)
        assert all(values.flags.aligned for piece in boxed for values in counted_columns(piece))
        columns = zip(*map(counted_columns, boxed), strict=True)
        for own, whole in zip(columns, counted_columns(PointRows.of_cloud(cloud, described, "kitti")), strict=True):
            rounding.assert_same(np.concatenate(own), whole)
        assert boxed[0].cloud.metadata == cloud.metadata
    launches.assert_none_is_new(runs[1], runs[0])


@pytest.mark.parametrize("dataset", ["kitti", "semantickitti"])
def test_a_frame_without_points_has_all_files(tmp_path: Path, dataset: str) -> None:
    scene = load_scene("car")
    empty = Simulator(scene, "table1-apd").empty()
    with kitti_dataset.frame_stream(dataset, tmp_path, 0, scene) as append:
        append(empty)
    paths = kitti_dataset.frame_files(dataset, kitti_dataset.cloud_path(dataset, tmp_path, 0))
    labels = (DONT_CARE + "\n").encode() if dataset == "kitti" else b""
    assert [path.read_bytes() for path in paths[:2]] == [b"", labels]
    assert all(path.is_file() for path in paths)
