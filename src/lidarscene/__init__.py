"""lidarscene: what an automotive direct-time-of-flight lidar would really report.

>>> import lidarscene
>>> cloud = lidarscene.render("scenes/car.toml", "table1-apd", seed=0)
>>> cloud.save("car.ply")
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .api import load_rig as load_rig
    from .api import load_scene as load_scene
    from .api import load_sensor as load_sensor
    from .api import render as render
    from .api import render_frames as render_frames
    from .cloud import PointCloud as PointCloud
    from .deskew import deskewed as deskewed
    from .errors import BackendError as BackendError
    from .errors import InputError as InputError
    from .errors import LidarSceneError as LidarSceneError
    from .errors import OutputError as OutputError
    from .geometry import Pose as Pose
    from .scene import Scene as Scene
    from .sensor import Sensor as Sensor
    from .simulate import Simulator as Simulator

_HOME = {
    "render": "api",
    "render_frames": "api",
    "load_rig": "api",
    "deskewed": "deskew",
    "load_scene": "api",
    "load_sensor": "api",
    "PointCloud": "cloud",
    "Pose": "geometry",
    "Scene": "scene",
    "Sensor": "sensor",
    "Simulator": "simulate",
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
