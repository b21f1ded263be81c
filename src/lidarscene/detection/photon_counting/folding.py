"""Folding: light from beyond the unambiguous range, which comes back after the next pulse has left.

The histogram counts time from the last pulse, so such an echo appears nearer by whole pulse periods.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ...light.echoes import EchoTrain
from ...maths.arrays import Lanes, xp
from ...physics.optics import radiometry
from ...sensor.histogram import Histogram


@dataclass(frozen=True, slots=True, kw_only=True)
class Folded:
    """Light folded into the unambiguous range.

    Attributes:
        train: sub-echoes at the ranges at which they appear, none of them beyond the unambiguous range
        folds_m: (n,) each, by how much every sub-echo of a surface appears too near; None: the pulse period is not
            known
    """

    train: EchoTrain
    folds_m: Sequence[Lanes] | None


def fold(train: EchoTrain, histogram: Histogram) -> Folded:
    """Fold sub-echoes back by whole pulse periods."""
    if histogram.period_s is None:
        return Folded(train=train, folds_m=None)
    ops = xp(train.parts[0].range_m)
    unambiguous_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=histogram.period_s)
    parts, folds_m = [], []
    for part in train.parts:
        periods = ops.floor(ops.maximum(part.range_m, 0.0) / unambiguous_m)
        # An echo that returns k periods later is missing in the first k shots.
        share = ops.maximum(1.0 - periods / histogram.shots, 0.0)
        parts.append(
            replace(part, range_m=part.range_m - periods * unambiguous_m, peak_power_w=part.peak_power_w * share)
        )
        folds_m += [ops.column(periods * unambiguous_m, number, part.count) for number in range(part.count)]
    return Folded(train=replace(train, parts=tuple(parts)), folds_m=folds_m[: train.surfaces])
