r"""Photons that the noise of REFLECTIVITY tells, where SIGNAL is not recorded.

REFLECTIVITY q is SIGNAL, but for the range and the sensor's optics, in whole numbers. So it scatters by

.. math:: \sigma_q^2 = g\, q^2 / N + t^2 q^2 + 1/12, \quad N = q\, W(R) / (100 R^2) \tag{T185b}

with W the photons of a white target times the square of the range, t the surface's own variation, and g the variance
of SIGNAL over Poisson's. A patch is five pulses side by side, of whose REFLECTIVITY columns share no noise.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...maths.arrays import Numbers
from .binned_fit import Statistics
from .recorded_pulses import RecordedPulses
from .scatter import (
    LEAST_PATCHES,
    MEAN_BELOW,
    MEDIAN_TWO,
    blocks_of_patches,
    patch_columns,
    smoothest,
    solve_squares,
    squared_rest,
)
from .tuning import (
    LEAST_READING,
    MOST_REFLECTIVITY,
    NOISE_PATCHES,
    NOISE_RANGE_STEP,
    PATCH_SQUARE,
    RANGE_TOLERANCE,
    ROUNDING,
)

SIGNAL_VARIANCE, SIGNAL_ERROR = 1.25, 0.1
"""Source: an OS1-32, an OS0-32 and an OS2-128 (ouster-sdk), whose photons SIGNAL tells: by Poisson's law the noise of
REFLECTIVITY tells 0.68 +/- 0.16, 0.78 +/- 0.05 and 0.80 +/- 0.06 of them. Variance over Poisson's, and relative
error."""


def noise_bins(pulses: RecordedPulses, white_m2: Numbers) -> tuple[Numbers, Statistics] | None:
    """Bin patches by ln R: (bins,) its mean, and ln W by (T185b); None with too few.

    Args:
        white_m2: (rows, columns) of W as expected, which only weighs the patches
    """
    assert pulses.reflectivity is not None
    columns = patch_columns(pulses.block, 1)
    range_m, reading, white_m2 = (v[:, columns] for v in (pulses.range_m, pulses.reflectivity, white_m2))
    mean, mean_m, near_m = reading.mean(axis=2), range_m.mean(axis=2), range_m.min(axis=2)
    # What reads less than its neighbours by chance must not be left out: no limit on the readings of single pulses.
    with np.errstate(invalid="ignore"):
        usable = range_m.max(axis=2) < (1.0 + RANGE_TOLERANCE) * near_m
        usable &= (mean >= LEAST_READING) & (reading.max(axis=2) < MOST_REFLECTIVITY)
    mean, mean_m = np.where(usable, mean, 1.0), np.where(usable, mean_m, 1.0)
    squares, rounding = squared_rest(reading, usable) / mean**2, (ROUNDING / mean) ** 2
    per_white = 100.0 * mean_m**2 / mean  # (T185b) is g times this over W
    inverse = per_white / np.where(usable, white_m2.mean(axis=2), 1.0)
    _, smooth = smoothest(np.where(usable, squares / (inverse + rounding), np.inf), usable)
    if smooth.sum() < LEAST_PATCHES:
        return None
    squares, rounding, inverse, per_white, x = (
        values[smooth] for values in (squares, rounding, inverse, per_white, np.log(mean_m))
    )
    block = blocks_of_patches(pulses, columns, smooth)
    solved = solve_squares(squares, inverse, block, rounding)
    if solved is None or solved.value[0] <= 0.0:
        return None
    rest = rounding + solved.value[1]
    of_law, noise = squares / (solved.value[0] * inverse + rest), (squares / MEAN_BELOW - rest) / per_white
    place = np.floor(x / NOISE_RANGE_STEP)
    members = []
    for number in np.unique(place):
        of_bin = np.flatnonzero(place == number)
        near = of_bin[of_law[of_bin] < PATCH_SQUARE * np.median(of_law[of_bin]) / MEDIAN_TWO]
        if len(near) >= NOISE_PATCHES and noise[near].mean() > 0.0:
            members.append(near)
    if not members:
        return None
    inverses = Statistics.of([noise[chosen] for chosen in members], members, block).logarithm()
    binned = replace(inverses, value=math.log(SIGNAL_VARIANCE) - inverses.value, parts=-inverses.parts)
    return np.array([x[chosen].mean() for chosen in members]), binned
