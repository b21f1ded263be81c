"""Histograms of chosen pulses over the whole window, for users who want to see them; NumPy.

The receiver draws only the bins around echoes. Here every bin has its expected count, from the exact course of the free
SPADs, and a count drawn with the random number that the receiver uses for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...light.echoes import EchoTrain
from ...light.waveform import sample_power_w
from ...maths import random
from ...maths.arrays import Numbers
from ...maths.random import Seed, Stage
from ...physics.photon_counting import dead_time, draws
from ...sensor.detectors.spad_detector import Spad
from ...sensor.sensor_model import Sensor
from .expectation import broaden
from .folding import fold

_FINE = 8
"""Steps of each bin in which the course of the free SPADs is followed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Histograms:
    """Histograms of n pulses, over bins from the moment when the pulse leaves.

    Attributes:
        time_s: (bins,) middle of each bin
        expected: (n, bins) mean counts
        counts: (n, bins) counts, drawn
    """

    time_s: Numbers
    expected: Numbers
    counts: Numbers


def histograms(train: EchoTrain, sensor: Sensor, *, seed: Seed, pulse: Numbers) -> Histograms:
    """Expected and drawn histograms of n pulses over the whole window.

    Args:
        train: their light; NumPy
        pulse: (n,) uint32 pulse numbers
    """
    assert isinstance(sensor.detector, Spad)
    assert sensor.histogram is not None
    spad, bin_s = sensor.detector, float(sensor.histogram.bin_s)
    pixel = sensor.pixel(np.asarray(train.background_power_w)[:, None])
    count = int(float(sensor.tdc.window_s) / bin_s + 1e-6)
    fine_s = bin_s / _FINE
    times = (np.arange(count * _FINE) + 0.5) * fine_s
    light = fold(train, sensor.histogram).train
    # An echo is as wide as pulse and jitter; sums over the steps of a bin make it as wide as in the histogram.
    width_s = np.sqrt(pixel.sigma_s**2 - bin_s**2 / 12.0)
    spread, narrow = broaden(light, sensor, width_s)
    power = sample_power_w(spread, narrow, times)
    fires_once = spad.fires_once
    background = np.asarray(pixel.primary_hz) + np.zeros((len(pulse), 1))
    rate = power * pixel.per_watt + background
    armed = times >= float(sensor.tdc.blanking_s)
    # A step of the background alone comes first: it is what the SPADs are in balance with when the pulse leaves.
    fired = dead_time.firing_shares(
        np.concatenate(
            [0.0 * background if fires_once else background, np.where(armed | (not fires_once), rate, 0.0)], axis=1
        ),
        bin_s=fine_s,
        dead_time_s=np.inf if fires_once else float(spad.dead_time_s),
        steady=not fires_once,
        afterpulse=0.0 if spad.afterpulse is None else float(spad.afterpulse),
        afterpulse_s=1.0 if spad.afterpulse_s is None else float(spad.afterpulse_s),
    )[:, 1:]
    share = fired.reshape(len(pulse), count, _FINE).sum(axis=2)
    share = np.asarray(pixel.count_probability(share))
    bins = np.arange(count, dtype=np.uint32)
    words = random.words(
        seed=seed, stage=Stage.HISTOGRAM, pulse=np.repeat(pulse, count), draw=np.tile(bins // 2, len(pulse))
    )
    word = np.where(np.tile(bins % 2 == 0, len(pulse)), words[0], words[1]).reshape(len(pulse), count)
    trials = float(pixel.trials)
    return Histograms(
        time_s=(bins + 0.5) * bin_s,
        expected=trials * share,
        counts=np.asarray(draws.binomial_count(trials=trials, probability=share, uniform=random.open_uniform(word))),
    )
