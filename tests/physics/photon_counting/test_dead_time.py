"""Dead time and pile-up against photons that arrive one by one."""

import math

import numpy as np
import pytest
from helpers import photons
from helpers.run_seed import chosen
from scipy import special, stats

from lidarscene.physics.photon_counting import dead_time
from lidarscene.physics.reference import photon_counting as reference_photon_counting

FINE = 20
"""Steps of a bin in which the course is followed: at 0.06 firings a nanosecond the rest is below 0.2 %."""


def course(*, rate_per_ns, echo, bins, bin_ns):
    """lambda [1/s] at the middle of each fine step."""
    mean, place, sigma = echo
    t = (np.arange(bins * FINE) + 0.5) * bin_ns / FINE
    return 1e9 * (rate_per_ns + mean * np.exp(-0.5 * ((t - place) / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi)))


@pytest.mark.parametrize("dead_ns", [12.0, math.inf])
def test_a_raw_histogram_is_that_of_photons_that_arrive_one_by_one(dead_ns):
    """1e5 shots of one SPAD at 63 MHz (Table 1's cell) with an echo of 0.8 detections; chi-square, p > 1e-4. With a
    dead time the counts of neighbours exclude each other, which makes chi-square smaller than its law, never larger.
    """
    rng, shots, bins, bin_ns = np.random.default_rng(0), 100_000, 80, 1.0
    light = {"rate_per_ns": 0.063, "echo": (0.8, 40.3, 2.0)}
    once = math.isinf(dead_ns)
    (counts,) = photons.renewal_counts(rng, (1, shots), **light, dead=dead_ns, bins=bins, bin_ns=bin_ns)
    share = dead_time.firing_shares(
        course(**light, bins=bins, bin_ns=bin_ns),
        bin_s=1e-9 * bin_ns / FINE,
        dead_time_s=1e-9 * dead_ns,
        steady=not once,
    )
    expected = shots * share.reshape(bins, FINE).sum(axis=1)
    chi2 = np.sum((counts - expected) ** 2 / (expected * (1 - expected / shots)))
    assert stats.chi2.sf(chi2, bins) > 1e-4
    # The test sees a fault: without dead time the same histogram fails.
    naive = shots * 1e-9 * course(**light, bins=bins, bin_ns=bin_ns).reshape(bins, FINE).mean(axis=1)
    assert stats.chi2.sf(np.sum((counts - naive) ** 2 / naive), bins) < 1e-6


@pytest.mark.parametrize(("rate_per_ns", "afterpulse_ns"), chosen(1, [(0.001, 30.0), (0.001, 8.0), (0.02, 30.0)]))
def test_afterpulses_are_those_of_spads_that_are_followed_one_by_one(rate_per_ns, afterpulse_ns):
    """Rationale: afterpulses of 5 % of the firings, of the sun's and of an echo of 2 detections.
    Reference: 200,000 SPADs, each followed from one firing to the next with its own afterpulses.
    Tolerance: 4.8 standard errors in each of 150 bins, false alarms of 2.4e-4 for each case; 0.3 % for afterpulses that
    meet in a SPAD, a second order of 5 %.
    """
    rng, trials, bins = np.random.default_rng(7), 200_000, 350
    mean, place, sigma = 2.0, 250.3, 1.5
    counts = photons.renewal_counts(
        rng,
        (1, trials),
        rate_per_ns=rate_per_ns,
        dead=12.0,
        bins=bins,
        bin_ns=1.0,
        echo=(mean, place, sigma),
        afterpulse=(0.05, afterpulse_ns),
    )[0]
    edges = np.arange(bins * FINE + 1) / FINE
    rate_hz = 1e9 * FINE * np.diff(rate_per_ns * edges + mean * special.ndtr((edges - place) / sigma))
    keys = {"bin_s": 1e-9 / FINE, "dead_time_s": 12e-9}

    def course_of(**afterpulses):
        share = dead_time.firing_shares(rate_hz, **keys, **afterpulses)
        return trials * share.reshape(bins, FINE).sum(axis=1)

    expected = course_of(afterpulse=0.05, afterpulse_s=1e-9 * afterpulse_ns)
    # The simulation starts without afterpulses to come.
    seen = slice(200, bins)
    assert (
        np.abs(counts - expected)[seen] < 4.8 * np.sqrt(np.maximum(expected, 1.0) + 1.0)[seen] + 0.003 * expected[seen]
    ).all()
    # The test sees a fault: behind the echo there are many more than without them.
    behind, without = slice(264, 290), course_of()
    assert counts[behind].sum() > without[behind].sum() + 10.0 * math.sqrt(without[behind].sum())
    np.testing.assert_array_equal(course_of(afterpulse=0.0, afterpulse_s=1e-9), without)


@pytest.mark.parametrize("dead_s", [12e-9, 12.05e-9])
def test_even_light_has_the_afterpulses_of_the_closed_form(dead_s):
    """a lambda / (1 - p G) in the steps of 0.125 ns from the first one on, to the square of such a step; in the dark G
    is the share that outlasts the dead time, to 1e-4, lambda times the delay. Dead times of whole steps and between.
    """
    keys = {"dead_time_s": dead_s, "afterpulse": 0.05, "afterpulse_s": 30e-9}
    rate_hz = 20e6 * dead_time.afterpulse_factor(rate_hz=20e6, **keys)
    share = dead_time.firing_shares(np.full(400, 20e6), bin_s=0.125e-9, **keys)
    np.testing.assert_allclose(share / 0.125e-9, rate_hz / (1.0 + rate_hz * dead_s), rtol=1e-4)
    dark = dead_time.afterpulse_factor(rate_hz=1e3, **keys)
    assert dark - 1.0 == pytest.approx(1.0 / (1.0 - 0.05 * math.exp(-dead_s / 30e-9)) - 1.0, rel=1e-4)


@pytest.mark.parametrize("dead_s", [6e-9, 6.3e-9, 6.8e-9])
def test_even_light_leaves_the_share_of_free_spads_that_renewal_says(dead_s):
    """a lambda in the steps of 0.1 ns from the first one on, to (lambda step)^2 / 12 = 3e-6; dead times of whole steps
    and between.
    """
    share = dead_time.firing_shares(np.full(400, 63e6), bin_s=1e-10, dead_time_s=dead_s)
    free = dead_time.free_share(rate_hz=63e6, dead_time_s=dead_s)
    np.testing.assert_allclose(share / (1e-10 * 63e6), free, rtol=5e-6)


def test_spads_that_start_free_come_into_balance():
    """SPADs have not fired before a dead time is over, exp(-lambda t); after ten of them they are in balance."""
    share = dead_time.firing_shares(np.full(1000, 63e6), bin_s=1e-10, dead_time_s=6e-9, steady=False)
    time_s = 1e-10 * np.arange(1000)
    np.testing.assert_allclose(share[:59], -np.expm1(-63e-4) * np.exp(-63e6 * time_s[:59]), rtol=1e-9)
    assert share[-1] == pytest.approx(63e-4 / (1.0 + 63e6 * 6e-9), rel=1e-4)


def test_first_photons_die_with_the_range():
    """63 MHz: exp(-0.42 R / m); 2 x 63e6 / c = 0.4203 per metre."""
    share = dead_time.firing_shares(np.full(1000, 63e6), bin_s=1e-10, dead_time_s=math.inf, steady=False)
    range_m = 0.5 * 299792458.0 * 1e-10 * np.arange(1000)
    slope = np.polyfit(range_m, np.log(share), 1)[0]
    assert slope == pytest.approx(-0.42, abs=2e-3)
    free = dead_time.free_share_of_first(rate_hz=63e6, time_s=1e-10 * np.arange(1000))
    np.testing.assert_allclose(share / share[0], free, rtol=1e-9)


@pytest.mark.parametrize(("dead_ns", "mean"), chosen(2, [(9.0, 0.5), (9.0, 2.0), (8.7, 2.0), (math.inf, 2.0)]))
def test_coates_correction_gives_the_light_back(mean, dead_ns):
    """An echo of up to two detections a shot on a background of 0.01 per ns: bias below 1 %.

    300,000 trials: the error of the sum is 0.3 % at most.
    """
    rng, trials, bins = np.random.default_rng(11), 300_000, 60
    light = {"rate_per_ns": 0.01, "echo": (mean, 30.0, 2.0)}
    (counts,) = photons.renewal_counts(rng, (1, trials), **light, dead=dead_ns, bins=bins, bin_ns=1.0)
    corrected = reference_photon_counting.coates(
        counts, trials=trials, dead_bins=None if math.isinf(dead_ns) else dead_ns
    )
    raw = counts / trials
    near = slice(20, 40)
    assert corrected[near].sum() == pytest.approx(mean + 0.2, rel=0.01)
    assert raw[near].sum() < 0.9 * (mean + 0.2)


@pytest.mark.parametrize("least", [1, 2, 4])
@pytest.mark.parametrize("spads", [16, 400])
@pytest.mark.parametrize("share", [1e-5, 1e-3, 0.02, 0.05, 0.3, 0.9])
def test_coincidences_are_a_binomial_tail(least, spads, share):
    coincidences = float(dead_time.coincidence_share(least=least, spads=float(spads), share=np.float64(share)))
    assert coincidences == pytest.approx(stats.binom.sf(least - 1, spads, share), rel=2e-5)


def test_what_a_share_says_of_the_light_is_its_inverse():
    light = np.array([1e-6, 1e-3, 0.3, 2.0, 8.0])
    recovered = dead_time.detections_of_share(share=dead_time.firing_share(detections=light))
    np.testing.assert_allclose(recovered, light, rtol=1e-6)
