"""A test that fails runs again on other seeds: tests/helpers/chance.py."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.waiting import PATIENCE_S

TESTS = Path(__file__).parent
DRAWS = """
import functools, os, subprocess, sys
import numpy as np
import pytest

@functools.cache
def cached():
    return int(np.random.default_rng(1).integers(1000))

@pytest.fixture(scope="session")
def of_the_session():
    return cached()

@pytest.fixture(scope="module")
def drawn(of_the_session):
    return int(np.random.default_rng(1).integers(1000)), of_the_session

def of_a_child():
    code = "import numpy as np; print(np.random.default_rng(1).integers(1000))"
    return int(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout)
"""
BEFORE = """
def test_before(drawn):
    pass
"""
"""Makes the fixtures, so that they are there already when the next test fails."""
AFTER = """
def test_after(drawn):
    assert drawn == (cached(), cached()) and os.environ["TEST_SEED"] == "100"
"""
"""Has the run's seed again."""
SEEDED = """
def test_seeded(drawn):
    assert drawn == (cached(), cached())
    assert os.environ["TEST_SEED"] not in {}
"""
CHILD = """
def test_child():
    of_a_child()
    assert os.environ["TEST_SEED"] != "100"
"""
NO_CHANCE = """
def test_no_chance():
    assert os.environ["TEST_SEED"] != "100"
"""


def run(folder: Path, text: str, *options: str) -> subprocess.CompletedProcess[str]:
    """A run of this file on seed 100."""
    (folder / "test_drawn.py").write_text(DRAWS + text)
    plain = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    path = os.pathsep.join((str(TESTS), os.environ["PYTHONPATH"]))
    start = [sys.executable, "-m", "pytest", "-c", TESTS.parent / "pyproject.toml", "--rootdir", folder]
    return subprocess.run(
        [*start, "-p", "helpers.chance", "-p", "no:cacheprovider", *options, folder],
        env=plain | {"PYTHONPATH": path, "TEST_SEED": "100"},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )


@pytest.mark.parametrize("options", [("-n", "0"), ("-n", "2", "--dist", "loadfile")])
def test_one_seed_of_six_is_chance(options: tuple[str, ...], tmp_path: Path) -> None:
    """Whatever drew by the run's seed is made anew for the others, and for the next test."""
    done = run(tmp_path, BEFORE + SEEDED.format(["100"]) + AFTER, *options)
    assert done.returncode == pytest.ExitCode.OK, done.stdout
    assert "2 passed, 1 failed by chance" in done.stdout
    assert "failed by chance: test_drawn.py::test_seeded: on TEST_SEED=100" in done.stdout
    assert "seeds that follow: AssertionError: assert '100' not in ['100']" in done.stdout


def test_two_seeds_of_six_are_none(tmp_path: Path) -> None:
    done = run(tmp_path, BEFORE + SEEDED.format(["100", "104"]) + AFTER)
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done.stdout
    assert "1 failed, 2 passed" in done.stdout
    assert "failed on TEST_SEED=100 and on TEST_SEED=104" in done.stdout


def test_what_a_child_draws_is_drawn(tmp_path: Path) -> None:
    done = run(tmp_path, CHILD)
    assert done.returncode == pytest.ExitCode.OK, done.stdout
    assert "1 failed by chance" in done.stdout


def test_what_does_not_draw_fails_at_once(tmp_path: Path) -> None:
    done = run(tmp_path, BEFORE + NO_CHANCE)
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done.stdout
    assert "1 failed, 1 passed" in done.stdout
    assert "it does not draw by the run's seed" in done.stdout


ONCE = """
CALLS = []

def test_once():
    np.random.default_rng(1).random()
    CALLS.append(1)
    assert len(CALLS) > 1, "the first call in a process is wrong"
"""


def test_what_passes_on_the_same_seed_has_another_cause(tmp_path: Path) -> None:
    """A kernel that is compiled, or a test before, decides: that is no chance."""
    done = run(tmp_path, ONCE)
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done.stdout
    assert "passes on TEST_SEED=100 again: its cause is not the seed" in done.stdout


BROKEN = """
@pytest.fixture(scope="module")
def broken():
    yield 1
    raise ValueError("its end")

def test_first(broken):
    assert False

def test_second(broken):
    pass
"""


def test_a_fixture_that_cannot_end_does_not_end_the_run(tmp_path: Path) -> None:
    done = run(tmp_path, BROKEN)
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done.stdout
    assert "INTERNALERROR" not in done.stdout
    assert "FAILED test_drawn.py::test_first" in done.stdout
