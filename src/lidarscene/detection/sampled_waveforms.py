"""Waveforms: chosen pulses and a road to their EchoTrains in, power and signal against time out, and into a file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..light.echoes import EchoTrain
from ..light.waveform import sampled
from ..maths.arrays import Numbers
from ..physics.optics import radiometry
from ..sensor.detectors import Apd
from ..sensor.model import Sensor

MOST_PULSES = 10_000
"""Each has some ten thousand samples."""

SAMPLES_PER_FWHM = 16
"""A Gaussian in steps this fine is a straight line between two samples to 7e-4 of its peak."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Waveforms:
    """What some pulses bring back, without noise.

    pulse       (n,) uint32 pulse number, rising, counted from the run's first frame on as in `--keep-missed`
    time_s      (times,) after the middle of the pulse left
    range_m     (times,) c t / 2
    power_w     (n, times) float32, optical, of echoes and of the air; the background is not in it
    background_w  (n,) float32, steady
    signal      (n, times) float32, mean of the detector's signal above that of the background
    threshold   (n,) float32, of the comparator
    unit        of signal and threshold: "A" (APD) or "cells" (SiPM)
    channel     (n,) uint16; azimuth_rad, elevation_rad (n,) float32, as the sensor reports them
    """

    pulse: Numbers
    time_s: Numbers
    range_m: Numbers
    power_w: Numbers
    background_w: Numbers
    signal: Numbers
    threshold: Numbers
    unit: str
    channel: Numbers
    azimuth_rad: Numbers
    elevation_rad: Numbers


def check_pulses(pulses: Sequence[int], sensor: Sensor) -> Numbers:
    """The different ones, rising. Raises InputError."""
    chosen = np.unique(np.asarray(pulses, dtype=np.int64))
    count = sensor.scanner.pulses
    wrong = chosen[(chosen < 0) | (chosen >= count)]
    if len(wrong):
        raise InputError(f"pulses: 0 to {count - 1} was expected, the frame has no more; {wrong[0]} came")
    if not 0 < len(chosen) <= MOST_PULSES:
        raise InputError(f"pulses: 1 to {MOST_PULSES} of them were expected, {len(chosen)} came")
    return chosen


def window_times_s(sensor: Sensor) -> Numbers:
    """The converter's window in even steps."""
    step = float(sensor.laser.pulse_fwhm_s) / SAMPLES_PER_FWHM
    return np.asarray(step * np.arange(int(float(sensor.tdc.window_s) / step) + 1))


def sampled_pulses(
    train_of: Callable[[int, int], EchoTrain],
    chosen: Numbers,
    sensor: Sensor,
    times_s: Numbers | None,
    *,
    first_pulse: int,
) -> Waveforms:
    """Waveforms of these pulses of a frame.

    train_of     from the first and the number of pulses that follow each other to what they bring back, numpy
    first_pulse  of the frame
    """
    times = window_times_s(sensor) if times_s is None else np.asarray(times_s, dtype=np.float64)
    powers, signals, backgrounds = [], [], []
    for together in np.split(chosen, np.flatnonzero(np.diff(chosen) > 1) + 1):
        pulse_train = train_of(int(together[0]), len(together))
        power, signal = sampled(pulse_train, sensor, times)
        powers.append(power.astype(np.float32))
        signals.append(signal.astype(np.float32))
        backgrounds.append(pulse_train.background_power_w + np.zeros(len(together)))
    background = np.concatenate(backgrounds)
    threshold = np.asarray(sensor.threshold(sensor.working_point(background))) + np.zeros(len(chosen))
    pulse = (chosen + first_pulse).astype(np.uint32)
    azimuth, elevation = sensor.scanner.angles(pulse)
    return Waveforms(
        pulse=pulse,
        time_s=times,
        range_m=np.asarray(radiometry.range_from_time_of_flight_m(time_of_flight_s=times)),
        power_w=np.concatenate(powers),
        background_w=background.astype(np.float32),
        signal=np.concatenate(signals),
        threshold=threshold.astype(np.float32),
        unit="A" if isinstance(sensor.detector, Apd) else "cells",
        channel=np.asarray(sensor.scanner.channel(pulse)).astype(np.uint16),
        azimuth_rad=np.asarray(azimuth, dtype=np.float32),
        elevation_rad=np.asarray(elevation, dtype=np.float32),
    )
