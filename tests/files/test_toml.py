"""TOML files: what is read and how it is checked; tests/cli/test_mistakes.py has what is refused."""

from pathlib import Path

import pytest
from pydantic import BaseModel

from lidarscene import catalog
from lidarscene.errors import InputError
from lidarscene.files.overrides import with_overrides
from lidarscene.files.toml import read_toml, validate
from lidarscene.scene.scene_file import scene_model
from lidarscene.sensor.sensor_file import SensorFile


def test_byte_order_mark_and_windows_lines_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_bytes('\ufeffname = "Käfer"\r\nx = 1\r\n'.encode())
    assert read_toml(tmp_path / "a.toml") == {"name": "Käfer", "x": 1}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"x = 1\nx = 2\n", "not valid TOML: Cannot overwrite a value (at line 2, column 6)"),
        (b"x = " + b"[" * 100_000, "not valid TOML: nested too deeply"),
        (b"x = " + b"1" * 5000, "cannot be read: "),
        (b"\xff\xfe", "not UTF-8 text (at line 1)"),
    ],
)
def test_what_is_not_toml(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_toml(path)
    assert str(caught.value).startswith(f"{path}: {message}")


class Inner(BaseModel):
    model_config = {"extra": "forbid"}
    x: int = 0


class Outer(BaseModel):
    rows: tuple[Inner, ...] = ()


def test_only_overrides_to_blame_are_named() -> None:
    tables = with_overrides({}, ["rows=[{ y = 1 }]", "z=3"])
    with pytest.raises(InputError) as caught:
        validate(Outer, tables, "file", overrides=["rows=[{ y = 1 }]", "z=3"])
    assert str(caught.value) == "file --set rows=[{ y = 1 }]: unknown key 'rows[0].y'; known here: x"


def test_type_that_is_missing_is_named() -> None:
    tables = read_toml(catalog.folder("sensors") / "table1-apd.toml")
    del tables["detector"]["type"]
    with pytest.raises(InputError, match=r"^file: key 'detector\.type' is missing$"):
        validate(SensorFile, tables, "file")


def test_a_scene_names_the_override_that_is_to_blame(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text('[[bodies]]\nname = "w"\nprimitive = "plane"\nsize_m = [4, 4]\nmaterial = "concrete"\n')
    assert scene_model(path, overrides=["bodies.w.scale=2", "sun.illuminance_klux=1"]).bodies[0].scale == 2
    with pytest.raises(InputError) as caught:
        scene_model(path, overrides=["sun.illuminance_klux=1", "bodies.w.scale=-2"])
    message = f'{path} --scene-set bodies.w.scale=-2: bodies[0 "w"].scale: must be > 0, got -2'
    assert str(caught.value) == message
