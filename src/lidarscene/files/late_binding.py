"""Late binding: methods of a lower tier whose work is done in a higher one.

`PointCloud.plot` draws, and `Scene.view` opens a page, but imports point downwards. So `lidarscene/__init__.py`, above
all tiers, binds the functions of `figures` and `view` to names, and the methods call them by these. A module is
imported when its function is first called.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from dataclasses import fields
from typing import Any, TypeVar

Kind = TypeVar("Kind", bound=type[Any])

_BOUND: dict[str, str] = {}


def bind(**functions: str) -> None:
    """Bind functions of higher tiers, each a text "package.module:function", to names, for `call_bound`."""
    _BOUND.update(functions)


def call_bound(name: str, *arguments: Any, **options: Any) -> Any:
    """Call the function that is bound to this name, and return its result."""
    module, _, function = _BOUND[name].partition(":")
    return getattr(importlib.import_module(module), function)(*arguments, **options)


def read_by_name(name: str) -> Callable[[Kind], Kind]:
    """Let a frozen dataclass be made of a name or a file, too: ``Sensor("apd-905")`` is what its reader gives.

    Args:
        name: of the bound function that reads one; it takes the same arguments
    """

    def decorate(kind: Kind) -> Kind:
        made: Callable[..., None] = kind.__init__

        @functools.wraps(made)
        def initialise(self: Any, *choice: Any, **values: Any) -> None:
            if not choice:
                made(self, **values)
                return
            read = call_bound(name, *choice, **values)
            for entry in fields(kind):
                object.__setattr__(self, entry.name, getattr(read, entry.name))

        setattr(kind, "__init__", initialise)  # noqa: B010
        return kind

    return decorate
