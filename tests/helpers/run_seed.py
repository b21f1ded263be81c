"""Seed of a run of the suite: TEST_SEED, from which the order of the tests and their random streams follow."""

import os
import random
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import pytest

NAME = "TEST_SEED"


def run_seed() -> int:
    """Seed of this run: the number in TEST_SEED; without one it is drawn, and left there for xdist's workers."""
    value = os.environ.get(NAME) or str(random.SystemRandom().randrange(2**32))
    if not value.isdecimal():
        raise pytest.UsageError(f"{NAME}: must be a whole number >= 0, got {value!r}")
    os.environ[NAME] = value
    return int(value)


Case = TypeVar("Case")


def chosen(count: int, cases: Sequence[Case]) -> list[Case]:
    """Some of many cases for `parametrize`, others in each run."""
    return random.Random(run_seed()).sample(cases, count)


Domain = Sequence[Any] | tuple[float, float]
"""Of an argument: a list or range of what it may be, or the ends of an interval."""
ENDS = 0.1
"""Choice: share of the arguments that are the first or the last of their domain, where functions break first."""


def examples(
    count: int, *more: Mapping[str, Any], **domains: Domain
) -> Callable[[Callable[..., None]], Callable[[], None]]:
    """Call a test for these cases, and for others of a domain in each run; a failure shows its arguments.

    Args:
        count: cases that are drawn
        more: arguments of cases that every run has
        domains: by the argument's name
    """

    def calls(test: Callable[..., None]) -> Callable[[], None]:
        def of_all_cases() -> None:
            draw = random.Random(f"{run_seed()} {test.__qualname__}")
            for case in more:
                test(**case)
            for _ in range(count):
                test(**{name: _drawn(draw, domain) for name, domain in domains.items()})

        of_all_cases.__name__, of_all_cases.__doc__ = test.__name__, test.__doc__
        return of_all_cases

    return calls


def _drawn(draw: random.Random, domain: Domain) -> Any:
    if draw.random() < ENDS:
        return domain[draw.choice((0, -1))]
    return draw.uniform(*domain) if isinstance(domain, tuple) else draw.choice(domain)


def shuffle(items: Sequence[pytest.Item], seed: int) -> list[pytest.Item]:
    """Reorder tests at random: the files among each other, and the tests of each file."""
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    order = random.Random(seed)
    paths = list(files)
    order.shuffle(paths)
    for tests in files.values():
        order.shuffle(tests)
    return [item for path in paths for item in files[path]]
