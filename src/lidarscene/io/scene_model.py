"""What a scene file may hold: the pydantic models of its tables."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..scene import Air
from .material_file import MaterialFile
from .sensor_file import PoseFile, Vector
from .toml_file import FileModel

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Length = Annotated[float, Field(gt=0, le=1e6)]
Name = Annotated[str, Field(min_length=1)]


class SunFile(FileModel):
    """[sun]: direction towards it and illuminance on a surface that faces it."""

    azimuth_deg: float = 0.0
    elevation_deg: Annotated[float, Field(ge=-90, le=90)] = 45.0
    illuminance_klux: NotNegative = 100.0


class SkyFile(FileModel):
    """[sky]: diffuse irradiance as a share of the sun's at normal incidence."""

    diffuse_share: NotNegative = 0.0


class AirFile(FileModel):
    """[air]: one of the three ways to say it; clear (transmittance 1) without."""

    transmittance: Annotated[float, Field(gt=0, le=1)] | None = None
    extinction_per_m: NotNegative | None = None
    visibility_km: Positive | None = None
    model: Literal["kruse", "kim"] = "kim"

    @model_validator(mode="after")
    def _only_one(self) -> AirFile:
        given = [
            k for k in ("transmittance", "extinction_per_m", "visibility_km") if getattr(self, k) is not None
        ]
        if len(given) > 1:
            raise ValueError(f"one way to say it was expected, {' and '.join(given)} came")
        return self

    def build(self) -> Air:
        """The air in metres."""
        return Air(
            transmittance=1.0 if self.transmittance is None else self.transmittance,
            extinction_per_m=self.extinction_per_m or 0.0,
            visibility_m=math.inf if self.visibility_km is None else self.visibility_km * 1e3,
            model=self.model,
        )


class SceneSensorFile(PoseFile):
    """[sensor]: which sensor by default (a catalogue name or a file), and where it stands."""

    name: Name = "table1-apd"


class PictureFile(FileModel):
    """[picture]: where pictures of the scene are taken from; chosen by what is near the sensor without."""

    eye_m: Vector
    target_m: Vector
    fov_deg: Annotated[float, Field(gt=0, lt=180, description="across")] = 60.0

    @model_validator(mode="after")
    def _not_from_above(self) -> PictureFile:
        if self.eye_m[:2] == self.target_m[:2]:
            raise ValueError("eye_m and target_m one above the other: which way is up cannot be told")
        return self


# What gives the size of each shape; a mesh has its own.
_SIZES: dict[str | None, tuple[str, ...]] = {
    None: (),
    "plane": ("size_m",),
    "box": ("size_m",),
    "sphere": ("radius_m",),
    "cylinder": ("radius_m", "height_m"),
}
_LENGTHS = {"plane": 2, "box": 3}


class BodyFile(PoseFile):
    """[[bodies]]: a mesh file or a primitive, its materials, and where it stands.

    Instances stand in the body's own frame, and are bodies named NAME.0, NAME.1, ...
    """

    name: Name
    mesh: Name | None = None
    primitive: Literal["plane", "box", "sphere", "cylinder"] | None = None
    size_m: tuple[Length, ...] | None = None
    radius_m: Length | None = None
    height_m: Length | None = None
    class_name: str = Field(default="", alias="class", description="the body's name if left out")
    material: Name | None = Field(default=None, description="for all sub-meshes that materials does not name")
    materials: dict[str, Name] = Field(default_factory=dict, description="sub-mesh to material")
    scale: Length = 1.0
    instances: Annotated[tuple[PoseFile, ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _one_shape(self) -> BodyFile:
        if (self.mesh is None) == (self.primitive is None):
            raise ValueError("one of mesh and primitive was expected, not both or none")
        shape = f"a {self.primitive}" if self.primitive else "a mesh"
        needed = _SIZES[self.primitive]
        given = [k for k in ("size_m", "radius_m", "height_m") if getattr(self, k) is not None]
        if set(given) != set(needed):
            expected = f"takes {' and '.join(needed)}" if needed else "has its own size"
            raise ValueError(f"{shape} {expected}, {' and '.join(given) or 'none'} came")
        length = _LENGTHS.get(self.primitive or "")
        if length and len(self.size_m or ()) != length:
            raise ValueError(f"size_m of {shape} has {length} numbers, {len(self.size_m or ())} came")
        if self.primitive and self.material is None:
            raise ValueError("key 'material' is missing")
        if self.primitive and self.materials:
            raise ValueError(f"materials is for the sub-meshes of a mesh, {shape} has only 'material'")
        return self


class SceneFile(FileModel):
    """A whole scene file."""

    name: str = ""
    description: str = ""
    base: Name | None = Field(default=None, description="Mitsuba XML scene whose shapes are added")
    base_materials: dict[str, Name] = Field(default_factory=dict, description="BSDF id in it to material")
    sun: SunFile = SunFile()
    sky: SkyFile = SkyFile()
    air: AirFile = AirFile()
    sensor: SceneSensorFile = SceneSensorFile()
    picture: PictureFile | None = None
    materials: dict[str, MaterialFile] = Field(default_factory=dict)
    bodies: tuple[BodyFile, ...] = ()

    @model_validator(mode="after")
    def _something(self) -> SceneFile:
        if not self.bodies and self.base is None:
            raise ValueError("the scene is empty: [[bodies]] or base = ... was expected")
        if self.base_materials and self.base is None:
            raise ValueError("base_materials came without base")
        return self
