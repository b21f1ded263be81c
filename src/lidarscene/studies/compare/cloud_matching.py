"""Observations from existing clouds, whose points are matched pulse by pulse.

A file has no pulse numbers. Points of two files belong to one pulse if time, channel, azimuth and elevation agree to
the last bit, as they do if the same scanner fired. A file does not say what its sensor missed, so rates are shares of
the pulses with which any of the sensors found a surface.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...cloud.point_cloud import PointCloud, with_common_names
from ...errors import InputError
from ...maths.arrays import Numbers
from .comparison_statistics import common_pulses, first_echoes
from .observations import Observation, Surfaces

LEAST_SHARED = 0.05
"""Choice: share of the smaller cloud's pulses that the other must have for the two to count as fired by one scanner."""


def read_clouds(clouds: Sequence[str | os.PathLike[str] | PointCloud]) -> list[Observation]:
    """Observations of clouds with ground truth, or of files of them, named after file or sensor.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    names, loaded = [], []
    for cloud in clouds:
        name = cloud.metadata.get("sensor", "cloud") if isinstance(cloud, PointCloud) else Path(cloud).stem
        points = cloud if isinstance(cloud, PointCloud) else PointCloud.load(cloud)
        if not points.has_truth:
            where = name if isinstance(cloud, PointCloud) else os.fspath(cloud)
            raise InputError(f"{where}: the cloud must have ground truth, got one without")
        names.append(name)
        loaded.append(points)
    return observe_clouds(names, loaded)


def observe_clouds(names: Sequence[str], clouds: Sequence[PointCloud]) -> list[Observation]:
    """Make observations from clouds, matched by pulse if every cloud shares pulses with the first.

    Equal names get a number.
    """
    labels = [f"{name} ({names[:i].count(name) + 1})" if name in names[:i] else name for i, name in enumerate(names)]
    unified_clouds = with_common_names(clouds)
    pulses = _pulse_numbers(unified_clouds)
    if not all(_share_pulses(pulses[0], pulse_numbers) for pulse_numbers in pulses[1:]):
        return [
            Observation(name=name, cloud=cloud, losses={}) for name, cloud in zip(labels, unified_clouds, strict=True)
        ]
    matched = [
        Observation(name=name, cloud=cloud, pulse=pulse, losses={})
        for name, cloud, pulse in zip(labels, unified_clouds, pulses, strict=True)
    ]
    return [
        replace(observation, surfaces=surfaces)
        for observation, surfaces in zip(matched, surfaces_found_by_any(matched), strict=True)
    ]


def surfaces_found_by_any(observations: Sequence[Observation]) -> list[Surfaces]:
    """Pulses with which any of the sensors found a surface, as `Surfaces` for each sensor.

    The truth of a pulse is that of the first observation that found its surface.
    """
    echoes = [first_echoes(observation) for observation in observations]
    all_pulses = np.unique(np.concatenate([pulse for pulse, _ in echoes]))
    truth: dict[str, Numbers] = {}
    # Last to first, so that the first observation's truth is written last and stays.
    for observation, (pulse, point) in reversed(list(zip(observations, echoes, strict=True))):
        rows = np.searchsorted(all_pulses, pulse)
        for attribute in _TRUTH_COLUMNS:
            values = getattr(observation.cloud, attribute)
            truth.setdefault(attribute, np.zeros(len(all_pulses), values.dtype))[rows] = values[point]
    surfaces = []
    for observation, (pulse, point) in zip(observations, echoes, strict=True):
        rows = np.searchsorted(all_pulses, pulse)
        detected, snr = np.zeros(len(all_pulses), bool), np.zeros(len(all_pulses), np.float32)
        detected[rows], snr[rows] = True, observation.cloud.snr[point]
        surfaces.append(Surfaces(pulse=all_pulses, detected=detected, snr=snr, **truth))
    return surfaces


_TRUTH_COLUMNS = ("true_range_m", "incidence_angle_rad", "reflectivity", "body", "class_id")


def disagreeing_share(a: Observation, b: Observation, *, tolerance_m: float = 0.01) -> float:
    """Share of the pulses detected by both whose true ranges differ by more than the tolerance.

    More than a few per cent mean that the scenes differ.
    """
    pulse_a, first_a = first_echoes(a)
    pulse_b, first_b = first_echoes(b)
    _, in_a, in_b = common_pulses(pulse_a, pulse_b)
    if not len(in_a) or a.cloud.true_range_m is None or b.cloud.true_range_m is None:
        return 0.0
    difference_m = a.cloud.true_range_m[first_a[in_a]] - b.cloud.true_range_m[first_b[in_b]]
    return float(np.mean(np.abs(difference_m) > tolerance_m))


def _pulse_numbers(clouds: Sequence[PointCloud]) -> list[Numbers]:
    """Pulse number of every point, an array (n,) for each cloud.

    Pulses of all clouds are numbered together in firing order: equal numbers mean the same pulse.
    """

    def joined(attribute: str) -> Numbers:
        # Adding 0 turns -0.0 into 0.0.
        return np.concatenate([getattr(cloud, attribute) + 0 for cloud in clouds])

    keys = [joined(name) for name in ("elevation_rad", "azimuth_rad", "channel", "sensor_index", "time_s")]
    order = np.lexsort(keys)
    starts_pulse = np.zeros(len(order), bool)
    for key in keys:
        starts_pulse[1:] |= np.diff(key[order]) != 0
    number = np.zeros(len(order), np.int64)
    number[order] = np.cumsum(starts_pulse)
    return np.split(number, np.cumsum([len(cloud) for cloud in clouds])[:-1])


def _share_pulses(a: Numbers, b: Numbers) -> bool:
    """True if two lists of pulse numbers have enough in common to come from one scanner."""
    a, b = np.unique(a), np.unique(b)
    smaller = min(len(a), len(b))
    return smaller == 0 or len(common_pulses(a, b)[0]) >= LEAST_SHARED * smaller
