"""Interference: light of other lidars and a comparator's level in, which of the alarms are theirs out."""

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
    """Pulses of one other lidar that trip the comparator, per pulse of ours.

    rate_hz       (n,) of the Poisson process
    probability   (n,) that one of its pulses trips
    source        whose pulses they are
    """

    rate_hz: Lanes
    probability: Lanes
    source: Interference


@dataclass(frozen=True, slots=True, kw_only=True)
class Assigned:
    """Height of an alarm, and whether it is another lidar's; None where there is no other lidar."""

    amplitude: Lanes
    theirs: Mask | None


def crossings(shots: Shots, sources: tuple[Interference, ...]) -> tuple[Crossings, ...]:
    """What of each lidar's pulses trips; the receiver's own noise is small against the spread of their peaks."""
    needed = shots.point.power_w(shots.threshold)
    found = []
    for source in sources:
        probability = formulas.tripping_probability(
            needed_power_w=needed, median_power_w=source.peak_power_w, spread_db=source.spread_db
        )
        found.append(Crossings(rate_hz=source.rate_hz * probability, probability=probability, source=source))
    return tuple(found)


def assigned(
    shots: Shots, others: tuple[Crossings, ...], *, noise_rate_hz: Lanes, noise_amplitude: Lanes, draw: Lanes
) -> Assigned:
    """Whether an alarm is another lidar's, and its amplitude.

    Alarms of several Poisson processes together are one, of the sum of their rates, and each is of one of them with
    a chance in proportion to its rate, whenever it comes.
    """
    ops = xp(shots.threshold)
    which, height = shots.words(Stage.INTERFERENCE, draw)
    place = random.open_uniform(which) * sum((one.rate_hz for one in others), noise_rate_hz)
    theirs, amplitude = place > noise_rate_hz, noise_amplitude
    before = noise_rate_hz
    for one in others:
        own = amplitude_of(shots, one, uniform=random.open_uniform(height))
        amplitude = ops.where(place > before, own, amplitude)
        before = before + one.rate_hz
    return Assigned(amplitude=amplitude, theirs=theirs)


def amplitude_of(shots: Shots, one: Crossings, *, uniform: Lanes) -> Lanes:
    """Peak of a pulse that trips; ``uniform`` is the share of those that trip and are at least as high."""
    point, threshold = shots.point, shots.threshold
    power = formulas.tripping_power_w(
        uniform=uniform, probability=one.probability,
        median_power_w=one.source.peak_power_w, spread_db=one.source.spread_db,
    )  # fmt: skip
    return point.measured(xp(threshold).maximum(point.signal(power), threshold))
