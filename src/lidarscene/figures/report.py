"""A report: headings, paragraphs, tables and figures in; text, Markdown, HTML, JSON and CSV out.

Every study writes its results as such a report, so that text, figures and data of a result lie together.
"""

from __future__ import annotations

import base64
import csv
import html
import io
import itertools
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from ..files.atomic import put_text, require_writable
from ..files.json_text import json_text
from . import lines
from .lines import Chart

_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; max-width: 62rem;
  margin: 2rem auto; padding: 0 1rem; }
body.wide { max-width: 84rem; } body.wide p { max-width: 62rem; }
h1 { font-size: 1.6rem; line-height: 1.25; } h2 { font-size: 1.25rem; margin-top: 2.5rem; }
figure { margin: 2rem 0; } figure img { width: 100%; max-width: 46rem; height: auto; }
figcaption { color: #444; max-width: 46rem; }
.scroll { overflow-x: auto; margin: 1.2rem 0; }
table { border-collapse: collapse; width: 100%; font-size: .92rem; }
th, td { text-align: left; vertical-align: top; padding: .4rem .7rem .4rem 0; border-bottom: 1px solid #ddd; }
th { border-bottom: 2px solid #1a1a1a; } td:first-child { min-width: 6rem; }
a { color: #0072b2; }
.row { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(30rem, 100%), 1fr)); gap: 0 1.5rem; }
.row figure { margin: 1rem 0; }
"""

_MEDIA = {"png": "image/png", "csv": "text/csv"}


Table = tuple[Sequence[str], Sequence[Sequence[str]]]
"""Header and rows of text."""

Data = tuple[Sequence[str], Iterable[Sequence[Any]]]
"""Header and rows of numbers and text."""


class Figure(NamedTuple):
    """A figure and its data, from one place, so that they cannot disagree.

    name     of its files, without suffix
    drawing  chart, which is drawn as PNG and SVG, or function that draws a PNG to a path
    data     table of the CSV beside it
    number   number in the report: "4(e)"; "" for figures that are called by their name
    """

    name: str
    drawing: Chart | Callable[[Path], object]
    data: Data
    caption: str
    number: str = ""


@dataclass
class Report:
    """Blocks in order, each added once for all forms.

    folder   of the report and its figures
    embeds   whether the HTML contains the figures, so that it can be sent alone; False: it links to the files beside it
    columns  whether figures that follow each other stand side by side, where there is room
    digits   of the numbers in CSV files
    """

    title: str
    folder: Path = Path()
    embeds: bool = True
    columns: bool = False
    digits: int = 7
    text: list[str] = field(default_factory=list)
    markdown: list[str] = field(default_factory=list)
    body: list[str] = field(default_factory=list)

    def heading(self, text: str) -> None:
        """Add a heading of the second level."""
        self.text.append(f"\n{text}")
        self.markdown.append(f"## {_escape(text)}")
        self.body.append(f"<h2>{html.escape(text)}</h2>")

    def paragraph(self, text: str) -> None:
        """Add a paragraph of plain text."""
        self.text.append(text)
        self.markdown.append(_escape(text))
        self.body.append(f"<p>{html.escape(text)}</p>")

    def figure(self, figure: Figure) -> None:
        """Draw a figure, write its CSV and add both. Raises OutputError."""
        name, drawing, data, caption, number = figure
        is_chart = isinstance(drawing, Chart)
        if isinstance(drawing, Chart):
            lines.save(drawing, [self.folder / f"{name}.png", self.folder / f"{name}.svg"])
        else:
            drawing(self.folder / f"{name}.png")
        self.data(name, data)
        shown_name = f"Fig. {number}" if number else name
        drawn = f"[SVG]({name}.svg), " if is_chart else ""
        linked = f'<a href="{name}.svg">SVG</a>, ' if is_chart else ""
        size = ' width="1200" height="840"' if is_chart else ""
        self.markdown.append(
            f"![{shown_name}]({name}.png)\n\n**{shown_name}** {_escape(caption)} {drawn}[CSV]({name}.csv)"
        )
        self.body.append(
            f'<figure><img src="{self._source(f"{name}.png")}" alt="{html.escape(shown_name)}"{size}>'
            f"<figcaption><b>{html.escape(shown_name)}</b> {html.escape(caption)} "
            f"{linked}<a {self._link(f'{name}.csv')}>CSV</a></figcaption></figure>"
        )

    def data(self, name: str, data: Data) -> None:
        """Write a table as CSV beside the report. Raises OutputError."""
        put_text(self.folder / f"{name}.csv", csv_text(*data, digits=self.digits))

    def pictures(self, captioned: Sequence[tuple[str, str]]) -> None:
        """Add PNGs, side by side if there is room: (name without suffix, caption) of each."""
        self.markdown += [f"![{name}]({name}.png)\n\n{_escape(caption)}" for name, caption in captioned]
        figures = "".join(
            f'<figure><img src="{self._source(f"{name}.png")}" alt="{html.escape(name)}">'
            f"<figcaption>{html.escape(caption)}</figcaption></figure>"
            for name, caption in captioned
        )
        self.body.append(f'<div class="row">{figures}</div>')

    def _source(self, name: str) -> str:
        """A file's name, or its content as a data URL if figures are embedded."""
        if not self.embeds:
            return name
        data = base64.b64encode((self.folder / name).read_bytes()).decode("ascii")
        return f"data:{_MEDIA[name.rpartition('.')[2]]};base64,{data}"

    def _link(self, name: str) -> str:
        """The attributes of a link to a file beside the page."""
        return f'href="{self._source(name)}"' + (f' download="{name}"' if self.embeds else "")

    def table(self, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Add a table of plain text."""
        self.text.append(text_table(header, rows))
        head_cells, *body_cells = ([_escape(cell) for cell in row] for row in (header, *rows))
        all_cells = [head_cells, ["---"] * len(header), *body_cells]
        self.markdown.append("\n".join("| " + " | ".join(cells) + " |" for cells in all_cells))
        head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(_with_unit(cell))}</td>" for cell in row) + "</tr>\n" for row in rows
        )
        self.body.append(
            f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>'
        )

    def as_text(self) -> str:
        """The blocks so far as plain text, without title and figures."""
        return "\n".join(self.text)

    def as_markdown(self) -> str:
        """The page in Markdown."""
        return "\n\n".join([f"# {_escape(self.title)}", *self.markdown]) + "\n"

    def _blocks(self) -> Iterator[str]:
        """Yield the HTML of all blocks, figures side by side if `columns` is set."""
        for is_figure, blocks in itertools.groupby(self.body, lambda block: block.startswith("<figure>")):
            if is_figure and self.columns:
                yield f'<div class="row">{"".join(blocks)}</div>'
            else:
                yield from blocks

    def as_html(self) -> str:
        """The page in HTML, including its style."""
        title, wide = html.escape(self.title), ' class="wide"' if self.columns else ""
        return (
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{title}</title>\n<style>{_STYLE}</style>\n</head>\n<body{wide}>\n<h1>{title}</h1>\n"
            + "\n".join(self._blocks())
            + "\n</body>\n</html>\n"
        )

    def write(self, *names: str, numbers: Any = None) -> None:
        """Write the report into its folder, in the form of each name's suffix. Raises OutputError.

        numbers  content of the JSON
        """
        for name in names:
            match Path(name).suffix:
                case ".html":
                    text = self.as_html()
                case ".md":
                    text = self.as_markdown()
                case _:
                    text = json_text(numbers, indent=1) + "\n"
            put_text(self.folder / name, text)


def require_writable_files(folder: Path, names: Iterable[str]) -> None:
    """Check that all files can be written, before any work is done. Raises OutputError."""
    for name in names:
        require_writable(folder / name)


def without_empty_columns(
    header: Sequence[str], rows: Sequence[Sequence[str]], empty: Collection[str] = ("",)
) -> Table:
    """Table without the columns whose cells are all ``empty``."""
    filled = [column for column in range(len(header)) if any(row[column] not in empty for row in rows)]
    return [header[column] for column in filled], [tuple(row[column] for column in filled) for row in rows]


_NUMBER = re.compile(r"[-+]?[\d,]*\.?\d+(e[-+]?\d+)?( ?%)?|nan|inf|-|")


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], align: str = "") -> str:
    """Text of a table in columns.

    align  "<" or ">" for each column, the last one for all further ones; "": numbers to the right, text to the left
    """
    columns = list(zip(header, *rows, strict=True))
    if not align:
        align = "".join(">" if all(map(_NUMBER.fullmatch, cells)) else "<" for _, *cells in columns)
    align = align.ljust(len(columns), align[-1:])
    widths = [max(map(len, column)) for column in columns]
    return "\n".join(
        "  ".join(f"{cell:{side}{width}}" for cell, side, width in zip(row, align, widths, strict=True)).rstrip()
        for row in (header, *rows)
    )


def csv_text(header: Sequence[str], rows: Iterable[Any], *, digits: int = 7) -> str:
    """Return a table as CSV, numbers to so many digits."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([f"{cell:.{digits}g}" if isinstance(cell, float) else cell for cell in row] for row in rows)
    return out.getvalue()


def _with_unit(text: str) -> str:
    """Keep numbers on one line with their units, by no-break spaces."""
    return re.sub(r"(?<=\d) (?=(?:%|s|m|mm|cm|km|ns|W)(?!\w))", "\N{NO-BREAK SPACE}", text)


def count_text(number: int, noun: str) -> str:
    """Return a number with its noun: "1 frame", "2 frames"."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def _escape(text: str) -> str:
    """Escape Markdown's special characters, also for tables."""
    # The backslash first; brackets make links, and a line break would end the table, heading or paragraph.
    for letter in "\\|*_`[]":
        text = text.replace(letter, "\\" + letter)
    # Not all programs know an escaped angle bracket; some make a tag of it.
    return html.escape(" ".join(text.split()), quote=False)
