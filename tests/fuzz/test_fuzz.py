"""Spoilt files and command lines, from a seed: 0 tracebacks, 0 hangs, 0 files left.

`make fuzz` tries thousands (FUZZ_INPUTS, from FUZZ_SEED), and traces the frames of those that can be traced.
"""

import contextlib
import os
import warnings
from pathlib import Path
from typing import Any

import pytest
from helpers.fuzzing import bounded_memory, failures, untraced
from helpers.run_seed import run_seed

INPUTS = int(os.environ.get("FUZZ_INPUTS", "200"))
SEED = int(os.environ.get("FUZZ_SEED") or run_seed())
PARTS = int(os.environ.get("FUZZ_PARTS", "1"))


@pytest.mark.parametrize("part", range(PARTS))
def test_nothing_breaks_it(mi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: int) -> None:
    monkeypatch.chdir(tmp_path)
    share = INPUTS // PARTS
    is_traced = os.environ.get("FUZZ_TRACED") == "1"
    with warnings.catch_warnings(), bounded_memory(), contextlib.nullcontext() if is_traced else untraced():
        warnings.simplefilter("ignore")  # of NumPy, about numbers that overflow
        broken_inputs = list(failures(tmp_path, SEED, share, first=part * share))
    for place, fuzzed, reason in broken_inputs:
        print(f"{place}: {fuzzed.about[:300]}\n{reason}\n")  # noqa: T201 what pytest shows of a failure
    assert not broken_inputs, f"{len(broken_inputs)} of {share} inputs break it"
