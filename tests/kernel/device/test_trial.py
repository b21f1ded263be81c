"""A GPU on trial: frames that are the same pass, once; others, and processes that die, leave the CPU."""

import pickle
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.run_seed import chosen

from lidarscene import load_scene
from lidarscene.files.cache_folder import VARIABLE
from lidarscene.kernel.device import trial
from lidarscene.kernel.device.trial import Columns, Verdict


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Verdicts of this test only."""
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache" / "trials"


def frame(points: int = 4000) -> dict[str, np.ndarray]:
    """Columns of a cloud, two returns of every second pulse."""
    rng = np.random.default_rng(1)
    pulse = np.sort(rng.choice(10 * points, points, replace=False)) // 2
    return {
        "time": np.repeat(pulse * 1e-6, 1),
        "return_number": 1 + np.r_[False, np.diff(pulse) == 0].astype(np.uint8),
        "range": rng.uniform(1.0, 200.0, points).astype(np.float32),
        "true_range": rng.uniform(1.0, 200.0, points).astype(np.float32),
        "reflectivity": np.where(np.arange(points) % 7 == 0, np.nan, 0.3),
        "intensity": rng.uniform(1e-6, 1e-3, points).astype(np.float32),
        "snr": rng.uniform(4.0, 100.0, points).astype(np.float32),
        "detection_probability": rng.uniform(0.0, 1.0, points).astype(np.float32),
        "status": np.zeros(points, np.uint8),
        "body": np.array(["road", "car"])[(np.arange(points) % 4 == 0).astype(int)],
    }


def without_rows(columns: Columns, rows: list[int]) -> Columns:
    return {name: np.delete(values, rows) for name, values in columns.items()}


def with_column(columns: Columns, name: str, values: np.ndarray) -> Columns:
    return {**columns, name: values}


def test_rounding_is_no_difference() -> None:
    columns = frame()
    rounded = with_column(
        with_column(columns, "range", columns["range"] + 2e-4), "intensity", columns["intensity"] * 1.0002
    )
    assert trial.difference(columns, rounded) == ""
    assert (
        trial.difference(without_rows(columns, [3]), without_rows(columns, [900])) == ""
    )  # two echoes at the threshold
    assert trial.difference(without_rows(columns, list(range(4000))), without_rows(columns, list(range(4000)))) == ""


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        (
            lambda columns: without_rows(columns, [1, 50, 900, 901, 2000]),
            "5 of 4000 points have no counterpart, 3 of them on 'road'",
        ),
        (lambda columns: without_rows(columns, list(range(4000))), "4000 of 4000 points have no counterpart"),
        (lambda columns: with_column(columns, "range", columns["range"] * 1.001), "points differ in range, "),
        (
            lambda columns: with_column(columns, "range", columns["range"] + 0.01 * (columns["body"] == "car")),
            "1000 of 4000 points differ in range, 1000 of them on 'car'",
        ),
        (lambda columns: with_column(columns, "intensity", columns["intensity"][::-1]), "points differ in intensity"),
        (lambda columns: with_column(columns, "snr", columns["snr"] * 1.01), "4000 of 4000 points differ in snr"),
        (
            lambda columns: with_column(columns, "true_range", np.full(4000, np.inf)),
            "4000 of 4000 points differ in true_range",
        ),
        (
            lambda columns: with_column(columns, "range", np.full(4000, np.nan, np.float32)),
            "4000 of 4000 points differ in range",
        ),
        (lambda columns: with_column(columns, "status", columns["status"] + 1), "4000 of 4000 points differ in status"),
    ],
)
def test_what_rounding_does_not_explain_is_told(fault, complaint: str) -> None:
    columns = frame()
    assert complaint in trial.difference(columns, fault(columns))
    assert complaint in trial.difference(fault(columns), columns)


@pytest.mark.parametrize(("points", "complaint"), [(15, ""), (30, "30 of 4000 points differ in range")])
def test_few_ranges_may_be_a_step_of_the_clock_off(points: int, complaint: str) -> None:
    """A time at the border between two steps falls on either side."""
    columns = frame()
    shift = np.where(np.arange(4000) < points, 0.002, 0.0).astype(np.float32)
    moved = with_column(columns, "range", columns["range"] + shift)
    assert trial.difference(columns, moved, step_m=0.002).startswith(complaint)
    assert bool(trial.difference(columns, moved, step_m=0.002)) == bool(complaint)
    assert trial.difference(columns, moved) != ""


@pytest.mark.parametrize(("points", "complaint"), [(15, ""), (25, "25 of 4000 points differ in reflectivity")])
def test_few_points_may_be_on_the_next_brick(points: int, complaint: str) -> None:
    """Their signal is another one then, and so is all that follows from it."""
    columns = frame()
    others = np.flatnonzero(np.isfinite(columns["reflectivity"]))[:points]
    beside = {name: values.copy() for name, values in columns.items()}
    for name in ("reflectivity", "snr", "intensity", "range"):
        beside[name][others] *= 0.8
    assert trial.difference(columns, beside).startswith(complaint)
    assert bool(trial.difference(columns, beside)) == bool(complaint)


def test_a_verdict_is_kept(cache: Path) -> None:
    calls: list[tuple[str, str]] = []

    def render(name: str, variant: str) -> Columns:
        calls.append((name, variant))
        return frame()

    for _ in range(2):
        assert trial.verdict("cuda_ad_mono", "llvm_ad_mono", render=render) == Verdict()
    assert calls == [(name, variant) for name in trial.FRAMES for variant in ("cuda_ad_mono", "llvm_ad_mono")]
    assert len(list(cache.iterdir())) == 1
    shutil.rmtree(cache)
    trial.verdict("cuda_ad_mono", "llvm_ad_mono", render=render)
    assert len(calls) == 4 * len(trial.FRAMES)


def test_a_bad_verdict_is_kept_too_but_not_for_another_driver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def render_crashing(name: str, variant: str) -> Columns | str:
        return "the process ended with -11" if variant.startswith("cuda") else frame()

    (tmp_path / "version").write_text("driver 1")
    monkeypatch.setattr(trial, "_DRIVER", tmp_path / "version")
    expected = Verdict("cannot render a small frame (drive): the process ended with -11", renders=False)
    assert trial.verdict("cuda_ad_mono", "llvm_ad_mono", render=render_crashing) == expected
    assert trial.verdict("cuda_ad_mono", "llvm_ad_mono", render=lambda *_: frame()) == expected
    (tmp_path / "version").write_text("driver 2")
    assert trial.verdict("cuda_ad_mono", "llvm_ad_mono", render=lambda *_: frame()) == Verdict()


def test_a_damaged_verdict_is_made_again(cache: Path) -> None:
    assert trial.verdict("cuda_ad_mono", "llvm_ad_mono", render=lambda *_: frame()) == Verdict()
    (entry,) = cache.iterdir()
    entry.write_text("{")
    assert trial.verdict("cuda_ad_mono", "llvm_ad_mono", render=lambda *_: frame()) == Verdict()
    assert entry.read_text() != "{"


def test_without_a_cpu_to_compare_with_the_gpu_is_used() -> None:
    def only_gpu(name: str, variant: str) -> Columns | str:
        return frame() if variant.startswith("cuda") else "no LLVM"

    assert trial.verdict("cuda_ad_mono", "llvm_ad_mono", render=only_gpu) == Verdict()


def test_frames_come_from_processes_of_their_own(mi, monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame is what the program renders, and one that cannot be is told by its last line."""
    monkeypatch.setitem(trial.FRAMES, "edges", ("edges", "--set", "scanner.azimuth_step_deg=1"))
    columns = trial._render_in_process("edges", mi.variant())
    assert not isinstance(columns, str), columns
    assert len(columns["time"]) > 1000
    assert columns["range"].min() > 1.0
    assert trial.difference(columns, columns) == ""
    message = trial._render_in_process("edges", "nonsense_variant")
    assert isinstance(message, str)
    assert message.startswith("LIDARSCENE_VARIANT=nonsense_variant: no such variant")
    monkeypatch.setattr(sys, "executable", "/bin/false")
    assert trial._render_in_process("drive", mi.variant()) == "the process ended with 1"


BASE = """<scene version="3.0.0"><shape type="rectangle"><transform name="to_world"><rotate y="1" angle="-90"/>
<translate x="9"/></transform><bsdf type="{bsdf}" id="own"/></shape></scene>"""


def test_a_scene_is_tried_once_unless_it_changes(tmp_path: Path) -> None:
    """What fails on the GPU alone is a fault of the GPU; a scene that is wrong is not."""
    base, calls = tmp_path / "base.xml", []
    base.write_text(BASE.format(bsdf="plastic"))

    def fault(*failing: str) -> str:
        def render(pickled: bytes, variant: str) -> str:
            calls.append(variant)
            assert pickle.loads(pickled).base == base
            return "ptxas fatal" if variant in failing else ""

        return trial.scene_verdict(load_scene(base), "cuda", "llvm", render=render).fault

    assert fault("cuda") == fault("cuda") == "ptxas fatal"
    assert calls == ["cuda", "llvm"]
    base.write_text(BASE.format(bsdf="conductor"))
    assert fault() == fault("cuda") == ""
    base.write_text(BASE.format(bsdf="dielectric"))
    assert fault("cuda", "llvm") == ""


def test_a_scene_is_rendered_in_a_process_of_its_own(mi, tmp_path: Path) -> None:
    base = tmp_path / "base.xml"
    base.write_text(BASE.format(bsdf="plastic"))
    pickled = pickle.dumps(load_scene(base))
    assert trial._render_scene(pickled, mi.variant()) == ""
    assert "no such variant" in trial._render_scene(pickled, "nonsense_variant")


def test_a_gpu_that_fails_on_a_scene_is_left_with_one_line(run_python, tmp_path: Path) -> None:
    """Nothing is on it yet; later that is an error. A variant of the CPU stands for the GPU's."""
    (tmp_path / "base.xml").write_text(BASE.format(bsdf="plastic"))
    code = """
import warnings
import lidarscene
from lidarscene.errors import BackendError
from lidarscene.kernel.device import backend, trial
backend.cuda_problem = lambda: ""
check, switch = backend._require_backend, backend._switch
backend._require_backend = lambda name: name.startswith("cuda") or check(name)
backend._switch = lambda mi, name: switch(mi, name.replace("cuda_ad_mono", "llvm_ad_rgb"))
backend._refused["llvm_ad_rgb"] = "not the user's choice"
trial._compare = lambda *_: trial.Verdict()
trial._render_scene = lambda _, variant: "ptxas fatal" if variant.startswith("cuda") else ""
scene = lidarscene.load_scene("BASE")
if IN_USE:
    backend.mitsuba()
    try:
        lidarscene.Simulator(scene, "vlp-16")
    except BackendError as error:
        print(error)
else:
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        points = len(lidarscene.render(scene, "vlp-16"))
    print(backend.variant(), points > 100, "|", *(one.message for one in told))
"""
    cannot = f"it cannot render {tmp_path / 'base.xml'}: ptxas fatal;"
    ways = (
        ("True", f"the GPU is in use, and {cannot} try: LIDARSCENE_VARIANT=llvm_ad_mono"),
        (
            "False",
            f"llvm_ad_mono True | the GPU is not used: {cannot} LIDARSCENE_VARIANT=cuda_ad_mono uses it nevertheless",
        ),
    )
    for in_use, expected in chosen(1, ways):
        process = run_python(
            code.replace("IN_USE", in_use).replace("BASE", str(tmp_path / "base.xml")),
            LIDARSCENE_VARIANT=None,
            LIDARSCENE_CACHE=str(tmp_path),
        )
        assert process.stdout.strip() == expected, process.stderr


def test_a_gpu_with_other_frames_is_left_with_one_line(run_python, tmp_path: Path) -> None:
    """The door itself: a driver is found, its frames are wrong, and the CPU is taken."""
    code = """
import warnings
from lidarscene.kernel.device import backend, trial
backend.cuda_problem = lambda: ""
check = backend._require_backend
backend._require_backend = lambda name: name.startswith("cuda") or check(name)
for renders in (True, False):
    trial._compare = lambda *_: trial.Verdict("points are wrong", renders)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        report = backend.probe()
    print(report.variant, "|", report.cuda, "|", *(one.message for one in told))
    # As in a new process: nothing chosen, no verdict kept.
    backend._chosen.cache_clear()
    backend._refused["llvm_ad_mono"] = "not yet tried"
    trial._verdict_file = lambda *_: None
"""
    process = run_python(code, LIDARSCENE_VARIANT=None, LIDARSCENE_CACHE=str(tmp_path))
    warning = "the GPU is not used: points are wrong; LIDARSCENE_VARIANT=cuda_ad_mono uses it nevertheless"
    assert [line.strip() for line in process.stdout.splitlines()] == [
        f"llvm_ad_mono | points are wrong | {warning}",
        "llvm_ad_mono | points are wrong |",
    ], process.stderr
