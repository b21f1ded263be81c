"""What every test shares: markers from folders, the back end or a reason, a Python to run."""

import contextlib
import gc
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
from helpers.waiting import PATIENCE_S
from hypothesis import HealthCheck, settings

from lidarscene.errors import BackendError, LidarSceneError
from lidarscene.files import open3d as open3d_door
from lidarscene.kernel.device import backend, llvm, transfer

os.environ.setdefault("MPLBACKEND", "Agg")
# Meshes are kept for this run alone, with all workers of xdist: what an earlier one left must not decide a test.
if "PYTEST_XDIST_WORKER" not in os.environ:
    CACHE = tempfile.TemporaryDirectory(prefix="lidarscene_tests_")
    os.environ["LIDARSCENE_CACHE"] = CACHE.name
OUTSIDE = dict(os.environ)
with contextlib.suppress(BackendError):
    llvm.use()  # before any test file imports drjit, which looks for LLVM only then

# Hypothesis fails an example that takes 0.2 s, and a test whose examples take long to make.
settings.register_profile("lidarscene", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("lidarscene")

TESTS = Path(__file__).parent
LONGEST = (
    "docs/test_study_commands.py", "docs/test_commands.py", "batch/test_run.py", "batch/test_cluster.py",
    "studies/sipm_events/test_events.py", "cli/test_batch.py", "chain/test_rain_and_snow.py",
    "view/test_page.py", "cli/test_paper.py", "cli/test_field_of_view.py", "figures/test_pictures.py",
    "studies/ranging/test_sensitivities.py", "studies/sipm_events/test_working_point.py",
    "kernel/device/test_replay.py", "cli/test_main.py",
)  # fmt: skip
"""Files that take longest. They come first, so that no worker of xdist is alone with one in the end."""
SLOW = {
    "cloud/test_points.py": ("test_to_open3d",),
    "cloud/test_thinning.py": ("test_the_picture_is_the_same_by_either_road",),
    "detection/test_interference.py": ("test_rates_add_up",),
    "detection/test_multi_echo.py": ("test_a_crossing_is_of_the_light_that_makes_it",),
    "detection/test_rises.py": ("test_fog_is_crossed_where_it_reaches_the_level",),
    "detection/test_sampled_waveforms.py": ("test_pulses_are_those_of_the_frame_in_rising_order",),
    "formats/test_las.py": ("test_laz_does_not_show_how_it_was_cut",),
    "formats/test_osi.py": ("test_osi_in_betterosi",),
    "formats/test_ply.py": ("test_every_truncation_is_noticed",),
    "light/test_echoes.py": (
        "test_a_second_frame_compiles_nothing", "test_rain_trips_as_often_as_drops_by_brute_force",
    ),
    "physics/electronics/test_mcintyre.py": ("test_exact_tail_against_a_double_sum",),
    "physics/optics/test_receiver.py": ("test_circles_overlap", "test_table_against_the_formula"),
    "physics/weather/test_fog.py": (
        "test_colour_ratio_of_drizzle", "test_enough_radii", "test_extinction_is_near_twice_the_shadow",
    ),
    "physics/weather/test_glory.py": ("test_bessel_functions",),
    "physics/weather/test_mie.py": ("test_bessel_functions",),
    "physics/weather/test_particles.py": ("test_against_a_box_of_drops",),
    "physics/weather/test_soft_target.py": ("test_integral_over_all_ranges_is_half_the_lidar_ratio",),
    "sensor/test_catalogue.py": ("test_fitted_range_is_the_published",),
    "sensor/test_detectors.py": ("test_busy_cells_in_steady_state",),
    "sensor/photon_counting/test_file.py": (
        "test_ranges_over_shots_are_those_of_poisson_histograms",
        "test_the_range_of_a_mode_is_that_which_the_maker_publishes",
    ),
}  # fmt: skip
"""What `make quick` leaves out: two fifths of the time of its folders."""
REQUIRED = os.environ.get("LIDARSCENE_REQUIRE_BACKEND") == "1"


def pytest_configure(config: pytest.Config) -> None:
    """Every folder is a marker: `pytest -m unit` runs tests/unit."""
    for folder in sorted(path.name for path in TESTS.iterdir() if path.is_dir()):
        config.addinivalue_line("markers", f"{folder}: the tests in tests/{folder}")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        folder, *rest = item.path.relative_to(TESTS).parts
        if rest:
            item.add_marker(folder)
            if getattr(item, "originalname", "") in SLOW.get("/".join((folder, *rest)), ()):
                item.add_marker("slow")
    turn = {TESTS / name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: turn.get(item.path, len(turn)))


def pytest_runtest_setup(item: pytest.Item) -> None:
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
    """Mitsuba with a variant set; where there is none the test is skipped, or fails if REQUIRED."""
    return _mitsuba()


def _mitsuba() -> ModuleType:
    try:
        mitsuba = backend.mitsuba()
        if "PYTEST_XDIST_WORKER" in os.environ:
            transfer.use_threads(
                1
            )  # there is a worker for each core; a thread that waits costs a fifth of the CPU
        return mitsuba
    except BackendError as error:
        if REQUIRED:
            raise
        pytest.skip(f"no usable back end: {' '.join(str(error).split())}")


@pytest.fixture(scope="session")
def open3d() -> ModuleType:
    """Open3D through its door; where it cannot be had the test is skipped, or fails if REQUIRED."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what it imports is not ours
        try:
            return open3d_door.open3d()
        except LidarSceneError as error:
            if REQUIRED:
                raise
            pytest.skip(str(error))


pytest_plugins = ("helpers.in_this_process", "helpers.libraries", "helpers.small_job", "helpers.browser")
"""Fixtures: a command line in this process; readers of other libraries; a job and a cluster; a browser."""

RunPython = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def run_python() -> RunPython:
    """Run code in a fresh Python, with NAME=value in its environment, or NAME=None for unset."""

    def run(code: str, **environment: str | None) -> subprocess.CompletedProcess[str]:
        merged = OUTSIDE | {"PYTHONPATH": str(TESTS.parent / "src")} | environment
        kept = {name: value for name, value in merged.items() if value is not None}
        return subprocess.run(
            [sys.executable, "-c", code], env=kept, capture_output=True, text=True, timeout=PATIENCE_S
        )

    return run
