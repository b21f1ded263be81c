"""Tasks: a job in, its frames out, each named by the hash of all that it depends on."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import itertools
import json
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from .. import catalog
from .._version import __version__
from ..errors import InputError, warn
from ..files.overrides import key_path, toml_text
from ..formats.registry import FORMATS
from ..rendering.render_options import FrameOptions, TraceOptions
from ..rendering.rig_simulators import require_common_frames
from ..rendering.surroundings import sun_doubts
from ..scene.foreign import is_xml
from ..scene.scene_file import files_of_scene, scene_model, scene_path, sensor_of_scene
from ..sensor.parts import located_parts
from ..sensor.rig_file import load_rig, read_rig
from ..sensor.sensor_file import files_of_sensor, load_sensor
from ..sensor.sensor_model import Sensor
from .dataset import Drive, Place, Places
from .job_file import JobFile, RangeFile, TrajectoryFile

LAYOUT = 1
"""Version of names and rows, part of every key; a new number makes all old results unknown."""

NOT_IN_WORLD = frozenset({"name", "description", "sun", "sky", "air", "weather", "sensor", "picture"})
"""Tables of a scene file that a compiled world does not depend on."""

NOT_IN_STREET = (
    NOT_IN_WORLD
    | {"ego", "own_car", "motion", "materials", "material", "base_materials", "interference", "ground", "reach_m"}
    | {"wet", "parked_share", "walking_spacing_m", "speed_m_s", "oncoming_gap_m", "ahead", "behind", "stop_share"}
    | {"laps", "shown_m"}
)
"""Keys of a scene file, at any depth, that change no place: light, paint, and who drives, walks and parks there."""

Parameters = tuple[tuple[str, Any], ...]
Rule = RangeFile | tuple[Any, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneChoice:
    """A scene file with changes to it.

    Attributes:
        parameters: swept keys with their values
        trajectory: label of the trajectory, or ""
        content: hash of the content of all its files
        digest: hash of the content, the file's name and the changes
        world: hash of all that its compiled worlds depend on
        street: hash of what stands where, by which drives through one place are known
    """

    path: str
    overrides: tuple[str, ...]
    parameters: Parameters
    trajectory: str
    content: str
    digest: str
    world: str
    street: str

    def drawn(self, rules: Mapping[str, Rule], seed: int) -> SceneChoice:
        """Choice of a drive with this seed: further changes by `DrawsFile.rules`."""
        if not rules:
            return self
        parameters = _draw(rules, [self.digest, seed])
        changes = _assignments(parameters)
        return replace(
            self,
            overrides=(*self.overrides, *changes),
            parameters=(*self.parameters, *parameters),
            digest=digest_of_data([self.digest, list(changes)]),
            world=digest_of_data([self.world, _in_world(changes)]),
            street=digest_of_data([self.street, _in_street(changes)]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorChoice:
    """A sensor, or one sensor of a rig, with changes to it.

    Attributes:
        name: catalogue name or file; "" for a rig
        rig: rig file; "" for a single sensor
        label: label of the rig's sensor
        content: hash of the content of all its files, or all the rig's
    """

    name: str
    rig: str
    label: str
    overrides: tuple[str, ...]
    parameters: Parameters
    content: str

    @property
    def vehicle(self) -> str:
        """Hash of all that the sensor depends on, or all sensors of its rig."""
        return digest_of_data([self.content, list(self.overrides)])

    @property
    def digest(self) -> str:
        """Hash of all that the sensor depends on."""
        return digest_of_data([self.vehicle, self.label])

    def drawn(self, rules: Mapping[str, Rule], seed: int) -> SensorChoice:
        """Choice of a drive with this seed: further changes by `DrawsFile.rules`."""
        parameters = _draw(rules, [self.vehicle, seed])
        overrides = (*self.overrides, *_assignments(parameters))
        return replace(self, overrides=overrides, parameters=(*self.parameters, *parameters))


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTask:
    """One frame of one sensor. Equal keys are equal clouds, so that nothing is done twice.

    Attributes:
        deskew: whether the cloud is without the sensor's own motion
        own_car: whether it has the points on the vehicle that carries the sensor
        all_around: whether KITTI's boxes are those outside the picture too
        place: place in a data set, which is part of the key; None without one
    """

    key: str
    version: str
    scene: SceneChoice
    sensor: SensorChoice
    trace: TraceOptions
    frame: FrameOptions
    format: str
    truth: bool
    deskew: bool
    own_car: bool
    all_around: bool
    place: Place | None = None

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return 1

    @property
    def parameters(self) -> dict[str, Any]:
        """Swept keys, as the manifest names them, and their values."""
        scene_parameters = {f"scene.{key}": value for key, value in self.scene.parameters}
        return scene_parameters | {f"sensor.{key}": value for key, value in self.sensor.parameters}


@dataclass(frozen=True, slots=True)
class Job:
    """A checked job: where its file is, what the file says, and its scenes with the sensors that see each of them."""

    path: Path
    file: JobFile
    choices: tuple[tuple[SceneChoice, tuple[SensorChoice, ...]], ...]

    @classmethod
    def read(cls, path: Path) -> Job:
        """Read a job file and check every scene and sensor file that it names.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        from .job_file import read_job

        file = read_job(path)
        FORMATS[file.format].require()
        try:
            job = cls(path.resolve(), file, tuple(_choices(file, path.parent)))
            job._check_draws()
            job.places()
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        for klux in file.sweep.scene_values().get("sun.illuminance_klux", ()):
            for doubt in sun_doubts(klux):
                warn(doubt)
        return job

    def _check_draws(self) -> None:
        """Raise InputError for a draw that a scene or sensor file refuses, or that names another file."""
        draws, checked = self.file.draws, set[str]()
        for scene, sensors in self.choices:
            for key, change in _ends(draws.rules("scene")):
                if scene_content(Path(scene.path), (*scene.overrides, change)) != scene.content:
                    raise InputError(f"draws.scene.{key}: must not name files; sweep them")
            for sensor in sensors:
                if sensor.vehicle in checked:
                    continue
                checked.add(sensor.vehicle)
                for key, change in _ends(draws.rules("sensor")):
                    content = rig_content if sensor.rig else sensor_content
                    if content(sensor.rig or sensor.name, (*sensor.overrides, change)) != sensor.content:
                        raise InputError(f"draws.sensor.{key}: must not name parts of other sensors; sweep them")

    def __len__(self) -> int:
        """Number of frames."""
        return self.file.frames * len(self.file.all_seeds()) * sum(len(s) for _, s in self.choices)

    def places(self) -> Places | None:
        """Places of the frames in the data set; None without one.

        Raises:
            InputError: for a part that would be empty
        """
        if self.file.dataset is None:
            return None
        return Places(self.file, itertools.starmap(_drive, self._drives()))

    def _drives(self) -> Iterator[tuple[SceneChoice, SensorChoice, int]]:
        draws = self.file.draws
        for scene, sensors in self.choices:
            for sensor, seed in itertools.product(sensors, self.file.all_seeds()):
                yield scene.drawn(draws.rules("scene"), seed), sensor.drawn(draws.rules("sensor"), seed), seed

    def tasks(self) -> Iterator[FrameTask]:
        """Iterate over all frames, those of one world consecutively; there may be millions."""
        file, trace, places = self.file, self.file.trace_options(), self.places()
        for scene, sensor, seed in self._drives():
            places_of_drive = itertools.repeat(None) if places is None else places.of_drive(_drive(scene, sensor, seed))
            for number, place in zip(range(file.frames), places_of_drive, strict=False):
                frame = file.frame_options(seed, number)
                form = {
                    "format": file.format,
                    "truth": file.truth,
                    "deskew": file.is_deskewed,
                    "own_car": file.own_car,
                    "all_around": file.all_around,
                }
                settings = cloud_settings(trace, frame) | form
                if place is not None:
                    # A frame of a whole drive is put into its place when the drive is written.
                    settings |= {"dataset": place.dataset} if place.is_whole_drive else dataclasses.asdict(place)
                key = digest_of_data([LAYOUT, __version__, scene.digest, sensor.digest, settings])
                yield FrameTask(
                    key=key,
                    version=__version__,
                    scene=scene,
                    sensor=sensor,
                    trace=trace,
                    frame=frame,
                    place=place,
                    **cast(dict[str, Any], form),
                )


def _drive(scene: SceneChoice, sensor: SensorChoice, seed: int) -> Drive:
    return Drive(street=scene.street, run=digest_of_data([scene.digest, sensor.vehicle, seed]), label=sensor.label)


def cloud_settings(trace: TraceOptions, frame: FrameOptions) -> dict[str, Any]:
    """Options that a cloud depends on, by the keys of a job file; not the chunk, which changes nothing."""
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

    job_sensors = tuple(catalog.located_sensor(sensor, folder.absolute()) for sensor in file.sensors)
    for name in file.scenes:
        path = folder / name if Path(name).suffix else scene_path(name)
        for trajectory in file.trajectories or (None,):
            for parameters in _points(file.sweep.scene_values()):
                scene = _scene_choice(path, trajectory, parameters, folder)
                scene_sensors = () if job_sensors or file.rigs else (sensor_of_scene(path, overrides=scene.overrides),)
                yield scene, sensors(job_sensors or scene_sensors)


def _points(values: dict[str, tuple[Any, ...]]) -> Iterator[Parameters]:
    """Iterate over the product of all keys' values; one empty tuple where there are no keys."""
    for point in itertools.product(*values.values()):
        yield tuple(zip(values, point, strict=True))


def _draw(rules: Mapping[str, Rule], of: Sequence[Any]) -> Parameters:
    """Draw a value for each key, anew for each drive, which ``of`` identifies; no draw depends on the other keys."""
    drawn = []
    for key, rule in rules.items():
        share = int(digest_of_data([*of, key]), 16) / 16**32
        drawn.append((key, rule.value(share) if isinstance(rule, RangeFile) else rule[int(share * len(rule))]))
    return tuple(drawn)


def _ends(rules: Mapping[str, Rule]) -> Iterator[tuple[str, str]]:
    """Iterate over the keys of draws, each with a change that must be allowed for all of its draws to be."""
    for key, rule in rules.items():
        for value in (rule.low, rule.high) if isinstance(rule, RangeFile) else rule:
            (change,) = _assignments(((key, value),))
            yield key, change


def _assignments(parameters: Parameters) -> tuple[str, ...]:
    return tuple(f"{key}={toml_text(value)}" for key, value in parameters)


def _scene_choice(path: Path, trajectory: TrajectoryFile | None, parameters: Parameters, folder: Path) -> SceneChoice:
    changes = _assignments(parameters)
    overrides = (*([trajectory.override(folder)] if trajectory else []), *changes)
    portable = (*([trajectory.override()] if trajectory else []), *changes)  # the same in any folder
    content = scene_content(path, overrides)
    return SceneChoice(
        path=str(path.absolute()),
        overrides=overrides,
        parameters=parameters,
        trajectory=trajectory.label if trajectory else "",
        content=content,
        digest=digest_of_data([path.stem, content, list(portable)]),
        world=digest_of_data([content, _in_world(portable)]),
        street=digest_of_data([_street(path, content), _in_street(changes)]),
    )


def _in_world(changes: Iterable[str]) -> list[str]:
    return [change for change in changes if key_path(change)[0] not in NOT_IN_WORLD]


def _in_street(changes: Iterable[str]) -> list[str]:
    return [change for change in changes if not NOT_IN_STREET.intersection(key_path(change))]


@functools.lru_cache(maxsize=1000)
def _street(path: Path, content: str) -> str:
    """Hash of what stands where in a scene file with this content, whatever the light, the paint and the traffic."""
    if is_xml(path):
        return content
    model = scene_model(path)
    standing = [body for body in model.bodies if not all(body.motions())]
    tables = model.model_dump(mode="json") | {"bodies": [body.model_dump(mode="json") for body in standing]}
    meshes = [_digest(path.parent / body.mesh) for body in standing if body.mesh]
    return digest_of_data([_without_keys(tables, {*NOT_IN_STREET, "extends", "mesh"}), meshes])


def _without_keys(value: Any, keys: Collection[str]) -> Any:
    """Plain data without these keys, at any depth."""
    if isinstance(value, dict):
        return {key: _without_keys(inner, keys) for key, inner in value.items() if key not in keys}
    return [_without_keys(inner, keys) for inner in value] if isinstance(value, list) else value


def scene_content(path: Path, overrides: Sequence[str]) -> str:
    """Hash of a scene file and of all files that it names but the sensor's.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    sensor = Path(sensor_of_scene(path, overrides=overrides))
    return digest_of_data([_digest(file) for file in files_of_scene(path, overrides=overrides) if file != sensor])


def _sensors(file: JobFile, names: tuple[str, ...], folder: Path) -> Iterator[SensorChoice]:
    """Iterate over the choices of sensors by name, and of the sensors of rigs."""
    for parameters in _points(file.sweep.sensor_values()):
        overrides = tuple(located_parts(_assignments(parameters), folder))
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
            path = str(catalog.file_or_example(rig, folder).absolute())
            content = rig_content(path, overrides)
            sensors = load_rig(path, overrides=overrides).sensors
            if file.dataset == "nuscenes":
                require_common_frames(sensors, file.frames)
            for label in (mounted.label for mounted in sensors):
                yield SensorChoice(
                    name="", rig=path, label=label, overrides=overrides, parameters=parameters, content=content
                )


def sensor_content(name: str, overrides: Sequence[str]) -> str:
    """Hash of the files of a sensor with these changes, which are checked.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    load_sensor(name, overrides=overrides)
    files = files_of_sensor(catalog.sensor_path(name), overrides=overrides)
    return digest_of_data([_digest(file) for file in files])


def rig_content(path: str, overrides: Sequence[str]) -> str:
    """Hash of the files of a rig and of its sensors with these changes, which are checked.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    digests = [_digest(Path(path))]

    def sensor(name: str, /, *, overrides: Sequence[str]) -> Sensor:
        digests.append(sensor_content(name, overrides))
        return load_sensor(name, overrides=overrides)

    read_rig(Path(path), sensor=sensor, overrides=overrides)
    return digest_of_data(digests)


def digest_of_data(value: Any) -> str:
    """Hash of plain data: 128 bits, in hexadecimal."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _digest(path: Path) -> str:
    """Hash of a file's content; "" where there is no file, since reading it will raise the error."""
    if not os.path.isfile(path):
        return ""
    status = path.stat()
    return _digest_of(str(path.absolute()), status.st_size, status.st_mtime_ns)


@functools.lru_cache(maxsize=100_000)
def _digest_of(path: str, size: int, modified_ns: int) -> str:
    """Hash of the content of a file with this size and time of change: cached until one of them differs."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
