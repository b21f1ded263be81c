"""A hook of MkDocs: a long table of keys is folded below the names of its keys, so that a page can be read through."""

import re
from typing import Any

KEYS = re.compile(r"^<!-- keys .* -->\n((?:\|.*\n)+)", re.MULTILINE)
KEY = re.compile(r"^\| (`\w+`) \|", re.MULTILINE)

SHORT = 5
"""Keys of a table that stays open."""


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page's text with its long tables of keys folded."""
    return KEYS.sub(lambda table: _folded(table[1]), markdown)


def _folded(table: str) -> str:
    names = KEY.findall(table)
    if len(names) <= SHORT:
        return table
    summary = ", ".join(f"<code>{name.strip('`')}</code>" for name in names)
    return f'<details markdown="1" class="keys">\n<summary>{summary}</summary>\n\n{table}\n</details>\n'
