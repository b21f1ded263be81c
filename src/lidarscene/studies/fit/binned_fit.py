"""Fits of laws to numbers of bins: weighted least squares, robust and from several starts, with its intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ...maths.arrays import Numbers, map_arrays
from ...maths.special import SIGMA_PER_MAD
from .estimates import Solution, huber_weight
from .tuning import (
    CURVE_HUBER,
    FAR_SQUARE,
    FOLLOWED,
    INTERVALS,
    LEAST_LIKELY,
    MOST_STEPS,
    ROUNDS,
    SAME_MINIMUM,
    STEP_RATIO,
    UNKNOWN_SIGMA,
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


def solve(
    recorded: Statistics,
    predict: Callable[[Numbers], Numbers],
    start: Numbers,
    bounds: Numbers,
    *,
    step: float,
    prior: Prior | None = None,
    error: Callable[[Numbers], Numbers | float] = lambda _: 0.0,
) -> Solution:
    """Fit parameters to statistics; bins that no law meets count less (Huber's weight).

    What the law misses beyond the noise of the bins is a scatter of all of their kind. Other minima widen the intervals
    by the squares of their distances, each by its share of the likelihood: the law of total variance.

    Args:
        predict: (m, k) statistics of (m, p) parameters
        start: (p,) parameters, or (s, p) of several starts. From the end of the first one go the others' ways from it;
            where these lead to places not far off the recording, other ends are sought
        bounds: (2, p) of the parameters
        step: of the first central differences that are the slopes; later ones reach along the main axes of the interval
            to its end, since over short ways the noise of a simulated law counts as information. They are taken at the
            nearest node of a lattice of such steps, so that places near each other share their statistics. Beside a
            step of the law, where a fit may end, those of the interval are to that side on which it changes less
        prior: what is expected; None: nothing
        error: (k,) standard deviation of what is predicted at (p,) parameters
    """
    from scipy.optimize import least_squares

    places = np.atleast_2d(start)
    expected, width, first_misfit = prior or Prior(places[0], np.full_like(places[0], np.inf))
    known: dict[tuple[float, ...], Numbers] = {}

    def laws(asked: Numbers) -> Numbers:
        rows = [tuple(row) for row in asked.tolist()]
        new = list(dict.fromkeys(row for row in rows if row not in known))
        if new:
            known.update(zip(new, predict(np.array(new)), strict=True))
        return np.array([known[row] for row in rows])

    def spread(place: Numbers) -> Numbers:
        return np.hypot(recorded.spread(laws(place[None])[0]), error(place))

    def residuals(place: Numbers, root: Numbers) -> Numbers:
        return np.append((laws(place[None])[0] - recorded.value) * root, (place - expected) / width)

    def jacobian_of(ways: Numbers, rises: Numbers, root: Numbers) -> Numbers:
        return np.vstack([np.linalg.lstsq(ways, rises, rcond=None)[0].T * root[:, None], np.diag(1.0 / width)])

    def slopes(place: Numbers, root: Numbers) -> Numbers:
        node = np.clip(step * np.rint(place / step), *bounds)
        above, below = np.clip(node + moves, *bounds), np.clip(node - moves, *bounds)
        return jacobian_of(above - below, np.subtract(*np.split(laws(np.vstack([above, below])), 2)), root)

    def least_slopes(place: Numbers, root: Numbers) -> tuple[Numbers, bool]:
        """Slopes to that side along each way on which the law changes less, and whether one is by far the less."""
        ends = np.clip(place + np.stack([moves, -moves]), *bounds)
        ways, rises = ends - place, np.stack([laws(side) for side in ends]) - laws(place[None])
        with np.errstate(invalid="ignore"):  # a side that a bound cuts off
            steepness = np.linalg.norm(rises * root, axis=2) / np.linalg.norm(ways, axis=2)
        chosen = np.nanargmin(steepness, axis=0), np.arange(len(moves))
        is_step = np.any(np.nanmax(steepness, axis=0) > STEP_RATIO * np.nanmin(steepness, axis=0))
        return jacobian_of(ways[chosen], rises[chosen], root), bool(is_step)

    rules: dict[str, Any] = {"x_scale": "jac", "max_nfev": MOST_STEPS, "xtol": 1e-5, "ftol": 1e-4}
    moves, sigma, weight = step * np.eye(len(expected)), spread(places[0]), np.ones_like(recorded.value)
    misfit = np.full_like(recorded.value, first_misfit)
    for number in range(ROUNDS):  # misfit and weights follow from the residuals, which follow from the weights
        root = np.sqrt(weight) / np.hypot(sigma, misfit)
        ends = [least_squares(residuals, places[0], slopes, bounds, args=(root,), **rules)]
        if number == 0:
            others = np.clip(ends[0].x + places[1:] - places[0], *bounds)
            off = np.array([np.sum(residuals(other, root) ** 2) for other in others])
            near = np.flatnonzero(off < 2.0 * ends[0].cost + FAR_SQUARE * len(root))
            places = np.vstack([places[:1], others[near[np.argsort(off[near])[:FOLLOWED]]]])
        ends += [least_squares(residuals, place, slopes, bounds, args=(root,), **rules) for place in places[1:]]
        best = int(np.argmin([end.cost for end in ends]))
        found = ends[best]
        residual, sigma = recorded.value - laws(found.x[None])[0], spread(found.x)
        for kind in np.unique(recorded.kind):
            alike = recorded.kind == kind
            misfit[alike] = misfit_beyond(residual[alike], sigma[alike])
        weight = huber_weight(residual, np.hypot(sigma, misfit), CURVE_HUBER)
        root = np.sqrt(weight) / np.hypot(sigma, misfit)
        jacobian = slopes(found.x, root)
        covariance = _covariance(jacobian)
        widths, moves = np.sqrt(np.diag(covariance)), _axes(covariance, step)
        squares = [float(np.sum(residuals(end.x, root) ** 2)) for end in ends]
        places, chances = found.x[None], np.exp([0.5 * (min(squares) - squares[best])])
        for end, square in zip(ends, squares, strict=True):
            chance, is_new = math.exp(0.5 * (min(squares) - square)), np.abs(places - end.x) > SAME_MINIMUM * widths
            if chance > LEAST_LIKELY and np.any(is_new, axis=1).all():
                places, chances = np.vstack([places, end.x]), np.append(chances, chance)
    moves = step * np.eye(len(expected))
    for number in range(INTERVALS):
        to_less, is_step = least_slopes(found.x, root)
        if number == 0 and not is_step:
            break
        moves = _axes(_covariance(to_less), step)
    else:  # the interval of the larger volume: the ways to one side may have been short
        jacobian = max(jacobian, to_less, key=lambda each: float(np.linalg.slogdet(_covariance(each))[1]))
    scores = ((recorded.parts + recorded.share * residual) * root) @ jacobian[: len(root)]
    return Solution(
        value=found.x,
        slope=jacobian.T @ jacobian,
        scores=scores,
        evaluations=len(known),
        held_covariance=(chances / chances.sum() * (places - found.x).T) @ (places - found.x),
        at_limit=found.status == 0,
    )


def _axes(covariance: Numbers, least: float) -> Numbers:
    """(p, p) main axes of an interval, as long as its standard deviations, from ``least`` to `UNKNOWN_SIGMA`."""
    squares, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.clip(np.sqrt(squares), least, UNKNOWN_SIGMA)).T


def _covariance(jacobian: Numbers) -> Numbers:
    """Inverse of the information of a Jacobian; large where there is none."""
    return np.linalg.inv(jacobian.T @ jacobian + 1e-9 * np.eye(jacobian.shape[1]))
