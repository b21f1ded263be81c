"""Scene files written of a `Scene`: what Python did not change stays as its file has it, all else is written anew.

Tables of a file say more than a `Scene` has, such as the ground on which a body stands; so they are kept with the scene
and with each body, and a body that Python made or changed has none. Meshes in memory are written as OBJ: as text,
vertices keep all digits, and parts their order. Streets that are made are written as a folder (`write_street`).
"""

from __future__ import annotations

import copy
import hashlib
import itertools
import math
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import catalog
from ..errors import InputError
from ..files.atomic import atomic_folder, atomic_output
from ..files.overrides import toml_entry, toml_text
from ..files.toml import validate
from ..materials.material_file import catalogue_material, material_table
from ..maths.trajectory import ALWAYS, Course, Motion, Riding
from ..sensor.pose_file import pose_keys
from .derived import Tables, with_absolute_paths
from .meshes.mesh_cache import MIRRORS
from .motion import EgoFile
from .scene import Ball, Body, Part, Scene
from .tables import AirFile, BodyFile, LidarsFile, PictureFile, SceneFile, SkyFile, SunFile, WeatherFile


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SceneOrigin:
    """File that a scene was read from.

    Attributes:
        file: its tables
        folder: in which the files that it names lie
        scene: as it was read
    """

    file: SceneFile
    folder: Path
    scene: Scene


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """See `Scene.save`."""
    target = Path(path)
    if target.suffix != ".toml":
        raise InputError(f"{path}: the name of a scene file must end in .toml")
    meshes: dict[str, str] = {}
    with ExitStack() as outputs:
        # The scene file gets its name last: what it names is there by then.
        temporary = outputs.enter_context(atomic_output(target))
        tables = saved_tables(scene, target, meshes)
        validate(SceneFile, tables, str(path))
        temporary.write_text(scene_text(tables), encoding="utf-8", newline="\n")
        for name, text in meshes.items():
            outputs.enter_context(atomic_output(target.parent / name)).write_text(text, encoding="utf-8", newline="\n")


def write_street(tables: Tables, folder: Path, *, origin: str) -> Path:
    """Write tables as street.toml in ``folder``, with their meshes and motions beside it; return the scene's path.

    Args:
        origin: what the first line of the file says it was made of

    Raises:
        OutputError: if a result cannot be written
    """
    tables = copy.deepcopy(tables)
    with atomic_folder(folder) as temporary:
        for name in ("meshes", "motions"):
            (temporary / name).mkdir()
        for body in tables["bodies"]:
            if "mesh" in body:
                mesh = Path(body["mesh"])
                shutil.copyfile(mesh, temporary / "meshes" / mesh.name)
                body["mesh"] = f"meshes/{mesh.name}"
        _write_motion(tables["ego"], temporary, "ego")
        for body in tables["bodies"]:
            for number, instance in enumerate(body.get("instances", ())):
                if "motion" in instance:
                    _write_motion(instance["motion"], temporary, f"{body['name']}_{number}")
        text = f"# Made by lidarscene street: {origin}\n" + scene_text({"name": "street"} | tables)
        (temporary / "street.toml").write_text(text, encoding="utf-8", newline="\n")
    return folder / "street.toml"


def scene_text(tables: Mapping[str, Any]) -> str:
    """Write the tables of a scene file as TOML, each body in a table and each instance on a line of its own."""
    lines = [toml_entry(key, value) for key, value in tables.items() if not isinstance(value, (dict, list))]
    for key, table in tables.items():
        if isinstance(table, dict):
            lines += ["", f"[{key}]", *(toml_entry(name, value) for name, value in table.items())]
    for key, rows in tables.items():
        for row in rows if isinstance(rows, list) else ():
            lines += ["", f"[[{key}]]"]
            for name, value in row.items():
                if name == "instances":
                    lines += ["instances = [", *(f"    {toml_text(instance)}," for instance in value), "]"]
                else:
                    lines.append(toml_entry(name, value))
    return "\n".join(lines) + "\n"


def saved_tables(scene: Scene, target: Path, meshes: dict[str, str]) -> Tables:
    """Tables of the scene file; the texts of its new mesh files go to ``meshes``, by name.

    Raises:
        InputError: for what no scene file can have
    """
    origin: SceneOrigin | None = scene.origin
    read = Scene() if origin is None else origin.scene
    tables: Tables = {} if origin is None else _dumped(origin.file, origin.folder)
    tables["name"] = scene.name
    tables.get("ego", {}).pop("mesh", None)  # is among the bodies
    if scene.sun is not read.sun:
        tables["sun"] = SunFile.written(scene.sun)
    if scene.sky is not read.sky:
        tables["sky"] = SkyFile.written(scene.sky)
    if scene.air is not read.air:
        tables["air"], tables["weather"] = AirFile.written(scene.air), WeatherFile.written(scene.air.weather)
    if (scene.lamps_w_m2, scene.interferers) != (read.lamps_w_m2, read.interferers):
        lamps = [{"kind": "lamps", "irradiance_w_m2": scene.lamps_w_m2}] if scene.lamps_w_m2 else []
        lidars = [{"kind": "lidar", **LidarsFile.written(lidar)} for lidar in scene.interferers]
        tables["interference"] = [*lamps, *lidars]
    if origin is None or (scene.sensor_name, scene.sensor_pose) != (read.sensor_name, read.sensor_pose):
        name = scene.sensor_name
        tables["sensor"] = {"name": str(Path(name).absolute()) if name.endswith(".toml") else name}
        tables["sensor"] |= pose_keys(scene.sensor_pose)
    if scene.ego is not read.ego:
        tables["ego"] = _motion_keys(scene.ego, f"{target}: ego")
    if scene.camera is not read.camera:
        tables["picture"] = None if scene.camera is None else PictureFile.written(scene.camera)
    if scene.reach_m != read.reach_m:
        tables["reach_m"] = None if math.isinf(scene.reach_m) else scene.reach_m
    if scene.base is not read.base:
        tables["base"] = None if scene.base is None else str(scene.base.absolute())
    if scene.base_materials is not read.base_materials:
        tables["base_materials"] = dict(scene.base_materials)
    described = tables.get("materials", {})
    tables["materials"] = {
        name: described[name]
        if material is read.materials.get(name) and name in described
        else material_table(material)
        for name, material in scene.materials.items()
        if name not in catalog.names("materials") or catalogue_material(name) is not material
    }
    tables["bodies"] = list(_body_tables(scene, target, meshes))
    _require_grounds(scene, str(target))
    return {key: list(value) if isinstance(value, tuple) else value for key, value in tables.items() if _is_said(value)}


def _is_said(value: object) -> bool:
    """Whether a value says something: None and an empty table or list do not."""
    return value is not None and value != {} and value != [] and value != ()


def _dumped(file: SceneFile, folder: Path) -> Tables:
    """Tables of a file with absolute paths; what it leaves out is left out."""
    return with_absolute_paths(file.model_dump(by_alias=True, exclude_unset=True, exclude_none=True), folder)


def _body_tables(scene: Scene, target: Path, meshes: dict[str, str]) -> Iterator[Tables]:
    """Tables of the bodies in their order; the instances of one table that follow each other are in one."""
    for _, run in itertools.groupby(scene.bodies, lambda body: id(body.origin.table if body.origin else body)):
        bodies = list(run)
        origin = bodies[0].origin
        if origin is None:
            yield _new_table(bodies[0], scene, target, meshes)
            continue
        if isinstance(origin.table, BodyFile):
            (table,) = _dumped(SceneFile.model_construct(bodies=(origin.table,)), origin.folder)["bodies"]
        else:
            table = dict(origin.table)
        given = {table.get("material"), *table.get("materials", {}).values()}
        # A mesh file's own colours are materials whose names have its path.
        own = {part.name: part.material for part in bodies[0].parts if isinstance(part, Part) and "mesh" in table}
        table["materials"] = table.get("materials", {}) | {key: name for key, name in own.items() if name not in given}
        if not table["materials"]:
            del table["materials"]
        numbers = [body.origin.instance for body in bodies if body.origin is not None]
        if origin.instance is not None and numbers != list(range(len(table["instances"]))):
            table["instances"] = [
                {**table["instances"][number or 0], "name": body.name}
                for number, body in zip(numbers, bodies, strict=True)
            ]
        yield table


def _new_table(body: Body, scene: Scene, target: Path, meshes: dict[str, str]) -> Tables:
    """Table of a body that no file describes; its mesh goes to ``meshes``.

    Raises:
        InputError: for what no scene file can have
    """
    where = f"{target}: body '{body.name}'"
    if body.away or body.gait is not None or body.present_s != ALWAYS:
        raise InputError(f"{where}: must be there always and rigid to be saved, got one that Python hid or lets walk")
    table: Tables = {"name": body.name, "class": body.class_name}
    if body.motion is None:
        table |= pose_keys(body.pose)
    elif isinstance(body.motion, Riding) and body.motion.carrier is scene.ego:
        table |= pose_keys(body.motion.pose) | {"motion": {"with_ego": True}}
    else:
        keys = _motion_keys(body.motion, where)
        pose = {key: keys.pop(key) for key in tuple(keys) if key in ("position_m", "yaw_deg", "pitch_deg", "roll_deg")}
        table |= pose | {"motion": keys}
    (first, *others) = body.parts or (None,)
    if isinstance(first, Ball) and not others:
        return table | {"primitive": "sphere", "radius_m": first.radius_m, "material": first.material}
    parts = [part for part in body.parts if isinstance(part, Part) and len(part.faces)]
    if len(parts) < max(len(body.parts), 1):
        raise InputError(f"{where}: must be one sphere or triangles to be saved, got {len(parts)} parts with triangles")
    for part in parts:
        for what in ("pattern", "cutout", "stride_m"):
            if getattr(part, what) is not None:
                raise InputError(f"{where}: {what}: must be of a mesh file to be saved, got one in memory")
    text = _obj(parts)
    words = re.sub(r"[^A-Za-z0-9]+", "_", body.name)
    name = f"{target.stem}-{words}-{hashlib.sha256(text.encode()).hexdigest()[:8]}.obj"
    meshes[name] = text
    materials = {_part_name(number, part): part.material for number, part in enumerate(parts)}
    return table | {"mesh": name, "materials": materials}


def _part_name(number: int, part: Part) -> str:
    """Name of a part in the OBJ file, which says whether boxes of labels enclose it."""
    return f"{'part' if part.in_box else MIRRORS}_{number:04d}"


def _obj(parts: Sequence[Part]) -> str:
    """OBJ file of parts, each an object with a material of its own; numbers with all digits."""
    lines, start = [], 1
    for number, part in reversed(tuple(enumerate(parts))):  # trimesh takes the last one first
        lines += [f"o {_part_name(number, part)}", f"usemtl {_part_name(number, part)}"]
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in part.vertices_m.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (part.faces.astype(int) + start).tolist()]
        start += len(part.vertices_m)
    return "\n".join(lines) + "\n"


def _motion_keys(motion: Motion | None, where: str) -> Any:
    """Keys of a motion by speeds, and of its pose at time 0; None without a motion.

    Raises:
        InputError: for another one
    """
    if motion is None:
        return None
    if not isinstance(motion, Course) or motion.since_s != 0.0:
        raise InputError(f"{where}: motion: must be by speeds, or of the scene's file, got another one made in Python")
    return pose_keys(motion.start) | EgoFile.written(motion)


def _require_grounds(scene: Scene, where: str) -> None:
    """Raise InputError if a ground is gone on which other bodies stand."""
    origin: SceneOrigin | None = scene.origin
    if origin is None:
        return
    kept = {body.name for body in scene.bodies}
    gone = [
        body.name
        for body in origin.scene.bodies
        if body.name not in kept and body.origin is not None and body.origin.table.primitive == "ground"
    ]
    standing = [body.name for body in scene.bodies if _follows_ground(body)]
    if gone and standing:
        raise InputError(f"{where}: '{standing[0]}' stands on the ground: '{gone[0]}' must not be removed from it")


def _follows_ground(body: Body) -> bool:
    """Whether the height of a body follows from the ground below it."""
    table = body.origin.table if body.origin is not None else None
    return isinstance(table, BodyFile) and (
        table.on_ground or any(motion is not None and motion.ride is not None for motion in table.motions())
    )


def _write_motion(motion: Tables, folder: Path, name: str) -> None:
    """Replace the poses of a motion by a file with them."""
    angles = [key for key in ("yaw_deg", "pitch_deg") if any(key in pose for pose in motion["poses"])] or ["yaw_deg"]
    lines = [",".join(["time_s,x_m,y_m,z_m", *angles])]
    for pose in motion.pop("poses"):
        numbers = [pose["time_s"], *pose["position_m"], *(pose.get(key, 0.0) for key in angles)]
        lines.append(",".join(map(repr, numbers)))
    text = "\n".join(lines) + "\n"
    (folder / "motions" / f"{name}.csv").write_text(text, encoding="utf-8", newline="\n")
    motion["poses_file"] = f"motions/{name}.csv"
