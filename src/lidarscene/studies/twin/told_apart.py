"""Balanced accuracy with which a classifier tells recorded from simulated range images.

The images are cut into patches. Extremely randomised trees (P. Geurts, D. Ernst and L. Wehenkel, Extremely randomized
trees, Machine Learning 63, 2006) learn from all sectors of the azimuth but one in four, and judge that: what they saw
of a place does not help them there. Features have no unit and no place, so that neither the scale of intensities nor
the scene tells a side. 0.5 is chance; two recorded frames of one sensor at rest are at 0.50 to 0.52.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...files.optional import import_optional
from ...maths.arrays import Numbers
from .tuning import SAME_SURFACE_M

PATCH = (8, 16)
"""Choice: rows and columns of a patch."""

LEAST_FILLED = 0.25
"""Choice: share of the pixels of a patch with a return on one of the sides, from which on it counts."""

SECTORS, FOLDS = 16, 4
"""Choice: sectors of the azimuth, and parts of them that are held out one after the other."""

LEAST_PATCHES = 50
"""Least number of patches of a side of which an accuracy is told: by chance it is good to 0.05."""

TREES, LEAF = 100, 3
"""Choice: number of trees, and least number of patches in a leaf."""

EXTRA = "certify"
"""Group of packages that brings the trees."""

QUANTILES = (0.25, 0.5, 0.75)
"""Choice: quantiles that describe the differences in a patch."""

LEAST_M, LEAST_STRENGTH = 1e-4, 1e-3
"""Accuracy bought: steps to which differences of ranges, and of logarithms of strengths, are rounded, and least ones
whose logarithm is taken. They are below the steps of any recording, and above the digits by which single precision, or
a step of 6.67 ps for 1 mm, would tell the sides apart."""

UNKNOWN = -99.0
"""Choice: value of a feature that a patch lacks, beyond all logarithms."""


class Image(NamedTuple):
    """Range image of one frame, (rows, columns) each: ranges, NaN where there is no return, and strengths, or None."""

    range_m: Numbers
    strength: Numbers | None


@dataclass(frozen=True, slots=True)
class ToldApart:
    """Result of a classifier.

    Attributes:
        accuracy: balanced accuracy
        sigma: its standard error, by the scatter from sector to sector
        patches: number of patches of each side
    """

    accuracy: float
    sigma: float
    patches: int


def told_apart(first: Sequence[Image], second: Sequence[Image], *, seed: int = 0) -> dict[str, ToldApart]:
    """Tell two sides apart, whose images have the same rows; by all features, and by each group of them.

    Args:
        seed: of the trees

    Returns:
        result by group, "all" first; empty with fewer than `LEAST_PATCHES`

    Raises:
        LidarSceneError: without scikit-learn
    """
    trees = import_optional("sklearn.ensemble", extra=EXTRA)
    columns = min(image.range_m.shape[1] for image in (*first, *second)) // PATCH[1]
    sides = [[_patches(image, columns * PATCH[1]) for image in images] for images in (first, second)]
    place = np.arange(columns) * SECTORS // max(columns, 1)
    sector_of_image = np.tile(place, first[0].range_m.shape[0] // PATCH[0])
    filled = np.max([patch.filled for side in sides for patch in side], axis=0) >= LEAST_FILLED
    counts = [int(filled.sum()) * len(side) for side in sides]
    if min(counts) < LEAST_PATCHES:
        return {}
    sector = np.concatenate([sector_of_image[filled]] * (len(first) + len(second)))
    label = np.repeat([0, 1], counts)
    groups = {
        name: np.concatenate([patch.features[name][filled] for side in sides for patch in side])
        for name in sides[0][0].features
    }
    results = {}
    for name, features in {"all": np.concatenate(list(groups.values()), axis=1), **groups}.items():
        named = np.zeros(len(label), int)
        for fold in range(FOLDS):
            held_out = sector % FOLDS == fold
            model = trees.ExtraTreesClassifier(
                TREES, min_samples_leaf=LEAF, class_weight="balanced", random_state=seed, n_jobs=1
            )
            if held_out.any() and not held_out.all():
                named[held_out] = model.fit(features[~held_out], label[~held_out]).predict(features[held_out])
        results[name] = _accuracy(named == label, label, sector)
    return results


def _accuracy(is_right: Numbers, label: Numbers, sector: Numbers) -> ToldApart:
    """Mean of the shares of both sides that are named right, and its scatter between sectors."""
    shares = [
        np.mean([is_right[(sector == number) & (label == side)].mean() for side in (0, 1)])
        for number in np.unique(sector)
    ]
    balanced = np.mean([is_right[label == side].mean() for side in (0, 1)])
    sigma = float(np.std(shares, ddof=1) / np.sqrt(len(shares))) if len(shares) > 1 else 0.5
    return ToldApart(float(balanced), sigma, int(np.sum(label == 0)))


class _Patches(NamedTuple):
    """Patches of an image, row by row: share of their pixels with a return, and features by group, (patches, k)."""

    filled: Numbers
    features: dict[str, Numbers]


def _patches(image: Image, columns: int) -> _Patches:
    """Patches of the first columns of an image."""
    # In single precision even a rounded step has digits of its own, by which trees would tell the sides apart.
    range_m, strength = (None if values is None else values[:, :columns].astype(np.float64) for values in image)
    assert range_m is not None
    has_return = np.isfinite(range_m)
    along, across = np.diff(range_m, axis=1), np.diff(range_m, axis=0)
    is_edge = np.abs(along) > SAME_SURFACE_M  # False beside a lost pixel

    def changes(values: Numbers, orders: int, least: float) -> list[Numbers]:
        """Quantiles of the differences of these orders along the rows, of those that cross no edge."""
        quantiles = []
        for order in range(1, orders + 1):
            change = np.abs(np.diff(values, n=order, axis=1))
            crosses = np.any([is_edge[:, k : k + change.shape[1]] for k in range(order)], axis=0)
            quantiles += _quantiles(np.where(crosses, np.nan, change), range_m.shape, least)
        return quantiles

    neighbours = sum(_shifted(has_return, *offset) for offset in ((0, 1), (0, -1), (1, 0), (-1, 0)))
    jumps = np.pad(is_edge, ((0, 0), (1, 1)))
    features = {
        "range texture": changes(range_m, 3, LEAST_M),
        "holes": [
            _means(mask)
            for mask in (
                has_return,
                has_return & (neighbours <= 1),
                ~has_return & (neighbours >= 3),
                has_return != _shifted(has_return, 0, 1),
                has_return != _shifted(has_return, 1, 0),
            )
        ],
        "edges": [
            _means(mask)
            for mask in (
                jumps[:, 1:],
                jumps[:, 1:] & jumps[:, :-1],
                np.pad(np.abs(across), ((0, 1), (0, 0))) > SAME_SURFACE_M,
            )
        ],
    }
    if strength is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            logarithm = np.where(has_return & (strength > 0.0), np.log(strength), np.nan)
        features["intensity"] = [
            *changes(logarithm, 2, LEAST_STRENGTH),
            _means(has_return & ~(strength > 0.0)),
            _means(np.abs(np.diff(logarithm, axis=1, append=np.nan)) == 0.0),
        ]
    return _Patches(_means(has_return), {name: np.stack(columns, axis=-1) for name, columns in features.items()})


def _cut(values: Numbers) -> Numbers:
    """(patches, pixels of a patch) of an image, row by row; what fills no patch at its ends is left out."""
    rows, columns = (size // part for size, part in zip(values.shape, PATCH, strict=True))
    whole = values[: rows * PATCH[0], : columns * PATCH[1]].reshape(rows, PATCH[0], columns, PATCH[1])
    return np.asarray(whole.swapaxes(1, 2).reshape(rows * columns, PATCH[0] * PATCH[1]))


def _means(mask: Numbers) -> Numbers:
    return np.asarray(_cut(mask.astype(float)).mean(axis=1))


def _quantiles(change: Numbers, shape: tuple[int, ...], least: float) -> list[Numbers]:
    """Logarithms of the quantiles of the differences in each patch, `UNKNOWN` where it has none."""
    steps = np.rint(change / least) * least
    patches = _cut(np.pad(steps, ((0, 0), (0, shape[1] - change.shape[1])), constant_values=np.nan))
    known = np.isfinite(patches).any(axis=1)
    columns = np.full((len(QUANTILES), len(patches)), UNKNOWN)
    columns[:, known] = np.log(np.maximum(np.nanquantile(patches[known], QUANTILES, axis=1), least))
    return list(columns)


def _shifted(mask: Numbers, rows: int, columns: int) -> Numbers:
    """The mask of the neighbours that lie so many rows and columns further; those of the last are of the first."""
    return np.roll(mask, (-rows, -columns), (0, 1)).astype(int)
