"""The table of all columns of point clouds, the protocol that writers need, and places and times in metadata.

One table gives name, type, unit and meaning of each column to files, documentation and pictures alike. Formats stand
below clouds: writers take whatever has a `Cloud`'s columns, readers return `Fields`, the keyword arguments of a
`cloud.point_cloud.PointCloud`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from ..detection.outcomes import Status
from ..maths.arrays import Numbers, frozen
from ..maths.pose import Pose

Fields = dict[str, Any]
"""Arrays, names and metadata by attribute of a point cloud."""

STATUS_PLURALS = ("echoes", "false alarms", "of interference", "of weather", "aliased")
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
    Column("intensity", "intensity", "float32", "A, cells or photons", "peak of the echo at the comparator"),
    Column("pulse_width", "pulse_width_s", "float32", "s", "time over the threshold, 0 if it is not measured"),
    Column("signal", "signal", "float32", "1", "photons counted of the return, 0 if they are not counted"),
    Column("snr", "snr", "float32", "1", "signal-to-noise ratio"),
    Column("detection_probability", "detection_probability", "float32", "1", "probability of detection"),
    Column("ambient", "ambient", "float32", "1", "background counts of the pulse"),
    Column("time", "time_s", "float64", "s", "emission of the pulse, from the start of the frame"),
    Column("channel", "channel", "int32", "1", "laser channel"),
    Column("azimuth", "azimuth_rad", "float32", "rad", "commanded beam azimuth in the sensor frame"),
    Column("elevation", "elevation_rad", "float32", "rad", "commanded beam elevation in the sensor frame"),
    Column("return_number", "return_number", "uint8", "1", "return of this shot, 1 = first"),
    Column("status", "status", "uint8", "1", "0 echo, 1 false alarm, 2 interference, 3 weather, 4 aliased"),
    Column("sensor_index", "sensor_index", "uint8", "1", "which sensor of a rig, 0 without one"),
    Column("true_range", "true_range_m", "float32", "m", "true range, inf without a surface", True),
    Column("incidence_angle", "incidence_angle_rad", "float32", "rad", "angle of incidence", True),
    Column("reflectivity", "reflectivity", "float32", "1", "diffuse reflectivity of the surface", True),
    Column("sun_angle", "sun_angle_rad", "float32", "rad", "angle of the sun to the surface normal", True),
    Column("in_shadow", "in_shadow", "uint8", "1", "1 where the sun does not reach", True),
    Column("interactions", "interactions", "uint8", "1", "panes, mirrors and gaps on the way to the surface", True),
    Column("ghost", "ghost", "uint8", "1", "1 where one mirrored it: no surface is there", True),
    Column("radial_velocity", "radial_velocity_m_s", "float32", "m/s", "of surface and sensor apart", True),
    Column("body", "body", "int32", "1", "body that was hit, -1 none", True),
    Column("class", "class_id", "int32", "1", "class of that body, -1 none", True),
    Column("material", "material", "int32", "1", "material that was hit, -1 none", True),
)
"""Every column of a file, in order: the one table for files, documentation and pictures."""

VECTORS = (
    *(
        Column(f"normal_{axis}", f"normal_{axis}", "float32", "1", f"normal of the surface, {way}", True)
        for axis, way in (("x", "forward"), ("y", "left"), ("z", "up"))
    ),
    *(
        Column(f"velocity_{axis}", f"velocity_{axis}_m_s", "float32", "m/s", f"of the surface, {way}", True)
        for axis, way in (("x", "forward"), ("y", "left"), ("z", "up"))
    ),
)
"""Columns of clouds with vectors, which follow the others. The axes are those of x, y and z. A normal is a unit vector
on the side from which the light came, a velocity is against the ground; both are 0 without a surface.
"""

_SCALARS = {column.attribute: column for column in COLUMNS[3:]}
MEASURED = ("xyz_m", *(attribute for attribute, column in _SCALARS.items() if not column.truth))
TRUTH = tuple(attribute for attribute, column in _SCALARS.items() if column.truth)
"""Attributes that every cloud has, and those that come all together or not at all."""

OF_VECTORS = tuple(column.attribute for column in VECTORS)
"""Attributes that come all together, with the truth, or not at all."""

_TYPES = {attribute: column.dtype for attribute, column in _SCALARS.items()} | {
    column.attribute: column.dtype for column in VECTORS
}

NAMES = {"sensor_index": "sensor_names", "body": "body_names", "class_id": "class_names", "material": "material_names"}
"""Attribute of an index -> attribute of the names. Index -1 has no name."""

SENSOR_TO_WORLD = "sensor_to_world"
"""Key of the metadata whose text is the pose of the sensor in the world: a (3, 4) matrix row by row."""


class Cloud(Protocol):
    """Members of a point cloud that writers need; `cloud.point_cloud.PointCloud` documents each."""

    def __len__(self) -> int: ...

    @property
    def columns(self) -> tuple[Column, ...]:
        """Scalar columns of the cloud."""

    @property
    def metadata(self) -> Mapping[str, str]:
        """Text by key."""

    @property
    def xyz_m(self) -> Numbers:
        """(n, 3) positions."""

    @property
    def has_truth(self) -> bool:
        """True if the cloud has the columns of the truth."""

    @property
    def has_vectors(self) -> bool:
        """True if the cloud has the columns `VECTORS`."""

    @property
    def sensor_position_m(self) -> Numbers:
        """(3,) position of the sensor in the frame of the points."""

    @property
    def sensor_place(self) -> Pose:
        """Pose of the sensor in the frame of the points."""

    @property
    def sensor_to_world(self) -> Pose | None:
        """Pose of the sensor in the world; None if the metadata lack it."""

    @property
    def frame_to_world(self) -> Pose | None:
        """Pose of the frame of the points in the world; None if the metadata lack it."""

    @property
    def frame_start_s(self) -> float:
        """Start of the frame [s], by the clock of motions."""

    def column(self, name: str) -> Numbers:
        """(n,) values of a column, by its name in files."""

    def select(self, mask_or_index: Any) -> Self:
        """Cloud of these points only."""

    def without_points(self) -> Self:
        """Cloud without points, with the same names and metadata."""

    def in_sensor_frame(self) -> Self:
        """Cloud with positions in the sensor's frame."""

    def to_structured(self) -> Numbers:
        """(n,) rows of all columns."""


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


def freeze_column(attribute: str, values: Any, points: int) -> Numbers:
    """Freeze ``values`` in dtype and shape of this attribute; ValueError that names it if they do not fit."""
    array, is_position = np.asarray(values), attribute == "xyz_m"
    position_dtype = "float32" if array.dtype == np.float32 else "float64"
    dtype = np.dtype(position_dtype if is_position else _TYPES[attribute])
    shape = (points, 3) if is_position else (points,)
    if array.dtype == dtype and array.shape == shape and not array.flags.writeable:
        return array  # it went through this function before
    if dtype.kind != "f" and array.dtype != dtype and array.size:
        limits = np.iinfo(str(dtype))
        if not limits.min <= array.min() <= array.max() <= limits.max:
            raise ValueError(f"PointCloud.{attribute}: values do not fit {dtype}")
    try:
        return frozen(array, dtype, shape)
    except ValueError as error:
        raise ValueError(f"PointCloud.{attribute}: {error}") from None


def attributes(*, truth: bool, vectors: bool) -> tuple[str, ...]:
    """Attributes of a cloud's arrays; vectors need the truth."""
    return MEASURED + (TRUTH if truth else ()) + (OF_VECTORS if truth and vectors else ())


def is_constant(column: Numbers) -> bool:
    """True if the column is one value that numpy repeats (strides of 0)."""
    return len(column) > 0 and not any(column.strides)
