"""Histograms of whole windows: even background and echoes in closed form, and counts that scatter as they should."""

import math

import numpy as np
import pytest
from helpers import photons
from helpers.trains import train

from lidarscene.detection.photon_counting.histograms import histograms

COUNT = 400


def fill_histograms(counter, power_w, background_w):
    light = train(np.full((COUNT, 1), 30.0), np.full((COUNT, 1), power_w), background_w=background_w)
    return histograms(light, counter, seed=3, pulse=np.arange(COUNT, dtype=np.uint32))


def test_background_and_echo_have_their_means_and_the_counts_scatter_around_them():
    """Bins of N a (1 - exp(-lambda bin)); an echo in the dark has N (1 - exp(-Lambda)) counts in all. Counts are within
    4.5 standard errors of their means in every bin: false alarms of 0.3 % with 400 bins.
    """
    counter = photons.sensor("histogram.window_us=0.4")
    pixel = counter.pixel(np.array([2e-10]))
    histogram = fill_histograms(counter, 0.0, 2e-10)
    np.testing.assert_allclose(histogram.expected, float(pixel.count_share[0]) * 3200.0, rtol=2e-3)
    mean = histogram.expected[0]
    assert (np.abs(histogram.counts.mean(axis=0) - mean) < 4.5 * np.sqrt(mean / COUNT)).all()
    dark = photons.sensor("histogram.window_us=0.4", "detector.dark_count_rate_hz=0")
    light = float(dark.pixel(np.zeros(1)).detections(2e-8))
    histogram = fill_histograms(dark, 2e-8, 0.0)
    assert histogram.expected[0].sum() == pytest.approx(-3200.0 * math.expm1(-light), rel=5e-3)
    place = float(np.sum(histogram.time_s * histogram.expected[0]) / histogram.expected[0].sum())
    assert 1.498962e8 * place == pytest.approx(30.0, abs=0.15)
    assert histogram.counts.sum(axis=1).mean() == pytest.approx(histogram.expected[0].sum(), rel=5e-3)
