"""The sensors of the catalogue, by name; sensor files too.

A name of the catalogue and a path are taken alike, so that a sensor of one's own needs no other call.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ..catalog import path_of
from .file import read_sensor
from .model import Sensor
from .readout import PublishedFile, read_published


def load_sensor(sensor: str | os.PathLike[str] | Sensor, *, overrides: Sequence[str] = ()) -> Sensor:
    """A sensor by catalogue name, or from a file if the name ends in .toml; a `Sensor` stays.

    overrides  ``detector.gain=60``-like changes to the file's values
    Raises InputError.
    """
    if isinstance(sensor, Sensor):
        return sensor
    name = os.fspath(sensor)
    return read_sensor(
        Path(name) if name.endswith(".toml") else path_of("sensors", name), overrides=overrides
    )


def published(name: str) -> PublishedFile | None:
    """What the maker publishes of a catalogue sensor, if its file says so. Raises InputError."""
    return read_published(path_of("sensors", name))
