"""Inertial sensors: what moves them, and the noise that their data sheets promise (T150 to T153).

Symbols: f specific force, w angular velocity, R sensor to world, a acceleration, g gravity, N noise density, B bias
instability, f_s samples a second, tau averaging time, T correlation time.

Source: IEEE Std 952-1997, annex C, for the Allan variance of each kind of noise. A data sheet's density N is one-sided
(rms/sqrt(Hz)): the standard's random walk is N / sqrt(2). The ADIS16470's prints both: 0.008 deg/s/sqrt(Hz)
and 0.34 deg/sqrt(h), which is 0.008 * 60 / sqrt(2).
"""

from __future__ import annotations

import math

import numpy as np

from ..maths.arrays import Numbers
from .constants import STANDARD_GRAVITY_M_S2

RATIO = 4.0
"""Accuracy bought: ratio of neighbouring correlation times: with it the sum is flat within 1 %."""

CORRELATION_TIMES_S = RATIO ** np.arange(10.0)
"""Correlation times of the processes whose sum is flicker noise: 1 s, below which white noise hides it, to 73 h."""


def specific_force_m_s2(*, rotation: Numbers, acceleration_m_s2: Numbers) -> Numbers:
    """(n, 3) specific force in the sensor's axes, f = R^T (a - g), with g down along z (T150): up where it rests.

    Args:
        rotation: (n, 3, 3) sensor to world
        acceleration_m_s2: (n, 3) of the sensor in the world
    """
    upward = acceleration_m_s2 + np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])
    return np.asarray(np.einsum("nji,nj->ni", rotation, upward))


def white_sigma(*, density: float, rate_hz: float) -> float:
    """Standard deviation of a sample, sigma = N sqrt(f_s / 2) (T151): all noise up to half the rate is in it."""
    return density * math.sqrt(0.5 * rate_hz)


def markov_sigma(*, instability: float) -> float:
    """Standard deviation of each Gauss-Markov process, sigma = B sqrt(ln(r) / pi) (T152).

    Processes of correlation times T_0 r^j together have the two-sided density B^2 / (2 pi f) of flicker noise.
    """
    return instability * math.sqrt(math.log(RATIO) / math.pi)
