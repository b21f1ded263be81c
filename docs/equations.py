r"""A hook of MkDocs: equations become MathML, which browsers draw without a script or a network, and numbers links.

The pages keep `$$...$$` with `\\tag{T1}`, which GitHub draws too. Docstrings have `.. math::` and name pages.
"""

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from markdown import Extension, Markdown
from markdown.preprocessors import Preprocessor

PAGES = [page for name in ("theory*", "photon_counting", "sipm") for page in Path(__file__).parent.glob(f"{name}.md")]
NUMBERED = re.compile(r"\\tag\{(T\w+)\}")
# What is code stays as it is: fenced blocks and spans.
CODE = re.compile(r"(^```.*?^```$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)
# A displayed equation of a docstring, with the lines that go on.
MATH = re.compile(r"^\.\. math:: (.*(?:\n {2,}\S.*)*)", re.MULTILINE)
# A page that a docstring names, and a section of it by its number.
NAMED_PAGE = re.compile(r"(?<![\w/])(?<!\]\()docs/(\w+)\.md(?:,? (\d+)\b)?")
PAGE_OF = {number: page.name for page in PAGES for number in NUMBERED.findall(page.read_text(encoding="utf-8"))}


class Equations(Extension):
    """Draws and links before Markdown reads a page or a docstring."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Called for the Markdown of the pages and for that of the docstrings."""
        md.preprocessors.register(_Equations(md), "equations", priority=100)


class _Equations(Preprocessor):
    def run(self, lines: list[str]) -> list[str]:
        return drawn("\n".join(lines)).split("\n")


def on_config(config: Any) -> None:
    """Pages and docstrings are read with the same extensions."""
    config.markdown_extensions.append(Equations())


def drawn(markdown: str) -> str:
    """The text with its equations drawn, every (T1) a link to its equation, and every page that is named a link."""
    parts = CODE.split(markdown)
    parts[::2] = [_linked(_drawn(part)) for part in parts[::2]]
    return "".join(parts)


def on_page_content(html: str, **_: Any) -> str:
    """Long names in tables may break after dots, slashes and underscores: tables stay as wide as the page."""
    return CELL.sub(lambda cell: NAME.sub(lambda name: BREAK.sub(r"\1<wbr>", name[0]), cell[0]), html)


CELL = re.compile(r"<td[ >].*?</td>", re.DOTALL)
NAME = re.compile(r"(?<=<code>)[^<]{16,}(?=</code>)")
BREAK = re.compile(r"([/._]|::)(?=\w)")


def _drawn(text: str) -> str:
    text = MATH.sub(lambda found: f"\n{equation(' '.join(found[1].split()))}\n", text)
    return re.sub(r"\$\$(.+?)\$\$", lambda found: equation(found[1]), text, flags=re.DOTALL)


def equation(latex: str) -> str:
    """One displayed equation as HTML, with its number at the right and as its anchor."""
    number = NUMBERED.search(latex)
    drawn = convert(NUMBERED.sub("", latex).strip(), display="block")
    label = f'<span class="number">({number[1]})</span>' if number else ""
    anchor = f' id="{number[1]}"' if number else ""
    source = html.escape(latex.strip(), quote=True).replace("\n", " ")
    return f'<div class="equation"{anchor} title="{source}">{drawn}{label}</div>'


def _linked(text: str) -> str:
    def link(found: re.Match[str]) -> str:
        return f"[({found[1]})]({PAGE_OF[found[1]]}#{found[1]})" if found[1] in PAGE_OF else found[0]

    def page(found: re.Match[str]) -> str:
        name = found[1].replace("_", " ")
        return f"[{name}{f', {found[2]}' if found[2] else ''}]({found[1]}.md)"

    return NAMED_PAGE.sub(page, re.sub(r"\((T\d+[a-z]?)\)(?!<)", link, text))
