"""Seconds of several tasks, taken in turns so that a busy machine slows all of them alike."""

import gc
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

Seconds = dict[str, np.ndarray]

WALL, CPU = time.perf_counter, time.process_time


def in_turns(
    tasks: Mapping[str, Callable[[], Any]],
    *,
    rounds: int,
    warm_up: int = 2,
    clock: Callable[[], float] = WALL,
) -> Seconds:
    """Seconds of each task in each round: A B C, A B C, ... What a task returns is freed off the clock.

    clock  `WALL`, or `CPU` for the time of all threads of this process
    """
    seconds: dict[str, list[float]] = {name: [] for name in tasks}
    for number in range(warm_up + rounds):
        for name, task in tasks.items():
            gc.collect()
            since = clock()
            result = task()
            spent = clock() - since
            del result
            if number >= warm_up:
                seconds[name].append(spent)
    return {name: np.array(values) for name, values in seconds.items()}


def ratio(seconds: Seconds, slow: str, fast: str) -> tuple[float, float, float]:
    """Median, lowest and highest over the rounds of how many times as long ``slow`` took as ``fast``."""
    ratios = seconds[slow] / seconds[fast]
    return float(np.median(ratios)), float(ratios.min()), float(ratios.max())
