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
from dataclasses import dataclass, field

import numpy as np

from ...maths import random
from ...maths.arrays import Array, Lanes, LookupTable, Numbers, xp
from ...maths.random import Seed
from ...maths.units import STATIC
from .precipitation import Sizes

MEAN_HITS = {1: 0.01, 2: 0.18, 4: 1.0, 8: 3.5, 16: 9.5, 32: 23.0}
"""Accuracy bought: particles drawn for a pulse, and the largest mean number above the cut. Pulses with more lose their
weakest: less than 0.5 % of the particles above the cut, and less of their power."""

_FIRST_LOG = math.log(1e-6)
"""Accuracy bought: ln Lambda at the tables' begin: rarer echoes than one in 1e6 pulses count as this strong."""

_RANGES, _LEVELS, _SHARES = 1000, 193, 1025  # points of the tables


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Strengths:
    """Strengths and ranges of the drawn particles, and the medium that is left without them.

    Attributes:
        count: particles to draw for a pulse
        last_log: ln Lambda at the cut, Lambda being the mean number of particles above it
        log_strength: ln s over the logarithm of Lambda, from 1e-6 to the cut
        log_range: ln R of a particle of that strength, over the same and the share of such particles that are nearer
        range_m: (n,) rising, from the nearest to the farthest particle
        backscatter_per_m_sr: (n,) beta of the particles too weak to be drawn, at these ranges
    """

    count: int = field(metadata=STATIC)
    last_log: Lanes
    log_strength: LookupTable
    log_range: LookupTable
    range_m: Numbers
    backscatter_per_m_sr: Numbers

    def weak_backscatter_per_m_sr(self, range_m: Numbers) -> Numbers:
        """beta of the particles that are not drawn. With the drawn ones it is the whole medium."""
        return np.interp(range_m, self.range_m, self.backscatter_per_m_sr)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sight:
    """View of a sensor on the particles in its beam, from ``nearest_m`` to ``farthest_m``.

    Attributes:
        beam_area_m2: S(R): the light is taken to be even over it. Of a Gaussian beam the disc of the 1/e^2 radius, pi
            w^2: mean and variance of the echoes are then those of the Gaussian, and the number of those that trip the
            catalogue's receivers is off by a fifth at most, by more only of fewer than one drop in 3,000 pulses
        overlap: xi(R), 0 where the receiver sees nothing of the beam
        aperture_radius_m: a, of the lens
        lens_offset_m: distance from the laser's exit to the middle of the lens
    """

    beam_area_m2: Callable[[Numbers], Numbers]
    overlap: Callable[[Numbers], Numbers]
    extinction_per_m: float
    nearest_m: float
    farthest_m: float
    aperture_radius_m: float = 0.0
    lens_offset_m: float = 0.0

    def angles_rad(self, range_m: Numbers) -> tuple[Numbers, Numbers]:
        """Largest and smallest angle between the beam and the way back to the lens."""
        nearest = max(self.lens_offset_m - self.aperture_radius_m, 0.0)
        return (self.lens_offset_m + self.aperture_radius_m) / range_m, nearest / range_m


def strengths(
    sight: Sight,
    *,
    sizes: Sizes,
    backscatter_m2_sr: Callable[..., Lanes],
    gain: Callable[..., Numbers] | None = None,
    count: int = 4,
    down_to: float | None = None,
) -> Strengths:
    """Tables for `hits`.

    A particle of diameter D at range R has the strength (power over P_t eta A, in 1/m2)

        s = sigma(D) g(D, R) xi(R) exp(-2 alpha R) / (S(R) R^2)

    Strengths grow as R^-4 towards the sensor, up to sigma / (S R^2) at ``nearest_m``: use the distance from which the
    receiver sees its beam, not less.

    Args:
        backscatter_m2_sr: sigma(diameter_m=D): W/sr per W/m2 on the particle
        gain: g(diameter_m=D, within_rad=..., from_rad=...) of it into the lens; None: one
        count: a key of `MEAN_HITS`, whose mean number gives the cut
        down_to: strength down to which more are drawn, as many as it takes and up to the most
    """
    r = np.geomspace(sight.nearest_m, sight.farthest_m, _RANGES)
    area = sight.beam_area_m2(r)
    strength_per_sigma = sight.overlap(r) * np.exp(-2.0 * sight.extinction_per_m * r) / (area * r * r)
    ranked = _Ranked.from_sizes(r, sight, sizes, backscatter_m2_sr, gain)

    def nearer(strength: Lanes) -> Numbers:
        """(m, n) mean number of particles of at least this strength, up to each range."""
        needed = np.atleast_1d(strength)[:, None] / np.maximum(strength_per_sigma, 1e-300)
        per_m = area * ranked.brighter_per_m3(needed)
        steps = 0.5 * (per_m[:, 1:] + per_m[:, :-1]) * np.diff(r)
        return np.concatenate([np.zeros((len(per_m), 1)), np.cumsum(steps, axis=1)], axis=1)

    # Step 1: Lambda(s) on trial strengths, then its inverse ln s(ln Lambda) on an even grid, with half steps.
    strongest = float((ranked.brightest * strength_per_sigma).max())
    trial = strongest * np.geomspace(1.0, 1e-12, 1500)
    expected = np.concatenate([nearer(part)[:, -1] for part in np.array_split(trial, 3)])
    usable = expected > 1e-12
    log_expected, log_trial = np.log(expected[usable]), np.log(trial[usable])
    mean_hits = MEAN_HITS[count]
    if down_to is not None:
        wanted = max(math.exp(np.interp(-math.log(down_to), -log_trial, log_expected)), mean_hits)
        count, most = next((entry for entry in MEAN_HITS.items() if entry[1] >= wanted), max(MEAN_HITS.items()))
        mean_hits = min(wanted, most)
    last_log = math.log(mean_hits)
    half = 0.5 * (last_log - _FIRST_LOG) / (_LEVELS - 1)
    level = np.linspace(_FIRST_LOG - half, last_log + half, 2 * _LEVELS + 1)
    log_strength = np.interp(level, log_expected, log_trial)
    # Step 2: where particles of each strength are. The difference of the counts half a step above and below is the
    # range distribution of particles of just that strength; its inverse gives ln R from a uniform number.
    counted = nearer(np.exp(log_strength[::2]))
    between = np.diff(counted, axis=0)
    share = np.linspace(0.0, 1.0, _SHARES).clip(1e-4, 1.0 - 1e-4)  # the tails are cut
    log_range = np.stack([np.interp(share, row / row[-1], np.log(r)) for row in between])
    # Step 3: backscatter of the rest, the particles below the weakest drawn strength.
    cut = math.exp(log_strength[-2]) / np.maximum(strength_per_sigma, 1e-300)
    return Strengths(
        count=count,
        last_log=last_log,
        log_strength=LookupTable(log_strength[1::2]),
        log_range=LookupTable(log_range),
        range_m=r,
        backscatter_per_m_sr=ranked.fainter_per_m_sr(cut),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ranked:
    """Particles by their backscatter, at some ranges or at one that stands for all; rows (ranges, diameters).

    Attributes:
        sigma: backscatter, rising
        brighter: particles of at least that, per m3
        fainter: backscatter of those below it, per m sr
    """

    sigma: Numbers
    brighter: Numbers
    fainter: Numbers

    @classmethod
    def from_sizes(
        cls,
        range_m: Numbers,
        sight: Sight,
        sizes: Sizes,
        backscatter_m2_sr: Callable[..., Lanes],
        gain: Callable[..., Numbers] | None,
    ) -> _Ranked:
        """Sort the particles by backscatter, range by range: with a gain the smaller of two may be the brighter."""
        longest, steps = (40.0, 4001) if gain is None else (25.0, 751)
        diameter = np.linspace(0.0, longest / sizes.slope_per_m, steps)
        sigma = np.asarray(backscatter_m2_sr(diameter_m=diameter))[None, :]
        if gain is not None:
            largest_rad, smallest_rad = sight.angles_rad(range_m[:, None])
            sigma = sigma * gain(diameter_m=diameter, within_rad=largest_rad, from_rad=smallest_rad)
        # Particles between the middles of the steps; the last is as long as the exponential goes on.
        edge = np.concatenate([[0.0], 0.5 * (diameter[1:] + diameter[:-1]), [np.inf]])
        number = -sizes.intercept_per_m4 / sizes.slope_per_m * np.diff(np.exp(-sizes.slope_per_m * edge))
        order = np.argsort(sigma, axis=1, kind="stable")
        sigma, number = np.take_along_axis(sigma, order, axis=1), number[order]
        # A particle counts half as brighter than itself: what lies between two steps is then the mean of both.
        brighter = np.cumsum(number[:, ::-1], axis=1)[:, ::-1] - 0.5 * number
        return cls(sigma=sigma, brighter=brighter, fainter=np.cumsum(number * sigma, axis=1) - 0.5 * number * sigma)

    @property
    def brightest(self) -> Numbers:
        """(1 or n,) sigma of the largest particle."""
        return np.asarray(self.sigma[:, -1])

    def brighter_per_m3(self, needed: Numbers) -> Numbers:
        """(m, n) particles of at least this backscatter at each range."""
        return self._read(self.brighter, needed, 0.0)

    def fainter_per_m_sr(self, needed: Numbers) -> Numbers:
        """(n,) beta of those below."""
        return np.asarray(self._read(self.fainter, needed[None, :], None)[0])

    def _read(self, values: Numbers, needed: Numbers, right: float | None) -> Numbers:
        if len(self.sigma) == 1:
            return np.asarray(np.interp(needed, self.sigma[0], values[0], right=right))
        columns = [np.interp(needed[:, i], self.sigma[i], values[i], right=right) for i in range(needed.shape[1])]
        return np.stack(columns, axis=1)


def medium_backscatter_per_m_sr(
    range_m: Numbers,
    *,
    sight: Sight,
    sizes: Sizes,
    backscatter_m2_sr: Callable[..., Lanes],
    gain: Callable[..., Numbers],
) -> Numbers:
    """(n,) beta of all particles at these ranges, with their gain into the lens; arguments as of `strengths`."""
    ranked = _Ranked.from_sizes(range_m, sight, sizes, backscatter_m2_sr, gain)
    return np.asarray(ranked.fainter[:, -1])


def hits(tables: Strengths, *, seed: Seed, pulse: Lanes, first_draw: int = 0) -> list[tuple[Array, Array, Array]]:
    """Range, strength and place (0 to 1) across the beam of each pulse's particles, strongest first; then strength 0.

    Args:
        seed: as in `maths.random.words`
        pulse: as in `maths.random.words`
        first_draw: first of 2 count random draws; a second population uses later ones
    """
    ops = xp(pulse)
    particles = []
    expected: Lanes = 0.0
    for number in range(tables.count):
        draw = first_draw + 2 * number
        words = [random.words(seed=seed, stage=random.Stage.PARTICLES, pulse=pulse, draw=draw + i) for i in (0, 1)]
        expected = expected + random.exponential(words[0])
        log_expected = ops.log(expected)
        level = (log_expected - _FIRST_LOG) / (tables.last_log - _FIRST_LOG)
        along, aside = (random.open_uniform(word) for word in words[1])
        range_m = ops.exp(tables.log_range.at(level, along))
        strength = ops.where(log_expected <= tables.last_log, ops.exp(tables.log_strength.at(level)), 0.0)
        particles.append((range_m, strength, aside))
    return particles
