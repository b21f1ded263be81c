#!/usr/bin/env python3
"""The CPU that each test takes, by which `make quick` leaves out what takes much (tests/helpers/part.py).

    tools/costs.py [TESTS...]      runs these tests (default: all) in one process and writes tests/costly anew

A function of tests takes much if its cases take LIMIT_S together, with the processes that they start and their share of
the fixtures that they have in common.
"""

import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
TESTS = ROOT / "tests"
LIMIT_S = 0.15
"""Choice: 2,500 of 3,350 functions stay, and take 70 s on one core."""


def cpu_s() -> float:
    """Time of this process and of those that it has waited for."""
    return sum(os.times()[:4])


class Costs:
    """Plugin of pytest: measures, and renews the lines of the files that ran."""

    def __init__(self) -> None:
        self.spent: dict[tuple[str, str], float] = defaultdict(float)
        self.shared: dict[Any, float] = defaultdict(float)
        self.users: dict[Any, set[tuple[str, str]]] = defaultdict(set)
        self.apart_s = 0.0

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Note which functions have which fixtures in common."""
        for item in session.items:
            for definitions in getattr(item, "_fixtureinfo").name2fixturedefs.values():  # noqa: B009
                self.users[definitions[-1]].add(_function(item))

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Generator[None, object, object]:
        """Time a fixture that several tests may have in common."""
        begin_s = cpu_s()
        value = yield
        if fixturedef.scope != "function":
            self.shared[fixturedef] += cpu_s() - begin_s
            self.apart_s += cpu_s() - begin_s
        return value

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Time a test, without such fixtures."""
        begin_s, self.apart_s = cpu_s(), 0.0
        value = yield
        self.spent[_function(item)] += cpu_s() - begin_s - self.apart_s
        return value

    def pytest_sessionfinish(self) -> None:
        """Share the fixtures out, and write."""
        for fixture, cost_s in self.shared.items():
            for function in self.users[fixture]:
                self.spent[function] += cost_s / len(self.users[fixture])
        from helpers.part import read_costs, write_costs  # pytest finds it, the command that starts pytest does not

        path = TESTS / "costly"
        costs = {file: functions for file, functions in read_costs(path).items() if (TESTS / file).exists()}
        costs |= {file: {} for file, _ in self.spent}
        for (file, name), spent_s in self.spent.items():
            if spent_s >= LIMIT_S:
                costs[file][name] = spent_s
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
