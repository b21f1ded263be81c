"""Claims and errata of the paper: sentences of sentences.toml, with the numbers that numbers.py computes.

Every verdict is computed when it is asked for, so it cannot become outdated.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources
from typing import Any

from . import numbers

HOLDS, FAILS = "holds", "does not hold"


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """A sentence of the paper (in our words), its place, what we find, and the verdict."""

    place: str
    says: str
    found: str
    verdict: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Erratum:
    """What the paper prints at a place, what follows from its own equations, and the size of the difference."""

    place: str
    printed: str
    derived: str
    size: str


def claims_and_errata() -> tuple[list[Claim], list[Erratum]]:
    """All claims in the paper's order, and all errata, formulas first."""
    sentences = tomllib.loads((resources.files(__package__) / "sentences.toml").read_text(encoding="utf-8"))
    names = {entry["numbers"] for entries in sentences.values() for entry in entries if "numbers" in entry}
    computed = {name: numbers.FUNCTIONS[name]() for name in sorted(names)}
    claims = [_claim(entry, computed[entry["numbers"]]) for entry in sentences["claims"]]
    errata = [_erratum(entry, computed.get(entry.get("numbers"), {})) for entry in sentences["errata"]]
    return claims, errata


def _claim(entry: dict[str, str], values: dict[str, Any]) -> Claim:
    verdict = entry.get("verdict", HOLDS).format(**values)
    if "holds_if" in entry and not values[entry["holds_if"]]:
        verdict = entry.get("otherwise", FAILS)
    return Claim(place=entry["place"], says=entry["says"], found=entry["found"].format(**values), verdict=verdict)


def _erratum(entry: dict[str, str], values: dict[str, Any]) -> Erratum:
    size = entry.get("size", "none").format(**values)
    return Erratum(place=entry["place"], printed=entry["printed"], derived=entry["derived"], size=size)
