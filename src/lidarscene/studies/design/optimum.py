"""What limits a design: what each constraint costs it, and which ranges end there.

At an optimum the gradient of the loss is a sum of the gradients of the bounds that hold it, with factors that are not
negative (Karush, Kuhn and Tucker): grad f = sum(lambda grad slack). lambda is what the loss would fall by if its bound
gave way by the bound's own size. For a front, the other objectives are bounds too, at the values of the design.

Symbols: as in the theory, f loss, lambda multiplier.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from .designs import Design, DesignSpace
from .search import loss_slopes, slack_slopes, slacks
from .slopes import SlopesOf
from .study_file import StudyFile

ACTIVE = 2e-3
"""Choice: a bound is active where less than this share of it is slack, or of the range of a key."""

_LARGEST_RESIDUAL = 0.1
"""Choice: share of the objective's slope that constraints may leave at a design that counts as an optimum."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ActiveConstraints:
    """What limits a design; see `limits_of`.

    Attributes:
        objective: what a bound that gives way improves
        costs: bound -> percent by which it would improve if the bound gave way by one percent
        held: continuous keys at an end of their range
        stands: whether the bounds explain the gradient, so that this is an optimum and the costs mean something
        methods: quantity by name -> how its slopes were found (`slopes.Slopes`)
    """

    objective: str
    costs: dict[str, float]
    held: tuple[str, ...]
    stands: bool
    methods: Mapping[str, str]


def at_an_end(space: DesignSpace, design: Design) -> tuple[str, ...]:
    """Keys of numbers that a design has at an end of their range."""
    shares = {free.key: free.share(design.values[free.key]) for free in space.free if free.key in design.values}
    # The least and the largest of n values stand half a place from the ends.
    return tuple(
        free.key
        for free in space.free
        if free.key in shares and (free.is_continuous or free.is_ordered)
        for margin in [ACTIVE if free.is_continuous else 0.75 / len(free.values)]
        if not margin < shares[free.key] < 1.0 - margin
    )


def limits_of(
    study: StudyFile, space: DesignSpace, design: Design, slopes_of: SlopesOf, *, best: str | None = None
) -> ActiveConstraints | None:
    """Compute the limits of a design over its continuous keys; None if it has none, or no step leaves a sensor.

    Args:
        best: objective of which this is the best design: the others bound it no more. None: they do
    """
    from scipy.optimize import nnls

    continuous = [space.free[number] for number in space.continuous]
    present = [number for number, entry in enumerate(continuous) if entry.key in design.values]
    if not present:
        return None
    free = [continuous[number] for number in present]
    shares = np.array([entry.share(design.values[entry.key]) for entry in free])
    try:
        slopes = slopes_of(design)
    except InputError:
        return None
    of_losses = loss_slopes(study, slopes.slopes)[:, present].T  # (keys, objectives)
    of_slacks = slack_slopes(study, slopes.slopes)
    bounds = slacks(study, design)
    held = [
        (entry.key, direction, number)
        for number, (entry, share) in enumerate(zip(free, shares, strict=True))
        for is_held, direction in ((share <= ACTIVE, 1.0), (share >= 1.0 - ACTIVE, -1.0))
        if is_held
    ]
    active = [number for number, slack in enumerate(bounds.values()) if slack <= ACTIVE]
    columns = [of_slacks[number, present] for number in active]
    objectives = list(study.objectives)
    first = 0 if best is None else objectives.index(best)
    if best is None:
        columns += [-of_losses[:, number] for number in range(1, of_losses.shape[1])]
    columns += [direction * np.eye(len(free))[number] for _, direction, number in held]
    target = of_losses[:, first]
    size = float(np.linalg.norm(target))
    multipliers, residual = (np.zeros(0), size) if not columns else nnls(np.stack(columns, axis=1), target)
    scale = abs(design.quantities[objectives[first]]) or 1.0
    names = list(bounds)
    return ActiveConstraints(
        objective=objectives[first],
        costs={names[number]: float(multipliers[place]) / scale for place, number in enumerate(active)},
        held=tuple(key for key, _, _ in held),
        stands=bool(residual <= _LARGEST_RESIDUAL * size or size <= 1e-3 * scale),
        methods=slopes.methods,
    )
