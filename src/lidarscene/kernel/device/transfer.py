"""Move numbers to the device and results back, so that a changed number never compiles a new kernel.

Dr.Jit writes every number whose value is known during recording into the text of the kernel, and finds compiled kernels
by that text. A pose, seed or coefficient that is a literal would cost some 80 ms of compilation whenever it changes. An
*opaque* number is memory on the device instead: the kernel reads it, and its text stays the same. Everything that may
differ between frames goes through this module; only what selects code (a detector's kind, the number of stops) stays a
Python value.

A *lane* is one element of a Dr.Jit array: one pulse, or one ray of a pulse. A kernel runs once for every lane.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from ...maths.arrays import Array, LookupTable, Numbers, aligned_copy, aligned_room, is_drjit
from ...maths.units import is_static
from .backend import is_cuda, mitsuba
from .types import DeviceArray


def opaque(value: object, *, double: bool = False) -> Any:
    """Return a copy in which every float and int is opaque, NumPy's too, however deep in frozen dataclasses and tuples.

    Fields that are `maths.units.STATIC`, strings, booleans, None, poses and arrays stay as they are: they select code
    or never enter a kernel. Tables stay too; they are uploaded at their first lookup.

    Args:
        double: floats become double precision, and (n,) NumPy arrays are uploaded in it
    """
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool | LookupTable):  # bool before int, of which it is a subclass
        return value
    if isinstance(value, float | int):
        return _opaque_number(value, double=double)
    if double and isinstance(value, np.ndarray):
        return mitsuba().Float64(aligned_copy(np.float64, value))
    if isinstance(value, tuple):
        return tuple(opaque(inner, double=double) for inner in value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        changed = {
            field.name: opaque(getattr(value, field.name), double=double)
            for field in dataclasses.fields(value)
            if not is_static(field)
        }
        return dataclasses.replace(value, **changed)
    return value


def _opaque_number(value: float, *, double: bool) -> Any:
    import drjit as dr

    mi = mitsuba()
    return dr.opaque(mi.Int32 if isinstance(value, int) else mi.Float64 if double else mi.Float, value)


def opaque_uint32(value: int) -> Any:
    """Return an opaque 32-bit unsigned number."""
    import drjit as dr

    return dr.opaque(mitsuba().UInt32, value)


def seed_word(seed: int) -> Any:
    """Return the seed of a frame as an opaque 32-bit word: the one way in which a seed enters a kernel."""
    return opaque_uint32(seed)


def counter(first: int, count: int) -> Any:
    """Return the (count,) numbers first, first + 1, ... as UInt32; neither argument becomes code."""
    import drjit as dr

    # An arange from 0 is the lane's own index: the kernel has no number in it, and the count is the launch's width.
    # An arange that starts elsewhere would have its start as a literal.
    return dr.arange(mitsuba().UInt32, count) + opaque_uint32(first)


def repeat_lanes(values: Array, times: int) -> tuple[Any, Any]:
    """Repeat each of (n,) numbers on ``times`` neighbouring lanes.

    Returns:
        (n times,) values and (n times,) the lane's number 0 to times - 1 within its group
    """
    import drjit as dr

    mi = mitsuba()
    lane = dr.arange(mi.UInt32, dr.width(values) * times)
    number = lane // times
    return dr.gather(type(values), values, number), lane - number * times


def from_numpy(*parts: Numbers) -> Any:
    """Upload (n,) numbers, one part behind the other, in single precision."""
    return mitsuba().Float(aligned_copy(np.float32, *parts))


def fours(*rows: Numbers) -> Any:
    """Upload (n, 3) rows, one part behind the other, as (4 n,) numbers of their type: four neighbours are one load.

    The last of each four is 0.
    """
    kind = rows[0].dtype.type
    room = aligned_room(kind, 4 * sum(map(len, rows)))
    np.concatenate(rows, out=room.reshape(-1, 4)[:, :3])
    room[3::4] = 0
    mi = mitsuba()
    return (mi.Float if kind is np.float32 else mi.UInt32)(room)


def unsigned_numbers(*parts: Numbers) -> Any:
    """Upload (n,) 32-bit unsigned numbers, one part behind the other."""
    return mitsuba().UInt32(aligned_copy(np.uint32, *parts))


def whole_numbers(values: Sequence[int] | Numbers) -> Any:
    """Upload (n,) 32-bit signed numbers."""
    return mitsuba().Int32(aligned_copy(np.int32, np.asarray(values)))


def pooled_memory(size: int) -> Numbers:
    """(size,) bytes of any value, in NumPy, of the memory that Dr.Jit keeps on a CPU: what it got back it gives again.

    The system's own comes in pages that are cleared when they are first written, which takes longer than to fill them.
    Waits for the device.
    """
    import drjit as dr

    return cast(DeviceArray, dr.empty(mitsuba().UInt8, size)).numpy()


def fetch(value: object) -> Any:
    """Return a copy of a description with every device array in it as NumPy; opaque numbers become arrays of one.

    All arrays are computed together.
    """
    start([value])
    return _as_numpy(value)


def _as_numpy(value: object) -> Any:
    if isinstance(value, tuple):
        return tuple(_as_numpy(inner) for inner in value)
    if isinstance(value, LookupTable):
        return value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        changed = {field.name: _as_numpy(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return dataclasses.replace(value, **changed)
    return cast(DeviceArray, value).numpy() if is_drjit(value) else value


def fetch_columns(arrays: dict[str, DeviceArray]) -> dict[str, Any]:
    """Compute arrays together and return them as NumPy, by name."""
    start(list(arrays.values()))
    wait()
    return {name: array.numpy() for name, array in arrays.items()}


def start(arrays: Sequence[object]) -> None:
    """Start to compute these arrays; do not wait for them."""
    import drjit as dr

    # One call for all of them: arrays of one width become one kernel, which computes what they share once. Read one by
    # one, each array would trace its rays anew.
    dr.eval(*arrays)


def split_kernel(*values: object) -> None:
    """Start to compute these on a GPU, so that what follows is another kernel.

    OptiX takes longer than in proportion for a long kernel: on an H200 52 s for 23,566 operations, all that a ray may
    meet in a scene that moves, 2.4 s for 5,497 and 0.9 s for 2,334. Twenty short ones take a frame 2 ms longer.
    """
    if is_cuda():
        start(values)


def wait() -> None:
    """Wait until everything that was started is done."""
    import drjit as dr

    dr.sync_thread()
