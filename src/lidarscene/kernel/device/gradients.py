"""Exact derivatives of a formula, by Dr.Jit's automatic differentiation.

The formulas of `physics` run on Dr.Jit arrays as well as on NumPy's. So the derivative of a range or of P_d with
respect to every number of a sensor needs no second formula and no step width, as finite differences would.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ...maths.arrays import Array, Lanes, Numbers
from . import backend
from .gate import exclusive


@exclusive
def gradient(
    formula: Callable[[Mapping[str, Array]], Lanes], values: Mapping[str, float]
) -> tuple[float, dict[str, float]]:
    """Return the formula's value and its derivative with respect to every number, in double precision.

    Reverse mode: one pass, however many numbers there are.

    Args:
        formula: a function of numbers by name (Dr.Jit arrays of one element that record derivatives); returns one
            number
        values: the point at which the derivatives are taken

    Raises:
        BackendError: without a back end
    """
    Float64 = _float64_type()  # first: it is the back end that loads LLVM
    import drjit as dr

    # Opaque: a literal would be folded into the kernel, and each new value would compile a new one.
    attached = {name: dr.opaque(Float64, value) for name, value in values.items()}
    for number in attached.values():
        dr.enable_grad(number)
    result = Float64(formula(attached))
    # A formula may use none of the numbers: then nothing is attached to the result and all derivatives are zero.
    if dr.grad_enabled(result):
        dr.backward(result)
    slopes = {name: float(dr.grad(number)[0]) for name, number in attached.items()}
    return float(result[0]), slopes


@exclusive
def jacobian(
    formula: Callable[[Mapping[str, Array]], Sequence[Lanes]], values: Mapping[str, float]
) -> tuple[list[Numbers], dict[str, list[Numbers]]]:
    """Return the formula's values, (n,) each, and their derivatives with respect to every number.

    Forward mode: one pass for each number, whatever n is.

    Args:
        formula: as of `gradient`; returns arrays of n, or single numbers

    Raises:
        BackendError: without a back end
    """
    Float64 = _float64_type()  # first: it is the back end that loads LLVM
    import drjit as dr

    attached = {name: dr.opaque(Float64, value) for name, value in values.items()}
    for number in attached.values():
        dr.enable_grad(number)
    results = [Float64(result) for result in formula(attached)]
    slopes = {}
    for name, number in attached.items():
        dr.set_grad(number, 1.0)
        dr.enqueue(dr.ADMode.Forward, number)
        dr.traverse(dr.ADMode.Forward, flags=dr.ADFlag.ClearVertices)
        slopes[name] = [dr.grad(result) for result in results]
        dr.clear_grad(results)
        # A kernel for each number: LLVM takes four times as long to compile twice the instructions.
        dr.eval(slopes[name])
    dr.eval(results)
    outputs = [np.array(dr.detach(result)) for result in results]
    shaped = {
        name: [
            np.broadcast_to(np.array(derivative), output.shape)
            for derivative, output in zip(derived, outputs, strict=True)
        ]
        for name, derived in slopes.items()
    }
    return outputs, shaped


def _float64_type() -> Any:
    """Return the back end's type of double precision.

    Raises:
        BackendError: without a back end
    """
    backend.mitsuba()
    if backend.is_cuda():
        from drjit.cuda.ad import Float64
    else:
        from drjit.llvm.ad import Float64
    return Float64
