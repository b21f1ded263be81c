"""SPADs and their histogram as data, and their working point under a background.

A macro-pixel is an array of single-photon avalanche diodes, of which each shot adds the times of their firings to one
histogram (`macropixel`). The signal is a number of photons: the value of the filter above that of the background
(docs/photon_counting.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pydantic import model_validator

from ...files.table_model import Table
from ...maths.arrays import Lanes
from ...physics.optics import radiometry
from .detector import Reception
from .geiger import check_operation
from .macropixel import Macropixel, working_point
from .spad_array import SpadArray
from .working_point import WorkingPoint


@dataclass(frozen=True, slots=True, kw_only=True)
class Spad(SpadArray):
    """Macro-pixel of single-photon avalanche diodes. SI units."""

    def pixel(self, background_power_w: Lanes, reception: Reception, *, range_m: Lanes | None = None) -> Macropixel:
        """The SPADs and their histogram under this background; ``range_m`` as for `working_point`."""
        assert reception.histogram is not None
        armed_s: Lanes = 0.0
        if range_m is not None:
            armed_s = radiometry.time_of_flight_s(range_m=range_m) - reception.blanking_s
        return Macropixel.for_background(
            background_power_w,
            self,
            reception.histogram,
            photon_energy_j=reception.photon_energy_j,
            pulse_fwhm_s=reception.pulse_fwhm_s,
            armed_s=armed_s,
        )

    def working_point(
        self, background_power_w: Lanes, reception: Reception, *, range_m: Lanes | None = None
    ) -> WorkingPoint:
        """Signal and noise behind the filter over the histogram, in photons."""
        return working_point(self.pixel(background_power_w, reception, range_m=range_m), ambient_s=reception.ambient_s)

    def background_counts(self, background_power_w: Lanes, reception: Reception) -> tuple[Lanes, Lanes]:
        """Counts of all shots of a point, averaged over the ambient window."""
        return self.pixel(background_power_w, reception).background_counts(reception.ambient_s)


class SpadFile(Table[Spad]):
    """[detector] type = "spad"."""

    type: Literal["spad"]

    @model_validator(mode="after")
    def _enough_spads_for_a_coincidence(self) -> SpadFile:
        check_operation(self.in_si())
        if self.coincidence > self.spads:
            raise ValueError(f"coincidence: must be <= {self.spads:g}, the spads of the pixel, got {self.coincidence}")
        return self

    @model_validator(mode="after")
    def _afterpulses_of_spads_that_fire_again(self) -> SpadFile:
        if (self.afterpulse is None) != (self.afterpulse_ns is None):
            raise ValueError("afterpulse, afterpulse_ns: must be given together, got one of them")
        if self.afterpulse is not None and self.stamps == "first":
            raise ValueError('afterpulse: must be left out with stamps = "first", whose SPADs fire once in a shot')
        return self
