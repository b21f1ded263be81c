"""Scene files: TOML (or a Mitsuba XML) in, `Scene` out. Paths in a scene file are relative to it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..errors import InputError
from ..materials import Material, Spectrum
from ..scene import Air, Ball, Body, Part, Scene, Sky, Sun
from . import meshes
from .material_file import MaterialFile
from .sensor_file import PoseFile
from .toml_file import FileModel, read_toml, validated

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
MaterialLookup = Callable[[str], Material]


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
            raise ValueError(
                f"one of transmittance, extinction_per_m and visibility_km was expected, {given} came"
            )
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
    """[sensor]: which sensor by default, and where it stands."""

    name: str = "table1-apd"


class BodyFile(PoseFile):
    """[[bodies]]: a mesh file or a primitive, its materials, and where it stands (or its instances)."""

    name: str
    mesh: str | None = None
    primitive: Literal["plane", "box", "sphere", "cylinder"] | None = None
    size_m: tuple[Positive, ...] | None = None
    radius_m: Positive | None = None
    height_m: Positive | None = None
    class_name: str = Field(default="", alias="class")
    material: str | None = None
    materials: dict[str, str] = Field(default_factory=dict)
    scale: Positive = 1.0
    instances: tuple[PoseFile, ...] | None = None

    @model_validator(mode="after")
    def _one_shape(self) -> BodyFile:
        if (self.mesh is None) == (self.primitive is None):
            raise ValueError("one of mesh and primitive was expected, not both or none")
        needed = {None: (), "plane": ("size_m",), "box": ("size_m",), "sphere": ("radius_m",)}.get(
            self.primitive, ("radius_m", "height_m")
        )
        given = {k for k in ("size_m", "radius_m", "height_m") if getattr(self, k) is not None}
        if given != set(needed):
            what = f"primitive '{self.primitive}'" if self.primitive else "a mesh"
            raise ValueError(
                f"{what} takes {' and '.join(needed) or 'no size'}, {sorted(given) or 'none'} came"
            )
        length = {"plane": 2, "box": 3}.get(self.primitive or "")
        if length and self.size_m is not None and len(self.size_m) != length:
            raise ValueError(f"size_m of a {self.primitive} has {length} numbers, {len(self.size_m)} came")
        if self.primitive and self.material is None:
            raise ValueError("key 'material' is missing")
        return self


class SceneFile(FileModel):
    """A whole scene file."""

    name: str = ""
    description: str = ""
    base: str | None = None
    base_materials: dict[str, str] = Field(default_factory=dict)
    sun: SunFile = SunFile()
    sky: SkyFile = SkyFile()
    air: AirFile = AirFile()
    sensor: SceneSensorFile = SceneSensorFile()
    materials: dict[str, MaterialFile] = Field(default_factory=dict)
    bodies: tuple[BodyFile, ...] = ()


def read_scene(path: Path, *, catalogue: MaterialLookup) -> Scene:
    """A scene from a TOML or Mitsuba XML file; ``catalogue`` finds materials the file does not define.

    Raises InputError, one line that names the file and the key.
    """
    if path.suffix.lower() == ".xml":
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        return Scene(name=path.stem, base=path)
    return scene_from_model(validated(SceneFile, read_toml(path), str(path)), path=path, catalogue=catalogue)


def scene_from_model(file: SceneFile, *, path: Path, catalogue: MaterialLookup) -> Scene:
    """A scene from a checked scene file that lies at ``path``."""
    materials = {name: model.build(name) for name, model in file.materials.items()}
    bodies: list[Body] = []
    for index, body in enumerate(file.bodies):
        where = f"{path}: bodies[{index}] ('{body.name}')"
        parts = _parts(body, folder=path.parent, where=where, materials=materials)
        bodies.extend(_placed(body, parts))
    _check_names(bodies, path)
    wanted = {part.material for body in bodies for part in body.parts} | set(file.base_materials.values())
    for name in sorted(wanted - set(materials)):
        try:
            materials[name] = catalogue(name)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    base = path.parent / file.base if file.base else None
    if base is not None and not base.is_file():
        raise InputError(f"{path}: base: no such file {base}")
    if not bodies and base is None:
        raise InputError(f"{path}: the scene has no bodies")
    return Scene(
        name=file.name or path.stem,
        bodies=tuple(bodies),
        materials=materials,
        sun=Sun(
            azimuth_rad=math.radians(file.sun.azimuth_deg),
            elevation_rad=math.radians(file.sun.elevation_deg),
            illuminance_klux=file.sun.illuminance_klux,
        ),
        sky=Sky(diffuse_share=file.sky.diffuse_share),
        air=file.air.build(),
        sensor_name=_sensor_name(file.sensor.name, path.parent),
        sensor_pose=file.sensor.pose(),
        base=base,
        base_materials=file.base_materials,
    )


def _sensor_name(name: str, folder: Path) -> str:
    """A catalogue name as it is, a sensor file relative to the scene file."""
    return str(folder / name) if name.endswith(".toml") else name


def _check_names(bodies: list[Body], path: Path) -> None:
    seen: set[str] = set()
    for body in bodies:
        if body.name in seen:
            raise InputError(f"{path}: two bodies are named '{body.name}'; every name once was expected")
        seen.add(body.name)


def _placed(body: BodyFile, parts: tuple[Part | Ball, ...]) -> list[Body]:
    """The body, or one for each of its instances (named NAME.0, NAME.1, ...)."""
    label = body.class_name or body.name
    if body.instances is None:
        return [Body(name=body.name, class_name=label, parts=parts, pose=body.pose())]
    return [
        Body(name=f"{body.name}.{i}", class_name=label, parts=parts, pose=placed.pose())
        for i, placed in enumerate(body.instances)
    ]


def _parts(
    body: BodyFile, *, folder: Path, where: str, materials: dict[str, Material]
) -> tuple[Part | Ball, ...]:
    """The body's shape, scaled, with a material name for every part."""
    if body.mesh is not None:
        return _mesh_parts(body, folder / body.mesh, where=where, materials=materials)
    material = body.material or ""
    size = body.size_m or ()
    if body.primitive == "sphere":
        return (Ball(radius_m=(body.radius_m or 0.0) * body.scale, material=material),)
    if body.primitive == "plane":
        vertices, faces = meshes.plane_mesh(size_m=(size[0] * body.scale, size[1] * body.scale))
    elif body.primitive == "box":
        vertices, faces = meshes.box_mesh(size_m=tuple(s * body.scale for s in size))  # type: ignore[arg-type]
    else:
        vertices, faces = meshes.cylinder_mesh(
            radius_m=(body.radius_m or 0.0) * body.scale, height_m=(body.height_m or 0.0) * body.scale
        )
    return (Part(vertices_m=vertices, faces=faces, material=material, name=body.name),)


def _mesh_parts(
    body: BodyFile, path: Path, *, where: str, materials: dict[str, Material]
) -> tuple[Part | Ball, ...]:
    try:
        pieces = meshes.read_mesh(path)
    except InputError as error:
        raise InputError(f"{where}: mesh: {error}") from None
    known = {key for piece in pieces for key in piece.keys}
    unknown = sorted(set(body.materials) - known)
    if unknown:
        raise InputError(
            f"{where}: materials: no sub-mesh '{unknown[0]}' in {path.name}; it has {', '.join(sorted(known))}"
        )
    parts = []
    for piece in pieces:
        named = next((body.materials[key] for key in piece.keys if key in body.materials), body.material)
        if named is None:
            named = _own_material(piece, path, where, materials)
        parts.append(
            Part(
                vertices_m=piece.vertices_m * body.scale,
                faces=piece.faces,
                material=named,
                name=piece.keys[0],
            )
        )
    return tuple(parts)


def _own_material(piece: meshes.SubMesh, path: Path, where: str, materials: dict[str, Material]) -> str:
    """The mesh file's own colour as a diffuse surface: an estimate, since colours are not infrared."""
    if piece.grey is None:
        raise InputError(
            f"{where}: no material for sub-mesh '{piece.keys[0]}' of {path.name}; give material = ..."
        )
    name = f"{path.stem}:{piece.keys[0]}"
    materials[name] = Material(
        name=name, bsdf="diffuse", reflectivity=Spectrum.constant(piece.grey),
        description="estimate: mean of the mesh file's base colour",
    )  # fmt: skip
    return name
