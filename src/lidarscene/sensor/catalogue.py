"""The sensors of the catalogue, by name; sensor files too.

A name of the catalogue and a path are taken alike, so that a sensor of one's own needs no other call.
"""

from __future__ import annotations

import os
from pathlib import Path

from ..catalog import path_of
from ..errors import InputError, OptionError
from ..files.overrides import Overrides, assignments
from .file import read_sensor
from .model import Sensor
from .readout import PublishedFile, read_published


def load_sensor(sensor: str | os.PathLike[str] | Sensor, *, overrides: Overrides = ()) -> Sensor:
    """A sensor by catalogue name, or from a file if the name ends in .toml; a `Sensor` stays.

    overrides  changes to the file's values: "detector.gain=60", a list of these, or {"detector.gain": 60}
    Raises InputError.
    """
    changes = assignments(overrides)
    if isinstance(sensor, Sensor):
        if changes:
            raise OptionError("{overrides}: must go with the name or file of a sensor, got a Sensor")
        return sensor
    if not isinstance(sensor, str | os.PathLike):
        raise InputError(f"sensor: must be a name, a file or a Sensor, got {type(sensor).__name__}")
    name = os.fspath(sensor)
    return read_sensor(Path(name) if name.endswith(".toml") else path_of("sensors", name), overrides=changes)


def published(name: str) -> PublishedFile | None:
    """What the maker publishes of a catalogue sensor, if its file says so. Raises InputError."""
    return read_published(path_of("sensors", name))
