"""Layers: a cloud and the scene where it was made in; the points without the sensor's own motion out, or why not."""

from __future__ import annotations

from ..cloud.deskew import KEPT, deskewed
from ..cloud.points import PointCloud
from ..maths.arrays import Numbers
from ..maths.trajectory import Riding, pose_at
from ..scene.model import Scene

NO_SCENE = "no deskewed layer: name the cloud's scene too, which knows how the vehicle drove"
OTHER_SCENE = "no deskewed layer: the vehicle of this scene stands still"
SEVERAL = "no deskewed layer: the cloud is of several sensors; render it with --deskew"
RECORDED = "no deskewed layer: of a recording, how its vehicle drove is not known"


def still_m(cloud: PointCloud, scene: Scene | None) -> tuple[Numbers | None, str]:
    """(n, 3) positions in the world as if all points had been measured when the frame began, and why there are none.

    The cloud is in the world's coordinates if there is a scene. Its file has the time of each point and where the
    sensor stood at the start, not the way that it took.
    """
    if cloud.metadata.get("ego_motion") != KEPT:
        return None, ""
    if scene is None:
        return None, NO_SCENE
    if scene.ego is None:
        return None, OTHER_SCENE
    if len(cloud.sensor_names) > 1:
        return None, SEVERAL
    # The sensor stays where it is on its vehicle, which may be another place than the scene's own (--pose).
    on_vehicle = pose_at(scene.ego, cloud.frame_start_s).inverse() @ cloud.sensor_place
    return deskewed(cloud, Riding(carrier=scene.ego, pose=on_vehicle)).xyz_m, ""
