"""Labels: boxes against brute force, and data sets in loaders that are not ours."""

import errno
import io
import json
import math
import os
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import street
from helpers.formats import osi_messages, rotated, value_at, write_frame
from helpers.mistakes import told
from scipy.spatial.transform import Rotation

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.cloud.rig_clouds import merge_clouds
from lidarscene.errors import InputError, OutputError
from lidarscene.files import spool
from lidarscene.formats.osi import framed
from lidarscene.formats.registry import DATASETS, LABELS
from lidarscene.labels import boxes as labels_boxes
from lidarscene.labels import kinds, kitti_dataset
from lidarscene.labels.boxes import Box, boxes, boxes_of_bodies, upright_size_and_yaw
from lidarscene.labels.files import (
    CAMERA,
    PICTURE_PX,
    label_paths,
    labels_stream,
    point_labels,
    semantic_kitti,
    write_labels,
)
from lidarscene.labels.kinds import KINDS, kind_of
from lidarscene.labels.kitti_dataset import _write_line
from lidarscene.labels.nuscenes_dataset import Sample, sample_stream
from lidarscene.labels.osi_truth import ground_truth
from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course, Riding, pose_at
from lidarscene.scene.scene import Ball, Body, Part, Scene

CAR = (4.0, 2.0, 1.5)


def box_named(cloud: PointCloud, name: str, scene: Scene | None = None) -> Box:
    return next(box for box in boxes(cloud, scene or street.scene()) if box.name == name)


# --- boxes ------------------------------------------------------------------------------------------


def test_a_box_is_the_block_that_was_put_there(street_cloud: PointCloud) -> None:
    """Reference: the scene. Tolerance: float64 rounding."""
    near = box_named(street_cloud, "near")
    np.testing.assert_allclose(near.size_m, CAR, atol=1e-12)
    np.testing.assert_allclose(near.pose.position_m, [12.0, -3.0, 0.75], atol=1e-12)
    np.testing.assert_allclose(near.pose.rotation, street.pose_at(0, 0, 0, 30.0).rotation, atol=1e-12)


def test_what_is_a_thing_has_a_box(street_cloud: PointCloud) -> None:
    """The road has none; a class that nobody knows has."""
    assert [box.name for box in boxes(street_cloud, street.scene())] == ["near", "far", "wall"]
    assert kind_of("gantry").is_thing
    assert kind_of("Car") is kind_of("car")


def test_points_are_counted_in_both_frames(street_cloud: PointCloud) -> None:
    """Reference: half-spaces of the box, point by point. Points lie on its faces, so half of them fall out by
    rounding: the block is counted a little larger and a little smaller, and the number lies between.
    """
    for cloud in (street_cloud, street_cloud.in_sensor_frame()):
        world_m = cloud.xyz_m.astype(float)
        if cloud is not street_cloud:
            world_m = street.SENSOR.apply(world_m)
        for index, box in enumerate(boxes(cloud, street.scene()), start=1):
            assert box.points_on == np.count_nonzero(cloud.body == index) > 100
            local = (world_m - box.pose.position_m) @ box.pose.rotation
            least, most = (np.all(np.abs(local) <= 0.5 * box.size_m + d, axis=1).sum() for d in (-1e-3, 1e-3))
            assert least <= box.points_inside <= most


def test_visibility_by_tracing_each_body_alone(street_cloud: PointCloud) -> None:
    """Reference: of the beams that meet the body when it stands alone, the share whose echo is from it. A block
    fills its box, so the two are one; tolerance: beams along its edges, a part in a hundred.
    """
    scene = street.scene()
    direction = (street_cloud.xyz_m - street.SENSOR.position_m).astype(float)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for box in boxes(street_cloud, scene):
        scene_of_body = Scene(bodies=(scene.bodies[box.body],))
        range_m, _ = street.nearest(scene_of_body, street.SENSOR.position_m, direction)
        meets = np.isfinite(range_m)
        assert box.beams == pytest.approx(meets.sum(), rel=0.01)
        expected = np.count_nonzero(street_cloud.body[meets] == box.body) / meets.sum()
        assert box.visibility == pytest.approx(expected, abs=0.01)
    assert box_named(street_cloud, "near").visibility == 1.0
    assert 0.2 < box_named(street_cloud, "far").visibility < 0.8


def test_the_ego_vehicle_has_no_box_but_in_osi(tmp_path: Path, library: Any) -> None:
    """Data sets label what the vehicle meets, not itself; OSI's ground truth has all bodies."""
    ego = Course(start=Pose(), speed_m_s=10.0)
    roof = street.block("own", "car", CAR, Pose())
    scene = street.scene()
    riding = replace(roof, motion=Riding(carrier=ego, pose=Pose()))
    driving = replace(scene, bodies=(*scene.bodies, riding), ego=ego)
    assert [box.name for box in boxes(street.cloud(), driving)] == ["near", "far", "wall"]
    (path,) = write_labels(street.cloud(), driving, tmp_path / "a.ply", format="osi")
    (message,) = osi_messages(path, "GroundTruth", library)
    assert len(message.moving_object) + len(message.stationary_object) == 4


def test_points_on_the_ego_vehicle_are_unlabelled(tmp_path: Path, street_cloud: PointCloud) -> None:
    """Rationale: the roof below the sensor is in every frame, and no data set has a car there."""
    ego = Course(start=Pose(), speed_m_s=10.0)
    scene = street.scene()
    near = replace(scene.bodies[1], motion=Riding(carrier=ego, pose=scene.bodies[1].pose))
    driving = replace(scene, bodies=(scene.bodies[0], near, *scene.bodies[2:]), ego=ego)
    label = semantic_kitti(street_cloud, driving)
    assert set(label[street_cloud.body == 1].tolist()) == {0}
    expected = semantic_kitti(street_cloud, scene)
    np.testing.assert_array_equal(label[street_cloud.body != 1], expected[street_cloud.body != 1])


def test_counts_are_those_of_every_point_and_beam() -> None:
    """Reference: each point and beam against each box, without sorting. Boxes lie all around, some across the seam
    of the azimuth, tilted, above the sensor and around it.
    """
    rng = np.random.default_rng(5)
    xyz_m = rng.normal(0.0, 10.0, (4000, 3)).astype(np.float32)
    origin_m = np.array([0.3, -0.2, 1.0])
    status = (rng.random(4000) < 0.1).astype(np.uint8)
    length_m = np.linalg.norm(xyz_m - origin_m, axis=1)
    true_m = length_m * rng.uniform(0.5, 1.2, 4000)
    body = rng.integers(-1, 3, 4000, np.int32)
    points = labels_boxes._PointsByAzimuth(xyz_m, origin_m, true_m - length_m, body, status)
    places = [*rng.normal(0.0, 10.0, (40, 3)), [-8.0, -0.2, 1.0], [-8.0, 0.1, 1.0], [0.3, -0.2, 6.0], [0.3, -0.2, 1.0]]
    for place in places:
        angles = rng.uniform(-180.0, 180.0, 3)
        pose = Pose.from_degrees(position_m=tuple(place), yaw_deg=angles[0], pitch_deg=angles[1], roll_deg=angles[2])
        box = Box(body=0, name="", class_name="car", size_m=rng.uniform(1.0, 6.0, 3), pose=pose)
        (counted,) = points.counted([box], [box])
        local, start = pose.inverse_apply(xyz_m.astype(float)), pose.inverse_apply(origin_m[None])
        inside = (np.abs(local) <= 0.5 * box.size_m).all(axis=1)
        assert counted.points_inside == inside.sum()
        assert counted.points_within == (inside & (body == 0) & (status == 0)).sum()
        way = local - start
        low, high = np.sort([(sign * 0.5 * box.size_m - start) / way for sign in (-1, 1)], axis=0)
        enter, leave = np.maximum(low.max(axis=1), 0.0), high.min(axis=1)
        meets = (enter <= leave) & (status == 0)
        assert counted.beams == meets.sum()
        reaches = (body == 0) | (true_m >= enter * length_m - labels_boxes.STOPPED_M)
        assert counted.reached == (meets & reaches).sum()


def test_a_body_that_no_beam_meets() -> None:
    hidden_car = street.block("behind", "car", CAR, street.pose_at(-30.0, 0.0, 0.75, 0.0))
    scene = replace(street.scene(), bodies=(*street.scene().bodies, hidden_car))
    box = box_named(street.cloud(described=scene), "behind", scene)
    assert (box.points_inside, box.points_on, box.beams, box.visibility, box.has_points) == (0, 0, 0, 0.0, False)


@pytest.mark.parametrize("format", ["kitti", "nuscenes"])
def test_a_box_with_points_of_others_alone_is_no_label(tmp_path: Path, street_cloud: PointCloud, format: str) -> None:
    """Rationale: a detector would learn a car where it sees none, as of the road below one that is hidden."""
    hidden = street.block("hidden", "car", CAR, street.scene().bodies[1].pose)
    scene = replace(street.scene(), bodies=(*street.scene().bodies, hidden))
    cloud = street.cloud(described=street.scene())
    assert box_named(cloud, "hidden", scene).points_inside >= 10
    labels = write_labels(cloud, scene, tmp_path / "a.bin", format=format)[0]
    without = write_labels(cloud, street.scene(), tmp_path / "b.bin", format=format)[0]
    assert labels.read_bytes() == without.read_bytes()


def test_the_sensor_may_be_inside_a_box() -> None:
    """Every beam then enters it, and nothing comes before."""
    hall = street.block("hall", "gantry", (200.0, 200.0, 50.0), street.pose_at(0.0, 0.0, 0.0, 0.0))
    cloud = street.cloud()
    scene = replace(street.scene(), bodies=(*street.scene().bodies, hall))
    box = box_named(cloud, "hall", scene)
    assert (box.beams, box.visibility) == (len(cloud), 1.0)


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg", "size_m"),
    [(0, 0, (4, 2, 1)), (90, 0, (4, 1, 2)), (-90, 0, (4, 1, 2)), (180, 0, (4, 2, 1)), (0, 90, (2, 1, 4))],
)
def test_up_is_the_axis_that_is_up(roll_deg: float, pitch_deg: float, size_m: tuple[float, ...]) -> None:
    """Rationale: a mesh with y up is turned by the scene's pose; its height is still its height."""
    pose = Pose.from_degrees(position_m=(5, 6, 7), yaw_deg=30.0, pitch_deg=pitch_deg, roll_deg=roll_deg)
    (box,) = boxes_of_bodies([(0, street.block("b", "car", (4.0, 2.0, 1.0), pose))])
    np.testing.assert_allclose(box.size_m, size_m, atol=1e-12)
    np.testing.assert_allclose(box.pose.rotation[:, 2], [0, 0, 1], atol=1e-12)
    assert np.linalg.det(box.pose.rotation) == pytest.approx(1.0)
    corners = pose.apply(
        0.5 * np.array([4.0, 2.0, 1.0]) * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    )
    assert sorted(map(tuple, box.corners_m().round(9))) == sorted(map(tuple, corners.round(9)))


def test_balls_and_bodies_off_their_origin() -> None:
    ball = Body(name="b", class_name="car", parts=(Ball(radius_m=0.5, material="m"),), pose=street.pose_at(1, 2, 3, 0))
    np.testing.assert_allclose(boxes_of_bodies([(0, ball)])[0].size_m, [1, 1, 1])
    part = street.block("c", "car", (2.0, 2.0, 2.0), Pose()).parts[0]
    shifted_part = replace(part, vertices_m=part.vertices_m + np.array([10.0, 0.0, 1.0]))
    shifted = Body(name="c", class_name="car", parts=(shifted_part,), pose=street.pose_at(0, 0, 0, 90.0))
    (box,) = boxes_of_bodies([(0, shifted)])
    np.testing.assert_allclose(box.pose.position_m, [0.0, 10.0, 1.0], atol=1e-12)


def test_a_body_of_mirrors_alone_has_a_box() -> None:
    body = street.block("mirrors_van", "van", (4.0, 2.0, 1.0), Pose())
    parts = tuple(replace(part, in_box=False) for part in body.parts if isinstance(part, Part))
    (box,) = boxes_of_bodies([(0, replace(body, parts=parts))])
    np.testing.assert_allclose(box.size_m, [4, 2, 1])


def test_upright_boxes_hold_the_corners() -> None:
    """A box that leans: the upright one around it holds all its corners, and touches them."""
    pose = Pose.from_degrees(yaw_deg=40.0, pitch_deg=10.0, roll_deg=5.0)
    box = Box(body=0, name="", class_name="car", size_m=np.array(CAR), pose=pose)
    size_m, yaw = upright_size_and_yaw(box)
    assert yaw == pytest.approx(math.radians(40.0))
    local = np.abs(box.corners_m() @ street.pose_at(0, 0, 0, 40.0).rotation)
    np.testing.assert_allclose(local.max(axis=0), 0.5 * size_m, atol=1e-12)
    assert (size_m > CAR).all()


# --- labels of points -------------------------------------------------------------------------------


def test_semantic_kitti_labels(tmp_path: Path, street_cloud: PointCloud) -> None:
    """Reference: the bit layout of SemanticKITTI: class in the lower half, instance in the upper."""
    status = np.zeros(len(street_cloud), np.uint8)
    status[:5] = 1
    cloud = replace(street_cloud, status=status)
    (path,) = write_labels(cloud, street.scene(), tmp_path / "a.bin", format="semantickitti")
    assert path == tmp_path / "a.label"
    label = np.fromfile(path, dtype=np.uint32)
    numbers = {"road": 40, "car": 10, "barrier": 52}
    expected = np.array([numbers[cloud.class_names[c]] for c in cloud.class_id])
    expected[:5] = 1
    np.testing.assert_array_equal(label & 0xFFFF, expected)
    is_thing = (cloud.body > 0) & (status == 0)
    np.testing.assert_array_equal(label >> 16, np.where(is_thing, cloud.body + 1, 0))


def test_points_without_a_body_are_unlabelled() -> None:
    cloud = street.cloud()
    none = np.full(len(cloud), -1)
    semantic, instance = point_labels(replace(cloud, body=none, class_id=none), street.scene())
    assert set(semantic.tolist()) == set(instance.tolist()) == {0}


# --- files ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", LABELS)
def test_labels_need_truth_and_place(tmp_path: Path, street_cloud: PointCloud, format: str) -> None:
    with told("labels | truth"):
        write_labels(street_cloud.without_truth(), street.scene(), tmp_path / "a.ply", format=format)
    if format != "semantickitti":
        unplaced = replace(street_cloud, metadata={})
        with told("sensor"):
            write_labels(unplaced, street.scene(), tmp_path / "a.ply", format=format)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("dataset", DATASETS)
def test_a_data_set_needs_truth(tmp_path: Path, street_cloud: PointCloud, dataset: str) -> None:
    """Rationale: a frame without its labels looks whole, and is of no use for training."""
    with told("labels | truth"), kitti_dataset.frame_stream(dataset, tmp_path, 0, street.scene()) as append:
        append(street_cloud.without_truth())
    assert os.listdir(tmp_path) == []


def test_names_of_label_files() -> None:
    assert label_paths("o/a.pcd.bin", format="nuscenes") == (Path("o/a.boxes.json"),)
    assert label_paths("o/a.bin", format="kitti") == (Path("o/a.txt"), Path("o/a.calib.txt"))
    assert label_paths("o/a.osi", format="osi") == (Path("o/a_gt.osi"),)
    assert label_paths("o/a.dat", format="semantickitti") == (Path("o/a.label"),)
    with told("labels 'coco' | kitti | nuscenes | osi"):
        label_paths("a.bin", format="coco")


def test_nuscenes_boxes(tmp_path: Path, street_cloud: PointCloud) -> None:
    """Reference: corners from centre, size (width, length, height) and quaternion, as the devkit makes them."""
    (path,) = write_labels(street_cloud, street.scene(), tmp_path / "a.pcd.bin", format="nuscenes")
    content = json.loads(path.read_text())
    annotations = {annotation["instance_name"]: annotation for annotation in content["sample_annotations"]}
    assert {annotation["category_name"] for annotation in annotations.values()} == {
        "vehicle.car",
        "movable_object.barrier",
    }
    for box in boxes(street_cloud, street.scene()):
        annotation = annotations[box.name]
        width, length, height = annotation["size"]
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        corners = (
            rotated(tuple(annotation["rotation"]), 0.5 * signs * [length, width, height]) + annotation["translation"]
        )
        np.testing.assert_allclose(corners, box.corners_m(), atol=1e-9)
        assert annotation["num_lidar_pts"] == box.points_inside
        bins = {"1": (0, 0.4), "2": (0.4, 0.6), "3": (0.6, 0.8), "4": (0.8, 1.01)}
        low, high = bins[annotation["visibility_token"]]
        assert low <= box.visibility < high
    place = content["lidar_to_world"]
    turned = rotated(tuple(place["rotation"]), street_cloud.in_sensor_frame().xyz_m.astype(float))
    np.testing.assert_allclose(turned + place["translation"], street_cloud.xyz_m, atol=2e-5)


def test_osi_ground_truth(tmp_path: Path, library: Any, street_cloud: PointCloud) -> None:
    """Reference: betterosi reads; OSI's angles are those of ISO 8855."""
    (path,) = write_labels(street_cloud, street.scene(), tmp_path / "a.osi", format="osi")
    (truth,) = osi_messages(path, "GroundTruth", library)
    boxes_by_id = {box.body + 1: box for box in boxes(street_cloud, street.scene())}
    assert sorted(moving_object.id.value for moving_object in truth.moving_object) == [2, 3]
    assert [moving_object.id.value for moving_object in truth.stationary_object] == [4]
    for moving_object in (*truth.moving_object, *truth.stationary_object):
        box = boxes_by_id[moving_object.id.value]
        get = lambda *path, base=moving_object.base: float(value_at(base, path))  # noqa: E731
        np.testing.assert_allclose([get("dimension", n) for n in ("length", "width", "height")], box.size_m)
        np.testing.assert_allclose([get("position", n) for n in "xyz"], box.pose.position_m)
        assert get("orientation", "yaw") == pytest.approx(math.atan2(*box.pose.rotation[[1, 0], 0]))
    car = truth.moving_object[0]
    assert (int(car.type), int(car.vehicle_classification.type)) == (2, 4)
    assert int(truth.stationary_object[0].classification.type) == 8


def boxes_of_classes(*class_names: str) -> list[Box]:
    poses = [Pose.from_degrees(position_m=(n, 2, 3), yaw_deg=30, pitch_deg=20, roll_deg=10) for n in range(99)]
    return [
        Box(body=n, name="", class_name=name, size_m=np.array(CAR), pose=poses[n], velocity_m_s=np.array([n, 5, -7]))
        for n, name in enumerate(class_names)
    ]


def of_classes(rows: str) -> dict[str, str]:
    """What each class is, of rows `WHAT CLASS CLASS ...`."""
    words = (row.split() for row in rows.replace("\n", ";").split(";") if row.strip())
    return {name: what for what, *names in words for name in names}


def test_classes_of_osi(tmp_path: Path, library: Any) -> None:
    """Reference: the names of the OSI group's own definitions, in betterosi; and roll, pitch, yaw as SciPy has them."""
    osi = library("betterosi")
    rows = """
        CAR car; DELIVERY_VAN van; HEAVY_TRUCK truck; TRAILER trailer; MOTORBIKE motorcycle motorcyclist
        BICYCLE bicycle cyclist; BUS bus; TRAM Tram
    """
    vehicles = of_classes(rows)
    walkers = of_classes("PEDESTRIAN pedestrian person child wheelchair_user; ANIMAL animal; OTHER pram")
    structures = of_classes("POLE pole; VERTICAL_STRUCTURE sign traffic_sign; BARRIER barrier; OTHER gantry")
    boxes = boxes_of_classes(*vehicles, *walkers, *structures)
    (tmp_path / "a.osi").write_bytes(framed(ground_truth(boxes).fields(17.25)))
    (truth,) = osi_messages(tmp_path / "a.osi", "GroundTruth", library)
    assert (truth.timestamp.seconds, truth.timestamp.nanos) == (17, 250_000_000)
    moving = truth.moving_object
    kinds = [osi.MovingObjectType(moving_object.type).name for moving_object in moving]
    assert kinds == ["VEHICLE"] * len(vehicles) + list(walkers.values())
    vehicle_type = osi.MovingObjectVehicleClassificationType
    assert [vehicle_type(vehicle.vehicle_classification.type).name for vehicle in moving[: len(vehicles)]] == list(
        vehicles.values()
    )
    standing = [
        osi.StationaryObjectClassificationType(stationary.classification.type).name
        for stationary in truth.stationary_object
    ]
    assert standing == list(structures.values())
    assert [osi_object.id.value for osi_object in (*moving, *truth.stationary_object)] == list(range(1, len(boxes) + 1))
    for box, moving_object in zip(boxes, moving, strict=False):
        get = lambda *path, base=moving_object.base: float(value_at(base, path))  # noqa: E731
        assert [get("velocity", axis) for axis in "xyz"] == box.velocity_m_s.tolist()
        turned = [get("orientation", name) for name in ("yaw", "pitch", "roll")]
        np.testing.assert_allclose(Rotation.from_euler("ZYX", turned).as_matrix(), box.pose.rotation, atol=1e-12)


KITTI_TYPES = {"Car", "Van", "Truck", "Pedestrian", "Cyclist", "Tram", "Misc"}
"""Of KITTI's devkit that are counted; "Person_sitting" and "DontCare" are of its pictures."""

SEMANTIC_ROWS = """
    0 unlabelled; 10 car; 11 bicycle; 13 bus; 15 motorcycle; 16 tram; 18 truck; 20 van trailer
    30 pedestrian child wheelchair_user person; 31 cyclist; 32 motorcyclist
    40 road; 44 parking; 48 sidewalk pavement; 49 ground kerb; 50 building; 51 fence; 52 wall barrier; 60 lane_marking
    70 vegetation; 72 terrain; 80 pole traffic_light; 81 sign traffic_sign; 99 animal pram traffic_cone bin
"""
"""SemanticKITTI's numbers (semantic-kitti-api, config/semantic-kitti.yaml): 13 bus, 16 on rails, 20 other vehicle, 48
sidewalk, 49 other ground, 52 other structure, 60 lane marking, 72 terrain, 80 pole, 81 traffic sign, 99 other object.
"""

MOVING_ROWS = "252 car; 253 cyclist; 254 pedestrian; 255 motorcyclist; 256 tram; 257 bus; 258 truck; 259 van trailer"
"""The same file: 253 moving bicyclist, 254 person, 255 motorcyclist, 256 on rails, 257 bus, 258 truck, 259 other."""


SEMANTIC, MOVING = (
    {name: int(number) for name, number in of_classes(rows).items()} for rows in (SEMANTIC_ROWS, MOVING_ROWS)
)


def test_classes_of_kitti() -> None:
    assert {name: kind.semantic_kitti for name, kind in KINDS.items()} == SEMANTIC
    assert {kind.kitti for kind in KINDS.values() if kind.is_thing} == {*KITTI_TYPES, "DontCare"}
    assert {kind.kitti for kind in KINDS.values() if not kind.is_thing} == {"DontCare"}
    people = dict.fromkeys(("person", "pedestrian", "child", "wheelchair_user"), "Pedestrian")
    expected = people | {name: name.capitalize() for name in ("car", "van", "truck", "tram", "cyclist")}
    assert {name: kind.kitti for name, kind in KINDS.items() if kind.kitti not in ("Misc", "DontCare")} == expected
    assert {name: kinds.MOVING[SEMANTIC[name]] for name in MOVING} == MOVING
    assert set(kinds.MOVING) == {SEMANTIC[name] for name in MOVING}


def label_of(box: Box) -> list[str]:
    from lidarscene.labels.files import _kitti_line

    return _kitti_line(box).split(" ")


def test_a_line_of_kitti_by_hand() -> None:
    """A car ahead and to the left that looks to the left: the devkit's rotation_y is 0 along the camera's x (right) and
    grows towards -z, and alpha is the same seen from the camera. Its place is the middle of its bottom.
    """
    pose = street.pose_at(20.0, 5.0, -1.0, 90.0)
    box = Box(body=0, name="", class_name="car", size_m=np.array(CAR), pose=pose, beams=10, reached=9)
    kind, truncated, occluded, alpha, *numbers = label_of(box)
    assert (kind, truncated, occluded) == ("Car", "0.00", "0")
    height, width, length, x, y, z, rotation_y = map(float, numbers[4:])
    assert (height, width, length) == (1.5, 2.0, 4.0)
    assert (x, y, z) == pytest.approx((-5.0, 1.75, 20.0), abs=1e-4)
    # To the left is -x: a heading (cos, -sin) of (-1, 0) in (x, z).
    assert (math.cos(rotation_y), -math.sin(rotation_y)) == pytest.approx((-1.0, 0.0), abs=1e-4)
    bearing = rotation_y - math.atan2(x, z)
    assert math.remainder(float(alpha) - bearing, 2.0 * math.pi) == pytest.approx(0.0, abs=2e-4)
    assert -math.pi <= float(alpha) <= math.pi


@pytest.mark.parametrize(
    ("reached", "level", "token"),
    [
        (85, "0", "4"),
        (80, "0", "4"),
        (79, "1", "3"),
        (60, "1", "3"),
        (59, "1", "2"),
        (40, "1", "2"),
        (39, "2", "1"),
        (0, "2", "1"),
    ],
)
def test_levels_of_visibility(reached: int, level: str, token: str) -> None:
    """nuScenes' bins end at 40, 60 and 80 %; of KITTI's levels 0 is fully visible, 1 partly, 2 largely occluded."""
    from lidarscene.labels.files import nuscenes_annotation

    pose = street.pose_at(20.0, 0.0, 0.0, 0.0)
    box = Box(body=0, name="", class_name="car", size_m=np.array(CAR), pose=pose, beams=100, reached=reached)
    assert label_of(box)[2] == level
    assert label_of(replace(box, beams=0, reached=0))[2] == "3"  # unknown
    content = nuscenes_annotation(replace(box, points_inside=12, points_on=7))
    assert (content["visibility_token"], content["visibility"]) == (token, reached / 100)
    assert (content["num_lidar_pts"], content["num_body_pts"], content["size"]) == (12, 7, [2.0, 4.0, 1.5])


OUT = (621 - 720 * 9.5 / 9.5, 621 - 720 * 7.5 / 10.5)
"""Left and right edge of a block whose corners are 9.5 m to the left at 9.5 m, and 7.5 m at 10.5 m."""


@pytest.mark.parametrize(
    ("place", "size_m", "expected", "truncated"),
    [
        (
            (10.0, 8.5),
            (1.0, 2.0, 2.0),
            (0.0, 187.5 - 720 / 9.5, OUT[1], 187.5 + 720 / 9.5),
            -OUT[0] / (OUT[1] - OUT[0]),
        ),
        # What is nearer than 0.1 m is drawn at that depth: 7200 and 5400 pixels off. The last pixels are 1241, 374.
        ((1.0, 0.0), CAR, (0.0, 0.0, 1241.0, 374.0), 1.0 - 1241 * 374 / (14_400 * 10_800)),
        ((10.0, -7.5), CAR, (621 + 720 * 6.5 / 12.0, 187.5 - 720 * 0.75 / 8.0, 1241.0, 187.5 + 720 * 0.75 / 8.0), None),
        # The near face is 28 m off and 2 m wide, 1.5 m high.
        ((30.0, 0.0), CAR, (621 - 720 / 28, 187.5 - 540 / 28, 621 + 720 / 28, 187.5 + 540 / 28), 0.0),
        ((-20.0, 0.0), CAR, (0.0, 0.0, 0.0, 0.0), 1.0),
        ((2.0, -30.0), CAR, (0.0, 0.0, 0.0, 0.0), 1.0),
    ],
)
def test_rectangles_of_boxes(place, size_m, expected, truncated):
    """The picture ends 621 pixels to the left, with 720 pixels for each metre at 1 m; behind it nothing is seen."""
    from lidarscene.labels.files import _picture_box

    pose = street.pose_at(*place, 0.0, 0.0)
    rectangle, share = _picture_box(Box(body=0, name="", class_name="car", size_m=np.array(size_m), pose=pose))
    assert rectangle == pytest.approx(expected, abs=1e-9)
    assert truncated is None or share == pytest.approx(truncated, abs=1e-9)


@pytest.mark.parametrize(("body", "instance"), [(0, 1), (65_534, 65_535), (65_535, 1), (65_536, 2)])
def test_instances_fill_16_bits(body: int, instance: int) -> None:
    """None of 65,536 bodies has 0, which is no instance."""
    cloud = street.cloud(step_deg=8.0)
    labelled = replace(cloud, body_names=(), body=np.full(len(cloud), body), class_id=np.full(len(cloud), 1))
    label = semantic_kitti(labelled, Scene(bodies=()))
    assert set((label >> 16).tolist()) == {instance}
    assert set((label & 0xFFFF).tolist()) == {10}


# --- data sets --------------------------------------------------------------------------------------


@pytest.fixture
def object_dataset(tmp_path: Path, street_cloud: PointCloud) -> Path:
    for frame in range(2):
        write_frame("kitti", tmp_path, frame, street_cloud, street.scene())
    return tmp_path


def test_open3d_ml_opens_a_kitti_dataset(object_dataset, library, open3d, street_cloud):
    """Reference: the KITTI loader of Open3D-ML, as it is. Its boxes are ours, in the sensor's frame.

    Tolerance: four decimals in the label file, and float32 of its calibration.
    """
    kitti = library("open3d._ml3d.datasets.kitti")
    split = kitti.KITTI(str(object_dataset), cache_dir=str(object_dataset / "cache")).get_split("training")
    assert len(split) == 2
    data = split.get_data(1)
    in_sensor_frame = street_cloud.in_sensor_frame()
    np.testing.assert_array_equal(data["full_point"][:, :3], in_sensor_frame.xyz_m)
    in_picture = is_in_picture(in_sensor_frame.xyz_m)
    assert len(data["point"]) == pytest.approx(np.count_nonzero(in_picture), abs=2)
    boxes_seen = [b.seen_from(street.SENSOR) for b in boxes(street_cloud, street.scene())]
    assert [b.label_class for b in data["bounding_boxes"]] == ["Car", "Car"]
    for theirs, ours in zip(data["bounding_boxes"], boxes_seen[:2], strict=True):
        (length, width, height), yaw = upright_size_and_yaw(ours)
        np.testing.assert_allclose(theirs.center, ours.pose.position_m, atol=2e-4)
        np.testing.assert_allclose(theirs.size, [width, height, length], atol=1e-4)
        np.testing.assert_allclose(theirs.front, [math.cos(yaw), math.sin(yaw), 0.0], atol=1e-4)
    assert [b.occlusion for b in data["bounding_boxes"]][:2] == [0, 1]


def is_in_picture(xyz_m: np.ndarray) -> np.ndarray:
    """Whether points lie in the picture: x right is -y, y down is -z, z forward is x."""
    x, y, z = xyz_m.astype(float).T
    u, v = CAMERA[0, 2] - CAMERA[0, 0] * y / x, CAMERA[1, 2] - CAMERA[1, 1] * z / x
    return (x > 0) & (u >= 0) & (u < PICTURE_PX[0]) & (v >= 0) & (v < PICTURE_PX[1])


def test_a_frame_without_boxes_has_a_line_for_loaders_of_kitti(tmp_path: Path, street_cloud: PointCloud) -> None:
    """Reference: how OpenPCDet reads a label file (pcdet/utils/object3d_kitti.py, `KittiDataset.get_infos`). It joins
    the rectangles of all lines, which fails without any, and takes objects to be the lines before those of DontCare.
    """
    scene = street.scene()
    scene = replace(scene, bodies=tuple(replace(body, class_name="building") for body in scene.bodies))
    write_frame("kitti", tmp_path, 0, street_cloud, scene)
    lines = (tmp_path / "training/label_2/000000.txt").read_text().splitlines()
    (fields,) = (line.strip().split(" ") for line in lines)
    assert fields[0] == "DontCare"
    numbers = [float(number) for number in fields[1:]]
    # The values of KITTI's own files, but for the rectangle.
    assert numbers == [-1, -1, -10, 0, 0, 0, 0, -1, -1, -1, -1000, -1000, -1000, -10]


def test_kitti_rectangles_hold_the_points(object_dataset: Path, street_cloud: PointCloud) -> None:
    """Every point of a body projects into its rectangle. Those of the far car, which is all in view, nearly fill
    its width. Tolerance: a pixel.
    """
    in_sensor_frame = street_cloud.in_sensor_frame()
    lines = (object_dataset / "training/label_2/000000.txt").read_text().splitlines()
    for body, line in enumerate(lines, start=1):
        left, top, right, low = map(float, line.split()[4:8])
        x, y, z = in_sensor_frame.xyz_m[in_sensor_frame.body == body].astype(float).T
        u, v = CAMERA[0, 2] - CAMERA[0, 0] * y / x, CAMERA[1, 2] - CAMERA[1, 1] * z / x
        inside = (u >= 0) & (u < PICTURE_PX[0]) & (v >= 0) & (v < PICTURE_PX[1])
        assert left - 1 <= u[inside].min() <= u[inside].max() <= right + 1
        assert top - 1 <= v[inside].min() <= v[inside].max() <= low + 1
        assert body != 2 or np.ptp(u[inside]) > 0.9 * (right - left)


@pytest.mark.parametrize(("all_around", "kinds"), [(False, ["Car"]), (True, ["Car", "Car"])])
def test_kitti_labels_what_its_camera_shows(tmp_path: Path, all_around: bool, kinds: list[str]) -> None:
    """A car ahead and one behind the sensor; a pole ahead is no object of KITTI's."""
    blocks = [
        street.block(name, class_name, CAR, street.pose_at(x, -3.0, 0.75, 0.0))
        for name, class_name, x in (("ahead", "car", 12.0), ("behind", "car", -12.0), ("post", "pole", 25.0))
    ]
    scene = replace(street.scene(), bodies=(street.scene().bodies[0], *blocks))
    turned = Pose(position_m=street.SENSOR.position_m, rotation=street.SENSOR.rotation @ np.diag([-1.0, -1.0, 1.0]))
    cloud = PointCloud.concatenate([street.cloud(described=scene, sensor=sensor) for sensor in (street.SENSOR, turned)])
    assert all(box.has_points for box in boxes(cloud, scene))
    path, _ = write_labels(cloud, scene, tmp_path / "a.bin", format="kitti", all_around=all_around)
    assert [line.split()[0] for line in path.read_text().splitlines()] == kinds


@pytest.fixture
def sequence(tmp_path: Path, street_cloud: PointCloud) -> Path:
    for frame in range(3):
        metadata = {**street_cloud.metadata, "frame_start_s": repr(0.1 * frame)}
        cloud = replace(street_cloud, metadata=metadata)
        write_frame("semantickitti", tmp_path, frame, cloud, street.scene())
    return tmp_path


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_open3d_ml_opens_a_semantic_kitti_sequence(sequence, library, open3d, street_cloud):
    """Reference: the SemanticKITTI loader of Open3D-ML, as it is; it leaves a file of its own open."""
    module = library("open3d._ml3d.datasets.semantickitti")
    dataset = module.SemanticKITTI(
        str(sequence), cache_dir=str(sequence / "cache"), training_split=["00"], validation_split=[], test_split=[]
    )
    split = dataset.get_split("training")
    assert len(split) == 3
    data = split.get_data(2)
    np.testing.assert_array_equal(data["point"], street_cloud.in_sensor_frame().xyz_m)
    names = dataset.get_label_to_names()
    labels_by_class = {
        name: {names[label] for label in data["label"][street_cloud.class_id == i].tolist()}
        for i, name in enumerate(street_cloud.class_names)
    }
    assert labels_by_class == {
        "road": {"road"},
        "car": {"car"},
        "barrier": {"unlabeled"},
    }  # it leaves other structures out


def test_pykitti_opens_a_sequence(sequence: Path, library: Any, street_cloud: PointCloud) -> None:
    """Reference: pykitti's odometry loader, as it is. Its pose and calibration take points into the world.

    Tolerance: float32 of 40 m.
    """
    data = library("pykitti").odometry(str(sequence / "dataset"), "00")
    assert [t.total_seconds() for t in data.timestamps] == [0.0, 0.1, 0.2]
    points = data.get_velo(1)
    np.testing.assert_array_equal(points[:, :3], street_cloud.in_sensor_frame().xyz_m)
    homogeneous = np.column_stack([points[:, :3], np.ones(len(points))])
    camera_world = (data.poses[1] @ data.calib.T_cam0_velo @ homogeneous.T).T[:, :3]
    x_right, y_down, z_forward = camera_world.T
    np.testing.assert_allclose(np.stack([z_forward, -x_right, -y_down], 1), street_cloud.xyz_m, atol=2e-5)


def test_frames_of_a_sequence_are_written_in_order(sequence: Path, street_cloud: PointCloud) -> None:
    """And a run that starts again does not leave lines of the old one."""
    later = replace(street_cloud, metadata={**street_cloud.metadata, "frame_start_s": "7.0"})
    with told("times.txt | 5 lines | 3"):
        write_frame("semantickitti", sequence, 5, later, street.scene())
    write_frame("semantickitti", sequence, 0, later, street.scene())
    assert (sequence / "dataset/sequences/00/times.txt").read_text() == "7.000000000e+00\n"


# --- what moves -------------------------------------------------------------------------------------


def render_driving(*, motion_in: str) -> tuple[PointCloud, Scene]:
    """A car that crosses at 10 m/s while the sensor drives at 20 m/s, seen pulse by pulse over 0.1 s.

    By hand: each beam is traced in the scene as it stands when its pulse leaves.
    """
    ego = Course(start=street.SENSOR, speed_m_s=20.0)
    crossing = Course(start=street.pose_at(25.0, -2.0, 0.75, 100.0), speed_m_s=10.0)
    standing = street.block("parked", "car", CAR, street.pose_at(30.0, 12.0, 0.75, 20.0))
    car = replace(street.block("crossing", "car", CAR, Pose()), motion=crossing)
    described = Scene(bodies=(car, standing), ego=ego)
    parts = []
    for time_s in np.arange(0.0, 0.1, 0.01):
        scene_at_time = Scene(
            bodies=tuple(
                replace(b, motion=None, pose=b.pose if b.motion is None else pose_at(b.motion, time_s))
                for b in described.bodies
            )
        )
        sensor = pose_at(ego, time_s)
        snapshot = street.cloud("sensor", described=scene_at_time, sensor=sensor, step_deg=0.7)
        own_m = snapshot.xyz_m.astype(float)
        world_m = (street.SENSOR if motion_in == "in the points" else sensor).apply(own_m)
        parts.append(replace(snapshot, xyz_m=world_m.astype(np.float32), time_s=np.full(len(snapshot), time_s)))
    metadata = street.cloud("world", described=described).metadata | {"ego_motion": motion_in}
    return replace(PointCloud.concatenate(parts), metadata=metadata), described


@pytest.mark.parametrize("motion_in", ["in the points", "removed"])
def test_boxes_are_where_the_cloud_shows_what_moves(motion_in: str) -> None:
    """Rationale: a box is to hold the points of its body, whoever moved. Over 0.1 s the car and the sensor go 1 m
    and 2 m: half of that on either side of the mean time is what points may lie outside.
    """
    cloud, scene = render_driving(motion_in=motion_in)
    frame_boxes = cloud.boxes(scene)
    for box in frame_boxes:
        body_points_m = cloud.xyz_m[cloud.body == box.body].astype(float)
        outside = np.abs(box.pose.inverse_apply(body_points_m)) - 0.5 * box.size_m
        moves = box.name == "crossing" or motion_in == "in the points"
        reach = (0.5 * (box.name == "crossing") + 1.0 * (motion_in == "in the points")) if moves else 1e-3
        assert outside.max() <= reach
        # The mean of the way on either side is as long: the box is in the middle.
        along = outside.max(axis=1)
        assert np.median(along) <= 0.5 * reach + 1e-3
        assert box.visibility == 1.0  # nothing is before either, wherever a pulse left
    assert frame_boxes[0].points_on > 100
    np.testing.assert_allclose(np.linalg.norm(frame_boxes[0].velocity_m_s), 10.0, rtol=1e-9)
    np.testing.assert_array_equal(frame_boxes[1].velocity_m_s, 0.0)


@pytest.mark.parametrize("format", LABELS)
@pytest.mark.parametrize("moves", [True, False])
def test_labels_do_not_show_how_the_frame_was_cut(tmp_path, monkeypatch, format, moves):
    """Pieces that end within blocks, against one piece and one block."""
    cloud, scene = render_driving(motion_in="in the points") if moves else (street.cloud(), street.scene())
    write_labels(cloud, scene, tmp_path / "whole.ply", format=format)
    monkeypatch.setattr(labels_boxes, "PIECE_POINTS", 700)
    monkeypatch.setattr(spool, "BLOCK_ROWS", 300)
    with labels_stream(tmp_path / "pieces.ply", scene, format=format) as append:
        for first in range(0, len(cloud), 1000):
            append(cloud.select(slice(first, first + 1000)))
    for complete, pieces in zip(
        *(label_paths(tmp_path / name, format=format) for name in ("whole.ply", "pieces.ply")), strict=True
    ):
        assert complete.read_bytes() == pieces.read_bytes()


@pytest.mark.parametrize("in_memory", [0, 700, labels_boxes.PIECE_POINTS])
def test_points_that_waited_are_counted_where_they_are(tmp_path, monkeypatch, in_memory):
    """Reference: the same boxes and half-spaces point by point, of a frame whose points wait since a car moves: all on
    disk, some, or none.

    Every other point comes a metre too far to the left and up: no axis may stand for another. Some are echoes of
    nothing known, 1 m ahead.
    """
    monkeypatch.setattr(labels_boxes, "WAITING_POINTS", in_memory)
    monkeypatch.setattr(labels_boxes, "PIECE_POINTS", 600)
    cloud, scene = render_driving(motion_in="removed")
    moved_m = cloud.xyz_m + np.where(np.arange(len(cloud))[:, None] % 2, np.float32([0.0, 1.0, 0.4]), 0)
    # A point that is no echo says nothing of what stopped a beam.
    noise, stopped = (np.arange(len(cloud)) % every == 0 for every in (5, 49))
    assert cloud.true_range_m is not None
    cloud = replace(
        cloud,
        xyz_m=moved_m.astype(np.float32),
        status=noise.astype(np.uint8),
        true_range_m=np.where(noise | stopped, np.float32(1.0), cloud.true_range_m),
        body=np.where(stopped, -1, cloud.body),
    )
    (path,) = write_labels(cloud, scene, tmp_path / "a.bin", format="nuscenes")
    content = json.loads(path.read_text())
    assert content["num_lidar_pts"] == len(cloud)
    by_name = {annotation["instance_name"]: annotation for annotation in content["sample_annotations"]}
    assert sorted(by_name) == ["crossing", "parked"]
    for box in boxes(cloud, scene):
        annotation = by_name[box.name]
        local = np.abs((cloud.xyz_m - box.pose.position_m) @ box.pose.rotation)
        least, most = (np.all(local <= 0.5 * box.size_m + d, axis=1).sum() for d in (-1e-4, 1e-4))
        assert least <= annotation["num_lidar_pts"] <= most < annotation["num_body_pts"]
        assert annotation["num_body_pts"] == np.count_nonzero((cloud.body == box.body) & ~noise)
        assert 0 < box.reached < box.beams
        assert annotation["velocity"] == box.velocity_m_s.tolist()
        assert annotation["visibility"] == pytest.approx(box.visibility, abs=1e-4)


def test_the_vehicle_is_asked_as_often_whatever_there_is_to_label() -> None:
    """Rationale: on springs one place of the vehicle costs as much as a hundred, and a street has a hundred bodies."""
    asked = []

    class Counting(Course):
        def at(self, time_s: np.ndarray) -> Any:
            asked.append(len(np.atleast_1d(time_s)))
            return super().at(time_s)

    cloud, scene = render_driving(motion_in="in the points")
    bodies = [
        *scene.bodies,
        *(street.block(f"b{i}", "car", CAR, street.pose_at(30.0 + 5 * i, 12.0, 0.75, 0.0)) for i in range(20)),
    ]
    asked.clear()
    ego = Counting(start=street.SENSOR, speed_m_s=20.0)
    assert len(boxes(cloud, replace(scene, ego=ego, bodies=tuple(bodies)))) == 22
    assert asked == [22, 22]


def test_a_rig_whose_sensors_see_the_same_has_the_same_boxes() -> None:
    """Two sensors in one place, of which one counts its times from 30 ms later on: the same moments, the same boxes."""
    cloud, scene = render_driving(motion_in="removed")
    later_cloud = replace(cloud, time_s=cloud.time_s - 0.03, metadata=cloud.metadata | {"frame_start_s": "0.03"})
    merged = merge_clouds([replace(cloud, metadata=cloud.metadata | {"frame_start_s": "0.0"}), later_cloud], ["a", "b"])
    for single, two in zip(boxes(cloud, scene), boxes(merged, scene), strict=True):
        np.testing.assert_allclose(two.pose.position_m, single.pose.position_m, atol=1e-9)
        assert two.points_on == 2 * single.points_on


@pytest.mark.parametrize("sensors", [1, 2])
def test_boxes_of_a_later_frame_are_as_much_farther_on(sensors: int) -> None:
    """0.2 s later everything that drives straight on is 0.2 s of its way farther, seen by one sensor or by two."""
    cloud, scene = render_driving(motion_in="removed")
    boxes_of_frames = []
    for start_s in ("0.0", "0.2"):
        frame = replace(cloud, metadata=cloud.metadata | {"frame_start_s": start_s})
        boxes_of_frames.append(boxes(frame if sensors == 1 else merge_clouds([frame, frame], ["a", "b"]), scene))
    for early_box, late_box in zip(*boxes_of_frames, strict=True):
        way_m = late_box.pose.position_m - early_box.pose.position_m
        np.testing.assert_allclose(way_m, 0.2 * early_box.velocity_m_s, atol=1e-9)
    assert np.linalg.norm(boxes_of_frames[0][0].velocity_m_s) == pytest.approx(10.0)


def test_visibility_of_a_rig() -> None:
    """Two sensors in one cloud: beams of each start where it stands."""
    second_sensor = street.pose_at(40.0, 20.0, 1.8, 200.0)
    clouds = [street.cloud("world"), street.cloud("world", sensor=second_sensor)]
    merged = merge_clouds(clouds, ["one", "two"])
    together = boxes(merged, street.scene())
    boxes_of_sensors = [boxes(cloud, street.scene()) for cloud in clouds]
    for box, first, two in zip(together, *boxes_of_sensors, strict=True):
        assert box.beams == first.beams + two.beams
        assert box.points_inside == first.points_inside + two.points_inside
        reached = first.visibility * first.beams + two.visibility * two.beams
        assert box.visibility * box.beams == pytest.approx(reached)
    with told("several sensors"):
        merged.in_sensor_frame()


def test_what_stands_is_not_labelled_as_moving(tmp_path: Path) -> None:
    """A course without speed is none; one that turns on the spot is one. nuScenes also knows who has stopped."""
    cloud, scene = render_driving(motion_in="removed")
    semantic, _ = point_labels(cloud, scene)
    assert (set(semantic[cloud.body == 0].tolist()), set(semantic[cloud.body == 1].tolist())) == ({252}, {10})
    start = scene.bodies[0].pose
    for course, number, state in (
        (Course(start=start), 10, "parked"),
        (Course(start=start, yaw_rate_rad_s=0.1), 252, "stopped"),
        (Course(start=start, velocity_m_s=(0, 0, 1)), 252, "moving"),
    ):
        stands = replace(scene, bodies=(replace(scene.bodies[0], motion=course), *scene.bodies[1:]))
        semantic, _ = point_labels(cloud, stands)
        assert set(semantic[cloud.body == 0].tolist()) == {number}
        record: dict[str, Any] = {}
        sample = Sample(scene=0, split="train", step=0, channel="LIDAR_TOP", number=0)
        with sample_stream(tmp_path, sample, stands, record) as append:
            append(cloud)
        assert record["boxes"][0]["attribute"] == f"vehicle.{state}"


@pytest.mark.parametrize(("short_m", "reached"), [(-0.02, 1), (0.0, 1), (0.049, 1), (0.051, 0), (3.0, 0)])
def test_a_beam_may_end_a_little_before_the_box_that_it_meets(short_m: float, reached: int) -> None:
    """The beam may end 5 cm before it, the error of a range. The block's near face is 8 m ahead; the beam has an echo
    there or before.
    """
    scene = Scene(bodies=(street.block("block", "car", CAR, street.pose_at(10.0, 0.0, 0.0, 0.0)),))
    cloud = street.cloud("sensor", described=scene, sensor=Pose(), step_deg=6.0)
    straight_ahead = np.flatnonzero((np.abs(cloud.azimuth_rad) < 1e-6) & (np.abs(cloud.elevation_rad) < 1e-6))
    assert len(straight_ahead) == 1
    single_beam = cloud.select(straight_ahead)
    assert single_beam.true_range_m is not None
    assert single_beam.true_range_m[0] == pytest.approx(8.0)
    true_range_m = single_beam.true_range_m - np.float32(short_m)
    single_beam = replace(single_beam, true_range_m=true_range_m, body=np.full(1, -1))
    (box,) = boxes(single_beam, scene)
    assert (box.beams, box.reached) == (1, reached)
    (box,) = boxes(replace(single_beam, status=np.ones(1)), scene)  # what is no echo says nothing of a surface
    assert (box.beams, box.reached) == (0, 0)


def test_a_box_off_the_origin_of_what_moves() -> None:
    """Where the body's own frame is then, its box is as far from it as ever; what is away has none."""
    part = street.block("b", "car", (2.0, 2.0, 2.0), Pose()).parts[0]
    part = replace(part, vertices_m=part.vertices_m + np.array([10.0, 0.0, 1.0]))
    course = Course(start=street.pose_at(5.0, 6.0, 0.0, 90.0), speed_m_s=10.0)
    body = Body(name="b", class_name="car", parts=(part,), pose=street.pose_at(1.0, 2.0, 3.0, 20.0), motion=course)
    cloud = street.cloud(step_deg=8.0)
    cloud = replace(cloud, body=np.full(len(cloud), -1), metadata=cloud.metadata | {"frame_start_s": "0.5"})
    (box,) = boxes(cloud, Scene(bodies=(body,)))
    # Half a second at 10 m/s to the left, then ten metres more along the body's own x, which is to the left.
    np.testing.assert_allclose(box.pose.position_m, [5.0, 6.0 + 5.0 + 10.0, 1.0], atol=1e-9)
    assert boxes(cloud, Scene(bodies=(replace(body, away=True),))) == []
    assert boxes(cloud, Scene(bodies=(replace(body, present_s=(0.0, 0.4)),))) == []
    assert len(boxes(cloud, Scene(bodies=(replace(body, present_s=(0.0, 0.5)),)))) == 1


def test_another_sequence_and_times_to_a_nanosecond(tmp_path: Path, street_cloud: PointCloud) -> None:
    cloud = replace(street_cloud, metadata=street_cloud.metadata | {"frame_start_s": "1.234567891"})
    write_frame("semantickitti", tmp_path, 0, cloud, street.scene(), sequence="07")
    folder = tmp_path / "dataset/sequences/07"
    assert float((folder / "times.txt").read_text()) == 1.234567891
    assert sorted(path.name for path in folder.iterdir()) == [
        "calib.txt",
        "labels",
        "poses.txt",
        "times.txt",
        "velodyne",
    ]
    assert (tmp_path / "dataset/poses/07.txt").read_text() == (folder / "poses.txt").read_text()


def test_beams_of_a_rig_that_waited_are_those_of_each_sensor(tmp_path: Path) -> None:
    """The second sensor's beams all end before the cars, of which something moves: half of all reach them."""
    cloud, scene = render_driving(motion_in="removed")
    assert cloud.true_range_m is not None
    far = replace(cloud, true_range_m=np.full(len(cloud), 1e3))
    near = replace(cloud, true_range_m=np.ones(len(cloud)), body=np.full(len(cloud), -1))
    start = {"frame_start_s": "0.0"}
    merged = merge_clouds([replace(cloud, metadata=cloud.metadata | start) for cloud in (far, near)], ["far", "near"])
    (path,) = write_labels(merged, scene, tmp_path / "a.bin", format="nuscenes")
    for annotation in json.loads(path.read_text())["sample_annotations"]:
        assert annotation["visibility"] == 0.5


def test_a_box_is_at_the_mean_time_to_a_microsecond() -> None:
    """Points 0.4 ms and 0.9 ms after the start, in equal numbers, of a car at 10 m/s: 6.5 mm of way."""
    cloud, scene = render_driving(motion_in="removed")
    body_points = cloud.select(np.flatnonzero(cloud.body == 0)[:100])
    body_points = replace(body_points, time_s=np.resize([4e-4, 9e-4], 100))
    box = next(frame_box for frame_box in boxes(body_points, scene) if frame_box.name == "crossing")
    motion = scene.bodies[0].motion
    assert motion is not None
    way_m = np.linalg.norm(box.pose.position_m - pose_at(motion, 0.0).position_m)
    assert way_m == pytest.approx(6.5e-3, abs=1e-9)


def test_osi_files_have_the_start_of_the_frame(tmp_path: Path, library: Any) -> None:
    cloud, scene = render_driving(motion_in="removed")
    (path,) = write_labels(cloud, scene, tmp_path / "a.osi", format="osi")
    (truth,) = osi_messages(path, "GroundTruth", library)
    place = truth.moving_object[0].base.position
    assert (place.x, place.y, place.z) == pytest.approx((25.0, -2.0, 0.75), abs=1e-12)
    standing = boxes(cloud, scene, as_seen=False)[1]
    np.testing.assert_allclose(standing.pose.position_m, [30.0, 12.0, 0.75], atol=1e-12)


@pytest.mark.parametrize(
    ("before", "frame", "after"),
    [
        ("", 0, "n\n"),
        ("0\n1\n", 0, "n\n"),
        ("0\n1\n", 2, "0\n1\nn\n"),
        ("0\n1\n2\n3\n", 2, "0\n1\nn\n"),  # a run that begins again in the middle
        ("0\n1", 2, "0\n1\nn\n"),  # saved by an editor
        ("0\n1\n2.", 2, "0\n1\nn\n"),  # torn by a kill
        ("0\n", 2, None),
    ],
)
def test_a_line_of_a_sequence_is_put_in_its_place(tmp_path: Path, before: str, frame: int, after: str | None) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(before)
    with nullcontext() if after else pytest.raises(InputError, match="must have 2 lines before this frame, got 1"):
        _write_line(path, frame, "n")
    assert path.read_text() == (after or before)


def test_a_line_without_room_leaves_the_file_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk takes 3 bytes of it, then no more."""

    class Full(io.FileIO):
        def write(self, data: Any) -> int:
            if len(data) < 9:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().write(data[:3]) or 0

    path = tmp_path / "poses.txt"
    path.write_text("0\n")
    monkeypatch.setattr(kitti_dataset, "open", lambda file, mode, buffering: Full(file, mode), raising=False)
    with pytest.raises(OutputError, match=r"poses.txt: cannot be written: No space left"):
        _write_line(path, 1, "long line")
    assert path.read_text() == "0\n"
