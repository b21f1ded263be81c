"""Units of files, and tables of files that dataclasses declare."""

import inspect
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import pytest
from helpers.mistakes import refused, told
from pydantic import Field

from lidarscene.files.table_model import Table
from lidarscene.files.toml import validate
from lidarscene.maths.units import SYMBOLS, UNITS, FileKey, Quantity, SameTable, si, split_unit
from lidarscene.scene import scene_file as _scene  # noqa: F401 all tables are known once it is
from lidarscene.sensor import sensor_file as _sensor  # noqa: F401

ROWS = """
    1e-12 ps; 1e-9 nm ns na; 1e-6 um us ua; 1e-3 mm ms mrad; 1e3 km khz; 1e6 mhz
    9.80665e-3 mg; 9.80665e-6 ug ug_sqrt_hz
"""
FACTORS = {
    unit: float(factor)
    for factor, *units in map(str.split, ROWS.strip().replace("\n", ";").split(";"))
    for unit in units
}
ENDINGS = {
    "m": ("nm", "um", "mm", "km"),
    "s": ("ps", "ns", "us", "ms"),
    "hz": ("khz", "mhz"),
    "a": ("na", "ua"),
    "rad": ("mrad", "deg"),
    "rad_s": ("deg_s", "deg_h"),
    "rad_s_sqrt_hz": ("deg_s_sqrt_hz",),
    "m_s2": ("mg", "ug"),
    "m_s2_sqrt_hz": ("ug_sqrt_hz",),
}


@pytest.mark.parametrize("value", [905.0, 3.0, 0.1, 7.3, 1e-3 / 3.0, -12.7, 55.7])
def test_conversion(value: float) -> None:
    """A product with the decimal factor, to the last bit: some of these differ from the quotient by 1e9."""
    assert {unit: si(value, unit) for unit in FACTORS} == {u: value * factor for u, factor in FACTORS.items()}
    assert si(value, "deg") == si(value, "deg_s") == si(value, "deg_s_sqrt_hz") == math.radians(value)
    assert si(value, "deg_h") == pytest.approx(math.radians(value) / 3600.0, rel=1e-15)
    assert si((value, 1.0), "ns") == (value * 1e-9, 1e-9)
    assert si(None, "ns") is None


def test_units_are_those_of_the_names() -> None:
    assert {*FACTORS, "deg", "deg_s", "deg_h", "deg_s_sqrt_hz"} == set(UNITS)
    assert {unit: ending for ending, units in ENDINGS.items() for unit in units} == {
        unit: ending for unit, (ending, _) in UNITS.items()
    }


def test_a_name_is_split_from_its_unit() -> None:
    assert split_unit("optics.aperture_radius_mm") == ("optics.aperture_radius", "mm")
    assert split_unit("sun_irradiance_w_m2") == ("sun_irradiance", "W/m²")
    assert split_unit("extinction_per_m") == ("extinction", "1/m")
    assert split_unit("detector.gain") == ("detector.gain", "")
    assert set(UNITS) | {unit for unit, _ in UNITS.values()} - {"rad_s"} <= set(SYMBOLS)


@dataclass(frozen=True, slots=True)
class Row:
    """Made by `create`."""

    all_s: tuple[float, ...]

    @classmethod
    def create(
        cls,
        times_s: Annotated[Sequence[float], Quantity("ns", ge=1, least=2)],
        more_s: Annotated[Sequence[float] | None, Quantity("us")] = None,
        other: int = 0,
    ) -> "Row":
        """Create them from lists."""
        return cls((*times_s, *(more_s or ())))


class RowFile(Table[Row]):
    """Lists."""


def test_lists_of_a_class_that_is_made_by_its_method() -> None:
    assert validate(RowFile, {"times_ns": [3.0, 5]}, "file").in_si() == Row((3.0 * 1e-9, 5.0 * 1e-9))
    row = validate(RowFile, {"times_ns": [3.0, 5], "more_us": [0.1]}, "file").in_si()
    assert row == Row((3.0 * 1e-9, 5.0 * 1e-9, 0.1 * 1e-6))
    with told("file | times_ns | at least 2 | [3.0]"):
        validate(RowFile, {"times_ns": [3.0]}, "file")
    with told("file | times_ns[1] | >= 1 | 0.5"):
        validate(RowFile, {"times_ns": [3.0, 0.5]}, "file")


@dataclass(frozen=True, slots=True, kw_only=True)
class Lamp:
    width_s: Annotated[Any, Quantity("ns", gt=0, le=9, about="of the flash")]
    power_w: Annotated[Any, Quantity(ge=0)] = 2.5
    radius_m: Annotated[Any | None, Quantity("mm", gt=0)] = None
    turn_rad: Annotated[float, Quantity("deg", name="tilt_deg")] = math.radians(45.0)
    cells: Annotated[Any, Quantity(ge=1, whole=True)] = 4.0
    count: Annotated[int, Quantity(ge=1)] = 1
    shape: Annotated[Literal["round", "square"], FileKey(name="form")] = "round"
    inner: float = 7.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Burst:
    shots: Annotated[int, Quantity(ge=1, whole=True)]
    pauses: Annotated[int | None, Quantity(ge=0, whole=True)] = None


class BurstFile(Table[Burst]):
    """Whole numbers."""


def test_a_whole_number_of_an_int_field_is_an_int() -> None:
    burst = validate(BurstFile, {"shots": 3, "pauses": 2}, "file").in_si()
    assert (type(burst.shots), type(burst.pauses)) == (int, int)
    assert type(validate(LampFile, {"width_ns": 1.0, "cells": 4}, "file").in_si().cells) is float


class LampFile(Table[Lamp]):
    """A lamp."""

    count: Annotated[int, Field(ge=3)] = 3
    extra: bool = False


class ShortFile(Table[Lamp], only=("width_s", "power_w")):
    """Some keys of a lamp."""


def test_a_table_has_the_declared_keys() -> None:
    schema = LampFile.model_json_schema()
    assert schema["required"] == ["width_ns"]
    assert " ".join(sorted(schema["properties"])) == "cells count extra form power_w radius_mm tilt_deg width_ns"
    assert schema["properties"]["width_ns"] == {
        "exclusiveMinimum": 0,
        "maximum": 9,
        "description": "of the flash",
        "title": "Width Ns",
        "type": "number",
    }
    assert schema["properties"]["tilt_deg"]["default"] == 45.0
    assert schema["properties"]["count"]["minimum"] == 3
    assert set(ShortFile.model_fields) == {"width_ns", "power_w"}


def test_a_table_makes_what_declares_it() -> None:
    assert LampFile(width_ns=3.0).in_si() == Lamp(width_s=3.0 * 1e-9, count=3)
    tables = {"width_ns": 7.3, "power_w": 1, "radius_mm": 7.3, "tilt_deg": 7.3, "cells": 9, "form": "square"}
    lamp = validate(LampFile, tables, "file").in_si(inner=1.0)
    assert lamp == Lamp(
        width_s=7.3 * 1e-9,
        power_w=1.0,
        radius_m=7.3 * 1e-3,
        turn_rad=math.radians(7.3),
        cells=9.0,
        count=3,
        shape="square",
        inner=1.0,
    )
    assert isinstance(lamp.cells, float)


test_mistakes_are_told_as_of_every_file = refused(
    lambda tables: validate(LampFile, tables, "file"),
    ({"width_ns": 0.0}, "width_ns | > 0 | 0.0"),
    ({"width_ns": 1.0, "cells": 1.5}, "cells | whole number | 1.5"),
    ({"width_ns": 1.0, "form": "oval"}, "form | 'round' or 'square' | \"oval\""),
    ({"power_w": 1.0}, "'width_ns'"),
    ({"width_ns": 1.0, "inner": 1.0}, "'inner' | width_ns, power_w, radius_mm, tilt_deg, cells, form, count, extra"),
    where="file",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Street:
    name: Annotated[Literal["high", "low"], FileKey()] = "high"
    lamp: Annotated[Lamp, SameTable()]
    length_m: Annotated[float, Quantity("km", gt=0)]


class StreetFile(Table[Street]):
    """The keys of a lamp between those of a street."""


def test_a_part_has_its_keys_in_the_table_of_the_whole() -> None:
    whole = list(StreetFile.model_fields)
    assert whole == ["name", "width_ns", "power_w", "radius_mm", "tilt_deg", "cells", "count", "form", "length_km"]
    street = validate(StreetFile, {"width_ns": 3.0, "length_km": 2.0}, "file").in_si(inner=1.0)
    assert street == Street(lamp=Lamp(width_s=3.0 * 1e-9, inner=1.0), length_m=2000.0)


def test_a_name_with_another_unit_is_refused() -> None:
    with told("width_s | _m | mm", TypeError):
        Quantity("mm").for_field("width_s")


def tables() -> list[type[Table[Any]]]:
    """All tables of the package."""
    table_classes, todo = [], [Table]
    while todo:
        table_class = todo.pop()
        todo += table_class.__subclasses__()
        if "keys" in vars(table_class) and table_class.__module__.startswith("lidarscene."):
            table_classes.append(table_class)
    return table_classes


@pytest.mark.parametrize("table", tables(), ids=lambda table: table.__name__)
def test_defaults_are_the_same_in_files_and_in_python(table: type[Table[Any]]) -> None:
    """Defaults are the same to the last bit; a default that the file writes in another unit comes back from there."""
    parameters = dict(inspect.signature(getattr(table.target, "create", table.target)).parameters)
    for part in table.parts.values():
        parameters |= inspect.signature(part).parameters
    for field, (name, key) in table.keys.items():
        info = table.model_fields[name]
        if not info.is_required() and parameters[field].default is not inspect.Parameter.empty:
            assert key.in_si(info.default) == parameters[field].default, name
