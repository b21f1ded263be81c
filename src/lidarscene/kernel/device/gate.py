"""The gate to the device: one thread at a time is behind it, and nothing of the device is freed behind its back.

Mitsuba and Dr.Jit have one state for the whole process. Scenes and materials stand in one registry, which every kernel
that is recorded reads; the variant is one; a recording covers whatever happens on the device. Two threads at once gave
aborts, errors from nowhere, and clouds that were wrong by 10 mm. So every function that the rest of the package calls
to touch the device is `exclusive`: a whole frame, a whole world. Nothing is lost, since a frame uses all cores.

A lock, and not a thread of its own that takes orders: so callbacks, warnings and Ctrl-C stay in the thread of the
caller, and a callback may render. What a callback waits for must not wait for the gate.

Freeing is half of it. Dr.Jit aborts the process if a device array is freed by the thread that records; a scene that
goes while another thread records takes materials out of the registry under its hands. Python frees at any time, in any
thread: a cache drops its oldest entry, a simulator goes out of scope. So whoever owns such things hands them over when
it goes (`maths.arrays.retire_with`), and they are freed as the gate opens and closes.
"""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable
from typing import Any, TypeVar, cast

from ...maths import arrays
from . import backend

_Function = TypeVar("_Function", bound=Callable[..., Any])


class _Gate:
    """State behind the lock; only the thread that holds it writes here.

    Attributes:
        occupied: whether a function is running behind the gate
        last_thread: what stands for the thread that was there last
    """

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.occupied = False
        self.last_thread: object = None


_gate = _Gate()
_this_thread = threading.local()


def exclusive(function: _Function) -> _Function:
    """Return the function so that one thread at a time runs it, or any other function that is exclusive.

    A thread that is behind the gate passes freely. An error or Ctrl-C opens the gate again.
    """

    @functools.wraps(function)
    def behind_gate(*arguments: Any, **keywords: Any) -> Any:
        # `with` and the lock itself, not a class of ours: Ctrl-C cannot come between taking the lock and the block.
        with _gate.lock:
            if _gate.occupied:
                return function(*arguments, **keywords)
            _gate.occupied = True
            try:
                _free_retired()
                with backend.users_variant_kept():
                    _take_over()
                    return function(*arguments, **keywords)
            finally:
                _gate.occupied = False
                _free_retired()

    return cast(_Function, behind_gate)


def _take_over() -> None:
    """Prepare Dr.Jit for this thread, if another one was behind the gate before."""
    # Not the thread's number, which a later thread may get again.
    thread = _this_thread.__dict__.setdefault("token", object())
    if _gate.last_thread is not thread:
        backend.prepare_thread(after_another=_gate.last_thread is not None)
        _gate.last_thread = thread


def _free_retired() -> None:
    """Free what was handed over; called while nothing is traced or recorded."""
    while arrays.retired:
        arrays.retired.popleft()


def retire(things: object) -> None:
    """Free things of the device: now, unless a thread is behind the gate; else as it leaves."""
    arrays.retired.append(things)
    del things
    if _gate.lock.acquire(blocking=False):
        try:
            if not _gate.occupied:
                _free_retired()
        finally:
            _gate.lock.release()


# A fork waits for the frame of another thread: its child has neither that thread nor the lock's owner.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_gate.lock.acquire, after_in_parent=_gate.lock.release, after_in_child=_gate.lock.release
    )
