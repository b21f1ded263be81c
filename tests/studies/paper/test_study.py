"""The paper reproduced: figures against the formulas, claims and errata against numbers from elsewhere."""

import math
import re

import numpy as np
import pytest
from helpers.paper_results import results
from scipy.constants import c, e, h, k

from lidarscene.studies.paper import case, study
from lidarscene.studies.paper.claims import FAILS, HOLDS
from lidarscene.studies.paper.numbers import closed_forms

PHOTON = h * c / 905e-9


@pytest.fixture(scope="module")
def claims():
    return results().claims


def column(figure, name):
    header, rows = figure.data
    return np.array(rows)[:, header.index(name)]


def first_column(figure):
    return np.array(figure.data[1])[:, 0]


def interpolated(figure, name, x):
    """A column at a place between its points, along logarithms."""
    return math.exp(np.interp(math.log(x), np.log(first_column(figure)), np.log(column(figure, name))))


# --- figures ----------------------------------------------------------------------------------------


def test_fig_4e_by_hand():
    """(19) typed out again."""
    figure = results().figure("fig-4e")
    gain = first_column(figure)
    aperture = math.pi * 0.025**2
    echo = 0.98**2 * 0.7206 * 0.1 * 45 * aperture / (math.pi * 100**2)
    sun = 29.4 * 0.7986 * 0.98 * 0.1 * aperture * (1e-4 / 0.03) ** 2 * 0.5
    responsivity = e * 0.7 / PHOTON
    grown = gain**2.3
    variance = 2 * e * 167e6 * (responsivity * sun * grown + 1e-10 * grown + 1e-10) + 4 * k * 300 * 167e6 / 1e4
    assert column(figure, "100 klux") == pytest.approx(responsivity * gain * echo / np.sqrt(variance), rel=1e-9)
    best = gain[np.argmax(column(figure, "100 klux"))]
    assert best == pytest.approx(30.87, rel=0.02)  # the grid's step is 2 %


def test_fig_5_by_hand():
    five_a, five_b, five_c = (results().figure(f"fig-5{letter}") for letter in "abc")
    n = first_column(five_a)
    assert column(five_a, "PDE 40%") == pytest.approx(100 * (1 - np.exp(n * (math.exp(-0.4 / 100) - 1))), abs=1e-9)
    n = first_column(five_b)
    assert column(five_b, "400 cells") == pytest.approx(400 * (1 - np.exp(n * (math.exp(-0.22 / 400) - 1))), abs=1e-9)
    n, trigger = first_column(five_c), math.exp(-0.22 / 100) - 1
    busy = 100 * (1 - math.exp(300 * trigger))
    free = 100 - busy - 100 * 2007 * 6e-9
    assert column(five_c, "300 photons") == pytest.approx(free * (1 - np.exp(n * trigger)), abs=1e-9)
    x = 300 * 0.22 / 100 + 2007 * 6e-9
    assert column(five_c, "300, derived")[-1] == pytest.approx(100 / (1 + x) * (1 - math.exp(-n[-1] * 0.22 / 100)))


def test_fig_6a_meets_the_table():
    """docs/validation.md: 61.4618 and 22.7009 at 100 m. Tolerance: interpolation between 300 points."""
    figure = results().figure("fig-6a")
    assert interpolated(figure, "APD (19)", 100.0) == pytest.approx(61.4618, rel=1e-4)
    assert interpolated(figure, "SiPM (27)", 100.0) == pytest.approx(22.7009, rel=1e-3)
    assert [mark.x for mark in figure.drawing.marks] == pytest.approx([350.605, 280.871], rel=1e-5)


def test_fig_6b_says_which_law():
    figure = results().figure("fig-6b")
    for name in ("APD, A cos θ", "SiPM, A cos θ"):
        curve = column(figure, name)
        assert curve[0] == pytest.approx(curve[-1], rel=1e-9)
        assert curve[0] < curve[60]
    assert column(figure, "APD, A cos θ")[60] == pytest.approx(350.605, rel=1e-5)
    mirror = column(figure, "APD, mirror")
    assert mirror[0] > mirror[60] > mirror[-1]
    assert "A(0) cos θ" in figure.caption


def test_fig_6c_meets_the_table():
    figure = results().figure("fig-6c")
    for klux, apd_m, sipm_m in (
        (100, 350.605, 280.871),
        (50, 414.464, 347.782),
        (10, 593.591, 539.426),
        (1, 817.209, 971.009),
    ):
        assert interpolated(figure, "APD (19)", klux) == pytest.approx(apd_m, rel=1e-4)
        assert interpolated(figure, "SiPM (27)", klux) == pytest.approx(sipm_m, rel=1e-4)
    assert "3.22191 klux" in figure.caption
    floored, printed = column(figure, "SiPM, steady state and floor"), column(figure, "SiPM (27)")
    assert floored[0] < 0.7 * printed[0]


def test_figures_have_axes_with_units_and_columns_with_names():
    for figure in results().figures:
        header, rows = figure.data
        assert len(header) == len(figure.drawing.lines) + 1
        assert {len(row) for row in rows} == {len(header)}
        assert np.isfinite(rows).all()
        assert figure.drawing.x_label
        assert figure.drawing.y_label


# --- claims -----------------------------------------------------------------------------------------


def claim_with(claims, word):
    (claim,) = [candidate for candidate in claims if word in candidate.says]
    return claim


@pytest.mark.parametrize(
    ("word", "number", "verdict"),
    [
        ("less than 3e-7", "2.86652e-07", HOLDS),
        ("99.977 %", "99.97713 %", HOLDS),
        ("optical noise equals electrical", "6.667", FAILS),
        ("maximises the SNR", "30.87", HOLDS),
        ("below 1e-2", "4.817e-03", HOLDS),
        ("ahead of the SiPM's throughout", "x1.3", HOLDS),
        ("sees farther", "3.22191 klux", HOLDS),
        ("50 %", "0.500", HOLDS),
        ("grows with the aperture area", "APD +0.256 %", HOLDS),
        ("shrinks with the excess noise index", "APD -0.32", HOLDS),
    ],
)
def test_claim(claims, word, number, verdict):
    claim = claim_with(claims, word)
    assert number in claim.found
    assert claim.verdict == verdict


def test_every_claim_has_a_number(claims):
    assert len(claims) >= 35
    for claim in claims:
        assert re.search(r"\d", claim.found), claim.says
        assert claim.verdict
        assert "nan" not in f"{claim.found} {claim.verdict}".split()
    assert len({claim.says for claim in claims}) == len(claims)


def test_approximation_28_is_told_with_its_error(claims):
    claim = claim_with(claims, "approximated")
    assert "47.64 for 22.70" in claim.found
    assert "308.7 m for 280.9 m" in claim.found


def test_dead_time_is_not_minimal(claims):
    claim = claim_with(claims, "dead time has minimal impact")
    assert "25.02 for 22.70" in claim.found
    assert "296.2 for 280.9 m (+5.47 %)" in claim.found


# --- errata -----------------------------------------------------------------------------------------


def test_errata_carry_the_sizes_of_the_reference():
    """docs/theory.md 11."""
    sizes = {erratum.place: erratum.size for erratum in results().errata if erratum.place != "(29), (30)"}
    assert "125.7 busy cells for 109.6; at 2000 photons 266.8 for 209.5" in sizes["(23), and with it (24) and (25)"]
    assert "86.2 for 79.6" in sizes["(23), and with it (24) and (25)"]
    assert "296.2 for 333.2 m (+12 %)" in sizes["(24)"]
    assert "factor 6.67" in sizes["after (20)"]
    assert "16 % too short" in sizes["(29)"]
    assert "4105" in sizes["(27) in the dark"]
    assert sizes["(S6)"] == sizes["after (10)"] == "none"
    assert any("41 % too long at 60°" in erratum.size for erratum in results().errata)


def test_closed_forms_of_table_1():
    assert closed_forms(as_printed=False) == pytest.approx((352.751, 308.667), rel=1e-5)


def test_case_is_table_1():
    """docs/validation.md, Numbers."""
    counts = case.sipm_counts()
    assert (counts.background_photons, counts.busy, counts.signal_photons) == pytest.approx(
        (686.093, 125.701, 2660.31), rel=1e-5
    )
    noise = case.apd_noise()
    assert noise.snr(80.0) == pytest.approx(61.4618, rel=1e-5)


# --- page -------------------------------------------------------------------------------------------


def test_scanner_is_named_and_explained():
    assert "A(0) cos(theta)" in study.SCANNER
    assert "fixed in the housing" in study.SCANNER
