"""Plugin of pytest: a test that fails runs again on other seeds, since a statistical test fails by chance at times.

The limits of such tests are passed by chance once in some ten thousand tests, and every run draws its seed. Failing on
one seed of six is chance, and reported as such; failing on two is not. What does not draw by the run's seed has no
chance, nor has what passes on the same seed again: its cause is what a process does once, or what came before.
Hypothesis' examples and spoilt inputs (tests/fuzz) are counterexamples: they fail at once.
"""

import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import reseed
from _pytest.runner import runtestprotocol

from helpers.run_seed import NAME

OTHERS = 5
"""Further seeds, those that follow the run's. A test with a false alarm in a hundred runs fails one run in 2,000."""
PROPERTY = "chance"


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool:
    """Run a test as pytest does, and again if it fails; report it once."""
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports = runtestprotocol(item, log=False, nextitem=nextitem)
    if _failed(reports):
        reports = _judged(item, reports)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, tuple[str, dict[str, bool]]] | None:
    """Count a test that failed by chance as such, in the line at the end."""
    if report.when == "call" and report.passed and _chance(report):
        return "failed by chance", "c", ("FAILED BY CHANCE", {"yellow": True})
    return None


def pytest_terminal_summary(terminalreporter: Any) -> None:
    for report in terminalreporter.stats.get("failed by chance", ()):
        terminalreporter.line(f"failed by chance: {report.nodeid}: {_chance(report)}", yellow=True)


def _chance(report: pytest.TestReport) -> str | None:
    return next((str(text) for name, text in report.user_properties if name == PROPERTY), None)


def _failed(reports: Sequence[pytest.TestReport]) -> bool:
    return any(report.failed for report in reports)


def _judged(item: pytest.Item, first: list[pytest.TestReport]) -> list[pytest.TestReport]:
    """Reports of a test that failed on the run's seed: of a pass, if it passes on all others."""
    failure = next(report for report in first if report.failed)
    if item.get_closest_marker("fuzz") or getattr(getattr(item, "obj", None), "is_hypothesis_test", False):
        return first
    try:
        item.session._setupstate.teardown_exact(None)  # what the module and the session have drawn is made anew
    except Exception as error:
        failure.sections.append((PROPERTY, f"not run again: a fixture ends with {error!r}"))
        return first
    reports = first
    for number, (seed, again, has_drawn) in enumerate(_runs(item)):
        if number == 0 and not has_drawn:
            failure.sections.append((PROPERTY, "not run on other seeds: it does not draw by the run's seed"))
            return first
        if number == 0:
            if not _failed(again):
                failure.sections.append((PROPERTY, f"passes on {NAME}={seed} again: its cause is not the seed"))
                return first
            continue
        if _failed(again):
            failure.sections.append((PROPERTY, f"failed on {NAME}={reseed.RUN} and on {NAME}={seed}"))
            return first
        reports = again
    crash = getattr(failure.longrepr, "reprcrash", None)
    message = (crash.message if crash else failure.longreprtext).strip().splitlines()[0]
    for report in reports:
        text = f"on {NAME}={reseed.RUN}, and not on the {OTHERS} seeds that follow: {message}"
        report.user_properties.append((PROPERTY, text))
    return reports


def _runs(item: pytest.Item) -> Iterator[tuple[int, list[pytest.TestReport], bool]]:
    """Run a test on the run's seed and on others, each with fixtures and caches of its own; whether it draws by it."""
    assert reseed.RUN is not None
    seed = int(reseed.RUN)
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder) / "drawn"
        os.environ[reseed.READ] = str(trace)
        try:
            for number in range(OTHERS + 1):
                _forget(item)
                other = (seed + number) % 2**32
                reseed.set_run(other)
                reports = runtestprotocol(item, log=False, nextitem=None)
                reseed.set_run(seed)
                yield other, reports, trace.exists()
        finally:
            reseed.set_run(seed)
            del os.environ[reseed.READ]
            _forget(item)


def _forget(item: pytest.Item) -> None:
    """Empty the caches of the functions of a test's module and of the helpers."""
    helpers = [module for name, module in sys.modules.items() if name.startswith("helpers.")]
    for module in (getattr(item, "module", None), *helpers):
        for value in vars(module).values() if module is not None else ():
            if callable(clear := getattr(value, "cache_clear", None)):
                clear()
