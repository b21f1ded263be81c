"""Names that an object, a class, a constructor or a module lacks: a message says what does it.

People try the names of other libraries first, and numbers without their unit: ``sensor.wavelength`` is
``sensor.laser.wavelength_m`` here.
"""

from __future__ import annotations

import functools
import inspect
from abc import ABCMeta
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import FrozenInstanceError, is_dataclass
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, cast

from ..errors import InputError, did_you_mean, meant_by_a_part, question
from .units import keys_like

Call = TypeVar("Call", bound=Callable[..., Any])

MOST_NAMES = 12
"""Most names of an object that a message lists."""


def no_attribute(owner: object, word: str, *, name: str, foreign_names: Mapping[str, str]) -> AttributeError:
    """Error for an attribute that an object lacks, with what does it, or else with the names that are there.

    Args:
        name: of the object in expressions, such as "sensor"
        foreign_names: names that people try, and the expression or the sentence that does it
    """
    public = _public_names(owner)
    fields = getattr(type(owner), "__dataclass_fields__", ())
    inner = [f"{part}.{entry}" for part in fields for entry in _numbers_of(getattr(owner, part, None))]
    like = question(f"{name}.{key}" for key in keys_like(word, public) or keys_like(word, inner))
    meant = meaning_of(word, {entry: f"{name}.{entry}" for entry in public}, foreign_names, like=like)
    return AttributeError(f"{type(owner).__name__} has no '{word}'; {meant or _listed(public)}")


def _public_names(owner: object) -> list[str]:
    """Public names of an object or a class: fields of a dataclass, then all others but constants."""
    fields = getattr(owner, "__dataclass_fields__", ())
    return [word for word in dict.fromkeys([*fields, *dir(owner)]) if not word.startswith("_") and not word.isupper()]


def _listed(names: Sequence[str]) -> str:
    """Names as the end of a message."""
    return f"known here: {', '.join(names[:MOST_NAMES])}{', ...' if len(names) > MOST_NAMES else ''}"


def meaning_of(word: str, public: Mapping[str, str], foreign_names: Mapping[str, str], *, like: str = "") -> str:
    """What a name means that an object or a module lacks; "" if nothing is like it.

    A name that people try comes first, then a slip of a public one, then the longest name that the word has as its
    parts: get_actors, to_ros2, list_scenes; last a public one that is less like it.

    Args:
        public: names that are there, each with how it is asked for
        foreign_names: as of `no_attribute`
        like: question for numbers of the object's parts that have the words of the name, which come before its parts
    """
    return (
        foreign_names.get(word)
        or did_you_mean(word, public, cutoff=0.8)
        or like
        or meant_by_a_part(word, {**public, **foreign_names})
        or did_you_mean(word, public, cutoff=0.7)
    )


def _numbers_of(part: object) -> list[str]:
    """Names of the fields and properties of a dataclass; [] of anything else."""
    kind = type(part)
    properties = [key for key in dir(kind) if not key.startswith("_") and isinstance(getattr(kind, key), property)]
    return [*getattr(kind, "__dataclass_fields__", ()), *properties] if is_dataclass(kind) else []


def refuse_to_set(owner: HintedAttributes, word: str, _: object) -> None:
    """Refuse to set an attribute, and say what makes a changed object."""
    hint = f"; {owner.CHANGED_BY}" if owner.CHANGED_BY else ""
    raise FrozenInstanceError(f"{type(owner).__name__}.{word} cannot be set{hint}")


def answers_calls(made: Call) -> Call:
    """Say in one line what a constructor takes, where a call does not fit it (a decorator)."""

    @functools.wraps(made)
    def answering(owner: Any, *arguments: Any, **keywords: Any) -> Any:
        try:
            return made(owner, *arguments, **keywords)
        except TypeError:
            # A good call costs what it cost.
            mistake = _mistake_of_call(owner, made, arguments, keywords)
            if not mistake:
                raise
        raise InputError(mistake)

    return cast(Call, answering)


def _mistake_of_call(
    owner: object, made: Callable[..., Any], arguments: Sequence[object], keywords: Collection[str]
) -> str:
    """Say which argument is too many, unknown or missing; "" if the call fits."""
    parameters = [*inspect.signature(made).parameters.values()][1:]
    if any(parameter.kind is not parameter.KEYWORD_ONLY for parameter in parameters):
        return ""  # such a call says best what it takes
    kind = owner if isinstance(owner, type) else type(owner)
    names = [parameter.name for parameter in parameters]
    required = [parameter.name for parameter in parameters if parameter.default is parameter.empty]
    called = f"{kind.__name__}{'' if made.__name__ == '__init__' else f'.{made.__name__}'}()"
    made_by = f"{text}; " if (text := getattr(kind, "MADE_BY", "")) else ""
    known = f"known here: {', '.join(names)}"
    if arguments:
        return f"{called}: must have all values by name, got {len(arguments)} without; {made_by}{known}"
    for word in [word for word in keywords if word not in names]:
        meant = question(keys_like(word, names)) or did_you_mean(word, names, cutoff=0.8)
        return f"{called}: unknown option '{word}'; {f'{meant} ' if meant else made_by}{known}"
    missing = [name for name in required if name not in keywords]
    return f"{called}: {missing[0]} is missing; {made_by}{known}" if missing else ""


_OPERATORS = {"__getitem__": "[...]", "__setitem__": "[...] ="}
"""Operators that people try, and how a message writes them."""


def _refusal_of(operator: str, hint: str) -> Any:
    """Operator that says what does it."""

    def refuse(owner: object, *_: object) -> None:
        raise TypeError(f"{type(owner).__name__} has no {_OPERATORS[operator]}; {hint}")

    return refuse


class _HintedClass(ABCMeta):
    """Class, abstract or not, that answers a constructor which it lacks, ``Scene.from_file``, with what makes one."""

    if not TYPE_CHECKING:

        def __getattr__(cls, word: str) -> Any:
            # What Python and libraries look for gets no hint.
            hint = "" if word.startswith("_") else f"; {cls.MADE_BY or _listed(_public_names(cls))}"
            raise AttributeError(f"class {cls.__name__} has no '{word}'{hint}")


class HintedAttributes(metaclass=_HintedClass):
    """Base of a class whose objects answer an attribute that they lack, or that cannot be set, with what does it.

    Attributes:
        FOREIGN_NAMES: names that people try, ``__getitem__`` too, and what does it
        CHANGED_BY: what makes a changed one, of a class whose objects are frozen; "" if nothing does
        MADE_BY: what makes one
    """

    __slots__ = ()
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {}
    CHANGED_BY: ClassVar[str] = ""
    MADE_BY: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "__init__" in vars(cls):
            setattr(cls, "__init__", answers_calls(cls.__init__))  # noqa: B010
        # A frozen dataclass says no more than that it cannot be set.
        if {"__setattr__", "__dataclass_fields__"} <= vars(cls).keys():
            setattr(cls, "__setattr__", refuse_to_set)  # noqa: B010
        for operator in _OPERATORS.keys() & cls.FOREIGN_NAMES.keys():
            setattr(cls, operator, _refusal_of(operator, cls.FOREIGN_NAMES[operator]))
        if "__getitem__" in cls.FOREIGN_NAMES:
            setattr(cls, "__iter__", None)  # noqa: B010  # else Python asks __getitem__ for the elements

    if not TYPE_CHECKING:

        def __getattr__(self, word: str) -> Any:
            if word.startswith("_"):  # what Python and libraries look for
                raise AttributeError(f"{type(self).__name__} has no '{word}'")
            changes = ("replace", "set", "update", "copy", "with", "override", "overrides", "change", "modify")
            foreign_names = {**dict.fromkeys(changes, self.CHANGED_BY), **self.FOREIGN_NAMES}
            raise no_attribute(self, word, name=type(self).__name__.lower(), foreign_names=foreign_names)
