"""What the study of the paper finds, computed once for all its tests, with all workers of xdist.

It takes some ten seconds, and three files of tests look at it.
"""

import os
import pickle
import tempfile
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from lidarscene.studies.paper import figures as drawn
from lidarscene.studies.paper import study
from lidarscene.studies.paper.claims_model import Claim, claims_of_the_model
from lidarscene.studies.paper.claims_results import claims_of_the_results
from lidarscene.studies.paper.errata import Erratum, errata


class Results(NamedTuple):
    figures: list[drawn.PaperFigure]
    of_the_model: list[Claim]
    of_the_results: list[Claim]
    errata: list[Erratum]

    @property
    def claims(self) -> list[Claim]:
        return [*self.of_the_model, *self.of_the_results]

    def figure(self, file: str) -> drawn.PaperFigure:
        (one,) = (figure for figure in self.figures if figure.file == file)
        return one


@cache
def results() -> Results:
    """Computed, or read where another process of this run has; two at the same time write the same."""
    if not (kept := _kept()).exists():
        return computed()
    found: Results = pickle.loads(kept.read_bytes())
    return found


def computed() -> Results:
    """Computed here, and kept for the others."""
    found = Results(drawn.figures(), claims_of_the_model(), claims_of_the_results(), errata())
    with tempfile.NamedTemporaryFile(dir=_kept().parent, delete=False) as file:
        file.write(pickle.dumps(found))
    Path(file.name).replace(_kept())
    return found


def _kept() -> Path:
    return Path(os.environ["LIDARSCENE_CACHE"]) / "paper_results.pickle"  # of this run alone: tests/conftest.py


def use(patch: pytest.MonkeyPatch, known: Results) -> None:
    """The study finds these, which are its own: it asks the same functions."""
    asked = study.figures, study.claims_of_the_model, study.claims_of_the_results, study.errata
    assert asked == (drawn.figures, claims_of_the_model, claims_of_the_results, errata)
    patch.setattr(study, "figures", lambda: known.figures)
    patch.setattr(study, "claims_of_the_model", lambda: known.of_the_model)
    patch.setattr(study, "claims_of_the_results", lambda: known.of_the_results)
    patch.setattr(study, "errata", lambda: known.errata)
