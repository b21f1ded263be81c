"""Rows in, a Markdown table out."""

from collections.abc import Iterable
from dataclasses import astuple, dataclass


@dataclass(frozen=True)
class Row:
    """One figure: what, how much, lowest to highest, a word on it, and the goal with its verdict."""

    what: str
    value: str
    spread: str = ""
    note: str = ""
    goal: str = ""


HEAD = Row("what", "median", "lowest to highest", "note", "goal")


def markdown(rows: Iterable[Row]) -> str:
    """The table."""
    lines = [astuple(HEAD), ("---", "---:", "---:", "---", "---")]
    lines += [astuple(row) for row in rows]
    return "".join("| " + " | ".join(cell.replace("|", "/") for cell in line) + " |\n" for line in lines)
