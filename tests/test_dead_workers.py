"""A run of the tests in which one dies or hangs: it ends soon, red, and says which one it was."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.child import FEW_PLUGINS
from helpers.run_seed import chosen
from helpers.waiting import PATIENCE_S

TESTS = Path(__file__).parent

ENDINGS = {
    "dies": ("os.abort()", ()),
    "hangs": ("wait_for_ever()", ("-o", "faulthandler_timeout=3", "-o", "timeout=4")),
}
AS_MAKE = "-p helpers.dead_workers -p no:cacheprovider -n 2 --dist loadfile --no-loadscope-reorder"
CULPRIT = """
import os, threading

def wait_for_ever():
    threading.Event().wait()

def test_culprit():
    {call}
"""
SLOW = """
import time, pytest

@pytest.mark.parametrize("number", range(600))
def test_slow(number):
    time.sleep(1.0)
"""


@pytest.mark.parametrize("ending", chosen(1, [*ENDINGS]))
def test_a_run_ends_with_the_worker_of_a_test(ending: str, tmp_path: Path) -> None:
    """The run has the options of pyproject.toml, and files handed out as by `make test`: at most half of the other
    tests are run, which take ten minutes.
    """
    call, options = ENDINGS[ending]
    (tmp_path / "test_a.py").write_text(CULPRIT.format(call=call))
    (tmp_path / "test_b.py").write_text(SLOW)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    start = [sys.executable, "-m", "pytest", "-c", TESTS.parent / "pyproject.toml", "--rootdir", tmp_path]
    done = subprocess.run(
        [*start, *AS_MAKE.split(), *options, tmp_path],
        env=environment | FEW_PLUGINS | {"PYTHONPATH": str(TESTS)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done.stdout
    assert "crashed while running 'test_a.py::test_culprit'" in done.stdout
    assert "in test_culprit" in done.stderr
    summary = re.search(r"= 1 failed(?:, (\d+) passed)? in ", done.stdout)
    assert summary is not None
    assert int(summary[1] or 0) < 300
