"""Number of points on each body of a scene against its distance, from one traced frame of each sensor.

The density of pulses per solid angle does not say how many points a pedestrian has at 50 m; this does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...cloud.point_cloud import PointCloud
from ...detection.outcomes import Status
from ...maths.pose import Pose
from ...rendering.rig_simulators import simulators
from ...scene.scene import Scene
from ...sensor.rig_file import Mounted


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyPoints:
    """Echoes of one body in one sensor's frame; a false alarm has the truth of its beam, but is on no body.

    Attributes:
        label: class of the body
        distance_m: median of the points' true ranges
        points: number of points
    """

    body: str
    label: str
    distance_m: float
    points: int


def points_on_bodies(
    scene: Scene, sensors: Sequence[Mounted], *, vehicle: Pose | None = None, seed: int = 0
) -> list[tuple[str, list[BodyPoints]]]:
    """Trace a frame with each sensor; returns sensor labels with the points on each body, from near to far.

    Bodies without a class or without a point are left out.

    Args:
        vehicle: pose in the scene of the frame in which sensors are mounted; the scene's sensor pose if None

    Raises:
        BackendError: if Mitsuba has no back end that works on this machine
    """
    place = scene.sensor_pose if vehicle is None else vehicle
    rendered = simulators(scene, sensors, pose=place)
    return [(label, _points_by_body(simulator.render(seed=seed))) for label, simulator in rendered]


def _points_by_body(cloud: PointCloud) -> list[BodyPoints]:
    assert cloud.body is not None
    assert cloud.class_id is not None
    assert cloud.true_range_m is not None
    bodies, is_echo = [], cloud.status == Status.ECHO
    for body in np.unique(cloud.body[is_echo & (cloud.body >= 0)]):
        on_body = is_echo & (cloud.body == body)
        label = cloud.class_names[int(cloud.class_id[on_body][0])] if cloud.class_id[on_body][0] >= 0 else ""
        if label:
            bodies.append(
                BodyPoints(
                    body=cloud.body_names[int(body)],
                    label=label,
                    points=int(on_body.sum()),
                    distance_m=float(np.median(cloud.true_range_m[on_body])),
                )
            )
    return sorted(bodies, key=lambda points: points.distance_m)
