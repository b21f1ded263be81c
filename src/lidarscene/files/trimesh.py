"""trimesh: the only door to it in this package.

It takes half a second to load, and so it is imported when it is first needed.
"""

from __future__ import annotations

import functools
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@functools.cache
def trimesh() -> Any:
    """Return the `trimesh` module."""
    with _signals_heard_later():  # it catches every exception of the packages that it tries, Ctrl-C too
        import trimesh as module
    return module


@contextmanager
def _signals_heard_later() -> Iterator[None]:
    """Hold Ctrl-C and SIGTERM back until the block ends, in the only thread that may."""
    held: list[int] = []
    handlers: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if callable(signal.getsignal(number)):
                handlers[number] = signal.signal(number, lambda came, _: held.append(came))
    try:
        yield
    finally:
        for held_back, handler in handlers.items():
            signal.signal(held_back, handler)
    if held:
        signal.raise_signal(held[0])
