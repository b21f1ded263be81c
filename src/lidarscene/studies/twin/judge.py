"""Differences between a simulated frame and the recorded one, and their limits.

Bias and scatter are kept apart, in the unit of the compared quantity (double validation metric; P. Rosenberger, Metrics
for specification, validation, and uncertainty prediction for credibility in simulation of active perception sensor
systems, TU Darmstadt 2022, with C. Linnhoff).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...maths.arrays import Numbers
from ...maths.special import SIGMA_PER_MAD
from ...recordings.sweep import Sweep
from ..held import LIMITS, UNLIMITED, Held, ratio, relative
from .clusters import share_found_again
from .ground import farthest_ground_m
from .matched_pulses import MatchedPulses
from .surfels import SMOOTH
from .tuning import CLIP_SIGMAS, OCTAVES_M, SAME_SURFACE_M

RANGE_BINS = 8
"""Bins of range for the mean signal, with as many recorded returns in each."""

LEAST_PULSES = 50
"""Least number of pulses in a bin of a share or a mean."""

LEAST_SCATTERED = 600
"""Least number of pulses in a bin whose scatters are compared, or shares of pulses at rest. The ratio of scatters has a
sigma of 6 %, by simulation 1.46 over the root of the number: one of 2,000 is beyond the limits by chance, so that the
worst of 20 bins hardly ever is."""

MOST_SIGMA = 0.05
"""Choice: largest relative sigma of the difference of two mean signals: a third of its limit."""

LEAST_LOSSES = 100
"""Least number of losses of which a share is held to a limit: that of one pulse in ten is good to 3 %."""

LEAST_CLUSTERS = 30
"""Least number of recorded clusters of which a share is held to a limit: the ratio of two shares of nine in ten is good
to 8 %."""

CLIPPED_DEVIATION = 0.98658
"""Source: normal distribution; deviation of a number of it that is cut off at 3 sigma, (1 - 6 phi(3) / P(|z| <
3))^0.5."""

MOST_CLIPS = 50


def twin_quantities(
    pulses: MatchedPulses,
    *,
    between: float | None = None,
    again: Numbers | None = None,
    source: Sweep | None = None,
    is_of_frame: bool = False,
) -> list[Held]:
    """Compute the whole table.

    Args:
        between: share of pulses that two recorded frames keep or lose differently (`disagreement`); None: not known
        again: recorded share of each pulse's neighbours that return (`losses_kept`); None: not known
        source: what the twin was made of, columns of this frame or another at rest; None: something else
        is_of_frame: whether the twin was made of this frame, so that its surfaces are where they were recorded
    """
    rows = [
        *_directions(pulses),
        *_nearer(pulses, is_of_frame),
        *_ranges(pulses),
        *_signals(pulses),
        *_points(pulses),
        *_kept_quantities(pulses, between),
        losses_kept(pulses, again),
    ]
    rows += [_ground(pulses), *_second(pulses), _clusters(pulses, source)]
    return rows


def _directions(pulses: MatchedPulses) -> Iterator[Held]:
    """Median angle between recorded and simulated beams, of all and of the worst ring; of pulses that returned."""
    returned = pulses.select(pulses.has_return)
    angle_deg = np.degrees(returned.angle_rad)
    rings = {ring: float(np.median(angle_deg[returned.ring == ring])) for ring in np.unique(returned.ring).tolist()}
    worst = max(rings, key=lambda ring: rings[ring], default=None)
    for quantity, condition, value in (
        ("beam direction", "median angle", float(np.median(angle_deg)) if rings else None),
        ("ring direction", "" if worst is None else f"ring {worst}", None if worst is None else rings[worst]),
    ):
        yield Held(quantity=quantity, condition=condition, value=value, limits=LIMITS[quantity], unit="deg")


def bias_and_scatter(real: Numbers, simulated: Numbers) -> tuple[float, float]:
    """Difference of the means, and the area between both distributions without it, in the unit of the values."""
    quantiles = (np.arange(1000) + 0.5) / 1000.0
    differences = np.quantile(simulated, quantiles) - np.quantile(real, quantiles)
    bias = float(np.mean(differences))
    return bias, float(np.mean(np.abs(differences - bias)))


def _double_metric(name: str, real: Numbers, simulated: Numbers, unit: str) -> Iterator[Held]:
    for part, value in zip(("bias", "scatter"), bias_and_scatter(real, simulated), strict=True):
        yield Held(quantity=f"{name}, double validation metric", condition=part, value=value, unit=unit)


def _nearer(pulses: MatchedPulses, is_of_frame: bool) -> Iterator[Held]:
    """Share of the simulated returns that are nearer than recorded in their direction, and that of the worst octave."""
    both = pulses.select(pulses.has_return & pulses.has_simulated_return)
    is_nearer = both.simulated_range_m < both.aimed_range_m - SAME_SURFACE_M
    octave = np.digitize(both.range_m, OCTAVES_M)
    full = np.bincount(octave) >= LEAST_PULSES
    shares = {number: float(np.mean(is_nearer[octave == number])) for number in np.flatnonzero(full)}
    worst = max(shares, key=lambda number: shares[number], default=None)
    quantity = f"returns {SAME_SURFACE_M:g} m nearer than recorded"
    yield Held(
        quantity=quantity, value=_share(is_nearer), limits=LIMITS["nearer returns"] if is_of_frame else UNLIMITED
    )
    if worst is not None:
        low, high = np.r_[0.0, OCTAVES_M, np.inf][worst : worst + 2]
        yield Held(quantity=f"{quantity}, worst octave", condition=f"{low:.3g} to {high:.3g} m", value=shares[worst])


def _ranges(pulses: MatchedPulses) -> Iterator[Held]:
    """Range errors against the twin's surface, where both sides have a return on a smooth surface."""
    near_surface = np.abs(pulses.range_m - pulses.true_range_m) < SAME_SURFACE_M
    returns = pulses.select(pulses.has_return & pulses.has_simulated_return & (pulses.kind == SMOOTH) & near_surface)
    real_mm = 1e3 * (returns.range_m - returns.true_range_m)
    simulated_mm = 1e3 * (returns.simulated_range_m - returns.true_range_m)
    has_enough = bool(len(real_mm) >= LEAST_PULSES)
    yield Held(
        quantity="range, bias",
        condition="smooth surfaces",
        unit="mm",
        limits=LIMITS["range bias"],
        value=float(np.median(simulated_mm - real_mm)) if has_enough else None,
    )
    scatters = []
    if has_enough:
        yield from _double_metric("range", real_mm, simulated_mm, "mm")
        scatters = list(_scatters(returns))
    yield from scatters or [Held(quantity="range, scatter", limits=LIMITS["scatter ratio"])]


def _scatters(returns: MatchedPulses) -> Iterator[Held]:
    """Scatter in each octave of signal with enough second differences; without signals, of all of them."""
    returns = returns.select(np.isfinite(returns.change_m))
    if returns.signal is None:
        if len(returns.change_m) >= LEAST_SCATTERED:
            yield _scatter("all strengths", returns)
        return
    octave = np.floor(np.log2(np.maximum(returns.signal, 1.0))).astype(int)
    for number in np.unique(octave):
        octave_returns = returns.select(octave == number)
        if len(octave_returns.change_m) >= LEAST_SCATTERED:
            yield _scatter(f"signal {2**number} to {2 ** (number + 1)}", octave_returns)


def _scatter(name: str, returns: MatchedPulses) -> Held:
    """Scatter of second differences along the ring on both sides, which errors of the twin's surface do not enter."""
    real, simulated = (
        1e3 * spread(values[np.isfinite(values)]) for values in (returns.change_m, returns.simulated_change_m)
    )
    return Held(
        quantity="range, scatter",
        condition=name,
        reference=real,
        simulated=simulated,
        value=ratio(simulated, real),
        limits=LIMITS["scatter ratio"],
        unit="mm",
    )


def spread(values: Numbers) -> float:
    """Standard deviation of the values within `CLIP_SIGMAS` of their mean, robust against a few edges.

    The median absolute deviation only starts it: that of whole millimetres goes in steps of 1.5 mm.
    """
    centre = float(np.median(values))
    sigma = float(SIGMA_PER_MAD * np.median(np.abs(values - centre))) or float(np.std(values))
    for _ in range(MOST_CLIPS):
        inlier = values[np.abs(values - centre) <= CLIP_SIGMAS * sigma]
        centre, previous, sigma = float(np.mean(inlier)), sigma, float(np.std(inlier)) / CLIPPED_DEVIATION
        if abs(sigma - previous) <= 1e-6 * previous:
            break
    return sigma


def _signals(pulses: MatchedPulses) -> Iterator[Held]:
    if pulses.signal is None or not np.nanmax(pulses.simulated_signal, initial=0.0) > 0.0:
        yield Held(quantity="signal, mean error over the range", limits=LIMITS["signal error"])
        return
    returned, simulated = pulses.has_return, pulses.has_simulated_return
    quantiles_m = np.quantile(pulses.range_m[returned], np.linspace(0.0, 1.0, RANGE_BINS + 1))
    means = [_signal_row("signal, mean", mean) for mean in mean_signals(pulses, quantiles_m)]
    yield from means
    yield Held(
        quantity="signal, mean error over the range",
        value=float(np.mean([abs(row.value or 0.0) for row in means])) if means else None,
        limits=LIMITS["signal error"],
    )
    quantity = "signal, error in the worst octave of the range"
    octaves = [_signal_row(quantity, mean) for mean in mean_signals(pulses, OCTAVES_M)]
    worst = max(octaves, key=lambda row: abs(row.value or 0.0), default=Held(quantity=quantity, unit="photons"))
    yield replace(worst, value=None if worst.value is None else abs(worst.value), limits=LIMITS["signal error"])
    both_mask = returned & simulated & (pulses.signal > 0.0) & (pulses.simulated_signal > 0.0)
    if both_mask.sum() >= LEAST_PULSES:
        signals = pulses.signal[both_mask], pulses.simulated_signal[both_mask]
        yield from _double_metric("signal", *signals, "photons")
        yield Held(quantity="signal, correlation of logarithms", value=float(np.corrcoef(*np.log(signals))[0, 1]))


def mean_signals(pulses: MatchedPulses, edges_m: Numbers) -> list[tuple[float, float, float, float]]:
    """Mean signal of the pulses that return on both sides between these ranges: (low, high, real, simulated).

    Losses have rows of their own. Here the pulses that one side lost, the weakest, would raise its mean.
    """
    assert pulses.signal is not None
    both_mask, rows = pulses.has_return & pulses.has_simulated_return, []
    for low, high in itertools.pairwise(edges_m.tolist()):
        of_bin = both_mask & (pulses.range_m >= low) & (pulses.range_m < high)
        if of_bin.sum() < LEAST_PULSES:
            continue
        signal, simulated = pulses.signal[of_bin], pulses.simulated_signal[of_bin]
        real, sigma = float(np.mean(signal)), float(np.std(simulated - signal)) / np.sqrt(len(signal))
        if real > 0.0 and sigma <= MOST_SIGMA * real:  # recorders write 0 for what they lack
            rows.append((low, high, real, float(np.mean(simulated))))
    return rows


def _signal_row(quantity: str, mean: tuple[float, float, float, float]) -> Held:
    low, high, real, simulated = mean
    return Held(
        quantity=quantity,
        condition=f"{low:.3g} to {high:.3g} m",
        reference=real,
        simulated=simulated,
        value=simulated / real - 1.0,
        unit="photons",
    )


def _points(pulses: MatchedPulses) -> Iterator[Held]:
    real, simulated = int(pulses.has_return.sum()), int(pulses.has_simulated_return.sum())
    yield Held(
        quantity="points", reference=real, simulated=simulated, value=relative(simulated, real), limits=LIMITS["points"]
    )
    rings = int(pulses.ring.max()) + 1
    of_real = np.bincount(pulses.ring[pulses.has_return], minlength=rings)
    of_simulated = np.bincount(pulses.ring[pulses.has_simulated_return], minlength=rings)
    full_rings = of_real >= LEAST_PULSES
    if not full_rings.any():
        yield Held(quantity="points per ring, worst", limits=LIMITS["points of a ring"])
        return
    error = of_simulated[full_rings] / of_real[full_rings] - 1.0
    worst_index = int(np.argmax(np.abs(error)))
    number = int(np.flatnonzero(full_rings)[worst_index])
    yield Held(
        quantity="points per ring, worst",
        condition=f"ring {number}",
        reference=int(of_real[number]),
        simulated=int(of_simulated[number]),
        value=float(error[worst_index]),
        limits=LIMITS["points of a ring"],
    )
    yield Held(
        quantity="rings within 10 %",
        condition=f"of {int(full_rings.sum())}",
        value=float(np.mean([LIMITS["points of a ring"].include(ring_error) for ring_error in error])),
    )


def _kept_quantities(pulses: MatchedPulses, between: float | None = None) -> Iterator[Held]:
    returned, simulated = pulses.has_return, pulses.has_simulated_return
    yield Held(quantity="real returns kept", value=_share(simulated[returned]), limits=LIMITS["returns kept"])
    if pulses.withheld.any():
        yield Held(
            quantity="found but withheld by the real sensor, kept",
            condition=f"of {int(pulses.withheld.sum())}",
            value=_share(simulated[pulses.withheld]),
        )
    yield Held(
        quantity="kept or lost otherwise than real",
        condition="" if between is None else "real: between two frames",
        reference=between,
        value=_share(returned != simulated),
        limits=UNLIMITED if between is None else LIMITS["disagreement"].shifted(between),
    )


def losses_kept(pulses: MatchedPulses, again: Numbers | None = None) -> Held:
    """Share of the recorded losses on smooth surfaces that the simulation keeps, beside what the recording keeps there.

    A pulse that is lost by chance is kept the next time. Where surfaces are not smooth the twin does not know what a
    beam met: leaves, edges and gaps are finer than its quads.

    Args:
        again: (n,) recorded share of the same pulse in other turns, or of its neighbours in the row; None: not known
    """
    lost = ~pulses.has_return & ~pulses.withheld & (pulses.kind == SMOOTH)
    reference = None if again is None else _share(again[lost])
    return Held(
        quantity="real losses on smooth surfaces kept",
        condition=f"of {int(lost.sum())}" + ("" if again is None else ", real: in other turns or columns"),
        reference=reference,
        value=_share(pulses.has_simulated_return[lost]) if lost.sum() >= LEAST_LOSSES else None,
        limits=LIMITS["losses kept"] if reference is None else LIMITS["losses kept again"].shifted(reference),
    )


def disagreement(first: Sweep, second: Sweep) -> float | None:
    """Share of the pulses that two frames keep or lose differently; None for other shapes or unknown losses."""
    recorded = first.recorded & second.recorded if first.shape == second.shape else np.zeros(0, bool)
    if not (recorded.any() and first.includes_lost and second.includes_lost):
        return None
    return _share((first.has_return != second.has_return)[recorded])


def _share(mask: Numbers) -> float | None:
    return float(np.mean(mask)) if len(mask) else None


def _ground(pulses: MatchedPulses) -> Held:
    real, simulated = map(farthest_ground_m, _points_m(pulses))
    return Held(
        quantity="farthest ground, 99.9 %",
        reference=real,
        simulated=simulated,
        value=relative(simulated, real),
        limits=LIMITS["farthest ground"],
        unit="m",
    )


def _points_m(pulses: MatchedPulses) -> tuple[Numbers, Numbers]:
    """Points of the first returns of both sides."""
    return pulses.xyz_m[pulses.has_return], pulses.simulated_xyz_m[pulses.has_simulated_return]


def _clusters(pulses: MatchedPulses, source: Sweep | None = None) -> Held:
    """Share of the clusters above the ground that perception finds again in the simulated cloud.

    The reference is the share that it finds in the recorded ``source``: a twin of that knows no more.
    """
    real_m, simulated_m = _points_m(pulses)
    clusters = share_found_again(real_m, simulated_m)
    share, number = (None, 0) if clusters is None else clusters
    in_source = None if source is None else share_found_again(real_m, source.xyz_m[source.has_return])
    reference = None if in_source is None else in_source[0]
    return Held(
        quantity="clusters found again",
        condition=f"of {number}" + ("" if in_source is None else ", real: in what the twin is made of"),
        reference=reference,
        simulated=share,
        value=None if number < LEAST_CLUSTERS else share if reference is None else ratio(share, reference),
        limits=LIMITS["clusters"],
    )


def _second(pulses: MatchedPulses) -> Iterator[Held]:
    gaps_m = [gap_m[np.isfinite(gap_m)] for gap_m in (pulses.gap_m, pulses.simulated_gap_m)]
    if not any(map(len, gaps_m)):
        return
    returns = (pulses.has_return, pulses.has_simulated_return)
    real, simulated = (len(gap_m) / max(int(mask.sum()), 1) for gap_m, mask in zip(gaps_m, returns, strict=True))
    yield Held(
        quantity="second returns, share",
        reference=real,
        simulated=simulated,
        value=ratio(simulated, real),
        limits=LIMITS["second returns"],
    )
    real_m, simulated_m = (float(np.percentile(gap_m, 1.0)) if len(gap_m) else None for gap_m in gaps_m)
    yield Held(
        quantity="second returns, least separation",
        condition="1 %",
        reference=real_m,
        simulated=simulated_m,
        unit="m",
        value=relative(simulated_m, real_m) if min(map(len, gaps_m)) >= LEAST_PULSES else None,
        limits=LIMITS["second separation"],
    )
