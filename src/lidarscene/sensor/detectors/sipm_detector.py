"""Silicon photomultiplier as data, and its working point under a background."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

from ...maths.arrays import Lanes, xp
from ...maths.units import FileKey, Quantity
from ...physics.electronics import counting, sipm, sipm_response
from .working_point import CellMemory, WorkingPoint, least_count


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
    statistics: Annotated[Literal["steady_state", "published", "time_domain"], FileKey()] = "time_domain"
    counting: Annotated[Literal["gaussian", "binomial"], FileKey()] = "gaussian"
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
        Lanes | None, Quantity("ns", ge=0.01, le=1e5, about="with afterpulse: mean delay of afterpulses, exponential")
    ] = None

    @property
    def saturates(self) -> bool:
        """True: the number of cells is finite."""
        return True

    def background_counts(self, *, background_power_w: Lanes, photon_energy_j: Lanes) -> tuple[Lanes, Lanes]:
        """Cells that fire per second, light and dark, and the factor by which the dead time narrows their noise."""
        busy = self._busy_share(
            sipm.background_photons(
                power_w=background_power_w, dead_time_s=self.dead_time_s, photon_energy_j=photon_energy_j
            )
        )
        rate = counting.fired_cells_hz(busy_share=busy, cells=self.cells, dead_time_s=self.dead_time_s)
        if self.crosstalk is None:
            return rate, 1.0 - busy
        return rate, sipm.firing_deviation(busy_share=busy, crosstalk=self.crosstalk)

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
                least=least_count(threshold + busy),
                cells=self.cells,
                busy_share=busy / self.cells,
                dead_time_s=self.dead_time_s,
            )

        return WorkingPoint(
            noise=xp(variance).sqrt(variance),
            kappa_1=kappa_1,
            kappa_2=kappa_2,
            crossings_hz=crossings_hz,
            least_threshold=self.cell_floor,
            signal=signal,
            power_w=power_w,
            cells=self.cells if self.counting == "binomial" else None,
            busy=self.cells - free_cells,
            knee=sipm.MOST_TELLING_SHARE * free_cells,
            largest=free_cells - 0.5,
            memory=memory,
        )

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
        return sipm_response.captured_photons(photons=1.0, pulse_fwhm_s=pulse_fwhm_s, dead_time_s=self.dead_time_s)

    def _in_time(
        self, busy_share: Lanes, pulse_fwhm_s: Lanes
    ) -> tuple[Callable[[Lanes], Lanes], Callable[[Lanes], Lanes]]:
        """Functions from photons of (24) to those that count at the peak, and back: with crosstalk, then in time."""
        crosstalk = self.crosstalk
        cells, refill = {"pde": self.pde, "cells": self.cells}, self._refill(busy_share)
        state = {"busy_share": refill / (1.0 + refill), "pulse_to_dead_time": pulse_fwhm_s / self.dead_time_s, **cells}
        in_time, captured = self.statistics == "time_domain", self.captured(pulse_fwhm_s)

        def at_peak(photons: Lanes) -> Lanes:
            photons = photons * captured
            if crosstalk is not None:
                photons = sipm.add_crosstalk(
                    photons=photons, ready_share=1.0 - busy_share, crosstalk=crosstalk, **cells
                )
            return sipm_response.peak_photons(photons=photons, **state) if in_time else photons

        def before_peak(photons: Lanes) -> Lanes:
            if in_time:
                photons = sipm_response.captured_for_peak(photons=photons, **state)
            if crosstalk is not None:
                photons = sipm.remove_crosstalk(
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
                afterpulse_to_dead_time=1.0 if self.afterpulse_s is None else self.afterpulse_s / self.dead_time_s,
            )
        return sipm.busy_share_steady_state(
            photons=photons,
            pde=self.pde,
            cells=self.cells,
            dark_count_rate_hz=self.dark_count_rate_hz,
            dead_time_s=self.dead_time_s,
        )
