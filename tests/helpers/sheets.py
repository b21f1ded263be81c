"""Scenes of files that a module has in common, and their grounds without roughness: each is built once."""

from functools import lru_cache
from pathlib import Path

from lidarscene.physics.road.roughness import RoughSurface
from lidarscene.scene.ground import Ground, lay
from lidarscene.scene.scene import Scene
from lidarscene.scene.scene_file import load_scene, scene_model
from lidarscene.sensor.pose_file import PoseFile

FLAT = RoughSurface.draw("flat", 0)


@lru_cache(maxsize=4)
def scene_of(path: Path) -> Scene:
    """The scene of a file that does not change."""
    return load_scene(path)


@lru_cache(maxsize=16)
def grounds(path: Path, *class_names: str) -> Ground:
    """The sheets of classes in a scene file, but for those that lie on others."""
    sheets = [
        lay(body.pose() @ place.pose(), plan=body.plan(), crown_m=body.crown_m, surface=FLAT)
        for body in scene_model(path).bodies
        if body.primitive == "ground" and not body.on_ground and body.class_name in class_names
        for place in body.instances or [PoseFile()]
    ]
    return Ground(surface=FLAT, sheets=sheets)
