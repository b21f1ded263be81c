r"""What a sensor reads of boards, without chance: noise of the range and share kept, by an echo's power and length.

The sensor's own stages read echoes of some powers and lengths again and again, without the clock's jitter and step.
Every other echo lies between them. So a law of these readings is smooth, and none of its numbers costs a further one:

.. math:: \sigma_R^2 = \sigma_\mathrm{edge}^2 + \tfrac{c^2}{4} \left((1 - p)\, j^2 + p\, j_s^2
    + \tfrac{\mathrm{lsb}^2}{12}\right) + (\theta R \tan\beta)^2 \tag{T185c}

Symbols: p probability that an echo is timed by the channel of strong ones, j and j_s the jitters without and with it,
lsb step of the clock, theta deviation of a beam from its direction, beta incidence. A change between two readings is
normal with that of none, one or both of them in this channel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ...light.echoes import Echoes
from ...maths.arrays import Lanes, Numbers
from ...maths.special import normal_tail
from ...physics.constants import SPEED_OF_LIGHT_M_S
from ...sensor.electronics import Tdc
from ...sensor.sensor_model import Sensor
from ..ranging.plane import Target, fluctuation_variance, margin_of_light, probability_of_light
from ..twin.judge import spread
from ..twin.reading_noise import pointing_noise_m, read_boards
from .tuning import (
    CLEAR_MARGIN,
    LEAST_MARGIN,
    LEAST_READ,
    LEAST_SHARE,
    LENGTHS,
    POWER_STEP,
    READINGS,
    SAMPLES_M,
    SMOOTHING,
)


class BoardNoise(NamedTuple):
    """What the tables say of n echoes.

    Attributes:
        place: (2, n) in the tables, in their steps
        square_m2: (n,) mean square of the range without the clock's part
        strong: (n,) share that the channel of strong echoes times
    """

    place: Numbers
    square_m2: Numbers
    strong: Numbers


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardLaw:
    """Readings of echoes of k powers and m lengths.

    Attributes:
        sensor: that reads them
        echoes: (k m,) of the tables
        shape: (k, m)
        first: (2,) logarithms of the least power and length
        log_square: (k, m) logarithms of the mean squares of the ranges [m2], without jitter and step of the clock
        variance: relative variance of the power from pulse to pulse; None: it does not fluctuate
    """

    sensor: Sensor
    echoes: Echoes
    shape: tuple[int, int]
    first: Numbers
    log_square: Numbers
    variance: Lanes | None

    @classmethod
    def of(cls, sensor: Sensor, light: Echoes, most: float = 1.0) -> BoardLaw:
        """Read echoes again and again.

        Args:
            light: (n,) echoes of boards; those of the tables have their median range and background
            most: largest power over the largest of these
        """
        middle = replace(
            light,
            **{name: np.median(getattr(light, name), keepdims=True) for name in ("range_m", "background_power_w")},
            broadening=None if light.broadening is None else np.ones(1),
            row_slope=None,
        )
        lengths = np.log(LENGTHS if light.broadening is not None else LENGTHS[:1])
        first_w = np.asarray(light.peak_power_w)[:1]
        faint = _echoes(middle, np.log(first_w), np.zeros(1))
        least = math.log(LEAST_MARGIN * first_w[0] / margin_of_light(sensor, faint)[0])
        powers = np.arange(least, max(least, math.log(most * np.max(light.peak_power_w))) + POWER_STEP, POWER_STEP)
        log_power, log_length = (values.ravel() for values in np.meshgrid(powers, lengths, indexing="ij"))
        echoes = _echoes(middle, log_power, log_length)
        variance = fluctuation_variance(sensor, Target(), echoes.range_m)
        no_clock = replace(sensor.tdc, chatter_hz=None, jitter_s=0.0, strong_jitter_s=None, least_significant_bit_s=0.0)
        reader = replace(sensor, tdc=no_clock, intensity=None)  # intensities of weak echoes near by are rounded to 0
        often = np.where(margin_of_light(sensor, echoes) < CLEAR_MARGIN, *READINGS)
        read = _echoes(middle, np.repeat(log_power, often), np.repeat(log_length, often))
        # An echo scatters by where it is between two samples, so each is read twice there.
        between_m = np.random.default_rng(0).uniform(0.0, SAMPLES_M, often.sum())
        read = replace(read, range_m=read.range_m + between_m)
        fluctuates = None if variance is None else np.repeat(variance, often)
        change_m = np.subtract(*(read_boards(reader, read, fluctuates, seed)[0] for seed in (0, 1))) / math.sqrt(2.0)
        known = [values[np.isfinite(values)] for values in np.split(change_m, np.cumsum(often)[:-1])]
        counts = np.array([len(values) if len(values) >= LEAST_READ else 0 for values in known])
        logs = [2.0 * math.log(max(spread(values), 1e-9)) if len(values) >= LEAST_READ else 0.0 for values in known]
        shape = len(powers), len(lengths)
        return cls(
            sensor=sensor,
            echoes=echoes,
            shape=shape,
            first=np.array([powers[0], lengths[0]]),
            log_square=_smooth(np.reshape(logs, shape), counts.reshape(shape)),
            variance=variance,
        )

    def noise(self, light: Echoes, lean_m: Numbers) -> BoardNoise:
        """Look up echoes of boards that lean so; those beyond the ends of the tables are as the end."""
        length = 1.0 if light.broadening is None else light.broadening
        logs = np.log(np.stack(np.broadcast_arrays(light.peak_power_w, length)))
        steps = np.array([POWER_STEP, np.log(LENGTHS[1])])
        place = np.clip(((logs.T - self.first) / steps).T, 0.0, np.array(self.shape)[:, None] - 1.0)
        square_m2 = np.exp(_at(self.log_square, place)) + pointing_noise_m(self.sensor, lean_m) ** 2
        above = self.sensor.tdc.strong_above
        if above is None:
            return BoardNoise(place, square_m2, np.zeros_like(square_m2))
        point = self.sensor.working_point(self.echoes.background_power_w)
        signal = point.response.signal(self.echoes.peak_power_w)
        variance = (0.0 if self.variance is None else self.variance) + (point.noise.at(signal) / signal) ** 2
        width = np.sqrt(variance + float(self.sensor.tdc.strong_spread or 0.0) ** 2)
        deviate = np.log(margin_of_light(self.sensor, self.echoes) / float(above)) / width
        return BoardNoise(place, square_m2, np.asarray(normal_tail(-_at(deviate.reshape(self.shape), place))))

    def squares_m2(self, noise: BoardNoise, tdc: Tdc) -> tuple[Numbers, Numbers]:
        """(3, n) mean squares of the change of an echo's range over root 2 with this clock, (T185c), and their chances.

        Of a pair of echoes none, one or both are timed by the channel of strong ones.
        """
        weak_s2, strong_s2 = (float(jitter_s or 0.0) ** 2 for jitter_s in (tdc.jitter_s, tdc.strong_jitter_s))
        pairs_s2 = np.array([weak_s2, 0.5 * (weak_s2 + strong_s2), strong_s2])[:, None]
        clock_s2 = pairs_s2 + float(tdc.least_significant_bit_s) ** 2 / 12.0
        weak = 1.0 - noise.strong
        chances = np.stack([weak**2, 2.0 * weak * noise.strong, noise.strong**2])
        return noise.square_m2 + (0.5 * SPEED_OF_LIGHT_M_S) ** 2 * clock_s2, chances

    def kept(self, noise: BoardNoise, tdc: Tdc) -> Numbers:
        """(n,) share of the pulses of each echo that are kept."""
        chatter_hz = None if tdc.chatter_hz is None else float(tdc.chatter_hz)
        return np.asarray(1.0 / (1.0 + np.exp(-_at(_kept_logit(self, chatter_hz), noise.place))))


@lru_cache(maxsize=4)
def _kept_logit(law: BoardLaw, chatter_hz: float | None) -> Numbers:
    """(k, m) logits of the shares kept."""
    sensor = replace(law.sensor, tdc=replace(law.sensor.tdc, chatter_hz=chatter_hz))
    share = probability_of_light(sensor, law.echoes, law.variance)
    share = np.clip(share, LEAST_SHARE, 1.0 - LEAST_SHARE)
    return np.log(share / (1.0 - share)).reshape(law.shape)


def _at(table: Numbers, place: Numbers) -> Numbers:
    """(n,) values of a (k, m) table, by cubic splines."""
    from scipy.ndimage import map_coordinates

    return np.asarray(map_coordinates(table, place, order=3, mode="nearest"))


def _echoes(middle: Echoes, log_power: Numbers, log_length: Numbers) -> Echoes:
    """Echoes of these powers and lengths that are otherwise as one is."""
    ones = np.ones_like(log_power)
    return replace(
        middle,
        has_surface=ones > 0.0,
        range_m=middle.range_m * ones,
        background_power_w=middle.background_power_w * ones,
        white_w_m2=middle.white_w_m2 * ones,
        peak_power_w=np.exp(log_power),
        broadening=None if middle.broadening is None else np.exp(log_length),
    )


def _smooth(logs: Numbers, counts: Numbers) -> Numbers:
    """Logarithms smoothed over neighbours, each by how often it was read; what was never read is as the next above."""
    from scipy.ndimage import gaussian_filter

    sums, weights = (gaussian_filter(values, SMOOTHING, mode="nearest") for values in (logs * counts, counts))
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(weights > 0.0, sums / weights, np.nan)
    for row in range(len(mean) - 2, -1, -1):
        mean[row] = np.where(np.isfinite(mean[row]), mean[row], mean[row + 1])
    return np.nan_to_num(mean)
