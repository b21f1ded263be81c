"""Maximum likelihood of the parameters of `known_scene`, with the reflectivities profiled out.

Fisher scoring: each step needs the slopes of the prediction for each pulse, exact by Dr.Jit, or by central differences
without a back end. The reflectivities are solved along with the parameters and eliminated from their matrix (Schur
complement). A small eigenvalue is a direction that the recording does not determine: it is reported, and one of its
parameters, the one best known from elsewhere, keeps its value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ....errors import BackendError
from ....maths.arrays import Lanes, Numbers
from ..estimates import MOST_EVALUATIONS, Estimate, Solution, huber_weight
from ..products import row_echelon
from ..tuning import (
    LARGEST_LOGARITHM,
    LAST_STEP,
    LEAST_CHANCE,
    LEAST_INFORMATION,
    LONGEST_STEP,
    OUTLIER_SIGMAS,
    SIGNAL_HUBER,
    SLOW_RATIO,
    SQUARE_CAP,
    UNKNOWN_SIGMA,
)
from .known_scene import PARAMETERS, KnownScene, Observations, Prediction, predict

BLOCKS = 40
"""Blocks of consecutive pulses for the bootstrap."""

MAY_VANISH = ("scatter_floor", "histogram.threshold_spread")
"""Scatters that may be zero."""

_WITHIN = math.erf(math.sqrt(0.5 * SQUARE_CAP))
_EDGE = math.sqrt(2.0 * SQUARE_CAP / math.pi) * math.exp(-0.5 * SQUARE_CAP)
_INSIDE = _WITHIN - _EDGE
MEAN_SQUARE = _INSIDE + SQUARE_CAP * (1.0 - _WITHIN)
_SLOPE = 2.0 * _INSIDE / MEAN_SQUARE
_VARIANCE = (3.0 * _WITHIN - (3.0 + SQUARE_CAP) * _EDGE + SQUARE_CAP**2 * (1.0 - _WITHIN)) / MEAN_SQUARE**2 - 1.0
"""Moments of min(x^2, `SQUARE_CAP`) over its mean, x standard normal: minus the slope by ln sigma, and variance.
Both are 2 without the cap."""

LEAST_EVALUATIONS = 7
"""Evaluations after which a fit may end: one more than fix which returns are strong."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterFit:
    """Fitted parameters.

    Attributes:
        solved: solution: logarithms of the fitted parameters over those of the scene's sensor
        names: names of the fitted parameters
        held: names of the parameters held at their values
        null: a line for each direction that the recording does not determine
        values: logarithms of all parameters, fitted and held
        reflectivity: (groups,) logarithms of the reflectivities over those traced
    """

    solved: Solution
    names: tuple[str, ...]
    held: tuple[str, ...]
    null: tuple[str, ...]
    values: Mapping[str, float]
    reflectivity: Numbers

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Each fitted parameter as a factor of its former value."""
        return tuple(
            self.solved.estimate(name, "times", lambda p, k=k: float(np.exp(p[k])))  # type: ignore[misc]
            for k, name in enumerate(self.names)
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Step:
    """Scores and Fisher matrix at one point: p parameters, g reflectivities, n pulses.

    Attributes:
        score: (p,) profiled score
        matrix: (p, p) profiled Fisher matrix
        pulse_scores: (n, p) share of each pulse in the score
        surface_score: (g,) score of the reflectivities
        cross: (p, g) Fisher matrix between parameters and reflectivities
        surface_curvature: (g,) diagonal Fisher matrix of the reflectivities
    """

    score: Numbers
    matrix: Numbers
    pulse_scores: Numbers
    surface_score: Numbers
    cross: Numbers
    surface_curvature: Numbers


def fit_parameters(
    scene: KnownScene,
    reported: Observations,
    names: Sequence[str] = PARAMETERS,
    *,
    reflectivity_sigma: float = np.inf,
    start: ParameterFit | None = None,
    max_evaluations: int = MOST_EVALUATIONS,
) -> ParameterFit:
    """Maximise the likelihood over the named parameters.

    Args:
        reflectivity_sigma: prior sigma of the logarithms of the reflectivities; inf: no prior
        start: earlier fit, with another texture, to start from; None: the scene's sensor
        max_evaluations: largest number of evaluations of the likelihood
    """
    prior_weight = 0.0 if np.isinf(reflectivity_sigma) else reflectivity_sigma**-2
    active, values = list(names), dict.fromkeys(names, 0.0)
    surfaces = np.zeros(int(scene.group.max()) + 1) if start is None else start.reflectivity
    if start is not None:
        values |= start.values
    strong_mask = _strong_mask(scene, reported, values, surfaces)
    step, evaluations = _step(scene, reported, values, surfaces, strong_mask, prior_weight), 1
    held: list[str] = []
    null: list[str] = []
    active, held, null = _hold_undetermined(step, names, active, held, null)
    damping, last_size = 1.0, np.inf
    while evaluations < max_evaluations:
        rows = [list(names).index(name) for name in active]
        matrix = step.matrix[np.ix_(rows, rows)]
        move = np.linalg.solve(matrix, step.score[rows])
        size = float(np.sqrt(move @ matrix @ move))
        # The chance of a return has a kink where its neighbours begin to lack it (T113), so a score may jump. At such a
        # maximum whole steps go to and fro for ever; halves of halves end at it.
        if evaluations > LEAST_EVALUATIONS and size > SLOW_RATIO * last_size:
            damping *= 0.5
        last_size, size = size, damping * size
        # Clip each component alone: a runaway parameter must not shorten the steps of the others.
        move = np.clip(damping * move, -LONGEST_STEP, LONGEST_STEP)
        all_moves = np.zeros(len(names))
        all_moves[rows] = move
        surfaces = surfaces + np.clip(
            (damping * step.surface_score - step.cross.T @ all_moves) / step.surface_curvature,
            -LONGEST_STEP,
            LONGEST_STEP,
        )
        for name, change in zip(active, move, strict=True):
            values[name] += float(change)
        runaway = [name for name in active if abs(values[name]) > LARGEST_LOGARITHM]
        null += [f"{name}: alone, beyond a factor of {math.exp(LARGEST_LOGARITHM):.0f}" for name in runaway]
        values |= {name: 0.0 for name in runaway if name not in MAY_VANISH}
        held += runaway
        active = [name for name in active if name not in runaway]
        if evaluations in (3, 6):  # fix early which returns are strong, else the steps go to and fro
            strong_mask = _strong_mask(scene, reported, values, surfaces)
        step = _step(scene, reported, values, surfaces, strong_mask, prior_weight)
        evaluations += 1
        if size < LAST_STEP and evaluations > LEAST_EVALUATIONS:
            determined, held, null = _hold_undetermined(step, names, active, held, null)
            if determined == active:
                break
            values |= {name: 0.0 for name in active if name not in determined}
            active = determined
    rows = [list(names).index(name) for name in active]
    block = np.arange(len(scene.range_m)) * BLOCKS // len(scene.range_m)
    scores = np.array([np.bincount(block, step.pulse_scores[:, row]) for row in rows]).reshape(len(rows), -1).T
    solved = Solution(
        value=np.array([values[name] for name in active]),
        slope=step.matrix[np.ix_(rows, rows)],
        scores=scores,
        evaluations=evaluations,
        held_covariance=_held_covariance(step.matrix, rows, [list(names).index(name) for name in held]),
    )
    return ParameterFit(
        solved=solved, names=tuple(active), held=tuple(held), null=tuple(null), values=values, reflectivity=surfaces
    )


def _held_covariance(matrix: Numbers, rows: Sequence[int], held: Sequence[int]) -> Numbers:
    """(p, p) covariance of the fitted parameters ``rows`` that comes from the held ones.

    A held parameter may be off by its own uncertainty, a factor of e or what the recording says if that is better; the
    fitted ones then move along. A parameter that occurs only as a factor of a product is held by convention and adds
    nothing.
    """
    free_matrix = matrix[np.ix_(rows, rows)]
    drag = np.linalg.solve(free_matrix, matrix[np.ix_(rows, held)])
    held_matrix = matrix[np.ix_(held, held)] - matrix[np.ix_(held, rows)] @ drag
    independent = np.diag(held_matrix) > LEAST_INFORMATION * np.diag(matrix)[held]
    drag, held_matrix = drag[:, independent], held_matrix[np.ix_(independent, independent)]
    return np.asarray(drag @ np.linalg.solve(held_matrix + np.eye(len(held_matrix)) * UNKNOWN_SIGMA**-2, drag.T))


def _hold_undetermined(
    step: _Step, names: Sequence[str], active: list[str], held: list[str], null: list[str]
) -> tuple[list[str], list[str], list[str]]:
    """Hold parameters until the matrix is regular; returns fitted names, held names and the lines of `null`."""
    while True:
        rows = [list(names).index(name) for name in active]
        eigenvalues, vectors = np.linalg.eigh(step.matrix[np.ix_(rows, rows)])
        undetermined = eigenvalues < UNKNOWN_SIGMA**-2
        if not undetermined.any():
            return active, held, null
        # Echelon form of the null space: each direction then has one parameter that no other has, the last ones first.
        directions, pivots = row_echelon(vectors[:, undetermined].T[:, ::-1])
        directions, last_columns = directions[:, ::-1], [len(active) - 1 - pivot for pivot in pivots]
        null = null + [
            _direction_text(active, direction, pivot) for direction, pivot in zip(directions, last_columns, strict=True)
        ]
        held = held + [active[pivot] for pivot in last_columns]
        active = [name for name in active if name not in held]


def _direction_text(active: Sequence[str], direction: Numbers, last: int) -> str:
    moves = [
        f"{name} {power:+.2g} %"
        for name, power in zip(active, direction, strict=True)
        if abs(power) > 0.05 and name != active[last]
    ]
    return f"{active[last]} +1 %: " + (", ".join(moves) or "alone")


def prediction_slopes(
    scene: KnownScene, values: Mapping[str, float], surfaces: Numbers, *, exact: bool = True
) -> tuple[Prediction, dict[str, list[Numbers]]]:
    """Prediction, and by parameter the slopes of signal, chance, near_ir and sigma_m, (n,) each.

    Args:
        exact: True: slopes by Dr.Jit where there is a back end; else by central differences
    """
    reflectivity = surfaces[scene.group]

    def formula(parameters: Mapping[str, Lanes]) -> list[Lanes]:
        prediction = predict(scene, parameters, reflectivity)
        return [prediction.signal, prediction.chance, prediction.near_ir, prediction.sigma_m]

    prediction = predict(scene, values, reflectivity)
    if exact:
        from ....kernel.device import gradients

        try:
            return prediction, gradients.jacobian(formula, values)[1]
        except BackendError:
            pass
    step = 1e-4
    slopes = {}
    for name, value in values.items():
        above, below = (formula({**values, name: value + sign * step}) for sign in (1.0, -1.0))
        slopes[name] = [np.asarray((a - b) / (2.0 * step)) for a, b in zip(above, below, strict=True)]
    return prediction, slopes


def _strong_mask(scene: KnownScene, reported: Observations, values: Mapping[str, float], surfaces: Numbers) -> Numbers:
    return np.asarray(predict(scene, values, surfaces[scene.group]).is_strong & reported.has_values)


def _step(
    scene: KnownScene,
    reported: Observations,
    values: Mapping[str, float],
    surfaces: Numbers,
    strong_mask: Numbers,
    prior_weight: float,
) -> _Step:
    """Compute scores and Fisher matrix at ``values``, with the reflectivities profiled out."""
    prediction, slopes = prediction_slopes(scene, values, surfaces)
    chance_mask = 1.0 - strong_mask
    chance = np.clip(prediction.chance, LEAST_CHANCE, 1.0 - LEAST_CHANCE)
    signal = np.where(strong_mask, np.nan_to_num(reported.signal) - prediction.signal, 0.0)
    signal_weight = huber_weight(signal, np.sqrt(prediction.variance), SIGNAL_HUBER)
    near_ir_mask = np.isfinite(reported.near_ir)
    range_sigmas = np.where(strong_mask, (np.nan_to_num(reported.range_m) - scene.range_m) / prediction.sigma_m, 0.0)
    near_mask = strong_mask & (np.abs(range_sigmas) < OUTLIER_SIGMAS)
    square_excess = np.where(near_mask, np.minimum(range_sigmas * range_sigmas, SQUARE_CAP) / MEAN_SQUARE - 1.0, 0.0)
    # Residual and weight of signal, chance, background and scatter: the score of each is slope x residual x weight.
    residuals = (
        signal,
        reported.has_return - chance,
        np.where(near_ir_mask, reported.near_ir - prediction.near_ir, 0.0),
        square_excess * (_SLOPE / _VARIANCE) * prediction.sigma_m,
    )
    weights = (
        strong_mask * signal_weight / prediction.variance,
        chance_mask / (chance * (1.0 - chance)),
        near_ir_mask / np.maximum(prediction.near_ir, 1.0),
        near_mask / prediction.sigma_m**2,
    )
    information = (1.0, 1.0, 1.0, _SLOPE**2 / _VARIANCE)
    n, groups = len(scene.range_m), len(surfaces)
    pulse_scores, pulse_surface_scores = np.zeros((n, len(values))), np.zeros(n)
    matrix, cross, surface_curvature = np.zeros((len(values),) * 2), np.zeros((len(values), groups)), np.zeros(groups)
    power, sun = slopes["laser.peak_power_w"], slopes.get("optics.sun_irradiance_w_m2")
    for kind, (residual, kind_weight, factor) in enumerate(zip(residuals, weights, information, strict=True)):
        slope = np.column_stack([slopes[name][kind] for name in values])
        # A brighter surface acts as more power and more sunlight at once.
        surface = power[kind] + (0.0 if sun is None else sun[kind])
        pulse_scores += slope * (residual * kind_weight)[:, None]
        pulse_surface_scores += surface * residual * kind_weight
        weighted = slope * (factor * kind_weight)[:, None]
        matrix += weighted.T @ slope
        for row in range(len(values)):
            cross[row] += np.bincount(scene.group, weighted[:, row] * surface, minlength=groups)
        surface_curvature += np.bincount(scene.group, factor * kind_weight * surface**2, minlength=groups)
    # 1e-9: a group that no pulse informs about must not divide by 0.
    surface_curvature = surface_curvature + prior_weight + 1e-9
    surface_score = np.bincount(scene.group, pulse_surface_scores, minlength=groups) - prior_weight * surfaces
    # Schur complement: eliminate the reflectivities, whose own block is diagonal, since a pulse has one group.
    profiled = cross / surface_curvature
    return _Step(
        score=pulse_scores.sum(axis=0) - profiled @ surface_score,
        matrix=matrix - profiled @ cross.T,
        pulse_scores=pulse_scores - pulse_surface_scores[:, None] * profiled.T[scene.group],
        surface_score=surface_score,
        cross=cross,
        surface_curvature=surface_curvature,
    )
