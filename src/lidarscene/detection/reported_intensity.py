"""Reported intensity: convert amplitude and range to the number that the sensor's maker would report.

Makers do not report the amplitude itself but a calibrated number, often a reflectivity from 0 to 255. A sensor's optics
and background are known, so the power follows from the amplitude. The air and the angle of the surface are not known,
so neither is corrected (docs/theory_receivers.md 3).
"""

from __future__ import annotations

from ..light.echoes import Echoes, EchoTrain
from ..maths.arrays import Lanes, xp
from ..physics.electronics import intensity as formulas
from .shots import Shots

_LEAST_OVERLAP = 1e-3
"""Choice: least share of the spot that the correction assumes: below it, it would amplify noise, so nearer echoes read
dark."""


def reported_intensity(
    shots: Shots, echoes: Echoes | EchoTrain, *, amplitude: Lanes, width_s: Lanes | None, range_m: Lanes
) -> Lanes:
    """Reported intensity, (n,): the amplitude (raw), watts (range_corrected) or 0 to 255 (reflectivity), theory (T46).

    Args:
        amplitude: (n,) in signal units
        width_s: (n,) time over the threshold, which gives the power of a saturated pulse; None: not measured
        range_m: (n,) reported range
    """
    sensor = shots.sensor
    scale = sensor.intensity
    if scale is None:
        return amplitude
    power = shots.point.response.inferred_power_w(
        amplitude, width_s=width_s, threshold=shots.threshold, pulse_fwhm_s=sensor.received_fwhm_s
    )
    if scale.measures == "energy" and echoes.broadening is not None:
        power = power * echoes.broadening
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
        exponent=scale.exponent,
        retro=scale.retro,
        retro_reflectivity=scale.retro_reflectivity,
        coarse_above=scale.coarse_above,
        coarse_step=scale.coarse_step,
    )
