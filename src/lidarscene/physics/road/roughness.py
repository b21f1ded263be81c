"""Road roughness by ISO 8608: the spectrum of its classes, and a random surface that has it along every line.

Symbols: n spatial frequency [cycles/m], G(n) one-sided spectral density of the height along a line [m3], C = G(n) n^2
[m], k wave vector of the surface [cycles/m], S(k) its two-sided spectral density [m4].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...maths.arrays import Numbers

Roughness = Literal["flat", "A", "B", "C", "D", "E", "F", "G", "H"]
"""Road class of ISO 8608:2016, from very good (A) to impassable; "flat" is a plane."""

REFERENCE_PER_M = 0.1
"""Source: ISO 8608; spatial frequency n0 at which it states the class."""

LOWEST_PER_M, HIGHEST_PER_M = 0.011, 2.83
"""Source: ISO 8608; band over which it fits a road's spectrum: waves of 91 m down to 0.35 m."""

WAVES = 512
"""Waves of a surface, 64 to an octave."""

_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_LINES = 32  # rows of places at a time: half a megabyte stays in a cache
_ROWS = 64  # places at a time: a quarter of a megabyte of their phases stays in a cache


def density_m3(roughness: Roughness) -> float:
    """Geometric mean G(n0) of a class [m3]: 16e-6 for A, four times as much from each class to the next."""
    return 0.0 if roughness == "flat" else 16e-6 * 4.0 ** "ABCDEFGH".index(roughness)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoughSurface:
    """A random surface as a sum of plane waves: h(r) = sum a_i cos 2 pi (k_i r + p_i).

    Attributes:
        wave_per_m: (n, 2) wave vectors k_i
        phase: (n,) p_i, in cycles
        amplitude_m: (n,) a_i
    """

    wave_per_m: Numbers
    phase: Numbers
    amplitude_m: Numbers

    @classmethod
    def draw(cls, roughness: Roughness, seed: int) -> RoughSurface:
        """Draw a surface of a class.

        The surface is isotropic: S(k) = C / (4 k^3) has G(n) = C / n^2 along every line, since
        G(n) = 2 integral of S(sqrt(n^2 + m^2)) dm (Kamash and Robson, J. Sound Vib. 57 (1978), 89) (T141). One wave in
        each of n even steps of ln k carries the step's variance 2 pi k S(k) dk, so that a^2 = pi C dln(k) / k. Its
        direction is the next of an even sequence over half a turn (k and -k are one wave), its phase random.
        """
        random = np.random.Generator(np.random.PCG64(seed))
        step = math.log(HIGHEST_PER_M / LOWEST_PER_M) / WAVES
        number = np.arange(WAVES)
        wave_number = LOWEST_PER_M * np.exp(step * (number + random.random(WAVES)))
        direction = np.pi * ((_GOLDEN * number + random.random()) % 1.0)
        curvature_m = density_m3(roughness) * REFERENCE_PER_M**2
        return cls(
            wave_per_m=wave_number[:, None] * np.stack([np.cos(direction), np.sin(direction)], axis=1),
            phase=random.random(WAVES),
            amplitude_m=np.sqrt(np.pi * curvature_m * step / wave_number),
        )

    def without_short_waves(self, highest_per_m: float) -> RoughSurface:
        """The same surface without the waves above a spatial frequency, which a coarse mesh cannot show."""
        resolved = np.hypot(*self.wave_per_m.T) <= highest_per_m
        return RoughSurface(
            wave_per_m=self.wave_per_m[resolved], phase=self.phase[resolved], amplitude_m=self.amplitude_m[resolved]
        )

    def rows_m(self, begin_m: Numbers, step_m: Numbers, count: int) -> Numbers:
        """Heights (n, count) [m] along n rows of even steps; from step to step each wave turns by one angle.

        Args:
            begin_m: (n, 2) first places
            step_m: (n, 2) from each place of a row to the next
        """
        height_m = np.zeros((len(begin_m), count))
        if not self.amplitude_m.any():
            return height_m
        for first in range(0, len(begin_m), _LINES):
            rows = slice(first, first + _LINES)
            wave = self.amplitude_m * np.exp(2j * np.pi * (begin_m[rows] @ self.wave_per_m.T + self.phase))
            turn = np.exp(2j * np.pi * (step_m[rows] @ self.wave_per_m.T))
            for column in range(count):
                height_m[rows, column] = wave.real.sum(axis=1)
                wave *= turn
        return height_m

    def height_m(self, place_m: Numbers) -> Numbers:
        """Height at (n, 2) places [m]: (n,), to 1e-7 of the roughness."""
        height_m = np.zeros(len(place_m))
        if not self.amplitude_m.any():
            return height_m
        amplitude_m, (along, across) = self.amplitude_m.astype(np.float32), self.wave_per_m.T.copy()
        # No products of matrices: they round a place otherwise beside others than alone. What is computed stays in
        # three arrays: new ones would be new pages each time.
        cycles, part = np.zeros((2, min(_ROWS, len(place_m)), len(self.phase)))
        wave = part.astype(np.float32)
        for first in range(0, len(place_m), _ROWS):
            x, y = place_m[first : first + _ROWS].T[:, :, None]
            cycles, part, wave = cycles[: len(x)], part[: len(x)], wave[: len(x)]
            np.multiply(x, along, out=cycles)
            cycles += np.multiply(y, across, out=part)
            cycles += self.phase
            # Whole cycles go in double precision; the cosine of the rest is three times as fast in single precision.
            cycles -= np.rint(cycles, out=part)
            np.multiply(cycles, np.float32(2.0 * np.pi), out=wave, casting="same_kind")
            height_m[first : first + _ROWS] = np.multiply(np.cos(wave, out=wave), amplitude_m, out=wave).sum(axis=1)
        return height_m
