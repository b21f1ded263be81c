"""The written file, read again: its equations give what was found."""

import re
from dataclasses import replace

import numpy as np
import pytest

from lidarscene.catalog import path_of
from lidarscene.studies.fit.estimates import Estimate
from lidarscene.studies.fit.products import near_field_m, pulse_fwhm_s, scatter_c_mm, white_m2
from lidarscene.studies.fit.row_gains import RowGains
from lidarscene.studies.fit.sensor_text import TWO_LENS_KEYS, fitted_text, parse_sensor, remove_keys, scaled_values

TEXT = path_of("sensors", "os2-128").read_text(encoding="utf-8")
ONE_LENS = remove_keys(TEXT, *TWO_LENS_KEYS[:3])


def estimate(key: str, value: float, sigma: float = 0.01) -> Estimate:
    return Estimate(key=key, value=value, unit="", fisher=sigma * abs(value), bootstrap=sigma * abs(value))


def fit_text(text: str, *estimates: Estimate, rows: RowGains | None = None) -> tuple[str, tuple[str, ...]]:
    return fitted_text(text, {estimate.key: estimate for estimate in estimates}, "drawn", "unit.toml", rows=rows)


def test_one_lens_moves_with_the_power_that_makes_up_for_it() -> None:
    """R0 = r_A f / r_PD is 1.5 times as far, r_A / f stays, a white wall sends twice the photons, all together."""
    before = parse_sensor(ONE_LENS, "before")
    range_m, photons = 1.5 * near_field_m(before), 2.0 * white_m2(before)
    text, _ = fit_text(
        ONE_LENS,
        estimate("near_field_m", range_m),
        estimate("white_m2", photons),
        estimate("spot_over_field", 0.4),
        estimate("scatter_c", 1.2 * scatter_c_mm(before)),
    )
    after = parse_sensor(text, "after")
    assert near_field_m(after) == pytest.approx(range_m, rel=1e-5)
    assert after.optics.aperture_radius_m / after.optics.focal_length_m == pytest.approx(
        before.optics.aperture_radius_m / before.optics.focal_length_m, rel=1e-5
    )
    assert white_m2(after) == pytest.approx(photons, rel=1e-3)
    assert scatter_c_mm(after) == pytest.approx(1.2 * scatter_c_mm(before), rel=1e-4)
    # The spot's half angle over that of the field of view of the new lens.
    field_rad = after.detector.radius_m / after.optics.focal_length_m
    assert 0.5 * after.laser.divergence_rad / field_rad == pytest.approx(0.4, rel=1e-5)


def test_the_pulse_that_scatters_so_is_found_again() -> None:
    """There and back; and none, where jitter and bin alone scatter more."""
    sensor = parse_sensor(TEXT, "os2")
    assert pulse_fwhm_s(sensor, scatter_c_mm(sensor)) == pytest.approx(sensor.laser.pulse_fwhm_s, rel=1e-6)
    assert pulse_fwhm_s(sensor, 1e-3) is None


def test_a_scatter_that_contradicts_the_file_is_blended_with_it() -> None:
    """62 +/- 42 mm for 185, 2.9 sigma: with 30 % of the file's own the mean by 62 / 42^2 + 185 / 55.5^2 is 107 mm. One
    that is as uncertain and does not contradict changes nothing.
    """
    before = parse_sensor(TEXT, "before")
    unit = scatter_c_mm(before) / 185.0
    text, _ = fit_text(TEXT, estimate("scatter_c", 62.0 * unit, 42.0 / 62.0))
    assert scatter_c_mm(parse_sensor(text, "after")) == pytest.approx(106.8 * unit, rel=1e-3)
    assert re.search(r"pulse_fwhm_ns.*blended with the \S+ mm of the file to \S+ \+/- \S+", text)
    text, notes = fit_text(TEXT, estimate("scatter_c", 120.0 * unit, 42.0 / 120.0))
    assert scatter_c_mm(parse_sensor(text, "after")) == pytest.approx(185.0 * unit)
    assert any("scatter_c" in note for note in notes)


@pytest.mark.parametrize(("misfit", "is_written"), [(1.9, True), (2.1, False)])
def test_no_pulse_is_written_from_a_law_that_misses_its_bins(misfit: float, is_written: bool) -> None:
    before = parse_sensor(TEXT, "before")
    found = replace(estimate("scatter_c", 0.5 * scatter_c_mm(before)), misfit=misfit)
    text, notes = fit_text(TEXT, found)
    assert (parse_sensor(text, "after").laser.pulse_fwhm_s != before.laser.pulse_fwhm_s) is is_written
    assert any("misses its bins by 2.1 times their sigmas" in note for note in notes) is not is_written


@pytest.mark.parametrize(("sigma", "is_written"), [(0.29, True), (0.31, False)])
def test_what_is_known_to_30_per_cent_is_written(sigma: float, is_written: bool) -> None:
    before = parse_sensor(ONE_LENS, "before")
    text, notes = fit_text(ONE_LENS, estimate("white_m2", 2.0 * white_m2(before), sigma))
    after = parse_sensor(text, "after")
    assert (after.laser.peak_power_w != before.laser.peak_power_w) is is_written
    assert any("laser.peak_power_w is left as it was" in note for note in notes) is not is_written


@pytest.mark.parametrize(("sigma", "is_written"), [(0.29, True), (0.31, False)])
def test_photons_that_weak_returns_share_are_written_where_the_file_has_them(sigma: float, is_written: bool) -> None:
    """Columns of a sensor of revision 7 share no more of weak returns, and its notes do not say so."""
    text, notes = fit_text(TEXT, estimate("column_photons", 105.0, sigma))
    histogram = parse_sensor(text, "after").histogram
    assert histogram is not None
    assert (histogram.column_photons == 105.0) is is_written
    assert ("drawn; scatter of weak returns" in text) is is_written
    assert any("column_photons is left as it was" in note for note in notes) is not is_written
    _, notes = fit_text(path_of("sensors", "os0-128-rev7").read_text(encoding="utf-8"))
    assert not any("column_photons" in note for note in notes)


@pytest.mark.parametrize(("sigma", "is_written"), [(0.29, True), (0.31, False)])
def test_slope_and_pedestal_are_written_together_and_replace_a_floor(sigma: float, is_written: bool) -> None:
    """A pedestal of 540 +- 400 counts in all shots, which alone would be too uncertain."""
    with_floor = TEXT.replace("threshold_slope =", "threshold_floor = 1.5\nthreshold_slope =")
    text, notes = fit_text(
        with_floor, estimate("threshold_slope", 0.2, sigma), estimate("threshold_pedestal", 540.0, 0.74)
    )
    histogram, before = parse_sensor(text, "after").histogram, parse_sensor(with_floor, "before").histogram
    assert histogram is not None
    assert before is not None
    if is_written:
        assert (histogram.threshold_floor, histogram.threshold_slope) == (0.0, 0.2)
        assert histogram.threshold_pedestal == pytest.approx(540.0 / before.shots, rel=1e-5)
    else:
        assert histogram == before
    assert any("histogram.threshold_pedestal is left" in note for note in notes) is not is_written


def test_factors_of_keys_lists_and_whole_numbers() -> None:
    text = "[detector]\nspads = 8\n[optics.overlap]\nfocus_at_m = 4.0\ntransmitter_offset_mm = [2, -3]\n"
    factors = {
        "detector.spads": 1.3,
        "optics.overlap.focus_at_m": 0.5,
        "optics.overlap.transmitter_offset_mm": 2.0,
        "laser.exit_diameter_mm": 9.0,
    }
    assert scaled_values(text, factors) == {
        "detector.spads": 10,
        "optics.overlap.focus_at_m": 2.0,
        "optics.overlap.transmitter_offset_mm": [4.0, -6.0],
    }
    assert isinstance(scaled_values(text, factors)["detector.spads"], int)


def test_two_lenses_are_stretched_together() -> None:
    """All of the near field 1.3 times as far: the curve is the same at 1.3 times the range, K as it was."""
    before = parse_sensor(TEXT, "before")
    text, _ = fit_text(
        TEXT, estimate("near_field_m", 1.3 * near_field_m(before)), estimate("white_m2", 2.0 * white_m2(before))
    )
    after = parse_sensor(text, "after")
    assert before.optics.overlap is not None
    assert after.optics.overlap is not None
    range_m = np.geomspace(1.0, 50.0, 9)
    np.testing.assert_allclose(
        after.optics.overlap.share(1.3 * range_m), before.optics.overlap.share(range_m), atol=1e-4
    )
    assert near_field_m(after) == pytest.approx(1.3 * near_field_m(before), rel=1e-5)
    assert white_m2(after) == pytest.approx(2.0 * white_m2(before), rel=1e-3)


@pytest.mark.parametrize("more", [-1, 1])
def test_gains_of_another_number_of_rows_are_not_written(more: int) -> None:
    rows = parse_sensor(TEXT, "os2").scanner.line_pulses
    gains = RowGains(gain=np.ones(rows + more), sigma=np.full(rows + more, 0.01), follows=(1.0, 0.01))
    text, notes = fit_text(TEXT, rows=gains)
    assert not re.search("(?m)^responsivity", text)
    assert any(f"of {rows + more} rows, and the file has {rows} beams" in note for note in notes)
