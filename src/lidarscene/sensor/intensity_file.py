"""[intensity] of a sensor file: the scale on which the maker reports it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ..files.toml import FileModel
from .model import Intensity


class RangeCorrectedFile(FileModel):
    """[intensity] kind = "range_corrected": optical power, as if all echoes came from one range."""

    kind: Literal["range_corrected"]
    reference_m: Annotated[float, Field(gt=0)] = Field(default=10.0, description="that range")

    def build(self) -> Intensity:
        """As the sensor has it."""
        return Intensity(kind=self.kind, reference_m=self.reference_m)


class ReflectivityFile(FileModel):
    """[intensity] kind = "reflectivity": 0 to 255, from the echo's power and range."""

    kind: Literal["reflectivity"]
    white_value: Annotated[float, Field(gt=0, lt=255)] = Field(
        default=100.0, description="of a white Lambertian surface across the beam"
    )
    retro: Literal["linear", "logarithmic"] = Field(default="logarithmic", description="the scale above that")
    retro_reflectivity: Annotated[float, Field(gt=1)] = Field(
        default=1000.0, description="that reads 255 on a logarithmic scale"
    )

    def build(self) -> Intensity:
        """As the sensor has it."""
        return Intensity(
            kind=self.kind, white_value=self.white_value, retro=self.retro,
            retro_reflectivity=self.retro_reflectivity,
        )  # fmt: skip


AnyIntensityFile = Annotated[RangeCorrectedFile | ReflectivityFile, Field(discriminator="kind")]
