"""Models of a file's tables whose keys are declared on the class that is built from them, with `maths.units.Quantity`.

A number of a sensor is declared once, on the frozen class that the simulation uses. The file's model, its bounds, its
defaults, its JSON Schema and the conversion to SI units follow from there, so that they cannot differ.
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, TypeVar

from pydantic import ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from ..maths.units import FileKey, Quantity, SameTable, note_of
from .toml import OUT_OF_BOUNDS, FileModel

Target = TypeVar("Target")


_BOUNDS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}


@dataclass(frozen=True, slots=True)
class Number(Quantity):
    """A `Quantity` as pydantic takes it: ``Annotated[float, Number("ns", ge=0.01, le=1e3)]`` on a key of a table."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Schema of the number that refuses values out of bounds."""

        def bounded(value: float) -> float:
            must = self.must_be(value)
            if must is None:
                return value
            intended = self.as_written_in_si(value)
            suggestion = "" if intended is None else f": did you mean {intended:.6g}?"
            raise PydanticCustomError(OUT_OF_BOUNDS, "{must}{suggestion}", {"must": must, "suggestion": suggestion})

        return core_schema.no_info_after_validator_function(bounded, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """JSON Schema of the number, for editors."""
        json_schema = handler(schema) | {_BOUNDS[name]: limit for name, limit in self.bounds.items()}
        if self.finest is not None:
            inner = {"exclusiveMinimum": -self.finest, "exclusiveMaximum": self.finest}
            json_schema["not"] = {**inner, "not": {"const": 0}}
        return json_schema


class Table(FileModel, Generic[Target]):
    """Base of ``class LaserFile(Table[Laser])``: a field of Laser with a `FileKey` is a key here, in the file's unit.

    Of a class with a method `create`, the keys are that method's parameters. A key that is written out in the table, or
    in a base of it, replaces a declared one. ``only`` restricts the keys to these fields. A field that is a `SameTable`
    is replaced by its own fields.
    """

    model_config = ConfigDict(defer_build=True)  # start-up: most tables are only parts of a whole file

    target: ClassVar[type[Any]]
    """Class that the table describes: Laser."""
    keys: ClassVar[dict[str, tuple[str, FileKey]]]
    """Field name -> (file key, declaration)."""
    parts: ClassVar[dict[str, type[Any]]]
    """Field name -> class, for fields whose own fields stand in this table (`SameTable`)."""

    def __init_subclass__(cls, only: Container[str] | None = None, **options: Any) -> None:
        """Add the declared keys to the annotations, from which pydantic then makes a model."""
        super().__init_subclass__(**options)
        target = next(
            (argument for base in cls.__bases__ for argument in _arguments(base) if isinstance(argument, type)), None
        )
        if target is None:
            return
        cls.target, cls.keys, cls.parts = target, {}, {}
        written, declared = cls.__annotations__, {}
        for field, hint, parameter in _parameters(_constructor(target), cls.parts):
            key = note_of(hint, FileKey)
            if key is None or (only is not None and field not in only):
                continue
            if isinstance(key, Quantity) and _takes_int(hint.__origin__):
                key = replace(key, whole=False)  # a whole number by its type: no float is made of it
            name = key.for_field(field)
            cls.keys[field] = (name, key)
            if name not in written and name not in cls.model_fields:
                declared[name] = _type_in_file(hint.__origin__, key)
                has_default = parameter.default is not parameter.empty
                default = {"default": key.in_file(parameter.default)} if has_default else {}
                setattr(cls, name, Field(description=key.about, **default))
        tag = {name: written[name] for name in ("type", "kind") if name in written}
        cls.__annotations__ = tag | declared | written

    def in_si(self, **more: Any) -> Target:
        """Build the target in SI units; ``more`` are its fields without a key, and those of its parts."""
        values = self.values_in_si() | more
        for name, part in self.parts.items():
            in_part = [part_field.name for part_field in fields(part) if part_field.name in values]
            values[name] = part(**{field: values.pop(field) for field in in_part})
        target: Target = _constructor(self.target)(**values)
        return target

    def values_in_si(self) -> dict[str, Any]:
        """Values of the keys in SI units, by field of the target."""
        return {field: key.in_si(getattr(self, name)) for field, (name, key) in self.keys.items()}

    @classmethod
    def written(cls, target: Target) -> dict[str, Any]:
        """Keys and values of the file that give this target; those with their default are left out."""
        values = {name: key.in_file(getattr(target, field)) for field, (name, key) in cls.keys.items()}
        return {name: value for name, value in values.items() if value != cls.model_fields[name].default}

    if TYPE_CHECKING:

        def __getattr__(self, key: str) -> Any:
            """Value of a declared key, in the file's unit."""


def _arguments(base: type) -> tuple[Any, ...]:
    """Arguments of a generic base: (Laser,) of ``Table[Laser]``."""
    return tuple(getattr(base, "__pydantic_generic_metadata__", {}).get("args", ()))


def _constructor(target: type[Any]) -> Callable[..., Any]:
    """Callable that builds the target: its method `create`, or the class itself."""
    constructor: Callable[..., Any] = getattr(target, "create", target)
    return constructor


def _parameters(
    constructor: Callable[..., Any], parts: dict[str, type[Any]]
) -> Iterator[tuple[str, Any, inspect.Parameter]]:
    """Yield name, type and declaration of each parameter, or of a part's fields; add parts to ``parts``."""
    hints = typing.get_type_hints(constructor, include_extras=True)
    for name, parameter in inspect.signature(constructor).parameters.items():
        hint = hints[name]
        if note_of(hint, SameTable):
            parts[name] = hint.__origin__
            yield from _parameters(hint.__origin__, {})
        else:
            yield name, hint, parameter


def _takes_int(hint: Any) -> bool:
    """Whether int is the type of a field, or one of its types."""
    return int in (hint, *typing.get_args(hint))


def _type_in_file(hint: Any, key: FileKey) -> Any:
    """Type of a field in the file: one number for an array, a list for a sequence."""
    if not isinstance(key, Quantity):
        return hint
    options = typing.get_args(hint)
    number: Any = int if key.whole or _takes_int(hint) else float
    if key.bounds:
        quantity = {part.name: getattr(key, part.name) for part in fields(Quantity)}
        number = Annotated[number, Number(**quantity)]
    if typing.get_origin(hint) is tuple:  # of a fixed length
        number = tuple[(number,) * len(options)]  # type: ignore[misc]
    if any(typing.get_origin(option) is Sequence for option in (hint, *options)):
        number = Annotated[tuple[number, ...], Field(min_length=key.least)] if key.least else tuple[number, ...]
    return number | None if NoneType in options else number
