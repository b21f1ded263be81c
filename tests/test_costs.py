"""tools/costs.py: which tests `make quick` leaves out."""

import json
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


def test_of_light_work():
    work(0.01)


def test_that_runs_what_others_do_not():
    work(0.4)


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
costs.MAP = costs.TESTS / "map"
sys.exit(pytest.main([sys.argv[1], "-q", "-p", "costs", "-p", "no:cacheprovider", "-c", sys.argv[2]]))
"""


def run(folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "pytest.ini").write_text("[pytest]\n")
    return subprocess.run(
        [sys.executable, "-c", RUN, folder, folder / "pytest.ini"],
        cwd=folder,
        env={"PYTHONPATH": str(TOOLS)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_costly_functions_are_written(tmp_path: Path) -> None:
    """Cases count together, and a fixture in equal shares; of a file whose tests are all costly there is a star. What
    runs functions of the sources that no other test runs may cost more.
    """
    (tmp_path / "test_a.py").write_text(TESTS)
    (tmp_path / "test_b.py").write_text(TESTS.replace("def test_of_light_work", "def not_a_test"))
    (tmp_path / "costly").write_text("test_a.py: test_gone\ntest_c.py: test_gone\n")
    (tmp_path / "map").mkdir()
    runs = {"test_a.py::test_that_runs_what_others_do_not": 10, "test_b.py::test_that_runs_what_others_do_not": 2}
    runs |= {"test_a.py::test_of_cases[1]": 1, "test_a.py::test_of_light_work": 1}
    lines = [json.dumps([f"tests/{test}", 0.1, [f"f{number}" for number in range(n)]]) for test, n in runs.items()]
    (tmp_path / "map" / "1.jsonl").write_text("\n".join(lines))
    assert_ended(run(tmp_path))
    written = (tmp_path / "costly").read_text()
    assert written == "test_a.py: test_of_cases test_that_shares test_that_shares_too\ntest_b.py: *\n"


def test_without_a_map_nothing_is_written(tmp_path: Path) -> None:
    (tmp_path / "test_a.py").write_text(TESTS)
    ended = run(tmp_path)
    assert ended.returncode
    assert "tools/costs.py: there is no map yet: run tools/mutants.py map first" in ended.stderr
    assert not (tmp_path / "costly").exists()
