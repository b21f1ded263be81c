"""TOML files: what is read, what is overridden; tests/cli/test_mistakes.py has what is refused."""

import copy
from pathlib import Path

import pytest
from pydantic import BaseModel

from lidarscene import catalog
from lidarscene.errors import InputError
from lidarscene.io.sensor_file import SensorFile
from lidarscene.io.toml_file import read_toml, validated, with_overrides

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
