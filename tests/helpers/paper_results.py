"""What the study of the paper finds, computed once for all its tests, with all workers of xdist.

It takes some ten seconds, and three files of tests look at it.
"""

import os
import pickle
import tempfile
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from lidarscene.figures.report import Figure
from lidarscene.studies.paper import figures as drawn
from lidarscene.studies.paper import study
from lidarscene.studies.paper.claims import Claim, Erratum, claims_and_errata


class Results(NamedTuple):
    figures: list[Figure]
    claims: list[Claim]
    errata: list[Erratum]

    def figure(self, name: str) -> Figure:
        (match,) = (figure for figure in self.figures if figure.name == name)
        return match

    def column(self, figure: str, name: str | None = None) -> Any:
        """The numbers of a curve of a figure, or of its axis."""
        header, rows = self.figure(figure).data
        return np.array(rows)[:, header.index(name) if name else 0]


@cache
def results() -> Results:
    """Computed, or read where another process of this run has; two at the same time write the same."""
    path = Path(os.environ["LIDARSCENE_CACHE"]) / "paper_results.pickle"  # of this run alone: tests/conftest.py
    if path.exists():
        pickled: Results = pickle.loads(path.read_bytes())
        return pickled
    fresh = Results(drawn.figures(), *claims_and_errata())
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        file.write(pickle.dumps(fresh))
    Path(file.name).replace(path)
    return fresh


def use(patch: pytest.MonkeyPatch, fixed: Results) -> None:
    """The study finds these, which are its own: it asks the same functions."""
    own = {"figures": drawn.figures, "claims_and_errata": claims_and_errata}
    assert {name: getattr(study, name) for name in own} == own
    patch.setattr(study, "figures", lambda: fixed.figures)
    patch.setattr(study, "claims_and_errata", lambda: (fixed.claims, fixed.errata))
