"""Pinned memory: what a GPU copies to without a detour, given to NumPy and kept by Dr.Jit for the next frame.

The driver copies to ordinary memory piece by piece through a buffer of its own. Pinned memory it writes itself, but the
system cannot swap it out, and it takes long to get: so there is a limit, and Dr.Jit gives again what it got back.
Python has no name for this in Dr.Jit; its library has.
"""

from __future__ import annotations

import ctypes
import functools
import sys
from collections.abc import Callable
from typing import Any, NamedTuple, cast

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

    def __init__(self, size: int, backend: int, library: _Library) -> None:
        self._size, self._free = size, library.free
        self.address = library.allocate(backend, size, 1)
        _Pinned.in_use += size

    def __del__(self, is_finalizing: Callable[[], bool] = sys.is_finalizing) -> None:
        if is_finalizing():  # Dr.Jit has let go of all its memory, and this module has no names any more
            return
        _Pinned.in_use -= self._size
        self._free(self.address)


class _Library(NamedTuple):
    """Functions of Dr.Jit's library."""

    allocate: Callable[[int, int, int], int]
    free: Callable[[int], None]
    copy: Callable[[int, int, int, int], None]


@functools.cache
def _library() -> _Library | None:
    """`jit_malloc(JitBackend, size_t, int shared)`, `jit_free(void*)` and `jit_memcpy_async(JitBackend, void*, const
    void*, size_t)`; None where the library has no such functions.
    """
    allocate, free, copy = map(
        core_function, ("_Z10jit_malloc10JitBackendmi", "_Z8jit_freePv", "_Z16jit_memcpy_async10JitBackendPvPKvm")
    )
    if None in (allocate, free, copy):
        return None
    allocate.restype, allocate.argtypes = ctypes.c_void_p, (ctypes.c_int, ctypes.c_size_t, ctypes.c_int)
    free.argtypes = (ctypes.c_void_p,)
    copy.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)
    return _Library(allocate, free, copy)


def to_numpy(array: DeviceArray) -> Numbers:
    """Copy (n,) numbers of the device, all bytes at once, to pinned memory while there is some; wait for it.

    Returns:
        (size,) bytes, uint8
    """
    dr, library = drjit(), _library()
    backend, size = dr.backend_v(array).value, int(dr.itemsize_v(array)) * int(dr.width(array))
    if library is None or _Pinned.in_use + size > MOST_BYTES:
        return array.numpy().view(np.uint8)
    pinned = _Pinned(size, backend, library)
    library.copy(backend, pinned.address, _address(array), size)
    dr.sync_thread()
    memory = (ctypes.c_uint8 * size).from_address(pinned.address)
    retire_with(memory, pinned)
    return np.ctypeslib.as_array(memory)


def _address(array: DeviceArray) -> int:
    """Address of the first byte of an array that is computed, on its device."""
    pointer = ctypes.pythonapi.PyCapsule_GetPointer
    pointer.restype, pointer.argtypes = ctypes.POINTER(ctypes.c_void_p), (ctypes.py_object, ctypes.c_char_p)
    capsule: object = cast(Any, array).__dlpack__()
    # The address is the first field of a `DLTensor`; the offset in bytes, the last, is 0 for an array of Dr.Jit.
    return int(pointer(capsule, b"dltensor")[0])
