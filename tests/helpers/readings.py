"""What a sampler reads of one echo, many times."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lidarscene import Sensor
from lidarscene.light.echoes import EchoTrain, Volume
from lidarscene.maths.arrays import LookupTable, Numbers

from . import trains
from .trains import SIGMA_M, detect, sensor, train

SHOTS = 8000

# An amplifier so noisy that the echo's own noise is nothing, and so fast that samples know nothing of one another.
WHITE = ["tdc.bandwidth_mhz=2000", "detector.circuit_noise_na=1e6", "tdc.threshold_to_noise=7"]
ADC = ["sampler.type='adc'", "sampler.rate_mhz=1000", "sampler.bits=20", "sampler.full_scale=100"]


CLEAN = ["detector.circuit_noise_na=1e6", "tdc.threshold_to_noise=1e4"]
"""Noise of 1e-4 of the threshold U, the echo's own included: edges move by some 1e-4 sigma_p."""


def readings(
    snr: float,
    *overrides: str,
    sub_echoes: Sequence[tuple[float, float]] = ((0.0, 1.0),),
    name: str = "table1-apd",
    seed: int = 6,
) -> tuple[Any, Any, Any]:
    """Errors of the range [m], amplitudes over the peak, widths [s] of echoes at SNR ``snr`` anywhere on the clock.

    Args:
        sub_echoes: places behind the first [m] and shares of the power
    """
    equipped = sensor(name, *overrides)
    range_m = np.random.default_rng(1).uniform(50.0, 60.0, SHOTS)
    offsets, shares = np.array(sub_echoes).T
    power = trains.power_at_snr(equipped, snr)
    light = train(range_m[:, None] + offsets, np.broadcast_to(power * shares, (SHOTS, len(shares))))
    stop: Any = detect(light, equipped, seed=seed).stops[0]
    is_echo = stop.reported & (stop.status == 0)
    assert is_echo.mean() > 0.99
    width_s = np.zeros(SHOTS) if stop.width_s is None else stop.width_s
    point = equipped.working_point(np.array([trains.BACKGROUND_W]))
    signal = float(np.ravel(point.response.signal(np.array([power])))[0])
    return (stop.range_m - range_m)[is_echo], stop.amplitude[is_echo] / signal, width_s[is_echo]


def on_light(
    equipped: Sensor, echoes: Sequence[tuple[float, float]], lasting: Sequence[tuple[float, float]]
) -> tuple[EchoTrain, Numbers, Numbers]:
    """Echoes on light that lasts: the train, U in watts, and the power over ranges in bins of sigma_p / 500.

    Args:
        echoes: (range [m], height in U) of each
        lasting: (range [m], height in U) of corners, between which the other light goes straight; none beyond the last
    """
    point = equipped.working_point(np.array([trains.BACKGROUND_W]))
    level_w = float(np.ravel(point.response.power_w(equipped.threshold(point)))[0])
    bins_m, (ranges_m, heights) = np.linspace(0.0, 150.0, 3001), np.array(echoes).T
    corners_m, corner_heights = np.array(lasting).T if lasting else ([0.0], [0.0])
    course = np.interp(bins_m, corners_m, corner_heights, left=0.0, right=0.0)
    air = Volume(
        shape=LookupTable(course),
        far_m=150.0,
        hump_m=(0.0, 150.0),
        scale=np.array([level_w if lasting else 0.0]),
        end_m=np.array([1e6]),
        extinction_per_m=0.0,
    )
    fine_m = np.arange(0.0, 150.0, SIGMA_M / 500.0)
    power = np.interp(fine_m, bins_m, course)
    for range_m, height in echoes:
        power = power + height * np.exp(-0.5 * ((fine_m - range_m) / SIGMA_M) ** 2)
    light = train(ranges_m[None, :], level_w * heights[None, :], volume=air if lasting else None)
    return light, fine_m, power
