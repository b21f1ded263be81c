"""Withholding: returns that a sensor leaves out, since light of its other channels may have caused them.

A sensor knows what its other channels saw. A stop that is withheld is lost for the other returns of its pulse.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..light.stray_light import ChannelLight, Crosstalk, Volley
from ..maths.arrays import Array, Lanes, Mask, xp
from ..sensor.sensor_model import Sensor
from .report import Detection, without_returns


@dataclass(frozen=True, slots=True, kw_only=True)
class _Glare:
    """Search of a volley for channels that glare; fields but for the number have an entry (n,) for each stop.

    Attributes:
        number: next pulse of the volley
        beside: whether the stop lies beside the range of one of them
    """

    number: Lanes
    beside: tuple[Mask, ...]


def withhold_beside_glare(
    detection: Detection, light: ChannelLight, crosstalk: Crosstalk, sensor: Sensor, *, pulse: Array
) -> Detection:
    """Leave out the returns at the range of a glaring echo of another channel of their volley, theory (T200).

    Args:
        light: of the pulses, computed before
        pulse: (n,) uint32 pulse numbers of whole scan lines in order of time
    """
    stray, glare_w, volleys = sensor.optics.stray, crosstalk.glare_w, crosstalk.volleys
    if stray is None or stray.glare_photons is None or glare_w is None:
        return detection
    glare_photons, reach_m = stray.glare_photons, stray.glare_reach_m
    ops, volley = xp(pulse, light.power_w), Volley.of_pulses(volleys, light, pulse)

    def search(state: _Glare) -> _Glare:
        source = volley.source(state.number)
        glares = ops.take(light.power_w, source) >= glare_w

        def compare() -> tuple[Mask, ...]:
            is_other, range_m = volley.share(state.number) > 0.0, ops.take(light.range_m, source)
            return tuple(
                is_beside | (glares & is_other & (ops.abs(stop.range_m - range_m) < reach_m))
                for is_beside, stop in zip(state.beside, detection.stops, strict=True)
            )

        return _Glare(number=state.number + 1, beside=ops.where_any(glares, compare, state.beside))

    never = ops.full(light.power_w, False)
    start = _Glare(number=ops.full(light.power_w, 0), beside=(never,) * len(detection.stops))
    beside = ops.loop(start, lambda state: state.number < volleys.size, search).beside
    masks = [
        is_beside & (stop.amplitude < glare_photons) for is_beside, stop in zip(beside, detection.stops, strict=True)
    ]
    return without_returns(detection, masks)
