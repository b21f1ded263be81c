"""Tables of a scene file as pydantic models.

Keys that go together are checked here, with the table and the key in the message; `scene.scene_file` then reads a scene
that fits together.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from typing import Annotated, Literal, cast

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from ..files import pvlib
from ..files.table_model import Number, Table
from ..files.toml import FileModel
from ..materials.material_file import MaterialFile
from ..maths.units import si
from ..physics.road.roughness import Roughness, RoughSurface
from ..sensor.pose_file import PoseFile, Turned, Vector
from .ground import MOST_VERTICES, SPACING_M, Strip
from .ground_area import Outline
from .meshes.mesh_axes import Axis, Unit
from .motion import BodyMotionFile, EgoFile
from .scene import Air, Interferer, Sky, Sun, View
from .street.street_file import StreetFile
from .weather import Weather

Irradiance = Annotated[float, Number(ge=0, le=1e5)]
Length = Annotated[float, Field(gt=0, le=1e6)]
Name = Annotated[str, Field(min_length=1)]
HeightRow = Annotated[tuple[Annotated[float, Number(ge=-1e4, le=1e4)], ...], Field(min_length=2, max_length=2_000)]


USUAL_HEIGHT_M = 1.8
"""Choice: height of a sensor on the roof of a car, above a ground at 0."""


def _parse_time(value: object) -> datetime:
    """Parse a time with its offset from UTC, a TOML date-time or text.

    Raises:
        ValueError: if a value is not allowed
    """
    if isinstance(value, str):
        with suppress(ValueError):
            value = datetime.fromisoformat(value)
    if not isinstance(value, datetime):
        raise ValueError(f"must be a time such as {_TIME}, got {value}")
    if value.utcoffset() is None:
        raise ValueError(f"must have an offset from UTC, such as {_TIME}, got {value.isoformat()}")
    if not 1900 <= value.year <= 2100:
        raise ValueError(f"must be a year from 1900 to 2100, got {value.year}")
    return value


_TIME = "2026-06-21T12:00:00+02:00"


class SunFile(Table[Sun]):
    """[sun]: direction towards it, or the place and time that it follows from, and illuminance on a surface that
    faces it.
    """

    place: tuple[Annotated[float, Field(ge=-90, le=90)], Annotated[float, Field(ge=-180, le=180)]] | None = Field(
        default=None,
        description=(
            "`[latitude, longitude]` in degrees, north and east positive; with `time` in place of"
            " the angles; needs pvlib"
        ),
    )
    time: Annotated[datetime, BeforeValidator(_parse_time)] | None = Field(
        default=None, description="date and time with the offset from UTC, such as `2026-06-21T12:00:00+02:00`"
    )
    north_deg: Turned = Field(
        default=90.0, description="with `place`: azimuth of north in the scene; at 90 x points east and y north"
    )

    @model_validator(mode="after")
    def _check_single_way(self) -> SunFile:
        keys = self.model_fields_set
        by_angles, by_place = keys & {"azimuth_deg", "elevation_deg"}, keys & {"place", "time", "north_deg"}
        if by_angles and by_place:
            keys_text = " and ".join(sorted(by_angles | by_place))
            raise ValueError(f"must have the sun's angles or its place and time, got {keys_text}")
        if by_place and (self.place is None or self.time is None):
            raise ValueError(f"place and time must be given together, got {' and '.join(sorted(by_place))}")
        return self

    def build(self) -> Sun:
        """The sun in radians.

        Raises:
            LidarSceneError: where place and time are given and pvlib is missing
        """
        if self.place is None or self.time is None:
            return self.in_si()
        clockwise_deg, elevation_deg = pvlib.sun_north_up_deg(
            latitude_deg=self.place[0], longitude_deg=self.place[1], time=self.time
        )
        azimuth_deg = 180.0 - (180.0 - self.north_deg + clockwise_deg) % 360.0
        return self.in_si(azimuth_rad=si(azimuth_deg, "deg"), elevation_rad=si(elevation_deg, "deg"))


class SkyFile(Table[Sky]):
    """[sky]: diffuse irradiance as a share of the sun's at normal incidence."""


class AirFile(Table[Air]):
    """[air]: one of the three ways to say it; clear (transmittance 1) without."""

    @model_validator(mode="after")
    def _check_single_way(self) -> AirFile:
        ways = ("transmittance", "extinction_per_m", "visibility_km")
        ways_given = [key for key in ways if key in self.model_fields_set]
        if len(ways_given) > 1:
            raise ValueError(f"must have only one of {', '.join(ways)}, got {' and '.join(ways_given)}")
        return self


class WeatherFile(Table[Weather]):
    """[weather]: what falls or floats in the air, on top of [air]; none without."""


class GroundFile(FileModel):
    """[ground]: roughness of the scene's ground, on which vehicles ride."""

    roughness: Roughness = Field(default="flat", description='road class of ISO 8608; `"flat"` is a plane')
    seed: Annotated[int, Number(ge=0, le=2**32 - 1)] = Field(default=1, description="of the random surface")

    def surface(self) -> RoughSurface:
        """Draw the rough surface."""
        return RoughSurface.draw(self.roughness, self.seed)


class SceneSensorFile(PoseFile):
    """[sensor]: which sensor by default (a catalogue name or a file), and where it stands."""

    name: Name = Field(default="table1-apd", description="catalogue name, or a sensor file (a name that ends in .toml)")
    position_m: Vector = Field(
        default=(0.0, 0.0, USUAL_HEIGHT_M), description="place of the sensor; on the roof of a car if left out"
    )


class PictureFile(Table[View]):
    """[picture]: where pictures of the scene are taken from; chosen by what is near the sensor without."""

    eye_m: Vector = Field(description="where the camera is")
    target_m: Vector = Field(description="what is in the middle")

    @model_validator(mode="after")
    def _check_direction(self) -> PictureFile:
        if self.eye_m[:2] == self.target_m[:2]:
            raise ValueError("eye_m and target_m: must not be one above the other, which leaves the up direction open")
        return self


# Keys that give the size of each shape; a mesh has its own size.
_SIZES: dict[str | None, tuple[str, ...]] = {
    None: (),
    "plane": ("size_m",),
    "ground": (),
    "box": ("size_m",),
    "sphere": ("radius_m",),
    "cylinder": ("radius_m", "height_m"),
}
_LENGTHS = {"plane": 2, "ground": 2, "box": 3}
_OF_GROUND = ("outline", "line", "width_m", "offset_m", "heights_m", "crown_m", "kerb_m", "spacing_m")


class InstanceFile(PoseFile):
    """Each of a body's instances."""

    name: Name | None = Field(default=None, description="of the body; NAME.0, NAME.1, ... if left out")
    motion: BodyMotionFile | None = Field(
        default=None, description="motion in place of the body's, with the keys of `[bodies.motion]`"
    )


class BodyFile(PoseFile):
    """[[bodies]]: a mesh file or a primitive, its materials, and where it stands.

    Instances stand in the body's own frame, and are bodies named NAME.0, NAME.1, ...
    """

    name: Name = Field(description="unique")
    mesh: Name | None = Field(
        default=None, description="glTF file, USD stage, or mesh file of any format that trimesh reads"
    )
    primitive: Literal["plane", "ground", "box", "sphere", "cylinder"] | None = Field(
        default=None,
        description=(
            '`"plane"` (normal +z), `"ground"`, `"box"`, `"sphere"`, `"cylinder"` (about z), centred on the origin'
        ),
    )
    size_m: tuple[Length, ...] | None = Field(
        default=None, description="two lengths of a plane or ground, three of a box"
    )
    line: Annotated[tuple[Vector, ...], Field(min_length=2, max_length=100_000)] | None = Field(
        default=None, description="points along the middle of a ground, in place of `size_m`; straight between them"
    )
    outline: Annotated[tuple[Vector, ...], Field(min_length=3, max_length=10_000)] | None = Field(
        default=None, description="corners of a ground, once around, in place of `size_m`"
    )
    width_m: Length | None = Field(default=None, description="of a ground along a line")
    offset_m: Annotated[float, Number(ge=-1e3, le=1e3)] = Field(
        default=0.0, description="of the middle of a ground from its line, to the left"
    )
    heights_m: Annotated[tuple[HeightRow, ...], Field(min_length=2, max_length=2_000)] | None = Field(
        default=None,
        description="of a ground with `size_m`: rows on even steps along x of heights on even steps along y",
    )
    radius_m: Length | None = Field(default=None, description="of a sphere or cylinder")
    height_m: Length | None = Field(default=None, description="of a cylinder")
    crown_m: Annotated[float, Number(ge=-10, le=10)] = Field(
        default=0.0, description="height of the middle of a ground over its sides"
    )
    kerb_m: Annotated[float, Number(ge=0, le=100)] = Field(
        default=0.0, description="height of the faces down from the edges of a ground"
    )
    spacing_m: Annotated[float, Number(ge=0.01, le=1e3)] = Field(
        default=SPACING_M, description="between the vertices of a ground"
    )
    on_ground: bool = Field(default=False, description="its height counts from the ground below")
    class_name: str = Field(default="", alias="class", description="class label; the body's name if empty")
    material: Name | None = Field(
        default=None, description="for all parts that `materials` does not name; a primitive needs it"
    )
    materials: dict[str, Name] = Field(
        default_factory=dict,
        description="part to material; a part goes by its material, geometry or node name in the mesh file",
    )
    pattern: Literal["reflectivity", "colour"] | None = Field(
        default=None,
        description="feature of the mesh file that varies the reflectivity of its diffuse parts: docs/materials.md",
    )
    animation: Name | None = Field(
        default=None,
        description="animation of the glTF file that is one stride of a walker, or turns wheels: docs/streets.md",
    )
    standing: Name | None = Field(
        default=None, description="with `animation`: one that begins as the walker stands; else it stops as it is"
    )
    unit: Unit | None = Field(
        default=None, description="of the mesh file's lengths; metres if left out. A USD stage says its own"
    )
    up: Axis | None = Field(
        default=None,
        description=(
            "axis of the mesh file that points up; if left out y for glTF, by its standard, and z"
            " for all others. A USD stage says its own"
        ),
    )
    scale: Length = Field(default=1.0, description="factor on all lengths of the shape")
    motion: BodyMotionFile | None = Field(default=None, description="how it moves; still if left out")
    instances: Annotated[tuple[InstanceFile, ...], Field(min_length=1)] | None = Field(
        default=None, description="poses in the body's own frame; bodies NAME.0, NAME.1, ..."
    )

    @model_validator(mode="after")
    def _check_shape(self) -> BodyFile:
        if (self.mesh is None) == (self.primitive is None):
            raise ValueError("one of mesh and primitive must be given, got both or none")
        shape = f"a {self.primitive}" if self.primitive else "a mesh"
        needed = _SIZES[self.primitive]
        if self.primitive == "ground" and self.line is None and self.outline is None:
            needed = ("size_m",)
        sizes_given = [key for key in ("size_m", "radius_m", "height_m") if getattr(self, key) is not None]
        if set(sizes_given) != set(needed):
            sizes = " and ".join(needed) or "no size_m, radius_m or height_m"
            raise ValueError(f"{shape} must have {sizes}, got {' and '.join(sizes_given) or 'none'}")
        length = _LENGTHS.get(self.primitive or "")
        if length and self.size_m is not None and len(self.size_m or ()) != length:
            raise ValueError(f"size_m of {shape} must have {length} numbers, got {len(self.size_m or ())}")
        self._check_ground(shape)
        axes = [key for key in ("unit", "up") if getattr(self, key) is not None]
        if self.primitive and axes:
            raise ValueError(f"{axes[0]} is for meshes, {shape} has none")
        if self.primitive and self.pattern:
            raise ValueError(f"pattern is for meshes, {shape} has none")
        if self.primitive and self.animation:
            raise ValueError(f"animation is for meshes, {shape} has none")
        if self.standing and not self.animation:
            raise ValueError("standing must go with animation, got no animation")
        if self.primitive and self.material is None:
            raise ValueError("key 'material' is missing")
        if self.primitive and self.materials:
            raise ValueError(f"materials is for the sub-meshes of a mesh, {shape} has only 'material'")
        return self

    def motions(self) -> list[BodyMotionFile | None]:
        """Motion of the body, or of each of its instances; None for what stands still."""
        return [self.motion] if self.instances is None else [place.motion or self.motion for place in self.instances]

    def _check_ground(self, shape: str) -> None:
        """Raise ValueError for keys of a ground on another shape, and for a ground that cannot be laid."""
        motions = self.motions()
        if self.on_ground and any(motion is not None and motion.with_ego for motion in motions):
            raise ValueError("on_ground does not go with motion.with_ego")
        if self.primitive != "ground":
            ground_keys = [key for key in _OF_GROUND if key in self.model_fields_set]
            if ground_keys:
                raise ValueError(f"{ground_keys[0]} is for a ground, {shape} has none")
            return
        if any(pose.pitch_deg or pose.roll_deg for pose in (self, *(self.instances or ()))):
            raise ValueError("a ground must be level, got pitch_deg or roll_deg")
        if any(motion is not None for motion in motions):
            raise ValueError("a ground must stand still, got motion")
        if (self.line is None) != (self.width_m is None):
            raise ValueError(f"line and width_m must go together, got {'width_m' if self.line is None else 'line'}")
        if self.line is not None and self.outline is not None:
            raise ValueError("a ground must have one of line and outline, got both")
        if self.heights_m is not None and self.size_m is None:
            raise ValueError(f"heights_m must go with size_m, got {'line' if self.line is not None else 'outline'}")
        if self.heights_m is not None and len({len(row) for row in self.heights_m}) > 1:
            raise ValueError("rows of heights_m must have as many heights as each other")
        plan = self.plan()
        if plan.vertices > MOST_VERTICES:
            raise ValueError(
                f"a ground must have <= {MOST_VERTICES} vertices, got {plan.vertices}; spacing_m spreads them"
            )
        if isinstance(plan, Outline):
            if not plan.is_usable():
                raise ValueError("outline must not cross itself, nor be as thin as a line")
            return
        corner_m = plan.sharp_corner()
        if corner_m is not None:
            raise ValueError(
                "line must not turn back, nor bend too sharply for width_m and offset_m, got such a bend at "
                f"{corner_m[0]:g}, {corner_m[1]:g} m"
            )

    def plan(self) -> Strip | Outline:
        """Return the plan of a ground."""
        if self.outline is not None:
            return Outline(corner_m=self.scale * np.array(self.outline), spacing_m=self.spacing_m)
        if self.line is None:
            length_m, width_m = cast(tuple[float, float], self.size_m)
            heights_m = None if self.heights_m is None else self.scale * np.array(self.heights_m)
            return Strip.rectangle((self.scale * length_m, self.scale * width_m), self.spacing_m, heights_m)
        return Strip(
            line_m=self.scale * np.array(self.line),
            width_m=self.scale * (self.width_m or 0.0),
            offset_m=self.scale * self.offset_m,
            spacing_m=self.spacing_m,
        )


class LampsFile(FileModel):
    """[[interference]] kind = "lamps": headlights and street lamps, on all surfaces alike."""

    kind: Literal["lamps"]
    irradiance_w_m2: Irradiance = Field(description="of every surface, in the sensor's band")


class LidarsFile(Table[Interferer]):
    """[[interference]] kind = "lidar": pulses of another lidar, at random times, in every direction alike."""

    kind: Literal["lidar"]


AnyInterferenceFile = Annotated[LampsFile | LidarsFile, Field(discriminator="kind")]


class SceneFile(FileModel):
    """A whole scene file."""

    name: str = Field(default="", description="name in the metadata; the file's name if empty")
    description: str = Field(default="", description="free text")
    extends: Name | None = Field(default=None, description="scene, by name or file, that this one extends")
    without: tuple[Name, ...] = Field(default=(), description="bodies of that scene that are left out")
    base: Name | None = Field(
        default=None,
        description="Mitsuba XML scene whose shapes are added; body names are shape ids, their class is `unlabelled`",
    )
    base_materials: dict[str, Name] = Field(
        default_factory=dict, description="material of each BSDF id in that file (docs/own_mesh.md)"
    )
    sun: SunFile = Field(default=SunFile(), description="direction and strength of the sun")
    sky: SkyFile = Field(default=SkyFile(), description="light of the sky")
    air: AirFile = Field(default=AirFile(), description="transmittance of the air")
    weather: WeatherFile = Field(default=WeatherFile(), description="fog, rain and snow")
    interference: tuple[AnyInterferenceFile, ...] = Field(default=(), description="lamps and other lidars")
    reach_m: Annotated[float, Number(ge=10, le=1e6)] | None = Field(
        default=None,
        description="bodies farther than this from the ego vehicle may be left out of a frame: docs/streets.md",
    )
    ground: GroundFile = Field(default=GroundFile(), description="roughness of the ground")
    street: StreetFile | None = Field(
        default=None, description="street from a seed, with its houses, traffic and people"
    )
    ego: EgoFile | None = Field(default=None, description="the vehicle that carries the sensor")
    sensor: SceneSensorFile = Field(default=SceneSensorFile(), description="sensor and its pose")
    picture: PictureFile | None = Field(
        default=None, description="camera of `--picture`; else chosen by what is near the sensor"
    )
    materials: dict[str, MaterialFile] = Field(
        default_factory=dict, description="materials by name, as in docs/materials.md; they go before the catalogue's"
    )
    bodies: tuple[BodyFile, ...] = Field(default=(), description="bodies of the scene")

    @model_validator(mode="after")
    def _check_references(self) -> SceneFile:
        """Raise ValueError for a scene without shapes, or tables that lack their counterpart."""
        if self.extends is not None:
            return self  # what fits together shows with what it extends
        if not self.bodies and self.base is None and self.street is None:
            raise ValueError("the scene must have [[bodies]], [street] or base = ..., got none")
        riding = [body.name for body in self.bodies if any(motion and motion.with_ego for motion in body.motions())]
        if riding and self.ego is None and self.street is None:
            raise ValueError(f"body '{riding[0]}' moves with_ego, but there is no [ego]")
        if self.reach_m is not None and self.ego is None and self.street is None:
            raise ValueError("reach_m must go with [ego], got none")
        if self.base_materials and self.base is None:
            raise ValueError("base_materials must go with base, got no base")
        return self


def lamps_w_m2(files: Sequence[LampsFile | LidarsFile]) -> float:
    """Irradiance of all lamps together."""
    return sum(file.irradiance_w_m2 for file in files if isinstance(file, LampsFile))


def interferers(files: Sequence[LampsFile | LidarsFile]) -> tuple[Interferer, ...]:
    """The other lidars, in the order of the file."""
    return tuple(file.in_si() for file in files if isinstance(file, LidarsFile))
