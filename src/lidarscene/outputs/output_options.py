"""Outputs: every file that a frame becomes, declared once for the library and the command line.

A wrong combination raises an error when the options are made. Errors name options in braces, which the command line
replaces by its own names.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import ClassVar

from ..errors import InputError, OptionError
from ..formats.registry import DATASETS, FORMATS, LABELS, PACKETS, SUFFIXES, Format, format_of
from ..rendering.render_options import Whole

File = str | os.PathLike[str]

ENDINGS = {
    "missed": (".npz",),
    "picture": (".png", ".svg"),
    "range_image": (".png", ".npz"),
    "ambient": (".png", ".npz"),
    "waveforms": (".npz",),
}
"""Option of a file beside the cloud -> suffixes that its name may have."""

SINGLE = ("missed", "range_image", "ambient", "waveforms")
"""Options of ENDINGS whose files hold the pulses of a single sensor."""

FRAMES = Whole(1, 10_000)
"""Frames of a run; file names have four digits for the number."""

FEW_PULSES = 9
"""Default number of pulses with waveforms."""


@dataclass(frozen=True, slots=True)
class Outputs:
    """Every file that a frame becomes.

    path         file of the point cloud; a folder for the clouds of several frames, of a rig or of a data set. A bag of
                 ROS 2, such as drive.mcap, and packets hold several frames in one file
    format       format of the cloud, a key of `formats.registry.FORMATS` or PACKETS; None: by the name's suffix, PLY in
                 a folder
    ascii        whether the cloud is text instead of binary
    colours      column by which points get red, green and blue, as in pictures; for PLY files
    truth        whether the cloud has the columns of ground truth; labels are made of the truth either way
    labels       boxes or classes beside the cloud, a key of `formats.registry.LABELS`
    dataset      makes the folder a data set, clouds and labels: one of `formats.registry.DATASETS`
    deskew       whether a second cloud without the sensor's own motion is written
    merge        whether the sensors of a rig make one cloud
    picture      a view of the cloud and its range image, .png or .svg
    range_image  range, intensity and status by ring and azimuth, .png or .npz
    missed       every pulse without an echo point, and why, .npz
    ambient      background counts of every pulse, .png or .npz
    waveforms    power on the detector and its signal against time, .npz
    pulses       pulses of a frame with waveforms, 0 for its first; None: a few, evenly spaced
    Each of several frames or sensors has files of its own: labels and numbers are added to the names.
    Raises InputError for options that do not go together.
    """

    KEYWORD: ClassVar[str] = "outputs"

    path: File
    _: KW_ONLY
    format: str | None = None
    ascii: bool = False
    truth: bool = True
    colours: str | None = None
    labels: str | None = None
    dataset: str | None = None
    deskew: bool = False
    merge: bool = False
    picture: File | None = None
    range_image: File | None = None
    missed: File | None = None
    ambient: File | None = None
    waveforms: File | None = None
    pulses: Sequence[int] | None = None

    def __post_init__(self) -> None:
        for option, choices in (("format", FORMATS | PACKETS), ("labels", LABELS), ("dataset", DATASETS)):
            name = getattr(self, option)
            if name is not None and name not in choices:
                raise OptionError(f"{{{option}}}: must be one of {{0}}, got {{1!r}}", ", ".join(choices), name)
        self._check_together()
        for option, endings in ENDINGS.items():
            file = self.extra_file(option)
            if file is not None and file.suffix.lower() not in endings:
                raise OptionError(f"{{{option}}} {{0}}: the name must end in {{1}}", file, " or ".join(endings))

    def _check_together(self) -> None:
        if self.merge:
            for option in SINGLE:
                if self.extra_file(option) is not None:
                    raise OptionError(f"{{{option}}}: goes with the clouds of single sensors, not with {{merge}}")
        if self.dataset is not None:
            for option in ("format", "labels"):
                if getattr(self, option) is not None:
                    raise OptionError(f"{{{option}}}: a data set has its own, leave it out with {{dataset}}")
            for option in ("merge", "ascii"):
                if getattr(self, option):
                    raise OptionError(f"{{dataset}}: goes without {{{option}}}")
        if self.packets:
            for option in ("labels", "deskew", "merge", "ascii"):
                if getattr(self, option):
                    raise OptionError(f"{{{option}}}: goes with clouds, not with packets")
        if self.pulses is not None and self.waveforms is None:
            raise OptionError("{pulses} goes with {waveforms}")

    @property
    def packets(self) -> bool:
        """Whether the sensor's own packets are written, and no cloud."""
        by_suffix = self.format is None and self.place.name.lower().endswith(PACKETS["pcap"].suffix)
        return self.dataset is None and (by_suffix or self.format in PACKETS)

    @property
    def place(self) -> Path:
        """Path of the cloud, or of the folder of clouds."""
        return Path(self.path)

    def extra_file(self, option: str) -> Path | None:
        """File that an option of ENDINGS names; None without it."""
        file = getattr(self, option)
        return None if file is None else Path(file)

    def format_of(self, *, folder: bool) -> Format:
        """Format by its name, or else by the suffix of the path; in a folder PLY."""
        if self.dataset is not None:
            return FORMATS["kitti"]
        if self.format is not None or folder:
            return (FORMATS | PACKETS)[self.format or "ply"]
        # The registry's message speaks of a path; here the user can name the format instead.
        try:
            return format_of(self.place)
        except InputError:
            raise OptionError(
                "{path} {0}: the name must end in one of {1}, or go with {format}", self.place, ", ".join(SUFFIXES)
            ) from None
