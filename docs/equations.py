r"""A hook of MkDocs: equations become MathML, which browsers draw without a script or a network, and numbers links.

The pages keep `$$...$$` with `\\tag{T1}`, which GitHub draws too.
"""

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

PAGES = [*Path(__file__).parent.glob("theory*.md"), Path(__file__).parent / "photon_counting.md"]
NUMBERED = re.compile(r"\\tag\{(T\w+)\}")
# What is code stays as it is: fenced blocks and spans.
CODE = re.compile(r"(^```.*?^```$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)
PAGE_OF = {number: page.name for page in PAGES for number in NUMBERED.findall(page.read_text(encoding="utf-8"))}


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """The page's text with its equations drawn and every (T1) a link to its equation."""
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

    return re.sub(r"\((T\d+[a-z]?)\)(?!<)", link, text)
