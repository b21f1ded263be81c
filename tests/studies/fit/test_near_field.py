"""The near field of pulses without noise."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.drawn_recordings import free_lenses

from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.studies.fit.near_field import fit_near_field, share
from lidarscene.studies.fit.recorded_pulses import RecordedPulses, gather_pulses

WHITE_M2, R0_M, SPOT = 3e5, 9.0, 0.5
ROWS, COLUMNS = 32, 800


def exact_pulses() -> RecordedPulses:
    """Every pulse on a wall of 25 to 90 % at 2 to 70 m, its signal that of the law, not rounded."""
    place = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    range_m = 2.0 * 35.0 ** ((place * 7919 % (ROWS * COLUMNS)) / (ROWS * COLUMNS))
    reflectivity = 25.0 + place % 66
    signal = WHITE_M2 * share(range_m / R0_M, SPOT) * reflectivity / 100.0 / range_m**2
    columns = np.arange(COLUMNS)
    return RecordedPulses(
        range_m=range_m,
        recorded=np.ones_like(range_m, bool),
        signal=np.asarray(signal),
        near_ir=None,
        reflectivity=reflectivity,
        azimuth_rad=np.zeros_like(range_m),
        frame=0 * columns,
        block=columns // 20,
    )


def with_signal_changed(
    pulses: RecordedPulses, mask: Any, *, white: Any = 1.0, reflectivity: float | None = None
) -> RecordedPulses:
    """These pulses with another SIGNAL over REFLECTIVITY, and perhaps another REFLECTIVITY."""
    mask = np.broadcast_to(mask, pulses.range_m.shape)
    before = np.asarray(pulses.reflectivity)
    after = before if reflectivity is None else np.where(mask, reflectivity, before)
    return replace(pulses, signal=np.where(mask, white, 1.0) * after / before * pulses.signal, reflectivity=after)


@pytest.mark.parametrize(
    "spoilt", [{}, {"white": 5.0}, {"white": 1.35, "reflectivity": 110.0}, {"white": 0.7, "reflectivity": 15.0}]
)
def test_the_law_is_found_whatever_a_fifth_reports(spoilt: dict[str, float]) -> None:
    """Rationale: light of another surface, reflectivities in steps and in logarithms are left out. A bin is 3 % wide:
    what its mean misses of the knee is below 0.5 %.
    """
    pulses = with_signal_changed(exact_pulses(), np.arange(ROWS)[:, None] % 5 == 2, **spoilt)
    fit = fit_near_field(pulses)
    assert fit is not None
    for estimate, truth in zip(fit.estimates, (WHITE_M2, R0_M, SPOT), strict=True):
        assert estimate.value == pytest.approx(truth, rel=0.01), estimate.key
    assert fit.misfit < 0.005
    assert fit.error < 0.005
    if not spoilt:  # along a bin's own slope nothing is left
        assert np.median(fit.sigma) < 1e-4


def test_the_error_is_that_of_the_blocks_that_were_not_fitted() -> None:
    """They have a fifth more light: the law misses 1 - 1 / 1.2 of it."""
    pulses = exact_pulses()
    fit = fit_near_field(with_signal_changed(pulses, ~pulses.fitted[None, :], white=1.2))
    assert fit is not None
    assert fit.error == pytest.approx(1.0 - 1.0 / 1.2, abs=0.005)
    assert fit.estimates[0].value == pytest.approx(WHITE_M2, rel=0.01)


def test_bins_that_follow_a_law_of_their_own_count_less() -> None:
    """There is half as much light again within 2.5 m, a fifteenth of the bins: far away K and R0 stay."""
    pulses = exact_pulses()
    fit = fit_near_field(with_signal_changed(pulses, pulses.range_m < 2.5, white=1.5))
    assert fit is not None
    assert fit.estimates[0].value == pytest.approx(WHITE_M2, rel=0.01)
    assert fit.estimates[1].value == pytest.approx(R0_M, rel=0.02)


def test_noise_of_the_pulses_is_no_misfit_of_the_law() -> None:
    """Signals 20 % up and down in turn, some 160 in a bin, which makes its mean sure to 1.4 %; and bins that are three
    quarters of that above and below the law in turn. Their median distance, as a deviation, is 1.11 sigmas, of which
    noise explains one: the law misses sqrt(1.11^2 - 1) = 0.49 of it.
    """
    pulses = exact_pulses()
    place = np.floor(np.log(pulses.range_m) / 0.03).astype(int)
    sigma = np.log(1.2) / np.sqrt(np.median(np.bincount(place[:, pulses.fitted].ravel())))
    noise = 0.75 * sigma * np.where(place % 2 == 0, 1.0, -1.0)
    for part in (pulses.fitted, ~pulses.fitted):
        columns = np.flatnonzero(part)
        order = np.argsort(place[:, columns].ravel(), kind="stable")
        turns = np.empty(len(order))
        turns[order] = np.where(np.arange(len(order)) % 2 == 0, 1.0, -1.0)
        noise[:, columns] += np.log(1.2) * turns.reshape(ROWS, len(columns))
    fit = fit_near_field(replace(pulses, signal=pulses.signal * np.exp(noise)))
    assert fit is not None
    assert np.median(fit.sigma) == pytest.approx(sigma, rel=0.1)
    # Scores are slopes over sigma: their blocks scatter as Fisher says, within a factor of two, as noise is balanced.
    for estimate in fit.estimates:
        assert 0.2 < estimate.bootstrap / estimate.fisher < 2.0, estimate.key
    assert 0.3 * sigma < fit.misfit < 0.7 * sigma


def test_intervals_of_free_lenses_hold_the_truth() -> None:
    """Each number is within one sigma in three of twelve units at least, and within two in eight: fewer are by a chance
    of 3.5e-4 and 1.2e-4. Of three and seven in ten it was 2.4e-3 and 7e-4, for each of six numbers.

    R0, offset and crossing have correlations of 0.99. Rationale: straight lines between places of the curve gave a
    minimum at each bend, with an interval of its own; one sigma held K and R0 in two units of ten.
    """
    sensor = load_sensor("os0-128")
    deviations: dict[str, list[float]] = {}
    for unit in range(12):
        truth, sweep = free_lenses(unit, sensor, columns=400)
        fit = fit_near_field(gather_pulses([sweep]), sensor)
        assert fit is not None
        for estimate in fit.estimates:
            deviations.setdefault(estimate.key, []).append((estimate.value - truth[estimate.key]) / estimate.sigma)
    assert len(deviations) == 6
    for key, far in deviations.items():
        held = [np.sum(np.abs(far) < sigmas) for sigmas in (1.0, 2.0)]
        assert held[0] >= 3, (key, np.round(far, 1))
        assert held[1] >= 8, (key, np.round(far, 1))
