"""Keys of cells in Geiger mode: what a file with them makes of the efficiency, and what does not go together."""

from typing import Any

import numpy as np
import pytest

from lidarscene import load_sensor
from lidarscene.sensor.detectors import GeigerDetector
from lidarscene.studies.ranging import plane, sensitivities
from lidarscene.studies.ranging.plane import Target

BIAS = {"detector.overvoltage_v": 3.0, "detector.rated_overvoltage_v": 3.0, "detector.trigger_voltage_v": 2.5}
WARM = {
    "detector.temperature_k": 318.15,
    "detector.rated_temperature_k": 298.15,
    "detector.dark_doubling_k": 10.0,
    "detector.breakdown_drift_v_k": 0.05,
}


def detector(name: str, changes: dict[str, Any]) -> GeigerDetector:
    cells = load_sensor(name, overrides=changes).detector
    assert isinstance(cells, GeigerDetector)
    return cells


@pytest.mark.parametrize("name", ["sipm-905", "os1-128"])
def test_at_its_rating_a_detector_is_that_of_its_file(name: str) -> None:
    plain, rated = (detector(name, changes) for changes in ({}, BIAS))
    assert rated.efficiency == pytest.approx(plain.pde, rel=1e-15)
    assert rated.dark_rate_hz == pytest.approx(plain.dark_count_rate_hz, rel=1e-15)
    assert (plain.efficiency, plain.dark_rate_hz, plain.fill_factor) == (plain.pde, plain.dark_count_rate_hz, 1.0)


@pytest.mark.parametrize("name", ["sipm-905", "os1-128"])
def test_a_warm_detector_under_a_fixed_bias(name: str) -> None:
    """Twenty degrees take 1 V of 3 V and quadruple the dark counts. The range is that of a file with these."""
    plain, warm = (detector(name, changes) for changes in ({}, BIAS | WARM))
    ratio = (1.0 - np.exp(-2.0 / 2.5)) / (1.0 - np.exp(-3.0 / 2.5))
    assert warm.efficiency == pytest.approx(plain.pde * ratio, rel=1e-12)
    assert warm.dark_rate_hz == pytest.approx(4.0 * plain.dark_count_rate_hz * ratio, rel=1e-12)
    equal = {"detector.pde": float(warm.efficiency), "detector.dark_count_rate_hz": float(warm.dark_rate_hz)}
    ranges = [
        plane.range_at_probability_m(load_sensor(name, overrides=changes), Target(), 0.9)
        for changes in (BIAS | WARM, equal, {})
    ]
    assert ranges[0] == pytest.approx(ranges[1], rel=1e-9)
    assert ranges[0] < ranges[2]
    following = detector(name, BIAS | {key: value for key, value in WARM.items() if "drift" not in key})
    assert following.efficiency == pytest.approx(plain.pde)


def test_more_cells_on_one_area_are_less_active() -> None:
    """0.1 mm radius and a border of 2 um: the fill factor falls with the cells, and sensitivities know it."""
    shares = [detector("sipm-905", {"detector.cells": n, "detector.cell_gap_um": 2}).fill_factor for n in (100, 400)]
    area_um2 = np.pi * 100.0**2
    assert shares == pytest.approx([(1.0 - 2.0 / np.sqrt(area_um2 / n)) ** 2 for n in (100, 400)])
    sensor = load_sensor("sipm-905", overrides={"detector.cell_gap_um": 2})
    slopes = {
        row.parameter: row.range_slope
        for row in sensitivities.sensitivities(sensor, Target(), method="differences").rows
    }
    low, high = (
        plane.range_at_probability_m(load_sensor("sipm-905", overrides={"detector.cell_gap_um": g}), Target(), 0.9)
        for g in (1.99, 2.01)
    )
    assert slopes["detector.cell_gap_m"] == pytest.approx((high - low) / 0.02e-6, rel=1e-3)
