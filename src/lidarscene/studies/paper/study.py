"""The paper reproduced and checked: a folder in; figures, their CSV and a page of claims and errata out.

The command `paper` and Python users call `write`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from ...figures.report import Report, require_writable_files
from ...files.atomic import atomic_folder
from ...files.json_text import json_text
from .claims import HOLDS, Claim, Erratum, claims_and_errata
from .figures import figures

PAGES = ("index.md", "index.html")

INTRODUCTION = (
    "X. Guo, Ranging Performance Analysis in Automotive DToF Lidars: its figures computed from its own formulas and "
    "Table 1, each claim of its text with the number behind it, and what it prints wrongly. Everything here "
    "was computed "
    "by the command lidarscene paper. Solid curves are the formulas as printed, without the floor of one "
    "cell; dashed ones are "
    "what they should have been, where that can be seen. What Table 1 leaves open: 300 K, no amplifier noise."
)

SCANNER = (
    "Fig. 6(b) needs an aperture law A(theta), and the paper gives none: 'the form of the function depends on the "
    "scanning method'. Used here: A(0) cos(theta), a receiver fixed in the housing. It is the only one of "
    "the usual laws "
    "without a further parameter that makes the range lower at both edges, as the text says. A rotating head has a "
    "constant aperture, and a single mirror at 45 degrees, A(0) cos(45 + theta/2) / cos(45), favours one "
    "edge; both are drawn "
    "beside it, and lidarscene range --over elevation --aperture-law computes all three."
)


def file_names() -> list[str]:
    """Names of all files that `write` writes."""
    stems = ("fig-4e", "fig-5a", "fig-5b", "fig-5c", "fig-6a", "fig-6b", "fig-6c")
    return [*PAGES, *(f"{stem}.{suffix}" for stem in stems for suffix in ("png", "svg", "csv"))]


def write(
    folder: Path, *, as_json: bool = False, progress: Callable[[int, int], object] = lambda done, total: None
) -> str:
    """Write all figures and both pages; returns the text to print. Raises OutputError.

    progress  called with (done, total) steps: what is computed, and each figure that is drawn
    """
    require_writable_files(folder, file_names())
    computed, total = 2, 2 + len(file_names()[len(PAGES) :: 3])
    progress(0, total)
    drawn_figures = figures()
    progress(1, total)
    claims, errata = claims_and_errata()
    progress(computed, total)
    with atomic_folder(folder) as temporary:
        report = Report("Ranging performance analysis: figures, claims, errata", temporary, embeds=False, digits=10)
        report.paragraph(INTRODUCTION)
        report.heading("Figures")
        for done, figure in enumerate(drawn_figures, start=computed + 1):
            report.figure(figure)
            progress(done, total)
        report.paragraph(SCANNER)
        report.heading("Claims")
        report.table(
            ("place", "the text says", "what we find", "verdict"),
            [(c.place, c.says, c.found, c.verdict) for c in claims],
        )
        report.heading("Errata")
        report.table(
            ("place", "printed", "derived", "size at Table 1"),
            [(e.place, e.printed, e.derived, e.size) for e in errata],
        )
        report.write(*PAGES)
    if as_json:
        return json_text(
            {
                "claims": [asdict(c) for c in claims],
                "errata": [asdict(e) for e in errata],
                "files": [str(folder / name) for name in file_names()],
            }
        )
    return _printed(folder, claims, errata)


def _printed(folder: Path, claims: list[Claim], errata: list[Erratum]) -> str:
    """A line for each claim that does not simply hold, and where to read more."""
    verdicts = Counter(c.verdict == HOLDS for c in claims)
    hold, limited = verdicts[True], verdicts[False]
    lines = [f"{len(claims)} claims of the text: {hold} hold; {limited} with a limit, in part or not at all:"]
    lines += [f"  {c.place}: {c.says} ({c.verdict})" for c in claims if c.verdict != HOLDS]
    lines.append(f"{len(errata)} errata, 7 figures")
    lines.append(f"wrote {folder / PAGES[0]}, {folder / PAGES[1]} and the figures beside them")
    return "\n".join(lines)
