"""Light in front of a place, whose SPADs are missing there."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import truncnorm

from lidarscene.detection.photon_counting import shadows


@pytest.mark.parametrize("begin", [None, -1.5, 0.4])
def test_light_between_two_places_of_an_echo(begin):
    """Detections and mean place of a Gaussian cut at both ends, in sigmas. Reference: SciPy's truncated normal
    distribution. Tolerance: 2e-4 of the echo, of the logistic function (Page, 1977), and what that moves the mean.
    """
    pixel = SimpleNamespace(per_watt=3e9, sigma_s=2e-9)
    wave = SimpleNamespace(centres=(20.0,), heights=(np.full(1, 0.05),), volume=None)
    light = 0.05 * 3e9 * 2e-9 * math.sqrt(2.0 * math.pi)
    for end in (0.9, 1.6, 3.0):
        low = -8.0 if begin is None else begin
        cut = truncnorm(low, end)
        share = float(np.diff(truncnorm(-8.0, 8.0).cdf([low, end]))[0])
        ends = (np.full(1, 20.0 + end), None if begin is None else np.full(1, 20.0 + begin))
        detections, place, inside = shadows._light_between(pixel, wave, ends, np.full(1, 1e-7), 1)
        assert detections[0] == pytest.approx(light * share, abs=4e-4 * light)
        assert inside[0] == pytest.approx(share, abs=4e-4)
        assert place[0] == pytest.approx(20.0 + cut.mean(), abs=2e-3 / share)


@pytest.mark.parametrize(
    ("earlier", "fired", "since"), [(0, (0.3, 0.0), 5.0), (1, (0.3, 0.2), 6.0), (2, (0.3, 0.2), 0.0)]
)
def test_fewer_spads_are_free_behind_light(earlier, fired, since):
    """SPADs that light has fired, and that the sun would have left, are missing: exp(-lambda t) (T106)."""
    place, firings = np.full(1, 30.0), tuple(np.full(1, share) for share in fired)
    shadow = shadows.Shadow(place=place, sun=0.1, dead=10.0, firings=firings, places=(place - 5.0, place - 16.0))
    missing = fired[earlier] * math.exp(-0.1 * since) if earlier < 2 else 0.0
    np.testing.assert_allclose(shadow.free(earlier), 1.0 - missing, rtol=1e-12)
