"""Sensor file of a fitted unit: the file of its model with estimates in place, and their sources in `[sources]`.

Numbers without an estimate keep their values. The lens changes along its own null direction: the product of aperture
and field of view, which sets the background, stays the same.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tomlkit

from ... import catalog
from ...errors import InputError
from ...recordings.units.unit_file import read_unit, write_unit
from ...sensor.sensor_file import sensor_from_tables
from ...sensor.sensor_model import Sensor
from .estimates import Estimate
from .products import near_field_m, pulse_fwhm_s, white_m2
from .row_gains import RowGains

MOST_RELATIVE_SIGMA = 0.3
"""Largest sigma of an estimate over its value; less certain estimates are not written."""

FILE_KEYS = {
    "white_m2": "laser.peak_power_w",
    "near_field_m": "the lens",
    "scatter_c": "laser.pulse_fwhm_ns",
    "threshold_floor": "histogram.threshold_floor",
    "threshold_slope": "histogram.threshold_slope",
    "threshold_spread": "histogram.threshold_spread",
}
"""Estimate -> key of the file that it sets."""

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
"""Key -> exponent of the factor that stretches the near field over the range. Transverse lengths grow by its square
root, angles shrink by it. Aperture times field of view stays, and so does the background; the power makes up for the
aperture."""

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
"""Keys of the file that are multiplied by their estimate."""


def base_text(sensor: str, metadata: Path | None) -> str:
    """Text of the sensor file to start from, of the catalogue or a path; with metadata it has the beams of this unit.

    Raises InputError if the file cannot be read.
    """
    path = Path(sensor) if sensor.endswith(".toml") else catalog.path_of("sensors", sensor)
    if metadata is None or sensor.endswith(".toml"):
        try:
            return path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "not UTF-8 text"
            raise InputError(f"--sensor {sensor}: cannot be read: {reason}") from None
    with TemporaryDirectory(prefix="lidarscene-") as folder:
        written = Path(folder) / "unit.toml"
        write_unit(read_unit(metadata), metadata, written, like=sensor)
        return written.read_text(encoding="utf-8")


def parse_sensor(text: str, where: str) -> Sensor:
    """Parse the text of a sensor file. Raises InputError."""
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{where}: no TOML: {error}") from None
    return sensor_from_tables(tables, where=where)


def fitted_text(
    text: str, estimates: Mapping[str, Estimate], recording: str, where: str, *, rows: RowGains | None = None
) -> tuple[str, tuple[str, ...]]:
    """Put the estimates into a sensor file; returns the text, and notes on numbers that stay, with the reason.

    rows  gains of the rows

    The near field comes first and the power last, since the power depends on all other numbers.
    """
    sensor = parse_sensor(text, where)
    if sensor.histogram is None:
        return text, ("all but the beams is left as it was: only sensors with [histogram] are fitted",)
    accepted = {
        key: estimate for key, estimate in estimates.items() if estimate.sigma < MOST_RELATIVE_SIGMA * estimate.value
    }
    slope = estimates.get("threshold_slope")
    if "threshold_floor" in accepted and slope is not None and slope.value >= 0.0:
        accepted["threshold_slope"] = slope
    else:
        accepted.pop("threshold_floor", None)
    notes = tuple(
        f"{subject} is left as it was: {key} is {_estimate_text(estimates.get(key))}"
        for key, subject in FILE_KEYS.items()
        if key not in accepted and not (key == "threshold_spread" and key not in estimates)
    )

    def source_of(key: str, also: str = "") -> str:
        estimate = estimates[key]
        return f"fitted: {estimate.value:.4g} +/- {estimate.sigma:.2g} {estimate.unit}, {recording}{also}".replace(
            " ,", ","
        )

    if "near_field_m" in accepted and "spot_over_field" not in estimates:
        # The fitted law was the file's own curve, stretched.
        factor = accepted["near_field_m"].value / near_field_m(sensor)
        source = source_of(
            "near_field_m", f"; the near field of the file's own optics, at {factor:.4g} times the range"
        )
        for key, value in scaled_values(text, {key: factor**power for key, power in STRETCHED.items()}).items():
            text = put_key(text, key, value, source)
    elif "near_field_m" in accepted:
        stretch = math.sqrt(accepted["near_field_m"].value / near_field_m(sensor))
        source = source_of("near_field_m", "; R0 = r_A f / r_PD, with r_A r_PD / f held")
        for key, value in (
            ("aperture_radius_mm", 1e3 * float(sensor.optics.aperture_radius_m)),
            ("focal_length_mm", 1e3 * float(sensor.optics.focal_length_m)),
        ):
            text = put_value(text, "optics", key, stretch * value, source)
        # The fitted law was that of one lens, focused at infinity, on the laser's axis.
        if _has_key(text, "optics.overlap", "transmitter_offset_mm", "focus_at_m"):
            notes += ("optics.overlap: the file's two lenses or focus are replaced by one lens, whose law was fitted",)
        lens_keys = ("transmitter_offset_mm", "parallax_free_at_m", "focus_at_m", "scattered_share")
        text = remove_keys(text, "optics.overlap", lens_keys)
        if _has_key(text, "laser", "exit_diameter_mm"):
            notes += ("laser.exit_diameter_mm is left out: the fitted spot starts as a point",)
        text = remove_keys(text, "laser", ("exit_diameter_mm", "divergence_elevation_mrad"))
        text = _with_overlap(text)
        text = put_source(text, "optics.overlap", source)
        spot = estimates.get("spot_over_field")
        if spot is not None and ("spot_over_field" in accepted or _has_key(text, "laser", "divergence_mrad")):
            # Full divergence [mrad]: twice the half angle behind the new lens.
            field = float(sensor.detector.radius_m / sensor.optics.focal_length_m) / stretch
            source = source_of(
                "spot_over_field", "; the spot's radius over the field's, from how sharp the near field ends"
            )
            text = put_value(text, "laser", "divergence_mrad", 2e3 * spot.value * field, source)
    if "scatter_c" in accepted:
        fwhm_s = pulse_fwhm_s(sensor, accepted["scatter_c"].value)
        if fwhm_s is not None:
            changed = put_value(
                text, "laser", "pulse_fwhm_ns", 1e9 * fwhm_s, source_of("scatter_c", "; scatter of the range")
            )
            try:
                parse_sensor(changed, where)
            except InputError:  # shorter than the bins of the file can show
                notes += (f"laser.pulse_fwhm_ns is left as it was: {1e9 * fwhm_s:.2g} ns is too short for its bins",)
            else:
                text = changed
    for key in ("threshold_floor", "threshold_slope", "threshold_spread"):
        if key in accepted:
            text = put_value(
                text, "histogram", key, accepted[key].value, source_of(key, "; SIGNAL and NEAR_IR of kept and lost")
            )
    if rows is not None:
        text, row_notes = _with_rows(text, rows, recording)
        notes += row_notes
    if "white_m2" in accepted:
        unscaled = parse_sensor(text, where)
        power_w = float(unscaled.laser.peak_power_w) * accepted["white_m2"].value / white_m2(unscaled)
        source = source_of("white_m2", "; power, lens, efficiency, PDE and shots are known as one product")
        text = put_value(text, "laser", "peak_power_w", power_w, source)
    return text, notes


def _with_rows(text: str, rows: RowGains, recording: str) -> tuple[str, tuple[str, ...]]:
    """Put the gains of the rows into the file; returns the text, and a note if they are not written."""
    beams = tomllib.loads(text).get("scanner", {}).get("elevation_deg", ())
    if len(beams) != len(rows.gain):
        return text, (f"row gains are not written: of {len(rows.gain)} rows, and the file has {len(beams)} beams",)
    if rows.key is None:
        reason = "SIGNAL of some rows is too weak"
        if rows.follows is not None:
            reason = "it goes with their power of {:.2f} +/- {:.2f}".format(*rows.follows)
        return text, (f"row gains are not written: whether SIGNAL has those of NEAR_IR is not told ({reason})",)
    assert rows.follows is not None
    source = (
        f"fitted: NEAR_IR of neighbouring rows, each +/- {rows.sigma[0]:.1%}, {recording}; SIGNAL goes with their "
        f"power of {rows.follows[0]:.2f} +/- {rows.follows[1]:.2f}"
    )
    return put_value(text, "scanner", rows.key, rows.gain.tolist(), source), ()


def _estimate_text(estimate: Estimate | None) -> str:
    return (
        "not recorded"
        if estimate is None
        else f"{estimate.value:.3g} +/- {estimate.sigma:.2g} {estimate.unit}".rstrip()
    )


def scaled_text(
    text: str, estimates: Mapping[str, Estimate], recording: str, where: str
) -> tuple[str, tuple[str, ...]]:
    """Scale the numbers of a sensor file by their estimates; returns the text, and notes on numbers that stay.

    estimates  factors of the file's values; those with a relative sigma above `MOST_RELATIVE_SIGMA` are not written
    """
    accepted = {
        key: estimate
        for key, estimate in estimates.items()
        if estimate.is_known and estimate.sigma < MOST_RELATIVE_SIGMA * estimate.value
    }
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
    except InputError:  # one value does not go with the others: put in those that do, one by one
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


def scaled_values(text: str, factors: Mapping[str, float]) -> dict[str, float | list[float]]:
    """Key -> value of the file times its factor; keys that the file does not have are left out."""
    tables = tomllib.loads(text)
    values: dict[str, float | list[float]] = {}
    for key, factor in factors.items():
        node: Any = tables
        for name in key.split("."):
            node = node.get(name) if isinstance(node, Mapping) else None
        if isinstance(node, list):
            values[key] = [float(number) * factor for number in node]
        elif node is not None:
            values[key] = round(node * factor) if key in WHOLE else float(node) * factor
    return values


def _with_overlap(text: str) -> str:
    """Add an empty table [optics.overlap] if there is none: field of view and spot on one axis."""
    document = tomlkit.parse(text)
    if _table(document, "optics.overlap") is None:
        document["optics"].append("overlap", tomlkit.table())
    return tomlkit.dumps(document)


def put_key(text: str, key: str, value: float | Sequence[float], source: str) -> str:
    """`put_value` with table and key as one."""
    table, _, name = key.rpartition(".")
    return put_value(text, table, name, value, source)


def put_value(text: str, table: str, key: str, value: float | Sequence[float], source: str) -> str:
    """Put a number or a list into a table of the text, with its source. Raises InputError without the table."""
    document = tomlkit.parse(text)
    entries = _table(document, table)
    if entries is None:
        raise InputError(f"[{table}]: must be a table of the sensor file, got none")
    numbers = [value] if isinstance(value, int | float) else value
    digits = ", ".join(str(number) if isinstance(number, int) else f"{number:.6g}" for number in numbers)
    entries[key] = tomlkit.value(digits if numbers is not value else f"[{digits}]")
    _put_source(document, f"{table}.{key}", source)
    return tomlkit.dumps(document)


def remove_keys(text: str, table: str, keys: Sequence[str]) -> str:
    """Remove keys of a table, and their sources, from the text."""
    document = tomlkit.parse(text)
    entries, sources = _table(document, table), _table(document, "sources")
    for key in keys:
        for node, name in ((entries, key), (sources, f"{table}.{key}")):
            if node is not None and name in node:
                node.remove(name)
    return tomlkit.dumps(document)


def put_source(text: str, key: str, source: str) -> str:
    """Put a source into `[sources]`."""
    document = tomlkit.parse(text)
    _put_source(document, key, source)
    return tomlkit.dumps(document)


def _put_source(document: tomlkit.TOMLDocument, key: str, source: str) -> None:
    sources = _table(document, "sources")
    if sources is None:
        sources = document["sources"] = tomlkit.table()
    sources[key] = source


def _table(document: tomlkit.TOMLDocument, name: str) -> Any:
    """Editable table of a dotted name; None if the file has none."""
    node: Any = document
    for part in name.split("."):
        node = node.get(part) if isinstance(node, Mapping) else None
    return node if isinstance(node, Mapping) else None


def _has_key(text: str, table: str, *keys: str) -> bool:
    """True if a table of the file has one of these keys."""
    entries = _table(tomlkit.parse(text), table)
    return entries is not None and any(key in entries for key in keys)
