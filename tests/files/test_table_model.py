"""Every number of every table has bounds, by which a value in SI units is known as one."""

import math
import tomllib
from collections.abc import Iterator
from contextlib import nullcontext
from typing import Annotated, Any

import pytest
from helpers.mistakes import told
from helpers.run_seed import chosen

from lidarscene import catalog
from lidarscene.batch.job_file import JobFile
from lidarscene.errors import InputError
from lidarscene.files.table_model import Number
from lidarscene.files.toml import FileModel, validate
from lidarscene.materials.material_file import MaterialFile
from lidarscene.maths.units import UNITS
from lidarscene.scene.tables import SceneFile
from lidarscene.sensor.rig_file import RigFile
from lidarscene.sensor.sensor_file import SensorFile

FILES = {"sensor": SensorFile, "scene": SceneFile, "rig": RigFile, "material": MaterialFile, "job": JobFile}

LOW, HIGH = {"minimum", "exclusiveMinimum"}, {"maximum", "exclusiveMaximum"}


def numbers(schema: Any, place: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every number in a JSON Schema, with where it is."""
    if isinstance(schema, list):
        for entry in schema:
            yield from numbers(entry, place)
    elif isinstance(schema, dict):
        if schema.get("type") in ("number", "integer"):
            yield place, schema
        for key, inner in schema.items():
            if key not in ("default", "not", "examples", "enum", "const"):
                yield from numbers(inner, f"{place}/{key}")


@pytest.mark.parametrize("kind", FILES)
def test_every_number_has_bounds(kind: str) -> None:
    """Rationale: what has none lets 1e300 and the wrong unit pass, and the frame ends in NaN."""
    constraints = list(numbers(FILES[kind].model_json_schema()))
    assert len(constraints) >= {"sensor": 120, "scene": 50, "rig": 3, "material": 12, "job": 10}[kind]
    open_ended = [place for place, keywords in constraints if not (LOW & set(keywords) and HIGH & set(keywords))]
    assert open_ended == []


# --- values in SI units -----------------------------------------------------------------------------

TOO_NEAR = {
    "deg": "a degree is 57 times less than a radian: no bound that lets all devices pass lies between them",
    "sony-spad-189x600 laser.repetition_rate_khz": "20 Hz: heads at 20 kHz are real",
    "rs-e1 laser.repetition_rate_khz": "10 Hz: heads at 10 kHz are real",
    "os0-128 laser.divergence_mrad": "10.8 mrad: 0.0108 mrad is a beam of telescopes, which are real",
    "os0-128-rev7 laser.divergence_mrad": "10.4 mrad: refused for its beam of 5 mm, as narrower than diffraction",
    "osdome-128 laser.divergence_mrad": "as os0-128-rev7",
    "hdl-64e scanner.height_mm": "all exits are 200 mm up, and 0.2 mm is not finer than a calibration",
}
"""Why a value in SI units may pass."""


def units_of(kind: str, name: str) -> list[tuple[str, float | list[float], float]]:
    """Numbers of a catalogue file whose unit is not SI: dotted key, value, factor to SI."""
    tables = tomllib.loads(catalog.path_of(kind, name).read_text(encoding="utf-8"))

    def walk(table: dict[str, Any], before: str) -> Iterator[tuple[str, Any, float]]:
        for key, value in table.items():
            if isinstance(value, dict):
                if key not in ("sources", "uncertainty", "unknowns"):  # which may be as small as one likes
                    yield from walk(value, f"{before}{key}.")
            else:
                numbers = value if isinstance(value, list) else [value]
                unit = key.rpartition("_")[2]
                factor = UNITS[unit][1] if unit in UNITS else 1e3 if unit == "klux" else None
                if factor and all(isinstance(number, (int, float)) for number in numbers) and any(numbers):
                    yield f"{before}{key}", value, factor

    return list(walk(tables, ""))


def in_si(value: float | list[float], factor: float) -> float | list[float]:
    return [number * factor for number in value] if isinstance(value, list) else value * factor


@pytest.mark.parametrize("name", chosen(12, catalog.names("sensors")))
def test_values_in_si_units_are_refused(name: str) -> None:
    """Each number of each sensor of the catalogue, in its SI unit: one line, with the number that was meant."""
    path = catalog.path_of("sensors", name)
    refused_count = 0
    for key, value, factor in units_of("sensors", name):
        place = key.split(".")
        if key.rpartition("_")[2] in TOO_NEAR or f"{name} {key}" in TOO_NEAR:
            continue
        changed = tomllib.loads(path.read_text(encoding="utf-8"))
        inner = changed
        for part in place[:-1]:
            inner = inner[part]
        inner[place[-1]] = in_si(value, factor)
        with pytest.raises(InputError) as error:
            validate(SensorFile, changed, name)
        message = str(error.value)
        assert message.startswith(f"{name}: {key}"), message
        suggested = float(message.partition("did you mean ")[2].partition("?")[0])
        nearest = value if isinstance(value, (int, float)) else min(value, key=lambda x: abs(x - suggested))
        assert math.isclose(suggested, nearest, rel_tol=1e-5), message
        refused_count += 1
    assert refused_count >= 9


def test_the_line_of_a_pulse_in_seconds() -> None:
    """Reference: the example of the issue."""
    tables = tomllib.loads(catalog.path_of("sensors", "table1-apd").read_text(encoding="utf-8"))
    tables["laser"]["pulse_fwhm_ns"] = 6e-9
    with told("own.toml | laser.pulse_fwhm_ns | >= 0.01 | 6e-09 | 6?"):
        validate(SensorFile, tables, "own.toml")


@pytest.mark.parametrize(
    ("value", "named"),
    [
        (0.0, None),
        (5.0, None),
        (-5.0, None),
        (0.05, "x_mm | 0 or >= 0.1 | 0.05 | 50?"),
        (-0.03, "x_mm | 0 or <= -0.1 | -0.03 | -30?"),
        (2e4, "x_mm | <= 10000 | 20000.0"),
        (1e-9, "x_mm | 0 or >= 0.1 | 1e-09"),  # 1e-6 mm would be outside as well
    ],
)
def test_a_number_is_nought_or_no_finer_than(value: float, named: str | None) -> None:
    class Place(FileModel):
        x_mm: Annotated[float, Number("mm", ge=-1e4, le=1e4, finest=0.1)]

    with told(named) if named else nullcontext():
        assert validate(Place, {"x_mm": value}, "file").x_mm == value
