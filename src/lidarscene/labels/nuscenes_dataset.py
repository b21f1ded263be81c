"""Write data sets in the tables of nuScenes v1.0, as nuscenes-devkit reads them.

A frame has its cloud (`samples/LIDAR_TOP/000000.pcd.bin`), the class of each point (`lidarseg/`) and a record: where
vehicle and sensor were, and what there was to see. Frames may be written in any order and by any process;
`write_tables` makes the tables of all records. Axes are those of nuScenes' lidar: x to the right, y forward.

Places are moved so that the map of a drive, a picture of its roads, has its corner at the origin, as nuScenes' maps do.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..files.atomic import atomic_output, put_text
from ..formats.clock import EPOCH, default_epoch_ns, stamp_ns
from ..formats.kitti import kitti_stream
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.rotations import quaternion
from ..maths.trajectory import Course, Motion, clipped, pose_at
from ..scene.scene import Body, Part, Scene
from .boxes import Box, GatheredBoxes, sensor_place, truth_of
from .files import Append, nuscenes_annotation
from .kinds import kind_of

VERSION = "v1.0-trainval"
"""Folder of the tables. nuScenes keeps its test scenes in a folder of their own; here `splits.json` names them."""

CATEGORIES = (
    "noise",
    "animal",
    "human.pedestrian.adult",
    "human.pedestrian.child",
    "human.pedestrian.construction_worker",
    "human.pedestrian.personal_mobility",
    "human.pedestrian.police_officer",
    "human.pedestrian.stroller",
    "human.pedestrian.wheelchair",
    "movable_object.barrier",
    "movable_object.debris",
    "movable_object.pushable_pullable",
    "movable_object.trafficcone",
    "static_object.bicycle_rack",
    "vehicle.bicycle",
    "vehicle.bus.bendy",
    "vehicle.bus.rigid",
    "vehicle.car",
    "vehicle.construction",
    "vehicle.emergency.ambulance",
    "vehicle.emergency.police",
    "vehicle.motorcycle",
    "vehicle.trailer",
    "vehicle.truck",
    "flat.driveable_surface",
    "flat.other",
    "flat.sidewalk",
    "flat.terrain",
    "static.manmade",
    "static.other",
    "static.vegetation",
    "vehicle.ego",
)
"""Categories of nuScenes-lidarseg by their numbers. The devkit has colours for these and knows no others."""

NOISE, OTHER, EGO = (CATEGORIES.index(name) for name in ("noise", "static.other", "vehicle.ego"))

ATTRIBUTES = (
    "vehicle.moving",
    "vehicle.stopped",
    "vehicle.parked",
    "cycle.with_rider",
    "cycle.without_rider",
    "pedestrian.sitting_lying_down",
    "pedestrian.standing",
    "pedestrian.moving",
)

MOVING_M_S = 0.2
"""Choice: speed from which an object moves, against the millimetres a second of what stands on a real road."""

VISIBILITY = {"1": "v0-40", "2": "v40-60", "3": "v60-80", "4": "v80-100"}

TO_NUSCENES = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Source: nuScenes; vectors of our sensors (x forward, y left) in the axes of its lidar (x right, y forward)."""

MAP_MARGIN_M, MAP_PIXEL_M = 120.0, 0.1
"""Choice: width around a drive's path, and resolution of its map: what the devkit draws around the vehicle must be on
it."""

DRIVES_APART_S = 3600.0
"""Choice: time between the starts of two drives in the tables: the devkit cannot sort scenes that begin at one time."""

DRIVEABLE = frozenset({"road", "parking", "lane_marking"})
"""Classes that the map shows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One frame of one sensor in a data set.

    Attributes:
        scene: number of the drive, from 0
        split: name of its part: train, val or test
        step: number of the frame within the drive
        channel: name of the sensor, such as LIDAR_TOP
        number: number of the frame in the channel's folder
    """

    scene: int
    split: str
    step: int
    channel: str
    number: int

    @property
    def cloud(self) -> str:
        """Path of the cloud in the data set."""
        return f"samples/{self.channel}/{self.number:06d}.pcd.bin"

    @property
    def token(self) -> str:
        """Token of the frame's `sample_data`."""
        return _token("sample_data", self.scene, self.step, self.channel)

    @property
    def classes(self) -> str:
        """Path of the classes of its points."""
        return f"lidarseg/{VERSION}/{self.token}_lidarseg.bin"

    @property
    def map(self) -> str:
        """Path of the drive's map."""
        return f"maps/{_token('map', self.scene)}.png"


@contextmanager
def sample_stream(folder: Path, sample: Sample, scene: Scene, record: dict[str, Any]) -> Iterator[Append]:
    """Write the clouds that are appended in the block, at least one, as a frame.

    Args:
        record: filled when the block ends: what `write_tables` needs of the frame, as plain data

    Raises:
        InputError: for a cloud without truth, of which the labels are made
    """
    with ExitStack() as streams:
        cloud_file = streams.enter_context(kitti_stream(folder / sample.cloud, ("intensity", "ring"), TO_NUSCENES))
        temporary = streams.enter_context(atomic_output(folder / sample.classes))
        class_file = streams.enter_context(open(temporary, "wb"))
        gathered = streams.enter_context(GatheredBoxes(temporary.parent, scene))

        def append(cloud: PointCloud) -> None:
            gathered.append(cloud)
            cloud_file(cloud)
            class_file.write(point_categories(cloud, scene).data)

        yield append
        sensor_pose, start_s = sensor_place(gathered.first), gathered.first.frame_start_s
        entries = [_record_of(box, scene.bodies[box.body]) for box in gathered.boxes()]
        record |= {
            "start_s": start_s,
            "scene": scene.name,
            "sensor": gathered.first.metadata.get("sensor", ""),
            "ego_to_world": _rows(pose_at(scene.ego or Course(), start_s)),
            "sensor_to_world": _rows(sensor_pose),
            # nuScenes has no boxes of what cannot move, such as poles; their points have classes.
            "boxes": [entry for entry in entries if not entry["category_name"].startswith("static.")],
        }


def point_categories(cloud: PointCloud, scene: Scene) -> Numbers:
    """(n,) uint8 numbers of nuScenes-lidarseg; a point that is no echo is noise."""
    _, body_index = truth_of(cloud)
    numbers = np.array([*(_category(name) for name in cloud.class_names), OTHER], np.uint8)
    category = numbers[np.asarray(cloud.class_id)]
    category[np.isin(body_index, scene.own_bodies)] = EGO
    return np.where(cloud.status == 0, category, np.uint8(NOISE))


def _category(class_name: str) -> int:
    name = kind_of(class_name).nuscenes
    return CATEGORIES.index(name) if name in CATEGORIES else OTHER


def _record_of(box: Box, body: Body) -> dict[str, Any]:
    category = CATEGORIES[_category(box.class_name)]
    state = "moving" if np.linalg.norm(box.velocity_m_s) > MOVING_M_S else "stopped" if body.moves else "parked"
    attribute = _attribute(box.class_name.lower(), category, state)
    return nuscenes_annotation(box) | {"category_name": category, "attribute": attribute}


def _attribute(class_name: str, category: str, state: str) -> str:
    """Name of nuScenes' attribute; "" for a category that has none."""
    if class_name in ("cyclist", "motorcyclist"):
        return "cycle.with_rider"
    if category in ("vehicle.bicycle", "vehicle.motorcycle"):
        return "cycle.without_rider"
    if category.startswith("vehicle."):
        return f"vehicle.{state}"
    if category.startswith("human."):
        return "pedestrian.moving" if state == "moving" else "pedestrian.standing"
    return ""


# --- map --------------------------------------------------------------------------------------------


def map_area(path_m: Numbers) -> tuple[Numbers, tuple[int, int]]:
    """(2,) corner [m] and size (width, height) in pixels of the map around a path, (n, 3) places in the world."""
    low = np.floor(path_m[:, :2].min(axis=0)) - MAP_MARGIN_M
    high = np.ceil(path_m[:, :2].max(axis=0)) + MAP_MARGIN_M
    width, height = np.rint((high - low) / MAP_PIXEL_M).astype(int).tolist()
    return low, (width, height)


def write_map(path: Path, scene: Scene, corner_m: Numbers, size_px: tuple[int, int]) -> None:
    """Draw the roads from above: white where one can drive, north (the world's y) up."""
    from PIL import Image, ImageDraw

    picture = Image.new("1", size_px)
    draw = ImageDraw.Draw(picture)
    for body in scene.bodies:
        if body.class_name.lower() not in DRIVEABLE:
            continue
        for part in body.parts:
            if isinstance(part, Part) and len(part.vertices_m):
                x, y = ((body.pose.apply(part.vertices_m)[:, :2] - corner_m) / MAP_PIXEL_M).T
                corners = np.stack([x, size_px[1] - y], axis=-1)[part.faces]
                low, high = corners.min(axis=1), corners.max(axis=1)
                for triangle in corners[((high >= 0) & (low <= size_px)).all(axis=1)].reshape(-1, 6).tolist():
                    draw.polygon(triangle, fill=1)
    with atomic_output(path) as temporary:
        picture.convert("L").save(temporary, format="PNG")


def path_of_drive(motion: Motion, begin_s: float, end_s: float) -> Numbers:
    """(n, 3) places of a motion, some metres apart, within its span."""
    times_s = np.linspace(begin_s, end_s, 2 + int(10 * (end_s - begin_s)))
    return motion.at(clipped(times_s, motion)).position_m


# --- tables -----------------------------------------------------------------------------------------


def write_tables(folder: Path, frames: Iterable[tuple[Sample, Mapping[str, Any]]], *, vehicle: str = "ego") -> None:
    """Write all tables of a data set, and `splits.json`, the scenes of each part.

    Args:
        frames: frames and their records (`sample_stream`); those of one drive and channel in order of time. The first
            record of a drive has "map_corner_m" too, the corner of its map, which all sensors of the drive share
    """
    tables = _Tables()
    for sample, record in frames:
        tables.add(sample, record)
    tables.count_again(folder)
    root = folder / VERSION
    for name, rows in tables.tables(vehicle).items():
        _write_rows(root / f"{name}.json", rows)
    put_text(root / "splits.json", json.dumps(tables.splits, indent=1) + "\n")


def scene_name(scene: int) -> str:
    """Name of a drive as nuScenes has them, from scene-0001 on."""
    return f"scene-{scene + 1:04d}"


class _Tables:
    """Tables that grow frame by frame.

    Attributes:
        splits: part -> names of its scenes
    """

    def __init__(self) -> None:
        self.splits: dict[str, list[str]] = {}
        self._scenes: dict[int, dict[str, Any]] = {}
        self._maps: dict[int, str] = {}
        self._corners_m: dict[int, Numbers] = {}
        self._samples: dict[tuple[int, int], dict[str, Any]] = {}
        self._sensors: dict[str, dict[str, Any]] = {}
        self._calibrations: dict[str, dict[str, Any]] = {}
        self._data: list[dict[str, Any]] = []
        self._ego_poses: list[dict[str, Any]] = []
        self._last_data: dict[tuple[int, str], dict[str, Any]] = {}
        self._annotations: dict[tuple[int, int, int], dict[str, Any]] = {}
        self._moving: set[tuple[int, int, int]] = set()

    def add(self, sample: Sample, record: Mapping[str, Any]) -> None:
        """Add a frame."""
        if sample.scene not in self._corners_m:
            self._corners_m[sample.scene] = np.array([*record["map_corner_m"], 0.0])
        corner_m = self._corners_m[sample.scene]
        ego, sensor_pose = _pose(record["ego_to_world"]), _pose(record["sensor_to_world"])
        mounting = ego.inverse() @ sensor_pose
        time_s = record["start_s"] + sample.scene * DRIVES_APART_S
        timestamp = stamp_ns(time_s, default_epoch_ns(record["start_s"])) // 1000
        scene = self._scene(sample, record)
        key = (sample.scene, sample.step)
        row = self._samples.setdefault(
            key, {"token": _token("sample", *key), "timestamp": timestamp, "prev": "", "next": "", "scene_token": scene}
        )
        sensor_token = _token("sensor", sample.channel)
        self._sensors[sample.channel] = {"token": sensor_token, "channel": sample.channel, "modality": "lidar"}
        calibration = {
            "sensor_token": sensor_token,
            "translation": _rounded(mounting.position_m),
            "rotation": _quaternion(mounting.rotation @ TO_NUSCENES.T),
            "camera_intrinsic": [],
        }
        calibration_token = _token("calibrated_sensor", sample.scene, sample.channel)
        self._calibrations.setdefault(calibration_token, {"token": calibration_token, **calibration})
        data = {
            "token": sample.token,
            "sample_token": row["token"],
            "ego_pose_token": _token("ego_pose", sample.token),
            "calibrated_sensor_token": calibration_token,
            "timestamp": timestamp,
            "fileformat": "pcd",
            "is_key_frame": True,
            "height": 0,
            "width": 0,
            "filename": sample.cloud,
            "prev": "",
            "next": "",
        }
        # The sensor may swing on its mounting by the vehicle's springs only together with it: one calibration holds for
        # the drive, and the vehicle's pose is the one that puts the sensor where it was.
        fixed = _row_pose(self._calibrations[calibration_token]) @ Pose(rotation=TO_NUSCENES)
        vehicle = sensor_pose @ fixed.inverse()
        self._ego_poses.append(
            {
                "token": data["ego_pose_token"],
                "timestamp": timestamp,
                "rotation": _quaternion(vehicle.rotation),
                "translation": _rounded(vehicle.position_m - corner_m),
            }
        )
        _link(self._last_data.get((sample.scene, sample.channel)), data)
        self._last_data[sample.scene, sample.channel] = data
        self._data.append(data)
        for box in record["boxes"]:
            self._annotate(sample, row["token"], box, corner_m)

    def _scene(self, sample: Sample, record: Mapping[str, Any]) -> str:
        """Token of the frame's drive, which is added with its first frame."""
        token = _token("scene", sample.scene)
        if sample.scene not in self._scenes:
            self._scenes[sample.scene] = {
                "token": token,
                "name": scene_name(sample.scene),
                "description": record["scene"],
                "log_token": _token("log", sample.scene),
            }
            self._maps[sample.scene] = sample.map
            self.splits.setdefault(sample.split, []).append(scene_name(sample.scene))
        return token

    def _annotate(self, sample: Sample, sample_token: str, box: Mapping[str, Any], corner_m: Numbers) -> None:
        """Add a box, or the points of another sensor to that of the first which has it."""
        key = (sample.scene, box["body"], sample.step)
        if any(box["velocity"]):
            self._moving.add(key)
        if key in self._annotations:
            self._annotations[key]["num_lidar_pts"] += box["num_lidar_pts"]
            seen = max(self._annotations[key]["visibility_token"], box["visibility_token"])
            self._annotations[key]["visibility_token"] = seen
            return
        self._annotations[key] = {
            "token": _token("sample_annotation", *key),
            "sample_token": sample_token,
            "instance_token": _token("instance", *key[:2]),
            "visibility_token": box["visibility_token"],
            "attribute_tokens": [_token("attribute", box["attribute"])] if box["attribute"] else [],
            "translation": _rounded(np.array(box["translation"]) - corner_m),
            "size": _rounded(box["size"]),
            "rotation": _rounded(box["rotation"], 9),
            "prev": "",
            "next": "",
            "num_lidar_pts": box["num_lidar_pts"],
            "num_radar_pts": 0,
            "category_name": box["category_name"],
        }

    def count_again(self, folder: Path) -> None:
        """Count the points of all sensors in the one box of each body that moves: each sensor had its own time."""
        data_of: dict[str, list[dict[str, Any]]] = {}
        for data in self._data:
            data_of.setdefault(data["sample_token"], []).append(data)
        moving: dict[str, list[dict[str, Any]]] = {}
        for key in sorted(self._moving):
            annotation = self._annotations[key]
            moving.setdefault(annotation["sample_token"], []).append(annotation)
        chains = {row["token"]: row for row in (*self._ego_poses, *self._calibrations.values())}
        for sample_token, rows in moving.items():
            if len(data_of[sample_token]) == 1:
                continue
            clouds_m = [_points_in_world(folder, data, chains) for data in data_of[sample_token]]
            for annotation in rows:
                annotation["num_lidar_pts"] = sum(_points_inside(annotation, points_m) for points_m in clouds_m)

    def tables(self, vehicle: str) -> dict[str, Sequence[Mapping[str, Any]]]:
        """Rows of each table by its name."""
        instances = self._instances()
        samples_of: dict[int, list[dict[str, Any]]] = {}
        for key in sorted(self._samples):
            samples_of.setdefault(key[0], []).append(self._samples[key])
            _link(self._samples.get((key[0], key[1] - 1)), self._samples[key])
        for scene, row in self._scenes.items():
            samples = samples_of[scene]
            row |= {
                "nbr_samples": len(samples),
                "first_sample_token": samples[0]["token"],
                "last_sample_token": samples[-1]["token"],
            }
        logs = [
            {
                "token": row["log_token"],
                "logfile": row["name"],
                "vehicle": vehicle,
                "date_captured": f"{EPOCH:%Y-%m-%d}",
                "location": row["description"],
            }
            for row in self._scenes.values()
        ]
        maps = [
            {
                "token": _token("map", scene),
                "log_tokens": [self._scenes[scene]["log_token"]],
                "category": "semantic_prior",
                "filename": path,
            }
            for scene, path in self._maps.items()
        ]
        lidarseg = [
            {
                "token": data["token"],
                "sample_data_token": data["token"],
                "filename": f"lidarseg/{VERSION}/{data['token']}_lidarseg.bin",
            }
            for data in self._data
        ]
        return {
            "category": [
                {"token": _token("category", name), "name": name, "description": "", "index": index}
                for index, name in enumerate(CATEGORIES)
            ],
            "attribute": [{"token": _token("attribute", name), "name": name, "description": ""} for name in ATTRIBUTES],
            "visibility": [{"token": token, "level": level, "description": ""} for token, level in VISIBILITY.items()],
            "instance": instances,
            "sensor": list(self._sensors.values()),
            "calibrated_sensor": list(self._calibrations.values()),
            "ego_pose": self._ego_poses,
            "log": logs,
            "scene": list(self._scenes.values()),
            "sample": [self._samples[key] for key in sorted(self._samples)],
            "sample_data": self._data,
            "sample_annotation": list(self._annotations.values()),
            "map": maps,
            "lidarseg": lidarseg,
        }

    def _instances(self) -> list[dict[str, Any]]:
        """Rows of the instances; links the annotations of each in order of time."""
        rows: dict[str, dict[str, Any]] = {}
        last: dict[str, dict[str, Any]] = {}
        for key in sorted(self._annotations):
            annotation = self._annotations[key]
            token, category = annotation["instance_token"], annotation.pop("category_name")
            _link(last.get(token), annotation)
            last[token] = annotation
            row = rows.setdefault(
                token,
                {
                    "token": token,
                    "category_token": _token("category", category),
                    "nbr_annotations": 0,
                    "first_annotation_token": annotation["token"],
                },
            )
            row["nbr_annotations"] += 1
            row["last_annotation_token"] = annotation["token"]
        return list(rows.values())


def _points_in_world(folder: Path, data: Mapping[str, Any], chains: Mapping[str, Mapping[str, Any]]) -> Numbers:
    """(n, 3) points of a cloud in the frame of the tables: by its calibration, then by the vehicle's pose."""
    points_m = np.fromfile(folder / data["filename"], np.float32).reshape(-1, 5)[:, :3].astype(np.float64)
    for row in (chains[data["calibrated_sensor_token"]], chains[data["ego_pose_token"]]):
        points_m = _row_pose(row).apply(points_m)
    return points_m


def _points_inside(annotation: Mapping[str, Any], points_m: Numbers) -> int:
    width, length, height = annotation["size"]
    local = _row_pose(annotation).inverse_apply(points_m)
    return int((np.abs(local) <= 0.5 * np.array([length, width, height])).all(axis=1).sum())


def _row_pose(row: Mapping[str, Any]) -> Pose:
    return Pose(position_m=np.array(row["translation"]), rotation=_rotation(row["rotation"]))


def _link(earlier: dict[str, Any] | None, later: dict[str, Any]) -> None:
    """Chain two rows of a table."""
    if earlier is not None:
        earlier["next"], later["prev"] = later["token"], earlier["token"]


def _token(*of: object) -> str:
    """Token of an entry: the same in each run."""
    return hashlib.sha256("/".join(map(str, of)).encode()).hexdigest()[:32]


def _rows(pose: Pose) -> list[list[float]]:
    rows: list[list[float]] = np.column_stack([pose.rotation, pose.position_m]).tolist()
    return rows


def _pose(rows: Sequence[Sequence[float]]) -> Pose:
    matrix = np.array(rows)
    return Pose(position_m=matrix[:, 3], rotation=matrix[:, :3])


def _quaternion(rotation: Numbers) -> list[float]:
    return list(quaternion(rotation))


def _rotation(numbers: Sequence[float]) -> Numbers:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(numbers, scalar_first=True).as_matrix())


def _rounded(values: Any, digits: int = 6) -> list[float]:
    rounded: list[float] = np.round(np.asarray(values, np.float64), digits).tolist()
    return rounded


def _write_rows(path: str | os.PathLike[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a table as JSON, a row a line."""
    with atomic_output(Path(path)) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write("[\n")
        for number, row in enumerate(rows):
            file.write(json.dumps(row) + (",\n" if number + 1 < len(rows) else "\n"))
        file.write("]\n")
