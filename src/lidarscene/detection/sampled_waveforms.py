"""Sampled waveforms: optical power and detector signal of chosen pulses over time, without noise.

The chain never samples a waveform: detection finds peaks and crossings as roots. This module samples the same light for
users who want to see it or to feed it to a detector model of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..light.echoes import EchoTrain
from ..light.waveform import sample_power_and_signal, sample_power_w
from ..maths.arrays import Numbers
from ..maths.random import Seed
from ..physics.optics import radiometry
from ..sensor.detectors import Wave
from ..sensor.sensor_model import Sensor
from .photon_counting.folding import fold
from .photon_counting.histograms import histograms

MOST_PULSES = 10_000
"""Most pulses of one call: each has some ten thousand samples."""

SAMPLES_PER_FWHM = 16
"""Samples in one pulse width: linear interpolation of a Gaussian is then good to 7e-4 of its peak."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Waveforms:
    """Waveforms of some pulses, without noise.

    Attributes:
        pulse: (n,) int64 pulse numbers, rising, counted from the run's first frame as in `--keep-missed`
        time_s: (times,) time since the middle of the pulse left
        range_m: (times,) c t / 2
        power_w: (n, times) float32, optical power of echoes and air, without the background
        background_w: (n,) float32, constant optical power of the background
        signal: (n, times) float32, mean signal of the detector above that of the background, with what earlier light of
            the pulse leaves in it (`sample_with_memory`)
        threshold: (n,) float32, level of the comparator
        unit: unit of signal and threshold: "A" (APD), "cells" (SiPM) or "photons" (histogram of counts)
        channel: (n,) uint16, as the sensor reports it
        azimuth_rad: (n,) float32, as the sensor reports it
        elevation_rad: (n,) float32, as the sensor reports it
        counts: (n, times) float32, of a receiver that sums shots: its histogram, with the noise of a frame; the times
            are the middles of its bins, and the signal is the mean count of each; None of any other
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
    counts: Numbers | None = None


def check_pulses(pulses: Sequence[int], sensor: Sensor) -> Numbers:
    """Check chosen pulse numbers; returns the distinct ones, rising, (n,) int64.

    Raises:
        InputError: for a number that the frame does not have, and for none or more than `MOST_PULSES`
    """
    chosen = np.unique(np.asarray(pulses, dtype=np.int64))
    count = sensor.scanner.pulses
    wrong = chosen[(chosen < 0) | (chosen >= count)]
    if len(wrong):
        raise InputError(f"pulses: must be 0 to {count - 1}, the pulses of a frame, got {wrong[0]}")
    if not 0 < len(chosen) <= MOST_PULSES:
        raise InputError(f"pulses: must be 1 to {MOST_PULSES} of them, got {len(chosen)}")
    return chosen


def window_times_s(sensor: Sensor) -> Numbers:
    """Times over the converter's window in even steps, (times,) s."""
    step = float(sensor.laser.pulse_fwhm_s) / SAMPLES_PER_FWHM
    return np.asarray(step * np.arange(int(float(sensor.tdc.window_s) / step) + 1))


def sample_with_memory(train: EchoTrain, sensor: Sensor, times_s: Numbers) -> tuple[Numbers, Numbers]:
    """`light.waveform.sample_power_and_signal` with the memory of the detector: (n, times) W and signal each.

    A SiPM in the time domain follows its own equation, with crosstalk and afterpulses; an amplifier that clips drains
    (docs/theory_receivers.md 2). Behind a frequency response cells have no memory here.
    """
    power, signal = sample_power_and_signal(train, sensor, times_s)
    if not len(times_s):
        return power, signal
    fwhm_s = float(sensor.laser.pulse_fwhm_s)
    step_s = sensor.detector.course_step_s(fwhm_s / SAMPLES_PER_FWHM, filtered=sensor.receiver.filters)
    if step_s is None:
        return power, signal
    # Memory needs all light from the first on, whatever times are asked for.
    first, last = -math.ceil(3.0 * fwhm_s / step_s), math.ceil(float(np.max(times_s)) / step_s) + 2
    course_s = step_s * np.arange(first, last)
    wave = Wave(
        point=sensor.working_point(np.asarray(train.background_power_w) + np.zeros(len(power))),
        reception=sensor.reception,
        power_w=lambda time_s: sample_power_w(train, sensor, time_s),
        signal=lambda time_s: sample_power_and_signal(train, sensor, time_s)[1],
    )
    course = sensor.detector.course_in_time(wave, course_s, step_s)
    return power, np.stack([np.interp(times_s, course_s, row) for row in course])


def sample_waveforms(
    train_of: Callable[[int, int], EchoTrain],
    pulse: Numbers,
    sensor: Sensor,
    times_s: Numbers | None,
    *,
    pulse_in_run: Numbers,
    seed: Seed = 0,
) -> Waveforms:
    """Waveforms of chosen pulses of a frame.

    Args:
        train_of: ``train_of(first, count)`` traces consecutive pulses of the frame; its EchoTrain is NumPy
        pulse: (n,) rising pulse numbers since the rollover of the frame
        times_s: (times,) time since the middle of the pulse left; None: `window_times_s`
        pulse_in_run: (n,) int64 the pulses' numbers counted from the run's first frame
        seed: seed of the frame, for the counts of a histogram

    Raises:
        InputError: for times with a sensor whose histogram has its own
    """
    if sensor.histogram is not None and times_s is not None:
        raise InputError("times_s: must be left out for a histogram, whose bins are the times")
    times = window_times_s(sensor) if times_s is None else np.asarray(times_s, dtype=np.float64)
    powers, signals, backgrounds, counts = [], [], [], []
    # Each run of consecutive pulses is traced in one call.
    for run in np.split(pulse, np.flatnonzero(np.diff(pulse) > 1) + 1):
        pulse_train = train_of(int(run[0]), len(run))
        if sensor.histogram is None:
            power, signal = sample_with_memory(pulse_train, sensor, times)
        else:
            pulse_histograms = histograms(pulse_train, sensor, seed=seed, pulse=run.astype(np.uint32))
            times, signal = pulse_histograms.time_s, pulse_histograms.expected
            counts.append(pulse_histograms.counts.astype(np.float32))
            power = sample_power_w(fold(pulse_train, sensor.histogram).train, sensor, times)
        powers.append(power.astype(np.float32))
        signals.append(signal.astype(np.float32))
        backgrounds.append(pulse_train.background_power_w + np.zeros(len(run)))
    background = np.concatenate(backgrounds)
    threshold = np.asarray(sensor.threshold(sensor.working_point(background))) + np.zeros(len(pulse))
    azimuth, elevation = sensor.scanner.angles(pulse_in_run)
    return Waveforms(
        pulse=pulse_in_run,
        time_s=times,
        range_m=np.asarray(radiometry.range_from_time_of_flight_m(time_of_flight_s=times)),
        power_w=np.concatenate(powers),
        background_w=background.astype(np.float32),
        signal=np.concatenate(signals),
        threshold=threshold.astype(np.float32),
        unit=sensor.detector.unit,
        channel=np.asarray(sensor.scanner.channel(pulse_in_run)).astype(np.uint16),
        azimuth_rad=np.asarray(azimuth, dtype=np.float32),
        elevation_rad=np.asarray(elevation, dtype=np.float32),
        counts=np.concatenate(counts) if counts else None,
    )
