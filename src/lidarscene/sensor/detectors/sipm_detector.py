"""Silicon photomultiplier as data, and its working point under a background."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from ...files.table_model import Table
from ...maths.arrays import Lanes, Numbers, xp
from ...maths.units import FileKey, Quantity
from ...physics.amplifier.low_pass import LowPass
from ...physics.electronics import counting, range_limit, sipm, sipm_response
from ...physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ...physics.electronics.sipm_edge import CountEdge
from .detector import Reception, Wave
from .geiger import GeigerDetector, check_operation
from .working_point import CellCounts, CellMemory, Filtered, Noise, Response, WorkingPoint, least_count

_STEPS = 24
"""Fewest steps of a course in a dead time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sipm(GeigerDetector):
    """Silicon photomultiplier, (21)-(27). SI units.

    Attributes:
        statistics: "time_domain": busy cells in steady state, signal from the cells' course in time through a table,
            see `physics.electronics.sipm_response`; "steady_state": the same noise, but (24)'s half pulse; "published":
            (23)-(27) as printed, see `physics.electronics.sipm`
        counting: "gaussian" (9) or "binomial": exact counts of cells for false alarms and detection, which matter where
            the background fires few cells
        cell_floor: least threshold in cells: 1, since a comparator cannot see less than one cell; 0 to reproduce the
            paper's Fig. 6
        crosstalk: share of the avalanches that cause another at once; None: no such thing. Not with "published", nor
            with counts of independent cells ("binomial")
        afterpulse: share of the avalanches that cause another later, likewise
    """

    label: ClassVar[str] = "SiPM"
    unit: ClassVar[str] = "cells"
    has_white_noise: ClassVar[bool] = False

    cells: Annotated[Lanes, Quantity(ge=1, le=1e9, whole=True, about="N")]
    radius_m: Annotated[Lanes, Quantity("mm", ge=1e-3, le=100, about="of the photosensitive area")]
    dead_time_s: Annotated[Lanes, Quantity("ns", ge=0.01, le=1e5, about="tau")]
    cell_floor: Annotated[
        Lanes, Quantity(ge=0, le=1e5, about="minimum threshold, cells; 0 reproduces the paper's Fig. 6")
    ] = 1.0
    statistics: Annotated[
        Literal["steady_state", "published", "time_domain"],
        FileKey(
            about=(
                '`"time_domain"`: cells followed in time (docs/sipm.md); `"steady_state"`: busy cells'
                ' so, but of the echo (24)\'s half pulse; `"published"`: (22)-(27) as printed'
            )
        ),
    ] = "time_domain"
    counting: Annotated[
        Literal["gaussian", "binomial"],
        FileKey(about='tails of detection and false alarms: `"gaussian"`, or `"binomial"` for exact counts'),
    ] = "gaussian"
    crosstalk: Annotated[
        Lanes | None,
        Quantity(ge=0, le=0.5, about="fraction of avalanches that fire another cell at once; none if left out"),
    ] = None
    afterpulse: Annotated[
        Lanes | None,
        Quantity(
            ge=0,
            le=0.5,
            about="with `afterpulse_ns`: fraction of avalanches that fire the same cell again; none if left out",
        ),
    ] = None
    afterpulse_s: Annotated[
        Lanes | None, Quantity("ns", ge=0.01, le=1e5, about="with `afterpulse`: mean delay of afterpulses, exponential")
    ] = None

    @property
    def number_of_cells(self) -> Lanes:
        """N."""
        return self.cells

    @property
    def counts_whole_cells(self) -> bool:
        """Whether ``counting`` is "binomial"."""
        return self.counting == "binomial"

    @property
    def noise_bandwidth_hz(self) -> Lanes:
        """Cells are as long as their dead time, and so is the noise of their number."""
        return 0.5 / self.dead_time_s

    def background_counts(self, background_power_w: Lanes, reception: Reception) -> tuple[Lanes, Lanes]:
        """Cells that fire per second, light and dark, and the factor by which the dead time narrows their noise."""
        busy = self._busy_share(
            sipm.background_photons(
                power_w=background_power_w, dead_time_s=self.dead_time_s, photon_energy_j=reception.photon_energy_j
            )
        )
        rate = counting.fired_cells_hz(busy_share=busy, cells=self.cells, dead_time_s=self.dead_time_s)
        if self.crosstalk is None:
            return rate, 1.0 - busy
        return rate, sipm.firing_deviation(busy_share=busy, crosstalk=self.crosstalk)

    def working_point(
        self, background_power_w: Lanes, reception: Reception, *, range_m: Lanes | None = None
    ) -> WorkingPoint:
        """Noise, free cells and response under this background; the bandwidth is that of the dead time."""
        photon_energy_j, pulse_fwhm_s = reception.photon_energy_j, reception.pulse_fwhm_s
        photons = sipm.background_photons(
            power_w=background_power_w, dead_time_s=self.dead_time_s, photon_energy_j=photon_energy_j
        )
        published = self.statistics == "published"
        noise_state = self._published_state(photons) if published else self._steady_state(photons)
        variance, busy_cells, free_cells, kappa_1, kappa_2 = noise_state
        busy_share = 1.0 - free_cells / self.cells
        share_of = sipm.fired_share_published if published else sipm.fired_share
        photons_of = sipm.photons_for_share_published if published else sipm.photons_for_share
        at_peak, before_peak = self._in_time(busy_share, pulse_fwhm_s)
        memory, edge = None, None
        if self.statistics == "time_domain":
            rate_hz = self._refill(busy_share) / self.dead_time_s
            memory = CellMemory(cells=self.cells, free=free_cells, rate_hz=rate_hz, dead_time_s=self.dead_time_s)
            edge = CountEdge.from_cells(
                sigma_s=pulse_fwhm_s / SIGMAS_PER_FWHM,
                rate_hz=rate_hz,
                dead_time_s=self.dead_time_s,
                busy=busy_cells,
                free=free_cells,
                variance=variance,
            )

        cells = {"pde": self.efficiency, "cells": self.cells}

        def signal(power_w: Lanes) -> Lanes:
            arriving = sipm.signal_photons(
                peak_power_w=power_w, pulse_fwhm_s=pulse_fwhm_s, photon_energy_j=photon_energy_j
            )
            return free_cells * share_of(photons=at_peak(arriving), **cells)

        def power_w(level: Lanes) -> Lanes:
            arriving = photons_of(share=level / free_cells, **cells)
            return 2.0 * before_peak(arriving) * photon_energy_j / pulse_fwhm_s

        def crossings_hz(threshold: Lanes, _bandwidth_hz: Lanes, _least_hz: Lanes | None) -> Lanes:
            return counting.upcrossings_hz(
                least=least_count(threshold + busy_cells),
                cells=self.cells,
                busy_share=busy_cells / self.cells,
                dead_time_s=self.dead_time_s,
            )

        return WorkingPoint(
            noise=Noise(
                deviation=xp(variance).sqrt(variance), kappa_1=kappa_1, kappa_2=kappa_2, crossings_hz=crossings_hz
            ),
            response=Response(
                signal=signal, power_w=power_w, knee=sipm.MOST_TELLING_SHARE * free_cells, largest=free_cells - 0.5
            ),
            counts=CellCounts(cells=self.cells, busy=busy_cells) if self.counts_whole_cells else None,
            least_threshold=self.cell_floor,
            memory=memory,
            edge=edge,
        )

    def filtered(self, low_pass: LowPass, *, peak: Lanes, fwhm_s: Lanes, cutoff_hz: Lanes) -> Filtered:
        """Cells as long as their dead time, and so the noise of their number."""
        cell = {"duration_s": self.dead_time_s, "cutoff_hz": cutoff_hz}
        noise = low_pass.box_noise_share(**cell)
        return Filtered(peak=peak, noise=noise, echo_noise=noise, cell=low_pass.box_peak_share(**cell))

    def closed_form_range_m(
        self, target: range_limit.Plane, transceiver: range_limit.Transceiver, reception: Reception
    ) -> Lanes:
        """(30), with all light of the dead time around the peak for cells in the time domain."""
        return range_limit.maximum_range_sipm_m(
            target,
            transceiver,
            pulse_fwhm_s=reception.pulse_fwhm_s * self.captured(reception.pulse_fwhm_s),
            pde=self.efficiency,
            dead_time_s=self.dead_time_s,
        )

    def course_step_s(self, step_s: float, *, filtered: bool) -> float | None:
        """A whole part of the dead time; behind a frequency response cells have no memory here."""
        if self.statistics != "time_domain" or filtered:
            return None
        dead_time_s = float(self.dead_time_s)
        return dead_time_s / max(_STEPS, math.ceil(dead_time_s / step_s))

    def course_in_time(self, wave: Wave, time_s: Numbers, step_s: float) -> Numbers:
        """Busy cells above those of the background, by the equation of their share, with crosstalk and afterpulses."""
        # The count is that at the end of a step, the light that of its middle.
        power_w = wave.power_w(time_s - 0.5 * step_s)
        assert wave.point.memory is not None
        busy = 1.0 - np.asarray(wave.point.memory.free) / self.cells
        per_watt = self.efficiency * self.dead_time_s / (wave.reception.photon_energy_j * self.cells)
        share = sipm_response.busy_share_in_steps(
            rate=power_w * per_watt,
            busy_share=busy,
            steps=round(float(self.dead_time_s) / step_s),
            crosstalk=float(self.crosstalk or 0.0),
            afterpulse=float(self.afterpulse or 0.0),
            afterpulse_to_dead_time=float((self.afterpulse_s or self.dead_time_s) / self.dead_time_s),
        )
        return np.asarray(self.cells * (share - busy[:, None]))

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
        cells, refill = {"pde": self.efficiency, "cells": self.cells}, self._refill(busy_share)
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

    def _published_state(self, photons: Lanes) -> tuple[Lanes, Lanes, Lanes, Lanes, Lanes]:
        """Variance (25) + (26), busy and free cells of (24), and the echo's own binomial variance on the free ones."""
        busy = self.cells * sipm.fired_share_published(photons=photons, pde=self.efficiency, cells=self.cells)
        dark = sipm.dark_counts(cells=self.cells, dark_count_rate_hz=self.dark_rate_hz, dead_time_s=self.dead_time_s)
        # Only a darkness of 1 / tau per cell could empty this; the bound keeps the division below finite.
        free = xp(busy, dark).maximum(self.cells - busy - dark, 1e-6 * self.cells)
        variance = sipm.fired_variance_published(fired=busy, cells=self.cells) + dark
        return variance, busy + dark, free, 1.0, -1.0 / free

    def _steady_state(self, photons: Lanes) -> tuple[Lanes, Lanes, Lanes, Lanes, Lanes]:
        """Busy and fired cells together are binomial: p = b + s / N gives N p (1 - p) around the variance.

        With crosstalk that is so much more by `sipm.crosstalk_variance`: exact here without an echo, with half of the
        free cells fired and with all; the noise in between is the parabola through these three.
        """
        busy = self._busy_share(photons)
        variance = sipm.busy_variance_steady_state(busy_share=busy, cells=self.cells)
        # Few busy ones among many cells are lost in the difference of all and the free ones.
        busy_cells, free = self.cells * busy, self.cells * (1.0 - busy)
        if self.crosstalk is None:
            return variance, busy_cells, free, 1.0 - 2.0 * busy, -1.0 / self.cells
        variance, half = variance * self._clusters(busy), 0.5 * (1.0 + busy)
        at_half = sipm.busy_variance_steady_state(busy_share=half, cells=self.cells) * self._clusters(half)
        at_none = variance / free
        slope = (2.0 * at_half / free - at_none) * 2.0 / free
        return variance, busy_cells, free, free * slope - at_none, -slope

    def _clusters(self, busy_share: Lanes) -> Lanes:
        """Variance over that of independent cells."""
        if self.crosstalk is None:
            return 1.0
        return sipm.crosstalk_variance(busy_share=busy_share, crosstalk=self.crosstalk)

    def _busy_share(self, photons: Lanes) -> Lanes:
        """Share of time that a cell is dead, with so many background photons in a dead time."""
        if self.crosstalk is not None or self.afterpulse_s is not None:
            return sipm.busy_share_correlated(
                firings=photons * self.efficiency / self.cells + self.dark_rate_hz * self.dead_time_s,
                crosstalk=0.0 if self.crosstalk is None else self.crosstalk,
                afterpulse=0.0 if self.afterpulse is None else self.afterpulse,
                afterpulse_to_dead_time=1.0 if self.afterpulse_s is None else self.afterpulse_s / self.dead_time_s,
            )
        return sipm.busy_share_steady_state(
            photons=photons,
            pde=self.efficiency,
            cells=self.cells,
            dark_count_rate_hz=self.dark_rate_hz,
            dead_time_s=self.dead_time_s,
        )


class SipmFile(Table[Sipm]):
    """[detector] type = "sipm"."""

    type: Literal["sipm"]

    @model_validator(mode="after")
    def _cells_that_know_each_other(self) -> SipmFile:
        if (self.afterpulse is None) != (self.afterpulse_ns is None):
            raise ValueError("afterpulse, afterpulse_ns: must be given together, got one of them")
        for key in ("crosstalk", "afterpulse"):
            if getattr(self, key) is not None and self.statistics == "published":
                raise ValueError(f'{key}: must be left out with statistics = "published", which has none')
        check_operation(self.in_si())
        if self.crosstalk is not None and self.counting == "binomial":
            raise ValueError('crosstalk: must be left out with counting = "binomial", whose cells are independent')
        return self
