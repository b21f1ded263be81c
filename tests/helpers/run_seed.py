"""Seed of a run of the suite: TEST_SEED, from which the order of the tests and their random streams follow."""

import os
import random
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

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
