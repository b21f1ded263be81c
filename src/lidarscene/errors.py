"""Errors: mistakes of the user or faults of the machine, each with one plain message."""

from __future__ import annotations

import difflib
import os
import re
import string
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping
from typing import Any

LONGEST = 1000
"""Most characters of a message, which may quote a user's text of any length."""


_OURS = (os.path.dirname(__file__) + os.sep, "<string>")
"""What the files of this package begin with, and the code that dataclasses make."""


def shorten(text: str) -> str:
    """Cut the middle out of a message longer than LONGEST: its ends name the mistake and what was expected."""
    if len(text) <= LONGEST:
        return text
    end = LONGEST // 4
    return f"{text[: LONGEST - end - 5]} ... {text[-end:]}"


def one_line(value: object) -> str:
    """Return what Python prints of a value, in one line of at most 60 characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."


def did_you_mean(word: object, choices: Iterable[str], *, most: int = 1, cutoff: float = 0.6) -> str:
    """Question for the choices that are most like a word, such as "did you mean 60 or 90?"; empty if none is.

    Args:
        cutoff: least likeness, from 0 to 1 (`difflib.get_close_matches`)
    """
    spelled = str(word)
    for american, british in SPELLINGS.items():
        spelled = spelled.replace(american, british)
    return question(difflib.get_close_matches(spelled, list(choices), n=most, cutoff=cutoff))


SPELLINGS = {"color": "colour", "gray": "grey", "center": "centre", "meter": "metre", "ization": "isation"}
"""American parts of words, and how names are spelled here."""


def meant_by_a_part(word: str, calls: Mapping[str, str]) -> str:
    """What the longest name in a word means, of names with what they mean; "" if there is none."""
    parts = [part.lower() for part in re.findall("[A-Z]+(?![a-z])|[A-Z]?[a-z]+", word)]
    if parts[:1] == ["set"]:
        return calls.get("set", "")
    names = ["_".join(parts[i:j]) for i in range(len(parts)) for j in range(len(parts), i, -1)]
    return next((calls[name] for name in sorted(names, key=len, reverse=True) if name in calls), "")


def question(choices: Iterable[str]) -> str:
    """Question whether one of these was meant, such as "did you mean 60 or 90?"; empty without any."""
    words = " or ".join(choices)
    return f"did you mean {words}?" if words else ""


class LidarSceneError(Exception):
    """Base of all errors for users: what is wrong, where (file and key), what came, what was expected.

    The message suffices without a traceback: the command line prints
    ``lidarscene: error: <message>`` and returns `exit_code`.
    """

    exit_code = 1

    def __str__(self) -> str:
        return shorten(super().__str__())


class InputError(LidarSceneError):
    """Raised when a file, a key or a value cannot be understood."""

    exit_code = 2


class OutputError(LidarSceneError):
    """Raised when a result cannot be written."""

    exit_code = 2


class BackendError(LidarSceneError):
    """Raised when Mitsuba has no back end (CUDA or LLVM) that works on this machine."""

    exit_code = 3

    def __str__(self) -> str:
        return Exception.__str__(self)


def warn(warning: Warning | str) -> None:
    """Warn, and name the line of the caller outside of this package: decorators and helpers of ours do not count."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_OURS):
        level, frame = level + 1, frame.f_back
    warnings.warn(OptionWarning("{0}", warning) if isinstance(warning, str) else warning, stacklevel=level)


class _NamingOptions(Exception):
    """Message that names options: in a template `{seed}` is an option and `{0}` is the first of the values.

    An option is `seed` in Python and `--seed` on the command line: `message_with` writes it either way.
    """

    def __init__(self, template: str, *values: object) -> None:
        self.template, self.values = template, values
        super().__init__(self.message_with(str))

    def message_with(self, name_of: Callable[[str], str]) -> str:
        """Message in which options have the names that ``name_of`` gives them."""
        return shorten(_OneLineFormatter().vformat(self.template, self.values, _Names(name_of)))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.template, *self.values)


class _OneLineFormatter(string.Formatter):
    """Formatter that writes what Python prints of a value in one line: that of an array has several."""

    def convert_field(self, value: Any, conversion: Any) -> Any:
        """Convert a value, by !r to one line."""
        return " ".join(repr(value).split()) if conversion == "r" else super().convert_field(value, conversion)


class _Names(Mapping[str, str]):
    """Mapping from every option to its name."""

    def __init__(self, name_of: Callable[[str], str]) -> None:
        self._name_of = name_of

    def __getitem__(self, option: str) -> str:
        return self._name_of(option)

    def __iter__(self) -> Any:
        return iter(())

    def __len__(self) -> int:
        return 0


class OptionError(_NamingOptions, InputError):
    """Raised when an option has a value that it cannot have, or does not go with another option."""


def placed(where: str, error: InputError) -> InputError:
    """Error with the place before it; options in it keep a name in Python and another on the command line."""
    if not isinstance(error, OptionError):
        return InputError(f"{where}: {error}")
    return OptionError(f"{where.replace('{', '{{').replace('}', '}}')}: {error.template}", *error.values)


class OptionWarning(_NamingOptions, UserWarning):
    """Issued when an option changes nothing, a sensor is not what it seems, or a figure cannot be drawn."""
