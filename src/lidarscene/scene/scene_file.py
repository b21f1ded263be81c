"""Scene files: a TOML file, a Mitsuba XML file, a mesh file or a trimesh object in, a `Scene` out.

All sources go through `load_scene`, so they get the same checks and the same one-line errors. Paths in a scene file
are relative to it.
"""

from __future__ import annotations

import functools
import itertools
import math
import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np

from .. import catalog
from ..errors import InputError, OptionWarning, placed, warn
from ..files.arguments import CHECKED_INSIDE, checks_arguments
from ..files.overrides import Overrides, assignments, change_error, key_path, with_overrides
from ..files.toml import read_toml, validate
from ..materials.material import Material
from ..materials.material_file import catalogue_material
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.trajectory import ALWAYS, Motion, Riding
from ..physics.road.roughness import RoughSurface
from ..sensor.pose_file import LARGEST_COORDINATE_M
from .bare_mesh import is_mesh, mesh_tables, warn_of_assumptions
from .derived import extended, files_extended, from_current_folder, is_early, with_ego_mesh
from .foreign import is_xml, mitsuba_scene, object_scene, xml_file
from .ground import Ground, Sheet, lay
from .ground_area import Area
from .meshes import primitives, reading, reflectivity_patterns
from .meshes.mesh_axes import UNITS, Axis, axis_of, turn_upright
from .meshes.mesh_cache import SubMesh, WalkingClips
from .meshes.usd import is_usd
from .motion import BodyMotionFile
from .saving import SceneOrigin, saved_tables
from .scene import Ball, Body, BodyOrigin, Part, Scene, box_of
from .sizes import VEHICLES, check_vehicle, metres_text, size_text
from .street.street_tables import with_street
from .tables import BodyFile, SceneFile, interferers, lamps_w_m2
from .walking import LONGEST_STRIDE, Gait

SMALLEST_BODY_M = 1e-6
"""Accuracy bought: smallest extent of a body: below it single precision cannot resolve the corners, so its scale must
be wrong."""


SceneChoice = Annotated[str | os.PathLike[str] | Scene, CHECKED_INSIDE]
"""Name, file or `Scene`, or what else `load_scene` takes."""


@checks_arguments
def load_scene(
    scene: Any,
    *,
    overrides: Overrides = (),
    material: str | Material | None = None,
    materials: Mapping[str, str | Material] | None = None,
    classes: Mapping[str, str] | None = None,
    **settings: Any,
) -> Scene:
    """Load a scene by name or file, or make one of a mesh of trimesh, Open3D, PyVista or Mitsuba.

    Args:
        scene: a `Scene`, which is returned as it is; a TOML file, a Mitsuba XML file, a mesh file, which is put on a
            plain of asphalt, or the name of a scene that comes with the package, such as "car"
        overrides: changes to values of a TOML file: "sun.illuminance_klux=1", a list of these, or
            {"sun.illuminance_klux": 1}
        material: catalogue name or `Material` of all meshes of a Trimesh or trimesh.Scene that ``materials`` does not
            name. A mesh without either is diffuse with the mean of its own colour, if it has one.
        materials: catalogue name or `Material` by the name of a mesh's material, geometry or node; for a Mitsuba XML
            file by BSDF id, where BSDFs that are not named are used as they are
        classes: class by node of a trimesh.Scene; each node is a body, and by default a class of its own
        settings: for an XML file or a mesh, other attributes of the scene: name, sun, air, sensor_name, sensor_pose,
            ...

    Raises:
        InputError: one line with the file and the key
    """
    return _loaded(
        scene, overrides, option="overrides", settings=settings, material=material, materials=materials, classes=classes
    )


@checks_arguments
def changed_scene(scene: Any, scene_overrides: Overrides = ()) -> Scene:
    """Load a scene as `load_scene` does, for callers whose changes are ``scene_overrides``.

    Raises:
        InputError: one line with the file and the key
    """
    return _loaded(scene, scene_overrides, option="scene_overrides", settings={})


def _loaded(
    scene: Any,
    overrides: Overrides,
    *,
    option: str,
    settings: Mapping[str, Any],
    material: str | Material | None = None,
    materials: Mapping[str, str | Material] | None = None,
    classes: Mapping[str, str] | None = None,
) -> Scene:
    """See `load_scene`; messages call the argument that has the overrides ``option``."""
    changes = assignments(overrides, name=option)
    options = {"material": material, "materials": materials, "classes": classes, **settings}
    option_names = [name for name, value in options.items() if value is not None]
    if isinstance(scene, Scene):
        _refuse([*option_names, *(f"override {change}" for change in changes)], "a Scene")
        return scene
    if not isinstance(scene, (str, os.PathLike)):
        _refuse([f"override {change}" for change in changes], "a mesh")
        return object_scene(
            scene, material=material, materials=materials or {}, classes=classes or {}, settings=settings
        )
    path = scene_path(scene)
    if is_xml(path):
        _refuse_overrides(path, changes, option)
        _refuse([name for name in option_names if name in ("material", "classes")], str(path))
        return mitsuba_scene(path, materials=materials or {}, settings=settings)
    _refuse(option_names, str(path))
    model = scene_model(path, overrides=changes, option=option)
    loaded = scene_from_model(model, path=path)
    if is_mesh(path):
        warn_of_assumptions(path, loaded, up=model.bodies[1].up or "z", option=option)
    return loaded


def scenes() -> list[str]:
    """Names of the scenes that come with the package, which `load_scene` and `render` take."""
    return catalog.names("scenes")


def scene_path(scene: str | os.PathLike[str]) -> Path:
    """Path of a scene's file, or of a bare mesh; a word without a suffix is one of the catalogue.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    path = Path(scene)
    if catalog.is_bare(str(scene)):
        is_mesh_name = path.name in catalog.names("meshes") and path.name not in catalog.names("scenes")
        return catalog.path_of("meshes" if is_mesh_name else "scenes", path.name)
    reading.refuse_other_formats(path)
    # Outside of a clone there is no folder `scenes`, as examples have it.
    if path.suffix == ".toml" and not os.path.exists(path) and path.stem in catalog.names("scenes"):
        raise InputError(f"{path}: no such file; the scene that comes with lidarscene goes by its name, {path.stem}")
    return path


def _refuse(options: Sequence[str], source: str) -> None:
    """Raise InputError for the first of these options, which this kind of source does not take."""
    if options:
        raise InputError(f"load_scene: {options[0]}: does not go with {source}")


def scene_model(path: Path, *, overrides: Sequence[str] = (), option: str = "scene_overrides") -> SceneFile:
    """Read a TOML scene file, or the tables made for a bare mesh, as a checked model.

    Args:
        option: Python's name of the argument that has the overrides

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    if is_mesh(path):
        tables = mesh_tables(path, overrides, option=option)
    else:
        overrides = [from_current_folder(change) for change in overrides]
        # What decides which bodies there are comes first; then they can be changed, too.
        early = [change for change in overrides if is_early(change)]
        tables = extended(with_overrides(read_toml(path), early, option=option), path, scene_path)
        if "street" in tables:
            street = validate(SceneFile, tables, str(path), overrides=early, option=option).street
            try:
                tables = with_street(tables, street) if street is not None else tables
            except InputError as error:  # what only the whole layout shows
                raise placed(str(path), error) from None
        tables = with_ego_mesh(tables, path.parent, str(path))
        others = [change for change in overrides if change not in early]
        tables = with_overrides(tables, others, option=option)
    return validate(SceneFile, tables, str(path), overrides=overrides, option=option)


def scene_description(path: Path) -> str:
    """What a scene file says of itself, and the size of what rides with the vehicle; no street is made."""
    file = validate(SceneFile, extended(read_toml(path), path, scene_path), str(path))
    sizes = [
        f"{body.name} {_size_text(body, path.parent)}"
        for body in file.bodies
        if body.mesh and any(motion and motion.with_ego for motion in body.motions())
    ]
    return "; ".join([file.description, *sizes])


def _size_text(body: BodyFile, folder: Path) -> str:
    """Length, width and height of a body's mesh in metres, as it stands in its own frame."""
    parts = _mesh_parts(
        body.model_copy(update={"material": "asphalt", "materials": {}, "pattern": None}),
        folder / (body.mesh or ""),
        where=body.name,
        scene_materials=_SceneMaterials(SceneFile(base="none")),
        reader=reading.read_mesh,
    )
    box = box_of(parts)
    assert box is not None
    return f"{size_text(box[1] - box[0])} m"


def sensor_of_scene(scene: str | os.PathLike[str], *, overrides: Sequence[str] = ()) -> str:
    """Name or file of the scene's own sensor; no mesh is read.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    path = scene_path(scene)
    if is_xml(path):
        _refuse_overrides(path, overrides)
        return Scene(name="").sensor_name
    return catalog.located_sensor(scene_model(path, overrides=overrides).sensor.name, path.parent)


def files_of_scene(scene: str | os.PathLike[str], *, overrides: Sequence[str] = ()) -> Iterator[Path]:
    """Yield the scene file and all files that it names (meshes, base scene, poses, sensor): no output may replace them.

    The file must be one that `load_scene` accepts. Files included by an included XML file are missed.
    """
    path = scene_path(scene)
    yield path
    if is_xml(path):
        with suppress(OSError, LookupError, ValueError, ElementTree.ParseError):
            for element in ElementTree.parse(path).getroot().iter():
                if element.tag in ("string", "include"):
                    yield path.parent / (element.get("filename") or element.get("value") or "")
        return
    if not is_mesh(path):
        yield from files_extended(path, scene_path)
    file = scene_model(path, overrides=overrides)
    yield from (path.parent / body.mesh for body in file.bodies if body.mesh)
    for motion in (file.ego, *(motion for body in file.bodies for motion in body.motions())):
        if motion is not None and motion.poses_file:
            yield path.parent / motion.poses_file
    yield Path(catalog.located_sensor(file.sensor.name, path.parent))
    if file.base:
        yield from files_of_scene(path.parent / file.base)


def scene_from_model(file: SceneFile, *, path: Path) -> Scene:
    """Build the scene of a checked scene file at ``path``.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    scene_materials = _SceneMaterials(file)
    reader = functools.cache(reading.read_mesh)
    ground = _lay_ground(file)
    folder = path.parent.absolute()  # of files that are opened later, perhaps from another folder
    ego = None
    if file.ego is not None:
        ego = file.ego.motion(
            file.ego.pose(),
            height_m=ground.wheel_height_m,
            on_ground=file.ego.on_ground,
            folder=path.parent,
            where=f"{path}: ego",
        )
    sheets = iter(ground.sheets)
    bodies: list[Body] = []
    shapes: set[tuple[object, ...]] = set()
    for index, body in enumerate(file.bodies):
        where = f'{path}: bodies[{index} "{body.name}"]'
        if body.primitive == "ground":
            scene_materials.load(body.material or "", f"{where}.material")
            bodies.extend(_ground_bodies(body, ground, sheets, folder=path.parent, where=where))
            continue
        parts = _parts(body, folder=path.parent, where=where, scene_materials=scene_materials, reader=reader)
        _check_extent(parts, where)
        # Streets have many bodies of a few shapes.
        shape = body.mesh, body.unit, body.up, body.scale, body.pitch_deg, body.roll_deg
        if shape not in shapes:
            shapes.add(shape)
            _check_vehicle(body, parts, path.parent, where)
        gait = _gait(body, parts, folder=path.parent, where=where, reader=reader)
        bodies.extend(_place_body(body, parts, gait=gait, ego=ego, ground=ground, folder=path.parent, where=where))
    for first, second in itertools.pairwise(sorted(body.name for body in bodies)):
        if first == second:
            raise InputError(f"{path}: names of bodies must be unique, got '{first}' twice")
    for identity, name in file.base_materials.items():
        scene_materials.load(name, f"{path}: base_materials.{identity}")
    scene = Scene(
        name=file.name or path.stem,
        bodies=tuple(bodies),
        materials=scene_materials.materials,
        sun=file.sun.build(),
        sky=file.sky.in_si(),
        air=file.air.in_si(weather=file.weather.in_si()),
        lamps_w_m2=lamps_w_m2(file.interference),
        interferers=interferers(file.interference),
        sensor_name=catalog.located_sensor(file.sensor.name, folder),
        sensor_pose=file.sensor.pose(),
        ego=ego,
        camera=file.picture.in_si() if file.picture else None,
        base=xml_file(path.parent / file.base, f"{path}: base: ") if file.base else None,
        base_materials=file.base_materials,
        reach_m=math.inf if file.reach_m is None else file.reach_m,
    )
    return replace(scene, origin=SceneOrigin(file=file, folder=folder, scene=scene))


_FIELDS = {
    "name": ("name",), "sun": ("sun",), "sky": ("sky",), "air": ("air",), "weather": ("air",),
    "interference": ("lamps_w_m2", "interferers"), "sensor": ("sensor_name", "sensor_pose"), "picture": ("camera",),
    "reach_m": ("reach_m",),
}  # fmt: skip
"""Table of a scene file -> fields of a `Scene` that follow from it alone."""


def replaced_scene(scene: Scene, changes: Sequence[str]) -> Scene:
    """See `Scene.replace`."""
    origin: SceneOrigin | None = scene.origin
    if origin is None:
        raise InputError(
            f"'{scene.name}': must be as `load_scene` gave it for its file's keys to be replaced, got a scene made in "
            "Python; dataclasses.replace changes its fields"
        )
    path = origin.folder / f"{scene.name}.toml"
    option = "changes"
    tables = with_overrides(saved_tables(scene, path, {}), map(from_current_folder, changes), option=option)
    file = validate(SceneFile, tables, scene.name, overrides=changes, option=option)
    names = {key_path(change)[0] for change in changes}
    if list(scene.bodies) == list(origin.scene.bodies):
        return scene_from_model(file, path=path)
    if edited := sorted(names - _FIELDS.keys()):
        raise InputError(f"'{scene.name}': {edited[0]}: must be replaced before bodies are added or removed")
    new = scene_from_model(file.model_copy(update={"bodies": ()}), path=path)
    fields = {field for name in names for field in _FIELDS[name]}
    return replace(scene, **{field: getattr(new, field) for field in fields})


def _refuse_overrides(path: Path, overrides: Sequence[str], option: str = "scene_overrides") -> None:
    if overrides:
        raise change_error(overrides[:1], f"the scene must be a TOML file, got {path}", option=option)


class _SceneMaterials:
    """Materials of a scene by name: those of its file, and those of the catalogue that it uses."""

    def __init__(self, file: SceneFile) -> None:
        self.materials = {name: model.build(name) for name, model in file.materials.items()}

    def load(self, name: str, where: str) -> str:
        """Load the material of this name unless it is there, and return the name.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        if name not in self.materials:
            try:
                self.materials[name] = catalogue_material(name)
            except InputError as error:
                raise InputError(f"{where}: {error}") from None
        return name

    def add_grey(self, name: str, grey: float) -> str:
        """Add a mesh file's own colour as a diffuse material, and return its name."""
        self.materials[name] = reading.grey_material(name, grey)
        return name


def _check_extent(parts: tuple[Part | Ball, ...], where: str) -> None:
    """Refuse a body that is too small or too far away for single precision."""
    box = box_of(parts)
    assert box is not None  # `meshes.reading.check_pieces` refuses meshes without a triangle
    low, high = box
    extent, reach = float((high - low).max()), float(np.maximum(high, -low).max())
    if extent < SMALLEST_BODY_M or reach > LARGEST_COORDINATE_M:
        raise InputError(
            f"{where}: with its scale a body must be >= {SMALLEST_BODY_M:g} m across and reach <= "
            f"{LARGEST_COORDINATE_M:g} m from its origin, got {extent:.3g} m and {reach:.3g} m"
        )


def _check_vehicle(body: BodyFile, parts: tuple[Part | Ball, ...], folder: Path, where: str) -> None:
    """Check size and axis of a vehicle of a mesh file."""
    if body.mesh is None or (body.class_name or body.name) not in VEHICLES:
        return
    check_vehicle(
        [part for part in parts if isinstance(part, Part)],
        Pose.from_degrees(pitch_deg=body.pitch_deg, roll_deg=body.roll_deg),
        where=f"{where}.mesh: {folder / body.mesh}",
        name=body.name,
        unit=None if is_usd(Path(body.mesh)) else body.unit or "m",
        scale=body.scale,
        up=body.up or axis_of(Path(body.mesh)) or "z",
    )


def _lay_ground(file: SceneFile) -> Ground:
    """Lay the sheets of all grounds that do not lie on others."""
    surface = file.ground.surface()
    sheets = [
        _sheet(body, pose, surface)
        for body in file.bodies
        if body.primitive == "ground" and not body.on_ground
        for _, pose in _places(body)
    ]
    return Ground(surface=surface, sheets=sheets)


def _sheet(body: BodyFile, pose: Pose, surface: RoughSurface) -> Sheet | Area:
    """Sheet of a ground at a pose."""
    return lay(pose, plan=body.plan(), crown_m=body.crown_m, surface=surface)


def _ground_bodies(
    body: BodyFile, ground: Ground, sheets: Iterator[Sheet | Area], *, folder: Path, where: str
) -> list[Body]:
    """Build a ground, or one for each of its instances; one on the ground is laid over the meshes of the others.

    Args:
        sheets: of the grounds that are still to be built, those on the ground left out
    """
    flat = RoughSurface.draw("flat", 0)
    places = _places(body)
    laid = [_sheet(body, pose, flat) if body.on_ground else next(sheets) for _, pose in places]
    meshes = [sheet.mesh(body.kerb_m) for sheet in laid]
    if body.on_ground:
        plan_m = [pose.apply(vertices_m)[:, :2] for (_, pose), (vertices_m, _) in zip(places, meshes, strict=True)]
        ends = np.cumsum([len(place_m) for place_m in plan_m])
        rises_m = np.split(_ground_below(ground, np.concatenate(plan_m), where), ends)[:-1]
        for (vertices_m, _), rise_m in zip(meshes, rises_m, strict=True):
            vertices_m[:, 2] += rise_m
    bodies = []
    for number, ((name, pose), (vertices_m, faces)) in enumerate(zip(places, meshes, strict=True)):
        part = Part(vertices_m=vertices_m, faces=faces, material=body.material or "", name=body.name)
        _check_extent((part,), where)
        made = Body(name=name, class_name=body.class_name or body.name, parts=(part,), pose=pose)
        bodies.append(made.made_from(_origin(body, folder, number)))
    return bodies


def _ground_below(ground: Ground, place_m: Numbers, where: str) -> Numbers:
    """Height of the ground's meshes at (n, 2) places.

    Raises:
        InputError: where there is none
    """
    height_m = ground.height_m(place_m)
    if np.isnan(height_m).any():
        x, y = place_m[np.isnan(height_m)][0]
        raise InputError(f"{where}.on_ground: must have a ground below it, got none at {x:g}, {y:g} m")
    return height_m


def _places(body: BodyFile) -> list[tuple[str, Pose]]:
    """Name and pose of the body, or of each of its instances."""
    pose = body.pose()
    if body.instances is None:
        return [(body.name, pose)]
    return [
        (instance.name or f"{body.name}.{index}", pose @ instance.pose())
        for index, instance in enumerate(body.instances)
    ]


def _origin(body: BodyFile, folder: Path, number: int) -> BodyOrigin:
    """Origin of a body, the one of this number that a table gives."""
    return BodyOrigin(table=body, folder=folder.absolute(), instance=None if body.instances is None else number)


def _place_body(
    body: BodyFile,
    parts: tuple[Part | Ball, ...],
    *,
    gait: Gait | None,
    ego: Motion | None,
    ground: Ground,
    folder: Path,
    where: str,
) -> list[Body]:
    """Build the body, or one body for each of its instances."""
    label = body.class_name or body.name
    places = [(name, pose, motion) for (name, pose), motion in zip(_places(body), body.motions(), strict=True)]
    stands = np.array([body.on_ground and motion is None for _, _, motion in places], dtype=bool)
    rise_m = np.zeros((len(places), 3))
    place_m = np.array([pose.position_m[:2] for _, pose, _ in places]).reshape(-1, 2)
    rise_m[stands, 2] = _ground_below(ground, place_m[stands], where)

    def make_body(name: str, pose: Pose, motion_file: BodyMotionFile | None) -> Body:
        motion: Motion | None = None
        present_s = ALWAYS
        if motion_file is not None and motion_file.with_ego and ego is not None:
            motion = Riding(carrier=ego, pose=pose)
        elif motion_file is not None:
            motion = motion_file.motion(
                pose, height_m=ground.wheel_height_m, on_ground=body.on_ground, folder=folder, where=f"{where}.motion"
            )
            present_s = motion_file.present_s(motion)
        return Body(name=name, class_name=label, parts=parts, pose=pose, motion=motion, present_s=present_s, gait=gait)

    return [
        make_body(name, replace(pose, position_m=pose.position_m + rise_m[number]), motion).made_from(
            _origin(body, folder, number)
        )
        for number, (name, pose, motion) in enumerate(places)
    ]


MeshReader = Callable[[Path, reflectivity_patterns.Kind | None, WalkingClips | None], list[SubMesh]]


def _parts(
    body: BodyFile, *, folder: Path, where: str, scene_materials: _SceneMaterials, reader: MeshReader
) -> tuple[Part | Ball, ...]:
    """Scaled shapes of the body, each with a material name."""
    if body.material is not None:
        scene_materials.load(body.material, f"{where}.material")
    for key, name in body.materials.items():
        scene_materials.load(name, f"{where}.materials.{key}")
    if body.mesh is not None:
        return _mesh_parts(body, folder / body.mesh, where=where, scene_materials=scene_materials, reader=reader)
    material, scale = body.material or "", body.scale
    size_m = tuple(scale * length for length in body.size_m or ())
    radius_m, height_m = scale * (body.radius_m or 0.0), scale * (body.height_m or 0.0)
    if body.primitive == "sphere":
        return (Ball(radius_m=radius_m, material=material),)
    if body.primitive == "plane":
        vertices, faces = primitives.plane_mesh(size_m=cast(tuple[float, float], size_m))
    elif body.primitive == "box":
        vertices, faces = primitives.box_mesh(size_m=cast(tuple[float, float, float], size_m))
    else:
        vertices, faces = primitives.cylinder_mesh(radius_m=radius_m, height_m=height_m)
    return (Part(vertices_m=vertices, faces=faces, material=material, name=body.name),)


def _mesh_parts(
    body: BodyFile, path: Path, *, where: str, scene_materials: _SceneMaterials, reader: MeshReader
) -> tuple[Part, ...]:
    """Parts of a mesh file with materials and patterns, upright and in metres.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    try:
        pieces = reader(path, body.pattern, _clips(body))
    except InputError as error:
        raise InputError(f"{where}.mesh: {error}") from None
    sub_mesh_names = {key for piece in pieces for key in piece.keys}
    unknown = sorted(set(body.materials) - sub_mesh_names)
    if unknown:
        raise InputError(
            f"{where}.materials: no sub-mesh '{unknown[0]}' in {path.name}; it has {', '.join(sorted(sub_mesh_names))}"
        )
    pieces_and_materials = [(piece, _material_of(piece, body, where, scene_materials)) for piece in pieces]
    up, scale = _axes(body, path, where=where)
    walks = any(motion is not None for motion in body.motions())
    return tuple(
        Part(
            vertices_m=turn_upright(piece.vertices_m, up) * scale,
            faces=piece.faces,
            material=material,
            name=piece.keys[0],
            in_box=piece.in_box,
            pattern=pattern,
            cutout=piece.cutout,
            stride_m=_upright_stride(piece.stride.vertices_m, up) * scale if piece.stride and walks else None,
        )
        for (piece, material), pattern in zip(
            pieces_and_materials, _patterns(pieces_and_materials, body, where, scene_materials), strict=True
        )
    )


def _clips(body: BodyFile) -> WalkingClips | None:
    """Animations that the body plays; None: it is rigid."""
    if body.animation is None:
        return None
    return WalkingClips(walk=body.animation, standing=body.standing, unit_m=body.scale * UNITS[body.unit or "m"])


def _upright_stride(stride_m: Numbers, up: Axis) -> Numbers:
    """(k, v, 3) vertices of a stride with z up."""
    return turn_upright(stride_m.reshape(-1, 3), up).reshape(stride_m.shape)


def _gait(body: BodyFile, parts: Sequence[Part | Ball], *, folder: Path, where: str, reader: MeshReader) -> Gait | None:
    """Gait of a body that walks; None for a rigid one.

    Raises:
        InputError: if its stride leads nowhere
    """
    if body.mesh is None or body.animation is None or all(motion is None for motion in body.motions()):
        return None
    strides_m = [part.stride_m for part in parts if isinstance(part, Part) and part.stride_m is not None]
    gait = None
    if strides_m:
        strides = [piece.stride for piece in reader(folder / body.mesh, body.pattern, _clips(body))]
        period_s = next(stride.period_s for stride in strides if stride is not None)
        gait = Gait.of_strides(strides_m, period_s=period_s, stands=body.standing is not None)
    if gait is None:
        raise InputError(
            f"{where}.animation: must be a stride, in which a foot on the ground goes back, got '{body.animation}', "
            "in which none does"
        )
    size_m = float(np.ptp(np.concatenate([stride_m[0] for stride_m in strides_m]), axis=0).max())
    if gait.stride_m > LONGEST_STRIDE * size_m:
        warn(
            OptionWarning(
                "{0}.animation: '{1}' leads {2} m in {3} s, and what moves has {4} m: it must be one stride, from a "
                "foot's contact to its next",
                where,
                body.animation,
                metres_text(gait.stride_m),
                f"{period_s:.3g}",
                metres_text(size_m),
            )
        )
    return gait


def _axes(body: BodyFile, path: Path, *, where: str) -> tuple[Axis, float]:
    """Axis that points up in the body's mesh file, and the factor from its lengths to metres.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    standard_axis = axis_of(path)
    declared = [key for key in ("unit", "up") if getattr(body, key) is not None]
    if declared and is_usd(path) and (body.unit, body.up) != ("m", "z"):
        raise InputError(
            f"{where}.{declared[0]}: must be left out, since a USD stage says it, got {getattr(body, declared[0])}"
        )
    if standard_axis is not None and body.up is None and abs(abs(body.roll_deg) - 90.0) < 1.0:
        warn(
            OptionWarning(
                "{0}: {1} is {2} up by its standard and is set upright by itself, and roll_deg turns it once more: "
                'leave roll_deg out, or say up = "z"',
                where,
                path.name,
                standard_axis,
            )
        )
    return body.up or standard_axis or "z", body.scale * UNITS[body.unit or "m"]


def _patterns(
    pieces_and_materials: Sequence[tuple[SubMesh, str]], body: BodyFile, where: str, scene_materials: _SceneMaterials
) -> list[reflectivity_patterns.ReflectivityPattern | None]:
    """Pattern of each piece, None where its material is not diffuse.

    Raises:
        InputError: if no piece has one
    """
    if body.pattern is None:
        return [None] * len(pieces_and_materials)
    varied = [
        piece.pattern if scene_materials.materials[material].bsdf == "diffuse" else None
        for piece, material in pieces_and_materials
    ]
    if all(pattern is None for pattern in varied):
        has = [piece.pattern for piece, _ in pieces_and_materials]
        materials = ", ".join(sorted({name for _, name in pieces_and_materials}))
        raise InputError(
            f"{where}.pattern: {body.mesh} has no {body.pattern} of its vertices, faces or texture"
            if has == [None] * len(has)
            else f"{where}.pattern: must have a diffuse material, got {materials}"
        )
    if body.pattern == "reflectivity":
        return varied
    # One level for all pieces of a material, or the contrast between them would be lost.
    level = {
        material: reflectivity_patterns.mean_over_surface(
            [
                (pattern, piece.vertices_m, piece.faces)
                for (piece, material_name), pattern in zip(pieces_and_materials, varied, strict=True)
                if pattern and material_name == material
            ]
        )
        for _, material in pieces_and_materials
    }
    return [
        pattern and replace(pattern, mean=level[material])
        for (_, material), pattern in zip(pieces_and_materials, varied, strict=True)
    ]


def _material_of(piece: SubMesh, body: BodyFile, where: str, scene_materials: _SceneMaterials) -> str:
    """Name of the material that the scene file gives this sub-mesh, else of one with the mesh file's own colour."""
    material = next((body.materials[key] for key in piece.keys if key in body.materials), body.material)
    if material is not None:
        return material
    if piece.grey is None:
        raise InputError(
            f"{where}: sub-mesh '{piece.keys[0]}' of {body.mesh} has no colour of its own and must have a material, "
            "by material or materials"
        )
    return scene_materials.add_grey(f"{body.mesh}:{piece.keys[0]}", piece.grey)
