"""The parameters at which the likelihood of `known_scene` is highest, reflectivities profiled out.

Fisher's scoring: each step needs the slopes of what is expected of each pulse, exact by Dr.Jit, or by differences
without a back end. Reflectivities are solved along with the parameters and taken out of their matrix (Schur's
complement). What the recording cannot tell shows as a small eigenvalue: its direction is named, and one of its
parameters, the one that is best known from elsewhere, stays at the value that it had.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ....errors import BackendError
from ....maths.arrays import Lanes, Numbers
from ..estimates import MOST_EVALUATIONS, UNKNOWN, Estimate, Solution
from ..products import row_echelon
from .known_scene import LEAST_CHANCE, MOST_FIRED, PARAMETERS, STRONG, KnownScene, Observations, Prediction, predict

BLOCKS = 40
"""Of pulses in order, for the bootstrap."""

LONGEST_STEP = 0.5
"""Of a logarithm."""

FARTHEST = math.log(5.0)
"""A logarithm that runs off farther is not told, or stands for what is not modelled: it stays as it was. A scatter
that is that much smaller than it was stays there, as it is none."""

MAY_VANISH = ("scatter_floor", "histogram.threshold_spread")
"""Scatters that may be none at all."""

OUTLIER = 5.0
"""Sigmas from which on a range is that of something else: of chance returns one in 2 million is left out."""

FARTHEST_SQUARE = 9.0
"""Of a range's distance from the surface over its sigma, squared: what is farther counts no more, since surfaces are
not quite where they are believed to be. That costs a clean recording 1 % of sigma."""

_WITHIN = math.erf(math.sqrt(0.5 * FARTHEST_SQUARE))
_EDGE = math.sqrt(2.0 * FARTHEST_SQUARE / math.pi) * math.exp(-0.5 * FARTHEST_SQUARE)
_INSIDE = _WITHIN - _EDGE
MEAN_SQUARE = _INSIDE + FARTHEST_SQUARE * (1.0 - _WITHIN)
_SLOPE = 2.0 * _INSIDE / MEAN_SQUARE
_VARIANCE = (
    3.0 * _WITHIN - (3.0 + FARTHEST_SQUARE) * _EDGE + FARTHEST_SQUARE**2 * (1.0 - _WITHIN)
) / MEAN_SQUARE**2 - 1.0
"""Of the square of a normal number, at most `FARTHEST_SQUARE`, over its mean: minus its slope by ln sigma; variance.
Without a limit both are 2."""

HUBER = 4.0
"""Sigmas from which on a signal counts less: an edge, a surface that is not as it is believed to be."""

PRODUCT = 1e-6
"""Share of a parameter's information that no other has: below, it is but a factor of a product."""

DONE = 1e-2
"""A step of so many sigmas is the last."""

SETTLED = 7
"""Evaluations after which a fit may end: one more than settles which returns are strong."""

SLOW = 0.7
"""A step of Fisher's scoring is far shorter than the one before it; one longer than this share of it is halved."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterFit:
    """What was found.

    solved       logarithms of the parameters over those of the scene's sensor
    names        of the parameters that were found
    held         those that stay as they were
    null         a line for each direction that cannot be told
    values       of all of them, at the end
    reflectivity (groups,) logarithms over those traced with
    """

    solved: Solution
    names: tuple[str, ...]
    held: tuple[str, ...]
    null: tuple[str, ...]
    values: Mapping[str, float]
    reflectivity: Numbers

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Each parameter as a factor of the value that it had."""
        return tuple(
            self.solved.estimate(name, "times", lambda p, k=k: float(np.exp(p[k])))  # type: ignore[misc]
            for k, name in enumerate(self.names)
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Step:
    """Scores and matrix at some parameters: p parameters, g reflectivities, n pulses."""

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
    """Find the parameters of these names.

    reflectivity_sigma  how well the logarithms of the reflectivities are known beforehand; inf: not at all
    start               what was found before, with another texture; None: the scene's sensor
    most                evaluations of the likelihood
    """
    prior_weight = 0.0 if np.isinf(reflectivity_sigma) else reflectivity_sigma**-2
    active, values = list(names), dict.fromkeys(names, 0.0)
    surfaces = np.zeros(int(scene.group.max()) + 1) if start is None else start.reflectivity
    if start is not None:
        values |= start.values
    strong = _strong_mask(scene, reported, values, surfaces)
    step, evaluations = _step(scene, reported, values, surfaces, strong, prior_weight), 1
    held: list[str] = []
    null: list[str] = []
    active, held, null = _hold_undetermined(step, names, active, held, null)
    damping, last_size = 1.0, np.inf
    while evaluations < max_evaluations:
        rows = [list(names).index(name) for name in active]
        matrix = step.matrix[np.ix_(rows, rows)]
        move = np.linalg.solve(matrix, step.score[rows])
        size = float(np.sqrt(move @ matrix @ move))
        # The chance of a return has a kink where its neighbours begin to lack it (T98c), so a score may jump. At such a
        # maximum whole steps go to and fro for ever; halves of halves end at it.
        if evaluations > SETTLED and size > SLOW * last_size:
            damping *= 0.5
        last_size, size = size, damping * size
        # Each for itself: one that runs off must not hold up the others.
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
        runaway = [name for name in active if abs(values[name]) > FARTHEST]
        null += [f"{name}: alone, beyond a factor of {math.exp(FARTHEST):.0f}" for name in runaway]
        values |= {name: 0.0 for name in runaway if name not in MAY_VANISH}
        held += runaway
        active = [name for name in active if name not in runaway]
        if evaluations in (3, 6):  # which returns are strong is settled early, and then stays
            strong = _strong_mask(scene, reported, values, surfaces)
        step = _step(scene, reported, values, surfaces, strong, prior_weight)
        evaluations += 1
        if size < DONE and evaluations > SETTLED:
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
    """(p, p) covariance of the parameters of these rows that comes from those that are held.

    A held one may be off by as much as it is not known, a factor of e or what the recording says if that is better; the
    others then move along. Those that come in a product alone are held by agreement and add nothing.
    """
    free_matrix = matrix[np.ix_(rows, rows)]
    drag = np.linalg.solve(free_matrix, matrix[np.ix_(rows, held)])
    held_matrix = matrix[np.ix_(held, held)] - matrix[np.ix_(held, rows)] @ drag
    independent = np.diag(held_matrix) > PRODUCT * np.diag(matrix)[held]
    drag, held_matrix = drag[:, independent], held_matrix[np.ix_(independent, independent)]
    return np.asarray(drag @ np.linalg.solve(held_matrix + np.eye(len(held_matrix)) * UNKNOWN**-2, drag.T))


def _hold_undetermined(
    step: _Step, names: Sequence[str], active: list[str], held: list[str], null: list[str]
) -> tuple[list[str], list[str], list[str]]:
    """Those that can be told apart at this step, those that stay, and what is said of them."""
    while True:
        rows = [list(names).index(name) for name in active]
        eigenvalues, vectors = np.linalg.eigh(step.matrix[np.ix_(rows, rows)])
        undetermined = eigenvalues < UNKNOWN**-2
        if not undetermined.any():
            return active, held, null
        # The same space by directions that have one parameter each for their own, the last ones first.
        directions, pivots = row_echelon(vectors[:, undetermined].T[:, ::-1])
        directions, last_columns = directions[:, ::-1], [len(active) - 1 - pivot for pivot in pivots]
        null = null + [
            _direction_text(active, direction, pivot)
            for direction, pivot in zip(directions, last_columns, strict=False)
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
    """What is expected, and the slopes of signal, chance, near_ir and sigma_m by each parameter.

    exact  by Dr.Jit, where there is a back end; else by central differences
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
    prediction = predict(scene, values, surfaces[scene.group])
    finite = np.isfinite(reported.signal) & np.isfinite(reported.range_m)
    return np.asarray((prediction.signal > STRONG * prediction.level) & (prediction.fired < MOST_FIRED) & finite)


def _step(
    scene: KnownScene,
    reported: Observations,
    values: Mapping[str, float],
    surfaces: Numbers,
    strong: Numbers,
    prior_weight: float,
) -> _Step:
    """Scores and Fisher's matrix, reflectivities profiled out."""
    prediction, slopes = prediction_slopes(scene, values, surfaces)
    chance_mask = 1.0 - strong
    chance = np.clip(prediction.chance, LEAST_CHANCE, 1.0 - LEAST_CHANCE)
    signal = np.where(strong, np.nan_to_num(reported.signal) - prediction.signal, 0.0)
    huber_weight = np.minimum(1.0, HUBER * np.sqrt(prediction.variance) / np.maximum(np.abs(signal), 1e-12))
    near_ir_mask = np.isfinite(reported.near_ir)
    range_sigmas = np.where(strong, (np.nan_to_num(reported.range_m) - scene.range_m) / prediction.sigma_m, 0.0)
    near_mask = strong & (np.abs(range_sigmas) < OUTLIER)
    square_excess = np.where(
        near_mask, np.minimum(range_sigmas * range_sigmas, FARTHEST_SQUARE) / MEAN_SQUARE - 1.0, 0.0
    )
    # Residual and weight of signal, chance, background and scatter: the score of each is slope x residual x weight.
    residuals = (
        signal,
        reported.has_return - chance,
        np.where(near_ir_mask, reported.near_ir - prediction.near_ir, 0.0),
        square_excess * (_SLOPE / _VARIANCE) * prediction.sigma_m,
    )
    weights = (
        strong * huber_weight / prediction.variance,
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
        surface = power[kind] + (0.0 if sun is None else sun[kind])
        pulse_scores += slope * (residual * kind_weight)[:, None]
        pulse_surface_scores += surface * residual * kind_weight
        weighted = slope * (factor * kind_weight)[:, None]
        matrix += weighted.T @ slope
        for row in range(len(values)):
            cross[row] += np.bincount(scene.group, weighted[:, row] * surface, minlength=groups)
        surface_curvature += np.bincount(scene.group, factor * kind_weight * surface**2, minlength=groups)
    surface_curvature = surface_curvature + prior_weight + 1e-9
    surface_score = np.bincount(scene.group, pulse_surface_scores, minlength=groups) - prior_weight * surfaces
    profiled = cross / surface_curvature
    return _Step(
        score=pulse_scores.sum(axis=0) - profiled @ surface_score,
        matrix=matrix - profiled @ cross.T,
        pulse_scores=pulse_scores - pulse_surface_scores[:, None] * profiled.T[scene.group],
        surface_score=surface_score,
        cross=cross,
        surface_curvature=surface_curvature,
    )
