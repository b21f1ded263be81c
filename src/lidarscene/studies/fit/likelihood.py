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

from ...errors import BackendError
from ...maths.arrays import Lanes, Numbers
from .estimates import MOST_EVALUATIONS, UNKNOWN, Estimate, Solved
from .known_scene import LEAST_CHANCE, MOST_FIRED, PARAMETERS, STRONG, Expected, Reported, Scene, expected
from .products import reduced

BLOCKS = 40
"""Of pulses in order, for the bootstrap."""

LONGEST_STEP = 0.5
"""Of a logarithm."""

FARTHEST = 3.0
"""A logarithm that runs off farther, a factor of 20, leads to nothing that the recording tells: it is held there."""

OUTLIER = 5.0
"""Sigmas from which on a range is that of something else: of chance returns one in 2 million is left out."""

HUBER = 4.0
"""Sigmas from which on a signal counts less: an edge, a surface that is not as it is believed to be."""

DONE = 1e-3
"""A step of so many sigmas is the last."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownFit:
    """What was found.

    solved       logarithms of the parameters over those of the scene's sensor
    names        of the parameters that were found
    held         those that stay as they were
    null         a line for each direction that cannot be told
    reflectivity (groups,) logarithms over those traced with
    """

    solved: Solved
    names: tuple[str, ...]
    held: tuple[str, ...]
    null: tuple[str, ...]
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
    each: Numbers
    of_groups: Numbers
    cross: Numbers
    own: Numbers


def fit_known(
    scene: Scene, reported: Reported, names: Sequence[str] = PARAMETERS, *, reflectivity_sigma: float = np.inf
) -> KnownFit:
    """Find the parameters of these names.

    reflectivity_sigma  how well the logarithms of the reflectivities are known beforehand; inf: not at all
    """
    weight = 0.0 if np.isinf(reflectivity_sigma) else reflectivity_sigma**-2
    active, values = list(names), dict.fromkeys(names, 0.0)
    surfaces = np.zeros(int(scene.group.max()) + 1)
    strong = _strong(scene, reported, values, surfaces)
    step, evaluations = _step(scene, reported, values, surfaces, strong, weight), 1
    held: list[str] = []
    null: list[str] = []
    while True:
        rows = [list(names).index(name) for name in active]
        matrix = step.matrix[np.ix_(rows, rows)]
        eigenvalues, vectors = np.linalg.eigh(matrix)
        lost = eigenvalues < UNKNOWN**-2
        if not lost.any():
            break
        # The same space by directions that have one parameter each for their own, the last ones first.
        directions, pivots = reduced(vectors[:, lost].T[:, ::-1])
        directions, own = directions[:, ::-1], [len(active) - 1 - pivot for pivot in pivots]
        null += [_told(active, direction, pivot) for direction, pivot in zip(directions, own, strict=False)]
        held += [active[pivot] for pivot in own]
        active = [name for name in active if name not in held]
    while evaluations < MOST_EVALUATIONS - 1:
        rows = [list(names).index(name) for name in active]
        matrix = step.matrix[np.ix_(rows, rows)]
        move = np.linalg.solve(matrix, step.score[rows])
        size = float(np.sqrt(move @ matrix @ move))
        # Each for itself: one that runs off must not hold up the others.
        move = np.clip(move, -LONGEST_STEP, LONGEST_STEP)
        whole = np.zeros(len(names))
        whole[rows] = move
        surfaces = surfaces + np.clip(
            (step.of_groups - step.cross.T @ whole) / step.own, -LONGEST_STEP, LONGEST_STEP
        )
        for name, one in zip(active, move, strict=True):
            values[name] += float(one)
        gone = [name for name in active if abs(values[name]) > FARTHEST]
        null += [f"{name}: alone, beyond a factor of {math.exp(FARTHEST):.0f}" for name in gone]
        held += gone
        active = [name for name in active if name not in gone]
        if evaluations in (3, 6):  # which returns are strong is settled early, and then stays
            strong = _strong(scene, reported, values, surfaces)
        step = _step(scene, reported, values, surfaces, strong, weight)
        evaluations += 1
        if size < DONE and evaluations > 7:
            break
    rows = [list(names).index(name) for name in active]
    block = np.arange(len(scene.range_m)) * BLOCKS // len(scene.range_m)
    scores = np.column_stack([np.bincount(block, step.each[:, row]) for row in rows])
    solved = Solved(
        value=np.array([values[name] for name in active]), slope=step.matrix[np.ix_(rows, rows)], scores=scores,
        evaluations=evaluations,
    )  # fmt: skip
    return KnownFit(
        solved=solved, names=tuple(active), held=tuple(held), null=tuple(null), reflectivity=surfaces
    )


def _told(active: Sequence[str], direction: Numbers, last: int) -> str:
    moves = [
        f"{name} {power:+.2g} %"
        for name, power in zip(active, direction, strict=True)
        if abs(power) > 0.05 and name != active[last]
    ]
    return f"{active[last]} +1 %: " + (", ".join(moves) or "alone")


def slopes_of(
    scene: Scene, values: Mapping[str, float], surfaces: Numbers, *, exact: bool = True
) -> tuple[Expected, dict[str, list[Numbers]]]:
    """What is expected, and the slopes of signal, chance, near_ir and sigma_m by each parameter.

    exact  by Dr.Jit, where there is a back end; else by central differences
    """
    ahead = surfaces[scene.group]

    def formula(at: Mapping[str, Lanes]) -> list[Lanes]:
        now = expected(scene, at, ahead)
        return [now.signal, now.chance, now.near_ir, now.sigma_m]

    now = expected(scene, values, ahead)
    if exact:
        from ...kernel.device import gradients

        try:
            return now, gradients.jacobian(formula, values)[1]
        except BackendError:
            pass
    step = 1e-4
    slopes = {}
    for name, value in values.items():
        above, below = (formula({**values, name: value + sign * step}) for sign in (1.0, -1.0))
        slopes[name] = [np.asarray((a - b) / (2.0 * step)) for a, b in zip(above, below, strict=True)]
    return now, slopes


def _strong(scene: Scene, reported: Reported, values: Mapping[str, float], surfaces: Numbers) -> Numbers:
    now = expected(scene, values, surfaces[scene.group])
    return np.asarray((now.signal > STRONG * now.level) & (now.fired < MOST_FIRED) & reported.kept)


def _step(
    scene: Scene, reported: Reported, values: Mapping[str, float], surfaces: Numbers, strong: Numbers, weight: float
) -> _Step:  # fmt: skip
    """Scores and Fisher's matrix, reflectivities profiled out."""
    now, slopes = slopes_of(scene, values, surfaces)
    said = 1.0 - strong
    chance = np.clip(now.chance, LEAST_CHANCE, 1.0 - LEAST_CHANCE)
    signal = np.where(strong, reported.signal - now.signal, 0.0)
    fair = np.minimum(1.0, HUBER * np.sqrt(now.variance) / np.maximum(np.abs(signal), 1e-12))
    light = np.isfinite(reported.near_ir)
    apart = np.where(strong, (reported.range_m - scene.range_m) / now.sigma_m, 0.0)
    near = strong & (np.abs(apart) < OUTLIER)
    apart = np.where(near, apart, 0.0)
    # Residual and weight of signal, chance, background and scatter: the score of each is slope x residual x weight.
    residuals = (
        signal,
        reported.kept - chance,
        np.where(light, reported.near_ir - now.near_ir, 0.0),
        (apart * apart - 1.0) * now.sigma_m,
    )
    weights = (
        strong * fair / now.variance, said / (chance * (1.0 - chance)), light / np.maximum(now.near_ir, 1.0),
        near / now.sigma_m**2,
    )  # fmt: skip
    # The variance of (z^2 - 1) sigma is 2 sigma^2: its information is twice the square of the slope over sigma^2.
    information = (1.0, 1.0, 1.0, 2.0)
    n, groups = len(scene.range_m), len(surfaces)
    each, each_surface = np.zeros((n, len(values))), np.zeros(n)
    matrix, cross, own = np.zeros((len(values),) * 2), np.zeros((len(values), groups)), np.zeros(groups)
    power, sun = slopes["laser.peak_power_w"], slopes.get("optics.sun_irradiance_w_m2")
    for kind, (residual, part, factor) in enumerate(zip(residuals, weights, information, strict=True)):
        slope = np.column_stack([slopes[name][kind] for name in values])
        surface = power[kind] + (0.0 if sun is None else sun[kind])
        each += slope * (residual * part)[:, None]
        each_surface += surface * residual * part
        weighted = slope * (factor * part)[:, None]
        matrix += weighted.T @ slope
        for row in range(len(values)):
            cross[row] += np.bincount(scene.group, weighted[:, row] * surface, minlength=groups)
        own += np.bincount(scene.group, factor * part * surface**2, minlength=groups)
    own = own + weight + 1e-9
    of_groups = np.bincount(scene.group, each_surface, minlength=groups) - weight * surfaces
    profiled = cross / own
    return _Step(
        score=each.sum(axis=0) - profiled @ of_groups, matrix=matrix - profiled @ cross.T,
        each=each - each_surface[:, None] * profiled.T[scene.group], of_groups=of_groups, cross=cross, own=own,
    )  # fmt: skip
