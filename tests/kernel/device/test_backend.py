"""The door to Mitsuba: which LLVM is taken, and that nothing but a clear error comes of a bad one."""

import ctypes.util
import glob
import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.child import assert_ended

from lidarscene.errors import BackendError, LidarSceneError
from lidarscene.kernel.device import backend, llvm

OPEN = """
from lidarscene.errors import BackendError
from lidarscene.kernel.device import backend
try:
    mi = backend.mitsuba()
except BackendError as error:
    print("BackendError:", error)
else:
    print(mi.variant(), *backend.trace_one_ray())
"""
OLD_LLVMS = [p for v in (14, 15, 16) for p in sorted(glob.glob(f"/usr/lib/*/libLLVM-{v}.so.1"))]


@pytest.fixture
def library(tmp_path: Path):
    """Make an empty file of a given name."""

    def make(name: str) -> str:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        return str(path)

    return make


@pytest.fixture
def places(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[str]]:
    """A machine with no LLVM but what the test puts in."""
    by_place: dict[str, list[str]] = {"environment": [], "wheel": [], "system": []}
    for name, paths in by_place.items():
        monkeypatch.setattr(llvm, f"_in_{name}", lambda paths=paths: iter(paths))
    monkeypatch.setattr(llvm, "_chosen", None)
    # Set before it is deleted, so that what the test itself sets is taken back too.
    monkeypatch.setenv(llvm.PATH_VARIABLE, "")
    monkeypatch.delenv(llvm.PATH_VARIABLE)
    return by_place


@pytest.mark.parametrize(
    ("path", "version"),
    [
        ("libLLVM.so.23.1", (23, 1)),
        ("libLLVM.so.16.0", (16, 0)),
        ("libLLVM.so.19.1", (19, 1)),
        ("libLLVM-14.so.1", (14,)),
        ("libLLVM-14.0.6.so.1", (14, 0, 6)),
        ("libLLVM-17.so", (17,)),
        ("libLLVM-18.dylib", (18,)),
        ("libLLVM.20.1.dylib", (20, 1)),
        ("llvm-19/lib/libLLVM.so.1", (19,)),
        ("llvm15/lib64/libLLVM.so", (15,)),
        ("Cellar/llvm/21.1.3/lib/libLLVM.dylib", (21, 1, 3)),
        ("Cellar/llvm@18/18.1.8/lib/libLLVM.dylib", (18, 1, 8)),
        ("libLLVM.so", ()),
        ("libLLVM.so.1", ()),
        ("LLVM-C.dll", ()),
        ("libfoo.so.99", ()),
    ],
)
def test_version_is_told_by_the_name(path: str, version: tuple[int, ...], library) -> None:
    assert llvm.version_in_name(library(path)) == version


def test_links_are_followed(tmp_path: Path, library) -> None:
    (tmp_path / "libLLVM.so").symlink_to(library("libLLVM.so.19.1"))
    (tmp_path / "libLLVM-99.so").symlink_to(library("libLLVM-14.so.1"))
    assert llvm.version_in_name(str(tmp_path / "libLLVM.so")) == (19, 1)
    assert llvm.version_in_name(str(tmp_path / "libLLVM-99.so")) == (14,)


def test_newest_of_a_place_comes_first(places, library) -> None:
    names = ["libLLVM-14.so.1", "libLLVM.so.9.0", "libLLVM.so.19.1", "libLLVM.so.16.0", "libLLVM-20.so.1"]
    places["system"] += map(library, names)
    candidates = list(llvm.candidates())
    assert [c.version for c in candidates] == [(20,), (19, 1), (16, 0), (14,), (9, 0)]
    assert [c.usable for c in candidates] == [True, True, False, False, False]
    assert llvm.choose() == candidates[0]


def test_the_environment_comes_before_a_newer_system(places, library) -> None:
    places["system"].append(library("a/libLLVM.so.25.0"))
    places["environment"].append(library("b/libLLVM.so.19.1"))
    assert llvm.choose().version == (19, 1)


def test_one_library_is_looked_at_once(places, tmp_path: Path, library) -> None:
    real = library("libLLVM.so.19.1")
    (tmp_path / "libLLVM.so").symlink_to(real)
    places["environment"] += [real, str(tmp_path / "libLLVM.so")]
    places["system"].append(real)
    assert [c.path for c in llvm.candidates()] == [os.path.realpath(real)]


def test_use_tells_drjit(places, library) -> None:
    places["wheel"].append(library("libLLVM.so.19.1"))
    llvm.use()
    assert os.environ[llvm.PATH_VARIABLE] == os.path.realpath(places["wheel"][0])
    assert llvm.choose().source != llvm.PATH_VARIABLE  # ours, not the user's word


def test_users_library_comes_first(places, library, monkeypatch: pytest.MonkeyPatch) -> None:
    places["environment"].append(library("a/libLLVM.so.23.1"))
    monkeypatch.setenv(llvm.PATH_VARIABLE, library("b/libLLVM.so.19.1"))
    assert (llvm.choose().source, llvm.choose().version) == (llvm.PATH_VARIABLE, (19, 1))


@pytest.mark.parametrize(
    ("name", "complaint"), [("libLLVM-14.so.1", "too old"), ("libLLVM-16.so.1", "too old"), (None, "no such file")]
)
def test_users_bad_library_is_an_error_with_the_fix(
    name: str | None, complaint: str, places, library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = library(name) if name else str(tmp_path / "missing" / "libLLVM.so")
    monkeypatch.setenv(llvm.PATH_VARIABLE, path)
    with pytest.raises(BackendError) as error:
        llvm.choose()
    assert path in str(error.value)
    assert complaint in str(error.value)
    assert llvm.remedy() in str(error.value)

    places["environment"].append(library("good/libLLVM.so.19.1"))
    with pytest.raises(BackendError, match="unset it"):
        llvm.choose()


def test_a_folder_is_not_a_library(places, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(llvm.PATH_VARIABLE, str(tmp_path))
    with pytest.raises(BackendError, match="a folder, not a library"):
        llvm.choose()


def test_no_library_is_an_error_with_the_fix(places) -> None:
    with pytest.raises(BackendError, match="no LLVM library found") as error:
        llvm.choose()
    assert llvm.remedy() in str(error.value)


def test_only_old_libraries_are_named(places, library) -> None:
    places["system"].append(library("libLLVM-14.so.1"))
    with pytest.raises(BackendError, match=r"(?s)no LLVM 17 or newer.*libLLVM-14\.so\.1"):
        llvm.choose()


def test_a_nameless_file_is_asked(places, library) -> None:
    """Rationale: LLVM-C.dll and libLLVM.dylib do not tell; here the file is no library at all."""
    assert "cannot be loaded" in llvm.examine(library("libLLVM.so"), "test").problem


def test_a_library_without_the_question_is_no_llvm() -> None:
    libm = ctypes.util.find_library("m")
    if not libm:
        pytest.skip("no libm to ask")
    assert "or not LLVM" in llvm.examine(libm, "test").problem


@pytest.mark.parametrize(
    ("system", "machine", "fix"),
    [
        ("linux", "x86_64", "pip install karellen-llvm-core"),
        ("linux", "aarch64", "apt install"),
        ("darwin", "arm64", "brew install llvm"),
        ("win32", "AMD64", "winget"),
    ],
)
def test_the_fix_fits_the_system(system, machine, fix, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr("platform.machine", lambda: machine)
    assert fix in llvm.remedy()


@pytest.mark.parametrize("system", ["linux", "darwin", "win32"])
def test_every_system_is_searched_without_trouble(system, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", system)
    assert all(isinstance(path, str) for path in llvm._in_system())


def test_linker_cache_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    cache = (
        "2 libs found in cache\n"
        "\tlibLLVM.so.19.1 (libc6,x86-64) => /lib/x86_64-linux-gnu/libLLVM.so.19.1\n"
        "\tlibLLVM.so.19.1 (libc6) => /lib/i386-linux-gnu/libLLVM.so.19.1\n"
        "\tlibz.so.1 (libc6,x86-64) => /lib/x86_64-linux-gnu/libz.so.1\n"
    )
    answer = subprocess.CompletedProcess([], 0, stdout=cache)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: answer)
    assert list(llvm._in_linker_cache("x86_64")) == ["/lib/x86_64-linux-gnu/libLLVM.so.19.1"]


# --- the door itself, in processes of its own --------------------------------------------------------


UNFIT = """
import os
from lidarscene.errors import BackendError
from lidarscene.kernel.device import backend, llvm
def print_error_of(**environment):
    llvm._chosen = None
    os.environ.update(environment)
    try:
        backend.mitsuba()
    except BackendError as error:
        print("BackendError:", " ".join(str(error).split()))
    else:
        print("no error")
for old in {olds}:
    print_error_of(DRJIT_LIBLLVM_PATH=old, LIDARSCENE_VARIANT="llvm_ad_mono")
del os.environ["LIDARSCENE_VARIANT"]
os.environ.update(DRJIT_LIBLLVM_PATH="/nowhere/libLLVM.so", CUDA_VISIBLE_DEVICES="")
llvm._chosen = None
report = backend.probe()
print(report.variant, report.llvm, "|", report.error.splitlines()[0])
del os.environ["DRJIT_LIBLLVM_PATH"]
for name in ("nonsense", "scalar_rgb"):
    print_error_of(LIDARSCENE_VARIANT=name)
"""


def test_what_is_unfit_is_an_error_not_an_abort(run_python) -> None:
    """Old LLVMs, one that is not there, and variants; one process, as none of them is ever loaded.

    Rationale: Dr.Jit with LLVM 15 or 16 aborts the process when the first kernel is compiled.
    """
    process = run_python(UNFIT.format(olds=OLD_LLVMS))
    assert_ended(process)
    *old, nowhere, nonsense, scalar = process.stdout.splitlines()
    assert len(old) == len(OLD_LLVMS)
    for path, line in zip(OLD_LLVMS, old, strict=True):
        assert line.startswith("BackendError:")
        assert f"DRJIT_LIBLLVM_PATH={path}: too old" in line
    assert nowhere.startswith("None DRJIT_LIBLLVM_PATH=/nowhere/libLLVM.so: no such file")
    assert "| no usable Mitsuba back end" in nowhere
    assert nonsense.startswith(
        "BackendError: LIDARSCENE_VARIANT=nonsense: no such variant; known are llvm_ad_rgb, llvm_ad_mono"
    )
    assert scalar.startswith(
        "BackendError: LIDARSCENE_VARIANT=scalar_rgb: scalar variants trace one ray at a time; a vectorised"
    )


def test_an_old_llvm_that_drjit_has_loaded_is_an_error_too(run_python) -> None:
    if not any("LLVM-15" in path for path in OLD_LLVMS):
        pytest.skip("no LLVM 15 on this system")
    old = next(path for path in OLD_LLVMS if "LLVM-15" in path)
    code = f"import drjit\n{OPEN}"
    process = run_python(code, DRJIT_LIBLLVM_PATH=old, LIDARSCENE_VARIANT="llvm_ad_mono")
    assert_ended(process, stderr=None)
    assert "imported before lidarscene and has loaded LLVM 15" in process.stdout


def test_the_door_opens_without_noise(mi, run_python) -> None:
    process = run_python(OPEN, LIDARSCENE_VARIANT=mi.variant())
    assert_ended(process)
    variant, expected, measured = process.stdout.split()
    assert variant == mi.variant()
    # One step of single precision at 5 m: which way Embree rounds depends on the processor.
    assert float(measured) == pytest.approx(float(expected), abs=5e-7)


def test_a_vectorised_variant_of_the_user_stays(mi, run_python) -> None:
    if backend.is_cuda():
        pytest.skip("for LLVM")
    path = os.environ[llvm.PATH_VARIABLE]
    code = f"import mitsuba; mitsuba.set_variant('llvm_ad_spectral')\n{OPEN}"
    process = run_python(code, DRJIT_LIBLLVM_PATH=path, LIDARSCENE_VARIANT=None)
    assert process.stdout.split()[0] == "llvm_ad_spectral"


def test_a_scalar_variant_of_the_user_is_an_error(run_python) -> None:
    code = f"import mitsuba; mitsuba.set_variant('scalar_rgb')\n{OPEN}"
    process = run_python(code, LIDARSCENE_VARIANT=None)
    assert "BackendError: the Mitsuba variant 'scalar_rgb' is set" in process.stdout


def test_hidden_gpus_are_respected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert "GPU" in backend.cuda_problem() or "CUDA" in backend.cuda_problem()


def test_drjit_comes_after_mitsuba(mi) -> None:
    assert backend.drjit().has_backend(getattr(backend.drjit().JitBackend, "CUDA" if backend.is_cuda() else "LLVM"))
    assert backend.variant() == mi.variant()


@pytest.mark.gpu
def test_a_gpu_traces() -> None:
    assert backend.variant() == "cuda_ad_mono"
    assert backend.trace_one_ray() == pytest.approx((5.0, 5.0), abs=5e-7)


def test_probe_tells_what_was_chosen(mi) -> None:
    report = backend.probe()
    assert report.variant == mi.variant()
    assert report.error is None
    assert "works" in (report.cuda, report.llvm)


def test_a_gpu_that_cannot_be_used_or_fails_at_work_leaves_llvm(mi, run_python) -> None:
    """Rationale: containers often have a driver that computes but has no OptiX to trace with."""
    if backend.is_cuda():
        pytest.skip("for machines without a GPU")
    code = """
from lidarscene.kernel.device import backend, trial
backend.cuda_problem = lambda: ""  # the cheap look finds a driver
report = backend.probe()
print(report.variant, report.cuda)
# As in a new process; now Dr.Jit finds a GPU too.
backend.mitsuba.cache_clear()
backend._refused["llvm_ad_mono"] = "not yet tried"
check = backend._require_backend
backend._require_backend = lambda name: name.startswith("cuda") or check(name)
trial.FRAMES = {"small": ("edges",)}
report = backend.probe()
print(report.variant, report.cuda)
"""
    process = run_python(code, LIDARSCENE_VARIANT=None)
    without, failing = process.stdout.splitlines()
    assert without == "llvm_ad_mono Dr.Jit finds no GPU that it can use", process.stderr
    assert failing.startswith("llvm_ad_mono cannot render a small frame (small): "), process.stderr


def test_backend_errors_are_ours() -> None:
    assert issubclass(BackendError, LidarSceneError)
    assert BackendError.exit_code == 3


def test_integrators_that_are_rewritten_on_demand_work(mi) -> None:
    """Mitsuba's own, whose loops `drjit.syntax` turns into Dr.Jit's at their first call: a white plate in white light.

    Every path sees the light directly or by the plate, which absorbs nothing: radiance 1. The pixels differ by 0.08, so
    that the mean of 16 is good to 0.02; the seed is fixed.
    """
    scene = mi.load_dict(
        {
            "type": "scene",
            "light": {"type": "constant", "radiance": {"type": "spectrum", "value": 1.0}},
            "plate": {
                "type": "rectangle",
                "bsdf": {"type": "diffuse", "reflectance": {"type": "spectrum", "value": 1.0}},
            },
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
            },
        }
    )
    image = mi.render(scene, integrator=mi.load_dict({"type": "prb", "max_depth": 4}), spp=4)
    assert image.array.numpy().mean() == pytest.approx(1.0, abs=0.08)
