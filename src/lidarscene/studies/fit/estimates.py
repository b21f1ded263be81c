"""Estimates with their uncertainties.

Every fit here solves sum_b s_b(theta) = 0, with one score s_b for each block of columns. Two uncertainties follow from
the scores and from H, the slope of their sum: Fisher's, which is that of the likelihood if blocks are independent and
the law is right, and that of a block bootstrap, which asks neither. In the bootstrap each draw makes one Newton step
from the solution, theta + H^-1 sum_b (w_b - 1) s_b with w_b how often block b was drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...maths.arrays import Numbers
from .tuning import DOUBTFUL_RATIO, UNKNOWN_SIGMA

DRAWS = 400
"""Draws of the bootstrap: a sigma from n draws scatters by 1 / sqrt(2 n), here 3.5 %."""

MOST_EVALUATIONS = 50
"""Largest number of evaluations of a likelihood by its solver."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """One number with its uncertainty.

    Attributes:
        key: name in the report
        unit: "" for a pure number
        fisher: sigma from the Fisher matrix
        bootstrap: sigma from the block bootstrap
        misfit: factor on both, of a law that does not hold (`misfit_factor`)
    """

    key: str
    value: float
    unit: str
    fisher: float
    bootstrap: float
    misfit: float = 1.0

    def __str__(self) -> str:
        """Value, sigma and unit."""
        return f"{self.value:.4g} +/- {self.sigma:.2g} {self.unit}".rstrip()

    @property
    def sigma(self) -> float:
        """Standard deviation, `scatter` times the misfit of the law."""
        return self.misfit * self.scatter

    @property
    def scatter(self) -> float:
        """Standard deviation of repeated fits: Fisher's, unless the bootstrap shows that blocks are not independent.

        The larger of the two would be too wide by some 5 %, since the bootstrap's own sigma scatters.
        """
        return self.bootstrap if self.bootstrap > DOUBTFUL_RATIO * self.fisher else self.fisher

    @property
    def is_known(self) -> bool:
        """True if sigma is below the value itself. A single block has no bootstrap, so nothing is known from it."""
        if not np.isfinite(self.bootstrap):
            return False
        return bool(np.isfinite(self.sigma) and self.sigma < UNKNOWN_SIGMA * abs(self.value))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """Solution of a fit with p parameters and b blocks of columns.

    Attributes:
        value: (p,) parameters
        slope: (p, p) H, the negative slope of the sum of the scores; the Fisher matrix of a likelihood
        scores: (b, p) score of each block at the solution
        meat: (p, p) variance of the sum of the scores if the law is right; None: H
        evaluations: number of evaluations of the law
        held_covariance: (p, p) covariance added to that of the data: by parameters held fixed, by what all data have in
            common, and by solutions as good; None: none
        misfit: factor on the uncertainties (`misfit_factor`)
        at_limit: True if the solver stopped at its largest number of steps
    """

    value: Numbers
    slope: Numbers
    scores: Numbers
    meat: Numbers | None = None
    evaluations: int = 0
    held_covariance: Numbers | None = None
    misfit: float = 1.0
    at_limit: bool = False

    def wider(self, covariance: Numbers) -> Solution:
        """Add (p, p) covariance that no block has."""
        held = covariance if self.held_covariance is None else self.held_covariance + covariance
        return replace(self, held_covariance=held)

    @property
    def covariance(self) -> Numbers:
        """(p, p) covariance H^-1 meat H^-T, Fisher's for a likelihood; infinite where H has no inverse."""
        inverse = _inverse(self.slope)
        covariance = inverse if self.meat is None else inverse @ self.meat @ inverse.T
        return np.asarray(covariance if self.held_covariance is None else covariance + self.held_covariance)

    def resampled(self, seed: int = 0) -> Numbers:
        """Solutions of resampled blocks, (DRAWS, p): one Newton step each, theta + H^-1 sum_b (w_b - 1) s_b."""
        return np.asarray(
            self.value + (drawn_counts(len(self.scores), seed) - 1.0) @ self.scores @ _inverse(self.slope).T
        )

    @property
    def bootstrap(self) -> Numbers:
        """(p, p) covariance of the resampled solutions, times b / (b - 1): resampling b blocks scatters too little."""
        blocks = len(self.scores)
        if blocks < 2 or not np.isfinite(_inverse(self.slope)).all():
            return np.full_like(self.slope, np.inf)
        covariance = np.atleast_2d(np.cov(self.resampled(), rowvar=False)) * (blocks / (blocks - 1.0))
        return np.asarray(covariance if self.held_covariance is None else covariance + self.held_covariance)

    def estimate(self, key: str, unit: str, formula: Callable[[Numbers], float]) -> Estimate:
        """Estimate a function of the parameters; its sigma follows from central differences of the formula."""
        centre = float(formula(self.value))
        steps = 1e-5 * np.maximum(np.abs(self.value), 1e-3)
        slopes = np.array(
            [
                (formula(self.value + move) - formula(self.value - move)) / (2.0 * step)
                for move, step in zip(np.diag(steps), steps, strict=True)
            ]
        )
        with np.errstate(invalid="ignore"):
            variances = [slopes @ covariance @ slopes for covariance in (self.covariance, self.bootstrap)]
        fisher, bootstrap = (
            float(np.sqrt(max(variance, 0.0))) if np.isfinite(variance) else np.inf for variance in variances
        )
        return Estimate(key=key, value=centre, unit=unit, fisher=fisher, bootstrap=bootstrap, misfit=self.misfit)

    @property
    def correlation(self) -> Numbers:
        """(p, p) correlation of the parameters, from `covariance`."""
        covariance = self.covariance
        sigma = np.sqrt(np.diag(covariance))
        return np.asarray(covariance / np.outer(sigma, sigma))


def exponential(index: int) -> Callable[[Numbers], float]:
    """Formula of a number whose logarithm is a parameter."""
    return lambda logs: math.exp(logs[index])


def drawn_counts(blocks: int, seed: int = 0) -> Numbers:
    """(DRAWS, blocks) how often each block is in a draw of as many of them."""
    return np.random.default_rng(seed).multinomial(blocks, np.full(blocks, 1.0 / blocks), size=DRAWS)


def block_sums(scores: Numbers, block: Numbers) -> Numbers:
    """(b, p) sums over the blocks of (n, p) scores."""
    return np.column_stack([np.bincount(block, column) for column in scores.T])


def huber_weight(residual: Numbers, sigma: Numbers, sigmas: float) -> Numbers:
    """Weight of each residual: 1, beyond so many sigmas it falls so that each counts as one there does (Huber's)."""
    return np.asarray(np.minimum(1.0, sigmas * sigma / np.maximum(np.abs(residual), 1e-12)))


def misfit_factor(deviations: Numbers, parameters: int) -> float:
    """Root of the reduced chi-square of a law, at least 1: the factor by which its uncertainties are too small.

    It is the scale factor S of the Particle Data Group (Review of Particle Physics, introduction, 5.2.2).

    Args:
        deviations: (n,) differences of bins from the law, in sigmas of their own
        parameters: number of fitted parameters
    """
    freedom = len(deviations) - parameters
    return max(1.0, float(np.sqrt(np.sum(deviations**2) / freedom))) if freedom > 0 else 1.0


def _inverse(matrix: Numbers) -> Numbers:
    try:
        return np.asarray(np.linalg.inv(matrix))
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.inf)
