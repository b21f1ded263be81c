"""Interference: the false alarms that pulses of other lidars cause.

Another lidar's pulses arrive at random times with peaks that spread widely. Those that reach the threshold are one more
Poisson process of crossings beside that of noise (docs/theory_light.md 3).

Symbols: U threshold, P_U optical power that reaches it, nu rate of the other lidar's pulses, q share that trips.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..light.echoes import Interference
from ..maths import random
from ..maths.arrays import Lanes, Mask, xp
from ..maths.random import Stage
from ..physics.electronics import crosstalk as formulas
from .shots import Shots


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossings:
    """Pulses of one other lidar that trip the comparator, for each pulse of the sensor.

    Attributes:
        rate_hz: (n,) nu q, rate of the Poisson process; over time of flight, of all shots that are summed
        probability: (n,) q, that one of its pulses trips, theory (T43)
        source: light of the other lidar
    """

    rate_hz: Lanes
    probability: Lanes
    source: Interference


@dataclass(frozen=True, slots=True, kw_only=True)
class Assigned:
    """An alarm with its source; each field (n,).

    Attributes:
        amplitude: peak, in signal units
        interfering: whether it is another lidar's pulse; None without other lidars
    """

    amplitude: Lanes
    interfering: Mask | None


def crossings(shots: Shots, sources: tuple[Interference, ...]) -> tuple[Crossings, ...]:
    """Compute the crossings that each other lidar causes.

    The receiver's noise is neglected: it is small against the spread of the peaks (docs/theory_light.md 3). A receiver
    that sums shots listens in each of them, but a pulse of another lidar arrives in one: it has to do there what our
    echo does in all.
    """
    ops, response, summed = xp(shots.threshold), shots.point.response, _summed_shots(shots)
    level = summed * shots.threshold
    needed = response.power_w(level)
    # All cells of one shot together may be too few.
    reached = response.signal(needed) > 0.99 * level
    by_lidar = []
    for source in sources:
        probability = formulas.tripping_probability(
            needed_power_w=needed, median_power_w=source.peak_power_w, spread_db=source.spread_db
        )
        probability = ops.where(reached, probability, 0.0)
        by_lidar.append(
            Crossings(rate_hz=summed * source.rate_hz * probability, probability=probability, source=source)
        )
    return tuple(by_lidar)


def _summed_shots(shots: Shots) -> Lanes:
    """Number of shots whose light is one signal."""
    return 1.0 if shots.sensor.histogram is None else shots.sensor.histogram.shots


def assign_source(
    shots: Shots, other_lidars: tuple[Crossings, ...], *, noise_rate_hz: Lanes, noise_amplitude: Lanes, draw: Lanes
) -> Assigned:
    """Choose the source of an alarm at random, and with it the amplitude.

    Args:
        noise_rate_hz: (n,) rate of crossings by noise
        noise_amplitude: (n,) amplitude that the alarm has if noise causes it
        draw: number of the alarm
    """
    # Several Poisson processes together are one, with the sum of their rates. Each of its alarms comes from one of
    # them with a probability in proportion to that one's rate, whatever its time. So the rates are laid end to end,
    # noise first, and a uniform place on them chooses the source. The loop keeps the last source that begins before it.
    ops = xp(shots.threshold)
    source_word, height_word = shots.words(Stage.INTERFERENCE, draw)
    place = random.open_uniform(source_word) * sum((lidar.rate_hz for lidar in other_lidars), noise_rate_hz)
    interfering, amplitude = place > noise_rate_hz, noise_amplitude
    lower_edge = noise_rate_hz
    for lidar in other_lidars:
        lidar_amplitude = tripping_amplitude(shots, lidar, uniform=random.open_uniform(height_word))
        amplitude = ops.where(place > lower_edge, lidar_amplitude, amplitude)
        lower_edge = lower_edge + lidar.rate_hz
    return Assigned(amplitude=amplitude, interfering=interfering)


def tripping_amplitude(shots: Shots, lidar: Crossings, *, uniform: Lanes) -> Lanes:
    """Peak of another lidar's pulse that trips, (n,) in signal units.

    Args:
        uniform: (n,) share of the tripping pulses that are at least as high
    """
    point, threshold = shots.point, shots.threshold
    power = formulas.tripping_power_w(
        uniform=uniform,
        probability=lidar.probability,
        median_power_w=lidar.source.peak_power_w,
        spread_db=lidar.source.spread_db,
    )
    peak = point.response.signal(power) / _summed_shots(shots)
    return point.response.measured(xp(threshold).maximum(peak, threshold))
