"""TEST_SEED: which streams a process of a run draws."""

import os
import subprocess
from collections.abc import Callable

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
