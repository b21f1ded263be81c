"""Functions that numpy and Dr.Jit share and that steer what is computed at all."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from helpers.child import assert_ended

from lidarscene.maths.arrays import map_arrays, xp
from lidarscene.physics.electronics import counting

pytestmark = pytest.mark.usefixtures("mi")


def test_where_any_is_a_choice():
    """Whether a whole packet of lanes, a single one of it or none needs the dear one."""
    import mitsuba as mi

    x = np.arange(64, dtype=np.float32)
    for chosen in (x < -1.0, x == 17.0, (x >= 16.0) & (x < 24.0), x >= 0.0):
        expected = np.where(chosen, np.sqrt(x) + 1.0, -x), np.where(chosen, 2.0 * x, 7.0)
        for array, where in ((x, chosen), (mi.Float(x), mi.Bool(chosen))):
            ops = xp(array)
            picked = ops.where_any(
                where, lambda a=array, o=ops: (o.sqrt(a) + 1.0, 2.0 * a), (-array, 7.0 + 0.0 * array)
            )
            for part, expected_part in zip(picked, expected, strict=True):
                np.testing.assert_allclose(np.asarray(part), expected_part, rtol=1e-6)


def test_where_any_leaves_what_it_chooses_from_as_it_was():
    """Dr.Jit's `if_stmt` puts its results into the arrays that a branch returns: the caller still needs these."""
    import mitsuba as mi

    x = np.arange(8, dtype=np.float32)
    if_true, if_false, where = mi.Float(10.0 * x), mi.Float(x), mi.Bool(x > 3.5)
    chosen = xp(if_false).where_any(where, lambda: if_true, if_false)
    np.testing.assert_array_equal(np.asarray(chosen), np.where(x > 3.5, 10.0 * x, x))
    np.testing.assert_array_equal(np.asarray(if_true), 10.0 * x)
    np.testing.assert_array_equal(np.asarray(if_false), x)


def test_poisson_counts_of_mixed_means():
    """Lanes of few counts beside lanes of many, which the loop passes over: the same as of numpy, but where the sum of
    probabilities comes within rounding of the uniform number (1e-6 of it, at some ten steps: 1 in 10,000 lanes).
    """
    import mitsuba as mi

    rng = np.random.default_rng(2)
    count = 20_000
    mean = np.where(rng.random(count) < 0.5, rng.uniform(0.0, 12.0, count), rng.uniform(10.0, 1e5, count))
    drawn = {"mean": mean, "uniform": 1.0 - rng.random(count), "deviate": rng.normal(size=count)}
    single = {name: values.astype(np.float32) for name, values in drawn.items()}
    expected = counting.poisson_count(**{k: v.astype(float) for k, v in single.items()}, narrowing=1.0)
    counts = counting.poisson_count(**{k: mi.Float(v) for k, v in single.items()}, narrowing=1.0).numpy()
    few = mean < 10.0
    assert (counts[few] != expected[few]).sum() <= 6
    assert np.abs(counts - expected).max() <= 1.0


@pytest.mark.parametrize("denominator", [1, 2, 3, 7, 128, 1001, 65_537, 2**20, 2**30 + 1, 2**31 - 1])
def test_whole_numbers_are_divided_exactly(mi, denominator):
    """The numbers lie around each of many multiples, up to the largest pulse number; against integers of Python."""
    largest = 2**31 - 1
    rng = np.random.default_rng(5)
    multiples = denominator * np.append(rng.integers(0, largest // denominator + 1, 300), largest // denominator)
    numbers = np.clip(multiples[:, None] + np.arange(-2, 3), 0, largest).ravel().astype(np.uint32)
    expected = np.array([divmod(int(number), denominator) for number in numbers]).T
    for lanes, divisor in ((mi.UInt32(numbers), mi.Int32(denominator)), (numbers, denominator)):
        parts = xp(lanes).divmod(xp(lanes).int32(lanes), divisor)
        assert (np.array([np.asarray(part) for part in parts]) == expected).all()


ROOMS = """
import numpy as np
from lidarscene.kernel.device import backend, transfer
mi = backend.mitsuba()
from lidarscene.maths.arrays import xp

def filled(size):
    # The size is opaque in all but the allocation: nothing else tells the kernels of two rooms apart.
    lanes = transfer.counter(0, 64)
    ops, last = xp(lanes), transfer.opaque(size - 1)
    begin = ops.full(lanes, 0), ops.room(lanes, size)
    step = lambda now: (now[0] + 1, ops.put(now[1], now[0], ops.float32(now[0] * 64) + ops.float32(lanes)))
    _, room = ops.loop(begin, lambda now: now[0] <= last, step)
    return ops.get(room, last + ops.full(lanes, 0)).numpy()

for size in {sizes}:
    expected = 64 * (size - 1) + np.arange(64)
    assert (filled(size) == expected).all(), size
print("all")
"""


def test_each_room_has_its_own_size(mi: Any, run_python: Any, tmp_path: Any) -> None:
    """Not that of the room for which a kernel was compiled first: writing 1.9 MB beyond that ends the process.

    The largest number, 64 * 30,000, is exact in single precision.
    """
    process = run_python(ROOMS.format(sizes=(8, 9, 30_000, 8)), HOME=str(tmp_path), LIDARSCENE_VARIANT=mi.variant())
    assert_ended(process, stdout="all\n", stderr=None)


@dataclass(frozen=True)
class Columns:
    """Arrays, and other fields beside them."""

    name: str
    range_m: np.ndarray
    signal: np.ndarray | None = None


def test_arrays_of_dataclasses_are_selected_and_joined() -> None:
    """What one of them lacks the whole lacks; the other fields are those of the first."""
    first, second = Columns("a", np.arange(3.0), np.ones(3)), Columns("b", np.arange(2.0))
    selected = map_arrays(lambda values: values[1:], first)
    assert (selected.name, selected.range_m.tolist(), np.size(selected.signal)) == ("a", [1.0, 2.0], 2)
    joined = map_arrays(lambda *values: np.concatenate(values), first, second)
    assert (joined.name, joined.range_m.tolist(), joined.signal) == ("a", [0.0, 1.0, 2.0, 0.0, 1.0], None)
