"""Detectors as data, and the working point that a background puts them in.

A `WorkingPoint` is all that the comparator needs to know of a detector: its noise without echo, how the
echo's own noise grows along the edge, and the response from optical power to signal and back.
Signals are amperes at the amplifier's input (APD) or fired cells (SiPM).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from ..maths.arrays import Lanes, xp
from ..maths.special import binomial_tail
from ..maths.units import Key, Quantity
from ..physics.constants import ELEMENTARY_CHARGE_C
from ..physics.electronics import apd, counting, mcintyre, sampling, saturation, sipm, sipm_response, tdc


@dataclass(frozen=True, slots=True, kw_only=True)
class CellMemory:
    """What decides how long a SiPM remembers an echo, `physics.electronics.sipm_response.left_busy`.

    free     cells that the background leaves ready
    rate_hz  at which it fires a ready cell
    """

    free: Lanes
    rate_hz: Lanes
    dead_time_s: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Filtered:
    """What an amplifier's frequency response leaves of a detector's signal and noise (docs/theory.md 28).

    peak        of a pulse's peak
    noise       of the variance without echo
    echo_noise  of the variance that the echo adds at its peak, before its peak is lowered
    cell        of the height of a single cell
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
    least_threshold   below this the comparator cannot be set: one cell of a SiPM, 0 of an APD
    signal            optical peak power [W] to peak signal
    power_w           signal to the optical power that makes it
    cells, busy       of a SiPM whose cells are counted exactly; None where the noise is Gaussian
    saturation        signal at which the amplifier clips; None: nowhere
    recovery_s        with which a clipped pulse drains; None: at once
    knee              amplitude from which a pulse's width tells its power better than its height; None: none
    largest           amplitude above which the height tells no power at all; None: none
    crossings_hz      threshold and bandwidth to crossings a second where Rice's formula for Gaussian noise does not
                      hold; None where it does
    unfiltered        the same before a matched filter; None without one
    noise_tail        threshold to P_f where (9) does not hold: McIntyre's for an APD, that of a filter over counted
                      photons; None for (9)
    echo_tail         threshold and signal to P_d where counts are not Gaussian; None: they are, or cells are counted
    level             threshold that follows the background by a law of its own; None: the converter sets it
    memory            of a SiPM whose cells are followed in time; None: every echo finds the detector as the first does
    calibrated        the point that the sensor takes this one for, with an earlier echo forgotten; None: itself
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
    unfiltered: WorkingPoint | None = None
    memory: CellMemory | None = None
    calibrated: WorkingPoint | None = None

    def matched(self, noise_share: Lanes) -> WorkingPoint:
        """The same detector behind a matched filter, which leaves the height of a lone pulse as it is (T78).

        noise_share  variance of white noise behind the filter over that before it
        """
        ratio = xp(noise_share).sqrt(noise_share)
        tail, crossings_hz = self.noise_tail, self.crossings_hz

        # Of as many deviations: the filter adds up more electrons, whose tail is nearer to a Gaussian's.
        def same_multiple(threshold: Lanes) -> Lanes:
            assert tail is not None
            return tail(threshold / ratio)

        def same_multiple_hz(threshold: Lanes, bandwidth_hz: Lanes) -> Lanes:
            assert crossings_hz is not None
            return crossings_hz(threshold / ratio, bandwidth_hz)

        return replace(
            self,
            noise=self.noise * ratio,
            kappa_1=self.kappa_1 * sampling.SHOT_SHARE * noise_share,
            kappa_2=self.kappa_2 * sampling.SQUARE_SHARE * noise_share,
            noise_tail=None if tail is None else same_multiple,
            crossings_hz=None if crossings_hz is None else same_multiple_hz,
            unfiltered=self,
        )

    @property
    def exact(self) -> bool:
        """Whether probabilities are those of counted cells rather than of a Gaussian."""
        return self.cells is not None

    def filtered(self, by: Filtered) -> WorkingPoint:
        """The same detector behind an amplifier that filters signal and noise; clipping comes after the filter."""
        # Nothing but peaks passes here, so that a cell's response to light, which is not linear, comes first: what is
        # filtered is its signal. Numbers of cells are no longer whole, and count as Gaussian.
        cells = self.saturation is None
        return replace(
            self,
            noise=self.noise * xp(by.noise).sqrt(by.noise),
            kappa_1=self.kappa_1 * by.echo_noise / by.peak,
            kappa_2=self.kappa_2 * by.echo_noise / (by.peak * by.peak),
            least_threshold=self.least_threshold * by.cell,
            signal=lambda power_w: by.peak * self.signal(power_w),
            power_w=lambda signal: self.power_w(signal / by.peak),
            cells=None,
            busy=None,
            # Of cells that are no longer whole the law of their counts is void: Rice's takes its place.
            crossings_hz=self.crossings_hz if self.largest is None else None,
            knee=self.knee * by.peak if cells and self.knee is not None else self.knee,
            largest=None if self.largest is None else self.largest * by.peak,
        )

    def measured(self, signal: Lanes) -> Lanes:
        """A peak as the amplifier passes it on."""
        if self.saturation is None:
            return signal
        return saturation.clipped(signal=signal, saturation=self.saturation)

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
                width_s=width_s, level=threshold, saturation=self.saturation, fwhm_s=pulse_fwhm_s,
                recovery_s=self.recovery_s,
            )  # fmt: skip
        ops = xp(overdrive)
        return self.power_w(threshold) * ops.exp(ops.minimum(overdrive, saturation.LARGEST_OVERDRIVE))

    def reachable(self, threshold: Lanes, probability: Lanes) -> Lanes:
        """A probability of tripping the comparator: none where its level is not below where the amplifier clips."""
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
        """How often a second noise of this bandwidth rises through the threshold: Rice's (T28a) or `crossings_hz`."""
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
        found = tdc.detection_probability(signal=signal, threshold=threshold, noise_at_peak=sigma)
        return self.reachable(threshold, found)

    @staticmethod
    def _tail(threshold: Lanes, cells: Lanes, busy: Lanes, share: Lanes) -> Lanes:
        """Probability of a count that lies ``threshold`` or more above the mean background."""
        return binomial_tail(least=_least_count(threshold + busy), trials=cells, probability=share)


def _least_count(level: Lanes) -> Lanes:
    """The least whole number of cells at or above a level."""
    # Rounding must not lift a count that just reaches the threshold above it: 1e-4 of a cell.
    return -xp(level).floor(-(level - 1e-4))


@dataclass(frozen=True, slots=True, kw_only=True)
class Apd:
    """Linear-mode avalanche photodiode and its amplifier, (12)-(19). SI units; currents before gain.

    tail          of false alarms: "gaussian" (9), or "mcintyre" (`electronics.mcintyre`), whose variance is the same
                  and whose upper tail is higher; detection is Gaussian with either
    saturation_a  at the amplifier's input (`physics.electronics.saturation`)
    """

    gain: Annotated[Lanes, Quantity(ge=1, le=1e5)]
    radius_m: Annotated[Lanes, Quantity("mm", ge=1e-3, le=100)]
    quantum_efficiency: Annotated[Lanes, Quantity(gt=0, le=1)]
    surface_dark_current_a: Annotated[Lanes, Quantity("na", ge=0, le=1e6, finest=1e-6)]
    bulk_dark_current_a: Annotated[Lanes, Quantity("na", ge=0, le=1e6, finest=1e-6)]
    excess_noise_index: Annotated[Lanes | None, Quantity(ge=0, le=10)] = None
    ionisation_ratio: Annotated[Lanes | None, Quantity(ge=0, le=1)] = None
    load_resistance_ohm: Annotated[Lanes, Quantity(ge=0.01, le=1e12)]
    temperature_k: Annotated[Lanes, Quantity(ge=1, le=1e4)] = 300.0
    circuit_noise_a: Annotated[Lanes, Quantity("na", ge=0, le=1e6, finest=1e-6)] = 0.0
    tail: Annotated[Literal["gaussian", "mcintyre"], Key()] = "gaussian"
    saturation_a: Annotated[
        Lanes | None,
        Quantity(
            "ua",
            ge=0.01,
            le=1e6,
            about="current at which the amplifier clips, after multiplication; never if left out",
        ),
    ] = None
    recovery_s: Annotated[
        Lanes | None,
        Quantity(
            "ns", ge=0.01, le=1e5, about="with saturation_ua: time constant with which a clipped pulse drains"
        ),
    ] = None

    @property
    def saturates(self) -> bool:
        """Whether strong echoes lose their height."""
        return self.saturation_a is not None

    @property
    def excess_noise(self) -> Lanes:
        """F of (14): McIntyre's if an ionisation ratio is given, else M^x."""
        if self.ionisation_ratio is not None:
            return apd.excess_noise_mcintyre(gain=self.gain, ionisation_ratio=self.ionisation_ratio)
        assert self.excess_noise_index is not None
        return apd.excess_noise_power_law(gain=self.gain, index=self.excess_noise_index)

    def unmultiplied_variance_a2(self, bandwidth_hz: Lanes) -> Lanes:
        """What of (18) the avalanche does not multiply: surface dark current, load and circuit."""
        surface = apd.dark_shot_variance_a2(
            surface_dark_current_a=self.surface_dark_current_a, bulk_dark_current_a=0.0, gain=1.0,
            excess_noise=1.0, bandwidth_hz=bandwidth_hz,
        )  # fmt: skip
        thermal = apd.thermal_variance_a2(
            temperature_k=self.temperature_k, load_resistance_ohm=self.load_resistance_ohm,
            bandwidth_hz=bandwidth_hz,
        )  # fmt: skip
        return surface + thermal + self.circuit_noise_a * self.circuit_noise_a

    def background_counts(self, *, background_power_w: Lanes, photon_energy_j: Lanes) -> tuple[Lanes, Lanes]:
        """Electrons that the avalanche multiplies in a second, light and dark, and the narrowing of their noise."""
        light = counting.detected_photons_hz(
            power_w=background_power_w, efficiency=self.quantum_efficiency, photon_energy_j=photon_energy_j
        )
        return light + self.bulk_dark_current_a / ELEMENTARY_CHARGE_C, 1.0

    def working_point(
        self, *, background_power_w: Lanes, photon_energy_j: Lanes, bandwidth_hz: Lanes, pulse_fwhm_s: Lanes
    ) -> WorkingPoint:
        """Noise (18) and response (12) under this background; the pulse width plays no part."""
        excess = self.excess_noise
        responsivity = apd.responsivity_a_w(
            quantum_efficiency=self.quantum_efficiency, photon_energy_j=photon_energy_j
        )
        avalanche = {"gain": self.gain, "excess_noise": excess, "bandwidth_hz": bandwidth_hz}
        primary = responsivity * background_power_w + self.bulk_dark_current_a
        multiplied = self.gain * primary * apd.shot_variance_per_ampere_a(**avalanche)
        rest = self.unmultiplied_variance_a2(bandwidth_hz)
        variance = multiplied + rest

        electrons = {**avalanche, "primary_current_a": primary, "unmultiplied_variance_a2": rest}

        def mcintyre_tail(threshold: Lanes) -> Lanes:
            return mcintyre.false_alarm_probability(threshold_a=threshold, **electrons)

        def mcintyre_crossings_hz(threshold: Lanes, _: Lanes) -> Lanes:
            return mcintyre.crossing_rate_hz(threshold_a=threshold, **electrons)

        ampere_per_watt = responsivity * self.gain
        return WorkingPoint(
            noise=xp(variance).sqrt(variance),
            kappa_1=apd.shot_variance_per_ampere_a(**avalanche),
            kappa_2=0.0,
            least_threshold=0.0,
            signal=lambda power_w: ampere_per_watt * power_w,
            power_w=lambda signal: signal / ampere_per_watt,
            saturation=self.saturation_a,
            recovery_s=self.recovery_s,
            knee=self.saturation_a,
            noise_tail=mcintyre_tail if self.tail == "mcintyre" else None,
            crossings_hz=mcintyre_crossings_hz if self.tail == "mcintyre" else None,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Sipm:
    """Silicon photomultiplier, (21)-(27). SI units.

    statistics   "time_domain": busy cells in steady state, signal from the cells' course in time through a table,
                 see `physics.electronics.sipm_response`; "steady_state": the same noise, but (24)'s half pulse;
                 "published": (23)-(27) as printed, see `physics.electronics.sipm`
    counting     "gaussian" (9) or "binomial": exact counts of cells for false alarms and detection, which
                 matter where the background fires few cells
    cell_floor   least threshold in cells: 1, since a comparator cannot see less than one cell; 0 to
                 reproduce the paper's Fig. 6
    crosstalk, afterpulse  shares of the avalanches that cause another; None: no such thing. Not with "published", nor
                 with counts of independent cells ("binomial")
    """

    cells: Annotated[Lanes, Quantity(ge=1, le=1e9, whole=True)]
    radius_m: Annotated[Lanes, Quantity("mm", ge=1e-3, le=100)]
    pde: Annotated[Lanes, Quantity(gt=0, le=1)]
    dead_time_s: Annotated[Lanes, Quantity("ns", ge=0.01, le=1e5)]
    dark_count_rate_hz: Annotated[Lanes, Quantity(ge=0, le=1e9, about="of each cell")]
    cell_floor: Annotated[Lanes, Quantity(ge=0, le=1e5)] = 1.0
    statistics: Annotated[Literal["steady_state", "published", "time_domain"], Key()] = "time_domain"
    counting: Annotated[Literal["gaussian", "binomial"], Key()] = "gaussian"
    crosstalk: Annotated[
        Lanes | None,
        Quantity(ge=0, le=0.5, about="share of avalanches that fire another cell at once; none if left out"),
    ] = None
    afterpulse: Annotated[
        Lanes | None,
        Quantity(
            ge=0,
            le=0.5,
            about="with afterpulse_ns: share of avalanches that fire their own cell again; none if left out",
        ),
    ] = None
    afterpulse_s: Annotated[
        Lanes | None,
        Quantity("ns", ge=0.01, le=1e5, about="with afterpulse: mean delay of afterpulses, exponential"),
    ] = None

    @property
    def saturates(self) -> bool:
        """Always: there are only so many cells."""
        return True

    def background_counts(self, *, background_power_w: Lanes, photon_energy_j: Lanes) -> tuple[Lanes, Lanes]:
        """Cells that fire in a second, light and dark, and the narrowing of their noise by the dead time."""
        busy = self._busy_share(
            sipm.background_photons(
                power_w=background_power_w, dead_time_s=self.dead_time_s, photon_energy_j=photon_energy_j
            )
        )
        rate = counting.fired_cells_hz(busy_share=busy, cells=self.cells, dead_time_s=self.dead_time_s)
        return rate, (1.0 - busy) * self._clusters(busy)

    def working_point(
        self, *, background_power_w: Lanes, photon_energy_j: Lanes, bandwidth_hz: Lanes, pulse_fwhm_s: Lanes
    ) -> WorkingPoint:
        """Noise, free cells and response under this background; the bandwidth is that of the dead time."""
        photons = sipm.background_photons(
            power_w=background_power_w, dead_time_s=self.dead_time_s, photon_energy_j=photon_energy_j
        )
        published = self.statistics == "published"
        noise_state = self._published_state(photons) if published else self._steady_state(photons)
        variance, free_cells, kappa_1, kappa_2 = noise_state
        busy_share = 1.0 - free_cells / self.cells
        share_of = sipm.fired_share_published if published else sipm.fired_share
        photons_of = sipm.photons_for_share_published if published else sipm.photons_for_share
        at_peak, before_peak = self._in_time(busy_share, pulse_fwhm_s)
        memory = None
        if self.statistics == "time_domain":
            rate_hz = self._refill(busy_share) / self.dead_time_s
            memory = CellMemory(free=free_cells, rate_hz=rate_hz, dead_time_s=self.dead_time_s)

        cells = {"pde": self.pde, "cells": self.cells}

        def signal(power_w: Lanes) -> Lanes:
            arriving = sipm.signal_photons(
                peak_power_w=power_w, pulse_fwhm_s=pulse_fwhm_s, photon_energy_j=photon_energy_j
            )
            return free_cells * share_of(photons=at_peak(arriving), **cells)

        def power_w(level: Lanes) -> Lanes:
            arriving = photons_of(share=level / free_cells, **cells)
            return 2.0 * before_peak(arriving) * photon_energy_j / pulse_fwhm_s

        def crossings_hz(threshold: Lanes, _: Lanes) -> Lanes:
            busy = self.cells - free_cells
            return counting.upcrossings_hz(
                least=_least_count(threshold + busy), cells=self.cells, busy_share=busy / self.cells,
                dead_time_s=self.dead_time_s,
            )  # fmt: skip

        return WorkingPoint(
            noise=xp(variance).sqrt(variance), kappa_1=kappa_1, kappa_2=kappa_2, crossings_hz=crossings_hz,
            least_threshold=self.cell_floor, signal=signal, power_w=power_w,
            cells=self.cells if self.counting == "binomial" else None, busy=self.cells - free_cells,
            knee=sipm.MOST_TELLING_SHARE * free_cells,
            largest=free_cells - 0.5, memory=memory,
        )  # fmt: skip

    def _refill(self, busy_share: Lanes) -> Lanes:
        """Rate per dead time at which the background takes back a change of the ready cells: x, more with crosstalk.

        Firings of the ready share f go as f / (1 - p f), whose slope is 1 / (1 - p f) of their ratio.
        """
        ready = 1.0 - busy_share
        steeper = 1.0 if self.crosstalk is None else 1.0 - self.crosstalk * ready
        return busy_share / (ready * steeper)

    def captured(self, pulse_fwhm_s: Lanes) -> Lanes:
        """Photons that can be busy cells at the peak over those that (24) counts, half a pulse's."""
        if self.statistics != "time_domain":
            return 1.0
        return sipm_response.captured_photons(
            photons=1.0, pulse_fwhm_s=pulse_fwhm_s, dead_time_s=self.dead_time_s
        )

    def _in_time(
        self, busy_share: Lanes, pulse_fwhm_s: Lanes
    ) -> tuple[Callable[[Lanes], Lanes], Callable[[Lanes], Lanes]]:
        """From photons of (24) to those that count at the peak, and back: with crosstalk, then in time."""
        crosstalk = self.crosstalk
        cells, refill = {"pde": self.pde, "cells": self.cells}, self._refill(busy_share)
        state = {
            "busy_share": refill / (1.0 + refill),
            "pulse_to_dead_time": pulse_fwhm_s / self.dead_time_s,
            **cells,
        }
        in_time, captured = self.statistics == "time_domain", self.captured(pulse_fwhm_s)

        def at_peak(photons: Lanes) -> Lanes:
            photons = photons * captured
            if crosstalk is not None:
                photons = sipm.with_crosstalk(
                    photons=photons, ready_share=1.0 - busy_share, crosstalk=crosstalk, **cells
                )
            return sipm_response.peak_photons(photons=photons, **state) if in_time else photons

        def before_peak(photons: Lanes) -> Lanes:
            if in_time:
                photons = sipm_response.captured_for_peak(photons=photons, **state)
            if crosstalk is not None:
                photons = sipm.without_crosstalk(
                    photons=photons, ready_share=1.0 - busy_share, crosstalk=crosstalk, **cells
                )
            return photons / captured

        return at_peak, before_peak

    def _published_state(self, photons: Lanes) -> tuple[Lanes, Lanes, Lanes, Lanes]:
        """Variance (25) + (26), free cells of (24), and the echo's own binomial variance on those cells."""
        busy = self.cells * sipm.fired_share_published(photons=photons, pde=self.pde, cells=self.cells)
        dark = sipm.dark_counts(
            cells=self.cells, dark_count_rate_hz=self.dark_count_rate_hz, dead_time_s=self.dead_time_s
        )
        # Only a darkness of 1 / tau per cell could empty this; the bound keeps the division below finite.
        free = xp(busy, dark).maximum(self.cells - busy - dark, 1e-6 * self.cells)
        return sipm.fired_variance_published(fired=busy, cells=self.cells) + dark, free, 1.0, -1.0 / free

    def _steady_state(self, photons: Lanes) -> tuple[Lanes, Lanes, Lanes, Lanes]:
        """Busy and fired cells together are binomial: p = b + s / N gives N p (1 - p) around the variance.

        With crosstalk that is so much more by `sipm.crosstalk_variance`: exact here without an echo, with half of the
        free cells fired and with all; the noise in between is the parabola through these three.
        """
        busy = self._busy_share(photons)
        variance = sipm.busy_variance_steady_state(busy_share=busy, cells=self.cells)
        free = self.cells * (1.0 - busy)
        if self.crosstalk is None:
            return variance, free, 1.0 - 2.0 * busy, -1.0 / self.cells
        variance, half = variance * self._clusters(busy), 0.5 * (1.0 + busy)
        at_half = sipm.busy_variance_steady_state(busy_share=half, cells=self.cells) * self._clusters(half)
        at_none = variance / free
        slope = (2.0 * at_half / free - at_none) * 2.0 / free
        return variance, free, free * slope - at_none, -slope

    def _clusters(self, busy_share: Lanes) -> Lanes:
        """Variance over that of independent cells."""
        if self.crosstalk is None:
            return 1.0
        return sipm.crosstalk_variance(busy_share=busy_share, crosstalk=self.crosstalk)

    def _busy_share(self, photons: Lanes) -> Lanes:
        """Share of time that a cell is dead, with so many background photons in a dead time."""
        if self.crosstalk is not None or self.afterpulse_s is not None:
            return sipm.busy_share_correlated(
                firings=photons * self.pde / self.cells + self.dark_count_rate_hz * self.dead_time_s,
                crosstalk=0.0 if self.crosstalk is None else self.crosstalk,
                afterpulse=0.0 if self.afterpulse is None else self.afterpulse,
                afterpulse_to_dead_time=1.0
                if self.afterpulse_s is None
                else self.afterpulse_s / self.dead_time_s,
            )
        return sipm.busy_share_steady_state(
            photons=photons, pde=self.pde, cells=self.cells,
            dark_count_rate_hz=self.dark_count_rate_hz, dead_time_s=self.dead_time_s,
        )  # fmt: skip


Detector = Apd | Sipm
