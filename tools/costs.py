#!/usr/bin/env python3
"""The time that each test takes, by which `make quick` leaves out what takes much (tests/helpers/part.py).

    tools/costs.py [TESTS...]      runs these tests (default: all) in one process and writes their costs in tests/costly
    tools/costs.py --part=quick    those that `make quick` runs, to leave out those that have become slower

A function of tests takes much if its cases take LIMIT_S together, with the processes that they start and their share of
the fixtures that they have in common: of CPU, or of time in which they wait.
"""

import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
TESTS = ROOT / "tests"
LIMIT_S = 0.15
"""Choice: 2,410 of 3,440 functions stay, and take 70 s on one core."""
SCHEDULED = Path("/proc/self/schedstat")
"""Linux: nanoseconds of CPU of this thread, and those in which it was ready and others had the cores."""


def spent_s() -> NDArray[np.float64]:
    """CPU of this process and of those that it has waited for, and the clock while it runs or waits for something."""
    others_s = int(SCHEDULED.read_text().split()[1]) * 1e-9 if SCHEDULED.exists() else 0.0
    return np.array([sum(os.times()[:4]), time.perf_counter() - others_s])


class Costs:
    """Plugin of pytest: measures, and renews the lines of the files that ran."""

    def __init__(self) -> None:
        self.spent: dict[tuple[str, str], NDArray[np.float64]] = defaultdict(lambda: np.zeros(2))
        self.shared: dict[Any, NDArray[np.float64]] = defaultdict(lambda: np.zeros(2))
        self.users: dict[Any, set[tuple[str, str]]] = defaultdict(set)
        self.apart_s = np.zeros(2)

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Note which functions have which fixtures in common."""
        for item in session.items:
            for definitions in getattr(item, "_fixtureinfo").name2fixturedefs.values():  # noqa: B009
                self.users[definitions[-1]].add(_function(item))

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Generator[None, object, object]:
        """Time a fixture that several tests may have in common."""
        begin_s = spent_s()
        value = yield
        if fixturedef.scope != "function":
            self.shared[fixturedef] += (took_s := spent_s() - begin_s)
            self.apart_s += took_s
        return value

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Time a test, without such fixtures."""
        begin_s, self.apart_s = spent_s(), np.zeros(2)
        value = yield
        self.spent[_function(item)] += spent_s() - begin_s - self.apart_s
        return value

    def pytest_sessionfinish(self) -> None:
        """Share the fixtures out, and write."""
        for fixture, cost_s in self.shared.items():
            for function in self.users[fixture]:
                self.spent[function] += cost_s / len(self.users[fixture])
        from helpers.part import read_costs, write_costs  # pytest finds it, the command that starts pytest does not

        path = TESTS / "costly"
        texts = {file: (TESTS / file).read_text("utf-8") for file in read_costs(path) if (TESTS / file).exists()}
        costs = {
            file: {name: cost_s for name, cost_s in read_costs(path)[file].items() if name in text}
            for file, text in texts.items()
        }
        for (file, name), times_s in self.spent.items():
            costs.setdefault(file, {}).pop(name, None)
            if times_s.max() >= LIMIT_S:
                costs[file][name] = float(times_s.max())
        write_costs(path, costs)


def _function(item: pytest.Item) -> tuple[str, str]:
    """The function of a test."""
    return item.path.relative_to(TESTS).as_posix(), item.name.partition("[")[0]


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(Costs())


if __name__ == "__main__":
    command = [sys.executable, "-m", "pytest", "-p", "costs", "-q", "-n", "0", *(sys.argv[1:] or ["tests"])]
    paths = os.pathsep.join(map(str, (ROOT / "tools", ROOT / "src", ROOT / "tests")))
    sys.exit(subprocess.run(command, cwd=ROOT, env=os.environ | {"PYTHONPATH": paths}, check=False).returncode)
