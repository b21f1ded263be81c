"""Arrays of codes that compare by name: "car" or its number.

NumPy compares numbers with text in silence: nothing is equal. Columns such as class, body and status are therefore
arrays of a class of their own, which knows the names.
"""

from __future__ import annotations

import numbers
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..errors import InputError, did_you_mean, one_line, warn
from ..maths.arrays import Numbers


class UnknownNameWarning(UserWarning):
    """Warning that no point can have a name that was asked for."""


class CategoryArray(np.ndarray[Any, np.dtype[Any]]):
    """Whole numbers, each the place of its name in ``names``: ``codes == "car"`` is a mask, as is ``codes == 2``.

    What is computed from it is a plain array; slices and selections keep the names. A code without a name is -1.

    Attributes:
        names: name of each code; empty if they have none
        title: what the codes are, for messages
    """

    names: tuple[str, ...]
    title: str

    @classmethod
    def of(cls, codes: Numbers, names: tuple[str, ...], title: str) -> CategoryArray:
        """Give names to ``codes``, whose memory is shared."""
        categories = codes.view(cls)
        categories.names, categories.title = names, title
        return categories

    def __array_finalize__(self, source: Any) -> None:
        self.names = getattr(source, "names", ())
        self.title = getattr(source, "title", "codes")

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        """Result of a computation: it is no code any more."""
        return array[()] if return_scalar else np.asarray(array)

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        """Function of NumPy on the codes; `numpy.isin` looks for names too."""
        if function is np.isin and not options and len(arguments) == 2 and arguments[0] is self:
            return self.isin(arguments[1])
        return super().__array_function__(function, types, arguments, options)

    def __eq__(self, other: Any) -> Any:
        return self._codes() == self._codes_of(other)

    def __ne__(self, other: Any) -> Any:
        return self._codes() != self._codes_of(other)

    __hash__ = None

    def isin(self, choices: Any) -> Numbers:
        """Mask of the codes that are one of these names or numbers.

        Raises:
            InputError: for what is neither
        """
        listed = list(choices) if isinstance(choices, list | tuple | set | frozenset | np.ndarray) else [choices]
        return np.isin(self._codes(), np.array([self._code(choice) for choice in listed], np.int64))

    def as_names(self) -> Numbers:
        """Names of the codes, an array of text; "" for what has none."""
        codes = self._codes().astype(np.intp)
        table = np.array([*self.names, ""])
        return table[np.where((codes >= 0) & (codes < len(self.names)), codes, len(self.names))]

    @property
    def has_names(self) -> bool:
        """True if every name is that of one code, so that the names alone say all."""
        return 0 < len(self.names) == len(set(self.names))

    def _codes(self) -> Numbers:
        return self.view(np.ndarray)

    def _codes_of(self, other: Any) -> Any:
        """``other`` with numbers in the place of names."""
        if isinstance(other, str):
            return self._code(other)
        values = np.asarray(other)
        if values.dtype.kind not in "USTO" or not values.size or not isinstance(values.flat[0], str):
            return values.view(np.ndarray)
        if values.shape != self.shape:
            raise InputError(
                f"{self.title} == {one_line(other)}: must be one name, or one for each of {len(self)} points; "
                f"for any of several write .isin({one_line(other)})"
            )
        distinct, place = np.unique(values, return_inverse=True)
        return np.array([self._code(str(name)) for name in distinct])[place]

    def _code(self, choice: Any) -> int:
        """Number of a name, beyond all numbers if nothing has it; numbers stay."""
        if isinstance(choice, numbers.Integral):
            return min(max(int(choice), -UNKNOWN), UNKNOWN)
        if not isinstance(choice, str):
            raise InputError(f"{self.title}: must be a name, a whole number or a list of them, got {one_line(choice)}")
        if choice in self.names:
            return self.names.index(choice)
        warn(UnknownNameWarning(f"{self.title}: nothing is named '{choice}' here; {hint(choice, self.names)}"))
        return UNKNOWN

    def __reduce__(self) -> Any:
        reduced: Any = super().__reduce__()
        return *reduced[:2], (reduced[2], self.names, self.title)

    def __setstate__(self, state: Any) -> None:
        array_state, self.names, self.title = state
        super().__setstate__(array_state)


UNKNOWN = 2**40
"""Code of a name that is in no table, beyond all that the columns hold."""


def hint(name: str, names: Iterable[str]) -> str:
    """What could have been meant, and the choices."""
    choices = list(names)
    listed = f"the choices are {', '.join(choices)}" if choices else "the cloud has no names for it"
    return f"{did_you_mean(name, choices)} {listed}".strip()
