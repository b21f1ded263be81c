"""Expectation: photons, P_d and threshold of the peaks of the expected light behind the filter.

The expected histogram after the filter is a sum of broadened echoes, so all of this has a closed form
(docs/photon_counting.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ...light.echoes import EchoTrain
from ...light.waveform import Waveform
from ...maths.arrays import Array, Lanes, Mask, Ops, xp
from ...physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ...physics.optics import scintillation
from ...physics.photon_counting import dead_time, matched_filter, valleys
from ...sensor.detectors import WorkingPoint
from ...sensor.detectors.macropixel import PLACES, Macropixel
from ...sensor.sensor_model import Sensor
from ..shots import Shots
from .tuning import MERGED, RETURNING, SURE


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """Expectation of a peak; each field (n,).

    Attributes:
        snr: its value over the noise without an echo
        probability: P_d
        level: median of its threshold, in photons
        lone: how far its neighbours lack it (`sensor.detectors.working_point.ThresholdLaw`)
        peaks: mean number of peaks there, a factor of the probability
    """

    snr: Lanes
    probability: Lanes
    level: Lanes
    lone: Lanes
    peaks: Lanes = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FilteredLight(Shots):
    """Light of n pulses, as it is expected in the histogram and behind its filter.

    Attributes:
        train: their light, folded into the unambiguous range
        folds_m: range by which each sub-echo of a surface was folded, (n,) each; None: nothing folds
        light: expected light as wide as in the histogram
        filtered: expected light as wide as behind the filter
        pixel: SPADs under the background, as they are where their number does not depend on the range
        level: (n,) median threshold of `point`, which is that of `pixel`
        deviate: (n,) standard normal number of the point, which scatters its thresholds
    """

    train: EchoTrain
    folds_m: Sequence[Lanes] | None
    light: Waveform
    filtered: Waveform
    pixel: Macropixel
    level: Lanes
    deviate: Lanes

    @property
    def ops(self) -> Ops:
        """Array functions of the arrays' kind, NumPy's or Dr.Jit's."""
        return xp(self.light.origin_m)

    @property
    def has_several(self) -> bool:
        """True if the light may have more than one peak."""
        return len(self.filtered.centres) > 1 or self.filtered.volume is not None

    def pixel_at(self, range_m: Lanes) -> Macropixel:
        """SPADs at this range, (n,): those that fire once in a shot become fewer."""
        if not self.pixel.spad.fires_once:
            return self.pixel
        return self.sensor.pixel(self.train.background_power_w, range_m=range_m)

    def point_at(self, range_m: Lanes) -> WorkingPoint:
        """Working point at this range, (n,)."""
        if not self.pixel.spad.fires_once:
            return self.point
        return self.sensor.working_point(self.train.background_power_w, range_m=range_m)

    def lone_w(self, power_w: Lanes) -> Lanes:
        """Peak power of the lone laser pulse that gives this filtered power: the argument of the working point."""
        return power_w * (self.filtered.fwhm_s / self.sensor.laser.pulse_fwhm_s)

    def signal(self, point: WorkingPoint, power_w: Lanes) -> Lanes:
        """Photons of a peak of the light behind the filter, (n,)."""
        return point.response.signal(self.lone_w(power_w))

    def expect(self, place: Lanes, power_w: Lanes, *, part: Lanes | None = None) -> Expected:
        """Expectation of a peak of the light behind the filter, (n,).

        Args:
            part: its height over that of an echo of this power alone; None: by the light before it, to first order
        """
        point, level = self.point_at(self.filtered.range_m(place)), self.level
        assert point.law is not None
        signal = self.signal(point, power_w)
        shadow: Lanes = self._shadow(place, signal) if part is None else 0.0
        share: Lanes = 1.0 if part is None else part
        signal = share * signal
        broad = level - self._gain_of_breadth(point, place, power_w) + shadow
        if self.fluctuation is None:
            probability, lone = self._chances(point, broad, signal)
        else:
            lone = point.law.lone(broad, signal)
            # The threshold is that of the light that comes, P_d is the mean over all light that may come.
            mean_w = power_w / self.fluctuation.relative_power
            signal = share * self.signal(point, mean_w)
            mean_level = level - self._gain_of_breadth(point, place, mean_w) + shadow

            def probability_of(relative_power: Lanes) -> Lanes:
                return point.detection_probability(mean_level, share * self.signal(point, mean_w * relative_power), 0.0)

            probability = scintillation.mean(probability_of, self.fluctuation.variance)
        return Expected(snr=point.snr(signal), probability=probability, level=level, lone=lone)

    def expect_shaded(
        self, place: Lanes, power_w: Lanes, expected: Expected, *, value: Lanes, shaded: Mask
    ) -> Expected:
        """Expectation of a peak whose SPADs earlier light has fired, or that are back; of others ``expected``.

        Before the bins are drawn it is known to first order only (`_shadow`).

        Args:
            value: (n,) mean of the filter's value at the peak
            shaded: (n,) bool, whether the peak is such a one
        """
        ops = self.ops

        def expect() -> Expected:
            range_m = self.filtered.range_m(place)
            alone = self.signal(self.point_at(range_m), power_w)
            height = self.pixel_at(range_m).peak(alone).height
            part = ops.maximum(value, 0.0) / ops.maximum(height, 1e-6)
            dimmed = self.expect(place, power_w, part=part)
            return replace(
                dimmed,
                probability=dimmed.probability * expected.peaks,
                level=dimmed.level + ops.full(place, 0.0),
                peaks=expected.peaks + ops.full(place, 0.0),
            )

        zero = ops.full(place, 0.0)
        same = replace(expected, level=expected.level + zero, peaks=expected.peaks + zero)
        return ops.where_any(shaded, expect, same)

    def _chances(self, point: WorkingPoint, threshold: Lanes, signal: Lanes) -> tuple[Lanes, Lanes]:
        """P_d of an echo, and how far its neighbours lack it, (n,) each."""
        assert point.law is not None
        ops, law, noise, histogram = self.ops, point.law, point.noise, self.sensor.histogram
        assert histogram is not None

        def compute() -> tuple[Array, Array]:
            zero = ops.full(signal, 0.0)
            return zero + point.detection_probability(threshold, signal, 0.0), zero + law.lone(threshold, signal)

        # Most echoes are sure, or there is none: packets of such lanes skip half a dozen tails.
        highest = threshold
        if histogram.threshold_spread is not None:
            highest = threshold * xp(histogram.threshold_spread).exp(PLACES[-1][0] * histogram.threshold_spread)
        deviation = ops.sqrt(noise.deviation * noise.deviation + noise.kappa_1 * signal)
        sure = signal - highest > SURE * deviation
        certain = ops.where(sure, 1.0, 0.0)
        return ops.where_any(~sure & (signal > 0.0), compute, (certain, 1.0 - certain))

    def _gain_of_breadth(self, point: WorkingPoint, place: Lanes, power_w: Lanes) -> Lanes:
        """Photons that noise gains on the broad peak of echoes that merge behind the filter, (n,) (T98a)."""
        if not self.has_several:
            return 0.0
        ops, signal = self.ops, self.signal(point, power_w)
        return matched_filter.gain_of_breadth(
            signal=signal,
            background=point.noise.deviation * point.noise.deviation,
            signal_variance=point.noise.of_echo(signal),
            bend=self.filtered.at(place)[2] / ops.maximum(power_w, 1e-30),
        )

    def _shadow(self, place: Lanes, signal: Lanes) -> Lanes:
        """Photons of a peak and its background that SPADs fired by nearer echoes miss, (n,) (T168)."""
        pixel = self.pixel
        if not self.has_several or not pixel.shades:
            return 0.0
        ops, wave = self.ops, self.filtered
        before: Lanes = 0.0
        for centre, height in zip(wave.centres, wave.heights, strict=True):
            since = (place - centre) * matched_filter.OUTPUT_WIDTH
            # The shadow that an echo casts on itself is in its own height. SPADs that come back while the light lasts
            # meet part of it: how many do the drawn bins say.
            blind = (since > MERGED * matched_filter.OUTPUT_WIDTH) & (since < pixel.blind_sigmas - RETURNING)
            before = before + ops.where(blind, height * ops.exp(-pixel.sun * ops.maximum(since, 0.0)), 0.0)
        fired = dead_time.firing_share(detections=pixel.detections(self.lone_w(before)))
        background = pixel.count_rate_hz * pixel.sigma_s * (matched_filter.SCALE * valleys.TEMPLATE_AREA)
        return fired * (signal + background)


def broaden(train: EchoTrain, sensor: Sensor, sigma_s: Lanes) -> tuple[EchoTrain, Sensor]:
    """Widen the echoes to ``sigma_s`` at constant energy; returns the light and a sensor with a pulse of that width."""
    ratio = sensor.laser.pulse_fwhm_s / (SIGMAS_PER_FWHM * sigma_s)
    parts = tuple(replace(part, peak_power_w=part.peak_power_w * ratio) for part in train.parts)
    laser = replace(sensor.laser, pulse_fwhm_s=SIGMAS_PER_FWHM * sigma_s)
    return replace(train, parts=parts), replace(sensor, laser=laser)
