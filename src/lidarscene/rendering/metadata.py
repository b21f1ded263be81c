"""Metadata: what a cloud says of the frame that it is.

A file that is found years later says how it was made: scene and sensor by name, seed, number and poses.
"""

from __future__ import annotations

import numpy as np

from ..cloud.deskew import MOTION_KEPT
from ..formats.cloud_columns import SENSOR_TO_WORLD
from ..maths.arrays import Numbers
from ..scene.scene import Scene
from ..sensor.detectors import Apd
from ..sensor.model import Sensor
from .frame import Frame
from .options import FrameOptions


def metadata_of(scene: Scene, sensor: Sensor, now: Frame, asked: FrameOptions) -> dict[str, str]:
    """Of a frame that was asked for so; the key `frame` says in which coordinates its points are."""
    from .._version import __version__

    metadata = {
        "software": "lidarscene",
        "version": __version__,
        "scene": scene.name,
        "sensor": sensor.name,
        "seed": str(asked.seed),
        "intensity_unit": _intensity_unit(sensor),
        "frame": asked.coordinates,
        "frame_number": str(now.number),
        "frame_start_s": repr(now.start_s),
        SENSOR_TO_WORLD: _text(np.column_stack([now.place.rotation, now.place.position_m])),
    }
    if now.moves:
        metadata["ego_motion"] = MOTION_KEPT
    if asked.coordinates != "sensor":
        goal = now.goal(asked.coordinates)
        metadata["sensor_position_m"] = _text(goal.position_m)
        metadata["sensor_rotation"] = _text(goal.rotation)
    return metadata


def _intensity_unit(sensor: Sensor) -> str:
    if sensor.intensity is not None:
        return {"range_corrected": "W", "reflectivity": "of 255"}[sensor.intensity.kind]
    if sensor.histogram is not None:
        return "photons"
    return "A" if isinstance(sensor.detector, Apd) else "cells"


def _text(values: Numbers) -> str:
    return " ".join(repr(float(x)) for x in values.ravel())
