"""An extension of Griffe, for the reference: the lists of our docstrings become tables.

Docstrings give the parts of a type and the parameters of a function as lines of a name, two spaces or more, and what
it is. Markdown would run such lines together.
"""

import importlib
import inspect
import re
from typing import Any

import griffe
from latex2mathml.converter import convert

# A name or several, or an expression of a few words, before two spaces or more; what it is goes on in lines further in.
ITEM = re.compile(r"^(?P<name>\S+(?:,? \S+){0,3}?) {2,}(?P<about>\S.*)$")
# `:func:`-like words, in ours single backquotes, are code already; a bar would end a cell.
BAR = re.compile(r"(?<!\\)\|")
# A displayed equation, with the lines that go on, and its number.
MATH = re.compile(r"^\.\. math:: (.*(?:\n {2,}\S.*)*)", re.MULTILINE)
TAG = re.compile(r"\\tag\{\w+\}")
# A page, and a section of it by its number.
PAGE = re.compile(r"\bdocs/(\w+)\.md(?:,? (\d+)\b)?")


class Lists(griffe.Extension):
    """Makes Markdown tables of the lists in every docstring."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called for every module, class, function and attribute."""
        if obj.docstring:
            obj.docstring.value = as_markdown(obj.docstring.value)

    def on_class_members(self, *, cls: griffe.Class, **_: Any) -> None:
        """Called for every class. One with options lists them in its docstring when it is made (`list_options`)."""
        values = [member.value for member in cls.members.values() if isinstance(member, griffe.Attribute)]
        if cls.docstring and any(isinstance(v, griffe.ExprCall) and str(v.function) == "option" for v in values):
            described = getattr(importlib.import_module(cls.module.path), cls.name)
            cls.docstring.value = as_markdown(inspect.cleandoc(described.__doc__))


def as_markdown(docstring: str) -> str:
    """The docstring with each list of "name  what it is" as a table of two columns."""
    out: list[str] = []
    rows: list[list[str]] = []
    for line in [*MATH.sub(_drawn, PAGE.sub(_link, docstring)).splitlines(), ""]:
        found = ITEM.match(line)
        if found:
            rows.append([found["name"], found["about"]])
        elif rows and line.startswith("  "):
            rows[-1][1] += " " + line.strip()
        else:
            if rows:
                out += ["", "| | |", "|---|---|", *(_row(*row) for row in rows), ""]
                rows = []
            out.append(line)
    return "\n".join(out).strip()


def _drawn(math: re.Match[str]) -> str:
    """Draw an equation as MathML, as `equations.py` does for the pages."""
    drawn = convert(TAG.sub("", " ".join(math[1].split())), display="block")
    return f'\n<div class="equation">{drawn}</div>\n'


def _link(page: re.Match[str]) -> str:
    """Link to a page of the site, by its name and the number of the section."""
    name = page[1].replace("_", " ")
    return f"[{name}{f', {page[2]}' if page[2] else ''}]({page[1]}.md)"


def _row(name: str, about: str) -> str:
    return "| `{}` | {} |".format(name, BAR.sub(r"\|", about))
