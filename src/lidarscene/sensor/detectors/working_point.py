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


@dataclass(frozen=True, slots=True, kw_only=True)
class CellMemory:
    """Parameters of a SiPM's memory of an echo, `physics.electronics.sipm_response.residual_busy`.

    free         cells that the background leaves ready
    rate_hz      rate at which the background fires a ready cell
    dead_time_s  time until a fired cell is ready again
    """

    free: Lanes
    rate_hz: Lanes
    dead_time_s: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Filtered:
    """Shares of signal and noise that pass an amplifier's frequency response (docs/theory_receivers.md 28).

    peak        share of a pulse's peak
    noise       share of the variance without echo
    echo_noise  share of the variance that the echo adds at its peak, before its peak is lowered
    cell        share of the height of a single cell
    """

    peak: Lanes
    noise: Lanes = 1.0
    echo_noise: Lanes = 1.0
    cell: Lanes = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkingPoint:
    """A detector under one background, per pulse.

    noise             sigma_0, standard deviation without echo: root of (18), or of (25) + (26)
    kappa_1, kappa_2  sigma(s)^2 = sigma_0^2 + kappa_1 s + kappa_2 s^2 at signal level s
    least_threshold   lowest threshold that can be set: one cell of a SiPM, 0 of an APD
    signal            optical peak power [W] to peak signal
    power_w           signal to the optical power that makes it
    cells, busy       cells of a SiPM that counts them exactly, and those busy; None where the noise is Gaussian
    saturation        signal at which the amplifier clips; None: nowhere
    recovery_s        time constant with which a clipped pulse drains; None: at once
    knee              amplitude above which a pulse's width gives its power better than its height; None: no such one
    largest           amplitude above which the height no longer depends on the power; None: no such one
    crossings_hz      threshold and bandwidth to crossings a second where Rice's formula for Gaussian noise does not
                      hold; None where it does
    unfiltered        the same before a matched filter; None without one
    noise_tail        threshold to P_f where (9) does not hold: McIntyre's for an APD, that of a filter over counted
                      photons; None for (9)
    echo_tail         threshold and signal to P_d where counts are not Gaussian; None: they are, or cells are counted
    level             threshold that follows the background by a law of its own; None: the converter sets it
    beyond_law        (threshold, signal) -> signal that an echo without neighbours needs above the threshold, and the
                      standard deviation of the threshold (None: sharp); None: neighbours play no part
    memory            memory of a SiPM whose cells are followed in time; None: earlier echoes leave no trace
    calibrated        point for which the sensor is calibrated, without residues of earlier echoes; None: this one
    """

    noise: Lanes
    kappa_1: Lanes
    kappa_2: Lanes
    least_threshold: Lanes
    signal: Callable[[Lanes], Lanes]
    power_w: Callable[[Lanes], Lanes]
    cells: Lanes | None = None
    busy: Lanes | None = None
    saturation: Lanes | None = None
    recovery_s: Lanes | None = None
    knee: Lanes | None = None
    largest: Lanes | None = None
    noise_tail: Callable[[Lanes], Lanes] | None = None
    crossings_hz: Callable[[Lanes, Lanes], Lanes] | None = None
    echo_tail: Callable[[Lanes, Lanes], Lanes] | None = None
    level: Lanes | None = None
    beyond_law: Callable[[Lanes, Lanes], tuple[Lanes, Lanes | None]] | None = None
    unfiltered: WorkingPoint | None = None
    memory: CellMemory | None = None
    calibrated: WorkingPoint | None = None

    def matched(self, noise_share: Lanes) -> WorkingPoint:
        """Working point behind a matched filter, which leaves the height of a lone pulse as it is (T78).

        noise_share  variance of white noise behind the filter over that before it
        """
        ratio = xp(noise_share).sqrt(noise_share)
        tail, crossings_hz = self.noise_tail, self.crossings_hz

        # The tail is taken at as many deviations as before. The filter adds up more electrons, so the true tail is
        # nearer to a Gaussian's.
        def same_multiple(threshold: Lanes) -> Lanes:
            assert tail is not None
            return tail(threshold / ratio)

        def same_multiple_hz(threshold: Lanes, bandwidth_hz: Lanes) -> Lanes:
            assert crossings_hz is not None
            return crossings_hz(threshold / ratio, bandwidth_hz)

        # Behind a filter no whole cells rise and fall: Rice's rate takes the place of theirs.
        counts_cells = self.largest is not None
        return replace(
            self,
            noise=self.noise * ratio,
            kappa_1=self.kappa_1 * sampling.SHOT_SHARE * noise_share,
            kappa_2=self.kappa_2 * sampling.SQUARE_SHARE * noise_share,
            noise_tail=None if tail is None else same_multiple,
            crossings_hz=None if crossings_hz is None or counts_cells else same_multiple_hz,
            unfiltered=self,
        )

    @property
    def exact(self) -> bool:
        """True if probabilities are those of counted cells rather than of a Gaussian."""
        return self.cells is not None

    def filtered(self, response: Filtered) -> WorkingPoint:
        """Working point behind an amplifier that filters signal and noise; clipping comes after the filter."""
        # Nothing but peaks passes here, so that a cell's response to light, which is not linear, comes first: what is
        # filtered is its signal. Numbers of cells are no longer whole, and count as Gaussian.
        cells = self.saturation is None
        return replace(
            self,
            noise=self.noise * xp(response.noise).sqrt(response.noise),
            kappa_1=self.kappa_1 * response.echo_noise / response.peak,
            kappa_2=self.kappa_2 * response.echo_noise / (response.peak * response.peak),
            least_threshold=self.least_threshold * response.cell,
            signal=lambda power_w: response.peak * self.signal(power_w),
            power_w=lambda signal: self.power_w(signal / response.peak),
            cells=None,
            busy=None,
            # Of cells that are no longer whole the law of their counts is void: Rice's takes its place.
            crossings_hz=self.crossings_hz if self.largest is None else None,
            knee=self.knee * response.peak if cells and self.knee is not None else self.knee,
            largest=None if self.largest is None else self.largest * response.peak,
        )

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

    def false_alarm_probability(self, threshold: Lanes) -> Lanes:
        """P_f of one comparison: (9), the exact binomial tail, or McIntyre's."""
        if self.noise_tail is not None:
            tail = self.noise_tail(threshold)
        elif self.cells is None or self.busy is None:
            tail = tdc.false_alarm_probability(threshold=threshold, noise=self.noise)
        else:
            tail = self._tail(threshold, self.cells, self.busy, self.busy / self.cells)
        return self.reachable(threshold, tail)

    def crossing_rate_hz(self, threshold: Lanes, bandwidth_hz: Lanes) -> Lanes:
        """Rate at which noise rises through the threshold, Hz: Rice's (T28a) or `crossings_hz`.

        bandwidth_hz  bandwidth of an ideal low-pass whose white noise has the same mean square frequency
        """
        if self.crossings_hz is not None:
            rate = self.crossings_hz(threshold, bandwidth_hz)
        else:
            rate = tdc.rice_rate_hz(threshold=threshold, noise=self.noise, bandwidth_hz=bandwidth_hz)
        return self.reachable(threshold, rate)

    def detection_probability(self, threshold: Lanes, signal: Lanes, sigma: Lanes) -> Lanes:
        """P_d of an echo whose peak is ``signal``, with noise ``sigma`` at the peak."""
        if self.echo_tail is not None:
            return self.echo_tail(threshold, signal)
        if self.cells is not None and self.busy is not None:
            return self._tail(threshold, self.cells, self.busy, (self.busy + signal) / self.cells)
        probability = tdc.detection_probability(signal=signal, threshold=threshold, noise_at_peak=sigma)
        return self.reachable(threshold, probability)

    @staticmethod
    def _tail(threshold: Lanes, cells: Lanes, busy: Lanes, share: Lanes) -> Lanes:
        """Probability of a count that lies ``threshold`` or more above the mean background."""
        return binomial_tail(least=least_count(threshold + busy), trials=cells, probability=share)


def least_count(level: Lanes) -> Lanes:
    """Least whole number of cells at or above a level."""
    # Rounding must not lift a count that just reaches the threshold above it: 1e-4 of a cell.
    return -xp(level).floor(-(level - 1e-4))
