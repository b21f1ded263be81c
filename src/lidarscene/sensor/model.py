"""A sensor as the simulation sees it: frozen, SI units and radians, no files.

`lidarscene.sensor.file` makes one from a TOML file, where the units are those that people write.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..maths.arrays import Lanes, xp
from ..maths.pose import Pose
from ..physics.optics import radiometry
from ..scan import Scanner
from .detectors import Detector, WorkingPoint
from .overlap import Overlap


@dataclass(frozen=True, slots=True, kw_only=True)
class Laser:
    """Pulsed transmitter. Divergences are full angles at 1/e^2, or to the edge of a top hat.

    profile                   of the power across the beam: "gaussian" or "top_hat"
    divergence_elevation_rad  on the second axis, or None: a round beam
    beam_rotation_rad         of the axes (azimuth, elevation) about the beam, from the left to the top
    exit_diameter_m           1/e^2 diameter where the beam leaves the sensor and its waist is, or None: not known
    source_rad                angle that the apparent source subtends; up to 1.5 mrad it is a point (eye safety)
    """

    wavelength_m: float
    peak_power_w: Lanes
    pulse_fwhm_s: Lanes
    repetition_rate_hz: float
    divergence_rad: float = 0.0
    profile: str = "gaussian"
    divergence_elevation_rad: float | None = None
    beam_rotation_rad: float = 0.0
    exit_diameter_m: float | None = None
    source_rad: float = 0.0

    @property
    def photon_energy_j(self) -> float:
        """h nu."""
        return radiometry.photon_energy_j(wavelength_m=self.wavelength_m)

    @property
    def least_divergence_rad(self) -> float:
        """On the axis on which the beam stays narrower."""
        return min(self.divergence_rad, self.divergence_elevation_rad or self.divergence_rad)

    @property
    def has_width(self) -> bool:
        """Whether rays over its footprint are more than its axis."""
        return bool(self.mean_divergence_rad or self.exit_diameter_m)

    @property
    def mean_divergence_rad(self) -> float:
        """Of a round beam that stands for an elliptical one."""
        return 0.5 * (self.divergence_rad + (self.divergence_elevation_rad or self.divergence_rad))


@dataclass(frozen=True, slots=True, kw_only=True)
class Halo:
    """Wide skirt around the beam: light that window, lens and dust scatter on the ways out and back, taken together.

    share           of the echo of a wide surface that it brings
    divergence_rad  full angle at 1/e^2
    """

    share: Lanes
    divergence_rad: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Optics:
    """Receiver.

    sun_irradiance_w_m2  in band, at normal incidence and 100 klux (E_sun of (6))
    overlap              of the laser's spot and the field of view, or None: all of the spot is seen at any range
    halo                 around the spot, or None
    """

    aperture_radius_m: Lanes
    focal_length_m: Lanes
    efficiency_laser: Lanes
    efficiency_sun: Lanes
    sun_irradiance_w_m2: Lanes
    overlap: Overlap | None = None
    halo: Halo | None = None

    @property
    def aperture_m2(self) -> Lanes:
        """A(0)."""
        return radiometry.disc_area_m2(radius_m=self.aperture_radius_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tdc:
    """Comparator and time-to-digital converter.

    window_s                  listening time after each pulse
    threshold_to_noise        U / sigma_0 (TNR), or None with a fixed level
    threshold_level           fixed U in signal units (A or cells), or None
    least_significant_bit_s   step of the reported time; 0: none
    jitter_s                  standard deviation of the converter's own jitter
    stops                     crossings reported per shot, in order of time
    keep                      which ones: "first", "last" or "strongest"
    blanking_s                after the pulse leaves, in which crossings go unnoticed
    dead_time_s               from a crossing by an echo to the next that can be taken
    both_edges                whether the end of a pulse is timed too: its width is known
    walk                      "raw" leaves the walk error in, "corrected" takes off what the measured amplitude
                              says it is (of a saturated pulse its width, if that is known), "none" takes off
                              exactly what it is
    ambient_window_s          time in which the background is counted, or None: the whole window
    """

    window_s: Lanes
    bandwidth_hz: Lanes
    threshold_to_noise: Lanes | None
    threshold_level: Lanes | None = None
    least_significant_bit_s: Lanes = 0.0
    jitter_s: Lanes = 0.0
    stops: int = 1
    keep: str = "first"
    blanking_s: Lanes = 0.0
    dead_time_s: Lanes = 0.0
    both_edges: bool = False
    walk: str = "corrected"
    ambient_window_s: Lanes | None = None

    @property
    def listening_s(self) -> Lanes:
        """Time in which crossings are taken."""
        return self.window_s - self.blanking_s

    @property
    def ambient_s(self) -> Lanes:
        """Time in which the background is counted."""
        return self.window_s if self.ambient_window_s is None else self.ambient_window_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Intensity:
    """The scale on which the maker reports intensity, `physics.electronics.intensity`.

    kind                "range_corrected": watts at ``reference_m``; "reflectivity": 0 to 255
    white_value         of a white Lambertian surface across the beam
    retro               the scale above that: "linear" or "logarithmic"
    retro_reflectivity  that reads 255 on a logarithmic one
    """

    kind: str
    reference_m: Lanes = 10.0
    white_value: Lanes = 100.0
    retro: str = "logarithmic"
    retro_reflectivity: Lanes = 1000.0

    @property
    def unit(self) -> str:
        """Of the number that is reported."""
        return "W" if self.kind == "range_corrected" else "1"


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiLevel:
    """Comparators at several levels behind the first: amplitude and walk from the width of the pulse.

    levels  in thresholds, rising, from 1 on
    """

    levels: tuple[Lanes, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Adc:
    """Converter that the comparator starts: samples around each crossing.

    rate_hz     samples per second, on a clock that starts with the pulse
    step        least significant bit, in signal units
    full_scale  largest sample; an offset keeps noise off the lower end
    samples     read for each crossing, from one pulse width before it to three behind
    room        for how many samples kernels are made: more than there are
    estimator   "matched_filter" or "centroid"
    """

    rate_hz: Lanes
    step: Lanes
    full_scale: Lanes
    samples: int
    room: int
    estimator: str = "matched_filter"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """All of a lidar. ``sources`` says where each number comes from, by dotted key of the sensor file.

    sampler  what measures the pulses that trip the comparator; None: the TDC alone
    intensity  as the maker reports it, or None: the amplitude
    """

    name: str
    laser: Laser
    optics: Optics
    scanner: Scanner
    detector: Detector
    tdc: Tdc
    sampler: MultiLevel | Adc | None = None
    mounting: Pose = field(default_factory=Pose)
    intensity: Intensity | None = None
    description: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)

    @property
    def measures_width(self) -> bool:
        """Whether it knows for how long a pulse was above the threshold."""
        return self.tdc.both_edges or self.sampler is not None

    def working_point(self, background_power_w: Lanes) -> WorkingPoint:
        """The detector under this background."""
        return self.detector.working_point(
            background_power_w=background_power_w,
            photon_energy_j=self.laser.photon_energy_j,
            bandwidth_hz=self.tdc.bandwidth_hz,
            pulse_fwhm_s=self.laser.pulse_fwhm_s,
        )

    def threshold(self, point: WorkingPoint) -> Lanes:
        """Comparator level U: TNR sigma_0 or the fixed level, never below what the detector can resolve."""
        if self.tdc.threshold_level is not None:
            level: Lanes = self.tdc.threshold_level
        else:
            assert self.tdc.threshold_to_noise is not None
            level = self.tdc.threshold_to_noise * point.noise
        return xp(level, point.least_threshold).maximum(level, point.least_threshold)
