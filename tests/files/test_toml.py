"""TOML files: what is read and how it is checked; tests/cli/test_mistakes.py has what is refused."""

from pathlib import Path

from helpers.mistakes import calls, given_file
from pydantic import BaseModel

from lidarscene import catalog
from lidarscene.files.overrides import with_overrides
from lidarscene.files.toml import TABLES, read_toml, validate
from lidarscene.scene.scene_file import scene_model
from lidarscene.scene.tables import SceneFile
from lidarscene.sensor.sensor_file import SensorFile


def test_byte_order_mark_and_windows_lines_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_bytes('\ufeffname = "Käfer"\r\nx = 1\r\n'.encode())
    assert read_toml(tmp_path / "a.toml") == {"name": "Käfer", "x": 1}


class Inner(BaseModel):
    model_config = {"extra": "forbid"}
    x: int = 0


class Outer(BaseModel):
    rows: tuple[Inner, ...] = ()


def sensor_without(key: str) -> SensorFile:
    tables = read_toml(catalog.path_of("sensors", "table1-apd"))
    del tables["detector"][key]
    return validate(SensorFile, tables, "file")


def with_changes(*changes: str) -> Outer:
    return validate(Outer, with_overrides({}, changes), "file", overrides=changes)


WALL_ALONE = '[[bodies]]\nname = "w"\nprimitive = "plane"\nsize_m = [4, 4]\nmaterial = "concrete"\n'

test_mistakes = calls(
    (lambda: read_toml(given_file("a.toml", "x = 1\nx = 2\n")), "a.toml | TOML | line 2, column 6"),
    (lambda: read_toml(given_file("job.json", '{"scenes": 1}')), "job.json | TOML | JSON"),
    (lambda: read_toml(given_file("a.toml", "x = " + "[" * 100_000)), "a.toml | TOML | nested too deeply"),
    (lambda: read_toml(given_file("a.toml", "x = " + "1" * 5000)), "a.toml | read"),
    (lambda: read_toml(given_file("a.toml", b"\xff\xfe")), "a.toml | UTF-8 | line 1"),
    (lambda: with_changes("rows=[{ y = 1 }]", "z=3"), "file overrides rows=[{ y = 1 }]: | 'rows[0].y' | known here: x"),
    (lambda: sensor_without("type"), "file | 'detector.type'"),
    (
        lambda: scene_model(
            given_file("a.toml", WALL_ALONE), overrides=["sun.illuminance_klux=1", "bodies.w.scale=-2"]
        ),
        'a.toml scene_overrides bodies.w.scale=-2: | bodies[0 "w"].scale | > 0 | -2',
    ),
)


def test_keys_of_scenes_and_sensors_are_told_apart() -> None:
    """Rationale: `files` imports no model, so that it has the keys once more."""
    models = {"scene": SceneFile, "sensor": SensorFile}
    shared = SceneFile.model_fields.keys() & SensorFile.model_fields.keys()
    assert {kind: {*names} for kind, (_, names) in TABLES.items()} == {
        kind: model.model_fields.keys() - shared for kind, model in models.items()
    }
