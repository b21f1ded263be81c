"""A SiPM's cells, the light on them, and when a cell would fire: the input of the event simulation.

Options beyond the equations (recovery, crosstalk, afterpulses, pulse shape) are off by default, so that the default
is what the equations describe.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidarscene.maths.arrays import Numbers
from lidarscene.maths.special import normal_tail
from lidarscene.physics.optics import pulse as pulse_shape
from lidarscene.sensor.detectors import Sipm

_LN2 = math.log(2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class CellArray:
    """A SiPM, cell by cell.

    Attributes:
        dark_count_rate_hz: of each cell
        recovery_s: after the dead time an avalanche's charge recovers as 1 - exp(-t / recovery); 0: at once
        trigger_recovery_s: the same for the probability to fire
        crosstalk: probability that an avalanche fires another cell at the same moment, which may do so in turn; any
            cell of the array is equally likely, if it can fire
        afterpulse: probability that an avalanche fires its own cell again, if it can fire by then
        afterpulse_s: mean delay of afterpulses, exponential
        shape: of one avalanche at the output, unit height: "box" of the dead time, so that the sum is the number of
            busy cells as in the paper, or "exponential"
        rise_s: of the exponential shape; a rise of 0 is a step
        fall_s: of the exponential shape; a rise of 0 is a step
    """

    cells: int
    pde: float
    dead_time_s: float
    dark_count_rate_hz: float = 0.0
    recovery_s: float = 0.0
    trigger_recovery_s: float = 0.0
    crosstalk: float = 0.0
    afterpulse: float = 0.0
    afterpulse_s: float = 10e-9
    shape: str = "box"
    rise_s: float = 0.0
    fall_s: float = 0.0

    def __post_init__(self) -> None:
        if self.shape not in ("box", "exponential"):
            raise ValueError(f"shape must be 'box' or 'exponential', got '{self.shape}'")
        if self.shape == "exponential" and not self.fall_s > self.rise_s >= 0.0:
            raise ValueError(f"an exponential shape needs fall_s > rise_s >= 0, not {self.fall_s}, {self.rise_s}")
        if not (0.0 <= self.crosstalk < 1.0 and 0.0 <= self.afterpulse < 1.0 and self.dead_time_s > 0.0):
            raise ValueError("crosstalk and afterpulse must be < 1 and the dead time > 0")

    @classmethod
    def from_detector(cls, detector: Sipm, **options: Any) -> CellArray:
        """The cells of a sensor's detector, with any option above."""
        return cls(
            cells=int(float(detector.cells)),
            pde=float(detector.pde),
            dead_time_s=float(detector.dead_time_s),
            dark_count_rate_hz=float(detector.dark_count_rate_hz),
            **options,
        )

    @property
    def warm_up_s(self) -> float:
        """Time after which an array that started without memory is stationary; 0 if the start is exact."""
        memory = 8.0 * (self.recovery_s + self.trigger_recovery_s)
        memory += 8.0 * self.fall_s if self.shape == "exponential" else 0.0
        memory += 8.0 * self.afterpulse_s if self.afterpulse > 0.0 else 0.0
        return memory + (8.0 * self.dead_time_s if memory > 0.0 or self.crosstalk > 0.0 else 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """Light on the whole array: a constant background and a Gaussian pulse that peaks at time 0.

    Attributes:
        background_photons: in one dead time, N_b-photon of (23)
        signal_photons: as in (24), half of P_r FWHM / (h nu); the whole pulse has 2.13 times as many
    """

    background_photons: float
    signal_photons: float = 0.0
    pulse_fwhm_s: float = 6e-9


class Rates:
    """Cumulative firings of a cell that never dies, over time, and the inverse."""

    def __init__(self, array: CellArray, light: Light, *, start_s: float, end_s: float) -> None:
        """Exact on a grid of a 40th of the pulse's width, linear between its points."""
        step = min(light.pulse_fwhm_s / 40.0, (end_s - start_s) / 100.0)
        count = math.ceil((end_s - start_s) / step) + 1
        self.time_s = np.linspace(start_s, end_s, count)
        tau = array.dead_time_s
        self.per_s = light.background_photons * array.pde / array.cells / tau + array.dark_count_rate_hz
        energy = pulse_shape.pulse_energy_j(peak_power_w=1.0, fwhm_s=light.pulse_fwhm_s) / light.pulse_fwhm_s
        flash = 2.0 * energy * light.signal_photons * array.pde / array.cells
        arrived = 1.0 - np.asarray(normal_tail(math.sqrt(8.0 * _LN2) * self.time_s / light.pulse_fwhm_s))
        # A floor under the rate keeps the inverse single-valued in the dark: one firing in 1e12 windows.
        floor = 1e-12 * np.linspace(0.0, 1.0, count)
        self.firings = self.per_s * (self.time_s - start_s) + flash * (arrived - arrived[0]) + floor
        self.busy_share = self.per_s * tau / (1.0 + self.per_s * tau)

    @property
    def total(self) -> float:
        """Firings over the whole window."""
        return float(self.firings[-1])

    def firings_until(self, time_s: Numbers) -> Numbers:
        """Firings until this time; times are evenly spaced, so nothing has to be searched as `np.interp` does."""
        last, start_s, end_s = len(self.time_s) - 1, self.time_s[0], self.time_s[-1]
        place = np.clip((time_s - start_s) * (last / (end_s - start_s)), 0.0, last)
        before = np.minimum(place.astype(np.intp), last - 1)
        low = self.firings[before]
        return np.asarray(low + (place - before) * (self.firings[before + 1] - low))

    def when(self, firings: Numbers) -> Numbers:
        """Time of this many firings; inf beyond the window."""
        return np.asarray(np.interp(firings, self.firings, self.time_s, right=np.inf))


def recovered_share(age_s: Numbers, recovery_s: float) -> Numbers:
    """1 - exp(-age / recovery); 1 if the recovery takes no time."""
    return -np.expm1(-age_s / recovery_s) if recovery_s > 0.0 else np.ones_like(age_s)
