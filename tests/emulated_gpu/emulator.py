"""An NVIDIA card for machines without one: a stand-in for its driver that runs Dr.Jit's kernels on the CPU.

    python tests/emulated_gpu/emulator.py .venv/bin/lidarscene doctor

runs a command with it. Its two parts, the driver (device.c, optix.h) and the translator of kernels (ptx.py), are
compiled when they are first used, into the cache folder.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from lidarscene.files.cache_folder import VARIABLE, cache_folder

SOURCES = Path(__file__).parent

ROUNDING_ULP = int(os.environ.get("EMULATED_GPU_ULP", "1"))
"""Choice: what an approximate instruction of the card may be off, units in the last place. A card's `div.approx` is off
by up to 2 of them, `sqrt.approx` and `ex2.approx` by about 1 ("PTX ISA"). From 2 on `sin`, `cos` and `lg2` have the
absolute errors that are allowed there, anew for each number: a card like that does not pass the trial, since 160 of
26,994 points of `drive` have another range."""


class NoEmulatorError(Exception):
    """Something is missing that the emulated card is made from."""


def environment() -> dict[str, str]:
    """Return this process's environment, with what makes Dr.Jit take the emulated card."""
    library = str(_driver())
    return os.environ | {
        "LIDARSCENE_VARIANT": "cuda_ad_mono",
        "DRJIT_LIBCUDA_PATH": library,
        "DRJIT_LIBOPTIX_PATH": library,
        "DRJIT_CACHE_DIR": str(Path(library).parent),
    }


def _driver() -> Path:
    """Return the driver's library; compile it if it is not there.

    Raises:
        NoEmulatorError: if it cannot be made here
    """
    compiler, mitsuba = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None), find_spec("mitsuba")
    embree = Path(mitsuba.origin if mitsuba and mitsuba.origin else __file__).with_name("libembree3.so")
    if sys.platform != "linux" or platform.machine() != "x86_64" or compiler is None or not embree.exists():
        raise NoEmulatorError("the emulated GPU needs Linux on x86-64, a C compiler (cc) and Mitsuba with its Embree")
    quick = shutil.which("tcc")
    to_kernel = [quick] if quick else [compiler, "-O0", "-w", "-fno-strict-aliasing", "-fPIC"]
    to_kernel += ["-shared", f"-DULPS={ROUNDING_ULP}", f"-I{SOURCES}"]
    to_c = [sys.executable, "-I", "-S", str(SOURCES / "ptx.py")]
    to_driver = [compiler, "-O1", "-w", "-fno-strict-aliasing", "-fPIC", "-shared", "-fvisibility=hidden", "-DULPS=0"]
    to_driver += [str(SOURCES / "device.c"), str(embree), "-Xlinker", "-rpath", "-Xlinker", str(embree.parent), "-ldl"]
    # The folder is named by all that its kernels depend on, so that none of another translator is found there.
    texts = [path.read_bytes() for path in (*sorted(SOURCES.glob("*.[ch]")), SOURCES / "ptx.py", Path(__file__))]
    folder = _own_folder(
        hashlib.sha256(b"".join([*texts, repr((to_kernel, to_c, to_driver)).encode()])).hexdigest()[:16]
    )
    library, partial = folder / "libcuda.so", folder / f"{os.getpid()}.so"
    if library.exists():
        return library
    # For printf: %1$s begins the names of a kernel's files in the folder, %2$s is that of its library.
    place, c, kernel = (shlex.join(words).replace("%", "%%") for words in (["cd", str(folder)], to_c, to_kernel))
    compiling = f"{place} && {c} %1$s %1$s.c && {kernel} %1$s.c -o %1$s.so -lm && mv %1$s.so %2$s && rm %1$s %1$s.c"
    defined = [f"-DFOLDER={_in_c(str(folder))}", f"-DCOMPILE={_in_c(compiling)}"]
    compiled = subprocess.run([*to_driver, *defined, "-lm", "-o", partial], stderr=subprocess.PIPE, text=True)
    if compiled.returncode:
        raise NoEmulatorError(f"{compiler} does not compile the emulated GPU: {compiled.stderr.strip()}")
    partial.rename(library)  # two processes at once make two, of which the last one stays
    return library


def _own_folder(name: str) -> Path:
    """Return a folder of the cache that no other user can have written to."""
    caches = cache_folder("emulated_gpu")
    if caches is None:
        raise NoEmulatorError(f"the emulated GPU needs a folder to compile into: {VARIABLE} is empty, or HOME missing")
    folder = caches.absolute() / name
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    if folder.stat().st_uid != os.getuid():
        raise NoEmulatorError(f"the emulated GPU runs nothing from another user's folder: {folder}")
    return folder


def _in_c(text: str) -> str:
    """Return a text as C writes it, which JSON does as well."""
    return json.dumps(text, ensure_ascii=False)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: python tests/emulated_gpu/emulator.py COMMAND [ARGUMENT...]")
    try:
        os.execvpe(sys.argv[1], sys.argv[1:], environment())
    except (NoEmulatorError, OSError) as error:
        sys.exit(f"error: {error}")
