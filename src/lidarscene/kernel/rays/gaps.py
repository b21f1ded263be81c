"""Gaps: rays at a porous surface, which Mitsuba calls a mask, on their way through or stopped, by chance.

A fence or a layer of leaves has gaps that are smaller than the beam, and a ray is too thin to be split. So each ray
goes through with the probability of a gap: over the rays of a pulse, or over pulses, the right share of them does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...maths import random
from ...maths.arrays import Lanes, Table, xp
from ..device.backend import mitsuba

_SLOPES = Table(np.array([math.sqrt(prime) % 1.0 for prime in (5, 2, 3, 7, 11, 13, 17, 19)]))
"""How far apart the numbers of a pulse's rays are at the first, second, ... surface on the way: Kronecker sequences,
which fill the unit interval evenly, and several of them a square or a cube."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Draws:
    """Where random numbers of the rays come from.

    seed   of the frame, 32 bits
    pulse  (n,) pulse number of each ray
    ray    (n,) its number within the pulse; 0: the only one
    """

    seed: Lanes
    pulse: Lanes
    ray: Lanes = 0

    def uniform(self, step: Lanes) -> Lanes:
        """A number in [0, 1) for each ray, at the surface that is number ``step`` on its way."""
        mi = mitsuba()
        step = mi.UInt32(step)
        first, _ = random.words(seed=self.seed, stage=random.Stage.GAPS, pulse=self.pulse, draw=step)
        ops = xp(first)
        place = random.open_uniform(first) + mi.Float(self.ray) * ops.take(_SLOPES, step)
        return place - ops.floor(place)


def gap_share(surface: Any, here: Any) -> Any:
    """Share of a surface that is gaps, where it is porous; 0 elsewhere."""
    import drjit as dr

    return dr.select(here, surface.bsdf().eval_null_transmission(surface, here)[0], 0.0)
