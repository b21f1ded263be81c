"""A test that fails runs again on other seeds: tests/helpers/chance.py."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from helpers.child import FEW_PLUGINS
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


def run(folder: Path, files: Mapping[str, str], *options: str) -> subprocess.CompletedProcess[str]:
    """A run of these files on seed 100."""
    for name, text in files.items():
        (folder / f"test_{name}.py").write_text(DRAWS + text)
    plain = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    path = os.pathsep.join((str(TESTS), os.environ["PYTHONPATH"]))
    start = [sys.executable, "-m", "pytest", "-c", TESTS.parent / "pyproject.toml", "--rootdir", folder]
    return subprocess.run(
        [*start, "-p", "helpers.chance", "-p", "no:cacheprovider", *options, folder],
        env=plain | FEW_PLUGINS | {"PYTHONPATH": path, "TEST_SEED": "100"},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )


ONCE = """
CALLS = []

def test_once():
    np.random.default_rng(1).random()
    CALLS.append(1)
    assert len(CALLS) > 1, "the first call in a process is wrong"
"""
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
NO_CHANCES = {
    "two": BEFORE + SEEDED.format(["100", "104"]) + AFTER,
    "none": BEFORE + NO_CHANCE,
    "once": ONCE,
    "broken": BROKEN,
}
"""Files with a test each that fails by more than chance."""


def test_one_seed_of_six_is_chance(tmp_path: Path) -> None:
    """Whatever drew by the run's seed, also in a child, is made anew for the others, and for the next test."""
    files = {"drawn": BEFORE + SEEDED.format(["100"]) + AFTER, "child": CHILD}
    done = run(tmp_path, files, "-n", "2", "--dist", "loadfile")
    assert done.returncode == pytest.ExitCode.OK, done.stdout
    assert "2 passed, 2 failed by chance" in done.stdout
    assert "failed by chance: test_child.py::test_child: on TEST_SEED=100" in done.stdout
    assert "failed by chance: test_drawn.py::test_seeded: on TEST_SEED=100" in done.stdout
    assert "seeds that follow: AssertionError: assert '100' not in ['100']" in done.stdout


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What a run of `NO_CHANCES` prints."""
    done = run(tmp_path_factory.mktemp("no_chances"), NO_CHANCES)
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done.stdout
    assert "failed by chance" not in done.stdout
    return done.stdout


@pytest.mark.parametrize(
    ("test", "reason"),
    [
        ("two.py::test_seeded", "failed on TEST_SEED=100 and on TEST_SEED=104"),
        ("none.py::test_no_chance", "it does not draw by the run's seed"),
        # A kernel that is compiled, or a test before, decides: that is no chance.
        ("once.py::test_once", "passes on TEST_SEED=100 again: its cause is not the seed"),
        # A fixture that cannot end does not end the run.
        ("broken.py::test_first", "not run again: a fixture ends with ValueError('its end')"),
    ],
)
def test_two_seeds_of_six_are_no_chance(printed: str, test: str, reason: str) -> None:
    assert f"FAILED test_{test}" in printed
    assert reason in printed
    assert "INTERNALERROR" not in printed


def test_others_pass(printed: str) -> None:
    assert "4 failed, " in printed
    assert "FAILED test_two.py::test_after" not in printed
