"""trimesh: the only door to it in this package.

It takes half a second to load, and so it is imported when it is first needed.
"""

from __future__ import annotations

import functools
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any


@functools.cache
def trimesh() -> Any:
    """Return the `trimesh` module."""
    with signals_heard(later=True):
        import trimesh as module
    return module


@contextmanager
def signals_heard(*, later: bool = False) -> Iterator[None]:
    """Raise Ctrl-C and SIGTERM of the block again at its end, in the only thread that may: trimesh catches all.

    Args:
        later: hold them back until then: of an import that is cut short, a part may be missing for good
    """
    held: list[int] = []
    handlers: dict[int, Any] = {}

    def hear(came: int, frame: Any) -> None:
        if later:
            held.append(came)
            return
        try:
            handlers[came](came, frame)
        except BaseException:
            held.append(came)
            raise

    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if callable(signal.getsignal(number)):
                handlers[number] = signal.signal(number, hear)
    try:
        yield
    except BaseException as error:
        _restore(handlers, held if isinstance(error, Exception) else ())
        raise
    _restore(handlers, held)


def _restore(handlers: Mapping[int, Any], held: Sequence[int]) -> None:
    """Restore the handlers of signals, and raise the first of those that were held."""
    for number, handler in handlers.items():
        signal.signal(number, handler)
    if held:
        signal.raise_signal(held[0])
