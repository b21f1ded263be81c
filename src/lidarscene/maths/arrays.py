"""One source, two array types: the functions that numpy and Dr.Jit share.

Stages and formulas ask ``xp(a, b, ...)`` for the functions that fit their arguments. The same lines then run on numpy
arrays (slow, easy to check, no LLVM) and on Dr.Jit arrays (fast, any device), so that the tests compare the
simulation with itself and `studies` compute with the very code that renders. Plain Python floats go with either.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, cast
from weakref import WeakKeyDictionary, finalize

import numpy as np

from .lanes import Array as Array
from .lanes import Lanes as Lanes
from .lanes import Mask as Mask
from .lanes import Numbers as Numbers
from .lanes import Ops as Ops
from .lanes import S as S

_names: dict[type, tuple[str, ...] | None] = {}


def _fields(kind: type) -> tuple[str, ...] | None:
    """Names of the fields of a dataclass; None for any other type. Cached, since every step flattens a state."""
    if kind not in _names:
        is_dataclass = dataclasses.is_dataclass(kind)
        _names[kind] = tuple(field.name for field in dataclasses.fields(kind)) if is_dataclass else None
    return _names[kind]


def flatten(state: object) -> Iterator[Any]:
    """Yield the arrays of a loop's state, in the order of the fields of its dataclasses and tuples; None is skipped."""
    if isinstance(state, tuple):
        for part in state:
            yield from flatten(part)
    elif (names := _fields(type(state))) is not None:
        for name in names:
            yield from flatten(getattr(state, name))
    elif state is not None:
        yield state


def rebuild(like: S, values: Iterator[Any]) -> S:
    """Return a state of the same form as ``like``, with the arrays that `flatten` yields."""
    state: Any
    if isinstance(like, tuple):
        state = tuple([rebuild(part, values) for part in like])
    elif (names := _fields(type(like))) is not None:
        state = type(like)(**{name: rebuild(getattr(like, name), values) for name in names})
    else:
        state = None if like is None else next(values)
    return cast(S, state)


def select_state(condition: Mask, if_true: S, if_false: S) -> S:
    """Select between two states, array by array, as `Ops.where` does."""
    choice = xp(condition).choice(condition)
    pairs = zip(flatten(if_true), flatten(if_false), strict=True)
    return rebuild(if_false, (choice(if_true, if_false) for if_true, if_false in pairs))


def map_arrays(function: Callable[..., Numbers], first: S, *others: S) -> S:
    """Apply a function to the numpy arrays of dataclasses, field by field; None where one of them has None.

    All other fields are those of ``first``.
    """
    changes: dict[str, Numbers | None] = {}
    for name in _fields(type(first)) or ():
        values = [getattr(state, name) for state in (first, *others)]
        if isinstance(values[0], np.ndarray):
            changes[name] = None if any(value is None for value in values) else function(*values)
    return cast(S, dataclasses.replace(cast(Any, first), **changes))


class NumpyOps:
    """The shared functions, on numpy."""

    exp = staticmethod(np.exp)
    log = staticmethod(np.log)
    sqrt = staticmethod(np.sqrt)
    sin = staticmethod(np.sin)
    cos = staticmethod(np.cos)
    asin = staticmethod(np.arcsin)
    atan2 = staticmethod(np.arctan2)
    abs = staticmethod(np.abs)
    floor = staticmethod(np.floor)
    rint = staticmethod(np.rint)
    maximum = staticmethod(np.maximum)
    minimum = staticmethod(np.minimum)
    where = staticmethod(np.where)

    @staticmethod
    def choice(condition: Any) -> Callable[[Any, Any], Any]:
        """Return `where` with this condition, as a function of two arrays of a state.

        An array that is selected whole, or that is the same on both sides, is not copied: the arrays of a state are
        never changed in place.
        """
        takes_all = bool(np.all(condition))
        lanes = np.shape(condition)

        def chosen_of(if_true: Any, if_false: Any) -> Any:
            same_shape = (
                isinstance(if_true, np.ndarray) and isinstance(if_false, np.ndarray) and if_true.shape == if_false.shape
            )
            if (
                same_shape
                and if_true.dtype == if_false.dtype
                and if_true.shape[-1:] == lanes
                and (takes_all or if_true is if_false)
            ):
                return if_true
            return np.where(condition, if_true, if_false)

        return chosen_of

    @staticmethod
    def uint32(x: Any) -> Any:
        """32-bit unsigned integers, at least one-dimensional (numpy scalars warn on overflow)."""
        return np.atleast_1d(np.asarray(x)).astype(np.uint32)

    @staticmethod
    def float32(x: Any) -> Any:
        """Single precision, as on the device."""
        return np.asarray(x, dtype=np.float32)

    @staticmethod
    def float64(x: Any) -> Any:
        """Double precision."""
        return np.asarray(x, dtype=np.float64)

    product = staticmethod(np.multiply)

    @staticmethod
    def fma(a: Any, b: Any, c: Any) -> Any:
        """The product of the first two, plus the third."""
        return a * b + c

    @staticmethod
    def int32(x: Any) -> Any:
        """32-bit signed integers."""
        return np.asarray(x).astype(np.int32)

    @staticmethod
    def divmod(number: Any, divisor: Any) -> tuple[Any, Any]:
        """Quotient and rest of whole numbers."""
        number = np.asarray(number)
        kind = np.int64 if number.dtype.itemsize == 8 else np.int32
        quotient, rest = np.divmod(number.astype(kind, copy=False), kind(divisor))
        return quotient, rest.astype(np.int32, copy=False)

    @staticmethod
    def take(table: Any, index: Any) -> Any:
        """Entries of a table's values, or of an array, by flat index."""
        return (table.values if isinstance(table, LookupTable) else table).ravel()[index]

    @classmethod
    def take_cell(cls, table: LookupTable, corners: Sequence[Any]) -> list[Any]:
        """Entries of a table's values at all corners of a cell of its grid, by their flat indices."""
        return [cls.take(table, index) for index in corners]

    @staticmethod
    def take_four(table: Any, index: Any) -> tuple[Any, Any, Any, Any]:
        """Entries 4 i to 4 i + 3 of a table's values, or of an array, for each index i."""
        values = table.values.ravel() if isinstance(table, LookupTable) else table
        a, b, c, d = (values[4 * index + i] for i in range(4))
        return a, b, c, d

    @staticmethod
    def full(like: Any, value: Any) -> Any:
        """One value for each entry of ``like``."""
        return np.full(np.shape(like), value)

    @staticmethod
    def width(values: Any) -> int:
        """Number of entries."""
        return int(np.size(values))

    @staticmethod
    def index(like: Any) -> Any:
        """(n,) 0 .. n - 1: number of each lane."""
        return np.arange(len(like), dtype=np.int32)

    @staticmethod
    def column(lanes: Any, number: int, columns: int) -> Any:
        """Entry ``number`` of each group of ``columns`` lanes."""
        return np.asarray(lanes)[number::columns]

    @staticmethod
    def room(like: Any, size: int) -> Any:
        """Local memory: ``size`` numbers for each lane, part of a loop's state. Write before reading."""
        return np.zeros((size, *np.shape(like)))

    @staticmethod
    def put(room: Any, index: Any, value: Any) -> Any:
        """The room with entry ``index`` of each lane set to ``value``."""
        room = room.copy()
        np.put_along_axis(room, np.asarray(index)[None], np.asarray(value)[None], axis=0)
        return room

    @staticmethod
    def get(room: Any, index: Any) -> Any:
        """Entry ``index`` of each lane."""
        return np.take_along_axis(room, np.asarray(index)[None], axis=0)[0]

    @staticmethod
    def loop(state: S, active: Callable[[S], Mask], step: Callable[[S], S]) -> S:
        """Step every lane of the state for as long as it is active.

        A lane that has ended keeps its values while others go on.
        """
        while np.any(np.asarray(lanes := active(state))):
            state = select_state(lanes, step(state), state)
        return state

    @staticmethod
    def where_any(condition: Mask, compute: Callable[[], S], otherwise: S) -> S:
        """``compute()`` where the condition holds, else ``otherwise``; not called if the condition holds nowhere."""
        return select_state(condition, compute(), otherwise) if np.any(np.asarray(condition)) else otherwise

    @staticmethod
    def each(function: Callable[[Any], Any], values: Sequence[Any]) -> Sequence[Any]:
        """``function`` of each of these values, all in one call."""
        return cast(Sequence[Any], function(np.stack(np.broadcast_arrays(*values))))


class DrjitOps:
    """The same functions, on Dr.Jit arrays of the active variant."""

    def __init__(self) -> None:
        import drjit as dr

        for name in ("exp", "log", "sqrt", "sin", "cos", "asin", "atan2", "abs", "floor"):
            setattr(self, name, getattr(dr, name))
        self.rint: Any = dr.round
        self.where: Any = dr.select
        self._dr = dr
        self._uploaded: WeakKeyDictionary[LookupTable, dict[Any, Any]] = WeakKeyDictionary()
        self._zeros: dict[type, Any] = {}
        self.lookups: list[Any] | None = None  # `table_lookups`

    # dr.minimum and dr.maximum compile to LLVM's fminimum and fmaximum, which some releases cannot lower for scalars:
    # they abort the process ("Cannot select"). A comparison and a select always compile.
    def minimum(self, a: Any, b: Any) -> Any:
        """The smaller of two."""
        return self.where(a < b, a, b)

    def maximum(self, a: Any, b: Any) -> Any:
        """The larger of two."""
        return self.where(a > b, a, b)

    def choice(self, condition: Any) -> Callable[[Any, Any], Any]:
        """Return `where` with this condition, as a function of two arrays."""
        return lambda if_true, if_false: self.where(condition, if_true, if_false)

    def uint32(self, x: Any) -> Any:
        """32-bit unsigned integers."""
        return self._dr.uint32_array_t(type(x))(x)

    def float32(self, x: Any) -> Any:
        """Single precision, on the device."""
        return self._dr.float32_array_t(type(x))(x)

    def float64(self, x: Any) -> Any:
        """Double precision."""
        return self._dr.float64_array_t(type(x))(x)

    def product(self, a: Any, b: Any) -> Any:
        """Product of two numbers in double precision, rounded before anything is added to it."""
        # PTX may fuse a product and a sum into one operation that rounds once: the last bit then differs from NumPy's.
        # The product plus a zero that no compiler knows is such an operation already.
        if (zero := self._zeros.get(type(a))) is None:
            zero = self._zeros[type(a)] = self._dr.opaque(type(a), 0.0)
        return self._dr.fma(a, b, zero)

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """The product of the first two, plus the third, rounded once; LLVM makes one operation of two only here."""
        return self._dr.fma(a, b, c)

    def int32(self, x: Any) -> Any:
        """32-bit signed integers."""
        return self._dr.int32_array_t(type(x))(x)

    def divmod(self, number: Any, divisor: Any) -> tuple[Any, Any]:
        """Quotient and rest of whole numbers."""
        # Processors divide whole numbers one by one, and a scan pattern divides twice for each pulse. So they are
        # multiplied in double precision: (n + 1/2) / d is at least 1 / 2d off every whole number, and for n < 2^31 its
        # rounding is below 2^-20 / d, so that its floor is the quotient.
        number = self.int32(number)
        double = self._dr.float64_array_t(type(number))
        whole = self.int32((double(number) + 0.5) * (1.0 / double(divisor)))
        return whole, number - whole * divisor

    def take(self, table: Any, index: Any) -> Any:
        """Entries of a table's values, or of an array, by flat index.

        A table is uploaded once and stays on the device as long as the `LookupTable` exists.
        """
        if not isinstance(table, LookupTable):
            return self._dr.gather(type(table), table, self.uint32(index))
        kind = self._dr.float32_array_t(type(index))
        return self._dr.gather(kind, self.upload(table, kind), self.uint32(index))

    def upload(self, table: LookupTable, kind: Any, *, cells: bool = False) -> Any:
        """Values of a table on the device, or of the corners of its cells, as an array of this kind; uploaded once."""
        if (uploaded := self._uploaded.get(table)) is None:
            uploaded = self._uploaded[table] = {}
            retire_with(table, uploaded)
        if (kind, cells) not in uploaded:
            values = table.cells() if cells else table.values
            uploaded[kind, cells] = kind(aligned_copy(np.float32, values.ravel()))
        array = uploaded[kind, cells]
        if self.lookups is not None and all(array is not known for known in self.lookups):
            self.lookups.append(array)
        return array

    def take_cell(self, table: LookupTable, corners: Sequence[Any]) -> list[Any]:
        """Entries of a table's values at all corners of a cell of its grid, by their flat indices.

        The values of a cell are side by side on the device: processors load 16 that lie apart in a hundred cycles.
        """
        values, first = self.upload(table, self._dr.float32_array_t(type(corners[0])), cells=True), corners[0]
        if len(corners) == 2:
            return [*self._neighbours(values, first, 2)]
        fours = range(len(corners) // 4)
        return [value for four in fours for value in self._neighbours(values, first * len(fours) + four, 4)]

    def take_four(self, table: Any, index: Any) -> tuple[Any, Any, Any, Any]:
        """Entries 4 i to 4 i + 3 of a table's values, or of an array, for each index i: one load, not four."""
        values = table
        if isinstance(table, LookupTable):
            values = self.upload(table, self._dr.float32_array_t(type(index)))
        a, b, c, d = self._neighbours(values, index, 4)
        return a, b, c, d

    def _neighbours(self, values: Any, index: Any, count: int) -> Any:
        """Entries n i to n i + n - 1 of an array, for each index i; n is 2 or 4."""
        suffix = "64" if self._dr.itemsize_v(values) == 8 else ""
        kind = getattr(sys.modules[type(values).__module__], f"Array{count}f{suffix}")
        return self._dr.gather(kind, values, self.uint32(index))

    def full(self, like: Any, value: Any) -> Any:
        """One value for each entry of ``like``."""
        kinds = {bool: self._dr.mask_t, int: self._dr.int32_array_t, float: self._dr.float32_array_t}
        return self._dr.full(kinds[type(value)](type(like)), value, self._dr.width(like))

    def width(self, values: Any) -> int:
        """Number of entries."""
        return int(self._dr.width(values))

    def index(self, like: Any) -> Any:
        """(n,) 0 .. n - 1: number of each lane."""
        return self._dr.arange(self._dr.int32_array_t(type(like)), self._dr.width(like))

    def column(self, lanes: Any, number: int, columns: int) -> Any:
        """Entry ``number`` of each group of ``columns`` lanes."""
        # A single lane is the same for all: where every ray ends at glass, none has an echo.
        if columns == 1 or self._dr.width(lanes) == 1:
            return lanes
        count = self._dr.width(lanes) // columns
        index = self._dr.arange(self._dr.uint32_array_t(type(lanes)), count) * columns + number
        return self._dr.gather(type(lanes), lanes, index)

    def room(self, like: Any, size: int) -> Any:
        """Local memory: ``size`` numbers for each lane, part of a loop's state. Write before reading."""
        return self._dr.alloc_local(self._dr.float32_array_t(type(like)), size)

    def put(self, room: Any, index: Any, value: Any) -> Any:
        """The room with entry ``index`` of each lane set to ``value``."""
        room[self._bounded(room, index)] = value
        return room

    def get(self, room: Any, index: Any) -> Any:
        """Entry ``index`` of each lane."""
        return room[self._bounded(room, index)]

    def _bounded(self, room: Any, index: Any) -> Any:
        """Index of an entry, at most that of the last one."""
        # Dr.Jit 1.5 finds compiled kernels by a hash that leaves out how large local memory is on LLVM: the kernel of a
        # smaller room would serve a larger one, and write beyond its stack (docs/limits.md). This bound is a literal in
        # what is hashed, so that rooms of two sizes are two kernels. A literal index folds it away, but Dr.Jit refuses
        # those beyond the room, and they are hashed themselves.
        return self.minimum(self.uint32(index), len(room) - 1)

    def loop(self, state: S, active: Callable[[S], Mask], step: Callable[[S], S]) -> S:
        """Step every lane of the state for as long as it is active, as a loop inside the kernel.

        No derivatives pass through it: these loops only search, for the time of a crossing or a peak.
        """

        def is_active(*values: Any) -> Mask:
            return active(rebuild(state, iter(values)))

        def stepped(*values: Any) -> tuple[Any, ...]:
            return tuple(flatten(step(rebuild(state, iter(values)))))

        with self._dr.suspend_grad():
            final = self._dr.while_loop(tuple(flatten(state)), is_active, stepped, mode="symbolic")
        return rebuild(state, iter(final))

    @staticmethod
    def each(function: Callable[[Any], Any], values: Sequence[Any]) -> Sequence[Any]:
        """``function`` of each of these values."""
        return [function(value) for value in values]

    def where_any(self, condition: Mask, compute: Callable[[], S], otherwise: S) -> S:
        """``compute()`` where the condition holds, else ``otherwise``.

        A packet of lanes in which the condition holds nowhere skips it.
        """

        # Dr.Jit puts the results into the objects that a branch returns: without copies the caller's would change.
        def copies(values: S) -> tuple[Any, ...]:
            return tuple(type(array)(array) for array in flatten(values))

        arrays = self._dr.if_stmt((), condition, lambda: copies(compute()), lambda: copies(otherwise), mode="symbolic")
        return rebuild(otherwise, iter(arrays))


@dataclass(frozen=True, eq=False)
class LookupTable:
    """Values on an even grid, each axis from 0 to 1; looked up with numpy or Dr.Jit coordinates."""

    values: Numbers

    def at(self, *coordinates: Lanes) -> Lanes:
        """Multilinear interpolation; coordinates outside 0 .. 1 are clipped to the edge."""
        corners = self._corners(coordinates)
        values = xp(*coordinates).take_cell(self, [index for index, _ in corners])
        return sum(weight * value for (_, weight), value in zip(corners, values, strict=True))

    def cells(self) -> Numbers:
        """Values at the corners of the cell that begins at each entry, in the order of `take_cell`: one axis more."""
        padded = np.pad(self.values, [(0, 1)] * self.values.ndim, mode="edge")
        corners = itertools.product((0, 1), repeat=self.values.ndim)
        shifted = (padded[tuple(map(slice, steps, np.add(steps, self.values.shape)))] for steps in corners)
        return np.stack([*shifted], axis=-1)

    def four_at(self, *coordinates: Lanes) -> tuple[Lanes, Lanes, Lanes, Lanes]:
        """`at` of a table whose last axis, which has no coordinate, is four values: they are loaded together."""
        ops = xp(*coordinates)
        corners = [(weight, ops.take_four(self, index)) for index, weight in self._corners(coordinates)]
        a, b, c, d = (sum(weight * values[i] for weight, values in corners) for i in range(4))
        return a, b, c, d

    def _corners(self, coordinates: tuple[Lanes, ...]) -> list[tuple[Lanes, Lanes]]:
        """Flat index and weight of each corner of the cell at these coordinates, over as many axes."""
        ops = xp(*coordinates)
        corners: list[tuple[Lanes, Lanes]] = [(0, 1.0)]
        for x, size in zip(coordinates, self.values.shape, strict=False):
            scaled = ops.minimum(ops.maximum(x, 0.0), 1.0) * (size - 1.0)
            lower = ops.minimum(ops.floor(scaled), size - 2.0)
            first, share = ops.int32(lower), scaled - lower
            # Each axis doubles the corners: the weights of all are products of the shares along the axes.
            corners = [
                (index * size + first + step, weight * (share if step else 1.0 - share))
                for index, weight in corners
                for step in (0, 1)
            ]
        return corners

    def at_row(self, row: Lanes) -> tuple[Lanes, ...]:
        """All entries of one row of a table with two axes."""
        ops, columns = xp(row), self.values.shape[1]
        return tuple(ops.take(self, row * columns + column) for column in range(columns))


retired: deque[object] = deque()
"""Device arrays and scenes whose owners have gone. Their last reference: `kernel.device.gate` frees them in time."""


def retire_with(owner: object, *things: object, then: Callable[[object], None] = retired.append) -> None:
    """Keep things of the device until their owner goes, and hand them to ``then``: it may go while Dr.Jit records."""
    finalize(owner, then, things).atexit = False


NUMPY = NumpyOps()
_drjit: Any = None


@contextmanager
def table_lookups() -> Iterator[list[Any]]:
    """Collect the device arrays of all tables that are looked up on the device in this block, each once."""
    ops = _drjit_ops()
    outer, ops.lookups = ops.lookups, []
    try:
        yield ops.lookups
    finally:
        ops.lookups = outer


def upload(table: LookupTable, kind: Any, *, cells: bool) -> Any:
    """Put a table, or its cells, on the device before it is looked up; returns the array, of this kind of Dr.Jit."""
    return _drjit_ops().upload(table, kind, cells=cells)


def _drjit_ops() -> DrjitOps:
    global _drjit
    _drjit = _drjit or DrjitOps()
    return cast(DrjitOps, _drjit)


_ALIGNMENT = 64
"""Bytes; no load that LLVM emits (AVX-512) wants a larger alignment."""


def aligned_room(dtype: type[np.generic], size: int) -> Numbers:
    """Memory for (size,) numbers, of any value, that starts at a multiple of `_ALIGNMENT`."""
    # On the CPU Dr.Jit maps NumPy's memory without a copy and writes its alignment into the kernel. NumPy aligns to 16
    # bytes and more by chance: of twelve frames of changing size eight compiled a kernel for that reason alone. Four
    # neighbours of a table are one load only where it is aligned.
    length = np.dtype(dtype).itemsize * size
    room = np.empty(length + _ALIGNMENT, dtype=np.uint8)  # to clear it would take as long as to fill it
    start = -room.ctypes.data % _ALIGNMENT
    return room[start : start + length].view(dtype)


def aligned_copy(dtype: type[np.generic], *parts: Numbers) -> Numbers:
    """Copy arrays of one axis, one behind the other, into an `aligned_room`."""
    return np.concatenate(parts, out=aligned_room(dtype, sum(map(len, parts))), casting="unsafe")


def is_drjit(x: object) -> bool:
    """Return whether ``x`` is a Dr.Jit array, without importing Dr.Jit."""
    return _is_of_drjit(type(x).__module__)


@functools.cache
def _is_of_drjit(module: str) -> bool:
    return module.startswith(("drjit", "mitsuba"))


def inverse(order: Numbers) -> Numbers:
    """Return the (n,) uint32 inverse of a permutation: the place of each of 0 .. n - 1 in ``order``; numpy."""
    place = np.zeros(len(order), dtype=np.uint32)
    place[order] = np.arange(len(order), dtype=np.uint32)
    return place


def xp(*arguments: object) -> Ops:
    """Return the functions for these arguments: Dr.Jit's if any of them is a Dr.Jit array, else numpy's."""
    if any(map(is_drjit, arguments)):
        return cast(Ops, _drjit_ops())
    return cast(Ops, NUMPY)


def frozen(values: object, dtype: Any, shape: tuple[int | None, ...], *, name: str = "array") -> Numbers:
    """Return ``values`` as a read-only array of this dtype and shape (None: any length).

    Copies only if the dtype changes.

    Raises:
        ValueError: with the name, the shape it got and the shape it needs
    """
    try:
        array = np.asarray(values, dtype=dtype)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if array.shape != shape and (
        len(array.shape) != len(shape)
        or any(want is not None and have != want for have, want in zip(array.shape, shape, strict=True))
    ):
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    if array.flags.writeable:
        array = array.view()
        array.flags.writeable = False
    return array
