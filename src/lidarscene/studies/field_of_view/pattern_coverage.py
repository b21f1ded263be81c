"""Coverage, density and revisit time of a scan pattern, for each cell of its field of view.

Non-repetitive patterns get denser with time, so all numbers are for a given time of observation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...errors import OptionError
from ...maths.arrays import Numbers
from ...maths.vectors import convex_hull
from ...scan import Scanner
from ..ranging.aperture_laws import shares
from .sphere_cells import SphereCells

MOST_PULSES = 20_000_000

DWELL_S = 1e-3
"""Choice: shortest pause between two pulses in a cell that makes them two visits."""

LONG = 4
"""Multiple of the longest requested time from which the field of view is found, if that is not too many pulses."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FiredPulses:
    """Pulses that a scanner fires in some time, in firing order; arrays (n,), ``direction`` (n, 3).

    Attributes:
        direction: unit vectors in the sensor's frame, as the beam leaves: without jitter or the encoder's steps
        share: (n, 2) effective aperture over that of `Scanner.typical_share`, and aperture times field of view over its
            value on the axis
    """

    time_s: Numbers
    azimuth_deg: Numbers
    elevation_deg: Numbers
    direction: Numbers
    share: Numbers

    def __len__(self) -> int:
        return len(self.time_s)

    def until(self, time_s: float) -> FiredPulses:
        """Pulses fired before this time."""
        # A pulse at exactly this time is left out, also where rounding puts it just below.
        n = int(np.searchsorted(self.time_s, time_s * (1.0 - 1e-12), side="left"))
        return FiredPulses(
            time_s=self.time_s[:n],
            azimuth_deg=self.azimuth_deg[:n],
            elevation_deg=self.elevation_deg[:n],
            direction=self.direction[:n],
            share=self.share[:n],
        )


def rate_hz(scanner: Scanner) -> float:
    """Pulses per second, averaged over a frame."""
    return scanner.pulses / scanner.frame_s


def fired_pulses(scanner: Scanner, time_s: float) -> FiredPulses:
    """Compute the pulses fired within this time from the start of frame 0.

    Raises:
        InputError: if they are too many
    """
    frames = max(math.ceil(time_s / scanner.frame_s - 1e-9), 1)
    count = min(frames * scanner.pulses, math.ceil(time_s * rate_hz(scanner)) + scanner.pulses)
    if count > MOST_PULSES + scanner.pulses:
        raise OptionError(f"{{times_s}}: {time_s:g} s of this scanner are {count} pulses, must be <= {MOST_PULSES}")
    pulse = np.arange(count, dtype=np.uint32)
    x, y, z = (np.asarray(component, dtype=np.float64) * np.ones(count) for component in scanner.direction(pulse))
    whole = FiredPulses(
        time_s=scanner.time_s(pulse),
        azimuth_deg=np.degrees(np.arctan2(y, x)),
        elevation_deg=np.degrees(np.arctan2(z, np.hypot(x, y))),
        direction=np.column_stack([x, y, z]),
        share=np.column_stack(shares(scanner, pulse)),
    )
    return whole.until(time_s)


def field_cells(scanner: Scanner, cells: SphereCells, time_s: float, *, kind: str = "outline") -> tuple[Numbers, float]:
    """Sorted cells of the field of view, and the time for which the scanner was watched to find them.

    Args:
        kind: "reached": cells that ever get a pulse; "outline": these, and those with their middle in the convex hull
            of all pulses in azimuth and elevation

    Raises:
        InputError: if the pulses are too many
    """
    watched_s = max(LONG * time_s, scanner.frame_s)
    watched_s = max(min(watched_s, MOST_PULSES / rate_hz(scanner)), time_s)
    pulses = fired_pulses(scanner, watched_s)
    reached = np.unique(cells.locate(pulses.azimuth_deg, pulses.elevation_deg))
    if kind == "reached":
        return reached, watched_s
    inside = cells.within(convex_hull(np.column_stack([pulses.azimuth_deg, pulses.elevation_deg])))
    return np.union1d(inside, reached), watched_s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellMaps:
    """Numbers for each cell of a field of view; arrays (cells,).

    Attributes:
        cell: number of the cell in `SphereCells`, rising
        square_degrees: solid angle
        first_s: time of its first pulse; inf: never
        pulses: number of pulses
        density: pulses per square degree
        revisit_s: mean time between visits; NaN for fewer than two
        share: (cells, 2) mean of its pulses' shares, of aperture and background; NaN without
    """

    cell: Numbers
    square_degrees: Numbers
    first_s: Numbers
    pulses: Numbers
    density: Numbers
    revisit_s: Numbers
    share: Numbers

    def coverage(self, times_s: Numbers) -> Numbers:
        """Share of the field's solid angle whose cells got a pulse before each of these times."""
        order = np.argsort(self.first_s)
        area = np.concatenate([[0.0], np.cumsum(self.square_degrees[order])])
        before = np.asarray(times_s, dtype=np.float64) * (1.0 - 1e-12)
        return np.asarray(area[np.searchsorted(self.first_s[order], before, side="left")] / area[-1])


def cell_maps(pulses: FiredPulses, cells: SphereCells, mask: Numbers, *, dwell_s: float = DWELL_S) -> CellMaps:
    """Count and time the pulses in each cell of the field of view.

    Args:
        mask: sorted numbers of the field's cells; pulses elsewhere are left out
        dwell_s: pulses of a cell that follow each other sooner than this are one visit
    """
    pulse_cell = cells.locate(pulses.azimuth_deg, pulses.elevation_deg)
    place = np.searchsorted(mask, pulse_cell)
    inside = (place < len(mask)) & (mask[np.minimum(place, len(mask) - 1)] == pulse_cell)
    lane = np.flatnonzero(inside)
    place = place[lane]
    order = np.argsort(place, kind="stable")  # by cell, and in it by time
    place, time_s, share = place[order], pulses.time_s[lane][order], pulses.share[lane][order]
    count = np.bincount(place, minlength=len(mask))
    starts = np.concatenate([[0], np.cumsum(count)])
    has_pulse = count > 0
    first_pulse = starts[:-1][has_pulse]
    first_s, revisit_s = (np.full(len(mask), value) for value in (np.inf, np.nan))
    mean_share = np.full((len(mask), 2), np.nan)
    first_s[has_pulse] = time_s[first_pulse]
    if len(first_pulse):
        mean_share[has_pulse] = np.add.reduceat(share, first_pulse) / count[has_pulse, None]
    starts_visit = np.ones(len(place), dtype=bool)
    starts_visit[1:] = (place[1:] != place[:-1]) | (time_s[1:] - time_s[:-1] >= dwell_s)
    visits = np.bincount(place[starts_visit], minlength=len(mask))
    # From the first visit's start to the last visit's start.
    last_s = np.zeros(len(mask))
    last_s[place[starts_visit]] = time_s[starts_visit]
    revisited = visits > 1
    revisit_s[revisited] = (last_s[revisited] - first_s[revisited]) / (visits[revisited] - 1)
    area = cells.square_degrees(mask)
    return CellMaps(
        cell=mask,
        square_degrees=area,
        first_s=first_s,
        pulses=count,
        density=count / area,
        revisit_s=revisit_s,
        share=mean_share,
    )
