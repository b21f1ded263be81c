"""Scene: bodies with materials, sun, sky and air as plain data in metres and radians.

`scene.scene_file.load_scene` reads one from a file; a `Scene` can also be built in Python.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from .. import catalog
from ..errors import InputError, did_you_mean
from ..files import facts
from ..files.arguments import CHECKED_INSIDE, checks_arguments
from ..files.facts import Picture
from ..files.late_binding import call_bound, read_by_name
from ..files.overrides import Overrides, assignments
from ..materials.material import Material
from ..materials.material_file import catalogue_material
from ..maths.arrays import Numbers, frozen
from ..maths.attributes import HintedAttributes
from ..maths.motion_table import Strides
from ..maths.pose import Pose, direction_from_angles
from ..maths.trajectory import ALWAYS, CLOCK_ROUNDING_S, Course, Motion, Riding, States, motion_in_frame, pose_at
from ..maths.units import FileKey, Quantity
from ..maths.vectors import box_around
from ..physics.optics import air
from ..sensor.pose_file import Placed, pose_keys, to_pose
from .meshes.mesh_objects import pieces_of_object
from .meshes.reading import grey_material
from .meshes.reflectivity_patterns import Cutout, ReflectivityPattern
from .walking import LARGEST_LEVEL, Gait, GaitOnMotion
from .weather import Weather

SCENE_CHANGED_BY = 'scene.replace("sun.illuminance_klux=50") is another scene'
BODY_CHANGED_BY = 'scene.replace({"bodies.car.position_m": [20, 0, 0]}) is another scene'
"""What changes a scene, and a body of it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part(HintedAttributes):
    """A triangle mesh of one material, in its body's frame.

    Attributes:
        vertices_m: (v, 3) float64
        faces: (f, 3) uint32, indices into the vertices
        pattern: reflectivity pattern, for materials of kind "diffuse"; None: the material's reflectivity everywhere
        in_box: whether boxes of labels enclose it; they leave out the outside mirrors of vehicles
        cutout: image of its gaps, which glass and mirrors do not have; None: solid
        stride_m: (k + 1, v, 3) float32, its vertices at k even instants of a stride, on the spot, and at the first of
            the next one; None: it is rigid
    """

    vertices_m: Numbers
    faces: Numbers
    material: str
    name: str = ""
    in_box: bool = True
    pattern: ReflectivityPattern | None = None
    cutout: Cutout | None = None
    stride_m: Numbers | None = None
    _extent_m: Numbers | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        """Check shapes and freeze the arrays."""
        object.__setattr__(self, "vertices_m", frozen(self.vertices_m, np.float64, (None, 3)))
        object.__setattr__(self, "faces", frozen(self.faces, np.uint32, (None, 3)))
        varied = {} if self.cutout is None else {"cutout": self.cutout.uv}
        if self.stride_m is not None:
            object.__setattr__(self, "stride_m", frozen(self.stride_m, np.float32, (None, None, 3)))
            varied["stride"] = self.stride_m[0]
        if self.pattern is not None:
            varied["pattern"] = self.pattern.values if self.pattern.uv is None else self.pattern.uv
        for what, values in varied.items():
            if len(values) != len(self.vertices_m):
                raise InputError(
                    f"part '{self.name}': its {what} must have {len(self.vertices_m)} vertices, got {len(values)}"
                )

    @property
    def extent_m(self) -> Numbers:
        """(2, 3) lowest and highest corner, in the body's frame; computed once. Only for a part with vertices."""
        if self._extent_m is None:
            object.__setattr__(self, "_extent_m", frozen(box_around(self.vertices_m), np.float64, (2, 3)))
        assert self._extent_m is not None
        return self._extent_m

    def posed(self, phase: float, level: float) -> Part:
        """Return the part as it is at a place of its stride (`walking`), rigid; itself if it has none."""
        if self.stride_m is None:
            return self
        place = (phase - np.floor(phase)) * (len(self.stride_m) - 1)
        # Just below 0 is a whole stride after rounding.
        before = min(int(place), len(self.stride_m) - 2)
        first_m, second_m = self.stride_m[before : before + 2].astype(np.float64)
        walking_m = first_m + (place - before) * (second_m - first_m)
        return replace(self, vertices_m=self.vertices_m + level * (walking_m - self.vertices_m), stride_m=None)

    @property
    def reach_m(self) -> Numbers:
        """(2, 3) lowest and highest corner at any place of its stride; only for a part with vertices."""
        if self.stride_m is None:
            return self.extent_m
        lowest_m, highest_m = self.stride_m.min(axis=0), self.stride_m.max(axis=0)
        widest_m = [self.vertices_m + LARGEST_LEVEL * (most - self.vertices_m) for most in (lowest_m, highest_m)]
        return box_around(np.concatenate([self.vertices_m, *widest_m]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Ball(HintedAttributes):
    """An exact sphere of one material, centred on its body's origin."""

    radius_m: float
    material: str


def box_of(parts: Sequence[Part | Ball], *, walking: bool = False) -> Numbers | None:
    """(2, 3) lowest and highest corner of a body's parts in its frame; None if it has no surface.

    Args:
        walking: whether at any place of their strides, and not only as they stand
    """
    corners = [
        np.outer([-part.radius_m, part.radius_m], np.ones(3))
        if isinstance(part, Ball)
        else part.reach_m
        if walking
        else part.extent_m
        for part in parts
        if isinstance(part, Ball) or len(part.vertices_m)
    ]
    return np.stack([np.min(corners, axis=(0, 1)), np.max(corners, axis=(0, 1))]) if corners else None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyOrigin:
    """Table of a scene file from which a body was built.

    Attributes:
        table: a `tables.BodyFile`, or keys and values of one
        folder: in which the files that it names lie
        instance: number of the body among its instances; None: it has none
    """

    table: Any
    folder: Path = Path()
    instance: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Body(HintedAttributes):
    """A named object with a class and a shape. Instances are bodies that share parts.

    Attributes:
        motion: motion in the world, or None for a body that stands at ``pose``. With a motion, ``pose`` is its pose at
            time 0, or at the nearest end of the motion's span.
        away: True while a body with a motion is absent from the scene: no light meets it
        present_s: first and last time at which a frame may begin that shows the body; it is absent from all others
        gait: how it walks along its motion, by the strides of its parts; None: it is rigid
        origin: table of a scene file that describes it; None if a program made or changed it
    """

    MADE_BY: ClassVar[str] = 'scene.add("car", position=(20, 0, 0)) is a scene with one more'
    CHANGED_BY: ClassVar[str] = BODY_CHANGED_BY
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("velocity", "speed", "trajectory"), "body.motion"),
        **dict.fromkeys(("move", "translate", "rotate", "scale"), BODY_CHANGED_BY),
        **dict.fromkeys(("mesh", "meshes", "vertices", "faces", "material", "materials"), "body.parts"),
        **dict.fromkeys(("label", "class_id", "category"), "body.class_name"),
        **dict.fromkeys(
            ("bounds", "size", "dimensions", "extent", "aabb", "bbox", "triangles"),
            "body.pose.apply(body.parts[0].vertices_m) are the corners of a part's triangles",
        ),
        **dict.fromkeys(("x", "y", "z", "location"), "body.pose.position_m"),
        **dict.fromkeys(("yaw", "heading"), "body.pose.rotation"),
        **dict.fromkeys(("id", "index"), "body.name"),
    }

    name: str
    class_name: str
    parts: tuple[Part | Ball, ...]
    pose: Pose = field(default_factory=Pose)
    motion: Motion | None = None
    gait: Gait | None = None
    away: bool = False
    present_s: tuple[float, float] = ALWAYS
    origin: BodyOrigin | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        """Take the pose from the motion, and check strides."""
        instants = {len(part.stride_m) for part in self.parts if isinstance(part, Part) and part.stride_m is not None}
        if len(instants) > 1:
            raise InputError(f"body '{self.name}': strides of its parts must have as many instants, got {instants}")
        if self.motion is not None:
            object.__setattr__(self, "pose", pose_at(self.motion))

    def __repr__(self) -> str:
        x, y, z = self.pose.position_m
        triangles = sum(len(part.faces) for part in self.parts if isinstance(part, Part))
        about = {"class": self.class_name, "parts": f"{len(self.parts)}", "triangles": f"{triangles:,}"}
        return facts.facts_line("Body", self.name, about | {"at": f"{x:g}, {y:g}, {z:g} m"})

    def made_from(self, origin: BodyOrigin) -> Body:
        """The body, which this table of a scene file describes."""
        object.__setattr__(self, "origin", origin)
        return self

    def is_present(self, time_s: float) -> bool:
        """Return whether a frame that begins at this time shows the body."""
        first_s, last_s = self.present_s
        return not self.away and first_s - CLOCK_ROUNDING_S <= time_s <= last_s + CLOCK_ROUNDING_S

    def walk_in_frame(self, start_s: float) -> Strides | None:
        """Return what gives phase and level at times of a frame that begins at ``start_s``; None: rigid."""
        if self.gait is None or self.motion is None:
            return None
        return GaitOnMotion(self.gait, motion_in_frame(self.motion, start_s))

    def posed(self, time_s: float, start_s: float) -> Body:
        """Return the body as its stride has it at a time of a frame that begins at ``start_s``; else unchanged."""
        parts = self.parts_at(time_s, start_s)
        return self if parts is self.parts else replace(self, parts=parts, gait=None)

    def parts_at(self, time_s: float, start_s: float, states: States | None = None) -> tuple[Part | Ball, ...]:
        """Return the parts of `posed`, without the body's pose, which takes long; ``states`` of its motion if known."""
        walk = self.walk_in_frame(start_s)
        if walk is None:
            return self.parts
        phase, level = walk(np.array([time_s]), states)[0].tolist()
        return tuple(part.posed(phase, level) if isinstance(part, Part) else part for part in self.parts)

    @property
    def moves(self) -> bool:
        """Whether it has a motion that is not one at rest for ever: true of what waits."""
        return self.motion is not None and not (isinstance(self.motion, Course) and self.motion.rests)

    def rides_with(self, ego: Motion | None) -> bool:
        """Whether the body is fixed to the ego vehicle, whose motion this is."""
        return ego is not None and isinstance(self.motion, Riding) and self.motion.carrier is ego


class Bodies(HintedAttributes, tuple[Body, ...]):
    """Bodies in their order, which are also found by name: ``scene.bodies["car"]``, of the only ``car.0`` too."""

    __slots__ = ()
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("keys", "names"), "[body.name for body in scene.bodies]"),
        **dict.fromkeys(("values", "items", "list"), "[body for body in scene.bodies]"),
        **dict.fromkeys(("get", "find", "by_name"), 'scene.bodies["car"]'),
        **dict.fromkeys(("add", "append", "insert"), 'scene.add("car", position=(20, 0, 0))'),
        **dict.fromkeys(("remove", "pop", "delete"), 'scene.remove("car")'),
    }

    def __getitem__(self, key: Any) -> Any:
        if not isinstance(key, str):
            return super().__getitem__(key)
        found = [body for body in self if body.name == key] or [b for b in self if b.name.rpartition(".")[0] == key]
        if len(found) > 1:
            raise InputError(f"scene.bodies['{key}']: must be one of {', '.join(body.name for body in found)}")
        if not found:
            names = [body.name for body in self]
            meant = did_you_mean(key, names)
            listed = f"the scene has {', '.join(names[:MOST_NAMES])}{', ...' if len(names) > MOST_NAMES else ''}"
            raise InputError(f"scene.bodies['{key}']: no body of this name; {meant or listed}")
        return found[0]


def _of_mesh_file(body: Body, path: Path) -> BodyOrigin:
    """Origin of a body of a mesh file."""
    materials = {part.name: part.material for part in body.parts if isinstance(part, Part)}
    table = {"name": body.name, "class": body.class_name, "mesh": str(path.absolute()), "materials": materials}
    return BodyOrigin(table=table | pose_keys(body.pose))


MOST_NAMES = 12
"""Most names of bodies that a message lists."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sun(HintedAttributes):
    """Direction of the sun and its illuminance on a surface that faces it.

    Azimuth is counter-clockwise from x, seen from above.
    """

    CHANGED_BY: ClassVar[str] = SCENE_CHANGED_BY

    azimuth_rad: Annotated[
        float, Quantity("deg", ge=-36e3, le=36e3, about="towards the sun, counter-clockwise from x")
    ] = 0.0
    elevation_rad: Annotated[float, Quantity("deg", ge=-90, le=90, about="above the horizon")] = math.radians(45.0)
    illuminance_klux: Annotated[
        float,
        Quantity(
            ge=0,
            le=1e4,
            multiple=1e3,
            about="photopic (docs/sun.md), on a surface that faces the sun; scales the sensor's E_sun",
        ),
    ] = 100.0

    @property
    def direction(self) -> Numbers:
        """(3,) unit vector towards the sun, world frame."""
        return np.array(direction_from_angles(azimuth_rad=self.azimuth_rad, elevation_rad=self.elevation_rad))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sky(HintedAttributes):
    """Uniform sky. ``diffuse_share`` is its irradiance over the sun's at normal incidence, in band."""

    diffuse_share: Annotated[
        float,
        Quantity(ge=0, le=1000, about="irradiance of the uniform sky over the sun's at normal incidence, in band"),
    ] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Air(HintedAttributes):
    """One-way transmittance: a fixed factor times extinction over the range (given, by visibility, by weather)."""

    CHANGED_BY: ClassVar[str] = SCENE_CHANGED_BY

    transmittance: Annotated[float, Quantity(gt=0, le=1, about="one way, at any range")] = 1.0
    extinction_per_m: Annotated[
        float, Quantity(ge=0, le=100, about="extinction coefficient at the laser's wavelength")
    ] = 0.0
    visibility_m: Annotated[float | None, Quantity("km", ge=1e-4, le=1000, about="meteorological visibility")] = None
    model: Annotated[Literal["kruse", "kim"], FileKey(about="from visibility to extinction")] = "kim"
    structure_constant: Annotated[
        float,
        Quantity(
            name="cn2",
            ge=0,
            le=1e-9,
            about=(
                "C_n^2 of the refractive index, m^(-2/3): turbulence, by which echoes scatter (docs/theory_light.md 10)"
            ),
        ),
    ] = 0.0
    weather: Weather = field(default_factory=Weather)

    def extinction_at_per_m(self, wavelength_m: float) -> float:
        """Extinction coefficient at a laser wavelength, weather included."""
        extinction_per_m = self.extinction_per_m + self.weather.extinction_at_per_m(wavelength_m)
        if self.visibility_m is None:
            return extinction_per_m
        return extinction_per_m + air.extinction_from_visibility_per_m(
            visibility_m=self.visibility_m, wavelength_m=wavelength_m, model=self.model
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Interferer(HintedAttributes):
    """Another lidar, whose pulses reach the receiver at random times, in any direction.

    Attributes:
        spread_db: of ten times the decimal logarithm of the peak
    """

    rate_hz: Annotated[
        float, Quantity(ge=0, le=1e12, about="mean rate of the pulses that reach the receiver, strong or weak")
    ]
    irradiance_w_m2: Annotated[
        float, Quantity(ge=1e-15, le=1e9, about="median of their peaks, at the receiver's aperture, in its band")
    ]
    spread_db: Annotated[
        float, Quantity(ge=0.1, le=40, about="standard deviation of ten times the decimal logarithm of the peak")
    ] = 6.0


@dataclass(frozen=True, slots=True, kw_only=True)
class View(HintedAttributes):
    """Camera for pictures of the scene: a pinhole at ``eye_m``, ``fov_deg`` across, world frame."""

    eye_m: Annotated[tuple[float, float, float], FileKey()]
    target_m: Annotated[tuple[float, float, float], FileKey()]
    fov_deg: Annotated[float, Quantity(gt=0, lt=180, about="full angle across")] = 60.0


@read_by_name("load_scene")
@checks_arguments
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene(HintedAttributes):
    """Everything that light can meet. ``Scene("car")`` is `load_scene`.

    Attributes:
        bodies: in the order of the file, also by name (`Bodies`); a point's `body` is an index into `body_names`
        materials: by name, including every one that a part names
        lamps_w_m2: irradiance of all surfaces by lamps, in the sensor's band
        interferers: other lidars
        sensor_name: catalogue name or file of the default sensor
        sensor_pose: where the sensor stands: on the ego vehicle, or in the world if there is none
        ego: motion of the vehicle that carries the sensor, or None: it stands at the world's origin
        camera: camera of pictures and of the page's first view; None: chosen from the echoes near the sensor
        base: a Mitsuba XML scene whose shapes are added, or None
        base_materials: BSDF id in that file to material name; other BSDFs are the file's, two-sided
        reach_m: bodies that stand farther than this from where the ego vehicle is may be left out of a frame
        origin: `saving.SceneOrigin`, what `save` writes of all that Python did not change; None: nothing
    """

    MADE_BY: ClassVar[str] = (
        'Scene("car") reads a name or a file, Scene().add(mesh, "brick") makes one; lidarscene.scenes() lists the names'
    )
    CHANGED_BY: ClassVar[str] = SCENE_CHANGED_BY

    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("__getitem__", "get", "find", "by_name"), 'scene.bodies["car"]'),
        **dict.fromkeys(("objects", "meshes", "actors", "vehicles"), "scene.bodies"),
        **dict.fromkeys(("weather", "fog", "rain", "snow"), "scene.air.weather"),
        **dict.fromkeys(
            ("add_body", "add_mesh", "add_object", "add_box", "add_sphere", "spawn"),
            'scene.add(mesh, "brick", position=(20, 0, 1))',
        ),
        **dict.fromkeys(("delete", "pop", "drop", "discard"), 'scene.remove("car")'),
        **dict.fromkeys(("export", "write", "dump", "to_file", "to_toml"), 'scene.save("mine.toml")'),
        **dict.fromkeys(("triangles", "n_triangles", "num_triangles", "stats"), 'scene.facts()["triangles"]'),
        **dict.fromkeys(("visualize", "visualise", "viz", "display"), "scene.plot(), scene.view()"),
        **dict.fromkeys(("move", "set_pose"), BODY_CHANGED_BY),
        **dict.fromkeys(("set_sun", "set_weather"), SCENE_CHANGED_BY),
        "sensor": "scene.sensor_name, scene.sensor_pose",
        **dict.fromkeys(
            ("bounds", "extent", "extents", "aabb", "size", "center", "centre"),
            "scene.plot(); lidarscene.boxes(cloud, scene) has those of bodies",
        ),
        **dict.fromkeys(
            ("time", "duration", "dt", "at", "step", "tick", "fps"), "lidarscene.render(scene, sensor, begin_s=1.0)"
        ),
        **dict.fromkeys(("lights", "light", "lamps"), "scene.sun, scene.sky, scene.lamps_w_m2"),
        **dict.fromkeys(("ground", "road", "roads"), "scene.bodies"),
        **dict.fromkeys(("describe", "summary", "info"), "print(scene), scene.facts()"),
        **dict.fromkeys(("names", "body_names"), "scene.bodies"),
        **dict.fromkeys(("render", "raycast", "ray_cast", "cast_rays"), "lidarscene.render(scene, sensor)"),
        **dict.fromkeys(("boxes", "bounding_boxes", "bboxes"), "lidarscene.boxes(cloud, scene)"),
    }

    name: str = "scene"
    bodies: tuple[Body, ...] = ()
    materials: Mapping[str, Material] = field(default_factory=dict)
    sun: Sun = field(default_factory=Sun)
    sky: Sky = field(default_factory=Sky)
    air: Air = field(default_factory=Air)
    lamps_w_m2: float = 0.0
    interferers: tuple[Interferer, ...] = ()
    sensor_name: str = "table1-apd"
    sensor_pose: Pose = field(default_factory=Pose)
    ego: Motion | None = None
    camera: View | None = None
    base: Path | None = None
    base_materials: Mapping[str, str] = field(default_factory=dict)
    reach_m: float = math.inf
    origin: Any = field(default=None, repr=False)

    if TYPE_CHECKING:  # the fields, or what `read_by_name` reads

        def __init__(self, file: Any = ..., /, **values: Any) -> None: ...

    def __post_init__(self) -> None:
        """Let bodies be found by name."""
        object.__setattr__(self, "bodies", Bodies(self.bodies))

    def remove(self, name: str) -> Scene:
        """Scene without the body of this name.

        Raises:
            InputError: if the scene has none of the name
        """
        gone = self.bodies[name]  # type: ignore[call-overload]
        return replace(self, bodies=tuple(body for body in self.bodies if body is not gone))

    def replace(self, overrides: Overrides = (), /, **tables: Any) -> Scene:
        """Build the scene anew with other values in its file; bodies that Python added or removed stay so.

        Args:
            overrides: "sun.illuminance_klux=1", a list of these, or {"sun.illuminance_klux": 1}, in the file's units
            tables: the same by table: ``sun={"illuminance_klux": 1}``

        Raises:
            InputError: for a key or value that the file cannot have, for a scene that no file describes, and for keys
                of bodies and grounds where bodies were added or removed
        """
        replaced: Scene = call_bound("replace_scene", self, [*assignments(overrides), *assignments(tables)])
        return replaced

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a scene file that `load_scene` reads again, to the same clouds.

        Files that the scene has from files stay in place, and the file has their absolute paths. Meshes that are in
        memory alone are written beside it, as NAME-BODY.obj with a mark of their content. A pose whose rotation no
        angles give exactly is written to rounding.

        Args:
            path: must end in .toml

        Raises:
            InputError: for what no scene file can have, such as a motion made in Python
            OutputError: if a result cannot be written
        """
        call_bound("save_scene", self, path)

    @property
    def own_bodies(self) -> list[int]:
        """Indices of the bodies that are fixed to the ego vehicle."""
        return [index for index, body in enumerate(self.bodies) if body.rides_with(self.ego)]

    def add(
        self,
        mesh: Any,
        material: Annotated[
            str | Material | None, "a name, a Material or None (arrays of a mesh are one tuple: (vertices, faces))"
        ] = None,
        pose: Placed | None = None,
        *,
        position: Annotated[Sequence[float] | None, "x, y, z in metres"] = None,
        name: str | None = None,
        class_name: str | None = None,
    ) -> Scene:
        """Scene with one more body.

        Args:
            mesh: a file, or the name of a mesh that comes with the package, such as "car"; a Trimesh or trimesh.Scene;
                a triangle mesh of Open3D, a PolyData of PyVista, a mesh or scene of Mitsuba; or (vertices, faces):
                (n, 3) numbers, and (m, 3) triangles or (m, 4) quads, each of which becomes two triangles. Metres, z up,
                except for formats that say otherwise
            material: catalogue name, a name among the scene's `materials`, or a `Material`, of parts to which the
                package gives none; None: a diffuse one with the mean of the mesh's own colour
            pose: in the world, a `Pose` or x, y, z in metres with or without yaw, pitch, roll in degrees
            position: in place of a pose: x, y, z in metres, not turned
            name: of the body; it gets a number if the scene has one of the name; None: the mesh's in the package, or
                "body"
            class_name: of its points; None: the mesh's in the package, or its name

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        if pose is not None and position is not None:
            raise InputError("scene.add: must have one of pose and position, got both")
        if position is not None:
            placed = to_pose(position, name="position")
        else:
            placed = Pose() if pose is None else to_pose(pose)
        known: Mapping[str, Any] = {}
        if isinstance(mesh, str) and catalog.is_bare(mesh) and not os.path.exists(mesh):
            mesh = catalog.path_of("meshes", mesh)
            known = {"name": mesh.stem} | catalog.shipped_meshes().get(mesh.stem, {})
        name = name or known.get("name", "body")
        free = _free(name, {body.name for body in self.bodies})
        pieces = pieces_of_object(mesh, "scene.add")
        materials = dict(self.materials)
        parts = []
        for piece in pieces:
            of_parts: Mapping[str, str] = known.get("materials", {})
            chosen = next((of_parts[key] for key in piece.keys if key in of_parts), material)
            if chosen is None:
                if piece.grey is None:
                    raise InputError(
                        "scene.add: the mesh has no colour of its own and must have a material, as in "
                        "scene.add(mesh, 'brick'), got none"
                    )
                colour_of = f"colour of {free if len(pieces) == 1 else f'{free}, {piece.keys[0]}'}"
                chosen = grey_material(colour_of, piece.grey)
                others = [key for key, made in materials.items() if asdict(made) != asdict(replace(chosen, name=key))]
                chosen = replace(chosen, name=_free(colour_of, others))
            parts.append(
                Part(
                    vertices_m=piece.vertices_m,
                    faces=piece.faces,
                    material=add_material(materials, chosen, "scene.add"),
                    name=piece.keys[0],
                    in_box=piece.in_box,
                    cutout=piece.cutout,
                )
            )
        body = Body(name=free, class_name=class_name or known.get("class", name), parts=tuple(parts), pose=placed)
        if isinstance(mesh, str | os.PathLike):
            body = body.made_from(_of_mesh_file(body, Path(mesh)))
        return replace(self, bodies=(*self.bodies, body), materials=materials)

    def __repr__(self) -> str:
        return facts.facts_line("Scene", self.name, self.facts())

    def _repr_html_(self) -> str:
        return facts.facts_table("Scene", self.name, self.facts())

    def plot(self) -> Picture:
        """Picture of what stands where, from above and as the sensor sees it, by the outlines of the bodies."""
        picture: Picture = call_bound("draw_scene", self)
        return picture

    def show(self, *, sensor: Annotated[str | None, CHECKED_INSIDE] = None) -> None:
        """Show the page of `view`: in the notebook, or else in the browser."""
        self.view(sensor=sensor).show()

    def view(self, *, sensor: Annotated[str | None, CHECKED_INSIDE] = None, height_px: int = 620) -> Any:
        """The page of `lidarscene view` in a notebook, with a frame of the scene.

        The object returned also has `save(path)`, which writes the page.

        Args:
            sensor: catalogue name or file; the scene's own if None
            height_px: of the frame in the notebook

        Raises:
            InputError: if a file, a key or a value cannot be understood
            BackendError: if Mitsuba has no back end that works on this machine
        """
        return call_bound("view", self, sensor=sensor, height_px=height_px)

    def facts(self) -> dict[str, str]:
        """Facts for a line about the scene, label -> text."""
        x, y, z = self.sensor_pose.position_m
        facts_by_name = {
            "bodies": f"{len(self.bodies):,}",
            "triangles": f"{sum(len(p.faces) for b in self.bodies for p in b.parts if isinstance(p, Part)):,}",
            "sun": f"{self.sun.illuminance_klux:g} klux",
            "sensor": f"{self.sensor_name} at {x:g}, {y:g}, {z:g} m",
        }
        return facts_by_name | ({"base": str(self.base)} if self.base else {})


def _free(name: str, taken: Collection[str]) -> str:
    """Return a name, with a number if it is taken."""
    return name if name not in taken else next(n for i in itertools.count(2) if (n := f"{name} {i}") not in taken)


def add_material(materials: dict[str, Material], chosen: str | Material, where: str) -> str:
    """Add a material to a scene's, and return its name; one of the catalogue goes by its name, as those of the scene.

    Raises:
        InputError: for another material of the same name
    """
    name = chosen if isinstance(chosen, str) else chosen.name
    if isinstance(chosen, Material) and asdict(materials.get(name, chosen)) != asdict(chosen):
        raise InputError(f"{where}: material '{name}': the scene has another of this name")
    if name not in materials:
        materials[name] = catalogue_material(chosen) if isinstance(chosen, str) else chosen
    return name
