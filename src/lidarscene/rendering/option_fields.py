"""Option: a dataclass field that declares its allowed values, its help text and its name on the command line, once.

``rays: int = option(1, RAYS, help="rays of each pulse", metavar="N")``. The check of the object (`check_options`), its
docstring (`list_options`) and the argument of the command line (`cli.options.add_options`) are made of the field.
"""

from __future__ import annotations

import functools
import inspect
import math
import re
from collections.abc import Collection, Mapping
from dataclasses import MISSING, Field, field, fields
from numbers import Integral, Number, Real
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, TypeVar, cast

from ..errors import OptionError, one_line
from ..files.arguments import is_of_type, require_type, type_hints
from ..formats.clock import parse_date

Options = TypeVar("Options")


class Whole(NamedTuple):
    """The whole numbers from ``low`` to ``high``, both included."""

    low: int
    high: int

    def __str__(self) -> str:
        return f"a whole number from {self.low} to {self.high}"

    def check(self, option: str, value: object) -> None:
        """Raise OptionError unless the value is one of these numbers."""
        whole = isinstance(value, Integral) and not isinstance(value, bool)
        if not whole or not self.low <= int(cast(int, value)) <= self.high:
            raise OptionError(f"{{{option}}}: must be {self}, got {{0!r}}", value)


class Finite(NamedTuple):
    """The finite numbers of a unit, such as "seconds", or those from ``low`` to ``high``."""

    unit: str
    low: float = -math.inf
    high: float = math.inf

    def check(self, option: str, value: object) -> None:
        """Raise OptionError unless the value is one of these numbers."""
        if not isinstance(value, Real) or not math.isfinite(value) or not self.low <= float(value) <= self.high:
            bounds = f"{self.low:g} to {self.high:g} {self.unit}"
            allowed = bounds if math.isfinite(self.low) else f"a finite number of {self.unit}"
            value_text = f"{value:g}" if isinstance(value, float) else one_line(value)
            raise OptionError(f"{{{option}}}: must be {allowed}, got {{0}}", value_text)


class OneOf(NamedTuple):
    """Some names. ``wording`` replaces "one of a, b" in messages."""

    names: Collection[str]
    wording: str = ""

    def check(self, option: str, value: object) -> None:
        """Raise OptionError unless the value is one of the names."""
        if value not in self.names:
            allowed = self.wording or f"one of {', '.join(self.names)}"
            raise OptionError(f"{{{option}}}: must be {{0}}, got {{1!r}}", allowed, value)


class FileName(NamedTuple):
    """The names of files that end in one of these suffixes."""

    suffixes: tuple[str, ...]

    def check(self, option: str, value: Any) -> None:
        """Raise OptionError unless the path has one of the suffixes."""
        if Path(value).suffix.lower() not in self.suffixes:
            raise OptionError(f"{{{option}}} {{0}}: the name must end in {{1}}", value, " or ".join(self.suffixes))


class Matching(NamedTuple):
    """The texts that match a pattern, which ``wording`` says in words."""

    pattern: str
    wording: str

    def check(self, option: str, value: Any) -> None:
        """Raise OptionError unless the text matches."""
        if not re.fullmatch(self.pattern, value):
            raise OptionError(f"{{{option}}}: must be {self.wording}, got {{0!r}}", value)


class Date:
    """Dates in ISO 8601 that stamps of files can hold."""

    def check(self, option: str, value: object) -> None:
        """Raise OptionError unless the value is such a date."""
        try:
            parse_date(str(value))
        except ValueError as error:
            allowed = "a date such as 2026-01-31 or 2026-01-31T12:00:00Z"
            reason = f" ({error})" if str(error).startswith("must") else ""
            raise OptionError(f"{{{option}}}: must be {{0}}, got {{1!r}}{{2}}", allowed, value, reason) from None


class Function:
    """All that can be called."""

    def check(self, option: str, value: object) -> None:
        """Raise OptionError unless the value can be called."""
        if not callable(value):
            raise OptionError(f"{{{option}}}: must be a function, got {{0!r}}", value)


class Values(Protocol):
    """Allowed values of an option, such as `Whole`."""

    def check(self, option: str, value: Any, /) -> None:
        """Raise OptionError unless the value is allowed."""


class Declaration(NamedTuple):
    """What a field says of its option.

    Attributes:
        help: one line for the docstring and for ``--help``
        values: allowed values; None: all of the field's type
        metavar: name of the value in ``--help``
        flags: names on the command line; none: the field's own name
    """

    help: str
    values: Values | None = None
    metavar: str | None = None
    flags: tuple[str, ...] = ()


def option(
    default: Any = MISSING,
    values: Values | None = None,
    *,
    help: str,
    metavar: str | None = None,
    flags: tuple[str, ...] = (),
) -> Any:
    """Declare an option: the dataclass field with this default and a `Declaration`.

    Args:
        help: in which ``{default}`` stands for the default
    """
    return field(default=default, metadata=declared(help.format(default=default), values, metavar, flags))


def declared(
    help: str, values: Values | None = None, metavar: str | None = None, flags: tuple[str, ...] = ()
) -> dict[str, Declaration]:
    """Metadata of a field that is an option without a default: type checkers see that only in a call of `field`."""
    return {"option": Declaration(help, values, metavar, flags)}


def options_of(kind: type[Any]) -> Mapping[str, tuple[Field[Any], Declaration]]:
    """Name -> field and declaration of each option of a dataclass."""
    hashable: Any = kind  # as every class is, which mypy does not see
    return _options_of(hashable)


@functools.cache
def _options_of(kind: Any) -> Mapping[str, tuple[Field[Any], Declaration]]:
    options = {entry.name: (entry, entry.metadata["option"]) for entry in fields(kind) if "option" in entry.metadata}
    return MappingProxyType(options)


def check_options(options: Any) -> None:
    """Raise OptionError for an option out of its values; the default is one of them, or None.

    Numbers of NumPy become Python's: those of few bytes overflow, or lose digits, in products of them.
    """
    kind: Any = type(options)
    for name, (entry, declaration) in options_of(kind).items():
        value = getattr(options, name)
        if value is entry.default:
            continue
        if isinstance(value, Number) and hasattr(value, "item"):
            object.__setattr__(options, name, value := value.item())
        if isinstance(entry.default, bool):
            if not is_of_type(value, bool):
                raise OptionError(f"{{{name}}}: must be True or False, got {{0!r}}", value)
            continue
        if not isinstance(declaration.values, Whole | Finite | Date | Function):  # these look at the type themselves
            require_type(name, value, type_hints(kind)[name])
        if declaration.values is not None:
            declaration.values.check(name, value)


def list_options(kind: type[Options]) -> type[Options]:
    """Add its options to the docstring of a dataclass, as attributes (a decorator)."""
    lines = [f"    {name}: {declaration.help}" for name, (_, declaration) in options_of(kind).items()]
    kind.__doc__ = "\n".join([inspect.cleandoc(kind.__doc__ or ""), "", "Attributes:", *lines])
    return kind
