"""Sensor files: the TOML that people write, in their units, to a `Sensor` in SI units."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tomlkit
from pydantic import Field, model_validator

from ..catalog import names, sensor_path
from ..errors import InputError
from ..files.arguments import checks_arguments
from ..files.overrides import Overrides, assignments, change_error
from ..files.table_model import Number, Table
from ..files.toml import FileModel, read_toml, validate
from ..maths.units import key_in_si, si
from ..physics.amplifier import high_pass
from ..physics.optics import beam
from ..scan import AnyScannerFile, Scanner
from ..scan.scanner_file import ScannerContext
from ..scan.spinning import Spinning
from .detectors import AnyDetectorFile, Detector, Spad
from .driver import DriverName
from .electronics import Keep, Receiver, Tdc, check_stops, kept_stops
from .histogram import Histogram, HistogramFile
from .imu import ImuFile
from .optics import OpticsFile
from .overlap import Overlap
from .parts import changed_tables, part_files, split_parts, with_absolute_files, with_part_of
from .pose_file import PoseFile
from .power import PowerFile
from .readout import AnyIntensityFile, AnySamplerFile, PublishedFile, read_published
from .sensor_model import UNPOLARISED, Laser, Optics, Polarisation, Sensor, Speckle, overlap_geometry
from .volleys import find_volleys
from .wear_file import WearFile


class PolarisationFile(Table[Polarisation]):
    """[laser.polarisation]: linear polarisation, which panes see."""


class SpeckleFile(Table[Speckle]):
    """[laser.speckle]: scatter of echoes by speckle; an empty table is light of one wavelength."""


class LaserFile(Table[Laser]):
    """[laser]: the pulsed transmitter."""

    repetition_rate_khz: Annotated[float, Number("khz", ge=1e-4, le=2e4)] | None = Field(
        default=None, description="pulses per second"
    )
    drift_nm: Annotated[float, Number("nm", ge=-100, le=100, finest=1e-3)] = Field(
        default=0.0,
        description="of the light from `wavelength_nm`, as by heat; needs `optics.filter` (docs/theory_light.md 9)",
    )
    polarisation: PolarisationFile | None = Field(
        default=None, description="of the light, for panes; unpolarised if left out"
    )
    speckle: SpeckleFile | None = Field(default=None, description="scatter of echoes; none if left out")

    def build(self, repetition_rate_hz: float) -> Laser:
        """Convert to SI units."""
        polarisation = UNPOLARISED if self.polarisation is None else self.polarisation.in_si()
        speckle = None if self.speckle is None else self.speckle.in_si()
        laser: Laser = self.in_si(repetition_rate_hz=repetition_rate_hz, polarisation=polarisation, speckle=speckle)
        if speckle is not None and not laser.has_width:
            raise InputError(
                "laser.speckle: must go with laser.divergence_mrad, which says how large the spot is, got none"
            )
        return laser

    @model_validator(mode="after")
    def _not_finer_than_light(self) -> LaserFile:
        second_mrad = self.divergence_elevation_mrad or self.divergence_mrad
        least_mrad = min(self.divergence_mrad, second_mrad)
        if self.exit_diameter_mm is None or least_mrad == 0.0:
            return self
        limit = least_mrad / beam.beam_quality(
            exit_diameter_m=si(self.exit_diameter_mm, "mm"),
            divergence_rad=si(least_mrad, "mrad"),
            wavelength_m=si(self.wavelength_nm, "nm"),
        )
        if least_mrad < limit * (1.0 - 1e-3):
            key = "divergence_mrad" if second_mrad >= self.divergence_mrad else "divergence_elevation_mrad"
            raise ValueError(
                f"{key}: must be >= {limit:.3g} for a beam of {self.exit_diameter_mm:g} mm (M2 of 1), "
                f"got {least_mrad:g}"
            )
        return self


class TdcFile(Table[Tdc]):
    """[tdc]: comparator and time-to-digital converter."""

    keep: Keep = Field(
        default="first",
        description=(
            'which crossings, if there are more; `"strongest_and_last"` are two, the second '
            'strongest if the strongest is the last; `"all"` is the first 16, without `stops`'
        ),
    )
    edges: Literal["rising", "both"] | None = Field(
        default=None,
        description=(
            '`"rising"` or `"both"`: which edges of a pulse are timed; both give `pulse_width`, '
            "and the walk of saturated pulses. Left out: both for a SiPM or with `saturation_ua`,"
            " else rising"
        ),
    )

    @model_validator(mode="after")
    def _one_threshold(self) -> TdcFile:
        if (self.threshold_to_noise is None) == (self.threshold_level is None):
            raise ValueError("one of threshold_to_noise and threshold_level must be given, got both or none")
        check_stops(self.keep, self.stops if "stops" in self.model_fields_set else None)
        if self.blanking_ns >= 1e3 * self.window_us:
            raise ValueError(f"blanking_ns: must be < {1e3 * self.window_us:g}, the window, got {self.blanking_ns:g}")
        return self

    def build(self, detector: Detector) -> Tdc:
        """Convert to SI units; with ``edges`` left out, both are timed where the detector saturates."""
        stops, keep = kept_stops(self.keep, self.stops)
        both_edges = detector.saturates if self.edges is None else self.edges == "both"
        return self.in_si(stops=stops, keep=keep, both_edges=both_edges)


class ReceiverFile(Table[Receiver]):
    """[receiver]: frequency response of the amplifier."""

    bandwidth_mhz: Annotated[float, Number("mhz", ge=1e-3, le=1e5)] | None = Field(
        default=None,
        description="-3 dB of the low pass, in place of `tdc.bandwidth_mhz`, which it follows from if left out",
    )

    def build(self, tdc: Tdc) -> tuple[Receiver, Tdc]:
        """Convert to SI units; returns the receiver, and the converter with the noise bandwidth behind the low pass."""
        receiver = self.in_si()
        if self.bandwidth_mhz is None:
            return receiver, tdc
        return receiver, replace(tdc, bandwidth_hz=si(self.bandwidth_mhz, "mhz") * receiver.noise_ratio)


UNCERTAIN = ("laser", "optics", "detector", "tdc", "receiver", "histogram", "sampler")
"""Tables whose numbers may be uncertain: those that decide the range."""


class SensorFile(FileModel):
    """A whole sensor file. ``sources`` says where each number comes from, by dotted key (or its table)."""

    name: Annotated[str, Field(min_length=1)] = Field(description="name in the metadata")
    description: str = Field(default="", description="for people")
    laser: LaserFile = Field(description="laser and its beam")
    optics: OpticsFile = Field(description="lenses, filter, overlap")
    scanner: Annotated[AnyScannerFile, Field(discriminator="type")] = Field(
        description="directions and times of the pulses"
    )
    detector: Annotated[AnyDetectorFile, Field(discriminator="type")] = Field(description="APD, SiPM or SPADs")
    tdc: TdcFile | None = Field(default=None, description="comparator and converter")
    receiver: ReceiverFile = Field(default_factory=ReceiverFile, description="frequency response of the amplifier")
    histogram: HistogramFile | None = Field(default=None, description="with SPADs, in place of `tdc` and `sampler`")
    sampler: AnySamplerFile | None = Field(
        default=None, description="measures the pulses that trip the comparator; the TDC alone if left out"
    )
    mounting: PoseFile = Field(default=PoseFile(), description="pose of the sensor frame in the vehicle's")
    imu: ImuFile | None = Field(default=None, description="an IMU in the same housing; none if left out")
    wear: WearFile | None = Field(
        default=None, description="dirt and drops on the window, weak lasers, a shifted mounting; as new if left out"
    )
    power: PowerFile | None = Field(
        default=None, description="electrical power, for design studies; not known if left out"
    )
    intensity: AnyIntensityFile | None = Field(
        default=None, description="the maker's scale; the amplitude itself if left out"
    )
    driver: DriverName | None = Field(
        default=None, description="of the maker for ROS: how it counts `ring`, lays out points, and names topics"
    )
    published: PublishedFile | None = Field(
        default=None, description="the maker's claims; the simulation does not use them"
    )
    sources: dict[str, str] = Field(default_factory=dict, description="sources of the numbers, by dotted key or table")
    uncertainty: dict[str, Annotated[float, Field(gt=0, le=1e12)]] = Field(
        default_factory=dict, description="how far a number may be off, either way, by dotted key and in its unit"
    )

    @model_validator(mode="after")
    def _keys_of_numbers(self) -> SensorFile:
        unknowns = {} if self.published is None else self.published.unknowns
        for where, keys in (("uncertainty", self.uncertainty), ("published.unknowns", unknowns)):
            for key in keys:
                table, _, field = key.partition(".")
                value = getattr(getattr(self, table, None), field, None) if table in UNCERTAIN else None
                if isinstance(value, bool) or not isinstance(value, (int, float)):
                    raise ValueError(f"{where}.{key}: must be a number of {', '.join(UNCERTAIN)} in this file")
        return self

    @model_validator(mode="after")
    def _one_way_of_timing(self) -> SensorFile:
        if self.tdc is None:
            return self
        timing = self.tdc.timing
        if self.sampler is not None and timing != "leading_edge":
            raise ValueError(f'tdc.timing: not "{timing}" together with [sampler], which times the pulses')
        if timing != "constant_fraction" and "fraction" in self.tdc.model_fields_set:
            raise ValueError('tdc.fraction: only with timing = "constant_fraction"')
        if self.tdc.strong_above is None:
            for key in ("strong_jitter_ps", "strong_spread"):
                if key in self.tdc.model_fields_set:
                    raise ValueError(f"tdc.{key}: must go with tdc.strong_above, got none")
        if timing == "matched_filter" and self.detector.in_si().counts_whole_cells:
            raise ValueError('detector.counting: must be "gaussian" behind a matched filter, got "binomial"')
        return self

    @model_validator(mode="after")
    def _drifts_from_a_filter(self) -> SensorFile:
        if self.laser.drift_nm and self.optics.filter is None:
            raise ValueError("laser.drift_nm: must go with optics.filter, whose band the laser leaves, got none")
        return self

    @model_validator(mode="after")
    def _one_receiver(self) -> SensorFile:
        counts = self.detector.in_si().fills_histogram
        for key, required in (("tdc", not counts), ("histogram", counts)):
            if (getattr(self, key) is not None) != required:
                verb = "must be given" if required else "must be left out"
                raise ValueError(f'{key}: {verb} with detector.type = "{self.detector.type}"')
        if counts and "receiver" in self.model_fields_set:
            raise ValueError('receiver: must be left out with detector.type = "spad", whose firings are counted')
        if counts and self.laser.slope_broadening:
            raise ValueError(
                'laser.slope_broadening: must be left out with detector.type = "spad", use rays > 1 instead'
            )
        if counts and self.sampler is not None:
            raise ValueError('sampler: must be left out with detector.type = "spad", which has a histogram')
        return self

    @model_validator(mode="after")
    def _window_within_a_period(self) -> SensorFile:
        rate_khz = self.laser.repetition_rate_khz
        if rate_khz is None and self.scanner.firing_rate_hz is None:
            raise ValueError(
                f'laser.repetition_rate_khz: must be given with scanner.type = "{self.scanner.type}", got none'
            )
        period_us = self.scanner.shot_period_us(1e6 / self._rate_hz)
        if self.tdc is not None and self.tdc.window_us > period_us * (1.0 + 1e-9):
            raise ValueError(f"tdc.window_us: must be <= {period_us:g}, the pulse period, got {self.tdc.window_us:g}")
        return self

    def build(self, folder: Path) -> Sensor:
        """Build the sensor in SI units; the files that it names lie in ``folder``.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        detector: Detector = self.detector.in_si()
        laser = self.laser.build(self._rate_hz)
        optics = self.optics.build(folder, laser.wavelength_m, drift_m=si(self.laser.drift_nm, "nm"))
        if self.optics.overlap is not None:
            geometry = overlap_geometry(laser, optics, detector, self.optics.overlap.build())
            optics = replace(optics, overlap=Overlap.from_geometry(geometry))
        wear, scanner = None, self._scanner(optics, folder)
        if self.wear is not None:
            optics = self.wear.worn_optics(optics, laser.wavelength_m)
            overlap_file = self.optics.overlap
            left_mm, up_mm = (0.0, 0.0) if overlap_file is None else overlap_file.transmitter_offset_mm
            wear = self.wear.build(
                optics=optics, laser=laser, scanner=scanner, offset_m=(si(left_mm, "mm"), si(up_mm, "mm"))
            )
        receiver, tdc = self.receiver.build(self._converter(detector))
        sensor = Sensor(
            name=self.name,
            description=self.description,
            driver=self.driver or "",
            laser=laser,
            optics=optics,
            scanner=scanner,
            detector=detector,
            tdc=tdc,
            receiver=receiver,
            histogram=self._histogram(detector),
            mounting=self.mounting.pose(),
            wear=wear,
            imu=None if self.imu is None else self.imu.build(folder),
            power=None if self.power is None else self.power.in_si(),
            intensity=None if self.intensity is None else self.intensity.in_si(),
            sources=dict(self.sources),
            uncertainty={
                name: half * factor for key, half in self.uncertainty.items() for name, factor in [key_in_si(key)]
            },
        )
        _check_response(sensor)
        if optics.stray is not None:
            find_volleys(sensor.scanner, optics.stray)  # refuses what cannot be
            if optics.stray.glare_photons is not None and sensor.histogram is None:
                raise InputError(
                    "optics.stray.glare_photons: must go with [histogram], whose returns are counted in photons"
                )
        _check_columns(sensor)
        if self.sampler is None:
            return sensor
        return replace(sensor, sampler=self.sampler.build(1e9 * float(sensor.received_fwhm_s)))

    @property
    def _rate_hz(self) -> float:
        """Points per second. A histogram's shots, and so the rate of its points, follow from the scanner's mode."""
        rate_khz = self.laser.repetition_rate_khz
        firing_rate_hz = self.scanner.firing_rate_hz
        if firing_rate_hz is not None and (self.histogram is not None or rate_khz is None):
            return firing_rate_hz
        return si(float(rate_khz or 0.0), "khz")

    @property
    def _dwell_us(self) -> float:
        """Time of one point."""
        return self.scanner.shot_period_us(1e6 / self._rate_hz)

    def _converter(self, detector: Detector) -> Tdc:
        if self.histogram is not None:
            return self.histogram.converter(self._dwell_us)
        assert self.tdc is not None
        return self.tdc.build(detector)

    def _histogram(self, detector: Detector) -> Histogram | None:
        if self.histogram is None:
            return None
        assert isinstance(detector, Spad)
        return self.histogram.build(
            dead_time_s=math.inf if detector.stamps == "first" else float(detector.dead_time_s),
            jitter_s=float(detector.jitter_s),
            spads=float(detector.spads),
            coincidence=detector.coincidence,
            pulse_fwhm_ns=float(self.laser.pulse_fwhm_ns),
            dwell_us=self._dwell_us,
            turn_rate_rad_s=self.scanner.turn_rate_rad_s,
        )

    def _scanner(self, optics: Optics, folder: Path) -> Scanner:
        context = ScannerContext(
            rate_hz=self._rate_hz,
            lens_radius_m=float(optics.aperture_radius_m),
            focal_length_m=float(optics.focal_length_m),
            folder=folder,
        )
        return self.scanner.build(context)


def _check_columns(sensor: Sensor) -> None:
    """Raise InputError for columns that cannot share their noise."""
    if sensor.histogram is None:
        return
    if sensor.histogram.column_weights is None:
        for key in ("column_range_sigmas", "column_photons"):
            if getattr(sensor.histogram, key) is not None:
                raise InputError(f"histogram.{key}: must go with histogram.column_weights, got none")
        return
    if sensor.histogram.estimator != "matched_filter":
        raise InputError(
            f'histogram.column_weights: must go with estimator = "matched_filter", got "{sensor.histogram.estimator}"'
        )
    if sensor.histogram.column_range_sigmas is not None and not isinstance(sensor.scanner, Spinning):
        raise InputError('histogram.column_range_sigmas: must be left out unless scanner.type = "spinning"')
    line = sensor.scanner.line_pulses
    if line is None or line >= sensor.scanner.pulses:
        raise InputError(
            "histogram.column_weights: must be left out for a scanner without columns that follow each other"
        )


def _check_response(sensor: Sensor) -> None:
    """Raise InputError for a frequency response that this detector or pulse cannot have."""
    rate = sensor.coupling_rate
    if rate is not None and sensor.laser.slope_broadening:
        raise InputError("laser.slope_broadening: must be left out with receiver.ac_coupling_khz, use rays > 1 instead")
    if rate is not None and rate > high_pass.WIDEST_RATE:
        coupling_khz, factor = 1e-3 * float(sensor.receiver.ac_coupling_hz or 0.0), high_pass.WIDEST_RATE / rate
        raise InputError(
            f"receiver.ac_coupling_khz: must be <= {factor * coupling_khz:.4g}, behind which the received pulse keeps "
            f"its shape, got {coupling_khz:g}"
        )
    if sensor.receiver.filters and sensor.detector.counts_whole_cells:
        raise InputError('detector.counting: must be "gaussian" behind a filter, got "binomial"')


def read_sensor(path: Path, *, overrides: Sequence[str] = ()) -> Sensor:
    """Read a sensor from a TOML file, with ``detector.gain=60``-like overrides.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    return sensor_from_tables(read_toml(path), where=str(path), overrides=overrides, folder=path.parent)


def sensor_from_tables(
    tables: dict[str, Any],
    *,
    where: str,
    overrides: Sequence[str] = (),
    over: Sequence[str] = (),
    folder: Path | None = None,
    option: str = "overrides",
) -> Sensor:
    """Build a sensor from the tables of a sensor file.

    Args:
        where: file, which errors name
        over: keys that a study varies, which errors name too
        folder: of the files that it names
        option: Python's name of the argument that has the overrides

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    changed = changed_tables(tables, overrides)
    parts, others = split_parts(overrides)
    named, option = (over, "over") if over else (parts, option)
    file = validate(SensorFile, changed, where, overrides=others, always=named, option=option)
    try:
        sensor = file.build(folder or Path())
    except InputError as error:
        raise change_error(named, str(error), where=where, option=option) from None
    object.__setattr__(sensor, "origin", SensorTables(changed, where, folder))
    return sensor


@dataclass(frozen=True, slots=True)
class SensorTables:
    """Tables that a sensor was built from: a function of changes, KEY=VALUE, that builds it anew.

    Attributes:
        tables: of the file, with all changes so far
        where: file, for messages
    """

    tables: dict[str, Any]
    where: str
    folder: Path | None

    def __call__(self, changes: Sequence[str]) -> Sensor:
        """Build the sensor with these changes.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        name = os.path.basename(self.where).removesuffix(".toml")  # the caller has a sensor, and no file
        return sensor_from_tables(self.tables, where=name, overrides=changes, folder=self.folder, option="changes")

    def with_part_of(self, name: str, other: SensorTables) -> Sensor:
        """Build the sensor with a part of another one, as `Sensor.with_detector` does with one of the catalogue.

        Raises:
            InputError: for parts that do not fit each other
        """
        changed = with_part_of(self.tables, name, other.tables, other.folder or Path())
        return sensor_from_tables(changed, where=self.where, folder=self.folder)

    def full_key(self, key: str) -> str:
        """Key with the name of its table, where it stands in one table alone; else as it is."""
        tables = [name for name, table in self.tables.items() if isinstance(table, dict) and key in table]
        values = [name for name in tables if name not in ("sources", "uncertainty", "published")]
        return f"{values[0]}.{key}" if len(values) == 1 and key not in self.tables else key

    def text(self) -> str:
        """TOML of the tables; files that they name are found from any folder."""
        return tomlkit.dumps(with_absolute_files(self.tables, self.folder or Path()))


def files_of_sensor(path: Path, *, overrides: Sequence[str] = ()) -> Iterator[Path]:
    """List the sensor file, those whose parts it has, and those that they name: a pattern, a filter.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    file = validate(SensorFile, changed_tables(read_toml(path), overrides), str(path), overrides=overrides)
    yield path
    yield from part_files(overrides)
    yield from (path.parent / name for name in file.scanner.files)
    if file.imu is not None:
        yield from file.imu.files(path.parent)
    if file.optics.filter is not None and file.optics.filter.csv is not None:
        yield path.parent / file.optics.filter.csv


def sensors() -> list[str]:
    """Names of the catalogue's sensors, which `load_sensor`, `render` and the studies take."""
    return names("sensors")


@checks_arguments
def load_sensor(sensor: str | os.PathLike[str] | Sensor, *, overrides: Overrides = ()) -> Sensor:
    """Load a sensor by catalogue name, or from a file if the name ends in .toml; a `Sensor` is returned as it is.

    Args:
        overrides: changes to the file's values: "detector.gain=60", a list of these, or {"detector.gain": 60}; the
            name or file of a sensor in place of a table, "detector=sipm-905", means that part of it

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    changes = assignments(overrides)
    if isinstance(sensor, Sensor):
        return sensor.replace(changes) if changes else sensor
    return read_sensor(sensor_path(os.fspath(sensor)), overrides=changes)


def published_performance(name: str) -> PublishedFile | None:
    """Read the maker's published performance of a sensor, by catalogue name or file; None if its file has none.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    return read_published(sensor_path(name))
