"""Rows in, a Markdown table out."""

from collections.abc import Iterable
from dataclasses import astuple, dataclass


@dataclass(frozen=True)
class Row:
    """One figure: what, how much, lowest to highest, a word on it, and the goal with its verdict."""

    quantity: str
    value: str
    spread: str = ""
    note: str = ""
    goal: str = ""


@dataclass(frozen=True)
class Section:
    """Rows that belong together, under a title, with what to know before reading them."""

    title: str
    text: str
    rows: list[Row]


def verdict(goal: str, is_met: object) -> str:
    """A goal in words, and whether it is reached."""
    return f"{goal}: {'met' if is_met else 'NOT met'}"


HEAD = Row("what", "median", "lowest to highest", "note", "goal")


def markdown(sections: Iterable[Section]) -> str:
    """A heading, the text and the table of each section."""
    return "\n".join(f"## {section.title}\n\n{section.text}\n\n{_table(section.rows)}" for section in sections)


def _table(rows: Iterable[Row]) -> str:
    lines = [astuple(HEAD), ("---", "---:", "---:", "---", "---")]
    lines += [astuple(row) for row in rows]
    return "".join("| " + " | ".join(cell.replace("|", "/") for cell in line) + " |\n" for line in lines)
