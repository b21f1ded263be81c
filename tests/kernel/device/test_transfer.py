"""Numbers on the device: all but those that choose code."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from helpers import launches

from lidarscene.kernel.device import transfer
from lidarscene.maths.arrays import is_drjit
from lidarscene.maths.units import STATIC


@dataclass(frozen=True, kw_only=True)
class Newcomer:
    """A part of a sensor whose field chooses code, under a name that no other part has."""

    gain: float = 2.0
    shots: int = 3
    rounds: int = field(default=4, metadata=STATIC)


def test_a_static_field_stays_a_number_of_python(mi: Any) -> None:
    on_device = transfer.opaque((Newcomer(),))[0]
    assert on_device.rounds == 4
    assert not is_drjit(on_device.rounds)
    assert is_drjit(on_device.gain)
    assert is_drjit(on_device.shots)


def test_numbers_of_numpy_are_opaque_too(mi: Any) -> None:
    """Rationale: each was a literal, and so a kernel of its own; one of half precision ended the process."""
    on_device = transfer.opaque(Newcomer(gain=np.float16(0.5), shots=np.int8(7)))
    assert (type(on_device.gain), type(on_device.shots)) == (mi.Float, mi.Int32)
    assert (on_device.gain[0], on_device.shots[0]) == (0.5, 7)


def test_what_is_fetched_is_computed_together(mi: Any) -> None:
    """One kernel for all arrays of a description: each for itself would compute what they share once more."""
    shared = transfer.counter(1, 5) * 3
    description = Newcomer(gain=shared + 1, shots=shared * 2)
    with launches.launched() as kernels:
        fetched = transfer.fetch((description,))[0]
    assert len(kernels) == 1
    np.testing.assert_array_equal([fetched.gain, fetched.shots], [[4, 7, 10, 13, 16], [6, 12, 18, 24, 30]])
    assert fetched.rounds == 4
