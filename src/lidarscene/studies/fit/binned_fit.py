"""Fits of laws to numbers of bins: weighted least squares, robust and from several starts, with its intervals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ...maths.arrays import Numbers, map_arrays
from ...maths.special import SIGMA_PER_MAD
from .estimates import Solution, huber_weight
from .tuning import (
    ABOUT,
    CURVE_HUBER,
    FAR_COST,
    FINE,
    FINEST,
    LEAST_SLOPE,
    LIKELY,
    MOST_SCANNED,
    MOST_STEPS,
    PINNED,
    ROUNDS,
    SCANNED,
    SLOPE_STEP,
    SMOOTH,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Statistics:
    """k numbers of bins of pixels.

    Attributes:
        value: (k,) as recorded
        sigma: (k,) standard deviation of what is recorded
        parts: (blocks, k) what each block adds to ``value``, less its mean
        share: (blocks, k) share of the pixels that are of the block
        kind: (k,) number of their kind; what a law misses is of one size in each
        trials: (k,) number of pulses of which a share was kept; infinite of other values
    """

    value: Numbers
    sigma: Numbers
    parts: Numbers
    share: Numbers
    kind: Numbers
    trials: Numbers

    @classmethod
    def of(cls, values: Sequence[Numbers], members: Sequence[Numbers], block: Numbers) -> Statistics:
        """Means of what is known of the pixels' values in each bin; NaN where nothing is.

        Args:
            values: (n,) of each bin
            members: (n,) of each bin, indices of its pixels
            block: block of every pixel
        """
        number, known = int(block.max()) + 1, [np.isfinite(bin_values) for bin_values in values]
        values = [bin_values[mask] for bin_values, mask in zip(values, known, strict=True)]
        blocks = [block[chosen[mask]] for chosen, mask in zip(members, known, strict=True)]
        counts = np.array([len(bin_values) for bin_values in values])
        sums = np.stack([np.bincount(*pair, number) for pair in zip(blocks, values, strict=True)], axis=1)
        with np.errstate(invalid="ignore"):
            mean = sums.sum(axis=0) / counts
            share = np.stack([np.bincount(of_bin, minlength=number) for of_bin in blocks], axis=1) / counts
            squares = [np.sum((bin_values - middle) ** 2) for bin_values, middle in zip(values, mean, strict=True)]
            sigma, parts = np.sqrt(squares) / counts, sums / counts - share * mean
        return cls(value=mean, sigma=sigma, parts=parts, share=share, kind=0 * counts, trials=counts + np.inf)

    def logarithm(self) -> Statistics:
        """Statistics of the logarithms."""
        return replace(self, value=np.log(self.value), sigma=self.sigma / self.value, parts=self.parts / self.value)

    def spread(self, law: Numbers) -> Numbers:
        """(k,) standard deviation about a law; of shares by its own chance.

        By the recorded share, bins that lost fewer pulses by chance would weigh more than those that lost more.
        """
        kept = np.clip(law, 0.0, 1.0)
        return np.sqrt(self.sigma**2 + (kept * (1.0 - kept) + 1.0 / self.trials) / self.trials)

    @staticmethod
    def join(parts: Sequence[Statistics]) -> Statistics:
        """Statistics of several kinds side by side."""
        numbered = [replace(part, kind=part.kind + number) for number, part in enumerate(parts)]
        return map_arrays(lambda *values: np.concatenate(values, axis=-1), *numbered)


class Prior(NamedTuple):
    """What is expected of p parameters.

    Attributes:
        value: (p,) parameters
        sigma: (p,) their standard deviations; inf: nothing is expected
        misfit: misfit of the law that the solver begins with
    """

    value: Numbers
    sigma: Numbers
    misfit: float = 0.0


def misfit_beyond(residual: Numbers, sigma: Numbers) -> float:
    """Standard deviation of residuals beyond their own sigma, by medians: a few bins may follow laws of their own."""
    excess = float(np.median((SIGMA_PER_MAD * residual) ** 2 - sigma**2))
    return math.sqrt(max(excess, 1e-6**2))


Law = Callable[[Numbers], Numbers]

RULES: Mapping[str, Any] = {"x_scale": "jac", "xtol": 1e-4, "ftol": 1e-3}
"""Accuracy bought: steps of the solver are far below what noise leaves open."""


class End(NamedTuple):
    """End of a solver.

    Attributes:
        place: (p,) parameters
        cost: half of the sum of the squares
        jacobian: (k + q, q) slopes of the residuals by the q parameters that were free, and of what their bounds say
        at_limit: True if it stopped at its largest number of steps
    """

    place: Numbers
    cost: float
    jacobian: Numbers
    at_limit: bool

    @property
    def covariance(self) -> Numbers:
        """(q, q) covariance of the free parameters; where nothing is known, that of an even spread over the bounds."""
        return np.linalg.inv(self.jacobian.T @ self.jacobian)


class _Solver:
    """Weighted least squares of a law whose values are kept."""

    def __init__(self, recorded: Statistics, predict: Law, start: Numbers, bounds: Numbers, prior: Prior) -> None:
        self.recorded, self.predict, self.start, self.bounds, self.prior = recorded, predict, start, bounds, prior
        self.known: dict[tuple[float, ...], Numbers] = {}

    def law(self, place: Numbers) -> Numbers:
        row = tuple(place.tolist())
        if row not in self.known:
            self.known[row] = self.predict(place)
        return self.known[row]

    def residuals(self, place: Numbers, root: Numbers) -> Numbers:
        off = (self.law(place) - self.recorded.value) * root
        return np.append(off, (place - self.prior.value) / self.prior.sigma)

    def slopes(self, place: Numbers, root: Numbers, free: Numbers) -> Numbers:
        ways = np.where(place + SLOPE_STEP > self.bounds[1], -SLOPE_STEP, SLOPE_STEP)
        rises = [self.residuals(side, root) - self.residuals(place, root) for side in (place + np.diag(ways))[free]]
        return np.stack(rises, axis=1) / ways[free]

    def descend(self, place: Numbers, root: Numbers, free: Numbers) -> End:
        """Minimum next to a place, by the parameters of the mask."""
        from scipy.optimize import least_squares

        def put(some: Numbers) -> Numbers:
            moved = place.copy()
            moved[free] = some
            return moved

        def end_from(some: Numbers) -> End:
            end = least_squares(
                lambda of: self.residuals(put(of), root),
                some,
                lambda of: self.slopes(put(of), root, free),
                self.bounds[:, free],
                max_nfev=MOST_STEPS,
                **RULES,
            )
            # Else the likelihood of a light at which a number says nothing would have no end.
            even = np.diag(math.sqrt(12.0) / np.ptp(self.bounds[:, free], axis=0))
            return End(put(end.x), end.cost, np.vstack([end.jac, even]), end.status == 0)

        end = end_from(place[free])
        silent = np.sum(end.jacobian**2, axis=0) < LEAST_SLOPE
        if not silent.any() or np.allclose(end.place[free][silent], self.start[free][silent], atol=SLOPE_STEP):
            return end
        # Where nothing depends on a number any more, no slope leads back.
        again = end_from(np.where(silent, self.start[free], end.place[free]))
        return min(end, again, key=lambda each: each.cost)

    def scan(self, values: Numbers, along: int, ends: Sequence[End], root: Numbers) -> list[End]:
        """Ends by the other parameters at these values of one, each from the nearest end so far."""
        found = list(ends)
        for value in sorted(values.tolist(), key=lambda value: abs(value - ends[0].place[along])):
            place = min(found, key=lambda end: abs(end.place[along] - value)).place.copy()
            place[along] = value
            found.append(self.descend(place, root, np.arange(len(place)) != along))
        return found[len(ends) :]

    def minima(self, along: int, first: End, root: Numbers) -> list[End]:
        """Minima along one parameter, of those that are not far above the lowest."""
        low, high = self.bounds[:, along].tolist()
        ends = self.scan(np.linspace(low, high, SCANNED + 2), along, [first], root)
        ends.sort(key=lambda end: end.place[along])
        costs = np.array([math.inf, *(end.cost for end in ends), math.inf])
        chosen = (costs[1:-1] <= np.minimum(costs[:-2], costs[2:])) & (costs[1:-1] < costs.min() + FAR_COST)
        return list(itertools.compress(ends, chosen))


def solve(
    recorded: Statistics,
    predict: Law,
    start: Numbers,
    bounds: Numbers,
    prior: Prior | None = None,
    along: int | None = None,
) -> Solution:
    """Fit parameters to statistics by a smooth law; bins that no law meets count less (Huber's weight).

    What the law misses beyond the noise of the bins is a scatter of all of their kind. Along one parameter, the others
    may be solved for at each of its values. Then no minimum is missed, and means and covariances are those of the
    likelihood, which may go in steps: the law of total variance.

    Args:
        predict: (k,) statistics of (p,) parameters
        start: (p,) parameters
        bounds: (2, p) of the parameters
        prior: what is expected; None: nothing
        along: index of such a parameter; None: the minimum next to the start, and a likelihood like a normal one
    """
    solver = _Solver(recorded, predict, start, bounds, prior or Prior(start, np.full_like(start, np.inf)))
    every, minima = np.ones(len(start), bool), [End(start, 0.0, np.zeros((0, 0)), at_limit=False)]
    sigma, weight = recorded.spread(solver.law(start)), np.ones_like(recorded.value)
    misfit = np.full_like(recorded.value, solver.prior.misfit)
    for number in range(ROUNDS):  # misfit and weights follow from the residuals, which follow from the weights
        root = np.sqrt(weight) / np.hypot(sigma, misfit)
        if along is not None and number == 0:
            minima = solver.minima(along, minima[0], root)
        minima = sorted((solver.descend(end.place, root, every) for end in minima), key=lambda end: end.cost)
        best = minima[0]
        residual, sigma = recorded.value - solver.law(best.place), recorded.spread(solver.law(best.place))
        for kind in np.unique(recorded.kind):
            alike = recorded.kind == kind
            misfit[alike] = misfit_beyond(residual[alike], sigma[alike])
        weight = huber_weight(residual, np.hypot(sigma, misfit), CURVE_HUBER)
    root = np.sqrt(weight) / np.hypot(sigma, misfit)
    jacobian = solver.slopes(best.place, root, every)
    solution = Solution(
        value=best.place,
        slope=jacobian.T @ jacobian,
        scores=((recorded.parts + recorded.share * residual) * root) @ jacobian[: len(root)],
        evaluations=len(solver.known),
        at_limit=best.at_limit,
    )
    return solution if along is None else _over_likelihood(solver, solution, along, minima, root)


def _over_likelihood(solver: _Solver, solution: Solution, along: int, minima: Sequence[End], root: Numbers) -> Solution:
    """Mean and covariance over the likelihood of one parameter, from values about each minimum on."""
    from scipy.interpolate import PchipInterpolator, make_interp_spline

    ends, known = list(minima), np.zeros(0)
    low, high = solver.bounds[:, along]
    sigmas = [min(end.covariance[along, along] ** 0.5, (high - low) / SCANNED) for end in minima]
    about = [end.place[along] + sigma * np.array(ABOUT) for end, sigma in zip(minima, sigmas, strict=True)]
    values = np.concatenate([*about, [low, high]])
    while len(values):
        ends += solver.scan(np.setdiff1d(np.clip(np.round(values, 4), low, high), known), along, ends, root)
        scanned = sorted(ends[len(minima) :], key=lambda end: end.place[along])
        known = np.array([end.place[along] for end in scanned])
        logs = np.array([0.5 * np.linalg.slogdet(end.covariance)[1] - end.cost for end in scanned])
        likely = np.maximum(logs[1:], logs[:-1]) > logs.max() - LIKELY
        coarse = likely & (np.abs(np.diff(logs)) > SMOOTH) & (np.diff(known) > FINEST) & (len(known) < MOST_SCANNED)
        values = 0.5 * (known[1:] + known[:-1])[coarse]
    fine = np.interp(np.linspace(0.0, len(known) - 1.0, FINE * len(known)), np.arange(len(known)), known)
    chance = np.exp(PchipInterpolator(known, logs)(fine) - logs.max()) * np.gradient(fine)
    chance /= chance.sum()
    others = np.delete(np.arange(len(minima[0].place)), along)
    square = np.ix_(others, others)
    places, covariances = (
        make_interp_spline(known, np.stack(of_ends), k=1)(fine)
        for of_ends in ([end.place for end in scanned], [end.covariance for end in scanned])
    )
    mean = chance @ places
    covariance = (chance * (places - mean).T) @ (places - mean)
    covariance[square] += np.einsum("n,nij->ij", chance, covariances)
    # The blocks' scores are those at the best place, with the parameter held there.
    slope = solution.slope.copy()
    slope[along], slope[:, along], slope[along, along] = 0.0, 0.0, PINNED
    covariance[square] -= np.linalg.inv(slope[square] + 1e-9 * np.eye(len(others)))
    return replace(solution, value=mean, slope=slope, held_covariance=covariance, evaluations=len(solver.known))
