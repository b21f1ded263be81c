"""Compile the kernels of the tests without LLVM's optimisations, in this process and in all that a test starts.

A kernel of the tests traces a few thousand rays once. To compile it is most of the work, and optimising is two thirds
of that. What a kernel computes is the same: neither LLVM nor Dr.Jit reorders floating-point operations. So the tests
hold for both. The commands of the wheel in `tools/environments.py`, and its part of the tests with the lowest releases,
compile as users do.

Dr.Jit finds a kernel on disk by what it computes. So these have a folder of their own. Otherwise whoever renders or
measures after the tests would get them; a frame of os1-128 took an eighth longer.

LLVM has no switch for this in Dr.Jit: its own options are those of its tool `opt`.
"""

import ctypes
import os
import re
from types import ModuleType

import on_import

VARIABLE = "TEST_OPTIMISED_KERNELS"
"""Set to 1 for kernels as users have them."""
OLDEST = 20
"""Release of LLVM: older ones may not know all these options."""
FOLDER = "~/.drjit/quick"
"""Folder of these kernels, unless DRJIT_CACHE_DIR names one."""
OPTIONS = (
    b"-opt-bisect-limit=0",  # no pass that can be left out
    b"-opt-bisect-verbose=0",  # and no line for each pass
    b"-regalloc=fast",
)


def use() -> None:
    """Hand the options to LLVM as soon as Dr.Jit is imported, before it compiles anything."""
    if os.environ.get(VARIABLE) != "1":
        os.environ.setdefault("DRJIT_CACHE_DIR", os.path.expanduser(FOLDER))
        on_import.change("drjit", _set_options)


def can_be_used() -> bool:
    """Whether the LLVM that the program has chosen is known to have the options."""
    release = re.search(r"libLLVM\.so\.(\d+)", _library())
    return release is not None and int(release[1]) >= OLDEST


def _library() -> str:
    return os.path.realpath(os.environ.get("DRJIT_LIBLLVM_PATH", ""))


def _set_options(drjit: ModuleType) -> None:
    if can_be_used():
        arguments = (ctypes.c_char_p * (1 + len(OPTIONS)))(b"tests", *OPTIONS)
        ctypes.CDLL(_library()).LLVMParseCommandLineOptions(len(arguments), arguments, None)
