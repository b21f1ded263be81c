"""Sensor file of a fitted unit: the file of its model with estimates in place, and their sources in `[sources]`.

Numbers without an estimate keep their values. The lens changes along its own null direction: the product of aperture
and field of view, which sets the background, stays the same.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ... import catalog
from ...errors import InputError, OptionError
from ...files.overrides import assignments, with_overrides
from ...files.toml_edit import KeyPath, get_value, put_values, remove_values, rounded
from ...recordings.units.unit_file import read_unit, unit_text
from ...sensor.sensor_file import sensor_from_tables
from ...sensor.sensor_model import Sensor
from ..twin.tuning import BRIGHTEST_KLUX
from .estimates import Estimate
from .near_field import LENSES
from .products import near_field_m, pulse_fwhm_s, scatter_c_mm, white_m2
from .row_gains import RowGains
from .tuning import CONTRADICTION, INFINITE, MOST_MISFIT, MOST_RELATIVE_SIGMA

FILE_KEYS = {
    "white_m2": "laser.peak_power_w",
    "near_field_m": "the lens",
    "scatter_c": "laser.pulse_fwhm_ns",
    "threshold_slope": "histogram.threshold_slope",
    "threshold_pedestal": "histogram.threshold_pedestal",
    "threshold_spread": "histogram.threshold_spread",
    "threshold_least": "histogram.threshold_least",
    "lone_factor": "histogram.lone_factor",
    "column_photons": "histogram.column_photons",
}
"""Estimate -> key of the file that it sets."""

RARE = {
    "threshold_least": "not known: too few returns are that weak, or a threshold without an end fits as well",
    "lone_factor": "not known: too few pulses without neighbours are strong enough",
    "column_photons": "not known: too few smooth surfaces of weak and of strong returns",
}
"""Estimate that many recordings lack -> why it is missing."""

TWO_LENS_KEYS = (
    "optics.overlap.transmitter_offset_mm",
    "optics.overlap.parallax_free_at_m",
    "optics.overlap.focus_at_m",
    "optics.overlap.scattered_share",
    "laser.exit_diameter_mm",
    "laser.divergence_elevation_mrad",
)
"""Keys of a near field other than that of one lens behind a point."""

Changes = dict[str, tuple[float | bool | list[float], str]]
"""Key of the file -> its new value and the source of that."""

WHOLE = ("detector.spads",)
"""Keys whose values are integers."""

STRETCHED = {
    "optics.aperture_radius_mm": 0.5,
    "optics.focal_length_mm": 0.5,
    "laser.peak_power_w": -1.0,
    "optics.overlap.transmitter_offset_mm": 0.5,
    "optics.overlap.parallax_free_at_m": 1.0,
    "optics.overlap.focus_at_m": 1.0,
    "laser.exit_diameter_mm": 0.5,
    "laser.divergence_mrad": -0.5,
    "laser.divergence_elevation_mrad": -0.5,
}
"""Source: the lidar equation; key -> exponent of the factor that stretches the near field over the range. Transverse
lengths grow by its square root, angles shrink by it. Aperture times field of view stays, and so does the background;
the power makes up for the aperture."""

SCALED_KEYS = (
    "laser.peak_power_w",
    "laser.pulse_fwhm_ns",
    "optics.sun_irradiance_w_m2",
    "detector.spads",
    "detector.pde",
    "detector.dark_count_rate_hz",
    "histogram.threshold_slope",
    "histogram.threshold_pedestal",
    "histogram.threshold_spread",
)
POWERS: Mapping[str, Mapping[str, float]] = {
    **{key: {key: 1.0} for key in SCALED_KEYS},
    "spot_over_field": {"laser.divergence_mrad": 1.0, "laser.divergence_elevation_mrad": 1.0},
    "near_field_m": STRETCHED,
}
"""Factor that was fitted -> key of the file -> exponent of the factor in that key's own factor."""


def base_text(sensor: str, metadata: Path | None, *, sensor_index: int = 0) -> str:
    """Text of the sensor file to start from, of the catalogue or a path; with metadata it has the beams of this unit.

    Args:
        sensor_index: which sensor of an OSF the metadata are of

    Raises:
        InputError: if the file cannot be read
    """
    path = catalog.sensor_path(sensor)
    if metadata is not None and not sensor.endswith(".toml"):
        return unit_text(read_unit(metadata, sensor_index=sensor_index), metadata, like=sensor)[0]
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise OptionError("{sensor} {0}: cannot be read: {1}", sensor, reason) from None


def parse_sensor(text: str, where: str, changes: Mapping[str, tuple[Any, str]] = {}) -> Sensor:
    """Parse the text of a sensor file, with values as `put_changes` writes them, which takes ten times as long.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{where}: no TOML: {error}") from None
    values = assignments({key: rounded(value) for key, (value, _) in changes.items()})
    return sensor_from_tables(with_overrides(tables, values), where=where)


def fitted_text(
    text: str,
    estimates: Mapping[str, Estimate],
    recording: str,
    where: str,
    *,
    rows: RowGains | None = None,
    at_rest: Mapping[str, Estimate] = {},
    held: Mapping[str, str] = {},
) -> tuple[str, tuple[str, ...]]:
    """Put the estimates into a sensor file; returns the text, and notes on numbers that stay, with the reason.

    The near field comes first and the power last, since the power depends on all other numbers.

    Args:
        rows: gains of the rows
        at_rest: estimates of frames at rest, by key of the file
        held: estimates that are not to be written -> the reason
    """
    accepted = {key: estimate for key, estimate in _certain(at_rest).items() if key not in held}
    notes = tuple(f"{key} is left as it was: {held.get(key, at_rest[key])}" for key in at_rest if key not in accepted)
    changes = {
        key: (estimate.value, f"fitted: {estimate}, pixels at rest, {recording}") for key, estimate in accepted.items()
    }
    text, change_notes = _with_changes(text, at_rest_changes(changes), where)
    if parse_sensor(text, where).histogram is None:
        rest = (
            "what frames at rest do not tell is left as it was: other laws are fitted to sensors with [histogram] only"
        )
        return text, (*notes, *change_notes, rest)
    text, more = _with_laws(text, estimates, recording, where, rows, held)
    return text, (*notes, *change_notes, *more)


def _with_laws(
    text: str,
    estimates: Mapping[str, Estimate],
    recording: str,
    where: str,
    rows: RowGains | None,
    held: Mapping[str, str],
) -> tuple[str, tuple[str, ...]]:
    """Put the laws of single frames into the file of a sensor that counts photons; as `fitted_text`."""
    sensor = parse_sensor(text, where)
    assert sensor.histogram is not None
    if "scatter_c" in estimates and (misfit := estimates["scatter_c"].misfit) > MOST_MISFIT:
        reason = f"{estimates['scatter_c']}, by a law that misses its bins by {misfit:.2g} times their sigmas"
        held = {"scatter_c": reason, **held}
    accepted = _certain({key: estimate for key, estimate in estimates.items() if key not in held})
    scatter_mm, scatter_note = scatter_c_mm(sensor), "; scatter of the range"
    if "scatter_c" in estimates and not {"scatter_c"} & (accepted.keys() | held.keys()):
        blended = _blended(estimates["scatter_c"], scatter_mm)
        if blended is not None:
            accepted["scatter_c"] = blended
            scatter_note += f"; blended with the {scatter_mm:.4g} mm of the file to {blended}"
    # Errors of slope and pedestal make up for each other, so that the threshold is known better than the pedestal.
    accepted.pop("threshold_pedestal", None)
    if "threshold_slope" in accepted:
        accepted["threshold_pedestal"] = estimates["threshold_pedestal"]
    subjects = FILE_KEYS | ({"white_m2": "what a white target returns"} if "white_m2" in held else {})
    reasons = RARE | {key: str(estimate) for key, estimate in estimates.items()} | dict(held)
    notes = tuple(
        f"{subject} is left as it was: {key} is {reasons.get(key, 'not recorded')}"
        for key, subject in subjects.items()
        if key not in accepted
        and not (key == "threshold_spread" and key not in estimates)
        # Sensors whose columns share as much of weak returns lack the key.
        and (key != "column_photons" or sensor.histogram.column_photons is not None)
    )

    def source_of(key: str, also: str) -> str:
        return f"fitted: {estimates[key]}, {recording}{also}"

    changes: Changes = {}
    if "near_field_m" in accepted:
        factor = accepted["near_field_m"].value / near_field_m(sensor)
        is_one_lens = "spot_over_field" in estimates  # else the fitted law was the file's own curve, stretched
        how = f"the near field of the file's own optics, at {factor:.4g} times the range"
        source = source_of("near_field_m", f"; {'R0 = r_A f / r_PD, with r_A r_PD / f held' if is_one_lens else how}")
        keys = ("optics.aperture_radius_mm", "optics.focal_length_mm") if is_one_lens else STRETCHED
        stretched = scaled_values(text, {key: factor ** STRETCHED[key] for key in keys})
        changes |= {key: (value, source) for key, value in stretched.items()}
    if "near_field_m" in accepted and LENSES[0] in estimates:
        lens_changes, text = _lens_changes(text, estimates, parse_sensor(put_changes(text, changes), where), source)
        changes = {key: change for key, change in changes.items() if key not in TWO_LENS_KEYS[:4]} | lens_changes
    if "near_field_m" in accepted and is_one_lens:
        # The fitted law was that of one lens, focused at infinity, on the laser's axis.
        if "spot_over_field" in accepted or get_key(text, "laser.divergence_mrad") is not None:
            # Full divergence [mrad]: twice the half angle behind the new lens.
            field = float(sensor.detector.radius_m / sensor.optics.focal_length_m) / math.sqrt(factor)
            changes["laser.divergence_mrad"] = (
                2e3 * estimates["spot_over_field"].value * field,
                source_of(
                    "spot_over_field", "; the spot's radius over the field's, from how sharp the near field ends"
                ),
            )
        if any(get_key(text, f"optics.overlap.{key}") for key in ("transmitter_offset_mm", "focus_at_m")):
            notes += ("optics.overlap: the file's two lenses or focus are replaced by one lens, whose law was fitted",)
        if get_key(text, "laser.exit_diameter_mm") is not None:
            notes += ("laser.exit_diameter_mm is left out: the fitted spot starts as a point",)
        text = remove_keys(text, *TWO_LENS_KEYS)
        table: dict[KeyPath, Any] = {} if get_key(text, "optics.overlap") is not None else {("optics", "overlap"): {}}
        text = put_values(text, {**table, ("sources", "optics.overlap"): source})
    if "scatter_c" in accepted:
        fwhm_s = pulse_fwhm_s(sensor, accepted["scatter_c"].value)
        if fwhm_s is not None:
            changes["laser.pulse_fwhm_ns"] = (1e9 * fwhm_s, source_of("scatter_c", scatter_note))
    for key, file_key in FILE_KEYS.items():
        if key in accepted and file_key == f"histogram.{key}":
            # The recording has the counts of all shots, the file those of one.
            scale = 1.0 / float(sensor.histogram.shots) if key == "threshold_pedestal" else 1.0
            also = "scatter of weak returns" if key == "column_photons" else "SIGNAL and NEAR_IR of kept and lost"
            changes[file_key] = accepted[key].value * scale, source_of(key, f"; {also}")
    if "threshold_slope" in accepted:
        text = remove_keys(text, "histogram.threshold_floor")
    if rows is not None:
        row_changes, row_notes = _row_changes(text, rows, recording)
        changes |= row_changes
        notes += row_notes
    text, change_notes = _with_changes(text, changes, where)
    unscaled = parse_sensor(text, where)
    if "white_m2" in accepted:
        power_w = float(unscaled.laser.peak_power_w) * accepted["white_m2"].value / white_m2(unscaled)
        source = source_of("white_m2", "; power, lens, efficiency, PDE and shots are known as one product")
        text = put_changes(text, {"laser.peak_power_w": (power_w, source)})
    elif "white_m2" in held and "laser.pulse_fwhm_ns" in changes:
        power_w = float(unscaled.laser.peak_power_w) * white_m2(sensor) / white_m2(unscaled)
        source = f"photons as before, with the pulse of {recording}"
        text = put_changes(text, {"laser.peak_power_w": (power_w, source)})
    return text, (*notes, *change_notes)


def _lens_changes(text: str, estimates: Mapping[str, Estimate], stretched: Sensor, source: str) -> tuple[Changes, str]:
    """Free lenses as changes, and the text without keys that are now at infinity.

    Args:
        stretched: sensor with the new aperture and field of view
        source: source of the stretched near field
    """
    offset, crossing, focus, scattered = (estimates[key].value for key in LENSES)
    r0_m, aperture_mm = near_field_m(stretched), 1e3 * float(stretched.optics.aperture_radius_m)
    direction = np.array(get_key(text, TWO_LENS_KEYS[0]) or (0.0, 0.0), float)
    length = float(np.hypot(*direction))
    direction = direction / length if length > 0.0 else np.array([0.0, 1.0])
    values: dict[str, float | list[float]] = {TWO_LENS_KEYS[0]: (offset * aperture_mm * direction).tolist()}
    for key, inverse in zip(TWO_LENS_KEYS[1:3], (crossing, focus), strict=True):
        if inverse > INFINITE:
            values[key] = r0_m / inverse
        else:
            text = remove_keys(text, key)
    values[TWO_LENS_KEYS[3]] = scattered
    changes: Changes = {}
    for key, name in zip(TWO_LENS_KEYS[:4], LENSES, strict=True):
        if key in values:
            changes[key] = (values[key], f"{source}; with all lenses free, {name} {estimates[name]}")
    return changes, text


def with_background_gain(text: str, klux: float, recording: str) -> tuple[str, str]:
    """Let the sensor count so much more background that the recording's light is what the sun gives at most.

    Args:
        klux: illuminance that explains the recorded NEAR_IR with this file

    Returns:
        the text, and a note; both say that it is a bound, since the recording's own light is not known. Unchanged if
        the sun gives as much, or without the key.
    """
    key = "optics.sun_irradiance_w_m2"
    irradiance = get_key(text, key)
    if klux <= BRIGHTEST_KLUX:
        return text, ""
    reason = f"NEAR_IR is that of {klux:.3g} klux with the background of the file, and the sun gives {BRIGHTEST_KLUX:g}"
    if irradiance is None:
        return text, f"{key} is not in the file: {reason}"
    gain = klux / BRIGHTEST_KLUX
    source = f"fitted: {reason} at most; {gain:.3g} times what it was, or more, {recording}"
    return put_changes(text, {key: (irradiance * gain, source)}), f"{key} is raised {gain:.3g} times: {reason} at most"


def _with_changes(text: str, changes: Changes, where: str) -> tuple[str, tuple[str, ...]]:
    """Put the changes in; returns the text, and notes on values that stay since the others do not allow them."""
    full_text = put_changes(text, changes)
    try:
        parse_sensor(full_text, where)
    except InputError:  # put in those that are allowed, one by one
        notes = []
        for key, change in changes.items():
            changed = put_changes(text, {key: change})
            try:
                parse_sensor(changed, where)
            except InputError as error:
                notes.append(f"{key} is left as it was: {error}")
            else:
                text = changed
        return text, tuple(notes)
    return full_text, ()


def _row_changes(text: str, rows: RowGains, recording: str) -> tuple[Changes, tuple[str, ...]]:
    """Gains of the rows as changes, and a note if they are not written."""
    beams = get_key(text, "scanner.elevation_deg") or ()
    if len(beams) != len(rows.gain):
        return {}, (f"row gains are not written: of {len(rows.gain)} rows, and the file has {len(beams)} beams",)
    follows = "" if rows.follows is None else "SIGNAL goes with their power of {:.2f} +/- {:.2f}".format(*rows.follows)
    if rows.key is None:
        reason = follows or "SIGNAL of some rows is too weak"
        return {}, (f"row gains are not written: whether SIGNAL has those of NEAR_IR is undetermined ({reason})",)
    source = f"fitted: NEAR_IR of neighbouring rows, each +/- {rows.sigma[0]:.1%}, {recording}; {follows}"
    return {f"scanner.{rows.key}": (rows.gain.tolist(), source)}, ()


def _blended(estimate: Estimate, value: float) -> Estimate | None:
    """Mean of an estimate and the file's value, weighted by their variances; None if they do not contradict."""
    if not abs(estimate.value - value) > CONTRADICTION * estimate.sigma:
        return None
    weights = np.array([estimate.sigma, MOST_RELATIVE_SIGMA * value]) ** -2.0
    mean, sigma = np.average([estimate.value, value], weights=weights), float(weights.sum() ** -0.5)
    return replace(estimate, value=float(mean), fisher=sigma, bootstrap=sigma, misfit=1.0)


def _certain(estimates: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """Estimates that are certain enough for the file: of a law that fails, too, since they come nearest to the data."""
    return {
        key: estimate for key, estimate in estimates.items() if estimate.scatter < MOST_RELATIVE_SIGMA * estimate.value
    }


def scaled_text(
    text: str, estimates: Mapping[str, Estimate], recording: str, where: str
) -> tuple[str, tuple[str, ...]]:
    """Scale the numbers of a sensor file by their estimates; returns the text, and notes on numbers that stay.

    Args:
        estimates: factors of the file's values; those with a relative sigma above `MOST_RELATIVE_SIGMA` are not written
    """
    accepted = _certain(estimates)
    notes = [
        f"{key} is left as it was: {estimate}"
        for key, estimate in estimates.items()
        if key not in accepted and key != "scatter_floor"
    ]
    factors: dict[str, float] = {}
    source: dict[str, str] = {}
    for name, powers in POWERS.items():
        for key, power in powers.items() if name in accepted else ():
            factors[key] = factors.get(key, 1.0) * accepted[name].value ** power
            source.setdefault(key, f"fitted with a scene: {name} {accepted[name]} what it was, {recording}")
    values = scaled_values(text, factors)
    notes += [
        f"{key} is left as it was: it is not a number of the file"
        for key in factors
        if key in accepted and key not in values
    ]
    text, change_notes = _with_changes(text, {key: (value, source[key]) for key, value in values.items()}, where)
    return text, (*notes, *change_notes)


def scaled_values(text: str, factors: Mapping[str, float]) -> dict[str, float | list[float]]:
    """Key -> value of the file times its factor; keys that the file does not have are left out."""
    values: dict[str, float | list[float]] = {}
    for key, factor in factors.items():
        value = get_key(text, key)
        if isinstance(value, list):
            values[key] = [float(number) * factor for number in value]
        elif value is not None:
            values[key] = round(value * factor) if key in WHOLE else float(value) * factor
    return values


def remove_keys(text: str, *keys: str) -> str:
    """Remove keys from a sensor file, and their sources."""
    return remove_values(text, [path for key in keys for path in (tuple(key.split(".")), ("sources", key))])


def at_rest_changes(values: Mapping[str, tuple[float, str]]) -> Changes:
    """Numbers by frames at rest, and their sources, as changes; a beam whose width slopes tell lengthens echoes."""
    changes: Changes = dict(values)
    if "laser.divergence_mrad" in values:
        changes["laser.slope_broadening"] = True, values["laser.divergence_mrad"][1]
    return changes


def put_changes(text: str, changes: Changes) -> str:
    """Put values and their sources into a sensor file."""
    values = {tuple(key.split(".")): value for key, (value, _) in changes.items()}
    return put_values(text, {**values, **{("sources", key): source for key, (_, source) in changes.items()}})


def get_key(text: str, key: str) -> Any:
    """Value of a key of a sensor file; None without it."""
    return get_value(text, tuple(key.split(".")))
