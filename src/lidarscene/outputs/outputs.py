"""What `render` writes: clouds in a format, labels beside them, range images, data sets."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..formats.registry import FORMATS, SUFFIXES, Format, format_of

if TYPE_CHECKING:
    from ..cloud.points import PointCloud
    from ..scene.model import Scene
    from ..sensor.model import Sensor


SINGLE = ("keep_missed", "range_image", "ambient", "waveforms")
"""Options for files of one sensor's pulses."""

FEW_PULSES = 9

Append = Callable[["PointCloud"], None]


def check_output_options(arguments: argparse.Namespace) -> None:
    """Refuse options that do not go together, and formats whose packages are not there."""
    if arguments.dataset is not None:
        for option in ("format", "labels"):
            if getattr(arguments, option) is not None:
                raise InputError(f"--{option}: a data set has its own, leave it out with --dataset")
        if arguments.merge or arguments.ascii:
            raise InputError(f"--dataset: goes without {'--merge' if arguments.merge else '--ascii'}")
    chosen = chosen_format(arguments)
    if arguments.ascii and not chosen.text:
        able = " and ".join(name for name, one in FORMATS.items() if one.text)
        raise InputError(f"--ascii: {able} can be text")
    chosen.require()
    if arguments.pulses is not None and arguments.waveforms is None:
        raise InputError("--pulses goes with --waveforms")
    if arguments.range_image is not None:
        from .range_image import range_image_paths

        range_image_paths(arguments.range_image)


def is_folder(arguments: argparse.Namespace) -> bool:
    """Whether -o is a folder for the clouds."""
    of_rig = arguments.rig is not None and not arguments.merge
    return bool(arguments.frames or arguments.dataset) or of_rig


def chosen_format(arguments: argparse.Namespace) -> Format:
    """The format that is asked for by name or by the name of the file; that of a folder is PLY."""
    if arguments.dataset is not None:
        return FORMATS["kitti"]
    if arguments.format is not None or is_folder(arguments):
        return FORMATS[arguments.format or "ply"]
    try:
        return format_of(arguments.output)
    except InputError:
        expected = ", ".join(SUFFIXES)
        raise InputError(
            f"--output {arguments.output}: a name that ends in one of {expected} was expected, or --format"
        ) from None


def cloud_files(arguments: argparse.Namespace, label: str, number: int) -> dict[str, Path]:
    """Files of one cloud and its labels by what they are; ``label`` is that of the rig's sensor."""
    output, suffix = arguments.output, chosen_format(arguments).suffix
    if arguments.dataset is not None:
        from ..labels.kitti_dataset import cloud_path

        return {"output": cloud_path(arguments.dataset, output / label, number)}
    if arguments.frames:
        output = output / label / f"frame_{number:04d}{suffix}"
    elif label:
        output = output / f"{label}{suffix}"
    files = {"output": output}
    if arguments.deskew:
        stem = output.name[: -len(suffix)] if output.name.lower().endswith(suffix) else output.stem
        files["deskewed"] = output.with_name(f"{stem}.deskewed{suffix}")
    if arguments.labels is not None:
        from ..labels.files import label_paths

        for key, path in list(files.items()):
            for count, beside in enumerate(label_paths(path, format=arguments.labels), start=1):
                files[f"{key}_labels{count if count > 1 else ''}"] = beside
    return files


@contextmanager
def cloud_stream(arguments: argparse.Namespace, path: Path, points: int) -> Iterator[Append]:
    """Write the clouds that are appended in the block as one; together, of so many points at most, where the format
    needs them so.
    """
    from ..cloud.builder import CloudBuilder
    from ..cloud.points import PointCloud

    chosen, options = chosen_format(arguments), {"ascii": True} if arguments.ascii else {}
    if chosen.stream is not None:
        with chosen.stream(path, **options) as append:
            yield _kept(arguments, append)
        return
    builder = CloudBuilder(capacity=points)
    yield _kept(arguments, builder.add)
    PointCloud(**builder.fields()).save(path, format=arguments.format, **options)


@contextmanager
def dataset_stream(arguments: argparse.Namespace, label: str, number: int, scene: Scene) -> Iterator[Append]:
    """Write the clouds that are appended in the block as a frame of a data set."""
    from ..labels.kitti_dataset import frame_stream

    with frame_stream(arguments.dataset, arguments.output / label, number, scene) as append:
        yield _kept(arguments, append)


def _kept(arguments: argparse.Namespace, append: Append) -> Append:
    """Append what is asked for."""
    return (lambda cloud: append(cloud.without_truth())) if arguments.no_truth else append


def pulses_of_waveforms(arguments: argparse.Namespace, sensor: Sensor) -> Sequence[int]:
    """The pulses that are asked for, or a few. Raises InputError."""
    from ..detection.sampled_waveforms import check_pulses

    last = sensor.scanner.pulses - 1
    few = [last * number // (FEW_PULSES - 1) for number in range(FEW_PULSES)]
    chosen = check_pulses(arguments.pulses or few, sensor)
    return [int(pulse) for pulse in chosen]
