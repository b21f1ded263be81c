"""The pages of the documentation and what stands in them: blocks, spans, files, commands, numbers."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
THEORY = tuple(sorted((ROOT / "docs").glob("theory*.md")))
ARCHITECTURE = ROOT / "ARCHITECTURE.md"
PAGES = (README, ARCHITECTURE, *sorted((ROOT / "docs").glob("*.md")))


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def page_text(page: str) -> str:
    """The text of README.md or of a page of docs/, without accounts; of the theory, that of all its pages."""
    pages = THEORY if page == "theory.md" else [README if page == README.name else ROOT / "docs" / page]
    return "\n".join(ACCOUNT.sub("", text_of(one)) for one in pages)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page, and the text block that follows it as its output, if any."""

    page: Path
    number: int
    language: str
    code: str
    output: str | None

    def __str__(self) -> str:
        return f"{self.page.name}-{self.number}"

    @property
    def file_name(self) -> str | None:
        """The name of the file that the block is, if its first line says one."""
        match = re.match(r"(?:#|<!--) (\S+\.\w+)(?: -->)?\n", self.code)
        return match[1] if match else None


def blocks(page: Path, language: str = r"\w+") -> list[Block]:
    pattern = rf"^```({language})\n(.*?)^```\n(?:\n```text\n(.*?)^```$)?"
    matches = re.finditer(pattern, text_of(page), re.MULTILINE | re.DOTALL)
    return [Block(page, i, match[1], match[2], match[3]) for i, match in enumerate(matches)]


def prose(page: Path) -> str:
    """The page without its fenced blocks and its accounts of numbers."""
    return ACCOUNT.sub("", re.sub(r"^```.*?^```$", "", text_of(page), flags=re.MULTILINE | re.DOTALL))


CODE_SPAN = r"`(?:[^`\n]|\n(?!\s*\n))+`"


def code_spans(page: Path) -> list[str]:
    """The code in its text, each piece on one line: a piece may be wrapped over lines, but not over paragraphs."""
    return [" ".join(span.strip("`").split()) for span in re.findall(CODE_SPAN, prose(page))]


def shell_lines(page: Path) -> list[str]:
    """The lines of its shell blocks without their remarks."""
    lines = [line for block in blocks(page, "sh") for line in block.code.splitlines()]
    return [re.split(" #", line)[0].strip() for line in lines]


def commands(page: Path) -> list[str]:
    """Every `lidarscene ...` line of a shell block, then every such code span that has arguments."""
    lines = [line.removeprefix(".venv/bin/") for line in (*shell_lines(page), *code_spans(page))]
    return list(dict.fromkeys(line for line in lines if line.startswith("lidarscene ")))


IN_AN_EMPTY_FOLDER = ("README.md", "recipes.md")
"""Pages whose commands need no file but those that the commands before them write."""


def make_workplace(folder: Path, page: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a folder look like the repository's root, with the files that the page shows, and go there.

    Of `IN_AN_EMPTY_FOLDER` it stays empty.
    """
    monkeypatch.chdir(folder)
    if page.name in IN_AN_EMPTY_FOLDER:
        return folder
    for name in ("scenes", "assets"):
        if not (folder / name).exists():
            (folder / name).symlink_to(ROOT / name, target_is_directory=True)
    (folder / "out").mkdir(exist_ok=True)
    for block in blocks(page):
        if block.file_name:
            (folder / block.file_name).write_text(block.code, encoding="utf-8")
    return folder


def in_order(page: Path) -> Iterator[Block]:
    """The blocks that do something, from the top of the page to its end."""
    return (block for block in blocks(page) if block.language in ("python", "sh"))


# --- numbers ----------------------------------------------------------------------------------------

NEAR = type(pytest.approx(0.0))
WORDS = ["zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"]
PLAIN = r"(?:\d{1,3}(?:[ ,]\d{3})+(?!\d)|\d+)(?:\.\d+)?(?:e[-+]?\d+)?"
SIGNED = rf"[-+]?{PLAIN}"
NUMBER = re.compile(rf"(?<![\w.^-]){SIGNED}(?![\d.]*\w)")
WORD = r"\b(?:" + "|".join(WORDS[1:]) + r")\b"

ACCOUNT = re.compile(r"<!-- = (.*?)\s-->", re.DOTALL)
"""An expression that gives the numbers before it, the last ones of the text between the account before and it."""

NO_NUMBERS = re.compile(
    r"""^```.*?^```$|<!--.*?-->|<[^>\n]+>|\$\$.*?\$\$|`[^`\n]*`  # blocks, comments, tags, equations, code
    |\]\([^)]*\)|^[#].*?$                             # links, headings
    |\((?:[ST]?\d+[a-d]?(?:,\ )?)+\)                  # numbers of equations
    |\([^()]*\b(?:18|19|20)\d\d\b[^()]*\)            # a bracket with a year is a citation
    |\b\d{4}-\d\d-\d\d\b                            # dates
    |\b(?:[Ss]ections?|Tables?|Figs?\.|[Cc]heck|[Cc]lass)\s\d+(?:(?:\s(?:and|to)\s|,\s)\d+)*
    |\b(?:Mitsuba|ROS|Argoverse|Euro\ NCAP)\s\d+     # names
    |\b(?:ISO|IEC|IEEE\ Std|ASTM|ITU-R|NREL/TP|AFGL-TR)[\ -][A-Z.]*[\d-]+  # standards and reports
    """,
    re.MULTILINE | re.DOTALL | re.VERBOSE,
)
"""What stands on a page and has no number in need of an account."""

PLAIN_WORDS = re.compile(
    r"""<!--\ (?:keys|columns|formats|materials|quantities)\b[^\n]*-->\n(?:\ *\|[^\n]*\n)+  # tables that a test writes
    |^\ *\d+\.\ |\b(?:18|19|20)\d\d\b(?!\.\d)            # numbers of lists, years
    |\b(?:Figures|CIE|glTF|OSI|revision|firmware)\s\d+(?:\.\d+)*  # names
    |\b(?:905|1550)(?=\ nm\b)                       # kinds of laser
    |\^[-(]*\d(?:/\d)?                              # powers
    |(?<![\w.])\d\ ?/\ ?(?=[(a-zA-Z])               # reciprocals, and units such as 1/s
    |(?<=[a-zA-Z)\d])/\d(?![\d.])|(?<=[a-zA-Z]\ )/\ \d(?![\d.])  # fractions
    |\b\d\ ?(?:[-+]\ [a-zA-Z(]|/\d(?![\d.])|(?:[BDReir]|pi|ln|exp|alpha)\b|sigma_\w+)|sqrt\([^()]*\)
    |[\w)]\ [<>=]{1,2}\ -?[012]\b(?![.\d])              # conditions of equations
    """,
    re.MULTILINE | re.VERBOSE,
)
"""Names and pieces of equations, whose numbers have no account unless one is behind them."""


@dataclass(frozen=True)
class Stretch:
    """The numbers of a page between two accounts, and the expression that ends them.

    Each has the words around it, and whether it is part of `PLAIN_WORDS`.
    """

    numbers: list[str]
    words: list[str]
    plain: list[bool]
    expression: str | None


def stretches(page: Path) -> Iterator[Stretch]:
    text = text_of(page)
    bare = NO_NUMBERS.sub(lambda match: re.sub(r"[^\n]", "\0", match[0]), text)
    plain = {place for match in PLAIN_WORDS.finditer(text) for place in range(match.start(), match.end())}
    start = 0
    for account in (*ACCOUNT.finditer(text), None):
        end = account.start() if account else len(text)
        found = list(NUMBER.finditer(bare, start, end))
        words = [" ".join(text[max(n.start() - 50, 0) : n.end() + 10].split()) for n in found]
        yield Stretch([n[0] for n in found], words, [n.end() - 1 in plain for n in found], account and account[1])
        start = end


def value_of(printed: str) -> tuple[float, float]:
    """A number as printed (`49,643`, `-0.07`, `2.9e-4`, `seven`) and half a unit of its last digit."""
    if printed.lower() in WORDS:
        return float(WORDS.index(printed.lower())), 0.0
    number = Decimal(re.sub("[ ,]", "", printed))
    exponent = number.as_tuple().exponent
    assert isinstance(exponent, int)
    return float(number), 0.5 * 10.0**exponent


def differs(printed: str, computed: Any) -> str:
    """Why this is not the computed number to the digits printed, or nothing.

    An approximation of pytest says its own tolerance, a string is meant word for word, `...` is any number.
    """
    if computed is ...:
        return ""
    if isinstance(computed, str):
        return "" if printed == computed else f"the page says {printed}, which is {computed}"
    value, half = value_of(printed)
    if isinstance(computed, NEAR):
        return "" if value == computed else f"the page says {printed}, computed {computed}"
    # The last digit may be rounded either way where the computed one lies in the middle.
    right = abs(value - float(computed)) <= half * (1.0 + 1e-6) + 1e-12 * abs(value)
    return "" if right else f"the page says {printed}, computed {float(computed):.9g}"


def printed_numbers(page: str, words: str) -> list[str]:
    """The numbers in place of each `{}` of these words, which stand on the page once. Line breaks do not count."""
    parts = [r"\s+".join(map(re.escape, re.split(r"\s+", part))) for part in words.split("{}")]
    pattern = rf"(?<![\d.]){f'({SIGNED}|{WORD})'.join(parts)}(?![\d%])"
    matches = list(re.finditer(pattern, page_text(page), re.IGNORECASE))
    assert len(matches) == 1, f"{page} says {len(matches)} times: {words}"
    return list(matches[0].groups())


def says(page: str, words: str, *computed: Any) -> None:
    """The numbers that `printed_numbers` finds are the computed ones, to the digits printed."""
    compare(f"{page}: {words}", printed_numbers(page, words), computed)


def compare(where: str, printed: Sequence[str], computed: Sequence[Any]) -> None:
    assert len(printed) == len(computed), f"{where}: {len(printed)} numbers, {len(computed)} computed"
    wrong = [why for pair in zip(printed, computed, strict=True) if (why := differs(*pair))]
    assert not wrong, f"{where}: {'; '.join(wrong)}"


def table(page: str, header: str) -> list[list[str]]:
    """The cells of the one table whose heading line begins so, row by row, without the heading."""
    pattern = rf"^ *\| {re.escape(header)}.*\n *\|[-:| ]+\|\n((?: *\|.*\n?)+)"
    (body,) = re.findall(pattern, page_text(page), re.MULTILINE)
    return [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in body.splitlines()]


def numbers(cell: str) -> list[str]:
    """The numbers in a cell, without those of names in code."""
    return NUMBER.findall(re.sub(r"`[^`]*`", "", cell))
