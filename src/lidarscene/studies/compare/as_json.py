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
    result: dict[str, Any] = {
        "title": comparison.title,
        "verdict": verdict(comparison),
        "matched": comparison.matched,
        "rates_are_shares_of": comparison.population,
        "seed": comparison.seed,
        "notes": [*comparison.notes, *comparison.windows],
        "sensors": [_observation(comparison, observation) for observation in comparison.observations],
        "pairs": [_pair(comparison, a, b) for a, b in comparison.against_first()],
    }
    if comparison.sweep is not None:
        result["sweep"] = _sweep(comparison.sweep)
    return result


def _sweep(swept: Sweep) -> dict[str, Any]:
    return {
        "illuminances_klux": list(swept.illuminances_klux),
        "courses": {
            name: [
                {
                    "illuminance_klux": step.illuminance_klux,
                    **_rate(step.rate),
                    "false_alarms": step.false_alarms,
                    "sigma_m": step.sigma_m,
                }
                for step in course
            ]
            for name, course in swept.courses.items()
        },
        "crossings": {name: [asdict(crossing) for crossing in crossings] for name, crossings in swept.crossings.items()},
        "on_plane_klux": swept.on_plane_klux,
    }


def _observation(comparison: Comparison, observation: Observation) -> dict[str, Any]:
    errors = range_errors(observation)
    result: dict[str, Any] = {
        "name": observation.name,
        "pulses": observation.pulses_fired,
        "points": len(observation.cloud),
        "false_alarms": observation.false_alarms,
        "lost": {key.replace(" ", "_"): count for key, count in observation.losses.items()},
        "range_error": asdict(errors[0]) if errors else None,
        "range_error_by_range": [asdict(error) for error in range_errors(observation, comparison.group("range"))],
    }
    if observation.surfaces is not None:
        result |= {"rate": _rate(rate(observation.surfaces)), "deviation_from_expected": deviation(observation.surfaces)}
        result["rates"] = {
            group.key: [_rate(group_rate) for group_rate in rates(observation.surfaces, group) if group_rate.surfaces] for group in comparison.groups
        }
    return result


def _pair(comparison: Comparison, a: Observation, b: Observation) -> dict[str, Any]:
    (total,) = pairs(a.rated_surfaces, b.rated_surfaces)
    range_difference = paired_range_difference(a, b)
    return {
        "a": a.name,
        "b": b.name,
        **_pairing(total),
        "range_difference": asdict(range_difference) if range_difference else None,
        "by": {
            group.key: [_pairing(pair) for pair in pairs(a.rated_surfaces, b.rated_surfaces, group) if pair.pulses]
            for group in comparison.groups
        },
    }


def _rate(group_rate: Rate) -> dict[str, Any]:
    return asdict(group_rate) | {"rate": group_rate.rate, "interval": list(group_rate.interval)}


def _pairing(pair: Pair) -> dict[str, Any]:
    return asdict(pair) | {"difference": pair.difference, "interval": list(pair.difference_interval)}
