"""Random numbers that belong to the pulse: the same (seed, stage, pulse, draw) gives the same numbers everywhere.

A frame is traced in chunks, on several threads, on CPU or GPU, perhaps by several workers; its noise must not depend
on that. Threefry-2x32 with 20 rounds (Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as 1, 2, 3",
SC11) is counter-based and needs only 32-bit additions, rotations and exclusive-ors, so numpy and Dr.Jit give the same
bits.

No two draws share a key and a counter. The key is (seed, stage + 2^8 rollover), with stages below 2^8 and rollovers
below 2^24, so its second word gives both; the counter is (pulse, draw). The rollover counts how often the pulse numbers
on the device, which have 31 bits, have begun again after whole frames (`rendering.frame`): with it the pulse's number
gives the frame. Under one key different counters give different words, since each round can be undone. In the first
frames, up to 2^31 pulses, the rollover is 0 and the second word the stage alone.
"""

from __future__ import annotations

import enum
import math
from typing import Any, TypeAlias

from .arrays import Array, Lanes, xp

Seed: TypeAlias = Lanes | tuple[Lanes, Lanes]
"""Seed of a frame, 32 bits, or the pair of it and the rollover of the frame's pulse numbers, 24 bits."""

ROLLOVERS = 2**24
"""Rollovers are below this."""


class Stage(enum.IntEnum):
    """Purpose of a draw, part of its key: two purposes never share a random number of a pulse.

    Values are below 2^8 and never used again: 7 and 10 are retired. A new stage takes one that no other has ever had.
    """

    EDGE_NOISE = 1
    FALSE_ALARM = 2
    TDC_JITTER = 3
    POINTING = 4
    TRAILING_EDGE = 5
    SAMPLES = 6
    INTERFERENCE = 8
    AMBIENT = 9
    PARTICLES = 11
    GAPS = 12
    HISTOGRAM = 16
    THRESHOLD = 17
    FLUCTUATION = 25
    COLUMN_NOISE = 26
    CHATTER = 27
    STRONG_CHANNEL = 28


_ROTATIONS = (13, 15, 26, 6, 17, 29, 16, 24)
_PARITY = 0x1BD11BDA
_ULP = 2.0**-32


def threefry2x32(key: tuple[Array, Array], counter: tuple[Array, Array]) -> tuple[Array, Array]:
    """Two 32-bit words for each (key, counter). All four arguments are 32-bit unsigned arrays and broadcast."""
    k0, k1 = key
    schedule = (k0, k1, k0 ^ k1 ^ _PARITY)
    x0, x1 = counter[0] + k0, counter[1] + k1
    for r in range(20):
        rotation = _ROTATIONS[r % 8]
        x0 = x0 + x1
        x1 = ((x1 << rotation) | (x1 >> (32 - rotation))) ^ x0
        if r % 4 == 3:  # every fourth round mixes in the key again
            s = r // 4 + 1
            x0 = x0 + schedule[s % 3]
            x1 = x1 + schedule[(s + 1) % 3] + s
    return x0, x1


def words(*, seed: Seed, stage: int, pulse: Lanes, draw: Lanes = 0) -> tuple[Array, Array]:
    """Two independent 32-bit words for every pulse.

    Args:
        seed: of the frame (opaque Dr.Jit integers, or Python ints), see `Seed`
        stage: purpose of the draw, a `Stage`
        pulse: (n,) 32-bit unsigned pulse numbers since the rollover
        draw: number of the draw in this stage, a number or (n,) unsigned
    """
    ops = xp(pulse)
    pulse = ops.uint32(pulse)
    zero = pulse ^ pulse
    word, rollover = seed if isinstance(seed, tuple) else (seed, 0)
    purpose: Any = rollover * 2**8 + int(stage)
    # On the device it is one number for all lanes and stays one: widened, loops would compute it anew at each pass, and
    # took half as long again.
    if isinstance(purpose, int):
        purpose = zero + purpose
    return threefry2x32((zero + ops.uint32(word), purpose), (pulse, zero + draw))


def open_uniform(word: Array) -> Array:
    """A float32 in (0, 1] from a 32-bit word; small values keep their relative precision."""
    ops = xp(word)
    return (ops.float32(word) + 0.5) * _ULP


def normal_pair(word: tuple[Array, Array]) -> tuple[Array, Array]:
    """Two independent standard normal deviates, by Box and Muller (reaches 6.7 sigma)."""
    ops = xp(word[0])
    radius = ops.sqrt(-2.0 * ops.log(open_uniform(word[0])))
    angle = math.tau * open_uniform(word[1])
    return radius * ops.cos(angle), radius * ops.sin(angle)


def exponential(word: tuple[Array, Array]) -> Array:
    """A standard exponential deviate whose small values are exact to float32 precision.

    First arrivals of rare events are small values. -log(u) with u just below one has only 24 bits there, so v = 1 - u
    is drawn with 64 bits, and -log(1 - v) comes from its series where v is small.
    """
    ops = xp(word[0])
    v = (ops.float32(word[0]) + open_uniform(word[1])) * _ULP
    series = v * (1.0 + v * (0.5 + v * (1.0 / 3.0)))
    return ops.where(v < 2.0**-6, series, -ops.log(ops.maximum(1.0 - v, 0.5 * _ULP)))
