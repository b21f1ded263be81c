"""What every test shares: markers from folders, the back end or a reason, a Python to run."""

import contextlib
import gc
import importlib
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from helpers.run_seed import CASES_NAME, run_seed, shuffle
from helpers.run_seed import NAME as SEED_NAME
from helpers.waiting import PATIENCE_S
from hypothesis import HealthCheck, settings

from lidarscene.errors import BackendError, LidarSceneError
from lidarscene.files import installed_llvm
from lidarscene.files import open3d as open3d_door
from lidarscene.kernel.device import backend, blocks, llvm

os.environ.setdefault("MPLBACKEND", "Agg")
# For workers of xdist, one for each core: threads of NumPy's BLAS that wait take several times the CPU.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
SEED = run_seed()
"""Of the order of the tests and of their random streams; drawn unless TEST_SEED says it."""
CASE_SEED = run_seed(CASES_NAME)
"""Of the cases that `chosen` gives; drawn unless CASE_SEED says it."""
# Meshes are kept for this run alone, with all workers of xdist: what an earlier one left must not decide a test.
if "PYTEST_XDIST_WORKER" not in os.environ:
    CACHE = tempfile.TemporaryDirectory(prefix="lidarscene_tests_")
    os.environ["LIDARSCENE_CACHE"] = CACHE.name
# This process and each that a test starts find the same sources, draw the run's random numbers, and compile quickly.
EVERY_PROCESS = Path(__file__).parent / "helpers" / "every_process"
os.environ["PYTHONPATH"] = os.pathsep.join(map(str, (Path(__file__).parents[1] / "src", EVERY_PROCESS)))
sys.path.append(str(EVERY_PROCESS))
reseed, quick_kernels = map(importlib.import_module, ("reseed", "quick_kernels"))
reseed.use()
quick_kernels.use()
OUTSIDE = dict(os.environ)
if not installed_llvm.users_path():
    OUTSIDE.pop(installed_llvm.PATH_VARIABLE, None)  # each process that a test starts looks for itself
with contextlib.suppress(BackendError):
    llvm.use()  # before any test file imports drjit, which looks for LLVM only then

# Hypothesis fails an example that takes 0.2 s, and a test whose examples take long to make. It keeps no examples for
# the next run; constants of our modules, which take each worker 2.5 s to find, stay in .hypothesis.
settings.register_profile(
    "lidarscene", database=None, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=False
)
settings.load_profile("lidarscene")

TESTS = Path(__file__).parent
LONGEST = (
    "docs/test_commands.py",
    "chain/test_rain_and_snow.py",
    "cli/test_main.py",
    "view/test_html_page.py",
    "batch/test_dispatch.py",
    "docs/test_site.py",
    "batch/test_cluster.py",
    "docs/test_docs.py",
    "cli/test_paper.py",
    "kernel/device/test_replay.py",
    "validation/sipm_events/test_events.py",
    "cli/test_fov.py",
    "cli/test_ranging.py",
    "docs/test_notebooks.py",
    "cli/test_batch.py",
)
"""Files that take longest. They come first, so that no worker of xdist is alone with one in the end."""
NO_SKIPS = os.environ.get("TEST_NO_SKIPS") == "1"
MAY_BE_SKIPPED = (
    "no GPU",
    "root may write anywhere",
    "no LLVM 15 on this system",
    "for machines without a GPU",
    "no disk of its own can be mounted here",
    "SimSiPM is not installed",
    "could not import 'mujoco'",
    "could not import 'torch'",
    "KISS-ICP is not installed",
    "small_gicp is not installed",
    "anywidget is not installed",
)
"""Reasons to skip a test that are none to install something: with TEST_NO_SKIPS=1 any other ends the run red."""


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Every folder is a marker: `pytest -m unit` runs tests/unit. Hypothesis has the run's seed."""
    if config.option.hypothesis_seed is None:
        config.option.hypothesis_seed = str(SEED)
    if missing := [name for name in LONGEST if not (TESTS / name).exists()]:
        raise pytest.UsageError(f"conftest.py: LONGEST: no such file or folder: {', '.join(missing)}")
    for folder in sorted(path.name for path in TESTS.iterdir() if path.is_dir()):
        config.addinivalue_line("markers", f"{folder}: the tests in tests/{folder}")


def pytest_report_header() -> str:
    """How to run the tests once more in this order, on these random streams, with these cases."""
    return f"order and random streams: {SEED_NAME}={SEED}; cases: {CASES_NAME}={CASE_SEED}"


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """The same in the end, where a long or quiet run shows it, and what should not have been skipped."""
    terminalreporter.line(pytest_report_header())
    for reason in refused_skips(terminalreporter):
        terminalreporter.line(f"TEST_NO_SKIPS=1: skipped: {reason}", red=True)


def pytest_sessionfinish(session: pytest.Session) -> None:
    terminal = session.config.pluginmanager.get_plugin("terminalreporter")
    if session.exitstatus == pytest.ExitCode.OK and terminal and refused_skips(terminal):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def refused_skips(terminal: Any) -> list[str]:
    """Reasons of skipped tests that TEST_NO_SKIPS=1 does not allow."""
    reasons = {report.longrepr[2].removeprefix("Skipped: ") for report in terminal.stats.get("skipped", ())}
    return sorted(reason for reason in reasons if NO_SKIPS and not reason.startswith(MAY_BE_SKIPPED))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.is_relative_to(TESTS) and item.path.parent != TESTS:
            item.add_marker(item.path.relative_to(TESTS).parts[0])
    items[:] = shuffle(items, SEED)
    turn = {TESTS / name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: turn.get(item.path, len(turn)))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is there in the end stays: else each search for garbage goes through all test items and libraries."""
    gc.disable()
    result = yield
    gc.enable()
    gc.collect()
    gc.freeze()
    gc.set_threshold(700, 10, 20)  # and half as many searches as by default through all that comes after
    return result


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """No scene of a file lives on in the next one: what is compiled would depend on which files a worker has had.

    What is left then stays, so that the next search does not go through it again.
    """
    if nextitem is None or nextitem.path != item.path:
        gc.collect()
        gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    reseed.pause(item.get_closest_marker("fixed_streams") is not None)  # before any fixture is made
    if item.get_closest_marker("gpu"):
        _mitsuba()
        if not backend.is_cuda():
            pytest.skip(f"no GPU: {backend.probe().cuda}")


@pytest.fixture(autouse=True)
def _no_garbage(request: pytest.FixtureRequest) -> Iterator[None]:
    """What is compiled depends on all BSDFs and shapes alive: other tests' must not go away within such a test."""
    if "compile" not in request.node.name:
        yield
        return
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.fixture(scope="session")
def mi() -> ModuleType:
    """Mitsuba with a variant set; where there is none the test is skipped."""
    return _mitsuba()


def _mitsuba() -> ModuleType:
    try:
        mitsuba = backend.mitsuba()
        if "PYTEST_XDIST_WORKER" in os.environ:
            blocks.use_threads(1)  # there is a worker for each core; a thread that waits costs a fifth of the CPU
        return mitsuba
    except BackendError as error:
        pytest.skip(f"no usable back end: {' '.join(str(error).split())}")


@pytest.fixture(scope="session")
def open3d() -> ModuleType:
    """Open3D through its door; where it cannot be had the test is skipped."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what it imports is not ours
        try:
            return open3d_door.open3d()
        except LidarSceneError as error:
            pytest.skip(str(error))


pytest_plugins = (
    "helpers.in_this_process",
    "helpers.libraries",
    "helpers.small_job",
    "helpers.browser",
    "helpers.dead_workers",
    "helpers.chance",
    "helpers.part",
    "helpers.kept_scenes",
)
"""Fixtures: a command line in this process; readers of other libraries; a job and a cluster; a browser. The last four
end a run whose worker dies, run a test that fails on other seeds, choose a part of the tests, and keep scenes."""

RunPython = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def run_python() -> RunPython:
    """Run code in a fresh Python, with NAME=value in its environment, or NAME=None for unset."""

    def run(code: str, **environment: str | None) -> subprocess.CompletedProcess[str]:
        drawn = {name: os.environ.get(name) for name in (SEED_NAME, reseed.READ)}  # of the test that runs now
        merged = OUTSIDE | drawn | environment
        variables = {name: value for name, value in merged.items() if value is not None}
        return subprocess.run(
            [sys.executable, "-c", code], env=variables, capture_output=True, text=True, timeout=PATIENCE_S
        )

    return run
