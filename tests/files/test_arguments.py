"""What fits an annotation, and the words for it."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

import numpy as np
import pytest
from helpers.mistakes import told

from lidarscene.files.arguments import CHECKED_INSIDE, checks_arguments, require_type

File = str | os.PathLike[str]


class Moves(Protocol):
    """Something with a method."""

    def at(self, time_s: float) -> float:
        """Place at a time."""


class Course:
    """What moves."""

    at = staticmethod(float)


@pytest.mark.parametrize(
    ("hint", "fitting", "others", "words"),
    [
        (int, [1, np.int32(1), 10**40], [True, 1.0, "1", None], "a whole number"),
        (float, [1, 1.0, np.float32(1), np.nan], [True, 1j, "1", np.zeros(1)], "a number"),
        (bool, [True, np.True_], [1, "yes", None], "True or False"),
        (str, ["", "a"], [b"a", Path("a"), None], "a text"),
        (File, ["a", Path("a")], [b"a", 1, None], "the name of a file"),
        (File | Course | None, ["a", None, Course()], [1, [None]], "a name, a file, a Course or None"),
        (Sequence[float], [[], [1, 2.0], (1,), np.arange(3), range(2)],
         ["ab", ["a"], {1.0}, np.eye(2), np.array(1), iter([1.0])], "a list, each a number"),
        (Iterable[str], [["a"], {"a"}, iter("ab")], ["a", {"a": 1}, [1]], "a list, each a text"),
        (tuple[int, int], [(1, 2), [1, 2], np.arange(2)], [(1,), (1, 2, 3), (1, "a"), "ab"],
         "a list, each a whole number"),
        (tuple[int, ...], [(), (1, 2, 3)], [("a",)], "a list, each a whole number"),
        (Mapping[str, float], [{}, {"a": 1}], [{1: 1}, {"a": "b"}, [("a", 1)]], "a dict"),
        (Literal["a", "b"], ["a"], ["c", ["a"], None], "'a' or 'b'"),
        (Callable[[int], int], [len, Course], [1, "len"], "a function"),
        (Moves, [Course()], [1, None], "a Moves"),
        (Annotated[int, "a count"], [1], ["a"], "a count"),
        (Annotated[int, CHECKED_INSIDE], [1, "a"], [], ""),
        (Any, [1, None, object()], [], ""),
    ],
)  # fmt: skip
def test_what_fits(hint: Any, fitting: list[Any], others: list[Any], words: str) -> None:
    for value in fitting:
        require_type("count", value, hint)
    for value in others:
        with told(f"count | {words} | {type(value).__name__}"):
            require_type("count", value, hint)


def test_public_methods_are_checked_and_a_value_stands_in_one_line() -> None:
    @checks_arguments
    class Counter:
        def __init__(self, start: int = 0) -> None:
            self.count = start

        def add(self, numbers: Sequence[int]) -> int:
            return self._sum(numbers)

        def _sum(self, numbers: Any) -> int:
            return self.count + sum(numbers)

        @staticmethod
        def double(number: int) -> int:
            return 2 * number

        @classmethod
        def from_text(cls, text: str) -> int:
            return cls(int(text)).count

    assert (Counter(1).add([2]), Counter.double(2), Counter.from_text("3")) == (3, 4, 3)
    with told("start | whole number | 'a'"):
        Counter("a")
    with told("whole number | list"):
        Counter().add([np.eye(2)])
    with told("number | whole number | NoneType"):
        Counter.double(None)
    with told(" | ".join(("text: ", "a text", "int"))):
        Counter.from_text(3)
