"""Rows in, a Markdown table out."""

from collections.abc import Iterable
from dataclasses import astuple, dataclass
from typing import Any


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
    """Rows that belong together, under a title, with what to know before reading them.

    Attributes:
        columns: heads of a table with columns of its own, whose rows are tuples of text
    """

    title: str
    text: str
    rows: list[Any]
    columns: tuple[str, ...] = ()


def verdict(goal: str, is_met: object) -> str:
    """A goal in words, and whether it is reached."""
    return f"{goal}: {'met' if is_met else 'NOT met'}"


HEAD = Row("what", "median", "lowest to highest", "note", "goal")


def markdown(sections: Iterable[Section]) -> str:
    """A heading, the text and the table of each section."""
    return "\n".join(f"## {section.title}\n\n{section.text}\n\n{_table(section)}" for section in sections)


def _table(section: Section) -> str:
    if section.columns:
        lines = [section.columns, ("---", *["---:"] * (len(section.columns) - 1)), *section.rows]
    else:
        lines = [astuple(HEAD), ("---", "---:", "---:", "---", "---"), *map(astuple, section.rows)]
    return "".join(map(line, lines))


def line(cells: Iterable[str]) -> str:
    """One line of a table."""
    return "| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |\n"
