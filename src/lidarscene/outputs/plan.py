"""Plan: `Outputs`, how many frames and of what in; the names of all files out, checked before any work is done.

A run may take hours. So all names are known at its start, and what cannot be written, or would write over what is
read, is refused there.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import OptionError
from ..files.atomic import require_writable
from ..formats.cloud_columns import COLUMNS
from ..formats.registry import FORMATS, SUFFIXES, Format
from ..labels.files import label_paths
from ..labels.kitti_dataset import cloud_path
from .options import ENDINGS, Outputs
from .range_image import all_range_image_paths

CLOUDS = ("output", "deskewed")
"""Keys of the files of points."""

SHARED = (*CLOUDS, "metadata")
"""Keys of the files that hold all frames, where a file can."""


@dataclass(frozen=True, slots=True)
class Plan:
    """The files of a run.

    frames  how many; None: one, whose cloud is a file and not in a folder
    rig     whether there is a rig
    """

    outputs: Outputs
    frames: int | None
    rig: bool

    @property
    def is_folder(self) -> bool:
        """Whether the path is a folder for the clouds."""
        return (
            (self.frames is not None and not self.is_one_file)
            or self.outputs.dataset is not None
            or (self.rig and not self.outputs.merge)
        )

    @property
    def is_one_file(self) -> bool:
        """Whether all frames of a sensor go into one file."""
        return self.is_bag or self.outputs.packets

    @property
    def is_bag(self) -> bool:
        """Whether all frames go into one file: its name ends as that of a format that can hold them."""
        outputs = self.outputs
        if self.frames is None or outputs.dataset is not None or (self.rig and not outputs.merge):
            return False
        bags = [one for name, one in FORMATS.items() if one.frames and outputs.format in (None, name)]
        return outputs.place.name.lower().endswith(tuple(one.suffix for one in bags))

    @property
    def format(self) -> Format:
        """That of the clouds."""
        return self.outputs.format_of(folder=self.is_folder)

    def check(self, coordinates: str, *, vectors: bool = False) -> None:
        """Raise InputError for outputs that such a run cannot have, LidarSceneError where a package is missing.

        coordinates, vectors  as in `FrameOptions` and `TraceOptions`
        """
        outputs, place = self.outputs, self.outputs.place
        if outputs.merge:
            if not self.rig:
                raise OptionError("{merge} goes with {rig}")
            if coordinates == "sensor":
                raise OptionError(
                    "{merge}: must go with {coordinates} world or vehicle, which all sensors share, got sensor"
                )
        if self.is_folder and (place.name.lower().endswith(SUFFIXES) or os.path.isfile(place)):
            asked = {"frames": self.frames is not None, "rig": self.rig, "dataset": outputs.dataset is not None}
            many = " and ".join(f"{{{option}}}" for option, there in asked.items() if there)
            raise OptionError(f"{{path}} {{0}}: must be a folder with {many}", place)
        if self.is_bag and outputs.labels is not None:
            raise OptionError("{labels}: goes with a folder of clouds, not with one file of several frames")
        chosen = self.format
        # Traced at some cost, normals and velocities would silently be in no file.
        if vectors and not outputs.truth:
            raise OptionError("{vectors}: normals and velocities are ground truth, which is left out ({truth})")
        if vectors and not chosen.all_columns:
            able = ", ".join(name for name, one in FORMATS.items() if one.all_columns)
            raise OptionError("{vectors}: must go with a format that has all columns: {0}", able)
        name = place.name.lower()
        if not self.is_folder and not name.endswith(chosen.suffix) and (outputs.packets or name.endswith(SUFFIXES)):
            raise OptionError("{path} {0}: the name must end in {1}", place, chosen.suffix)
        if outputs.ascii and not chosen.text:
            able = " and ".join(name for name, one in FORMATS.items() if one.text)
            raise OptionError("{ascii}: {0} can be text", able)
        if outputs.colours is not None:
            known = [column.name for column in COLUMNS if outputs.truth or not column.truth]
            if outputs.colours not in known:
                raise OptionError("{colours}: must be one of {0}, got {1!r}", ", ".join(known), outputs.colours)
            if not chosen.colour:
                able = " and ".join(name for name, one in FORMATS.items() if one.colour)
                raise OptionError("{colours}: {0} can have colours", able)
        chosen.require()

    def files(self, label: str, number: int) -> dict[str, Path]:
        """Files of one cloud by what they are: "output", "deskewed", "output_labels", ..., and the options of ENDINGS.

        label  of the rig's sensor; "" for clouds of a single one, and for those that are merged
        """
        # F.png of a single cloud is F.png; of several, F_front_0003.png, so that none writes over another.
        counted = "" if self.frames is None else f"{number:04d}"
        files = self._clouds(label, number)
        for option in ENDINGS:
            path = self.outputs.beside(option)
            if path is not None:
                files[option] = path.with_name("_".join(filter(None, (path.stem, label, counted))) + path.suffix)
        return files

    def distinct(self, wanted: Sequence[Mapping[str, Path]]) -> Sequence[Mapping[str, Path]]:
        """Each file once, though several frames may be in one."""
        if not self.is_one_file:
            return wanted
        seen: set[Path] = set()
        once = []
        for files in wanted:
            once.append({key: path for key, path in files.items() if key not in SHARED or path not in seen})
            seen |= {files[key] for key in SHARED if key in files}
        return once

    def _clouds(self, label: str, number: int) -> dict[str, Path]:
        """The cloud, its twin without motion, and the labels of both."""
        outputs, path, suffix = self.outputs, self.outputs.place, self.format.suffix
        if outputs.dataset is not None:
            return {"output": cloud_path(outputs.dataset, path / label, number)}
        if self.frames is not None and not self.is_one_file:
            path = path / label / f"frame_{number:04d}{suffix}"
        elif label:
            path = path / f"{label}{suffix}"
        files = {"output": path}
        if outputs.deskew:
            # `Path.stem` would leave half of a suffix with two dots, such as .pcd.bin.
            stem = path.name[: -len(suffix)] if path.name.lower().endswith(suffix) else path.stem
            files["deskewed"] = path.with_name(f"{stem}.deskewed{suffix}")
        if outputs.labels is not None:
            for key, cloud in list(files.items()):
                # Some labels are two files, such as boxes and their calibration.
                for count, beside in enumerate(label_paths(cloud, format=outputs.labels), start=1):
                    files[f"{key}_labels{count if count > 1 else ''}"] = beside
        return files


def check_writable(wanted: Sequence[Mapping[str, Path]]) -> None:
    """Refuse what could not be written, before any work goes into it. Raises OutputError.

    Two files of one name too: the second would be written over the first. Raises InputError.
    """
    taken: set[str] = set()
    for files in wanted:
        for key, path in files.items():
            require_writable(path)
            # By the file that a name leads to; a range image has others beside it.
            for file in all_range_image_paths(path) if key == "range_image" else (path,):
                real = os.path.realpath(file)
                if real in taken:
                    raise OptionError(f"{{{_option(key)}}} {{0}}: must be another name, got one of two outputs", file)
                taken.add(real)


def _option(key: str) -> str:
    """The option that names a file of `Plan.files`."""
    return key if key in ENDINGS else "path"


def keep_inputs(wanted: Sequence[Mapping[str, Path]], inputs: Sequence[Path]) -> None:
    """Refuse to write over a file that is read. Raises InputError."""
    for files in wanted:
        for key, path in files.items():
            # By identity of the file, not by name: links and ../ lead to the same one.
            if path.exists() and any(os.path.exists(one) and one.samefile(path) for one in inputs):
                raise OptionError(f"{{{_option(key)}}} {{0}}: must be another name, got an input of this run", path)
