"""Cells in Geiger mode: fill factors of data sheets, and what overvoltage and temperature make of a cell."""

import math

import numpy as np
import pytest

from lidarscene.physics.electronics import geiger


@pytest.mark.parametrize(
    ("pitch_um", "stated", "tolerance"), [(25.0, 0.47, 0.06), (50.0, 0.74, 0.01), (75.0, 0.82, 0.01)]
)
def test_fill_factor_of_hamamatsus_data_sheets(pitch_um: float, stated: float, tolerance: float) -> None:
    """S13360-3025, -3050 and -3075: 3 x 3 mm; with borders of 7 um, which at 25 um must be a little wider."""
    cells = (3000.0 / pitch_um) ** 2
    assert geiger.fill_factor(area_m2=9e-6, cells=cells, gap_m=7e-6) == pytest.approx(stated, abs=tolerance)


def test_no_cell_is_active_where_the_border_is_the_pitch() -> None:
    cells = np.array([100.0, 1e4, 1e6])  # pitches of 100, 10 and 1 um on a square millimetre
    share = geiger.fill_factor(area_m2=1e-6, cells=cells, gap_m=5e-6)
    np.testing.assert_allclose(share, [0.95**2, 0.25, 0.0], rtol=1e-12)


def test_trigger_probability_by_hand() -> None:
    volts = np.array([-1.0, 0.0, 2.5, 5.0])
    expected = [0.0, 0.0, 1.0 - math.exp(-1.0), 1.0 - math.exp(-2.0)]
    np.testing.assert_allclose(geiger.trigger_probability(overvoltage_v=volts, scale_v=2.5), expected, rtol=1e-12)


def test_warming_takes_overvoltage_and_doubles_dark_counts() -> None:
    """Hamamatsu's S13360 lose 54 mV a degree; a factor of two for each ten degrees is 64 over sixty."""
    assert geiger.overvoltage_v(rated_v=3.0, drift_v_k=0.054, warming_k=20.0) == pytest.approx(1.92)
    assert geiger.dark_growth(warming_k=60.0, doubling_k=10.0) == pytest.approx(64.0, rel=1e-12)
    assert geiger.dark_growth(warming_k=-10.0, doubling_k=10.0) == pytest.approx(0.5, rel=1e-12)
