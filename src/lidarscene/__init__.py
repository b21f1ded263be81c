"""lidarscene: what an automotive direct-time-of-flight lidar would really report.

>>> import lidarscene
>>> cloud = lidarscene.render("scenes/car.toml", "table1-apd", seed=0)
>>> cloud.save("car.ply")
"""

from typing import Any

import lazy_loader

from .files.installed_llvm import write_newest_path
from .files.late_binding import bind

# Public names stand in __init__.pyi, and are imported when first asked for: importing the package costs nothing.
_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_INSTEAD = {
    "batch": "`lidarscene batch JOB` renders a job; render_frames and record render in Python",
    "budget": "`lidarscene view CLOUD SCENE` shows the photon budget of each point",
    "check": "load_scene, load_sensor and load_rig check a file; `lidarscene check FILE` says what it holds",
    "street": "load_scene takes a scene file with [street]; `lidarscene street` writes one",
    "view": "clouds and scenes have .view() and .show(); `lidarscene view FILE` opens a browser",
}
"""Names that people try first, with the call that does it."""


def __getattr__(name: str) -> Any:
    """Return a public name; say what to call in place of one that is none."""
    try:
        return _public(name)
    except AttributeError:
        if name in _INSTEAD:
            raise AttributeError(f"lidarscene has no '{name}': {_INSTEAD[name]}") from None
        raise


def _view(content: Any, **options: Any) -> Any:
    from .view.notebook import view_in_notebook

    return view_in_notebook(content, **options)


def _draw(cloud: Any, **options: Any) -> Any:
    from .figures.pictures import draw_in_memory

    return draw_in_memory(cloud, **options)


def _boxes(cloud: Any, scene: Any, **options: Any) -> Any:
    from .labels.boxes import boxes

    return boxes(cloud, scene, **options)


def _deskew(cloud: Any, motion: Any, **options: Any) -> Any:
    from .cloud.deskew import deskewed

    return deskewed(cloud, motion, **options)


def _draw_scene(scene: Any) -> Any:
    from .figures.panels import draw_scene

    return draw_scene(scene)


def _draw_sensor(sensor: Any) -> Any:
    from .studies.sensor_picture import draw_sensor

    return draw_sensor(sensor)


def _replace_scene(scene: Any, changes: Any) -> Any:
    from .scene.scene_file import replaced_scene

    return replaced_scene(scene, changes)


def _save_scene(scene: Any, path: Any) -> None:
    from .scene.saving import save_scene

    save_scene(scene, path)


# Methods of `PointCloud`, `Scene` and `Sensor` call these by name.
bind(
    view=_view,
    draw=_draw,
    draw_scene=_draw_scene,
    draw_sensor=_draw_sensor,
    boxes=_boxes,
    deskew=_deskew,
    replace_scene=_replace_scene,
    save_scene=_save_scene,
)

write_newest_path()  # for a program that imports Dr.Jit or Mitsuba by itself after lidarscene
