"""Whole drives: all frames of a drive in one file, a bag of ROS 2 or a log of Rerun.

Any worker renders any frame, to a separate file. When all frames of a drive are there, one worker writes them in
order of time to the drive's file, and removes them. So a drive that was broken off loses no frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

from ..cloud.point_cloud import PointCloud
from ..formats.registry import FORMATS
from ..outputs.output_options import Outputs
from ..outputs.run_motion import poses_between
from ..outputs.streams import rerun_stream
from ..scene.scene import Scene
from .job_file import WHOLE_DRIVES
from .store import Store
from .tasks import FrameTask, digest_of_data


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveTask:
    """One file to be written from frames that are there.

    Attributes:
        file: path in the job's folder
        frames: frames of the drive, sensor by sensor
    """

    key: str
    file: Path
    frames: tuple[FrameTask, ...]

    @property
    def version(self) -> str:
        """Version of lidarscene that gave the task out."""
        return self.frames[0].version

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def write(self, store: Store, scene: Scene) -> None:
        """Write the file and its row, then remove the clouds of its frames.

        Raises:
            OutputError: where it cannot be written
            InputError: where a frame is missing
        """
        path, place = store.folder / self.file, self.frames[0].place
        assert place is not None
        chosen = FORMATS[place.dataset]
        outputs = Outputs(path, truth=self.frames[0].truth)
        assert chosen.frames is not None
        with chosen.frames(path) as append:
            frames = sorted(self.frames, key=partial(_time_s, store, "start_s"))
            # The vehicle's poses come with its first sensor, as where `record` writes them.
            first = self.frames[0].sensor.label
            starts_s = [_time_s(store, "start_s", frame) for frame in frames if frame.sensor.label == first]
            spans_s = pairwise([*starts_s, max(_time_s(store, "end_s", frame) for frame in frames)])
            for frame in frames:
                cloud = PointCloud.load(store.cloud(frame.key, frame.format))
                append_frame: Callable[..., None] = partial(cast(Callable[..., None], append), label=frame.sensor.label)
                if chosen.boxes:
                    with rerun_stream(outputs, path.parent, scene, append_frame) as gather:
                        gather(cloud)
                else:
                    append_frame(cloud if frame.truth else cloud.without_truth())
                if chosen.driver and frame.sensor.label == first:
                    cast(Any, append).append_motion(*poses_between(scene.ego, *next(spans_s)))
        store.finish(self.key, [path], {"frames": len(self.frames)})
        self.remove_frames(store)

    def remove_frames(self, store: Store) -> None:
        """Remove the clouds of the frames; their rows stay."""
        for frame in self.frames:
            store.cloud(frame.key, frame.format).unlink(missing_ok=True)

    def row_of_frame(self, store: Store, frame: FrameTask) -> dict[str, Any] | None:
        """Row of a frame of the drive, with the drive's file where it is written; None if it is not done."""
        drive, entry = store.row(self.key, read=False), store.entry(frame.key)
        if drive is None or entry is None:
            return store.row(frame.key, read=False)
        return entry | {"file": drive["file"], "bytes": drive["bytes"]}


def drives_of(tasks: Iterable[FrameTask]) -> list[DriveTask]:
    """Gather the frames of each whole drive; empty for other jobs."""
    frames_of_file: dict[Path, dict[str, FrameTask]] = {}
    for task in tasks:
        if task.place is None or task.place.dataset not in WHOLE_DRIVES:
            return []
        frames_of_file.setdefault(task.place.files[0], {})[task.key] = task
    return [
        DriveTask(key=digest_of_data(["drive", file.as_posix(), *frames]), file=file, frames=tuple(frames.values()))
        for file, frames in frames_of_file.items()
    ]


def _time_s(store: Store, name: str, frame: FrameTask) -> float:
    """Start ("start_s") or end ("end_s") of a frame that is done, by the scene's clock [s]."""
    entry = store.entry(frame.key) or {}
    return float(entry.get("truth", {}).get(name, 0.0))
