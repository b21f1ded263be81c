"""Names that an object, a class or a module lacks: a message says what does it.

People try the names of other libraries first, and numbers without their unit: ``sensor.wavelength`` is
``sensor.laser.wavelength_m`` here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import FrozenInstanceError, is_dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ..errors import did_you_mean, meant_by_a_part, question


def no_attribute(owner: object, word: str, *, name: str, foreign_names: Mapping[str, str]) -> AttributeError:
    """Error for an attribute that an object lacks, with what does it.

    Args:
        name: of the object in expressions, such as "sensor"
        foreign_names: names that people try, and the expression or the sentence that does it
    """
    # Only who mistypes needs it, and it takes pydantic.
    from .toml import keys_like

    public = [entry for entry in dir(owner) if not entry.startswith("_")]
    fields = getattr(type(owner), "__dataclass_fields__", ())
    inner = [f"{part}.{entry}" for part in fields for entry in _numbers_of(getattr(owner, part, None))]
    like = question(f"{name}.{key}" for key in keys_like(word, public) or keys_like(word, inner))
    meant = meaning_of(word, {entry: f"{name}.{entry}" for entry in public}, foreign_names, like=like)
    meant = meant or did_you_mean(word, public, cutoff=0.7)
    return AttributeError(f"{type(owner).__name__} has no '{word}'" + (f"; {meant}" if meant else ""))


def meaning_of(word: str, public: Mapping[str, str], foreign_names: Mapping[str, str], *, like: str = "") -> str:
    """What a name means that an object or a module lacks; "" if nothing is like it.

    A name that people try comes first, then a slip of a public one, then the longest name that the word has as its
    parts: get_actors, to_ros2, list_scenes.

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
    )


def _numbers_of(part: object) -> list[str]:
    """Names of the fields and properties of a dataclass; [] of anything else."""
    kind = type(part)
    properties = [key for key in dir(kind) if not key.startswith("_") and isinstance(getattr(kind, key), property)]
    return [*getattr(kind, "__dataclass_fields__", ()), *properties] if is_dataclass(kind) else []


def _refuse_to_set(owner: HintedAttributes, word: str, _: object) -> None:
    """Refuse to set an attribute, and say what makes a changed object."""
    hint = f"; {owner.CHANGED_BY}" if owner.CHANGED_BY else ""
    raise FrozenInstanceError(f"{type(owner).__name__}.{word} cannot be set{hint}")


def _refuse_entry(owner: HintedAttributes, _: object) -> None:
    """Refuse ``owner[...]``, and say what does it."""
    raise TypeError(f"{type(owner).__name__} has no [...]; {owner.FOREIGN_NAMES['__getitem__']}")


class _HintedClass(type):
    """Class that answers a constructor which it lacks, such as ``Scene.from_file``, with what makes an object."""

    if not TYPE_CHECKING:

        def __getattr__(cls, word: str) -> Any:
            # What Python and libraries look for gets no hint.
            hint = "" if word.startswith("_") or not cls.MADE_BY else f"; {cls.MADE_BY}"
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
        if "__setattr__" in vars(cls):  # a frozen dataclass, which says no more than that it cannot be set
            setattr(cls, "__setattr__", _refuse_to_set)  # noqa: B010
        if "__getitem__" in cls.FOREIGN_NAMES:
            setattr(cls, "__getitem__", _refuse_entry)  # noqa: B010
            setattr(cls, "__iter__", None)  # noqa: B010  # else Python asks __getitem__ for the elements

    if not TYPE_CHECKING:

        def __getattr__(self, word: str) -> Any:
            if word.startswith("_"):  # what Python and libraries look for
                raise AttributeError(f"{type(self).__name__} has no '{word}'")
            changes = ("replace", "set", "update", "copy", "with", "override", "overrides", "change", "modify")
            foreign_names = {**dict.fromkeys(changes, self.CHANGED_BY), **self.FOREIGN_NAMES}
            raise no_attribute(self, word, name=type(self).__name__.lower(), foreign_names=foreign_names)
