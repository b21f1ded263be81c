"""The scanner in a sensor file: one model for each mechanism, in the units that people write, to a `Scanner`."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..errors import InputError
from ..files.toml import FileModel
from ..scan import Bank, FacetSize, Flash, Pattern, Polygon, Raster, Risley, Spinning, Wedge
from ..scan.flash import LARGEST_HEIGHT
from .pattern import read_pattern
from .scanner_tables import (
    Count,
    LissajousFile,
    MirrorFile,
    Positive,
    Rotation,
    ScannerFile,
    Share,
    Surroundings,
)

Elevation = Annotated[float, Field(ge=-90, le=90)]
Beam = Annotated[float, Field(ge=-45, le=45)]
Azimuth = Annotated[float, Field(ge=-360, le=360)]
Millimetres = Annotated[float, Field(ge=-1e4, le=1e4)]


class RasterFile(ScannerFile):
    """[scanner] type = "raster": an even grid of directions, both edges included."""

    type: Literal["raster"]
    azimuth_fov_deg: Annotated[float, Field(gt=0, le=360)]
    elevation_fov_deg: Annotated[float, Field(gt=0, le=180)]
    azimuth_step_deg: Positive
    elevation_step_deg: Positive

    @model_validator(mode="after")
    def _steps_fit(self) -> RasterFile:
        for axis in ("azimuth", "elevation"):
            fov, step = getattr(self, f"{axis}_fov_deg"), getattr(self, f"{axis}_step_deg")
            if step > fov:
                raise ValueError(f"{axis}_step_deg = {step} is wider than {axis}_fov_deg = {fov}")
        pulses = (self.azimuth_fov_deg / self.azimuth_step_deg + 1) * (
            self.elevation_fov_deg / self.elevation_step_deg + 1
        )
        if pulses > 2**31 - 1:
            raise ValueError(f"{pulses:.3g} pulses in a frame came, fewer than 2^31 were expected")
        return self

    def build(self, around: Surroundings) -> Raster:
        """In SI units."""
        return Raster.from_field_of_view(
            azimuth_fov=self.azimuth_fov_deg, elevation_fov=self.elevation_fov_deg,
            azimuth_step=self.azimuth_step_deg, elevation_step=self.elevation_step_deg,
            unit_rad=math.pi / 180.0, rate_hz=around.rate_hz,
        ).with_errors(jitter_rad=self.jitter_rad, encoder_rad=self.encoder_rad)  # fmt: skip


class SpinningFile(ScannerFile):
    """[scanner] type = "spinning": a rotating head; the lists have one entry for each laser."""

    type: Literal["spinning"]
    rotation_hz: Rotation = Field(description="positive is counter-clockwise seen from above")
    cycle_us: Positive | None = Field(default=None, description="from cycle to cycle, if clocked by time")
    columns_per_turn: Count | None = Field(
        default=None, description="cycles in a turn, if clocked by the encoder"
    )
    start_azimuth_deg: Azimuth = 0.0
    elevation_deg: Annotated[tuple[Elevation, ...], Field(min_length=1)]
    azimuth_offset_deg: tuple[Azimuth, ...] | None = None
    firing_time_us: tuple[Annotated[float, Field(ge=0)], ...] | None = Field(
        default=None, description="after the start of the cycle; all at once if left out"
    )
    forward_mm: tuple[Millimetres, ...] | None = Field(default=None, description="of the exits, in the head")
    left_mm: tuple[Millimetres, ...] | None = None
    height_mm: tuple[Millimetres, ...] | None = None

    @property
    def cycle_s(self) -> float:
        """From cycle to cycle."""
        if self.cycle_us is not None:
            return self.cycle_us * 1e-6
        assert self.columns_per_turn is not None
        return 1.0 / (abs(self.rotation_hz) * self.columns_per_turn)

    def shot_period_us(self, pulse_period_us: float) -> float:
        """Each laser has a receiver of its own, which listens until that laser's next pulse."""
        return self.cycle_s * 1e6

    @model_validator(mode="after")
    def _fits_together(self) -> SpinningFile:
        if (self.cycle_us is None) == (self.columns_per_turn is None):
            raise ValueError("one of cycle_us and columns_per_turn was expected, not both or none")
        if self.rotation_hz == 0.0:
            raise ValueError("a rotation_hz other than 0 was expected")
        lasers = len(self.elevation_deg)
        for key in ("azimuth_offset_deg", "firing_time_us", "forward_mm", "left_mm", "height_mm"):
            values = getattr(self, key)
            if values is not None and len(values) != lasers:
                raise ValueError(f"{key} has {len(values)} entries, elevation_deg has {lasers}")
        if self.firing_time_us and max(self.firing_time_us) * 1e-6 >= self.cycle_s:
            raise ValueError(f"firing_time_us beyond the cycle of {self.cycle_s * 1e6:g} us came")
        if lasers / self.cycle_s > (2**31 - 1) * abs(self.rotation_hz):
            raise ValueError("fewer than 2^31 pulses in a frame were expected")
        return self

    def build(self, around: Surroundings) -> Spinning:
        """In SI units; the laser's rate must be what the firing table gives, to 1 %."""
        lasers = len(self.elevation_deg)
        rate_hz = lasers / self.cycle_s
        if abs(around.rate_hz / rate_hz - 1.0) > 0.01:
            raise InputError(
                f"laser.repetition_rate_khz = {around.rate_hz * 1e-3:g} came, but {lasers} lasers every"
                f" {self.cycle_s * 1e6:g} us fire {rate_hz * 1e-3:.3f} thousand pulses a second"
            )
        zeros = (0.0,) * lasers
        starts = self.forward_mm, self.left_mm, self.height_mm
        x, y, z = ([1e-3 * value for value in values or zeros] for values in starts)
        return Spinning.of(
            rotation_hz=self.rotation_hz,
            cycle_s=None if self.cycle_us is None else self.cycle_s,
            cycles_per_turn=self.columns_per_turn,
            bank=Bank(
                elevation_rad=[math.radians(a) for a in self.elevation_deg],
                azimuth_rad=[math.radians(a) for a in self.azimuth_offset_deg or zeros],
                firing_s=[1e-6 * t for t in self.firing_time_us or zeros],
                start_m=None if starts == (None, None, None) else (x, y, z),
            ),
            start_azimuth_rad=math.radians(self.start_azimuth_deg),
        ).with_errors(jitter_rad=self.jitter_rad, encoder_rad=self.encoder_rad)


class PolygonFile(ScannerFile):
    """[scanner] type = "polygon": one line for each facet."""

    type: Literal["polygon"]
    rotation_hz: Rotation = Field(description="positive is counter-clockwise seen from above")
    facet_tilt_deg: Annotated[tuple[Annotated[float, Field(ge=-40, le=40)], ...], Field(min_length=3)] = (
        Field(
            description="of each facet against the axis, in the order in which they pass; positive looks up"
        )
    )
    duty: Share = Field(default=1.0, description="part of a facet's time in which pulses leave")
    incidence_deg: Annotated[float, Field(ge=0, le=80)] = 45.0
    side: Literal["left", "right"] = "left"
    inradius_mm: Positive | None = Field(
        default=None,
        description="from the axis to the facets; without it the facets cut nothing off the aperture",
    )

    @model_validator(mode="after")
    def _faces_the_beam(self) -> PolygonFile:
        if self.rotation_hz == 0.0:
            raise ValueError("a rotation_hz other than 0 was expected")
        swing = self.incidence_deg + self.duty * 180.0 / len(self.facet_tilt_deg)
        if swing >= 90.0:
            raise ValueError(
                f"facets that always face the beam were expected; with incidence_deg = {self.incidence_deg:g} and"
                f" duty = {self.duty:g} they turn to {swing:g} degrees from it"
            )
        return self

    def build(self, around: Surroundings) -> Polygon:
        """In SI units."""
        facets = len(self.facet_tilt_deg)
        on_facet = around.rate_hz * self.duty / (facets * abs(self.rotation_hz))
        if not 1.0 - 1e-6 <= on_facet < 2**24:
            raise InputError(f"scanner: {on_facet:.3g} pulses on each facet came, 1 to 2^24 were expected")
        return Polygon.of(
            rate_hz=around.rate_hz, rotation_hz=self.rotation_hz, duty=self.duty,
            tilt_rad=[math.radians(a) for a in self.facet_tilt_deg],
            incidence_rad=math.radians(self.incidence_deg), side=self.side,
            size=None if self.inradius_mm is None else FacetSize(
                inradius_m=self.inradius_mm * 1e-3, lens_radius_m=around.lens_radius_m
            ),
        ).with_errors(jitter_rad=self.jitter_rad, encoder_rad=self.encoder_rad)  # fmt: skip


class WedgeFile(FileModel):
    """One prism of a Risley scanner, the first one next to the laser."""

    angle_deg: Annotated[float, Field(gt=0, le=45)]
    index: Annotated[float, Field(ge=1, le=4)]
    rotation_hz: Rotation = Field(description="positive from the left to the top")
    phase_deg: float = Field(
        default=0.0, description="of the thick side at the start, from the left to the top"
    )
    inclined_face: Literal["in", "out"] = Field(description="out is towards the scene")


class RisleyFile(ScannerFile):
    """[scanner] type = "risley": two or three rotating wedges."""

    type: Literal["risley"]
    wedges: Annotated[tuple[WedgeFile, ...], Field(min_length=2, max_length=3)]
    frame_hz: Positive
    beam_elevation_deg: Annotated[tuple[Beam, ...], Field(min_length=1)] | None = Field(
        default=None, description="of each laser before the prisms; one along the axis if left out"
    )

    def build(self, around: Surroundings) -> Risley:
        """In SI units."""
        elevations = self.beam_elevation_deg
        beams = None if elevations is None else [math.radians(e) for e in elevations]
        scanner = Risley.of(
            rate_hz=around.rate_hz, frame_hz=self.frame_hz,
            wedges=[
                Wedge.of(
                    rate_hz=around.rate_hz, angle_rad=math.radians(w.angle_deg), index=w.index,
                    rotation_hz=w.rotation_hz, phase_rad=math.radians(w.phase_deg), tilted=w.inclined_face,
                )
                for w in self.wedges
            ],
            beam_elevation_rad=beams,
        ).with_errors(jitter_rad=self.jitter_rad, encoder_rad=self.encoder_rad)  # fmt: skip
        if any(self._reflects(scanner, beam) for beam in beams or (None,)):
            raise InputError(
                "scanner: light is totally reflected in these wedges; smaller angle_deg were expected"
            )
        return scanner

    def _reflects(self, scanner: Risley, elevation_rad: float | None) -> bool:
        """Whether a beam is lost on its way; on the axis only the wedges' phases to each other matter."""
        phases = np.radians(np.arange(0.0, 360.0, 5.0))
        first = np.zeros(1) if elevation_rad is None else phases
        turned = np.meshgrid(first, *[phases] * (len(self.wedges) - 1), indexing="ij", sparse=True)
        start = None if elevation_rad is None else np.array(elevation_rad)
        with np.errstate(divide="ignore", invalid="ignore"):  # behind a face that reflects all
            share = np.asarray(scanner.through(tuple(turned), start)[1])
        return not bool(np.all(share > 0.0))


class FlashFile(ScannerFile):
    """[scanner] type = "flash": all pixels at once; the laser's rate is that of the flashes."""

    type: Literal["flash"]
    columns: Count
    rows: Count
    pixel_pitch_um: Positive
    projection: Literal["rectilinear", "equidistant", "equisolid", "stereographic", "orthographic"] = (
        "rectilinear"
    )
    falloff: Literal["pupil", "pupil_and_pixel"] = Field(
        default="pupil",
        description="what weakens the edge: foreshortened pupil, or solid angle of the pixels too",
    )

    @model_validator(mode="after")
    def _nothing_turns(self) -> FlashFile:
        if self.encoder_step_deg is not None:
            raise ValueError("encoder_step_deg came, but nothing turns in a flash")
        if self.columns * self.rows > 2**31 - 1:
            raise ValueError("fewer than 2^31 pixels were expected")
        return self

    def build(self, around: Surroundings) -> Flash:
        """In SI units."""
        pitch = self.pixel_pitch_um * 1e-6 / around.focal_length_m
        height = 0.5 * pitch * math.hypot(self.columns - 1, self.rows - 1)
        if height >= LARGEST_HEIGHT[self.projection]:
            raise InputError(
                f"scanner: a pixel {height:.3g} focal lengths off the axis came, less than"
                f" {LARGEST_HEIGHT[self.projection]:.3g} was expected of a lens that is {self.projection}"
            )
        return Flash(
            columns=self.columns, rows=self.rows, pitch=pitch, frame_rate_hz=around.rate_hz,
            projection=self.projection, falloff=self.falloff, jitter_rad=self.jitter_rad,
        )  # fmt: skip


class TableFile(ScannerFile):
    """[scanner] type = "table": a pattern of one's own, CSV or npz."""

    type: Literal["table"]
    file: Annotated[str, Field(min_length=1)] = Field(
        description="with columns azimuth_deg, elevation_deg, time_s (or _rad, _ms, _us) and, if wanted, channel"
    )
    frame_ms: Positive | None = Field(
        default=None, description="length of a frame; from the times if left out"
    )

    def build(self, around: Surroundings) -> Pattern:
        """In SI units."""
        return read_pattern(
            around.folder / self.file,
            frame_s=None if self.frame_ms is None else self.frame_ms * 1e-3,
            jitter_rad=self.jitter_rad,
            encoder_rad=self.encoder_rad,
        )


AnyScannerFile = (
    RasterFile
    | SpinningFile
    | MirrorFile
    | LissajousFile
    | PolygonFile
    | RisleyFile
    | FlashFile
    | TableFile
)  # fmt: skip
