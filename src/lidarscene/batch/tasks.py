"""Tasks: a job in, its frames out, each named by the hash of all that it follows from."""

from __future__ import annotations

import functools
import hashlib
import itertools
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import catalog
from .._version import __version__
from ..errors import InputError
from ..files.overrides import toml_text
from ..formats.registry import FORMATS
from ..rendering.options import FrameOptions, TraceOptions
from ..scene.scene_file import files_of_scene, scene_path, sensor_of_scene
from ..sensor.catalogue import load_sensor
from ..sensor.file import files_of_sensor
from ..sensor.model import Sensor
from ..sensor.rig_file import load_rig, read_rig
from .file import JobFile, TrajectoryFile

LAYOUT = 1
"""Of names and rows; a new number makes all old results unknown."""

NOT_IN_WORLD = frozenset({"name", "description", "sun", "sky", "air", "weather", "sensor", "picture"})
"""Tables of a scene file that a compiled world does not depend on."""

Parameters = tuple[tuple[str, Any], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneChoice:
    """A scene file with changes to it.

    parameters  swept keys with their values
    content     hash of the content of all its files
    digest      the same with the file's name and the changes
    world       hash of what its compiled worlds depend on
    """

    path: str
    overrides: tuple[str, ...]
    parameters: Parameters
    trajectory: str
    content: str
    digest: str
    world: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorChoice:
    """A sensor, or the one of a rig with this label, with changes to it; a catalogue name or a file.

    content  hash of the content of all its files, or all the rig's, and of the changes
    digest   the same with the label
    """

    name: str
    rig: str
    label: str
    overrides: tuple[str, ...]
    parameters: Parameters
    content: str

    @property
    def digest(self) -> str:
        """Hash of all that it follows from."""
        return _hash([self.content, self.label])


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTask:
    """One frame of one sensor. Equal keys are equal clouds, so that nothing is done twice."""

    key: str
    version: str
    scene: SceneChoice
    sensor: SensorChoice
    trace: TraceOptions
    frame: FrameOptions
    format: str
    truth: bool

    @property
    def parameters(self) -> dict[str, Any]:
        """Every key that is swept, as the manifest names it."""
        of_scene = {f"scene.{key}": value for key, value in self.scene.parameters}
        return of_scene | {f"sensor.{key}": value for key, value in self.sensor.parameters}


@dataclass(frozen=True, slots=True)
class Job:
    """A checked job: its file, and its scenes with the sensors that see each of them."""

    file: JobFile
    choices: tuple[tuple[SceneChoice, tuple[SensorChoice, ...]], ...]

    @classmethod
    def read(cls, path: Path) -> Job:
        """From a job file. Every scene and sensor file that it names is checked. Raises InputError."""
        from .file import read_job

        file = read_job(path)
        FORMATS[file.format].require()
        try:
            return cls(file, tuple(_choices(file, path.parent)))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    def __len__(self) -> int:
        """How many frames."""
        return self.file.frames * len(self.file.all_seeds()) * sum(len(s) for _, s in self.choices)

    def tasks(self) -> Iterator[FrameTask]:
        """All frames; those of one world follow each other. Made one by one: there may be millions."""
        file, trace = self.file, self.file.trace_options()
        for scene, sensors in self.choices:
            for sensor, seed, number in itertools.product(sensors, file.all_seeds(), range(file.frames)):
                frame = file.frame_options(seed, number)
                how = told_of(trace, frame) | {"format": file.format, "truth": file.truth}
                key = _hash([LAYOUT, __version__, scene.digest, sensor.digest, how])
                yield FrameTask(
                    key=key,
                    version=__version__,
                    scene=scene,
                    sensor=sensor,
                    trace=trace,
                    frame=frame,
                    format=file.format,
                    truth=file.truth,
                )


def told_of(trace: TraceOptions, frame: FrameOptions) -> dict[str, Any]:
    """What a cloud follows from, by the keys of a job file: its chunk changes nothing."""
    return {
        "seed": frame.seed,
        "number": frame.number,
        "begin_s": frame.begin_s,
        "coordinates": frame.coordinates,
        "rays": trace.rays,
        "interactions": trace.interactions,
    }


def _choices(file: JobFile, folder: Path) -> Iterator[tuple[SceneChoice, tuple[SensorChoice, ...]]]:
    @functools.cache
    def sensors(names: tuple[str, ...]) -> tuple[SensorChoice, ...]:
        return tuple(_sensors(file, names, folder))

    given = tuple(_located(one, folder) for one in file.sensors)
    for name in file.scenes:
        path = folder / name if Path(name).suffix else scene_path(name)
        for trajectory in file.trajectories or (None,):
            for parameters in _points(file.sweep.of_scene()):
                scene = _scene_choice(path, trajectory, parameters, folder)
                own = () if given or file.rigs else (sensor_of_scene(path, overrides=scene.overrides),)
                yield scene, sensors(given or own)


def _points(values: dict[str, tuple[Any, ...]]) -> Iterator[Parameters]:
    """Every value of every key with every other; once nothing where there are no keys."""
    for point in itertools.product(*values.values()):
        yield tuple(zip(values, point, strict=True))


def _assignments(parameters: Parameters) -> tuple[str, ...]:
    return tuple(f"{key}={toml_text(value)}" for key, value in parameters)


def _scene_choice(path: Path, trajectory: TrajectoryFile | None, parameters: Parameters, folder: Path) -> SceneChoice:
    told = _assignments(parameters)
    overrides = (*([trajectory.override(folder)] if trajectory else []), *told)
    named = (*([trajectory.override()] if trajectory else []), *told)  # wherever the folder is
    content = scene_content(path, overrides)
    in_world = [one for one in named if one.partition("=")[0].partition(".")[0].strip() not in NOT_IN_WORLD]
    return SceneChoice(
        path=str(path.absolute()),
        overrides=overrides,
        parameters=parameters,
        trajectory=trajectory.label if trajectory else "",
        content=content,
        digest=_hash([path.stem, content, list(named)]),
        world=_hash([content, in_world]),
    )


def scene_content(path: Path, overrides: Sequence[str]) -> str:
    """Hash of a scene file and of all that it names but the sensor. Raises InputError."""
    sensor = Path(sensor_of_scene(path, overrides=overrides))
    return _hash([_digest(one) for one in files_of_scene(path, overrides=overrides) if one != sensor])


def _sensors(file: JobFile, names: tuple[str, ...], folder: Path) -> Iterator[SensorChoice]:
    """The choices of sensors by name, and those of rigs."""
    for parameters in _points(file.sweep.of_sensor()):
        overrides = _assignments(parameters)
        for name in names:
            yield SensorChoice(
                name=name,
                rig="",
                label="",
                overrides=overrides,
                parameters=parameters,
                content=sensor_content(name, overrides),
            )
        for rig in file.rigs:
            path = str((folder / rig).absolute())
            content = rig_content(path, overrides)
            for label in (one.label for one in load_rig(path, overrides=overrides).sensors):
                yield SensorChoice(
                    name="", rig=path, label=label, overrides=overrides, parameters=parameters, content=content
                )


def _located(name: str, folder: Path) -> str:
    """A catalogue name as it is, a file in the job's folder."""
    return str((folder / name).absolute()) if name.endswith(".toml") else name


def sensor_content(name: str, overrides: Sequence[str]) -> str:
    """Hash of a sensor: its files, and the changes. Raises InputError."""
    load_sensor(name, overrides=overrides)
    path = Path(name) if name.endswith(".toml") else catalog.path_of("sensors", name)
    return _hash([[_digest(one) for one in files_of_sensor(path, overrides=overrides)], list(overrides)])


def rig_content(path: str, overrides: Sequence[str]) -> str:
    """Hash of a rig: its file, its sensors and the changes to them. Raises InputError."""
    found = [_digest(Path(path))]

    def sensor(name: str, /, *, overrides: Sequence[str]) -> Sensor:
        found.append(sensor_content(name, overrides))
        return load_sensor(name, overrides=overrides)

    read_rig(Path(path), sensor=sensor, overrides=overrides)
    return _hash(found)


def _hash(value: Any) -> str:
    """128 bits of a hash of plain data, as text."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _digest(path: Path) -> str:
    """Hash of a file's content; of nothing where there is no file, which reading it will tell."""
    if not os.path.isfile(path):
        return ""
    about = path.stat()
    return _digest_of(str(path.absolute()), about.st_size, about.st_mtime_ns)


@functools.lru_cache(maxsize=100_000)
def _digest_of(path: str, size: int, modified_ns: int) -> str:
    """Of a file that has this size since then: not read again until it changes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
