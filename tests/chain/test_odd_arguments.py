"""Odd arguments of every public function: each call succeeds, or says in one line which argument is wrong.

One argument at a time is odd. What would take long is left out by a stand-in: what is asked is what comes before it.
"""

import inspect
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.command_line import WALL
from helpers.mistakes import told
from helpers.recordings import OUSTER
from helpers.run_seed import chosen

import lidarscene
from lidarscene import LidarSceneError, Report, Scene
from lidarscene.files.arguments import type_hints
from lidarscene.maths.trajectory import Course

ODD = {
    "None": None, "-1": -1, "nan": np.nan, "inf": np.inf, "no text": "", "text": "x" * 10, "bytes": b"x", "list": [],
    "list of one": [object()], "dict": {}, "object": object(), "array": np.arange(6.0).reshape(2, 3),
    "large": 10**40, "complex": 1j, "path": Path("no/such"), "True": True,
}  # fmt: skip
SLOW = (
    "view.notebook.Viewed.show",
    "studies.design.design_study.run_study",
    "studies.field_of_view.field_of_view_study.field_of_view_study",
    "studies.compare.comparison_study.compare_sensors",
    "studies.compare.comparison_study.compare_clouds",
    "studies.fit.recording_fit.fit_recordings",
    "studies.fit.on_scene.scene_fit.fit_on_scene",
    "studies.twin.twin_files.build_twin",
    "studies.twin.certificate.certify_sensor",
    "studies.twin.certificate.certify_in_twin",
    "outputs.record._Run.write",
    "rendering.simulator.Simulator.render",
)
SENSORS = {"sensors": "table1-apd"}
FUNCTIONS: dict[str, dict[str, Any]] = {
    "batch": {"job": "no.toml", "output": "out"},
    "budget": {"cloud": small_cloud(), "scene": "wall.toml", "sensor": "table1-apd"},
    "boxes": {"cloud": small_cloud(), "scene": Scene()},
    "certify": {"recording": OUSTER},
    "check": {"subject": "wall.toml"},
    "compare": {"scene": "wall.toml", "sensors": ["table1-apd", "vlp-16"]},
    "deskewed": {"cloud": small_cloud(), "motion": Course()},
    "design": {"study": "gain", "folder": "out"},
    "eye_safety": SENSORS,
    "fit": {"recordings": OUSTER, "sensor": "os0-128"},
    "fov": SENSORS,
    "load_cloud": {"path": "cloud.ply"},
    "load_rig": {"rig": "rig"},
    "load_scene": {"scene": "wall.toml"},
    "load_sensor": {"sensor": "table1-apd"},
    "materials": {},
    "max_range": SENSORS,
    "open_recording": {"path": OUSTER},
    "record": {"scene": "wall.toml", "sensor": "sensor.toml", "outputs": "out/a.ply"},
    "render": {"scene": "wall.toml", "sensor": "sensor.toml"},
    "render_frames": {"scene": "wall.toml", "sensor": "sensor.toml", "frames": 1},
    "scenes": {},
    "sensitivities": SENSORS,
    "sensors": {},
    "street": {"osm": "no.osm"},
    "sweep": {**SENSORS, "over": "distance", "points": 2},
    "twin": {"recording": OUSTER, "folder": "out"},
    "view": {"content": small_cloud()},
    "Simulator": {"scene": "wall.toml", "sensor": "sensor.toml"},
    "LiveSimulator": {"scene": "wall.toml", "sensor": "sensor.toml"},
    "FrameOptions": {},
    "Observers": {},
    "Outputs": {"path": "out/a.ply"},
    "TraceOptions": {},
}
METHODS: list[tuple[Callable[[], Any], str, dict[str, Any]]] = [
    (small_cloud, "column", {"name": "x"}),
    (small_cloud, "colours", {}),
    (small_cloud, "plot", {}),
    (small_cloud, "save", {"path": "b.ply"}),
    (small_cloud, "select", {"mask_or_index": slice(2)}),
    (Scene, "add", {"mesh": (np.eye(3), np.array([[0, 1, 2]])), "material": "brick"}),
    (lambda: lidarscene.load_sensor("table1-apd"), "replace", {}),
    (lambda: lidarscene.load_sensor("table1-apd"), "source_of", {"key": "laser"}),
    (lambda: Report("a"), "add_heading", {"text": "a"}),
    (lambda: Report("a"), "add_table", {"header": ["a"], "rows": [["b"]]}),
    (lambda: Report("a"), "plot", {}),
    (lambda: Report("a"), "save", {"folder": "out"}),
    (lambda: Report("a"), "write", {"name": "a", "path": "a.csv"}),
]
NO_FUNCTIONS = {
    "Air", "BackendError", "Body", "DeviceCloud", "InputError", "LidarSceneError", "Material", "Outcome", "OutputError",
    "Part", "PointCloud", "Pose", "Report", "Rig", "Scene", "Sensor", "Sky", "Status", "Sun", "__version__",
}  # fmt: skip
"""Types that hold data, and errors."""


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with a wall, a small sensor and a cloud; nothing takes long there."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wall.toml").write_text(WALL)
    small_cloud().save(tmp_path / "cloud.ply")
    text = (Path(lidarscene.__file__).parent / "catalog/sensors/table1-apd.toml").read_text("utf-8")
    (tmp_path / "sensor.toml").write_text(text, "utf-8")
    for name in SLOW:
        monkeypatch.setattr(f"lidarscene.{name}", lambda *_, **__: ("", Report("a")))


def names_of(function: Callable[..., Any]) -> list[str]:
    """Names of all arguments, with those of its keywords."""
    names = []
    for name, parameter in inspect.signature(function).parameters.items():
        hint = type_hints(function.__init__ if isinstance(function, type) else function).get(name)
        if parameter.kind is parameter.VAR_KEYWORD and typing.get_origin(hint) is typing.Unpack:
            names += list(typing.get_args(hint)[0].__annotations__)  # of its bases, too
        elif parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            names.append(name)
    return names


def call_oddly(function: Callable[..., Any], good: dict[str, Any]) -> None:
    """Every argument, with every odd value."""
    wrong = []
    for name in names_of(function):
        for words, odd in ODD.items():
            try:
                function(**(good | {name: odd}))
            except LidarSceneError as error:
                if "\n" in str(error):
                    wrong.append((name, words, str(error)))
            except Exception as error:
                wrong.append((name, words, f"{type(error).__name__}: {error}"))
    assert not wrong


@pytest.mark.filterwarnings("ignore::lidarscene.errors.OptionWarning")
@pytest.mark.usefixtures("mi")
@pytest.mark.parametrize("name", chosen(6, list(FUNCTIONS)))
def test_functions(name: str) -> None:
    of_package = name in lidarscene._FUNCTIONS
    function = lidarscene._function_of_package(name) if of_package else getattr(lidarscene, name)
    call_oddly(function, FUNCTIONS[name])


@pytest.mark.filterwarnings("ignore::lidarscene.formats.category_array.UnknownNameWarning")
@pytest.mark.parametrize(("owner", "name", "good"), METHODS, ids=[name for _, name, _ in METHODS])
def test_methods(owner: Callable[[], Any], name: str, good: dict[str, Any]) -> None:
    call_oddly(getattr(owner(), name), good)


def test_no_function_is_left_out() -> None:
    assert {*FUNCTIONS, *NO_FUNCTIONS} == set(lidarscene.__all__)


def test_an_unknown_keyword_and_a_missing_argument_are_named() -> None:
    with told("option 'wokers' | study, folder"):
        lidarscene.design("gain", "out", wokers=3)
    with pytest.raises(lidarscene.InputError, match=r"^design\(\): must have study, folder; folder is missing$"):
        lidarscene.design("gain")
    with pytest.raises(lidarscene.InputError, match=r"^record\(\): must have scene, outputs; .* missing, got output$"):
        lidarscene.record("car", output="a.ply")  # type: ignore[call-arg]
    with pytest.raises(lidarscene.InputError, match=r"^compare\(\): scene is given twice; .* are scene$"):
        lidarscene.compare(["apd-905", "sipm-905"], scene="car")  # type: ignore[misc]
    with pytest.raises(lidarscene.InputError, match=r"got 3; the others go by name: overrides=, .*start=, stop="):
        lidarscene.sweep("apd-905", "detector.gain", [20, 50])  # type: ignore[misc]
