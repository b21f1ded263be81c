"""tools/costs.py: which tests `make quick` leaves out."""

import subprocess
import sys
from pathlib import Path

from helpers.child import assert_ended

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


@pytest.mark.parametrize("case", range(30))
def test_of_light_cases(case):
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
sys.exit(pytest.main([sys.argv[1], "-q", "-p", "costs", "-p", "no:cacheprovider", "-c", sys.argv[2]]))
"""


def test_costly_functions_are_written(tmp_path: Path) -> None:
    """Cases count together unless each is light, and a fixture in equal shares; of a file whose tests are all costly
    there is a star.
    """
    (tmp_path / "test_a.py").write_text(TESTS)
    (tmp_path / "test_b.py").write_text(TESTS.replace("def test_of_light_cases", "def not_a_test"))
    (tmp_path / "costly").write_text("test_a.py: test_gone\ntest_c.py: test_gone\n")
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    ran = subprocess.run(
        [sys.executable, "-c", RUN, tmp_path, tmp_path / "pytest.ini"],
        cwd=tmp_path,
        env={"PYTHONPATH": str(TOOLS)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert_ended(ran)
    written = (tmp_path / "costly").read_text()
    assert written == "test_a.py: test_of_cases test_that_shares test_that_shares_too\ntest_b.py: *\n"
