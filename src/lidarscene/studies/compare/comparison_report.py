"""Verdict, sentences and tables of a comparison, for its page and for the text that the command prints.

Tables leave out columns without any known number, so clouds from files and simulated ones share one code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...figures.report import Table, text_table, without_empty_columns
from ...sensor.sensor_model import Sensor
from ..ranging.conditions import PROBABILITY
from .comparison_statistics import (
    DetectionRate,
    count_pairs,
    detection_deviation,
    overall_rate,
    paired_range_difference,
    range_errors,
    rates_by_group,
)
from .illuminance_sweep import IlluminanceSweep, RateCrossing
from .observations import Grouping, Observation

MOST_BODIES = 25  # rows of the page's table


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """Observations of several sensors, and how they are compared: all that the report needs.

    Attributes:
        observations: one for each sensor; the first is compared with each other one
        sensors: sensor of each observation; None for a cloud from a file
        groups: how pulses are grouped
        matched: whether equal pulse numbers mean the same pulse for all
        population: what rates are shares of, in words
        notes: how the comparison was made, for the reader
        aliasing_notes: sentence for each sensor that reports echoes from beyond its unambiguous range too near
        equal_terms: sentences on the ranges on equal terms (`ranging.equal_terms`); () for clouds from files
        seed: seed of all simulated frames; None for clouds from files
        sweep: results over the illuminance, if one was asked for
    """

    title: str
    observations: tuple[Observation, ...]
    sensors: tuple[Sensor | None, ...]
    groups: tuple[Grouping, ...]
    matched: bool
    population: str
    notes: tuple[str, ...]
    aliasing_notes: tuple[str, ...] = ()
    equal_terms: tuple[str, ...] = ()
    seed: int | None = None
    sweep: IlluminanceSweep | None = None

    @property
    def rated(self) -> bool:
        """True if every observation has detection rates."""
        return all(observation.surfaces is not None for observation in self.observations)

    def group(self, key: str) -> Grouping:
        """Grouping with this key."""
        return next(grouping for grouping in self.groups if grouping.key == key)

    def against_first(self) -> list[tuple[Observation, Observation]]:
        """Pairs of the first observation and each other one; none where pulses do not match."""
        return [(self.observations[0], observation) for observation in self.observations[1:]] if self.matched else []


def verdict(comparison: Comparison) -> str:
    """The outcome in one sentence: who detected more and by how much, and who measured ranges better."""
    if not comparison.rated:
        counts = [
            f"{observation.name} {int(np.count_nonzero(observation.is_echo)):,}"
            for observation in comparison.observations
        ]
        return f"Echoes: {', '.join(counts)}; missed pulses are not known, so the sensors cannot be ranked."
    shares = [(observation.name, overall_rate(observation.rated_surfaces)) for observation in comparison.observations]
    if not comparison.matched:
        # Shares of different pulses: one raster sees more of a dark far wall than the other, whatever the receivers.
        own = ", ".join(f"{name} {_percent(share.rate)} ({_interval_text(share.interval)})" for name, share in shares)
        return (
            "The sensors fire different pulses, so they cannot be ranked. Detected fraction of "
            f"{comparison.population}, for the pulses of each sensor (95 % interval): {own}. With the same beams for "
            "all, pulses are compared one by one."
        )
    order = sorted(shares, key=lambda pair: -pair[1].rate)
    (best, best_rate), (second, second_rate), *_ = order
    other_shares = ", ".join(f"{name} {_percent(share.rate)}" for name, share in order[1:])
    if _differ_significantly(comparison, best, second):
        more = f", {100.0 * (best_rate.rate - second_rate.rate):.3g} percentage points more" if len(order) == 2 else ""
        outcome = f"{best} detects most, {_percent(best_rate.rate)} of {comparison.population}{more}; {other_shares}"
    else:
        alike = f"{best} and {second} detect equally many of {comparison.population}, within chance"
        outcome = f"{alike}: {best} {_percent(best_rate.rate)}, {other_shares}"
    spread = [
        (errors[0].sigma_m, observation.name)
        for observation in comparison.observations
        if (errors := range_errors(observation))
    ]
    if len(spread) < len(shares):
        return f"{outcome}."
    (finest_mm, finest), *coarser = [(f"{1e3 * sigma_m:.3g} mm", name) for sigma_m, name in sorted(spread)]
    if all(spread_mm == finest_mm for spread_mm, _ in coarser):
        return f"{outcome}. Ranges scatter by {finest_mm} with each."
    other_spreads = ", ".join(f"{spread_mm} of {name}" for spread_mm, name in coarser)
    return f"{outcome}. Ranges scatter least with {finest}: {finest_mm} against {other_spreads}."


def _differ_significantly(comparison: Comparison, best: str, second: str) -> bool:
    """True if the rate of ``best`` is above that of ``second`` by more than chance, to 95 %, pulse by pulse."""
    a, b = (
        next(observation for observation in comparison.observations if observation.name == name)
        for name in (best, second)
    )
    (pair,) = count_pairs(a.rated_surfaces, b.rated_surfaces)
    return pair.difference_interval[0] > 0.0


def _percent(share: float) -> str:
    return f"{100.0 * share:.2f} %"


def _interval_text(ends: tuple[float, float]) -> str:
    return f"{100.0 * ends[0]:.2f} to {100.0 * ends[1]:.2f} %"


_FATE_SHORT = ("sensor", "pulses", "hit a surface", "kept", "points", "false alarms")
_RATES_SHORT = ("sensor", "found", "95 % interval", "expected", "mean range error", "deviation of range error")

FATE = (
    "sensor",
    "pulses",
    "hit a surface",
    "kept",
    "lost: below threshold",
    "of these without any light",
    "lost: out of window",
    "lost: hidden",
    "points",
    "false alarms",
)


def fate_table(comparison: Comparison) -> Table:
    """Table of the pulses of each sensor by outcome: kept, lost and why, and the points that came of them."""
    rows: list[Sequence[str]] = []
    for observation in comparison.observations:
        cells = ["-"] * 7
        if observation.surfaces is not None and observation.pulses_fired is not None:
            below, *other_losses = observation.losses.values()
            dark = np.count_nonzero(observation.surfaces.snr == 0.0)
            surface_pulses, detected = len(observation.surfaces.pulse), np.count_nonzero(observation.surfaces.detected)
            counts = (observation.pulses_fired, surface_pulses, detected, below, dark, *other_losses)
            cells = [f"{count:,}" for count in counts]
        rows.append((observation.name, *cells, f"{len(observation.cloud):,}", f"{observation.false_alarms:,}"))
    return without_empty_columns(FATE, rows, ("-", "0"))


RATES = (
    "sensor",
    "found",
    "95 % interval",
    "expected",
    "detected minus expected",
    "mean range error",
    "deviation of range error",
)


def summary_table(comparison: Comparison) -> Table:
    """Table of each sensor's detection rate and range error over all pulses."""
    rows: list[Sequence[str]] = []
    for observation in comparison.observations:
        cells = ["-", "-", "-", "-"]
        if observation.surfaces is not None:
            total, deviations = overall_rate(observation.surfaces), detection_deviation(observation.surfaces)
            cells = [_percent(total.rate), _interval_text(total.interval)]
            cells += ["-" if total.expected is None else _percent(total.expected)]
            cells += ["-" if deviations is None else f"{deviations:+.1f} standard deviations"]
        errors = range_errors(observation)
        error_cells = ("-", "-")
        if errors:
            error = errors[0]
            error_cells = (
                f"{1e3 * error.bias_m:+.2f} ± {1e3 * error.bias_interval_m:.2f} mm",
                f"{1e3 * error.sigma_m:.2f} ± {1e3 * error.sigma_interval_m:.2f} mm",
            )
        rows.append((observation.name, *cells, *error_cells))
    return without_empty_columns(RATES, rows, ("-", "0"))


PAIRS = (
    "A",
    "B",
    "detected by both",
    "A only",
    "B only",
    "neither",
    "rate of A minus B",
    "95 % interval",
    "range of A minus B, mean and deviation",
)


def pair_rows(comparison: Comparison) -> list[tuple[str, ...]]:
    """Rows under `PAIRS`: the first sensor compared with each other one, where pulses match."""
    rows: list[tuple[str, ...]] = []
    for a, b in comparison.against_first():
        (pair,) = count_pairs(a.rated_surfaces, b.rated_surfaces)
        difference = paired_range_difference(a, b)
        range_text = (
            "-" if difference is None else f"{1e3 * difference.bias_m:+.2f} mm, {1e3 * difference.sigma_m:.2f} mm"
        )
        rows.append(
            (
                a.name,
                b.name,
                f"{pair.both:,}",
                f"{pair.only_a:,}",
                f"{pair.only_b:,}",
                f"{pair.neither:,}",
                f"{100.0 * pair.difference:+.2f} %",
                _interval_text(pair.difference_interval),
                range_text,
            )
        )
    return rows


def group_table(comparison: Comparison, key: str, most: int | None = None) -> Table:
    """Table by class or body: found by each sensor, and by A only or B only if pulses match.

    Args:
        most: number of rows at most: those where one sensor found most pulses that the other missed if pulses match,
            else those with most pulses
    """
    grouping = comparison.group(key)
    names = [observation.name for observation in comparison.observations]
    header = [key, f"pulses, {names[0]}", *(f"detected, {name}" for name in names)]
    rates_by_sensor = [
        rates_by_group(observation.surfaces, grouping)
        for observation in comparison.observations
        if observation.surfaces is not None
    ]
    pairs_by_sensor = [count_pairs(a.rated_surfaces, b.rated_surfaces, grouping) for a, b in comparison.against_first()]
    for a, b in comparison.against_first():
        header += [f"only {a.name}", f"only {b.name}"] if len(pairs_by_sensor) == 1 else [f"{a.name} minus {b.name}"]
    groups = [
        group
        for group in range(len(grouping.labels))
        if any(sensor_rates[group].surfaces for sensor_rates in rates_by_sensor)
    ]
    groups.sort(key=lambda group: -max(sensor_rates[group].surfaces for sensor_rates in rates_by_sensor))
    if most is not None and pairs_by_sensor:
        # A body that all sensors found alike would fill the table without showing a difference.
        disagreements = {
            group: sum(pairs[group].only_a + pairs[group].only_b for pairs in pairs_by_sensor) for group in groups
        }
        groups = sorted((group for group in groups if disagreements[group]), key=lambda group: -disagreements[group])
    rows = []
    for group in groups[:most]:
        row = [
            grouping.labels[group] or "unlabelled",
            f"{rates_by_sensor[0][group].surfaces:,}",
            *(_rate_cell(sensor_rates[group]) for sensor_rates in rates_by_sensor),
        ]
        for pairs in pairs_by_sensor:
            only_a, only_b = pairs[group].only_a, pairs[group].only_b
            row += [f"{only_a:,}", f"{only_b:,}"] if len(pairs_by_sensor) == 1 else [f"{only_a - only_b:+,}"]
        rows.append(row)
    return header, rows


def _rate_cell(group_rate: DetectionRate) -> str:
    return f"{_percent(group_rate.rate)} ({_interval_text(group_rate.interval)})" if group_rate.surfaces else "-"


def counts_table(comparison: Comparison, key: str) -> Table:
    """Table of each sensor's echoes by group, where there are no rates."""
    grouping = comparison.group(key)
    counts_by_sensor = [
        {error.group: error.points for error in range_errors(observation, grouping)}
        for observation in comparison.observations
    ]
    rows = [
        [label or "unlabelled", *(f"{counts.get(label, 0):,}" for counts in counts_by_sensor)]
        for label in dict.fromkeys(grouping.labels)
        if any(label in counts for counts in counts_by_sensor)
    ]
    heading = f"{key} [{grouping.unit}]" if grouping.unit else key
    return [heading, *(f"echoes, {observation.name}" for observation in comparison.observations)], rows


def crossing_lines(sweep: IlluminanceSweep, first: str) -> list[str]:
    """Sentences on the crossings of the first sensor with each other one, or on their absence."""
    lines = []
    low, high = sweep.illuminances_klux[0], sweep.illuminances_klux[-1]
    for name, crossings in sweep.crossings.items():
        if not crossings:
            lines.append(f"The ranking of {first} and {name} does not flip between {low:g} and {high:g} klux.")
        lines += [_crossing_sentence(crossing) for crossing in crossings]
        plane = sweep.on_plane_klux[name]
        if plane is not None:
            lines.append(
                "On Table 1's target alone, a plane of reflectivity 0.1 in air of transmittance 0.98, "
                f"{first} and {name} have the same range, at P_d {PROBABILITY:g}, at {plane:.3g} klux."
            )
    return lines


def _crossing_sentence(crossing: RateCrossing) -> str:
    return (
        f"{crossing.ahead_above} overtakes {crossing.ahead_below} at {crossing.illuminance_klux:.3g} klux, where both "
        f"are expected to detect {_percent(crossing.expected)}."
    )


def sweep_table(sweep: IlluminanceSweep) -> Table:
    """Table of the results of each sensor under each illuminance."""
    header = ["illuminance"]
    for name in sweep.courses:
        header += [f"detected, {name}", "expected", "false alarms", "deviation of range error"]
    rows = []
    for number, lux in enumerate(sweep.illuminances_klux):
        row = [f"{lux:g} klux"]
        for course in sweep.courses.values():
            step = course[number]
            sigma = "-" if step.sigma_m is None else f"{1e3 * step.sigma_m:.1f} mm"
            row += [_percent(step.rate.rate), _percent(step.rate.expected or 0.0), f"{step.false_alarms:,}", sigma]
        rows.append(row)
    return header, rows


def as_text(comparison: Comparison) -> str:
    """Text of the command: the verdicts, two tables of the sensors, a line for each pair and each crossing."""
    lines = [*comparison.equal_terms, verdict(comparison)]
    for short, (header, rows) in ((_FATE_SHORT, fate_table(comparison)), (_RATES_SHORT, summary_table(comparison))):
        columns = [i for i, name in enumerate(header) if name in short]
        short_rows = [[row[i] for i in columns] for row in (("", *header[1:]), *rows)]
        lines.append(text_table(short_rows[0], short_rows[1:], "<>"))
    for row in pair_rows(comparison):
        lines.append(
            f"{row[0]} against {row[1]}: both {row[2]}, only {row[0]} {row[3]}, only {row[1]} {row[4]}, "
            f"neither {row[5]}"
        )
    lines += comparison.aliasing_notes
    if comparison.sweep is not None:
        lines += crossing_lines(comparison.sweep, comparison.observations[0].name)
    return "\n".join(lines)
