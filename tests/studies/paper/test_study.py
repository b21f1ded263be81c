"""The paper reproduced: what its figures show and its claims come to; test_claims.py has their numbers."""

import numpy as np
import pytest
from helpers.paper_results import results

from lidarscene.studies.paper import study
from lidarscene.studies.paper.case import apd_lidar, range_m
from lidarscene.studies.paper.claims import FAILS, HOLDS


@pytest.fixture(scope="module")
def claims():
    return results().claims


# --- figures ----------------------------------------------------------------------------------------


def test_fig_6b_says_which_law():
    apd, sipm, mirror = (results().column("fig-6b", name) for name in ("APD, A cos θ", "SiPM, A cos θ", "APD, mirror"))
    for curve in (apd, sipm):
        assert curve[0] == pytest.approx(curve[-1], rel=1e-9)
        assert curve[0] < curve[60]
    assert apd[60] == pytest.approx(range_m(apd_lidar()))
    assert mirror[0] > mirror[60] > mirror[-1]
    assert "A(0) cos θ" in results().figure("fig-6b").caption


def test_figures_have_axes_with_units_and_columns_with_names():
    for figure in results().figures:
        header, rows = figure.data
        assert len(header) == len(figure.drawing.lines) + 1
        assert {len(row) for row in rows} == {len(header)}
        assert np.isfinite(rows).all()
        assert figure.drawing.x_label
        assert figure.drawing.y_label


# --- claims -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("word", "verdict"),
    [
        ("less than 3e-7", HOLDS),
        ("99.977 %", HOLDS),
        ("optical noise equals electrical", FAILS),
        ("maximises the SNR", HOLDS),
        ("below 1e-2", HOLDS),
        ("ahead of the SiPM's throughout", HOLDS),
        ("sees farther", HOLDS),
        ("50 %", HOLDS),
        ("grows with the aperture area", HOLDS),
        ("shrinks with the excess noise index", HOLDS),
    ],
)
def test_claim(claims, word, verdict):
    (claim,) = [candidate for candidate in claims if word in candidate.says]
    assert claim.verdict == verdict


# --- page -------------------------------------------------------------------------------------------


def test_scanner_is_named_and_explained():
    assert "A(0) cos(theta)" in study.SCANNER
    assert "fixed in the housing" in study.SCANNER
