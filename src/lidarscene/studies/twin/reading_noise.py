r"""Noise of a sensor's readings, and surfaces without it.

A twin that has the recorded noise in its surfaces would have it twice: once more when it is rendered. Smoothed surfaces
lack what is real. So a deviation e from the smooth surface keeps the part of its mean square that the sensor's noise
sigma leaves, and the simulated readings vary as much as the recorded ones:

.. math:: e' = e \sqrt{1 - \sigma^2 / \overline{e^2}} \tag{T208a}

and nothing where mean squares are those of noise, together (`_mere_noise`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...detection.outcomes import Status
from ...detection.receiver import detect
from ...light.echoes import Echoes
from ...light.fluctuations import fluctuate
from ...light.hits import relative_row_slope
from ...maths.arrays import Lanes, Numbers
from ...physics.photon_counting import shared_shots
from ...sensor.histogram import Histogram
from ...sensor.sensor_model import Sensor
from ..ranging.plane import Target, echoes_of_plane, fluctuation_variance
from .apparent_reflectivity import board, white_signal
from .planes import Grid, Planes, shifted
from .tuning import ALONG, FAR_M, LEAST_COS, MOST_BEAM_M, MOST_BY_CHANCE, NOISE_BINS, NOISE_SHOTS

LAGS = sum(ALONG)
"""Pixels of a row that share in the mean of a mean."""

INDEPENDENT: Numbers = np.eye(LAGS)[0]
"""Correlation of noise that pixels do not share."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadingNoise:
    """Standard deviations of what a sensor reads of a surface from shot to shot.

    Attributes:
        range_m: (rows, columns) of the range; NaN where nothing returned
        log_strength: (rows, columns) of the logarithm of photons or intensity
        correlation: (`LAGS`,) correlation of the noise of ranges so many pixels of a row apart
    """

    range_m: Numbers
    log_strength: Numbers
    correlation: Numbers

    @classmethod
    def of(cls, sensor: Sensor, range_m: Numbers, apparent: Numbers, step_rad: float) -> ReadingNoise | None:
        """Measure the noise of boards at these ranges that the sensor sees twice; None if it hardly sees any.

        Args:
            sensor: any sensor; its own stages detect the boards
            range_m: (rows, columns) ranges, NaN where nothing returned
            apparent: (rows, columns) apparent reflectivities
            step_rad: azimuth from one pixel of a row to the next
        """
        returned = np.flatnonzero(np.isfinite(range_m))
        shots = np.random.default_rng(0).choice(returned, min(NOISE_SHOTS, len(returned)), replace=False)
        drawn, drawn_m = (values.ravel()[shots] for values in (apparent, range_m))
        light = echoes_of_plane(sensor, board(drawn), drawn_m)
        variance = fluctuation_variance(sensor, Target(), drawn_m)
        readings = [read_boards(sensor, light, variance, seed) for seed in (0, 1)]
        read = np.isfinite(readings[0] + readings[1]).all(axis=0)
        power_w = np.asarray(light.peak_power_w)[read]
        if len(power_w) < NOISE_BINS**2:
            return None
        change = (readings[1] - readings[0])[:, read] / np.sqrt(2.0)
        bins = np.array_split(np.argsort(power_w), NOISE_BINS)
        middle = np.array([np.median(power_w[members]) for members in bins])
        sigma = np.array([[np.sqrt(np.mean(row[members] ** 2)) for members in bins] for row in change])
        all_w = np.full(range_m.shape, np.nan)
        boards = board(apparent.flat[returned])
        all_w.flat[returned] = echoes_of_plane(sensor, boards, range_m.flat[returned]).peak_power_w
        range_sigma_m, log_sigma = (np.interp(all_w, middle, row) for row in sigma)
        return cls(range_m=range_sigma_m, log_strength=log_sigma, correlation=_correlation(sensor, step_rad))


def _correlation(sensor: Sensor, step_rad: float) -> Numbers:
    """Correlation of the noise of ranges by the pixels of a row between them."""
    apart = np.arange(LAGS)
    if sensor.histogram is None or sensor.histogram.column_weights is None:
        return INDEPENDENT
    weights = [float(weight) for weight in sensor.histogram.window.values()]
    return np.asarray(shared_shots.correlation(weights, round(abs(step_rad) / sensor.histogram.column_rad) * apart))


def read_boards(sensor: Sensor, light: Echoes, variance: Lanes | None, seed: int) -> Numbers:
    """(2, n) ranges and logarithms of strengths that the sensor reads of these echoes; NaN where it reads none.

    Args:
        variance: relative variance of their powers (`fluctuation_variance`); None: they do not fluctuate
    """
    pulse = np.arange(np.size(light.range_m), dtype=np.uint32)
    if variance is not None:
        # Nobody asks for the P_d of all powers that might be drawn, which would take most of the time.
        light = replace(fluctuate(light, variance, seed=seed, pulse=pulse), fluctuation=None)
    stop = detect(light, sensor, seed=seed, pulse=pulse).stops[0]
    strength = stop.intensity if sensor.histogram is None else stop.amplitude
    read = np.asarray(stop.reported & (stop.status == int(Status.ECHO)) & (strength > 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(read, np.stack([np.asarray(stop.range_m), np.log(np.asarray(strength))]), np.nan)


def surface_without_noise(
    sensor: Sensor, grid: Grid, planes: Planes, apparent: Numbers
) -> tuple[Numbers, Numbers, Numbers]:
    """Ranges and apparent reflectivities of a sweep whose returns lack the noise of their readings; which are smooth.

    Smooth are the returns of smooth planes within `MOST_BEAM_M` of them along the beam: paint or a kerb in the beam
    moves the others, as no surface of one pixel does.

    Args:
        sensor: the sensor that recorded
        apparent: (rows, columns) apparent reflectivities as recorded
    """
    returned, flat_m = grid.sweep.has_return, np.where(planes.has_plane, planes.range_m, 0.0)
    measured_m = np.where(returned, grid.sweep.range_m, np.nan)
    noise = ReadingNoise.of(sensor, measured_m, apparent, grid.step_rad)
    if noise is None:
        return np.where(planes.has_plane, planes.range_m, grid.sweep.range_m), apparent, planes.smooth()
    range_sigma_m = np.hypot(
        _noise_on_planes(noise.range_m, apparent, sensor, grid, planes), pointing_noise_m(sensor, _lean_m(grid, planes))
    )
    off_m = without_noise(measured_m - flat_m, range_sigma_m, noise.correlation)
    # On ground that is seen flat a pixel may be near its plane and metres off along the beam. Quads out there would
    # stand before their neighbours, as a second surface. A corner's plane is that of neither side: pixels stay there.
    smooth, share = planes.smooth(), np.clip(2.0 - np.abs(off_m) / MOST_BEAM_M, 0.0, 1.0)
    range_m = flat_m + np.where(smooth, share, 1.0) * off_m
    log_apparent = without_noise(np.where(returned, np.log(apparent), np.nan), noise.log_strength, INDEPENDENT)
    apparent = np.where(returned, np.exp(log_apparent), apparent)
    return np.where(returned, range_m, planes.range_m), apparent, smooth & (share == 1.0)


def _noise_on_planes(level_m: Numbers, apparent: Numbers, sensor: Sensor, grid: Grid, planes: Planes) -> Numbers:
    """Noise of each pixel's range, ``level_m`` on a surface that does not lean along its row, (T176a).

    Columns count less by the noise of the pixel's own light, which weak returns have less of (T176b).
    """
    histogram = sensor.histogram
    if histogram is None or histogram.column_range_sigmas is None:
        return level_m
    direction = np.moveaxis(grid.sweep.direction, -1, 0)
    row_slope = relative_row_slope(tuple(np.moveaxis(planes.normal, -1, 0)), tuple(direction))
    step_m = row_slope * np.where(planes.has_plane, planes.range_m, 0.0) * histogram.column_rad
    range_m = np.where(grid.sweep.has_return, grid.sweep.range_m, FAR_M)
    own_m = level_m / histogram.noise_left(apparent * white_signal(sensor, range_m))
    return level_m * noise_by_step(histogram, np.asarray(step_m / (float(histogram.column_range_sigmas) * own_m)))


def noise_by_step(histogram: Histogram, step: Numbers) -> Numbers:
    """Noise of ranges over that of a level surface, (T176a), where columns differ by ``step`` reaches."""
    window = {column: float(weight) for column, weight in histogram.window.items()}
    return np.asarray(shared_shots.shares(window, step)[1])


def pointing_noise_m(sensor: Sensor, lean_m: Numbers) -> Numbers | float:
    """Noise of ranges by beams that miss their directions: the jitter times the lean R tan(beta) of the surface."""
    return 0.0 if sensor.scanner.jitter_rad is None else np.asarray(float(sensor.scanner.jitter_rad) * lean_m)


def lean_of(range_m: Numbers, cosine: Numbers) -> Numbers:
    """Range times tangent of the incidence, to which the length of an echo goes."""
    return np.asarray(range_m * np.sqrt(np.maximum(1.0 / np.maximum(cosine, LEAST_COS) ** 2 - 1.0, 0.0)))


def _lean_m(grid: Grid, planes: Planes) -> Numbers:
    """Lean of each pixel's plane [m]; 0 where it has none."""
    cosine = -np.einsum("...i,...i", planes.normal, grid.sweep.direction)
    with np.errstate(invalid="ignore"):
        return np.where(planes.has_plane, lean_of(planes.range_m, cosine), 0.0)


def without_noise(values: Numbers, sigma: Numbers, correlation: Numbers) -> Numbers:
    """Values of rows whose deviations from means of `ALONG` pixels are those of the surface, as (T208a).

    Only in a row noise is told from the surface: calibration and elevation differ from row to row. Deviations from the
    mean of a few pixels come first, then those of that mean from a wider one. Values without as many neighbours stay.

    Args:
        values: (rows, columns) as recorded, NaN where nothing is known
        sigma: (rows, columns) noise
        correlation: (`LAGS`,) of the noise of pixels so many columns apart
    """
    places = np.arange(LAGS)
    shared = correlation[np.abs(places[:, None] - places)]
    weights, rest = np.eye(LAGS)[LAGS // 2], values
    surface = np.zeros_like(values)
    for along in ALONG:
        mean_weights, mean = np.convolve(weights, np.full(along, 1.0 / along), "same"), _mean(rest, along, 0)
        left = (weights - mean_weights) @ shared @ (weights - mean_weights)  # of the noise's square
        off = rest - mean
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = _mean(off * off, along, 1) / (left * _mean(sigma**2, along, 0))
            share = np.sqrt(np.where(ratio <= _mere_noise(ratio), 0.0, 1.0 - 1.0 / ratio))
        known = np.isfinite(share * off)
        surface = np.where(known, surface + share * off, surface)
        weights, rest = mean_weights, np.where(known, mean, rest)
    return np.asarray(surface + rest)


def _mere_noise(ratio: Numbers) -> float:
    """Largest ratio up to which mean squares are together those of the noise alone.

    The mean square of a few deviations scatters. If each kept what is above the noise's, and those below it nothing,
    mere noise would leave a texture.
    """
    ordered = np.sort(ratio[ratio < MOST_BY_CHANCE])
    return float(ordered[np.cumsum(ordered - 1.0) <= 0.0].max(initial=1.0))


def _mean(values: Numbers, along: int, rows: int) -> Numbers:
    """Mean over so many columns about each pixel, and over those of so many rows to both sides that lack no value."""
    columns = range(-(along // 2), along // 2 + 1)
    in_row = np.mean([np.roll(values, column, axis=1) for column in columns], axis=0)
    around = np.stack([shifted(in_row, row, 0) for row in range(-rows, rows + 1)])
    known = np.isfinite(around)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(known, around, 0.0).sum(axis=0) / known.sum(axis=0))
