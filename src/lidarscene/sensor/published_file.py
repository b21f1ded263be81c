"""What the maker publishes of a sensor, for comparison; nothing of it enters the simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from ..files.toml import FileModel, read_toml, validated

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(gt=0, le=1)]


class PublishedFile(FileModel):
    """[published]: performance and its conditions; what is left out is not published."""

    range_m: Positive | None = None
    reflectivity: Share | None = Field(default=None, description="of the target at that range")
    illuminance_klux: NotNegative | None = Field(default=None, description="at that range")
    also: tuple[tuple[Share, Positive], ...] = Field(
        default=(), description="further reflectivities and ranges, at the same illuminance"
    )
    precision_m: Positive | None = Field(default=None, description="standard deviation of the range")
    precision_at_m: Positive | None = Field(default=None, description="range of that target")
    precision_reflectivity: Share | None = Field(default=None, description="of that target")
    points_per_second: Positive | None = Field(default=None, description="one return, as rounded there")
    assumed: tuple[str, ...] = Field(
        default=(), description="keys of conditions above that are not published but assumed"
    )
    source: Annotated[str, Field(min_length=1)]

    @model_validator(mode="after")
    def _complete(self) -> PublishedFile:
        for value, conditions in (
            ("range_m", ("reflectivity", "illuminance_klux")),
            ("precision_m", ("precision_at_m", "precision_reflectivity", "illuminance_klux")),
        ):
            missing = [key for key in conditions if getattr(self, key) is None]
            if getattr(self, value) is not None and missing:
                raise ValueError(
                    f"{value} needs {' and '.join(missing)}; name it in assumed if it is not known"
                )
        if self.also and self.illuminance_klux is None:
            raise ValueError("also needs illuminance_klux; name it in assumed if it is not known")
        for key in self.assumed:
            if key not in type(self).model_fields or getattr(self, key) is None:
                raise ValueError(f"assumed names {key}, which has no value here")
        return self


def read_published(path: Path) -> PublishedFile | None:
    """[published] of a sensor file, None where it has none. Raises InputError."""
    tables = read_toml(path)
    if "published" not in tables:
        return None
    return validated(PublishedFile, tables["published"], f"{path}: published")
