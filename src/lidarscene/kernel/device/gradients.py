"""Derivatives by Dr.Jit: a formula and the numbers that go into it in, its value and all partial derivatives out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from . import backend


def gradient(
    formula: Callable[[Mapping[str, Any]], Any], values: Mapping[str, float]
) -> tuple[float, dict[str, float]]:
    """The formula's value and its derivative with respect to every number, in double precision.

    formula   from numbers by name, which come as attached Dr.Jit arrays of one element, to one number
    values    where it is taken

    Reverse mode: one pass, however many numbers there are. Raises `BackendError` without a back end.
    """
    backend.mitsuba()
    if backend.is_cuda():
        from drjit.cuda.ad import Float64
    else:
        from drjit.llvm.ad import Float64
    import drjit as dr

    attached = {name: dr.opaque(Float64, value) for name, value in values.items()}
    for number in attached.values():
        dr.enable_grad(number)
    result = Float64(formula(attached))
    if dr.grad_enabled(result):
        dr.backward(result)
    slopes = {name: float(dr.grad(number)[0]) for name, number in attached.items()}
    return float(result[0]), slopes
