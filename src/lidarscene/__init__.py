"""lidarscene: what an automotive direct-time-of-flight lidar would really report.

>>> import lidarscene
>>> cloud = lidarscene.render("scenes/car.toml", "table1-apd", seed=0)
>>> cloud.save("car.ply")
"""

from typing import TYPE_CHECKING, Any

from ._version import __version__ as __version__
from .files.facts import register_viewer

if TYPE_CHECKING:
    # isort: off
    # scene
    from .scene.scene_file import load_scene as load_scene
    from .scene.scene import Scene as Scene
    from .scene.scene import Body as Body
    from .scene.scene import Part as Part
    from .materials.material import Material as Material
    from .scene.scene import Sun as Sun
    from .scene.scene import Sky as Sky
    from .scene.scene import Air as Air
    from .maths.pose import Pose as Pose

    # sensor
    from .sensor.sensor_file import load_sensor as load_sensor
    from .sensor.sensor_model import Sensor as Sensor
    from .sensor.rig_file import load_rig as load_rig
    from .sensor.rig_file import Rig as Rig

    # simulation
    from .rendering.api import render as render
    from .rendering.api import render_frames as render_frames
    from .rendering.simulator import Simulator as Simulator
    from .rendering.live_simulator import LiveSimulator as LiveSimulator
    from .rendering.render_options import TraceOptions as TraceOptions
    from .rendering.render_options import FrameOptions as FrameOptions
    from .rendering.render_options import Observers as Observers

    # results
    from .cloud.point_cloud import PointCloud as PointCloud
    from .detection.outcomes import Status as Status
    from .detection.outcomes import Outcome as Outcome
    from .cloud.deskew import deskewed as deskewed
    from .labels.boxes import boxes as boxes

    # files
    from .outputs.record import record as record
    from .outputs.output_options import Outputs as Outputs

    # errors
    from .errors import LidarSceneError as LidarSceneError
    from .errors import InputError as InputError
    from .errors import OutputError as OutputError
    from .errors import BackendError as BackendError
    # isort: on

_HOME = {
    # scene
    "load_scene": "scene.scene_file",
    "Scene": "scene.scene",
    "Body": "scene.scene",
    "Part": "scene.scene",
    "Material": "materials.material",
    "Sun": "scene.scene",
    "Sky": "scene.scene",
    "Air": "scene.scene",
    "Pose": "maths.pose",
    # sensor
    "load_sensor": "sensor.sensor_file",
    "Sensor": "sensor.sensor_model",
    "load_rig": "sensor.rig_file",
    "Rig": "sensor.rig_file",
    # simulation
    "render": "rendering.api",
    "render_frames": "rendering.api",
    "Simulator": "rendering.simulator",
    "LiveSimulator": "rendering.live_simulator",
    "TraceOptions": "rendering.render_options",
    "FrameOptions": "rendering.render_options",
    "Observers": "rendering.render_options",
    # results
    "PointCloud": "cloud.point_cloud",
    "Status": "detection.outcomes",
    "Outcome": "detection.outcomes",
    "deskewed": "cloud.deskew",
    "boxes": "labels.boxes",
    # files
    "record": "outputs.record",
    "Outputs": "outputs.output_options",
    # errors
    "LidarSceneError": "errors",
    "InputError": "errors",
    "OutputError": "errors",
    "BackendError": "errors",
}

__all__ = ["__version__", *sorted(_HOME)]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use, so that importing the package costs nothing."""
    if name not in _HOME:
        raise AttributeError(f"module 'lidarscene' has no attribute '{name}'")
    import importlib

    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def _view(content: Any, **options: Any) -> Any:
    from .view.notebook import view_in_notebook

    return view_in_notebook(content, **options)


# `PointCloud.view` and `Scene.view` need the page, which is in a higher tier: it is registered here.
register_viewer(_view)


def __dir__() -> list[str]:
    return sorted(__all__)
