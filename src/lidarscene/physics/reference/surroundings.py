"""Roads, rain and inertial sensors: what others published.

Nothing in a render or a study runs this: tests compare with it what does (`lidarscene.physics.reference`).
"""

from __future__ import annotations

import numpy as np

from ...maths.arrays import Numbers
from ..inertial import CORRELATION_TIMES_S, markov_sigma
from ..road.roughness import REFERENCE_PER_M, Roughness, density_m3
from ..weather.precipitation import DB_PER_KM


def allan_deviation(*, density: float, instability: float, tau_s: Numbers) -> Numbers:
    """Allan deviation of white noise and of the sum of Gauss-Markov processes (T153), in the unit of the signal.

    It falls as N / sqrt(2 tau) and then is flat at 0.664 B.
    """
    tau_s = np.asarray(tau_s, dtype=np.float64)
    decay = np.exp(-tau_s[..., None] / CORRELATION_TIMES_S)
    ratio = CORRELATION_TIMES_S / tau_s[..., None]
    # Small differences of long correlation times: 2 x - x^2 (3 - 4 e^(-1/x) + e^(-2/x)) cancels to 1/x for large x.
    markov = np.where(ratio > 1e4, 2.0 / (3.0 * ratio), 2.0 * ratio - ratio**2 * (3.0 - 4.0 * decay + decay**2)).sum(
        axis=-1
    )
    variance = 0.5 * density**2 / tau_s + markov_sigma(instability=instability) ** 2 * markov
    return np.asarray(np.sqrt(variance))


def profile_density_m3(frequency_per_m: Numbers, roughness: Roughness) -> Numbers:
    """One-sided spectral density of the height along a line, G(n) = G(n0) (n / n0)^-2 [m3] (T140)."""
    return np.asarray(density_m3(roughness) * (frequency_per_m / REFERENCE_PER_M) ** -2.0)


def rain_extinction_carbonneau_per_m(*, rate_mm_h: float) -> float:
    """1.076 R^0.67 dB/km, measured in France: T. H. Carbonneau and D. R. Wisely, Proc. SPIE 3232, 119 (1998)."""
    return float(1.076 * rate_mm_h**0.67 * DB_PER_KM)
