"""Seed of a run of the suite: TEST_SEED, from which the order of the tests and their random streams follow."""

import os
import random
from collections.abc import Sequence
from pathlib import Path

import pytest

NAME = "TEST_SEED"


def run_seed() -> int | None:
    """Seed of this run: None if TEST_SEED is unset (fixed order and streams), else the number in TEST_SEED.

    TEST_SEED=random draws a number and leaves it in the environment, where xdist's workers find it.
    """
    value = os.environ.get(NAME, "")
    if value == "random":
        value = os.environ[NAME] = str(random.SystemRandom().randrange(2**32))
    if not value:
        return None
    if not value.isdecimal():
        raise pytest.UsageError(f"{NAME}: must be a whole number >= 0 or 'random', got {value!r}")
    return int(value)


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
