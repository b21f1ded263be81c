"""The sensor file with the numbers that were found with a scene, each a factor of the value that the file had."""

from __future__ import annotations

from collections.abc import Mapping

from ....errors import InputError
from ..estimates import Estimate
from ..unit import STRETCHED, MOST_RELATIVE_SIGMA, scaled_values, put_key, parse_sensor

SCALED_KEYS = (
    "laser.peak_power_w",
    "laser.pulse_fwhm_ns",
    "optics.sun_irradiance_w_m2",
    "detector.spads",
    "detector.pde",
    "detector.dark_count_rate_hz",
    "histogram.threshold_floor",
    "histogram.threshold_slope",
    "histogram.threshold_spread",
)
"""Keys that are multiplied by what was found."""


def scaled_text(
    text: str, estimates: Mapping[str, Estimate], recording: str, where: str
) -> tuple[str, tuple[str, ...]]:
    """The file with what is known to better than `WRITTEN`, and what was left as it was."""
    accepted = {key: estimate for key, estimate in estimates.items() if estimate.is_known and estimate.sigma < MOST_RELATIVE_SIGMA * estimate.value}
    notes = [
        f"{key} is left as it was: {estimate.value:.3g} +/- {estimate.sigma:.2g} times"
        for key, estimate in estimates.items()
        if key not in accepted and key != "scatter_floor"
    ]
    factors: dict[str, float] = {key: accepted[key].value for key in SCALED_KEYS if key in accepted}
    source = {key: _scaled_source(key, accepted[key], recording) for key in SCALED_KEYS if key in accepted}
    near_field = accepted.get("near_field_m")
    if near_field is not None:
        for key, power in STRETCHED.items():
            factors[key] = factors.get(key, 1.0) * near_field.value**power
            source.setdefault(key, _scaled_source("near_field_m", near_field, recording))
    if "spot_over_field" in accepted:
        spot = accepted["spot_over_field"]
        for key in ("laser.divergence_mrad", "laser.divergence_elevation_mrad"):
            factors[key] = factors.get(key, 1.0) * spot.value
            source[key] = _scaled_source("spot_over_field", spot, recording)
    values = scaled_values(text, factors)
    notes += [
        f"{key} is left as it was: it is not a number of the file"
        for key in factors
        if key in accepted and key not in values
    ]
    full_text = text
    for key, value in values.items():
        full_text = put_key(full_text, key, value, source[key])
    try:
        parse_sensor(full_text, where)
    except InputError:  # one of them does not go with the others: those that do are put in
        for key, value in values.items():
            changed = put_key(text, key, value, source[key])
            try:
                parse_sensor(changed, where)
            except InputError as error:
                notes.append(f"{key} is left as it was: {error}")
            else:
                text = changed
        return text, tuple(notes)
    return full_text, tuple(notes)


def _scaled_source(key: str, estimate: Estimate, recording: str) -> str:
    return f"fitted with a scene: {key} {estimate.value:.4g} +/- {estimate.sigma:.2g} times what it was, {recording}"
