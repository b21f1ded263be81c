"""Sensor files: the TOML that people write, in their units, to a `Sensor` in SI units."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from ..errors import InputError
from ..files.toml import FileModel, read_toml, validated, with_overrides
from ..maths.pose import Pose
from ..physics.optics import beam
from ..scan import Scanner
from .detectors import Apd, Detector, Sipm
from .model import Laser, Optics, Sensor, Tdc
from .optics import OpticsFile
from .readout import AnyIntensityFile, AnySamplerFile, PublishedFile
from .scanner_tables import Surroundings
from .scanners import AnyScannerFile, TableFile

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(gt=0, le=1)]

MOST_STOPS = 16

LARGEST_COORDINATE_M = 1e8
"""No position is farther off: enough for any map projection, and far from what single precision can hold."""

Coordinate = Annotated[float, Field(ge=-LARGEST_COORDINATE_M, le=LARGEST_COORDINATE_M)]
Vector = tuple[Coordinate, Coordinate, Coordinate]


class LaserFile(FileModel):
    """[laser]: the pulsed transmitter."""

    wavelength_nm: Annotated[float, Field(ge=300, le=2500)]
    peak_power_w: Positive
    pulse_fwhm_ns: Positive
    repetition_rate_khz: Positive
    divergence_mrad: NotNegative = Field(
        default=0.0,
        description="full angle at 1/e^2, or to the edge of a top hat; not used with one ray a pulse",
    )
    beam_profile: Literal["gaussian", "top_hat"] = "gaussian"
    divergence_elevation_mrad: Positive | None = Field(
        default=None, description="the same on the second axis; a round beam if left out"
    )
    beam_rotation_deg: float = Field(
        default=0.0, description="of the beam's two axes about the beam, from the left to the top"
    )
    exit_diameter_mm: Positive | None = Field(
        default=None, description="1/e^2 diameter where the beam leaves; not known if left out"
    )
    apparent_source_mrad: NotNegative = Field(
        default=0.0, description="angle of the apparent source, for eye safety; up to 1.5 it is a point"
    )

    @model_validator(mode="after")
    def _not_finer_than_light(self) -> LaserFile:
        least = min(self.divergence_mrad, self.divergence_elevation_mrad or self.divergence_mrad)
        if self.exit_diameter_mm is None or least == 0.0:
            return self
        limit = least / beam.beam_quality(
            exit_diameter_m=self.exit_diameter_mm * 1e-3,
            divergence_rad=least * 1e-3,
            wavelength_m=self.wavelength_nm * 1e-9,
        )
        if least < limit * (1.0 - 1e-3):
            raise ValueError(
                f"divergence_mrad: a beam of {self.exit_diameter_mm:g} mm spreads by {limit:.3g} mrad at least "
                f"(M2 of 1), {least:g} came"
            )
        return self


class ApdFile(FileModel):
    """[detector] type = "apd"."""

    type: Literal["apd"]
    gain: Annotated[float, Field(ge=1)]
    radius_mm: Positive
    quantum_efficiency: Share
    surface_dark_current_na: NotNegative
    bulk_dark_current_na: NotNegative
    excess_noise_index: NotNegative | None = None
    ionisation_ratio: Annotated[float, Field(ge=0, le=1)] | None = None
    load_resistance_ohm: Positive
    temperature_k: Positive = 300.0
    circuit_noise_na: NotNegative = 0.0
    tail: Literal["gaussian", "mcintyre"] = "gaussian"
    saturation_ua: Positive | None = Field(
        default=None,
        description="current at which the amplifier clips, after multiplication; never if left out",
    )
    recovery_ns: Positive | None = Field(
        default=None, description="with saturation_ua: time constant with which a clipped pulse drains"
    )

    @model_validator(mode="after")
    def _one_excess_noise(self) -> ApdFile:
        if (self.excess_noise_index is None) == (self.ionisation_ratio is None):
            raise ValueError("one of excess_noise_index and ionisation_ratio was expected, not both or none")
        if self.recovery_ns is not None and self.saturation_ua is None:
            raise ValueError("recovery_ns: together with saturation_ua, from which the pulse recovers")
        return self

    def build(self) -> Apd:
        """In SI units."""
        return Apd(
            gain=self.gain,
            radius_m=self.radius_mm * 1e-3,
            quantum_efficiency=self.quantum_efficiency,
            surface_dark_current_a=self.surface_dark_current_na * 1e-9,
            bulk_dark_current_a=self.bulk_dark_current_na * 1e-9,
            excess_noise_index=self.excess_noise_index,
            ionisation_ratio=self.ionisation_ratio,
            load_resistance_ohm=self.load_resistance_ohm,
            temperature_k=self.temperature_k,
            circuit_noise_a=self.circuit_noise_na * 1e-9,
            tail=self.tail,
            saturation_a=None if self.saturation_ua is None else self.saturation_ua * 1e-6,
            recovery_s=None if self.recovery_ns is None else self.recovery_ns * 1e-9,
        )


class SipmFile(FileModel):
    """[detector] type = "sipm"."""

    type: Literal["sipm"]
    cells: Annotated[int, Field(ge=1)]
    radius_mm: Positive
    pde: Share
    dead_time_ns: Positive
    dark_count_rate_hz: NotNegative = Field(description="of each cell")
    statistics: Literal["steady_state", "published", "time_domain"] = "steady_state"
    counting: Literal["gaussian", "binomial"] = "gaussian"
    cell_floor: NotNegative = 1.0

    def build(self) -> Sipm:
        """In SI units."""
        return Sipm(
            cells=float(self.cells),
            radius_m=self.radius_mm * 1e-3,
            pde=self.pde,
            dead_time_s=self.dead_time_ns * 1e-9,
            dark_count_rate_hz=self.dark_count_rate_hz,
            statistics=self.statistics,
            counting=self.counting,
            cell_floor=self.cell_floor,
        )


class TdcFile(FileModel):
    """[tdc]: comparator and time-to-digital converter."""

    window_us: Positive
    bandwidth_mhz: Annotated[float, Field(ge=1e-3)]
    threshold_to_noise: Annotated[float, Field(ge=0.01)] | None = None
    threshold_level: Annotated[float, Field(ge=1e-15)] | None = Field(
        default=None, description="amperes (APD) or cells (SiPM)"
    )
    lsb_ps: NotNegative = 0.0
    jitter_ps: NotNegative = 0.0
    stops: Annotated[int, Field(ge=1, le=MOST_STOPS)] = 1
    keep: Literal["first", "last", "strongest", "all"] = Field(
        default="first", description='which crossings, if there are more than stops; "all" is the first 16'
    )
    blanking_ns: NotNegative = Field(
        default=0.0, description="after the pulse leaves, in which crossings go unnoticed: the shortest range"
    )
    dead_time_ns: NotNegative = Field(
        default=0.0, description="from an echo's crossing to the next that can be taken"
    )
    edges: Literal["rising", "both"] | None = Field(
        default=None,
        description="of a pulse that are timed: both give its width; left out: both where the detector can saturate",
    )
    walk: Literal["none", "raw", "corrected"] = "corrected"
    ambient_window_us: Positive | None = Field(
        default=None, description="time in which the background is counted; the window if left out"
    )

    @model_validator(mode="after")
    def _one_threshold(self) -> TdcFile:
        if (self.threshold_to_noise is None) == (self.threshold_level is None):
            raise ValueError("one of threshold_to_noise and threshold_level was expected, not both or none")
        if self.keep == "all" and "stops" in self.model_fields_set:
            raise ValueError('stops: not together with keep = "all", which has 16')
        if self.blanking_ns >= 1e3 * self.window_us:
            raise ValueError(
                f"blanking_ns: less than the window of {1e3 * self.window_us:g} was expected, {self.blanking_ns:g} came"
            )
        return self


class PoseFile(FileModel):
    """A pose as people write it: yaw about z, then pitch (positive looks up), then roll."""

    position_m: Vector = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0

    def pose(self) -> Pose:
        """As a rotation and a position."""
        return Pose.from_degrees(
            position_m=self.position_m, yaw_deg=self.yaw_deg, pitch_deg=self.pitch_deg, roll_deg=self.roll_deg
        )


class SensorFile(FileModel):
    """A whole sensor file. ``sources`` says where each number comes from, by dotted key (or its table)."""

    name: Annotated[str, Field(min_length=1)]
    description: str = ""
    laser: LaserFile
    optics: OpticsFile
    scanner: Annotated[AnyScannerFile, Field(discriminator="type")]
    detector: Annotated[ApdFile | SipmFile, Field(discriminator="type")]
    tdc: TdcFile
    sampler: AnySamplerFile | None = Field(
        default=None,
        description="what measures the pulses that trip the comparator; the TDC alone if left out",
    )
    mounting: PoseFile = PoseFile()
    intensity: AnyIntensityFile | None = Field(
        default=None, description="the maker's scale; the amplitude if left out"
    )
    published: PublishedFile | None = Field(
        default=None, description="for comparison; not used by the simulation"
    )
    sources: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _window_within_a_period(self) -> SensorFile:
        period_us = self.scanner.shot_period_us(1e3 / self.laser.repetition_rate_khz)
        if self.tdc.window_us > period_us * (1.0 + 1e-9):
            raise ValueError(
                f"tdc.window_us: at most the pulse period of {period_us:g} us was expected, {self.tdc.window_us:g} came"
            )
        return self

    def build(self, folder: Path) -> Sensor:
        """The sensor in SI units; the files that it names lie in ``folder``."""
        detector: Detector = self.detector.build()
        laser, optics = _laser(self.laser), self.optics.build(folder)
        if self.optics.overlap is not None:
            overlap = self.optics.overlap.build(
                optics=optics, laser=laser, detector_radius_m=self.detector.radius_mm * 1e-3
            )
            optics = replace(optics, overlap=overlap)
        return Sensor(
            name=self.name,
            description=self.description,
            laser=laser,
            optics=optics,
            scanner=self._scanner(optics, folder),
            detector=detector,
            tdc=_tdc(self.tdc, detector),
            sampler=None if self.sampler is None else self.sampler.build(self.laser.pulse_fwhm_ns),
            mounting=self.mounting.pose(),
            intensity=None if self.intensity is None else self.intensity.build(),
            sources=dict(self.sources),
        )

    def _scanner(self, optics: Optics, folder: Path) -> Scanner:
        around = Surroundings(
            rate_hz=self.laser.repetition_rate_khz * 1e3,
            lens_radius_m=float(optics.aperture_radius_m),
            focal_length_m=float(optics.focal_length_m),
            folder=folder,
        )
        return self.scanner.build(around)


def _laser(laser: LaserFile) -> Laser:
    return Laser(
        wavelength_m=laser.wavelength_nm * 1e-9,
        peak_power_w=laser.peak_power_w,
        pulse_fwhm_s=laser.pulse_fwhm_ns * 1e-9,
        repetition_rate_hz=laser.repetition_rate_khz * 1e3,
        divergence_rad=laser.divergence_mrad * 1e-3,
        profile=laser.beam_profile,
        divergence_elevation_rad=(
            None if laser.divergence_elevation_mrad is None else laser.divergence_elevation_mrad * 1e-3
        ),
        beam_rotation_rad=math.radians(laser.beam_rotation_deg),
        exit_diameter_m=None if laser.exit_diameter_mm is None else laser.exit_diameter_mm * 1e-3,
        source_rad=laser.apparent_source_mrad * 1e-3,
    )


def _tdc(tdc: TdcFile, detector: Detector) -> Tdc:
    return Tdc(
        window_s=tdc.window_us * 1e-6,
        bandwidth_hz=tdc.bandwidth_mhz * 1e6,
        threshold_to_noise=tdc.threshold_to_noise,
        threshold_level=tdc.threshold_level,
        least_significant_bit_s=tdc.lsb_ps * 1e-12,
        jitter_s=tdc.jitter_ps * 1e-12,
        stops=MOST_STOPS if tdc.keep == "all" else tdc.stops,
        keep="first" if tdc.keep == "all" else tdc.keep,
        blanking_s=tdc.blanking_ns * 1e-9,
        dead_time_s=tdc.dead_time_ns * 1e-9,
        both_edges=detector.saturates if tdc.edges is None else tdc.edges == "both",
        walk=tdc.walk,
        ambient_window_s=None if tdc.ambient_window_us is None else tdc.ambient_window_us * 1e-6,
    )


def read_sensor(path: Path, *, overrides: Sequence[str] = ()) -> Sensor:
    """A sensor from a TOML file, with ``detector.gain=60``-like overrides. Raises InputError."""
    return sensor_from_tables(read_toml(path), where=str(path), overrides=overrides, folder=path.parent)


def sensor_from_tables(
    tables: dict[str, Any], *, where: str, overrides: Sequence[str] = (), folder: Path | None = None
) -> Sensor:
    """A sensor from the tables of a sensor file that ``where`` names, and whose files lie in ``folder``."""
    file = validated(SensorFile, with_overrides(tables, overrides), where, overrides=overrides)
    try:
        return file.build(folder or Path())
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def files_of_sensor(path: Path, *, overrides: Sequence[str] = ()) -> Iterator[Path]:
    """The sensor file and those that it names: a pattern, a filter. Raises InputError."""
    file = validated(SensorFile, with_overrides(read_toml(path), overrides), str(path), overrides=overrides)
    yield path
    if isinstance(file.scanner, TableFile):
        yield path.parent / file.scanner.file
    if file.optics.filter is not None and file.optics.filter.csv is not None:
        yield path.parent / file.optics.filter.csv
