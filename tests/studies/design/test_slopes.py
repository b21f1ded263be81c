"""Slopes of a design's quantities: exact ones against differences of the whole evaluation."""

from pathlib import Path

import numpy as np
import pytest
from helpers.run_seed import chosen

from lidarscene.studies.design.design_study import load_study
from lidarscene.studies.design.designs import Design
from lidarscene.studies.design.slopes import AUTOMATIC, CHAIN, DIFFERENCES, derivatives, differences

STUDY = """
sensor = "{sensor}"
[set]
{settings}
[free]
{free}
[objectives]
snr = {{ maximize = "snr", distance = 90, illuminance_klux = 60 }}
area = {{ minimize = "aperture_area_mm2" }}
[constraints]
range = {{ quantity = "range", at_least = 1, probability = 0.8, illuminance_klux = {klux}, visibility = 2 }}
pd = {{ quantity = "detection_probability", at_least = 0, distance = {distance}, reflectivity = 0.2 }}
eye = {{ quantity = "class_1_margin", at_least = 0.1 }}
"""

APD = """
"laser.peak_power_w" = { low = 5, high = 75, log = true }
"optics.aperture_radius_mm" = { low = 5, high = 50 }
"optics.focal_length_mm" = { low = 20, high = 60 }
"detector.gain" = { low = 5, high = 150, log = true }
"detector.radius_mm" = { low = 0.05, high = 0.3 }
"laser.pulse_fwhm_ns" = { low = 2, high = 10 }
"tdc.bandwidth_mhz" = { low = 60, high = 300 }
"tdc.threshold_to_noise" = { low = 3, high = 9 }
"""
SIPM = """
"laser.peak_power_w" = { low = 5, high = 75, log = true }
"optics.aperture_radius_mm" = { low = 5, high = 50 }
"detector.pde" = { low = 0.05, high = 0.6 }
"detector.dead_time_ns" = { low = 2, high = 20 }
"""
SPAD = """
"laser.peak_power_w" = { low = 5, high = 30, log = true }
"optics.aperture_radius_mm" = { low = 3, high = 9 }
"""
LENS = """
"laser.peak_power_w" = { low = 50, high = 200, log = true }
"optics.aperture_radius_mm" = { low = 6, high = 12 }
"laser.divergence_mrad" = { low = 0.5, high = 4 }
"""

CASES = {
    "apd": ("table1-apd", "", APD, 100, 250),
    "apd by night": ("table1-apd", "", APD, 0.01, 250),
    "sipm": ("table1-sipm", '"detector.statistics" = "time_domain"', SIPM, 100, 200),
    "sipm as printed": ("table1-sipm", "", SIPM, 30, 230),
    "spads that sum shots": ("os1-128", "", SPAD, 80, 90),
    "two lenses": ("biaxial-905", "", LENS, 80, 280),
}


@pytest.mark.parametrize("case", chosen(3, sorted(CASES)))
@pytest.mark.usefixtures("mi")
def test_slopes_against_differences(case: str, tmp_path: Path) -> None:
    """Every key's slope of range, P_d and SNR to 1e-4 of the largest slope.

    Central differences with steps of 1e-4 of a key's range are off by the third derivative, some 1e-7 of the quantity,
    and by the 1e-9 to which a range is narrowed, over the step: 1e-5.
    """
    sensor, settings, free, klux, distance = CASES[case]
    text = STUDY.format(sensor=sensor, settings=settings, free=free, klux=klux, distance=distance)
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    _, evaluator = load_study(tmp_path / "study.toml")
    values = evaluator.space.values(np.full(len(evaluator.space.free), 0.4))
    design = Design(values=values, quantities=evaluator(values))
    exact, differenced = derivatives(evaluator)(design), differences(evaluator, evaluator.space)(design)
    method = CHAIN if "sum" in case or case == "sipm" else AUTOMATIC
    assert [exact.methods[name] for name in ("snr", "range", "pd", "eye")] == [method, method, method, DIFFERENCES]
    for name, slopes in differenced.slopes.items():
        assert exact.slopes[name] == pytest.approx(slopes, rel=1e-4, abs=1e-4 * np.abs(slopes).max())
        assert np.abs(slopes).max() > 0.0 or name == "eye"
