"""Light: a World, a Sensor and some pulses in, their Echoes out as numpy: the chain up to the detector, once more."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .. import beams, echoes
from ..echoes import Ambient, Echoes
from ..geometry import Pose
from ..sensor import Sensor
from . import device
from .trace import trace
from .world import World

Matrix = np.ndarray[Any, Any]


def light_of(
    world: World, sensor: Sensor, ambient: Ambient, *, sun: Matrix, place: Pose, pulse: Matrix, seed: int
) -> Echoes:
    """What these pulses bring back.

    sun    (3,) unit vector towards the sun
    place  of the sensor in the world, its mounting included
    pulse  (n,) pulse numbers
    seed   of the frame, which the pointing jitter follows
    """
    equipment = device.opaque(sensor)
    rays = beams.fire(
        equipment,
        pulse=device.uint32(pulse),
        origin_m=_numbers(place.position_m - world.centre_m),
        rotation=_numbers(place.rotation),
        seed=device.opaque_uint32(seed),
    )
    hits = trace(world, rays, sun=_numbers(sun))
    light = echoes.receive(rays, hits, equipment, device.opaque(ambient))
    columns = {field.name: getattr(light, field.name) for field in dataclasses.fields(light)}
    device.start(list(columns.values()))  # together, or each would be traced for itself
    return Echoes(**{name: column.numpy() for name, column in columns.items()})


def _numbers(values: Matrix) -> Any:
    return device.opaque(tuple(float(x) for x in values.ravel()))
