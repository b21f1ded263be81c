"""TEST_SEED: which streams a process of a run draws."""

import os
import subprocess
from collections.abc import Callable

import pytest
from helpers.run_seed import NAME, examples

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


def test_examples_are_of_their_domains_with_their_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Others for another seed, the same again for the same one; those that are given come first."""
    cases: list[tuple[float, int, str]] = []

    @examples(200, {"x": 7.0, "n": 9, "name": "given"}, x=(1.0, 2.0), n=range(3, 6), name=["a", "b"])
    def test(x: float, n: int, name: str) -> None:
        cases.append((x, n, name))

    runs = []
    for seed in ("1", "2", "1"):
        monkeypatch.setenv(NAME, seed)
        cases.clear()
        test()
        runs.append(cases.copy())
    assert runs[0] == runs[2] != runs[1]
    assert runs[0].pop(0) == (7.0, 9, "given")
    numbers, counts, names = map(set, zip(*runs[0], strict=True))
    assert {1.0, 2.0} < numbers
    assert all(1.0 <= x <= 2.0 for x in numbers)
    assert (counts, names) == ({3, 4, 5}, {"a", "b"})
