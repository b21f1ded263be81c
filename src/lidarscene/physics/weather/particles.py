"""Drops and flakes one by one: the strongest echoes of the particles in a beam, drawn for every pulse.

A single drop close to the sensor can trip the comparator, which a homogeneous medium never does. The particles in a
beam are a Poisson process in range and size, so their echoes are a Poisson process in strength, with on average
Lambda(s) echoes stronger than s. The strongest is where Lambda(s) equals a standard exponential deviate, the next
where it equals the sum of two, and so on (mapping theorem; J. F. C. Kingman, Poisson Processes (1993), chapter 2). So
the few that matter are drawn directly, whatever the number of the others. Weaker particles are left to
`physics.weather.soft_target`.

Symbols: D diameter, sigma(D) backscatter, xi(R) overlap, S(R) beam area, s strength, Lambda(s) mean number above s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...maths import random
from ...maths.arrays import Array, Lanes, Numbers, Table, xp
from .precipitation import Sizes

MEAN_HITS = {4: 1.0, 8: 3.5, 16: 9.5, 32: 23.0}
"""Particles drawn for a pulse, and the mean number above the cut. Pulses with more lose their weakest: less than 0.5 %
of the particles above the cut, and less of their power."""

_FIRST_LOG = math.log(1e-6)  # of Lambda: rarer echoes than one in 1e6 pulses count as this strong
_RANGES, _LEVELS, _SHARES = 1000, 193, 1025  # points of the tables


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Strengths:
    """Strengths and ranges of the drawn particles, and the medium that is left without them.

    count         particles to draw for a pulse
    log_strength  ln s over the logarithm of Lambda, from 1e-6 to `MEAN_HITS` of the count
    log_range     ln R of a particle of that strength, over the same and the share of such particles that are nearer
    range_m       (n,) rising, from the nearest to the farthest particle
    backscatter_per_m_sr  (n,) beta of the particles too weak to be drawn, at these ranges
    """

    count: int
    log_strength: Table
    log_range: Table
    range_m: Numbers
    backscatter_per_m_sr: Numbers

    def weak_backscatter_per_m_sr(self, range_m: Numbers) -> Numbers:
        """beta of the particles that are not drawn. With the drawn ones it is the whole medium."""
        return np.interp(range_m, self.range_m, self.backscatter_per_m_sr)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sight:
    """How a sensor sees the particles in its beam, from ``nearest_m`` to ``farthest_m``.

    beam_area_m2  S(R): the light is taken to be even over it. Of a Gaussian beam the disc of the 1/e^2 radius, pi w^2:
                  mean and variance of the echoes are then those of the Gaussian
    overlap       xi(R), 0 where the receiver sees nothing of the beam
    """

    beam_area_m2: Callable[[Numbers], Numbers]
    overlap: Callable[[Numbers], Numbers]
    extinction_per_m: float
    nearest_m: float
    farthest_m: float


def strengths(
    sight: Sight, *, sizes: Sizes, backscatter_m2_sr: Callable[..., Lanes], count: int = 4
) -> Strengths:
    """Tables for `hits`.

    A particle of diameter D at range R has the strength (power over P_t eta A, in 1/m2)

        s = sigma(D) xi(R) exp(-2 alpha R) / (S(R) R^2)

    backscatter_m2_sr  sigma(diameter_m=D), rising: W/sr per W/m2 on the particle
    beam_area_m2       S(R), taken as evenly lit. For a Gaussian beam use the disc of the 1/e^2 radius, pi w^2: mean and
                       variance of the echoes are then those of the Gaussian
    overlap            xi(R), 0 where the receiver sees nothing of the beam
    count              a key of `MEAN_HITS`; more particles mean a weaker cut

    Strengths grow as R^-4 towards the sensor, up to sigma / (S R^2) at ``nearest_m``: use the distance from which the
    receiver sees its beam, not less.
    """
    r = np.geomspace(sight.nearest_m, sight.farthest_m, _RANGES)
    area = sight.beam_area_m2(r)
    seen = sight.overlap(r) * np.exp(-2.0 * sight.extinction_per_m * r) / (area * r * r)
    diameter = np.linspace(0.0, 40.0 / sizes.slope_per_m, 4001)
    sigma = np.asarray(backscatter_m2_sr(diameter_m=diameter))

    def smallest_m(strength: Lanes) -> Numbers:
        """(m, n) diameter that a particle at each range needs for this strength."""
        needed = np.atleast_1d(strength)[:, None] / np.maximum(seen, 1e-300)
        return np.interp(needed, sigma, diameter, right=np.inf)

    def nearer(strength: Lanes) -> Numbers:
        """(m, n) mean number of particles of at least this strength, up to each range."""
        larger = (
            sizes.intercept_per_m4 / sizes.slope_per_m * np.exp(-sizes.slope_per_m * smallest_m(strength))
        )
        per_m = area * larger
        steps = 0.5 * (per_m[:, 1:] + per_m[:, :-1]) * np.diff(r)
        return np.concatenate([np.zeros((len(per_m), 1)), np.cumsum(steps, axis=1)], axis=1)

    # Step 1: Lambda(s) on trial strengths, then its inverse ln s(ln Lambda) on an even grid, with half steps.
    strongest = float(sigma[-1] * seen.max())
    trial = strongest * np.geomspace(1.0, 1e-12, 1500)
    expected = np.concatenate([nearer(part)[:, -1] for part in np.array_split(trial, 30)])
    usable = expected > 1e-12
    last_log = math.log(MEAN_HITS[count])
    half = 0.5 * (last_log - _FIRST_LOG) / (_LEVELS - 1)
    level = np.linspace(_FIRST_LOG - half, last_log + half, 2 * _LEVELS + 1)
    log_strength = np.interp(level, np.log(expected[usable]), np.log(trial[usable]))
    # Step 2: where particles of each strength are. The difference of the counts half a step above and below is the
    # range distribution of particles of just that strength; its inverse gives ln R from a uniform number.
    counted = nearer(np.exp(log_strength[::2]))
    between = np.diff(counted, axis=0)
    share = np.linspace(0.0, 1.0, _SHARES).clip(1e-4, 1.0 - 1e-4)  # the tails are cut
    log_range = np.stack([np.interp(share, row / row[-1], np.log(r)) for row in between])
    # Step 3: backscatter of the rest, the particles below the weakest drawn strength.
    moment = _below(diameter, sizes, sigma)
    return Strengths(
        count=count,
        log_strength=Table(log_strength[1::2]),
        log_range=Table(log_range),
        range_m=r,
        backscatter_per_m_sr=np.interp(smallest_m(np.exp(log_strength[-2]))[0], diameter, moment),
    )


def _below(diameter: Numbers, sizes: Sizes, sigma: Numbers) -> Numbers:
    """beta of all particles smaller than each diameter."""
    density = sizes.intercept_per_m4 * np.exp(-sizes.slope_per_m * diameter) * sigma
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(diameter)
    return np.concatenate([[0.0], np.cumsum(steps)])


def hits(tables: Strengths, *, seed: Lanes, pulse: Lanes, first_draw: int = 0) -> list[tuple[Array, Array]]:
    """Range and strength of the strongest particles of each pulse, strongest first; strength 0 if there are no more.

    seed, pulse  as in `maths.random.words`
    first_draw   first of 2 count random draws; a second population uses later ones
    """
    ops = xp(pulse)
    found = []
    expected: Lanes = 0.0
    mean_hits = MEAN_HITS[tables.count]
    for number in range(tables.count):
        draw = first_draw + 2 * number
        words = [
            random.words(seed=seed, stage=random.Stage.PARTICLES, pulse=pulse, draw=draw + i) for i in (0, 1)
        ]
        expected = expected + random.exponential(words[0])
        level = (ops.log(expected) - _FIRST_LOG) / (math.log(mean_hits) - _FIRST_LOG)
        range_m = ops.exp(tables.log_range.at(level, random.open_uniform(words[1][0])))
        strength = ops.where(expected <= mean_hits, ops.exp(tables.log_strength.at(level)), 0.0)
        found.append((range_m, strength))
    return found
