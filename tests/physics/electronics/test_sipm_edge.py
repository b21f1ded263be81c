"""The rising edge of a count of SiPM cells."""

import itertools

import numpy as np
import pytest
from scipy.stats import norm

from lidarscene.physics.electronics.sipm_edge import CountEdge


@pytest.mark.parametrize(
    ("dead", "rate"), [*itertools.product((2.5, 5.0, 20.0, 80.0), (1e-3, 0.02, 0.1, 0.3)), (5.0, 1.0)]
)
def test_the_peak_is_where_the_count_is_highest(dead: float, rate: float) -> None:
    """Reference: a search. On a plateau the place is not sharp: within 0.6 % of the height."""
    numbers = {"sigma_s": 1.0, "rate_hz": rate, "dead_time_s": dead, "busy": 100.0, "free": 900.0, "variance": 0.09}
    edge = CountEdge.from_cells(**{name: np.array([value]) for name, value in numbers.items()})
    highest = edge.course(np.linspace(-4.0, 0.5 * dead + 1.0, 4001)).max()
    assert 0.994 * highest <= float(edge.course(edge.peak)[0]) <= 1.000001 * highest


@pytest.mark.parametrize(("signal", "free"), [(1e-6, 1e3), (10.0, 1e3), (30.0, 1e3), (30.0, 50.0)])
def test_late_passages_end_with_the_echo_or_when_the_noise_has_gone_as_far(signal: float, free: float) -> None:
    """A level mean is passed until the echo ends; a falling one within twice the time of S = pi f^2 / 4 in the mean.

    f follows from the passages themselves, S is that of the background's steps: (jumps T - drop) / (2 sigma^2). The
    count free (1 - exp(-y)) falls by y / (exp(y) - 1) of the light's share, the less the fewer cells are free.
    """
    sigma, at_peak, deviations, jumps, dead_time = 5.0, 0.3, 0.5, 10.0, 12.0
    edge = CountEdge(sigma_s=1.0, decay=np.array([0.3]), dead_time=dead_time, free=free, jumps=jumps, cluster=0.0)
    passage = edge.passage(np.array([at_peak]), threshold=signal + sigma * deviations, signal=signal, sigma=sigma)
    after_peak = dead_time - 1.0 - edge.peak
    hazard = norm.pdf(deviations) / norm.cdf(deviations)
    before, both = (-np.log1p((at_peak - each) / (1.0 - at_peak)) / hazard for each in (passage.on_edge, passage.ever))
    firings = -np.log1p(-signal / free)
    drop = signal * firings / np.expm1(firings) * (1.0 - edge.course(edge.peak + after_peak) / edge.course(edge.peak))
    variance = (jumps * after_peak - drop) / (2.0 * sigma**2)
    share = 0.5 * np.pi * (both - before) ** 2 / variance
    np.testing.assert_allclose(passage.duration, after_peak * np.minimum(share, 1.0), rtol=1e-5)
    assert (share[0] < 0.9) == (signal > 1.0)
