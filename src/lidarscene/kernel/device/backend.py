"""Choose and load a Mitsuba variant. No other module imports Mitsuba.

Mitsuba sets no variant when it is imported, and its own errors do not say what is wrong: one text stands for an LLVM
that is absent, too old or broken. So the variants are tried here one at a time, each failure is kept with its reason,
and a machine without a usable one gets a single error that names what to install. Nothing is imported before the
first call of `mitsuba()`: commands that trace nothing run without any back end.
"""

import contextlib
import ctypes
import functools
import os
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from ...errors import BackendError, OptionWarning, warn
from ...files.inputs import current_folder
from ...files.installed_llvm import OLDEST, PATH_VARIABLE
from ...scene.scene import Scene
from . import llvm, trial
from .llvm import LlvmCandidate

VARIANT_VARIABLE = "LIDARSCENE_VARIANT"
DEFAULT_ORDER = ("cuda_ad_mono", "llvm_ad_mono")

_refused: dict[str, str] = {}  # variant: the reason why it does not work
_tried: dict[str, str] = {}  # variant that has passed its trial: why a scene cannot be rendered with it, "" if all can


@dataclass(frozen=True, slots=True)
class BackendReport:
    """The variant in use, why the others were refused, and which LLVM libraries were examined."""

    variant: str | None  # in use; None if none works
    error: str | None  # why none works, and how to mend it
    cuda: str  # "works", or the reason why not
    llvm: str  # "works", or the reason why not
    llvm_loaded: tuple[int, ...]  # version that Dr.Jit has loaded; () if none
    candidates: tuple[LlvmCandidate, ...]  # best first


def mitsuba() -> ModuleType:
    """Return the `mitsuba` module with the variant set that the first call has chosen.

    Mitsuba has one variant for the whole process: if the user has set another since, it is set again.

    Raises:
        BackendError: if Mitsuba has no back end that works on this machine
    """
    mi, name = _chosen()
    if mi.variant() != name:
        _switch(mi, name)
    return mi


@contextlib.contextmanager
def users_variant_kept() -> Iterator[None]:
    """Leave Mitsuba's variant as it was before the block, once `mitsuba()` has changed it."""
    loaded: Any = sys.modules.get("mitsuba")
    before = loaded.variant() if loaded else None
    try:
        yield
    finally:
        if before and before != loaded.variant():
            _switch(loaded, before)


@functools.cache
def _chosen() -> tuple[ModuleType, str]:
    """Return Mitsuba and the variant that is chosen and set.

    The order: LIDARSCENE_VARIANT if it is set; else a variant that the user has already set, if it is of use here; else
    cuda_ad_mono if a GPU works and its frames are those of the CPU (`trial`); else llvm_ad_mono.

    Raises:
        BackendError: if none works
    """
    requested = os.environ.get(VARIANT_VARIABLE)
    if requested:
        try:
            return _set_variant(requested), requested
        except BackendError as error:
            raise BackendError(f"{VARIANT_VARIABLE}={requested}: {error}") from None
    loaded: Any = sys.modules.get("mitsuba")
    current = loaded.variant() if loaded else None
    # A variant of ours that failed after it was set (CUDA without OptiX) stays current in Mitsuba. It is no choice of
    # the user's, and must not be taken for one when this is called again: the cache keeps results, not errors.
    if current and current not in _refused:
        return _users_variant(loaded, current), current
    for name in DEFAULT_ORDER:
        try:
            if name.startswith("cuda"):
                _require_trial(name)
            return _set_variant(name), name
        except BackendError as error:
            _refused[name] = str(error)
    reasons = "".join(f"\n  {name}: {_refused[name]}" for name in DEFAULT_ORDER)
    raise BackendError(f"no usable Mitsuba back end{reasons}")


def prepare_thread(*, after_another: bool) -> None:
    """Give Dr.Jit's settings to this thread, which alone has them, and wait for what another thread has started."""
    if not _chosen.cache_info().currsize or not is_cuda():
        return  # one queue for all threads, and no settings
    _set_cuda_flags()
    # A GPU has a queue for each thread: this one's kernels must not overtake those of another.
    if after_another and (synchronise := core_function("_Z20jit_sync_all_devicesv")) is not None:
        synchronise()


@functools.cache
def core_function(mangled: str) -> Any:
    """Return a function of Dr.Jit's library that Python has no name for; None where the library has no such function.

    Args:
        mangled: its name after the Itanium ABI: Linux and macOS
    """
    for name in ("libdrjit-core.so", "libdrjit-core.dylib"):
        with contextlib.suppress(OSError, AttributeError):
            function = getattr(ctypes.CDLL(str(Path(str(drjit().__file__)).parent / name)), mangled)
            function.restype = None
            return function
    return None


def _set_cuda_flags() -> None:
    """Set what kernels of a GPU need; the flags are of one thread."""
    import drjit as dr

    # Dr.Jit 1.5 asks for it by a pragma that the assembler of CUDA 13 refuses in kernels that call functions (C7800),
    # which aborts the process.
    dr.set_flag(dr.JitFlag.SpillToSharedMemory, False)


def drjit() -> ModuleType:
    """Return the `drjit` module, once `mitsuba()` has chosen the variant."""
    mitsuba()
    import drjit as dr

    return dr


def variant() -> str:
    """Return the variant in use, such as 'llvm_ad_mono'."""
    return str(mitsuba().variant())


def is_cuda() -> bool:
    """Return whether rays are traced on a GPU."""
    return variant().startswith("cuda")


@functools.cache
def mitsuba_plugins() -> frozenset[str]:
    """Return the names of the plugins in Mitsuba's own folder."""
    return frozenset(file.stem for file in (_mitsuba_folder(mitsuba()) / "plugins").iterdir())


@contextlib.contextmanager
def without_outside_files() -> Iterator[None]:
    """Let Mitsuba look for files and plugins in its own folder only, within the block."""
    mi = mitsuba()
    before = mi.file_resolver()
    mi.set_file_resolver(_resolver(mi, []))
    try:
        yield
    finally:
        mi.set_file_resolver(before)


def _resolver(mi: ModuleType, folders: Iterable[str]) -> Any:
    """Return a search path: Mitsuba's own folder, then these."""
    resolver = mi.FileResolver()
    resolver.clear()
    for folder in (str(_mitsuba_folder(mi)), *folders):
        resolver.append(folder)
    return resolver


def _mitsuba_folder(mi: ModuleType) -> Path:
    """Folder in which Mitsuba is installed."""
    return Path(str(mi.__file__)).parent


def trace_one_ray(mi: ModuleType | None = None) -> tuple[float, float]:
    """Trace a plate that is 5 m away; return the true range and the traced one, in metres."""
    mi = mi or mitsuba()
    scene = mi.load_dict({"type": "scene", "plate": {"type": "rectangle"}})
    hit = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(0.25, 0.25, 5), mi.Vector3f(0, 0, -1)))
    return 5.0, float(hit.t.numpy()[0])


def probe() -> BackendReport:
    """Report everything that the choice of the variant rests on. Raises nothing, even if the back end is broken."""
    chosen = error = None
    try:
        chosen = variant()
    except BackendError as problem:
        error = str(problem)
    kind = (chosen or "none").partition("_")[0]
    cuda = "works" if kind == "cuda" else _refused.get("cuda_ad_mono") or cuda_problem() or "not tried"
    cpu = "works" if kind == "llvm" else _refused.get("llvm_ad_mono") or llvm_problem() or "not tried"
    dr: Any = sys.modules.get("drjit")
    version = tuple(dr.detail.llvm_version()) if dr else ()
    return BackendReport(chosen, error, cuda, cpu, version if version > (0,) else (), tuple(llvm.candidates()))


def cuda_problem() -> str:
    """Return why CUDA cannot work, as far as a quick check can tell; "" if nothing speaks against it."""
    if sys.platform == "darwin":
        return "there is no CUDA on macOS"
    if os.environ.get("CUDA_VISIBLE_DEVICES") in ("", "-1"):
        return "CUDA_VISIBLE_DEVICES hides every GPU"
    name = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
    paths = [os.environ.get("DRJIT_LIBCUDA_PATH"), name, f"/usr/lib/wsl/lib/{name}"]
    for path in filter(None, paths):
        with contextlib.suppress(OSError):
            ctypes.CDLL(path)
            return ""
    return f"no NVIDIA driver ({name} cannot be loaded)"


def llvm_problem() -> str:
    """Return why LLVM cannot work, as far as a quick check can tell; "" if nothing speaks against it."""
    try:
        llvm.choose()
    except BackendError as error:
        return str(error)
    return ""


def _require_trial(name: str) -> None:
    """Raise `BackendError` unless frames of this variant are those of the CPU; the first time this takes seconds."""
    if problem := cuda_problem() or _tried.get(name):
        raise BackendError(problem)
    _import_mitsuba()
    _require_backend(name)
    result = trial.verdict(name, DEFAULT_ORDER[-1])
    if result.fault and result.renders:
        _warn_of_unused_gpu(name, result.fault)
    if result.fault:
        raise BackendError(result.fault)
    _tried.setdefault(name, "")


def _warn_of_unused_gpu(name: str, fault: str) -> None:
    warn(OptionWarning("the GPU is not used: {0}; {1}={2} uses it nevertheless", fault, VARIANT_VARIABLE, name))


def require_scene_trial(scene: Scene) -> None:
    """Leave a GPU that was chosen here and cannot render a scene with a Mitsuba file: its BSDFs are code of their own.

    Raises:
        BackendError: if it cannot, and this process has begun to use the GPU
    """
    is_first = not _chosen.cache_info().currsize
    _, name = _chosen()
    if name not in _tried:
        return
    fault = trial.scene_verdict(scene, name, DEFAULT_ORDER[-1]).fault
    if not fault:
        return
    fault = f"it cannot render {scene.base}: {fault}"
    if not is_first:
        raise BackendError(f"the GPU is in use, and {fault}; try: {VARIANT_VARIABLE}={DEFAULT_ORDER[-1]}")
    _warn_of_unused_gpu(name, fault)
    _refused[name] = _tried[name] = fault
    _chosen.cache_clear()


# --- one variant ------------------------------------------------------------------------------------


def _set_variant(name: str) -> ModuleType:
    """Set this variant and return Mitsuba.

    Raises:
        BackendError: with the reason if the variant does not work
    """
    if problem := _misfit(name):
        raise BackendError(problem)
    if name.startswith("cuda") and (problem := cuda_problem()):
        raise BackendError(problem)
    if name.startswith("llvm") and "drjit" not in sys.modules:
        llvm.use()  # raises if there is no usable library; `_import_mitsuba` only tries
    mi = _import_mitsuba()
    if name not in mi.variants():
        choices = ", ".join(choice for choice in mi.variants() if not _misfit(choice))
        raise BackendError(f"no such variant; known are {choices}")
    _require_backend(name)
    try:
        _switch(mi, name)
        if name.startswith("cuda"):
            _set_cuda_flags()
            trace_one_ray(mi)  # a driver without OptiX is found out only now
    except Exception as error:
        raise BackendError(" ".join(str(error).split())) from error
    return mi


def _misfit(name: str) -> str:
    """Return why the chain cannot run in a variant of this name; "" if nothing speaks against it."""
    if name.startswith("scalar"):
        return "scalar variants trace one ray at a time; a vectorised one is needed"
    if name.endswith("polarized"):
        return "polarised variants have matrices where numbers are needed; one without 'polarized' is needed"
    return ""


def _switch(mi: Any, name: str) -> None:
    """Set a variant."""
    with _syntax_on_demand():
        mi.set_variant(name)


@contextlib.contextmanager
def _syntax_on_demand() -> Iterator[None]:
    """Let functions that are marked with `drjit.syntax` be rewritten at their first call, within the block."""
    # Mitsuba imports its integrators, some when a variant is set, and `syntax` parses the source of each: 0.13 s of
    # every start, for functions that nobody calls here.
    import drjit as dr

    rewritten = dr.syntax

    def on_demand(function: Any = None, **options: object) -> Any:
        if function is None:
            return functools.partial(on_demand, **options)
        compiled: list[Any] = []

        @functools.wraps(function)
        def call(*arguments: object, **keywords: object) -> Any:
            if not compiled:
                compiled.append(rewritten(function, **options))
            return compiled[0](*arguments, **keywords)

        return call

    dr.syntax = on_demand
    try:
        yield
    finally:
        dr.syntax = rewritten


def _users_variant(mi: ModuleType, current: str) -> ModuleType:
    """Return Mitsuba with the variant that the user has set.

    Raises:
        BackendError: if it is of no use here
    """
    if problem := _misfit(current):
        raise BackendError(
            f"the Mitsuba variant '{current}' is set, but {problem}; "
            "try: mitsuba.set_variant('llvm_ad_mono'), or set none at all"
        )
    _require_backend(current)
    if current.startswith("cuda"):
        _set_cuda_flags()
    return _import_mitsuba()


def _import_mitsuba() -> Any:
    """Import Mitsuba and silence its log.

    Raises:
        BackendError: if Mitsuba has no back end that works on this machine
        InputError: without a current folder
    """
    here = current_folder()  # Mitsuba has it on its search path: without one its import would abort the process
    # Dr.Jit looks for LLVM once, while it is imported. So the path is set before, also when CUDA is tried first: if
    # CUDA fails, LLVM is next, in the same process.
    if "drjit" not in sys.modules:
        with contextlib.suppress(BackendError):
            llvm.use()
    try:
        import drjit as dr

        with _syntax_on_demand():
            import mitsuba as mi
    except ImportError as error:
        raise BackendError(f"Mitsuba cannot be imported ({error}); try: pip install mitsuba") from error
    # Mitsuba loads plugins, which are native code, from `plugins/` of each folder of its search path, and has the
    # current folder there. What lies beside a user's files must not run.
    search_folders = [
        str(folder) for folder in mi.file_resolver() if Path(str(folder)) not in (here, _mitsuba_folder(mi))
    ]
    mi.set_file_resolver(_resolver(mi, search_folders))
    if mi.variant() is None:
        dr.set_log_level(dr.LogLevel.Error)
        mi.set_log_level(mi.LogLevel.Error)
    return mi


def _require_backend(name: str) -> None:
    """Raise `BackendError` unless what Dr.Jit has loaded can run this variant."""
    import drjit as dr

    if name.startswith("cuda"):
        if not dr.has_backend(dr.JitBackend.CUDA):
            raise BackendError("Dr.Jit finds no GPU that it can use")
        return
    path = os.environ.get(PATH_VARIABLE)
    if path and not dr.has_backend(dr.JitBackend.LLVM):
        raise BackendError(f"Dr.Jit cannot load LLVM from {path}; try: {llvm.remedy()}")
    # LLVM 15 and 16 load without complaint and abort the process when the first kernel is compiled.
    version = dr.detail.llvm_version()
    if version[0] < OLDEST:
        loaded = f"LLVM {'.'.join(map(str, version))}" if version[0] > 0 else "no LLVM"
        raise BackendError(
            f"Dr.Jit was imported before lidarscene and has loaded {loaded}, but {OLDEST} or newer "
            f"is needed; try: set {PATH_VARIABLE} before that, or call lidarscene first"
        )
