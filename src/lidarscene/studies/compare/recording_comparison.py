"""Comparison of a simulated cloud with a recording of a real lidar whose scene is not known.

Neither the pulses nor the surfaces are the same, so nothing is matched: points, losses, ranges, channels, ground and
strengths are counted on each side, and a table gives their ratios.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...cloud.point_cloud import PointCloud
from ...figures.report import PAGE, Report
from ...maths.arrays import Numbers
from ...recordings.sweep import Sweep
from ..held import Held, held_data, held_table, ratio, value_text

NUMBERS = "real.json"

QUANTILES = (1.0, 10.0, 50.0, 90.0, 99.0, 99.9)
"""Choice: quantiles of the ranges that are compared [%]."""

FIRST_OCTAVE_M, OCTAVES = 2.0, 7
"""Choice: octaves of range in which strengths are compared: 2 to 4 m, 4 to 8 m, ..."""

GROUND_NEAR_M = 25.0
"""Choice: farthest points to which the ground's plane is fitted, so that a slope or a hill does not tilt it."""

LEAST_GROUND = 100
"""Fewest points that make a plane, or a median of strengths."""

CHANNEL_PREFIX = "points at "
"""Start of the quantity in rows of single channels."""

ALIKE = 0.1
"""Choice: distance of a ratio from 1 that the verdict ignores: two frames of one sensor in one street differ as
much."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """Data of one side, a cloud or a recording; arrays (n,) and (n, 3) are of the first returns.

    Attributes:
        xyz_m: (n, 3) positions in the sensor's frame
        range_m: (n,) ranges
        ring: (n,) ring of the maker's driver, None if unknown
        strength: (n,) signal, or intensity, in a unit of its own; None if unknown
        return_share: share of the pulses with a return; None where lost pulses are not known
        gap_m: (m,) distances between first and second returns of one pulse
    """

    name: str
    xyz_m: Numbers
    range_m: Numbers
    ring: Numbers | None
    strength: Numbers | None
    return_share: float | None
    gap_m: Numbers


def side_of_sweep(name: str, sweep: Sweep) -> Side:
    """Side of one frame of a recording."""
    is_first = sweep.has_return
    if sweep.return_number is not None:
        is_first = is_first & (sweep.return_number <= 1)
    strengths = (sweep.signal, sweep.intensity, sweep.reflectivity)
    strength = next((values for values in strengths if values is not None), None)
    has_second = is_first & np.isfinite(sweep.second.range_m) if sweep.second is not None else np.zeros_like(is_first)
    gap_m = np.abs(sweep.second.range_m - sweep.range_m)[has_second] if sweep.second is not None else np.zeros(0)
    return Side(
        name=name,
        xyz_m=sweep.xyz_m[is_first],
        range_m=sweep.range_m[is_first],
        ring=None if sweep.ring is None else sweep.ring[is_first],
        strength=None if strength is None else strength[is_first],
        return_share=float(sweep.has_return.sum() / max(sweep.recorded.sum(), 1)) if sweep.includes_lost else None,
        gap_m=gap_m,
    )


def side_of_cloud(name: str, cloud: PointCloud) -> Side:
    """Side of a simulated cloud."""
    local = cloud.in_sensor_frame()
    order = np.lexsort((local.return_number, local.channel, local.time_s))
    # Neighbours of equal time and channel are two returns of one pulse.
    same_pulse = (np.diff(local.time_s[order]) == 0.0) & (np.diff(local.channel[order]) == 0)
    gap_m = np.abs(np.diff(local.range_m[order].astype(np.float64)))[same_pulse]
    first = local.select(local.return_number <= 1)
    return Side(
        name=name,
        xyz_m=first.xyz_m.astype(np.float64),
        range_m=first.range_m.astype(np.float64),
        ring=first.ring,
        strength=first.signal if np.any(first.signal) else first.intensity,
        return_share=None,
        gap_m=gap_m,
    )


def compare_with_recording(side: Side, real: Side) -> Report:
    """Compare a side with that of a recording, quantity by quantity."""
    sides = [compared_quantities(side), compared_quantities(real)]
    rows = [*_quantity_rows(*sides), *_channel_rows(*sides)]
    words = {"reference": real.name, "simulated": side.name, "value": "ratio"}
    numbers: dict[str, Any] = {
        "verdict": verdict(side.name, real.name, rows),
        "sides": sides,
        "rows": [row.as_dict(**words) for row in rows],
    }
    report = Report(
        f"{side.name} beside {real.name}", numbers=numbers, main_table=held_data(rows, **words), pages=(PAGE, NUMBERS)
    )
    report.add_paragraph(numbers["verdict"])
    report.add_table(*held_table(rows, reference=real.name, simulated=side.name, value="ratio"))
    report.summary = report.as_text()
    report.add_paragraph(_NOTE)
    return report


def verdict(name: str, real_name: str, rows: Sequence[Held]) -> str:
    """The outcome in one sentence: how many points, what differs most, and what only one side has."""
    points, *others = (row for row in rows if not row.quantity.startswith(CHANNEL_PREFIX))
    sentence = f"{name} has {value_text(points.simulated)} points"
    if points.simulated == points.reference:
        sentence += f", as many as {real_name}"
    else:
        share = "" if points.value is None else f" ({100.0 * (points.value - 1.0):+.3g} %)"
        sentence += f", {real_name} {value_text(points.reference)}{share}"
    return f"{sentence}; {_largest_difference(others)}{_on_one_side(name, real_name, others)}."


def _largest_difference(rows: Sequence[Held]) -> str:
    """Part of the verdict: the quantity whose ratio is farthest from 1."""
    ratios = [(abs(math.log(row.value)), row) for row in rows if row.value is not None and row.value > 0.0]
    if not ratios:
        return "nothing else is known of both"
    _, row = max(ratios, key=lambda pair: pair[0])
    if row.value is not None and abs(row.value - 1.0) < ALIKE:
        return f"nothing else differs by {100.0 * ALIKE:.0f} % or more"
    values = f"{value_text(row.simulated)} against {value_text(row.reference)}"
    return f"what differs most is '{row.quantity}': {values}"


def _on_one_side(name: str, real_name: str, rows: Sequence[Held]) -> str:
    """Part of the verdict: quantities without a ratio, since one side lacks them or has none."""
    sides = (
        (name, [f"'{row.quantity}'" for row in rows if row.simulated and not row.reference]),
        (real_name, [f"'{row.quantity}'" for row in rows if row.reference and not row.simulated]),
    )
    return "".join(f"; only {side} has {', '.join(names)}" for side, names in sides if names)


_NOTE = (
    "Not the same scene: nothing is matched. Strengths have a unit of their own on each side, so each is divided "
    "by its median over all points. Channels are ordered by their elevation. The ground is the plane below the sensor; "
    "its farthest return is the 99.9 % quantile."
)


def compared_quantities(side: Side) -> dict[str, Any]:
    """Compared quantities by name; None for those that a side has no data for.

    Also "rings", the channels as `channel_points` gives them.
    """
    range_m = side.range_m
    ground = measure_ground(side.xyz_m)
    quantities: dict[str, Any] = {"points": len(range_m), "share of pulses kept": side.return_share}
    quantities |= {
        f"range, {quantile:g} % quantile [m]": float(np.percentile(range_m, quantile)) if len(range_m) else None
        for quantile in QUANTILES
    }
    height, farthest, share = ground if ground else (None, None, None)
    quantities |= {"sensor above ground [m]": height, "farthest ground [m]": farthest, "share on the ground": share}
    quantities["second returns, share"] = len(side.gap_m) / len(range_m) if len(side.gap_m) else None
    quantities["second returns, 1 % gap [m]"] = float(np.percentile(side.gap_m, 1.0)) if len(side.gap_m) else None
    for number in range(OCTAVES):
        low = FIRST_OCTAVE_M * 2.0**number
        name = f"strength, {low:g} to {2.0 * low:g} m"
        in_octave = (range_m >= low) & (range_m < 2.0 * low)
        quantities[name] = None
        # The unit of the strength is unknown, so it is compared as a multiple of the median over all points.
        if side.strength is not None and in_octave.sum() >= LEAST_GROUND and np.median(side.strength) > 0:
            quantities[name] = float(np.median(side.strength[in_octave]) / np.median(side.strength))
    quantities["rings"] = channel_points(side)
    return quantities


def channel_points(side: Side) -> list[tuple[float, int]] | None:
    """Median elevation [degrees] and number of points of each channel, from the lowest up; None if unknown."""
    if side.ring is None:
        return None
    elevation = np.degrees(np.arcsin((side.xyz_m[:, 2] / side.range_m).clip(-1.0, 1.0)))
    numbers, inverse, counts = np.unique(side.ring, return_inverse=True, return_counts=True)
    order = np.argsort(inverse, kind="stable")
    parts = np.split(elevation[order], np.cumsum(counts)[:-1])
    return sorted((float(np.median(part)), len(part)) for part in parts) if len(numbers) else None


def measure_ground(xyz_m: Numbers) -> tuple[float, float, float] | None:
    """Height of the sensor [m], the ground's farthest return [m] (99.9 %), share of the points on it; None if no plane.

    Points within 0.1 m of `ground_plane`, or within 0.3 % of their range, are on the ground.
    """
    plane = ground_plane(xyz_m)
    if plane is None:
        return None
    range_m = np.sqrt(np.sum(xyz_m**2, axis=1))
    on_ground = np.abs(_height_above(plane, xyz_m)) < np.maximum(0.1, 0.003 * range_m)
    height_m = -plane[0] / np.sqrt(1.0 + plane[1] ** 2 + plane[2] ** 2)
    return float(height_m), float(np.percentile(range_m[on_ground], 99.9)), float(on_ground.mean())


def ground_plane(xyz_m: Numbers) -> Numbers | None:
    """Fit the plane z = a + b x + c y to the ground near the sensor: (3,) a, b, c; None if there is no ground.

    The fit starts at the lowest well-filled 0.2 m of height below the sensor. It is repeated with the points within
    0.3, 0.15 and 0.1 m of the plane.
    """
    level_m = np.hypot(xyz_m[:, 0], xyz_m[:, 1])
    near = xyz_m[(level_m < GROUND_NEAR_M) & (xyz_m[:, 2] < -0.2)]
    if len(near) < LEAST_GROUND:
        return None
    # The lowest layer with at least 0.3 of the fullest one's points: stray points below the ground are too few for it.
    counts, edges = np.histogram(near[:, 2], bins=np.arange(near[:, 2].min(), 0.2, 0.2))
    start = int(np.argmax(counts >= 0.3 * counts.max()))
    plane: Numbers = np.array([0.5 * (edges[start] + edges[start + 1]), 0.0, 0.0])
    for within_m in (0.3, 0.15, 0.1):
        chosen = near[np.abs(_height_above(plane, near)) < within_m]
        if len(chosen) < LEAST_GROUND:
            return None
        design = np.column_stack([np.ones(len(chosen)), chosen[:, :2]])
        plane = np.linalg.lstsq(design, chosen[:, 2], rcond=None)[0]
    return plane


def _height_above(plane: Numbers, xyz_m: Numbers) -> Numbers:
    """(n,) vertical distance of points above the plane."""
    return np.asarray(xyz_m[:, 2] - plane[0] - xyz_m[:, :2] @ plane[1:])


def _quantity_rows(quantities: dict[str, Any], real_quantities: dict[str, Any]) -> list[Held]:
    """Rows of all quantities that at least one side has."""
    return [
        _row(name, value, real_quantities[name])
        for name, value in quantities.items()
        if name != "rings" and (value, real_quantities[name]) != (None, None)
    ]


def _channel_rows(quantities: dict[str, Any], real_quantities: dict[str, Any]) -> list[Held]:
    channels, real_channels = quantities["rings"], real_quantities["rings"]
    if channels is None and real_channels is None:
        return []
    counts = (None if rings is None else len(rings) for rings in (channels, real_channels))
    rows = [_row("channels with points", *counts)]
    if channels and real_channels and len(channels) == len(real_channels):
        rows += [
            _row(f"{CHANNEL_PREFIX}{elevation_deg:.2f} degrees", points, real_points)
            for (_, points), (elevation_deg, real_points) in zip(channels, real_channels, strict=True)
        ]
    return rows


def _row(quantity: str, value: float | None, real_value: float | None) -> Held:
    return Held(quantity=quantity, reference=real_value, simulated=value, value=ratio(value, real_value))
