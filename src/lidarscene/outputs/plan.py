"""Plan: `Outputs`, the number of frames in; the names of all files out, checked before any work is done.

A run may take hours. So all names are made at its start, and a file that cannot be written, or would overwrite an
input, is refused there.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import OptionError, OptionWarning, warn
from ..files.atomic import require_writable
from ..files.inputs import by_numbers
from ..formats.cloud_columns import columns_of
from ..formats.osi import trace_name
from ..formats.registry import FORMATS, SUFFIXES, Format, formats_with
from ..labels.files import label_paths
from ..labels.kitti_dataset import cloud_path
from .output_options import EXTRA_FILES, RUN_FILES, Outputs
from .range_image import all_range_image_paths

CLOUDS = ("output", "deskewed")
"""Keys of the files of points."""

BAG_FILE = "metadata.yaml"
"""File of a bag that is a folder."""

SHARED = (*CLOUDS, "metadata")
"""Keys of the files that hold all frames, where the format can."""


@dataclass(frozen=True, slots=True)
class Plan:
    """File names of a run.

    Attributes:
        frames: number of frames; None: one, whose cloud is a file and not in a folder
        rig: whether there is a rig
        begin_s: time of the scene at which frame 0 begins
    """

    outputs: Outputs
    frames: int | None
    rig: bool
    begin_s: float = 0.0

    @property
    def is_folder(self) -> bool:
        """Whether the path is a folder for the clouds."""
        bag, rig = self.outputs.bag, self.rig and not self.outputs.merge
        if self.is_bag and bag is not None:
            # A bag of ROS 2 holds all sensors; a trace of OSI is of one, and has a name of its own in a folder.
            return (rig or not self._names_file(bag)) if not bag.rig else False
        return (self.frames is not None and not self.is_one_file) or rig or self.outputs.dataset is not None

    @property
    def is_one_file(self) -> bool:
        """Whether all frames of a sensor go into one file."""
        return self.is_bag or self.outputs.packets

    @property
    def is_bag(self) -> bool:
        """Whether all frames of a sensor go into one file, or one folder, of a format that can hold them.

        A bag's name ends as its format's do; without, frames are files in a folder. A trace of OSI may have any name.
        """
        bag = self.outputs.bag
        if bag is None:
            return False
        return bag.folder or self._names_file(bag) or (not bag.rig and (self.frames is not None or self.rig))

    def _names_file(self, bag: Format) -> bool:
        return self.outputs.place.name.lower().endswith(bag.suffix)

    @property
    def has_truth(self) -> bool:
        """Whether the labels are in the clouds' own file: ground truth in a trace of OSI."""
        return self.is_bag and not self.format.rig and self.outputs.labels == "osi"

    @property
    def format(self) -> Format:
        """Format of the clouds."""
        return self.outputs.format_of(folder=self.is_folder)

    def check(self, coordinates: str, *, vectors: bool = False) -> None:
        """Raise InputError for outputs that this run cannot have, LidarSceneError where a package is missing.

        Args:
            coordinates: as in `FrameOptions`
            vectors: as in `TraceOptions`
        """
        outputs, place = self.outputs, self.outputs.place
        if outputs.merge:
            if not self.rig:
                raise OptionError("{merge} needs {rig}")
            if coordinates == "sensor":
                raise OptionError("{merge}: needs {coordinates} world or vehicle, which all sensors share, got sensor")
        if self.is_folder and (place.name.lower().endswith(SUFFIXES) or os.path.isfile(place)):
            many_clouds = {"frames": self.frames is not None, "rig": self.rig, "dataset": outputs.dataset is not None}
            options = " and ".join(f"{{{option}}}" for option, applies in many_clouds.items() if applies)
            raise OptionError(f"{{path}} {{0}}: must be a folder with {options}", place)
        if self.is_bag and not self.has_truth and outputs.labels is not None and (self.frames is not None or self.rig):
            raise OptionError("{labels}: needs a folder of clouds, got one file for several frames")
        chosen = self.format
        # Traced at some cost, normals and velocities would silently be in no file.
        if vectors and not outputs.truth:
            raise OptionError("{vectors}: normals and velocities are ground truth, which is left out ({truth})")
        if vectors and not chosen.all_columns:
            able = ", ".join(formats_with("all_columns"))
            raise OptionError("{vectors}: needs a format that has all columns: {0}", able)
        name = place.name.lower()
        if not self.is_folder and not name.endswith(chosen.suffix) and (outputs.packets or name.endswith(SUFFIXES)):
            raise OptionError("{path} {0}: the name must end in {1}", place, chosen.suffix)
        if outputs.ascii and not chosen.text:
            raise OptionError("{ascii}: {0} can be text", " and ".join(formats_with("text")))
        if outputs.colours is not None:
            column_names = [column.name for column in columns_of(truth=outputs.truth, vectors=False)]
            if outputs.colours not in column_names:
                raise OptionError("{colours}: must be one of {0}, got {1!r}", ", ".join(column_names), outputs.colours)
            if not chosen.colour:
                raise OptionError("{colours}: {0} can have colours", " and ".join(formats_with("colour")))
        chosen.require()
        if outputs.keep_rays is not None and Path(outputs.keep_rays).suffix.lower() == ".parquet":
            FORMATS["parquet"].require()

    def files(self, label: str, number: int) -> dict[str, Path]:
        """Files of one cloud by key: "output", "deskewed", "output_labels", ..., and the options of EXTRA_FILES.

        Args:
            label: label of the rig's sensor; "" for a single sensor, and for merged clouds
        """
        # F.png of a single cloud is F.png; of several, F_front_0003.png, so that none writes over another.
        counted = "" if self.frames is None else f"{number:04d}"
        files = self._clouds(label, number)
        for option in EXTRA_FILES:
            file = getattr(self.outputs, option)
            if file is not None:
                path = Path(file)
                files[option] = path.with_name("_".join(filter(None, (path.stem, label, counted))) + path.suffix)
        return files

    def run_files(self, option: str, labels: Sequence[str]) -> dict[str, Path]:
        """Files of all frames of an option of RUN_FILES, by label of the sensor; empty if they are not asked for."""
        file = getattr(self.outputs, option)
        if file is None:
            return {}
        path = Path(file)
        return {label: path.with_name("_".join(filter(None, (path.stem, label))) + path.suffix) for label in labels}

    def distinct(self, clouds: Sequence[Mapping[str, Path]]) -> Sequence[Mapping[str, Path]]:
        """Drop repeated names of files that hold several frames, so that each file is there once."""
        if not self.is_one_file:
            return clouds
        earlier: set[Path] = set()
        distinct = []
        for files in clouds:
            distinct.append({key: path for key, path in files.items() if key not in SHARED or path not in earlier})
            earlier |= {files[key] for key in SHARED if key in files}
        return distinct

    def _clouds(self, label: str, number: int) -> dict[str, Path]:
        """Files of the cloud, of the deskewed cloud, and of the labels of both."""
        outputs, path, suffix = self.outputs, self.outputs.place, self.format.suffix
        if outputs.dataset is not None:
            return {"output": cloud_path(outputs.dataset, path / label, number)}
        if self.frames is not None and not self.is_one_file:
            path = path / label / f"frame_{number:04d}{suffix}"
        elif self.is_bag and self.is_folder:
            name = trace_name("sd", self.frames or 1, label or path.name, outputs.epoch_ns(self.begin_s), suffix)
            path = path / name
        elif label and not self.is_bag:
            path = path / f"{label}{suffix}"
        files = {"output": path}
        if outputs.deskew:
            # `Path.stem` would leave half of a suffix with two dots, such as .pcd.bin.
            stem = path.name[: -len(suffix)] if path.name.lower().endswith(suffix) else path.stem
            # ASAM's names have one dot.
            dot = "-" if self.is_bag and self.is_folder else "."
            files["deskewed"] = path.with_name(f"{stem}{dot}deskewed{suffix}")
        if outputs.labels is not None and not self.has_truth:
            for key, cloud in list(files.items()):
                # Some labels are two files, such as boxes and their calibration.
                for count, label_path in enumerate(label_paths(cloud, format=outputs.labels), start=1):
                    files[f"{key}_labels{count if count > 1 else ''}"] = label_path
        return files


def check_writable(plan: Plan, clouds: Sequence[Mapping[str, Path]]) -> None:
    """Raise OutputError for a file that could not be written, before any work goes into it.

    Raises:
        InputError: for two outputs with one name: the second would overwrite the first
    """
    clouds = plan.distinct(clouds)
    is_set = plan.outputs.dataset is not None
    if is_set or (plan.frames is not None and not plan.is_one_file):
        _tell_of_later_frames([files["output"] for files in clouds if "output" in files], refuse=is_set)
    is_folder = plan.is_bag and plan.format.folder
    folders = {files[key] for files in clouds for key in CLOUDS if key in files} if is_folder else set()
    real_paths: set[str] = set()
    for files in clouds:
        for key, path in files.items():
            require_writable(path / BAG_FILE if path in folders else path)
            # Compared after links are resolved; a range image is several files.
            for file in all_range_image_paths(path) if key == "range_image" else (path,):
                real = os.path.realpath(file)
                if real in real_paths:
                    raise OptionError(f"{{{_option(key)}}} {{0}}: must be another name, got one of two outputs", file)
                real_paths.add(real)


def _tell_of_later_frames(paths: Sequence[Path], *, refuse: bool) -> None:
    """Raise OptionError, or warn, where there are frames after this run's last: they are of another run."""

    def place(file: Path) -> list[tuple[int, str]]:
        return by_numbers(Path(file.name.split(".")[0]))

    for folder, frames in itertools.groupby(sorted(paths, key=lambda path: path.parent), lambda path: path.parent):
        last = max(frames, key=place)
        later = [file for file in folder.glob(f"[0-9f]*{last.suffix}") if place(file) > place(last)]
        if later:
            message = "{path} {0}: holds {1} of an earlier run, after this run's last frame, {2}; choose another folder"
            names = min(later, key=by_numbers).name, last.name
            if refuse:
                raise OptionError(message, folder, *names)
            warn(OptionWarning(message, folder, *names))


def _option(key: str) -> str:
    """Name of the option behind a key of `Plan.files`."""
    return key if key in (*EXTRA_FILES, *RUN_FILES) else "path"


def protect_inputs(clouds: Sequence[Mapping[str, Path]], inputs: Sequence[Path]) -> None:
    """Raise InputError for an output that would overwrite a file the run reads."""
    for files in clouds:
        for key, path in files.items():
            # By identity of the file, not by name: links and ../ lead to the same one.
            if path.exists() and any(os.path.exists(source) and source.samefile(path) for source in inputs):
                raise OptionError(f"{{{_option(key)}}} {{0}}: must be another name, got an input of this run", path)
