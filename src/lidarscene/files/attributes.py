"""Attributes that an object lacks: a message names what does it.

People try the names of other libraries first, and numbers without their unit: ``sensor.wavelength`` is
``sensor.laser.wavelength_m`` here.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import FrozenInstanceError, is_dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ..errors import did_you_mean, question


def no_attribute(owner: object, word: str, *, name: str, foreign_names: Mapping[str, str]) -> AttributeError:
    """Error for an attribute that an object lacks, with what does it.

    Args:
        name: of the object in expressions, such as "sensor"
        foreign_names: names that people try, and the expression or the sentence that does it
    """
    # Only who mistypes needs it, and it takes pydantic.
    from .toml import keys_like

    public = [entry for entry in dir(owner) if not entry.startswith("_")]
    meant = foreign_names.get(word) or did_you_mean(word, public, cutoff=0.8)
    if not meant:
        meant = _meant_by_a_part(word, foreign_names, {entry: f"{name}.{entry}" for entry in public})
    if not meant:
        fields = getattr(type(owner), "__dataclass_fields__", ())
        inner = [f"{part}.{entry}" for part in fields for entry in _numbers_of(getattr(owner, part, None))]
        found = keys_like(word, public) or keys_like(word, inner)
        meant = question(f"{name}.{key}" for key in found) or did_you_mean(word, public, cutoff=0.7)
    return AttributeError(f"{type(owner).__name__} has no '{word}'" + (f"; {meant}" if meant else ""))


def _meant_by_a_part(word: str, foreign_names: Mapping[str, str], public: Mapping[str, str]) -> str:
    """What does the longest name that a word has as its parts: get_actors, to_ros2, voxel_downsample."""
    parts = re.findall("[a-z]+", word.lower())
    if parts[:1] == ["set"]:
        return foreign_names.get("set", "")
    names = ["_".join(parts[i:j]) for i in range(len(parts)) for j in range(len(parts), i, -1)]
    calls = {**public, **foreign_names}
    return next((calls[name] for name in sorted(names, key=len, reverse=True) if name in calls), "")


def _numbers_of(part: object) -> list[str]:
    """Names of the fields and properties of a dataclass; [] of anything else."""
    kind = type(part)
    properties = [key for key in dir(kind) if not key.startswith("_") and isinstance(getattr(kind, key), property)]
    return [*getattr(kind, "__dataclass_fields__", ()), *properties] if is_dataclass(kind) else []


def _refuse_to_set(owner: HintedAttributes, word: str, _: object) -> None:
    """Refuse to set an attribute, and say what makes a changed object."""
    hint = f"; {owner.CHANGED_BY}" if owner.CHANGED_BY else ""
    raise FrozenInstanceError(f"{type(owner).__name__}.{word} cannot be set{hint}")


class HintedAttributes:
    """Base of a class whose objects answer an attribute that they lack, or that cannot be set, with what does it.

    Attributes:
        CHANGED_BY: what makes a changed one, of a class whose objects are frozen; "" if nothing does
    """

    __slots__ = ()
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {}
    CHANGED_BY: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "__setattr__" in vars(cls):  # a frozen dataclass, which says no more than that it cannot be set
            setattr(cls, "__setattr__", _refuse_to_set)  # noqa: B010

    if not TYPE_CHECKING:

        def __getattr__(self, word: str) -> Any:
            if word.startswith("_"):  # what Python and libraries look for
                raise AttributeError(f"{type(self).__name__} has no '{word}'")
            changes = dict.fromkeys(("replace", "set", "update", "copy", "with_", "overrides"), self.CHANGED_BY)
            foreign_names = {**changes, **self.FOREIGN_NAMES}
            raise no_attribute(self, word, name=type(self).__name__.lower(), foreign_names=foreign_names)
