"""The catalogue: every sensor loads, and every number in it has a source."""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lidarscene import catalog
from lidarscene.errors import InputError
from lidarscene.materials.catalogue import material as catalogue_material
from lidarscene.sensor.catalogue import load_sensor


def tables_of(name: str) -> dict[str, Any]:
    return tomllib.loads((catalog.folder("sensors") / f"{name}.toml").read_text(encoding="utf-8"))


def number_keys(tables: dict[str, Any], prefix: str = "") -> Iterator[str]:
    """Dotted keys of all numbers, lists of numbers included."""
    for key, value in tables.items():
        if isinstance(value, dict):
            yield from number_keys(value, f"{prefix}{key}.")
        elif not isinstance(value, (str, bool)):
            yield prefix + key


def every_key(tables: dict[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in tables.items():
        yield prefix + key
        if isinstance(value, dict):
            yield from every_key(value, f"{prefix}{key}.")


def test_both_sensors_of_table_1_are_there() -> None:
    assert {"table1-apd", "table1-sipm"} <= set(catalog.names("sensors"))


@pytest.mark.parametrize("name", catalog.names("sensors"))
def test_sensor_loads_under_its_own_name(name: str) -> None:
    sensor = load_sensor(name)
    assert sensor.name == name
    assert sensor.description


@pytest.mark.parametrize("name", catalog.names("sensors"))
def test_every_number_has_a_source(name: str) -> None:
    """By its dotted key, or by its table's."""
    tables = tables_of(name)
    sources = tables.pop("sources")
    numbers = list(number_keys(tables))
    assert len(numbers) > 20
    without = [k for k in numbers if not sources.get(k, "") and not sources.get(k.partition(".")[0], "")]
    assert without == []
    assert set(sources) <= set(every_key(tables))


@pytest.mark.parametrize("name", catalog.names("materials"))
def test_material_loads(name: str) -> None:
    material = catalogue_material(name)
    assert material.name == name
    assert 0 <= material.at(905e-9)["reflectivity"] <= 1


def test_sensor_by_path(tmp_path: Path) -> None:
    text = (catalog.folder("sensors") / "table1-apd.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(
        text.replace('name = "table1-apd"', 'name = "mine"'), encoding="utf-8"
    )
    assert load_sensor(tmp_path / "mine.toml").name == "mine"
    assert load_sensor(str(tmp_path / "mine.toml")).name == "mine"


@pytest.mark.parametrize("name", ["../sensors/table1-apd", "/etc/passwd\0", "concret", ""])
def test_unknown_material(name: str) -> None:
    with pytest.raises(InputError, match=r"^no material '.*' in the catalogue; (did you mean|it has) "):
        catalogue_material(name)
