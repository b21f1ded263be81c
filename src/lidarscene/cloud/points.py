"""PointCloud: what the user gets. Columns of points in, files and Open3D out."""

from __future__ import annotations

import importlib
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from ..detection.returns import Status
from ..errors import InputError
from ..formats.registry import FORMATS, format_of
from ..maths.arrays import frozen
from ..maths.pose import Pose

Array = np.ndarray[Any, Any]

STATUS_PLURALS = ("echoes", "false alarms", "of interference", "of weather")
STATUS_NAMES = tuple(status.name.lower().replace("_", " ") for status in Status)
"""Meaning of the `status` column, by value."""


@dataclass(frozen=True, slots=True)
class Column:
    """One scalar column: its name in files, the attribute of PointCloud that holds it, dtype and unit.

    x, y and z are the three columns of `xyz_m`, float32 or float64 as that array is.
    """

    name: str
    attribute: str
    dtype: str
    unit: str
    meaning: str
    truth: bool = False


COLUMNS = (
    Column("x", "xyz_m", "float32", "m", "position, forward"),
    Column("y", "xyz_m", "float32", "m", "position, left"),
    Column("z", "xyz_m", "float32", "m", "position, up"),
    Column("range", "range_m", "float32", "m", "range that the sensor reports"),
    Column("intensity", "intensity", "float32", "A or cells", "peak of the echo at the comparator"),
    Column(
        "pulse_width", "pulse_width_s", "float32", "s", "time over the threshold, 0 if it is not measured"
    ),
    Column("snr", "snr", "float32", "1", "signal-to-noise ratio"),
    Column("detection_probability", "detection_probability", "float32", "1", "probability of detection"),
    Column("ambient", "ambient", "float32", "1", "background counts of the pulse"),
    Column("time", "time_s", "float64", "s", "emission of the pulse, from the start of the frame"),
    Column("channel", "channel", "int32", "1", "laser channel"),
    Column("azimuth", "azimuth_rad", "float32", "rad", "commanded beam azimuth in the sensor frame"),
    Column("elevation", "elevation_rad", "float32", "rad", "commanded beam elevation in the sensor frame"),
    Column("return_number", "return_number", "uint8", "1", "return of this shot, 1 = first"),
    Column("status", "status", "uint8", "1", "0 echo, 1 false alarm, 2 interference, 3 weather"),
    Column("sensor_index", "sensor_index", "uint8", "1", "which sensor of a rig, 0 without one"),
    Column("true_range", "true_range_m", "float32", "m", "true range, inf without a surface", True),
    Column("incidence_angle", "incidence_angle_rad", "float32", "rad", "angle of incidence", True),
    Column("reflectivity", "reflectivity", "float32", "1", "diffuse reflectivity of the surface", True),
    Column("sun_angle", "sun_angle_rad", "float32", "rad", "angle of the sun to the surface normal", True),
    Column("in_shadow", "in_shadow", "uint8", "1", "1 where the sun does not reach", True),
    Column(
        "interactions",
        "interactions",
        "uint8",
        "1",
        "panes, mirrors and gaps on the way to the surface",
        True,
    ),
    Column("ghost", "ghost", "uint8", "1", "1 where one mirrored it: no surface is there", True),
    Column("radial_velocity", "radial_velocity_m_s", "float32", "m/s", "of surface and sensor apart", True),
    Column("body", "body", "int32", "1", "body that was hit, -1 none", True),
    Column("class", "class_id", "int32", "1", "class of that body, -1 none", True),
    Column("material", "material", "int32", "1", "material that was hit, -1 none", True),
)
"""Every column of a file, in order: the one table for files, documentation and pictures."""

_SCALARS = {c.attribute: c for c in COLUMNS[3:]}
MEASURED = ("xyz_m", *(a for a, c in _SCALARS.items() if not c.truth))
TRUTH = tuple(a for a, c in _SCALARS.items() if c.truth)
"""Attributes that every cloud has, and those that come all together or not at all."""

NAMES = {
    "sensor_index": "sensor_names",
    "body": "body_names",
    "class_id": "class_names",
    "material": "material_names",
}
"""Attribute that holds an index: attribute that holds the names. -1 has none."""

SENSOR_TO_WORLD = "sensor_to_world"
"""Key of the metadata: rotation and place of the sensor in the world, a (3, 4) matrix row by row."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PointCloud:
    """The points of one frame, struct of arrays, read-only; COLUMNS has the meaning of each field.

    xyz_m     (n, 3) float32 or float64, in the frame metadata["frame"]: "sensor" (default), "vehicle" or "world"
    range_m   (n,) float32, c t / 2 as the sensor reports it; all others (n,) of the dtype in COLUMNS
    truth     true_range_m to material: None all together, or none of them; -1 and inf mean no surface
    names     sensor_names[sensor_index], body_names[body], class_names[class_id], material_names[material]; each
              may be empty
    metadata  text by key: sensor, scene, seed, ...; a frame other than the sensor's needs
              "sensor_position_m": "x y z", three numbers for each sensor

    The arrays are not copied: who hands them over leaves them alone from then on. Raises ValueError for a
    wrong shape, an integer out of range, a NaN anywhere.
    """

    xyz_m: Array
    range_m: Array
    intensity: Array
    pulse_width_s: Array
    snr: Array
    detection_probability: Array
    ambient: Array
    time_s: Array
    channel: Array
    azimuth_rad: Array
    elevation_rad: Array
    return_number: Array
    status: Array
    sensor_index: Array
    true_range_m: Array | None = None
    incidence_angle_rad: Array | None = None
    reflectivity: Array | None = None
    sun_angle_rad: Array | None = None
    in_shadow: Array | None = None
    interactions: Array | None = None
    ghost: Array | None = None
    radial_velocity_m_s: Array | None = None
    body: Array | None = None
    class_id: Array | None = None
    material: Array | None = None
    sensor_names: tuple[str, ...] = ()
    body_names: tuple[str, ...] = ()
    class_names: tuple[str, ...] = ()
    material_names: tuple[str, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check and freeze every array; none is copied unless its dtype has to change."""
        absent = [a for a in TRUTH if getattr(self, a) is None]
        if absent and len(absent) < len(TRUTH):
            raise ValueError(f"PointCloud: truth fields come all together; missing: {', '.join(absent)}")
        n = len(self.xyz_m)
        for attribute in MEASURED if absent else MEASURED + TRUTH:
            object.__setattr__(self, attribute, _checked(attribute, getattr(self, attribute), n))
        for attribute in NAMES.values():
            object.__setattr__(self, attribute, tuple(getattr(self, attribute)))
        object.__setattr__(self, "metadata", {str(k): str(v) for k, v in self.metadata.items()})
        for attribute, names in NAMES.items():
            if attribute not in absent:
                _check_index(attribute, getattr(self, attribute), getattr(self, names))
        if not all(0 < len(key) <= 100 for key in self.metadata):
            raise ValueError("PointCloud.metadata: keys of 1 to 100 characters were expected")
        sensor_positions_m(self.metadata)

    def __len__(self) -> int:
        return int(self.xyz_m.shape[0])

    def __repr__(self) -> str:
        kinds = np.bincount(self.status, minlength=len(Status))
        told = [f"{count} {kind}" for count, kind in zip(kinds, STATUS_PLURALS, strict=True)]
        counts = f"{len(self)} points: {', '.join(told[:2] + [one for one in told[2:] if one[0] != '0'])}"
        axes = zip("xyz", self.xyz_m.T, strict=True) if len(self) else ()
        extent = "".join(f"; {name} {x.min():.1f}..{x.max():.1f} m" for name, x in axes)
        return f"PointCloud({counts}{extent}; sensor '{self.metadata.get('sensor', 'unknown')}')"

    @property
    def has_truth(self) -> bool:
        """Whether the truth fields are there."""
        return self.true_range_m is not None

    @property
    def sensor_position_m(self) -> Array:
        """(3,) float64 position of the sensor (of the first, of a rig) in the frame of the points."""
        return np.asarray(sensor_positions_m(self.metadata)[0])

    @property
    def sensor_place(self) -> Pose:
        """Where the sensor (of a rig the first) stood in the frame of the points.

        Not turned where metadata do not tell.
        """
        if self.metadata.get("frame", "sensor") == "sensor":
            return Pose()
        text = self.metadata.get("sensor_rotation", "1 0 0 0 1 0 0 0 1")
        turned = _numbers(text, "sensor_rotation", (-1, 3, 3))[0]
        return Pose(position_m=self.sensor_position_m, rotation=turned)

    @property
    def frame_start_s(self) -> float:
        """When the frame (of a rig the first sensor's) began, by the clock of motions; 0 if metadata do not tell."""
        return frame_starts_s(self.metadata)[0]

    @property
    def sensor_to_world(self) -> Pose | None:
        """Where the sensor (of a rig the first) stood in the world; None if metadata do not tell.

        Of a sensor that moves: at the start of the frame, as all that is said of places.
        """
        if SENSOR_TO_WORLD not in self.metadata:
            return None
        rows = _numbers(self.metadata[SENSOR_TO_WORLD], SENSOR_TO_WORLD, (3, 4))
        return Pose(position_m=rows[:, 3], rotation=rows[:, :3])

    @property
    def frame_to_world(self) -> Pose | None:
        """The frame of the points in the world; None if metadata do not tell."""
        place = self.sensor_to_world
        if self.metadata.get("frame", "sensor") == "world":
            return Pose()
        return None if place is None else place @ self.sensor_place.inverse()

    @property
    def columns(self) -> tuple[Column, ...]:
        """The columns that this cloud has, in the order of files."""
        return tuple(c for c in COLUMNS if self.has_truth or not c.truth)

    def column(self, name: str) -> Array:
        """(n,) values of the column of this name, as in files: "x", "snr", "class", ..."""
        choices = {c.name: c for c in self.columns}
        if name not in choices:
            raise InputError(f"column '{name}': not in this cloud; the choices are {', '.join(choices)}")
        values: Array = getattr(self, choices[name].attribute)
        return values[:, "xyz".index(name)] if values.ndim == 2 else values

    def select(self, mask_or_index: Any) -> PointCloud:
        """The points where a (n,) mask holds, or of an index array or slice, in that order."""
        return replace(self, **{a: v[mask_or_index] for a, v in self._arrays().items()})

    def without_points(self) -> PointCloud:
        """Names, metadata and types alone: it keeps nothing of this cloud in memory, as an empty slice would."""
        return self.select(np.zeros(0, np.intp))

    def without_truth(self) -> PointCloud:
        """The same points as a real sensor would give them."""
        nothing: dict[str, Any] = dict.fromkeys(TRUTH)
        return replace(self, **nothing)

    @staticmethod
    def concatenate(parts: list[PointCloud], *, consume: bool = False) -> PointCloud:
        """All points of the parts in order; names and metadata are those of the first.

        With ``consume`` the list is emptied: if nothing else holds the parts, memory peaks at one copy of the
        cloud plus one column. Raises ValueError where names differ, or only some parts have truth.
        """
        if not parts:
            raise ValueError("PointCloud.concatenate: no parts")
        description: dict[str, Any] = {a: getattr(parts[0], a) for a in (*NAMES.values(), "metadata")}
        if any(getattr(part, a) != description[a] for part in parts for a in NAMES.values()):
            raise ValueError("PointCloud.concatenate: the parts name different bodies, classes or materials")
        builder = CloudBuilder()
        for columns in [part._arrays() for part in parts]:
            builder.append(columns)
            columns.clear()
        if consume:
            parts.clear()
        return builder.build(**description)

    def in_sensor_frame(self) -> PointCloud:
        """The same points with positions in the sensor's frame, float32.

        Raises InputError for a cloud whose metadata do not say how the sensor stood, or of several sensors.
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
        metadata = {k: v for k, v in self.metadata.items() if k not in placing} | {"frame": "sensor"}
        xyz_m = self.sensor_place.inverse_apply(self.xyz_m.astype(np.float64)).astype(np.float32)
        return replace(self, xyz_m=xyz_m, metadata=metadata)

    def save(self, path: str | os.PathLike[str], *, format: str | None = None, ascii: bool = False) -> None:
        """Write a file of this format, or else of the one that the suffix names (`formats.registry`).

        ascii  text instead of binary, where the format has both
        """
        chosen = format_of(path, format)
        if ascii and not chosen.text:
            raise InputError(f"{os.fspath(path)}: this format is not text; ply and pcd can be")
        chosen.write()(path, self, **chosen.options, **({"ascii": True} if ascii else {}))

    @staticmethod
    def load(path: str | os.PathLike[str], *, format: str | None = None) -> PointCloud:
        """Read a file that `save` wrote, of a format that holds all of a cloud."""
        chosen = format_of(path, format)
        if not chosen.reader:
            raise InputError(
                f"{os.fspath(path)}: such files are written only, they do not hold all of a point cloud; "
                f"those that do: {', '.join(n for n, f in FORMATS.items() if f.reader)}"
            )
        return cast(PointCloud, chosen.read()(path))

    def to_structured(self) -> Array:
        """(n,) structured array with a field for each column, by the names of files; copied."""
        names = [column.name for column in self.columns]
        rows = np.zeros(len(self), np.dtype([(name, self.column(name).dtype) for name in names]))
        for name in names:
            rows[name] = self.column(name)
        return rows

    def to_pandas(self) -> Any:
        """A pandas.DataFrame with the columns of files, not copied; metadata in its `attrs`.

        Raises LidarSceneError, with what to install, where pandas cannot be imported.
        """
        return _interop("to_pandas", self)

    def to_torch(self) -> Any:
        """Tensors by name, in the memory of the cloud: do not write into them; "xyz" is (n, 3).

        Raises LidarSceneError, with what to install, where PyTorch cannot be imported.
        """
        return _interop("to_torch", self)

    def to_open3d(self) -> Any:
        """An open3d.t.geometry.PointCloud, copied: positions, and each other column as (n, 1) attribute.

        Raises LidarSceneError, with what to install, where Open3D cannot be imported.
        """
        return _interop("to_open3d", self)

    def _repr_png_(self) -> bytes:
        """A small picture, for notebooks."""
        return cast(bytes, _interop("thumbnail", self))

    def _repr_html_(self) -> str:
        """The same with the text below it."""
        return cast(str, _interop("to_html", self))

    def _arrays(self) -> dict[str, Array]:
        """The arrays by attribute."""
        return {a: getattr(self, a) for a in (MEASURED + TRUTH if self.has_truth else MEASURED)}


class CloudBuilder:
    """Gathers a cloud chunk by chunk. A single chunk is taken as it is; of several each column is one array.
    One value that was broadcast (all strides 0), the same in every chunk, stays one value.

    capacity  points at most, if known: room is reserved, and takes no memory until it is used. Beyond it, and
              without it, the columns grow in steps of a quarter. Small arrays that are joined in the end would
              double the peak: the allocator keeps the holes they leave.
    """

    def __init__(self, *, capacity: int = 0) -> None:
        self._columns: dict[str, Array] = {}
        self._description: dict[str, Any] = {}
        self._capacity, self._points, self._chunks = capacity, 0, 0

    def append(self, columns: Mapping[str, Any]) -> None:
        """Add points: arrays by attribute of PointCloud (xyz_m, range_m, ...), with or without TRUTH.

        The arrays must not change afterwards: a single chunk's become the cloud's own.
        """
        expected = self._columns or (MEASURED + TRUTH if TRUTH[0] in columns else MEASURED)
        if set(columns) != set(expected):
            differing = ", ".join(sorted(set(columns) ^ set(expected)))
            raise ValueError(f"CloudBuilder.append: columns missing, unknown or not as before: {differing}")
        n = len(columns["xyz_m"])
        # What is in them is checked once, when they are a cloud.
        checked = {a: _fitted(a, columns[a], n) for a in expected}
        self._chunks += 1
        if self._chunks == 1:
            self._columns, self._points = checked, n
            return
        end = self._points + n
        for a, values in checked.items():
            if (
                _is_constant(kept := self._columns[a])
                and _is_constant(values)
                and (kept[0] == values[0]).all()
            ):
                self._columns[a] = np.broadcast_to(kept[0], (end, *kept.shape[1:]))
                continue
            self._columns[a] = self._with_room(kept, end)
            self._columns[a][self._points : end] = values
        self._points = end

    def add(self, cloud: PointCloud) -> None:
        """Add the points of a cloud; the first's names and metadata are those of what is built."""
        if not self._description:
            self._description = {a: getattr(cloud, a) for a in (*NAMES.values(), "metadata")}
        self.append(cloud._arrays())

    def _with_room(self, column: Array, end: int) -> Array:
        """The column, or its points in a longer one if it is the first chunk's or too short."""
        if self._chunks > 2 and len(column) >= end:
            return column
        room = max(self._capacity, end) if self._chunks == 2 else end * 5 // 4
        longer = np.zeros((room, *column.shape[1:]), column.dtype)
        longer[: self._points] = column[: self._points]
        return longer

    def build(self, **description: Any) -> PointCloud:
        """The cloud of everything appended, with body_names, class_names, material_names and metadata if given.

        The builder is empty afterwards. Nothing appended: a cloud of no points, with truth.
        """
        columns: dict[str, Any] = {a: v[: self._points] for a, v in self._columns.items()}
        if not columns:
            columns = {a: np.zeros((0, 3) if a == "xyz_m" else 0) for a in MEASURED + TRUTH}
        described = self._description | description
        self._columns, self._description, self._points, self._chunks = {}, {}, 0, 0
        return PointCloud(**columns, **described)


def _is_constant(column: Array) -> bool:
    """Whether it is one value that numpy repeats."""
    return len(column) > 0 and not any(column.strides)


def sensor_positions_m(metadata: Mapping[str, str]) -> Array:
    """(sensors, 3) float64 positions of the sensors in the frame of the points; ValueError unless metadata tell."""
    frame, text = metadata.get("frame", "sensor"), metadata.get("sensor_position_m", "")
    if frame == "sensor":
        return np.zeros((1, 3))
    with suppress(ValueError):
        positions = np.array([float(word) for word in text.split()]).reshape(-1, 3)
        if frame in ("world", "vehicle") and len(positions) and np.isfinite(positions).all():
            return positions
    expected = "'frame' must be 'sensor', or 'world' or 'vehicle' with 'sensor_position_m' as 'x y z'"
    raise ValueError(f"metadata: {expected}; came '{frame}' with '{text}'")


def frame_starts_s(metadata: Mapping[str, str]) -> list[float]:
    """When the frame of each sensor began, by the clock of motions."""
    return [float(word) for word in metadata.get("frame_start_s", "0.0").split()]


def _fitted(attribute: str, values: Any, n: int) -> Array:
    """``values`` frozen in dtype and shape of this attribute; ValueError that names it if they do not fit."""
    array, is_position = np.asarray(values), attribute == "xyz_m"
    position_dtype = "float32" if array.dtype == np.float32 else "float64"
    dtype = np.dtype(position_dtype if is_position else _SCALARS[attribute].dtype)
    if dtype.kind != "f" and array.dtype != dtype and array.size:
        limits = np.iinfo(str(dtype))
        if not limits.min <= array.min() <= array.max() <= limits.max:
            raise ValueError(f"PointCloud.{attribute}: values do not fit {dtype}")
    try:
        return frozen(array, dtype, (n, 3) if is_position else (n,))
    except ValueError as error:
        raise ValueError(f"PointCloud.{attribute}: {error}") from None


def _checked(attribute: str, values: Any, n: int) -> Array:
    """`_fitted`, and ValueError if there is a NaN."""
    array = _fitted(attribute, values, n)
    told = array[:1] if _is_constant(array) else array
    if told.dtype.kind == "f" and told.size and np.isnan(told.min()):
        raise ValueError(f"PointCloud.{attribute}: NaN at {int(np.isnan(array).sum())} places")
    return array


def _check_index(attribute: str, index: Array, names: tuple[str, ...]) -> None:
    """ValueError unless each index is -1 or has a name; without names any index will do."""
    if _is_constant(index):
        index = index[:1]
    if index.size and names and not -1 <= index.min() <= index.max() < len(names):
        raise ValueError(
            f"PointCloud.{attribute}: {index.min()} to {index.max()}, with names for 0 to {len(names) - 1}"
        )


def _numbers(text: str, key: str, shape: tuple[int, ...]) -> Array:
    """The numbers of an entry of the metadata; ValueError that names it if they do not have this shape."""
    try:
        return np.array([float(word) for word in text.split()]).reshape(shape)
    except ValueError:
        count = math.prod(abs(size) for size in shape)
        raise ValueError(f"metadata: '{key}': {count} numbers were expected, '{text}' came") from None


def _interop(function: str, cloud: PointCloud) -> Any:
    """What `lidarscene.cloud.interop`, which is above this module, makes of a cloud."""
    return getattr(importlib.import_module("lidarscene.cloud.interop"), function)(cloud)
