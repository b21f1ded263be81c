"""Every file model by name."""

from typing import Any

from lidarscene.batch.job_file import JobFile
from lidarscene.files.toml import FileModel
from lidarscene.materials.material_file import MaterialFile
from lidarscene.scene.tables import SceneFile
from lidarscene.sensor.rig_file import RigFile
from lidarscene.sensor.sensor_file import SensorFile
from lidarscene.studies.design.study_file import StudyFile


def models(*roots: type[FileModel]) -> dict[str, type[FileModel]]:
    """These file models and all models inside them, by name."""
    by_name = {}
    todo: list[Any] = list(roots)
    while todo:
        model = todo.pop()
        if isinstance(model, type) and issubclass(model, FileModel):
            if model.__name__ not in by_name:
                by_name[model.__name__] = model
                todo += [info.annotation for info in model.model_fields.values()]
        else:
            todo += getattr(model, "__args__", ())
    return by_name


FILES = (SceneFile, SensorFile, MaterialFile, RigFile, JobFile, StudyFile)
MODELS = models(*FILES)
