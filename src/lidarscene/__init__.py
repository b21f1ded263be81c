"""lidarscene: what an automotive direct-time-of-flight lidar would really report.

>>> import lidarscene
>>> cloud = lidarscene.render("scenes/car.toml", "table1-apd", seed=0)
>>> cloud.save("car.ply")
"""

from typing import TYPE_CHECKING, Any

from ._version import __version__ as __version__

if TYPE_CHECKING:
    from .cloud.deskew import deskewed as deskewed
    from .cloud.points import PointCloud as PointCloud
    from .errors import BackendError as BackendError
    from .errors import InputError as InputError
    from .errors import LidarSceneError as LidarSceneError
    from .errors import OutputError as OutputError
    from .maths.pose import Pose as Pose
    from .rendering.api import render as render
    from .rendering.api import render_frames as render_frames
    from .rendering.simulator import Simulator as Simulator
    from .scene.file import load_scene as load_scene
    from .scene.model import Scene as Scene
    from .sensor.catalogue import load_sensor as load_sensor
    from .sensor.model import Sensor as Sensor
    from .sensor.rig_file import load_rig as load_rig

_HOME = {
    "render": "rendering.api",
    "render_frames": "rendering.api",
    "load_rig": "sensor.rig_file",
    "deskewed": "cloud.deskew",
    "load_scene": "scene.file",
    "load_sensor": "sensor.catalogue",
    "PointCloud": "cloud.points",
    "Pose": "maths.pose",
    "Scene": "scene.model",
    "Sensor": "sensor.model",
    "Simulator": "rendering.simulator",
    "LidarSceneError": "errors",
    "InputError": "errors",
    "OutputError": "errors",
    "BackendError": "errors",
}

__all__ = ["__version__", *sorted(_HOME)]


def __getattr__(name: str) -> Any:
    """Public names are imported when first asked for, so that importing the package costs nothing."""
    if name not in _HOME:
        raise AttributeError(f"module 'lidarscene' has no attribute '{name}'")
    import importlib

    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
