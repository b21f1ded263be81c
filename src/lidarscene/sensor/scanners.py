"""The scanner in a sensor file: one model for each mechanism, in the units that people write, to a `Scanner`."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..errors import InputError
from ..files.toml import FileModel
from ..maths.units import si
from ..scan import Flash, Pattern, Polygon, Raster, Risley, Spinning, Wedge
from ..scan.flash import LARGEST_HEIGHT
from .pattern import read_pattern
from .scanner_tables import (
    LissajousFile,
    MirrorFile,
    Positive,
    Rotation,
    ScannerFile,
    Surroundings,
)

Millimetres = Annotated[float, Field(ge=-1e4, le=1e4)]


class RasterFile(ScannerFile[Raster]):
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
            fov=(self.azimuth_fov_deg, self.elevation_fov_deg),
            step=(self.azimuth_step_deg, self.elevation_step_deg),
            unit_rad=math.pi / 180.0, rate_hz=around.rate_hz, **self.values_in_si(),
        )  # fmt: skip


class SpinningFile(ScannerFile[Spinning]):
    """[scanner] type = "spinning": a rotating head; the lists have one entry for each laser."""

    type: Literal["spinning"]
    forward_mm: tuple[Millimetres, ...] | None = Field(default=None, description="of the exits, in the head")
    left_mm: tuple[Millimetres, ...] | None = None
    height_mm: tuple[Millimetres, ...] | None = None

    @property
    def cycle_s(self) -> float:
        """From cycle to cycle."""
        if self.cycle_us is not None:
            return si(float(self.cycle_us), "us")
        return 1.0 / float(abs(self.rotation_hz) * self.columns_per_turn)

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
        if self.firing_time_us and si(max(self.firing_time_us), "us") >= self.cycle_s:
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
        starts = self.forward_mm, self.left_mm, self.height_mm
        x, y, z = (si(values or (0.0,) * lasers, "mm") for values in starts)
        return self.in_si(start_m=None if starts == (None, None, None) else (x, y, z))


class PolygonFile(ScannerFile[Polygon]):
    """[scanner] type = "polygon": one line for each facet."""

    type: Literal["polygon"]

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
        lens_radius_m = None if self.inradius_mm is None else around.lens_radius_m
        return self.in_si(rate_hz=around.rate_hz, lens_radius_m=lens_radius_m)


class WedgeFile(FileModel):
    """One prism of a Risley scanner, the first one next to the laser."""

    angle_deg: Annotated[float, Field(gt=0, le=45)]
    index: Annotated[float, Field(ge=1, le=4)]
    rotation_hz: Rotation = Field(description="positive from the left to the top")
    phase_deg: float = Field(
        default=0.0, description="of the thick side at the start, from the left to the top"
    )
    inclined_face: Literal["in", "out"] = Field(description="out is towards the scene")

    def build(self, rate_hz: float) -> Wedge:
        """In SI units."""
        return Wedge.of(
            rate_hz=rate_hz, angle_rad=math.radians(self.angle_deg), index=self.index,
            rotation_hz=self.rotation_hz, phase_rad=math.radians(self.phase_deg), tilted=self.inclined_face,
        )  # fmt: skip


class RisleyFile(ScannerFile[Risley]):
    """[scanner] type = "risley": two or three rotating wedges."""

    type: Literal["risley"]
    wedges: Annotated[tuple[WedgeFile, ...], Field(min_length=2, max_length=3)]

    def build(self, around: Surroundings) -> Risley:
        """In SI units."""
        scanner = self.in_si(
            rate_hz=around.rate_hz, wedges=tuple(one.build(around.rate_hz) for one in self.wedges)
        )
        beams: tuple[float, ...] | None = si(self.beam_elevation_deg, "deg")
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


class FlashFile(ScannerFile[Flash]):
    """[scanner] type = "flash": all pixels at once; the laser's rate is that of the flashes."""

    type: Literal["flash"]
    pixel_pitch_um: Positive

    @model_validator(mode="after")
    def _nothing_turns(self) -> FlashFile:
        if self.encoder_step_deg is not None:
            raise ValueError("encoder_step_deg came, but nothing turns in a flash")
        if self.columns * self.rows > 2**31 - 1:
            raise ValueError("fewer than 2^31 pixels were expected")
        return self

    def build(self, around: Surroundings) -> Flash:
        """In SI units."""
        pitch = si(self.pixel_pitch_um, "um") / around.focal_length_m
        height = 0.5 * pitch * math.hypot(self.columns - 1, self.rows - 1)
        if height >= LARGEST_HEIGHT[self.projection]:
            raise InputError(
                f"scanner: a pixel {height:.3g} focal lengths off the axis came, less than"
                f" {LARGEST_HEIGHT[self.projection]:.3g} was expected of a lens that is {self.projection}"
            )
        return self.in_si(pitch=pitch, frame_rate_hz=around.rate_hz)


class TableFile(ScannerFile[Pattern]):
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
        return read_pattern(around.folder / self.file, frame_s=si(self.frame_ms, "ms"), **self.values_in_si())


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
