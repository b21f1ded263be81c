"""Observations that a comparison starts from, and the groups in which their pulses are counted.

Simulated clouds and clouds from files become the same `Observation`; later steps treat both alike.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...cloud.point_cloud import PointCloud
from ...detection.outcomes import Status
from ...maths.arrays import Numbers

INCIDENCE_DEG = tuple(range(0, 91, 10))

REFLECTIVITY = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0)
"""Choice: edges of the bins by reflectivity: finer where surfaces are dark."""

_MOST_RANGE_BINS = 16


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surfaces:
    """Pulses that rates are shares of, each once; all arrays (n,). Truth has the names of PointCloud's columns.

    Attributes:
        pulse: pulse numbers, rising
        detected: whether an echo of the pulse is a point
        snr: signal-to-noise ratio of the echo; 0 if unknown
        probability: detection probability P_d of each echo, or None: unknown
        tripped: whether the echo tripped the comparator, also if it was hidden or out of the window; None: unknown
    """

    pulse: Numbers
    detected: Numbers
    snr: Numbers
    true_range_m: Numbers
    incidence_angle_rad: Numbers
    reflectivity: Numbers
    body: Numbers
    class_id: Numbers
    probability: Numbers | None = None
    tripped: Numbers | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observation:
    """One sensor's frame of a scene: points, and what is known of the pulses that gave none.

    Attributes:
        pulse: (n,) pulse number of each point of the cloud, or None: they match no other cloud's
        surfaces: pulses that rates refer to, or None: there are no rates
        pulses_fired: pulses in the frame, or None: unknown
        losses: reason -> number of pulses that met a surface and gave no point; empty if unknown
    """

    name: str
    cloud: PointCloud
    pulse: Numbers | None = None
    surfaces: Surfaces | None = None
    pulses_fired: int | None = None
    losses: dict[str, int]

    @property
    def rated_surfaces(self) -> Surfaces:
        """``surfaces``, of an observation that has rates."""
        assert self.surfaces is not None
        return self.surfaces

    @property
    def is_echo(self) -> Numbers:
        """(n,) mask of the points that are echoes of a surface."""
        return np.asarray((self.cloud.status == Status.ECHO) & np.isfinite(truth_column(self.cloud, "true_range_m")))

    @property
    def false_alarms(self) -> int:
        """Number of false alarms among the points."""
        return int(np.count_nonzero(self.cloud.status == Status.FALSE_ALARM))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grouping:
    """Groups of pulses: bins of a truth column, or one group for each name.

    Attributes:
        attribute: column of Surfaces and PointCloud that decides the group
        unit: unit in labels and on axes, "deg" for an attribute in radians
        edges: edges of the bins, rising, in the attribute's unit; None for names
    """

    key: str
    attribute: str
    unit: str
    labels: tuple[str, ...]
    edges: Numbers | None = None

    def group_index(self, source: Surfaces | PointCloud) -> Numbers:
        """(n,) number of each pulse's or point's group, -1 for none.

        A bin holds its lower edge but not its upper one; the last bin holds both.
        """
        values = truth_column(source, self.attribute)
        if self.edges is None:
            return np.where(values < len(self.labels), values, -1)
        index = np.searchsorted(self.edges, values, side="right") - 1
        index = np.where(values == self.edges[-1], len(self.labels) - 1, index)
        return np.where(index < len(self.labels), index, -1)

    @property
    def middles(self) -> Numbers:
        """Middles of the bins in ``unit``: degrees for angles."""
        assert self.edges is not None
        scale = 180.0 / math.pi if self.unit == "deg" else 1.0
        return scale * 0.5 * (self.edges[1:] + self.edges[:-1])


def range_bins(farthest_m: float) -> Grouping:
    """Bins of true range, at most 16, from 0 to the farthest surface; each 1, 2 or 5 times a power of ten metres."""
    step = 10.0 ** math.floor(math.log10(max(farthest_m, 1e-3) / _MOST_RANGE_BINS))
    step *= next(factor for factor in (1.0, 2.0, 5.0, 10.0) if farthest_m <= _MOST_RANGE_BINS * factor * step)
    edges = step * np.arange(max(math.ceil(farthest_m / step), 1) + 1)
    return _bin_grouping("range", "true_range_m", "m", edges)


def groupings(observations: Sequence[Observation]) -> tuple[Grouping, ...]:
    """Groupings by true range, incidence and reflectivity, by class and by body."""
    true_ranges_m = [
        truth_column(observation.surfaces or observation.cloud, "true_range_m") for observation in observations
    ]
    farthest_m = max((float(range_m[np.isfinite(range_m)].max(initial=0.0)) for range_m in true_ranges_m), default=0.0)
    cloud = observations[0].cloud
    return (
        range_bins(farthest_m),
        _bin_grouping("incidence", "incidence_angle_rad", "deg", np.radians(INCIDENCE_DEG), INCIDENCE_DEG),
        _bin_grouping("reflectivity", "reflectivity", "", np.array(REFLECTIVITY)),
        Grouping(key="class", attribute="class_id", unit="", labels=cloud.class_names),
        Grouping(key="body", attribute="body", unit="", labels=cloud.body_names),
    )


def _bin_grouping(
    key: str, attribute: str, unit: str, edges: Numbers, label_edges: Sequence[float] | None = None
) -> Grouping:
    """Bins between these edges; ``label_edges`` are the same edges in the unit of the labels."""
    bounds = edges if label_edges is None else label_edges
    labels = tuple(f"{low:g} to {high:g}" for low, high in itertools.pairwise(bounds))
    return Grouping(key=key, attribute=attribute, unit=unit, labels=labels, edges=np.asarray(edges))


def truth_column(source: Surfaces | PointCloud, attribute: str) -> Numbers:
    """Column of ground truth, which must be there."""
    values = getattr(source, attribute)
    assert values is not None
    return np.asarray(values)
