#!/usr/bin/env python3
"""The CPU that each test takes, by which `make quick` leaves out what costs much.

    tools/costs.py [TESTS...]      runs these tests (default: all) in one process and writes tests/costly anew

A function is costly if its cases take LIMIT_S together and CASE_S each, with the processes that they start and their
share of the fixtures that they have in common. The others, of every folder, are most of the tests and take a tenth of
the time.
"""

import os
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
TESTS = ROOT / "tests"
LIMIT_S = 0.25
CASE_S = 0.03
"""Choice: 2,700 of 3,350 functions stay, which take a tenth of the CPU."""
ALL = "*"
"""Of a file whose functions are all costly: it need not be imported."""


def cpu_s() -> float:
    """Time of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def costly(costs: Mapping[tuple[str, str], float], cases: Mapping[tuple[str, str], int]) -> dict[str, list[str]]:
    """Names of costly functions by file, from the cost and the number of cases of each (file, function)."""
    names: dict[str, list[str]] = {}
    for path in sorted({path for path, _ in costs}):
        functions = sorted(function for function in costs if function[0] == path)
        over = [key[1] for key in functions if costs[key] >= max(LIMIT_S, CASE_S * cases[key])]
        names[path] = [ALL] if len(over) == len(functions) else over
    return names


def read(path: Path) -> dict[str, list[str]]:
    """Names of costly functions by file."""
    lines = (line.partition(": ") for line in path.read_text(encoding="utf-8").splitlines())
    return {name: functions.split() for name, _, functions in lines}


class Costs:
    """Plugin of pytest: measures, and renews the lines of the files that ran."""

    def __init__(self) -> None:
        self.spent: dict[tuple[str, str], float] = defaultdict(float)
        self.cases: Counter[tuple[str, str]] = Counter()
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
        self.cases[_function(item)] += 1
        return value

    def pytest_sessionfinish(self) -> None:
        """Share the fixtures out, and write."""
        for fixture, cost_s in self.shared.items():
            for function in self.users[fixture]:
                self.spent[function] += cost_s / len(self.users[fixture])
        path = TESTS / "costly"
        lines = read(path) | costly(self.spent, self.cases)
        kept = {name: names for name, names in lines.items() if names and (TESTS / name).exists()}
        path.write_text("".join(f"{name}: {' '.join(kept[name])}\n" for name in sorted(kept)), encoding="utf-8")


def _function(item: pytest.Item) -> tuple[str, str]:
    """File, below tests/, and name of a test's function."""
    return item.path.relative_to(TESTS).as_posix(), item.name.partition("[")[0]


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(Costs())


if __name__ == "__main__":
    command = [sys.executable, "-m", "pytest", "-p", "costs", "-q", "-n", "0", *(sys.argv[1:] or ["tests"])]
    paths = os.pathsep.join(map(str, (ROOT / "tools", ROOT / "src")))
    sys.exit(subprocess.run(command, cwd=ROOT, env=os.environ | {"PYTHONPATH": paths}, check=False).returncode)
