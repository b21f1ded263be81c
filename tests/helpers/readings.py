"""What a sampler reads of one echo, many times."""

import numpy as np

from . import trains
from .trains import detect, sensor, train

SHOTS = 8000

# An amplifier so noisy that the echo's own noise is nothing, and so fast that samples know nothing of one another.
WHITE = ["tdc.bandwidth_mhz=2000", "detector.circuit_noise_na=1e6", "tdc.threshold_to_noise=7"]
ADC = ["sampler.type='adc'", "sampler.rate_mhz=1000", "sampler.bits=20", "sampler.full_scale=100"]


def readings(snr, *overrides, sub_echoes=((0.0, 1.0),), name="table1-apd", seed=6):
    """Errors of the range [m], amplitudes over the peak, widths [s] of echoes at SNR ``snr`` anywhere on the clock.

    sub_echoes  places behind the first [m] and shares of the power
    """
    equipped = sensor(name, *overrides)
    range_m = np.random.default_rng(1).uniform(50.0, 60.0, SHOTS)
    offsets, shares = np.array(sub_echoes).T
    power = trains.power_at_snr(equipped, snr)
    light = train(range_m[:, None] + offsets, np.broadcast_to(power * shares, (SHOTS, len(shares))))
    stop = detect(light, equipped, seed=seed).stops[0]
    kept = stop.reported & (stop.status == 0)
    assert kept.mean() > 0.99
    width_s = np.zeros(SHOTS) if stop.width_s is None else stop.width_s
    signal = float(equipped.working_point(light.background_power_w[:1]).signal(np.array([power]))[0])
    return (stop.range_m - range_m)[kept], stop.amplitude[kept] / signal, width_s[kept]
