"""Seconds of several tasks, taken in turns so that a busy machine slows all of them alike."""

import gc
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

Seconds = dict[str, np.ndarray]

SETTLED_S = 0.04
"""Dr.Jit's threads look for work for 20 ms after they had some, and would take a core from the task that comes next."""


def in_turns(tasks: Mapping[str, Callable[[], Any]], *, rounds: int, warm_up: int = 2) -> Seconds:
    """Seconds of each task in each round: A B C, A B C, ... What a task returns is freed off the clock."""
    return both_in_turns(tasks, rounds=rounds, warm_up=warm_up)[0]


def both_in_turns(tasks: Mapping[str, Callable[[], Any]], *, rounds: int, warm_up: int = 2) -> tuple[Seconds, Seconds]:
    """The same, and the seconds of the processor: of all threads of this process."""
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in tasks}
    with _collect_garbage() as sweep:
        for number in range(warm_up + rounds):
            for name, task in tasks.items():
                sweep()
                time.sleep(SETTLED_S)
                since, busy = time.perf_counter(), time.process_time()
                result = task()
                spent = time.perf_counter() - since, time.process_time() - busy
                del result
                if number >= warm_up:
                    seconds[name].append(spent)
    parts = {name: np.array(values) for name, values in seconds.items()}
    return (
        {name: values[:, 0] for name, values in parts.items()},
        {name: values[:, 1] for name, values in parts.items()},
    )


@contextmanager
def _collect_garbage() -> Iterator[Callable[[], Any]]:
    """What collects garbage, of what comes up in this block alone.

    Libraries have a million objects, and to go through these takes 0.1 s: half the time of a run of all parts.
    """
    gc.collect()
    gc.freeze()
    try:
        yield gc.collect
    finally:
        gc.unfreeze()


def ratio(seconds: Seconds, slow: str, fast: str) -> tuple[float, float, float]:
    """Median, lowest and highest over the rounds of how many times as long ``slow`` took as ``fast``."""
    ratios = seconds[slow] / seconds[fast]
    return float(np.median(ratios)), float(ratios.min()), float(ratios.max())
