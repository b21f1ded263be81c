"""Record: a scene and a sensor, or a rig of them, in; the files of one frame or of several out.

This is what the command `render` calls, so that Python and the command line write the same files, bit for bit. A frame
is never held in memory: its chunks go into all of its files at once.
"""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Unpack

from ..errors import InputError, OptionError, OptionWarning
from ..files.atomic import named
from ..files.overrides import Overrides, assignments
from ..rendering.options import FrameKeywords, FrameOptions, Keywords, Observers, TraceKeywords, TraceOptions
from ..rendering.rig import require_common_frames, simulators
from ..rendering.summary import Summary
from ..rendering.surroundings import Surroundings, surroundings_of, warn_of_surroundings
from ..scene.scene import Scene
from ..scene.scene_file import files_of_scene, load_scene
from ..sensor.catalogue import load_sensor
from ..sensor.model import Sensor, warn_of_doubts
from ..sensor.rig import Mounted, Rig
from .captures import captured_files, captures, makers
from .frame_files import FrameFiles
from .options import FRAMES, File, Outputs
from .plan import CLOUDS, Plan, check_writable, keep_inputs
from .size import warn_of_size
from .streams import Append, pulses_of_waveforms

Told = Callable[[int, int], object]
Named = str | os.PathLike[str]


class RecordKeywords(TraceKeywords, FrameKeywords, total=False):
    """What `record` takes as keywords: options of tracing and of the frame, and who is told of the progress."""

    trace: TraceOptions
    frame: FrameOptions
    progress: Told | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedCloud:
    """One cloud that was written: of a frame of one sensor, or of those of a rig that are merged.

    label    of the rig's sensor; "" for a single one, and for merged ones
    number   of the frame
    files    by what they are: "output" is the cloud, others are named in `Plan.files`
    summary  what happened in the frame
    """

    label: str
    number: int
    files: Mapping[str, Path]
    summary: Summary


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """What `record` wrote, cloud by cloud.

    surroundings  how each sensor stands in the scene as the first frame begins
    """

    clouds: tuple[RecordedCloud, ...]
    surroundings: tuple[Surroundings, ...]

    @property
    def summary(self) -> Summary:
        """Of all frames together."""
        return Summary.total([one.summary for one in self.clouds])

    @property
    def files(self) -> tuple[Path, ...]:
        """Of all frames, each once."""
        return tuple(dict.fromkeys(path for one in self.clouds for path in one.files.values()))


def record(
    scene: Named | Scene,
    sensor: Named | Sensor | Rig | None = None,
    *,
    outputs: Outputs | File,
    frames: int | None = None,
    overrides: Overrides = (),
    scene_overrides: Overrides = (),
    **options: Unpack[RecordKeywords],
) -> Recorded:
    """Render a frame, or so many ``frames`` one after the other, into the files of ``outputs``.

    scene            scene file, Mitsuba XML or `Scene`
    sensor           catalogue name, sensor file, `Sensor` or `Rig` (`load_rig`); the scene's own if None
    outputs          an `Outputs`, or the file of the cloud alone
    frames           how many, from the options' number on; None: one, whose cloud is the file `Outputs.path`
    overrides        changes to the sensor file's values: "detector.gain=60", a list of these, or {"detector.gain": 60}
    scene_overrides  changes to the scene file's values, likewise
    options          `TraceOptions` as ``trace`` and `FrameOptions` as ``frame``, or their fields; the pose is the
                     vehicle's if there is a rig. ``progress`` is told (done, pulses) of all frames
    Raises InputError and OutputError before anything is traced. No file that the run reads is written over.
    """
    changes = assignments(overrides)
    scene_changes = assignments(scene_overrides, name="scene_overrides")
    told = Observers(progress=options.pop("progress", None)).progress
    keywords = Keywords(options)
    trace, frame = keywords.take(TraceOptions), keywords.take(FrameOptions)
    keywords.end()
    if frames is not None:
        FRAMES.check("frames", frames)
    rig = sensor if isinstance(sensor, Rig) else None
    if changes and isinstance(sensor, Rig | Sensor):
        raise OptionError("{overrides}: must go with the name or file of a sensor, got a {0}", type(sensor).__name__)
    if isinstance(outputs, str | os.PathLike):
        outputs = Outputs(outputs)
    if not isinstance(outputs, Outputs):
        raise InputError(f"outputs: must be a file or Outputs, got {type(outputs).__name__}")
    plan = Plan(outputs, frames, rig is not None)
    plan.check(frame.coordinates, vectors=trace.vectors)
    before, since = Summary(), time.perf_counter()
    labels = [""] if rig is None else [one.label for one in rig.sensors]
    # Each group of sensors becomes one cloud: all of them when merged, else one at a time.
    groups = [labels] if outputs.merge else [[label] for label in labels]
    numbers = range(frame.number, frame.number + (frames or 1))
    clouds = [("" if outputs.merge else group[0], group, number) for number in numbers for group in groups]
    wanted = [plan.files(label, number) for label, _, number in clouds]
    # What can be refused is refused in order of its cost: names first, then files, then the world, then tracing.
    check_writable(plan.distinct(wanted))
    described = load_scene(scene, overrides=scene_changes)
    sensors = _sensors(described, sensor, changes, frame)
    _warn_of_thin_beams(trace, sensors)
    warn_of_doubts(one.sensor for one in sensors)
    warn_of_size(plan, sensors, trace, frame.chunk)
    packets = makers({one.label: one.sensor for one in sensors}, plan.format.profile or "") if outputs.packets else {}
    for (label, _, _), files in zip(clouds, wanted, strict=True):
        if label in packets:
            files |= captured_files(files["output"], packets[label])
    check_writable(plan.distinct(wanted))
    keep_inputs(wanted, [*_inputs(scene, scene_changes, sensor)])
    # Wrong pulse numbers are told now, not after an hour of tracing.
    if outputs.waveforms is not None:
        for mounted in sensors:
            pulses_of_waveforms(outputs, mounted.sensor)
    since = before.spent("load", since)
    if outputs.merge:
        require_common_frames(sensors, len(numbers))
    # Simulators are made once for all frames: worlds and compiled kernels are kept.
    made = dict(simulators(described, sensors, trace, pose=frame.pose if rig else None))
    for simulator in made.values():
        simulator.check_frames(numbers, begin_s=frame.begin_s)
    surroundings = tuple(surroundings_of(one, begin_s=frame.begin_s) for one in made.values())
    warn_of_surroundings(surroundings)
    before.spent("build", since)
    pulses = len(numbers) * sum(one.sensor.scanner.pulses for one in sensors)
    progress = None if told is None else _Progress(told, pulses)
    written: list[RecordedCloud] = []
    paths = {label: files["output"] for (label, _, _), files in zip(clouds, wanted, strict=True)}
    with ExitStack() as opened:
        bags = _bags(plan, wanted, opened)
        taken = opened.enter_context(captures(paths if packets else {}, packets))
        for (label, group, number), files in zip(clouds, wanted, strict=True):
            one = FrameFiles(
                plan=plan,
                scene=described,
                simulators={name: made[name] for name in group},
                frame=replace(frame, number=number, pose=None),
                files=files,
                placed=rig is not None or frame.pose is not None,
                # Loading and building happened once; the first frame is charged for it.
                summary=Summary(seconds={} if written else before.seconds),
                bags=bags,
                capture=taken.get(label),
            )
            one.write(progress)
            written.append(RecordedCloud(label=label, number=number, files=files, summary=one.summary))
    return Recorded(tuple(written), surroundings)


def _bags(plan: Plan, wanted: Sequence[Mapping[str, Path]], opened: ExitStack) -> dict[Path, Append]:
    """The files that hold the clouds of all frames, and what takes each cloud."""
    if not plan.is_bag or plan.format.frames is None:
        return {}
    paths = dict.fromkeys(files[key] for files in wanted for key in CLOUDS if key in files)
    return {path: named(path, opened.enter_context(plan.format.frames(path))) for path in paths}


def _sensors(
    scene: Scene, sensor: Named | Sensor | Rig | None, overrides: Sequence[str], frame: FrameOptions
) -> Sequence[Mounted]:
    """Those of the rig; or else the one that is asked for, or the scene's, without a label."""
    if isinstance(sensor, Rig):
        return sensor.sensors
    found = load_sensor(scene.sensor_name if sensor is None else sensor, overrides=overrides)
    return [Mounted(label="", sensor=found, pose=frame.pose or scene.sensor_pose)]


def _inputs(scene: Named | Scene, overrides: Sequence[str], sensor: Named | Sensor | Rig | None) -> Iterator[Path]:
    """The files that are read."""
    if not isinstance(scene, Scene):
        yield from files_of_scene(scene, overrides=overrides)
    if isinstance(sensor, Rig):
        yield from sensor.files
    elif sensor is not None and not isinstance(sensor, Sensor):
        yield Path(sensor)


def _warn_of_thin_beams(trace: TraceOptions, sensors: Sequence[Mounted]) -> None:
    """No mistake, but not what who asks for rays expects."""
    if trace.rays == 1:
        return
    thin = [one.sensor for one in sensors if not (one.sensor.laser.has_width or one.sensor.optics.halo)]
    for name in dict.fromkeys(sensor.name for sensor in thin):
        warnings.warn(
            OptionWarning(
                "{rays} {0} changes nothing: laser.divergence_mrad of '{1}' is 0; a width is given by {overrides} "
                "laser.divergence_mrad=3",
                trace.rays,
                name,
            ),
            stacklevel=3,
        )


class _Progress:
    """An observer of one frame after the other, which tells of the pulses of all of them."""

    def __init__(self, told: Told, pulses: int) -> None:
        self._told, self._pulses, self._before = told, pulses, 0

    def __call__(self, done: int, pulses: int) -> None:
        self._told(self._before + done, self._pulses)
        # A frame has ended: the next one counts from 0 again.
        if done == pulses:
            self._before += pulses
