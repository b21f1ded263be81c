"""How tests wait: for what happens. A deadline is not a measure of speed; it ends what hangs, and nothing else."""

import time
from collections.abc import Callable

PATIENCE_S = 1200.0
"""Ten times the two minutes that the slowest of these waits stays below on two quiet cores."""


def wait_until(happened: Callable[[], bool]) -> None:
    """Look again and again, until it has happened."""
    deadline = time.monotonic() + PATIENCE_S
    while not happened():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.02)
