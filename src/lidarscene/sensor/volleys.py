"""Volleys: the pulses of a scan line that leave at the same instant, and the stray light among their channels.

A detector sees stray light of another direction only if that direction was lit at the same instant. So channels that
fire together share their light, and those that fire in turn do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..maths.arrays import Lanes, LookupTable, Numbers
from ..physics.optics.lens_scatter import stray_share
from ..scan import Scanner
from .sensor_model import StrayLight

LARGEST_TABLE = 2**24
"""Most numbers of a table of shares: 64 MiB in single precision."""

LARGEST_SUM = 0.5
"""Choice: most of a channel's light that may come from others, all of which see the same."""

LEAST_SHARE = 1e-30
"""Accuracy bought: share in the table of channels that fire together without stray light: those of 0 are of no
volley."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Volleys:
    """Volleys of a scan line, the same in every line.

    Attributes:
        line: pulses of a line
        size: most pulses of a volley
        first: (line,) place in the line of the first pulse of each pulse's volley
        share: (line, size) share of the light of each pulse of the volley that reaches the detector of this pulse
        largest_sum: largest sum of the shares of a pulse
    """

    line: Lanes
    size: Lanes
    first: LookupTable
    share: LookupTable
    largest_sum: float


def find_volleys(scanner: Scanner, stray: StrayLight) -> Volleys:
    """Find the volleys of a scanner's lines and the shares of stray light in them, by (T122).

    Raises:
        InputError: for a scanner without any, for one whose lines leave together, and for shares that add up to more
            than `LARGEST_SUM`
    """
    line = scanner.line_pulses
    if line is None or line >= scanner.pulses:
        raise InputError("optics.stray: must be left out for a scanner without lines of pulses that leave together")
    pulse = np.arange(line + 1, dtype=np.uint32)
    time_s = np.asarray(scanner.time_s(pulse))
    # Places in a line are in order of time, so a volley is a run of equal times.
    begins = np.flatnonzero(np.diff(time_s, prepend=-1.0) != 0.0)
    if begins[-1] != line:
        raise InputError("optics.stray: must be left out for a scanner whose lines all leave at once, as a flash's do")
    sizes = np.diff(begins)
    size = int(sizes.max())
    if size == 1:
        raise InputError("optics.stray: must be left out for a scanner whose pulses leave one by one")
    if line * size > LARGEST_TABLE:
        raise InputError(
            f"optics.stray: must go with lines of <= {LARGEST_TABLE // size} pulses if {size} of them leave together, "
            f"got {line}"
        )
    first = np.repeat(begins[:-1], sizes)
    source = first[:, None] + np.arange(size)
    exists = (np.arange(size) < np.repeat(sizes, sizes)[:, None]) & (source != np.arange(line)[:, None])
    source = np.minimum(source, line - 1)
    direction = np.stack([np.broadcast_to(np.asarray(c, np.float64), line + 1) for c in scanner.direction(pulse)], -1)
    apart = np.linalg.norm(direction[:line, None] - direction[source], axis=-1)
    shares: Numbers = np.asarray(
        stray_share(
            angle_rad=2.0 * np.arcsin(np.minimum(0.5 * apart, 1.0)),
            near=stray.share,
            half_angle_rad=stray.half_angle_rad,
            veil=stray.veil,
        )
    )
    # The light that another channel's receiver counts is that on its lens times its responsivity; ours has its own.
    responsivity = np.broadcast_to(np.asarray(scanner.aperture_share(pulse), np.float64), line + 1)
    shares = np.where(exists, np.maximum(shares * (responsivity[:line, None] / responsivity[source]), LEAST_SHARE), 0.0)
    most = float(shares.sum(axis=1).max())
    if most > LARGEST_SUM:
        raise InputError(
            f"optics.stray: shares of all channels that fire together must add up to <= {LARGEST_SUM:g}, got {most:.3g}"
        )
    return Volleys(
        line=line, size=size, first=LookupTable(first.astype(np.float64)), share=LookupTable(shares), largest_sum=most
    )
