"""What limits a design: what each constraint costs it, and which ranges end there.

At an optimum the gradient of the loss is a sum of the gradients of the bounds that hold it, with factors that are not
negative (Karush, Kuhn and Tucker): grad f = sum(lambda grad slack). lambda is what the loss would fall by if its bound
gave way by the bound's own size. For a front, the other objectives are bounds too, at the values of the design.

Symbols: as in the theory, f loss, lambda multiplier.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ...maths.arrays import Numbers
from .designs import DesignSpace, Values
from .search import Design, losses, slacks
from .study_file import StudyFile

ACTIVE = 2e-3
"""A bound is active where less than this share of it is slack, or of the range of a key."""

_STEP = 1e-4
_LARGEST_RESIDUAL = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What limits a design; see `limits_of`.

    costs   bound -> percent by which the first objective would improve if the bound gave way by one percent
    held    keys at an end of their range
    stands  whether the bounds explain the gradient, so that this is an optimum and the costs mean something
    """

    costs: dict[str, float]
    held: tuple[str, ...]
    stands: bool


def limits_of(
    study: StudyFile, space: DesignSpace, design: Design, evaluate: Callable[[Values], dict[str, float]]
) -> Limits | None:
    """Compute the limits of a design over its continuous keys; None if it has none, or a step leaves the sensor.

    Central differences of a ten-thousandth of each key's range, one-sided at its ends.
    """
    from scipy.optimize import nnls

    free = [entry for entry in space.free if entry.is_continuous and entry.key in design.values]
    if not free:
        return None
    shares = np.array([entry.share(design.values[entry.key]) for entry in free])

    def at(changed: Numbers) -> tuple[Numbers, Numbers]:
        values = dict(design.values) | {
            entry.key: entry.value(float(share)) for entry, share in zip(free, changed, strict=True)
        }
        moved = Design(values=values, quantities=evaluate(values))
        return losses(study, moved), np.array(list(slacks(study, moved).values()))

    try:
        ends = [(np.maximum(shares - step, 0.0), np.minimum(shares + step, 1.0)) for step in np.eye(len(free)) * _STEP]
        pairs = [(at(low), at(high), float((high - low).sum())) for low, high in ends]
    except InputError:
        return None
    loss_slopes = np.stack([(high[0] - low[0]) / width for low, high, width in pairs])  # (keys, objectives)
    slack_slopes = np.stack([(high[1] - low[1]) / width for low, high, width in pairs])  # (keys, bounds)
    bounds = slacks(study, design)
    held = [
        (entry.key, direction, number)
        for number, (entry, share) in enumerate(zip(free, shares, strict=True))
        for is_held, direction in ((share <= ACTIVE, 1.0), (share >= 1.0 - ACTIVE, -1.0))
        if is_held
    ]
    active = [number for number, slack in enumerate(bounds.values()) if slack <= ACTIVE]
    columns = [slack_slopes[:, number] for number in active]
    columns += [-loss_slopes[:, number] for number in range(1, loss_slopes.shape[1])]
    columns += [direction * np.eye(len(free))[number] for _, direction, number in held]
    target = loss_slopes[:, 0]
    size = float(np.linalg.norm(target))
    multipliers, residual = (np.zeros(0), size) if not columns else nnls(np.stack(columns, axis=1), target)
    first = next(iter(study.objectives))
    scale = abs(design.quantities[first]) or 1.0
    names = list(bounds)
    return Limits(
        costs={names[number]: float(multipliers[place]) / scale for place, number in enumerate(active)},
        held=tuple(key for key, _, _ in held),
        stands=bool(residual <= _LARGEST_RESIDUAL * size or size <= 1e-3 * scale),
    )
