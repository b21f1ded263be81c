"""Comparison of existing clouds: files with truth in, what each sensor made of its pulses out.

A file has no pulse numbers. Points of two files belong to one pulse if time, channel, azimuth and elevation agree to
the last bit, as they do if the same scanner fired. A file does not say what its sensor missed, so rates are shares of
the pulses with which any of the sensors found a surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...cloud.point_cloud import PointCloud
from ...errors import InputError
from ...maths.arrays import Numbers
from .data import Observation, Surfaces
from .numbers import common, first_echoes

LEAST_SHARED = 0.05
"""Share of the smaller cloud's pulses that the other must have for the two to count as fired by one scanner."""

_NAMES = {"body": "body_names", "class_id": "class_names", "material": "material_names"}


def read(paths: Sequence[Path]) -> list[Observation]:
    """Observations from these files, matched by pulse if all share pulses with the first. Raises InputError."""
    clouds = [PointCloud.load(path) for path in paths]
    for path, cloud in zip(paths, clouds, strict=True):
        if not cloud.has_truth:
            raise InputError(f"{path}: the cloud must have ground truth, got one without")
    return observations([path.stem for path in paths], clouds)


def observations(names: Sequence[str], clouds: Sequence[PointCloud]) -> list[Observation]:
    """Observations from clouds in memory; equal names get a number."""
    labels = [f"{name} ({names[:i].count(name) + 1})" if name in names[:i] else name for i, name in enumerate(names)]
    unified_clouds = _same_names(clouds)
    pulses = _numbered(unified_clouds)
    if not all(_shared(pulses[0], pulse_numbers) for pulse_numbers in pulses[1:]):
        return [Observation(name=name, cloud=cloud, losses={}) for name, cloud in zip(labels, unified_clouds, strict=True)]
    matched = [
        Observation(name=name, cloud=cloud, pulse=pulse, losses={})
        for name, cloud, pulse in zip(labels, unified_clouds, pulses, strict=True)
    ]
    return [replace(observation, surfaces=surfaces) for observation, surfaces in zip(matched, found_by_any(matched), strict=True)]


def found_by_any(observations: Sequence[Observation]) -> list[Surfaces]:
    """For each sensor, the pulses with which any of them found a surface; truth from the first that did."""
    echoes = [first_echoes(observation) for observation in observations]
    all_pulses = np.unique(np.concatenate([pulse for pulse, _ in echoes]))
    truth: dict[str, Numbers] = {}
    for observation, (pulse, point) in reversed(list(zip(observations, echoes, strict=True))):
        rows = np.searchsorted(all_pulses, pulse)
        for attribute in _TRUTHS:
            values = getattr(observation.cloud, attribute)
            truth.setdefault(attribute, np.zeros(len(all_pulses), values.dtype))[rows] = values[point]
    surfaces = []
    for observation, (pulse, point) in zip(observations, echoes, strict=True):
        rows = np.searchsorted(all_pulses, pulse)
        detected, snr = np.zeros(len(all_pulses), bool), np.zeros(len(all_pulses), np.float32)
        detected[rows], snr[rows] = True, observation.cloud.snr[point]
        surfaces.append(Surfaces(pulse=all_pulses, detected=detected, snr=snr, **truth))
    return surfaces


_TRUTHS = ("true_range_m", "incidence_angle_rad", "reflectivity", "body", "class_id")


def disagreeing(a: Observation, b: Observation, *, tolerance_m: float = 0.01) -> float:
    """Share of the pulses found by both whose true ranges differ.

    More than a few mean that the scenes differ.
    """
    pulse_a, first_a = first_echoes(a)
    pulse_b, first_b = first_echoes(b)
    _, in_a, in_b = common(pulse_a, pulse_b)
    if not len(in_a) or a.cloud.true_range_m is None or b.cloud.true_range_m is None:
        return 0.0
    difference_m = a.cloud.true_range_m[first_a[in_a]] - b.cloud.true_range_m[first_b[in_b]]
    return float(np.mean(np.abs(difference_m) > tolerance_m))


def _numbered(clouds: Sequence[PointCloud]) -> list[Numbers]:
    """For each cloud, the number of each point's pulse among all pulses of all clouds, in firing order."""

    def joined(attribute: str) -> Numbers:
        # + 0.0 makes one zero of the two.
        return np.concatenate([getattr(cloud, attribute) + 0 for cloud in clouds])

    keys = [joined(name) for name in ("elevation_rad", "azimuth_rad", "channel", "sensor_index", "time_s")]
    order = np.lexsort(keys)
    new = np.zeros(len(order), bool)
    for key in keys:
        new[1:] |= np.diff(key[order]) != 0
    number = np.zeros(len(order), np.int64)
    number[order] = np.cumsum(new)
    return np.split(number, np.cumsum([len(cloud) for cloud in clouds])[:-1])


def _shared(a: Numbers, b: Numbers) -> bool:
    a, b = np.unique(a), np.unique(b)
    smaller = min(len(a), len(b))
    return smaller == 0 or len(common(a, b)[0]) >= LEAST_SHARED * smaller


def _same_names(clouds: Sequence[PointCloud]) -> list[PointCloud]:
    """The clouds with one numbering of bodies, classes and materials."""
    if all(getattr(cloud, key) == getattr(clouds[0], key) for cloud in clouds for key in _NAMES.values()):
        return list(clouds)
    tables = {
        key: tuple(dict.fromkeys(name for cloud in clouds for name in getattr(cloud, key))) for key in _NAMES.values()
    }
    renamed_clouds = []
    for cloud in clouds:
        changes: dict[str, Any] = {}
        for attribute, key in _NAMES.items():
            names = getattr(cloud, key)
            # One more entry, the last, for -1 and for numbers without a name.
            renumbered = np.array([*(tables[key].index(name) for name in names), -1], np.int32)
            values = renumbered[np.minimum(getattr(cloud, attribute), len(names))]
            changes |= {key: tables[key], attribute: values}
        renamed_clouds.append(replace(cloud, **changes))
    return renamed_clouds
