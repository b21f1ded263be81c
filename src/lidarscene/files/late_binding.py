"""Late binding: methods of a lower tier whose work is done in a higher one.

`PointCloud.plot` draws, and `Scene.view` opens a page, but imports point downwards. So `lidarscene/__init__.py`, above
all tiers, binds the functions of `figures` and `view` to names, and the methods call them by these.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_BOUND: dict[str, Callable[..., Any]] = {}


def bind(**functions: Callable[..., Any]) -> None:
    """Bind functions of higher tiers to names, for `call_bound`."""
    _BOUND.update(functions)


def call_bound(name: str, *arguments: Any, **options: Any) -> Any:
    """Call the function that is bound to this name, and return its result."""
    return _BOUND[name](*arguments, **options)
