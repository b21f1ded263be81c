"""What every detector gives: a new kind is one module with a subclass of `Detector` and its table of a sensor file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from ...maths.arrays import Lanes, Numbers
from ...maths.attributes import HintedAttributes
from ...physics.amplifier.low_pass import LowPass
from ...physics.electronics.range_limit import Plane, Transceiver
from ..electronics import SENSOR_CHANGED_BY
from ..histogram import Histogram
from .working_point import Filtered, WorkingPoint


@dataclass(frozen=True, slots=True, kw_only=True)
class Reception:
    """The rest of a sensor, as far as it decides what its detector makes of light.

    Attributes:
        bandwidth_hz: of the noise
        blanking_s: after each pulse, in which nothing is counted
        ambient_s: time of each shot in which the background is counted
        histogram: that SPADs fill; None with any other detector
    """

    photon_energy_j: Lanes
    pulse_fwhm_s: Lanes
    bandwidth_hz: Lanes
    blanking_s: Lanes
    ambient_s: Lanes
    histogram: Histogram | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Wave:
    """Light on the detector over time, NumPy, for a detector that remembers what came before.

    Attributes:
        power_w: times (times,) to watts (n, times)
        signal: times to the signal (n, times) of a detector without memory
    """

    point: WorkingPoint
    reception: Reception
    power_w: Callable[[Numbers], Numbers]
    signal: Callable[[Numbers], Numbers]


class Detector(HintedAttributes, ABC):
    """A photodetector with its amplifier, as data in SI units.

    Numbers with a `maths.units.Slider` can be changed in the view.

    Attributes:
        label: for people
        unit: of its signal: "A", "cells" or "photons"
        has_white_noise: whether the noise is white up to the amplifier's bandwidth
        fills_histogram: whether [histogram] stands in the place of [tdc]
        radius_m: of the disc that decides the field of view
    """

    __slots__ = ()

    CHANGED_BY: ClassVar[str] = SENSOR_CHANGED_BY
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        "bandwidth": "sensor.tdc.bandwidth_hz",
        **dict.fromkeys(("type", "kind", "name"), "sensor.detector.label"),
        **dict.fromkeys(("noise", "nep"), "lidarscene.budget(cloud, scene, sensor)"),
        **dict.fromkeys(("dcr", "dark_counts"), "dark_count_rate_hz of cells and SPADs"),
        **dict.fromkeys(
            ("pde", "qe", "efficiency", "responsivity"), "pde of cells and SPADs, quantum_efficiency of an APD"
        ),
        "gain": "an APD has a gain; cells and SPADs fire whole",
    }

    label: ClassVar[str]
    unit: ClassVar[str]
    has_white_noise: ClassVar[bool] = True
    fills_histogram: ClassVar[bool] = False
    radius_m: Lanes

    @property
    @abstractmethod
    def saturates(self) -> bool:
        """Whether strong echoes lose their height."""

    @property
    def counts_whole_cells(self) -> bool:
        """Whether noise and signal are exact counts, which no filter may precede."""
        return False

    @property
    def noise_bandwidth_hz(self) -> Lanes | None:
        """Bandwidth of the detector's own noise; None: that of the amplifier."""
        return None

    @property
    def silicon(self) -> str | None:
        """What says that the detector is of silicon; None if nothing does."""
        return None

    @abstractmethod
    def working_point(
        self, background_power_w: Lanes, reception: Reception, *, range_m: Lanes | None = None
    ) -> WorkingPoint:
        """Noise and response under this background.

        Args:
            range_m: of the echo, for SPADs that fire once in a shot: those that fired before are blind; None: none has
        """

    @abstractmethod
    def background_counts(self, background_power_w: Lanes, reception: Reception) -> tuple[Lanes, Lanes]:
        """Counts a second of light and dark, and the narrowing of their noise by dead times."""

    def filtered(self, low_pass: LowPass, *, peak: Lanes, fwhm_s: Lanes, cutoff_hz: Lanes) -> Filtered:
        """What a low pass leaves of the detector's signal and noise.

        Args:
            peak: what the whole amplifier leaves of a pulse's peak
            fwhm_s: of the pulse before it
        """
        # White noise of the background has the low pass' bandwidth already.
        return Filtered(peak=peak, echo_noise=low_pass.echo_noise_share(fwhm_s=fwhm_s, cutoff_hz=cutoff_hz))

    def closed_form_range_m(self, target: Plane, transceiver: Transceiver, reception: Reception) -> Lanes | None:
        """Range that the shot noise of the background allows, (29) or (30); None: no closed form is known."""
        return None

    def course_step_s(self, step_s: float, *, filtered: bool) -> float | None:
        """Step in which the course of the signal in time is computed; None: the detector has no memory.

        Args:
            step_s: longest step that shows the pulse
            filtered: whether an amplifier with a frequency response follows
        """
        return None

    def course_in_time(self, wave: Wave, time_s: Numbers, step_s: float) -> Numbers:
        """Signal (n, times) at even steps, memory included, where `course_step_s` gives a step."""
        raise NotImplementedError
