"""Types: the state that loops carry, and the numbers of stages."""

import dataclasses

import numpy as np
import pytest

from lidarscene.maths import arrays, random
from lidarscene.maths.arrays import NUMPY


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pair:
    """Two numbers of a state, one of which may be missing."""

    value: object
    optional: object = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Nested:
    """A state with states in it."""

    count: object
    pairs: tuple[Pair, ...]


def test_states_are_taken_apart_and_put_together() -> None:
    state = Nested(count=1, pairs=(Pair(value=2), Pair(value=3, optional=4)))
    assert list(arrays.flatten((state, (5,)))) == [1, 2, 3, 4, 5]
    assert arrays.rebuild((state, (5,)), iter([6, 7, 8, 9, 10])) == (
        Nested(count=6, pairs=(Pair(value=7), Pair(value=8, optional=9))),
        (10,),
    )


def halve(make, ops) -> Nested:
    """Numbers halved, each lane until it is below one, with the halvings counted."""
    values = make(np.array([0.5, 5.0, 40.0], dtype=np.float32))
    start = Nested(count=ops.full(values, 0), pairs=(Pair(value=values), Pair(value=values, optional=2.0 * values)))

    def step(state: Nested) -> Nested:
        first, second = state.pairs
        pairs = (Pair(value=0.5 * first.value), Pair(value=second.value, optional=0.5 * second.optional))
        return Nested(count=state.count + 1, pairs=pairs)

    return ops.loop(start, lambda state: state.pairs[0].value >= 1.0, step)


@pytest.mark.parametrize("where", ["numpy", "device"])
def test_a_loop_carries_dataclasses(where: str, request: pytest.FixtureRequest) -> None:
    if where == "device":
        mi = request.getfixturevalue("mi")
        final = halve(mi.Float, arrays.xp(mi.Float(0.0)))
    else:
        final = halve(np.asarray, NUMPY)
    first, second = final.pairs
    assert np.array(final.count).tolist() == [0, 3, 6]
    assert np.array(first.value).tolist() == [0.5, 0.625, 0.625]
    assert np.array(second.value).tolist() == [0.5, 5.0, 40.0]
    assert np.array(second.optional).tolist() == [1.0, 1.25, 1.25]
    assert first.optional is None


@pytest.mark.parametrize("where", ["numpy", "device"])
def test_where_any_takes_a_state(where: str, request: pytest.FixtureRequest) -> None:
    make = np.asarray if where == "numpy" else request.getfixturevalue("mi").Float
    value = make(np.array([1.0, 2.0, 3.0], dtype=np.float32))
    ops = arrays.xp(value)
    chosen = ops.where_any(value > 2.5, lambda: Pair(value=10.0 * value), Pair(value=value))
    assert np.array(chosen.value).tolist() == [1.0, 2.0, 30.0]
    assert chosen.optional is None


def test_both_array_types_have_every_function(mi) -> None:
    """`xp` promises `Ops`, which no type checker compares with functions that Dr.Jit brings."""
    promised = [name for name in vars(arrays.Ops) if not name.startswith("_")]
    assert len(promised) > 20
    for ops in (NUMPY, arrays.xp(mi.Float(0.0))):
        assert [name for name in promised if not callable(getattr(ops, name, None))] == []


def test_numbers_of_stages_are_never_given_out_again() -> None:
    """Old clouds can be made again because each stage keeps its number; a new stage takes one that none has had."""
    numbers = " ".join(f"{stage.name} {stage.value}" for stage in random.Stage)
    assert numbers == (
        "EDGE_NOISE 1 FALSE_ALARM 2 TDC_JITTER 3 POINTING 4 TRAILING_EDGE 5 SAMPLES 6 INTERFERENCE 8 AMBIENT 9 "
        "PARTICLES 11 GAPS 12 HISTOGRAM 16 THRESHOLD 17 FLUCTUATION 25 COLUMN_NOISE 26 CHATTER 27 "
        "STRONG_CHANNEL 28"
    )


def test_a_stage_is_a_plain_number_to_the_generator(mi) -> None:
    pulse = np.arange(5, dtype=np.uint32)
    for number in (pulse, mi.UInt32(pulse)):
        by_name = random.words(seed=3, stage=random.Stage.GAPS, pulse=number)
        plain = random.words(seed=3, stage=12, pulse=number)
        for a, b in zip(by_name, plain, strict=True):
            assert np.array(a).dtype == np.uint32
            np.testing.assert_array_equal(np.array(a), np.array(b))
