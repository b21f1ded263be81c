"""A comparison as a dictionary for JSON.

Numbers keep their units in their names; null means not known.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from .data import Observation
from .numbers import Pair, Rate, deviation, paired_range_difference, pairs, range_errors, rate, rates
from .report import Comparison, verdict
from .run import Sweep


def as_dict(comparison: Comparison) -> dict[str, Any]:
    """All results; null for unknown numbers."""
    told: dict[str, Any] = {
        "title": comparison.title,
        "verdict": verdict(comparison),
        "matched": comparison.matched,
        "rates_are_shares_of": comparison.of,
        "seed": comparison.seed,
        "notes": [*comparison.notes, *comparison.windows],
        "sensors": [_observation(comparison, one) for one in comparison.everything],
        "pairs": [_pair(comparison, a, b) for a, b in comparison.against_first()],
    }
    if comparison.swept is not None:
        told["sweep"] = _sweep(comparison.swept)
    return told


def _sweep(swept: Sweep) -> dict[str, Any]:
    return {
        "illuminances_klux": list(swept.illuminances_klux),
        "courses": {
            name: [
                {
                    "illuminance_klux": lit.illuminance_klux,
                    **_rate(lit.rate),
                    "false_alarms": lit.false_alarms,
                    "sigma_m": lit.sigma_m,
                }
                for lit in course
            ]
            for name, course in swept.courses.items()
        },
        "crossings": {name: [asdict(c) for c in crossed] for name, crossed in swept.crossings.items()},
        "on_plane_klux": swept.on_plane_klux,
    }


def _observation(comparison: Comparison, one: Observation) -> dict[str, Any]:
    total = range_errors(one)
    told: dict[str, Any] = {
        "name": one.name,
        "pulses": one.fired,
        "points": len(one.cloud),
        "false_alarms": one.alarms,
        "lost": {key.replace(" ", "_"): n for key, n in one.lost.items()},
        "range_error": asdict(total[0]) if total else None,
        "range_error_by_range": [asdict(e) for e in range_errors(one, comparison.group("range"))],
    }
    if one.surfaces is not None:
        told |= {"rate": _rate(rate(one.surfaces)), "deviation_from_expected": deviation(one.surfaces)}
        told["rates"] = {
            group.key: [_rate(r) for r in rates(one.surfaces, group) if r.surfaces] for group in comparison.groups
        }
    return told


def _pair(comparison: Comparison, a: Observation, b: Observation) -> dict[str, Any]:
    (total,) = pairs(a.counted, b.counted)
    apart = paired_range_difference(a, b)
    return {
        "a": a.name,
        "b": b.name,
        **_pairing(total),
        "range_difference": asdict(apart) if apart else None,
        "by": {
            group.key: [_pairing(p) for p in pairs(a.counted, b.counted, group) if p.pulses]
            for group in comparison.groups
        },
    }


def _rate(one: Rate) -> dict[str, Any]:
    return asdict(one) | {"rate": one.rate, "interval": list(one.interval)}


def _pairing(one: Pair) -> dict[str, Any]:
    return asdict(one) | {"difference": one.difference, "interval": list(one.difference_interval)}
