"""A report: headings, paragraphs, tables and figures in; text, Markdown, HTML, JSON and CSV out.

Every study writes its results as such a report, so that text, figures and data of a result lie together. Numbers are
written before anything is drawn: a figure that cannot be drawn is a warning, and costs no result.
"""

from __future__ import annotations

import base64
import csv
import html
import io
import itertools
import os
import re
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from ..errors import InputError, OptionWarning, OutputError, did_you_mean, warn
from ..files.arguments import checks_arguments
from ..files.atomic import atomic_folder, put_text, require_writable
from ..files.facts import Picture
from ..files.json_text import json_text
from ..maths.attributes import HintedAttributes
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

_NOTEBOOK_STYLE = """
.lidarscene figure { margin: 1rem 0; } .lidarscene figure img { width: 100%; max-width: 40rem; height: auto; }
.lidarscene .row { display: grid; grid-template-columns: repeat(auto-fit, minmax(20rem, 1fr)); gap: 0 1rem; }
.lidarscene .scroll { overflow-x: auto; } .lidarscene h1 { font-size: 1.3rem; } .lidarscene h2 { font-size: 1.1rem; }
"""

PAGE = "index.html"
"""Page of every report."""

NOT_DRAWN = "(not drawn)"
"""What a page has in place of a figure that could not be drawn."""

_MEDIA = {"png": "image/png", "csv": "text/csv"}


Table = tuple[Sequence[str], Sequence[Sequence[str]]]
"""Header and rows of text."""

Data = tuple[Sequence[str], Iterable[Sequence[Any]]]
"""Header and rows of numbers and text."""


class Figure(NamedTuple):
    """A figure and its data, from one place, so that they cannot disagree.

    Attributes:
        name: of its files, without suffix
        drawing: chart, which is drawn as PNG and SVG, or function that draws a PNG to a path
        data: table of the CSV beside it
        number: number in the report: "4(e)"; "" for figures that are called by their name
    """

    name: str
    drawing: Chart | Callable[[Path], object]
    data: Data
    caption: str
    number: str = ""

    @property
    def is_chart(self) -> bool:
        """Whether it is a chart, which is drawn as SVG too."""
        return isinstance(self.drawing, Chart)

    def draw(self, *paths: Path) -> None:
        """Draw it to files; a chart to several, of its forms.

        Raises:
            OutputError: and whatever a library raises
        """
        if isinstance(self.drawing, Chart):
            lines.save(self.drawing, paths)
        else:
            self.drawing(*paths)


class _Heading(NamedTuple):
    text: str

    def as_text(self) -> str:
        return f"\n{self.text}"

    def as_markdown(self, _: Collection[str]) -> str:
        return f"## {_escape(self.text)}"

    def as_html(self, _: _Files) -> str:
        return f"<h2>{html.escape(self.text)}</h2>"


class _Paragraph(NamedTuple):
    text: str
    lead: str = ""

    def as_text(self) -> str:
        return f"{self.lead}: {self.text}" if self.lead else self.text

    def as_markdown(self, _: Collection[str]) -> str:
        return f"**{_escape(self.lead)}.** {_escape(self.text)}" if self.lead else _escape(self.text)

    def as_html(self, _: _Files) -> str:
        lead = f"<b>{html.escape(self.lead)}.</b> " if self.lead else ""
        return f"<p>{lead}{html.escape(self.text)}</p>"


class _TableBlock(NamedTuple):
    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    def as_text(self) -> str:
        return text_table(self.header, self.rows)

    def as_markdown(self, _: Collection[str]) -> str:
        head_cells, *body_cells = ([_escape(cell) for cell in row] for row in (self.header, *self.rows))
        all_cells = [head_cells, ["---"] * len(self.header), *body_cells]
        return "\n".join("| " + " | ".join(cells) + " |" for cells in all_cells)

    def as_html(self, _: _Files) -> str:
        head = "".join(f"<th>{html.escape(cell)}</th>" for cell in self.header)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(_with_unit(cell))}</td>" for cell in row) + "</tr>\n"
            for row in self.rows
        )
        return f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>'


class _FigureBlock(NamedTuple):
    figure: Figure

    def as_text(self) -> str | None:
        return None

    @property
    def shown_name(self) -> str:
        return f"Fig. {self.figure.number}" if self.figure.number else self.figure.name

    def as_markdown(self, undrawn: Collection[str]) -> str:
        name = self.figure.name
        drawn = f"[SVG]({name}.svg), " if self.figure.is_chart and name not in undrawn else ""
        caption = f"**{self.shown_name}** {_escape(self.figure.caption)} {drawn}[CSV]({name}.csv)"
        return f"{_markdown_image(self.shown_name, name, undrawn)}\n\n{caption}"

    def as_html(self, files: _Files) -> str:
        name, is_chart = self.figure.name, self.figure.is_chart
        linked = is_chart and files.are_beside and name not in files.undrawn
        svg = f'<a href="{name}.svg">SVG</a>, ' if linked else ""
        size = ' width="1200" height="840"' if is_chart else ""
        return (
            f"<figure>{files.image(self.shown_name, name, size)}"
            f"<figcaption><b>{html.escape(self.shown_name)}</b> {html.escape(self.figure.caption)} "
            f"{svg}<a {files.link(f'{name}.csv')}>CSV</a></figcaption></figure>"
        )


class _Pictures(NamedTuple):
    captioned: Sequence[tuple[str, str]]

    def as_text(self) -> str | None:
        return None

    def as_markdown(self, undrawn: Collection[str]) -> str:
        return "\n\n".join(
            f"{_markdown_image(name, name, undrawn)}\n\n{_escape(caption)}" for name, caption in self.captioned
        )

    def as_html(self, files: _Files) -> str:
        figures = "".join(
            f"<figure>{files.image(name, name)}<figcaption>{html.escape(caption)}</figcaption></figure>"
            for name, caption in self.captioned
        )
        return f'<div class="row">{figures}</div>'


_Block = _Heading | _Paragraph | _TableBlock | _FigureBlock | _Pictures


class _Files(NamedTuple):
    """How HTML names the files of its figures.

    Attributes:
        folder: that the data are in
        embeds: whether the HTML contains them
        drawn: folder of what is drawn
        undrawn: names of figures that are not drawn
        are_beside: whether they will be beside the page
    """

    folder: Path
    embeds: bool
    drawn: Path
    undrawn: Collection[str]
    are_beside: bool = True

    def image(self, words: str, name: str, attributes: str = "") -> str:
        """Image of a figure, with words for those who do not see it."""
        if name in self.undrawn:
            return f"<p>{NOT_DRAWN}</p>"
        return f'<img src="{self.source(self.drawn, f"{name}.png")}" alt="{html.escape(words)}"{attributes}>'

    def link(self, name: str) -> str:
        """Attributes of a link to a file beside the page."""
        return f'href="{self.source(self.folder, name)}"' + (f' download="{name}"' if self.embeds else "")

    def source(self, folder: Path, name: str) -> str:
        """A file's name, or its content as a data URL if figures are embedded."""
        if not self.embeds:
            return name
        data = base64.b64encode((folder / name).read_bytes()).decode("ascii")
        return f"data:{_MEDIA[name.rpartition('.')[2]]};base64,{data}"


@checks_arguments
@dataclass(repr=False)
class Report(HintedAttributes):
    """Result of a study: blocks in order, each added once for all forms. Nothing is drawn before it is asked for.

    Attributes:
        numbers: all numbers of the result by name, as its JSON file has them
        main_table: header and rows of the numbers that `table` gives; None: those of the first table of the page
        summary: text that a command prints; "": that of all blocks
        passed: whether all limits that the study holds something to are met; None: there are none
        pages: files of the page and of the numbers, in the form of each name's suffix
        embeds: whether the HTML contains the figures, so that it can be sent alone; False: it links to files beside it
        columns: whether figures that follow each other stand side by side, where there is room
        digits: of the numbers in CSV files
        undrawn: names of the figures that `save` or `write` could not draw
    """

    MADE_BY: ClassVar[str] = "studies make one, such as lidarscene.max_range(sensor)"
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("to_pandas", "to_dataframe", "df", "to_dict"), "pandas.DataFrame(report.table)"),
        **dict.fromkeys(("to_csv", "to_json", "to_excel"), "report.save(folder) writes CSV, JSON and pictures"),
        **dict.fromkeys(("data", "results", "values"), "report.table has columns, report.numbers all numbers"),
        **dict.fromkeys(("max_range", "ranges", "range", "range_m"), 'report.table["range_m"]'),
        **dict.fromkeys(("show", "figure", "figures"), "report.plot()"),
        **dict.fromkeys(("to_html", "html", "open"), "report.save(folder) writes the page"),
        "keys": "report.table has columns by name",
        **dict.fromkeys(("print", "text", "describe"), "print(report)"),
    }

    title: str
    numbers: Any = None
    main_table: Data | None = None
    summary: str = ""
    passed: bool | None = None
    pages: tuple[str, ...] = (PAGE,)
    embeds: bool = True
    columns: bool = False
    digits: int = 7
    undrawn: set[str] = field(default_factory=set)
    _blocks: list[_Block] = field(default_factory=list)
    # Name of a file of numbers -> function that writes it to a path.
    _files: dict[str, Callable[[Path], object]] = field(default_factory=dict)
    # Name of a figure or picture -> its suffixes, and function that draws it to so many paths.
    _drawings: dict[str, tuple[tuple[str, ...], Callable[..., object]]] = field(default_factory=dict)

    def add_heading(self, text: str) -> None:
        """Add a heading of the second level."""
        self._blocks.append(_Heading(text))

    def add_paragraph(self, text: str, lead: str = "") -> None:
        """Add a paragraph of plain text; ``lead`` stands before it in bold: what it answers."""
        self._blocks.append(_Paragraph(text, lead))

    def add_table(self, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Add a table of plain text."""
        self._blocks.append(_TableBlock(header, rows))

    def add_figure(self, figure: Figure) -> None:
        """Add a figure, with its data as CSV beside it."""
        self._blocks.append(_FigureBlock(figure))
        self._drawings[figure.name] = (".png", ".svg") if figure.is_chart else (".png",), figure.draw
        self.add_data(figure.name, figure.data)

    def add_pictures(self, pictures: Sequence[tuple[str, str, Callable[[Path], object]]]) -> None:
        """Add PNGs, side by side if there is room: (name without suffix, caption, function that draws to a path)."""
        self._blocks.append(_Pictures([(name, caption) for name, caption, _ in pictures]))
        self._drawings |= {name: ((".png",), draw) for name, _, draw in pictures}

    def add_data(self, name: str, data: Data) -> None:
        """Add a table as CSV beside the page; ``name`` is without suffix."""
        header, rows = data[0], data[1] if isinstance(data[1], Sequence) else list(data[1])
        self.add_file(f"{name}.csv", lambda path: put_text(path, csv_text(header, rows, digits=self.digits)))

    def add_file(self, name: str, write: Callable[[Path], object]) -> None:
        """Add a file beside the page, which a function writes to a path."""
        self._files[name] = write

    def __repr__(self) -> str:
        return f"Report({self.title!r}: {', '.join(self.file_names)})"

    def __str__(self) -> str:
        return self.summary or self.as_text()

    @property
    def file_names(self) -> list[str]:
        """Names of all files that `save` writes; without what could not be drawn."""
        drawn = (file for file, figure in self._figure_files.items() if figure not in self.undrawn)
        return [*self.pages, *self._files, *drawn]

    @property
    def figure_names(self) -> list[str]:
        """Names of the figures and pictures that `plot` draws, in the order of the page."""
        return list(self._drawings)

    @property
    def _figure_files(self) -> dict[str, str]:
        """File of a figure or picture -> its name."""
        return {f"{name}{suffix}": name for name, (suffixes, _) in self._drawings.items() for suffix in suffixes}

    @property
    def table(self) -> dict[str, list[Any]]:
        """Column -> values of the main table, as pandas.DataFrame takes them; numbers where they are known as such."""
        if self.main_table is None:
            first = next((block for block in self._blocks if isinstance(block, _TableBlock)), _TableBlock((), ()))
            header, rows = first.header, [list(row) for row in first.rows]
        else:
            header, rows = self.main_table[0], [list(row) for row in self.main_table[1]]
        return {name: [row[column] for row in rows] for column, name in enumerate(header)}

    def __getitem__(self, column: str) -> list[Any]:
        """Return a column of `table`.

        Raises:
            InputError: for an unknown one
        """
        table = self.table
        if column not in table:
            meant = did_you_mean(column, table)
            raise InputError(f"report[{column!r}]: {meant}{' ' if meant else ''}must be one of {', '.join(table)}")
        return table[column]

    def plot(self, name: str | None = None) -> Picture:
        """Draw a figure of the report, or its first; a notebook shows it.

        A figure that cannot be drawn raises OutputError.

        Raises:
            InputError: for an unknown name
        """
        drawings = self._drawings
        if not drawings:
            raise InputError(f"plot: '{self.title}' has no figures; its numbers are its table")
        name = next(iter(drawings)) if name is None else name
        if name not in drawings:
            raise InputError(f"plot: must be one of {', '.join(drawings)}, got {name!r}")
        return Picture.drawn(partial(self._draw, name))

    def save(
        self, folder: str | os.PathLike[str], *, progress: Callable[[int, int], object] = lambda done, total: None
    ) -> None:
        """Write the data and the page into a folder, all or none; then draw the figures into it and onto the page.

        A figure that cannot be drawn is a warning: its name is in `undrawn`, and the page says so.

        Args:
            progress: called with (done, total) files

        Raises:
            OutputError: if a result cannot be written
        """
        total = len(self._files) + len(self._drawings)
        self.undrawn = set(self._drawings)
        progress(0, total)
        with atomic_folder(folder) as temporary:
            for done, (name, write) in enumerate(self._files.items(), start=1):
                (temporary / name).parent.mkdir(exist_ok=True)
                write(temporary / name)
                progress(done, total)
            self._put_pages(self.pages, _Files(temporary, self.embeds, temporary, self.undrawn))
        if not self._drawings:
            return
        with atomic_folder(folder) as temporary:
            for done, (name, (suffixes, _)) in enumerate(self._drawings.items(), start=len(self._files) + 1):
                self._try_to_draw(name, *(temporary / f"{name}{suffix}" for suffix in suffixes))
                progress(done, total)
            illustrated = [page for page in self.pages if Path(page).suffix in (".html", ".md")]
            self._put_pages(illustrated, _Files(Path(folder), self.embeds, temporary, self.undrawn))

    def write(self, name: str, path: str | os.PathLike[str]) -> None:
        """Write one of the files beside the page to a path; a chart's in the form of the path's suffix.

        A figure that cannot be drawn is a warning, and its name is in `undrawn`.

        Raises:
            InputError: for a name that is none of `file_names`
            OutputError: if a result cannot be written
        """
        figures = self._figure_files
        if name in figures:
            lines.suffix_of(path)
            self._try_to_draw(figures[name], Path(path))
        elif name in self._files:
            self._files[name](Path(path))
        else:
            raise InputError(f"write: must be one of {', '.join([*self._files, *figures])}, got {name!r}")

    def as_json(self) -> str:
        """JSON text of the numbers; a number that is not finite is null."""
        return json_text(self.numbers, indent=1)

    def as_text(self) -> str:
        """The blocks so far as plain text, without title and figures."""
        return "\n".join(text for block in self._blocks if (text := block.as_text()) is not None)

    def as_markdown(self) -> str:
        """The page in Markdown."""
        blocks = (block.as_markdown(self.undrawn) for block in self._blocks)
        return "\n\n".join([f"# {_escape(self.title)}", *blocks]) + "\n"

    def _repr_html_(self) -> str:
        """The page for a notebook, with all figures in it."""
        with tempfile.TemporaryDirectory() as folder:
            for name, write in self._files.items():
                if name.endswith(".csv"):
                    write(Path(folder) / name)
            for name in self._drawings:
                self._try_to_draw(name, Path(folder) / f"{name}.png")
            files = _Files(Path(folder), True, Path(folder), self.undrawn, are_beside=False)
            body = "\n".join(self._body(files))
        heading = f"<h1>{html.escape(self.title)}</h1>"
        return f'<style>{_NOTEBOOK_STYLE}</style>\n<div class="lidarscene">{heading}\n{body}</div>'

    def _draw(self, name: str, *paths: Path) -> None:
        """Draw a figure to paths.

        Raises:
            OutputError: whatever goes wrong in the libraries that draw
        """
        try:
            self._drawings[name][1](*paths)
        except OutputError:
            raise
        except Exception as error:
            raise _UndrawnError(f"figure '{name}': cannot be drawn: {type(error).__name__}: {error}") from error

    def _try_to_draw(self, name: str, *paths: Path) -> None:
        """Draw a figure to paths, and keep `undrawn`: a figure that cannot be drawn is a warning."""
        try:
            self._draw(name, *paths)
            self.undrawn.discard(name)
        except _UndrawnError as error:
            self.undrawn.add(name)
            warn(OptionWarning("{0}; the numbers are not affected", error))

    def _put_pages(self, names: Iterable[str], files: _Files) -> None:
        """Write pages, each in the form of its suffix, into the folder of what is drawn."""
        for name in names:
            match Path(name).suffix:
                case ".html":
                    text = self._as_html(files)
                case ".md":
                    text = self.as_markdown()
                case _:
                    text = self.as_json() + "\n"
            put_text(files.drawn / name, text)

    def _body(self, files: _Files) -> Iterator[str]:
        """Yield the HTML of all blocks, figures side by side if `columns` is set."""
        for is_figure, blocks in itertools.groupby(self._blocks, lambda block: isinstance(block, _FigureBlock)):
            if is_figure and self.columns:
                yield f'<div class="row">{"".join(block.as_html(files) for block in blocks)}</div>'
            else:
                yield from (block.as_html(files) for block in blocks)

    def _as_html(self, files: _Files) -> str:
        """The page in HTML, including its style."""
        title, wide = html.escape(self.title), ' class="wide"' if self.columns else ""
        return (
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{title}</title>\n<style>{_STYLE}</style>\n</head>\n<body{wide}>\n<h1>{title}</h1>\n"
            + "\n".join(self._body(files))
            + "\n</body>\n</html>\n"
        )


class _UndrawnError(OutputError):
    """Raised when a figure cannot be drawn."""


def require_writable_report(folder: str | os.PathLike[str]) -> None:
    """Check that a report can be written into a folder, before any work is done.

    Raises:
        OutputError: if a result cannot be written
    """
    require_writable(Path(folder) / PAGE)


def without_empty_columns(
    header: Sequence[str], rows: Sequence[Sequence[str]], empty: Collection[str] = ("",)
) -> Table:
    """Table without the columns whose cells are all ``empty``."""
    filled = [column for column in range(len(header)) if any(row[column] not in empty for row in rows)]
    return [header[column] for column in filled], [tuple(row[column] for column in filled) for row in rows]


_NUMBER = re.compile(r"[-+]?[\d,]*\.?\d+(e[-+]?\d+)?( ?%)?|nan|inf|-|")


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], align: str = "") -> str:
    """Text of a table in columns.

    Args:
        align: "<" or ">" for each column, the last one for all further ones; "": numbers to the right, text to the left
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


def _markdown_image(words: str, name: str, undrawn: Collection[str]) -> str:
    """Image of a figure in Markdown."""
    return NOT_DRAWN if name in undrawn else f"![{words}]({name}.png)"


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
