"""Sensor model of the simulation: frozen, SI units and radians, no files.

`lidarscene.sensor.sensor_file` makes one from a TOML file, where the units are those that people write.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol

import numpy as np

from ..errors import InputError, OptionWarning, warn
from ..files import facts
from ..files.arguments import checks_arguments
from ..files.atomic import put_text
from ..files.facts import Picture
from ..files.late_binding import call_bound, read_by_name
from ..files.overrides import Overrides, assignments
from ..maths.arrays import Lanes, Numbers, xp
from ..maths.attributes import HintedAttributes
from ..maths.pose import Pose
from ..maths.units import STATIC, FileKey, Quantity
from ..physics.amplifier import high_pass
from ..physics.electronics import sampling, tdc
from ..physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ..physics.optics import radiometry
from ..scan import Flash, Scanner
from .detectors import Detector, Filtered, Reception, Spad, WorkingPoint
from .detectors.macropixel import Macropixel
from .detectors.matching import silicon_doubt, spot_doubt
from .detectors.working_point import Noise
from .driver import DRIVERS
from .electronics import SENSOR_CHANGED_BY, Adc, Intensity, MultiLevel, Receiver, Tdc
from .histogram import Histogram
from .imu import Imu
from .overlap import Alignment, Overlap, OverlapGeometry, Spot
from .power import Power
from .wear import Wear

PULSE_BANDWIDTH = 0.35
"""Source: an RC low-pass, whose rise time is 0.35 over its bandwidth; bandwidth times FWHM that a pulse needs: a slower
amplifier lowers it."""

_FLATTEST = 1e-4
"""Accuracy bought: least curvature of a peak: broader echoes count as a hundred pulses long."""

_QUIET = 1e-6
"""Choice: noise over the threshold in the place of none, which does not chatter."""

MATCHED_WIDTHS = 1.75
"""Source: (T78), which is 1 at x = 1.747: least x = 2 pi B sigma_p at which a matched filter leaves no more noise than
a raw sample has."""

SMOOTH_COUNTS = 2.0
"""Accuracy bought: threshold in counts from which on P_d is right to 0.06; below, to 0.25."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Polarisation:
    """Linear polarisation of a laser's light."""

    angle_rad: Annotated[
        Lanes,
        Quantity(
            "deg",
            ge=-36e3,
            le=36e3,
            about=(
                "about the beam, from the left to the top: 0 is horizontal, in the plane of incidence "
                "of an upright pane beside the beam; 90 is vertical, in that of a raked windscreen ahead"
            ),
        ),
    ]
    share: Annotated[Lanes, Quantity(ge=0, le=1, about="of the light; the rest is unpolarised")] = 1.0


UNPOLARISED = Polarisation(angle_rad=0.0, share=0.0)
"""Light of a laser of which nobody says how it stands."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Speckle:
    """Speckle of the laser's light on rough surfaces, which lets echoes scatter."""

    linewidth_m: Annotated[
        Lanes,
        Quantity(
            "nm", ge=0, le=100, about="full width at half of the laser's line: more wavelengths, less speckle on slopes"
        ),
    ] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Laser(HintedAttributes):
    """Pulsed transmitter. Divergences are full angles at 1/e^2, or to the edge of a top hat.

    The beam leaves the sensor at its waist, of ``exit_diameter_m``.

    Attributes:
        speckle: of the light; None: echoes have none
    """

    CHANGED_BY: ClassVar[str] = SENSOR_CHANGED_BY
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(
            ("pulse_width", "pulse_length", "pulse_duration", "pulse", "fwhm"), "sensor.laser.pulse_fwhm_s"
        ),
        **dict.fromkeys(("prf", "rep_rate", "pulse_rate", "frequency"), "sensor.laser.repetition_rate_hz"),
        **dict.fromkeys(
            ("pulse_energy", "energy", "average_power", "mean_power"),
            "1.0645 * sensor.laser.peak_power_w * sensor.laser.pulse_fwhm_s is the energy of a pulse",
        ),
    }

    wavelength_m: Annotated[float, Quantity("nm", ge=300, le=2500, about="materials must have data there")]
    peak_power_w: Annotated[Lanes, Quantity(ge=1e-6, le=1e6, about="P_t, leaving the sensor")]
    pulse_fwhm_s: Annotated[
        Lanes, Quantity("ns", ge=0.01, le=1000, about="width of the Gaussian pulse at half of its peak power")
    ]
    repetition_rate_hz: Annotated[float, Quantity("khz", ge=1e-4, le=2e4)]
    divergence_rad: Annotated[
        float,
        Quantity(
            "mrad",
            ge=0,
            le=3000,
            finest=0.01,
            about=(
                "full angle at 1/e^2, or to the edge of a top hat; if one ray represents a pulse, used by "
                "`slope_broadening` only"
            ),
        ),
    ] = 0.0
    profile: Annotated[
        Literal["gaussian", "top_hat"], FileKey(name="beam_profile", about="of the power across the beam")
    ] = "gaussian"
    divergence_elevation_rad: Annotated[
        float | None,
        Quantity(
            "mrad",
            ge=0.01,
            le=3000,
            about="of an elliptical beam, whose `divergence_mrad` is that of azimuth; a round beam if left out",
        ),
    ] = None
    exit_diameter_m: Annotated[
        float | None,
        Quantity(
            "mm",
            ge=0.05,
            le=1e4,
            about="1/e^2 diameter where the beam leaves, which is its waist; rays start from a point if left out",
        ),
    ] = None
    energy_spread: Annotated[
        Lanes | None,
        Quantity(
            ge=0,
            le=0.5,
            about=(
                "relative standard deviation of the energy from pulse to pulse, which a detector's gain may have too: "
                "it moves intensities and crossings; none if left out (docs/theory_light.md 10)"
            ),
        ),
    ] = None
    source_rad: Annotated[
        float,
        Quantity(
            "mrad",
            name="apparent_source_mrad",
            ge=0,
            le=3000,
            finest=0.01,
            about="angle of the apparent source, for eye safety; up to 1.5 it is a point",
        ),
    ] = 0.0
    slope_broadening: Annotated[
        bool,
        FileKey(
            about=(
                "whether a surface that leans lengthens the echo, and lowers its peak, where one ray stands for a "
                "pulse; several rays do so by themselves (docs/theory_light.md 4)"
            )
        ),
    ] = field(default=False, metadata=STATIC)
    polarisation: Polarisation = UNPOLARISED
    speckle: Speckle | None = None

    @property
    def photon_energy_j(self) -> float:
        """h nu."""
        return radiometry.photon_energy_j(wavelength_m=self.wavelength_m)

    @property
    def least_divergence_rad(self) -> float:
        """Divergence on the narrower axis of the beam."""
        return min(self.divergence_rad, self.divergence_elevation_rad or self.divergence_rad)

    @property
    def has_width(self) -> bool:
        """True if the beam has a width, so that several rays differ from its axis."""
        return bool(self.mean_divergence_rad or self.exit_diameter_m)

    @property
    def mean_divergence_rad(self) -> float:
        """Divergence of the round beam that stands for an elliptical one."""
        second_rad = self.divergence_rad if self.divergence_elevation_rad is None else self.divergence_elevation_rad
        return 0.5 * (self.divergence_rad + second_rad)

    @property
    def spot(self) -> Spot:
        """Spot of that round beam."""
        return Spot(
            profile=self.profile,
            half_divergence_rad=0.5 * self.mean_divergence_rad,
            exit_radius_m=0.0 if self.exit_diameter_m is None else 0.5 * self.exit_diameter_m,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Halo:
    """Wide skirt around the beam: light that window, lens and dust scatter on the ways out and back, taken together."""

    share: Annotated[Lanes, Quantity(gt=0, lt=1, about="of a wide surface's echo that comes from the halo")]
    divergence_rad: Annotated[Lanes, Quantity("mrad", ge=0.1, le=3000, about="full angle at 1/e^2 of its Gaussian")]


@dataclass(frozen=True, slots=True, kw_only=True)
class StrayLight:
    """Light that lenses and detectors pass on between channels that fire at the same instant; theory (T122)."""

    share: Annotated[
        Lanes, Quantity(ge=0, le=0.5, about="of a channel's light on the detector of the next one, without the veil")
    ] = 1e-4
    half_angle_rad: Annotated[
        Lanes, Quantity("deg", ge=1e-3, le=180, about="between two channels, at which the share has fallen to half")
    ] = math.pi / 180.0
    veil: Annotated[Lanes, Quantity(ge=0, le=0.5, about="fraction at any angle, as of ghosts between surfaces")] = 0.0
    glare_photons: Annotated[
        Lanes | None,
        Quantity(
            gt=0,
            le=1e9,
            about="of a channel from which on others report no weaker return at its range; all do if left out",
        ),
    ] = None
    glare_reach_m: Annotated[
        Lanes, Quantity(gt=0, le=100, about="m from that range within which returns are withheld")
    ] = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class Optics(HintedAttributes):
    """Receiver.

    Attributes:
        sun_irradiance_w_m2: in band, at normal incidence and 100 klux (E_sun of (6))
        overlap: overlap of the laser's spot and the field of view; None: all of the spot is seen at any range
        halo: around the spot, or None
        filter_share: of the echo that the filter passes, over that without the laser's drift; None: it has none
        stray: stray light of channels that fire together, or None
    """

    CHANGED_BY: ClassVar[str] = SENSOR_CHANGED_BY
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("diameter", "aperture_diameter"), "2 * sensor.optics.aperture_radius_m"),
        "f_number": "sensor.optics.focal_length_m / (2 * sensor.optics.aperture_radius_m)",
        **dict.fromkeys(
            ("efficiency", "transmission", "transmittance"),
            "sensor.optics.efficiency_laser, sensor.optics.efficiency_sun",
        ),
        **dict.fromkeys(("fov", "field_of_view"), "lidarscene.fov(sensor) studies it"),
    }

    aperture_radius_m: Annotated[Lanes, Quantity("mm", ge=0.05, le=5000, about="r_A of the receiver")]
    focal_length_m: Annotated[
        Lanes, Quantity("mm", ge=0.1, le=1e5, about="f; the field of view has the half angle atan(`radius_mm` / f)")
    ]
    efficiency_laser: Annotated[Lanes, Quantity(gt=0, le=1, about="eta_r, for the echo")]
    efficiency_sun: Annotated[Lanes, Quantity(gt=0, le=1, about="eta_rs, for sunlight")]
    sun_irradiance_w_m2: Annotated[Lanes, Quantity(ge=0, le=1e9)]
    overlap: Overlap | None = None
    halo: Halo | None = None
    stray: StrayLight | None = None
    filter_share: Lanes | None = None

    @property
    def echo_efficiency(self) -> Lanes:
        """eta_r of the echo, with what a laser beside the filter's band loses."""
        return self.efficiency_laser if self.filter_share is None else self.efficiency_laser * self.filter_share

    @property
    def aperture_m2(self) -> Lanes:
        """A(0)."""
        return radiometry.disc_area_m2(radius_m=self.aperture_radius_m)


def overlap_geometry(laser: Laser, optics: Optics, detector: Detector, alignment: Alignment) -> OverlapGeometry:
    """Geometry of a sensor's overlap, of numbers of its laser, optics and detector."""
    return OverlapGeometry(
        spot=laser.spot,
        aperture_radius_m=optics.aperture_radius_m,
        field_rad=detector.radius_m / optics.focal_length_m,
        alignment=alignment,
    )


class Origin(Protocol):
    """What a sensor was built from: the tables of a file."""

    def __call__(self, changes: Sequence[str]) -> Sensor:
        """Build the sensor with these changes, KEY=VALUE."""
        ...

    def full_key(self, key: str) -> str:
        """Key with the name of its table, where one table alone has it."""
        ...

    def text(self) -> str:
        """TOML of the tables."""
        ...


@read_by_name("load_sensor")
@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor(HintedAttributes):
    """All of a lidar. ``Sensor("apd-905")`` is `load_sensor`.

    ``sources`` says where each number comes from, by dotted key of the sensor file.

    Attributes:
        sampler: sampler that measures the pulses that trip the comparator; None: the TDC alone
        histogram: histogram over the shots of a `Spad`; None with any other detector
        wear: drops, weak lasers and a knocked mounting, `sensor.wear`; None: as new
        power: what it draws, or None: not known
        intensity: as the maker reports it, or None: the amplitude
        imu: IMU in its housing, or None
        driver: key of `driver.DRIVERS`, whose words files take; "" of no maker
        uncertainty: how far numbers may be off, either way, by dotted field: detector.dead_time_s
        origin: `sensor_file.SensorTables`, which build it anew with changes of its file; None if a program made or
            changed it: `dataclasses.replace` does not hand it on, since the file does not have what was replaced
    """

    MADE_BY: ClassVar[str] = 'Sensor("apd-905") reads a name or a file; lidarscene.sensors() lists the names'
    CHANGED_BY: ClassVar[str] = SENSOR_CHANGED_BY
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("snr", "detection_probability"), "lidarscene.max_range(sensor, distance=100).table has it"),
        **dict.fromkeys(("range", "range_m", "range_max"), "sensor.max_range() computes it"),
        "__getitem__": "sensor.laser, sensor.optics, sensor.scanner and sensor.detector are its parts",
        **dict.fromkeys(("fov", "field_of_view"), "lidarscene.fov(sensor) studies it"),
        **dict.fromkeys(
            ("channels", "n_channels", "beams", "n_beams", "num_beams"),
            "sensor.scanner.channel_elevation_rad has the elevation of each channel",
        ),
        **dict.fromkeys(("frame_rate", "frame_rate_hz", "fps", "rate_hz"), "1 / sensor.scanner.frame_s"),
        **dict.fromkeys(("info", "describe", "summary"), "print(sensor), sensor.facts()"),
        "budget": "sensor.max_range(distance=100), of the points of a cloud lidarscene.budget(cloud, scene, sensor)",
        **dict.fromkeys(("waveform", "waveforms", "signal"), "lidarscene.Simulator(scene, sensor).waveforms([0])"),
        **dict.fromkeys(("to_dict", "to_toml", "as_dict"), "sensor.save(path) writes its file"),
        **dict.fromkeys(("eye_safety", "eye_safe", "is_eye_safe"), "lidarscene.eye_safety(sensor).passed"),
        **dict.fromkeys(("angular_resolution", "resolution", "points_per_frame"), "lidarscene.fov(sensor) studies it"),
        "bandwidth": "sensor.tdc.bandwidth_hz",
        **dict.fromkeys(("prf", "rep_rate", "pulse_rate"), "sensor.laser.repetition_rate_hz"),
        **dict.fromkeys(("pde", "qe", "responsivity", "dcr"), "sensor.detector has it"),
        "noise": "lidarscene.budget(cloud, scene, sensor).noise",
        "pulse_width": "sensor.laser.pulse_fwhm_s",
        "render": "lidarscene.render(scene, sensor)",
        **dict.fromkeys(("visualize", "visualise", "viz", "display", "show"), "sensor.plot()"),
        **dict.fromkeys(("export", "write", "dump"), "sensor.save(path)"),
    }

    name: str
    laser: Laser
    optics: Optics
    scanner: Scanner
    detector: Detector
    tdc: Tdc
    sampler: MultiLevel | Adc | None = None
    receiver: Receiver = field(default_factory=Receiver)
    histogram: Histogram | None = None
    mounting: Pose = field(default_factory=Pose)
    intensity: Intensity | None = None
    wear: Wear | None = None
    power: Power | None = None
    imu: Imu | None = None
    description: str = ""
    driver: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    origin: Origin | None = field(default=None, init=False, repr=False, compare=False, metadata=STATIC)

    if TYPE_CHECKING:  # the fields, or what `read_by_name` reads

        def __init__(self, file: str | os.PathLike[str] = ..., /, **values: Any) -> None: ...

    def __repr__(self) -> str:
        return facts.facts_line("Sensor", self.name, self.facts())

    def _repr_html_(self) -> str:
        return facts.facts_table("Sensor", self.name, self.facts())

    def facts(self) -> dict[str, str]:
        """Facts for the one-line summary: label -> text."""
        return {
            "laser": f"{float(self.laser.wavelength_m) * 1e9:g} nm, {float(self.laser.peak_power_w):.3g} W",
            "detector": type(self.detector).__name__,
            "pulses": f"{self.scanner.pulses:,} a frame",
        }

    @checks_arguments
    def replace(self, overrides: Overrides = (), /, **tables: Any) -> Sensor:
        """Build the sensor anew with other values in its file; all that follows from them follows.

        Args:
            overrides: "laser.peak_power_w=60", a list of these, or {"laser.peak_power_w": 60}, in the file's units
            tables: the same by table: ``laser={"peak_power_w": 60}``, or ``**{"laser.peak_power_w": 60}``; a key that
                one table alone has may come by itself: ``peak_power_w=60``

        Raises:
            InputError: for a key or value that the file cannot have, and for a sensor that no file describes
        """
        origin = self._described("its file's keys to be replaced", "; dataclasses.replace changes its fields")
        dotted = {origin.full_key(key): value for key, value in tables.items()}
        return origin([*assignments(overrides), *assignments(dotted)])

    @checks_arguments
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a sensor file with all that was replaced, which `load_sensor` reads; files that it names stay in place.

        Raises:
            InputError: for a sensor that no file describes
            OutputError: if a result cannot be written
        """
        put_text(path, self._described("it to be saved").text())

    def _described(self, purpose: str, otherwise: str = "") -> Origin:
        """Tables of the file that the sensor was built from."""
        if self.origin is None:
            raise InputError(
                f"'{self.name}': must be as `load_sensor` gave it for {purpose}, got a sensor made or changed in "
                f"Python{otherwise}"
            )
        return self.origin

    def max_range(self, **conditions: Any) -> Any:
        """See `lidarscene.max_range`."""
        return call_bound("max_range", self, **conditions)

    def plot(self) -> Picture:
        """Picture of its pattern, of its detector's response, and of the echo's power over the distance."""
        picture: Picture = call_bound("draw_sensor", self)
        return picture

    @checks_arguments
    def with_laser(self, sensor: str | os.PathLike[str]) -> Sensor:
        """Build the sensor anew with another's laser; it fires at the rate that this one's scanner has.

        Args:
            sensor: catalogue name or sensor file

        Raises:
            InputError: for parts that do not fit each other, and for a sensor that no file describes
        """
        return self.replace({"laser": sensor})

    @checks_arguments
    def with_optics(self, sensor: str | os.PathLike[str]) -> Sensor:
        """Build the sensor anew with another's optics; arguments and errors as for `with_laser`."""
        return self.replace({"optics": sensor})

    @checks_arguments
    def with_scanner(self, sensor: str | os.PathLike[str]) -> Sensor:
        """Build the sensor anew with another's scanner and pulse rate; arguments and errors as for `with_laser`."""
        return self.replace({"scanner": sensor})

    @checks_arguments
    def with_detector(self, sensor: str | os.PathLike[str]) -> Sensor:
        """Build the sensor anew with another's detector, amplifier, threshold and converter.

        The time in which it listens and the returns that it keeps stay. Arguments and errors as for `with_laser`.
        """
        return self.replace({"detector": sensor})

    @checks_arguments
    def source_of(self, key: str) -> str | None:
        """Source of the number with this dotted key of the sensor file: its own, or its table's; None: no source."""
        return self.sources.get(key, self.sources.get(key.partition(".")[0]))

    def rings(self, channel: Numbers) -> Numbers:
        """(n,) int32 rings of channels, as the maker's driver counts them."""
        rows = self.rings_by_channel
        return channel if rows is None else rows[channel].astype(np.int32)

    @property
    def rings_by_channel(self) -> Numbers | None:
        """Ring of each channel; None: rings are channels."""
        return self._rows if DRIVERS[self.driver].rings_rise else None

    @property
    def ring_rows(self) -> Numbers | None:
        """Row of each ring, from the lowest up, where rings are channels; None where rings rise, or are no rows."""
        return None if DRIVERS[self.driver].rings_rise else self._rows

    @property
    def _rows(self) -> Numbers | None:
        """Row of each channel, from the lowest up; None if channels are no rows."""
        elevation = self.scanner.channel_elevation_rad
        return None if elevation is None else np.argsort(np.argsort(elevation, kind="stable"), kind="stable")

    @property
    def calibrated_efficiency(self) -> Lanes:
        """Efficiency for the echo with which the maker's intensity scale was calibrated: that of a clean window."""
        efficiency = self.optics.efficiency_laser
        return efficiency if self.wear is None else efficiency / self.wear.calibrated_share

    @property
    def times_edge(self) -> bool:
        """True if the TDC alone times the edge on which a pulse trips the comparator."""
        return self.sampler is None and self.tdc.timing == "leading_edge"

    @property
    def finds_peaks(self) -> bool:
        """True if the receiver searches for peaks, and not only for edges of its comparator.

        A receiver that ranks pulses by strength, waits for the last, or samples them, must follow the signal beyond
        the crossing of the threshold.
        """
        return not self.times_edge or self.tdc.keep != "first"

    @property
    def sweep_rad(self) -> float:
        """Angle by which the head turns while the shots of a point are summed; 0 if it does not."""
        return 0.0 if self.histogram is None else self.histogram.sweep_rad

    @property
    def matches(self) -> bool:
        """True if pulses are detected behind a matched filter."""
        if self.detector.counts_whole_cells:
            return False  # behind a filter no whole cells are counted
        samples_match = isinstance(self.sampler, Adc) and self.sampler.estimator == "matched_filter"
        return samples_match or self.tdc.timing == "matched_filter"

    @property
    def lasting_gain(self) -> float:
        """Gain of the matched filter for light that lasts, over that for a pulse as it leaves; 1 without one."""
        return sampling.LASTING_GAIN if self.matches else 1.0

    def height_gain(self, curvature: Lanes) -> Lanes:
        """Gain of the matched filter for the height of a pulse, (T80); 1 without one.

        Args:
            curvature: -P'' / P at the peak, 1 of a pulse as it leaves
        """
        return sampling.matched_gain(curvature=curvature) if self.matches else 1.0

    @property
    def housing_m(self) -> Lanes:
        """Radius of the receiver's lens, which is surely part of the sensor: no surface can be nearer."""
        return self.optics.aperture_radius_m

    @property
    def noise_bandwidth_hz(self) -> Lanes:
        """Bandwidth of white noise: the amplifier's, or less if cells stay for a dead time or samples are far apart."""
        bandwidth: Lanes = self.tdc.bandwidth_hz
        limits_hz = [] if self.detector.noise_bandwidth_hz is None else [self.detector.noise_bandwidth_hz]
        limits_hz += [0.5 * self.sampler.rate_hz] if isinstance(self.sampler, Adc) else []
        for limit_hz in limits_hz:
            bandwidth = xp(bandwidth, limit_hz).minimum(bandwidth, limit_hz)
        return bandwidth

    @property
    def _widths(self) -> Lanes:
        """x of `sampling.widths`, of the noise and the pulse as they are received."""
        return sampling.widths(bandwidth_hz=self.noise_bandwidth_hz, pulse_fwhm_s=self.received_fwhm_s)

    @property
    def measures_width(self) -> bool:
        """True if the receiver measures for how long a pulse is above the threshold."""
        return self.tdc.both_edges or self.sampler is not None

    @property
    def cutoff_hz(self) -> Lanes:
        """-3 dB frequency of the amplifier's low pass; without one, the bandwidth of the noise."""
        return self.tdc.bandwidth_hz / self.receiver.noise_ratio

    @property
    def low_pass_share(self) -> Lanes:
        """Share of a pulse's peak that passes the low pass; 1 without one."""
        filtering = self.receiver.low_pass
        if filtering is None:
            return 1.0
        return filtering.peak_share(fwhm_s=self.laser.pulse_fwhm_s, cutoff_hz=self.cutoff_hz)

    @property
    def received_fwhm_s(self) -> Lanes:
        """Width of the pulse behind the low pass: its area stays (docs/theory_receivers.md 5)."""
        if self.receiver.low_pass is None:
            return self.laser.pulse_fwhm_s
        return self.laser.pulse_fwhm_s / self.low_pass_share

    @property
    def coupling_rate(self) -> Lanes | None:
        """w of `physics.amplifier.high_pass`; None of a DC-coupled amplifier."""
        coupling_hz = self.receiver.ac_coupling_hz
        if coupling_hz is None:
            return None
        return high_pass.rate(coupling_hz=coupling_hz, fwhm_s=self.received_fwhm_s)

    @property
    def peak_share(self) -> Lanes:
        """Share of a pulse's peak that passes the whole response; 1 for "none"."""
        rate = self.coupling_rate
        return self.low_pass_share if rate is None else self.low_pass_share * high_pass.peak_share(rate=rate)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Warnings about numbers that do not fit each other, a line each."""
        laser, focal_length_m = self.laser, float(self.optics.focal_length_m)
        messages = [
            self._bandwidth_doubt,
            self._filter_doubt,
            self._count_doubt,
            silicon_doubt(self.detector, wavelength_m=laser.wavelength_m),
        ]
        # A flash's beam is as wide as all of its pixels.
        if self.optics.overlap is None and not isinstance(self.scanner, Flash):
            divergence_rad = laser.mean_divergence_rad
            messages.append(spot_doubt(self.detector, divergence_rad=divergence_rad, focal_length_m=focal_length_m))
        return tuple(f"'{self.name}': {message}" for message in messages if message is not None)

    @property
    def _bandwidth_doubt(self) -> str | None:
        """Warning, one line, that the amplifier is too slow for the pulse; None if it is not."""
        cutoff_mhz, fwhm_ns = 1e-6 * float(self.cutoff_hz), 1e9 * float(self.laser.pulse_fwhm_s)
        needed_mhz = 1e3 * PULSE_BANDWIDTH / fwhm_ns
        if cutoff_mhz >= needed_mhz * (1.0 - 1e-9):
            return None
        message = (
            f"a bandwidth of {cutoff_mhz:.4g} MHz is slow for a pulse of {fwhm_ns:.4g} ns, which "
            f"needs {needed_mhz:.3g}; "
        )
        if self.receiver.low_pass is not None:
            return message + f"it leaves {100.0 * float(self.low_pass_share):.0f} % of the peak"
        return message + 'receiver.response = "none" lets the pulse pass whole, so ranges come out too long'

    @property
    def _filter_doubt(self) -> str | None:
        """Warning, one line, that the matched filter has more noise than raw samples; None if it has not."""
        if not self.matches or self._bandwidth_doubt is not None:
            return None
        x = float(self._widths)
        if x >= MATCHED_WIDTHS:
            return None
        noise_mhz, fwhm_ns = 1e-6 * float(self.noise_bandwidth_hz), 1e9 * float(self.received_fwhm_s)
        return (
            f"the matched filter of a pulse of {fwhm_ns:.4g} ns has more noise than raw samples with a bandwidth of "
            f"{noise_mhz:.4g} MHz: 2 pi B sigma_p is {x:.3g}, and must be {MATCHED_WIDTHS:g} "
            f"({noise_mhz * MATCHED_WIDTHS / x:.3g} MHz) or more"
        )

    @property
    def _count_doubt(self) -> str | None:
        """Warning, one line, that whole counts pass a threshold in steps; None if it is high enough."""
        if self.histogram is None:
            return None
        counts = float(np.ravel(self.threshold(self.working_point(np.zeros(1))))[0])
        if counts >= SMOOTH_COUNTS:
            return None
        return (
            f"its threshold in the dark is {counts:.3g} counts, and counts are whole numbers: P_d, which follows a "
            "smooth law, may be off by 0.25; the points that `render` keeps are right"
        )

    def noise_correlation(self, lag_s: Lanes) -> Lanes:
        """Autocorrelation of the noise at a lag; without a low pass that of a single pole of the noise's bandwidth."""
        if self.receiver.low_pass is None:
            return tdc.noise_correlation(lag_s=lag_s, bandwidth_hz=self.tdc.bandwidth_hz)
        return self.receiver.low_pass.correlation(lag_s=lag_s, cutoff_hz=self.cutoff_hz)

    @property
    def reception(self) -> Reception:
        """What the detector needs of the rest."""
        return Reception(
            photon_energy_j=self.laser.photon_energy_j,
            pulse_fwhm_s=self.laser.pulse_fwhm_s,
            bandwidth_hz=self.tdc.bandwidth_hz,
            blanking_s=self.tdc.blanking_s,
            ambient_s=self.tdc.ambient_s,
            histogram=self.histogram,
        )

    def working_point(self, background_power_w: Lanes, *, range_m: Lanes | None = None) -> WorkingPoint:
        """Working point of the detector under this background; behind a matched filter, if pulses are detected there.

        Args:
            range_m: range of the echo, for SPADs that fire once in a shot: those that fired before are blind; None:
                none is
        """
        point = self.detector.working_point(background_power_w, self.reception, range_m=range_m)
        if self.receiver.filters:
            point = point.filtered(self.response)
        if not self.matches:
            return point
        return point.matched(sampling.matched_noise_share(x=self._widths))

    @property
    def response(self) -> Filtered:
        """Shares of the detector's peaks and noise that pass the amplifier's response."""
        peak, filtering = self.peak_share, self.receiver.low_pass
        if filtering is None:
            return Filtered(peak=peak, keeps_edge=True)
        fwhm_s, cutoff_hz = self.laser.pulse_fwhm_s, self.cutoff_hz
        return self.detector.filtered(filtering, peak=peak, fwhm_s=fwhm_s, cutoff_hz=cutoff_hz)

    @property
    def crossing_bandwidth_hz(self) -> Lanes:
        """Bandwidth of the ideal low-pass whose white noise crosses a level as often as the noise at the comparator.

        sqrt(3) f_rms of (T28a): of the filtered noise's spectrum where that is known. A single pole's has no f_rms, and
        that of a SiPM's cells depends on their dead time: there it is the bandwidth of the noise.
        """
        bandwidth_hz, filtering = self.tdc.bandwidth_hz, self.receiver.low_pass
        if self.matches:
            slower = sampling.matched_slope_noise(x=self._widths) / sampling.slope_noise(x=self._widths)
            return self.noise_bandwidth_hz * slower
        if filtering is None or not self.detector.has_white_noise:
            return bandwidth_hz
        return bandwidth_hz * filtering.crossing_ratio

    def steadiness(self, noise: Noise, threshold: Lanes, signal: Lanes, curvature: Lanes = 1.0) -> Lanes:
        """Probability that noise lets a pulse's edge cross the threshold once only, exp(-further crossings), (T80a).

        The edge is that of a Gaussian. Just below its peak it is flat and no straight edge, so a peak counts as one
        deviation of the noise above the threshold at least. 1 of a comparator that does not chatter.

        Args:
            signal: of the peak
            curvature: -P'' / P at the peak, 1 of a pulse as it leaves
        """
        if self.tdc.chatter_hz is None:
            return 1.0
        ops, sigma = xp(signal, threshold), noise.at(threshold)
        sigma_s = self.received_fwhm_s / SIGMAS_PER_FWHM / ops.sqrt(ops.maximum(curvature, _FLATTEST))
        top = ops.maximum(signal, threshold + sigma)
        slope = threshold * ops.sqrt(2.0 * ops.log(top / threshold)) / sigma_s
        shake = (2.0 * math.pi) * self.tdc.chatter_hz * ops.maximum(sigma, _QUIET * threshold)
        return ops.exp(-tdc.further_crossings(steepness=slope / shake))

    def false_alarm_rate_hz(self, point: WorkingPoint, threshold: Lanes, least_hz: Lanes | None = None) -> Lanes:
        """Rate at which noise trips the comparator, Hz: (T28), or the rate of its crossings.

        Args:
            least_hz: rate below which 0 may stand for it, as an alarm would be too late; None: none
        """
        bandwidth_hz = self.tdc.bandwidth_hz
        if self.tdc.false_alarms == "crossings":
            return point.crossing_rate_hz(threshold, self.crossing_bandwidth_hz, least_hz)
        return tdc.false_alarm_rate_hz(p_false=point.false_alarm_probability(threshold), bandwidth_hz=bandwidth_hz)

    def pixel(self, background_power_w: Lanes, *, range_m: Lanes | None = None) -> Macropixel:
        """SPADs under this background; ``range_m`` as for `working_point`."""
        assert isinstance(self.detector, Spad)
        return self.detector.pixel(background_power_w, self.reception, range_m=range_m)

    def background_counts(self, background_power_w: Lanes) -> tuple[Lanes, Lanes]:
        """Counts per second of light and dark, and the factor by which dead times narrow their noise."""
        return self.detector.background_counts(background_power_w, self.reception)

    def threshold(self, point: WorkingPoint) -> Lanes:
        """Level U: TNR sigma_0, the fixed level or the detector's own law; never below what the detector resolves."""
        if self.tdc.threshold_level is not None:
            level: Lanes = self.tdc.threshold_level
        elif self.tdc.threshold_to_noise is not None:
            level = self.tdc.threshold_to_noise * point.noise.deviation
        else:
            assert point.law is not None
            level = point.law.level
        return xp(level, point.least_threshold).maximum(level, point.least_threshold)


def warn_of_doubts(sensors: Iterable[Sensor]) -> None:
    """Warn of each doubt about the sensors once."""
    for doubt in dict.fromkeys(doubt for sensor in sensors for doubt in sensor.doubts):
        warn(OptionWarning("{0}", doubt))
