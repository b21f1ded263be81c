"""One source, two array types: the small set of functions that numpy and Dr.Jit share.

Stage and formula code asks ``xp(a, b, ...)`` for the functions that fit its arguments and then runs
unchanged on numpy arrays (slow, obvious, no LLVM) and on Dr.Jit arrays (fast, any device). Plain
Python floats go with either.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np

Array: TypeAlias = Any
"""A Python float, a numpy array or a Dr.Jit array; all operators work on each."""

State: TypeAlias = tuple[Any, ...]
"""What a loop carries from step to step: arrays of one length."""


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
    def uint32(x: Array) -> Array:
        """32-bit unsigned integers, at least one-dimensional (numpy scalars warn when they wrap)."""
        return np.atleast_1d(np.asarray(x)).astype(np.uint32)

    @staticmethod
    def float32(x: Array) -> Array:
        """Single precision, as the device computes in."""
        return np.asarray(x, dtype=np.float32)

    @staticmethod
    def int32(x: Array) -> Array:
        """32-bit signed integers."""
        return np.asarray(x).astype(np.int32)

    @staticmethod
    def take(table: Table | Array, index: Array) -> Array:
        """Entries of a table's values, or of an array's, one after the other."""
        return (table.values if isinstance(table, Table) else table).ravel()[index]

    @staticmethod
    def full(like: Array, value: Any) -> Array:
        """As many times this number as ``like`` is long."""
        return np.full(np.shape(like), value)

    @staticmethod
    def width(values: Array) -> int:
        """How many numbers these are."""
        return int(np.size(values))

    @staticmethod
    def index(like: Array) -> Array:
        """Number of each lane."""
        return np.arange(len(like), dtype=np.int32)

    @staticmethod
    def column(lanes: Array, number: int, columns: int) -> Array:
        """Entry ``number`` of each group of ``columns`` lanes."""
        return np.asarray(lanes)[number::columns]

    @staticmethod
    def room(like: Array, size: int) -> Array:
        """``size`` numbers for each lane, to be written before they are read; part of a loop's state."""
        return np.zeros((size, *np.shape(like)))

    @staticmethod
    def put(room: Array, index: Array, value: Array) -> Array:
        """The room with each lane's number ``index`` changed."""
        room = room.copy()
        np.put_along_axis(room, np.asarray(index)[None], np.asarray(value)[None], axis=0)
        return room

    @staticmethod
    def get(room: Array, index: Array) -> Array:
        """Each lane's number ``index``."""
        return np.take_along_axis(room, np.asarray(index)[None], axis=0)[0]

    @staticmethod
    def loop(state: State, going: Callable[..., Array], step: Callable[..., State]) -> State:
        """Step every lane of the state (a tuple of arrays) for as long as it is going."""
        while np.any(lanes := going(*state)):
            changed = step(*state)
            state = tuple(np.where(lanes, new, old) for new, old in zip(changed, state, strict=True))
        return state

    @staticmethod
    def rarely(condition: Array, then: Callable[[], State], otherwise: State) -> State:
        """``then()`` where the condition holds, else ``otherwise``; for what is dear and seldom needed."""
        if not np.any(condition):
            return otherwise
        return tuple(np.where(condition, new, old) for new, old in zip(then(), otherwise, strict=True))


class DrjitOps:
    """The same functions, on Dr.Jit arrays of the active variant."""

    def __init__(self) -> None:
        import drjit as dr

        for name in ("exp", "log", "sqrt", "sin", "cos", "asin", "atan2", "abs", "floor"):
            setattr(self, name, getattr(dr, name))
        self.rint: Any = dr.round
        self.where: Any = dr.select
        self._dr = dr
        self._uploaded: WeakKeyDictionary[Table, dict[Any, Any]] = WeakKeyDictionary()

    # dr.minimum and dr.maximum become LLVM's fminimum and fmaximum, which some releases cannot lower for
    # scalars and then abort the process ("Cannot select"); a comparison and a select are always there.
    def minimum(self, a: Array, b: Array) -> Array:
        """The smaller of two."""
        return self.where(a < b, a, b)

    def maximum(self, a: Array, b: Array) -> Array:
        """The larger of two."""
        return self.where(a > b, a, b)

    def uint32(self, x: Array) -> Array:
        """32-bit unsigned integers."""
        return self._dr.uint32_array_t(type(x))(x)

    def float32(self, x: Array) -> Array:
        """Single precision, on the device."""
        return self._dr.float32_array_t(type(x))(x)

    def int32(self, x: Array) -> Array:
        """32-bit signed integers."""
        return self._dr.int32_array_t(type(x))(x)

    def take(self, table: Table | Array, index: Array) -> Array:
        """Entries of a table's values, which go to the device once and stay as long as the table, or of an array."""
        kind = self._dr.float32_array_t(type(index))
        if not isinstance(table, Table):
            return self._dr.gather(kind, table, self.uint32(index))
        uploaded = self._uploaded.setdefault(table, {})
        if kind not in uploaded:
            uploaded[kind] = kind(table.values.ravel().astype(np.float32))
        return self._dr.gather(kind, uploaded[kind], self.uint32(index))

    def full(self, like: Array, value: Any) -> Array:
        """As many times this number as ``like`` is long."""
        kinds = {bool: self._dr.mask_t, int: self._dr.int32_array_t, float: self._dr.float32_array_t}
        return self._dr.full(kinds[type(value)](type(like)), value, self._dr.width(like))

    def width(self, values: Array) -> int:
        """How many numbers these are."""
        return int(self._dr.width(values))

    def index(self, like: Array) -> Array:
        """Number of each lane."""
        return self._dr.arange(self._dr.int32_array_t(type(like)), self._dr.width(like))

    def column(self, lanes: Array, number: int, columns: int) -> Array:
        """Entry ``number`` of each group of ``columns`` lanes."""
        if columns == 1:
            return lanes
        count = self._dr.width(lanes) // columns
        index = self._dr.arange(self._dr.uint32_array_t(type(lanes)), count) * columns + number
        return self._dr.gather(type(lanes), lanes, index)

    def room(self, like: Array, size: int) -> Array:
        """``size`` numbers for each lane, to be written before they are read; part of a loop's state."""
        return self._dr.alloc_local(self._dr.float32_array_t(type(like)), size)

    def put(self, room: Array, index: Array, value: Array) -> Array:
        """The room with each lane's number ``index`` changed."""
        room[self.uint32(index)] = value
        return room

    def get(self, room: Array, index: Array) -> Array:
        """Each lane's number ``index``."""
        return room[self.uint32(index)]

    def loop(self, state: State, going: Callable[..., Array], step: Callable[..., State]) -> State:
        """Step every lane of the state (a tuple of arrays) for as long as it is going, inside the kernel.

        No derivatives go through it: loops look for places.
        """
        with self._dr.suspend_grad():
            done: State = self._dr.while_loop(state, going, step, mode="symbolic")
        return done

    def rarely(self, condition: Array, then: Callable[[], State], otherwise: State) -> State:
        """``then()`` where the condition holds, else ``otherwise``; a packet of lanes that all do without skips it."""
        found: State = self._dr.if_stmt((), condition, then, lambda: otherwise, mode="symbolic")
        return found


@dataclass(frozen=True, eq=False)
class Table:
    """Values on an even grid, each axis from 0 to 1: looked up by numpy and Dr.Jit arrays alike."""

    values: np.ndarray[Any, Any]

    def at(self, *coordinates: Array) -> Array:
        """Linear between the grid's points along every axis; what lies outside counts as the edge."""
        ops = xp(*coordinates)
        corners: list[tuple[Array, Array]] = [(0, 1.0)]  # flat index and weight
        for x, size in zip(coordinates, self.values.shape, strict=True):
            scaled = ops.minimum(ops.maximum(x, 0.0), 1.0) * (size - 1.0)
            lower = ops.minimum(ops.floor(scaled), size - 2.0)
            first, share = ops.int32(lower), scaled - lower
            corners = [
                (index * size + first + step, weight * (share if step else 1.0 - share))
                for index, weight in corners
                for step in (0, 1)
            ]
        return sum(weight * ops.take(self, index) for index, weight in corners)

    def at_row(self, row: Array) -> tuple[Array, ...]:
        """All entries of a row of a table with two axes."""
        ops, columns = xp(row), self.values.shape[1]
        return tuple(ops.take(self, row * columns + column) for column in range(columns))


NUMPY = NumpyOps()
_drjit: DrjitOps | None = None


def uploaded_tables() -> list[Array]:
    """Values of all tables that are on the device."""
    return [] if _drjit is None else [one for kinds in _drjit._uploaded.values() for one in kinds.values()]


def is_drjit(x: object) -> bool:
    """Whether ``x`` is a Dr.Jit array; does not import Dr.Jit."""
    return type(x).__module__.startswith(("drjit", "mitsuba"))


def inverse(order: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """(n,) uint32 where each of 0 .. n - 1 stands in ``order``, a permutation of them; numpy."""
    place = np.zeros(len(order), dtype=np.uint32)
    place[order] = np.arange(len(order), dtype=np.uint32)
    return place


def xp(*arguments: object) -> Any:
    """The function set for these arguments: Dr.Jit's if any of them is a Dr.Jit array, else numpy's."""
    global _drjit
    if any(is_drjit(x) for x in arguments):
        if _drjit is None:
            _drjit = DrjitOps()
        return _drjit
    return NUMPY


def frozen(values: object, dtype: Any, shape: tuple[int | None, ...]) -> np.ndarray[Any, Any]:
    """``values`` as a read-only array of this dtype and shape (None: any length).

    Copies only when the dtype has to change. Raises ValueError naming what came and what was expected.
    """
    array = np.asarray(values, dtype=dtype).view()
    if len(array.shape) != len(shape) or any(
        want is not None and have != want for have, want in zip(array.shape, shape, strict=True)
    ):
        raise ValueError(f"array of shape {array.shape} came, {shape} was expected")
    array.flags.writeable = False
    return array
