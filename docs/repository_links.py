"""A hook of MkDocs: links to files outside docs/ lead to the repository, whose address pyproject.toml has."""

import re
import tomllib
from pathlib import Path
from typing import Any

from mkdocs.structure.pages import Page

PROJECT = tomllib.loads(Path(__file__).parents[1].joinpath("pyproject.toml").read_text(encoding="utf-8"))["project"]
REPOSITORY = PROJECT["urls"]["Changelog"].removesuffix("CHANGELOG.md")
PARENT = re.compile(r"(?<=\]\()\.\./")


def on_page_markdown(markdown: str, *, page: Page, **_: Any) -> str:
    """The page's text with the repository's address in place of the folder above docs/."""
    return markdown if "/" in page.file.src_uri else PARENT.sub(REPOSITORY, markdown)
