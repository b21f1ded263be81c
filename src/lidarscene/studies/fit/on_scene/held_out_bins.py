"""What was found with a scene, held to columns that were not fitted: signal, kept or lost, scatter of the range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....maths.arrays import Numbers
from .known_scene import MOST_FIRED, STRONG, Prediction, predict
from .likelihood import FARTHEST_SQUARE, MEAN_SQUARE, OUTLIER, ParameterFit
from .pulses_on_scene import PulsesOnScene

RANGES, CHANCES = 8, 10
"""Bins of the range, with as many pulses each, and of the chance to be kept."""

LEAST = 50
"""Fewer pulses in a bin are not told, and nothing of `RANGES` times fewer on smooth surfaces: they stand on a few, and
the law of one that was simulated misses the others."""

LOG_SIGMA_OF_ONE = 0.75
"""Sigma of the logarithm of a scatter (`capped_scatter`), times the root of the number of pulses."""

NEAR_M = 0.3
"""A recorded return farther from the scene's surface is of another one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOutBins:
    """By bins of the pulses that were not fitted; the first column of each is what they are sorted by.

    signal   (k, 3) range [m], mean of the recorded signal, of the expected one
    kept_shares     (k, 3) chance that is expected, share that was kept, number of pulses
    scatter  (k, 4) signal, scatter of the recorded range [m], the expected one, sigma of the logarithm of their ratio:
             of so many pulses, and of the law, which is known no better than its parameters
    """

    signal: Numbers
    kept_shares: Numbers
    scatter: Numbers

    @property
    def signal_error(self) -> float | None:
        """Mean absolute error over the range, relative."""
        return float(np.mean(np.abs(self.signal[:, 2] / self.signal[:, 1] - 1.0))) if len(self.signal) else None

    @property
    def kept_error(self) -> float | None:
        """Mean absolute difference of the shares; all bins count alike, since nearly all pulses are in the last."""
        return (
            float(np.mean(np.abs(self.kept_shares[:, 0] - self.kept_shares[:, 1]))) if len(self.kept_shares) else None
        )

    @property
    def ratios(self) -> Numbers:
        """Recorded over expected scatter, by octave of the signal."""
        return np.asarray(self.scatter[:, 1] / self.scatter[:, 2])

    def beyond(self, most: float) -> bool:
        """Whether one of the ratios is above `most`, or below its inverse, by more than two of its sigmas.

        Of a ratio that is `most` chance says so in one of 40 bins; of one that is 1, in fewer than one of 1000.
        """
        return bool(np.any(np.abs(np.log(self.ratios)) > np.log(most) + 2.0 * self.scatter[:, 3]))


def judge(laid: PulsesOnScene, parameter_fit: ParameterFit) -> HeldOutBins:
    """Hold the sensor with these numbers to these pulses; their surfaces are as bright as they are believed to be."""
    prediction = predict(laid.scene, parameter_fit.values)
    strong = _strong_mask(laid, prediction)
    rows = []
    enough = strong.sum() >= LEAST * RANGES
    if enough:
        range_m = laid.scene.range_m[strong]
        edges = np.quantile(range_m, np.linspace(0.0, 1.0, RANGES + 1)[1:-1])
        bin_index = np.searchsorted(edges, range_m)
        columns = range_m, laid.reported.signal[strong], np.asarray(prediction.signal)[strong]
        rows = [[float(np.mean(values[bin_index == k])) for values in columns] for k in range(RANGES)]
    return HeldOutBins(
        signal=np.array(rows).reshape(-1, 3),
        kept_shares=_kept_shares(laid, prediction),
        scatter=_scatter(laid, prediction, strong, parameter_fit) if enough else np.zeros((0, 4)),
    )


def _strong_mask(laid: PulsesOnScene, prediction: Prediction) -> Numbers:
    """Mask of the pulses that are all kept, and of which the signal and the range are told."""
    finite = np.isfinite(laid.reported.signal) & np.isfinite(laid.reported.range_m)
    mask = (prediction.signal > STRONG * prediction.level) & (prediction.fired < MOST_FIRED) & finite
    return np.asarray(mask & (np.abs(np.nan_to_num(laid.reported.range_m) - laid.scene.range_m) < NEAR_M))


def _kept_shares(laid: PulsesOnScene, prediction: Prediction) -> Numbers:
    """Of the pulses whose signal is not far above the threshold."""
    weak = np.asarray(prediction.signal <= STRONG * prediction.level)
    chance, returned = np.asarray(prediction.chance)[weak], laid.reported.has_return[weak]
    bin_index = np.minimum((chance * CHANCES).astype(int), CHANCES - 1)
    rows = [
        [float(chance[bin_index == k].mean()), float(returned[bin_index == k].mean()), int((bin_index == k).sum())]
        for k in range(CHANCES)
        if (bin_index == k).sum() >= LEAST
    ]
    return np.array(rows).reshape(-1, 3)


def capped_scatter(relative: Numbers) -> float:
    """Standard deviation as the likelihood has it, in which what is far off counts no more.

    A median would say less where surfaces are not quite as they are believed to be: they are a tail, which is in the
    law that was fitted.
    """
    near = relative[np.abs(relative) < OUTLIER]
    return float(np.sqrt(np.mean(np.minimum(near * near, FARTHEST_SQUARE)) / MEAN_SQUARE))


def _scatter(laid: PulsesOnScene, prediction: Prediction, strong: Numbers, parameter_fit: ParameterFit) -> Numbers:
    signal = np.asarray(prediction.signal)[strong]
    relative = (laid.reported.range_m - laid.scene.range_m)[strong]
    octave = np.floor(np.log2(np.maximum(signal, 1.0))).astype(int)
    step = 1e-3
    sigma_m = np.asarray(prediction.sigma_m)[strong]
    moved_sigmas_m = [
        np.asarray(predict(laid.scene, {**parameter_fit.values, name: parameter_fit.values[name] + step}).sigma_m)[
            strong
        ]
        for name in parameter_fit.names
    ]
    slopes = [np.log(moved_m / sigma_m) / step for moved_m in moved_sigmas_m]
    covariances = parameter_fit.solved.covariance, parameter_fit.solved.bootstrap
    rows = []
    for number in np.unique(octave):
        mask = octave == number
        if mask.sum() >= LEAST:
            expected_m = float(np.median(sigma_m[mask]))
            slope = np.array([np.median(values[mask]) for values in slopes])
            variance = LOG_SIGMA_OF_ONE**2 / mask.sum() + max(
                float(slope @ covariance @ slope) for covariance in covariances
            )
            rows.append(
                [
                    2.0 ** (number + 0.5),
                    expected_m * capped_scatter(relative[mask] / sigma_m[mask]),
                    expected_m,
                    variance**0.5,
                ]
            )
    return np.array(rows).reshape(-1, 4)
