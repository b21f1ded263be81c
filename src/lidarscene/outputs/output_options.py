"""Outputs: every file that a frame becomes, declared once for the library and the command line.

A wrong combination raises an error when the options are made. Errors name options in braces, which the command line
replaces by its own names.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import ClassVar

from ..errors import InputError, OptionError
from ..formats.clock import EPOCH, default_epoch_ns, parse_date, to_ns
from ..formats.registry import (
    ALL,
    BAGS,
    DATASETS,
    FORMATS,
    IMU_SUFFIXES,
    LABELS,
    PACKETS,
    POSE_SUFFIXES,
    SUFFIXES,
    Format,
    format_of,
)
from ..rendering.option_fields import (
    Date,
    FileName,
    Matching,
    OneOf,
    Whole,
    check_options,
    declared,
    list_options,
    option,
    options_of,
)

File = str | os.PathLike[str]

FRAMES = Whole(1, 10_000)
"""Frames of a run; file names have four digits for the number."""

FEW_PULSES = 9
"""Default number of pulses with waveforms."""


@list_options
@dataclass(frozen=True, slots=True)
class Outputs:
    """Every file that a frame becomes.

    Each of several frames or sensors has separate files: labels and numbers are added to the names. Labels are made of
    the ground truth whether or not the cloud has it.

    Raises:
        InputError: for options that do not go together
    """

    KEYWORD: ClassVar[str] = "outputs"

    path: File = field(
        metadata=declared(
            "file of the point cloud, whose suffix chooses the format; a folder for several frames, for a "
            "data set, and for a rig that is not merged; a ROS 2 bag (.mcap, .db3) or a Rerun log (.rrd) "
            "contains all frames of all sensors, and packets (.pcap) all frames of one",
            metavar="OUT.ply|DIR",
            flags=("-o", "--output"),
        )
    )
    _: KW_ONLY
    format: str | None = option(
        None,
        OneOf(ALL),
        help=f"format of the cloud (default: by its suffix): {', '.join(FORMATS | BAGS)}; or packets of the sensor: "
        f"{', '.join(PACKETS)}",
        metavar="NAME",
    )
    epoch: str | None = option(
        None,
        Date(),
        help="date of the scene's second 0 for time stamps of bags and packets, in ISO 8601 (default "
        f"{EPOCH:%Y-%m-%d}, or 1970-01-01 if the first frame begins at 1e9 s or later)",
        metavar="DATE",
    )
    topic: str | None = option(
        None,
        Matching("/?[A-Za-z]\\w*(/[A-Za-z]\\w*)*", "a name of ROS such as lidar/points"),
        help="topic of the points in a ROS 2 bag (default: that of the maker's driver)",
        metavar="NAME",
    )
    frame_id: str | None = option(
        None,
        Matching("[A-Za-z]\\w*", "a name of ROS such as lidar_top"),
        help="frame of the points in a ROS 2 bag (default: that of the maker's driver)",
        metavar="NAME",
    )
    ascii: bool = option(False, help="write text instead of binary data")
    truth: bool = option(True, help="columns of ground truth in the cloud", flags=("--no-truth",))
    colours: str | None = option(
        None, help="colour the points of a PLY file by a column, such as intensity", metavar="COLUMN"
    )
    labels: str | None = option(
        None,
        OneOf(LABELS),
        help=f"write labels (boxes or classes of points) beside the cloud, in the format of {', '.join(LABELS)}",
        metavar="NAME",
    )
    dataset: str | None = option(
        None, OneOf(DATASETS), help=f"write a data set with clouds and labels: {', '.join(DATASETS)}", metavar="NAME"
    )
    all_around: bool = option(False, help="label boxes outside the picture of KITTI's camera too")
    own_car: bool = option(True, help="points on the vehicle that carries the sensor", flags=("--no-own-car",))
    rrd: bool = option(
        False, help="also send every frame to the running Rerun viewer on this machine (start it with: rerun)"
    )
    deskew: bool | None = option(
        None,
        help="also write OUT.deskewed.ply, the cloud with the sensor's own motion removed; data sets contain "
        "only this cloud, as real ones do, unless False",
    )
    merge: bool = option(False, help="write one cloud with the points of all sensors of the rig")
    missed: File | None = option(
        None,
        FileName((".npz",)),
        help="write every pulse without an echo point, and the reason",
        metavar="F.npz",
        flags=("--keep-missed",),
    )
    keep_rays: File | None = option(
        None,
        FileName((".npz", ".parquet", ".ply")),
        help="write the ray of every pulse, with origin, direction, time, outcome and range, for maps of free space",
        metavar="F.npz|F.parquet|F.ply",
    )
    picture: File | None = option(
        None,
        FileName((".png", ".svg")),
        help="write a picture of the cloud and its range image (.png or .svg)",
        metavar="F.png",
    )
    range_image: File | None = option(
        None,
        FileName((".png", ".npz")),
        help="write images of range, intensity and status by ring and azimuth, with a pixel for each beam",
        metavar="F.png|F.npz",
    )
    ambient: File | None = option(
        None,
        FileName((".png", ".npz")),
        help="write the background counts of every pulse as a near-infrared image by ring and azimuth",
        metavar="F.npz|F.png",
    )
    waveforms: File | None = option(
        None,
        FileName((".npz",)),
        help="write the power on the detector and its signal over time, for a few pulses",
        metavar="F.npz",
    )
    imu: File | None = option(
        None,
        FileName(IMU_SUFFIXES),
        help="write the IMU samples of all frames, in the format of the EuRoC data sets",
        metavar="F.csv",
    )
    poses: File | None = option(
        None,
        FileName(POSE_SUFFIXES),
        help="write the true pose of the sensor at the start of each frame, as TUM lines, or KITTI's (F.txt); "
        "for merged sensors, the pose of the vehicle",
        metavar="F.tum|F.txt",
    )
    pulses: Sequence[int] | None = option(
        None,
        help=f"pulses of each frame with waveforms, counted from 0 (default: {FEW_PULSES}, evenly spaced)",
        metavar="0,100,2000-2010",
    )

    def __post_init__(self) -> None:
        check_options(self)
        self._check_together()

    def _check_together(self) -> None:
        if self.merge:
            for name in SINGLE:
                if getattr(self, name) is not None:
                    raise OptionError(
                        f"{{{name}}}: needs the clouds of single sensors, cannot be combined with {{merge}}"
                    )
        if self.dataset is not None:
            for name in ("format", "labels"):
                if getattr(self, name) is not None:
                    raise OptionError(f"{{{name}}}: a data set has its own, leave it out with {{dataset}}")
            for name in ("merge", "ascii"):
                if getattr(self, name):
                    raise OptionError(f"{{dataset}}: cannot be combined with {{{name}}}")
        if self.packets:
            for name in ("labels", "deskew", "merge", "ascii"):
                if getattr(self, name):
                    raise OptionError(f"{{{name}}}: needs clouds, cannot be combined with packets")
        for name in ("topic", "frame_id"):
            if getattr(self, name) is not None and not (self.bag is not None and self.bag.driver):
                raise OptionError(f"{{{name}}}: needs a ROS 2 bag, such as OUT.mcap")
        if self.pulses is not None and self.waveforms is None:
            raise OptionError("{pulses} needs {waveforms}")

    def epoch_ns(self, begin_s: float) -> int:
        """Nanoseconds from 1970 to the scene's second 0, of a run that begins at ``begin_s``."""
        return default_epoch_ns(begin_s) if self.epoch is None else to_ns(parse_date(self.epoch))

    @property
    def is_deskewed(self) -> bool:
        """Whether clouds without the sensor's motion are written."""
        return self.dataset is not None if self.deskew is None else self.deskew

    @property
    def packets(self) -> bool:
        """Whether the sensor's own packets are written, and no cloud."""
        by_suffix = self.format is None and self.place.name.lower().endswith(PACKETS["pcap"].suffix)
        return self.dataset is None and (by_suffix or self.format in PACKETS)

    @property
    def bag(self) -> Format | None:
        """Format that can hold several frames in one file; None if the chosen one cannot."""
        if self.dataset is not None or self.packets:
            return None
        if self.format is not None:
            chosen: Format | None = ALL[self.format]
        else:
            name = self.place.name.lower()
            chosen = next((entry for entry in ALL.values() if entry.frames and name.endswith(entry.suffix)), None)
        return chosen if chosen is not None and chosen.frames else None

    @property
    def place(self) -> Path:
        """Path of the cloud, or of the folder of clouds."""
        return Path(self.path)

    def format_of(self, *, folder: bool) -> Format:
        """Format by its name, or else by the suffix of the path; in a folder PLY."""
        if self.dataset is not None:
            return FORMATS["kitti"]
        if self.format is not None or folder:
            return ALL[self.format or "ply"]
        # The registry's message speaks of a path; here the user can name the format instead.
        try:
            return format_of(self.place)
        except InputError:
            raise OptionError(
                "{path} {0}: the name must end in one of {1}, or {format} must be given",
                self.place,
                ", ".join(SUFFIXES),
            ) from None


RUN_FILES = ("imu", "poses")
"""Options that name a file of all frames."""

EXTRA_FILES = tuple(
    name
    for name, (_, entry) in options_of(Outputs).items()
    if isinstance(entry.values, FileName) and name not in RUN_FILES
)
"""Options that name a file beside the cloud."""

SINGLE = tuple(name for name in EXTRA_FILES if name != "picture")
"""Options of EXTRA_FILES whose files hold the pulses of a single sensor."""
