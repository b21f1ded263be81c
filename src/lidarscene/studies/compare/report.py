"""A comparison in words and numbers: tables for the page, and the text that the command prints.

Tables leave out columns of which nothing is known, so clouds from files and simulated ones share one code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...sensor.model import Sensor
from .data import Grouping, Observation
from .numbers import Rate, deviation, paired_range_difference, pairs, range_errors, rate, rates
from .run import Crossing, Sweep

MOST_BODIES = 25  # rows of the page's table


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """Everything that a report is made of.

    observations  the observations; the first is compared with each other one
    sensors     of each observation; None for a cloud from a file
    groups      how pulses are grouped
    matched     whether equal pulse numbers mean the same pulse for all
    population          what rates are shares of, in words
    notes       how the comparison was made, for the reader
    windows     a line for each sensor that reports echoes too near, from beyond its window
    """

    title: str
    observations: tuple[Observation, ...]
    sensors: tuple[Sensor | None, ...]
    groups: tuple[Grouping, ...]
    matched: bool
    population: str
    notes: tuple[str, ...]
    windows: tuple[str, ...] = ()
    seed: int | None = None
    sweep: Sweep | None = None

    @property
    def rated(self) -> bool:
        """Whether there are rates."""
        return all(observation.surfaces is not None for observation in self.observations)

    def group(self, key: str) -> Grouping:
        """The grouping with this key."""
        return next(grouping for grouping in self.groups if grouping.key == key)

    def against_first(self) -> list[tuple[Observation, Observation]]:
        """The first observation with each other one, where pulses match."""
        return [(self.observations[0], observation) for observation in self.observations[1:]] if self.matched else []


def verdict(comparison: Comparison) -> str:
    """The outcome in one sentence: who found more and by how much, and who measured ranges better."""
    if not comparison.rated:
        counts = [f"{observation.name} {int(np.count_nonzero(observation.is_echo)):,}" for observation in comparison.observations]
        return f"Echoes: {', '.join(counts)}; which pulses found nothing is not known, so none is called better."
    shares = [(observation.name, rate(observation.rated_surfaces)) for observation in comparison.observations]
    order = sorted(shares, key=lambda pair: -pair[1].rate)
    (best, most), (second, less), *_ = order
    other_shares = ", ".join(f"{name} {_percent(share.rate)}" for name, share in order[1:])
    if _differ(comparison, best, second):
        more = f", {100.0 * (most.rate - less.rate):.3g} percentage points more" if len(order) == 2 else ""
        outcome = f"{best} finds most, {_percent(most.rate)} of {comparison.population}{more}; {other_shares}"
    else:
        alike = f"{best} and {second} find equally many of {comparison.population}, within chance"
        outcome = f"{alike}: {best} {_percent(most.rate)}, {other_shares}"
    spread = [(errors[0].sigma_m, observation.name) for observation in comparison.observations if (errors := range_errors(observation))]
    if len(spread) < len(shares):
        return f"{outcome}."
    (finest, exact), *coarser = sorted(spread)
    other_spreads = ", ".join(f"{1e3 * sigma:.3g} mm of {name}" for sigma, name in coarser)
    return f"{outcome}. Ranges scatter least with {exact}: {1e3 * finest:.3g} mm against {other_spreads}."


def _differ(comparison: Comparison, best: str, second: str) -> bool:
    """Whether the rates of two differ by more than chance, to 95 %; pulse by pulse where pulses match."""
    a, b = (next(observation for observation in comparison.observations if observation.name == name) for name in (best, second))
    if comparison.matched:
        (pair,) = pairs(a.rated_surfaces, b.rated_surfaces)
        return pair.difference_interval[0] > 0.0
    return rate(a.rated_surfaces).interval[0] > rate(b.rated_surfaces).interval[1]


def _percent(share: float) -> str:
    return f"{100.0 * share:.2f} %"


def _between(ends: tuple[float, float]) -> str:
    return f"{100.0 * ends[0]:.2f} to {100.0 * ends[1]:.2f} %"


Table = tuple[Sequence[str], Sequence[Sequence[str]]]
"""Header and rows."""

_FATE_SHORT = ("sensor", "pulses", "met a surface", "kept", "points", "false alarms")
_RATES_SHORT = ("sensor", "found", "95 % interval", "expected", "mean range error", "deviation of range error")

FATE = (
    "sensor",
    "pulses",
    "met a surface",
    "kept",
    "lost: below threshold",
    "of these without any light",
    "lost: out of window",
    "lost: hidden",
    "points",
    "false alarms",
)


def fate(comparison: Comparison) -> Table:
    """What became of each sensor's pulses."""
    rows: list[Sequence[str]] = []
    for observation in comparison.observations:
        cells = ["-"] * 7
        if observation.surfaces is not None and observation.pulses_fired is not None:
            below, *other_losses = observation.losses.values()
            dark = np.count_nonzero(observation.surfaces.snr == 0.0)
            surface_count, found_count = len(observation.surfaces.pulse), np.count_nonzero(observation.surfaces.detected)
            numbers = (observation.pulses_fired, surface_count, found_count, below, dark, *other_losses)
            cells = [f"{count:,}" for count in numbers]
        rows.append((observation.name, *cells, f"{len(observation.cloud):,}", f"{observation.false_alarms:,}"))
    return _known(FATE, rows)


RATES = (
    "sensor",
    "found",
    "95 % interval",
    "expected",
    "found less expected",
    "mean range error",
    "deviation of range error",
)


def summary(comparison: Comparison) -> Table:
    """Rates and range errors over all pulses."""
    rows: list[Sequence[str]] = []
    for observation in comparison.observations:
        cells = ["-", "-", "-", "-"]
        if observation.surfaces is not None:
            total, deviations = rate(observation.surfaces), deviation(observation.surfaces)
            cells = [_percent(total.rate), _between(total.interval)]
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
    return _known(RATES, rows)


def _known(header: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """The table without columns of which nothing is known, or that are 0 for all."""
    columns = [i for i in range(len(header)) if any(row[i] not in ("-", "0") for row in rows)]
    return [header[i] for i in columns], [[row[i] for i in columns] for row in rows]


PAIRS = (
    "A",
    "B",
    "found by both",
    "A only",
    "B only",
    "neither",
    "rate of A less B",
    "95 % interval",
    "range of A less B, mean and deviation",
)


def pair_rows(comparison: Comparison) -> list[tuple[str, ...]]:
    """The first sensor compared with each other."""
    rows: list[tuple[str, ...]] = []
    for a, b in comparison.against_first():
        (pair,) = pairs(a.rated_surfaces, b.rated_surfaces)
        difference = paired_range_difference(a, b)
        range_apart = "-" if difference is None else f"{1e3 * difference.bias_m:+.2f} mm, {1e3 * difference.sigma_m:.2f} mm"
        rows.append(
            (
                a.name,
                b.name,
                f"{pair.both:,}",
                f"{pair.only_a:,}",
                f"{pair.only_b:,}",
                f"{pair.neither:,}",
                f"{100.0 * pair.difference:+.2f} %",
                _between(pair.difference_interval),
                range_apart,
            )
        )
    return rows


def group_table(comparison: Comparison, key: str, most: int | None = None) -> Table:
    """Header and rows of a table by class or body: found by each sensor, and by A only or B only if pulses match.

    most  most rows: those where one sensor found most pulses that the other missed, else those with most pulses
    """
    grouping = comparison.group(key)
    names = [observation.name for observation in comparison.observations]
    header = [key, f"pulses, {names[0]}", *(f"found, {name}" for name in names)]
    rates_by_sensor = [rates(observation.surfaces, grouping) for observation in comparison.observations if observation.surfaces is not None]
    pairs_by_sensor = [pairs(a.rated_surfaces, b.rated_surfaces, grouping) for a, b in comparison.against_first()]
    for a, b in comparison.against_first():
        header += [f"only {a.name}", f"only {b.name}"] if len(pairs_by_sensor) == 1 else [f"{a.name} less {b.name}"]
    order = [n for n in range(len(grouping.labels)) if any(sensor_rates[n].surfaces for sensor_rates in rates_by_sensor)]
    order.sort(key=lambda n: -max(sensor_rates[n].surfaces for sensor_rates in rates_by_sensor))
    if most is not None:
        # A body that all found alike says nothing here.
        order = [n for n in order if not pairs_by_sensor or any(sensor_pairs[n].only_a or sensor_pairs[n].only_b for sensor_pairs in pairs_by_sensor)]
        order.sort(key=lambda n: -sum(sensor_pairs[n].only_a + sensor_pairs[n].only_b for sensor_pairs in pairs_by_sensor))
    rows = []
    for n in order[:most]:
        row = [grouping.labels[n] or "unlabelled", f"{rates_by_sensor[0][n].surfaces:,}", *(_found(sensor_rates[n]) for sensor_rates in rates_by_sensor)]
        for sensor_pairs in pairs_by_sensor:
            row += (
                [f"{sensor_pairs[n].only_a:,}", f"{sensor_pairs[n].only_b:,}"] if len(pairs_by_sensor) == 1 else [f"{sensor_pairs[n].only_a - sensor_pairs[n].only_b:+,}"]
            )
        rows.append(row)
    return header, rows


def _found(group_rate: Rate) -> str:
    return f"{_percent(group_rate.rate)} ({_between(group_rate.interval)})" if group_rate.surfaces else "-"


def counts_table(comparison: Comparison, key: str) -> Table:
    """Echoes by group, if there are no rates."""
    grouping = comparison.group(key)
    counts_by_sensor = [{error.group: error.points for error in range_errors(observation, grouping)} for observation in comparison.observations]
    rows = [
        [label or "unlabelled", *(f"{counts.get(label, 0):,}" for counts in counts_by_sensor)]
        for label in dict.fromkeys(grouping.labels)
        if any(label in counts for counts in counts_by_sensor)
    ]
    heading = f"{key} [{grouping.unit}]" if grouping.unit else key
    return [heading, *(f"echoes, {observation.name}" for observation in comparison.observations)], rows


def crossing_lines(sweep: Sweep, first: str) -> list[str]:
    """A sentence for each crossing, or one that there is none."""
    lines = []
    low, high = sweep.illuminances_klux[0], sweep.illuminances_klux[-1]
    for name, crossings in sweep.crossings.items():
        if not crossings:
            lines.append(f"{first} and {name} do not change places between {low:g} and {high:g} klux.")
        lines += [_crossed(crossing) for crossing in crossings]
        plane = sweep.on_plane_klux[name]
        if plane is not None:
            lines.append(
                "On Table 1's target alone, a plane of reflectivity 0.1 in air of transmittance 0.98, "
                f"{first} and {name} reach equally far at {plane:.3g} klux."
            )
    return lines


def _crossed(crossing: Crossing) -> str:
    return (
        f"{crossing.ahead_above} overtakes {crossing.ahead_below} at {crossing.illuminance_klux:.3g} klux, where both are expected to "
        f"find {_percent(crossing.expected)}."
    )


def sweep_table(sweep: Sweep) -> Table:
    """Each sensor under each illuminance."""
    header = ["illuminance"]
    for name in sweep.courses:
        header += [f"found, {name}", "expected", "false alarms", "deviation of range error"]
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
    """For people: the verdict, a table of the sensors, then a line for each pair and each crossing."""
    lines = [verdict(comparison)]
    for short, (header, rows) in ((_FATE_SHORT, fate(comparison)), (_RATES_SHORT, summary(comparison))):
        columns = [i for i, name in enumerate(header) if name in short]
        lines += _columns([[row[i] for i in columns] for row in (("", *header[1:]), *rows)])
    for row in pair_rows(comparison):
        lines.append(
            f"{row[0]} against {row[1]}: both {row[2]}, only {row[0]} {row[3]}, only {row[1]} {row[4]}, "
            f"neither {row[5]}"
        )
    lines += comparison.windows
    if comparison.sweep is not None:
        lines += crossing_lines(comparison.sweep, comparison.observations[0].name)
    return "\n".join(lines)


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        row[0].ljust(widths[0]) + "".join(f"  {cell:>{width}}" for cell, width in zip(row[1:], widths[1:], strict=True))
        for row in rows
    ]
