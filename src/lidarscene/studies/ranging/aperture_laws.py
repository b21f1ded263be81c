"""Effective aperture laws A(theta_r) of (4): the receiving aperture off the axis, by kind of scanner.

The paper says that the law depends on the scanning method and gives none. A law is a share of the aperture on the
axis. Echo and sunlight are both proportional to it, so range goes with its fourth root where the background's shot
noise dominates.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ...errors import OptionError
from ...maths.arrays import Numbers
from ...scan import Scanner

LARGEST_DEG = 89.0
"""Choice: largest angle at which a fixed window or a scan mirror still has an aperture."""


def constant(angle_deg: Numbers) -> Numbers:
    """A(theta) = A(0): the receiver turns with the beam (a rotating head), and the raster as `render` has it."""
    return np.ones_like(angle_deg)


def cosine(angle_deg: Numbers) -> Numbers:
    """A(theta) = A(0) cos(theta): the aperture stands still, and a beam theta off its normal sees it foreshortened.

    A window or lens fixed in the housing, a flash or a solid-state receiver.
    """
    return np.asarray(np.cos(np.radians(angle_deg)))


def mirror(angle_deg: Numbers) -> Numbers:
    """A(theta) = A(0) cos(45 deg + theta / 2) / cos(45 deg): a scan mirror is the stop (galvanometer, MEMS).

    On the axis the mirror folds the beam by 90 degrees, so it is at 45 degrees to it. To deflect the beam by theta it
    turns by theta / 2, and its projected area goes with the cosine of 45 deg + theta / 2. One edge of the field sees
    less than the centre, the other more (unless a lens behind it is the stop).
    """
    return np.asarray(np.cos(np.radians(45.0 + 0.5 * angle_deg)) / math.cos(math.radians(45.0)))


LAWS: dict[str, Callable[[Numbers], Numbers]] = {"constant": constant, "cosine": cosine, "mirror": mirror}

_PULSES = 200_000  # pulses of a frame that are evaluated

_SLICE = 0.02
"""Choice: share of the pulses, nearest to the axis, that count as lying on it."""


def field_of_view_deg(scanner: Scanner, axis: str) -> tuple[float, float]:
    """Smallest and largest angle of a frame along "elevation" or "azimuth"."""
    along = _frame(scanner, axis)[0]
    return round(float(along.min()), 4), round(float(along.max()), 4)


def of_scanner(scanner: Scanner, axis: str, angle_deg: Numbers) -> tuple[Numbers, Numbers]:
    """A(theta) as the sensor's own scanner has it, for the echo and for the background; `render` uses the same.

    Along one axis, from the pulses of a frame that are nearest to zero on the other, with linear interpolation. Prisms
    change the aperture, but not its product with the field of view: the background stays.

    Raises:
        InputError: outside the scanner's field of view, unless the share is one everywhere (a raster)
    """
    along, across, *pulses = _frame(scanner, axis)
    if all(np.all(share == share[0]) for share in pulses):
        echo, background = (np.full_like(angle_deg, share[0]) for share in pulses)
        return echo, background
    low, high = field_of_view_deg(scanner, axis)
    if np.min(angle_deg) < low - 1e-3 or np.max(angle_deg) > high + 1e-3:
        must = f"the scanner's field of view is {low:g} to {high:g} degrees (or another {{aperture_law}})"
        raise OptionError(f"{{over}} {{0}}: {must}, got {np.min(angle_deg):g} to {np.max(angle_deg):g}", axis)
    near = np.abs(across) <= np.quantile(np.abs(across), _SLICE)
    order = np.argsort(along[near], kind="stable")
    echo, background = (np.asarray(np.interp(angle_deg, along[near][order], share[near][order])) for share in pulses)
    return echo, background


def shares(scanner: Scanner, pulse: Numbers) -> tuple[Numbers, Numbers]:
    """(n,) shares of pulses: of aperture over the typical one, and of aperture times field of view."""
    echo = np.asarray(scanner.aperture_share(pulse)) / scanner.typical_share
    background = np.asarray(scanner.background_share(pulse))
    return np.full(len(pulse), echo, np.float64), np.full(len(pulse), background, np.float64)


def _frame(scanner: Scanner, axis: str) -> tuple[Numbers, ...]:
    """Angles along and across the axis in degrees, and shares of aperture and background, of a frame's pulses."""
    count = min(scanner.pulses, _PULSES)
    pulse = np.unique(np.linspace(0, scanner.pulses - 1, count).astype(np.uint32))
    azimuth, elevation = (np.degrees(np.asarray(angle_rad, dtype=np.float64)) for angle_rad in scanner.angles(pulse))
    along, across = (elevation, azimuth) if axis == "elevation" else (azimuth, elevation)
    return along, across, *shares(scanner, pulse)
