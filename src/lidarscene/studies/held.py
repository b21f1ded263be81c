"""Quantities held to limits: the row that every judging study yields, and the one table of all limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

from ..figures.report import Data, Table, without_empty_columns

MOST_NAMED = 3
"""Largest number of missed limits that `verdict` names."""


class Limits(NamedTuple):
    """Lowest and highest accepted value, both included, and why these; None: no limit on that side."""

    low: float | None = None
    high: float | None = None
    source: str = ""

    def __str__(self) -> str:
        """Text for tables, such as "0.8 to 1.25"; empty without limits."""
        if self.low is not None and self.high is not None:
            return f"{self.low:.3g} to {self.high:.3g}"
        if self.high is not None:
            return f"at most {self.high:.3g}"
        return "" if self.low is None else f"at least {self.low:.3g}"

    def include(self, value: float) -> bool:
        """True if the value is within, ends included; False for NaN."""
        return bool(
            (-math.inf if self.low is None else self.low) <= value <= (math.inf if self.high is None else self.high)
        )

    def shifted(self, by: float) -> Limits:
        """Limits that are higher by so much."""
        low, high = (None if end is None else end + by for end in self[:2])
        return self._replace(low=low, high=high)


UNLIMITED = Limits()


def _either_way(ratio: float, source: str) -> Limits:
    """Limits of a ratio and of its inverse."""
    return Limits(1.0 / ratio, ratio, source)


_CHOICE = "this project's choice"
_HAIDER = "; Haider et al., Sensors 22, 7556, 2022, reach on known targets: "

# No standard sets limits for simulated lidars. docs/recordings.md and docs/fit.md have what three Ousters reach.
LIMITS = {
    # Of a twin beside its recording.
    "beam direction": Limits(None, 0.01, f"{_CHOICE}: median angle between beams, degrees"),
    "ring direction": Limits(None, 0.02, f"{_CHOICE}: degrees; packets have azimuths in steps of 0.01"),
    "range bias": Limits(-10.0, 10.0, f"{_CHOICE}: median on smooth surfaces, mm{_HAIDER}2 cm"),
    "nearer returns": Limits(None, 0.02, f"{_CHOICE}: share, of edges between two columns"),
    "points": Limits(-0.05, 0.05, f"{_CHOICE}: relative difference{_HAIDER}8.5 %"),
    "points of a ring": Limits(-0.10, 0.10, f"{_CHOICE}: relative difference of any ring"),
    "returns kept": Limits(0.95, None, f"{_CHOICE}: share of the recorded returns"),
    "losses kept": Limits(None, 0.50, f"{_CHOICE}: share of the recorded losses"),
    "losses kept again": Limits(None, 0.10, f"{_CHOICE}: excess over the recorded share of other turns or columns"),
    "kept share": Limits(-0.05, 0.05, f"{_CHOICE}: difference in any octave of the range, pixel by pixel at rest"),
    "told apart": Limits(None, 0.7, f"{_CHOICE}: balanced accuracy; two recorded frames at rest have 0.50 to 0.52"),
    "disagreement": Limits(None, 0.03, f"{_CHOICE}: excess over the disagreement of two recorded frames"),
    "farthest ground": Limits(-0.15, 0.15, f"{_CHOICE}: relative difference of the 99.9 % quantile"),
    "clusters": Limits(0.8, None, f"{_CHOICE}: share, over that of the recorded pulses that the twin is made of"),
    "second returns": _either_way(1.5, f"{_CHOICE}: ratio of the shares"),
    "second separation": Limits(-0.15, 0.15, f"{_CHOICE}: relative difference of the least separation"),
    # Of twins, fits and the catalogue.
    "signal error": Limits(None, 0.15, f"uncertainty of recorded reflectivities: mean over the range{_HAIDER}9.3 %"),
    "signal ratio": _either_way(1.15, "as the signal error"),
    "scatter ratio": _either_way(1.25, f"{_CHOICE}: ratio at one signal, in each octave"),
    "scatter ratio, target assumed": _either_way(1.5, f"{_CHOICE}: signal and light are not recorded"),
    "elevations": Limits(None, 0.05, f"{_CHOICE}: rms of all channels, degrees; a Pandar64 is 0.02 from nominal"),
    "step ratio": _either_way(1.01, f"{_CHOICE}: steps are whole numbers of a unit"),
    "threshold ratio": _either_way(
        1.2, "uncertainty of a recorded floor, steps of a photon; of the highest noise, too"
    ),
    "share of returns": Limits(None, 0.1, f"{_CHOICE}: mean difference; three recorded Ousters have 0.05 to 0.07"),
    # Of the catalogue beside published ranges.
    "brighter over darker": Limits(0.0, None, "no maker publishes a range that falls with reflectivity"),
    # Of eye safety: limit over emission.
    "margin": Limits(1.0, None, "IEC 60825-1:2014, 4.3 f"),
}
"""Name -> limits, with the source of each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """A quantity held to its limits, one row of a report.

    Attributes:
        subject: sensor, viewer or other part that the quantity is of; "" if the whole report is of one
        condition: where or how it was found, in words
        reference: recorded, published or prescribed value; None: there is none
        simulated: simulated or modelled value; None: there is none
        value: number that the limits are for: their difference, ratio, or a share; None: not to be judged, NaN: fails
        unit: unit of the reference and the simulated value, and of a value that is a difference
        note: what else there is to say
    """

    subject: str = ""
    quantity: str
    condition: str = ""
    reference: float | None = None
    simulated: float | None = None
    value: float | None = None
    limits: Limits = UNLIMITED
    unit: str = ""
    note: str = ""

    @property
    def verdict(self) -> bool | None:
        """True if the value is within its limits, ends included; None without limits or value."""
        return self.limits.include(self.value) if self.is_limited and self.value is not None else None

    @property
    def is_limited(self) -> bool:
        """True if the quantity has a limit, whether its value is known or not."""
        return self.limits.low is not None or self.limits.high is not None

    @property
    def is_shown(self) -> bool:
        """True if the row has a number, or a limit that nothing could be held to."""
        return self.is_limited or (self.reference, self.simulated, self.value) != (None, None, None)

    def as_dict(self, **keys: str) -> dict[str, Any]:
        """The row for JSON.

        Args:
            keys: field -> its key, where that is another word; subject and note are left out without one
        """
        row = asdict(self)
        low, high, _ = row.pop("limits")
        row |= {"low": low, "high": high, "unit": row.pop("unit"), "met": self.verdict}
        fields = row.keys() - {"subject", "note"} | keys.keys()
        return {keys.get(field, field): row[field] for field in row if field in fields}


def ratio(simulated: float | None, reference: float | None) -> float | None:
    """Simulated over reference value; None if one of them is unknown or the reference is 0."""
    return simulated / reference if simulated is not None and reference else None


def relative(simulated: float | None, reference: float | None) -> float | None:
    """Relative difference of the simulated from the reference value; None as in `ratio`."""
    share = ratio(simulated, reference)
    return None if share is None else share - 1.0


def passed(rows: Sequence[Held]) -> bool:
    """True if no row misses its limits."""
    return all(row.verdict is not False for row in rows)


def verdict(rows: Sequence[Held], whole: str) -> str:
    """Outcome in one sentence: how many limits are met, which are not, and for which there is no value.

    Args:
        whole: what is judged, to begin the sentence: "The twin"
    """
    limited = [row for row in rows if row.verdict is not None]
    missed = [row for row in limited if not row.verdict]
    unmeasured = [_name(row) for row in rows if row.is_limited and row.value is None]
    not_measured = f"; not measured: {', '.join(unmeasured)}" if unmeasured else ""
    if not limited:
        return f"{whole} has nothing that can be held to a limit{not_measured}."
    if not missed:
        count = f"all {len(limited)} limits" if len(limited) > 1 else "the one limit"
        return f"{whole} meets {count}{' that could be measured' if unmeasured else ''}{not_measured}."
    misses = [f"{_name(row)}, {value_text(row.value)} where {row.limits} is allowed" for row in missed[:MOST_NAMED]]
    more = [f"{len(missed) - MOST_NAMED} more"] if len(missed) > MOST_NAMED else []
    count = f"{len(limited) - len(missed)} of {len(limited)} limits"
    return f"{whole} meets {count}; it misses {'; '.join(misses + more)}{not_measured}."


def _name(row: Held) -> str:
    """Name of a row within a sentence."""
    where = ", ".join(text for text in (row.subject, row.condition) if text)
    return f"'{row.quantity} ({where})'" if where else f"'{row.quantity}'"


def value_text(value: float | None) -> str:
    """Text of a number for tables: four digits, or all before the point; an unknown one is empty."""
    if value is None:
        return ""
    return f"{value:,}" if isinstance(value, int) else f"{value:,.0f}" if 1e4 <= abs(value) < 1e9 else f"{value:.4g}"


def held_table(rows: Sequence[Held], *, percent: bool = False, **headings: str) -> Table:
    """Header and cells of the rows, without columns that are empty in all of them.

    Args:
        percent: write values in per cent, with their signs
        headings: column -> its heading, where it is not the name of the field
    """
    marks = {None: "", True: "met", False: "NOT MET"}
    columns = ("subject", "quantity", "condition", "reference", "simulated", "value", "limit", "", "note")
    cells = [
        (
            row.subject,
            f"{row.quantity} [{row.unit}]" if row.unit else row.quantity,
            row.condition,
            value_text(row.reference),
            value_text(row.simulated),
            f"{row.value:+z.1%}" if percent and row.value is not None else value_text(row.value),
            str(row.limits),
            "not measured" if row.is_limited and row.value is None else marks[row.verdict],
            row.note,
        )
        for row in rows
    ]
    return without_empty_columns([headings.get(column, column) for column in columns], cells)


def held_data(rows: Sequence[Held], **headings: str) -> Data:
    """Header and values of the rows, numbers as numbers, for `Report.main_table`; ``headings`` as in `held_table`."""
    columns = ("subject", "quantity", "condition", "unit", "reference", "simulated", "value", "low", "high", "met")
    values = [row.as_dict(subject="subject", note="note") for row in rows]
    return [headings.get(column, column) for column in columns], [[row[column] for column in columns] for row in values]
