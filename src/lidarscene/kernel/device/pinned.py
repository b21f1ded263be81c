"""Pinned memory: what a GPU copies to without a detour, given to NumPy and kept by Dr.Jit for the next frame.

The driver copies to ordinary memory piece by piece through a buffer of its own. Pinned memory it writes itself, but the
system cannot swap it out, and it takes long to get: so there is a limit, and Dr.Jit gives again what it got back.
Python has no name for this in Dr.Jit; its library has.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from ...maths.arrays import Numbers, retire_with
from .backend import core_function, drjit
from .types import DeviceArray

MOST_BYTES = 2**31
"""Pinned memory of clouds that are kept; the copies of further ones are in ordinary memory."""


class _Pinned:
    """Some bytes of pinned memory, which go back to Dr.Jit with this object.

    Attributes:
        in_use: bytes of all of them
    """

    in_use = 0

    def __init__(self, size: int, backend: int, allocate: Any, free: Any) -> None:
        allocate.restype, allocate.argtypes = ctypes.c_void_p, (ctypes.c_int, ctypes.c_size_t, ctypes.c_int)
        free.argtypes = (ctypes.c_void_p,)
        self._size, self._free = size, free
        self.address: int = allocate(backend, size, 1)
        _Pinned.in_use += size

    def __del__(self, is_finalizing: Callable[[], bool] = sys.is_finalizing) -> None:
        if is_finalizing():  # Dr.Jit has let go of all its memory, and this module has no names any more
            return
        _Pinned.in_use -= self._size
        self._free(self.address)


def to_numpy(array: Any) -> Numbers:
    """Copy (n,) numbers of the device, all bytes at once, to pinned memory while there is some; wait for it.

    Returns:
        (size,) bytes, uint8
    """
    dr = drjit()
    backend, size = dr.backend_v(array).value, int(dr.itemsize_v(array)) * int(dr.width(array))
    # `jit_malloc(JitBackend, size_t, int shared)`, `jit_free(void*)` and
    # `jit_memcpy_async(JitBackend, void*, const void*, size_t)`.
    allocate, free, copy = map(
        core_function, ("_Z10jit_malloc10JitBackendmi", "_Z8jit_freePv", "_Z16jit_memcpy_async10JitBackendPvPKvm")
    )
    if None in (allocate, free, copy) or _Pinned.in_use + size > MOST_BYTES:
        return cast(DeviceArray, array).numpy().view(np.uint8)
    copy.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)
    pinned = _Pinned(size, backend, allocate, free)
    copy(backend, pinned.address, _address(array), size)
    dr.sync_thread()
    memory = (ctypes.c_uint8 * size).from_address(pinned.address)
    retire_with(memory, pinned)
    return np.ctypeslib.as_array(memory)


def _address(array: Any) -> int:
    """Address of the first byte of an array that is computed, on its device."""
    capsule = array.__dlpack__()
    pointer = ctypes.pythonapi.PyCapsule_GetPointer
    pointer.restype, pointer.argtypes = ctypes.POINTER(ctypes.c_void_p), (ctypes.py_object, ctypes.c_char_p)
    # The address is the first field of a `DLTensor`; the offset in bytes, the last, is 0 for an array of Dr.Jit.
    return int(pointer(capsule, b"dltensor")[0])
