"""The columns of point clouds, the class that holds them, and places and times in its metadata.

One table gives name, type, unit and meaning of each column to files, documentation and pictures alike. Formats stand
below `cloud.point_cloud.PointCloud`: writers take a `Cloud`, readers return `Fields`, the
keyword arguments of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, InitVar, dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, get_type_hints, overload

import numpy as np

from ..detection.outcomes import Status
from ..errors import InputError, one_line
from ..files.arguments import checks_arguments
from ..maths.arrays import Numbers, frozen
from ..maths.attributes import HintedAttributes, no_attribute
from ..maths.pose import Pose
from .category_array import CategoryArray, hint

Fields = dict[str, Any]

FOREIGN_NAMES = {
    **dict.fromkeys(("classes", "labels", "label", "semantic", "semantic_labels"), 'cloud["class"], cloud.class_names'),
    **dict.fromkeys(("instance", "instances", "instance_id", "instance_labels"), 'cloud["body"], cloud.body_names'),
    **dict.fromkeys(("bounding_boxes", "bboxes", "boxes_3d"), "cloud.boxes(scene)"),
    **dict.fromkeys(("annotations", "targets", "objects"), 'cloud.boxes(scene), cloud["class"]'),
    **dict.fromkeys(
        ("shuffle", "sample", "downsample", "down_sample", "subsample"),
        "cloud[numpy.random.permutation(len(cloud))[:1024]], cloud[::10]",
    ),
    **dict.fromkeys(
        ("voxel_down_sample", "voxel_downsample", "voxel", "voxelize"), "cloud.to_open3d().voxel_down_sample(0.2)"
    ),
    **dict.fromkeys(("fields", "features", "column_names", "keys"), "cloud.columns"),
    **dict.fromkeys(("rotate", "translate", "transformed"), "cloud.transform(pose)"),
    **dict.fromkeys(("height", "altitude"), "cloud.z"),
    "width": "cloud.range_image() has rows and columns",
    **dict.fromkeys(("laser_id", "beam_id", "laser", "beam"), "cloud.channel"),
    **dict.fromkeys(("returns", "num_returns"), "cloud.return_number"),
    **dict.fromkeys(("false_alarms", "noise"), 'cloud.select(status="false alarm")'),
    "echoes": 'cloud.select(status="echo")',
    **dict.fromkeys(("ground_truth", "truth"), "cloud.has_truth, cloud.true_range"),
    **dict.fromkeys(("reflectance", "albedo"), "cloud.reflectivity"),
    **dict.fromkeys(("get", "get_field"), 'cloud["intensity"]'),
    **dict.fromkeys(("velocity", "doppler"), "cloud.radial_velocity"),
    **dict.fromkeys(("pose", "origin"), "cloud.sensor_place"),
    **dict.fromkeys(("scatter", "imshow", "draw", "plot3d", "picture", "image"), "cloud.plot()"),
    **dict.fromkeys(("info", "summary", "stats", "statistics"), "print(cloud), cloud.to_pandas().describe()"),
    **dict.fromkeys(("filter", "mask", "where"), 'cloud.select(class_="car"), cloud[cloud.range < 50]'),
    "crop": "cloud[(cloud.x > 0) & (cloud.x < 50)]",
    **dict.fromkeys(("num_points", "n_points", "size", "count"), "len(cloud)"),
    **dict.fromkeys(("error", "errors", "range_error"), "cloud.range_m - cloud.true_range_m"),
    **dict.fromkeys(("sort", "sort_by", "argsort"), "cloud[numpy.argsort(cloud.time)]"),
    **dict.fromkeys(("split", "train_test_split"), "cloud[:1000], cloud[1000:]"),
    **dict.fromkeys(("sensor", "scene"), 'cloud.metadata["sensor"], cloud.metadata["scene"]'),
    **dict.fromkeys(("visualize", "visualise", "viz", "display"), "cloud.plot(), cloud.view()"),
    **dict.fromkeys(("to_bytes", "tobytes"), "cloud.to_numpy().tobytes()"),
    **dict.fromkeys(("to_dataframe", "to_df", "dataframe", "df"), "cloud.to_pandas()"),
    **{
        name: f"cloud.to_pandas().{name}(...)"
        for name in ("to_csv", "groupby", "query", "sort_values", "value_counts", "to_json", "apply")
    },
    **{name: f"cloud.to_pandas().{name}()" for name in ("describe", "head", "tail", "iterrows")},
    "hist": "cloud.to_pandas().intensity.hist()",
    **{name: f"cloud.to_pandas().{name}(numeric_only=True)" for name in ("mean", "std", "min", "max", "median")},
    **dict.fromkeys(("budget", "budgets", "photons"), "lidarscene.budget(cloud, scene, sensor)"),
    **dict.fromkeys(("waveform", "waveforms"), "lidarscene.Simulator(scene, sensor).waveforms([0])"),
    **dict.fromkeys(("append", "concat", "merge"), "cloud + other, sum(clouds)"),
    **dict.fromkeys(
        ("to_ros", "to_msg", "to_pointcloud2", "publish", "laserscan"), 'cloud.save("a.mcap"), `lidarscene stream`'
    ),
    **dict.fromkeys(("transform_to", "to_world"), "cloud.transform(pose), render(..., coordinates='world')"),
    **dict.fromkeys(("distance", "distances", "depth"), "cloud.range"),
    **dict.fromkeys(("timestamp", "timestamps", "stamp", "t"), "cloud.time"),
    **dict.fromkeys(
        ("write", "export", "to_arrow", "to_file", "to_ply", "to_pcd", "to_las", "to_kitti", "to_npz"),
        "cloud.save(path)",
    ),
    "frame_id": 'cloud.metadata["frame"]',
    "header": "cloud.metadata",
    **dict.fromkeys(("frame", "to_frame"), "render(..., coordinates='world'), cloud.transform(pose)"),
    **dict.fromkeys(
        ("to_list", "tolist", "data", "array", "values", "dtype", "to_structured", "to_records"), "cloud.to_numpy()"
    ),
    **dict.fromkeys(("bounds", "extent", "extents", "aabb"), "cloud.xyz_m.min(axis=0), cloud.xyz_m.max(axis=0)"),
    **dict.fromkeys(("center", "centre", "centroid"), "cloud.xyz_m.mean(axis=0)"),
    **dict.fromkeys(("min_range", "max_range", "range_min", "range_max"), "cloud.range.min(), cloud.range.max()"),
    **dict.fromkeys(("ndim", "nbytes", "astype"), "cloud.to_numpy()"),
    **dict.fromkeys(("polar", "spherical", "r", "phi", "theta"), "cloud.range, cloud.azimuth, cloud.elevation"),
    **dict.fromkeys(("name", "seed", "number"), "cloud.metadata"),
    "duration": "cloud.time.max() - cloud.time.min()",
    **dict.fromkeys(("unique", "class_counts", "by_class"), 'numpy.unique(cloud["class"], return_counts=True)'),
    **dict.fromkeys(("empty", "is_empty"), "len(cloud) == 0"),
    **dict.fromkeys(
        ("kdtree", "nearest", "cluster", "segment_plane", "remove_outliers", "estimate_normals"),
        "cloud.to_open3d() has neighbours, clusters and planes",
    ),
    **dict.fromkeys(
        ("to_polars", "to_xarray", "iloc", "loc", "assign", "drop", "rename", "dropna", "add_column", "with_columns"),
        "cloud.to_pandas()",
    ),
    **dict.fromkeys(
        ("copy", "__setitem__"), "a cloud is read-only; dataclasses.replace(cloud, range_m=...) is another"
    ),
    "dump": "cloud.save(path)",
    "to_dict": "cloud.to_pandas().to_dict('list')",
}
"""Names that other libraries have for what a cloud has, and how it is asked for here."""
"""Arrays, names and metadata by attribute of a point cloud."""

STATUS_PLURALS = ("echoes", "false alarms", "of interference", "of weather", "aliased", "stray", "revived")
STATUS_NAMES = tuple(status.name.lower().replace("_", " ") for status in Status)
"""Meaning of the `status` column, by value."""


Measured = Annotated[Numbers, "measured"]
Truth = Annotated[Numbers | None, "truth"]
Vectors = Annotated[Numbers | None, "vectors"]
"""Groups of columns: every cloud has the measured ones; the others come all together, vectors only with the truth."""


@dataclass(frozen=True, slots=True)
class Column(HintedAttributes):
    """Declaration of one scalar column: its name in files, dtype, unit and meaning.

    Attributes:
        dtype: one of `DTYPES`
        attribute: field of `CloudColumns` that holds it
        names: field with the names behind an index; index -1 has no name
        absent: value in clouds of sensors or worlds that lack the quantity; None if all have it
        group: "measured", "truth" or "vectors", from the type of the field
    """

    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("data", "values", "array", "min", "max", "mean"), "cloud[column.name]"),
        **dict.fromkeys(("description", "doc", "about"), "column.meaning"),
    }

    name: str
    dtype: str
    unit: str
    meaning: str
    _: KW_ONLY
    names: str | None = None
    absent: float | None = None
    group: str = ""
    attribute: str = ""

    @property
    def truth(self) -> bool:
        """True if no real sensor could report it."""
        return self.group != "measured"


DTYPES = ("float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32")
"""Types that every format of all columns can hold."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class CloudColumns:
    """Arrays of a cloud. Each column is declared here alone: files, documentation and pictures follow.

    xyz_m holds three columns, float32 or float64 as the array is. What may be None is the truth, or vectors: normals
    (unit vectors on the side from which the light came) and velocities against the ground, both in the axes of x, y
    and z and 0 without a surface.
    """

    xyz_m: Annotated[
        Measured,
        Column("x", "float32", "m", "position, forward"),
        Column("y", "float32", "m", "position, left"),
        Column("z", "float32", "m", "position, up"),
    ]
    range_m: Annotated[Measured, Column("range", "float32", "m", "range that the sensor reports")]
    intensity: Annotated[
        Measured, Column("intensity", "float32", "A, cells or photons", "peak of the echo at the comparator")
    ]
    pulse_width_s: Annotated[
        Measured, Column("pulse_width", "float32", "s", "time over the threshold, 0 if it is not measured", absent=0)
    ]
    signal: Annotated[
        Measured,
        Column("signal", "float32", "1", "photons counted of the return, whole; 0 if they are not counted", absent=0),
    ]
    snr: Annotated[Measured, Column("snr", "float32", "1", "signal-to-noise ratio")]
    detection_probability: Annotated[
        Measured, Column("detection_probability", "float32", "1", "probability of detection")
    ]
    ambient: Annotated[Measured, Column("ambient", "float32", "1", "background counts of the pulse")]
    time_s: Annotated[Measured, Column("time", "float64", "s", "emission of the pulse, from the start of the frame")]
    channel: Annotated[Measured, Column("channel", "int32", "1", "number of the laser, or of the row")]
    ring: Annotated[Measured, Column("ring", "int32", "1", "row as the maker's driver counts it")]
    azimuth_rad: Annotated[Measured, Column("azimuth", "float32", "rad", "commanded beam azimuth in the sensor frame")]
    elevation_rad: Annotated[
        Measured, Column("elevation", "float32", "rad", "commanded beam elevation in the sensor frame")
    ]
    return_number: Annotated[Measured, Column("return_number", "uint8", "1", "return of this shot, 1 = first")]
    status: Annotated[
        Measured,
        Column(
            "status", "uint8", "1", "0 echo, 1 false alarm, 2 interference, 3 weather, 4 aliased, 5 stray, 6 revived"
        ),
    ]
    sensor_index: Annotated[
        Measured,
        Column("sensor_index", "uint8", "1", "which sensor of a rig, 0 without one", names="sensor_names", absent=0),
    ]
    true_range_m: Annotated[Truth, Column("true_range", "float32", "m", "true range, inf without a surface")] = None
    incidence_angle_rad: Annotated[Truth, Column("incidence_angle", "float32", "rad", "angle of incidence")] = None
    reflectivity: Annotated[Truth, Column("reflectivity", "float32", "1", "diffuse reflectivity of the surface")] = None
    sun_angle_rad: Annotated[Truth, Column("sun_angle", "float32", "rad", "angle of the sun to the surface normal")] = (
        None
    )
    in_shadow: Annotated[Truth, Column("in_shadow", "uint8", "1", "1 where the sun does not reach")] = None
    interactions: Annotated[
        Truth, Column("interactions", "uint8", "1", "panes, mirrors and gaps on the way to the surface", absent=0)
    ] = None
    ghost: Annotated[Truth, Column("ghost", "uint8", "1", "1 where one mirrored it: no surface is there", absent=0)] = (
        None
    )
    wear: Annotated[
        Truth, Column("wear", "float32", "1", "share of the echo that dirt, drops or a weak laser take", absent=0)
    ] = None
    radial_velocity_m_s: Annotated[
        Truth, Column("radial_velocity", "float32", "m/s", "of surface and sensor apart", absent=0)
    ] = None
    body: Annotated[Truth, Column("body", "int32", "1", "body that was hit, -1 none", names="body_names")] = None
    class_id: Annotated[Truth, Column("class", "int32", "1", "class of that body, -1 none", names="class_names")] = None
    material: Annotated[
        Truth, Column("material", "int32", "1", "material that was hit, -1 none", names="material_names")
    ] = None
    normal_x: Annotated[Vectors, Column("normal_x", "float32", "1", "normal of the surface, forward")] = None
    normal_y: Annotated[Vectors, Column("normal_y", "float32", "1", "normal of the surface, left")] = None
    normal_z: Annotated[Vectors, Column("normal_z", "float32", "1", "normal of the surface, up")] = None
    velocity_x_m_s: Annotated[Vectors, Column("velocity_x", "float32", "m/s", "of the surface, forward")] = None
    velocity_y_m_s: Annotated[Vectors, Column("velocity_y", "float32", "m/s", "of the surface, left")] = None
    velocity_z_m_s: Annotated[Vectors, Column("velocity_z", "float32", "m/s", "of the surface, up")] = None


def _declared_columns() -> Iterator[Column]:
    """Yield the columns that `CloudColumns` declares."""
    for attribute, declared in get_type_hints(CloudColumns, include_extras=True).items():
        group, *columns = declared.__metadata__
        yield from (replace(column, group=group, attribute=attribute) for column in columns)


COLUMNS = tuple(_declared_columns())
"""Every column of a file, in order: the one table for files, documentation and pictures."""

MEASURED, TRUTH, OF_VECTORS = (
    tuple(dict.fromkeys(column.attribute for column in COLUMNS if column.group == group))
    for group in ("measured", "truth", "vectors")
)
"""Attributes that every cloud has, and those that come all together or not at all."""

NAMES = {column.attribute: column.names for column in COLUMNS if column.names}
"""Attribute of an index -> attribute of the names. Index -1 has no name."""


_OTHER_NAMES = {column.name for column in COLUMNS if column.name != column.attribute}
"""Names of columns in files that are not those of attributes."""

_DTYPES = {column.attribute: column.dtype for column in COLUMNS}


def columns_of(*, truth: bool, vectors: bool) -> tuple[Column, ...]:
    """Columns of a file, in order; vectors need the truth."""
    groups = ("measured", *(("truth",) if truth else ()), *(("vectors",) if truth and vectors else ()))
    return tuple(column for column in COLUMNS if column.group in groups)


SENSOR_TO_WORLD = "sensor_to_world"
"""Key of the metadata whose text is the pose of the sensor in the world: a (3, 4) matrix row by row."""

SENSOR_TO_VEHICLE = "sensor_to_vehicle"
"""Key of the metadata whose text has the pose of each sensor on its vehicle: (3, 4) matrices row by row."""


RING_ROWS = "ring_rows"
"""Key of the metadata with the row of each ring, from the lowest up, where the maker's driver counts otherwise."""


@checks_arguments
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Cloud(CloudColumns, HintedAttributes):
    """Data of a `cloud.point_cloud.PointCloud`, which documents them: all that formats need of a cloud."""

    MADE_BY = 'PointCloud("a.ply") reads a file, lidarscene.render(scene, sensor) makes one'
    CHANGED_BY = "dataclasses.replace(cloud, range_m=...) is another cloud"
    FOREIGN_NAMES = FOREIGN_NAMES

    sensor_names: tuple[str, ...] = ()
    body_names: tuple[str, ...] = ()
    class_names: tuple[str, ...] = ()
    material_names: tuple[str, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)
    checked: InitVar[bool] = False

    def __post_init__(self, checked: bool) -> None:
        """Check and freeze every array; none is copied unless its dtype has to change."""
        absent_truth = [name for name in TRUTH if getattr(self, name) is None]
        if absent_truth and len(absent_truth) < len(TRUTH):
            raise ValueError(f"PointCloud: truth fields come all together; missing: {', '.join(absent_truth)}")
        absent_vectors = [name for name in OF_VECTORS if getattr(self, name) is None]
        if len(absent_vectors) not in (0, len(OF_VECTORS)) or (absent_truth and not absent_vectors):
            raise ValueError("PointCloud: normals and velocities come all together, and with the truth fields")
        points = len(self.xyz_m)
        for attribute in attributes(truth=not absent_truth, vectors=not absent_vectors):
            array = freeze_column(attribute, getattr(self, attribute), points)
            if not checked:
                _check_numbers(attribute, array)
            object.__setattr__(self, attribute, array)
        for attribute in NAMES.values():
            object.__setattr__(self, attribute, tuple(getattr(self, attribute)))
        for column in self.columns:
            if column.names or column.name == "status":
                names = getattr(self, column.names) if column.names else STATUS_NAMES
                codes = CategoryArray.of(getattr(self, column.attribute), names, column.name)
                object.__setattr__(self, column.attribute, codes)
        object.__setattr__(self, "metadata", {str(key): str(value) for key, value in self.metadata.items()})
        for attribute, names in NAMES.items():
            if attribute not in absent_truth and not checked:
                _check_index(attribute, getattr(self, attribute), getattr(self, names))
        if not all(0 < len(key) <= 100 for key in self.metadata):
            raise ValueError("PointCloud.metadata: keys must have 1 to 100 characters")
        sensor_positions_m(self.metadata)

    def __len__(self) -> int:
        return int(self.xyz_m.shape[0])

    @property
    def has_truth(self) -> bool:
        """True if the cloud has the truth fields."""
        return self.true_range_m is not None

    @property
    def has_vectors(self) -> bool:
        """True if the points have normals and velocities of their surfaces."""
        return self.normal_x is not None

    @property
    def normals(self) -> Numbers:
        """(n, 3) float32 unit normals of the surfaces, on the side of the light, in the frame of the points."""
        return self._vectors("normals", OF_VECTORS[:3])

    @property
    def velocities_m_s(self) -> Numbers:
        """(n, 3) float32 velocities of the surfaces against the ground, in the axes of the frame of the points."""
        return self._vectors("velocities", OF_VECTORS[3:])

    @property
    def sensor_position_m(self) -> Numbers:
        """(3,) float64 position of the sensor (the first one of a rig) in the frame of the points."""
        return np.asarray(sensor_positions_m(self.metadata)[0])

    @property
    def sensor_place(self) -> Pose:
        """Pose of the sensor (the first one of a rig) in the frame of the points.

        Not rotated if the metadata lack the rotation.
        """
        if self.metadata.get("frame", "sensor") == "sensor":
            return Pose()
        rotation_text = self.metadata.get("sensor_rotation", "1 0 0 0 1 0 0 0 1")
        rotation = parse_numbers(rotation_text, "sensor_rotation", (-1, 3, 3))[0]
        return Pose(position_m=self.sensor_position_m, rotation=rotation)

    @property
    def frame_start_s(self) -> float:
        """Start of the frame (of the first sensor of a rig) by the clock of motions; 0 if the metadata lack it."""
        return frame_starts_s(self.metadata)[0]

    @property
    def sensor_to_world(self) -> Pose | None:
        """Pose of the sensor (the first one of a rig) in the world; None if the metadata lack it.

        For a sensor that moves it is the pose at the start of the frame, like all places in the metadata.
        """
        if SENSOR_TO_WORLD not in self.metadata:
            return None
        rows = parse_numbers(self.metadata[SENSOR_TO_WORLD], SENSOR_TO_WORLD, (3, 4))
        return Pose(position_m=rows[:, 3], rotation=rows[:, :3])

    @property
    def sensors_to_vehicle(self) -> tuple[Pose, ...]:
        """Pose of each sensor on its vehicle; empty if the metadata lack them."""
        if SENSOR_TO_VEHICLE not in self.metadata:
            return ()
        matrices = parse_numbers(self.metadata[SENSOR_TO_VEHICLE], SENSOR_TO_VEHICLE, (-1, 3, 4))
        return tuple(Pose(position_m=rows[:, 3], rotation=rows[:, :3]) for rows in matrices)

    @property
    def vehicle_to_world(self) -> Pose | None:
        """Pose of the vehicle in the world at the start of the frame; None if the metadata lack it.

        Without an ego vehicle the world's origin stands for it.
        """
        mountings, place = self.sensors_to_vehicle, self.sensor_to_world
        return place @ mountings[0].inverse() if mountings and place is not None else None

    @property
    def frame_to_world(self) -> Pose | None:
        """Pose of the points' frame in the world; None if the metadata lack it."""
        place = self.sensor_to_world
        if self.metadata.get("frame", "sensor") == "world":
            return Pose()
        return None if place is None else place @ self.sensor_place.inverse()

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of this cloud, in the order of files."""
        return columns_of(truth=self.has_truth, vectors=self.has_vectors)

    @property
    def xyz(self) -> Numbers:
        """(n, 3) positions [m]: the columns "x", "y", "z", which are `xyz_m` too."""
        return self.xyz_m

    points = xyz

    @property
    def shape(self) -> tuple[int]:
        """(n,): that of ``np.asarray(cloud)``."""
        return (len(self),)

    def __iter__(self) -> Iterator[Any]:
        """Points one by one, each a row of `to_numpy`."""
        return iter(self.to_numpy())

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Numbers:
        """Structured array of `to_numpy`, for ``np.asarray(cloud)``; it is always a copy."""
        if copy is False:
            raise ValueError("a point cloud holds columns: its rows must be a copy, got copy=False")
        rows = self.to_numpy()
        return rows if dtype is None else rows.astype(dtype)

    @overload
    def __getitem__(self, key: str | list[str] | int) -> Any: ...

    @overload
    def __getitem__(self, key: Numbers | slice | Sequence[int]) -> Self: ...

    def __getitem__(self, key: Any) -> Any:
        """Look up a column by its name, several as (n, k), one point by its number, or `select` points."""
        if isinstance(key, str):
            return self.column(key)
        if isinstance(key, list) and key and all(isinstance(name, str) for name in key):
            return self.to_numpy(key)
        if isinstance(key, (int, np.integer)) and not isinstance(key, (bool, np.bool)):
            if not -len(self) <= key < len(self):
                raise InputError(f"cloud[{key}]: must be one of {len(self)} points")
            place = int(key) % len(self)
            return self.select(slice(place, place + 1)).to_numpy()[0]
        if np.ndim(key) == 0 and not isinstance(key, slice):
            raise InputError(
                f"cloud[{key!r}]: must be the name of a column, a list of names, the number of a point, a mask, an "
                "index array or a slice"
            )
        return self.select(key)

    def column(self, name: str) -> Numbers:
        """(n,) values of the column of this name, as in files: "x", "snr", "class", ..."""
        choices = {column.name: column for column in self.columns}
        if name not in choices:
            meant = f"{FOREIGN_NAMES[name]}; " if name in FOREIGN_NAMES else ""
            raise InputError(f"column '{name}': not in this cloud; {meant}{hint(name, choices)}")
        values: Numbers = getattr(self, choices[name].attribute)
        return values[:, "xyz".index(name)] if values.ndim == 2 else values

    def select(
        self,
        mask_or_index: Any = None,
        *,
        class_: Any = None,
        body: Any = None,
        material: Any = None,
        status: Any = None,
        sensor: Any = None,
    ) -> Self:
        """Select points by a (n,) mask, or by an index array or slice, in its order; and by name.

        ``cloud.select(class_="car", status="echo")`` are the echoes of cars. Each keyword takes a name, a number, or a
        list of them.

        Args:
            class_: of the body that was hit
            body: that was hit
            material: that was hit
            status: cause of the point, such as "false alarm"
            sensor: of a rig, by its label
        """
        categories = {"class": class_, "body": body, "material": material, "status": status, "sensor_index": sensor}
        asked = {name: choices for name, choices in categories.items() if choices is not None}
        if mask_or_index is not None:
            chosen = self._chosen(mask_or_index)
            return (
                chosen.select(None, class_=class_, body=body, material=material, status=status, sensor=sensor)
                if asked
                else chosen
            )
        if not asked:
            raise InputError('select: must have a mask, an index array, a slice or names such as class_="car"')
        mask = np.ones(len(self), bool)
        for name, choices in asked.items():
            mask &= self.column(name).isin(choices)  # type: ignore[attr-defined]
        return self._chosen(mask)

    def _chosen(self, mask_or_index: Any) -> Self:
        """Points by a mask, an index array or a slice."""
        must = "select: must be a mask such as cloud.status == 0, an index array or a slice, got"
        if isinstance(mask_or_index, str):
            raise InputError(f"{must} {mask_or_index!r}; names go by keyword: cloud.select(class_={mask_or_index!r})")
        try:
            index = mask_or_index if isinstance(mask_or_index, slice) else np.asarray(mask_or_index)
        except ValueError:
            raise InputError(f"{must} {one_line(mask_or_index)}") from None
        if isinstance(index, np.ndarray):
            if not index.size and index.ndim == 1:
                index = index.astype(np.intp)
            # A column of categories is uint8: NumPy would use it as an index.
            if index.ndim != 1 or index.dtype.kind not in "bui" or index.dtype == np.uint8:
                raise InputError(f"{must} {index.dtype} of shape {index.shape}")
            if index.dtype == bool and len(index) != len(self):
                raise InputError(f"{must} a mask of {len(index)} for {len(self)} points")
        try:
            chosen: dict[str, Any] = {name: array[index] for name, array in self._arrays().items()}
        except (IndexError, TypeError) as error:
            raise InputError(f"{must} one that does not fit {len(self)} points: {error}") from None
        return replace(self, checked=True, **chosen)

    def without_points(self) -> Self:
        """The cloud without its points: names, metadata and types. Unlike an empty slice it keeps no array."""
        return self.select(np.zeros(0, np.intp))

    def in_sensor_frame(self) -> Self:
        """The same points with positions in the sensor's frame, float32.

        Raises:
            InputError: for a cloud whose metadata do not say how the sensor stood, or of several sensors
        """
        if self.metadata.get("frame", "sensor") == "sensor":
            return self
        if len(sensor_positions_m(self.metadata)) > 1:
            raise InputError("this needs points in the sensor's frame, and the cloud is of several sensors")
        if "sensor_rotation" not in self.metadata:
            raise InputError(
                "this needs points in the sensor's frame, and the cloud's metadata do not say how the sensor was "
                "turned; render it with the frame 'sensor'"
            )
        placing = ("sensor_position_m", "sensor_rotation")
        metadata = {key: value for key, value in self.metadata.items() if key not in placing} | {"frame": "sensor"}
        xyz_m = self.sensor_place.inverse_apply(self.xyz_m.astype(np.float64)).astype(np.float32)
        turned_vectors = self.vectors_turned(self.sensor_place.rotation.T)
        return replace(self, xyz_m=xyz_m, metadata=metadata, **turned_vectors)

    def vectors_turned(self, rotation: Numbers) -> dict[str, Any]:
        """Normals and velocities in other axes, attribute -> (n,) array; empty if the cloud has none.

        Args:
            rotation: (3, 3) or (n, 3, 3), from the axes of the points to the others
        """
        if not self.has_vectors:
            return {}
        triples = (self._vectors("vectors", OF_VECTORS[first : first + 3]) for first in range(0, len(OF_VECTORS), 3))
        turned = [np.einsum("...ij,...j->...i", rotation, vectors) for vectors in triples]
        return dict(zip(OF_VECTORS, np.concatenate(turned, axis=1).astype(np.float32).T, strict=True))

    def _vectors(self, quantity: str, names: tuple[str, ...]) -> Numbers:
        if not self.has_vectors:
            raise InputError(f"{quantity}: not in this cloud; render with vectors=True")
        return np.stack([getattr(self, name) for name in names], axis=1)

    def to_numpy(self, columns: Sequence[str] | None = None) -> Numbers:
        """Copy columns to one array.

        Args:
            columns: names as in files, for an (n, k) array, of their common type; None: all of them, in a
                structured array of shape (n,) with a field for each
        """
        if columns is not None:
            arrays = [np.asarray(self.column(name)) for name in columns]
            return np.stack(arrays, axis=1) if arrays else np.zeros((len(self), 0))
        names = [column.name for column in self.columns]
        rows = np.zeros(len(self), np.dtype([(name, self.column(name).dtype) for name in names]))
        for name in names:
            rows[name] = self.column(name)
        return rows

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Columns by their names in files: cloud.x, cloud.range, cloud.time."""
            if name.startswith("_"):
                raise AttributeError(f"PointCloud has no attribute '{name}'")
            name = name.removesuffix("_")  # as keywords of Python are written: cloud.class_
            if name not in _OTHER_NAMES:
                raise no_attribute(self, name, name="cloud", foreign_names=FOREIGN_NAMES)
            try:
                return self.column(name)
            except InputError as error:
                raise AttributeError(str(error)) from None

    def __dir__(self) -> list[str]:
        return [*dir(type(self)), *(column.name for column in self.columns if column.name in _OTHER_NAMES)]

    def _arrays(self) -> dict[str, Numbers]:
        """Arrays of the columns, attribute -> array."""
        names = attributes(truth=self.has_truth, vectors=self.has_vectors)
        return {name: getattr(self, name) for name in names}


def _check_numbers(attribute: str, array: Numbers) -> None:
    """Raise ValueError for a NaN, and for a position at infinity."""
    distinct = array[:1] if is_constant(array) else array
    if attribute == "xyz_m" and distinct.size and np.isinf([distinct.min(), distinct.max()]).any():
        raise ValueError(f"PointCloud.{attribute}: infinite at {int(np.isinf(array).sum())} places")
    if distinct.dtype.kind == "f" and distinct.size and np.isnan(distinct.min()):
        raise ValueError(f"PointCloud.{attribute}: NaN at {int(np.isnan(array).sum())} places")


def _check_index(attribute: str, index: Numbers, names: tuple[str, ...]) -> None:
    """Raise ValueError unless each index is -1 or has a name; without names every index is accepted."""
    if is_constant(index):
        index = index[:1]
    if index.size and names and not -1 <= index.min() <= index.max() < len(names):
        raise ValueError(
            f"PointCloud.{attribute}: {index.min()} to {index.max()}, with names for 0 to {len(names) - 1}"
        )


def sensor_positions_m(metadata: Mapping[str, str]) -> Numbers:
    """(sensors, 3) float64 positions of the sensors in the frame of the points; ValueError if metadata lack them."""
    frame, text = metadata.get("frame", "sensor"), metadata.get("sensor_position_m", "")
    if frame == "sensor":
        return np.zeros((1, 3))
    with suppress(ValueError):
        positions = np.array([float(word) for word in text.split()]).reshape(-1, 3)
        if frame in ("world", "vehicle") and len(positions) and np.isfinite(positions).all():
            return positions
    expected = "'frame' must be 'sensor', or 'world' or 'vehicle' with 'sensor_position_m' as 'x y z'"
    raise ValueError(f"metadata: {expected}, got '{frame}' with '{text}'")


def frame_starts_s(metadata: Mapping[str, str]) -> list[float]:
    """Start of each sensor's frame [s], by the clock of motions."""
    return [float(word) for word in metadata.get("frame_start_s", "0.0").split()]


def parse_numbers(text: str, key: str, shape: tuple[int, ...]) -> Numbers:
    """Parse the numbers of an entry of the metadata; ValueError that names it if they do not have this shape."""
    try:
        return np.array([float(word) for word in text.split()]).reshape(shape)
    except ValueError:
        count = math.prod(abs(size) for size in shape)
        raise ValueError(f"metadata: '{key}': must be {count} numbers, got '{text}'") from None


def numbers_text(values: Numbers) -> str:
    """Text of an entry of the metadata, row by row in full precision: `parse_numbers` reads it."""
    return " ".join(map(repr, values.ravel().tolist()))


def pose_text(pose: Pose) -> str:
    """Text of the (3, 4) matrix of a pose."""
    return numbers_text(np.column_stack([pose.rotation, pose.position_m]))


def freeze_column(attribute: str, values: Any, points: int) -> Numbers:
    """Freeze ``values`` in dtype and shape of this attribute; ValueError that names it if they do not fit."""
    array, is_position = np.asarray(values), attribute == "xyz_m"
    position_dtype = "float32" if array.dtype == np.float32 else "float64"
    dtype = np.dtype(position_dtype if is_position else _DTYPES[attribute])
    shape = (points, 3) if is_position else (points,)
    if dtype.kind != "f" and array.dtype != dtype and array.size:
        limits = np.iinfo(str(dtype))
        if not limits.min <= array.min() <= array.max() <= limits.max:
            raise ValueError(f"PointCloud.{attribute}: values do not fit {dtype}")
    return frozen(array, dtype, shape, name=f"PointCloud.{attribute}")


def attributes(*, truth: bool, vectors: bool) -> tuple[str, ...]:
    """Attributes of a cloud's arrays; vectors need the truth."""
    return MEASURED + (TRUTH if truth else ()) + (OF_VECTORS if truth and vectors else ())


def is_constant(column: Numbers) -> bool:
    """True if the column is one value that numpy repeats (strides of 0)."""
    return len(column) > 0 and not any(column.strides)


def pulse_changes(cloud: Cloud, rows: slice) -> Numbers:
    """Mask (n - 1,) of points of another pulse than the point before: time, channel or direction differs."""
    key = (
        cloud.column("time")[rows],
        cloud.column("channel")[rows],
        cloud.column("azimuth")[rows],
        cloud.column("elevation")[rows],
    )
    return np.asarray(np.any([np.diff(values) != 0 for values in key], axis=0))


def returns_of_pulses(cloud: Cloud) -> Numbers:
    """Return (n,) number of points of each point's pulse: neighbours of the same time, channel and direction."""
    if not len(cloud):
        return np.zeros(0, np.uint8)
    starts = np.flatnonzero(np.r_[True, pulse_changes(cloud, slice(None))])
    counts = np.diff(np.r_[starts, len(cloud)])
    return np.repeat(counts, counts).clip(max=255).astype(np.uint8)
