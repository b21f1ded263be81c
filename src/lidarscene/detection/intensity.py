"""Intensity: an amplitude and its range in, the number that the sensor's maker would report out."""

from __future__ import annotations

from ..light.echoes import Echoes, EchoTrain
from ..maths.arrays import Lanes, xp
from ..physics.electronics import intensity as formulas
from .shots import Shots

_LEAST_OVERLAP = 1e-3
"""Where less of the spot is seen the makers' correction would be noise; echoes from there count as dark."""


def reported(
    shots: Shots,
    echoes: Echoes | EchoTrain,
    *,
    amplitude: Lanes,
    width_s: Lanes | None,
    range_m: Lanes,
) -> Lanes:
    """(n,) the amplitude itself (raw), watts (range_corrected) or 0 to 255 (reflectivity).

    The sensor knows its own optics and what background it stands in, so that the amplitude gives the power (of a
    saturated pulse its width, if that is known); not the air, nor the angle of the surface.
    """
    sensor = shots.sensor
    scale = sensor.intensity
    if scale is None:
        return amplitude
    power = shots.point.inferred_power_w(
        amplitude, width_s=width_s, threshold=shots.threshold, pulse_fwhm_s=sensor.laser.pulse_fwhm_s
    )
    if scale.kind == "range_corrected":
        return formulas.range_corrected_power_w(power_w=power, range_m=range_m, reference_m=scale.reference_m)
    overlap: Lanes = 1.0
    if sensor.optics.overlap is not None:
        overlap = sensor.optics.overlap.share(range_m)
        overlap = xp(overlap).maximum(overlap, _LEAST_OVERLAP)
    return formulas.on_scale(
        reflectivity=formulas.reflectivity_estimate(
            power_w=power, range_m=range_m, white_w_m2=echoes.white_w_m2, overlap=overlap
        ),
        white_value=scale.white_value,
        retro=scale.retro,
        retro_reflectivity=scale.retro_reflectivity,
    )
