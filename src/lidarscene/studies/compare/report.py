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

    everything  the observations; the first is compared with each other one
    sensors     of each observation; None for a cloud from a file
    groups      how pulses are grouped
    matched     whether equal pulse numbers mean the same pulse for all
    of          what rates are shares of, in words
    notes       how the comparison was made, for the reader
    windows     a line for each sensor that reports echoes too near, from beyond its window
    """

    title: str
    everything: tuple[Observation, ...]
    sensors: tuple[Sensor | None, ...]
    groups: tuple[Grouping, ...]
    matched: bool
    of: str
    notes: tuple[str, ...]
    windows: tuple[str, ...] = ()
    seed: int | None = None
    swept: Sweep | None = None

    @property
    def rated(self) -> bool:
        """Whether there are rates."""
        return all(one.surfaces is not None for one in self.everything)

    def group(self, key: str) -> Grouping:
        """The grouping with this key."""
        return next(one for one in self.groups if one.key == key)

    def against_first(self) -> list[tuple[Observation, Observation]]:
        """The first observation with each other one, where pulses match."""
        return [(self.everything[0], other) for other in self.everything[1:]] if self.matched else []


def verdict(comparison: Comparison) -> str:
    """The outcome in one sentence: who found more and by how much, and who measured ranges better."""
    if not comparison.rated:
        counts = [f"{one.name} {int(np.count_nonzero(one.is_echo)):,}" for one in comparison.everything]
        return f"Echoes: {', '.join(counts)}; which pulses found nothing is not known, so none is called better."
    shares = [(one.name, rate(one.counted)) for one in comparison.everything]
    order = sorted(shares, key=lambda pair: -pair[1].rate)
    (best, most), (second, less), *_ = order
    told = ", ".join(f"{name} {_percent(one.rate)}" for name, one in order[1:])
    if _differ(comparison, best, second):
        more = f", {100.0 * (most.rate - less.rate):.3g} percentage points more" if len(order) == 2 else ""
        found = f"{best} finds most, {_percent(most.rate)} of {comparison.of}{more}; {told}"
    else:
        alike = f"{best} and {second} find equally many of {comparison.of}, within chance"
        found = f"{alike}: {best} {_percent(most.rate)}, {told}"
    spread = [(errors[0].sigma_m, one.name) for one in comparison.everything if (errors := range_errors(one))]
    if len(spread) < len(shares):
        return f"{found}."
    (finest, exact), *others = sorted(spread)
    told = ", ".join(f"{1e3 * sigma:.3g} mm of {name}" for sigma, name in others)
    return f"{found}. Ranges scatter least with {exact}: {1e3 * finest:.3g} mm against {told}."


def _differ(comparison: Comparison, best: str, second: str) -> bool:
    """Whether the rates of two differ by more than chance, to 95 %; pulse by pulse where pulses match."""
    a, b = (next(one for one in comparison.everything if one.name == name) for name in (best, second))
    if comparison.matched:
        (pair,) = pairs(a.counted, b.counted)
        return pair.difference_interval[0] > 0.0
    return rate(a.counted).interval[0] > rate(b.counted).interval[1]


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
    for one in comparison.everything:
        cells = ["-"] * 7
        if one.surfaces is not None and one.fired is not None:
            below, *lost = one.lost.values()
            dark = np.count_nonzero(one.surfaces.snr == 0.0)
            met, found = len(one.surfaces.pulse), np.count_nonzero(one.surfaces.found)
            numbers = (one.fired, met, found, below, dark, *lost)
            cells = [f"{n:,}" for n in numbers]
        rows.append((one.name, *cells, f"{len(one.cloud):,}", f"{one.alarms:,}"))
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
    for one in comparison.everything:
        cells = ["-", "-", "-", "-"]
        if one.surfaces is not None:
            all_of, apart = rate(one.surfaces), deviation(one.surfaces)
            cells = [_percent(all_of.rate), _between(all_of.interval)]
            cells += ["-" if all_of.expected is None else _percent(all_of.expected)]
            cells += ["-" if apart is None else f"{apart:+.1f} standard deviations"]
        errors = range_errors(one)
        error_cells = ("-", "-")
        if errors:
            e = errors[0]
            error_cells = (
                f"{1e3 * e.bias_m:+.2f} ± {1e3 * e.bias_interval_m:.2f} mm",
                f"{1e3 * e.sigma_m:.2f} ± {1e3 * e.sigma_interval_m:.2f} mm",
            )
        rows.append((one.name, *cells, *error_cells))
    return _known(RATES, rows)


def _known(header: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """The table without columns of which nothing is known, or that are 0 for all."""
    kept = [i for i in range(len(header)) if any(row[i] not in ("-", "0") for row in rows)]
    return [header[i] for i in kept], [[row[i] for i in kept] for row in rows]


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
        (p,) = pairs(a.counted, b.counted)
        apart = paired_range_difference(a, b)
        range_apart = "-" if apart is None else f"{1e3 * apart.bias_m:+.2f} mm, {1e3 * apart.sigma_m:.2f} mm"
        rows.append(
            (
                a.name,
                b.name,
                f"{p.both:,}",
                f"{p.only_a:,}",
                f"{p.only_b:,}",
                f"{p.neither:,}",
                f"{100.0 * p.difference:+.2f} %",
                _between(p.difference_interval),
                range_apart,
            )
        )
    return rows


def group_table(comparison: Comparison, key: str, most: int | None = None) -> Table:
    """Header and rows of a table by class or body: found by each sensor, and by A only or B only if pulses match.

    most  most rows: those where one sensor found most pulses that the other missed, else those with most pulses
    """
    grouping = comparison.group(key)
    names = [one.name for one in comparison.everything]
    header = [key, f"pulses, {names[0]}", *(f"found, {name}" for name in names)]
    table = [rates(one.surfaces, grouping) for one in comparison.everything if one.surfaces is not None]
    between = [pairs(a.counted, b.counted, grouping) for a, b in comparison.against_first()]
    for a, b in comparison.against_first():
        header += [f"only {a.name}", f"only {b.name}"] if len(between) == 1 else [f"{a.name} less {b.name}"]
    order = [n for n in range(len(grouping.labels)) if any(one[n].surfaces for one in table)]
    order.sort(key=lambda n: -max(one[n].surfaces for one in table))
    if most is not None:
        # A body that all found alike says nothing here.
        order = [n for n in order if not between or any(p[n].only_a or p[n].only_b for p in between)]
        order.sort(key=lambda n: -sum(p[n].only_a + p[n].only_b for p in between))
    rows = []
    for n in order[:most]:
        row = [grouping.labels[n] or "unlabelled", f"{table[0][n].surfaces:,}", *(_found(one[n]) for one in table)]
        for p in between:
            row += (
                [f"{p[n].only_a:,}", f"{p[n].only_b:,}"] if len(between) == 1 else [f"{p[n].only_a - p[n].only_b:+,}"]
            )
        rows.append(row)
    return header, rows


def _found(one: Rate) -> str:
    return f"{_percent(one.rate)} ({_between(one.interval)})" if one.surfaces else "-"


def counts_table(comparison: Comparison, key: str) -> Table:
    """Echoes by group, if there are no rates."""
    grouping = comparison.group(key)
    counted = [{e.group: e.points for e in range_errors(one, grouping)} for one in comparison.everything]
    rows = [
        [label or "unlabelled", *(f"{one.get(label, 0):,}" for one in counted)]
        for label in dict.fromkeys(grouping.labels)
        if any(label in one for one in counted)
    ]
    named = f"{key} [{grouping.unit}]" if grouping.unit else key
    return [named, *(f"echoes, {one.name}" for one in comparison.everything)], rows


def crossing_lines(swept: Sweep, first: str) -> list[str]:
    """A sentence for each crossing, or one that there is none."""
    lines = []
    low, high = swept.illuminances_klux[0], swept.illuminances_klux[-1]
    for name, crossed in swept.crossings.items():
        if not crossed:
            lines.append(f"{first} and {name} do not change places between {low:g} and {high:g} klux.")
        lines += [_crossed(one) for one in crossed]
        plane = swept.on_plane_klux[name]
        if plane is not None:
            lines.append(
                "On Table 1's target alone, a plane of reflectivity 0.1 in air of transmittance 0.98, "
                f"{first} and {name} reach equally far at {plane:.3g} klux."
            )
    return lines


def _crossed(one: Crossing) -> str:
    return (
        f"{one.ahead_above} overtakes {one.ahead_below} at {one.illuminance_klux:.3g} klux, where both are expected to "
        f"find {_percent(one.expected)}."
    )


def sweep_table(swept: Sweep) -> Table:
    """Each sensor under each illuminance."""
    header = ["illuminance"]
    for name in swept.courses:
        header += [f"found, {name}", "expected", "false alarms", "deviation of range error"]
    rows = []
    for number, lux in enumerate(swept.illuminances_klux):
        row = [f"{lux:g} klux"]
        for course in swept.courses.values():
            lit = course[number]
            sigma = "-" if lit.sigma_m is None else f"{1e3 * lit.sigma_m:.1f} mm"
            row += [_percent(lit.rate.rate), _percent(lit.rate.expected or 0.0), f"{lit.false_alarms:,}", sigma]
        rows.append(row)
    return header, rows


def as_text(comparison: Comparison) -> str:
    """For people: the verdict, a table of the sensors, then a line for each pair and each crossing."""
    lines = [verdict(comparison)]
    for short, (header, rows) in ((_FATE_SHORT, fate(comparison)), (_RATES_SHORT, summary(comparison))):
        kept = [i for i, name in enumerate(header) if name in short]
        lines += _columns([[row[i] for i in kept] for row in (("", *header[1:]), *rows)])
    for row in pair_rows(comparison):
        lines.append(
            f"{row[0]} against {row[1]}: both {row[2]}, only {row[0]} {row[3]}, only {row[1]} {row[4]}, "
            f"neither {row[5]}"
        )
    lines += comparison.windows
    if comparison.swept is not None:
        lines += crossing_lines(comparison.swept, comparison.everything[0].name)
    return "\n".join(lines)


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        row[0].ljust(widths[0]) + "".join(f"  {cell:>{width}}" for cell, width in zip(row[1:], widths[1:], strict=True))
        for row in rows
    ]
