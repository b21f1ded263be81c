"""What generated frames teach a detector of cars and people, judged on real frames that people labelled.

    python benchmarks/detection.py                         240 frames to learn from, 30 of other towns held out
    python benchmarks/detection.py --real FOLDER           judged on real frames, too
    python benchmarks/detection.py --frames 8              in small

The detector runs on a CPU: points above the ground within 30 m are clustered on a grid seen from above, and a random
forest names each cluster by its shape: car, person or other. It learns three times: from frames as an HDL-64E reports
them, from the same pulses without noise (true ranges, no false points), and from those with noise of which only the
cars and people of one size are left. Judged are whole objects of ten points and more: recall is the share of them that
a cluster of their class is on, precision the share of the clusters named so that are on an object of the class.

FOLDER has real frames, which are not shipped:

    kitti/{velodyne,label_2,calib}/NNNNNN.*   KITTI's 3D object benchmark, such as the three frames in the repository
                                              kuixu/kitti_object_vis; judged within the camera's picture
    av2/LOG/{annotations,TIMESTAMP}.feather   Argoverse 2's sensor data set, such as the three frames of two logs in the
                                              tests of argoverse/av2-api: two lidars of 32 beams, one above the other
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lidarscene import load_scene, load_sensor
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.labels.boxes import boxes
from lidarscene.maths.pose import Pose
from lidarscene.rendering.render_options import FrameOptions
from lidarscene.rendering.simulator import Simulator

Array = np.ndarray

OTHER, CAR, PERSON = range(3)
NAMES = ("other", "car", "person")
CLASS_OF = {"car": CAR, "van": CAR, "pedestrian": PERSON, "person": PERSON, "child": PERSON}
KITTI_CLASS_OF = {"Car": CAR, "Van": CAR, "Pedestrian": PERSON, "Person_sitting": PERSON}
AV2_CLASS_OF = {"REGULAR_VEHICLE": CAR, "PEDESTRIAN": PERSON}

SENSOR, HEIGHT_M = "hdl-64e", 1.73
"""Sensor of the generated frames, and its height over the ground: KITTI's."""

FRAMES_OF_TOWN, APART = 30, 12
"""Frames of each town, and frames from one that is used to the next."""

NEAR_M, OWN_M = 30.0, 3.0
"""Ranges between which objects are judged; what is nearer is the own car."""

CELL_M, GROUND_CELL_M, GROUND_M, TOP_M = 0.1, 1.0, 0.3, 3.2
"""Cells of clusters and of the ground; heights over the ground between which points are clustered."""

LEAST_POINTS = 10
TREES, FORESTS = 200, 3
COLUMNS = ("cars: recall", "precision", "people: recall", "precision")

NOISY, CLEAN, ONE_SIZE = "as the sensor reports", "without noise", "one car, one person"


class Objects(NamedTuple):
    """Labelled objects: class, pose of the box's centre in the frame of the points, and (length, width, height)."""

    classes: Array
    poses: list[Pose]
    sizes_m: Array


class Clusters(NamedTuple):
    """Clusters of a frame: (n, features), and for each the object that most of its points are in, or -1."""

    features: Array
    on: Array
    seen: Array
    """Whether each object is judged: it is near and has ten points."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=240, help="frames to learn from (default 240)")
    parser.add_argument("--held-out", type=int, default=None, help="frames to be judged on (default: an eighth)")
    parser.add_argument("--real", type=Path, default=None, help="folder of real frames")
    parser.add_argument("--seed", type=int, default=0, help="of the forests")
    arguments = parser.parse_args()
    held_out = arguments.held_out or max(2, arguments.frames // 8)
    print("\n".join(report(arguments.frames, held_out, arguments.real, arguments.seed)))
    return 0


def report(frames: int, held_out: int, real: Path | None, seed: int) -> list[str]:
    """Lines of the result."""
    from sklearn.ensemble import RandomForestClassifier

    training = {kind: Samples() for kind in (NOISY, CLEAN, ONE_SIZE)}
    sizes: dict[int, bytes] = {}
    for cloud, objects in generated(frames, first_town=1):
        for kind, points_m in ((NOISY, cloud.xyz_m), (CLEAN, without_noise(cloud))):
            training[kind].add(clusters(points_m, objects), objects)
        # The first car and the first person that are seen whole are all that is known of cars and people.
        found = clusters(cloud.xyz_m, objects)
        for number in np.flatnonzero(found.seen):
            sizes.setdefault(int(objects.classes[number]), objects.sizes_m[number].round(3).tobytes())
        alike = np.array([sizes.get(int(c)) == size.round(3).tobytes() for c, size in zip(*objects[::2], strict=True)])
        keep = np.array([on < 0 or objects.classes[on] == OTHER or alike[on] for on in found.on], np.bool_)
        training[ONE_SIZE].add(found._replace(features=found.features[keep], on=found.on[keep]), objects)
    judged = {"held-out towns": [(clusters(c.xyz_m, o), o) for c, o in generated(held_out, first_town=1001)]}
    if real is not None:
        judged["KITTI"] = [(clusters(*frame), frame[1]) for frame in kitti_frames(real / "kitti")]
        judged["Argoverse 2"] = [(clusters(*frame), frame[1]) for frame in av2_frames(real / "av2")]
    counts = ", ".join(f"{(training[NOISY].classes == n).sum()} of {name}" for n, name in enumerate(NAMES))
    lines = [f"{frames} frames to learn from; clusters: {counts}"]
    for name, found in judged.items():
        there, reached = (sum(rows) for rows in zip(*(objects_reached(*frame) for frame in found), strict=True))
        parts = (f"{NAMES[label]}: {there[label]}, a cluster on {reached[label]}" for label in (CAR, PERSON))
        lines.append(f"{name}: {len(found)} frames; {'; '.join(parts)}")
    lines += ["", f"{'learned from':<24}{'judged on':<18}" + "".join(f"{column:>18}" for column in COLUMNS)]
    for kind, samples in training.items():
        scores: dict[str, list[Array]] = {}
        for number in range(FORESTS):
            forest = RandomForestClassifier(
                TREES,
                min_samples_leaf=2,
                class_weight="balanced_subsample",
                n_jobs=2,
                random_state=FORESTS * seed + number,
            )
            forest.fit(np.concatenate(samples.features), samples.classes)
            for name, found in judged.items():
                scores.setdefault(name, []).append(score(forest, found))
        for name, rows in scores.items():
            cells = zip(np.mean(rows, axis=0), np.std(rows, axis=0, ddof=1), strict=True)
            text = "".join(f"{f'{mean:.2f} +-{spread:.2f}' if mean == mean else '-':>18}" for mean, spread in cells)
            lines.append(f"{kind:<24}{name:<18}{text}")
    return lines


class Samples:
    """Features and classes of clusters to learn from."""

    def __init__(self) -> None:
        self.features: list[Array] = []
        self._classes: list[Array] = []

    def add(self, found: Clusters, objects: Objects) -> None:
        """Add the clusters of a frame."""
        self.features.append(found.features)
        self._classes.append(np.append(objects.classes, OTHER)[found.on])

    @property
    def classes(self) -> Array:
        """Class of each cluster."""
        return np.concatenate(self._classes)


def objects_reached(found: Clusters, objects: Objects) -> tuple[Array, Array]:
    """Number of judged objects of each class, and of those that most of a cluster's points are in."""
    reached = np.isin(np.arange(len(found.seen)), found.on) & found.seen
    return tuple(np.bincount(objects.classes[mask], minlength=len(NAMES)) for mask in (found.seen, reached))


def score(forest: Any, frames: Sequence[tuple[Clusters, Objects]]) -> Array:
    """Recall and precision of cars and of people; NaN where there are none, or none is named so."""
    counts = np.zeros((4, 2))
    for found, objects in frames:
        classes = np.append(objects.classes, OTHER)[found.on]
        named = forest.predict(found.features) if len(found.features) else np.zeros(0, int)
        for column, label in enumerate((CAR, PERSON)):
            wanted = np.flatnonzero(found.seen & (objects.classes == label))
            counts[:, column] += (
                np.count_nonzero(np.isin(wanted, found.on[named == label])),
                len(wanted),
                np.count_nonzero(classes[named == label] == label),
                np.count_nonzero(named == label),
            )
    with np.errstate(invalid="ignore"):
        return (counts[::2] / counts[1::2]).T.ravel()


def generated(frames: int, *, first_town: int) -> Iterator[tuple[PointCloud, Objects]]:
    """Clouds in the sensor's frame, of as many towns as needed, and what is in them."""
    for town in range(-(-frames // FRAMES_OF_TOWN)):
        scene = load_scene("town", overrides=[f"street.seed={first_town + town}", "street.length_m=500"])
        pose = Pose(position_m=np.array([0.0, 0.0, HEIGHT_M]))
        simulator = Simulator(scene, load_sensor(SENSOR), pose=pose)
        for number in range(min(FRAMES_OF_TOWN, frames - town * FRAMES_OF_TOWN)):
            cloud = simulator.render(FrameOptions(number=number * APART, coordinates="sensor", seed=town))
            place = cloud.sensor_to_world
            assert place is not None
            cloud = cloud.select(~np.isin(cloud.body, scene.own_bodies))
            seen = [box.seen_from(place) for box in boxes(cloud, scene) if box.has_points]
            yield (
                cloud,
                Objects(
                    classes=np.array([CLASS_OF.get(box.class_name, OTHER) for box in seen], np.int64),
                    poses=[box.pose for box in seen],
                    sizes_m=np.array([box.size_m for box in seen]).reshape(-1, 3),
                ),
            )


def without_noise(cloud: PointCloud) -> Array:
    """(n, 3) echoes of a cloud in the sensor's frame, at their true ranges."""
    assert cloud.true_range_m is not None
    echo = (cloud.status == 0) & np.isfinite(cloud.true_range_m)
    points_m = cloud.xyz_m[echo].astype(np.float64)
    return points_m * (cloud.true_range_m[echo] / np.linalg.norm(points_m, axis=1))[:, None]


def kitti_frames(folder: Path) -> Iterator[tuple[Array, Objects]]:
    """Points in the picture and labelled objects of KITTI's frames, in the frame of the lidar."""
    for path in sorted((folder / "velodyne").glob("*.bin")):
        rows = (folder / "calib" / f"{path.stem}.txt").read_text().splitlines()
        numbers = {name: np.array(words.split(), float) for name, _, words in (row.partition(":") for row in rows)}
        rectified, to_camera = np.eye(4), np.eye(4)
        rectified[:3, :3] = numbers["R0_rect"].reshape(3, 3)
        to_camera[:3] = numbers["Tr_velo_to_cam"].reshape(3, 4)
        to_camera = rectified @ to_camera
        xyz_m = np.fromfile(path, np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
        pixels = np.c_[xyz_m, np.ones(len(xyz_m))] @ (numbers["P2"].reshape(3, 4) @ to_camera).T
        column, line = pixels[:, :2].T / pixels[:, 2]
        shown = (pixels[:, 2] > 0) & (column >= 0) & (column < 1242) & (line >= 0) & (line < 375)
        classes, poses, sizes = [], [], []
        for words in map(str.split, (folder / "label_2" / f"{path.stem}.txt").read_text().splitlines()):
            if words[0] == "DontCare":
                continue
            height, width, length, x, y, z, yaw = map(float, words[8:15])
            centre = np.linalg.inv(to_camera) @ [x, y - 0.5 * height, z, 1.0]
            # rotation_y turns about the camera's y, which points down.
            ahead = np.linalg.inv(to_camera)[:3, :3] @ [np.cos(yaw), 0.0, -np.sin(yaw)]
            poses.append(upright_pose(centre[:3], np.arctan2(ahead[1], ahead[0])))
            classes.append(KITTI_CLASS_OF.get(words[0], OTHER))
            sizes.append([length, width, height])
        yield xyz_m[shown], Objects(np.array(classes), poses, np.array(sizes))


def av2_frames(folder: Path) -> Iterator[tuple[Array, Objects]]:
    """Points and labelled objects of Argoverse 2's frames, in the frame of the vehicle."""
    from pyarrow import feather

    for log in sorted(folder.iterdir()):
        table = feather.read_table(log / "annotations.feather").to_pydict()
        stamps = np.array(table["timestamp_ns"])
        for path in sorted(log.glob("[0-9]*.feather")):
            cloud = feather.read_table(path, columns=["x", "y", "z"]).to_pydict()
            rows = np.flatnonzero(stamps == int(path.stem))
            value = lambda name, rows=rows, table=table: np.array(table[name])[rows]  # noqa: E731
            yaw = 2.0 * np.arctan2(value("qz"), value("qw"))
            places = np.stack([value("tx_m"), value("ty_m"), value("tz_m")], axis=-1)
            yield (
                np.stack([np.array(cloud[axis], float) for axis in "xyz"], axis=-1),
                Objects(
                    classes=np.array([AV2_CLASS_OF.get(name, OTHER) for name in value("category")]),
                    poses=[upright_pose(place, angle) for place, angle in zip(places, yaw, strict=True)],
                    sizes_m=np.stack([value("length_m"), value("width_m"), value("height_m")], axis=-1),
                ),
            )


def upright_pose(centre_m: Array, yaw_rad: float) -> Pose:
    """Pose of a box that stands upright."""
    return Pose.from_degrees(position_m=tuple(centre_m), yaw_deg=float(np.degrees(yaw_rad)))


def clusters(xyz_m: Array, objects: Objects) -> Clusters:
    """Cluster the points of a frame that are near and above the ground."""
    from scipy import ndimage

    xyz_m = np.asarray(xyz_m, np.float64)
    level = np.hypot(*xyz_m[:, :2].T)
    xyz_m = xyz_m[(level > OWN_M) & (level < NEAR_M + 3.0)]
    over_m = xyz_m[:, 2] - ground_m(xyz_m)
    kept = (over_m > GROUND_M) & (over_m < TOP_M)
    points, over_m = xyz_m[kept], over_m[kept]
    cell = np.floor(points[:, :2] / CELL_M).astype(int)
    cell -= cell.min(axis=0)
    grid = np.zeros(cell.max(axis=0) + 1, np.bool_)
    grid[tuple(cell.T)] = True
    labels, _ = ndimage.label(grid, structure=np.ones((3, 3)))
    cluster = labels[tuple(cell.T)]
    of_point, seen = objects_of(points, objects)
    order = np.argsort(cluster, kind="stable")
    features, on = [], []
    for member in np.split(order, np.flatnonzero(np.diff(cluster[order])) + 1):
        if len(member) < LEAST_POINTS:
            continue
        inside = of_point[member]
        best = np.bincount(inside + 1).argmax() - 1
        on.append(best if np.count_nonzero(inside == best) > 0.5 * len(member) else -1)
        features.append(shape_of(points[member], over_m[member], len(np.unique(cell[member], axis=0))))
    return Clusters(np.array(features).reshape(-1, 20), np.array(on, np.int64), seen)


def ground_m(xyz_m: Array) -> Array:
    """(n,) height of the ground below each point: the lowest of the cells around, in each the second lowest point."""
    from scipy import ndimage

    cell = np.floor(xyz_m[:, :2] / GROUND_CELL_M).astype(int)
    cell -= cell.min(axis=0)
    size = cell.max(axis=0) + 1
    number = cell @ [size[1], 1]
    order = np.lexsort((xyz_m[:, 2], number))
    first = np.flatnonzero(np.diff(number[order], prepend=-1))
    # A single low point is a false one.
    second = np.minimum(first + 1, np.append(first[1:], len(order)) - 1)
    lowest = np.full(size.prod(), np.inf)
    lowest[number[order[first]]] = xyz_m[order[second], 2]
    around = ndimage.minimum_filter(lowest.reshape(size), size=5, mode="constant", cval=np.inf)
    return around[tuple(cell.T)]


def objects_of(points_m: Array, objects: Objects) -> tuple[Array, Array]:
    """(n,) object that each point is in, or -1; and whether each object is judged."""
    of_point, seen = np.full(len(points_m), -1), np.zeros(len(objects.classes), np.bool_)
    for number, (pose, size_m) in enumerate(zip(objects.poses, objects.sizes_m, strict=True)):
        inside = (np.abs(pose.inverse_apply(points_m)) <= 0.5 * size_m + 0.1).all(axis=1)
        of_point[inside] = number
        seen[number] = inside.sum() >= LEAST_POINTS and OWN_M < np.hypot(*pose.position_m[:2]) < NEAR_M
    return of_point, seen


def shape_of(points_m: Array, over_m: Array, cells: int) -> list[float]:
    """Features of a cluster: its size, where its points are, and how many there are for its distance."""
    centred = points_m[:, :2] - points_m[:, :2].mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov(centred.T) + 1e-9 * np.eye(2))
    across, along = (centred @ axes).T
    length, width = np.ptp(along), np.ptp(across)
    distance = np.hypot(*points_m[:, :2].mean(axis=0))
    heights = np.histogram(over_m, bins=[0.0, 0.6, 0.9, 1.2, 1.5, 1.8, 2.2, 9.0])[0] / len(over_m)
    return [
        *(length, width, length * width, length / (width + 0.1)),
        *(over_m.max(), over_m.min(), over_m.mean(), over_m.std()),
        *np.sqrt(np.maximum(spread, 0.0)),
        *(cells * CELL_M**2, distance, np.log(len(over_m) * distance**2)),
        *heights,
    ]


if __name__ == "__main__":
    sys.exit(main())
