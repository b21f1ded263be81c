"""A SiPM under a background and a pulse, measured shot by shot: noise, signal, detection, false alarms, timing.

What a laboratory would measure, and what `sensor.detectors.WorkingPoint` predicts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lidarscene.maths.arrays import Numbers
from lidarscene.physics.electronics.sipm_response import LATEST_PEAK

from .events import simulate
from .output import waveforms

_EDGE = 2.0  # FWHM before the peak at which a shot begins
_DARK_WINDOW = 20  # dead times of a shot that is watched for false alarms
_DARK_SEED = 1  # added to the seed of the shots with a pulse


@dataclass(frozen=True, slots=True, kw_only=True)
class Moments:
    """Mean, variance and skewness of the output over shots, (samples,) each."""

    time_s: Numbers
    mean: Numbers
    variance: Numbers
    skewness: Numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """A working point; levels in units of one recovered cell above the mean before the pulse.

    Attributes:
        noise: of the output without echo; ``before`` is its mean
        before: of the output without echo; ``before`` is its mean
        skewness_before: of the output without echo; ``before`` is its mean
        signal: of the output at ``peak_time_s``, where its mean is highest
        peak_noise: of the output at ``peak_time_s``, where its mean is highest
        peak_skewness: of the output at ``peak_time_s``, where its mean is highest
        snr: signal / noise, to compare with (27)
        threshold: of the comparator, U
        false_alarm_probability: that one sample without echo is >= U, to compare with (9)
        false_alarm_rate_hz: of a single-stop converter: -log(share of quiet shots) over the watched window
        detection_probability: that the sample at ``peak_time_s`` is >= U
        tripped: share of shots whose output passes U between 2 FWHM before the pulse's peak and the end of what it
            leaves: 2 FWHM after its last cells revive
        crossing_s: mean of the time of passing; nan if it never does
        crossing_deviation_s: standard deviation of the time of passing
    """

    shots: int
    before: float
    noise: float
    skewness_before: float
    peak_time_s: float
    signal: float
    peak_noise: float
    peak_skewness: float
    snr: float
    threshold: float
    false_alarm_probability: float
    false_alarm_rate_hz: float
    detection_probability: float
    tripped: float
    crossing_s: float
    crossing_deviation_s: float


def outputs(array, light, *, start_s, end_s, shots, seed, steps=16):
    """(samples,) times and (shots, samples) outputs in single precision, some shots at a time.

    Args:
        steps: samples per dead time
    """
    step = array.dead_time_s / steps
    samples = max(1, math.floor((end_s - start_s) / step + 1e-6) + 1)
    time_s = start_s + step * np.arange(samples)
    runs = simulate(array, light, start_s=start_s, end_s=time_s[-1] + 0.5 * step, shots=shots, seed=seed)
    for count, avalanches in runs:
        wave = waveforms(array, avalanches, shots=count, start_s=start_s, step_s=step, samples=samples)
        yield time_s, wave.astype(np.float32)


def all_outputs(array, light, *, start_s, end_s, shots, seed, steps=16):
    """`outputs` of all shots in one array."""
    runs = list(outputs(array, light, start_s=start_s, end_s=end_s, shots=shots, seed=seed, steps=steps))
    return runs[0][0], np.concatenate([wave for _, wave in runs])


def pulse_outputs(array, light, *, shots, seed, steps=16, until_revival=False):
    """Times and outputs from 2 FWHM before the light's peak until the output's mean has peaked.

    Args:
        until_revival: go on until cells of a box shape have revived
    """
    # On the sampling grid, so that one sample falls on the light's peak.
    step = array.dead_time_s / steps
    start_s = -step * math.ceil(_EDGE * light.pulse_fwhm_s / step)
    if array.shape == "box" and until_revival:
        end_s = array.dead_time_s + _EDGE * light.pulse_fwhm_s
    elif array.shape == "box":
        end_s = min(_EDGE * light.pulse_fwhm_s, LATEST_PEAK * array.dead_time_s)
    else:
        end_s = _EDGE * light.pulse_fwhm_s + 4.0 * array.rise_s
    return all_outputs(array, light, start_s=start_s, end_s=end_s, shots=shots, seed=seed, steps=steps)


def moments(time_s: Numbers, wave: Numbers) -> Moments:
    """Mean, variance and skewness over shots, at each sample."""
    centre = wave.mean(axis=0, dtype=np.float64)
    variance, third = np.zeros((2, len(time_s)))
    for rows in np.array_split(wave, max(1, len(wave) // 10_000)):
        residual = rows - centre
        square = residual * residual
        variance += square.sum(axis=0)
        third += (square * residual).sum(axis=0)
    variance, third = variance / len(wave), third / len(wave)
    quiet = variance <= 0.0
    skewness = np.where(quiet, 0.0, third / np.where(quiet, 1.0, variance) ** 1.5)
    return Moments(time_s=time_s, mean=centre, variance=variance, skewness=skewness)


def measure(array, light, *, threshold_to_noise=5.0, threshold=None, shots=100000, seed=0, steps=16):
    """The working point of these cells under this light.

    Args:
        threshold: in cells above the mean before the pulse; if None, threshold_to_noise times the noise, at least 1
        steps: samples per dead time, which is also how often the comparator looks
    """
    window_s = _DARK_WINDOW * array.dead_time_s
    dark_time, dark = all_outputs(
        array,
        replace(light, signal_photons=0.0),
        start_s=0.0,
        end_s=window_s,
        shots=max(shots // 10, 1),
        seed=seed + _DARK_SEED,
        steps=steps,
    )
    time_s, wave = pulse_outputs(array, light, shots=shots, seed=seed, steps=steps, until_revival=True)
    # Stationary: every sample has the same distribution.
    still, pulse = moments(dark_time, dark), moments(time_s, wave)
    before, noise = float(still.mean.mean()), math.sqrt(float(still.variance.mean()))
    level = max(threshold_to_noise * noise, 1.0) if threshold is None else threshold
    absolute = before + level - 1e-4  # rounding must not lift a count that just reaches it
    top = int(np.argmax(pulse.mean))
    above, rate_hz = _alarms(dark, absolute, window_s)
    crossings = _first_passages(time_s, wave, absolute)
    signal = float(pulse.mean[top]) - before
    return Measured(
        shots=shots,
        before=before,
        noise=noise,
        skewness_before=float(still.skewness.mean()),
        peak_time_s=float(time_s[top]),
        signal=signal,
        peak_noise=math.sqrt(float(pulse.variance[top])),
        peak_skewness=float(pulse.skewness[top]),
        snr=signal / noise if noise > 0.0 else math.inf,
        threshold=level,
        false_alarm_probability=above,
        false_alarm_rate_hz=rate_hz,
        detection_probability=float(np.mean(wave[:, top] >= absolute)),
        tripped=len(crossings) / shots,
        crossing_s=float(crossings.mean()) if len(crossings) else math.nan,
        crossing_deviation_s=float(crossings.std()) if len(crossings) else math.nan,
    )


def _first_passages(time_s: Numbers, wave: Numbers, absolute: float) -> Numbers:
    """Time of each shot's first upward passage, if it has one, linear between samples."""
    if wave.shape[1] < 2:
        return np.zeros(0)
    high = wave >= absolute
    up = high[:, 1:] & ~high[:, :-1]
    row = np.flatnonzero(up.any(axis=1))
    after = np.argmax(up[row], axis=1) + 1
    low, above = wave[row, after - 1].astype(np.float64), wave[row, after].astype(np.float64)
    share = (absolute - low) / (above - low)
    return np.asarray(time_s[after - 1] + share * (time_s[after] - time_s[after - 1]))


def _alarms(wave: Numbers, absolute: float, window_s: float) -> tuple[float, float]:
    """Share of samples at or above the level, and rate of first passages [1/s]; inf if no shot is quiet."""
    high = wave >= absolute
    quiet = int(np.count_nonzero(~high.any(axis=1)))
    low_at_first = int(np.count_nonzero(~high[:, 0]))
    rate_hz = math.log(low_at_first / quiet) / window_s if quiet else math.inf
    return float(np.mean(high)), rate_hz
