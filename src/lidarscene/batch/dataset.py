"""Data sets of a job: which part each frame belongs to, the files it becomes, and what is written when all are done.

Frames of one drive (one scene, sensor and seed) look alike, and so do drives through one street: what is tested there
was learned there. So whole streets are shared out, drawn by their hashes; `by = "drive"` shares out drives, and
`by = "frames"` cuts each drive into runs of consecutive frames.
"""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..errors import InputError
from ..files.atomic import put_text
from ..formats.registry import FORMATS
from ..labels import kitti_dataset, nuscenes_dataset
from ..labels.boxes import sensor_place
from ..labels.nuscenes_dataset import Sample
from ..labels.point_rows import PointRows
from ..maths.pose import Pose
from ..maths.trajectory import Course
from ..rendering.simulator import Simulator
from ..scene.scene import Scene
from .job_file import WHOLE_DRIVES, JobFile, SplitFile

PARTS = ("train", "val", "test")

CLOUD_FOLDERS = {
    "kitti": ("training/velodyne/*.bin", "testing/velodyne/*.bin"),
    "semantickitti": ("dataset/sequences/*/velodyne/*.bin",),
    "nuscenes": ("samples/*/*.pcd.bin",),
    **{name: tuple(f"{part}/drive_*{FORMATS[name].suffix}" for part in PARTS) for name in WHOLE_DRIVES},
}
"""Where the clouds of a data set lie, or its drives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Place of a frame in a data set.

    Attributes:
        dataset: name of the data set, a key of CLOUD_FOLDERS
        split: part: train, val or test
        sequence: number of the drive, or of the run of it that is in this part
        step: number of the frame within the sequence
        steps: number of frames of the sequence
        number: number of the frame in its folder
        channel: nuScenes' name of the sensor; "" in others
    """

    dataset: str
    split: str
    sequence: int
    step: int
    steps: int
    number: int
    channel: str = ""

    @property
    def sample(self) -> Sample:
        """The same in a data set of nuScenes."""
        return Sample(scene=self.sequence, split=self.split, step=self.step, channel=self.channel, number=self.number)

    @property
    def is_whole_drive(self) -> bool:
        """Whether all frames of the drive are in one file."""
        return self.dataset in WHOLE_DRIVES

    @property
    def name(self) -> str:
        """Name of the sequence as its data set writes it; "" in KITTI, which has none."""
        if self.dataset == "kitti":
            return ""
        if self.is_whole_drive:
            return f"drive_{self.sequence:04d}"
        return f"{self.sequence:02d}" if self.dataset == "semantickitti" else nuscenes_dataset.scene_name(self.sequence)

    @property
    def files(self) -> tuple[Path, ...]:
        """Files of the frame in the data set, the cloud the first; or the drive's."""
        if self.is_whole_drive:
            return (Path(self.split) / f"{self.name}{FORMATS[self.dataset].suffix}",)
        if self.dataset == "nuscenes":
            sample = self.sample
            return Path(sample.cloud), Path(sample.classes), *([Path(sample.map)] if self._has_map else [])
        part = "testing" if self.split == "test" else "training"
        cloud = kitti_dataset.cloud_path(self.dataset, "", self.number, sequence=self.name, part=part)
        return kitti_dataset.frame_files(self.dataset, cloud)

    @property
    def _has_map(self) -> bool:
        """Whether the map of the drive is among the files of this frame."""
        return self.step == 0 and self.channel == TOP

    def write(
        self,
        folder: Path,
        pieces: Sequence[PointCloud | PointRows],
        simulator: Simulator,
        scene: Scene,
        *,
        all_around: bool,
    ) -> dict[str, Any]:
        """Write the files of the frame; returns what `write_tables` needs of it, as plain data.

        Args:
            pieces: the frame's cloud in nuScenes, else the rows of its points
        """
        if self.dataset == "nuscenes":
            (cloud,) = pieces
            return self._write_sample(folder, cast(PointCloud, cloud), simulator, scene)
        path = folder / self.files[0]
        with kitti_dataset.files_stream(self.dataset, path, scene, all_around=all_around) as (append, first):
            for piece in pieces:
                append(piece)
        if self.dataset == "kitti":
            return {}
        pose = sensor_place(first[0])
        rows = np.column_stack([pose.rotation, pose.position_m])
        return {"start_s": first[0].frame_start_s, "sensor_to_world": rows.tolist()}

    def _write_sample(self, folder: Path, cloud: PointCloud, simulator: Simulator, scene: Scene) -> dict[str, Any]:
        record: dict[str, Any] = {}
        with nuscenes_dataset.sample_stream(folder, self.sample, scene, record) as append:
            append(cloud)
        if self._has_map:
            begin_s = record["start_s"]
            end_s = begin_s + self.steps * simulator.sensor.scanner.frame_s
            path_m = nuscenes_dataset.path_of_drive(scene.ego or Course(), begin_s, end_s)
            corner_m, size_px = nuscenes_dataset.map_area(path_m)
            nuscenes_dataset.write_map(folder / self.sample.map, scene, corner_m, size_px)
            record["map_corner_m"] = corner_m.tolist()
        return record


TOP = "LIDAR_TOP"
"""nuScenes' name of a single lidar, and of a rig's first."""


class Drive(NamedTuple):
    """Consecutive frames of one sensor.

    Attributes:
        street: hash of what stands where, whatever the light, the paint, the sensor and the vehicle's way
        run: hash of scene, sensor or rig, and seed
        label: label of the rig's sensor, or ""
    """

    street: str
    run: str
    label: str


class Places:
    """Places of a job's frames, asked for in its order, drive by drive."""

    def __init__(self, file: JobFile, drives: Iterable[Drive]) -> None:
        """Share out the parts.

        Raises:
            InputError: for a part that would be empty
        """
        self._file, self._splits = file, file.splits or SplitFile()
        self._numbers: Counter[tuple[str, ...]] = Counter()
        self._sequences: dict[str, int] = {}
        self._first_labels: dict[str, str] = {}
        self._part_of_unit: dict[str, str] = {}
        if self._splits.by == "frames":
            self._lengths = share_out(file.frames, self._splits.shares(), "frames of a drive")
        else:
            units = dict.fromkeys(self._unit(drive) for drive in drives)
            counts = share_out(len(units), self._splits.shares(), f"{self._splits.by}s", hint=HINTS[self._splits.by])
            parts = iter([part for part in PARTS for _ in range(counts[part])])
            self._part_of_unit = dict(zip(sorted(units), parts, strict=True))

    def _unit(self, drive: Drive) -> str:
        """Hash of what goes into one part: the drive's frames, or those of all drives through its street."""
        # Hashed once more: the order of parts is not that of anything else.
        name = drive.street if self._splits.by == "street" else drive.run
        return hashlib.sha256(f"part {name}".encode()).hexdigest()

    def of_drive(self, drive: Drive) -> Iterator[Place]:
        """Places of the frames of one drive of one sensor, in order."""
        file = self._file
        assert file.dataset is not None
        if self._splits.by == "frames":
            runs = [(part, length) for part, length in self._lengths.items() if length]
        else:
            runs = [(self._part_of_unit[self._unit(drive)], file.frames)]
        is_nuscenes = file.dataset == "nuscenes"
        for part, length in runs:
            # In KITTI's data sets each sensor of a rig has a sequence of its own; elsewhere they share a drive.
            key = (
                f"{drive.run} {part}"
                if is_nuscenes or file.dataset in WHOLE_DRIVES
                else f"{drive.run} {part} {drive.label}"
            )
            sequence = self._sequences.setdefault(key, len(self._sequences))
            channel = ""
            if is_nuscenes:
                first = self._first_labels.setdefault(drive.run, drive.label)
                channel = TOP if drive.label == first else f"LIDAR_{drive.label.upper()}"
            folder = (channel,) if is_nuscenes else ("test" if part == "test" else "training",)
            for step in range(length):
                number = step
                if file.dataset != "semantickitti":
                    number = self._numbers[folder]
                    self._numbers[folder] += 1
                yield Place(
                    dataset=file.dataset,
                    split=part,
                    sequence=sequence,
                    step=step,
                    steps=length,
                    number=number,
                    channel=channel,
                )


HINTS = {
    "street": '; sweep "street.seed", add scenes, or share out drives through one street (by = "drive")',
    "drive": "; add seeds or scenes",
}
"""What helps where there are too few streets or drives."""


def share_out(count: int, shares: Mapping[str, float], name: str, *, hint: str = "") -> dict[str, int]:
    """Share a number of things out by shares that add up to 1, at least one to each that is not 0.

    Args:
        name: of the things, for the error
        hint: what helps, for the error

    Raises:
        InputError: where there are too few
    """
    wanted = [part for part in PARTS if shares[part] > 0.0]
    if count < len(wanted):
        must = f"{', '.join(wanted)} must each have some of the {name}, of which there are {count}"
        raise InputError(f"splits: {must}{hint}")
    counts = {part: max(1, math.floor(count * shares[part])) if part in wanted else 0 for part in PARTS}
    # Largest remainders get what is over; the largest part gives where the least ones were given too much.
    while (missing := count - sum(counts.values())) != 0:
        step = 1 if missing > 0 else -1
        candidates = wanted if step > 0 else [part for part in wanted if counts[part] > 1]
        part = max(candidates, key=lambda name: step * (count * shares[name] - counts[name]))
        counts[part] += step
    return counts


def require_no_other_clouds(folder: Path, places: Iterable[Place | None]) -> None:
    """Raise InputError for a folder with clouds of another data set: they would be taken for the job's."""
    expected: set[str] = set()
    for place in places:
        if place is None:
            return
        expected.add(place.files[0].as_posix())
    others = (
        path
        for dataset in CLOUD_FOLDERS
        for pattern in CLOUD_FOLDERS[dataset]
        for path in sorted(folder.glob(pattern))
        if path.relative_to(folder).as_posix() not in expected
    )
    if (other := next(others, None)) is not None:
        raise InputError(f"{other}: is of an earlier job, not of this one; choose another folder")


def write_tables(folder: Path, rows: Callable[[], Iterator[tuple[Place, Mapping[str, Any]]]]) -> None:
    """Write what a data set has of all frames: splits, poses and times, nuScenes' tables.

    Args:
        rows: iterates over the places of all frames, and their rows of the store, in the job's order

    Raises:
        OutputError: if a result cannot be written
    """
    first = next(rows(), None)
    if first is None:
        return
    dataset = first[0].dataset
    if first[0].is_whole_drive:
        return
    if dataset == "nuscenes":
        nuscenes_dataset.write_tables(folder, ((place.sample, row["truth"]) for place, row in rows()))
    elif dataset == "kitti":
        _write_image_sets(folder / "ImageSets", [place for place, _ in rows()])
    else:
        poses = ((place.name, row["truth"]["start_s"], _pose(row["truth"])) for place, row in rows())
        kitti_dataset.write_sequences(folder / "dataset", poses)
        splits = {place.name: place.split for place, _ in rows()}
        put_text(folder / "dataset" / "splits.yaml", _splits_yaml(splits))


def _pose(truth: Mapping[str, Any]) -> Pose:
    matrix = np.array(truth["sensor_to_world"])
    return Pose(position_m=matrix[:, 3], rotation=matrix[:, :3])


def _write_image_sets(folder: Path, places: Sequence[Place]) -> None:
    """Write the lists of frames that loaders of KITTI read."""
    names = {part: [f"{place.number:06d}" for place in places if place.split == part] for part in PARTS}
    for part, numbers in (names | {"trainval": sorted(names["train"] + names["val"])}).items():
        put_text(folder / f"{part}.txt", "".join(number + "\n" for number in numbers))


def _splits_yaml(splits: Mapping[str, str]) -> str:
    """Text of the table `split` of semantic-kitti-api's configuration, whose second part is called valid."""
    parts = {"train": "train", "val": "valid", "test": "test"}
    lines = [f"  {parts[part]}: [{', '.join(str(int(n)) for n, p in splits.items() if p == part)}]\n" for part in PARTS]
    return "split:\n" + "".join(lines)
