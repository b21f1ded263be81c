"""Record the stages of a frame once, and launch the recording for every later frame.

Dr.Jit computes nothing while Python runs the stages: it records their operations, turns them into a kernel and
launches that. Recording takes Python 7 ms for pulses that end at the first surface and 25 ms for those that go on
through glass, however few pulses there are: half the time of a frame of 65,000. `dr.freeze` keeps the kernels of a
function and how its inputs and outputs are wired to them. The next call then skips Python and launches them, for
inputs of any values and any number of lanes.

A recording is only right if everything that differs between calls is an input, and an array rather than a literal.
This module sees to that; what cannot be recorded runs as an ordinary function.
"""

from __future__ import annotations

import dataclasses
import gc
import operator
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, cast

from ...maths.arrays import LookupTable, is_drjit, table_lookups, upload
from ...scene.scene import Body, Scene
from . import transfer
from .backend import mitsuba
from .types import DeviceArray

_RECORDINGS = 4
"""Recordings kept of one function. Dr.Jit makes one for each layout of the inputs: their types, and which of them have
the same length."""

_PASSES = 10
"""Limit of `_settle`, where three passes were needed, and of the attempts to record, where two were."""


class Replay:
    """A function of device arrays, recorded at its first call and replayed at later ones.

    The results are those of the function itself, bit by bit (tests/kernel/device/test_replay.py), if it keeps two
    rules: no number of lanes enters its kernels as a literal, and Python takes no decision in it by what differs
    between calls. If Dr.Jit cannot record it (a plug-in that hides its arrays), each call runs the function itself.

    Args:
        function: takes arrays and tuples of them, the first with an element for each lane; returns a description
            (frozen dataclasses and tuples) whose arrays have that length, or one element
        select_outputs: takes such a description and returns the list of its arrays that are needed; `LEFT_OUT` stands
            for the others
        captured: descriptions and Mitsuba objects whose arrays the function uses without getting them as arguments
        rays: of each lane: the function may return arrays with an element for each of these, too
    """

    def __init__(
        self,
        function: Callable[..., object],
        select_outputs: Callable[[Any], list[Any]],
        *,
        captured: tuple[object, ...],
        rays: int = 1,
    ) -> None:
        self._function, self._select_outputs, self._rays = function, select_outputs, rays
        self._inputs: list[Any] = []
        _collect_arrays(captured, self._inputs)
        self._plan: list[Any] = []
        self._frozen: Any = None
        self._attempts = 0
        self._records = True

    def __call__(self, *arguments: object) -> Any:
        """Return what the function returns for these arguments; its selected arrays are being computed."""
        while self._records:
            self._attempts += 1
            with table_lookups() as tables:
                try:
                    result = self._replay(*arguments)
                    self._attempts = 0
                    return result
                except RuntimeError as error:
                    # Dr.Jit wraps whatever goes wrong while it records. An error of the function itself, or Ctrl-C, is
                    # raised as it was; Dr.Jit's own RuntimeError means that this cannot be recorded.
                    cause = _root_cause(error)
                    if not isinstance(cause, RuntimeError):
                        raise cause from None
            # With one exception: a table that is in none of the descriptions is no input, which Dr.Jit refuses. It is
            # one of the next attempt. Only the function's own tables are: those of other simulators would be a new
            # layout of the inputs, and a new recording, whenever one is made.
            known = {id(array) for array in self._inputs}
            missing = [array for array in tables if id(array) not in known]
            self._inputs += missing
            self._records = bool(missing) and self._attempts < _PASSES
        description = self._function(*arguments)
        transfer.start(self._select_outputs(description))
        return description

    @property
    def recordings(self) -> int:
        """Number of recordings made; 0 if each call runs the function itself."""
        return int(self._frozen.n_recordings) if self._records and self._frozen is not None else 0

    def _replay(self, *arguments: object) -> Any:
        import drjit as dr

        with _no_garbage():
            if self._frozen is None:
                self._frozen = self._frozen_function()
            arrays = self._frozen(*arguments)
        # An output that depends on no lane, such as a constant over all lanes, is replayed with the width of its
        # recording. Such a function is not recorded at all.
        lanes = dr.width(arguments[0])
        lengths = (1, lanes, lanes * self._rays)
        if any(dr.width(array) not in lengths for array in arrays):
            raise RuntimeError("an array of numbers that are all the same keeps the length it was recorded with")
        return self._plan[0](arrays)

    def _frozen_function(self) -> Any:
        import drjit as dr

        # A frozen function is part of a reference cycle and lives until the garbage collector finds it. It must not
        # keep scenes and sensors alive so long: it reaches them through this dictionary, which is emptied with `self`.
        shared: dict[str, Any] = {
            "function": self._function,
            "select_outputs": self._select_outputs,
            "inputs": self._inputs,
            "plan": self._plan,
        }
        weakref.finalize(self, shared.clear)

        # `shared` is a default, not a closure: Dr.Jit traverses closures at each call and would see all inputs twice.
        def recorded(*arguments: object, shared: dict[str, Any] = shared) -> list[Any]:
            # A frozen function returns a flat list. The plan, which is made while Python still runs, remembers which
            # array of the list belongs where in the description; a replay only brings a new list.
            description = shared["function"](*arguments)
            outputs: list[Any] = shared["select_outputs"](description)
            shared["plan"][:] = [_filler(description, {id(array): place for place, array in enumerate(outputs)})]
            return outputs

        def inputs(*_: object) -> Any:
            """Return all arrays that are read and are not arguments, which Dr.Jit must watch, too."""
            return shared["inputs"]

        _settle(inputs)
        # auto_opaque would begin with literals in the kernels and turn those into arrays that change from call to
        # call, with a new recording each time. Without it every literal among the inputs becomes an array at once.
        return dr.freeze(recorded, state_fn=inputs, limit=_RECORDINGS, warn_after=1000, auto_opaque=False)


def _root_cause(error: BaseException) -> BaseException:
    """Return the first error in a chain of causes."""
    return error if error.__cause__ is None else _root_cause(error.__cause__)


def _settle(inputs: Callable[..., object]) -> None:
    """Bring all inputs into the form in which Dr.Jit leaves them, before anything is recorded with them."""
    import drjit as dr

    # A frozen function turns literals among its inputs into arrays and lets equal ones share one. That changes their
    # layout, and Dr.Jit records anew for each layout: the second frame would compile again. So a function that does
    # nothing goes over the same inputs until it meets no new layout.
    no_op = dr.freeze(lambda x: x + 1, state_fn=inputs, auto_opaque=False, warn_after=1000)
    number, before = transfer.opaque_uint32(0), -1
    while before < no_op.n_recordings <= _PASSES:
        before = no_op.n_recordings
        dr.eval(no_op(number))


@contextmanager
def _no_garbage() -> Iterator[None]:
    """Keep the garbage collector off: Dr.Jit aborts the process if a scene is freed while it records."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class _LeftOut:
    """Type of `LEFT_OUT`: neither an array nor None, which in descriptions means that there never was an array."""


LEFT_OUT = _LeftOut()
"""Placeholder, in a replayed description, for an array that was not selected."""


def _collect_arrays(value: object, arrays: list[DeviceArray]) -> None:
    """Append to ``arrays`` every array in descriptions and tuples, however deep; upload their tables."""
    if is_drjit(value):
        arrays.append(cast(DeviceArray, value))
    elif isinstance(value, LookupTable):
        # Now, not at its first lookup: that would be in the middle of the first recording, which then fails.
        # Which of both it is looked up in is not known before.
        arrays.extend(upload(value, mitsuba().Float, cells=cells) for cells in (False, True))
    elif isinstance(value, tuple | list):
        for inner in value:
            _collect_arrays(inner, arrays)
    elif dataclasses.is_dataclass(value) and not isinstance(value, Scene | Body):
        # Scenes and bodies have no array of the device, and a town 380,000 parts, poses and names.
        for field in dataclasses.fields(value):
            _collect_arrays(getattr(value, field.name), arrays)


Filler = Callable[[list[DeviceArray]], Any]
"""Function that builds a description from the list of its outputs."""


def _filler(value: object, places: dict[int, int]) -> Filler:
    """Return a function that fills a description of this form with new arrays.

    Built once: to go through dataclasses by their fields takes half a millisecond, a tenth of Python's share of a
    frame.

    Args:
        places: index in the list of outputs by id of the array
    """
    if is_drjit(value):
        return operator.itemgetter(places[id(value)]) if id(value) in places else lambda _: LEFT_OUT
    if isinstance(value, tuple | list):
        kind, inner = type(value), [_filler(part, places) for part in value]
        return lambda arrays: kind([fill(arrays) for fill in inner])
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        dataclass_type, names = type(value), [field.name for field in dataclasses.fields(value)]
        parts = [_filler(getattr(value, name), places) for name in names]
        return lambda arrays: dataclass_type(**{name: fill(arrays) for name, fill in zip(names, parts, strict=True)})
    return lambda _: value
