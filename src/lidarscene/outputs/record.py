"""Record: a scene and a sensor or a rig in; the files of one frame or of several out.

The command `render` calls this, so that Python and the command line write the same files, bit for bit. A frame is never
held in memory: its chunks go into all of its files at once.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence, Sized
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Unpack

from ..errors import OptionError
from ..files.arguments import checks_arguments
from ..files.atomic import name_path_in_errors
from ..files.overrides import Overrides, assignments
from ..formats.packets.packet_encoder import PacketEncoder
from ..formats.rerun import require_viewer, rerun_live
from ..kernel.device import blocks
from ..rendering.frame_summary import Summary
from ..rendering.render_options import FrameKeywords, FrameOptions, Keywords, Observers, TraceKeywords, TraceOptions
from ..rendering.rig_simulators import require_common_frames, simulators
from ..rendering.simulator import Simulator
from ..rendering.surroundings import Surroundings, simulator_surroundings, warn_of_surroundings
from ..scene.scene import Scene
from ..scene.scene_file import SceneChoice, changed_scene, files_of_scene
from ..sensor.rig_file import Mounted, Rig
from ..sensor.sensor_file import load_sensor
from ..sensor.sensor_model import Sensor, warn_of_doubts
from .closing import Closing, frames_at_once
from .frame_files import FrameFiles
from .output_options import FRAMES, File, Outputs
from .plan import CLOUDS, Plan, check_writable, protect_inputs
from .run_motion import RunMotion, imu_labels
from .size import warn_of_size
from .streams import captures, description_files, packet_encoders, waveform_pulses

ProgressCallback = Callable[[int, int], object]
NameOrFile = str | os.PathLike[str]


class RecordKeywords(TraceKeywords, FrameKeywords, total=False):
    """Keywords of `record`: options of tracing and of the frame, and a function called with the progress."""

    trace: TraceOptions
    frame: FrameOptions
    progress: ProgressCallback | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedCloud:
    """One cloud that was written: a frame of one sensor, or the merged frames of a rig.

    Attributes:
        label: label of the rig's sensor; "" for a single sensor, and for merged frames
        number: number of the frame
        files: key -> path: "output" is the cloud, `Plan.files` lists the other keys
        summary: counts and times of the frame
    """

    label: str
    number: int
    files: Mapping[str, Path]
    summary: Summary


@dataclass(frozen=True, slots=True, eq=False)
class RecordedRun:
    """Result of `record`: the clouds that were written.

    Attributes:
        surroundings: place of each sensor in the scene as the first frame begins
        run_files: files of all frames: IMUs, poses
    """

    clouds: tuple[RecordedCloud, ...]
    surroundings: tuple[Surroundings, ...]
    run_files: tuple[Path, ...] = ()

    @property
    def summary(self) -> Summary:
        """Sum of the summaries of all frames."""
        return Summary.total([cloud.summary for cloud in self.clouds])

    @property
    def files(self) -> tuple[Path, ...]:
        """Files of all frames, each once."""
        cloud_files = (path for cloud in self.clouds for path in cloud.files.values())
        return tuple(dict.fromkeys((*cloud_files, *self.run_files)))


@checks_arguments
def record(
    scene: SceneChoice,
    sensor: NameOrFile | Sensor | Rig | None = None,
    *,
    outputs: Annotated[Outputs | File, "a file or Outputs"],
    frames: int | None = None,
    overrides: Overrides = (),
    scene_overrides: Overrides = (),
    **options: Unpack[RecordKeywords],
) -> RecordedRun:
    """Render one frame, or ``frames`` consecutive ones, into the files of ``outputs``.

    No file that the run reads is overwritten.

    Args:
        scene: scene file, Mitsuba XML or `Scene`
        sensor: catalogue name, sensor file, `Sensor` or `Rig` (`load_rig`); the scene's own if None
        outputs: an `Outputs`, or the file of the cloud alone
        frames: number of frames, from the options' number on; None: one, whose cloud is the file `Outputs.path`
        overrides: changes to the sensor file's values: "detector.gain=60", a list of these, or {"detector.gain": 60}
        scene_overrides: changes to the scene file's values, likewise
        options: `TraceOptions` as ``trace`` and `FrameOptions` as ``frame``, or their fields; the pose is the vehicle's
            if there is a rig. ``progress`` is called with (done, pulses) of all frames

    Raises:
        InputError: before anything is traced
        OutputError: before anything is traced
    """
    changes = assignments(overrides)
    scene_changes = assignments(scene_overrides, name="scene_overrides")
    callback = Observers(progress=options.pop("progress", None)).progress
    keywords = Keywords(options)
    trace, frame = keywords.take(TraceOptions), keywords.take(FrameOptions)
    keywords.end()
    if frames is not None:
        FRAMES.check("frames", frames)
        frames = int(frames)  # one of NumPy would overflow beside a number that is larger
    rig = sensor if isinstance(sensor, Rig) else None
    if changes and isinstance(sensor, Rig | Sensor):
        raise OptionError("{overrides}: needs the name or file of a sensor, got a {0}", type(sensor).__name__)
    if isinstance(outputs, str | os.PathLike):
        outputs = Outputs(outputs)
    # What can be refused is refused in order of its cost: names first, then files, then the world, then tracing.
    plan = Plan(outputs, frames, rig is not None, frame.begin_s)
    if outputs.rrd:
        require_viewer()
    plan.check(frame.coordinates, vectors=trace.vectors)
    before, since = Summary(), time.perf_counter()
    labels = [""] if rig is None else [mounted.label for mounted in rig.sensors]
    numbers = range(frame.number, frame.number + (frames or 1))
    clouds = _planned_clouds(plan, labels, numbers)
    pose_files = plan.run_files("poses", [""] if outputs.merge else labels)
    planned = [cloud.files for cloud in clouds]
    check_writable(plan, [*planned, *({"poses": path} for path in pose_files.values())])
    described = changed_scene(scene, scene_changes)
    sensors = _sensors(described, sensor, changes, frame)
    warn_of_doubts(mounted.sensor for mounted in sensors)
    warn_of_size(plan, sensors, trace, blocks.lanes_per_chunk(frame.chunk))
    encoders = _encoders(plan, sensors, clouds)
    has_imu = {mounted.label: mounted.sensor.imu is not None for mounted in sensors}
    imu_files = plan.run_files("imu", [] if outputs.imu is None else imu_labels(has_imu, rig))
    planned += [{"poses": path} for path in pose_files.values()] + [{"imu": path} for path in imu_files.values()]
    check_writable(plan, planned)
    protect_inputs(planned, [*_inputs(scene, scene_changes, sensor)])
    # Wrong pulse numbers raise here, not after an hour of tracing.
    if outputs.waveforms is not None:
        for mounted in sensors:
            waveform_pulses(outputs, mounted.sensor)
    since = before.add_time("load", since)
    if outputs.merge:
        require_common_frames(sensors, len(numbers))
    # Simulators are made once for all frames: worlds and compiled kernels are kept.
    simulator_by_label = dict(simulators(described, sensors, trace, pose=frame.pose if rig else None))
    for simulator in simulator_by_label.values():
        simulator.check_frames(numbers, begin_s=frame.begin_s)
    surroundings = tuple(
        simulator_surroundings(simulator, frame, len(numbers)) for simulator in simulator_by_label.values()
    )
    warn_of_surroundings(surroundings)
    before.add_time("build", since)
    with_imus = outputs.imu is not None or outputs.packets or outputs.rrd or plan.format.rig
    motion = RunMotion.of_run(described, simulator_by_label, frame, len(numbers), rig=rig, with_imus=with_imus)
    pulses = len(numbers) * sum(mounted.sensor.scanner.pulses for mounted in sensors)
    run = _Run(plan, described, simulator_by_label, frame, motion, placed=rig is not None or frame.pose is not None)
    # Loading and building happened once; the first frame is charged for it.
    written = run.write(clouds, encoders, before, None if callback is None else _Progress(callback, pulses))
    epoch_ns = outputs.epoch_ns(frame.begin_s)
    for label, path in imu_files.items():
        motion.write_imu(path, label, epoch_ns)
    for label, path in pose_files.items():
        motion.write_poses(path, label, epoch_ns)
    return RecordedRun(written, surroundings, (*imu_files.values(), *pose_files.values()))


class _PlannedCloud(NamedTuple):
    """Cloud that the run will write.

    Attributes:
        label: label of the rig's sensor; "" for a single sensor, and for merged clouds
        sensor_labels: labels of the sensors whose points are in it
        number: number of the frame
        files: key of `Plan.files` -> path
    """

    label: str
    sensor_labels: Sequence[str]
    number: int
    files: dict[str, Path]


def _planned_clouds(plan: Plan, labels: Sequence[str], numbers: Sequence[int]) -> list[_PlannedCloud]:
    """Clouds of all frames in the order of writing: all sensors in one when merged, else one for each."""
    groups = {"": labels} if plan.outputs.merge else {label: [label] for label in labels}
    return [
        _PlannedCloud(label, group, number, plan.files(label, number))
        for number in numbers
        for label, group in groups.items()
    ]


def _encoders(plan: Plan, sensors: Sequence[Mounted], clouds: Sequence[_PlannedCloud]) -> dict[str, PacketEncoder]:
    """Encoder of each sensor's packets, by label; empty without packets. Their description files join the clouds'."""
    if not plan.outputs.packets:
        return {}
    encoders = packet_encoders({mounted.label: mounted.sensor for mounted in sensors}, plan.format.profile or "")
    for cloud in clouds:
        cloud.files.update(description_files(cloud.files["output"], encoders[cloud.label]))
    return encoders


@dataclass(frozen=True, slots=True)
class _Run:
    """Run whose options are checked and whose simulators are built.

    Attributes:
        simulators: label of the sensor -> its simulator
        placed: whether the sensors have another pose than the scene's
    """

    plan: Plan
    scene: Scene
    simulators: Mapping[str, Simulator]
    frame: FrameOptions
    motion: RunMotion
    placed: bool

    def write(
        self,
        clouds: Sequence[_PlannedCloud],
        encoders: Mapping[str, PacketEncoder],
        before: Summary,
        progress: ProgressCallback | None,
    ) -> tuple[RecordedCloud, ...]:
        """Trace all clouds into their files; the first has the times of ``before`` in its summary."""
        plan, written = self.plan, list[RecordedCloud]()
        epoch_ns, keeps_rig = plan.outputs.epoch_ns(self.frame.begin_s), plan.format.rig
        with ExitStack() as opened:
            bags = _bags(plan, [cloud.files for cloud in clouds], opened, epoch_ns)
            live = opened.enter_context(rerun_live(epoch_ns=epoch_ns)) if plan.outputs.rrd else None
            packet_files = {cloud.label: cloud.files["output"] for cloud in clouds} if encoders else {}
            open_captures = opened.enter_context(captures(packet_files, encoders))
            closed_later = self._closed_later(clouds, bags, live, encoders)
            closing = opened.enter_context(Closing(closed_later)) if closed_later else None
            end = clouds[-1].number + 1
            for (label, group, number, files), following in zip(clouds, [*clouds[1:], None], strict=True):
                parts = list(self.motion.parts(group, number - self.frame.number))
                frame_files = FrameFiles(
                    plan=plan,
                    scene=self.scene,
                    simulators={name: self.simulators[name] for name in group},
                    frame=self._frame_of(number),
                    files=files,
                    placed=self.placed,
                    summary=Summary(seconds={} if written else before.seconds),
                    bags={
                        path: name_path_in_errors(path, partial(append, label=label) if keeps_rig else append)
                        for path, append in bags.items()
                    },
                    live=None if live is None else partial(live, label=label),
                    epoch_ns=epoch_ns,
                    capture=open_captures.get(label),
                    imu=next((samples for track, samples in parts if track.label == label), None),
                    frames=end - number,
                    ahead=None if following is None else partial(self._begin, following, end - following.number),
                    closing=closing,
                )
                frame_files.write(progress)
                for log in bags.values() if plan.format.driver else ():
                    log.append_motion(*self.motion.vehicle_poses(group[0], number - self.frame.number))
                for log in (*(bags.values() if keeps_rig else ()), *(() if live is None else (live,))):
                    for track, samples in parts:
                        log.append_imu(samples, label=track.label, mounting=track.on_vehicle)
                written.append(RecordedCloud(label=label, number=number, files=files, summary=frame_files.summary))
        return tuple(written)

    def _closed_later(self, clouds: Sized, *in_order: object) -> int:
        """Number of frames whose files are completed while the next one is traced; 0: none.

        None where a file or a viewer has several frames, one of ``in_order``, and of frames so large that two would
        fill the memory.
        """
        pulses = sum(simulator.sensor.scanner.pulses for simulator in self.simulators.values())
        return 0 if len(clouds) == 1 or any(in_order) else frames_at_once(pulses, self.frame.chunk)

    def _begin(self, cloud: _PlannedCloud, frames: int) -> None:
        """Start the first sensor of a cloud: the device computes while the files of the last one are written.

        Args:
            frames: number of frames from the cloud's on
        """
        self.simulators[cloud.sensor_labels[0]].begin(self._frame_of(cloud.number), frames)

    def _frame_of(self, number: int) -> FrameOptions:
        return replace(self.frame, number=number, pose=None)


def _bags(plan: Plan, clouds: Sequence[Mapping[str, Path]], opened: ExitStack, epoch_ns: int) -> dict[Path, Any]:
    """File that holds the clouds of all frames -> its open `Format.frames`."""
    if not plan.is_bag or plan.format.frames is None:
        return {}
    paths = dict.fromkeys(files[key] for files in clouds for key in CLOUDS if key in files)
    frames, outputs = plan.format.frames, plan.outputs
    names = {"topic": outputs.topic, "frame_id": outputs.frame_id} if plan.format.driver else {}
    return {path: opened.enter_context(frames(path, epoch_ns=epoch_ns, **names)) for path in paths}


def _sensors(
    scene: Scene, sensor: NameOrFile | Sensor | Rig | None, overrides: Sequence[str], frame: FrameOptions
) -> Sequence[Mounted]:
    """Sensors of the rig; without one the given sensor or the scene's, with the label ""."""
    if isinstance(sensor, Rig):
        return sensor.sensors
    single = load_sensor(scene.sensor_name if sensor is None else sensor, overrides=overrides)
    return [Mounted(label="", sensor=single, pose=frame.pose or scene.sensor_pose)]


def _inputs(
    scene: NameOrFile | Scene, overrides: Sequence[str], sensor: NameOrFile | Sensor | Rig | None
) -> Iterator[Path]:
    """Iterate over the files that the run reads."""
    if not isinstance(scene, Scene):
        yield from files_of_scene(scene, overrides=overrides)
    if isinstance(sensor, Rig):
        yield from sensor.files
    elif sensor is not None and not isinstance(sensor, Sensor):
        yield Path(sensor)


class _Progress:
    """Observer of consecutive frames that reports progress over the pulses of all of them."""

    def __init__(self, callback: ProgressCallback, pulses: int) -> None:
        self._callback, self._pulses, self._before = callback, pulses, 0

    def __call__(self, finished: int, pulses: int) -> None:
        self._callback(self._before + finished, self._pulses)
        # A frame has ended: the next one counts from 0 again.
        if finished == pulses:
            self._before += pulses
