"""Numbers on the device: all but those that choose code."""

from dataclasses import dataclass, field
from typing import Any

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
