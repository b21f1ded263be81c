"""TOML files: what is read, what is overridden; tests/cli/test_mistakes.py has what is refused."""

import copy
from pathlib import Path

import pytest
from pydantic import BaseModel

from lidarscene import catalog
from lidarscene.errors import InputError
from lidarscene.files.toml import read_toml, toml_text, validated, with_overrides
from lidarscene.scene.file import scene_model
from lidarscene.sensor.file import SensorFile

TABLES = {"a": {"b": 1, "c": [1, 2]}, "name": "x"}


def test_byte_order_mark_and_windows_lines_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_bytes('\ufeffname = "Käfer"\r\nx = 1\r\n'.encode())
    assert read_toml(tmp_path / "a.toml") == {"name": "Käfer", "x": 1}


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"x = 1\nx = 2\n", "not valid TOML: Cannot overwrite a value (at line 2, column 6)"),
        (b"x = " + b"[" * 100_000, "not valid TOML: nested too deeply"),
        (b"x = " + b"1" * 5000, "cannot be read: "),
        (b"\xff\xfe", "not UTF-8 text (at line 1)"),
    ],
)
def test_what_is_not_toml(tmp_path: Path, content: bytes, told: str) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_toml(path)
    assert str(caught.value).startswith(f"{path}: {told}")


@pytest.mark.parametrize(
    ("assignment", "changed"),
    [
        ("a.b=2", {"a": {"b": 2, "c": [1, 2]}, "name": "x"}),
        ("a.b = 2.5e3 ", {"a": {"b": 2500.0, "c": [1, 2]}, "name": "x"}),
        ("a.c=[3, 4, 5]", {"a": {"b": 1, "c": [3, 4, 5]}, "name": "x"}),
        ("a={ d = true }", {"a": {"d": True}, "name": "x"}),
        ("e.f.g=1", {"a": {"b": 1, "c": [1, 2]}, "name": "x", "e": {"f": {"g": 1}}}),
        ("name=two words", {"a": {"b": 1, "c": [1, 2]}, "name": "two words"}),
        ('name="1"', {"a": {"b": 1, "c": [1, 2]}, "name": "1"}),
        ("name=a=b", {"a": {"b": 1, "c": [1, 2]}, "name": "a=b"}),
        ("name=1\ny=2", {"a": {"b": 1, "c": [1, 2]}, "name": "1\ny=2"}),
    ],
)
def test_override(assignment: str, changed: dict[str, object]) -> None:
    original = copy.deepcopy(TABLES)
    assert with_overrides(original, [assignment]) == changed
    assert original == TABLES


def test_last_override_holds() -> None:
    assert with_overrides({}, ["a=1", "a=2"]) == {"a": 2}


class Inner(BaseModel):
    model_config = {"extra": "forbid"}
    x: int = 0


class Outer(BaseModel):
    rows: tuple[Inner, ...] = ()


def test_only_overrides_to_blame_are_named() -> None:
    tables = with_overrides({}, ["rows=[{ y = 1 }]", "z=3"])
    with pytest.raises(InputError) as caught:
        validated(Outer, tables, "file", overrides=["rows=[{ y = 1 }]", "z=3"])
    assert str(caught.value) == "file --set rows=[{ y = 1 }]: unknown key 'rows[0].y'; known here: x"


def test_type_that_is_missing_is_named() -> None:
    tables = read_toml(catalog.folder("sensors") / "table1-apd.toml")
    del tables["detector"]["type"]
    with pytest.raises(InputError, match=r"^file: key 'detector\.type' is missing$"):
        validated(SensorFile, tables, "file")


BODIES = {"bodies": [{"name": "a", "x": 1, "motion": {"v": 2}}, {"name": "b"}]}


@pytest.mark.parametrize(
    ("assignment", "changed"),
    [
        ("bodies.a.x=3", [{"name": "a", "x": 3, "motion": {"v": 2}}, {"name": "b"}]),
        ("bodies.1.x=3", [{"name": "a", "x": 1, "motion": {"v": 2}}, {"name": "b", "x": 3}]),
        ("bodies.a.motion.v=3", [{"name": "a", "x": 1, "motion": {"v": 3}}, {"name": "b"}]),
        (
            "bodies.b.motion.v=3",
            [{"name": "a", "x": 1, "motion": {"v": 2}}, {"name": "b", "motion": {"v": 3}}],
        ),
    ],
)
def test_override_in_a_list_of_tables(assignment: str, changed: list[object]) -> None:
    original = copy.deepcopy(BODIES)
    assert with_overrides(original, [assignment]) == {"bodies": changed}
    assert original == BODIES


@pytest.mark.parametrize("assignment", ["bodies.c.x=1", "bodies.2.x=1", "bodies.-1.x=1", "bodies.a=1"])
def test_override_of_a_table_that_is_not_there(assignment: str) -> None:
    with pytest.raises(InputError) as caught:
        with_overrides(BODIES, [assignment], option="--scene-set")
    told = f"--scene-set {assignment}: must be bodies.NAME.KEY, with a name of a, b"
    assert str(caught.value) == told


@pytest.mark.parametrize(
    "value", [1, 2.5, 1e-9, True, 'x "y"', [1, [2.5, "z"]], {"a b": {"c": [1, {"d": False}]}}]
)
def test_toml_text_is_read_back(value: object) -> None:
    assert with_overrides({}, [f"a={toml_text(value)}"]) == {"a": value}


def test_a_scene_names_the_override_that_is_to_blame(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text('[[bodies]]\nname = "w"\nprimitive = "plane"\nsize_m = [4, 4]\nmaterial = "concrete"\n')
    assert scene_model(path, overrides=["bodies.w.scale=2", "sun.illuminance_klux=1"]).bodies[0].scale == 2
    with pytest.raises(InputError) as caught:
        scene_model(path, overrides=["sun.illuminance_klux=1", "bodies.w.scale=-2"])
    told = f'{path} --scene-set bodies.w.scale=-2: bodies[0 "w"].scale: must be > 0, got -2'
    assert str(caught.value) == told
