"""The pages of the documentation and what stands in them: blocks, spans, files, commands."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = (README, *sorted((ROOT / "docs").glob("*.md")))


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


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
        named = re.match(r"(?:#|<!--) (\S+\.\w+)(?: -->)?\n", self.code)
        return named[1] if named else None


def blocks(page: Path, language: str = r"\w+") -> list[Block]:
    pattern = rf"^```({language})\n(.*?)^```\n(?:\n```text\n(.*?)^```$)?"
    found = re.finditer(pattern, text_of(page), re.MULTILINE | re.DOTALL)
    return [Block(page, i, match[1], match[2], match[3]) for i, match in enumerate(found)]


def prose(page: Path) -> str:
    """The page without its fenced blocks."""
    return re.sub(r"^```.*?^```$", "", text_of(page), flags=re.MULTILINE | re.DOTALL)


def code_spans(page: Path) -> list[str]:
    return re.findall(r"`([^`\n]+)`", prose(page))


def shell_lines(page: Path) -> list[str]:
    """The lines of its shell blocks without their remarks."""
    lines = [line for block in blocks(page, "sh") for line in block.code.splitlines()]
    return [re.split(" #", line)[0].strip() for line in lines]


def commands(page: Path) -> list[str]:
    """Every `lidarscene ...` line of a shell block, then every such code span that has arguments."""
    lines = [line.removeprefix(".venv/bin/") for line in (*shell_lines(page), *code_spans(page))]
    return list(dict.fromkeys(line for line in lines if line.startswith("lidarscene ")))


def make_workplace(folder: Path, page: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a folder look like the repository's root, with the files that the page shows, and go there."""
    for name in ("scenes", "assets"):
        if not (folder / name).exists():
            (folder / name).symlink_to(ROOT / name, target_is_directory=True)
    (folder / "out").mkdir(exist_ok=True)
    for block in blocks(page):
        if block.file_name:
            (folder / block.file_name).write_text(block.code, encoding="utf-8")
    monkeypatch.chdir(folder)
    return folder


def in_order(page: Path) -> Iterator[Block]:
    """The blocks that do something, from the top of the page to its end."""
    return (block for block in blocks(page) if block.language in ("python", "sh"))
