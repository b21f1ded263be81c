"""Errors: mistakes of the user or of the machine, each told in one plain message."""

import string
from collections.abc import Callable, Mapping
from typing import Any

LONGEST = 1000
"""Letters of a message. A user's text may be in it, of any length; a line that fills the screen tells nothing."""


def shortened(text: str) -> str:
    """A message without its middle if it is longer than LONGEST: its ends say what is wrong, and what was expected."""
    if len(text) <= LONGEST:
        return text
    end = LONGEST // 4
    return f"{text[: LONGEST - end - 5]} ... {text[-end:]}"


class LidarSceneError(Exception):
    """A mistake of the user or the machine: what, where (file and key), what came, what was expected.

    The message is the whole story, without a traceback: the command line prints
    ``lidarscene: error: <message>`` and returns `exit_code`.
    """

    exit_code = 1

    def __str__(self) -> str:
        return shortened(super().__str__())


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


class _NamingOptions(Exception):
    """A message that names options: in a template `{seed}` is an option and `{0}` is the first of the values.

    Python users know an option as `seed`, users of the command line as `--seed`: `message_with` writes it either way.
    """

    def __init__(self, template: str, *values: object) -> None:
        self.template, self.values = template, values
        super().__init__(self.message_with(str))

    def message_with(self, name_of: Callable[[str], str]) -> str:
        """The message with the names that ``name_of`` gives to the options."""
        return shortened(string.Formatter().vformat(self.template, self.values, _Names(name_of)))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.template, *self.values)


class _Names(Mapping[str, str]):
    """Every option by its name."""

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


class OptionWarning(_NamingOptions, UserWarning):
    """Warned of when an option changes nothing, or a sensor is not what it seems."""
