"""Tables of files whose keys are declared by the dataclass that is made of them, with `maths.units.Quantity`."""

from __future__ import annotations

import typing
from collections.abc import Container
from dataclasses import MISSING, fields
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, TypeVar

from pydantic import Field

from ..maths.units import Key, Quantity
from .toml import FileModel

Made = TypeVar("Made")


class Table(FileModel, Generic[Made]):
    """Base of ``class LaserFile(Table[Laser])``: each field of Laser with a `Key` is a key here, in the file's unit.

    A key that is written out in the class itself takes the place of a declared one. With ``only``, the other fields
    of the dataclass are no keys.
    """

    made: ClassVar[type[Any]]
    """The dataclass."""
    keys: ClassVar[dict[str, tuple[str, Key]]]
    """Its fields to the keys of the file, and how they are declared."""

    def __init_subclass__(cls, only: Container[str] | None = None, **options: Any) -> None:
        """Add the declared keys to the annotations, from which pydantic then makes a model."""
        super().__init_subclass__(**options)
        made = next(
            (one for base in cls.__bases__ for one in _arguments(base) if isinstance(one, type)), None
        )
        if made is None:
            return
        cls.made, cls.keys = made, {}
        hints = typing.get_type_hints(made, include_extras=True)
        for field in fields(made):
            hint = hints[field.name]
            key = next((note for note in getattr(hint, "__metadata__", ()) if isinstance(note, Key)), None)
            if key is None or (only is not None and field.name not in only):
                continue
            name = key.of(field.name)
            cls.keys[field.name] = (name, key)
            if name not in cls.__annotations__:
                cls.__annotations__[name] = _type_in_file(hint.__origin__, key)
                default = {} if field.default is MISSING else {"default": key.in_file(field.default)}
                setattr(cls, name, Field(description=key.about, **default))

    def in_si(self, **more: Any) -> Made:
        """The dataclass, in SI units; ``more`` are its other fields."""
        values = {field: key.in_si(getattr(self, name)) for field, (name, key) in self.keys.items()}
        made: Made = self.made(**(values | more))
        return made

    if TYPE_CHECKING:

        def __getattr__(self, key: str) -> Any:
            """Any of the declared keys."""


def _arguments(base: type) -> tuple[Any, ...]:
    """(Laser,) of ``Table[Laser]``."""
    return tuple(getattr(base, "__pydantic_generic_metadata__", {}).get("args", ()))


def _type_in_file(hint: Any, key: Key) -> Any:
    """The type that a file takes for a field: of an array, one number."""
    if not isinstance(key, Quantity):
        return hint
    number: Any = int if key.whole or hint is int else float
    if key.bounds:
        number = Annotated[number, Field(**key.bounds)]
    return number | None if NoneType in typing.get_args(hint) else number
