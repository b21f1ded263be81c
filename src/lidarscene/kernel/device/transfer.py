"""To and from the device: descriptions made opaque, so that a changed number never compiles a new kernel."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ...maths.arrays import Table, is_drjit
from .backend import is_cuda, mitsuba

_KEPT_STATIC = frozenset({"stops", "count", "room"})
"""These decide how many outputs, or how much work or memory, a kernel has."""

_ALIGNMENT = 64


def opaque(value: Any) -> Any:
    """A copy in which every float and int, however deep in frozen dataclasses and tuples, is on the device.

    Strings, None, poses and other arrays stay as they are: they choose code, or never enter a kernel. So do tables,
    which are uploaded when something is first looked up in them.
    """
    if isinstance(value, bool | Table):
        return value
    if isinstance(value, float | int):
        return _opaque_number(value)
    if isinstance(value, tuple):
        return tuple(opaque(inner) for inner in value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        changed = {
            field.name: opaque(getattr(value, field.name))
            for field in dataclasses.fields(value)
            if field.name not in _KEPT_STATIC
        }
        return dataclasses.replace(value, **changed)
    return value


def _opaque_number(value: float) -> Any:
    import drjit as dr

    mi = mitsuba()
    return dr.opaque(mi.Int32 if isinstance(value, int) else mi.Float, value)


def opaque_uint32(value: int) -> Any:
    """A 32-bit unsigned number on the device."""
    import drjit as dr

    return dr.opaque(mitsuba().UInt32, value)


def counter(first: int, count: int) -> Any:
    """(count,) 32-bit unsigned numbers from ``first`` on; neither number becomes code."""
    import drjit as dr

    return dr.arange(mitsuba().UInt32, count) + opaque_uint32(first)


def repeated(values: Any, times: int) -> tuple[Any, Any]:
    """Each of (n,) numbers on ``times`` lanes, lane after lane; and which of its lanes each is."""
    import drjit as dr

    mi = mitsuba()
    lane = dr.arange(mi.UInt32, dr.width(values) * times)
    number = lane // times
    return dr.gather(type(values), values, number), lane - number * times


def from_numpy(values: Any) -> Any:
    """(n,) numbers in single precision."""
    return mitsuba().Float(_aligned(values, np.float32))


def unsigned_numbers(values: Any) -> Any:
    """(n,) 32-bit unsigned numbers."""
    return mitsuba().UInt32(_aligned(values, np.uint32))


def _aligned(values: Any, dtype: Any) -> Any:
    """Always at the same alignment: Dr.Jit takes numpy's memory as it is, and what that is aligned to would become part
    of the kernel (MITSUBA.md 5.2).
    """
    room = np.zeros(4 * len(values) + _ALIGNMENT, dtype=np.uint8)
    start = -room.ctypes.data % _ALIGNMENT
    aligned = room[start : start + 4 * len(values)].view(dtype)
    aligned[:] = values
    return aligned


def whole_numbers(values: Any) -> Any:
    """(n,) signed numbers."""
    import numpy as np

    return mitsuba().Int32(np.asarray(values, dtype=np.int32))


def fetched(value: Any) -> Any:
    """A description with every array in it, however deep, as numpy; numbers on the device become one-element arrays."""
    if isinstance(value, tuple):
        return tuple(fetched(inner) for inner in value)
    if isinstance(value, Table):
        return value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        changed = {field.name: fetched(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return dataclasses.replace(value, **changed)
    return value.numpy() if is_drjit(value) else value


def columns(arrays: dict[str, Any]) -> dict[str, Any]:
    """Arrays by name, computed together, as numpy."""
    start(list(arrays.values()))
    wait()
    return {name: array.numpy() for name, array in arrays.items()}


def start(arrays: list[Any]) -> None:
    """Have these arrays computed, in one kernel where they have one size, without waiting."""
    import drjit as dr

    dr.eval(*arrays)


def wait() -> None:
    """Until everything that was started is done."""
    import drjit as dr

    dr.sync_thread()


def apart(*arrays: Any) -> None:
    """On a GPU, have these computed before another scene is traced: two in one kernel would be two OptiX pipelines,
    and Dr.Jit turns the second one off (MITSUBA.md 5.5). On a CPU they may share the kernel.
    """
    import drjit as dr

    if is_cuda():
        dr.eval(*arrays)


def use_threads(count: int) -> None:
    """Have Dr.Jit compute with so many threads of this process."""
    from .backend import drjit

    dr = drjit()
    if dr.thread_count() != count:
        dr.set_thread_count(count)
