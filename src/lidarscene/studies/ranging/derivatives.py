"""Derivatives of a formula: by Dr.Jit if there is a back end, else by central differences.

So sensitivities need no LLVM, and with it they are exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ...errors import BackendError
from ...maths.arrays import Lanes

Formula = Callable[[Mapping[str, Lanes]], Lanes]
"""Numbers by name in, one number out; numpy or Dr.Jit."""

Derivation = Callable[[Formula, Mapping[str, float]], tuple[float, dict[str, float]]]
"""A formula and where to take it in, its value and its derivative with respect to every number out."""


def choose_derivation(method: str) -> tuple[str, Derivation]:
    """The method that "auto" stands for, or the named one, and its function.

    Raises ValueError for an unknown name, BackendError if "drjit" is asked for and not available.
    """
    if method not in ("auto", "drjit", "differences"):
        raise ValueError(f"no method '{method}'; expected auto, drjit or differences")
    if method != "differences":
        from ...kernel.device import backend, gradients

        try:
            backend.mitsuba()
        except BackendError:
            if method == "drjit":
                raise
        else:
            return "drjit", gradients.gradient
    return "differences", differences


def differences(formula: Formula, values: Mapping[str, float]) -> tuple[float, dict[str, float]]:
    """Sixth-order central differences, one parameter after the other."""
    weights = ((1.0, 0.75), (2.0, -0.15), (3.0, 1.0 / 60.0))

    def at(parameter: str, value_at_step: float) -> float:
        return float(formula({**values, parameter: np.float64(value_at_step)}))

    centre = float(formula(values))
    slopes = {}
    for name, value in values.items():
        step = 1e-3 * abs(value)
        if step == 0.0:  # no scale of its own: the step that moves the formula by some thousandths
            step = 1e-15
            while step < 1e-3 and abs(at(name, step) - centre) < 1e-3:
                step *= 10.0
        rise = sum(w * (at(name, value + k * step) - at(name, value - k * step)) for k, w in weights)
        slopes[name] = rise / step
    return centre, slopes
