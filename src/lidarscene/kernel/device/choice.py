"""Ask one of several objects with each lane, in a kernel that holds the code of these alone.

A call through Mitsuba's own pointers goes through a table of all objects of the process. Its length and the code of
each object are part of the kernel, so a world that another simulator makes or frees would have it compiled anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

from ...maths.arrays import Array, Mask
from .backend import mitsuba

Target = TypeVar("Target")


def ask_one(
    targets: Sequence[Target], number: Array, ask: Callable[..., object], *arguments: object, active: Mask
) -> Any:
    """Return what one of the targets answers each active lane; zeros for the others.

    Args:
        number: of the target
        ask: takes a target, the arguments and whether each lane is active
    """
    import drjit as dr

    if len(targets) == 1:
        return ask(targets[0], *arguments, active)
    # What is the same code for several targets, Dr.Jit compiles once: their numbers are data.
    return dr.switch(mitsuba().UInt32(number), [partial(ask, target) for target in targets], *arguments, active)
