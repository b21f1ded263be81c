"""Detection rates, range errors and paired counts of observations, with 95 % intervals.

A rate is the share of the pulses in `Surfaces` that were detected. Two sensors that fire the same pulses are compared
pulse by pulse, which needs far fewer pulses than comparing two rates.

Symbols: k found of n, p = k / n rate, z = 1.96.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ...cloud.point_cloud import PointCloud
from ...maths.arrays import Numbers
from .observations import Grouping, Observation, Surfaces, truth_column

NORMAL_95 = 1.959963984540054
"""Source: normal distribution; standard deviations that hold 95 % of it, two-sided."""

_ALL: tuple[str, ...] = ("all",)

DIFFERENCE = ("both", "only_a", "only_b")
"""Names of the kinds 0, 1 and 2 of a difference cloud's points."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionRate:
    """Detection rate of one group of pulses.

    Attributes:
        surfaces: pulses of the group that met a surface
        found: those of them with an echo among the points
        expected: mean of their P_d, None if unknown
    """

    group: str
    surfaces: int
    found: int
    expected: float | None = None

    @property
    def rate(self) -> float:
        """Share found; 0 if there are no pulses."""
        return self.found / self.surfaces if self.surfaces else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the rate (Wilson)."""
        return wilson_interval(self.found, self.surfaces)

    @property
    def cells(self) -> tuple[float, ...]:
        """Numbers of a row of data: surfaces, found, the rate and its interval."""
        return self.surfaces, self.found, self.rate, *self.interval


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeError:
    """Reported minus true range of one group's echoes: mean and standard deviation (0 for a single echo)."""

    group: str
    points: int
    bias_m: float
    sigma_m: float

    @property
    def bias_interval_m(self) -> float:
        """Half the 95 % interval of the mean."""
        return NORMAL_95 * self.sigma_m / math.sqrt(self.points)

    @property
    def sigma_interval_m(self) -> float:
        """Half the 95 % interval of the deviation, for Gaussian errors."""
        return NORMAL_95 * self.sigma_m / math.sqrt(2.0 * max(self.points - 1, 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class PairCounts:
    """Numbers of pulses in one group by which of the two sensors found their surface."""

    group: str
    both: int
    only_a: int
    only_b: int
    neither: int

    @property
    def pulses(self) -> int:
        """Number of pulses."""
        return self.both + self.only_a + self.only_b + self.neither

    @property
    def difference(self) -> float:
        """Rate of A minus rate of B; 0 if there are no pulses."""
        return (self.only_a - self.only_b) / self.pulses if self.pulses else 0.0

    @property
    def difference_interval(self) -> tuple[float, float]:
        """95 % interval of the difference of these paired shares."""
        return paired_interval(only_a=self.only_a, only_b=self.only_b, pulses=self.pulses)


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a share (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209); 0 to 1 for no pulses."""
    if not trials:
        return 0.0, 1.0
    share, z2 = successes / trials, NORMAL_95**2 / trials
    middle = (share + 0.5 * z2) / (1.0 + z2)
    half = NORMAL_95 * math.sqrt(share * (1.0 - share) / trials + 0.25 * z2 / trials) / (1.0 + z2)
    # Exactly 0 and 1 at the ends, where rounding may step over.
    return (max(middle - half, 0.0) if successes else 0.0), (min(middle + half, 1.0) if successes < trials else 1.0)


def paired_interval(*, only_a: int, only_b: int, pulses: int) -> tuple[float, float]:
    """95 % interval of p_A - p_B from pairs (Agresti and Min, Statistics in Medicine 24 (2005) 729).

    Wald's interval with half a pulse added to each of the four cells, so that a difference of zero has a width too.
    """
    total = pulses + 2.0
    b, c = only_a + 0.5, only_b + 0.5
    middle = (b - c) / total
    half = NORMAL_95 * math.sqrt(max(b + c - (b - c) ** 2 / total, 0.0)) / total
    return middle - half, middle + half


def overall_rate(surfaces: Surfaces) -> DetectionRate:
    """Detection rate over all pulses."""
    expected = None if surfaces.probability is None else _mean(surfaces.probability)
    found_count = int(np.count_nonzero(surfaces.detected))
    return DetectionRate(group="all", surfaces=len(surfaces.pulse), found=found_count, expected=expected)


def rates_by_group(surfaces: Surfaces, grouping: Grouping) -> list[DetectionRate]:
    """Detection rate of each group in order, including empty groups."""
    index, size = grouping.group_index(surfaces), len(grouping.labels)
    counts, found_counts = _counts(index, size), _counts(index[surfaces.detected], size)
    is_known = surfaces.probability is not None
    weights = surfaces.probability[index >= 0].astype(np.float64) if surfaces.probability is not None else None
    sums = np.bincount(index[index >= 0], weights=weights, minlength=size)
    return [
        DetectionRate(group=label, surfaces=int(n), found=int(k), expected=float(p / n) if is_known and n else None)
        for label, n, k, p in zip(grouping.labels, counts, found_counts, sums, strict=True)
    ]


def detection_deviation(surfaces: Surfaces) -> float | None:
    """Tripped minus expected echoes, in standard deviations of independent draws; None if unknown.

    (number tripped - sum p) / sqrt(sum p (1 - p))
    """
    if surfaces.probability is None or surfaces.tripped is None:
        return None
    p = surfaces.probability.astype(np.float64)
    sigma = math.sqrt(float(np.sum(p * (1.0 - p))))
    return (int(np.count_nonzero(surfaces.tripped)) - float(p.sum())) / sigma if sigma > 0.0 else 0.0


def range_errors(observation: Observation, grouping: Grouping | None = None) -> list[RangeError]:
    """Range error of each group that has an echo; without a grouping, one of all echoes, or none."""
    echoes = observation.cloud.select(observation.is_echo)
    error_m = echoes.range_m.astype(np.float64) - truth_column(echoes, "true_range_m")
    if grouping is None:
        index, labels = np.zeros(len(echoes), dtype=np.int64), _ALL
    else:
        index, labels = grouping.group_index(echoes), grouping.labels
    errors = []
    for number in np.unique(index[index >= 0]):
        errors.append(_range_error(labels[number], error_m[index == number]))
    return errors


def _range_error(group: str, error_m: Numbers) -> RangeError:
    sigma_m = float(error_m.std(ddof=1)) if len(error_m) > 1 else 0.0
    return RangeError(group=group, points=len(error_m), bias_m=float(error_m.mean()), sigma_m=sigma_m)


def count_pairs(a: Surfaces, b: Surfaces, grouping: Grouping | None = None) -> list[PairCounts]:
    """Count the pulses that met a surface for both sensors, by which of them found it.

    Groups are by A's truth, in order, including empty ones.
    """
    _, in_a, in_b = common_pulses(a.pulse, b.pulse)
    index, labels = np.zeros(len(in_a), dtype=np.int64), _ALL
    if grouping is not None:
        index, labels = grouping.group_index(a)[in_a], grouping.labels
    kind = 2 * a.detected[in_a].astype(np.int64) + b.detected[in_b]
    table = [_counts(index[kind == number], len(labels)) for number in (3, 2, 1, 0)]
    return [
        PairCounts(group=label, both=int(both), only_a=int(only_a), only_b=int(only_b), neither=int(neither))
        for label, both, only_a, only_b, neither in zip(labels, *table, strict=True)
    ]


def first_echoes(observation: Observation) -> tuple[Numbers, Numbers]:
    """Pulse numbers with an echo among the points, rising, and the index of each pulse's first echo."""
    assert observation.pulse is not None
    echo_points = np.flatnonzero(observation.is_echo)
    pulse, first = np.unique(observation.pulse[echo_points], return_index=True)
    return pulse, echo_points[first]


def paired_range_difference(a: Observation, b: Observation) -> RangeError | None:
    """Range of A minus range of B for pulses with an echo in both; None if there are none."""
    pulse_a, first_a = first_echoes(a)
    pulse_b, first_b = first_echoes(b)
    _, in_a, in_b = common_pulses(pulse_a, pulse_b)
    if not len(in_a):
        return None
    difference_m = a.cloud.range_m[first_a[in_a]].astype(np.float64) - b.cloud.range_m[first_b[in_b]]
    return _range_error("all", difference_m)


def difference_cloud(a: Observation, b: Observation) -> tuple[PointCloud, Numbers]:
    """Difference cloud of two sensors, and the kind of each of its points (an index of DIFFERENCE), by pulse.

    The cloud has the first echo of each pulse that has one: A's point if A has one, else B's, with the sensor index 0
    or 1. False alarms are left out.
    """
    pulse_a, first_a = first_echoes(a)
    pulse_b, first_b = first_echoes(b)
    kind_a = np.where(np.isin(pulse_a, pulse_b, assume_unique=True), 0, 1)
    only_b = ~np.isin(pulse_b, pulse_a, assume_unique=True)
    order = np.argsort(np.concatenate([pulse_a, pulse_b[only_b]]), kind="stable")
    parts = [a.cloud.select(first_a), b.cloud.select(first_b[only_b])]
    names = (a.name, b.name)
    together = PointCloud.concatenate(
        [
            replace(part, sensor_index=np.full(len(part), i, np.uint8), sensor_names=names)
            for i, part in enumerate(parts)
        ]
    )
    kinds = np.concatenate([kind_a, np.full(int(only_b.sum()), 2)]).astype(np.uint8)
    return together.select(order), kinds[order]


def paired_snr(a: Surfaces, b: Surfaces) -> tuple[Numbers, Numbers, Numbers]:
    """SNR for A and for B of the pulses for which both are known, and which sensors found the surface.

    The third array is 0 where both found it, 1 for A only, 2 for B only, 3 for neither.
    """
    _, in_a, in_b = common_pulses(a.pulse, b.pulse)
    found_a, found_b = a.detected[in_a], b.detected[in_b]
    kind = np.where(found_a, np.where(found_b, 0, 1), np.where(found_b, 2, 3))
    has_both = (a.snr[in_a] > 0.0) & (b.snr[in_b] > 0.0)
    return a.snr[in_a][has_both], b.snr[in_b][has_both], kind[has_both]


def common_pulses(a: Numbers, b: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Pulse numbers in both of two lists without repetition, and their indices in each."""
    return np.intersect1d(a, b, assume_unique=True, return_indices=True)


def _counts(index: Numbers, size: int) -> Numbers:
    return np.bincount(index[index >= 0], minlength=size)


def _mean(values: Numbers) -> float:
    return float(values.mean(dtype=np.float64)) if len(values) else 0.0
