"""Working point: noise, response and counts of a detector under one background, as the comparator needs them.

Its noise without echo, how the echo's own noise grows along the edge, and the response from optical power to signal and
back. Signals are amperes at the amplifier's input (APD) or fired cells (SiPM).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from ...maths.arrays import Lanes, xp
from ...maths.special import binomial_tail
from ...physics.electronics import sampling, saturation, tdc
from ...physics.electronics.sipm_edge import CountEdge, Passage


@dataclass(frozen=True, slots=True, kw_only=True)
class CellMemory:
    """Parameters of a SiPM's memory of an echo, `physics.electronics.sipm_response.residual_busy`.

    Attributes:
        cells: all of them
        free: those that the background leaves ready
        rate_hz: rate at which the background fires a ready cell
        dead_time_s: time until a fired cell is ready again
    """

    cells: Lanes
    free: Lanes
    rate_hz: Lanes
    dead_time_s: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Filtered:
    """Shares of signal and noise that pass an amplifier's frequency response (docs/theory_receivers.md 5).

    Attributes:
        peak: share of a pulse's peak
        noise: share of the variance without echo
        echo_noise: share of the variance that the echo adds at its peak, before its peak is lowered
        cell: share of the height of a single cell
        keeps_edge: whether a count rises as it does without the amplifier: behind a high pass
    """

    peak: Lanes
    noise: Lanes = 1.0
    echo_noise: Lanes = 1.0
    cell: Lanes = 1.0
    keeps_edge: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Noise of the signal, without echo and on its edge.

    Attributes:
        deviation: sigma_0, standard deviation without echo: root of (18), or of (25) + (26)
        kappa_1: sigma(s)^2 = sigma_0^2 + kappa_1 s + kappa_2 s^2 at signal level s
        kappa_2: sigma(s)^2 = sigma_0^2 + kappa_1 s + kappa_2 s^2 at signal level s
        tail: threshold to P_f where (9) does not hold: McIntyre's for an APD, that of a filter over counted photons;
            None for (9)
        echo_tail: threshold and signal to P_d where counts are not Gaussian; None: they are, or cells are counted
        crossings_hz: threshold, bandwidth and a rate below which 0 may stand for it to crossings a second where Rice's
            formula for Gaussian noise does not hold; None where it does
    """

    deviation: Lanes
    kappa_1: Lanes
    kappa_2: Lanes
    tail: Callable[[Lanes], Lanes] | None = None
    echo_tail: Callable[[Lanes, Lanes], Lanes] | None = None
    crossings_hz: Callable[[Lanes, Lanes, Lanes | None], Lanes] | None = None

    def at(self, signal: Lanes) -> Lanes:
        """Standard deviation sigma(s) at a signal level; (13), (T12) or (T20)."""
        return tdc.noise_at_level(level=signal, noise=self.deviation, kappa_1=self.kappa_1, kappa_2=self.kappa_2)

    def of_echo(self, signal: Lanes) -> Lanes:
        """Variance that an echo of this signal adds at its peak; none where its cells take more from the background."""
        return xp(signal).maximum(self.kappa_1 * signal + self.kappa_2 * signal * signal, 0.0)

    def crossing_level(self, threshold: Lanes, deviate: Lanes) -> Lanes:
        """Noiseless signal at which an edge with this standard normal deviate crosses the threshold (T25)."""
        return tdc.crossing_level(
            threshold=threshold, deviate=deviate, noise=self.deviation, kappa_1=self.kappa_1, kappa_2=self.kappa_2
        )

    def matched(self, noise_share: Lanes, *, of_cells: bool) -> Noise:
        """Noise behind a matched filter (T78); see `WorkingPoint.matched`.

        Args:
            of_cells: whether it is that of whole cells, which a filter leaves no longer whole
        """
        ratio = xp(noise_share).sqrt(noise_share)
        tail, crossings_hz = self.tail, self.crossings_hz

        # The tail is taken at as many deviations as before. The filter adds up more electrons, so the true tail is
        # nearer to a Gaussian's.
        def same_multiple(threshold: Lanes) -> Lanes:
            assert tail is not None
            return tail(threshold / ratio)

        def same_multiple_hz(threshold: Lanes, bandwidth_hz: Lanes, least_hz: Lanes | None) -> Lanes:
            assert crossings_hz is not None
            return crossings_hz(threshold / ratio, bandwidth_hz, least_hz)

        # Behind a filter no whole cells rise and fall: Rice's rate takes the place of theirs.
        return replace(
            self,
            deviation=self.deviation * ratio,
            kappa_1=self.kappa_1 * sampling.SHOT_SHARE * noise_share,
            kappa_2=self.kappa_2 * sampling.SQUARE_SHARE * noise_share,
            tail=None if tail is None else same_multiple,
            crossings_hz=None if crossings_hz is None or of_cells else same_multiple_hz,
        )

    def filtered(self, by: Filtered, *, of_cells: bool) -> Noise:
        """Noise behind an amplifier that filters; ``of_cells`` as for `matched`."""
        return replace(
            self,
            deviation=self.deviation * xp(by.noise).sqrt(by.noise),
            kappa_1=self.kappa_1 * by.echo_noise / by.peak,
            kappa_2=self.kappa_2 * by.echo_noise / (by.peak * by.peak),
            # Of cells that are no longer whole the law of their counts is void: Rice's takes its place.
            crossings_hz=None if of_cells else self.crossings_hz,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """Light to signal and back.

    Attributes:
        signal: optical peak power [W] to peak signal
        power_w: signal to the optical power that makes it
        saturation: signal at which the amplifier clips; None: nowhere
        recovery_s: time constant with which a clipped pulse drains; None: at once
        knee: amplitude above which a pulse's width gives its power better than its height; None: no such one
        largest: amplitude above which the height no longer depends on the power; None: no such one
    """

    signal: Callable[[Lanes], Lanes]
    power_w: Callable[[Lanes], Lanes]
    saturation: Lanes | None = None
    recovery_s: Lanes | None = None
    knee: Lanes | None = None
    largest: Lanes | None = None

    def measured(self, signal: Lanes) -> Lanes:
        """Clip a peak at the amplifier's saturation level."""
        if self.saturation is None:
            return signal
        return saturation.clip(signal=signal, saturation=self.saturation)

    def inferred_power_w(
        self, measured: Lanes, *, width_s: Lanes | None, threshold: Lanes, pulse_fwhm_s: Lanes
    ) -> Lanes:
        """Optical peak power that a sensor infers from an amplitude and, if it times both edges, the pulse's width.

        As a maker calibrates it, on flat targets of any reflectivity up to retro-reflectors.
        """
        if self.largest is not None:
            measured = xp(measured, self.largest).minimum(measured, self.largest)
        power = self.power_w(measured)
        if self.knee is None or width_s is None:
            return power
        by_width = self.power_of_width_w(width_s, threshold=threshold, pulse_fwhm_s=pulse_fwhm_s)
        return xp(measured, power).where(measured < self.knee, power, by_width)

    def power_of_width_w(self, width_s: Lanes, *, threshold: Lanes, pulse_fwhm_s: Lanes) -> Lanes:
        """Optical peak power of a lone pulse that stays above a threshold for so long."""
        if self.saturation is None or self.recovery_s is None:
            overdrive = saturation.overdrive_of_symmetric_width(width_s=width_s, fwhm_s=pulse_fwhm_s)
        else:
            overdrive = saturation.overdrive_of_width(
                width_s=width_s,
                level=threshold,
                saturation=self.saturation,
                fwhm_s=pulse_fwhm_s,
                recovery_s=self.recovery_s,
            )
        ops = xp(overdrive)
        return self.power_w(threshold) * ops.exp(ops.minimum(overdrive, saturation.LARGEST_OVERDRIVE))

    def reachable(self, threshold: Lanes, probability: Lanes) -> Lanes:
        """Set a probability or rate to 0 where the threshold is not below the level at which the amplifier clips."""
        if self.saturation is None:
            return probability
        return xp(threshold, probability).where(threshold < self.saturation, probability, 0.0)

    def filtered(self, by: Filtered) -> Response:
        """Response behind an amplifier that filters the signal; clipping comes after the filter."""
        of_cells = self.saturation is None
        return replace(
            self,
            signal=lambda power_w: by.peak * self.signal(power_w),
            power_w=lambda signal: self.power_w(signal / by.peak),
            knee=self.knee * by.peak if of_cells and self.knee is not None else self.knee,
            largest=None if self.largest is None else self.largest * by.peak,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class CellCounts:
    """Cells of a SiPM that counts them exactly, and those that the background keeps busy."""

    cells: Lanes
    busy: Lanes

    def tail(self, threshold: Lanes, signal: Lanes = 0.0) -> Lanes:
        """Probability of a count that lies ``threshold`` or more above the mean background, with ``signal`` cells."""
        share = (self.busy + signal) / self.cells
        return binomial_tail(least=least_count(threshold + self.busy), trials=self.cells, probability=share)


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdLaw:
    """Threshold that follows the background by a special law.

    Attributes:
        level: median over points, signal
        lone: (threshold, signal) -> how far the neighbours of an echo lack it, from 0, as on a surface, to 1, alone
    """

    level: Lanes
    lone: Callable[[Lanes, Lanes], Lanes]


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkingPoint:
    """A detector under one background, per pulse.

    Attributes:
        counts: of a SiPM that counts cells exactly; None where the noise is Gaussian
        least_threshold: lowest threshold that can be set: one cell of a SiPM, 0 of an APD
        law: of the threshold; None: the converter sets it
        memory: memory of a SiPM whose cells are followed in time; None: earlier echoes leave no trace
        edge: edge of its count; None: the signal follows the light, and is compared at its peak
        unfiltered: the same before a matched filter; None without one
        calibrated: point for which the sensor is calibrated, without residues of earlier echoes; None: this one
    """

    noise: Noise
    response: Response
    counts: CellCounts | None = None
    least_threshold: Lanes = 0.0
    law: ThresholdLaw | None = None
    memory: CellMemory | None = None
    edge: CountEdge | None = None
    unfiltered: WorkingPoint | None = None
    calibrated: WorkingPoint | None = None

    @property
    def _of_cells(self) -> bool:
        return self.response.largest is not None

    def matched(self, noise_share: Lanes) -> WorkingPoint:
        """Working point behind a matched filter, which leaves the height of a lone pulse as it is (T78).

        Args:
            noise_share: variance of white noise behind the filter over that before it
        """
        noise = self.noise.matched(noise_share, of_cells=self._of_cells)
        return replace(self, noise=noise, edge=None, unfiltered=self)

    def filtered(self, by: Filtered) -> WorkingPoint:
        """Working point behind an amplifier that filters signal and noise; clipping comes after the filter."""
        # Nothing but peaks passes here, so that a cell's response to light, which is not linear, comes first: what is
        # filtered is its signal. Numbers of cells are no longer whole, and count as Gaussian.
        return replace(
            self,
            noise=self.noise.filtered(by, of_cells=self._of_cells),
            response=self.response.filtered(by),
            counts=None,
            edge=self.edge if by.keeps_edge else None,
            least_threshold=self.least_threshold * by.cell,
        )

    def snr(self, signal: Lanes) -> Lanes:
        """Signal-to-noise ratio of a peak, (11): the noise is that without an echo; (19) or (27)."""
        return tdc.signal_to_noise(signal=signal, noise=self.noise.deviation)

    def false_alarm_probability(self, threshold: Lanes) -> Lanes:
        """P_f of one comparison: (9), the exact binomial tail, or McIntyre's."""
        if self.noise.tail is not None:
            tail = self.noise.tail(threshold)
        elif self.counts is None:
            tail = tdc.false_alarm_probability(threshold=threshold, noise=self.noise.deviation)
        else:
            tail = self.counts.tail(threshold)
        return self.response.reachable(threshold, tail)

    def crossing_rate_hz(self, threshold: Lanes, bandwidth_hz: Lanes, least_hz: Lanes | None = None) -> Lanes:
        """Rate at which noise rises through the threshold, Hz: Rice's (T28a) or the noise's own.

        Args:
            bandwidth_hz: bandwidth of an ideal low-pass whose white noise has the same mean square frequency
            least_hz: rate below which 0 may stand for it; None: none
        """
        if self.noise.crossings_hz is not None:
            rate = self.noise.crossings_hz(threshold, bandwidth_hz, least_hz)
        else:
            rate = tdc.rice_rate_hz(threshold=threshold, noise=self.noise.deviation, bandwidth_hz=bandwidth_hz)
        return self.response.reachable(threshold, rate)

    def detection_probability(self, threshold: Lanes, signal: Lanes, sigma: Lanes) -> Lanes:
        """P_d of an echo whose peak is ``signal``, with noise ``sigma`` at the peak."""
        passage = self.passage(threshold, signal, sigma)
        return self._probability_at_peak(threshold, signal, sigma) if passage is None else passage.ever

    def passage(self, threshold: Lanes, signal: Lanes, sigma: Lanes) -> Passage | None:
        """Passages of the threshold by a count that is followed in time; None of any other signal."""
        if self.edge is None:
            return None
        at_peak = self._probability_at_peak(threshold, signal, sigma)
        return self.edge.passage(at_peak, threshold=threshold, signal=signal, sigma=sigma)

    def _probability_at_peak(self, threshold: Lanes, signal: Lanes, sigma: Lanes) -> Lanes:
        """Probability that the signal is above the threshold at its peak."""
        if self.noise.echo_tail is not None:
            return self.noise.echo_tail(threshold, signal)
        if self.counts is not None:
            return self.counts.tail(threshold, signal)
        probability = tdc.detection_probability(signal=signal, threshold=threshold, noise_at_peak=sigma)
        return self.response.reachable(threshold, probability)


def least_count(level: Lanes) -> Lanes:
    """Least whole number of cells at or above a level."""
    # Rounding must not lift a count that just reaches the threshold above it: 1e-4 of a cell.
    return -xp(level).floor(-(level - 1e-4))
