"""Point cloud: columns of points, their meaning, and how to save, load and convert them.

A frozen struct of arrays, checked once when it is made, so that every user of a PointCloud can rely on shapes, types
and finite numbers. `formats.cloud_columns.CloudColumns` declares each column.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import InitVar, dataclass, field, replace
from typing import Any

import numpy as np

from ..detection.outcomes import Status
from ..errors import InputError, did_you_mean
from ..files import facts
from ..formats.cloud_columns import (
    NAMES,
    OF_VECTORS,
    SENSOR_TO_WORLD,
    STATUS_PLURALS,
    TRUTH,
    CloudColumns,
    Column,
    attributes,
    columns_of,
    frame_starts_s,
    freeze_column,
    is_constant,
    parse_numbers,
    sensor_positions_m,
)
from ..formats.cloud_description import input_errors
from ..formats.registry import format_of, formats_with
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from .builder import CloudBuilder


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PointCloud(CloudColumns):
    """The points of one frame, struct of arrays, read-only; `CloudColumns` declares each column.

    xyz_m     (n, 3) float32 or float64, in the frame metadata["frame"]: "sensor" (default), "vehicle" or "world"
    range_m   (n,) float32, c t / 2 as the sensor reports it; all others (n,) of the dtype declared
    truth     true_range_m to material: all given or all None; -1 and inf mean no surface
    vectors   normal_x to velocity_z_m_s: all given or all None; they need the truth
    names     sensor_names[sensor_index], body_names[body], class_names[class_id], material_names[material]; each
              may be empty
    metadata  text by key: sensor, scene, seed, ...; a frame other than the sensor's needs
              "sensor_position_m": "x y z", three numbers for each sensor

    checked   True if the numbers are valid, so that only shapes and types are checked

    The arrays are not copied, so the caller must not write to them afterwards. Raises ValueError for a
    wrong shape, an integer out of range, a NaN anywhere.
    """

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
                _check_nan(attribute, array)
            object.__setattr__(self, attribute, array)
        for attribute in NAMES.values():
            object.__setattr__(self, attribute, tuple(getattr(self, attribute)))
        object.__setattr__(self, "metadata", {str(key): str(value) for key, value in self.metadata.items()})
        for attribute, names in NAMES.items():
            if attribute not in absent_truth and not checked:
                _check_index(attribute, getattr(self, attribute), getattr(self, names))
        if not all(0 < len(key) <= 100 for key in self.metadata):
            raise ValueError("PointCloud.metadata: keys must have 1 to 100 characters")
        sensor_positions_m(self.metadata)

    def __len__(self) -> int:
        return int(self.xyz_m.shape[0])

    def __repr__(self) -> str:
        kinds = np.bincount(self.status, minlength=len(Status))
        parts = [f"{count} {kind}" for count, kind in zip(kinds, STATUS_PLURALS, strict=True)]
        counts = f"{len(self)} points: {', '.join(parts[:2] + [part for part in parts[2:] if part[0] != '0'])}"
        axes = zip("xyz", self.xyz_m.T, strict=True) if len(self) else ()
        extent = "".join(f"; {name} {values.min():.1f}..{values.max():.1f} m" for name, values in axes)
        return f"PointCloud({counts}{extent}; sensor '{self.metadata.get('sensor', 'unknown')}')"

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

    def column(self, name: str) -> Numbers:
        """(n,) values of the column of this name, as in files: "x", "snr", "class", ..."""
        choices = {column.name: column for column in self.columns}
        if name not in choices:
            hint = f"{did_you_mean(name, choices)} the choices are {', '.join(choices)}".strip()
            raise InputError(f"column '{name}': not in this cloud; {hint}")
        values: Numbers = getattr(self, choices[name].attribute)
        return values[:, "xyz".index(name)] if values.ndim == 2 else values

    def select(self, mask_or_index: Any) -> PointCloud:
        """Select points by a (n,) mask, or by an index array or slice, in its order."""
        if isinstance(mask_or_index, str):
            raise InputError(
                f"select: must be a mask, an index array or a slice, such as cloud.status == 0, got {mask_or_index!r}"
            )
        if (
            getattr(mask_or_index, "dtype", None) == np.uint8
        ):  # a column of categories, which NumPy would use as an index
            raise InputError("select: must be a mask such as cloud.status == 0, an index array or a slice, got uint8")
        return replace(self, checked=True, **{name: array[mask_or_index] for name, array in self._arrays().items()})

    def without_points(self) -> PointCloud:
        """The cloud without its points: names, metadata and types. Unlike an empty slice it keeps no array."""
        return self.select(np.zeros(0, np.intp))

    def without_truth(self) -> PointCloud:
        """The same points without truth, as a real sensor would report them."""
        absent: dict[str, Any] = dict.fromkeys((*TRUTH, *OF_VECTORS))
        return replace(self, checked=True, **absent)

    @staticmethod
    def concatenate(parts: list[PointCloud], *, consume: bool = False) -> PointCloud:
        """Join all points of the parts in order; names and metadata are those of the first.

        With ``consume`` the list is emptied: if nothing else holds the parts, memory peaks at one copy of the
        cloud plus one column. Raises ValueError where names differ, or only some parts have truth.
        """
        if not parts:
            raise ValueError("PointCloud.concatenate: no parts")
        description: dict[str, Any] = {name: getattr(parts[0], name) for name in (*NAMES.values(), "metadata")}
        if any(getattr(part, name) != description[name] for part in parts for name in NAMES.values()):
            raise ValueError("PointCloud.concatenate: the parts name different bodies, classes or materials")
        builder = CloudBuilder()
        for columns in [part._arrays() for part in parts]:
            builder.append(columns)
            columns.clear()
        if consume:
            parts.clear()
        return PointCloud(**builder.fields(**description), checked=True)

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
        metadata = {key: value for key, value in self.metadata.items() if key not in placing} | {"frame": "sensor"}
        xyz_m = self.sensor_place.inverse_apply(self.xyz_m.astype(np.float64)).astype(np.float32)
        turned_vectors = self.vectors_turned(self.sensor_place.rotation.T)
        return replace(self, xyz_m=xyz_m, metadata=metadata, **turned_vectors)

    def vectors_turned(self, rotation: Numbers) -> dict[str, Any]:
        """Normals and velocities in other axes, attribute -> (n,) array; empty if the cloud has none.

        rotation  (3, 3) or (n, 3, 3), from the axes of the points to the others
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

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        format: str | None = None,
        ascii: bool = False,
        colour_by: str | None = None,
    ) -> None:
        """Write a file of this format, or else of the one that the suffix names (`formats.registry`).

        ascii      text instead of binary, where the format has both
        colour_by  a column by which points get red, green and blue, as pictures have them; of a PLY file
        """
        chosen = format_of(path, format)
        if colour_by is not None and not chosen.colour:
            able = " and ".join(formats_with("colour"))
            raise InputError(f"{os.fspath(path)}: this format has no colours; {able} can have some")
        if ascii and not chosen.text:
            able = " and ".join(formats_with("text"))
            raise InputError(f"{os.fspath(path)}: this format is not text; {able} can be")
        options: dict[str, Any] = {"ascii": True} if ascii else {}
        if colour_by is not None:
            options["colours"] = self.colours(colour_by)
        chosen.write(path, self, **options)

    def colours(self, column: str = "intensity") -> Numbers:
        """(n, 3) uint8 red, green and blue of the points by a column, as pictures have them."""
        from .shades import Shades

        return np.asarray(Shades(self, column).rgb)

    @staticmethod
    def load(path: str | os.PathLike[str], *, format: str | None = None) -> PointCloud:
        """Read a file that `save` wrote, of a format that holds all of a cloud."""
        chosen = format_of(path, format)
        if chosen.read is None:
            raise InputError(
                f"{os.fspath(path)}: such files are written only, they do not hold all of a point cloud; "
                f"those that do: {', '.join(formats_with('read'))}"
            )
        fields = chosen.read(path)
        with input_errors(path):
            return PointCloud(**fields)

    def to_structured(self) -> Numbers:
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
        from .interop import to_pandas

        return to_pandas(self)

    def to_torch(self) -> Any:
        """Tensors by name, in the memory of the cloud: do not write into them; "xyz" is (n, 3).

        Raises LidarSceneError, with what to install, where PyTorch cannot be imported.
        """
        from .interop import to_torch

        return to_torch(self)

    def to_open3d(self, *, colour_by: str | None = None, legacy: bool = False) -> Any:
        """An open3d.t.geometry.PointCloud, copied: positions, and each other column as (n, 1) attribute.

        colour_by  a column by which points are coloured, as in pictures; None: no colours
        legacy     an open3d.geometry.PointCloud instead, which has positions and colours alone
        Raises LidarSceneError, with what to install, where Open3D cannot be imported.
        """
        from .interop import to_open3d

        return to_open3d(self, colours=None if colour_by is None else self.colours(colour_by), legacy=legacy)

    def view(self, *, scene: Any = None, sensor: str | None = None, height_px: int = 620) -> Any:
        """The page of `lidarscene view` in a notebook, where the cloud is turned, coloured and clicked.

        scene      where it was made, a `Scene`, its name or file: its surfaces are shown too, and a point's budget
        sensor     catalogue name or file; None: the sensor that the cloud names
        height_px  of the frame in the notebook
        The object returned also has `save(path)`, which writes the page. Raises InputError.
        """
        return facts.show_with_viewer(self, scene=scene, sensor=sensor, height_px=height_px)

    def _repr_png_(self) -> bytes:
        """A small picture, for notebooks."""
        from .interop import thumbnail

        return thumbnail(self)

    def _repr_html_(self) -> str:
        """The picture with the cloud's repr below it."""
        from .interop import to_html

        return to_html(self)

    def _arrays(self) -> dict[str, Numbers]:
        """Arrays of the columns, attribute -> array."""
        names = attributes(truth=self.has_truth, vectors=self.has_vectors)
        return {name: getattr(self, name) for name in names}


def _check_nan(attribute: str, array: Numbers) -> None:
    """Raise ValueError for a NaN."""
    distinct = array[:1] if is_constant(array) else array
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
