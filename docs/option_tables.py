"""A hook of MkDocs, for the reference: a class of options gets the table of them.

mkdocstrings reads sources, and the docstring of such a class gets its options when it is made (`list_options`).
"""

import re
from dataclasses import is_dataclass
from typing import Any

import lidarscene
from lidarscene.rendering.option_fields import options_of

NAME = re.compile(r"^::: lidarscene\.(\w+)$", re.MULTILINE)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page's text with a table below the name of each class of options."""
    return NAME.sub(lambda found: found[0] + _table(getattr(lidarscene, found[1])), markdown)


def _table(shown: object) -> str:
    options = options_of(shown) if isinstance(shown, type) and is_dataclass(shown) else {}
    rows = [f"| `{name}` | {declaration.help} |" for name, (_, declaration) in options.items()]
    return "\n".join(["\n", "| Option | Meaning |", "|---|---|", *rows, ""]) if rows else ""
