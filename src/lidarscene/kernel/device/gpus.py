"""GPUs of this machine, for several processes that are to have one each.

CUDA reads which GPUs a process may see once, when it starts there. So all of this happens before a variant is chosen,
and without CUDA itself: NVIDIA's management library, which comes with every driver, counts the cards.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys

from . import backend

VISIBLE = "CUDA_VISIBLE_DEVICES"
"""CUDA's list of the GPUs that a process may see: numbers or identifiers, separated by commas."""


def visible_gpus() -> tuple[str, ...]:
    """Return the names by which CUDA lists the GPUs that this process may see; none where another variant is set."""
    requested = os.environ.get(backend.VARIANT_VARIABLE)
    if requested and not requested.startswith("cuda"):
        return ()
    listed = os.environ.get(VISIBLE)
    if listed is None:
        return tuple(str(number) for number in range(_count()))
    names = [name.strip() for name in listed.split(",")]
    # CUDA sees those before the first that is none.
    none = next((place for place, name in enumerate(names) if name in ("", "-1")), len(names))
    return tuple(names[:none])


def gpus_in_use() -> tuple[str, ...]:
    """Return `visible_gpus` where frames are rendered on them, which loads Mitsuba if there are any; else none."""
    names = visible_gpus()
    return names if names and backend.is_cuda() else ()


def see_one_gpu(number: int) -> None:
    """Let this process, the one with this number among several, see one GPU; before a variant is chosen."""
    if names := visible_gpus():
        os.environ[VISIBLE] = names[number % len(names)]


def _count() -> int:
    """Number of NVIDIA's GPUs; 0 without their driver."""
    count = ctypes.c_uint(0)
    with contextlib.suppress(OSError):
        library = ctypes.CDLL("nvml.dll" if sys.platform == "win32" else "libnvidia-ml.so.1")
        if library.nvmlInit_v2() == 0:
            if library.nvmlDeviceGetCount_v2(ctypes.byref(count)) != 0:
                count.value = 0
            library.nvmlShutdown()
    return count.value
