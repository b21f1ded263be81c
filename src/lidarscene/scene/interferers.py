"""[[interference]] of a scene file: light that is neither the sun's nor our own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from ..files.toml import FileModel
from .model import Interferer

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class LampsFile(FileModel):
    """[[interference]] kind = "lamps": headlights and street lamps, on all surfaces alike."""

    kind: Literal["lamps"]
    irradiance_w_m2: NotNegative = Field(description="of the surfaces, in the sensor's band")


class LidarsFile(FileModel):
    """[[interference]] kind = "lidar": pulses of another lidar, at random times, in every direction alike."""

    kind: Literal["lidar"]
    rate_hz: NotNegative = Field(description="mean rate of the pulses that reach the receiver")
    irradiance_w_m2: Positive = Field(
        description="median of their peaks, at the receiver's aperture, in its band"
    )
    spread_db: Annotated[float, Field(ge=0.1, le=40)] = Field(
        default=6.0, description="standard deviation of the peaks' level"
    )

    def build(self) -> Interferer:
        """As the scene has it."""
        return Interferer(
            rate_hz=self.rate_hz, irradiance_w_m2=self.irradiance_w_m2, spread_db=self.spread_db
        )


AnyInterferenceFile = Annotated[LampsFile | LidarsFile, Field(discriminator="kind")]


def lamps_w_m2(files: Sequence[LampsFile | LidarsFile]) -> float:
    """Irradiance of all lamps together."""
    return sum(one.irradiance_w_m2 for one in files if isinstance(one, LampsFile))


def interferers(files: Sequence[LampsFile | LidarsFile]) -> tuple[Interferer, ...]:
    """The other lidars, in the order of the file."""
    return tuple(one.build() for one in files if isinstance(one, LidarsFile))
