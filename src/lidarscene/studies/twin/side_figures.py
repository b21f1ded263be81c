"""Figures of a recording beside its simulation: losses, noise and photons of both sides."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ...figures.lines import Chart, Line
from ...figures.report import Figure
from ...maths.arrays import Numbers
from .judge import LEAST_SCATTERED, mean_signals
from .matched_pulses import MatchedPulses
from .repeats import Changes, Repeats, changes_along_rings, kept_by_bin, on_surfaces, scatter_by_bin
from .tuning import OCTAVES_M

REAL, SIMULATED = "recorded", "simulated"
"""Names of the sides."""

STRENGTH_BINS = 8
"""Choice: most bins of the figures over the strength, with as many pixels in each."""

REFLECTIVITIES = np.geomspace(0.003, 1.0, 11)
"""Choice: edges of the bins of the figure over the reflectivity."""


def side_figures(
    pulses: MatchedPulses, repeats: Repeats | None = None, was_kept: Numbers | None = None
) -> Iterator[Figure]:
    """Losses and noise of both sides over the range, and over reflectivity or strength; photons over the range.

    Args:
        pulses: of all frames
        repeats: pixels of a sensor at rest; None: noise is that along the rings
        was_kept: (n,) mask of the pulses whose losses are shown; None: those that met a surface
    """
    met = pulses.select(on_surfaces(pulses) if was_kept is None else was_kept)
    of = "met a surface" if was_kept is None else "returned in the frame that the twin is made of"
    half_octaves_m = np.geomspace(OCTAVES_M[0], OCTAVES_M[-1], 2 * len(OCTAVES_M) - 1)
    for name, words, values, edges in (
        ("kept-range", "range [m]", met.true_range_m, half_octaves_m),
        ("kept-reflectivity", "reflectivity of the surface", met.reflectivity, REFLECTIVITIES),
    ):
        caption = f"Share with a return, of the pulses that {of}, by {words.partition(' [')[0]}."
        rows = kept_by_bin(met.has_return, met.has_simulated_return, values, edges)
        yield from _figure(name, caption, (words, "share with a return"), rows)
    changes = changes_along_rings(pulses) if repeats is None else repeats.changes()
    how = "second differences along the ring on smooth surfaces" if repeats is None else "pixels at rest"
    bins = [("scatter-range", "range [m]", changes.range_m, half_octaves_m)]
    if changes.strength is not None:
        unit = "SIGNAL [photons]" if pulses.signal is not None else "strength, as recorded"
        bins.append(("scatter-strength", unit, changes.strength, _even_edges(changes)))
    for name, words, values, edges in bins:
        rows = [(low, high, 1e3 * a, 1e3 * b) for low, high, a, b in scatter_by_bin(changes, values, edges)]
        caption = f"Scatter of the range, of {how}, by {words.partition(' [')[0]}."
        yield from _figure(name, caption, (words, "scatter of the range [mm]"), rows, y_log=True)
    if pulses.signal is not None:
        yield from _figure(
            "signal",
            "Mean signal by range.",
            ("range [m]", "SIGNAL [photons]"),
            mean_signals(pulses, half_octaves_m),
            y_log=True,
        )


def _even_edges(changes: Changes) -> Numbers:
    """Edges of bins of the strength with as many recorded differences in each."""
    assert changes.strength is not None
    strength = changes.strength[np.isfinite(changes.real_m) & (changes.strength > 0.0)]
    # A quarter more than are compared, since the simulation may have lost some.
    bins = min(int(len(strength) / (1.25 * LEAST_SCATTERED)), STRENGTH_BINS)
    return np.unique(np.quantile(strength, np.linspace(0.0, 1.0, bins + 1))) if bins else np.zeros(0)


def _figure(
    name: str,
    caption: str,
    axes: tuple[str, str],
    rows: Sequence[tuple[float, float, float, float]],
    *,
    y_log: bool = False,
) -> Iterator[Figure]:
    """Figure of both sides by bin; none without two bins."""
    if len(rows) < 2:
        return
    low, high, real, simulated = np.array(rows).T
    middle = np.sqrt(low * high)
    chart = Chart(
        lines=(
            Line(label=REAL, x=middle, y=real),
            Line(label=SIMULATED, x=middle, y=simulated, colour=1, style="dashed"),
        ),
        x_label=axes[0],
        y_label=axes[1],
        x_log=True,
        y_log=y_log,
    )
    yield Figure(name, chart, (("from", "to", REAL, SIMULATED), rows), caption)
