"""Rigs: several sensors on one vehicle, and the TOML files that describe them.

Each sensor simulates on its own: a rig adds only names and places. Sensor files are named relative to the rig file, so
that a rig can be copied with its sensors. An override may name one sensor or reach all.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Protocol

from pydantic import Field, model_validator

from ..catalog import file_or_example, located_sensor
from ..errors import InputError, placed
from ..files.arguments import checks_arguments
from ..files.late_binding import read_by_name
from ..files.overrides import Overrides, assignments, split_sensor
from ..files.toml import FileModel, read_toml, validate
from ..maths.attributes import HintedAttributes
from ..maths.pose import Pose
from .imu import Imu, ImuFile
from .parts import located_parts
from .pose_file import PoseFile
from .sensor_file import load_sensor
from .sensor_model import Sensor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mounted(HintedAttributes):
    """Sensor of a rig with its ``pose`` on the vehicle, to which its own mounting is added."""

    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {"name": "mounted.label, mounted.sensor.name"}

    label: str
    sensor: Sensor
    pose: Pose = field(default_factory=Pose)

    @property
    def placed(self) -> Sensor:
        """Sensor whose mounting is its full pose on the vehicle."""
        return replace(self.sensor, mounting=self.pose @ self.sensor.mounting)


@read_by_name("load_rig")
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig(HintedAttributes):
    """The sensors of a vehicle, each with a unique label; ``files`` are those that it was read from.

    ``Rig("rig")`` is `load_rig`.

    Attributes:
        imu: the vehicle's own, or None
    """

    MADE_BY: ClassVar[str] = 'Rig("rig") reads the name of an example or a file'
    CHANGED_BY: ClassVar[str] = "dataclasses.replace(rig, imu=None) is another rig"
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("__getitem__", "lidars", "names", "labels", "poses"), "rig.sensors"),
        **dict.fromkeys(("render", "record"), "lidarscene.record(scene, rig, outputs=...)"),
        "add": "a rig's file has a table [[sensors]] for each",
    }

    name: str
    sensors: tuple[Mounted, ...]
    imu: Imu | None = None
    files: tuple[Path, ...] = ()

    if TYPE_CHECKING:  # the fields, or what `read_by_name` reads

        def __init__(self, file: str | os.PathLike[str] = ..., /, **values: Any) -> None: ...


class SensorLookup(Protocol):
    """Function that loads a sensor, such as `load_sensor`."""

    def __call__(self, sensor: str, /, *, overrides: Sequence[str]) -> Sensor:
        """Load the sensor of this catalogue name or file."""


MOST_SENSORS = 256


class MountedFile(PoseFile):
    """[[sensors]]: one sensor, and where it is on the vehicle."""

    label: Annotated[str, Field(min_length=1)] = Field(
        description="names the sensor's files: letters, digits, - and _ ; each once"
    )
    sensor: Annotated[str, Field(min_length=1)] = Field(
        description="catalogue name, or a file (a name that ends in .toml)"
    )
    set: tuple[str, ...] = Field(
        default=(),
        description=('changes to the sensor\'s values, such as `"detector.gain=60"`; `--set` comes after them'),
    )

    @model_validator(mode="after")
    def _plain(self) -> MountedFile:
        if not re.fullmatch(r"[\w-]+", self.label, re.ASCII):
            raise ValueError(f"label: must be letters, digits, - and _, got '{self.label}'")
        return self


class RigFile(FileModel):
    """A whole rig file."""

    name: str = Field(default="", description="for people; the file's name if empty")
    sensors: Annotated[tuple[MountedFile, ...], Field(min_length=1, max_length=MOST_SENSORS)] = Field(
        description="sensors and their poses"
    )
    imu: ImuFile | None = Field(default=None, description="the vehicle's IMU; none if left out")

    @model_validator(mode="after")
    def _distinct_labels(self) -> RigFile:
        labels = [mounted.label for mounted in self.sensors]
        repeated = sorted({label for label in labels if labels.count(label) > 1})
        if repeated:
            raise ValueError(f"labels must be unique, got '{repeated[0]}' twice")
        return self


@checks_arguments
def load_rig(rig: Annotated[str | os.PathLike[str] | Rig, "a file or a Rig"], *, overrides: Overrides = ()) -> Rig:
    """Load a rig from a TOML file, or the catalogue's example by its name; a `Rig` is returned unchanged.

    Args:
        overrides: KEY=VALUE for every sensor, or LABEL:KEY=VALUE for that one, after its own

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    return rig if isinstance(rig, Rig) else read_rig(file_or_example(rig), overrides=assignments(overrides))


def read_rig(path: Path, *, sensor: SensorLookup = load_sensor, overrides: Sequence[str] = ()) -> Rig:
    """`load_rig`; ``sensor`` finds a sensor by catalogue name or path, with overrides applied."""
    file = validate(RigFile, read_toml(path), str(path))
    labels = [entry.label for entry in file.sensors]
    changes = [split_sensor(assignment, labels) for assignment in overrides]
    mounted = []
    for index, entry in enumerate(file.sensors):
        name = located_sensor(entry.sensor, path.parent)
        entry_changes = [
            *located_parts(entry.set, path.parent),
            *(text for target, text in changes if target in (None, entry.label)),
        ]
        try:
            built = sensor(name, overrides=entry_changes)
        except InputError as error:
            raise placed(f'{path}: sensors[{index} "{entry.label}"]', error) from None
        mounted.append(Mounted(label=entry.label, sensor=built, pose=entry.pose()))
    imu = None
    if file.imu is not None:
        try:
            imu = file.imu.build(path.parent)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    files = [path, *(path.parent / entry.sensor for entry in file.sensors if entry.sensor.endswith(".toml"))]
    if file.imu is not None:
        files += file.imu.files(path.parent)
    return Rig(name=file.name or path.stem, sensors=tuple(mounted), imu=imu, files=tuple(files))
