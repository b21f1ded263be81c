"""Pile-up within an echo, against firings drawn one by one and sums over the shadow."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from lidarscene.physics.photon_counting import dead_time, matched_filter, pile_up


def test_pile_up_moves_strong_echoes_to_the_front():
    """Compared with firings drawn one by one: the first of Poisson arrivals, 40,000 SPADs."""
    rng = np.random.default_rng(3)
    for light in (0.2, 2.0, 20.0):
        share = 1 - np.exp(-light)
        # The time of a first arrival: G(t) = -ln(1 - u share) / Lambda.
        times = norm.ppf(-np.log1p(-rng.random(40_000) * share) / light)
        place = times.mean()
        for _ in range(30):
            near = np.exp(-0.5 * ((times - place) / matched_filter.TEMPLATE) ** 2)
            place = np.sum(near * times) / np.sum(near)
        top = pile_up.top(detections=light, sun=0.0, dead=20.0)
        assert float(pile_up.shift(detections=light, sun=0.0, dead=20.0)) == pytest.approx(place, abs=0.02)
        height = matched_filter.SCALE * np.exp(-0.5 * ((times - place) / matched_filter.TEMPLATE) ** 2).mean()
        assert float(top.height) == pytest.approx(height, abs=0.005)


def course(detections, sun, dead):
    """Firings of a SPAD less those of the background, over its free share, in steps of 0.02 sigmas; their times."""
    step = 0.02
    time = np.arange(-8.0, 8.0 + dead, step) + 0.5 * step
    rate = np.concatenate([[sun], sun + detections * norm.pdf(time)])
    fired = dead_time.firing_shares(rate, bin_s=step, dead_time_s=dead)
    return time, (fired[1:] - fired[0]) * (1.0 + sun * dead)


@pytest.mark.parametrize("dead", [2.36, 3.0, 5.0, 12.0])
@pytest.mark.parametrize("sun", [0.03, 0.3, 1.2])
def test_the_peak_behind_the_filter_is_that_of_the_course_of_the_free_spads(sun, dead):
    """Rationale: echoes of any strength, whose SPADs miss the background behind them until they are back.
    Reference: the renewal course, filtered and searched here. Tolerance: 0.5 % of the height for a table's steps, 0.02
    sigmas of the place for the search's; 3 % of curvature and variances, 6 % where SPADs come back within the filter.
    """
    places = np.arange(-3.0, 1.0, 0.02)
    weak_and_dark = summed_at(0.0, *course(1e-3, 0.0, 12.0))[1:]
    for detections in (0.003, 0.04, 0.06, 0.5, 3.0, *((20.0,) if dead > 4.0 else ())):
        time, counts = course(detections, sun, dead)
        counts = counts / -math.expm1(-detections)
        template = np.exp(-0.5 * ((time - places[:, None]) / matched_filter.TEMPLATE) ** 2)
        values = matched_filter.SCALE * template @ counts
        top = pile_up.top(detections=detections, sun=sun, dead=dead)
        assert float(top.height) == pytest.approx(values.max(), rel=5e-3)
        shift = float(pile_up.shift(detections=detections, sun=sun, dead=dead))
        assert shift == pytest.approx(places[values.argmax()], abs=0.02)
        bend, variance, of_slope = summed_at(shift, time, counts)
        tolerance = 0.03 if dead > 4.0 else 0.06
        assert float(top.bend) == pytest.approx(bend, rel=tolerance)
        unit = matched_filter.SIGNAL_VARIANCE * 1e-3
        assert float(top.variance) == pytest.approx(unit * variance / weak_and_dark[0], rel=tolerance)
        assert float(top.of_slope) == pytest.approx(unit * of_slope / weak_and_dark[1], rel=tolerance)


def summed_at(place, time, counts):
    """Curvature of the filter's value over the value, and sums of counts with the squares of its weight and slope."""
    apart = (time - place) / matched_filter.TEMPLATE
    weight = np.exp(-0.5 * apart**2)
    bend = (counts * weight) @ (1.0 - apart**2) / (counts @ weight)
    width = matched_filter.OUTPUT_WIDTH / matched_filter.TEMPLATE
    return bend * width**2, counts @ weight**2, counts @ (apart * weight) ** 2


def test_counts_around_an_echo_in_the_sun():
    """Rationale: the shadow takes some of the photons of the box. Reference: the course. Tolerance: 0.3 %."""
    for sun in (0.01, 0.1, 0.5):
        time, counts = course(1e-3, sun, 12.0)
        near = np.abs(time - float(pile_up.shift(detections=0.0, sun=sun, dead=12.0))) < pile_up.BOX
        assert float(pile_up.shade_of_box(sun=sun)) == pytest.approx(counts[near].sum() / 1e-3, rel=3e-3)


@pytest.mark.parametrize("detections", [0.3, 1.0, 5.0])
@pytest.mark.parametrize("lambda_tau", [0.27, 0.55, 1.1])
def test_the_hump_of_spads_that_come_back_is_that_of_the_renewal_course(lambda_tau, detections):
    """(T108) against the filtered course (T100) of a dead time of 12 sigmas: height within 3 %, place within 0.15
    sigma, for (T107), which is of first order in the sun, and a Gaussian that stands for the times of firing.
    """
    dead, step = 12.0, 0.04
    sun = lambda_tau / dead
    time = np.arange(-8.0, 22.0, step) + 0.5 * step
    rate = sun + detections * np.exp(-0.5 * time * time) / math.sqrt(2.0 * math.pi)
    fired = dead_time.firing_shares(rate, bin_s=step, dead_time_s=dead)
    even = sun / (1.0 + lambda_tau)
    places = np.arange(10.0, 16.0, step)
    template = np.exp(-0.5 * ((time[:, None] - places) / 1.2) ** 2) / (1.2 * math.sqrt(2.0 * math.pi))
    values = (fired / step / even - 1.0) @ template * step
    echo = pile_up.firings(detections=np.array([detections]), sun=sun)
    hump = pile_up.hump(echo, sun=sun, dead=dead)
    assert float(hump.excess[0]) == pytest.approx(values.max(), rel=0.03)
    assert float((dead + echo.mean + hump.place)[0]) == pytest.approx(places[values.argmax()], abs=0.15)


@pytest.mark.parametrize("detections", [0.3, 2.0, 5.0, 50.0])
@pytest.mark.parametrize("sun", [0.02, 0.1, 0.2])
def test_firings_of_an_echo_in_the_sun_are_those_of_the_renewal_course(sun, detections):
    """(T107) against the course (T100) of a dead time that outlasts the echo: the light times the free SPADs.

    Tolerance: the second order in the sun, (lambda sigma)^2 of the share, of its mean and deviation, and 1 % of the
    table's steps.
    """
    dead, step = 12.0, 0.02
    time = np.arange(-8.0, 11.0, step) + 0.5 * step
    light = detections * np.exp(-0.5 * time * time) / math.sqrt(2.0 * math.pi)
    fired = dead_time.firing_shares(np.concatenate([[sun], sun + light]), bin_s=step, dead_time_s=dead)[1:]
    of_light = fired / (sun + light) * light * (1.0 + sun * dead)
    mean = of_light @ time / of_light.sum()
    echo = pile_up.firings(detections=np.array([detections]), sun=sun)
    within = 0.01 + sun * sun
    assert float(echo.share[0]) == pytest.approx(of_light.sum(), rel=within)
    assert float(echo.mean[0]) == pytest.approx(mean, abs=within)
    assert float(echo.deviation[0]) == pytest.approx(
        math.sqrt(of_light @ time**2 / of_light.sum() - mean**2), abs=within
    )
