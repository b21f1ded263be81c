"""The scanner in a sensor file: one model for each mechanism, in the units that people write, to a `Scanner`.

What can be wrong about a mechanism depends on others of its numbers (a facet that turns away from the beam, a laser
that fires after its cycle). Such mistakes are refused here, by key, before anything is traced.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..errors import InputError
from ..files.table_model import Number, Table
from ..maths.units import si
from ..scan import Flash, Pattern, Polygon, Raster, Risley, Spinning, Wedge
from ..scan.flash import LARGEST_HEIGHT
from .pattern_file import read_pattern
from .scanner_tables import LissajousFile, MirrorFile, ScannerContext, ScannerFile, require_fewer

Millimetres = Annotated[float, Number("mm", ge=-1e4, le=1e4, finest=0.1)]


class RasterFile(ScannerFile[Raster]):
    """[scanner] type = "raster": an even grid of directions, both edges included."""

    type: Literal["raster"]

    @model_validator(mode="after")
    def _steps_fit(self) -> RasterFile:
        for axis in ("azimuth", "elevation"):
            fov, step = getattr(self, f"{axis}_fov_deg"), getattr(self, f"{axis}_step_deg")
            if step > fov:
                raise ValueError(f"{axis}_step_deg: must be <= {fov:g}, {axis}_fov_deg, got {step:g}")
        pulses = (self.azimuth_fov_deg / self.azimuth_step_deg + 1) * (
            self.elevation_fov_deg / self.elevation_step_deg + 1
        )
        require_fewer(pulses)
        return self


class SpinningFile(ScannerFile[Spinning]):
    """[scanner] type = "spinning": a rotating head; the lists have one entry for each laser."""

    type: Literal["spinning"]
    elevation_shift_deg: Annotated[float, Field(ge=-10, le=10)] = Field(
        default=0.0, description="added to all elevations: how one unit differs from another"
    )
    elevation_scale: Annotated[float, Field(ge=0.8, le=1.2)] = Field(
        default=1.0, description="factor of all elevations, before the shift"
    )
    forward_mm: tuple[Millimetres, ...] | None = Field(default=None, description="of the exits, in the head")
    left_mm: tuple[Millimetres, ...] | None = None
    height_mm: tuple[Millimetres, ...] | None = None

    @property
    def cycle_s(self) -> float:
        """Time from cycle to cycle."""
        if self.cycle_us is not None:
            return si(float(self.cycle_us), "us")
        return 1.0 / float(abs(self.rotation_hz) * self.columns_per_turn)

    def shot_period_us(self, pulse_period_us: float) -> float:
        """Each laser has a receiver of its own, which listens until that laser's next pulse."""
        return self.cycle_s * 1e6

    @model_validator(mode="after")
    def _fits_together(self) -> SpinningFile:
        if (self.cycle_us is None) == (self.columns_per_turn is None):
            raise ValueError("one of cycle_us and columns_per_turn must be given, got both or none")
        if self.rotation_hz == 0.0:
            raise ValueError("rotation_hz: must not be 0")
        lasers = len(self.elevation_deg)
        for key in (
            "azimuth_offset_deg",
            "firing_time_us",
            "forward_mm",
            "left_mm",
            "height_mm",
            "responsivity",
            "background_gain",
        ):
            values = getattr(self, key)
            if values is not None and len(values) != lasers:
                raise ValueError(f"{key}: must have {lasers} entries, as elevation_deg has, got {len(values)}")
        last_us = max(self.firing_time_us or (0.0,))
        if si(last_us, "us") >= self.cycle_s:
            raise ValueError(f"firing_time_us: must be < {self.cycle_s * 1e6:g}, the cycle, got {last_us:g}")
        require_fewer(lasers / self.cycle_s / abs(self.rotation_hz))
        return self

    def build(self, context: ScannerContext) -> Spinning:
        """Convert to SI units; the laser's rate must agree with the firing table to 1 %. Raises InputError."""
        lasers = len(self.elevation_deg)
        rate_hz = lasers / self.cycle_s
        # The rate follows from the firing table. The file states it too, for the laser: both must agree.
        if abs(context.rate_hz / rate_hz - 1.0) > 0.01:
            raise InputError(
                f"laser.repetition_rate_khz: must be {rate_hz * 1e-3:.3f}, for {lasers} lasers every"
                f" {self.cycle_s * 1e6:g} us, got {context.rate_hz * 1e-3:g}"
            )
        starts = self.forward_mm, self.left_mm, self.height_mm
        x, y, z = (si(values or (0.0,) * lasers, "mm") for values in starts)
        elevation_deg = [
            self.elevation_scale * angle_deg + self.elevation_shift_deg for angle_deg in self.elevation_deg
        ]
        if max(map(abs, elevation_deg)) > 90.0:
            raise InputError(f"scanner: elevations must be -90 to 90 degrees, got {max(elevation_deg, key=abs):g}")
        return self.in_si(
            elevation_rad=si(tuple(elevation_deg), "deg"), start_m=None if starts == (None, None, None) else (x, y, z)
        )


class PolygonFile(ScannerFile[Polygon]):
    """[scanner] type = "polygon": one line for each facet."""

    type: Literal["polygon"]

    @model_validator(mode="after")
    def _faces_the_beam(self) -> PolygonFile:
        if self.rotation_hz == 0.0:
            raise ValueError("rotation_hz: must not be 0")
        # The last pulse of a facet finds it turned by half of the duty's part of a facet.
        swing = self.incidence_deg + self.duty * 180.0 / len(self.facet_tilt_deg)
        if swing >= 90.0:
            raise ValueError(
                f"facets must turn by < 90 degrees from the beam, got {swing:g} with"
                f" incidence_deg = {self.incidence_deg:g} and duty = {self.duty:g}"
            )
        return self

    def build(self, context: ScannerContext) -> Polygon:
        """Convert to SI units; only a facet of known size needs the lens. Raises InputError if a facet has no pulse."""
        facets = len(self.facet_tilt_deg)
        on_facet = context.rate_hz * self.duty / (facets * abs(self.rotation_hz))
        # float32 counts columns exactly up to 2^24.
        if not 1.0 - 1e-6 <= on_facet < 2**24:
            raise InputError(f"scanner: must have 1 to 2^24 pulses on each facet, got {on_facet:.3g}")
        lens_radius_m = None if self.inradius_mm is None else context.lens_radius_m
        return self.in_si(rate_hz=context.rate_hz, lens_radius_m=lens_radius_m)


class WedgeFile(Table[Wedge]):
    """One prism of a Risley scanner, the first one next to the laser."""


class RisleyFile(ScannerFile[Risley]):
    """[scanner] type = "risley": two or three rotating wedges."""

    type: Literal["risley"]
    wedges: Annotated[tuple[WedgeFile, ...], Field(min_length=2, max_length=3)]

    def build(self, context: ScannerContext) -> Risley:
        """Convert to SI units. Raises InputError if light does not pass the wedges at every position."""
        scanner = self.in_si(
            rate_hz=context.rate_hz, wedges=tuple(wedge.in_si(rate_hz=context.rate_hz) for wedge in self.wedges)
        )
        beams: tuple[float, ...] | None = si(self.beam_elevation_deg, "deg")
        if any(self._reflects(scanner, beam) for beam in beams or (None,)):
            raise InputError("scanner: light is totally reflected in these wedges; they need a smaller angle_deg")
        return scanner

    def _reflects(self, scanner: Risley, elevation_rad: float | None) -> bool:
        """True if a beam is totally reflected; on the axis only the wedges' phases relative to each other matter."""
        # All positions of the wedges to each other, in steps of 15 degrees: the losses change slowly with the angle,
        # and are largest where all thick sides are in one plane with the beam, which these steps meet.
        phases = np.radians(np.arange(0.0, 360.0, 15.0))
        first = np.zeros(1) if elevation_rad is None else phases
        turned = np.meshgrid(first, *[phases] * (len(self.wedges) - 1), indexing="ij", sparse=True)
        start = None if elevation_rad is None else np.array(elevation_rad)
        with np.errstate(divide="ignore", invalid="ignore"):  # behind a face that reflects all
            share = np.asarray(scanner.refract(tuple(turned), start)[1])
        return not bool(np.all(share > 0.0))


class FlashFile(ScannerFile[Flash]):
    """[scanner] type = "flash": all pixels at once; the laser's rate is that of the flashes."""

    type: Literal["flash"]
    pixel_pitch_um: Annotated[float, Number("um", ge=0.01, le=1e4)]

    @model_validator(mode="after")
    def _nothing_turns(self) -> FlashFile:
        if self.encoder_step_deg is not None:
            raise ValueError("encoder_step_deg: nothing turns in a flash")
        if self.columns * self.rows > 2**31 - 1:
            raise ValueError(f"must have fewer than 2^31 pixels, got {self.columns * self.rows:.3g}")
        return self

    def build(self, context: ScannerContext) -> Flash:
        """Convert to SI units, the pitch over the focal length. Raises InputError for pixels that the lens misses."""
        pitch = si(self.pixel_pitch_um, "um") / context.focal_length_m
        height = 0.5 * pitch * math.hypot(self.columns - 1, self.rows - 1)
        if height >= LARGEST_HEIGHT[self.projection]:
            raise InputError(
                f"scanner: pixels must be < {LARGEST_HEIGHT[self.projection]:.3g} focal lengths off the axis of"
                f" a lens that is {self.projection}, got {height:.3g}"
            )
        return self.in_si(pitch=pitch, frame_rate_hz=context.rate_hz)


class TableFile(ScannerFile[Pattern]):
    """[scanner] type = "table": a pattern of one's own, CSV or npz."""

    type: Literal["table"]
    file: Annotated[str, Field(min_length=1)] = Field(
        description="with columns azimuth_deg, elevation_deg, time_s (or _rad, _ms, _us) and, if wanted, channel"
    )
    frame_ms: Annotated[float, Number("ms", ge=1e-3, le=1e7)] | None = Field(
        default=None, description="length of a frame; from the times if left out"
    )

    def build(self, context: ScannerContext) -> Pattern:
        """Read the pattern's file and convert it to SI units. Raises InputError."""
        return read_pattern(context.folder / self.file, frame_s=si(self.frame_ms, "ms"), **self.values_in_si())


AnyScannerFile = (
    RasterFile | SpinningFile | MirrorFile | LissajousFile | PolygonFile | RisleyFile | FlashFile | TableFile
)
