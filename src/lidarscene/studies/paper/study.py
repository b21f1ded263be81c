"""The paper reproduced and checked: a report of its figures, claims and errata.

The command `paper` and Python users call `paper_report`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict

from ...figures.report import Report
from .claims import HOLDS, Claim, Erratum, claims_and_errata
from .figures import figures

PAGES = ("index.html", "index.md")

INTRODUCTION = (
    "X. Guo, Ranging Performance Analysis in Automotive DToF Lidars: its figures computed from its own formulas and "
    "Table 1, each claim of its text with the number behind it, and what it prints wrongly. Everything here "
    "was computed "
    "by the command lidarscene paper. Solid curves are the formulas as printed, without the floor of one "
    "cell; dashed ones are "
    "what they should have been, where that can be seen. What Table 1 leaves open: 300 K, no amplifier noise. "
    "A maximum range is the paper's: where the SNR is TNR, so that P_d is one half."
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


def paper_report(*, progress: Callable[[int, int], object] = lambda done, total: None) -> Report:
    """Compute all figures, claims and errata.

    Args:
        progress: called with (done, total) steps
    """
    progress(0, 2)
    drawn_figures = figures()
    progress(1, 2)
    claims, errata = claims_and_errata()
    progress(2, 2)
    report = Report(
        "Ranging performance analysis: figures, claims, errata",
        numbers={"claims": [asdict(c) for c in claims], "errata": [asdict(e) for e in errata]},
        summary=_summary(claims, errata),
        pages=PAGES,
        embeds=False,
        digits=10,
    )
    report.add_paragraph(INTRODUCTION)
    report.add_heading("Figures")
    for figure in drawn_figures:
        report.add_figure(figure)
    report.add_paragraph(SCANNER)
    report.add_heading("Claims")
    report.add_table(
        ("place", "the text says", "what we find", "verdict"), [(c.place, c.says, c.found, c.verdict) for c in claims]
    )
    report.add_heading("Errata")
    report.add_table(
        ("place", "printed", "derived", "size at Table 1"), [(e.place, e.printed, e.derived, e.size) for e in errata]
    )
    return report


def _summary(claims: list[Claim], errata: list[Erratum]) -> str:
    """A line for each claim that does not simply hold, and where to read more."""
    verdicts = Counter(c.verdict == HOLDS for c in claims)
    hold, limited = verdicts[True], verdicts[False]
    lines = [f"{len(claims)} claims of the text: {hold} hold; {limited} with a limit, in part or not at all:"]
    lines += [f"  {c.place}: {c.says} ({c.verdict})" for c in claims if c.verdict != HOLDS]
    lines.append(f"{len(errata)} errata, 7 figures")
    return "\n".join(lines)
