"""Seeds of a run of the suite: TEST_SEED of the order of the tests and their random streams, CASE_SEED of `chosen`."""

import os
import random
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import pytest

NAME = "TEST_SEED"
CASES_NAME = "CASE_SEED"
EVERY_NAME = "EVERY_CASE"


def run_seed(name: str = NAME) -> int:
    """Seed of this run: the number in this variable; without one it is drawn, and left there for xdist's workers."""
    value = os.environ.get(name) or str(random.SystemRandom().randrange(2**32))
    if not value.isdecimal():
        raise pytest.UsageError(f"{name}: must be a whole number >= 0, got {value!r}")
    os.environ[name] = value
    return int(value)


Case = TypeVar("Case")


def chosen(count: int, cases: Sequence[Case]) -> list[Case]:
    """Some of many cases for `parametrize`, others in each run, also on a known TEST_SEED; EVERY_CASE=1 takes all."""
    if os.environ.get(EVERY_NAME) == "1":
        return list(cases)
    return random.Random(run_seed(CASES_NAME)).sample(cases, count)


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
