"""A cloud that stays on the device: the same points, which other libraries read without a copy."""

import gc

import numpy as np
import pytest
from helpers import launches
from helpers.clouds import assert_same
from helpers.mistakes import told
from helpers.traffic import traffic

from lidarscene import load_scene, load_sensor, render, render_frames
from lidarscene.cloud.device_cloud import DeviceCloud
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats.cloud_columns import attributes
from lidarscene.kernel.device import backend, gate, pinned
from lidarscene.kernel.rays import device_columns
from lidarscene.maths.pose import Pose
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Scene

pytestmark = pytest.mark.usefixtures("mi")

ROWS = ["scanner.elevation_step_deg=0.35"]
CHUNK = 10_000

MOVING = traffic(), load_sensor("table1-apd", overrides=["scanner.elevation_step_deg=2.5"])
"""Frames of 0.13 s of a scene in which all moves."""


def simulator(scene: Scene | str = "car", **options: object) -> Simulator:
    return Simulator(load_scene(scene), load_sensor("table1-apd", overrides=ROWS), **options)


def in_numpy(cloud: DeviceCloud, name: str) -> np.ndarray:
    return np.array(np.from_dlpack(getattr(cloud, name), device="cpu"))


@pytest.mark.parametrize("chunk", [2**20, CHUNK])
def test_columns_on_the_device_are_those_of_the_cloud(chunk: int) -> None:
    """Bit for bit, of a frame in one piece and of one in five: glass gives some chunks columns that others lack."""
    sim = simulator(vectors=True)
    cloud = sim.render(seed=5, chunk=chunk)
    on_device = sim.render(seed=5, chunk=chunk, on_device=True)
    assert isinstance(on_device, DeviceCloud)
    assert cloud.interactions is not None
    assert cloud.interactions.any()
    assert_same(on_device.numpy(), cloud)
    assert (len(on_device), on_device.metadata["seed"]) == (len(cloud), "5")
    for name in attributes(truth=True, vectors=True):
        values, column = getattr(cloud, name), getattr(on_device, name)
        assert column.shape == values.shape
        np.testing.assert_array_equal(in_numpy(on_device, name), values, err_msg=name)
        assert in_numpy(on_device, name).dtype == values.dtype


def test_far_points_are_in_double_precision() -> None:
    """The position is added on the device, to what single precision holds."""
    sim = simulator(pose=Pose(position_m=np.array([4000.0, -3000.0, 2.0])))
    cloud, on_device = sim.render(), sim.render(on_device=True)
    assert cloud.xyz_m.dtype == in_numpy(on_device, "xyz_m").dtype == np.float64
    np.testing.assert_array_equal(in_numpy(on_device, "xyz_m"), cloud.xyz_m)


def test_columns_outlive_frames_and_simulator() -> None:
    """Later frames would write where they are, if nothing held them; a column outlives its cloud."""
    sim = simulator()
    kept = sim.render(seed=1, on_device=True)
    ranges, expected = kept.range_m, in_numpy(kept, "snr")
    before = np.array(np.from_dlpack(ranges, device="cpu"))
    for seed in range(3):
        sim.render(seed=seed, on_device=True)
    del sim
    gc.collect()
    np.testing.assert_array_equal(in_numpy(kept, "snr"), expected)
    del kept
    gc.collect()
    simulator().render(seed=9)
    np.testing.assert_array_equal(np.from_dlpack(ranges, device="cpu"), before)


def test_a_cpu_shares_its_memory() -> None:
    if backend.is_cuda():
        pytest.skip("a GPU has memory of its own")
    cloud = simulator().render(on_device=True)
    assert np.shares_memory(np.from_dlpack(cloud.range_m), cloud.numpy().range_m)
    assert cloud.range_m.__dlpack_device__() == (1, 0)
    assert not np.shares_memory(np.from_dlpack(cloud.range_m, copy=True), cloud.numpy().range_m)


def test_a_frame_without_points_has_empty_columns() -> None:
    overrides = [*ROWS, "tdc.threshold_to_noise=100"]
    sky = Simulator(load_scene("car"), load_sensor("table1-apd", overrides=overrides), pose=(0, 0, 500, 0, 90))
    assert len(sky.render()) == 0
    cloud = sky.render(on_device=True)
    assert_same(cloud.numpy(), sky.render())
    assert in_numpy(cloud, "xyz_m").shape == (0, 3)
    assert in_numpy(cloud, "ghost").shape == (0,)


def test_every_way_to_render_leaves_columns_there() -> None:
    overrides = [*ROWS, "scanner.azimuth_step_deg=2"]
    cloud = render("car", "table1-apd", overrides=overrides, on_device=True)
    assert_same(cloud.numpy(), render("car", "table1-apd", overrides=overrides))
    frames = [*render_frames("car", "table1-apd", frames=2, overrides=overrides, on_device=True)]
    assert [frame.metadata["frame_number"] for frame in frames] == ["0", "1"]
    assert_same(frames[0].numpy(), cloud.numpy())
    with pytest.raises(AttributeError, match="no column or attribute 'rang_m'"):
        cloud.rang_m  # noqa: B018
    with told("keep_rays | False | on_device is True"):
        render("car", "table1-apd", overrides=overrides, on_device=True, keep_rays=True)


def test_frames_of_a_run_are_each_their_own() -> None:
    """Small frames may be traced together; each cloud has its own points, positions and times, and keeps no others."""
    clouds, sim = [*render_frames(*MOVING, frames=6, on_device=True)], Simulator(*MOVING)
    for number, cloud in enumerate(clouds):
        alone = sim.render(number=number)
        assert_same(cloud.numpy(), alone)
        for name in ("xyz_m", "time_s", "body", "ghost"):
            np.testing.assert_array_equal(in_numpy(cloud, name), getattr(alone, name))


def test_columns_in_one_copy_are_those_of_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """All types, glass, normals, far points, and frames that share a launch, as a GPU hands them out. Another number
    of points compiles nothing, and what no cloud holds any more goes back.
    """
    gc.collect()
    gate.retire(())
    others, near = pinned._Pinned.in_use, simulator(vectors=True)
    far = simulator(pose=Pose(position_m=np.array([4000.0, -3000.0, 2.0])))
    expected = [near.render(seed=1), near.render(seed=2), far.render(), *render_frames(*MOVING, frames=4)]
    assert len(expected[0]) != len(expected[1])
    monkeypatch.setattr(device_columns, "is_cuda", lambda: True)
    clouds, runs = list[PointCloud](), []
    for seed in (1, 2):
        with launches.launched() as kernels:
            clouds.append(near.render(seed=seed))
        runs.append(kernels)
    launches.assert_none_is_new(runs[1], runs[0])
    clouds += [far.render(), *render_frames(*MOVING, frames=4)]
    for cloud, reference in zip(clouds, expected, strict=True):
        assert_same(cloud, reference)
        assert all(getattr(cloud, name).flags.c_contiguous for name in ("xyz_m", "time_s", "status"))
    np.testing.assert_array_equal(clouds[0].normal_x, expected[0].normal_x)
    assert pinned._Pinned.in_use > 20 * sum(map(len, clouds))
    monkeypatch.setattr(pinned, "MOST_BYTES", pinned._Pinned.in_use)
    assert_same(near.render(seed=1), expected[0])  # in ordinary memory
    assert pinned._Pinned.in_use == pinned.MOST_BYTES
    del clouds, cloud, reference, expected, near, far
    gc.collect()
    gate.retire(())
    assert pinned._Pinned.in_use == others


def test_tensors_of_pytorch_are_where_the_cloud_is() -> None:
    torch = pytest.importorskip("torch")
    cloud = simulator().render(on_device=True)
    tensor = torch.from_dlpack(cloud.xyz_m)
    assert tensor.is_cuda == backend.is_cuda()
    np.testing.assert_array_equal(tensor.cpu().numpy(), cloud.numpy().xyz_m)
