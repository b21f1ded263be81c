"""`check`: all mistakes of a file at once, and the doubts about what it describes, by the models of all files."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .. import catalog
from ..batch.job_file import JobFile
from ..batch.tasks import Job
from ..errors import InputError, OptionWarning
from ..files.arguments import checks_arguments
from ..files.toml import list_mistakes, read_toml
from ..materials.material import Material
from ..materials.material_file import MaterialFile, read_material
from ..recordings.opening import ONLY_RECORDINGS
from ..rendering.surroundings import warn_of_scene
from ..scene.scene import Scene
from ..scene.scene_file import load_scene, scene_from_model, scene_model, scene_path
from ..scene.tables import SceneFile
from ..sensor.imu import ImuModelFile, read_imu_model
from ..sensor.rig_file import Rig, RigFile, load_rig
from ..sensor.sensor_file import SensorFile, read_sensor
from ..sensor.sensor_model import Sensor, warn_of_doubts
from ..studies.design.design_study import load_study
from ..studies.design.study_file import StudyFile

FILE_MODELS: dict[str, Any] = {
    "scene": SceneFile,
    "sensor": SensorFile,
    "imu": ImuModelFile,
    "rig": RigFile,
    "material": MaterialFile,
    "job": JobFile,
    "design": StudyFile,
}
"""Kind of a file -> its model."""

READERS: dict[str, Any] = {
    "scene": load_scene,
    "sensor": read_sensor,
    "imu": read_imu_model,
    "rig": load_rig,
    "material": read_material,
    "job": Job.read,
    "design": load_study,
}
"""Kind of a file -> function that reads it, with all files that it names."""

DISTINCTIVE_KEYS = {
    "design": {"free", "objectives"},
    "job": {"scenes", "sweep", "seed_count"},
    "rig": {"sensors"},
    "sensor": {"laser", "detector", "tdc", "scanner", "optics"},
    "imu": {"gyroscope_noise_deg_s_sqrt_hz", "accelerometer_noise_ug_sqrt_hz"},
    "material": {"bsdf", "reflectivity"},
}
"""Tables and keys that only a file of this kind has. A job has sensors too: it is tested before a rig."""


@checks_arguments
def check(subject: str | os.PathLike[str] | Scene | Sensor | Rig | Material) -> list[str]:
    """Check a file, a scene, a sensor, a rig or a material, as `lidarscene check` does.

    Args:
        subject: file of any kind, name of an entry of the catalogue, `Scene`, `Sensor`, `Rig` or
            `Material`, which was checked when it was made

    Returns:
        a line for each mistake, then one for each doubt, which the command's exit code ignores; none without any
    """
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("always")
        if isinstance(subject, Scene | Sensor | Rig | Material):
            mistakes = []
            _warn_of_content(subject)
        else:
            mistakes = list(mistakes_of(Path(subject)))
    doubts = [str(warning.message) for warning in issued if isinstance(warning.message, OptionWarning)]
    for warning in issued:  # those of other packages are no findings
        if not isinstance(warning.message, OptionWarning):
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    return [*mistakes, *doubts]


def checked_path(path: Path) -> Path:
    """Path of a file to check; a word without a suffix is an entry of the catalogue, a scene first.

    Raises:
        InputError: for a name that no entry has
    """
    name = os.fspath(path)
    if catalog.is_bare(name) and not os.path.isfile(path) and name not in catalog.names("scenes"):
        for kind in ("examples", "sensors", "imus", "materials", "designs"):
            if name in catalog.names(kind):
                return catalog.path_of(kind, name)
    return scene_path(path)


def mistakes_of(path: Path) -> Iterator[str]:
    """Iterate over the mistakes of a file, a line each; doubts about what it describes are warnings."""
    try:
        path = checked_path(path)
        if path.suffix.lower() in ONLY_RECORDINGS:
            yield f"{path}: must be a file that describes something, such as a scene, got a recording"
            return
        if path.suffix.lower() != ".toml":
            yield from _mistakes_in_content("scene", path)
            return
        tables = read_toml(path)
        kind = _kind_of(tables)
        mistakes = list_mistakes(FILE_MODELS[kind], tables)
        yield from (f"{path}: {line}" for line in mistakes)
        if not mistakes:
            yield from _mistakes_in_content(kind, path)
    except InputError as error:
        yield str(error)


def _kind_of(tables: dict[str, Any]) -> str:
    """Kind of a file: that with the most of its DISTINCTIVE_KEYS; a scene if there are none."""
    counts = {kind: len(keys & tables.keys()) for kind, keys in DISTINCTIVE_KEYS.items()}
    best = max(counts, key=lambda kind: counts[kind])
    return best if counts[best] and "bodies" not in tables else "scene"


def _warn_of_content(content: Any) -> None:
    """Issue the doubts about a scene, a sensor or the sensors of a rig."""
    if isinstance(content, Scene):
        warn_of_scene(content)
    elif isinstance(content, Sensor):
        warn_of_doubts([content])
    elif isinstance(content, Rig):
        warn_of_doubts(mounted.sensor for mounted in content.sensors)


def _mistakes_in_content(kind: str, path: Path) -> Iterator[str]:
    """Mistakes that show only when all files it names are read: the first one, or in a scene one for each body."""
    try:
        _warn_of_content(READERS[kind](path))
        return
    except InputError as error:
        first = str(error)
    if kind != "scene" or path.suffix.lower() != ".toml":
        yield first
        return
    file, yielded = scene_model(path), set()
    for index, body in enumerate(file.bodies):
        try:
            scene_from_model(file.model_copy(update={"bodies": (body,)}), path=path)
        except InputError as error:
            # A body read alone has number 0.
            line = str(error).replace("bodies[0 ", f"bodies[{index} ", 1)
            if line not in yielded:
                yielded.add(line)
                yield line
    if not yielded:
        yield first
