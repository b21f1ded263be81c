"""TEST_SEED: which streams a process of a run draws. CASE_SEED: which cases."""

import os
import subprocess
from collections.abc import Callable

import pytest
from helpers.run_seed import CASES_NAME, NAME, chosen, run_seed

DRAW = """
import subprocess, sys
import reseed
import numpy as np
from lidarscene.maths import random

CODE = "import numpy as np; print(int(np.random.default_rng(3).integers(2**32)))"
for paused in {paused}:
    reseed.pause(paused)
    started = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True).stdout
    words = random.words(seed=3, stage=1, pulse=np.arange(1, dtype=np.uint32))
    print(int(np.random.default_rng(3).integers(2**32)), int(started), int(words[0][0]))
"""


def test_a_run_has_streams_of_its_own(run_python: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    """Other numbers for another seed, the same in a process that is started; the fixed ones while a run is paused."""

    def drawn(seed: str, *paused: bool) -> list[list[int]]:
        done = run_python(DRAW.format(paused=paused), TEST_SEED=seed, PYTHONPATH=path)
        return [[int(number) for number in line.split()] for line in done.stdout.splitlines()]

    path = os.environ["PYTHONPATH"]  # ours and that of `reseed`, by conftest.py
    (fixed,), (one, paused), (other,) = drawn("", False), drawn("1", False, True), drawn("2", False)
    for numbers in (fixed, one, other):
        assert numbers[0] == numbers[1]
    assert len({fixed[0], one[0], other[0]}) == len({fixed[2], one[2], other[2]}) == 3
    assert paused == fixed


def test_cases_are_drawn_anew_on_a_known_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same ones by the number that the first process leaves to the others."""
    monkeypatch.setenv(NAME, "3740570311")
    drawn = []
    for _ in range(4):
        monkeypatch.delenv(CASES_NAME, raising=False)
        cases = chosen(8, range(10**9))
        assert os.environ[CASES_NAME].isdecimal()
        assert chosen(8, range(10**9)) == cases
        drawn.append(cases)
    assert len(set(map(tuple, drawn))) > 1
    assert run_seed() == 3740570311
    monkeypatch.setenv(CASES_NAME, "7")
    first = chosen(2, "abcdef")
    monkeypatch.setenv(NAME, "8")
    assert chosen(2, "abcdef") == first
    monkeypatch.setenv("EVERY_CASE", "1")
    assert chosen(2, "abcdef") == list("abcdef")
    monkeypatch.delenv("EVERY_CASE")
    monkeypatch.setenv(CASES_NAME, "seven")
    with pytest.raises(pytest.UsageError, match="CASE_SEED: must be a whole number >= 0, got 'seven'"):
        chosen(2, "abcdef")
