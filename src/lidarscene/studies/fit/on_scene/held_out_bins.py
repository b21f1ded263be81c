"""Comparison of a fit with a scene to its held-out columns: signal, share of returns, scatter of the range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....maths.arrays import Numbers
from ...twin.tuning import SAME_SURFACE_M
from ..threshold import shares_by_chance
from ..tuning import OUTLIER_SIGMAS, SQUARE_CAP, STRONG_RATIO
from .known_scene import Prediction, predict
from .likelihood import MEAN_SQUARE, ParameterFit
from .pulses_on_scene import PulsesOnScene

RANGE_BINS, CHANCE_BINS = 8, 10
"""Number of bins over the range, with as many pulses each, and over the chance of a return."""

LEAST_PULSES = 50
"""Least number of pulses in a bin, and of pulses on smooth surfaces per range bin. With fewer they lie on few surfaces,
and even a simulated recording misses the law there. The scatter of so many has a sigma of 11 %."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOutBins:
    """Recorded and expected values of the held-out pulses by bin; the first column of each array is the bin's variable.

    Attributes:
        signal: (k, 3) range [m], mean recorded signal, mean expected signal
        kept_shares: (k, 3) expected chance of a return, recorded share, number of pulses
        scatter: (k, 3) signal, recorded scatter of the range [m], expected scatter [m]
    """

    signal: Numbers
    kept_shares: Numbers
    scatter: Numbers

    @property
    def signal_error(self) -> float | None:
        """Mean absolute relative error of the signal over the bins of range; None without bins."""
        return float(np.mean(np.abs(self.signal[:, 2] / self.signal[:, 1] - 1.0))) if len(self.signal) else None

    @property
    def share_error(self) -> float | None:
        """Mean absolute difference of the shares; bins count alike, since nearly all pulses are in the last."""
        return (
            float(np.mean(np.abs(self.kept_shares[:, 0] - self.kept_shares[:, 1]))) if len(self.kept_shares) else None
        )


def judge(pulses: PulsesOnScene, parameter_fit: ParameterFit) -> HeldOutBins:
    """Bin recorded and predicted values of these pulses; reflectivities are the scene's, without fitted factors."""
    prediction = predict(pulses.scene, parameter_fit.values)
    strong_mask = _strong_mask(pulses, prediction)
    rows = []
    has_enough = strong_mask.sum() >= LEAST_PULSES * RANGE_BINS
    if has_enough:
        range_m = pulses.scene.range_m[strong_mask]
        edges = np.quantile(range_m, np.linspace(0.0, 1.0, RANGE_BINS + 1)[1:-1])
        bin_index = np.searchsorted(edges, range_m)
        columns = range_m, pulses.reported.signal[strong_mask], np.asarray(prediction.signal)[strong_mask]
        rows = [[float(np.mean(values[bin_index == k])) for values in columns] for k in range(RANGE_BINS)]
    return HeldOutBins(
        signal=np.array(rows).reshape(-1, 3),
        kept_shares=_kept_shares(pulses, prediction),
        scatter=_scatter(pulses, prediction, strong_mask) if has_enough else np.zeros((0, 3)),
    )


def _strong_mask(pulses: PulsesOnScene, prediction: Prediction) -> Numbers:
    """Mask of the pulses far above the threshold whose signal and range count, on the scene's surface."""
    off_m = np.abs(np.nan_to_num(pulses.reported.range_m) - pulses.scene.range_m)
    return np.asarray(prediction.is_strong & pulses.reported.has_values & (off_m < SAME_SURFACE_M))


def _kept_shares(pulses: PulsesOnScene, prediction: Prediction) -> Numbers:
    """Expected chance, recorded share and number of the pulses not far above the threshold, by chance."""
    weak_mask = np.asarray(prediction.signal <= STRONG_RATIO * prediction.level)
    chance, returned = np.asarray(prediction.chance)[weak_mask], pulses.reported.has_return[weak_mask]
    return shares_by_chance(chance, returned, CHANCE_BINS, LEAST_PULSES)


def capped_scatter(relative: Numbers) -> float:
    """Standard deviation of residuals in sigmas with the likelihood's cap (`SQUARE_CAP`).

    A median absolute deviation would come out smaller where surfaces differ from the scene's: their tail is part of the
    fitted law.
    """
    inliers = relative[np.abs(relative) < OUTLIER_SIGMAS]
    return float(np.sqrt(np.mean(np.minimum(inliers * inliers, SQUARE_CAP)) / MEAN_SQUARE))


def _scatter(pulses: PulsesOnScene, prediction: Prediction, strong_mask: Numbers) -> Numbers:
    signal = np.asarray(prediction.signal)[strong_mask]
    relative = (pulses.reported.range_m - pulses.scene.range_m)[strong_mask]
    octave = np.floor(np.log2(np.maximum(signal, 1.0))).astype(int)
    sigma_m = np.asarray(prediction.sigma_m)[strong_mask]
    rows = []
    for number in np.unique(octave):
        mask = octave == number
        if mask.sum() >= LEAST_PULSES:
            expected_m = float(np.median(sigma_m[mask]))
            rows.append(
                [2.0 ** (number + 0.5), expected_m * capped_scatter(relative[mask] / sigma_m[mask]), expected_m]
            )
    return np.array(rows).reshape(-1, 3)
