"""Which boxes a ray passes, against double precision, and that they change nothing."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import chain, launches
from helpers.run_seed import chosen
from helpers.traffic import SENSOR, direction, moving, traffic

from lidarscene import load_scene
from lidarscene.kernel.device import transfer
from lidarscene.kernel.rays import nearby_bodies
from lidarscene.maths import motion_table
from lidarscene.maths.box_tree import BoxTree
from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course, Spline
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Part, Scene

pytestmark = pytest.mark.usefixtures("mi")


def rays(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origins, unit directions (some along an axis) and lengths (some infinite), (n, 3) and (n,)."""
    rng = np.random.default_rng(11)
    towards = rng.normal(size=(count, 3))
    towards[: count // 8, :2] = 0.0
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    length = np.where(rng.random(count) < 0.5, math.inf, rng.uniform(1.0, 40.0, count))
    return rng.uniform(-20.0, 20.0, (count, 3)), towards, length


def passes_box(origin: np.ndarray, towards: np.ndarray, length: np.ndarray, box: np.ndarray) -> np.ndarray:
    """(n,) whether rays pass a (2, 3) box."""
    with np.errstate(divide="ignore"):
        to_low, to_high = ((corner - origin) / towards for corner in box)
    near = np.maximum(np.fmin(to_low, to_high).max(axis=1), 0.0)
    return near <= np.minimum(np.fmax(to_low, to_high).min(axis=1), length)


@pytest.mark.parametrize("count", [1, 2, 33, 150])
def test_boxes_that_are_passed(count: int) -> None:
    """A box 1 mm smaller has none that is not found, one 1 mm larger all that are: 20 m in single precision are good
    to some 10 um. One level and four; some boxes hold the origin of a ray, and nothing is in every seventh.
    """
    import drjit as dr
    import mitsuba as mi

    origin, towards, length = (array.astype(np.float32).astype(np.float64) for array in rays(2000))
    rng = np.random.default_rng(12)
    low = rng.uniform(-20.0, 15.0, (count, 3))
    boxes = np.stack([low, low + rng.uniform(4.0, 9.0, low.shape)], axis=1)
    boxes[3::7] = motion_table.NOWHERE
    ray = mi.Ray3f(mi.Point3f(*origin.T), mi.Vector3f(*towards.T))
    tree = BoxTree.from_boxes(boxes)
    on_device = dataclasses.replace(tree, nodes=transfer.from_numpy(tree.nodes))
    walk = nearby_bodies.BoxWalk(tree=on_device, slabs=nearby_bodies.Slabs.of_ray(ray))
    passed = np.zeros((len(origin), count), dtype=bool)
    node = walk.start(True, mi.Float(length))
    while (node.numpy() != 0).any():
        node, number = walk.next_box(node, mi.Float(length))
        dr.eval(node, number)
        (lanes,) = np.nonzero(number.numpy() >= 0)
        assert not passed[lanes, number.numpy()[lanes]].any()  # each box once
        passed[lanes, number.numpy()[lanes]] = True
    for number, box in enumerate(boxes):
        if number % 7 == 3:
            assert not passed[:, number].any()
            continue
        assert passed[:, number].any()
        grow = np.array([[-1e-3], [1e-3]])
        assert not (passes_box(origin, towards, length, box - grow) & ~passed[:, number]).any()
        assert not (passed[:, number] & ~passes_box(origin, towards, length, box + grow)).any()


def crowd(count: int = 40, shapes: int = 1) -> Scene:
    """Boxes of one shape or of several, and a wall behind, before a sensor that drives."""
    shared = [chain.box(at=(0.0, 0.0, 0.0), size_m=(0.4, 0.3, 1.6)) for _ in range(shapes)]
    bodies = [chain.facing(range_m=50.0, size_m=120.0)]
    for number in range(count):
        shape = shared[number % shapes]
        azimuth, distance_m = math.radians(-17.5 + 0.9 * number), 22.0 + number % 7 * 2.0
        start = Pose.from_degrees(
            position_m=(distance_m * math.cos(azimuth), distance_m * math.sin(azimuth), 0.3), yaw_deg=31.0 * number
        )
        motion = Course(start=start, speed_m_s=0.05 * number, yaw_rate_rad_s=0.2 * (number % 3))
        bodies.append(moving(shape, f"box {number}", motion))
    return dataclasses.replace(traffic(), bodies=tuple(bodies))


def nearest_hit_m(origin: np.ndarray, towards: np.ndarray, part: Part) -> np.ndarray:
    """(n,) distance to the nearest triangle, one after the other (Moeller and Trumbore), infinite for none."""
    nearest = np.full(len(origin), np.inf)
    for corners in np.asarray(part.vertices_m, np.float64)[part.faces]:
        first, second = corners[1] - corners[0], corners[2] - corners[0]
        across = np.cross(towards, second)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = 1.0 / (across @ first)
            offset = origin - corners[0]
            u = np.einsum("ni,ni->n", offset, across) * share
            normal = np.cross(offset, first)
            v, t = np.einsum("ni,ni->n", towards, normal) * share, normal @ second * share
            inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)
        nearest = np.where(inside, np.fmin(nearest, t), nearest)
    return nearest


@pytest.mark.parametrize("shapes", chosen(1, [1, 7]))
def test_the_nearest_of_a_loop_over_all_bodies(shapes: int) -> None:
    """Each beam is carried into the frame of every body as it stands when that beam leaves, in double precision.

    Tolerances: 0.1 mm, single precision of 50 m over some ten operations. A beam that grazes an edge may fall to either
    side: fewer than one in a thousand.
    """
    scene = crowd(shapes=shapes)
    simulator = Simulator(scene, chain.sensor("table1-apd", *SENSOR))
    cloud = simulator.render(seed=1)
    cloud = cloud.select(cloud.status == 0)
    assert len(np.unique(cloud.body)) > 33
    sensor = simulator.motion.at(cloud.time_s)
    towards = np.einsum("nij,nj->ni", sensor.rotation, direction(cloud))
    distance = []
    for body in scene.bodies:
        states = (body.motion or Course(start=body.pose)).at(cloud.time_s)
        origin = np.einsum("nji,nj->ni", states.rotation, sensor.position_m - states.position_m)
        (part,) = body.parts
        assert isinstance(part, Part)
        distance.append(nearest_hit_m(origin, np.einsum("nji,nj->ni", states.rotation, towards), part))
    table = np.stack(distance)
    agree = (table.argmin(axis=0) == cloud.body) & (np.abs(table.min(axis=0) - cloud.true_range_m) < 1e-4)
    assert agree.mean() > 0.999


@pytest.mark.parametrize("rays", [1, 3])
def test_boxes_change_nothing(monkeypatch: pytest.MonkeyPatch, rays: int) -> None:
    """Frames are the same to the last bit, against boxes that every ray passes, so that every ray asks every body."""
    sensor = chain.sensor("table1-apd", *SENSOR, "scanner.azimuth_step_deg=0.8")
    cloud = Simulator(crowd(), sensor, rays=rays).render(seed=2)
    monkeypatch.setattr(
        motion_table,
        "_swept_boxes",
        lambda _, carried, step_s: np.tile([[[-1e4] * 3, [1e4] * 3]], (len(carried), 1, 1)),
    )
    expected = Simulator(crowd(), sensor, rays=rays).render(seed=2)
    assert len(np.unique(cloud.body)) > 33
    for name in ("time_s", "true_range_m", "range_m", "body", "in_shadow", "radial_velocity_m_s", "snr"):
        np.testing.assert_array_equal(getattr(cloud, name), getattr(expected, name), err_msg=name)


def test_a_body_that_comes_into_view_compiles_nothing() -> None:
    """Far behind the sensor at first, where no ray comes near it; a second and a half later 12 m ahead."""
    way = [Pose.from_degrees(position_m=(x, 0.0, 0.0)) for x in (-300.0, 12.0)]
    comes = moving(chain.box(at=(0.0, 0.0, 0.0)), "comes", Spline(time_s=np.array([0.0, 1.5]), poses=tuple(way)))
    simulator = Simulator(
        chain.scene(chain.facing(range_m=50.0, size_m=120.0), comes), chain.sensor("table1-apd", *SENSOR)
    )
    with launches.launched() as before:
        without_body = simulator.render(seed=0)
    with launches.launched(after=before):
        with_body = simulator.render(seed=1, begin_s=1.1)
    assert not np.any(without_body.body == 1)
    assert np.any(with_body.body == 1)


def test_another_number_of_bodies_compiles_nothing() -> None:
    """Nor does another number of shapes; and which bodies share one changes a place by its rounding.

    Tolerance: 0.02 mm, five steps of single precision at 50 m.
    """
    sensor = chain.sensor("table1-apd", *SENSOR, "scanner.azimuth_step_deg=0.8")
    with launches.launched() as before:
        Simulator(crowd(3), sensor).render(seed=0)
    with launches.launched(after=before):
        cloud = Simulator(crowd(29), sensor).render(seed=1)
        several = Simulator(crowd(29, shapes=5), sensor)
        expected = several.render(seed=1)
    mover_scene = several.world.mover_scene
    assert mover_scene is not None
    assert len(mover_scene.scene.shapes()) == 1  # all of one material; each shape costs time in every frame
    assert len(np.unique(cloud.body)) > 20
    for name in ("body", "in_shadow"):
        np.testing.assert_array_equal(getattr(cloud, name), getattr(expected, name), err_msg=name)
    for name in ("xyz_m", "true_range_m", "radial_velocity_m_s"):
        np.testing.assert_allclose(getattr(cloud, name), getattr(expected, name), atol=2e-5, rtol=0.0, err_msg=name)


def test_worlds_of_other_simulators_compile_nothing() -> None:
    """Nor do those that went: a kernel has the surfaces of its own world, whatever else this process holds."""
    sensor = chain.sensor("table1-apd", *SENSOR, "scanner.azimuth_step_deg=0.8")
    with launches.launched() as before:
        Simulator(crowd(3, shapes=3), sensor).render(seed=0)
    others = [Simulator(load_scene(name), sensor) for name in ("car", "glass")]
    for _ in range(2):
        with launches.launched(after=before):
            Simulator(crowd(3, shapes=3), sensor).render(seed=1)
        others.clear()


def test_no_kernel_of_a_card_is_long() -> None:
    """A card compiles 23,566 operations in 52 s: there each path and its end are kernels, with the same cloud."""
    sensor = chain.sensor("table1-apd", *SENSOR)
    whole = Simulator(load_scene("drive"), sensor).render(seed=1)
    with pytest.MonkeyPatch.context() as patch, launches.launched() as kernels:
        patch.setattr(transfer, "is_cuda", lambda: True)
        split = Simulator(load_scene("drive"), sensor).render(seed=1)
    assert 1000 < max(kernel["operation_count"] for kernel in kernels) < 10_000
    np.testing.assert_array_equal(split.xyz_m, whole.xyz_m)
    np.testing.assert_array_equal(split.intensity, whole.intensity)


def test_one_kernel_asks_all_scenes() -> None:
    """Scenes that do not share a pipeline need kernels of their own on a GPU, where `emulated_gpu` runs this, too."""
    simulator = Simulator(load_scene("drive"), chain.sensor("table1-apd", *SENSOR))
    with pytest.MonkeyPatch.context() as patch, launches.launched() as kernels:
        patch.setattr(transfer, "split_kernel", lambda *values: None)
        cloud = simulator.render(seed=1)
    assert simulator.world.speculars is not None
    assert simulator.world.speculars.lets_through
    assert simulator.world.mover_scene is not None
    assert len(cloud) > 100
    assert sum(bool(kernel.get("uses_optix")) for kernel in kernels) <= 3
    assert 3 < len(kernels) < 20, [(kernel["operation_count"], kernel["size"]) for kernel in kernels]
