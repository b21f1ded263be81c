"""A hook of MkDocs: every notebook becomes a page, with its text, its code and what the code showed.

Other pages link to the notebook's file, which GitHub draws; on the site the links lead to the page.
"""

import base64
import json
import re
import tomllib
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
REPOSITORY = PROJECT["urls"]["Repository"]

NOTEBOOK_LINK = re.compile(r"(\]\([\w/.]*notebooks/\w+)\.ipynb")


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add a page for each notebook, and its pictures."""
    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        stem = file.src_uri.removesuffix(".ipynb")
        cells = json.loads(file.content_string)["cells"]
        pictures = [picture for cell in cells for picture in _pictures(cell)]
        for number, picture in enumerate(pictures):
            files.append(File.generated(config, f"{stem}_{number}.png", content=base64.b64decode(picture)))
        files.append(File.generated(config, f"{stem}.md", content=_page(file.name, cells)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page's text with links to notebooks' pages in place of links to their files."""
    return NOTEBOOK_LINK.sub(r"\1.md", markdown)


def _pictures(cell: dict[str, Any]) -> Iterator[str]:
    return (output["data"]["image/png"] for output in cell.get("outputs", ()) if "image/png" in output.get("data", {}))


def _page(name: str, cells: list[dict[str, Any]]) -> str:
    title, *blocks = (block for cell in cells for block in _blocks(cell))
    heading, _, rest = title.partition("\n")
    download = f"[This page as a notebook]({name}.ipynb), to run and to change{_services(name)}."
    numbers = count()
    text = "\n\n".join([heading, download, rest.strip(), *blocks])
    return re.sub(r"\(PICTURE\)", lambda _: f"({name}_{next(numbers)}.png)", text)


def _services(name: str, repository: str = REPOSITORY) -> str:
    """Links that open a notebook in Colab and in Binder, which take repositories of GitHub alone."""
    of_github = re.fullmatch(r"https://github\.com/([\w.-]+/[\w.-]+?)(?:\.git)?/?", repository)
    if of_github is None:
        return ""
    colab = f"https://colab.research.google.com/github/{of_github[1]}/blob/main/docs/notebooks/{name}.ipynb"
    binder = f"https://mybinder.org/v2/gh/{of_github[1]}/HEAD?labpath=docs%2Fnotebooks%2F{name}.ipynb"
    return f", or open it in [Colab]({colab}) or [Binder]({binder})"


def _blocks(cell: dict[str, Any]) -> Iterator[str]:
    """Markdown of a cell and of what it showed; pictures by the word PICTURE."""
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        yield source
        return
    yield f"```python\n{source}\n```"
    for output in cell["outputs"]:
        data = output.get("data", {"text/plain": output.get("text", ())})
        if "image/png" in data:
            yield "![What the cell above draws](PICTURE)"
        elif "text/html" in data:
            yield "".join(data["text/html"])
        else:
            yield "```text\n" + "".join(data["text/plain"]).rstrip() + "\n```"
