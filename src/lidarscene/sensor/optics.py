"""[optics] of a sensor file: the receiver, and how the laser's spot lies in its field of view."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from ..files.toml import FileModel
from .filter_file import FilterFile
from .model import Halo, Laser, Optics
from .overlap import Overlap

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(gt=0, le=1)]
Millimetres = Annotated[float, Field(ge=-1e4, le=1e4)]


class OverlapFile(FileModel):
    """[optics.overlap]: where the transmitter stands beside the receiver, and at what range this is in focus."""

    transmitter_offset_mm: tuple[Millimetres, Millimetres] = Field(
        default=(0.0, 0.0), description="to the left and up from the receiver's axis, where the beam leaves"
    )
    parallax_free_at_m: Positive | None = Field(
        default=None, description="range at which the two axes meet; side by side if left out"
    )
    focus_at_m: Positive | None = Field(
        default=None, description="range that is in focus; infinity if left out"
    )

    def build(self, *, optics: Optics, laser: Laser, detector_radius_m: float) -> Overlap:
        """The share of the spot in the field of view, by range."""
        return Overlap.of(
            profile=laser.profile,
            half_divergence_rad=0.5 * laser.mean_divergence_rad,
            exit_radius_m=0.5 * (laser.exit_diameter_m or 0.0),
            aperture_radius_m=optics.aperture_radius_m,
            field_rad=detector_radius_m / optics.focal_length_m,
            offset_m=1e-3 * math.hypot(*self.transmitter_offset_mm),
            crossing_m=self.parallax_free_at_m or math.inf,
            focus_m=self.focus_at_m or math.inf,
        )


class HaloFile(FileModel):
    """[optics.halo]: light that window and lens scatter around the beam, out and back together."""

    share: Annotated[float, Field(gt=0, lt=1)] = Field(
        description="of a wide surface's echo that comes from the halo"
    )
    divergence_mrad: Annotated[float, Field(gt=0, le=500)] = Field(description="full angle at 1/e^2")

    def build(self) -> Halo:
        """In SI units."""
        return Halo(share=self.share, divergence_rad=self.divergence_mrad * 1e-3)


class OpticsFile(FileModel):
    """[optics]: the receiver."""

    aperture_radius_mm: Positive
    focal_length_mm: Positive
    efficiency_laser: Share
    efficiency_sun: Share
    sun_irradiance_w_m2: NotNegative | None = Field(
        default=None, description="in band, normal incidence, at 100 klux; or a filter to compute it from"
    )
    filter: FilterFile | None = None
    overlap: OverlapFile | None = Field(
        default=None,
        description="of spot and field of view; the spot is wholly in it, and sharp, if left out",
    )
    halo: HaloFile | None = Field(
        default=None, description="around the beam, with four rays a pulse or more; none if left out"
    )

    @model_validator(mode="after")
    def _one_sun(self) -> OpticsFile:
        if (self.sun_irradiance_w_m2 is None) == (self.filter is None):
            raise ValueError("one of sun_irradiance_w_m2 and filter was expected, not both or none")
        return self

    @model_validator(mode="after")
    def _focus_beyond_the_lens(self) -> OpticsFile:
        focus = None if self.overlap is None else self.overlap.focus_at_m
        if focus is not None and focus * 1e3 < 10.0 * self.focal_length_mm:
            raise ValueError(
                f"overlap.focus_at_m: at least ten focal lengths were expected "
                f"({0.01 * self.focal_length_mm:g} m), {focus:g} came"
            )
        return self

    def build(self, folder: Path) -> Optics:
        """In SI units, without the overlap; a filter's transmittance file lies in ``folder``."""
        sun = self.sun_irradiance_w_m2 if self.filter is None else self.filter.sun_irradiance_w_m2(folder)
        return Optics(
            aperture_radius_m=self.aperture_radius_mm * 1e-3,
            focal_length_m=self.focal_length_mm * 1e-3,
            efficiency_laser=self.efficiency_laser,
            efficiency_sun=self.efficiency_sun,
            sun_irradiance_w_m2=sun,
            halo=None if self.halo is None else self.halo.build(),
        )
