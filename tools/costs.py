#!/usr/bin/env python3
"""The CPU that each test takes, by which `make quick` leaves out what costs more than it adds.

    tools/costs.py [TESTS...]      runs these tests (default: all) in one process and writes tests/costly anew

A function of tests is costly if its cases take LIMIT_S together, with the processes that they start and their share of
the fixtures that they have in common; unless it runs functions of the sources that no other test of `make quick` runs,
and takes no more than NEW_S for each. What a test runs stands in the map of tools/mutants.py, which is made before.
"""

import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Collection, Generator, Mapping
from pathlib import Path
from typing import Any

import mutants
import pytest

ROOT = Path(__file__).resolve().parents[1]
TESTS = ROOT / "tests"
MAP = mutants.KEPT / "map"
Test = tuple[str, str]
"""File, below tests/, and name of a function of tests."""
LIMIT_S = 0.2
"""Choice: 2,435 of 3,330 functions stay whatever they run, and take 90 s."""
NEW_S = 0.1
"""Choice: 13 more, which take 6 s, run 230 functions of the sources that those do not."""
ALL = "*"
"""Of a file whose functions are all costly: it need not be imported."""


def cpu_s() -> float:
    """Time of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def costly(costs: Mapping[Test, float], runs: Mapping[Test, Collection[str]], known: set[str]) -> dict[str, list[str]]:
    """Names of costly functions by file.

    Args:
        costs: CPU of each function in seconds
        runs: functions of the sources that each runs
        known: functions of the sources that other tests run
    """
    over = {test for test, cost in costs.items() if cost >= LIMIT_S}
    known = known.union(*(runs.get(test, ()) for test in costs.keys() - over))
    while over:
        new = {test: len(set(runs.get(test, ())) - known) for test in over}
        best = max(sorted(over), key=lambda test: new[test] / costs[test])
        if new[best] * NEW_S < costs[best]:
            break
        over.remove(best)
        known |= set(runs[best])
    names: dict[str, list[str]] = {}
    for path in sorted({path for path, _ in costs}):
        functions = [name for file, name in costs if file == path]
        left_out = sorted(name for file, name in over if file == path)
        names[path] = [ALL] if len(left_out) == len(functions) else left_out
    return names


def runs_of_tests() -> dict[Test, set[str]]:
    """Functions of the sources that each function of tests runs, from the map of tools/mutants.py."""
    runs: dict[Test, set[str]] = defaultdict(set)
    for name, tests in mutants.Map(MAP).tests.items():
        for test in tests:
            path, _, function = test.partition("[")[0].partition("::")
            runs[path.removeprefix("tests/"), function].add(name)
    return runs


def read(path: Path) -> dict[str, list[str]]:
    """Names of costly functions by file."""
    lines = (line.partition(": ") for line in path.read_text(encoding="utf-8").splitlines())
    return {name: functions.split() for name, _, functions in lines}


class Costs:
    """Plugin of pytest: measures, and renews the lines of the files that ran."""

    def __init__(self) -> None:
        self.runs = runs_of_tests()
        if not self.runs:
            raise pytest.UsageError("tools/costs.py: there is no map yet: run tools/mutants.py map first")
        self.spent: dict[Test, float] = defaultdict(float)
        self.shared: dict[Any, float] = defaultdict(float)
        self.users: dict[Any, set[Test]] = defaultdict(set)
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
        path = TESTS / "costly"
        ran, before = {file for file, _ in self.spent}, read(path)
        others = [
            runs
            for (file, name), runs in self.runs.items()
            if file not in ran and not {ALL, name} & set(before.get(file, ()))
        ]
        lines = before | costly(self.spent, self.runs, set().union(*others))
        kept = {name: names for name, names in lines.items() if names and (TESTS / name).exists()}
        path.write_text("".join(f"{name}: {' '.join(kept[name])}\n" for name in sorted(kept)), encoding="utf-8")


def _function(item: pytest.Item) -> Test:
    """The function of a test."""
    return item.path.relative_to(TESTS).as_posix(), item.name.partition("[")[0]


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(Costs())


if __name__ == "__main__":
    command = [sys.executable, "-m", "pytest", "-p", "costs", "-q", "-n", "0", *(sys.argv[1:] or ["tests"])]
    paths = os.pathsep.join(map(str, (ROOT / "tools", ROOT / "src")))
    sys.exit(subprocess.run(command, cwd=ROOT, env=os.environ | {"PYTHONPATH": paths}, check=False).returncode)
