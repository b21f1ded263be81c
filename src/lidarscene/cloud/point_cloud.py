"""Point cloud: columns of points, their meaning, and how to save, load and convert them.

A frozen struct of arrays, checked once when it is made, so that every user of a PointCloud can rely on shapes, types
and finite numbers. `formats.cloud_columns.CloudColumns` declares each column.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..detection.outcomes import Status
from ..errors import InputError
from ..files import facts
from ..files.arguments import CHECKED_INSIDE, checks_arguments
from ..files.late_binding import call_bound, read_by_name
from ..formats.cloud_columns import (
    NAMES,
    OF_VECTORS,
    SENSOR_TO_VEHICLE,
    SENSOR_TO_WORLD,
    STATUS_PLURALS,
    TRUTH,
    Cloud,
    numbers_text,
    parse_numbers,
    sensor_positions_m,
)
from ..formats.cloud_description import input_errors
from ..formats.registry import format_of, formats_with
from ..maths.arrays import Numbers
from ..scene.scene import View
from ..sensor.pose_file import Placed, to_pose
from .builder import CloudBuilder
from .rays import PulseRays


class _CloudWithRays(Cloud):
    """Cloud that may have the rays of its frame: no field, so that what is made of it by `replace` has none."""

    __slots__ = ("_rays",)
    _rays: PulseRays

    @property
    def rays(self) -> PulseRays:
        """Rays of every pulse of the frame, with a point or without, in the coordinates of this cloud.

        Raises:
            InputError: unless the cloud is as `render` gave it with ``keep_rays=True``: what is selected, moved or
                read of a file has none; an AttributeError too, so that ``hasattr`` answers
        """
        return self._rays

    @property
    def missed(self) -> PulseRays:
        """Rays of the pulses without a point; their outcomes say why. Errors as of `rays`."""
        rays = self.rays
        return rays.select(np.isinf(rays.range_m))

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name in ("rays", "missed", "_rays"):
                raise _WithoutRays(
                    "cloud.rays: must be of a cloud as render(..., keep_rays=True) gave it, and this has none"
                )
            return super().__getattr__(name)


class _WithoutRays(InputError, AttributeError):
    """Error for a cloud without rays, which ``hasattr`` understands."""


def _of_fields(values: dict[str, Any]) -> PointCloud:
    """Cloud of the fields of one that was checked."""
    return PointCloud(**values, checked=True)


@read_by_name("load_cloud")
@checks_arguments
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PointCloud(_CloudWithRays):
    """The points of one frame, struct of arrays, read-only; `CloudColumns` declares each column.

    ``PointCloud("a.ply")`` is `load_cloud`.

    * `truth`: true_range_m to material: all given or all None; -1 and inf mean no surface
    * `vectors`: normal_x to velocity_z_m_s: all given or all None; they need the truth
    * `names`: sensor_names[sensor_index], body_names[body], class_names[class_id], material_names[material]; each may
      be empty

    The arrays are not copied, so the caller must not write to them afterwards.

    Attributes:
        xyz_m: (n, 3) float32 or float64, in the frame metadata["frame"]: "sensor" (default), "vehicle" or "world"
        range_m: (n,) float32, c t / 2 as the sensor reports it; all others (n,) of the dtype declared
        metadata: text by key: sensor, scene, seed, ...; a frame other than the sensor's needs "sensor_position_m": "x y
            z", three numbers for each sensor

    Args:
        checked: True if the numbers are valid, so that only shapes and types are checked

    Raises:
        ValueError: for a wrong shape, an integer out of range, a NaN anywhere
    """

    if TYPE_CHECKING:  # the fields, or what `read_by_name` reads

        def __init__(self, file: str | os.PathLike[str] = ..., /, **values: Any) -> None: ...

    def __repr__(self) -> str:
        kinds = np.bincount(self.status, minlength=len(Status))
        parts = [f"{count} {kind}" for count, kind in zip(kinds, STATUS_PLURALS, strict=True)]
        counts = f"{len(self)} points: {', '.join(parts[:2] + [part for part in parts[2:] if part[0] != '0'])}"
        axes = zip("xyz", self.xyz_m.T, strict=True) if len(self) else ()
        extent = "".join(f"; {name} {values.min():.1f}..{values.max():.1f} m" for name, values in axes)
        return f"PointCloud({counts}{extent}; sensor '{self.metadata.get('sensor', 'unknown')}')"

    def __reduce__(self) -> tuple[Any, ...]:
        # NumPy's copies and pickles of read-only arrays can be written to: a new cloud makes them read-only again.
        return _of_fields, ({field.name: getattr(self, field.name) for field in fields(self)},)

    def without_truth(self) -> PointCloud:
        """The same points without truth, as a real sensor would report them."""
        absent: dict[str, Any] = dict.fromkeys((*TRUTH, *OF_VECTORS))
        return replace(self, checked=True, **absent)

    def without_bodies(self, bodies: Sequence[int]) -> PointCloud:
        """Points that are not on these bodies, given by their indices.

        Raises:
            InputError: for a cloud without truth
        """
        if self.body is None:
            raise InputError("without_bodies: the cloud must have its truth, which names the body of each point")
        return self.select(~np.isin(self.body, bodies))

    @staticmethod
    def concatenate(parts: list[PointCloud], *, consume: bool = False) -> PointCloud:
        """Join all points of the parts in order; names and metadata are those of the first.

        With ``consume`` the list is emptied: if nothing else holds the parts, memory peaks at one copy of the cloud
        plus one column.

        Raises:
            ValueError: where names differ, or only some parts have truth
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

    def __radd__(self, other: Any) -> PointCloud:
        """Begin a sum: ``sum(clouds)`` starts at 0."""
        return self if isinstance(other, int) and other == 0 else NotImplemented

    def __add__(self, other: PointCloud) -> PointCloud:
        """Points of both clouds, bodies, classes and materials by their names; metadata are those of the first.

        Raises:
            InputError: for clouds in different coordinates, or where only one has truth or vectors
        """
        if not isinstance(other, PointCloud):
            return NotImplemented
        if self._coordinates() != other._coordinates():
            raise InputError(
                "cloud + cloud: must be in the same coordinates, got "
                f"{_coordinates_text(self)} and {_coordinates_text(other)}; render both with coordinates='world'"
            )
        if self.sensor_names != other.sensor_names:
            raise InputError(
                "cloud + cloud: must be of the same sensors of a rig, got "
                f"{', '.join(self.sensor_names) or 'one sensor'} and {', '.join(other.sensor_names) or 'one sensor'}"
            )
        if (self.has_truth, self.has_vectors) != (other.has_truth, other.has_vectors):
            raise InputError("cloud + cloud: both must have truth and vectors, or none, got only one that has")
        return PointCloud.concatenate(with_common_names([self, other]))

    def _coordinates(self) -> tuple[str, str]:
        """Frame of the points, and the pose of what it is fixed to."""
        frame = self.metadata.get("frame", "sensor")
        keys = {"sensor": (SENSOR_TO_WORLD,), "vehicle": (SENSOR_TO_WORLD, SENSOR_TO_VEHICLE)}.get(frame, ())
        return frame, " ".join(self.metadata.get(key, "") for key in keys)

    def transform(self, pose: Placed) -> PointCloud:
        """Move the points, their normals and velocities: positions become ``pose.apply(xyz)``.

        The coordinates then count as the world's, and the sensor stands in them where the pose puts it:
        ``cloud.transform(cloud.frame_to_world)`` are the points in the world.

        Args:
            pose: of the frame of the points in the new one

        Raises:
            InputError: for anything but a pose
        """
        pose = to_pose(pose)
        positions_m = pose.apply(sensor_positions_m(self.metadata))
        standing = self.metadata.get("sensor_rotation", "1 0 0 0 1 0 0 0 1 " * len(positions_m))
        rotations = pose.rotation @ parse_numbers(standing, "sensor_rotation", (len(positions_m), 3, 3))
        placing = {"sensor_position_m": positions_m, "sensor_rotation": rotations}
        texts = {key: numbers_text(numbers) for key, numbers in placing.items()}
        return replace(
            self,
            xyz_m=pose.apply(self.xyz_m),
            metadata={**self.metadata, "frame": "world", **texts},
            **self.vectors_turned(pose.rotation),
        )

    def deskew(self, motion: Annotated[Any, CHECKED_INSIDE], *, length_s: float | None = None) -> PointCloud:
        """See `lidarscene.deskewed`."""
        moved: PointCloud = call_bound("deskew", self, motion, length_s=length_s)
        return moved

    def boxes(self, scene: Annotated[Any, CHECKED_INSIDE], *, as_seen: bool = True) -> Any:
        """See `lidarscene.boxes`."""
        return call_bound("boxes", self, scene, as_seen=as_seen)

    def range_image(self) -> dict[str, Numbers]:
        """Images of elevation by azimuth as the sensor sees them: name -> (rows, columns), 0 where no point is.

        range, intensity and, of sensors that count it, ambient; status is 1 + the cloud's, point is the index of the
        point, -1 for none; azimuth_deg (columns + 1,) and elevation_deg (rows + 1,) are the edges of the pixels.
        """
        from .pixels import images

        return images(self)

    def plot(
        self, colour_by: str = "intensity", *, view: View | None = None, size_px: tuple[int, int] = (1280, 720)
    ) -> facts.Picture:
        """Picture of the points with title and scale, which a notebook shows and `Picture.save` writes.

        Args:
            colour_by: a column
            view: camera, a `scene.scene.View`; None: from above and behind the sensor
        """
        picture: facts.Picture = call_bound("draw", self, colour_by=colour_by, view=view, size_px=size_px)
        return picture

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        format: str | None = None,
        ascii: bool = False,
        colour_by: str | None = None,
    ) -> None:
        """Write a file of this format, or else of the one that the suffix names (`formats.registry`).

        Args:
            ascii: text instead of binary, where the format has both
            colour_by: a column by which points get red, green and blue, as pictures have them; of a PLY file
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

    def to_pandas(self) -> Any:
        """A pandas.DataFrame with the columns of files, not copied; metadata in its `attrs`.

        Columns of codes with names (class, body, material, status) are categories: ``frame["class"] == "car"``; the
        codes are ``frame["class"].cat.codes``.

        Raises:
            LidarSceneError: with what to install, where pandas cannot be imported
        """
        from .interop import to_pandas

        return to_pandas(self)

    def to_torch(self) -> Any:
        """Tensors by name, in the memory of the cloud: do not write into them; "xyz" is (n, 3).

        Raises:
            LidarSceneError: with what to install, where PyTorch cannot be imported
        """
        from .interop import to_torch

        return to_torch(self)

    def to_open3d(self, *, colour_by: str | None = None, legacy: bool = False) -> Any:
        """An open3d.t.geometry.PointCloud, copied: positions, and each other column as (n, 1) attribute.

        Args:
            colour_by: a column by which points are coloured, as in pictures; None: no colours
            legacy: an open3d.geometry.PointCloud instead, which has positions and colours alone

        Raises:
            LidarSceneError: with what to install, where Open3D cannot be imported
        """
        from .interop import to_open3d

        return to_open3d(self, colours=None if colour_by is None else self.colours(colour_by), legacy=legacy)

    def view(
        self, *, scene: Any = None, sensor: Annotated[str | None, CHECKED_INSIDE] = None, height_px: int = 620
    ) -> Any:
        """The page of `lidarscene view` in a notebook, where the cloud is turned, coloured and clicked.

        The object returned also has `save(path)`, which writes the page.

        Args:
            scene: where it was made, a `Scene`, its name or file: its surfaces are shown too, and a point's budget
            sensor: catalogue name or file; None: the sensor that the cloud names
            height_px: of the frame in the notebook

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        return call_bound("view", self, scene=scene, sensor=sensor, height_px=height_px)

    def show(self, *, scene: Any = None, sensor: Annotated[str | None, CHECKED_INSIDE] = None) -> None:
        """Show the page of `view`: in the notebook, or else in the browser."""
        self.view(scene=scene, sensor=sensor).show()

    def _repr_png_(self) -> bytes:
        """A small picture, for notebooks."""
        from .interop import thumbnail

        return thumbnail(self)

    def _repr_html_(self) -> str:
        """The picture with the cloud's repr below it."""
        from .interop import to_html

        return to_html(self)


def with_common_names(clouds: Sequence[PointCloud]) -> list[PointCloud]:
    """Renumber bodies, classes and materials so that equal numbers mean equal names in all clouds."""
    names_of = {attribute: names for attribute, names in NAMES.items() if attribute in TRUTH}
    if all(getattr(cloud, key) == getattr(clouds[0], key) for cloud in clouds for key in names_of.values()):
        return list(clouds)
    tables = {
        key: tuple(dict.fromkeys(name for cloud in clouds for name in getattr(cloud, key))) for key in names_of.values()
    }
    renamed_clouds = []
    for cloud in clouds:
        changes: dict[str, Any] = dict(tables)
        for attribute, key in names_of.items() if cloud.has_truth else ():
            names = getattr(cloud, key)
            # One more entry, the last, for -1 and for numbers without a name.
            renumbered = np.array([*(tables[key].index(name) for name in names), -1], np.int32)
            changes[attribute] = renumbered[np.minimum(getattr(cloud, attribute), len(names))]
        renamed_clouds.append(replace(cloud, **changes))
    return renamed_clouds


def _coordinates_text(cloud: PointCloud) -> str:
    frame, pose = cloud._coordinates()
    return f"'{frame}' of the pose {pose.strip()}" if pose.strip() else f"'{frame}'"


load_cloud = PointCloud.load
