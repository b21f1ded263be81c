"""The door to Mitsuba: which LLVM is taken, and that nothing but a clear error comes of a bad one."""

import ctypes.util
import glob
import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.child import assert_ended
from helpers.run_seed import chosen

from lidarscene.errors import BackendError, LidarSceneError
from lidarscene.files import installed_llvm
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
    monkeypatch.setattr(installed_llvm, "_written", "")
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
def test_users_bad_library_is_an_error_with_the_fix(name, complaint, places, library, tmp_path, monkeypatch):
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


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, places) -> Path:
    """A Python environment, whose folder `lib` has no library but what the test puts in; Dr.Jit is not imported."""
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr("site.ENABLE_USER_SITE", False)
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    return tmp_path


@pytest.mark.parametrize(
    ("names", "written"),
    [
        ([], None),
        (["libLLVM-15.so", "libLLVM.so.16.0"], None),
        (["libLLVM.so"], None),
        (["libLLVM.so.9.0", "libLLVM.so.19.1", "libLLVM-15.so.1"], "libLLVM.so.19.1"),
    ],
)
def test_the_environments_newest_library_is_written_at_import(names, written, environment, library):
    """Rationale: the name tells the version, and no process is asked for it."""
    for name in names:
        library(f"lib/{name}")
    installed_llvm.write_newest_path()
    assert os.environ.get(llvm.PATH_VARIABLE) == (written and os.path.realpath(environment / "lib" / written))
    assert installed_llvm.users_path() == ""


def test_what_is_set_or_loaded_stays_at_import(environment: Path, library, monkeypatch: pytest.MonkeyPatch) -> None:
    library("lib/libLLVM.so.19.1")
    monkeypatch.setitem(sys.modules, "drjit", sys)
    installed_llvm.write_newest_path()
    assert llvm.PATH_VARIABLE not in os.environ
    monkeypatch.delitem(sys.modules, "drjit")
    monkeypatch.setenv(llvm.PATH_VARIABLE, "/mine/libLLVM.so.20.1")
    installed_llvm.write_newest_path()
    assert installed_llvm.users_path() == os.environ[llvm.PATH_VARIABLE] == "/mine/libLLVM.so.20.1"


# --- the door itself, in processes of its own --------------------------------------------------------


UNFIT = """
import os
from lidarscene.errors import BackendError
from lidarscene.files import installed_llvm
from lidarscene.kernel.device import backend
def print_error_of(**environment):
    installed_llvm._written = ""
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
installed_llvm._written = ""
report = backend.probe()
print(report.variant, report.llvm, "|", report.error.splitlines()[0])
del os.environ["DRJIT_LIBLLVM_PATH"]
for name in ("nonsense", "scalar_rgb", "llvm_ad_mono_polarized"):
    print_error_of(LIDARSCENE_VARIANT=name)
"""


def test_what_is_unfit_is_an_error_not_an_abort(run_python) -> None:
    """Old LLVMs, one that is not there, and variants; one process, as none of them is ever loaded.

    Rationale: Dr.Jit with LLVM 15 or 16 aborts the process when the first kernel is compiled.
    """
    process = run_python(UNFIT.format(olds=OLD_LLVMS))
    assert_ended(process)
    *old, nowhere, nonsense, scalar, polarised = process.stdout.splitlines()
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
    assert "polarized: polarised variants have matrices" in polarised


def test_an_old_llvm_that_drjit_has_loaded_is_an_error_too(run_python) -> None:
    if not any("LLVM-15" in path for path in OLD_LLVMS):
        pytest.skip("no LLVM 15 on this system")
    old = next(path for path in OLD_LLVMS if "LLVM-15" in path)
    code = f"import drjit\n{OPEN}"
    process = run_python(code, DRJIT_LIBLLVM_PATH=old, LIDARSCENE_VARIANT="llvm_ad_mono")
    assert_ended(process, stderr=None)
    assert "imported before lidarscene and has loaded LLVM 15" in process.stdout


def test_mitsuba_imported_after_lidarscene_has_a_usable_llvm(mi, run_python) -> None:
    """Rationale: Dr.Jit alone takes the system's, of which 15 and 16 abort the process."""
    if backend.is_cuda() or not list(installed_llvm.in_environment()):
        pytest.skip("for LLVM in this Python environment")
    code = """
import lidarscene, sys
print("drjit" in sys.modules)
import mitsuba as mi, drjit as dr
mi.set_variant("llvm_ad_mono")
print(dr.detail.llvm_version()[0] >= 17)
"""
    process = run_python(f"{code}{OPEN}", DRJIT_LIBLLVM_PATH=None, LIDARSCENE_VARIANT=None)
    assert process.stdout.split()[:3] == ["False", "True", "llvm_ad_mono"], process.stderr


def test_the_door_opens_without_noise(mi, run_python) -> None:
    process = run_python(OPEN, LIDARSCENE_VARIANT=mi.variant())
    assert_ended(process)
    variant, expected, measured = process.stdout.split()
    assert variant == mi.variant()
    # One step of single precision at 5 m: which way Embree rounds depends on the processor.
    assert float(measured) == pytest.approx(float(expected), abs=5e-7)


FRAME = """
import lidarscene
cloud = lidarscene.render("edges", seed=1)
print(hashlib.sha256(cloud.xyz_m.tobytes() + cloud.intensity.tobytes()).hexdigest())
"""


def test_a_variant_that_the_user_sets_first_is_used_and_gives_the_same_cloud(mi, run_python) -> None:
    """Rationale: of a surface only the reflectivity at the laser's wavelength is asked, in every variant."""
    if backend.is_cuda():
        pytest.skip("for LLVM")
    path = os.environ[llvm.PATH_VARIABLE]
    told = set()
    for variant in ("llvm_ad_mono", *chosen(1, ["llvm_ad_rgb", "llvm_ad_spectral"])):
        code = f"import hashlib, mitsuba; mitsuba.set_variant('{variant}')\n{FRAME}print(mitsuba.variant())"
        process = run_python(code, DRJIT_LIBLLVM_PATH=path, LIDARSCENE_VARIANT=None)
        cloud, used = process.stdout.split()
        assert used == variant, process.stderr
        told.add(cloud)
    assert len(told) == 1


def test_a_variant_that_the_user_sets_later_costs_nothing(mi, run_python) -> None:
    """Frames are those of the first variant; what the user has set is set again after each call."""
    if backend.is_cuda():
        pytest.skip("for LLVM")
    code = f"""
import hashlib
{FRAME}
import mitsuba as mi
for variant in ("llvm_ad_rgb", "scalar_rgb", "llvm_ad_mono_polarized"):
    mi.set_variant(variant)
    {FRAME.strip().splitlines()[1]}
    {FRAME.strip().splitlines()[2]}
    assert mi.variant() == variant
    plate = mi.load_dict({{"type": "scene", "plate": {{"type": "rectangle"}}}})
    try:
        lidarscene.render("car", "vlp-16", rays=-1)
    except lidarscene.InputError:
        assert mi.variant() == variant
"""
    process = run_python(code, LIDARSCENE_VARIANT="llvm_ad_mono")
    assert (process.returncode, process.stderr) == (0, "")
    first, *others = process.stdout.split()
    assert others == [first] * 3


@pytest.mark.parametrize("variant", chosen(1, ["scalar_rgb", "llvm_ad_mono_polarized", "llvm_ad_spectral_polarized"]))
def test_a_variant_of_the_user_that_is_of_no_use_is_an_error(mi, run_python, variant: str) -> None:
    if backend.is_cuda():
        pytest.skip("for LLVM")
    path = os.environ[llvm.PATH_VARIABLE]
    code = f"import mitsuba; mitsuba.set_variant('{variant}')\n{OPEN}mitsuba.set_variant('llvm_ad_mono')\n{OPEN}"
    process = run_python(code, DRJIT_LIBLLVM_PATH=path, LIDARSCENE_VARIANT=None)
    refused, used = process.stdout.splitlines()
    assert refused.startswith(f"BackendError: the Mitsuba variant '{variant}' is set, but ")
    assert refused.endswith("; try: mitsuba.set_variant('llvm_ad_mono'), or set none at all")
    assert used.startswith("llvm_ad_mono ")


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
backend._chosen.cache_clear()
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
