"""Fields of a frame's points, from the columns of a cloud and its link budget, packed as a blob."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..formats.cloud_columns import STATUS_NAMES, Column
from ..formats.cloud_description import unit_of
from ..maths.arrays import Numbers
from ..studies.budget import Budget
from .blob import pack_blob

BUDGET, SURFACE, POINT = GROUPS = ("Budget", "Surface (truth)", "Point")
SYMBOLS = {
    "range": "R",
    "true_range": "R",
    "range_error": "ΔR",
    "incidence_angle": "θ",
    "reflectivity": "ρ",
    "sun_angle": "θₛ",
    "detection_probability": "P_d",
    "echo_power": "P_r",
    "lambertian_power": "P_r, (5)",
    "background_power": "P_rs",
    "noise": "σ₀",
    "noise_at_peak": "σ",
    "threshold": "U",
    "peak_signal": "s",
    "intensity": "s + noise",
}
SCALES = ("W", "of 255")
"""Units of an intensity by the sensor file's [intensity], which is no signal at the comparator."""

LOGARITHMIC = ("intensity", "snr", "echo_power", "lambertian_power", "background_power", "signal", "peak_signal")
OF_BUDGET = (
    "echo_power",
    "lambertian_power",
    "background_power",
    "peak_signal",
    "noise",
    "noise_at_peak",
    "threshold",
    "snr",
    "detection_probability",
    "intensity",
)
"""Fields of the link budget, in the order from light to signal."""


@dataclass(frozen=True, slots=True)
class Field:
    """Quantity of the points that the page shows.

    Attributes:
        names: names of the values of a category; None for a number
        computed: True if it comes from the link budget
    """

    name: str
    group: str
    unit: str
    meaning: str
    names: tuple[str, ...] | None = None
    computed: bool = False

    def header(self) -> dict[str, Any]:
        """Entry of the blob's header."""
        return {
            "name": self.name,
            "label": "SNR" if self.name == "snr" else self.name.replace("_", " "),
            "symbol": "" if self.name == "intensity" and self.unit in SCALES else SYMBOLS.get(self.name, ""),
            "group": self.group,
            "unit": self.unit,
            "meaning": self.meaning,
            "names": self.names,
            "log": self.name in LOGARITHMIC,
            "computed": self.computed,
        }


def frame_blob(
    cloud: PointCloud,
    *,
    name: str,
    origin_m: Numbers,
    budget: Budget | None,
    extra_header: dict[str, Any],
    still_m: Numbers | None = None,
) -> bytes:
    """Pack one frame.

    Args:
        origin_m: (3,) subtracted from the positions before they become single precision
        budget: link budget of the points, or None
        extra_header: further entries of the header
        still_m: (n, 3) positions without the sensor's own motion, or None
    """
    fields: list[Field] = []
    arrays: dict[str, Numbers] = {"xyz": (cloud.xyz_m - origin_m).astype(np.float32).ravel()}
    if still_m is not None:
        arrays["still"] = (still_m - origin_m).astype(np.float32).ravel()
    for field, values in [*_column_fields(cloud), *_budget_fields(budget)]:
        fields.append(field)
        if field.name not in ("x", "y", "z"):  # the page takes these from xyz
            arrays[field.name] = values
    fields.sort(key=lambda field: OF_BUDGET.index(field.name) if field.group == BUDGET else -1)
    header = {
        "name": name,
        "count": len(cloud),
        "fields": [field.header() for field in fields],
        "groups": GROUPS,
        "alarms": int(np.count_nonzero(cloud.status)),
        "metadata": dict(cloud.metadata),
        "sensor": cloud.sensor_position_m.tolist(),
    }
    return pack_blob(header | extra_header, arrays)


def _column_fields(cloud: PointCloud) -> list[tuple[Field, Numbers]]:
    """Fields and values of all columns, angles in degrees, and of the range error."""
    fields = []
    # A cloud of a recording has all columns, but only those listed in its metadata hold measured values.
    attributes = cloud.metadata.get("recorded", " ".join(column.attribute for column in cloud.columns)).split()
    for column in cloud.columns:
        if column.attribute not in (*attributes, "status"):
            continue
        values, unit = cloud.column(column.name), unit_of(cloud, column.name)
        if unit == "rad":
            values, unit = np.degrees(values), "°"
        field = Field(column.name, _group(column), "" if unit == "1" else unit, column.meaning, _names(cloud, column))
        fields.append((field, _as_blob_type(values)))
        if column.name == "true_range":
            echo = (cloud.status == 0) & np.isfinite(values)
            error = np.full(len(cloud), np.inf, np.float32)
            error[echo] = cloud.range_m[echo] - values[echo]
            meaning = "reported less true range, of echoes"
            fields.append((Field("range_error", _group(column), "m", meaning), error))
    return fields


def _group(column: Column) -> str:
    if column.name in OF_BUDGET:
        return BUDGET
    return SURFACE if column.truth else POINT


def _names(cloud: PointCloud, column: Column) -> tuple[str, ...] | None:
    """Names by value of a column of categories; None for a quantity."""
    if column.names:
        return tuple(getattr(cloud, column.names))
    return {"status": STATUS_NAMES, "in_shadow": ("lit", "in shadow")}.get(column.name)


def _budget_fields(budget: Budget | None) -> list[tuple[Field, Numbers]]:
    """Fields and values of the link budget; none without one."""
    if budget is None:
        return []
    unit = budget.signal_unit
    quantities = (
        ("echo_power", budget.echo_power_w, "W", "peak power of the echo on the detector"),
        ("lambertian_power", budget.lambertian_power_w, "W", "the same by (5), of a Lambertian surface"),
        ("background_power", budget.background_power_w, "W", "sun and sky on the detector, by (8)"),
        ("peak_signal", budget.signal, unit, "peak of the echo at the comparator, without noise"),
        ("noise", budget.noise, unit, "standard deviation without an echo"),
        ("noise_at_peak", budget.noise_at_peak, unit, "standard deviation at the echo's peak"),
        ("threshold", budget.threshold, unit, "level of the comparator"),
    )
    return [
        (Field(name, BUDGET, quantity_unit, meaning, computed=True), _as_blob_type(values))
        for name, values, quantity_unit, meaning in quantities
    ]


def _as_blob_type(values: Numbers) -> Numbers:
    """Convert to a type that a blob can hold."""
    return np.asarray(values) if values.dtype in (np.uint8, np.int32) else np.asarray(values, np.float32)
