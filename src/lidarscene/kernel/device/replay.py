"""Replay: stages written down for the device once, and from then on only launched again.

Python takes 7 ms to write down the stages of pulses that end at the first surface, and 25 ms those of pulses that go
on through glass, however few there are: half the time of a frame of 65,000. Dr.Jit can keep what it recorded
(`dr.freeze`); what it is handed may then have any values, and any number of lanes.
"""

from __future__ import annotations

import dataclasses
import gc
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ...maths.arrays import is_drjit, uploaded_tables
from . import transfer
from .backend import is_cuda

_RECORDINGS = 4
"""Kept of one function: what looks alike to it is told by types, and by which arrays are of one length."""

_PASSES = 10
"""More than enough: three were needed."""


class Replay:
    """A function from arrays on the device to a description full of them, of one length or one.

    Its first call is recorded, others repeat it. What the function makes of a number of lanes must not become a number
    in its kernels (`dr.freeze`), and Python must not choose anything in it by what may differ between calls: then the
    answers are the same, bit by bit (tests/kernel/test_replay.py). Where Dr.Jit cannot record it, as with a plug-in
    that hides its arrays, it is an ordinary function.

    function  of arrays alone, the first one with a number for each lane
    wanted    a description to the list of its arrays that are still needed; instead of others comes `LEFT_OUT`
    held      other descriptions, or Mitsuba objects, whose arrays it uses
    """

    def __init__(
        self, function: Callable[..., Any], wanted: Callable[[Any], list[Any]], *, held: tuple[Any, ...]
    ) -> None:
        self._function, self._wanted = function, wanted
        self._handed: list[Any] = []
        _gather(held, self._handed)
        self._plan: list[Any] = []
        self._frozen: Any = None
        self._records = not is_cuda()

    def __call__(self, *arguments: Any) -> Any:
        """What the function says of these arguments (arrays and tuples of them), its wanted arrays started."""
        while self._records:
            tables = len(uploaded_tables())
            try:
                return self._repeated(*arguments)
            except RuntimeError as error:
                first = _first(error)
                if not isinstance(first, RuntimeError):  # of the function itself, or Ctrl-C
                    raise first from None
                # A table goes to the device when something is first looked up in it; the next time it is handed over.
                self._records = len(uploaded_tables()) > tables
        found = self._function(*arguments)
        transfer.start(self._wanted(found))
        return found

    @property
    def recordings(self) -> int:
        """How often it was written down; 0 where it is an ordinary function."""
        return int(self._frozen.n_recordings) if self._records and self._frozen is not None else 0

    def _repeated(self, *arguments: Any) -> Any:
        import drjit as dr

        with _no_garbage():
            if self._frozen is None:
                self._frozen = self._prepared()
            arrays = self._frozen(*arguments)
        lengths = (1, dr.width(arguments[0]))
        if any(dr.width(one) not in lengths for one in arrays):
            raise RuntimeError(
                "an array of numbers that are all the same keeps the length it was recorded with"
            )
        return _filled(self._plan[0], arrays)

    def _prepared(self) -> Any:
        import drjit as dr

        # A function that Dr.Jit has frozen waits for the garbage collector: what it works with must not.
        own: dict[str, Any] = {
            "function": self._function,
            "wanted": self._wanted,
            "handed": self._handed,
            "plan": self._plan,
        }
        weakref.finalize(self, own.clear)

        def recorded(*arguments: Any) -> list[Any]:
            found = own["function"](*arguments)
            outputs: list[Any] = own["wanted"](found)
            own["plan"][:] = [_plan(found, {id(one): place for place, one in enumerate(outputs)})]
            return outputs

        def handed(*_: Any) -> Any:
            return own["handed"], uploaded_tables()

        _settle(handed)
        # What is a number in one recording and an array in the next would be another kernel: all become arrays.
        return dr.freeze(recorded, state_fn=handed, limit=_RECORDINGS, warn_after=1000, auto_opaque=False)


def _first(error: BaseException) -> BaseException:
    """What an error began with."""
    return error if error.__cause__ is None else _first(error.__cause__)


def _settle(handed: Callable[..., Any]) -> None:
    """Have all that a recording is handed become arrays, and what is equal one: each pass over it leaves less to do,
    and what is left would be compiled anew in the next frame.
    """
    import drjit as dr

    nothing = dr.freeze(lambda x: x + 1, state_fn=handed, auto_opaque=False, warn_after=1000)
    number, before = transfer.opaque_uint32(0), -1
    while before < nothing.n_recordings <= _PASSES:
        before = nothing.n_recordings
        dr.eval(nothing(number))


@contextmanager
def _no_garbage() -> Iterator[None]:
    """Dr.Jit aborts the process where another scene goes away while it records."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class _LeftOut:
    """No array, and not None either, which says that there never was one."""


LEFT_OUT = _LeftOut()


@dataclasses.dataclass(frozen=True, slots=True)
class _Place:
    """Where an array of a plan is in the list."""

    index: int


def _gather(value: Any, found: list[Any]) -> None:
    """Every array in descriptions and tuples, however deep."""
    if is_drjit(value):
        found.append(value)
    elif isinstance(value, tuple | list):
        for inner in value:
            _gather(inner, found)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            _gather(getattr(value, field.name), found)


def _plan(value: Any, places: dict[int, int]) -> Any:
    """A description with the places of its arrays instead of them."""
    if is_drjit(value):
        return _Place(places[id(value)]) if id(value) in places else LEFT_OUT
    return _changed(value, lambda inner: _plan(inner, places))


def _filled(plan: Any, arrays: list[Any]) -> Any:
    """A plan with arrays in their places."""
    if isinstance(plan, _Place):
        return arrays[plan.index]
    return _changed(plan, lambda inner: _filled(inner, arrays))


def _changed(value: Any, change: Callable[[Any], Any]) -> Any:
    """A description with everything in it changed."""
    if isinstance(value, tuple | list):
        return type(value)(change(inner) for inner in value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.replace(
            value, **{field.name: change(getattr(value, field.name)) for field in dataclasses.fields(value)}
        )
    return value
