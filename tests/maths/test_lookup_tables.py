"""Tables on the device: the numbers of NumPy, and the values of a cell in one load."""

from typing import Any

import numpy as np
import pytest
from helpers import launches, rounding

from lidarscene.kernel.device.backend import is_cuda
from lidarscene.maths.arrays import LookupTable


@pytest.mark.parametrize("shape", [(7,), (5, 9), (3, 4, 6)])
def test_a_cell_is_one_load(mi: Any, shape: tuple[int, ...]) -> None:
    """Places lie inside, at the edges and beyond. LLVM's code has no load of values that lie apart, 16 at a time."""
    rng = np.random.default_rng(49)
    table = LookupTable(rng.random(shape, np.float32))
    places = [np.r_[rng.uniform(-0.2, 1.2, 100), 0.0, 1.0].astype(np.float32) for _ in shape]
    on_device = [mi.Float(place) for place in places]
    with launches.launched() as kernels:
        values = table.at(*on_device).numpy()  # type: ignore[union-attr]
    rounding.assert_same(values, np.asarray(table.at(*places)))
    if not is_cuda():
        assert not any("masked.gather" in kernel["ir"].getvalue() for kernel in kernels)


def test_four_neighbours_are_one_load(mi: Any) -> None:
    """Whatever the alignment that NumPy's memory has by chance."""
    rng = np.random.default_rng(49)
    place = rng.random(100, np.float32)
    for rows in (7, 8, 9):
        table = LookupTable(rng.random((rows, 4), np.float32))
        with launches.launched() as kernels:
            values = [part.numpy() for part in table.four_at(mi.Float(place))]  # type: ignore[union-attr]
        rounding.assert_same(np.array(values), np.array(table.four_at(place)))
        if not is_cuda():
            assert not any("masked.gather" in kernel["ir"].getvalue() for kernel in kernels)
