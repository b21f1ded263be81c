"""An NVIDIA card for machines without one: a stand-in for its driver that runs Dr.Jit's kernels on the CPU.

    python tests/emulated_gpu/emulator.py .venv/bin/lidarscene doctor

runs a command with it. Its two parts, the driver (device.c, optix.h) and the translator of kernels (ptx.py), are
compiled when they are first used, into a folder for these sources.
"""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

SOURCES = Path(__file__).parent

ROUNDING_ULP = int(os.environ.get("EMULATED_GPU_ULP", "1"))
"""Choice: what an approximate instruction of the card may be off, units in the last place. A card's `div.approx` is off
by up to 2 of them, `sqrt.approx` and `ex2.approx` by about 1 ("PTX ISA")."""


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

    Its folder is named by all that its kernels depend on, so that none of another translator is found there.
    """
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    mitsuba = find_spec("mitsuba")
    if sys.platform != "linux" or compiler is None or mitsuba is None or mitsuba.origin is None:
        raise NoEmulatorError("the emulated GPU needs Linux, a C compiler (cc) and Mitsuba")
    embree = Path(mitsuba.origin).with_name("libembree3.so")
    quick = shutil.which("tcc")
    kernels = f"{quick} -shared" if quick else f"{compiler} -O0 -w -fno-strict-aliasing -shared -fPIC"
    python, translator, headers = map(shlex.quote, (sys.executable, str(SOURCES / "ptx.py"), str(SOURCES)))
    compile_kernel = (
        f"{python} -I -S {translator} '%s' '%s.c'"
        f" && {kernels} -DULPS={ROUNDING_ULP} -I{headers} '%s.c' -o '%s.so' -lm && mv '%s.so' '%s'"
    )
    texts = [path.read_bytes() for path in (*sorted(SOURCES.glob("*.[ch]")), SOURCES / "ptx.py")]
    digest = hashlib.sha256(b"".join([*texts, compile_kernel.encode(), str(embree).encode()])).hexdigest()[:16]
    folder = Path(tempfile.gettempdir()) / f"lidarscene-emulated-gpu-{os.getuid()}-{digest}"
    library = folder / "libcuda.so"
    if not library.exists():
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        partial = folder / f"{os.getpid()}.so"
        defined = [f'-DFOLDER="{folder}"', f'-DCOMPILE="{compile_kernel}"', "-DULPS=0"]
        options = ["-O1", "-w", "-fno-strict-aliasing", "-fvisibility=hidden", "-shared", "-fPIC", *defined]
        libraries = [str(embree), f"-Wl,-rpath,{embree.parent}", "-ldl", "-lm"]
        subprocess.run([compiler, *options, str(SOURCES / "device.c"), "-o", str(partial), *libraries], check=True)
        partial.rename(library)  # two processes at once make two, of which the last one stays
    return library


if __name__ == "__main__":
    try:
        os.execvpe(sys.argv[1], sys.argv[1:], environment())
    except NoEmulatorError as error:
        sys.exit(f"error: {error}")
