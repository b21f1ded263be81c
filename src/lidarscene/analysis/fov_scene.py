"""Points on each body of a scene against its distance: the one part of these studies that traces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..geometry import Pose
from ..scene import Scene
from ..sensor import Sensor

Matrix = np.ndarray[Any, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class OnBody:
    """What one frame of a sensor has on a body: echoes, the median of their ranges, its class."""

    body: str
    label: str
    distance_m: float
    points: int


def points_on_bodies(scene: Scene, sensor: Sensor, *, seed: int = 0) -> list[OnBody]:
    """One frame of the sensor at the scene's sensor pose, without its mounting; bodies from near to far.

    Bodies without a class are left out, and those without a point. Needs a back end.
    """
    from ..simulate import Simulator

    cloud = Simulator(scene, replace(sensor, mounting=Pose())).render(seed=seed)
    assert cloud.body is not None
    assert cloud.class_id is not None
    assert cloud.true_range_m is not None
    found = []
    for body in np.unique(cloud.body[cloud.body >= 0]):
        own = cloud.body == body
        label = cloud.class_names[int(cloud.class_id[own][0])] if cloud.class_id[own][0] >= 0 else ""
        if label:
            found.append(
                OnBody(
                    body=cloud.body_names[int(body)], label=label, points=int(own.sum()),
                    distance_m=float(np.median(cloud.true_range_m[own])),
                )
            )  # fmt: skip
    return sorted(found, key=lambda one: one.distance_m)
