"""The formats of point clouds by name and suffix, and what each can do.

The command line, the library and the documentation use this table, so that a new format is one module and one line.
A line names the format's functions; their module is imported when the first of them is called, so that
`lidarscene --help` and `import lidarscene` read the table and load no format, and no NumPy.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..files.optional import require

if TYPE_CHECKING:
    from .cloud_columns import Fields

Write = Callable[..., None]
Read = Callable[[str | os.PathLike[str]], "Fields"]
Stream = Callable[..., AbstractContextManager[Callable[[Any], None]]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """One format.

    Attributes:
        suffix: end of the names of such files
        write: write a cloud: path, cloud, options; without a function of its own through ``stream`` or ``frames``
        read: read the fields of a cloud from a path; None if such a file does not hold all of a cloud
        stream: context manager from a path (and ``ascii``) to a function that appends clouds; None if a file cannot be
            written piece by piece with the same bytes as from the whole cloud
        profile: profile of packets (`packets.select_encoder`): a run's frames are in one file. None: a file is a cloud
        extra: group of optional packages that the format needs (`files.optional.EXTRAS`)
        frames: context manager from a path (and ``epoch_ns``, as `formats.clock` has it) to a function that appends
            whole clouds, the frames of one file, each with the label of its sensor; None if a file holds a single frame
        rig: whether such a file holds the clouds of several sensors, each by itself, and IMUs (``append_imu``)
        driver: whether ``frames`` takes the names of a ROS driver, ``topic`` and ``frame_id``, and the vehicle's motion
        boxes: whether ``frames`` takes boxes of bodies and range images with a cloud
        folder: whether it is a folder of files, so that its name needs no suffix
        text: whether ``write`` and ``stream`` take ``ascii``
        colour: whether ``write`` takes ``colours``
        columns: what a file holds of a cloud's columns, in words; begins with "all" if it is every one
        positions: types and coordinates of its positions, in words
        beside: what else it holds, in words
    """

    suffix: str
    write: Write
    read: Read | None = None
    stream: Stream | None = None
    profile: str | None = None
    frames: Stream | None = None
    extra: str = ""
    rig: bool = False
    driver: bool = False
    boxes: bool = False
    folder: bool = False
    text: bool = False
    colour: bool = False
    columns: str = "all, exact"
    positions: str = "float32 or float64"
    beside: str = "metadata, units, names"

    @property
    def all_columns(self) -> bool:
        """True if a file holds every column of a cloud, normals and velocities too."""
        return self.columns.startswith("all")

    def require(self) -> None:
        """Raise LidarSceneError, with what to install, if a package is missing."""
        if self.extra:
            require(self.extra)


def _import_on_call(module: str, name: str, **options: object) -> Callable[..., Any]:
    """Wrap a function of a module here with these options; the module is imported when the function is called."""

    def call(*arguments: Any, **keywords: Any) -> Any:
        return getattr(import_module(f"lidarscene.formats.{module}"), name)(*arguments, **options, **keywords)

    return call


def _written_by(stream: Stream) -> Write:
    """Write a file of one cloud with a function that writes one of several."""

    def write(path: str | os.PathLike[str], cloud: object, **options: object) -> None:
        with stream(path, **options) as append:
            append(cloud)

    return write


def _functions(module: str, members: str, **options: object) -> dict[str, Any]:
    """Functions of a format in its module, by member of `Format`: write_MODULE, read_MODULE, MODULE_stream, ...

    Args:
        members: which of them the module has; one that cannot write writes with its stream or its frames
        options: of all but the reader
    """
    names = {"write": f"write_{module}", "stream": f"{module}_stream", "frames": f"{module}_frames"}
    functions = {name: _import_on_call(module, names[name], **options) for name in names if name in members.split()}
    if "write" not in functions:
        functions["write"] = _written_by(*functions.values())
    return functions | ({"read": _import_on_call(module, f"read_{module}")} if "read" in members.split() else {})


def _ros(suffix: str, storage: str, layout: str = "") -> Format:
    return Format(
        suffix=suffix,
        extra="ros",
        columns=_CUSTOM_COLUMNS if layout == "livox-custom" else "all; the driver's own first, in its units",
        positions="float32, sensor frame",
        beside="poses as `/tf` and `/tf_static`; metadata, units, names",
        rig=True,
        driver=True,
        folder=storage == "sqlite3",
        **_functions("ros", "frames", storage=storage, layout=layout),
    )


_CUSTOM_COLUMNS = "`time` in ns, `intensity` as a byte, `return_number` in the tag, `ring` as line"


def _las(suffix: str, *, compressed: bool) -> Format:
    return Format(
        suffix=suffix,
        extra="las",
        columns="all, exact, as extra bytes; the standard fields coarser",
        positions="steps of 10 um, 21 km around the sensor",
        **_functions("las", "read stream", compressed=compressed),
    )


def _osi(suffix: str, *, extra: str = "", storage: str) -> Format:
    return Format(
        suffix=suffix,
        extra=extra,
        columns="`range`, `azimuth`, `elevation`, `detection_probability`, `intensity` in percent, `pulse_width` in "
        "metres of range if it is measured, `channel`, what is no echo as clutter; `body`, `reflectivity`, "
        "`radial_velocity`",
        positions="none: range and angles of each sensor",
        beside="time, mounting positions, host vehicle",
        **_functions("osi", "frames", storage=storage),
    )


def _rows(suffix: str, text: str, columns: tuple[str, ...]) -> Format:
    functions = _functions("kitti", "stream", columns=columns)
    return Format(suffix=suffix, columns=text, positions="float32, sensor frame", beside="nothing", **functions)


ROS_LAYOUTS = ("velodyne", "ouster", "hesai", "robosense", "livox", "livox-custom")
"""Layouts of messages of ROS 2 that may be chosen by name; without, the sensor's driver chooses."""

_PCD: dict[str, Any] = {
    "positions": "float32; far from the origin from the viewpoint's whole metres on",
    "beside": "metadata, units, names, viewpoint",
}

FORMATS = {
    "ply": Format(suffix=".ply", text=True, colour=True, **_functions("ply", "read stream")),
    "pcd": Format(suffix=".pcd", text=True, **_PCD, **_functions("pcd", "read stream")),
    "pcd-compressed": Format(suffix=".pcd", extra="pcd", **_PCD, **_functions("pcd", "write read")),
    "las": _las(".las", compressed=False),
    "laz": _las(".laz", compressed=True),
    "e57": Format(
        suffix=".e57",
        extra="e57",
        columns="all, exact, infinity as 3.4e38",
        beside="metadata, units, names; the pose of the scan",
        **_functions("e57", "write"),
    ),
    "kitti": _rows(".bin", "`intensity`", ("intensity",)),
    "nuscenes": _rows(".pcd.bin", "`intensity`, `ring` from the lowest up", ("intensity", "ring")),
    "npz": Format(suffix=".npz", **_functions("npz", "write read")),
    "parquet": Format(suffix=".parquet", extra="parquet", **_functions("parquet", "read stream")),
    "mcap": _ros(".mcap", storage="mcap"),
    **{f"mcap-{layout}": _ros(".mcap", storage="mcap", layout=layout) for layout in ROS_LAYOUTS},
    "rrd": Format(
        suffix=".rrd",
        extra="rerun",
        columns="all, exact",
        positions="float32, sensor frame",
        beside="boxes, range images, poses, the vehicle's path; metadata, units, names",
        rig=True,
        boxes=True,
        **_functions("rerun", "frames"),
    ),
    "osi": _osi(".osi", storage="binary"),
    "osi-mcap": _osi(".mcap", extra="osi", storage="mcap"),
}
"""Formats of files by name. A suffix means the first format that has it."""

BAGS = {"rosbag2": _ros(".db3", storage="sqlite3")} | {
    f"rosbag2-{layout}": _ros(".db3", storage="sqlite3", layout=layout) for layout in ROS_LAYOUTS
}
"""Formats that are folders, by name."""


def formats_with(member: str) -> list[str]:
    """Names of the formats of which this member of `Format` is true or given."""
    return [name for name, file_format in (FORMATS | BAGS).items() if getattr(file_format, member)]


def readable_suffixes() -> set[str]:
    """Suffixes of the files that hold all of a cloud."""
    return {file_format.suffix for file_format in FORMATS.values() if file_format.read}


def _packets(profile: str) -> Format:
    write = _import_on_call("packets.pcap", "refuse_cloud")
    return Format(suffix=".pcap", write=write, profile=profile, columns="")


PACKETS = {"pcap": _packets("default"), "pcap-low-rate": _packets("low-rate"), "pcap-legacy": _packets("legacy")}
"""Formats of the sensor's own packets, by name: they hold lost pulses too, so they are no formats of clouds."""

ALL = FORMATS | BAGS | PACKETS
SUFFIXES = tuple(dict.fromkeys(file_format.suffix for file_format in ALL.values()))

LABELS = {
    "kitti": (".txt", ".calib.txt"),
    "nuscenes": (".boxes.json",),
    "semantickitti": (".label",),
    "osi": ("_gt.osi",),
}
"""Labels by name (`lidarscene.labels.files`): what their files have in place of the cloud's suffix."""

IMU_SUFFIXES, POSE_SUFFIXES = (".csv",), (".tum", ".txt")
"""Ends of the names of `lidarscene.formats.motion_files`."""

DATASETS = ("kitti", "semantickitti")
"""Data sets by name (`lidarscene.labels.kitti_dataset`)."""


OTHER_SUFFIXES = {
    ".bag": "bags of ROS 2 are .mcap and .db3",
    ".csv": "cloud.to_pandas().to_csv(path) writes a table",
    ".h5": "cloud.to_pandas().to_hdf(path, key='cloud') writes a table",
    **dict.fromkeys((".png", ".jpg", ".svg", ".pdf"), "cloud.plot().save('a.png') writes a picture"),
    ".npy": "numpy.save(path, cloud.to_numpy()) writes an array",
    ".xyz": "numpy.savetxt(path, cloud.xyz_m) writes positions",
}
"""Suffixes that people try, and what writes such a file."""


def format_of(path: str | os.PathLike[str], name: str | None = None) -> Format:
    """Return the format of this name, or else the one whose suffix the path has; the longest suffix wins."""
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"path: must be the name of a file, got {type(path).__name__}")
    if name is not None:
        if name not in ALL:
            choices = ", ".join(ALL)
            raise InputError(f"format '{name}': there is none; the choices are {choices}")
        return ALL[name]
    file = os.path.basename(os.fspath(path)).lower()
    matches = [file_format for file_format in ALL.values() if file.endswith(file_format.suffix)]
    if not matches:
        suffix, choices = os.path.splitext(file)[1], ", ".join(SUFFIXES)
        suffix_or_folder = "a folder" if os.path.isdir(path) else f"suffix '{suffix}'"
        meant = f"{OTHER_SUFFIXES[suffix]}; " if suffix in OTHER_SUFFIXES else ""
        raise InputError(f"{os.fspath(path)}: {suffix_or_folder} names no point cloud format; {meant}known: {choices}")
    return max(matches, key=lambda file_format: len(file_format.suffix))
