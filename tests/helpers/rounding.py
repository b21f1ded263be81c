"""Rounding of the back ends, for tests that compare kernels with each other or with NumPy.

LLVM rounds each operation as IEEE 754 says, so that the same operations give the same bits. PTX has `mul.ftz`,
`div.approx` and `sqrt.approx`, of up to 2 units in the last place, and contracts products and sums by the kernel.
"""

import numpy as np

from lidarscene.kernel.device import backend

OF_GPU = 8.0
"""Factor of a limit of rounding on a GPU: the largest seen on an H200 was 5.4, of slopes."""

UNITS_OF_GPU = 5e-7
"""Relative difference of numbers that LLVM gives bit for bit: 4 units in the last place."""


def limit(of_cpu: float) -> float:
    """Limit of rounding on the back end in use, from that of a CPU."""
    return of_cpu * OF_GPU if backend.is_cuda() else of_cpu


def assert_same(actual: np.ndarray, expected: np.ndarray) -> None:
    """Same bits on a CPU; on a GPU the same but for rounding."""
    np.testing.assert_allclose(actual, expected, rtol=UNITS_OF_GPU if backend.is_cuda() else 0.0, atol=0.0)
