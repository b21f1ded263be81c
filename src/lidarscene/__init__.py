"""lidarscene: what an automotive direct-time-of-flight lidar would really report.

>>> import lidarscene
>>> cloud = lidarscene.render("scenes/car.toml", "table1-apd", seed=0)
>>> cloud.save("car.ply")
"""

import importlib
import sys
from types import ModuleType
from typing import Any

import lazy_loader

from .errors import question
from .files.installed_llvm import write_newest_path
from .files.late_binding import bind
from .maths.attributes import meaning_of

# Public names stand in __init__.pyi, and are imported when first asked for: importing the package costs nothing.
_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_FUNCTIONS = ("batch", "materials", "view")
"""Packages whose names are public functions, too."""

_FOREIGN_NAMES = {
    "catalog": "sensors(), scenes() and materials() list names",
    **dict.fromkeys(("examples", "demo", "example"), "scenes() lists what render takes: render('car')"),
    "help": "help(lidarscene.render) explains a call; dir(lidarscene) lists them",
    **dict.fromkeys(
        ("load", "read", "open", "io", "from_file", "cloud"),
        "load_cloud, load_scene, load_sensor and load_rig read files",
    ),
    **dict.fromkeys(
        ("load_mesh", "mesh", "Mesh", "TriangleMesh"),
        "load_scene(file) reads one as a scene; scene.add(file, 'brick') adds it",
    ),
    **dict.fromkeys(("load_material", "material"), "Material(name) reads one; materials() lists them"),
    **dict.fromkeys(
        ("simulate", "run", "scan", "trace", "raycast", "ray_cast", "simulation"),
        "render(scene, sensor) renders a frame",
    ),
    **dict.fromkeys(("Lidar", "LiDAR", "sensor"), "Sensor(name) reads one; sensors() lists them"),
    **dict.fromkeys(("World", "scene"), "Scene(name) reads one; scenes() lists them"),
    **dict.fromkeys(("optimize", "optimise", "search"), "design(study, folder) searches the designs of a study"),
    **dict.fromkeys(("stream", "publish"), "`lidarscene stream` sends packets; cloud.save('a.mcap') writes a bag"),
    **dict.fromkeys(
        ("Dataset", "dataset", "generate", "random", "render_batch"),
        "street(seed) makes scenes; batch(job, folder) writes data sets, of which load_cloud(path) reads a cloud",
    ),
    **dict.fromkeys(
        ("snr", "link_budget", "detection_probability", "detection_range", "range"),
        "max_range(sensors, distance=100) has range, SNR and P_d; budget(cloud, scene, sensor) that of points",
    ),
    **dict.fromkeys(
        ("plot", "show", "draw", "visualize", "visualise", "viz", "vis"),
        "clouds, scenes, sensors and reports have .plot(); view(cloud)",
    ),
    **dict.fromkeys(("save", "write", "export"), "clouds, scenes, sensors and reports have .save(path)"),
    **dict.fromkeys(("weather", "fog", "rain"), "render('car', scene_overrides={'weather.fog_visibility_km': 0.1})"),
    **dict.fromkeys(("noise", "noise_model"), "noise follows from the sensor, which sensor.replace(...) changes"),
    **dict.fromkeys(("info", "describe", "summary"), "print(Sensor(name)), print(Scene(name))"),
    **dict.fromkeys(
        ("config", "settings", "options", "set_backend", "backend", "device"),
        "nothing is set for all calls: options go with a call, and a GPU is used where there is one",
    ),
    **dict.fromkeys(("doctor", "test", "diagnose", "check_install"), "`lidarscene doctor` looks over the installation"),
    **dict.fromkeys(("seed", "set_seed", "random_seed"), "a frame has its seed: render(scene, sensor, seed=1)"),
    **dict.fromkeys(
        ("Laser", "Detector", "Scanner", "Optics", "Imu"), "parts of a sensor are changed by Sensor(name).replace(...)"
    ),
    **dict.fromkeys(
        ("Motion", "Trajectory", "Transform", "Vector"),
        "Pose.from_degrees(position_m=(0, 0, 1.8), yaw_deg=90) is a pose",
    ),
    **dict.fromkeys(
        ("animate", "video", "Frame", "frame", "sequence", "drive"),
        "render_frames(scene, sensor, frames=10) has several frames",
    ),
    **dict.fromkeys(("light", "camera", "lamp"), "Scene(name).replace(...) changes sun, sky, lamps and camera"),
    **dict.fromkeys(("load_recording", "recording"), "open_recording(file) reads one"),
    **dict.fromkeys(("false_alarm_rate", "photon_budget"), "budget(cloud, scene, sensor) has that of points"),
    **dict.fromkeys(("validate", "lint"), "check(file) lists mistakes and doubts"),
    **dict.fromkeys(("version",), "lidarscene.__version__"),
    "waveform": "Simulator(scene, sensor).waveforms([0]) has those of pulses",
}
"""Names that people try first, with the call that does it."""


def __getattr__(name: str) -> Any:
    """Return a public name; say what to call in place of one that is none."""
    if name in _FUNCTIONS:
        return importlib.import_module(f".{name}", __name__)
    try:
        return _public(name)
    except AttributeError:
        if name.startswith("_"):  # what Python and libraries look for
            raise
        public = {entry: question([entry]) for entry in __all__}
        meant = meaning_of(name, public, _FOREIGN_NAMES) or "dir(lidarscene) lists the names"
        raise AttributeError(f"lidarscene has no '{name}'; {meant}") from None


def _function_of_package(name: str) -> Any:
    """Return the function that has a package's name; the package stays the attribute."""
    function = _public(name)
    globals()[name] = sys.modules[f"{__name__}.{name}"]
    return function


class _CalledPackage(ModuleType):
    """Package that does what a function of its name would do, or says what does it."""

    @property
    def __signature__(self) -> Any:
        """Signature of the function, for help and editors."""
        from inspect import signature

        return signature(_function_of_package(self.__name__.rpartition(".")[2]))

    def __reduce__(self) -> tuple[Any, ...]:
        return importlib.import_module, (self.__name__,)

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        name = self.__name__.rpartition(".")[2]
        if name in _FUNCTIONS:
            return _function_of_package(name)(*arguments, **options)
        raise TypeError(f"lidarscene.{name} is no function; {_FOREIGN_NAMES[name]}")


class _Lidarscene(ModuleType):
    """This package: its packages become attributes of it when they are imported, and hide what has their names."""

    def __setattr__(self, name: str, value: Any) -> None:
        if isinstance(value, ModuleType) and (name in _FUNCTIONS or name in _FOREIGN_NAMES):
            value.__class__ = _CalledPackage
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Lidarscene

# Methods and constructors of lower tiers call these by name.
bind(
    boxes="lidarscene.labels.boxes:boxes",
    check_material="lidarscene.materials.material_file:check_material",
    deskew="lidarscene.cloud.deskew:deskewed",
    draw="lidarscene.figures.pictures:draw_in_memory",
    draw_scene="lidarscene.figures.panels:draw_scene",
    draw_sensor="lidarscene.studies.sensor_picture:draw_sensor",
    load_cloud="lidarscene.cloud.point_cloud:load_cloud",
    load_material="lidarscene.materials.material_file:catalogue_material",
    load_rig="lidarscene.sensor.rig_file:load_rig",
    load_scene="lidarscene.scene.scene_file:load_scene",
    load_sensor="lidarscene.sensor.sensor_file:load_sensor",
    max_range="lidarscene.studies.api:max_range",
    replace_scene="lidarscene.scene.scene_file:replaced_scene",
    save_scene="lidarscene.scene.saving:save_scene",
    view="lidarscene.view.notebook:view_in_notebook",
)

write_newest_path()  # for a program that imports Dr.Jit or Mitsuba by itself after lidarscene
