"""tools/costs.py: which tests `make quick` leaves out."""

import os
import subprocess
import sys
from pathlib import Path

from helpers import part
from helpers.child import FEW_PLUGINS, assert_ended

TOOLS = Path(__file__).parents[1] / "tools"
TESTS = '''
import time

import pytest


def work(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


@pytest.fixture(scope="module")
def heavy():
    work(0.8)


@pytest.mark.parametrize("case", range(3))
def test_of_cases(case):
    work(0.15)


def test_that_waits():
    time.sleep(0.5)


def test_of_light_work():
    work(0.01)


def test_that_shares(heavy):
    """0.4 s, whichever of the two runs first."""


def test_that_shares_too(heavy):
    pass
'''
RUN = """
import sys
from pathlib import Path
import pytest
import costs

costs.TESTS = Path(sys.argv[1])
options = ["-q", "-p", "costs", "-p", "no:cacheprovider", "-c", f"{sys.argv[1]}/pytest.ini"]
sys.exit(pytest.main([*sys.argv[2:], *options]))
"""


def run(folder: Path, *files: str) -> subprocess.CompletedProcess[str]:
    (folder / "pytest.ini").write_text("[pytest]\n")
    return subprocess.run(
        [sys.executable, "-c", RUN, folder, *(folder / file for file in files)],
        cwd=folder,
        env=FEW_PLUGINS | {"PYTHONPATH": f"{TOOLS}{os.pathsep}{TOOLS.parent / 'tests'}"},
        capture_output=True,
        text=True,
        check=False,
    )


def test_costly_functions_are_written(tmp_path: Path) -> None:
    """Cases count together, a fixture in equal shares, waiting as work. What did not run stays while it is there."""
    (tmp_path / "test_a.py").write_text(TESTS)
    (tmp_path / "test_b.py").write_text("def test_b(): pass")
    (tmp_path / "test_c.py").write_text("def test_c(): pass")
    lines = ("test_b.py: test_b=3.0", "test_c.py: test_c=2.0 test_gone=4.0", "test_d.py: test_gone=1.0")
    (tmp_path / "costly").write_text("\n".join(lines))
    assert_ended(run(tmp_path, "test_a.py", "test_b.py"))
    costs = part.read_costs(tmp_path / "costly")
    assert costs.pop("test_c.py") == {"test_c": 2.0}
    assert costs.keys() == {"test_a.py"}
    assert costs["test_a.py"].keys() == {"test_of_cases", "test_that_waits", "test_that_shares", "test_that_shares_too"}
    assert all(seconds >= 0.4 for seconds in costs["test_a.py"].values())
