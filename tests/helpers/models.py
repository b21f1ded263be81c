"""Every file model by name."""

from types import UnionType
from typing import Any

from lidarscene.batch.job_file import JobFile
from lidarscene.files.toml import FileModel
from lidarscene.materials.material_file import MaterialFile
from lidarscene.scene.scene_file import SceneFile
from lidarscene.sensor.rig_file import RigFile
from lidarscene.sensor.sensor_file import SensorFile


def models(*roots: type[FileModel]) -> dict[str, type[FileModel]]:
    """These file models and all models inside them, by name."""
    found = {}
    todo: list[Any] = list(roots)
    while todo:
        one = todo.pop()
        if isinstance(one, type) and not isinstance(one, UnionType) and issubclass(one, FileModel):
            if one.__name__ not in found:
                found[one.__name__] = one
                todo += [info.annotation for info in one.model_fields.values()]
        else:
            todo += getattr(one, "__args__", ())
    return found


MODELS = models(SceneFile, SensorFile, MaterialFile, RigFile, JobFile)
