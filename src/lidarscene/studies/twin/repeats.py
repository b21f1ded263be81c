"""Pulses that are fired again and again by a sensor at rest: what is lost by chance, and the noise of one pixel.

Neither the scene nor the scale of its strengths enters: a pixel is compared with itself, recorded and simulated.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from ...maths.arrays import Numbers
from ..held import LIMITS, Held, ratio
from .judge import LEAST_PULSES, LEAST_SCATTERED, spread
from .matched_pulses import NO_SURFACE, MatchedPulses
from .surfels import SMOOTH
from .tuning import OCTAVES_M, SAME_SURFACE_M

STRENGTHS = 4
"""Choice: bins of the strength in each octave of the range, with as many pixels in each."""


class Changes(NamedTuple):
    """Differences between ranges, (n,) each, whose deviation is that of one range; NaN where a side has none.

    Attributes:
        range_m: range of the pixel
        strength: strength of its recorded return; None where none is recorded
        real_m: recorded difference
        simulated_m: simulated difference
    """

    range_m: Numbers
    strength: Numbers | None
    real_m: Numbers
    simulated_m: Numbers


def changes_m(range_m: Numbers) -> Numbers:
    """Differences between frames that follow each other, over the root of two; NaN from another surface.

    Args:
        range_m: (frames, n)
    """
    change_m = np.diff(range_m, axis=0)
    return np.asarray(np.where(np.abs(change_m) < SAME_SURFACE_M, change_m, np.nan) / np.sqrt(2.0))


def changes_along_rings(pulses: MatchedPulses) -> Changes:
    """Second differences along the ring, on smooth surfaces, for a frame that stands alone."""
    return Changes(pulses.range_m, pulses.strength, pulses.change_m, pulses.simulated_change_m)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Repeats:
    """Frames of a sensor at rest, (frames, pulses) each by the number of the pulse; NaN where there is no return."""

    range_m: Numbers
    simulated_range_m: Numbers
    strength: Numbers | None
    simulated_strength: Numbers | None
    is_smooth: Numbers

    @classmethod
    def from_frames(cls, frames: Sequence[MatchedPulses], pulses: int) -> Repeats:
        """Order the matched pulses of each frame; the scanner fires so many a frame."""

        def by_pulse(name: str) -> Any:
            if getattr(frames[0], name) is None:
                return None
            values = np.full((len(frames), pulses), np.nan)
            for row, frame in zip(values, frames, strict=True):
                row[frame.pulse] = getattr(frame, name)
            return values

        ranges_and_strengths = [field.name for field in fields(cls) if field.name != "is_smooth"]
        return cls(**{name: by_pulse(name) for name in ranges_and_strengths}, is_smooth=by_pulse("kind") == SMOOTH)

    def changes(self) -> Changes:
        """Changes between frames that follow each other, on smooth surfaces.

        Elsewhere beams that miss meet another leaf or stair, which is finer than the twin's quads.
        """
        smooth = self.is_smooth[1:]
        return Changes(
            range_m=self.range_m[1:][smooth],
            strength=None if self.strength is None else self.strength[1:][smooth],
            real_m=changes_m(self.range_m)[smooth],
            simulated_m=changes_m(self.simulated_range_m)[smooth],
        )

    def kept_again(self, pulses: MatchedPulses) -> Numbers:
        """(n,) recorded share of each pulse that returns in the other frames, if it was lost in its own."""
        return np.asarray(np.isfinite(self.range_m).sum(axis=0)[pulses.pulse] / (len(self.range_m) - 1))

    def quantities(self) -> Iterator[Held]:
        """Rows on pixels that flicker, jump or scatter."""
        measures: Sequence[tuple[str, Callable[[Numbers], float | None], Numbers | None, Numbers | None]] = (
            ("pixels that return now and then", _flickering, self.range_m, self.simulated_range_m),
            (f"pixels that jump by {SAME_SURFACE_M:g} m", _jumping, self.range_m, self.simulated_range_m),
            ("strength, relative scatter", _relative_scatter, self.strength, self.simulated_strength),
        )
        for name, measure, real, simulated in measures:
            if real is not None and simulated is not None:
                reference, value = measure(real), measure(simulated)
                yield Held(
                    quantity=name,
                    condition="at rest",
                    reference=reference,
                    simulated=value,
                    value=ratio(value, reference),
                )
        yield from _scatters_at_rest(self.changes())


def _flickering(range_m: Numbers) -> float:
    """Share of the pixels that return in some frames and not in all, of those that ever return."""
    share = np.isfinite(range_m).mean(axis=0)
    return float(np.mean(share[share > 0.0] < 1.0)) if share.any() else 0.0


def _jumping(range_m: Numbers) -> float:
    """Share of the pixels that return twice running, and the second time from another surface."""
    change_m = np.diff(range_m, axis=0)
    known = np.isfinite(change_m)
    return float(np.mean(np.abs(change_m[known]) > SAME_SURFACE_M)) if known.any() else 0.0


def _relative_scatter(strength: Numbers) -> float | None:
    """Scatter of the strength of a pixel over its mean."""
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.diff(np.log(strength), axis=0)
    change = change[np.isfinite(change)]
    return spread(change) / np.sqrt(2.0) if len(change) >= LEAST_SCATTERED else None


def scatter_by_bin(changes: Changes, values: Numbers, edges: Numbers) -> list[tuple[float, float, float, float]]:
    """Scatter of both sides [m] in the bins of ``values`` that have enough: (low, high, recorded, simulated)."""
    rows = []
    for low, high in itertools.pairwise(edges.tolist()):
        mask = (values >= low) & (values < high)
        sides = [side[mask & np.isfinite(side)] for side in (changes.real_m, changes.simulated_m)]
        if min(map(len, sides)) >= LEAST_SCATTERED:
            real_m, simulated_m = map(spread, sides)
            rows.append((low, high, real_m, simulated_m))
    return rows


def _scatters_at_rest(changes: Changes) -> Iterator[Held]:
    """Scatter by octave of the range and quarter of the strength: the worst bin, and how many are within the limits."""
    bins: list[Held] = []
    for low_m, high_m in itertools.pairwise(OCTAVES_M.tolist()):
        mask = (changes.range_m >= low_m) & (changes.range_m < high_m) & np.isfinite(changes.real_m)
        octave = Changes(*(None if values is None else values[mask] for values in changes))  # type: ignore[arg-type]
        strength = np.zeros(mask.sum()) if octave.strength is None else octave.strength
        edges = np.unique(np.quantile(strength, np.linspace(0.0, 1.0, STRENGTHS + 1))) if mask.any() else np.zeros(0)
        edges = np.r_[edges[:-1], np.inf] if len(edges) > 1 else np.array([-np.inf, np.inf])
        for low, high, real_m, simulated_m in scatter_by_bin(octave, strength, edges):
            of_strength = "" if octave.strength is None else f", strength from {max(low, 0.0):.3g}"
            bins.append(
                Held(
                    quantity="range, scatter at rest, worst bin",
                    condition=f"{low_m:g} to {high_m:g} m{of_strength}" + (f" to {high:.3g}" if high < np.inf else ""),
                    reference=1e3 * real_m,
                    simulated=1e3 * simulated_m,
                    value=ratio(simulated_m, real_m),
                    limits=LIMITS["scatter ratio"],
                    unit="mm",
                )
            )
    if not bins:
        yield Held(quantity="range, scatter at rest, worst bin", limits=LIMITS["scatter ratio"])
        return
    yield max(bins, key=lambda row: abs(np.log(max(row.value or 0.0, 1e-9))))
    yield Held(
        quantity="range, scatter at rest, bins within the limits",
        condition=f"of {len(bins)}",
        value=float(np.mean([bool(row.verdict) for row in bins])),
    )


def kept_by_bin(
    real: Numbers, simulated: Numbers, values: Numbers, edges: Numbers, least: int = LEAST_PULSES
) -> list[tuple[float, float, float, float]]:
    """Share of pulses that return, in the bins of ``values`` that have enough: (low, high, real, simulated).

    Args:
        real: (n,) whether each is kept, or how often
        simulated: (n,) the same, simulated
        least: number of pulses that is enough
    """
    rows = []
    for low, high in itertools.pairwise(edges.tolist()):
        chosen = (values >= low) & (values < high)
        if chosen.sum() >= least:
            shares = (side[chosen].mean() for side in (real, simulated))
            rows.append((low, high, *map(float, shares)))
    return rows


def kept_at_rest(pulses: MatchedPulses, mask: Numbers) -> Held:
    """Worst octave of the range of the share that is kept on smooth surfaces.

    Of a surface that one pixel meets alone the twin has one reading, and of those near the threshold the strong ones.

    Args:
        pulses: of all frames
        mask: pulses that returned in the frame that the twin is made of: they met something there on either side
    """
    met = pulses.select(mask & (pulses.kind == SMOOTH))
    sides = met.has_return, met.has_simulated_return
    shares = kept_by_bin(*sides, met.true_range_m, OCTAVES_M, least=LEAST_SCATTERED)
    quantity = "share kept at rest on smooth surfaces, worst octave of the range"
    if not shares:
        return Held(quantity=quantity, limits=LIMITS["kept share"])
    return held_share(quantity, *max(shares, key=lambda row: abs(row[3] - row[2])))


def held_share(quantity: str, low: float, high: float, real: float, simulated: float) -> Held:
    """Share kept between these ranges, one of `kept_by_bin`."""
    return Held(
        quantity=quantity,
        condition=f"{low:g} to {high:g} m",
        reference=real,
        simulated=simulated,
        value=simulated - real,
        limits=LIMITS["kept share"],
    )


def on_surfaces(pulses: MatchedPulses) -> Numbers:
    """Mask of the pulses that met a surface of the twin and were not withheld, for a frame that stands alone."""
    return np.asarray((pulses.kind != NO_SURFACE) & ~pulses.withheld)
