"""Types that numpy and Dr.Jit arrays share: lanes, masks, and the functions of `arrays.xp`.

Formulas are written once and run on both (`maths.arrays`). Neither library's types fit the other's arrays, so these
protocols say what a formula may use; mypy then finds a formula that would run on one kind only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias, TypeVar

from numpy.typing import NDArray


class Mask(Protocol):
    """Yes or no for each lane, or for all of them: a bool goes with arrays of them."""

    def __and__(self, other: Any, /) -> Mask: ...
    def __rand__(self, other: Any, /) -> Mask: ...
    def __or__(self, other: Any, /) -> Mask: ...
    def __ror__(self, other: Any, /) -> Mask: ...
    def __invert__(self) -> Mask: ...


class Array(Protocol):
    """The operators that numpy and Dr.Jit arrays share, on numbers, whole numbers and masks; all lane by lane."""

    def __add__(self, other: Any, /) -> Array: ...
    def __radd__(self, other: Any, /) -> Array: ...
    def __sub__(self, other: Any, /) -> Array: ...
    def __rsub__(self, other: Any, /) -> Array: ...
    def __mul__(self, other: Any, /) -> Array: ...
    def __rmul__(self, other: Any, /) -> Array: ...
    def __truediv__(self, other: Any, /) -> Array: ...
    def __rtruediv__(self, other: Any, /) -> Array: ...
    def __pow__(self, other: Any, /) -> Array: ...
    def __floordiv__(self, other: Any, /) -> Array: ...
    def __mod__(self, other: Any, /) -> Array: ...
    def __lt__(self, other: Any, /) -> Array: ...
    def __le__(self, other: Any, /) -> Array: ...
    def __gt__(self, other: Any, /) -> Array: ...
    def __ge__(self, other: Any, /) -> Array: ...
    def __and__(self, other: Any, /) -> Array: ...
    def __rand__(self, other: Any, /) -> Array: ...
    def __or__(self, other: Any, /) -> Array: ...
    def __ror__(self, other: Any, /) -> Array: ...
    def __xor__(self, other: Any, /) -> Array: ...
    def __rxor__(self, other: Any, /) -> Array: ...
    def __lshift__(self, other: Any, /) -> Array: ...
    def __rshift__(self, other: Any, /) -> Array: ...
    def __eq__(self, other: Any, /) -> Array: ...  # type: ignore[override]
    def __neg__(self) -> Array: ...
    def __invert__(self) -> Array: ...
    def __len__(self) -> int: ...
    def __getitem__(self, index: Any, /) -> Any: ...
    def __float__(self) -> float: ...
    def __array__(self) -> Numbers: ...


Lanes: TypeAlias = float | Array
"""A number for each lane, or one number for all of them."""

Numbers: TypeAlias = NDArray[Any]
"""A numpy array; its dtype and shape stand in the docstring."""

S = TypeVar("S")
"""State of a loop: a dataclass or tuple of arrays, dataclasses and tuples."""


class Tabulated(Protocol):
    """A `maths.arrays.LookupTable`."""

    @property
    def values(self) -> Numbers:
        """Values on an even grid."""


class Ops(Protocol):
    """The shared functions; `NumpyOps` and `DrjitOps` have them."""

    def exp(self, x: Lanes, /) -> Array:
        """e^x."""

    def log(self, x: Lanes, /) -> Array:
        """Natural logarithm."""

    def sqrt(self, x: Lanes, /) -> Array:
        """Square root."""

    def sin(self, x: Lanes, /) -> Array:
        """Sine."""

    def cos(self, x: Lanes, /) -> Array:
        """Cosine."""

    def asin(self, x: Lanes, /) -> Array:
        """Arc sine."""

    def abs(self, x: Lanes, /) -> Array:
        """Absolute value."""

    def floor(self, x: Lanes, /) -> Array:
        """Next whole number below."""

    def rint(self, x: Lanes, /) -> Array:
        """Nearest whole number, halves to the even one."""

    def atan2(self, y: Lanes, x: Lanes, /) -> Array:
        """Angle of (x, y)."""

    def maximum(self, a: Lanes, b: Lanes, /) -> Array:
        """The larger of two."""

    def minimum(self, a: Lanes, b: Lanes, /) -> Array:
        """The smaller of two."""

    def where(self, condition: Mask, if_true: Lanes | Mask, if_false: Lanes | Mask, /) -> Array:
        """``if_true`` where the condition holds, else ``if_false``."""

    def choice(self, condition: Mask, /) -> Callable[[Any, Any], Any]:
        """Return `where` with this condition, as a function of two arrays of a state."""

    def uint32(self, x: Lanes) -> Array:
        """32-bit unsigned integers."""

    def float32(self, x: Lanes) -> Array:
        """Single precision, as the device computes in."""

    def float64(self, x: Lanes) -> Array:
        """Double precision."""

    def product(self, a: Lanes, b: Lanes) -> Array:
        """Product of two numbers in double precision, rounded before anything is added to it."""

    def fma(self, a: Lanes, b: Lanes, c: Lanes) -> Array:
        """The product of the first two, plus the third: one operation on the device, for kernels' inner loops."""

    def int32(self, x: Lanes) -> Array:
        """32-bit signed integers."""

    def divmod(self, number: Lanes, divisor: Lanes) -> tuple[Array, Array]:
        """Quotient and rest of whole numbers, 0 to 2^31 - 1 by 1 to 2^31 - 1; 32-bit signed integers.

        NumPy divides 64-bit numbers, too; their quotients have 64 bits.
        """

    def take(self, table: Tabulated | Lanes, index: Lanes) -> Array:
        """Entries of a table's values, or of an array, by flat index."""

    def take_cell(self, table: Tabulated, corners: Sequence[Lanes]) -> Sequence[Array]:
        """Entries of a table's values at all corners of a cell of its grid, by their flat indices."""

    def take_four(self, table: Tabulated | Lanes, index: Lanes) -> tuple[Array, Array, Array, Array]:
        """Entries 4 i to 4 i + 3 of a table's values, or of an array, for each index i."""

    def full(self, like: Lanes | Mask, value: float) -> Array:
        """Array of ``value`` in each lane of ``like``."""

    def width(self, values: Lanes) -> int:
        """Number of lanes."""

    def index(self, like: Lanes) -> Array:
        """Number of each lane."""

    def column(self, lanes: Lanes | Mask, number: int, columns: int) -> Array:
        """Entry ``number`` of each group of ``columns`` lanes."""

    def room(self, like: Lanes, size: int) -> Array:
        """Local memory of ``size`` numbers for each lane, part of a loop's state; write before reading."""

    def put(self, room: Array, index: Lanes, value: Lanes) -> Array:
        """Set entry ``index`` of each lane's local memory; returns the memory."""

    def get(self, room: Array, index: Lanes) -> Array:
        """Entry ``index`` of each lane's local memory."""

    def loop(self, state: S, active: Callable[[S], Mask], step: Callable[[S], S]) -> S:
        """Step every lane of the state for as long as it is active."""

    def each(self, function: Callable[[Any], Any], values: Sequence[Lanes], /) -> Sequence[Any]:
        """``function``, which goes lane by lane, of each of these values."""

    def where_any(self, condition: Mask, compute: Callable[[], S], otherwise: S) -> S:
        """``compute()`` where the condition holds, else ``otherwise``; for what is costly and seldom needed."""
