"""Decide which rays pass through a porous surface (Mitsuba's `mask`), and which it stops.

A fence or a layer of leaves has gaps that are smaller than the beam, while a ray has no width and cannot be split. So
each ray passes with the probability of a gap: of the rays of a pulse, or of many pulses, the right share does
(docs/theory_glass.md 2). This is the only place where a ray's path is drawn at random.

Symbols: ray i of a pulse draws u_i = frac(u_0 + i s) at each surface, u_0 uniform, s the surface's slope.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...maths import random
from ...maths.arrays import Lanes, LookupTable, Mask, xp
from ...maths.random import Seed
from ..device.backend import mitsuba
from ..device.types import Bsdf, Interaction
from ..world.mitsuba_world import World

_SLOPES = LookupTable(np.array([math.sqrt(prime) % 1.0 for prime in (5, 2, 3, 7, 11, 13, 17, 19)]))
"""Choice: slopes s at the first, second, ... surface of a path: fractional parts of square roots of primes. Each makes
a Kronecker sequence, which fills the unit interval evenly; several together fill a square or a cube evenly, because the
roots are independent over the rationals. So the layers of a hedge are passed independently of each other."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Draws:
    """The source of the rays' random numbers.

    Attributes:
        seed: of the frame, 32 bits
        pulse: (n,) pulse number of each ray
        ray: (n,) number of each ray within its pulse; 0 if it is the only one
    """

    seed: Seed
    pulse: Lanes
    ray: Lanes = 0

    def uniform(self, step: Lanes) -> Lanes:
        """Return (n,) numbers in [0, 1), one for each ray at the surface number ``step`` of its path."""
        mi = mitsuba()
        step = mi.UInt32(step)
        # The random offset belongs to the pulse and the surface, and is the same for all rays of the pulse. The rays
        # share one even sequence, so that of 16 rays at a surface with 25 % gaps 4 pass, give or take one.
        first, _ = random.words(seed=self.seed, stage=random.Stage.GAPS, pulse=self.pulse, draw=step)
        ops = xp(first)
        place = random.open_uniform(first) + mi.Float(self.ray) * ops.take(_SLOPES, step)
        return place - ops.floor(place)


def gap_share(world: World, surface: Interaction, porous: Mask) -> Any:
    """Return the share of gaps of a porous surface, 0 to 1; 0 where ``porous`` does not hold."""
    import drjit as dr

    def through(bsdf: Bsdf, surface: Interaction, active: Mask) -> Any:
        return bsdf.eval_null_transmission(surface, active)[0]

    return dr.select(porous, world.ask_bsdf(through, surface, active=porous), 0.0)
