"""A raster: rows of constant elevation from the top down, each from the left (positive azimuth) to the right.

The paper's figures use such an ideal scanner. Directions are given, not derived from a mirror (a real mirror's raster
is `scan.mirror_raster`), so there is no aperture to derive either: A(theta_r) = A(0).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import model_validator

from ..maths.arrays import Lanes, xp
from ..maths.units import Quantity
from .base import Encoder, GivenAngles, Jitter, LineByLine
from .clock import PulseClock
from .scanner_file import ScannerFile, require_fewer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Raster(LineByLine, GivenAngles):
    """Even grid of directions around the sensor's x axis, both edges of the field of view included; see `create`."""

    columns: int
    rows: int
    azimuth_step_rad: Lanes
    elevation_step_rad: Lanes
    rate_hz: float

    @classmethod
    def create(
        cls,
        *,
        azimuth_fov_rad: Annotated[float, Quantity("deg", gt=0, le=360, about="full angle")],
        elevation_fov_rad: Annotated[float, Quantity("deg", gt=0, le=180, about="full angle")],
        azimuth_step_rad: Annotated[float, Quantity("deg", ge=1e-6, le=360, about="between columns")],
        elevation_step_rad: Annotated[float, Quantity("deg", ge=1e-6, le=180, about="between rows")],
        rate_hz: float,
        jitter_rad: Jitter = None,
        encoder_rad: Encoder = None,
    ) -> Raster:
        """Build from the full angles of the field of view and the steps."""
        # 120 / 0.2 is 599.99... in binary: allow 1e-6 of a step before rounding down.
        columns, rows = (
            int(fov / step + 1e-6) + 1
            for fov, step in ((azimuth_fov_rad, azimuth_step_rad), (elevation_fov_rad, elevation_step_rad))
        )
        return cls(
            columns=columns,
            rows=rows,
            rate_hz=rate_hz,
            azimuth_step_rad=azimuth_step_rad,
            elevation_step_rad=elevation_step_rad,
            jitter_rad=jitter_rad,
            encoder_rad=encoder_rad,
        )

    @property
    def frame_s(self) -> float:
        """Length of a frame, without a fly-back."""
        return self.pulses / self.rate_hz

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        ops = xp(pulse)
        row, column = self._row_and_column(pulse)
        # Twice the offset from the centre is a whole number, so the middle of the grid is exactly zero.
        azimuth = ops.float32(self.columns - 1 - 2 * column) * (0.5 * self.azimuth_step_rad)
        elevation = ops.float32(self.rows - 1 - 2 * row) * (0.5 * self.elevation_step_rad)
        return azimuth, elevation

    @property
    def clock(self) -> PulseClock:
        """One pulse after the other, without a pause."""
        return PulseClock(rate_hz=self.rate_hz)


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
